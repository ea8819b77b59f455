//! Stops the arm of a live cell when no command comes in time. Decides from time and measured joint speeds alone.

use std::time::Duration;

use holdpoint_body::{Command, Interrupt, RATE_HZ, Standstill};
use holdpoint_cell::{LiveCell, RobotCell};

use crate::refusal::WatchdogStop;

/// The longest braking, ticks.
const BRAKE_TICKS: u64 = RATE_HZ as u64;

/// How long a connection without a watchdog waits at a time.
const WITHOUT: Duration = Duration::from_hours(1);

/// Waits for the next command of a live cell.
pub(super) struct Watchdog {
    /// The longest time between two commands; none in lockstep.
    within: Option<Duration>,
    /// Whether the arm may move: a command went out since the last stop or end of a task.
    is_armed: bool,
    standstill: Standstill,
}

impl Watchdog {
    pub(super) fn new(within_ms: Option<u32>) -> Self {
        let within = within_ms.map(|ms| Duration::from_millis(u64::from(ms)));
        Self { within, is_armed: false, standstill: Standstill::default() }
    }

    /// How long the next request is waited for.
    pub(super) fn wait(&self) -> Duration {
        self.within.filter(|_| self.is_armed).unwrap_or(WITHOUT)
    }

    /// A tick passed.
    pub(super) fn stepped(&mut self, cell: &dyn RobotCell) {
        self.is_armed = true;
        if self.within.is_some() {
            self.standstill.observe(&cell.telemetry());
        }
    }

    /// The arm is stopped, or nothing is to be done.
    pub(super) fn rest(&mut self) {
        self.is_armed = false;
        self.standstill = Standstill::default();
    }

    /// No command came in time, or none will come: stops an arm that moves, and says how that went.
    pub(super) fn stop(&mut self, cell: &mut dyn LiveCell, silent: Duration) -> Option<WatchdogStop> {
        let moves = self.is_armed && !self.standstill.is_reached();
        self.rest();
        moves.then(|| WatchdogStop {
            silent_ms: u32::try_from(silent.as_millis()).unwrap_or(u32::MAX),
            standstill_ticks: brake(cell),
        })
    }
}

/// Interrupts, and lets ticks pass until the arm is at standstill; returns the tick at which the standstill began.
fn brake(cell: &mut dyn LiveCell) -> Option<u64> {
    cell.interrupt(Interrupt::Stop);
    let mut standstill = Standstill::default();
    for tick in 1..=BRAKE_TICKS {
        cell.step(&Command::Hold).ok()?;
        if standstill.observe(&cell.telemetry()) {
            return Some(tick.saturating_sub(Standstill::TICKS as u64));
        }
    }
    None
}
