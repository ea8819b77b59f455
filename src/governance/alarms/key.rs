//! What alarms are raised for: a closed set of kinds, each with what it is about.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::ids::{CapabilityId, Family};

crate::words! {
    /// What an alarm is raised for.
    AlarmKind, "kind of alarm", {
        /// A version was taken off, and its predecessor is in control.
        RolledBack = "rolled-back",
        /// The monitor asks people whether a version may work on.
        Escalated = "escalated",
        /// The monitor capped a version's speed and force.
        Restricted = "restricted",
        /// An active version, whichever, violated a limit.
        Violation = "violation",
        /// A version works worse than its family did when it was commissioned.
        Degraded = "degraded",
        /// An active version's own recovery drills pass too seldom.
        WeakRecovery = "weak-recovery",
        /// A version is in the live world not what it was in the sandbox.
        Shifted = "shifted",
        /// The cell's own senses are worse than when it was commissioned, whoever is active.
        CellDegraded = "cell-degraded",
        /// A family is stopped without an active version.
        SafeStopped = "safe-stopped",
        /// A family is back at its predecessor and does not work safely.
        NotRecovered = "not-recovered",
        /// A candidate was rejected by a rule or a person.
        Rejected = "rejected",
        /// People are asked for an approval.
        Approval = "approval",
        /// One person let a version in by the emergency door, and nobody has reviewed it yet.
        Unreviewed = "unreviewed",
        /// Kept results of an active version are not what running it again gives.
        KeptFalse = "kept-false",
        /// Telemetry that the record seals is not there any more.
        TelemetryMissed = "telemetry-missed",
        /// A checkpoint cannot be written, or cannot be sent to a witness.
        CheckpointFailed = "checkpoint-failed",
        /// Another program took the name of the engine's socket, and may have answered in its place.
        NameTaken = "name-taken",
        /// The cell came up stopped: the last engine ended suddenly, or a stop was not on record yet.
        CameUpStopped = "came-up-stopped",
        /// No administrator authorized the profile as this program has it.
        ProfileUnauthorized = "profile-unauthorized",
        /// The machine's clock was set, or is behind the newest record: nothing is activated until a person confirms the time.
        ClockDoubted = "clock-doubted",
        /// The engine met a fault and holds.
        EngineFault = "engine-fault",
    }
}

crate::words! {
    /// What alarms are grouped by in a flood: those of one topic share a row.
    AlarmTopic, "topic of an alarm", {
        /// What the monitors of active versions found.
        Monitor = "monitor",
        /// Versions that were taken off, and what came of it.
        Rollback = "rollback",
        /// Questions to people about an activation.
        Approval = "approval",
        /// Candidates that were rejected.
        Rejected = "rejected",
        /// The engine itself.
        Engine = "engine",
    }
}

impl AlarmKind {
    /// The row it shares with others in a flood.
    #[must_use]
    pub const fn topic(self) -> AlarmTopic {
        match self {
            Self::Escalated
            | Self::Restricted
            | Self::Violation
            | Self::Degraded
            | Self::WeakRecovery
            | Self::Shifted
            | Self::CellDegraded => AlarmTopic::Monitor,
            Self::RolledBack | Self::SafeStopped | Self::NotRecovered => AlarmTopic::Rollback,
            Self::Rejected => AlarmTopic::Rejected,
            Self::Approval | Self::Unreviewed => AlarmTopic::Approval,
            Self::KeptFalse
            | Self::TelemetryMissed
            | Self::CheckpointFailed
            | Self::NameTaken
            | Self::CameUpStopped
            | Self::ProfileUnauthorized
            | Self::ClockDoubted
            | Self::EngineFault => AlarmTopic::Engine,
        }
    }
}

