//! Why a history cannot be trusted, as far as no database is needed to find it.

use std::borrow::Cow;

use super::files::FileError;
use super::head_copies::HeadFault;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

#[derive(Debug, thiserror::Error)]
pub enum HistoryError {
    #[error(transparent)]
    Unreadable(#[from] FileError),
    #[error("audit record {seq} is bad: {problem}")]
    Record { seq: u64, problem: String },
    #[error("the checkpoint {file:?} is bad: {problem}")]
    Checkpoint { file: String, problem: String },
    /// A signed head that was kept elsewhere, or the chain that it contradicts.
    #[error("the copy {file:?} contradicts it: {fault}")]
    Copy { file: String, fault: HeadFault },
    #[error("line {line} is bad: {problem}")]
    Line { line: u64, problem: String },
    /// The signature of the end of the chain.
    #[error("the audit chain is not signed to its end: {0}")]
    Unsigned(String),
    #[error("the approval {nonce} is bad: {problem}")]
    Approval { nonce: String, problem: String },
    #[error("the person {name:?} is bad: {problem}")]
    Person { name: String, problem: String },
}

impl HistoryError {
    /// The record that it concerns, if it concerns one.
    #[must_use]
    pub const fn record(&self) -> Option<u64> {
        match self {
            Self::Record { seq, .. } => Some(*seq),
            Self::Unreadable(_)
            | Self::Checkpoint { .. }
            | Self::Copy { .. }
            | Self::Line { .. }
            | Self::Unsigned(_)
            | Self::Approval { .. }
            | Self::Person { .. } => None,
        }
    }
}

impl Hint for HistoryError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Unreadable(error) => error.details(),
            Self::Record { .. }
            | Self::Checkpoint { .. }
            | Self::Copy { .. }
            | Self::Line { .. }
            | Self::Unsigned(_)
            | Self::Approval { .. }
            | Self::Person { .. } => Some(ErrorReason::StoreRefused.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        None
    }
}
