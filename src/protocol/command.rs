//! What can be asked of the engine, and what it answers. Plain serde values: the one interface for all front ends.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeSet;

use super::detail::{AuditPage, Detail, RegistryPage, Verified};
use super::explained::blank;
use super::film::{Film, FilmAsked};
use super::health::{HealthAsked, HealthSeries};
use super::purpose::Purpose;
use super::question::QuestionView;
use holdpoint_approvals::{SignedApproval, SignedCall, SignedPersonAct};
use holdpoint_body::rehearsal::{DriftKind, LiveFault, Magnitude};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::{RecordKind, VersionGroup};
use holdpoint_governance::submission::Package;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_text::Hint;

pub use super::authority::Authority;
pub use super::caller::Caller;

/// The paces of the simulated live world, simulated seconds in a second.
pub const PACE_ALLOWED: std::ops::RangeInclusive<f64> = 0.1..=100.0;

/// Something asked of the engine. A command grants nothing: the engine checks every one of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "command", deny_unknown_fields)]
pub enum Command {
    /// Take in a candidate version; it acts on nothing before its gate.
    Register {
        /// Manifest, submission and parameters, as their author wrote them.
        package: Package,
        /// What the package is called in messages (its folder).
        name: String,
        /// In a script, the person on whose behalf it is registered; elsewhere the signature says who asks, and this
        /// is not looked at. Absent where a script's step names nobody.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        by: Option<String>,
    },
    /// A question as one person gets it: lines to show, the facts behind them, and what an answer has to name.
    Question {
        /// The version it is about.
        version: CapabilityId,
        /// Which question: one that waits, or the emergency door.
        purpose: Purpose,
        /// Name of the identity that would answer.
        who: String,
    },
    /// A person's signed approval or refusal of a waiting candidate. An approval is over what [`Command::Question`]
    /// answered; the engine makes it again and refuses another.
    Decide {
        /// The decision with its signature; checked by the engine and again by the store.
        signed: Box<SignedApproval>,
    },
    /// An administrator's signed act: a person's key is enrolled, or revoked.
    Person {
        /// The act with its signature; checked by the engine and again by the store.
        signed: Box<SignedPersonAct>,
    },
    /// Refuse a candidate for good; an active version is rolled back instead.
    Reject(Operation),
    /// Take the active version off: safe pose first, then the predecessor. Without a predecessor it is refused;
    /// [`Command::Vacate`] is for that.
    Rollback(Operation),
    /// Take the last version of a family off: no version acts until somebody re-arms the family.
    Vacate(Operation),
    /// Send a version back to evaluation, or close profiles to it.
    Demote {
        /// Version, person and reason.
        operation: Operation,
        /// Profiles that are closed to it (a profile demotion: it keeps its state, unless it acts under one of
        /// them); empty for a soft demotion.
        profiles: Vec<ProfileName>,
    },
    /// Lift the restriction of an active version, or open profiles to a version again.
    Release {
        /// Version, person and reason.
        operation: Operation,
        /// Profiles that are open to it again; empty for the envelope that monitor or operator tightened.
        profiles: Vec<ProfileName>,
    },
    /// Hold a candidate: it does not advance; rejecting, demoting and rolling back still work.
    Pause(Operation),
    /// Let a held candidate go on from where it was held.
    Resume(Operation),
    /// Run sandbox or shadow again; a gate pass and approvals are void with it.
    Repeat {
        /// Version, person and reason.
        operation: Operation,
        /// Sandbox or shadow; the lifecycle refuses any other.
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
        /// How much; absent (an empty text) if it ends.
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
        /// Name of the alarm, e.g. `rolled-back:grasp@1.3.0`.
        alarm: String,
        /// Identity of the operator who has taken note.
        by: String,
    },
    /// Close a latched alarm whose condition is gone.
    ResetAlarm {
        /// Name of the alarm, e.g. `safe-stopped:grasp`.
        alarm: String,
        /// Identity of the operator who answers for the reset.
        by: String,
        /// Why it is safe to close the alarm; a blank reason is refused.
        reason: String,
    },
    /// Set an alarm aside for a time.
    ShelveAlarm {
        /// Name of the alarm; a critical one is refused.
        alarm: String,
        /// Identity of the operator who sets it aside.
        by: String,
        /// For how long from now, ms; at most one shift of eight hours.
        for_ms: u64,
        /// Why it may be out of sight meanwhile; a blank reason is refused.
        reason: String,
    },
    /// Take an alarm from its shelf before the shelf ends.
    UnshelveAlarm {
        /// Name of the alarm, which must be shelved.
        alarm: String,
        /// Identity of the operator who brings it back.
        by: String,
    },
    /// Answer a monitor's question: the version goes on as it is.
    Continue(Operation),
    /// Stop the arm in the tick that runs, whatever is under way; carried out at any time, also while the engine
    /// holds. It stays stopped, over restarts as well, until [`Command::Go`].
    Stop {
        /// Who stops it, as they call themselves; any text will do, also none.
        by: String,
        /// Why, in the person's own words; may be empty.
        reason: String,
    },
    /// Let a stopped cell work again.
    Go {
        /// Identity of the person who answers for it.
        by: String,
        /// Why it is safe, in the person's own words; a blank reason is refused.
        reason: String,
        /// Which standstill is meant: virtual time since when it is stopped, ms
        /// ([`StoppedView::since_ms`](crate::snapshot::StoppedView::since_ms)); refused for another one.
        since_ms: u64,
        /// How many stops of it the person knows of ([`StoppedView::stops`](crate::snapshot::StoppedView::stops));
        /// refused where there are more.
        stops: u64,
    },
    /// Confirm what the machine's clock says, where it was set or is behind the newest record: until then nothing is
    /// activated.
    ConfirmTime {
        /// Identity of the person who answers for it.
        by: String,
        /// How the person knows, in their own words; a blank reason is refused.
        reason: String,
        /// The time that the person confirms; refused if the machine's clock says another one by more than five minutes.
        time: WallTime,
    },
    /// Leave a note for those who come after: on record, and a mark over the charts of health. It changes nothing else.
    Note {
        /// Whose it is.
        by: String,
        /// What it says; a blank one is refused.
        text: String,
    },
    /// What the agent of the live world works towards, from the next sequence on.
    Goal {
        /// In the words of the agent's goal interpreter: `pick-align-place`, or the last primitive to work (`grasp`,
        /// `align`, `place`).
        goal: String,
        /// Who sets it.
        by: String,
        /// Why, in the person's own words; a blank reason is refused.
        reason: String,
    },
    /// How fast the simulated live world works.
    Pace {
        /// Simulated seconds in a second; absent for as fast as it computes.
        times: Option<f64>,
    },
    /// Everything about one version.
    Detail {
        /// The version that is asked about.
        version: CapabilityId,
    },
    /// A piece of its evaluation, worked again and drawn. Nothing is decided by it and nothing of it kept.
    Film {
        /// The version that was evaluated.
        version: CapabilityId,
        /// Which piece of it.
        asked: FilmAsked,
    },
    /// A page of the registry's versions, by family and semantic version.
    Registry {
        /// The lifecycle states to list.
        group: VersionGroup,
        /// Whose name contains this; empty for all.
        text: String,
        /// Rows to skip from the start of the list.
        offset: u64,
        /// Most rows to return; [`PAGE_MAX`](super::detail::PAGE_MAX) is the limit.
        limit: u64,
    },
    /// A page of the audit log, the newest first.
    Audit {
        /// Records before this one; absent for the newest.
        before: Option<u64>,
        /// Only records about this family, version or alarm; empty for all.
        subject: String,
        /// Kinds that are left out before rows are counted; empty for none.
        #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
        without: BTreeSet<RecordKind>,
        /// Most rows to return; [`PAGE_MAX`](super::detail::PAGE_MAX) is the limit.
        limit: u64,
    },
    /// What live tasks came to over a span of time, what happened beside them, and the alarms of that span.
    Health {
        /// The span, and how it is cut.
        asked: HealthAsked,
    },
    /// Check the whole audit chain and the views that follow from it.
    #[serde(deserialize_with = "nothing_more")]
    VerifyAudit,
    /// The state of the whole engine at this moment.
    #[serde(deserialize_with = "nothing_more")]
    Snapshot,
    /// End in an orderly way: nothing is approved or activated by it.
    #[serde(deserialize_with = "nothing_more")]
    Shutdown,
}

