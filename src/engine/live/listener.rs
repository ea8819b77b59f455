//! Who looks on while the live world is worked.

use holdpoint_body::TaskKind;
use holdpoint_cell::RobotCell;
use holdpoint_runtime::task::{Supervision, Tick};

/// Called around the live tasks.
pub trait Listener {
    /// A task is about to start on this world.
    fn before_task(&mut self, world: &dyn RobotCell, task: TaskKind, seed: u64);
    /// One tick of it passed.
    fn tick(&mut self, world: &dyn RobotCell, task: TaskKind, passed: &Tick<'_>) -> Supervision;
}

/// The listener without an observer.
pub struct NoListener;

impl Listener for NoListener {
    fn before_task(&mut self, _: &dyn RobotCell, _: TaskKind, _: u64) {}
    fn tick(&mut self, _: &dyn RobotCell, _: TaskKind, _: &Tick<'_>) -> Supervision {
        Supervision::Continue
    }
}
