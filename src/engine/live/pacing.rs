//! Keeps simulated time to real time.
//!
//! Escorts a sequence on a thread of its own: waits between ticks, has it drawn, runs a candidate in shadow, and
//! stops the arm in the tick of a stop request. Decides nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use holdpoint_body::{TICK_SECS, TaskKind};
use holdpoint_cell::RobotCell;

use super::listener::Listener;
use super::painter::Painter;
use super::sequence::{ShadowResult, StoppedTask};
use super::shadow::Shadow;
use super::station::SequenceReport;
use super::stop_switch::StopSwitch;
use holdpoint_protocol::clock::{Clock, tick_of};
use holdpoint_runtime::task::{Supervision, Tick};

/// Shorter waits are left to the next tick.
const WAIT_LEAST: Duration = Duration::from_millis(6);

/// Who is further behind does not hurry to catch up.
const LATE_MAX: Duration = Duration::from_millis(250);

/// A pace that several threads see.
#[derive(Debug, Default)]
pub(crate) struct SharedPace(AtomicU64);

impl SharedPace {
    pub(crate) fn set(&self, times: Option<f64>) {
        self.0.store(times.unwrap_or(0.0).to_bits(), Ordering::Release);
    }

    fn get(&self) -> Option<f64> {
        Some(f64::from_bits(self.0.load(Ordering::Acquire))).filter(|times| *times > 0.0)
    }
}

/// Waits until it is time for a tick.
struct Throttle {
    pace: Arc<SharedPace>,
    times: Option<f64>,
    from: Instant,
    from_tick: u64,
}

impl Throttle {
    fn new(pace: Arc<SharedPace>) -> Self {
        Self { times: pace.get(), pace, from: Instant::now(), from_tick: 0 }
    }

    fn rebase(&mut self, tick: u64) {
        self.times = self.pace.get();
        self.from = Instant::now();
        self.from_tick = tick;
    }

    fn wait(&mut self, tick: u64) {
        if self.pace.get() != self.times || tick < self.from_tick {
            self.rebase(tick);
        }
        let Some(times) = self.times else { return };
        let due_secs = (tick - self.from_tick) as f64 * TICK_SECS / times;
        let due = Duration::from_secs_f64(due_secs.clamp(0.0, 3600.0));
        let passed = self.from.elapsed();
        if due > passed + WAIT_LEAST {
            std::thread::sleep(due.saturating_sub(passed));
        } else if passed > due + LATE_MAX {
            self.rebase(tick);
        }
    }
}

/// Escorts a sequence: waits, draws, shadows, and stops the arm on request.
pub(crate) struct SequenceEscort {
    painter: Painter,
    number: u64,
    shadow: Option<Shadow>,
    switch: Arc<StopSwitch>,
    clock: Clock,
    throttle: Throttle,
    started: u64,
    stopped: Option<StoppedTask>,
}

impl SequenceEscort {
    pub(crate) fn new(
        painter: Painter,
        number: u64,
        shadow: Option<Shadow>,
        (switch, pace): (Arc<StopSwitch>, Arc<SharedPace>),
        clock: Clock,
    ) -> Self {
        Self {
            painter,
            number,
            shadow,
            switch,
            clock,
            throttle: Throttle::new(pace),
            started: 0,
            stopped: None,
        }
    }

    /// After the sequence: the arm at rest, how it was stopped, and what shadow came to.
    pub(crate) fn conclude(
        mut self,
        world: &dyn RobotCell,
        report: &SequenceReport,
    ) -> (Option<StoppedTask>, Option<ShadowResult>) {
        self.painter.rest(world, self.stopped.is_some());
        let shadowed = self.shadow.take().map(|shadow| {
            let id = shadow.id();
            let live = report.tasks.iter().map(|done| &done.record).find(|done| done.task == shadow.task());
            // A live task that a person stopped says nothing about the candidate beside it.
            let live = live.filter(|_| self.stopped.is_none());
            let (trace, fork) = shadow.conclude(live, report.seed);
            ShadowResult { id, trace, fork }
        });
        let stopped = self.stopped.take().map(|stopped| {
            let last = report.tasks.last().filter(|done| Some(&done.id) == stopped.id.as_ref());
            StoppedTask { report: last.and_then(|done| done.record.recovered), ..stopped }
        });
        (stopped, shadowed)
    }
}

impl Listener for SequenceEscort {
    fn before_task(&mut self, world: &dyn RobotCell, task: TaskKind, seed: u64) {
        self.started = world.tick();
        self.painter.before_task_beside(world, task, seed, self.shadow.as_mut());
        if self.shadow.is_some() {
            self.throttle.rebase(world.tick());
        }
    }

    fn tick(&mut self, world: &dyn RobotCell, task: TaskKind, passed: &Tick<'_>) -> Supervision {
        if self.stopped.is_none() && self.switch.stops(self.number) {
            self.stopped = Some(StoppedTask {
                id: self.painter.at_work(task),
                world_tick: self.started + passed.tick,
                tick: tick_of(self.clock.now_ms()),
                report: None,
                halted: self.switch.is_halted(),
            });
        }
        let supervision =
            self.shadow.as_mut().map_or(Supervision::Continue, |shadow| shadow.tick(world, task, passed));
        self.painter.tick(world, task, passed, self.shadow.as_ref(), self.stopped.is_some());
        if self.stopped.is_some() {
            return Supervision::StepIn;
        }
        self.throttle.wait(world.tick());
        supervision
    }
}

#[cfg(test)]
mod tests {
    use holdpoint_body::RATE_HZ;

    use super::*;

    #[test]
    fn ticks_keep_to_the_clock() {
        let pace = Arc::new(SharedPace::default());
        pace.set(Some(10.0));
        let mut throttle = Throttle::new(Arc::clone(&pace));
        let begun = Instant::now();
        // 240 ticks are a simulated second, a tenth of a real one at this pace.
        (1..=u64::from(RATE_HZ)).for_each(|tick| throttle.wait(tick));
        assert!(begun.elapsed() >= Duration::from_millis(90), "{:?}", begun.elapsed());
        pace.set(None);
        let begun = Instant::now();
        (1..=100 * u64::from(RATE_HZ)).for_each(|tick| throttle.wait(tick));
        assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    }
}