/// A command without fields refuses those it does not know, as the others do: the derived code would pass over them.
fn nothing_more<'de, D: serde::Deserializer<'de>>(from: D) -> Result<(), D::Error> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Nothing {}
    Nothing::deserialize(from).map(|Nothing {}| ())
}

/// Which version, by whom and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Operation {
    /// The version that is to be moved.
    pub version: CapabilityId,
    /// Identity of the person who asks for it; kept on record.
    pub by: String,
    /// Why, in the person's own words; kept on record.
    pub reason: String,
}

/// A command with the id that makes a retry harmless.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Chosen by the sender, unique; a retry uses the same.
    pub id: String,
    /// What the engine is to do or to report.
    pub command: Command,
    /// Who signed the command, where it gives or widens authority ([`Authority`]); absent if nobody did. Under the
    /// profiles `real` and `human` such a command is refused without. With any other command it is not looked at.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seal: Option<Box<SignedCall>>,
}

impl Request {
    /// A request that nobody signed.
    #[must_use]
    pub const fn unsigned(id: String, command: Command) -> Self {
        Self { id, command, seal: None }
    }
}

/// The engine's answer to one request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "reply", deny_unknown_fields)]
pub enum Reply {
    /// Done, and on disk: a sudden death does not undo it.
    Accepted {
        /// What was done, one sentence for the person who asked.
        text: String,
        /// The version it is about; absent if it is about none.
        version: Option<CapabilityId>,
    },
    /// Not done; nothing has changed.
    Refused {
        /// The class of the refusal, for programs to match on.
        code: Refusal,
        /// What failed and why, one sentence for the person who asked.
        text: String,
        /// What would help, one sentence; absent if nothing the sender can do would.
        hint: Option<String>,
    },
    /// Answers [`Command::Stop`]: the cell is stopped, whether or not that could be written down.
    Stopped {
        /// What was done, one sentence for the person who asked.
        text: String,
        /// What of the stop outlasts this engine.
        kept: StopKept,
    },
    /// Answers [`Command::Snapshot`].
    Snapshot {
        /// The state of the whole engine.
        snapshot: Box<super::snapshot::Snapshot>,
    },
    /// Answers [`Command::Question`].
    Question {
        /// The question as that person gets it.
        question: Box<QuestionView>,
    },
    /// Answers [`Command::Detail`].
    Detail {
        /// Everything that is known of the version.
        detail: Box<Detail>,
    },
    /// Answers [`Command::Film`].
    Film {
        /// The pictures of both versions.
        film: Box<Film>,
    },
    /// Answers [`Command::Registry`].
    Registry {
        /// The rows asked for, with the number there are in all.
        page: RegistryPage,
    },
    /// Answers [`Command::Audit`].
    Audit {
        /// The rows asked for, with the head of the log.
        page: AuditPage,
    },
    /// Answers [`Command::Health`].
    Health {
        /// Bucket by bucket, with what it rests on.
        series: Box<HealthSeries>,
    },
    /// What checking the audit chain came to.
    Verified {
        /// Whether the chain holds, and what was found.
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

/// Where a stop is kept, so that it is in force after the engine's end, however that comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum StopKept {
    /// In the audit chain.
    OnRecord,
    /// In a file beside the record, which the next engine reads first.
    InMark,
    /// Nowhere but in the memory of this engine: a sudden end forgets it.
    InMemory,
}

/// Why a command was refused: a closed set for programs, beside the sentence for people.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Refusal {
    /// A value in the command is not allowed.
    BadInput,
    /// There is no such version, family, prompt or alarm.
    NotFound,
    /// A version of this name is registered already; what is registered never changes.
    Exists,
    /// The lifecycle does not allow it now.
    NotNow,
    /// The decision is over something that has changed since.
    Stale,
    /// The identity's role, or its part in the candidate, does not let it decide this.
    NotAllowed,
    /// The engine could not write it down.
    Store,
    /// The engine is holding after a fault of its own.
    Holding,
    /// No engine has answered: whether it was carried out is not known. Said by whoever asked, never by an engine.
    NoAnswer,
}

