//! The causes of alarms: a closed set of kinds, each with its subject.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::ids::{CapabilityId, Family, text_form};

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

/// Makes the kinds and the keys: documentation, subject, name and topic of each.
macro_rules! alarm_keys {
    (@subject) => { AlarmSubject::Cell };
    (@subject $about:ident) => { AlarmSubject::from($about) };
    ($($(#[$doc:meta])* $kind:ident $(($about:ident: $subject:ty))? = $name:literal: $topic:ident;)+) => {
        crate::closed_set! {
            /// The cause of an alarm.
            AlarmKind, "kind of alarm", { $($(#[$doc])* $kind = $name),+ }
        }

        impl AlarmKind {
            /// The row it shares with others in a flood.
            #[must_use]
            pub const fn topic(self) -> AlarmTopic {
                match self { $(Self::$kind => AlarmTopic::$topic),+ }
            }
        }

        /// The name of an alarm: its kind and its subject. Written `rolled-back:grasp@1.3.0`, `safe-stopped:grasp` or
        /// `engine-fault`; ordered as it is written.
        #[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, schemars::JsonSchema)]
        #[serde(try_from = "String", into = "String")]
        #[schemars(with = "String")]
        pub enum AlarmKey { $($(#[$doc])* $kind $(($subject))?),+ }

        impl AlarmKey {
            /// Its cause, without the subject.
            #[must_use]
            pub const fn kind(&self) -> AlarmKind {
                match self { $(Self::$kind { .. } => AlarmKind::$kind),+ }
            }

            fn subject(&self) -> AlarmSubject<'_> {
                match self { $(Self::$kind $(($about))? => alarm_keys!(@subject $($about)?)),+ }
            }
        }

        impl FromStr for AlarmKey {
            type Err = AlarmKeyError;
            fn from_str(text: &str) -> Result<Self, Self::Err> {
                let bad = || AlarmKeyError(text.to_owned());
                let (kind, about) = text.split_once(':').map_or((text, None), |(kind, about)| (kind, Some(about)));
                let key = match kind.parse::<AlarmKind>().map_err(|_| bad())? {
                    $(AlarmKind::$kind => Self::$kind $((
                        <$subject>::try_from(about.ok_or_else(bad)?.to_owned()).map_err(|_| bad())?
                    ))?),+
                };
                let takes_subject = !matches!(key.subject(), AlarmSubject::Cell);
                if about.is_some() == takes_subject { Ok(key) } else { Err(bad()) }
            }
        }
    };
}

alarm_keys! {
    /// A version was rolled back, and its rollback target is active.
    RolledBack(version: CapabilityId) = "rolled-back": Rollback;
    /// An escalation asks operators whether a version may continue.
    Escalated(version: CapabilityId) = "escalated": Monitor;
    /// The monitor capped a version's speed and force.
    Restricted(version: CapabilityId) = "restricted": Monitor;
    /// An active version, whichever, violated a limit.
    Violation(version: CapabilityId) = "violation": Monitor;
    /// A version performs worse than its family did when it was commissioned.
    Degraded(version: CapabilityId) = "degraded": Monitor;
    /// A commissioned version was a danger in a live task, or does harm more often than is normal.
    Harm(version: CapabilityId) = "harm": Monitor;
    /// The own recovery drills of an active version pass too seldom; it lasts while the version is the rollback target.
    WeakRecovery(version: CapabilityId) = "weak-recovery": Monitor;
    /// A version differs in the live world from the sandbox.
    Shifted(version: CapabilityId) = "shifted": Monitor;
    /// An active version has, in the same scene, the event that stopped the version compared with it.
    SharedEvent(version: CapabilityId) = "shared-event": Monitor;
    /// The evidence of an active version does not cover the start of a task.
    OutsideDomain(version: CapabilityId) = "outside-domain": Monitor;
    /// The camera check is worse than when the cell was commissioned, with any active version.
    CellDegraded = "cell-degraded": Monitor;
    /// A family is stopped without an active version.
    SafeStopped(family: Family) = "safe-stopped": Rollback;
    /// A family is back at its rollback target and does not run safely.
    NotRecovered(family: Family) = "not-recovered": Rollback;
    /// A candidate was rejected by a rule or a person. Older stores have it; a rejection raises no alarm any more.
    Rejected(version: CapabilityId) = "rejected": Rejected;
    /// An approval request is open.
    Approval(version: CapabilityId) = "approval": Approval;
    /// One person activated a version by break-glass, and the review is open.
    Unreviewed(version: CapabilityId) = "unreviewed": Approval;
    /// Cached results of an active version differ from its re-run.
    KeptFalse = "kept-false": Engine;
    /// Telemetry that the record seals is not there any more.
    TelemetryMissed = "telemetry-missed": Engine;
    /// A checkpoint cannot be written, or cannot be sent to a witness.
    CheckpointFailed = "checkpoint-failed": Engine;
    /// Another program took the name of the engine's socket, and may have answered in its place.
    NameTaken = "name-taken": Engine;
    /// The cell came up stopped: the last engine ended suddenly, or a stop was not on record yet.
    CameUpStopped = "came-up-stopped": Engine;
    /// The cell does not answer any more, or stopped its arm by itself, and is stopped.
    CellLost = "cell-lost": Engine;
    /// No administrator authorized the profile as this program has it.
    ProfileUnauthorized = "profile-unauthorized": Engine;
    /// The machine's clock was set, or is behind the newest record: nothing is activated until a person confirms the time.
    ClockDoubted = "clock-doubted": Engine;
    /// The engine is halted after a fault.
    EngineFault = "engine-fault": Engine;
}

/// A text that names no alarm.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not the name of an alarm; e.g. \"safe-stopped:grasp\" is one")]
pub struct AlarmKeyError(pub String);

/// The subject of an alarm.
#[derive(Clone, Copy)]
enum AlarmSubject<'a> {
    Version(&'a CapabilityId),
    Family(&'a Family),
    /// The one cell, with its store and its engine.
    Cell,
}

impl<'a> From<&'a CapabilityId> for AlarmSubject<'a> {
    fn from(version: &'a CapabilityId) -> Self {
        Self::Version(version)
    }
}

impl<'a> From<&'a Family> for AlarmSubject<'a> {
    fn from(family: &'a Family) -> Self {
        Self::Family(family)
    }
}

impl AlarmKey {
    /// The version that it is about; absent for an alarm about a family or the cell.
    #[must_use]
    pub fn version(&self) -> Option<&CapabilityId> {
        match self.subject() {
            AlarmSubject::Version(version) => Some(version),
            AlarmSubject::Family(_) | AlarmSubject::Cell => None,
        }
    }
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

text_form! { AlarmKey, AlarmKeyError }

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
            let texts = ["", ":grasp", ":grasp@1.3.0"].map(|about| format!("{kind}{about}"));
            let read: Vec<AlarmKey> = texts.iter().filter_map(|text| text.parse().ok()).collect();
            assert_eq!(read.len(), 1, "{kind} has one kind of subject");
            let text = read[0].to_string();
            assert!(read[0].kind() == kind && texts.contains(&text), "{text}");
            assert_eq!(serde_json::to_string(&read[0]).unwrap(), format!("{text:?}"));
        }
        for bad in ["", "nothing", "rolled-back", "rolled-back:grasp", "safe-stopped:", "engine-fault:x"] {
            assert!(bad.parse::<AlarmKey>().is_err(), "{bad}");
        }
    }
}