/// The name of an alarm: its kind and what it is about. Written `rolled-back:grasp@1.3.0`, `safe-stopped:grasp` or
/// `engine-fault`; ordered as it is written.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub enum AlarmKey {
    /// The version that was taken off.
    RolledBack(CapabilityId),
    /// The version a monitor asks about.
    Escalated(CapabilityId),
    /// The version whose envelope was tightened.
    Restricted(CapabilityId),
    /// The active version that violated a limit.
    Violation(CapabilityId),
    /// The active version under which the family works worse.
    Degraded(CapabilityId),
    /// The active version whose drills pass too seldom.
    WeakRecovery(CapabilityId),
    /// The version that was in shadow.
    Shifted(CapabilityId),
    /// The one cell there is: its senses.
    CellDegraded,
    /// The family that is stopped.
    SafeStopped(Family),
    /// The family that does not work safely under the predecessor either.
    NotRecovered(Family),
    /// The candidate that was rejected.
    Rejected(CapabilityId),
    /// The candidate that waits for people.
    Approval(CapabilityId),
    /// The version that was let in by the emergency door.
    Unreviewed(CapabilityId),
    /// What is kept, all of it.
    KeptFalse,
    /// The one file of telemetry there is.
    TelemetryMissed,
    /// The store's checkpoints, here and elsewhere.
    CheckpointFailed,
    /// The name of the one engine's socket.
    NameTaken,
    /// The one cell there is: how it came up.
    CameUpStopped,
    /// The one profile in force.
    ProfileUnauthorized,
    /// The machine's clock.
    ClockDoubted,
    /// The one engine there is.
    EngineFault,
}

/// A text that names no alarm.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not the name of an alarm; e.g. \"safe-stopped:grasp\" is one")]
pub struct AlarmKeyError(pub String);

impl AlarmKey {
    /// What it is raised for, without what it is about.
    #[must_use]
    pub const fn kind(&self) -> AlarmKind {
        match self {
            Self::RolledBack(_) => AlarmKind::RolledBack,
            Self::Escalated(_) => AlarmKind::Escalated,
            Self::Restricted(_) => AlarmKind::Restricted,
            Self::Violation(_) => AlarmKind::Violation,
            Self::Degraded(_) => AlarmKind::Degraded,
            Self::WeakRecovery(_) => AlarmKind::WeakRecovery,
            Self::Shifted(_) => AlarmKind::Shifted,
            Self::CellDegraded => AlarmKind::CellDegraded,
            Self::SafeStopped(_) => AlarmKind::SafeStopped,
            Self::NotRecovered(_) => AlarmKind::NotRecovered,
            Self::Rejected(_) => AlarmKind::Rejected,
            Self::Approval(_) => AlarmKind::Approval,
            Self::Unreviewed(_) => AlarmKind::Unreviewed,
            Self::KeptFalse => AlarmKind::KeptFalse,
            Self::TelemetryMissed => AlarmKind::TelemetryMissed,
            Self::CheckpointFailed => AlarmKind::CheckpointFailed,
            Self::NameTaken => AlarmKind::NameTaken,
            Self::CameUpStopped => AlarmKind::CameUpStopped,
            Self::ProfileUnauthorized => AlarmKind::ProfileUnauthorized,
            Self::ClockDoubted => AlarmKind::ClockDoubted,
            Self::EngineFault => AlarmKind::EngineFault,
        }
    }
}

impl fmt::Display for AlarmKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = self.kind();
        match self {
            Self::RolledBack(version)
            | Self::Escalated(version)
            | Self::Restricted(version)
            | Self::Violation(version)
            | Self::Degraded(version)
            | Self::WeakRecovery(version)
            | Self::Shifted(version)
            | Self::Rejected(version)
            | Self::Approval(version)
            | Self::Unreviewed(version) => write!(f, "{kind}:{version}"),
            Self::SafeStopped(family) | Self::NotRecovered(family) => write!(f, "{kind}:{family}"),
            Self::CellDegraded
            | Self::KeptFalse
            | Self::TelemetryMissed
            | Self::CheckpointFailed
            | Self::NameTaken
            | Self::CameUpStopped
            | Self::ProfileUnauthorized
            | Self::ClockDoubted
            | Self::EngineFault => {
                write!(f, "{kind}")
            }
        }
    }
}

