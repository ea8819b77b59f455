//! Settings of a search, and why there may be no candidate.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use holdpoint_body::TaskKind;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::policy::PolicyError;
use holdpoint_governance::text_error::TextError;
use holdpoint_runtime::capability::PackageError;
use holdpoint_runtime::skill::native::NativeError;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use holdpoint_trials::fault::TrialFault;

/// The most generations of one search.
pub const GENERATIONS_MAX: u32 = 1_000;

/// The most episodes per set of parameters. Four times as many fresh ones fit a search's block of seeds.
pub const EPISODES_MAX: u32 = 500;

pub const JOBS_MAX: usize = 64;

/// The subject and the effort of a search.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SearchSettings<'a> {
    pub task: TaskKind,
    /// Generations of the search, 1 to [`GENERATIONS_MAX`].
    pub generations: u32,
    /// Episodes per set of parameters, 1 to [`EPISODES_MAX`].
    pub episodes: u32,
    /// Seed of the search and of the episodes it trains on.
    pub seed: u32,
    /// Workers, 1 to [`JOBS_MAX`]; the result is the same for any number.
    pub jobs: usize,
    /// The folder in which `<family>-refined` is made.
    pub out: &'a Path,
    /// The candidate's version; the parent's next minor one if none is given.
    pub version: Option<semver::Version>,
}

/// Why there is no candidate.
#[derive(Debug, thiserror::Error)]
pub enum RefineError {
    /// A setting is outside its range.
    #[error("{field} = {value} is not allowed; {allowed} is")]
    Setting {
        field: &'static str,
        value: String,
        /// The allowed range.
        allowed: String,
    },
    /// The candidate's folder is there already.
    #[error("{0:?} is there already and is not overwritten")]
    Exists(PathBuf),
    /// A file or folder cannot be used.
    #[error("cannot {what} {path:?}: {source}")]
    Io { what: &'static str, path: PathBuf, source: std::io::Error },
    /// The journal is larger than any search makes it.
    #[error("{path:?} has {bytes} bytes; up to {allowed} are allowed")]
    JournalTooLarge { path: PathBuf, bytes: u64, allowed: u64 },
    /// The search was interrupted.
    #[error("interrupted after {evaluations} evaluations; they are kept in {journal:?}")]
    Interrupted {
        /// Evaluations that are done.
        evaluations: u32,
        /// The path of the journal.
        journal: PathBuf,
    },
    /// No set of parameters was better than the baseline.
    #[error("nothing better than {parent} was found in {evaluations} evaluations")]
    NothingBetter {
        parent: CapabilityId,
        /// The number of sets that were tried.
        evaluations: u32,
    },
    /// There is no native baseline to search from.
    #[error("the family {0} has no native baseline with parameters")]
    NoBaseline(Family),
    /// A package does not load.
    #[error(transparent)]
    Package(#[from] PackageError),
    /// Parameters do not parse.
    #[error(transparent)]
    Native(#[from] NativeError),
    /// A text of the baseline cannot be edited.
    #[error("the baseline's {file} cannot be edited: {source}")]
    Edit { file: &'static str, source: toml_edit::TomlError },
    /// An embedded profile does not parse.
    #[error(transparent)]
    Profile(#[from] TextError),
    /// The embedded policies do not compile.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    #[error("the simulation failed: {0}")]
    Sim(#[from] holdpoint_cell::CellError),
    /// A worker panicked.
    #[error(transparent)]
    Work(#[from] TrialFault),
    /// The optimizer rejected its box.
    #[error("the optimizer rejected the search: {0}")]
    Optimizer(String),
}

impl Hint for RefineError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::Setting { .. } => ErrorReason::Usage.into(),
            Self::Exists(path) => ErrorDetails::of_path(ErrorReason::Exists, path),
            Self::Io { path, .. } | Self::JournalTooLarge { path, .. } => {
                ErrorDetails::of_path(ErrorReason::BadFile, path)
            }
            Self::Interrupted { .. } => ErrorReason::Interrupted.into(),
            Self::NothingBetter { .. } | Self::NoBaseline(_) => ErrorReason::NotFound.into(),
            Self::Package(error) => return error.details(),
            Self::Native(error) => return error.details(),
            Self::Profile(error) => return error.details(),
            Self::Policy(error) => return error.details(),
            Self::Work(error) => return error.details(),
            Self::Edit { file, .. } => ErrorDetails::of_file(ErrorReason::BadFile, *file),
            Self::Sim(_) | Self::Optimizer(_) => ErrorReason::Internal.into(),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Exists(_) => Some("remove it, or name another folder with --out".into()),
            Self::JournalTooLarge { .. } => Some("remove it, and the search starts again".into()),
            Self::Interrupted { .. } => Some("the same command continues from there".into()),
            Self::NothingBetter { .. } => Some("more --generations, or another --seed".into()),
            Self::Package(error) => error.hint(),
            Self::Native(error) => error.hint(),
            Self::Profile(error) => error.hint(),
            Self::Policy(error) => error.hint(),
            Self::Setting { .. }
            | Self::Io { .. }
            | Self::NoBaseline(_)
            | Self::Edit { .. }
            | Self::Sim(_)
            | Self::Work(_)
            | Self::Optimizer(_) => None,
        }
    }
}

impl RefineError {
    pub(crate) fn io(what: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { what, path, source }
    }
}
