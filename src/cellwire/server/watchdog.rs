//! Stops the arm of a live cell when no command comes in time. Decides from time and measured joint speeds alone.

use std::collections::VecDeque;
use std::time::Duration;

use holdpoint_body::{Command, Interrupt, JointVec, RATE_HZ, Telemetry};
use holdpoint_cell::{LiveCell, RobotCell};

use crate::refusal::WatchdogStop;

/// Ticks over which the mean of the joint speeds is taken.
const STILL_TICKS: usize = 12;

/// A mean joint speed below this is a standstill, rad/s; above the noise of the sensors.
const STILL_RAD_S: f64 = 0.02;

/// The longest braking, ticks.
const BRAKE_TICKS: u64 = RATE_HZ as u64;

/// How long a connection without a watchdog waits at a time.
const WITHOUT: Duration = Duration::from_hours(1);

/// Looks for a standstill.
#[derive(Default)]
struct Stillness {
    window: VecDeque<JointVec>,
}

impl Stillness {
    /// Takes one tick; returns whether the arm is at standstill.
    fn observe(&mut self, seen: &Telemetry) -> bool {
        self.window.push_back(seen.dq.clone());
        if self.window.len() > STILL_TICKS {
            self.window.pop_front();
        }
        self.stands()
    }

    fn stands(&self) -> bool {
        let joints = self.window.front().map_or(0, JointVec::len);
        let sum = |joint: usize| self.window.iter().filter_map(|dq| dq.get(joint)).sum::<f64>();
        // Written so that a speed that is no number is no standstill.
        self.window.len() == STILL_TICKS
            && (0..joints).all(|joint| sum(joint).abs() / (STILL_TICKS as f64) < STILL_RAD_S)
    }
}

/// Waits for the next command of a live cell.
pub(super) struct Watchdog {
    /// The longest time between two commands; none in lockstep.
    within: Option<Duration>,
    /// Whether the arm may move: a command went out since the last stop or end of a task.
    is_armed: bool,
    stillness: Stillness,
}

impl Watchdog {
    pub(super) fn new(within_ms: Option<u32>) -> Self {
        let within = within_ms.map(|ms| Duration::from_millis(u64::from(ms)));
        Self { within, is_armed: false, stillness: Stillness::default() }
    }

    /// How long the next request is waited for.
    pub(super) fn wait(&self) -> Duration {
        self.within.filter(|_| self.is_armed).unwrap_or(WITHOUT)
    }

    /// A tick passed.
    pub(super) fn stepped(&mut self, cell: &dyn RobotCell) {
        self.is_armed = true;
        if self.within.is_some() {
            self.stillness.observe(&cell.telemetry());
        }
    }

    /// The arm is stopped, or nothing is to be done.
    pub(super) fn rest(&mut self) {
        self.is_armed = false;
        self.stillness = Stillness::default();
    }

    /// No command came in time, or none will come: stops an arm that moves, and says how that went.
    pub(super) fn stop(&mut self, cell: &mut dyn LiveCell, silent: Duration) -> Option<WatchdogStop> {
        let moves = self.is_armed && !self.stillness.stands();
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
    let mut stillness = Stillness::default();
    for tick in 1..=BRAKE_TICKS {
        cell.step(&Command::Hold).ok()?;
        if stillness.observe(&cell.telemetry()) {
            return Some(tick.saturating_sub(STILL_TICKS as u64));
        }
    }
    None
}
