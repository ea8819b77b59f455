//! The paper's own evaluation, re-run: rounds of upgrades by arms (its sections 7 and 8), and pools of candidates
//! through the stages, with parts of the pipeline left out.
//!
//! Every arm gets the same candidates and the same held-out sequences. Results are cached under the digest of their
//! inputs, so that arms share equal runs and an interrupted run continues. The planted faults and the referee's
//! verdicts are read after every decision.

pub mod active_families;
pub mod arm;
pub mod candidate_stream;
#[cfg(feature = "parquet")]
pub mod columns;
pub mod csv;
pub mod figures;
pub mod held_out;
pub mod overhead;
pub mod pool_screening;
pub mod preset;
pub mod published;
pub mod raw_rows;
pub mod regression;
pub mod report;
pub mod report_table;
pub mod rounds;
pub mod run;
pub mod sections;

use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_sim::SimCells;
use holdpoint_store::ResultCache;
use holdpoint_trials::cell::Cell;

pub use arm::{Arm, Fork};
pub use pool_screening::{ScreenRow, Variant, screen};
pub use preset::Preset;
pub use rounds::{RoundRow, rounds};

use crate::pipeline_experiments::ExperimentError;

/// The shared inputs of all runs.
pub struct PaperSetup {
    pub cell: Cell,
    pub cache: ResultCache,
    /// The context of the arms' decisions and of the versions.
    pub profile: Profile,
    /// The part of the runs that this process does, and the number of parts.
    pub shard: (usize, usize),
    pub jobs: usize,
}

impl PaperSetup {
    /// The built-in cell and the profile `sim`, which is the paper's.
    ///
    /// # Errors
    /// If the cell cannot be built.
    pub fn new(cache: ResultCache, shard: (usize, usize), jobs: usize) -> Result<Self, ExperimentError> {
        let profile = Profile::builtin(ProfileName::Sim).map_err(ExperimentError::unexpected)?;
        Ok(Self { cell: Cell::of(&SimCells, None)?, cache, profile, shard, jobs })
    }

    /// The pieces of the work that belong to this process.
    fn of_shard<T>(&self, pieces: impl IntoIterator<Item = T>) -> Vec<T> {
        let (shard, of) = self.shard;
        pieces.into_iter().skip(shard).step_by(of.max(1)).collect()
    }
}
