//! A run that is measured while it works: what it asks for, and how long each tick takes.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use holdpoint_body::{Command, Observation};
use holdpoint_governance::ids::Digest;
use holdpoint_runtime::skill::{Confined, Hook, Skill};

/// What is measured.
#[derive(Clone, Debug, Default)]
pub(super) struct Measures {
    /// Each command as text, one a line: equal texts are equal commands to the last bit.
    commands: String,
    /// Time of each tick, ns.
    pub(super) tick_ns: Vec<u64>,
}

impl Measures {
    /// Of all commands, in their order.
    pub(super) fn digest(&self) -> Digest {
        Digest::of_parts("holdpoint.commands.v1", &[self.commands.as_bytes()])
    }
}

/// A run, and where its measures go.
pub(super) struct Measured {
    pub(super) skill: Box<dyn Skill>,
    pub(super) measures: Arc<Mutex<Measures>>,
}

impl Skill for Measured {
    fn tick(&mut self, seen: &Observation) -> Command {
        let began = Instant::now();
        let command = self.skill.tick(seen);
        let took = u64::try_from(began.elapsed().as_nanos()).unwrap_or(u64::MAX);
        let mut measures = self.measures.lock().unwrap_or_else(PoisonError::into_inner);
        measures.tick_ns.push(took);
        // The shortest text that reads back as the number: it differs wherever the number does.
        measures.commands.push_str(&format!("{command:?}\n"));
        command
    }

    fn enter(&mut self, hook: Hook) {
        self.skill.enter(hook);
    }

    fn confined(&self) -> Confined {
        self.skill.confined()
    }
}
