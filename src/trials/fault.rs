//! Faults of trials: an evaluation that met one has no result.

use std::borrow::Cow;

use holdpoint_cell::CellError;
use holdpoint_store::StoreError;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// Why a trial gave no result. None of them is the version's.
#[derive(Debug, thiserror::Error)]
pub enum TrialFault {
    /// Cached results or traces cannot be read or kept.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The trial cell failed, or a worker panicked.
    #[error(transparent)]
    Cell(#[from] CellError),
    /// A record has no canonical form.
    #[error("a record has no canonical form: {0}")]
    Canonical(#[from] serde_json::Error),
    /// A state that should be impossible, or an evaluation that was interrupted.
    #[error("{0}")]
    Impossible(String),
}

impl Hint for TrialFault {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Store(error) => error.details(),
            Self::Cell(_) | Self::Canonical(_) | Self::Impossible(_) => Some(ErrorReason::Internal.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Store(error) => error.hint(),
            Self::Cell(_) | Self::Canonical(_) | Self::Impossible(_) => None,
        }
    }
}
