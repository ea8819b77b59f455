//! What can be asked of the engine, and what it answers. Plain serde values: the one door for all front ends.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

use super::detail::{AuditPage, Detail, RegistryPage, Verified};
use super::explained::blank;
use holdpoint_approvals::SignedApproval;
use holdpoint_body::rehearsal::{DriftKind, LiveFault, Magnitude};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::VersionGroup;
use holdpoint_governance::submission::Package;
use holdpoint_text::Hint;

/// Something asked of the engine. A command grants nothing: the engine checks every one of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
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
        /// What was on the screen, kept with the decision; absent where there was none.
        shown: Option<String>,
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
        /// What changes; absent ends it.
        kind: Option<DriftKind>,
        /// How much; absent (an empty text) where it ends.
        #[serde(with = "blank")]
        #[schemars(with = "String")]
        magnitude: Option<Magnitude>,
    },
    /// Break something in the simulated live world, for a rehearsal.
    LiveFault {
        /// What breaks; absent mends it.
        fault: Option<LiveFault>,
    },
    /// Note that somebody has seen an alarm.
    AcknowledgeAlarm {
        /// Which.
        alarm: String,
        /// Who.
        by: String,
    },
    /// Close a latched alarm whose condition is gone.
    ResetAlarm {
        /// Which.
        alarm: String,
        /// Who.
        by: String,
        /// Why it is safe.
        reason: String,
    },
    /// Set an alarm aside for a time.
    ShelveAlarm {
        /// Which.
        alarm: String,
        /// Who.
        by: String,
        /// For how long, ms.
        for_ms: u64,
        /// Why.
        reason: String,
    },
    /// Take an alarm from its shelf.
    UnshelveAlarm {
        /// Which.
        alarm: String,
        /// Who.
        by: String,
    },
    /// Answer a monitor's question: the version goes on as it is.
    Continue(Operation),
    /// How fast the simulated live world works.
    Pace {
        /// Simulated seconds in a second; absent for as fast as it computes.
        times: Option<f64>,
    },
    /// Everything about one version.
    Detail {
        /// Which.
        version: CapabilityId,
    },
    /// A page of the registry.
    Registry {
        /// Which versions.
        group: VersionGroup,
        /// Whose name contains this; empty for all.
        text: String,
        /// How many to skip.
        offset: u64,
        /// How many at most.
        limit: u64,
    },
    /// A page of the audit log, the newest first.
    Audit {
        /// Records before this one; absent for the newest.
        before: Option<u64>,
        /// About this alone; empty for all.
        subject: String,
        /// How many at most.
        limit: u64,
    },
    /// Check the whole audit chain.
    VerifyAudit,
    /// How things stand.
    Snapshot,
    /// End in an orderly way: nothing is approved or activated by it.
    Shutdown,
}

/// Which version, by whom and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Chosen by the sender, unique; a retry uses the same.
    pub id: String,
    /// What is asked.
    pub command: Command,
}

/// The engine's answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
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
    /// Everything about one version.
    Detail {
        /// All of it.
        detail: Box<Detail>,
    },
    /// A page of the registry.
    Registry {
        /// The page.
        page: RegistryPage,
    },
    /// A page of the audit log.
    Audit {
        /// The page.
        page: AuditPage,
    },
    /// What checking the audit chain came to.
    Verified {
        /// All of it.
        verified: Verified,
    },
}

impl Reply {
    /// A refusal in an error's own words, with its hint.
    #[must_use]
    pub fn refused(code: Refusal, error: &impl Hint) -> Self {
        Self::Refused { code, text: error.to_string(), hint: error.hint().map(Cow::into_owned) }
    }
}

/// Why a command was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
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
    /// Whether it only reads, or is about alarms alone: it is carried out while the engine holds as well.
    #[must_use]
    pub const fn is_harmless(&self) -> bool {
        match self {
            Self::AcknowledgeAlarm { .. }
            | Self::ResetAlarm { .. }
            | Self::ShelveAlarm { .. }
            | Self::UnshelveAlarm { .. }
            | Self::Detail { .. }
            | Self::Registry { .. }
            | Self::Audit { .. }
            | Self::VerifyAudit
            | Self::Snapshot => true,
            Self::Register { .. }
            | Self::Decide { .. }
            | Self::Reject(_)
            | Self::Rollback(_)
            | Self::Demote { .. }
            | Self::Pause(_)
            | Self::Resume(_)
            | Self::Repeat { .. }
            | Self::Restrict(_)
            | Self::Rearm(_)
            | Self::Drift { .. }
            | Self::LiveFault { .. }
            | Self::Continue(_)
            | Self::Pace { .. }
            | Self::Shutdown => false,
        }
    }

    /// Whether it changes nothing, so that its answer need not be remembered.
    #[must_use]
    pub const fn only_reads(&self) -> bool {
        matches!(
            self,
            Self::Detail { .. }
                | Self::Registry { .. }
                | Self::Audit { .. }
                | Self::VerifyAudit
                | Self::Snapshot
        )
    }

    /// Whether it takes authority away: the arm is stopped for it wherever it works.
    #[must_use]
    pub const fn stops_the_arm(&self) -> bool {
        matches!(self, Self::Rollback(_) | Self::Restrict(_) | Self::Rearm(_) | Self::Shutdown)
    }

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
            | Self::Continue(operation)
            | Self::Demote { operation, .. }
            | Self::Repeat { operation, .. } => Some(&operation.version.family),
            Self::Detail { version } => Some(&version.family),
            Self::Register { .. }
            | Self::Decide { .. }
            | Self::Drift { .. }
            | Self::LiveFault { .. }
            | Self::AcknowledgeAlarm { .. }
            | Self::ResetAlarm { .. }
            | Self::ShelveAlarm { .. }
            | Self::UnshelveAlarm { .. }
            | Self::Pace { .. }
            | Self::Registry { .. }
            | Self::Audit { .. }
            | Self::VerifyAudit
            | Self::Snapshot
            | Self::Shutdown => None,
        }
    }
}
