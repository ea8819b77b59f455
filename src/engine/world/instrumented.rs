//! The live world's body, with a place for a referee and for somebody who draws beside it.
//!
//! Ground truth is for reports: what the referee sees is read by experiments and by nothing that decides.

use holdpoint_body::{Command, GuardVerdict, Interrupt, Observation, Telemetry};
use holdpoint_sim::referee::{Referee, RefereeLimits, RefereeReport};
use holdpoint_sim::world::World;

use crate::world::painter::Sketch;
use holdpoint_body::{Body, BodyError};

/// A world, and a referee who looks on if one was asked for.
pub struct InstrumentedWorld {
    world: World,
    limits: Option<RefereeLimits>,
    referee: Option<Referee>,
    sketch: Option<Sketch>,
}

impl InstrumentedWorld {
    /// A world that nobody looks at.
    #[must_use]
    pub const fn new(world: World) -> Self {
        Self { world, limits: None, referee: None, sketch: None }
    }

    /// The world, to look at.
    #[must_use]
    pub const fn world(&self) -> &World {
        &self.world
    }

    /// The world, for what is done between tasks.
    pub const fn world_mut(&mut self) -> &mut World {
        &mut self.world
    }

    /// From now on a referee looks on.
    pub const fn call_referee(&mut self, limits: RefereeLimits) {
        self.limits = Some(limits);
    }

    /// From now on every tick is drawn by `sketch`; by nobody if it is absent.
    pub(crate) fn draw(&mut self, sketch: Option<Sketch>) {
        self.sketch = sketch;
    }

    /// Ends a verdict and begins the next. Absent if nobody looked on.
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
        Body::step(&mut self.world, command)?;
        if let Some(referee) = &mut self.referee {
            referee.observe(&self.world);
        }
        if let Some(sketch) = &mut self.sketch {
            sketch.tick(&self.world);
        }
        Ok(())
    }
    fn interrupt(&mut self, interrupt: Interrupt) {
        Body::interrupt(&mut self.world, interrupt);
    }
    fn inspect(&self) -> bool {
        Body::inspect(&self.world)
    }
}
