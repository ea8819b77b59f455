//! A skill run with measurements: its commands, and the time of each tick.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use holdpoint_body::{Command, Observation};
use holdpoint_governance::ids::Digest;
use holdpoint_runtime::skill::{ConfinementReport, Hook, Skill};

/// The measurements.
#[derive(Clone, Debug, Default)]
pub(super) struct RunMeasurements {
    /// Each command as text, one a line: equal text means equal commands to the last bit.
    commands: String,
    /// Time of each tick, ns.
    pub(super) tick_ns: Vec<u64>,
}

impl RunMeasurements {
    /// The digest of all commands, in order.
    pub(super) fn digest(&self) -> Digest {
        Digest::of_parts("holdpoint.commands.v1", &[self.commands.as_bytes()])
    }
}

/// A run and its measurements.
pub(super) struct MeasuredSkill {
    pub(super) skill: Box<dyn Skill>,
    pub(super) measures: Arc<Mutex<RunMeasurements>>,
}

impl Skill for MeasuredSkill {
    fn tick(&mut self, seen: &Observation) -> Command {
        let began = Instant::now();
        let command = self.skill.tick(seen);
        let took = u64::try_from(began.elapsed().as_nanos()).unwrap_or(u64::MAX);
        let mut measures = self.measures.lock().unwrap_or_else(PoisonError::into_inner);
        measures.tick_ns.push(took);
        // The shortest text that reads back as the same number.
        measures.commands.push_str(&format!("{command:?}\n"));
        command
    }

    fn enter(&mut self, hook: Hook) {
        self.skill.enter(hook);
    }

    fn confined(&self) -> ConfinementReport {
        self.skill.confined()
    }
}
