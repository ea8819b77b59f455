//! Compares the start of a live task with the domain of its version's evidence, before the skill sees what is outside.
//!
//! Owns what was seen at the start and what was found. It decides nothing: the rule is [`StartDomain`], and the profile
//! names the response.

use std::sync::Arc;

use holdpoint_body::Observation;
use holdpoint_governance::start_domain::{DomainMiss, StartDomain, StartObservation, Uncovered};

/// The comparison of one task.
#[derive(Clone, Debug)]
pub struct StartCheck {
    domain: Arc<StartDomain>,
    /// Whether the skill is not given a task that starts outside.
    refuses: bool,
    /// Absent before the first tick.
    seen: Option<StartObservation>,
    found: Uncovered,
}

impl StartCheck {
    /// A comparison with this domain. `refuses`: the skill is not given a task that starts outside.
    #[must_use]
    pub fn new(domain: Arc<StartDomain>, refuses: bool) -> Self {
        Self { domain, refuses, seen: None, found: Uncovered::default() }
    }

    /// Adds what the skill is about to see; `is_held`: the hand holds something. Returns whether the skill must not see
    /// it. After the start only the age of camera frames is compared: the skill controls everything else.
    pub(crate) fn observe(&mut self, observation: &Observation, is_held: bool) -> bool {
        match &mut self.seen {
            Some(seen) if seen.has_frame() => {
                let age = observation.object().map(|seen| seen.age_ticks);
                if age.is_some_and(|ticks| !self.domain.covers_age(ticks)) {
                    self.found.old_frame_ticks = self.found.old_frame_ticks.saturating_add(1);
                }
                return false;
            }
            Some(seen) => seen.see(observation),
            none @ None => *none = Some(StartObservation::new(observation, is_held)),
        }
        self.found.start = self.seen.as_ref().map(|seen| self.domain.misses(seen)).unwrap_or_default();
        self.refuses && !self.found.start.is_empty()
    }

    /// What of the task is not covered; `None` if everything is.
    #[must_use]
    pub fn uncovered(&self) -> Option<Uncovered> {
        (!self.found.is_empty()).then(|| self.found.clone())
    }

    /// The start that the skill was not given, and how it lies outside; `None` if it was given.
    #[must_use]
    pub fn refused(&self) -> Option<(&StartObservation, &[DomainMiss])> {
        let refused = self.refuses && !self.found.start.is_empty();
        self.seen.as_ref().filter(|_| refused).map(|seen| (seen, &*self.found.start))
    }
}

#[cfg(test)]
mod tests {
    use holdpoint_body::{Estimate, GuardVerdict, JointVec, Pose, ReadingVec, TaskKind, Twist};
    use holdpoint_governance::start_domain::{StartBound, StartQuantity};

    use super::*;

    fn observation(object_x_m: Option<f64>, age_ticks: u32) -> Observation {
        let estimate =
            |x| Estimate { pose: Pose { position: [x, 0.0, 0.0], ..Pose::IDENTITY }, age_ticks, sequence: 1 };
        Observation {
            tick: 0,
            q: JointVec::new(),
            dq: JointVec::new(),
            tau: JointVec::new(),
            tool: Pose::IDENTITY,
            tool_twist: Twist::default(),
            gripper_width_m: 0.08,
            gripper_force_n: 0.0,
            wrist_force_n: 0.0,
            objects: TaskKind::Grasp
                .seen_objects(object_x_m.map(estimate), object_x_m.map(|_| estimate(0.5))),
            sensors: ReadingVec::new(),
            tool_available: true,
            goal: TaskKind::Grasp,
            guard: GuardVerdict::Allowed,
        }
    }

    fn check(refuses: bool) -> StartCheck {
        let bounds = vec![
            StartBound { quantity: StartQuantity::ObjectX, low: 0.4, high: 0.6 },
            StartBound { quantity: StartQuantity::PictureAge, low: 0.0, high: 100.0 },
            StartBound { quantity: StartQuantity::Held, low: 0.0, high: 0.0 },
        ];
        StartCheck::new(Arc::new(StartDomain { bounds }), refuses)
    }

    #[test]
    fn the_skill_is_not_given_the_first_frame_outside() {
        let mut refusing = check(true);
        assert!(!refusing.observe(&observation(None, 0), false), "nothing outside has been seen");
        assert!(refusing.refused().is_none());
        assert!(refusing.observe(&observation(Some(0.7), 4), false));
        assert_eq!(refusing.refused().map(|(_, missed)| missed.len()), Some(1));
        // A hand that holds something is known before the first frame.
        assert!(check(true).observe(&observation(None, 0), true));
        let mut counting = check(false);
        assert!(!counting.observe(&observation(Some(0.7), 4), false));
        assert!(counting.refused().is_none() && counting.uncovered().is_some());
    }

    #[test]
    fn after_the_start_only_the_age_of_frames_is_compared() {
        let mut check = check(true);
        for (object_x_m, age_ticks) in [(0.5, 24), (0.9, 24), (0.5, 25), (0.9, 30)] {
            assert!(!check.observe(&observation(Some(object_x_m), age_ticks), false));
        }
        assert!(!check.observe(&observation(None, 0), true));
        assert_eq!(check.uncovered(), Some(Uncovered { start: Vec::new(), old_frame_ticks: 2 }));
    }

    #[test]
    fn a_covered_task_leaves_nothing_on_record() {
        let mut check = check(true);
        assert!(!check.observe(&observation(Some(0.5), 24), false));
        assert_eq!(check.uncovered(), None);
    }
}
