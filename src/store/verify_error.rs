//! Why the history of a store cannot be trusted.

use std::borrow::Cow;

use crate::error::StoreError;
use holdpoint_audit::history_error::HistoryError;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

#[derive(Debug, thiserror::Error)]
pub enum VerifyError {
    #[error(transparent)]
    Unreadable(#[from] StoreError),
    #[error(transparent)]
    History(#[from] HistoryError),
    #[error("the database is damaged: {0}")]
    Damaged(String),
    #[error("the {table} {key:?} does not match the audit chain: {problem}")]
    State { table: &'static str, key: String, problem: String },
    #[error("the registry breaks an invariant: {0}")]
    Invariant(String),
    #[error("the telemetry file is not as this program makes it: {0}")]
    TelemetryFile(String),
    #[error("telemetry batch {batch}, sealed by audit record {seq}, is bad: {problem}")]
    Telemetry { batch: u64, seq: u64, problem: String },
}

impl VerifyError {
    /// The record that it concerns, if it concerns one.
    #[must_use]
    pub const fn record(&self) -> Option<u64> {
        match self {
            Self::History(error) => error.record(),
            Self::Telemetry { seq, .. } => Some(*seq),
            Self::Unreadable(_)
            | Self::Damaged(_)
            | Self::TelemetryFile(_)
            | Self::State { .. }
            | Self::Invariant(_) => None,
        }
    }
}

impl Hint for VerifyError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Unreadable(error) => error.details(),
            Self::History(error) => error.details(),
            Self::Damaged(_)
            | Self::TelemetryFile(_)
            | Self::State { .. }
            | Self::Invariant(_)
            | Self::Telemetry { .. } => Some(ErrorReason::StoreRefused.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Unreadable(error) => error.hint(),
            Self::History(error) => error.hint(),
            Self::Damaged(_)
            | Self::TelemetryFile(_)
            | Self::State { .. }
            | Self::Invariant(_)
            | Self::Telemetry { .. } => None,
        }
    }
}
