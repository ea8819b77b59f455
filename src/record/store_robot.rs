//! The recorded robot of a store.

use std::path::PathBuf;

use holdpoint_cell::{CellError, CellSource};
use holdpoint_trials::cell::Cell;
use serde::{Deserialize, Serialize};

/// A robot in a store's record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoreRobot {
    /// Name in its description.
    pub name: String,
    /// Digest of its description, hexadecimal.
    pub digest: String,
    /// The file it was read from; absent for a built-in one.
    pub file: Option<PathBuf>,
}

impl StoreRobot {
    /// The robot of a cell.
    #[must_use]
    pub fn of(cell: &Cell) -> Self {
        let digest = format!("{:016x}", cell.spec.robot.digest);
        Self { name: cell.spec.robot.name.clone(), digest, file: cell.robot_file.clone() }
    }

    /// Whether it is the same robot, wherever its file is.
    #[must_use]
    pub fn is(&self, other: &Self) -> bool {
        self.digest == other.digest
    }

    /// The cell of this robot.
    ///
    /// # Errors
    /// If its file cannot be read.
    pub fn cell(&self, source: &dyn CellSource) -> Result<Cell, CellError> {
        match &self.file {
            None => Cell::new(source.builtin(Some(&self.name))?),
            Some(file) => Cell::of(source, Some(file)),
        }
    }
}

impl std::fmt::Display for StoreRobot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.file {
            Some(file) => write!(f, "{} ({}, {})", self.name, file.display(), self.digest),
            None => write!(f, "{} (built in, {})", self.name, self.digest),
        }
    }
}
