//! What a version is given to see: the parts of an observation whose sensor or tool its manifest declares.
//!
//! An input that is not declared is delivered empty: an empty vector, a NaN, an absent estimate, a tool that does not
//! answer. Code that uses it anyway computes NaN, which the guard stops.

use holdpoint_body::{Command, Observation, Pose, Twist};
use holdpoint_governance::manifest::Permissions;
use holdpoint_governance::mode::{Sensor, Tool};

use super::skill::{ConfinementReport, Hook, Skill};

/// Which parts of an observation are delivered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Senses {
    camera: bool,
    joints: bool,
    wrist: bool,
    gripper: bool,
    named: bool,
}

impl Senses {
    /// Those that a manifest declares.
    #[must_use]
    pub fn of(declared: &Permissions) -> Self {
        Self {
            camera: declared.sensors.contains(&Sensor::Camera),
            joints: declared.sensors.contains(&Sensor::Joints),
            wrist: declared.sensors.contains(&Sensor::WristForce),
            gripper: declared.tools.contains(&Tool::ParallelGripper),
            named: declared.sensors.contains(&Sensor::Named),
        }
    }

    const fn are_all(self) -> bool {
        self.camera && self.joints && self.wrist && self.gripper && self.named
    }

    /// A run that is given these parts alone.
    #[must_use]
    pub fn confine(self, skill: Box<dyn Skill>) -> Box<dyn Skill> {
        // Nothing is withheld, so nothing has to be copied.
        if self.are_all() { skill } else { Box::new(FilteredSkill { senses: self, skill }) }
    }

    fn withhold(self, seen: &mut Observation) {
        // What is withheld is no number.
        const NONE: [f64; 3] = [f64::NAN; 3];
        if !self.camera {
            seen.objects.clear();
        }
        if !self.joints {
            seen.q.clear();
            seen.dq.clear();
            seen.tau.clear();
            seen.tool = Pose { position: NONE, rotation: [f64::NAN; 4] };
            seen.tool_twist = Twist { linear: NONE, angular: NONE };
        }
        if !self.wrist {
            seen.wrist_force_n = f64::NAN;
        }
        if !self.gripper {
            seen.gripper_width_m = f64::NAN;
            seen.gripper_force_n = f64::NAN;
            seen.tool_available = false;
        }
        if !self.named {
            seen.sensors.clear();
        }
    }
}

/// A run behind its manifest's declaration.
struct FilteredSkill {
    senses: Senses,
    skill: Box<dyn Skill>,
}

impl Skill for FilteredSkill {
    fn tick(&mut self, seen: &Observation) -> Command {
        let mut delivered = seen.clone();
        self.senses.withhold(&mut delivered);
        self.skill.tick(&delivered)
    }

    fn enter(&mut self, hook: Hook) {
        self.skill.enter(hook);
    }

    fn fork(&self) -> Option<Box<dyn Skill>> {
        Some(Box::new(Self { senses: self.senses, skill: self.skill.fork()? }))
    }

    fn confined(&self) -> ConfinementReport {
        self.skill.confined()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use holdpoint_body::{Estimate, GuardVerdict, JointVec, NamedReading, ObjectName, TaskKind};
    use holdpoint_governance::manifest::Manifest;

    use super::*;

    struct ObservationSender(mpsc::Sender<Observation>);

    impl Skill for ObservationSender {
        fn tick(&mut self, seen: &Observation) -> Command {
            self.0.send(seen.clone()).unwrap();
            Command::Hold
        }
        fn enter(&mut self, _: Hook) {}
    }

    fn whole() -> Observation {
        let one = JointVec::from_iter([1.0; 7]);
        let estimate = Estimate { pose: Pose::IDENTITY, age_ticks: 0, sequence: 1 };
        let name = ObjectName::from("pad-forces").unwrap();
        let reading = NamedReading { name, age_ticks: 0, values: [1.0, 5.0].into_iter().collect() };
        Observation {
            tick: 1,
            q: one.clone(),
            dq: one.clone(),
            tau: one,
            tool: Pose::IDENTITY,
            tool_twist: Twist::default(),
            gripper_width_m: 0.05,
            gripper_force_n: 3.0,
            wrist_force_n: 2.0,
            objects: TaskKind::Grasp.seen_objects(Some(estimate), Some(estimate)),
            sensors: [reading].into_iter().collect(),
            tool_available: true,
            goal: TaskKind::Grasp,
            guard: GuardVerdict::Allowed,
        }
    }

    /// What a version sees that declares everything but one word: what the baseline's manifest does, and named sensors.
    fn without(name: &str) -> Observation {
        let text = include_str!("../../manifests/grasp/1.0.0/manifest.toml");
        let text = text.replace("sensors = [", "sensors = [\"named\", ");
        let less = text.replace(&format!("\"{name}\", "), "").replace(&format!(", \"{name}\""), "");
        let less = less.replace(&format!("[\"{name}\"]"), "[]");
        let manifest = Manifest::parse("manifest.toml", &less).unwrap();
        let (sender, receiver) = mpsc::channel();
        let mut skill = Senses::of(&manifest.permissions).confine(Box::new(ObservationSender(sender)));
        skill.tick(&whole());
        receiver.recv().unwrap()
    }

    #[test]
    fn only_undeclared_inputs_are_withheld() {
        assert_eq!(without("no such word"), whole());
        let camera = without("camera");
        assert!(camera.objects.is_empty());
        assert_eq!(Observation { objects: whole().objects, ..camera }, whole());
        let joints = without("joints");
        assert!(joints.q.is_empty() && joints.dq.is_empty() && joints.tau.is_empty());
        assert!(joints.tool.position[0].is_nan() && joints.tool_twist.linear[2].is_nan());
        assert_eq!((joints.wrist_force_n, joints.objects), (2.0, whole().objects));
        let wrist = without("wrist-force");
        assert!(wrist.wrist_force_n.is_nan());
        assert_eq!(Observation { wrist_force_n: 2.0, ..wrist }, whole());
        let named = without("named");
        assert!(named.sensors.is_empty());
        assert_eq!(Observation { sensors: whole().sensors, ..named }, whole());
        let gripper = without("parallel-gripper");
        assert!(
            gripper.gripper_width_m.is_nan() && gripper.gripper_force_n.is_nan() && !gripper.tool_available
        );
        assert_eq!((gripper.q.len(), gripper.wrist_force_n), (7, 2.0));
    }
}
