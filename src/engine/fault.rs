//! Faults of the engine's own.

use std::borrow::Cow;

use holdpoint_body::BodyError;
use holdpoint_cell::CellError;
use holdpoint_explain::fault::ExplainFault;
use holdpoint_protocol::command::{AuthorityEffect, Refusal};
use holdpoint_store::StoreError;

use holdpoint_text::{ErrorDetails, ErrorReason, Hint, Problem};
use holdpoint_trials::fault::TrialFault;

use holdpoint_record::version_table::VersionTableError;

/// A fault of the engine, which halts it unless the command caused it ([`EngineFault::refusal`]).
#[derive(Debug, thiserror::Error)]
pub enum EngineFault {
    /// A transition could not be written.
    #[error(transparent)]
    VersionTable(#[from] VersionTableError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Cell(#[from] CellError),
    /// The robot's body failed.
    #[error(transparent)]
    Body(#[from] BodyError),
    /// A record has no canonical form.
    #[error("a record has no canonical form: {0}")]
    Canonical(#[from] serde_json::Error),
    /// A state that should be impossible.
    #[error("{0}")]
    Impossible(String),
}

impl From<TrialFault> for EngineFault {
    fn from(fault: TrialFault) -> Self {
        match fault {
            TrialFault::Store(error) => Self::Store(error),
            TrialFault::Cell(error) => Self::Cell(error),
            TrialFault::Canonical(error) => Self::Canonical(error),
            TrialFault::Impossible(text) => Self::Impossible(text),
        }
    }
}

impl From<ExplainFault> for EngineFault {
    fn from(fault: ExplainFault) -> Self {
        match fault {
            ExplainFault::VersionTable(error) => Self::VersionTable(error),
            ExplainFault::Store(error) => Self::Store(error),
            ExplainFault::Canonical(error) => Self::Canonical(error),
        }
    }
}

impl EngineFault {
    /// Why the engine is halted, with a hint: it writes nothing more until it restarts.
    #[must_use]
    pub fn halt_problem(&self) -> Problem {
        match self {
            _ if self.is_disk_full() => {
                let hint = "free some space, then end the engine and start it again";
                Problem::of(self).with_hint(hint)
            }
            Self::Cell(CellError::Body(BodyError::Lost(_))) | Self::Body(BodyError::Lost(_)) => {
                let hint = "start the cell again, then end the engine and start it again";
                Problem::of(self).with_hint(hint)
            }
            _ => Problem::of(self),
        }
    }

    /// Whether the disk had no room for the write.
    #[must_use]
    pub const fn is_disk_full(&self) -> bool {
        matches!(
            self,
            Self::Store(StoreError::DiskFull { .. })
                | Self::VersionTable(VersionTableError::Store(StoreError::DiskFull { .. }))
        )
    }

    /// The refusal for a command that caused the fault, so that nothing has changed; absent for a fault of the engine, which
    /// halts it.
    #[must_use]
    pub const fn refusal(&self) -> Option<Refusal> {
        match self {
            Self::VersionTable(
                VersionTableError::UnknownFamily(_) | VersionTableError::UnknownVersion(_),
            ) => Some(Refusal::NotFound),
            Self::VersionTable(VersionTableError::Exists(_)) => Some(Refusal::Exists),
            Self::VersionTable(VersionTableError::Refused(_)) => Some(Refusal::NotNow),
            Self::Store(error) | Self::VersionTable(VersionTableError::Store(error)) => match error {
                StoreError::Invalid { .. } => Some(Refusal::BadInput),
                StoreError::DiskFull { .. } => Some(Refusal::Store),
                StoreError::Approval { .. } | StoreError::Person { .. } => Some(Refusal::NotAllowed),
                _ => None,
            },
            Self::VersionTable(_)
            | Self::Cell(_)
            | Self::Body(_)
            | Self::Canonical(_)
            | Self::Impossible(_) => None,
        }
    }

    /// As [`EngineFault::refusal`], for a command with this effect. If authority cannot be taken away because nothing can
    /// be written, the engine halts: the version may not run on. A candidate has no authority yet, and is put on hold
    /// instead.
    #[must_use]
    pub fn refusal_to(&self, effect: AuthorityEffect) -> Option<Refusal> {
        let takes_away = effect == AuthorityEffect::TakesAway;
        self.refusal().filter(|code| !(takes_away && *code == Refusal::Store))
    }
}

impl Hint for EngineFault {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::VersionTable(error) => error.details(),
            Self::Store(error) => error.details(),
            Self::Cell(_) | Self::Body(_) | Self::Canonical(_) | Self::Impossible(_) => {
                Some(ErrorReason::Internal.into())
            }
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::VersionTable(error) => error.hint(),
            Self::Store(error) => error.hint(),
            Self::Cell(_) | Self::Body(_) | Self::Canonical(_) | Self::Impossible(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use holdpoint_store::ApprovalFault;

    use super::*;

    /// The text for an approval that cannot be written: the fault is the store's, not the approver's.
    #[test]
    fn only_an_approval_at_fault_is_not_allowed() {
        let approval = StoreError::Approval { nonce: "7".to_owned(), problem: ApprovalFault::Used };
        assert_eq!(EngineFault::Store(approval).refusal(), Some(Refusal::NotAllowed));
        assert_eq!(
            EngineFault::Store(StoreError::DiskFull { what: "write" }).refusal(),
            Some(Refusal::Store)
        );
        let full = EngineFault::Store(StoreError::DiskFull { what: "write" });
        assert_eq!(full.refusal_to(AuthorityEffect::Gives), Some(Refusal::Store));
        assert_eq!(full.refusal_to(AuthorityEffect::TakesAway), None, "a rollback that is not written: halt");
        let problem = EngineFault::Store(StoreError::DiskFull { what: "write" }).halt_problem();
        let hint = "free some space, then end the engine and start it again";
        assert_eq!(problem.hint().as_deref(), Some(hint));
        assert_eq!(
            EngineFault::Store(StoreError::Unknown).refusal(),
            None,
            "it is unknown what is written: halt"
        );
    }
}
