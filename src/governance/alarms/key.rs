//! The causes of alarms: a closed set of kinds, each with its subject.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::ids::{CapabilityId, Family};

crate::closed_set! {
    /// The cause of an alarm.
    AlarmKind, "kind of alarm", {
        /// A version was rolled back, and its rollback target is active.
        RolledBack = "rolled-back",
        /// An escalation asks operators whether a version may continue.
        Escalated = "escalated",
        /// The monitor capped a version's speed and force.
        Restricted = "restricted",
        /// An active version, whichever, violated a limit.
        Violation = "violation",
        /// A version performs worse than its family did when it was commissioned.
        Degraded = "degraded",
        /// A commissioned version was a danger in a live task, or does harm more often than is normal.
        Harm = "harm",
        /// An active version's own recovery drills pass too seldom.
        WeakRecovery = "weak-recovery",
        /// A version differs in the live world from the sandbox.
        Shifted = "shifted",
        /// An active version has, in the same scene, the event that stopped the version compared with it.
        SharedEvent = "shared-event",
        /// The evidence of an active version does not cover the start of a task.
        OutsideDomain = "outside-domain",
        /// The camera check is worse than when the cell was commissioned, with any active version.
        CellDegraded = "cell-degraded",
        /// A family is stopped without an active version.
        SafeStopped = "safe-stopped",
        /// A family is back at its rollback target and does not run safely.
        NotRecovered = "not-recovered",
        /// A candidate was rejected by a rule or a person. Older stores have it; a rejection raises no alarm any more.
        Rejected = "rejected",
        /// An approval request is open.
        Approval = "approval",
        /// One person activated a version by break-glass, and the review is open.
        Unreviewed = "unreviewed",
        /// Cached results of an active version differ from its re-run.
        KeptFalse = "kept-false",
        /// Telemetry that the record seals is not there any more.
        TelemetryMissed = "telemetry-missed",
        /// A checkpoint cannot be written, or cannot be sent to a witness.
        CheckpointFailed = "checkpoint-failed",
        /// Another program took the name of the engine's socket, and may have answered in its place.
        NameTaken = "name-taken",
        /// The cell came up stopped: the last engine ended suddenly, or a stop was not on record yet.
        CameUpStopped = "came-up-stopped",
        /// The cell does not answer any more, or stopped its arm by itself, and is stopped.
        CellLost = "cell-lost",
        /// No administrator authorized the profile as this program has it.
        ProfileUnauthorized = "profile-unauthorized",
        /// The machine's clock was set, or is behind the newest record: nothing is activated until a person confirms the time.
        ClockDoubted = "clock-doubted",
        /// The engine is halted after a fault.
        EngineFault = "engine-fault",
    }
}

crate::closed_set! {
    /// The groups of alarms in a flood: those of one topic share a row.
    AlarmTopic, "topic of an alarm", {
        /// Findings of the monitors of active versions.
        Monitor = "monitor",
        /// Rollbacks and their results.
        Rollback = "rollback",
        /// Approval requests about an activation.
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
            | Self::Harm
            | Self::WeakRecovery
            | Self::Shifted
            | Self::SharedEvent
            | Self::OutsideDomain
            | Self::CellDegraded => AlarmTopic::Monitor,
            Self::RolledBack | Self::SafeStopped | Self::NotRecovered => AlarmTopic::Rollback,
            Self::Rejected => AlarmTopic::Rejected,
            Self::Approval | Self::Unreviewed => AlarmTopic::Approval,
            Self::KeptFalse
            | Self::TelemetryMissed
            | Self::CheckpointFailed
            | Self::NameTaken
            | Self::CameUpStopped
            | Self::CellLost
            | Self::ProfileUnauthorized
            | Self::ClockDoubted
            | Self::EngineFault => AlarmTopic::Engine,
        }
    }
}

