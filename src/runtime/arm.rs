//! The right to move an arm, as a value.
//!
//! Exactly one [`ActuatorHandle`] exists per [`Arm`]: it is lent for the length of a task and
//! cannot be copied. What holds no handle cannot send a command: a candidate in shadow is run
//! against a [`CommandRecorder`] instead, which is a different type.

use holdpoint_body::{Body, BodyError, Command, GuardVerdict, Interrupt, Observation, Telemetry};

/// One arm and the only handle to it.
pub struct Arm<B> {
    body: B,
}

impl<B: Body> Arm<B> {
    /// Takes a body under governance.
    pub const fn new(body: B) -> Self {
        Self { body }
    }

    /// Lends the handle; the borrow checker sees to it that there is one at a time.
    pub const fn handle(&mut self) -> ActuatorHandle<'_, B> {
        ActuatorHandle { body: &mut self.body }
    }

    /// Gives the body back.
    pub fn into_body(self) -> B {
        self.body
    }

    /// The body, to look at.
    pub const fn body(&self) -> &B {
        &self.body
    }

    /// The body, for what is done between tasks (reset, fork).
    pub const fn body_mut(&mut self) -> &mut B {
        &mut self.body
    }
}

/// The right to move one arm, for as long as it is borrowed. Neither `Clone` nor constructible elsewhere.
pub struct ActuatorHandle<'arm, B> {
    body: &'arm mut B,
}

impl<B: Body> ActuatorHandle<'_, B> {
    /// The body's [`Body::observe`].
    pub fn observe(&mut self, last: GuardVerdict) -> Observation {
        self.body.observe(last)
    }
    /// The body's [`Body::telemetry`].
    #[must_use]
    pub fn telemetry(&self) -> Telemetry {
        self.body.telemetry()
    }
    /// See [`Body::step`].
    ///
    /// # Errors
    /// As [`Body::step`].
    pub fn step(&mut self, command: &Command) -> Result<(), BodyError> {
        self.body.step(command)
    }
    /// The body's [`Body::interrupt`].
    pub fn interrupt(&mut self, interrupt: Interrupt) {
        self.body.interrupt(interrupt);
    }
    /// The body, to look at: for a screen, never for a decision.
    #[must_use]
    pub const fn body(&self) -> &B {
        self.body
    }
    /// The body's [`Body::inspect`].
    #[must_use]
    pub fn inspect(&self) -> bool {
        self.body.inspect()
    }
}

/// Where the commands of a version in shadow go: into a list, and nowhere else.
#[derive(Clone, Debug, Default)]
pub struct CommandRecorder {
    commands: Vec<(u64, Command)>,
    dropped: u64,
}

impl CommandRecorder {
    /// The most commands that are kept; later ones are counted.
    pub const LIMIT: usize = 4096;

    /// Keeps one command; [`Command::Hold`] says nothing and is not kept.
    pub fn record(&mut self, tick: u64, command: Command) {
        if command == Command::Hold {
            return;
        }
        if self.commands.len() < Self::LIMIT {
            self.commands.push((tick, command));
        } else {
            self.dropped += 1;
        }
    }

    /// What was asked for, with the tick.
    #[must_use]
    pub fn commands(&self) -> &[(u64, Command)] {
        &self.commands
    }

    /// How many commands were not kept.
    #[must_use]
    pub const fn dropped(&self) -> u64 {
        self.dropped
    }
}
