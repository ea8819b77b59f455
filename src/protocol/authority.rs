//! The effect of each command on authority over the arm, which decides who may send it.

use super::command::Command;
use holdpoint_governance::ids::{CapabilityId, Digest};

/// The effect of a command on authority.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AuthorityEffect {
    /// It only reads.
    Reads,
    /// It takes authority away or withholds it: any client may send it at any time, unsigned.
    TakesAway,
    /// It grants or widens authority: signed by an enrolled person, except under the profile `sim` and in scripts.
    Gives,
    /// It carries its own signature.
    SignedItself,
    /// It neither grants nor takes authority: seen alarms, and the pace of the live cell.
    Neither,
}

impl Command {
    /// Its effect on authority.
    #[must_use]
    pub fn authority_effect(&self) -> AuthorityEffect {
        self.facts().authority
    }

    /// Whether it only takes or withholds authority: the engine accepts it under any load of other requests.
    #[must_use]
    pub fn takes_authority_away(&self) -> bool {
        self.authority_effect() == AuthorityEffect::TakesAway
    }

    /// The version whose authority over the arm it takes away or narrows; `None` if there is none.
    #[must_use]
    pub const fn takes_from(&self) -> Option<&CapabilityId> {
        match self {
            Self::Rollback(operation)
            | Self::Vacate(operation)
            | Self::Restrict(operation)
            | Self::Reject(operation)
            | Self::Demote { operation, .. } => Some(&operation.version),
            _ => None,
        }
    }

    /// Whether it asks for confirmation, and does nothing, where no version would take over.
    #[must_use]
    pub const fn needs_last_confirmation(&self) -> bool {
        matches!(self, Self::Rollback(_) | Self::Demote { .. })
    }

    /// The person it names as requester; `None` if it names none.
    #[must_use]
    pub fn by(&self) -> Option<&str> {
        self.facts().by
    }

    /// The digest of its content that a signature covers: canonical JSON, without spaces and with sorted field names.
    ///
    /// # Errors
    /// If it holds a non-finite number, which JSON cannot express.
    pub fn digest(&self) -> Result<Digest, serde_json::Error> {
        Digest::of_json("holdpoint/command/v1", self)
    }
}