impl FromStr for AlarmKey {
    type Err = AlarmKeyError;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let bad = || AlarmKeyError(text.to_owned());
        let (kind, about) = text.split_once(':').map_or((text, None), |(kind, about)| (kind, Some(about)));
        let version = || about.and_then(|about| about.parse::<CapabilityId>().ok()).ok_or_else(bad);
        let family = || about.and_then(|about| Family::new(about).ok()).ok_or_else(bad);
        Ok(match kind.parse::<AlarmKind>().map_err(|_| bad())? {
            AlarmKind::RolledBack => Self::RolledBack(version()?),
            AlarmKind::Escalated => Self::Escalated(version()?),
            AlarmKind::Restricted => Self::Restricted(version()?),
            AlarmKind::Violation => Self::Violation(version()?),
            AlarmKind::Degraded => Self::Degraded(version()?),
            AlarmKind::WeakRecovery => Self::WeakRecovery(version()?),
            AlarmKind::Shifted => Self::Shifted(version()?),
            AlarmKind::SafeStopped => Self::SafeStopped(family()?),
            AlarmKind::NotRecovered => Self::NotRecovered(family()?),
            AlarmKind::Rejected => Self::Rejected(version()?),
            AlarmKind::Approval => Self::Approval(version()?),
            AlarmKind::Unreviewed => Self::Unreviewed(version()?),
            AlarmKind::KeptFalse if about.is_none() => Self::KeptFalse,
            AlarmKind::TelemetryMissed if about.is_none() => Self::TelemetryMissed,
            AlarmKind::CheckpointFailed if about.is_none() => Self::CheckpointFailed,
            AlarmKind::NameTaken if about.is_none() => Self::NameTaken,
            AlarmKind::CameUpStopped if about.is_none() => Self::CameUpStopped,
            AlarmKind::ProfileUnauthorized if about.is_none() => Self::ProfileUnauthorized,
            AlarmKind::ClockDoubted if about.is_none() => Self::ClockDoubted,
            AlarmKind::EngineFault if about.is_none() => Self::EngineFault,
            AlarmKind::CellDegraded if about.is_none() => Self::CellDegraded,
            AlarmKind::EngineFault
            | AlarmKind::NameTaken
            | AlarmKind::CameUpStopped
            | AlarmKind::ProfileUnauthorized
            | AlarmKind::ClockDoubted
            | AlarmKind::CheckpointFailed
            | AlarmKind::TelemetryMissed
            | AlarmKind::CellDegraded
            | AlarmKind::KeptFalse => return Err(bad()),
        })
    }
}

impl TryFrom<String> for AlarmKey {
    type Error = AlarmKeyError;
    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<AlarmKey> for String {
    fn from(key: AlarmKey) -> Self {
        key.to_string()
    }
}

impl Ord for AlarmKey {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.to_string().cmp(&other.to_string())
    }
}

impl PartialOrd for AlarmKey {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back_as_they_are_written() {
        for kind in AlarmKind::ALL {
            let about = match kind {
                AlarmKind::SafeStopped | AlarmKind::NotRecovered => ":grasp",
                AlarmKind::EngineFault
                | AlarmKind::ClockDoubted
                | AlarmKind::CellDegraded
                | AlarmKind::KeptFalse
                | AlarmKind::CheckpointFailed
                | AlarmKind::NameTaken
                | AlarmKind::CameUpStopped
                | AlarmKind::ProfileUnauthorized
                | AlarmKind::TelemetryMissed => "",
                AlarmKind::RolledBack
                | AlarmKind::Escalated
                | AlarmKind::Restricted
                | AlarmKind::Violation
                | AlarmKind::Degraded
                | AlarmKind::WeakRecovery
                | AlarmKind::Shifted
                | AlarmKind::Rejected
                | AlarmKind::Approval
                | AlarmKind::Unreviewed => ":grasp@1.3.0",
            };
            let text = format!("{kind}{about}");
            let key: AlarmKey = text.parse().unwrap();
            assert_eq!((key.kind(), key.to_string()), (kind, text.clone()));
            assert_eq!(serde_json::to_string(&key).unwrap(), format!("{text:?}"));
        }
        for bad in ["", "nothing", "rolled-back", "rolled-back:grasp", "safe-stopped:", "engine-fault:x"] {
            assert!(bad.parse::<AlarmKey>().is_err(), "{bad}");
        }
    }
}
