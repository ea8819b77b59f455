//! The live cell's body, with a place for a referee and for a painter.
//!
//! While the cell is stopped it brakes and takes no command, whatever commands it: a skill, a hook, the ladder.
//!
//! Ground truth is for reports: what the referee sees is read by experiments and by nothing that decides.

use std::sync::Arc;

use holdpoint_body::{Command, GuardVerdict, Interrupt, Observation, Standstill, Telemetry};
use holdpoint_cell::{LiveCell, Referee, RefereeLimits, RefereeReport};

use crate::live::painter::LadderPainter;
use crate::live::stop_switch::StopSwitch;
use holdpoint_body::{Body, BodyError};

/// A world, and a referee who looks on if one was asked for.
pub struct InstrumentedWorld {
    world: Box<dyn LiveCell>,
    limits: Option<RefereeLimits>,
    referee: Option<Referee>,
    sketch: Option<LadderPainter>,
    switch: Arc<StopSwitch>,
    /// Looks for a standstill while the cell is stopped.
    standstill: Standstill,
}

impl InstrumentedWorld {
    /// A world without observers, stopped by `switch`.
    #[must_use]
    pub fn new(world: Box<dyn LiveCell>, switch: Arc<StopSwitch>) -> Self {
        let standstill = Standstill::default();
        Self { world, limits: None, referee: None, sketch: None, switch, standstill }
    }

    /// Whether the cell is stopped: no command reaches the arm.
    #[must_use]
    pub fn is_halted(&self) -> bool {
        self.switch.is_halted()
    }

    /// The world, to look at.
    #[must_use]
    pub fn world(&self) -> &dyn LiveCell {
        self.world.as_ref()
    }

    /// The world, for what is done between tasks.
    pub fn world_mut(&mut self) -> &mut dyn LiveCell {
        self.world.as_mut()
    }

    /// From now on a referee looks on.
    pub const fn call_referee(&mut self, limits: RefereeLimits) {
        self.limits = Some(limits);
    }

    /// From now on `sketch` draws every tick; `None` ends the drawing.
    pub(crate) fn draw(&mut self, sketch: Option<LadderPainter>) {
        self.sketch = sketch;
    }

    /// Ends a verdict and begins the next. Absent without a referee.
    pub fn verdict(&mut self) -> Option<RefereeReport> {
        let next = self.limits.map(Referee::new);
        std::mem::replace(&mut self.referee, next).map(|referee| referee.verdict())
    }
}

impl Body for InstrumentedWorld {
    fn observe(&mut self, last: GuardVerdict) -> Observation {
        Body::observe(&mut self.world, last)
    }
    fn telemetry(&self) -> Telemetry {
        Body::telemetry(&self.world)
    }
    fn step(&mut self, command: &Command) -> Result<(), BodyError> {
        if self.switch.is_halted() {
            if self.world.stop_declared().is_none() {
                Body::interrupt(&mut self.world, Interrupt::Stop);
            }
            Body::step(&mut self.world, &Command::Hold)?;
            let stands = self.standstill.observe(&self.world.telemetry());
            self.switch.stepped(stands.then_some(Standstill::TICKS as u64));
        } else {
            self.standstill = Standstill::default();
            Body::step(&mut self.world, command)?;
            self.switch.stepped(None);
        }
        if let Some(referee) = &mut self.referee {
            referee.observe(self.world.as_ref());
        }
        if let Some(sketch) = &mut self.sketch {
            sketch.tick(self.world.as_ref());
        }
        Ok(())
    }
    fn interrupt(&mut self, interrupt: Interrupt) {
        if interrupt == Interrupt::Release && self.switch.is_halted() {
            return;
        }
        Body::interrupt(&mut self.world, interrupt);
    }
    fn inspect(&self) -> bool {
        Body::inspect(&self.world)
    }
}
