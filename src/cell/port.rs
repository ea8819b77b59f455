//! The ports of a cell: what live cells and trial cells have in common, what each adds, and where cells come from.

use std::any::Any;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use holdpoint_body::disturbance::Drift;
use holdpoint_body::{Body, FurtherObject, Observation, TICK_SECS, TaskKind};
use nalgebra::Isometry3;

use crate::distribution::Distribution;
use crate::episode::EpisodeSetup;
use crate::error::CellError;
use crate::fault::InjectedFault;
use crate::film::EpisodeFrame;
use crate::spec::CellSpec;
use crate::state::{CellCopy, StateImage};
use crate::truth::{ContactPoint, TrueState};

/// A box that stands in a cell: pose of its middle, and half extents, m.
pub type FixtureBox = (Isometry3<f64>, [f64; 3]);

/// What live cells and trial cells have in common.
pub trait RobotCell: Body + Send {
    /// What the cell is and can do.
    fn spec(&self) -> &Arc<CellSpec>;

    /// Ticks since the work was presented.
    fn tick(&self) -> u64;

    /// Seconds since the work was presented.
    fn secs(&self) -> f64 {
        self.tick() as f64 * TICK_SECS
    }

    /// Switches the goal and restarts the task's tick.
    fn begin_task(&mut self, task: TaskKind);

    /// The task is over.
    fn end_task(&mut self) {}

    /// Where a screen draws the object: where it is, or where the sensors saw it last.
    fn shown_object(&self) -> Isometry3<f64>;

    /// Tick of a declared failure, or of a stop from outside, that still stands.
    fn stop_declared(&self) -> Option<u64>;

    /// The present state, for trial cells to continue from.
    ///
    /// # Errors
    /// [`CellError::Unable`] for a cell that cannot export its state.
    fn copy(&self) -> Result<CellCopy, CellError> {
        Ok(CellCopy::of_image(self.tick(), self.export()?))
    }

    /// The present state as bytes.
    ///
    /// # Errors
    /// [`CellError::Unable`] for a cell that cannot export its state.
    fn export(&self) -> Result<StateImage, CellError> {
        Err(CellError::Unable("export its state"))
    }

    /// What the sensors tell of the present state, for a trial cell to be set to; `None` for a cell that does not say.
    fn observed(&self) -> Option<Observation> {
        None
    }

    /// True state, for reports and for a screen; `None` for a cell that knows no more than its sensors tell.
    fn truth(&self) -> Option<TrueState<'_>> {
        None
    }

    /// What stands in the cell, beside table and robot; for a screen. Boxes at a place and of the size of the scene's
    /// clutter are that clutter; all others are parts of the tray.
    fn fixtures(&self) -> Vec<FixtureBox> {
        Vec::new()
    }

    /// Where robot and object touch what they touch, the strongest contact first; for a screen.
    fn contact_points(&self) -> Vec<ContactPoint> {
        Vec::new()
    }
}

/// A call for the next work of a live cell.
#[derive(Clone, Copy, Debug)]
pub struct WorkCall<'a> {
    /// What a simulated cell draws the work from.
    pub conditions: &'a Distribution,
    /// Seed of the draw.
    pub seed: u64,
}

/// The cell that works.
pub trait LiveCell: RobotCell {
    /// Waits until work is presented. A simulated cell draws it and is reset to it.
    ///
    /// # Errors
    /// If no work can be presented.
    fn await_work(&mut self, call: &WorkCall<'_>) -> Result<(), CellError>;

    /// Breaks something, from the next tick on until the next work: for a drill of the whole cell.
    ///
    /// # Errors
    /// [`CellError::Unable`] for a cell in which nothing can be broken on demand.
    fn inject(&mut self, _fault: InjectedFault) -> Result<(), CellError> {
        Err(CellError::Unable("break on demand"))
    }
}

/// A cell for trials: it is reset, continues from a state, and breaks on demand.
pub trait TrialCell: RobotCell {
    /// Starts an episode from a new state: the episode before has no effect on it. [`EpisodeSetup`] states each
    /// condition.
    ///
    /// # Errors
    /// [`CellError::InvalidStart`] if the start is out of reach, the object does not hold, or the cell cannot do a
    /// condition.
    fn reset(&mut self, setup: &EpisodeSetup) -> Result<(), CellError>;

