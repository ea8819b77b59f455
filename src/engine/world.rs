//! The live cell: the world that works on under the active versions while candidates are judged.
//!
//! Owns the arm with its agent, how a sequence is worked (in one slice, or on a thread of its own at the pace of a
//! clock), what is drawn of it, and the descent to a safe pose. Decides nothing about versions.

pub mod descent;
pub mod instrumented;
pub mod listener;
pub mod live;
pub mod pacing;
pub mod painter;
pub mod portrait;
pub mod sequence;
pub mod shadow;
pub mod supervisor;
pub mod switch;
pub mod thread;

use std::collections::VecDeque;
use std::sync::Arc;

use holdpoint_protocol::event::TaskSummary;
use holdpoint_protocol::picture::Scenery;
use holdpoint_protocol::sink::Pictures;
use holdpoint_protocol::snapshot::StoppedView;
use holdpoint_sim::SimError;

use self::live::LiveCell;
use self::sequence::Stopped;
use self::switch::Switch;
use self::thread::LiveThread;
use crate::cell::Cell;
use crate::halt::UnwrittenStops;

/// Sequences whose success is kept for display.
const RECENT: usize = 50;

/// The live cell with its pace, its pictures and what it worked last.
pub struct LiveWorld {
    pub cell: LiveCell,
    /// Sequences that fall due beside an evaluation.
    due: f64,
    pace: Option<f64>,
    /// The thread it works on; absent if it works in step with the engine.
    pub(crate) thread: Option<LiveThread>,
    pub(crate) pictures: Option<Pictures>,
    /// How the last sequence was stopped, if it was.
    pub(crate) stopped: Option<Stopped>,
    /// Who stopped the cell, while it is stopped.
    pub(crate) halted: Option<StoppedView>,
    pub(crate) unwritten: UnwrittenStops,
    /// It is on record that this engine works the cell.
    pub(crate) at_work: bool,
    recent: VecDeque<bool>,
    last_tasks: Vec<TaskSummary>,
}

impl LiveWorld {
    /// A live world at rest, which works in step with the engine.
    ///
    /// # Errors
    /// If the world cannot be built.
    pub(crate) fn new(cell: Cell, switch: Arc<Switch>) -> Result<Self, SimError> {
        Ok(Self {
            cell: LiveCell::with(cell, switch)?,
            due: 0.0,
            pace: None,
            thread: None,
            pictures: None,
            stopped: None,
            halted: None,
            unwritten: UnwrittenStops::default(),
            at_work: false,
            recent: VecDeque::new(),
            last_tasks: Vec::new(),
        })
    }

    /// From now on it works on a thread of its own: `times` simulated seconds in a second (absent: as fast as it
    /// computes).
    pub fn work_on_a_thread(&mut self, times: Option<f64>) {
        self.pace = times;
        self.thread = Some(LiveThread::new(times, self.cell.switch()));
    }

    /// How fast it works from now on. Tells whether it has a pace at all.
    pub fn set_pace(&mut self, times: Option<f64>) -> bool {
        let Some(thread) = &self.thread else { return false };
        thread.set_pace(times);
        self.pace = times;
        true
    }

    /// Simulated seconds in a second; absent for as fast as it computes.
    #[must_use]
    pub const fn pace(&self) -> Option<f64> {
        self.pace
    }

    /// Whether it works on a thread of its own.
    #[must_use]
    pub const fn is_paced(&self) -> bool {
        self.thread.is_some()
    }

    /// Whether a sequence is being worked on its thread.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(LiveThread::is_running)
    }

    /// Whether the arm is being stopped.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.thread.as_ref().is_some_and(LiveThread::is_stopping)
    }

    /// Stops the arm in the tick that runs. The sequence is over soon after.
    pub fn stop(&self) {
        self.switch().stop();
    }

    /// Stops the arm where it works now, from any thread.
    #[must_use]
    pub fn switch(&self) -> Arc<Switch> {
        self.cell.switch()
    }

    /// Whether a person stopped the cell: nothing moves the arm.
    #[must_use]
    pub fn is_halted(&self) -> bool {
        self.cell.switch().is_halted()
    }

    /// A stop from before a restart holds on.
    pub(crate) fn stay_halted(&mut self, halted: StoppedView) {
        self.cell.switch().latch();
        self.halted = Some(halted);
    }

    /// So many sequences fall due, in fractions.
    pub fn fall_due(&mut self, sequences: f64) {
        self.due += sequences;
    }

    /// Whether a whole sequence is due; it is taken then.
    pub fn take_due(&mut self) -> bool {
        let due = self.due >= 1.0;
        if due {
            self.due -= 1.0;
        }
        due
    }

    /// Keeps what a sequence came to, for display. Work that a person stopped is neither done nor failed.
    pub fn note(&mut self, done: Option<bool>, tasks: &[TaskSummary]) {
        self.recent.extend(done);
        if self.recent.len() > RECENT {
            self.recent.pop_front();
        }
        self.last_tasks = tasks.to_vec();
    }

    /// Success of the last sequences, oldest first.
    #[must_use]
    pub fn recent(&self) -> Vec<bool> {
        self.recent.iter().copied().collect()
    }

    /// Whether the last sequence was done.
    #[must_use]
    pub fn works(&self) -> bool {
        self.recent.back() == Some(&true)
    }

    /// The tasks of the last sequence.
    #[must_use]
    pub fn last_tasks(&self) -> &[TaskSummary] {
        &self.last_tasks
    }
}

/// What stands round the robot.
#[must_use]
pub fn scenery(cell: &Cell) -> Scenery {
    portrait::scenery(&cell.scene)
}
