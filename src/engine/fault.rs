//! Faults of the engine's own.

use std::borrow::Cow;

use holdpoint_body::BodyError;
use holdpoint_protocol::command::Refusal;
use holdpoint_registry::StoreError;
use holdpoint_sim::SimError;

use holdpoint_text::{Hint, Problem};

use crate::ledger::LedgerError;

/// What the engine itself failed at; it holds from then on, unless the command was at fault
/// ([`Fault::refusal`]).
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// A transition could not be written.
    #[error(transparent)]
    Ledger(#[from] LedgerError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Sim(#[from] SimError),
    /// The robot's body failed.
    #[error(transparent)]
    Body(#[from] BodyError),
    /// A record has no canonical form.
    #[error("a record has no canonical form: {0}")]
    Canonical(#[from] serde_json::Error),
    /// Something that cannot be is.
    #[error("{0}")]
    Impossible(String),
}

impl Fault {
    /// Why the engine holds for it, and what helps from then on: nothing is written any more before it begins anew.
    #[must_use]
    pub fn held(&self) -> Problem {
        match self {
            Self::Store(StoreError::DiskFull { .. })
            | Self::Ledger(LedgerError::Store(StoreError::DiskFull { .. })) => {
                let hint = "free some space, then end the engine and start it again";
                Problem::new(self.to_string()).with_hint(hint)
            }
            _ => Problem::of(self),
        }
    }

    /// Why a command is refused that was itself at fault, so that nothing has changed; absent for a fault of the
    /// engine's own, after which it holds.
    #[must_use]
    pub const fn refusal(&self) -> Option<Refusal> {
        match self {
            Self::Ledger(LedgerError::UnknownFamily(_) | LedgerError::UnknownVersion(_)) => {
                Some(Refusal::NotFound)
            }
            Self::Ledger(LedgerError::Exists(_)) => Some(Refusal::Exists),
            Self::Ledger(LedgerError::Refused(_)) => Some(Refusal::NotNow),
            Self::Store(error) | Self::Ledger(LedgerError::Store(error)) => match error {
                StoreError::Invalid { .. } => Some(Refusal::BadInput),
                StoreError::DiskFull { .. } => Some(Refusal::Store),
                StoreError::Approval { .. } | StoreError::Person { .. } => Some(Refusal::NotAllowed),
                _ => None,
            },
            Self::Ledger(_) | Self::Sim(_) | Self::Body(_) | Self::Canonical(_) | Self::Impossible(_) => None,
        }
    }
}

impl Hint for Fault {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Ledger(error) => error.hint(),
            Self::Store(error) => error.hint(),
            Self::Sim(_) | Self::Body(_) | Self::Canonical(_) | Self::Impossible(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a person is told of an approval that cannot be written: the store's fault is not the person's.
    #[test]
    fn only_an_approval_at_fault_is_not_allowed() {
        let approval = StoreError::Approval { nonce: "7".to_owned(), problem: "used".to_owned() };
        assert_eq!(Fault::Store(approval).refusal(), Some(Refusal::NotAllowed));
        assert_eq!(Fault::Store(StoreError::DiskFull { what: "write" }).refusal(), Some(Refusal::Store));
        let held = Fault::Store(StoreError::DiskFull { what: "write" }).held();
        let hint = "free some space, then end the engine and start it again";
        assert_eq!(held.hint().as_deref(), Some(hint));
        assert_eq!(Fault::Store(StoreError::Unknown).refusal(), None, "nobody knows what is written: hold");
    }
}
