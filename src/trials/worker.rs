//! One world, used again for every episode that its worker works.

use holdpoint_body::{BodyError, TaskKind};
use holdpoint_cell::film::EpisodeFrame;
use holdpoint_cell::{CellCopy, CellError, EpisodeSetup, TrialCell};
use holdpoint_governance::ids::Digest;
use holdpoint_runtime::arm::Arm;
use holdpoint_runtime::task::TaskRecord;

use crate::cell::Cell;

/// The arm of a worker, in any cell for trials.
pub type TrialArm = Arm<Box<dyn TrialCell>>;

/// A worker of the pool: one world, used again for every episode.
#[derive(Default)]
pub struct Worker {
    /// The arm in its world, and the digest of the cell it was built from.
    built: Option<(Digest, TrialArm)>,
    films: bool,
    /// Why the cell was lost; the results of the job do not count then.
    lost: Option<CellError>,
}

impl Worker {
    /// A worker that builds its world at its first episode.
    #[must_use]
    pub const fn new() -> Self {
        Self { built: None, films: false, lost: None }
    }

    /// A worker that films what it works ([`Worker::take_film`]). The records are the same.
    #[must_use]
    pub const fn filming() -> Self {
        Self { built: None, films: true, lost: None }
    }

    /// What its world showed of the last episode; nothing if it does not film, or if the world failed.
    #[must_use]
    pub fn take_film(&mut self) -> Vec<EpisodeFrame> {
        self.built.as_mut().map(|(_, arm)| arm.body_mut().take_film()).unwrap_or_default()
    }

    /// Drops what its world showed so far: a film begins where a task does.
    pub(super) fn restart_film(&mut self) {
        if let Some((_, arm)) = self.built.as_mut().filter(|_| self.films) {
            arm.body_mut().film();
        }
    }

    fn new_arm(&self, cell: &Cell) -> Result<TrialArm, CellError> {
        let mut world = cell.trial()?;
        if self.films {
            world.film();
        }
        Ok(Arm::new(world))
    }

    /// The worker's arm, reset to an episode.
    ///
    /// # Errors
    /// If the world cannot be built or the episode has no valid start.
    pub fn arm(&mut self, cell: &Cell, setup: &EpisodeSetup) -> Result<&mut TrialArm, CellError> {
        self.arm_after(cell, |arm| arm.body_mut().reset(setup))
    }

    /// The worker's arm, in the state of a world of the same cell.
    ///
    /// # Errors
    /// If the world cannot be built, or the copy is not of this robot.
    pub fn arm_from(&mut self, cell: &Cell, copy: &CellCopy) -> Result<&mut TrialArm, CellError> {
        self.arm_after(cell, |arm| arm.body_mut().go_on_from(copy))
    }

    /// The worker's arm once its world is brought to a state; a world that fails at that is not used again.
    fn arm_after(
        &mut self,
        cell: &Cell,
        bring: impl FnOnce(&mut TrialArm) -> Result<(), CellError>,
    ) -> Result<&mut TrialArm, CellError> {
        let mut arm = match self.built.take() {
            Some((of, arm)) if of == cell.digest() => arm,
            _ => self.new_arm(cell)?,
        };
        bring(&mut arm)?;
        let (_, arm) = self.built.insert((cell.digest(), arm));
        Ok(arm)
    }

    /// The worker's arm as it stands.
    ///
    /// # Errors
    /// If it has none: before its first episode, and after one in which its world failed.
    pub fn built_arm(&mut self) -> Result<&mut TrialArm, CellError> {
        let none = || CellError::Worker { item: 0, message: "it has no world".to_owned() };
        self.built.as_mut().map(|(_, arm)| arm).ok_or_else(none)
    }

    /// The record of an episode in which the world failed.
    pub fn failed(&mut self, error: CellError, task: TaskKind, seed: u64) -> TaskRecord {
        self.note_failure(error);
        TaskRecord::invalid(task, seed)
    }

    /// Notes why the world failed. The next episode builds another one.
    pub fn note_failure(&mut self, error: CellError) {
        self.built = None;
        if matches!(error, CellError::Body(BodyError::Lost(_))) {
            self.lost.get_or_insert(error);
        }
    }

    /// Takes why the cell was lost, if it was since the last call.
    pub(super) fn take_lost(&mut self) -> Option<CellError> {
        self.lost.take()
    }
}
