//! What each command does to authority over the arm: who may ask for it follows from that.

use super::command::Command;
use holdpoint_governance::ids::{CapabilityId, Digest};

/// What a command does to authority.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Authority {
    /// It only reads.
    Reads,
    /// It takes authority away, or keeps it from being given: anybody may, at any time, and nothing is signed.
    TakesAway,
    /// It gives authority or widens it: signed by an enrolled person, but under the profile `sim` and in scripts.
    Gives,
    /// It carries a signature of its own over what it is about.
    SignedItself,
    /// It gives and takes none: what somebody has seen, and how fast the simulated cell works.
    Neither,
}

impl Command {
    /// What it does to authority.
    #[must_use]
    pub const fn authority(&self) -> Authority {
        match self {
            Self::Question { .. }
            | Self::Detail { .. }
            | Self::Film { .. }
            | Self::Registry { .. }
            | Self::Audit { .. }
            | Self::Health { .. }
            | Self::VerifyAudit
            | Self::Snapshot => Authority::Reads,
            Self::Stop { .. }
            | Self::Rollback(_)
            | Self::Vacate(_)
            | Self::Restrict(_)
            | Self::Reject(_)
            | Self::Demote { .. }
            | Self::Pause(_)
            | Self::Shutdown => Authority::TakesAway,
            // An alarm that is reset no longer holds anything, and one on a shelf is out of sight.
            Self::Register { .. }
            | Self::Release { .. }
            | Self::Resume(_)
            | Self::Repeat { .. }
            | Self::Rearm(_)
            | Self::Continue(_)
            | Self::Go { .. }
            | Self::ConfirmTime { .. }
            | Self::Goal { .. }
            // A link that is down leaves a monitor without what it looks at.
            | Self::Drift { .. }
            | Self::LiveFault { .. }
            | Self::ResetAlarm { .. }
            | Self::ShelveAlarm { .. } => Authority::Gives,
            Self::Decide { .. } | Self::Person { .. } => Authority::SignedItself,
            Self::AcknowledgeAlarm { .. }
            | Self::UnshelveAlarm { .. }
            | Self::Note { .. }
            | Self::Pace { .. } => Authority::Neither,
        }
    }

    /// Whether it does nothing but take authority away, or keep it from being given: no crowd of other requests keeps it
    /// out.
    #[must_use]
    pub const fn takes_authority_away(&self) -> bool {
        matches!(self.authority(), Authority::TakesAway)
    }

    /// The version whose authority over the arm it takes away or narrows; `None` if it is about no version's.
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

    /// Whether it asks back, and does nothing, where nobody would take over.
    #[must_use]
    pub const fn asks_for_the_last(&self) -> bool {
        matches!(self, Self::Rollback(_) | Self::Demote { .. })
    }

    /// The person it names as who asks; `None` if it names none.
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

    /// The digest of its content that a signature is over: of its canonical JSON (no spaces, names of fields sorted).
    ///
    /// # Errors
    /// If it holds a number that is none, which no JSON can.
    pub fn digest(&self) -> Result<Digest, serde_json::Error> {
        Digest::of_json("holdpoint/command/v1", self)
    }
}
