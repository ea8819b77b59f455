//! How long a version computes on an arm that real time does not wait for.
//!
//! Used on live arms at the pace of a clock and nowhere else: a wall clock has no place where equal seeds give equal
//! logs. Ticks and commands, which are the same everywhere, are the guard's ([`crate::grant`]).

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use holdpoint_body::{Command, Observation, RATE_HZ};

use super::skill::{ConfinementReport, Hook, Skill};

/// Ticks that are looked at together: one second.
const WINDOW_TICKS: u32 = RATE_HZ;

/// Counts the ticks in which a version computed longer than it declares. One that is late for more than half of a
/// second's ticks is late by itself; a single late tick is the machine's affair.
#[derive(Debug)]
pub struct TickMeter {
    declared: Duration,
    ticks: AtomicU32,
    late: AtomicU32,
    breached: AtomicBool,
}

impl TickMeter {
    /// A meter for a version that declares so many microseconds a tick.
    #[must_use]
    pub fn new(cpu_us_per_tick: u32) -> Arc<Self> {
        Arc::new(Self {
            declared: Duration::from_micros(u64::from(cpu_us_per_tick)),
            ticks: AtomicU32::new(0),
            late: AtomicU32::new(0),
            breached: AtomicBool::new(false),
        })
    }

    /// Takes in how long one tick took.
    pub fn note(&self, took: Duration) {
        let late = self.late.fetch_add(u32::from(took > self.declared), Ordering::Relaxed);
        let late = late.saturating_add(u32::from(took > self.declared));
        if self.ticks.fetch_add(1, Ordering::Relaxed).saturating_add(1) < WINDOW_TICKS {
            return;
        }
        if 2 * late > WINDOW_TICKS {
            self.breached.store(true, Ordering::Relaxed);
        }
        self.ticks.store(0, Ordering::Relaxed);
        self.late.store(0, Ordering::Relaxed);
    }

    /// Whether the version computed longer than it declares.
    #[must_use]
    pub fn is_breached(&self) -> bool {
        self.breached.load(Ordering::Relaxed)
    }
}

/// A run whose ticks are timed.
pub(crate) struct TimedSkill {
    pub(crate) skill: Box<dyn Skill>,
    pub(crate) meter: Arc<TickMeter>,
}

impl Skill for TimedSkill {
    fn tick(&mut self, seen: &Observation) -> Command {
        let begun = Instant::now();
        let command = self.skill.tick(seen);
        self.meter.note(begun.elapsed());
        command
    }

    fn enter(&mut self, hook: Hook) {
        self.skill.enter(hook);
    }

    fn fork(&self) -> Option<Box<dyn Skill>> {
        Some(Box::new(Self { skill: self.skill.fork()?, meter: Arc::clone(&self.meter) }))
    }

    fn confined(&self) -> ConfinementReport {
        self.skill.confined()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constantly_late_ticks_are_a_breach_and_single_ones_are_not() {
        let (fast, slow) = (Duration::from_micros(10), Duration::from_millis(9));
        for (late_every, breached) in [(0, false), (60, false), (3, false), (2, false), (1, true)] {
            let meter = TickMeter::new(50);
            for tick in 1..=3 * WINDOW_TICKS {
                let late = late_every > 0 && tick % late_every == 0;
                meter.note(if late { slow } else { fast });
            }
            assert_eq!(meter.is_breached(), breached, "every {late_every}");
        }
    }
}