/// The name of an alarm: its kind and its subject. Written `rolled-back:grasp@1.3.0`, `safe-stopped:grasp` or
/// `engine-fault`; ordered as it is written.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub enum AlarmKey {
    /// The version that was rolled back.
    RolledBack(CapabilityId),
    /// The version of an escalation.
    Escalated(CapabilityId),
    /// The version whose envelope was tightened.
    Restricted(CapabilityId),
    /// The active version that violated a limit.
    Violation(CapabilityId),
    /// The active version under which the family performs worse.
    Degraded(CapabilityId),
    /// The active version that did harm.
    Harm(CapabilityId),
    /// The active version whose drills pass too seldom.
    WeakRecovery(CapabilityId),
    /// The version that was in shadow.
    Shifted(CapabilityId),
    /// The active version with the same event.
    SharedEvent(CapabilityId),
    /// The active version whose evidence does not cover a start.
    OutsideDomain(CapabilityId),
    /// The only cell: its camera check.
    CellDegraded,
    /// The family that is stopped.
    SafeStopped(Family),
    /// The family that does not run safely under the rollback target either.
    NotRecovered(Family),
    /// The candidate that was rejected.
    Rejected(CapabilityId),
    /// The candidate that waits for people.
    Approval(CapabilityId),
    /// The version activated by break-glass.
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
    /// The one cell there is: its answers.
    CellLost,
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
    /// Its cause, without the subject.
    #[must_use]
    pub const fn kind(&self) -> AlarmKind {
        match self {
            Self::RolledBack(_) => AlarmKind::RolledBack,
            Self::Escalated(_) => AlarmKind::Escalated,
            Self::Restricted(_) => AlarmKind::Restricted,
            Self::Violation(_) => AlarmKind::Violation,
            Self::Degraded(_) => AlarmKind::Degraded,
            Self::Harm(_) => AlarmKind::Harm,
            Self::WeakRecovery(_) => AlarmKind::WeakRecovery,
            Self::Shifted(_) => AlarmKind::Shifted,
            Self::SharedEvent(_) => AlarmKind::SharedEvent,
            Self::OutsideDomain(_) => AlarmKind::OutsideDomain,
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
            Self::CellLost => AlarmKind::CellLost,
            Self::ProfileUnauthorized => AlarmKind::ProfileUnauthorized,
            Self::ClockDoubted => AlarmKind::ClockDoubted,
            Self::EngineFault => AlarmKind::EngineFault,
        }
    }

    /// The version that it is about; absent for an alarm about a family or the cell.
    #[must_use]
    pub const fn version(&self) -> Option<&CapabilityId> {
        match self.subject() {
            AlarmSubject::Version(version) => Some(version),
            AlarmSubject::Family(_) | AlarmSubject::Cell => None,
        }
    }

    const fn subject(&self) -> AlarmSubject<'_> {
        match self {
            Self::RolledBack(version)
            | Self::Escalated(version)
            | Self::Restricted(version)
            | Self::Violation(version)
            | Self::Degraded(version)
            | Self::Harm(version)
            | Self::WeakRecovery(version)
            | Self::Shifted(version)
            | Self::SharedEvent(version)
            | Self::OutsideDomain(version)
            | Self::Rejected(version)
            | Self::Approval(version)
            | Self::Unreviewed(version) => AlarmSubject::Version(version),
            Self::SafeStopped(family) | Self::NotRecovered(family) => AlarmSubject::Family(family),
            Self::CellDegraded
            | Self::KeptFalse
            | Self::TelemetryMissed
            | Self::CheckpointFailed
            | Self::NameTaken
            | Self::CameUpStopped
            | Self::CellLost
            | Self::ProfileUnauthorized
            | Self::ClockDoubted
            | Self::EngineFault => AlarmSubject::Cell,
        }
    }
}

/// The subject of an alarm.
#[derive(Clone, Copy)]
enum AlarmSubject<'a> {
    Version(&'a CapabilityId),
    Family(&'a Family),
    /// The one cell, with its store and its engine.
    Cell,
}

impl fmt::Display for AlarmKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = self.kind();
        match self.subject() {
            AlarmSubject::Version(version) => write!(f, "{kind}:{version}"),
            AlarmSubject::Family(family) => write!(f, "{kind}:{family}"),
            AlarmSubject::Cell => write!(f, "{kind}"),
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
            AlarmKind::Harm => Self::Harm(version()?),
            AlarmKind::WeakRecovery => Self::WeakRecovery(version()?),
            AlarmKind::Shifted => Self::Shifted(version()?),
            AlarmKind::SharedEvent => Self::SharedEvent(version()?),
            AlarmKind::OutsideDomain => Self::OutsideDomain(version()?),
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
            AlarmKind::CellLost if about.is_none() => Self::CellLost,
            AlarmKind::ProfileUnauthorized if about.is_none() => Self::ProfileUnauthorized,
            AlarmKind::ClockDoubted if about.is_none() => Self::ClockDoubted,
            AlarmKind::EngineFault if about.is_none() => Self::EngineFault,
            AlarmKind::CellDegraded if about.is_none() => Self::CellDegraded,
            AlarmKind::EngineFault
            | AlarmKind::NameTaken
            | AlarmKind::CameUpStopped
            | AlarmKind::CellLost
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
                | AlarmKind::CellLost
                | AlarmKind::ProfileUnauthorized
                | AlarmKind::TelemetryMissed => "",
                AlarmKind::RolledBack
                | AlarmKind::Escalated
                | AlarmKind::Restricted
                | AlarmKind::Violation
                | AlarmKind::Degraded
                | AlarmKind::Harm
                | AlarmKind::WeakRecovery
                | AlarmKind::Shifted
                | AlarmKind::SharedEvent
                | AlarmKind::OutsideDomain
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