    /// Continues from a state of a cell of the same description, bit-identical to an uninterrupted run.
    ///
    /// # Errors
    /// [`CellError::Snapshot`] for a state of another cell; this one is then unchanged.
    fn go_on_from(&mut self, copy: &CellCopy) -> Result<(), CellError>;

    /// As [`TrialCell::go_on_from`], from exported bytes.
    ///
    /// # Errors
    /// [`CellError::Snapshot`] for bytes that are no state of this cell; this one is then unchanged.
    fn import(&mut self, image: &StateImage) -> Result<(), CellError>;

    /// Goes to the state that another cell observed, as far as that tells. What is not observed it chooses itself.
    ///
    /// # Errors
    /// [`CellError::Unable`] for a cell that cannot be set to an observation; [`CellError::Snapshot`] for one that it
    /// cannot reach.
    fn set_to(&mut self, _observed: &Observation) -> Result<(), CellError> {
        Err(CellError::Unable("be set to an observation"))
    }

    /// Breaks something, from the next tick on and for the rest of the episode.
    fn inject(&mut self, fault: InjectedFault);

    /// True state.
    fn true_state(&self) -> TrueState<'_>;

    /// The cell's own type, for reports that know it.
    fn as_any(&self) -> &dyn Any;

    /// From now on the frames of every episode are kept, if the cell can film.
    fn film(&mut self) {}

    /// The frames of the episode so far, oldest first; none if it is not filmed.
    fn take_film(&mut self) -> Vec<EpisodeFrame> {
        Vec::new()
    }
}

/// Builds cells of one description.
pub trait CellFactory: Send + Sync {
    /// What its cells are.
    fn spec(&self) -> &Arc<CellSpec>;

    /// Digest of what computes its cells: sources, dependencies, compiler. Evidence of another build does not count.
    fn build_digest(&self) -> &str;

    /// The distributions that trials are drawn from: without disturbance, the sandbox's, and the live cell's.
    ///
    /// # Errors
    /// If they cannot be read.
    fn distributions(&self) -> Result<[Distribution; 3], CellError>;

    /// A distribution after a drift.
    ///
    /// # Errors
    /// If the cell has no such drift.
    fn with_drift(&self, of: &Distribution, drift: &Drift) -> Result<Distribution, CellError>;

    /// Builds the same cells with further objects, by their names in observations; `file` declares them.
    ///
    /// # Errors
    /// [`CellError::Unable`] for cells that have the objects that they have; [`CellError::File`] naming an object that
    /// they cannot have.
    fn with_objects(
        &self,
        _file: &str,
        _objects: &BTreeMap<String, FurtherObject>,
    ) -> Result<Arc<dyn CellFactory>, CellError> {
        Err(CellError::Unable("have further objects"))
    }

    /// A new live cell at rest.
    ///
    /// # Errors
    /// If it cannot be built.
    fn live(&self) -> Result<Box<dyn LiveCell>, CellError>;

    /// A new trial cell.
    ///
    /// # Errors
    /// If it cannot be built.
    fn trial(&self) -> Result<Box<dyn TrialCell>, CellError>;
}

/// Finds the cell of a robot.
pub trait CellSource: Send + Sync {
    /// The cell of a built-in robot, or of the default one.
    ///
    /// # Errors
    /// If there is no robot of this name.
    fn builtin(&self, robot: Option<&str>) -> Result<Arc<dyn CellFactory>, CellError>;

    /// The cell of the robot in a file.
    ///
    /// # Errors
    /// If the file cannot be read.
    fn load(&self, robot: &Path) -> Result<Arc<dyn CellFactory>, CellError>;

    /// The cells of another process.
    ///
    /// # Errors
    /// [`CellError::Unable`] for a source that knows none; [`CellError::File`] if no cell is there.
    fn connect(&self, _endpoint: &str) -> Result<Arc<dyn CellFactory>, CellError> {
        Err(CellError::Unable("be connected to"))
    }
}