impl Command {
    /// Whether it only reads, is about alarms alone, or stops the cell: it is carried out while the engine holds as
    /// well.
    #[must_use]
    pub const fn is_harmless(&self) -> bool {
        match self {
            Self::AcknowledgeAlarm { .. }
            | Self::ResetAlarm { .. }
            | Self::ShelveAlarm { .. }
            | Self::UnshelveAlarm { .. }
            | Self::Stop { .. }
            | Self::Question { .. }
            | Self::Detail { .. }
            | Self::Film { .. }
            | Self::Registry { .. }
            | Self::Audit { .. }
            | Self::Health { .. }
            | Self::VerifyAudit
            | Self::Snapshot => true,
            Self::Register { .. }
            | Self::Decide { .. }
            | Self::Person { .. }
            | Self::Reject(_)
            | Self::Rollback(_)
            | Self::Vacate(_)
            | Self::Demote { .. }
            | Self::Release { .. }
            | Self::Pause(_)
            | Self::Resume(_)
            | Self::Repeat { .. }
            | Self::Restrict(_)
            | Self::Rearm(_)
            | Self::Drift { .. }
            | Self::LiveFault { .. }
            | Self::Continue(_)
            | Self::Go { .. }
            | Self::ConfirmTime { .. }
            | Self::Goal { .. }
            | Self::Note { .. }
            | Self::Pace { .. }
            | Self::Shutdown => false,
        }
    }

