//! Why a history cannot be trusted.

use std::borrow::Cow;

use super::error::StoreError;
use super::head_copies::HeadFault;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// The first problem.
#[derive(Debug, thiserror::Error)]
pub enum VerifyError {
    /// The file cannot be opened or read.
    #[error(transparent)]
    Unreadable(#[from] StoreError),
    /// The file is damaged.
    #[error("the database is damaged: {0}")]
    Damaged(String),
    /// A record of the chain.
    #[error("audit record {seq} is bad: {problem}")]
    Record { seq: u64, problem: String },
    /// The registry does not match the chain.
    #[error("the {table} {key:?} does not match the audit chain: {problem}")]
    State { table: &'static str, key: String, problem: String },
    /// An invariant of the registry.
    #[error("the registry breaks an invariant: {0}")]
    Invariant(String),
    #[error("the checkpoint {file:?} is bad: {problem}")]
    Checkpoint { file: String, problem: String },
    /// A signed head that was kept elsewhere, or the chain that it contradicts.
    #[error("the copy {file:?} contradicts it: {fault}")]
    Copy { file: String, fault: HeadFault },
    /// An invalid line of an exported file.
    #[error("line {line} is bad: {problem}")]
    Line { line: u64, problem: String },
    /// The signature of the end of the chain.
    #[error("the audit chain is not signed to its end: {0}")]
    Unsigned(String),
    #[error("the approval {nonce} is bad: {problem}")]
    Approval { nonce: String, problem: String },
    /// An act that enrolled or revoked a person.
    #[error("the person {name:?} is bad: {problem}")]
    Person { name: String, problem: String },
    /// The telemetry file has another form.
    #[error("the telemetry file is not as this program makes it: {0}")]
    TelemetryFile(String),
    /// A sealed batch of telemetry.
    #[error("telemetry batch {batch}, sealed by audit record {seq}, is bad: {problem}")]
    Telemetry {
        batch: u64,
        /// The record that sealed it.
        seq: u64,
        problem: String,
    },
}

impl VerifyError {
    /// The record that it concerns, if it concerns one.
    #[must_use]
    pub const fn record(&self) -> Option<u64> {
        match self {
            Self::Record { seq, .. } | Self::Telemetry { seq, .. } => Some(*seq),
            Self::Unreadable(_)
            | Self::Damaged(_)
            | Self::TelemetryFile(_)
            | Self::State { .. }
            | Self::Invariant(_)
            | Self::Checkpoint { .. }
            | Self::Copy { .. }
            | Self::Line { .. }
            | Self::Unsigned(_)
            | Self::Approval { .. }
            | Self::Person { .. } => None,
        }
    }
}

impl Hint for VerifyError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Unreadable(error) => error.details(),
            Self::Damaged(_)
            | Self::TelemetryFile(_)
            | Self::Record { .. }
            | Self::State { .. }
            | Self::Invariant(_)
            | Self::Checkpoint { .. }
            | Self::Copy { .. }
            | Self::Line { .. }
            | Self::Unsigned(_)
            | Self::Approval { .. }
            | Self::Person { .. }
            | Self::Telemetry { .. } => Some(ErrorReason::StoreRefused.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Unreadable(error) => error.hint(),
            Self::Damaged(_)
            | Self::TelemetryFile(_)
            | Self::Record { .. }
            | Self::State { .. }
            | Self::Invariant(_)
            | Self::Checkpoint { .. }
            | Self::Copy { .. }
            | Self::Line { .. }
            | Self::Unsigned(_)
            | Self::Approval { .. }
            | Self::Person { .. }
            | Self::Telemetry { .. } => None,
        }
    }
}
