//! What a task does after its skill says that it is done.

use std::sync::Arc;

use holdpoint_body::{Body, Interrupt, RATE_HZ};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_sim::RobotModel;
use holdpoint_sim::scene::Scene;
use holdpoint_sim::world::World;

use super::*;
use crate::arm::Arm;
use crate::skill::Hook;
use crate::terms::SkillTerms;

struct Done;

impl Skill for Done {
    fn tick(&mut self, _: &Observation) -> Command {
        Command::Done
    }
    fn enter(&mut self, _: Hook) {}
}

/// The simulated cell, of which the wrist tells a blow from a tick on.
struct Struck {
    world: World,
    ticks: u64,
    from: u64,
}

impl Body for Struck {
    fn observe(&mut self, last: GuardVerdict) -> Observation {
        Body::observe(&mut self.world, last)
    }
    fn telemetry(&self) -> Telemetry {
        let mut seen = Body::telemetry(&self.world);
        if self.ticks >= self.from {
            seen.contact_force_n = 400.0;
        }
        seen
    }
    fn step(&mut self, command: &Command) -> Result<(), BodyError> {
        self.ticks += 1;
        Body::step(&mut self.world, command)
    }
    fn interrupt(&mut self, interrupt: Interrupt) {
        Body::interrupt(&mut self.world, interrupt);
    }
    fn inspect(&self) -> bool {
        true
    }
}

/// Runs a skill that is done at once on a body that is struck from a tick on.
fn work(from: u64, supervise: &mut Supervisor<'_, Struck>) -> TaskRecord {
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
    let (model, scene) = (RobotModel::builtin("arm7").unwrap(), Scene::cell().unwrap());
    let world = World::new(&model, &scene).unwrap();
    let terms = SkillTerms::new(&profile, table, Arc::new(model.geometry), scene.zones.into());
    let authority = holdpoint_governance::mode::Authority::ALL[0];
    let mut guard = terms.guard(authority);
    let mut arm = Arm::new(Struck { world, ticks: 0, from });
    let task = terms.task(TaskKind::Grasp, 1, 0.5);
    run(&mut arm.handle(), &mut Done, &mut guard, &task, supervise).unwrap()
}

#[test]
fn a_blow_after_the_last_word_is_a_violation() {
    let quiet = work(u64::MAX, &mut |_, _| Supervision::Continue);
    assert!(quiet.success && !quiet.violation, "{quiet:?}");
    let struck = work(4, &mut |_, _| Supervision::Continue);
    assert!(struck.violation && struck.recovery && !struck.success, "{struck:?}");
    assert!(struck.hits.iter().any(|(_, hit)| *hit == PolicyHit::ForceMeasured));
}

#[test]
fn what_is_measured_while_it_settles_is_in_the_record() {
    let record = work(4, &mut |_, _| Supervision::Continue);
    assert_eq!((record.peak_force_n, record.near), (400.0, true));
}

#[test]
fn whoever_supervises_sees_and_stops_the_settling_arm() {
    let mut settling = 0;
    work(u64::MAX, &mut |_, passed| {
        settling += u64::from(passed.settling);
        Supervision::Continue
    });
    assert_eq!(settling, INSPECT_AFTER_TICKS);
    let stopped = work(u64::MAX, &mut |_, passed| {
        if passed.settling { Supervision::Abort } else { Supervision::Continue }
    });
    assert!(stopped.recovery && !stopped.success && stopped.recovered.is_some());
    assert!(stopped.time_secs < 1.0 / f64::from(RATE_HZ) * 2.0, "the task itself was over");
}
