//! Experiments: measurements of the method through the pipeline's own code, on their own seeds.
//!
//! Owns the runs, their resumable cells and their report files. Must not decide, nor reach into a run: drift,
//! ground truth and time come from the simulator. Ground truth is read here and in no decision.

pub mod candidate_run;
pub mod claims;
pub mod demonstrations;
pub mod drift;
mod drift_report;
pub(crate) mod drift_run;
pub mod layer_failure;
pub mod per_candidate;
pub mod series;
mod series_tweaks;

use holdpoint_governance::ids::Digest;
use holdpoint_governance::submission::Package;
use holdpoint_runtime::capability::Capability;
use holdpoint_store::{CacheLookup, CacheSecret, ResultCache};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use holdpoint_trials::embedded;
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
    Pool(#[from] crate::candidate_pool::PoolError),
    /// The cell cannot be built.
    #[error(transparent)]
    Sim(#[from] holdpoint_cell::CellError),
    /// A candidate did not come to an end.
    #[error("the candidate {name}: {problem}")]
    Candidate { name: String, problem: String },
    /// The engine could not be started.
    #[error(transparent)]
    Start(#[from] holdpoint_engine::StartError),
    #[error(transparent)]
    Fault(#[from] holdpoint_engine::fault::EngineFault),
    /// The cache or its key file cannot be used.
    #[error(transparent)]
    Cache(#[from] holdpoint_store::StoreError),
    /// A statistic could not be computed.
    #[error(transparent)]
    Stats(#[from] holdpoint_governance::stats::StatsError),
    /// A record has no form on disk.
    #[error("a record cannot be written: {0}")]
    Json(#[from] serde_json::Error),
    /// The plot could not be drawn.
    #[error("the plot cannot be drawn: {0}")]
    Plot(String),
    /// A file of a report cannot be read: which, where, its content, and the allowed content.
    #[error("{0}")]
    Text(String),
    /// A condition that cannot occur.
    #[error("{0}")]
    Unexpected(String),
}

impl Hint for ExperimentError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::Option { .. } => ErrorReason::Usage.into(),
            Self::File { path, .. } => ErrorDetails::of_file(ErrorReason::BadFile, path.as_str()),
            Self::Text(_) => ErrorReason::BadFile.into(),
            Self::Pool(error) => return error.details(),
            Self::Start(error) => return error.details(),
            Self::Fault(error) => return error.details(),
            Self::Cache(error) => return error.details(),
            Self::Sim(_)
            | Self::Candidate { .. }
            | Self::Stats(_)
            | Self::Json(_)
            | Self::Plot(_)
            | Self::Unexpected(_) => ErrorReason::Internal.into(),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Pool(error) => error.hint(),
            Self::Start(error) => error.hint(),
            Self::Fault(error) => error.hint(),
            Self::Cache(error) => error.hint(),
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

    /// An error that cannot occur.
    pub(crate) fn unexpected(error: impl Hint) -> Self {
        Self::Unexpected(error.sentence())
    }

    pub(crate) fn file(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::File { path: path.display().to_string(), source }
    }
}

/// Workers for each of the pieces that run at once: on a machine with more processors than pieces none is idle.
pub(crate) fn workers_each(jobs: usize, pieces: usize) -> usize {
    (jobs / pieces.max(1)).max(1)
}

/// Reports an experiment's progress; called from several threads.
pub type ProgressFn<'a> = dyn Fn(&str) + Sync + 'a;

/// A result from the cache; `None` if it cannot be read or its MAC is missing or wrong.
pub(crate) fn cached_result<T: serde::de::DeserializeOwned>(cache: &ResultCache, key: &Digest) -> Option<T> {
    match cache.get(key) {
        CacheLookup::Found { body, .. } => serde_json::from_slice(&body).ok(),
        CacheLookup::Nothing | CacheLookup::Refused => None,
    }
}

/// A plan's cache, or one in a folder with a key of its own.
pub(crate) fn cache_or_new(
    cache: Option<&ResultCache>,
    folder: &Path,
) -> Result<ResultCache, ExperimentError> {
    match cache {
        Some(cache) => Ok(cache.clone()),
        None => Ok(ResultCache::in_folder(folder.to_owned(), CacheSecret::fresh()?)),
    }
}

/// The versions that a store is installed with.
pub(crate) fn baselines() -> Result<Vec<Capability>, ExperimentError> {
    embedded::baselines().map_err(ExperimentError::unexpected)
}

/// A package that comes with the program.
pub(crate) fn embedded_package(name: &str) -> Result<Package, ExperimentError> {
    embedded::package(name)
        .ok_or_else(|| ExperimentError::Unexpected(format!("the candidate {name} is not embedded")))
}

/// A folder that is removed on drop.
pub(crate) fn scratch() -> Result<tempfile::TempDir, ExperimentError> {
    tempfile::tempdir().map_err(ExperimentError::file(Path::new("a temporary folder")))
}

/// Writes a file whole or not at all.
pub(crate) fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), ExperimentError> {
    let part = path.with_extension(format!("{}.part", std::process::id()));
    std::fs::write(&part, bytes)
        .and_then(|()| std::fs::rename(&part, path))
        .map_err(ExperimentError::file(path))
}
