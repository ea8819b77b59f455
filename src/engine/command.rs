//! What can be asked of the engine, and what it answers. Plain serde values: the one door for all front ends.

use serde::{Deserialize, Serialize};

use crate::approvals::SignedApproval;
use crate::governance::ids::{CapabilityId, Family};
use crate::governance::lifecycle::Stage;
use crate::governance::profile::ProfileName;
use crate::runtime::capability::Package;

/// Something asked of the engine. A command grants nothing: the engine checks every one of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "command", deny_unknown_fields)]
pub enum Command {
    /// Take in a candidate version.
    Register {
        /// Its texts.
        package: Package,
        /// What the package is called in messages (its folder).
        name: String,
    },
    /// A signed approval or refusal.
    Decide {
        /// The decision with its signature.
        signed: Box<SignedApproval>,
    },
    /// Refuse a candidate for good.
    Reject(Operation),
    /// Take an active version off.
    Rollback(Operation),
    /// Send a version back to evaluation, or close profiles to it.
    Demote {
        /// Which, by whom and why.
        operation: Operation,
        /// Profiles that are closed to it; empty for a soft demotion.
        profiles: Vec<ProfileName>,
    },
    /// Hold a candidate.
    Pause(Operation),
    /// Let a held candidate go on.
    Resume(Operation),
    /// Run a stage again.
    Repeat {
        /// Which, by whom and why.
        operation: Operation,
        /// Which stage.
        stage: Stage,
    },
    /// Tighten the envelope of an active version, as the monitor would.
    Restrict(Operation),
    /// Make a superseded version of a safe-stopped family active again.
    Rearm(Operation),
    /// Let a drift set in, in the simulated cell.
    Drift {
        /// `sensor-noise`, `distribution-shift`, `actuator-delay`, `combined`; absent ends it.
        kind: Option<String>,
        /// `mild`, `middle` or `strong`.
        magnitude: String,
    },
    /// Break something in the simulated live world, for a rehearsal.
    LiveFault {
        /// `telemetry-lost` or `camera-lost`; absent mends it.
        fault: Option<String>,
    },
    /// Note that somebody has seen an alarm.
    AcknowledgeAlarm {
        /// Which.
        alarm: String,
        /// Who.
        by: String,
    },
    /// How things stand.
    Snapshot,
    /// End in an orderly way: nothing is approved or activated by it.
    Shutdown,
}

/// Which version, by whom and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Operation {
    /// The version.
    pub version: CapabilityId,
    /// Who asks.
    pub by: String,
    /// Why.
    pub reason: String,
}

/// A command with the id that makes a retry harmless.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Chosen by the sender, unique; a retry uses the same.
    pub id: String,
    /// What is asked.
    pub command: Command,
}

/// The engine's answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "reply", deny_unknown_fields)]
pub enum Reply {
    /// Done, and on disk.
    Accepted {
        /// One sentence.
        text: String,
        /// The version it is about.
        version: Option<CapabilityId>,
    },
    /// Not done; nothing has changed.
    Refused {
        /// A stable name.
        code: Refusal,
        /// What failed and why.
        text: String,
        /// What would help.
        hint: Option<String>,
    },
    /// How things stand.
    Snapshot {
        /// All of it.
        snapshot: Box<super::snapshot::Snapshot>,
    },
}

/// Why a command was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Refusal {
    /// A value in the command is not allowed.
    BadInput,
    /// There is no such version, family, prompt or alarm.
    NotFound,
    /// It exists already.
    Exists,
    /// The lifecycle does not allow it now.
    NotNow,
    /// The decision is over something that has changed since.
    Stale,
    /// The identity may not decide this.
    NotAllowed,
    /// The engine could not write it down.
    Store,
    /// The engine is holding after a fault of its own.
    Holding,
}

impl Command {
    /// The family a command is about, where it names one.
    #[must_use]
    pub const fn family(&self) -> Option<&Family> {
        match self {
            Self::Reject(operation)
            | Self::Rollback(operation)
            | Self::Pause(operation)
            | Self::Resume(operation)
            | Self::Restrict(operation)
            | Self::Rearm(operation)
            | Self::Demote { operation, .. }
            | Self::Repeat { operation, .. } => Some(&operation.version.family),
            Self::Register { .. }
            | Self::Decide { .. }
            | Self::Drift { .. }
            | Self::LiveFault { .. }
            | Self::AcknowledgeAlarm { .. }
            | Self::Snapshot
            | Self::Shutdown => None,
        }
    }
}
