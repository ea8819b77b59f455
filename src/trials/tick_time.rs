//! The processor time that a component takes for a tick, measured before an evaluation depends on it.
//!
//! Fuel bounds the instructions of a tick and not their time. So the first second of a simulated task runs twice. In the
//! second run, with warm caches, the thread's own clock times each tick: other load of the machine does not count. A
//! controller that is compiled in is part of the program, has no fuel, and is not timed. Judges nothing
//! ([`holdpoint_governance::time_excess`] does).

use std::sync::{Arc, Mutex, PoisonError};

use holdpoint_body::{Command, Observation, RATE_HZ};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::skill::{ConfinementReport, Hook, Skill};
use holdpoint_runtime::terms::SkillTerms;
use rustix::time::{ClockId, clock_gettime};

use super::episodes::alone_with;
use super::seeds::{CALIBRATION_FROM_RUN, SeedPurpose, episode_seed};
use super::undisturbed_run::TrialCase;
use super::worker::Worker;
use crate::cell::{Cell, Conditions};

/// Runs of the episode; the last one counts.
const RUNS: usize = 2;

/// The most ticks of a run.
const TICKS_MAX: usize = RATE_HZ as usize;

/// Processor time after which a run ends, ns, so that a slow component does not occupy the engine.
const RUN_NS_MAX: u64 = 1_000_000_000;

/// Processor time of a version's median tick, us; `None` for a controller that is compiled in, and if no tick ran.
#[must_use]
pub fn median_tick_us(cell: &Cell, terms: &SkillTerms, version: &Capability) -> Option<f64> {
    version.package.component.as_ref()?;
    let seed = episode_seed(CALIBRATION_FROM_RUN, SeedPurpose::Canonical, 0);
    let trial = TrialCase { cell, terms, version, conditions: Conditions::Canonical, seed };
    let (mut worker, mut tick_ns) = (Worker::new(), Vec::new());
    for _ in 0..RUNS {
        let times = Arc::new(Mutex::new(Vec::new()));
        let timed = |skill| -> Box<dyn Skill> {
            Box::new(ThreadTimedSkill { skill, run_ns: 0, tick_ns: Arc::clone(&times) })
        };
        // What the episode comes to is no evidence.
        drop(alone_with(&mut worker, trial, timed));
        tick_ns = std::mem::take(&mut *times.lock().unwrap_or_else(PoisonError::into_inner));
    }
    median(tick_ns).map(|ns| ns as f64 / 1_000.0)
}

fn median(mut values: Vec<u64>) -> Option<u64> {
    values.sort_unstable();
    values.get(values.len() / 2).copied()
}

/// Processor time of this thread, ns.
fn thread_ns() -> u64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    u64::try_from(time.tv_sec.saturating_mul(1_000_000_000).saturating_add(time.tv_nsec)).unwrap_or(0)
}

/// A run whose ticks are timed by the thread's clock, and which is done after enough of them.
struct ThreadTimedSkill {
    skill: Box<dyn Skill>,
    run_ns: u64,
    tick_ns: Arc<Mutex<Vec<u64>>>,
}

impl Skill for ThreadTimedSkill {
    fn tick(&mut self, seen: &Observation) -> Command {
        let mut tick_ns = self.tick_ns.lock().unwrap_or_else(PoisonError::into_inner);
        if tick_ns.len() >= TICKS_MAX || self.run_ns >= RUN_NS_MAX {
            return Command::Done;
        }
        let begun = thread_ns();
        let command = self.skill.tick(seen);
        let took = thread_ns().saturating_sub(begun);
        self.run_ns = self.run_ns.saturating_add(took);
        tick_ns.push(took);
        command
    }

    fn enter(&mut self, hook: Hook) {
        self.skill.enter(hook);
    }

    fn confined(&self) -> ConfinementReport {
        self.skill.confined()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_ignores_single_late_ticks() {
        assert_eq!(median(vec![9_000_000, 11, 10, 8_000_000, 12]), Some(12));
        assert_eq!(median(vec![7]), Some(7));
        assert_eq!(median(Vec::new()), None);
    }

    #[test]
    fn the_clock_of_the_thread_counts_computing_and_no_waiting() {
        let before = thread_ns();
        let mut value = 1_u64;
        while thread_ns() < before + 2_000_000 {
            value = std::hint::black_box(value.wrapping_mul(3));
        }
        let computed = thread_ns() - before;
        assert!(computed >= 2_000_000, "{computed}");
        let before = thread_ns();
        std::thread::scope(|scope| {
            // Another thread computes, and this one waits for it.
            scope.spawn(|| {
                let begun = thread_ns();
                while thread_ns() < begun + 20_000_000 {
                    std::hint::spin_loop();
                }
            });
        });
        let waited = thread_ns() - before;
        assert!(waited < 20_000_000, "{waited}");
    }
}