    /// Whether it changes nothing, so that its answer need not be remembered.
    #[must_use]
    pub const fn only_reads(&self) -> bool {
        matches!(
            self,
            Self::Question { .. }
                | Self::Detail { .. }
                | Self::Film { .. }
                | Self::Registry { .. }
                | Self::Audit { .. }
                | Self::Health { .. }
                | Self::VerifyAudit
                | Self::Snapshot
        )
    }

    /// Whether it takes authority away: the arm is stopped for it wherever it works.
    #[must_use]
    pub const fn stops_the_arm(&self) -> bool {
        matches!(
            self,
            Self::Rollback(_) | Self::Vacate(_) | Self::Restrict(_) | Self::Rearm(_) | Self::Shutdown
        )
    }

    /// Whether it stops or tightens what acts and does nothing else, with no signature: it is as right for whatever engine
    /// is at work as for the one that it was meant for.
    #[must_use]
    pub const fn stops_what_acts(&self) -> bool {
        matches!(
            self,
            Self::Stop { .. } | Self::Rollback(_) | Self::Vacate(_) | Self::Restrict(_) | Self::Pause(_)
        )
    }

    /// The family the command is about; `None` if it names none.
    #[must_use]
    pub const fn family(&self) -> Option<&Family> {
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
            | Self::Repeat { operation, .. } => Some(&operation.version.family),
            Self::Question { version, .. } | Self::Detail { version } | Self::Film { version, .. } => {
                Some(&version.family)
            }
            Self::Register { .. }
            | Self::Decide { .. }
            | Self::Person { .. }
            | Self::Drift { .. }
            | Self::LiveFault { .. }
            | Self::AcknowledgeAlarm { .. }
            | Self::ResetAlarm { .. }
            | Self::ShelveAlarm { .. }
            | Self::UnshelveAlarm { .. }
            | Self::Stop { .. }
            | Self::Go { .. }
            | Self::ConfirmTime { .. }
            | Self::Goal { .. }
            | Self::Note { .. }
            | Self::Pace { .. }
            | Self::Registry { .. }
            | Self::Audit { .. }
            | Self::Health { .. }
            | Self::VerifyAudit
            | Self::Snapshot
            | Self::Shutdown => None,
        }
    }
}

#[cfg(test)]
mod tests;
