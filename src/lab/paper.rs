//! The paper's own evaluation, worked anew: rounds of upgrades by arms (its sections 7 and 8), and pools of candidates
//! through the stages with parts of the way left out.
//!
//! Every arm meets the same candidates and the same held-out sequences. What is worked is kept by what determines it, so
//! that arms share what is the same for them and a run that was cut off goes on. What was planted, and what the referee
//! says of a version, is read after every decision.

pub mod arm;
#[cfg(feature = "parquet")]
pub mod columns;
pub mod csv;
pub mod figures;
pub mod held_out;
pub mod in_force;
pub mod overhead;
pub mod preset;
pub mod printed;
pub mod regression;
pub mod report;
pub mod rounds;
pub mod rows;
pub mod run;
pub mod screen;
pub mod sections;
pub mod stream;
pub mod table;

use std::time::Instant;

use holdpoint_engine::cell::Cell;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_registry::KeptCells;
use holdpoint_text::Hint;

pub use arm::{Arm, Fork};
pub use preset::Preset;
pub use rounds::{RoundRow, rounds};
pub use screen::{ScreenRow, Variant, screen};

use crate::experiment::ExperimentError;

/// What everything is worked with.
pub struct Ground {
    pub cell: Cell,
    pub cells: KeptCells,
    /// What the arms decide and the versions work under.
    pub profile: Profile,
    /// Which part of the work this process does, and of how many.
    pub shard: (usize, usize),
    pub jobs: usize,
}

impl Ground {
    /// The built-in cell and the profile `sim`, which is the paper's.
    ///
    /// # Errors
    /// If the cell cannot be built.
    pub fn new(cells: KeptCells, shard: (usize, usize), jobs: usize) -> Result<Self, ExperimentError> {
        let profile = Profile::builtin(ProfileName::Sim)
            .map_err(|error| ExperimentError::Unexpected(error.sentence()))?;
        Ok(Self { cell: Cell::builtin()?, cells, profile, shard, jobs })
    }

    /// Whether a piece of work is this process's.
    #[must_use]
    pub const fn is_ours(&self, index: usize) -> bool {
        let (shard, of) = self.shard;
        of == 0 || index % of == shard
    }
}

/// How far something is, with about how long the rest takes.
pub(crate) fn progress(what: &str, finished: usize, all: usize, began: Instant) -> String {
    let left = began.elapsed().as_secs_f64() / finished.max(1) as f64 * (all - finished) as f64;
    format!("[{finished}/{all}] {what}; about {:.0} min left", left / 60.0)
}
