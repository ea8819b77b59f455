//! The cells that the program works in: the simulated ones, and those of other processes. Others are added here alone.

use std::path::Path;
use std::sync::Arc;

use holdpoint_cell::{CellError, CellFactory, CellSource};
use holdpoint_cellwire::client::ClientOptions;
use holdpoint_cellwire::{Endpoint, WireFactory};
use holdpoint_sim::SimCells;

/// Where every cell of the program comes from.
pub struct ProgramCells {
    is_paced: bool,
}

/// For scripts and single verbs: no time counts, and a cell of another process has no watchdog.
pub const CELLS: ProgramCells = ProgramCells { is_paced: false };

/// For engines at the pace of a clock: a cell of another process stops its arm by itself if no command comes.
pub const PACED_CELLS: ProgramCells = ProgramCells { is_paced: true };

impl CellSource for ProgramCells {
    fn builtin(&self, robot: Option<&str>) -> Result<Arc<dyn CellFactory>, CellError> {
        SimCells.builtin(robot)
    }

    fn load(&self, robot: &Path) -> Result<Arc<dyn CellFactory>, CellError> {
        SimCells.load(robot)
    }

    fn connect(&self, endpoint: &str) -> Result<Arc<dyn CellFactory>, CellError> {
        let parsed: Endpoint = endpoint.parse().map_err(|error: holdpoint_cellwire::EndpointError| {
            CellError::file(endpoint, "endpoint", error.to_string())
        })?;
        let options = if self.is_paced { ClientOptions::paced() } else { ClientOptions::lockstep() };
        Ok(Arc::new(WireFactory::connect(&parsed, options)?))
    }
}
