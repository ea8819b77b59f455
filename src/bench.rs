//! Measures the engine on this machine: what an episode, a rule and a record cost.
//!
//! Owns the measurements and the report; runs the product's own code on the embedded versions, on calibration seeds.
//! Must not touch the operator's store, decide anything, or state a figure that was not measured in this run. The
//! laboratory's benchmarks use the same figures.

mod measure;
mod rules;
mod simulation;
mod storage;
mod subjects;

use std::borrow::Cow;

use serde::Serialize;

pub use measure::{FigureClock, FigureEffort, FigureUnit, MeasuredFigure, median};
pub use rules::CLEAN;
pub use simulation::{TaskCost, task_costs};

use holdpoint_engine::StartError;
use holdpoint_governance::policy::PolicyError;
use holdpoint_governance::stats::StatsError;
use holdpoint_governance::text_error::TextError;
use holdpoint_runtime::capability::PackageError;
use holdpoint_store::{StoreError, VerifyError};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// Everything that was measured in one run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchReport {
    /// Version of the program.
    pub version: &'static str,
    /// Whether the program was built with optimization (`release`) or for development (`dev`).
    pub build: &'static str,
    /// The robot of the cell that was measured; the rules compute in f64.
    pub robot: String,
    /// Whether fewer samples were taken.
    pub quick: bool,
    /// Times, in the order of the stages.
    pub entries: Vec<MeasuredFigure>,
}

/// Why no measurement was possible.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    #[error("the cell failed: {0}")]
    Cell(#[from] holdpoint_cell::CellError),
    /// A tick could not be carried out.
    #[error("the cell failed: {0}")]
    Body(#[from] holdpoint_body::BodyError),
    /// An embedded text does not parse.
    #[error(transparent)]
    Text(#[from] TextError),
    /// The embedded policies do not compile.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// An embedded version does not load.
    #[error(transparent)]
    Package(#[from] PackageError),
    /// The engine does not start.
    #[error("the engine does not start: {0}")]
    Start(#[from] StartError),
    /// The scratch store failed.
    #[error("the scratch store failed: {0}")]
    Store(#[from] StoreError),
    /// The scratch store does not verify.
    #[error("the scratch store does not verify: {0}")]
    Verify(#[from] VerifyError),
    #[error("cannot make a scratch folder: {0}")]
    Scratch(#[from] std::io::Error),
    /// A value has no canonical form.
    #[error("a value has no canonical form: {0}")]
    Canonical(#[from] serde_json::Error),
    /// The timed operation had another result than its name says, so its time means nothing.
    #[error("{what}: {found:?} where {expected} was expected, so a figure would mean nothing")]
    Unexpected {
        what: &'static str,
        /// The measured result.
        found: String,
        /// The expected result.
        expected: &'static str,
    },
    /// Too few samples could be taken.
    #[error("{name}: {found} samples could be taken; {needed} are needed")]
    TooFew { name: String, found: usize, needed: usize },
}

impl Hint for BenchError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Start(error) => error.details(),
            Self::Store(error) => error.details(),
            Self::Verify(error) => error.details(),
            Self::Scratch(_) => Some(ErrorReason::CannotWrite.into()),
            Self::Cell(_)
            | Self::Body(_)
            | Self::Text(_)
            | Self::Policy(_)
            | Self::Package(_)
            | Self::Canonical(_)
            | Self::Unexpected { .. }
            | Self::TooFew { .. } => Some(ErrorReason::Internal.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Store(_) | Self::Scratch(_) => Some("TMPDIR names the folder it is made in".into()),
            Self::Text(error) => error.hint(),
            Self::Policy(error) => error.hint(),
            Self::Package(error) => error.hint(),
            Self::Start(error) => error.hint(),
            Self::Verify(error) => error.hint(),
            Self::Cell(_)
            | Self::Body(_)
            | Self::Canonical(_)
            | Self::Unexpected { .. }
            | Self::TooFew { .. } => None,
        }
    }
}

impl From<StatsError> for BenchError {
    fn from(error: StatsError) -> Self {
        Self::Unexpected { what: "the statistics", found: error.sentence(), expected: "an answer" }
    }
}

/// Measures everything; `quick` takes fewer samples.
///
/// # Errors
/// [`BenchError`]; figures taken so far are not returned, because a broken engine's times mean nothing.
pub fn run(quick: bool) -> Result<BenchReport, BenchError> {
    let effort = if quick { FigureEffort::QUICK } else { FigureEffort::DEFAULT };
    let subjects = subjects::Subjects::load()?;
    let mut entries = simulation::measure(&subjects, &effort)?;
    entries.extend(rules::measure(&subjects, &effort)?);
    entries.extend(storage::measure(&effort)?);
    Ok(BenchReport {
        version: env!("CARGO_PKG_VERSION"),
        build: if cfg!(debug_assertions) { "dev" } else { "release" },
        robot: subjects.cell.spec.robot.name.clone(),
        quick,
        entries,
    })
}
