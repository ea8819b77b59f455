//! What the marks and the panels of the health charts state.
//!
//! Typed values of the engine that never travel: the crate `holdpoint-wording` makes the text of a
//! [`HealthMark`](super::HealthMark) and the titles of an exported chart from them.

use holdpoint_governance::decision::Reason;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::notice::NoticeOrText;

/// What a mark states.
#[derive(Clone, Debug, PartialEq)]
pub enum MarkContent {
    /// A candidate became active.
    TookOver {
        /// The version.
        version: CapabilityId,
    },
    /// The first version of a family became active.
    FirstOfFamily {
        /// The version.
        version: CapabilityId,
    },
    /// An earlier version became active by a rollback.
    TookOverAgain {
        /// The version.
        version: CapabilityId,
    },
    /// A person reactivated a version.
    Reactivated {
        /// The version.
        version: CapabilityId,
    },
    /// A family has no active version any more.
    NoActiveVersion {
        /// The family.
        family: Family,
    },
    /// A version was rolled back or returned to evaluation.
    StateChanged {
        /// The version, as the record has it.
        subject: String,
        /// Why.
        reason: NoticeOrText,
    },
    /// An upgrade was confirmed.
    Confirmed {
        /// The version, as the record has it.
        subject: String,
    },
    /// The drift monitor restricted a version.
    Restricted {
        /// The version, as the record has it.
        subject: String,
        /// Why; absent if the record gives no reason that this build can read.
        reason: Option<Box<Reason>>,
    },
    /// A person acted on the cell or on a version.
    Acted {
        /// The person; empty if the record names none.
        by: String,
        /// The act.
        act: MarkedAct,
        /// The person's reason; empty if there is none.
        reason: String,
    },
    /// A drift of the live cell began.
    DriftBegan {
        /// The kind, as the record has it.
        drift: String,
        /// The magnitude, as the record has it.
        magnitude: String,
    },
    /// The drift of the cell ended.
    DriftEnded,
    /// Something in the live cell broke.
    FaultBegan {
        /// The fault, as the record has it.
        fault: String,
    },
    /// The fault of the live cell was repaired.
    FaultRepaired,
    /// A person left a note.
    Note {
        /// The person.
        by: String,
        /// The note.
        text: String,
    },
    /// A profile came into force.
    ProfileInForce {
        /// The profile, as the record has it; absent if the record does not name it.
        profile: Option<String>,
    },
    /// The normal rates of a version were counted.
    NormalCounted {
        /// The version, as the record has it.
        subject: String,
        /// Tasks.
        tasks: f64,
        /// Of these, failed.
        failures: f64,
        /// The largest force, N.
        force_n: f64,
    },
    /// No engine ran, or the machine slept.
    NoEngine {
        /// For how long, ms.
        ms: u64,
    },
    /// An alarm was raised.
    AlarmRaised {
        /// Its name.
        alarm: String,
        /// Its latest text; absent if the record does not repeat it.
        text: Option<NoticeOrText>,
    },
    /// A person closed an alarm.
    AlarmClosed {
        /// Its name.
        alarm: String,
        /// The person; absent if the record names none.
        by: Option<String>,
        /// The person's reason; empty if there is none.
        reason: String,
    },
}

/// An act of a person that is a mark.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MarkedAct {
    /// The person activated a version by break-glass.
    BreakGlass {
        /// The version, as the record has it.
        subject: String,
    },
    /// The person stopped the cell.
    StoppedCell,
    /// The person started the cell.
    StartedCell,
    /// The person set the goal of the agent.
    SetGoal {
        /// The goal, as the record has it.
        goal: String,
    },
}

/// A panel of an exported chart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HealthPanel {
    /// The success rate with its interval.
    Success,
    /// The rate of violations, and of these with near ones.
    Violations,
    /// The duration of a task.
    Time,
    /// The largest force of a task.
    Force,
}
