//! Hard stops of scenes that two versions worked: whose each of them is.

use holdpoint_governance::evidence::HardStop;
use holdpoint_governance::profile::Profile;
use holdpoint_governance::shared_event::{SceneKind, SharedEvent, StoppingEvent, one_sided};
use holdpoint_runtime::task::TaskRecord;

use crate::past_limit::past_limit;

/// Hard stops so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneStops {
    /// The candidate's alone.
    pub own: Vec<HardStop>,
    /// Of both versions in one scene.
    pub shared: Vec<SharedEvent>,
    /// The candidate's in scenes that gave no valid episode of the other version. They count for neither version until a valid
    /// scene shows the same stop.
    pub uncompared: Vec<HardStop>,
}

impl SceneStops {
    /// Takes in a scene that the candidate and the version compared with have worked.
    pub fn note(&mut self, scene: SceneKind, candidate: &TaskRecord, other: &TaskRecord, profile: &Profile) {
        let Some(stop) = candidate.hard_stop else { return };
        if other.invalid {
            self.uncompared.push(stop);
            return;
        }
        self.uncompared.retain(|waiting| *waiting != stop);
        match one_sided(candidate.hard_stop, other.hard_stop) {
            Some(stop) => self.own.push(stop),
            None => self.shared.push(SharedEvent {
                scene,
                seed: candidate.seed,
                event: StoppingEvent::HardStop(stop),
                past: past_limit(StoppingEvent::HardStop(stop), other, profile),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::TaskKind;
    use holdpoint_governance::profile::ProfileName;

    #[test]
    fn stop_of_both_versions_in_one_scene_counts_for_neither() {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let record = |hard_stop| TaskRecord {
            hard_stop,
            unsafe_continuation_ms: 640,
            invalid: false,
            ..TaskRecord::invalid(TaskKind::Grasp, 7)
        };
        let (moves, asks) = (Some(HardStop::MotionAfterStop), Some(HardStop::CommandPastGuard));
        for (candidate, other, own, shared) in
            [(moves, moves, 0, 1), (moves, None, 1, 0), (moves, asks, 1, 0), (None, moves, 0, 0)]
        {
            let mut stops = SceneStops::default();
            stops.note(SceneKind::Pair, &record(candidate), &record(other), &profile);
            assert_eq!((stops.own.len(), stops.shared.len()), (own, shared), "{candidate:?} {other:?}");
            for shared in stops.shared {
                let past = shared.past.unwrap();
                assert_eq!((past.value, past.limit), (640.0, profile.runtime.unsafe_continuation_max_ms));
            }
        }
    }

    /// The candidate was rejected for it, though nothing showed that the active version does otherwise.
    #[test]
    fn stop_beside_an_invalid_episode_waits_for_a_valid_scene() {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let stop = Some(HardStop::MotionAfterStop);
        let valid =
            |hard_stop| TaskRecord { hard_stop, invalid: false, ..TaskRecord::invalid(TaskKind::Grasp, 7) };
        let invalid = TaskRecord::invalid(TaskKind::Grasp, 7);
        for (other, own, shared) in [(None, 1, 0), (stop, 0, 1)] {
            let mut stops = SceneStops::default();
            stops.note(SceneKind::Pair, &valid(stop), &invalid, &profile);
            stops.note(SceneKind::Pair, &valid(None), &valid(None), &profile);
            assert_eq!((stops.own.len(), stops.shared.len(), stops.uncompared.len()), (0, 0, 1));
            stops.note(SceneKind::Pair, &valid(stop), &valid(other), &profile);
            let counts = (stops.own.len(), stops.shared.len(), stops.uncompared.len());
            assert_eq!(counts, (own, shared, 0), "{other:?}");
        }
    }
}
