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
    pub const fn authority_effect(&self) -> AuthorityEffect {
        match self {
            Self::Question { .. }
            | Self::Detail { .. }
            | Self::Film { .. }
            | Self::Registry { .. }
            | Self::Audit { .. }
            | Self::Health { .. }
            | Self::VerifyAudit
            | Self::Snapshot => AuthorityEffect::Reads,
            Self::Stop { .. }
            | Self::Rollback(_)
            | Self::Vacate(_)
            | Self::Restrict(_)
            | Self::Reject(_)
            | Self::Demote { .. }
            | Self::Pause(_)
            | Self::Shutdown => AuthorityEffect::TakesAway,
            // A reset alarm no longer blocks anything, and a shelved one is hidden.
            Self::Register { .. }
            | Self::Release { .. }
            | Self::Resume(_)
            | Self::Repeat { .. }
            | Self::Rearm(_)
            | Self::Anchor(_)
            | Self::ReviewTries(_)
            | Self::Continue(_)
            | Self::Go { .. }
            | Self::ConfirmTime { .. }
            | Self::Goal { .. }
            // A link that is down leaves a monitor without data.
            | Self::Drift { .. }
            | Self::LiveFault { .. }
            | Self::ResetAlarm { .. }
            | Self::ShelveAlarm { .. } => AuthorityEffect::Gives,
            Self::Decide { .. } | Self::Person { .. } => AuthorityEffect::SignedItself,
            Self::AcknowledgeAlarm { .. }
            | Self::UnshelveAlarm { .. }
            | Self::Note { .. }
            | Self::Pace { .. } => AuthorityEffect::Neither,
        }
    }

    /// Whether it only takes or withholds authority: the engine accepts it under any load of other requests.
    #[must_use]
    pub const fn takes_authority_away(&self) -> bool {
        matches!(self.authority_effect(), AuthorityEffect::TakesAway)
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
        match self {
            Self::Reject(operation)
            | Self::Rollback(operation)
            | Self::Vacate(operation)
            | Self::Pause(operation)
            | Self::Resume(operation)
            | Self::Restrict(operation)
            | Self::Rearm(operation)
            | Self::Anchor(operation)
            | Self::ReviewTries(operation)
            | Self::Continue(operation)
            | Self::Demote { operation, .. }
            | Self::Release { operation, .. }
            | Self::Repeat { operation, .. } => Some(&operation.by),
            Self::AcknowledgeAlarm { by, .. }
            | Self::ResetAlarm { by, .. }
            | Self::ShelveAlarm { by, .. }
            | Self::UnshelveAlarm { by, .. }
            | Self::Stop { by, .. }
            | Self::Go { by, .. }
            | Self::ConfirmTime { by, .. }
            | Self::Goal { by, .. }
            | Self::Note { by, .. } => Some(by),
            Self::Register { by, .. } => by.as_deref(),
            Self::Question { .. }
            | Self::Decide { .. }
            | Self::Person { .. }
            | Self::Drift { .. }
            | Self::LiveFault { .. }
            | Self::Pace { .. }
            | Self::Detail { .. }
            | Self::Film { .. }
            | Self::Registry { .. }
            | Self::Audit { .. }
            | Self::Health { .. }
            | Self::VerifyAudit
            | Self::Snapshot
            | Self::Shutdown => None,
        }
    }

    /// The digest of its content that a signature covers: canonical JSON, without spaces and with sorted field names.
    ///
    /// # Errors
    /// If it holds a non-finite number, which JSON cannot express.
    pub fn digest(&self) -> Result<Digest, serde_json::Error> {
        Digest::of_json("holdpoint/command/v1", self)
    }
}
