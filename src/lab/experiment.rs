//! Experiments: what the method does, measured through the pipeline's own code on seeds of their own.
//!
//! Owns the runs, their resumable cells and their report files. Must not decide, nor reach into a run: drift,
//! ground truth and time come from the simulator. Ground truth is read here and in no decision.

pub mod candidate;
pub mod drift;
mod drift_report;
pub(crate) mod drift_run;
pub mod layer;
pub mod per_candidate;
pub mod verdict;

use holdpoint_governance::ids::Digest;
use holdpoint_registry::{Found, KeptCells};
use holdpoint_text::Hint;
use std::borrow::Cow;
use std::path::Path;

pub use drift::{DriftOptions, DriftReport};

/// Why an experiment could not be run.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// An option is not allowed.
    #[error("{option} {value} is not allowed; {allowed}")]
    Option { option: &'static str, value: String, allowed: &'static str },
    /// A file could not be read or written.
    #[error("cannot use {path}: {source}")]
    File { path: String, source: std::io::Error },
    /// The pool cannot be used.
    #[error(transparent)]
    Pool(#[from] crate::pool::PoolError),
    /// The cell cannot be built.
    #[error(transparent)]
    Sim(#[from] holdpoint_sim::SimError),
    /// A candidate did not come to an end.
    #[error("the candidate {name}: {problem}")]
    Candidate { name: String, problem: String },
    /// The engine could not be started.
    #[error(transparent)]
    Start(#[from] holdpoint_engine::StartError),
    #[error(transparent)]
    Fault(#[from] holdpoint_engine::fault::Fault),
    /// What is kept cannot be used, or its key file.
    #[error(transparent)]
    Kept(#[from] holdpoint_registry::StoreError),
    /// A statistic could not be computed.
    #[error(transparent)]
    Stats(#[from] holdpoint_governance::stats::StatsError),
    /// A record has no form on disk.
    #[error("a record cannot be written: {0}")]
    Json(#[from] serde_json::Error),
    /// The plot could not be drawn.
    #[error("the plot cannot be drawn: {0}")]
    Plot(String),
    /// A file of a report cannot be read: which, where, what it has, and what is allowed.
    #[error("{0}")]
    Text(String),
    /// Something that cannot be is.
    #[error("{0}")]
    Unexpected(String),
}

impl Hint for ExperimentError {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Pool(error) => error.hint(),
            Self::Start(error) => error.hint(),
            Self::Fault(error) => error.hint(),
            Self::Kept(error) => error.hint(),
            Self::Stats(error) => error.hint(),
            Self::Option { .. }
            | Self::File { .. }
            | Self::Sim(_)
            | Self::Candidate { .. }
            | Self::Json(_)
            | Self::Plot(_)
            | Self::Text(_)
            | Self::Unexpected(_) => None,
        }
    }
}

impl ExperimentError {
    pub(crate) fn candidate(name: &str, problem: String) -> Self {
        Self::Candidate { name: name.to_owned(), problem }
    }

    pub(crate) fn file(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::File { path: path.display().to_string(), source }
    }
}

/// Workers of each of so many pieces that are worked at once: a machine with more of them than pieces has none idle.
pub(crate) fn workers_each(jobs: usize, pieces: usize) -> usize {
    (jobs / pieces.max(1)).max(1)
}

/// Tells how far an experiment is; called from several threads.
pub type Tell<'a> = dyn Fn(&str) + Sync + 'a;

/// A finished cell as it is kept; one that cannot be read, or that was not kept with the secret, is none.
pub(crate) fn kept<T: serde::de::DeserializeOwned>(cells: &KeptCells, key: &Digest) -> Option<T> {
    match cells.get(key) {
        Found::Cell { body, .. } => serde_json::from_slice(&body).ok(),
        Found::Nothing | Found::Refused => None,
    }
}

/// A folder that is gone when it is dropped.
pub(crate) fn scratch() -> Result<tempfile::TempDir, ExperimentError> {
    tempfile::tempdir().map_err(ExperimentError::file(Path::new("a temporary folder")))
}

/// Writes a file whole or not at all.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), ExperimentError> {
    let part = path.with_extension(format!("{}.part", std::process::id()));
    std::fs::write(&part, bytes)
        .and_then(|()| std::fs::rename(&part, path))
        .map_err(ExperimentError::file(path))
}
