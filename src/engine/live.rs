//! The live cell, which continues under the active versions while candidates are evaluated.
//!
//! Owns the arm with its agent, the run of a sequence (in one slice, or on its own thread at the pace of a clock), its
//! monitors and camera frames, the stop switch with the stop mark, and the ladder to a safe pose. Must not decide about versions, write to the record, or know a simulator.

pub(crate) mod account_stops;
#[cfg(test)]
pub(crate) mod fake_cell;
pub(crate) mod forked_task;
pub mod instrumented;
pub mod ladder_motion;
pub mod listener;
pub mod monitors;
pub mod pacing;
pub mod painter;
pub mod sequence;
pub mod shadow;
pub mod station;
pub mod stop_mark;
pub mod stop_switch;
pub mod supervisor;
pub mod thread;
pub(crate) mod twin_start;
pub(crate) mod unwritten_stops;

use std::collections::VecDeque;
use std::sync::Arc;

use holdpoint_cell::CellError;
use holdpoint_protocol::event::TaskSummary;
use holdpoint_protocol::sink::VideoFrameSink;
use holdpoint_protocol::snapshot::StoppedView;
use holdpoint_protocol::video_frame::Scenery;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::cell_frame;

use self::account_stops::AccountStops;
use self::sequence::StoppedTask;
use self::station::LiveStation;
use self::stop_switch::StopSwitch;
use self::thread::LiveThread;
use self::unwritten_stops::UnwrittenStops;

/// Sequences whose success is stored for display.
const RECENT: usize = 50;

/// The live cell with its pace, its camera frames and its last sequence.
pub struct LiveWorld {
    pub cell: LiveStation,
    /// Sequences due beside an evaluation.
    due: f64,
    pace: Option<f64>,
    /// The thread it runs on; absent if it runs in step with the engine.
    pub(crate) thread: Option<LiveThread>,
    pub(crate) frame_sink: Option<VideoFrameSink>,
    /// How the last sequence was stopped, if it was.
    pub(crate) stopped: Option<StoppedTask>,
    /// The stop of the cell, while it is stopped.
    pub(crate) halted: Option<StoppedView>,
    pub(crate) unwritten: UnwrittenStops,
    pub(crate) account_stops: AccountStops,
    /// Whether the record names this engine as running the cell.
    pub(crate) at_work: bool,
    recent: VecDeque<bool>,
    pub(crate) last_tasks: Vec<TaskSummary>,
    /// Tasks of this session that ran although no evidence covers their start.
    pub(crate) uncovered: u64,
}

impl LiveWorld {
    /// A live cell at rest, in step with the engine.
    ///
    /// # Errors
    /// If the world cannot be built.
    pub(crate) fn new(cell: Cell, switch: Arc<StopSwitch>) -> Result<Self, CellError> {
        Ok(Self {
            cell: LiveStation::with(cell, switch)?,
            due: 0.0,
            pace: None,
            thread: None,
            frame_sink: None,
            stopped: None,
            halted: None,
            unwritten: UnwrittenStops::default(),
            account_stops: AccountStops::default(),
            at_work: false,
            recent: VecDeque::new(),
            last_tasks: Vec::new(),
            uncovered: 0,
        })
    }

    /// From now on it runs on its own thread, `times` as fast as real time (absent: unlimited).
    pub fn work_on_a_thread(&mut self, times: Option<f64>) {
        self.pace = times;
        self.thread = Some(LiveThread::new(times, self.cell.switch()));
    }

    /// Sets its pace from now on. Returns whether it has a pace.
    pub fn set_pace(&mut self, times: Option<f64>) -> bool {
        let Some(thread) = &self.thread else { return false };
        thread.set_pace(times);
        self.pace = times;
        true
    }

    /// Simulated seconds per second; absent for unlimited.
    #[must_use]
    pub const fn pace(&self) -> Option<f64> {
        self.pace
    }

    /// Whether it runs on its own thread.
    #[must_use]
    pub const fn is_paced(&self) -> bool {
        self.thread.is_some()
    }

    /// Whether its thread is running a sequence.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(LiveThread::is_running)
    }

    /// Whether the arm is being stopped.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.thread.as_ref().is_some_and(LiveThread::is_stopping)
    }

    /// Stops the arm in the running tick. The sequence ends soon after.
    pub fn stop(&self) {
        self.switch().stop();
    }

    /// The switch that stops the arm from any thread.
    #[must_use]
    pub fn switch(&self) -> Arc<StopSwitch> {
        self.cell.switch()
    }

    /// Whether a person stopped the cell: nothing moves the arm.
    #[must_use]
    pub fn is_halted(&self) -> bool {
        self.cell.switch().is_halted()
    }

    /// Restores a stop from before a restart.
    pub(crate) fn stay_halted(&mut self, halted: StoppedView) {
        self.cell.switch().latch();
        self.halted = Some(halted);
    }

    /// Makes sequences due, in fractions.
    pub fn fall_due(&mut self, sequences: f64) {
        self.due += sequences;
    }

    /// Whether a whole sequence is due; takes it.
    pub fn take_due(&mut self) -> bool {
        let due = self.due >= 1.0;
        if due {
            self.due -= 1.0;
        }
        due
    }

    /// Stores the result of a sequence for display. A sequence that a person stopped neither succeeded nor failed.
    pub fn note(&mut self, done: Option<bool>, tasks: &[TaskSummary]) {
        self.recent.extend(done);
        if self.recent.len() > RECENT {
            self.recent.pop_front();
        }
        self.last_tasks = tasks.to_vec();
        self.uncovered += tasks.iter().filter(|task| task.uncovered).count() as u64;
    }

    /// Success of the last sequences, oldest first.
    #[must_use]
    pub fn recent(&self) -> Vec<bool> {
        self.recent.iter().copied().collect()
    }

    /// Whether the last sequence succeeded.
    #[must_use]
    pub fn works(&self) -> bool {
        self.recent.back() == Some(&true)
    }
}

/// The surroundings of the robot.
#[must_use]
pub fn scenery(cell: &Cell) -> Scenery {
    cell_frame::scenery(&cell.scene)
}
