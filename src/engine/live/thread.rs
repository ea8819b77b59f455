//! The live world on a thread of its own, at the pace of a clock, while the engine's thread evaluates and answers.
//!
//! Owns the thread and what it shares with the engine's. An engine that is not paced (a script, an experiment) works
//! whole sequences in one slice and never comes here.

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use holdpoint_governance::monitor::MonitorDecision;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::sink::VideoFrameSink;

use super::pacing::{SequenceEscort, SharedPace};
use super::painter::Painter;
use super::sequence::{FinishedSequence, StartedSequence};
use super::shadow::Shadow;
use super::stop_switch::StopSwitch;
use super::supervisor::MonitorQuestions;
use crate::fault::EngineFault;
use crate::live::monitors::ActivationMonitor;

/// Pause after a sequence in which nothing was worked: no version is active, or the world failed.
const NOTHING_PAUSE: Duration = Duration::from_secs(2);

/// The live world's thread and what it shares with the engine's.
pub struct LiveThread {
    switch: Arc<StopSwitch>,
    pace: Arc<SharedPace>,
    questions: MonitorQuestions,
    number: u64,
    running: Option<JoinHandle<FinishedSequence>>,
    not_before: Option<Instant>,
}

impl LiveThread {
    /// A thread that waits for its first sequence.
    #[must_use]
    pub(crate) fn new(times: Option<f64>, switch: Arc<StopSwitch>) -> Self {
        let pace = Arc::new(SharedPace::default());
        pace.set(times);
        Self {
            switch,
            pace,
            questions: MonitorQuestions::default(),
            number: 0,
            running: None,
            not_before: None,
        }
    }

    /// Whether a sequence is being worked.
    #[must_use]
    pub const fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Whether a sequence is over and not taken back yet.
    #[cfg(test)]
    pub(crate) fn has_ended(&self) -> bool {
        self.running.as_ref().is_some_and(JoinHandle::is_finished)
    }

    /// Whether the arm is being stopped.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.running.is_some() && self.switch.stops(self.number)
    }

    /// Whether it rests after a sequence in which nothing was worked.
    pub(crate) fn rests(&self) -> bool {
        self.not_before.is_some_and(|not_before| Instant::now() < not_before)
    }

    /// After a sequence: if nothing was worked, the next one waits.
    pub(crate) fn rest_if(&mut self, nothing: bool) {
        self.not_before = nothing.then(|| Instant::now() + NOTHING_PAUSE);
    }

    /// What monitors asked while their sequence ran.
    pub(crate) fn take_questions(&self) -> Vec<(ActivationMonitor, MonitorDecision)> {
        self.questions.lock().map_or_else(|_| Vec::new(), |mut waiting| std::mem::take(&mut *waiting))
    }

    /// How fast it works from now on.
    pub fn set_pace(&self, times: Option<f64>) {
        self.pace.set(times);
    }

    /// Runs a sequence on a thread of its own.
    ///
    /// # Errors
    /// If no thread starts.
    pub(crate) fn start(
        &mut self,
        mut begun: StartedSequence,
        shadow: Option<Shadow>,
        sink: VideoFrameSink,
        clock: Clock,
    ) -> Result<(), EngineFault> {
        self.number += 1;
        begun.tell_at_once(Arc::clone(&self.questions));
        let painter = Painter::new(sink, clock.clone(), begun.index(), begun.workers());
        let shared = (Arc::clone(&self.switch), Arc::clone(&self.pace));
        let mut escort = SequenceEscort::new(painter, self.number, shadow, shared, clock);
        self.switch.begin(self.number);
        let work = move || {
            let mut worked = begun.run(&mut escort);
            let (stopped, shadow) = escort.conclude(worked.running.world(), &worked.report);
            worked.stopped = stopped;
            worked.shadow = shadow;
            worked
        };
        let thread = std::thread::Builder::new().name("live-world".to_owned()).spawn(work);
        let thread = thread.map_err(|error| {
            EngineFault::Impossible(format!("the live world's thread does not start: {error}"))
        })?;
        self.running = Some(thread);
        Ok(())
    }

    /// The sequence that is over; `None` while one runs, and if none was started.
    pub(crate) fn finished(&mut self, wait: bool) -> Option<Result<FinishedSequence, EngineFault>> {
        let thread = self.running.take_if(|thread| wait || thread.is_finished())?;
        self.switch.end();
        let failed = |_| EngineFault::Impossible("the live world's thread failed".to_owned());
        Some(thread.join().map_err(failed))
    }
}
