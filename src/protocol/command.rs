//! The commands of the engine and its replies. Plain serde values: one interface for all front ends.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeSet;

use super::approval_document::ApprovalDocument;
use super::detail::{AuditPage, AuditVerification, Detail, RegistryPage};
use super::explanation::blank;
use super::film::{Film, FilmRequest};
use super::health::{HealthQuery, HealthSeries};
use super::request_kind::RequestKind;
use holdpoint_approvals::{SignedApproval, SignedCall, SignedPersonAct};
use holdpoint_body::disturbance::{DriftKind, LiveFault, Magnitude};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::{RecordKind, VersionGroup};
use holdpoint_governance::submission::Package;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_text::Hint;

pub use super::authority::AuthorityEffect;
pub use super::caller::Caller;

/// The paces of the live cell, seconds of the cell per second.
pub const PACE_ALLOWED: std::ops::RangeInclusive<f64> = 0.1..=100.0;

/// A command to the engine. It grants nothing: the engine checks every one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "command", deny_unknown_fields)]
pub enum Command {
    /// Register a candidate; it moves nothing before its gate.
    Register {
        /// Manifest, submission and parameters, as their author wrote them.
        package: Package,
        /// The package's name in messages (its folder).
        name: String,
        /// In a script, the person on whose behalf the version is registered; absent if the step names none. Elsewhere
        /// the signature identifies the requester, and this is ignored.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        by: Option<String>,
    },
    /// Render an approval request for one person: lines to show, the facts behind them, and the ids an answer must name.
    Question {
        /// Its version.
        version: CapabilityId,
        /// Which request: one that waits, or break-glass.
        purpose: RequestKind,
        /// Name of the identity that would answer.
        who: String,
    },
    /// A person's signed approval or refusal of a waiting candidate. An approval covers the reply to
    /// [`Command::Question`]; the engine renders it again and refuses a different one.
    Decide {
        /// The decision with its signature, which the store verifies.
        signed: Box<SignedApproval>,
    },
    /// An administrator's signed act that enrolls or revokes a person's key.
    Person {
        /// The act with its signature; checked by the engine and again by the store.
        signed: Box<SignedPersonAct>,
    },
    /// Reject a candidate; refused for an active version, of which `rollback` takes the control away.
    Reject(Operation),
    /// Roll the active version back: safe pose first, then the rollback target; refused without one. Then use
    /// [`Command::Vacate`].
    Rollback(Operation),
    /// Deactivate the last version of a family: none is active until an operator reactivates one.
    Vacate(Operation),
    /// Return a version to evaluation, or block it under profiles.
    Demote {
        /// Version, person and reason.
        operation: Operation,
        /// Profiles under which to block it (a profile demotion: it keeps its state, unless it is active under one
        /// of them); empty to return it to evaluation.
        profiles: Vec<ProfileName>,
    },
    /// Lift the restriction of an active version, or unblock a version under profiles.
    Release {
        /// Version, person and reason.
        operation: Operation,
        /// Profiles under which to unblock it; empty to restore the full envelope.
        profiles: Vec<ProfileName>,
    },
    /// Pause a candidate: it does not advance; reject, demote and rollback still work.
    Pause(Operation),
    /// Resume a candidate from the point where it was paused or put on hold.
    Resume(Operation),
    /// Run sandbox or shadow again; this voids a gate pass and approvals.
    Repeat {
        /// Version, person and reason.
        operation: Operation,
        /// Sandbox or shadow; the lifecycle refuses any other.
        stage: Stage,
    },
    /// Make a confirmed version its family's anchor: candidates are compared with it, too, so that tolerances do not add
    /// up over several versions.
    Anchor(Operation),
    /// Review the tries of the version's family: their count begins again. Where people approve, a person does it who
    /// neither wrote nor registered what was tried.
    ReviewTries(Operation),
    /// Tighten the envelope of an active version, as the monitor would.
    Restrict(Operation),
    /// Reactivate an earlier version of a safe-stopped family.
    Rearm(Operation),
    /// Start a drift of the live cell, or end it.
    Drift {
        /// What changes; absent ends it.
        kind: Option<DriftKind>,
        /// How much; absent (an empty text) if it ends.
        #[serde(with = "blank")]
        #[schemars(with = "String")]
        magnitude: Option<Magnitude>,
    },
    /// Break something in the live cell for an exercise, or repair it.
    LiveFault {
        /// What breaks; absent to repair it.
        fault: Option<LiveFault>,
    },
    /// Acknowledge an alarm.
    AcknowledgeAlarm {
        /// Name of the alarm, e.g. `rolled-back:grasp@1.3.0`.
        alarm: String,
        /// Identity of the operator who acknowledges it.
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
    /// Shelve an alarm for at most eight hours; never a critical one.
    ShelveAlarm {
        /// Name of the alarm.
        alarm: String,
        /// Identity of the operator who shelves it.
        by: String,
        /// For how long from now, ms.
        for_ms: u64,
        /// Why it may be hidden meanwhile; a blank reason is refused.
        reason: String,
    },
    /// Unshelve an alarm before its time.
    UnshelveAlarm {
        /// Name of the alarm, which must be shelved.
        alarm: String,
        /// Identity of the operator who unshelves it.
        by: String,
    },
    /// Answer an escalation: the version continues unchanged.
    Continue(Operation),
    /// Stop the arm in the current tick; accepted at any time, also while the engine is halted. The cell stays
    /// stopped, over restarts as well, until [`Command::Go`].
    Stop {
        /// The person's own name, unverified; any text, also none.
        by: String,
        /// Why, in the person's own words; may be empty.
        reason: String,
    },
    /// Start a stopped cell again.
    Go {
        /// Identity of the person who answers for it.
        by: String,
        /// Why it is safe, in the person's own words; a blank reason is refused.
        reason: String,
        /// The stop to end: the virtual time of its beginning, ms
        /// ([`StoppedView::since_ms`](crate::snapshot::StoppedView::since_ms)); refused for another one.
        since_ms: u64,
        /// How many stops of it the person knows of ([`StoppedView::stops`](crate::snapshot::StoppedView::stops));
        /// refused if there are more.
        stops: u64,
    },
    /// Confirm the machine's clock after a clock mismatch; until then nothing is activated.
    ConfirmTime {
        /// Identity of the person who answers for it.
        by: String,
        /// How the person knows, in their own words; a blank reason is refused.
        reason: String,
        /// The time that the person confirms; refused if the machine's clock says another one by more than five minutes.
        time: WallTime,
    },
    /// Leave a note for the next shift: on record, and a mark over the health charts. It changes nothing else.
    Note {
        /// Its author.
        by: String,
        /// Its text; a blank one is refused.
        text: String,
    },
    /// Set the goal of the live cell's agent, from the next sequence on.
    Goal {
        /// In the words of the agent's goal interpreter: `pick-align-place`, or the last primitive to run (`grasp`,
        /// `align`, `place`).
        goal: String,
        /// The person who sets it.
        by: String,
        /// Why, in the person's own words; a blank reason is refused.
        reason: String,
    },
    /// Set the pace of the live cell: 0.1 to 100 simulated seconds in a second, or no limit.
    Pace {
        /// Simulated seconds in a second; absent for as fast as it computes.
        times: Option<f64>,
    },
    /// Everything about one version.
    Detail {
        /// The version.
        version: CapabilityId,
    },
    /// Re-run a piece of its evaluation with video. It decides nothing, and nothing of it is stored.
    Film {
        /// The version that was evaluated.
        version: CapabilityId,
        /// Which piece of it.
        asked: FilmRequest,
    },
    /// A page of at most 10,000 versions, by family and semantic version, with the chosen anchors.
    Registry {
        /// The lifecycle states to list.
        group: VersionGroup,
        /// Only versions whose name contains this; empty for all.
        text: String,
        /// Rows to skip from the start of the list.
        offset: u64,
        /// Most rows to return; [`PAGE_MAX`](super::detail::PAGE_MAX) is the limit.
        limit: u64,
    },
    /// A page of at most 10,000 records of the audit log, the newest first.
    Audit {
        /// Records before this one; absent for the newest.
        before: Option<u64>,
        /// Only records about this family, version or alarm; empty for all.
        subject: String,
        /// Kinds to omit before rows are counted; empty for none.
        #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
        without: BTreeSet<RecordKind>,
        /// Most rows to return; [`PAGE_MAX`](super::detail::PAGE_MAX) is the limit.
        limit: u64,
    },
    /// Results of live tasks over a span of time, events beside them, and the alarms of that span.
    Health {
        /// The span and its buckets.
        asked: HealthQuery,
    },
    /// Check the whole audit chain and the views that follow from it.
    #[serde(deserialize_with = "nothing_more")]
    VerifyAudit,
    /// The state of the whole engine at this moment.
    #[serde(deserialize_with = "nothing_more")]
    Snapshot,
    /// End the engine cleanly; this approves and activates nothing.
    #[serde(deserialize_with = "nothing_more")]
    Shutdown,
}

/// A command without fields refuses unknown ones, as the others do: the derived code would ignore them.
fn nothing_more<'de, D: serde::Deserializer<'de>>(from: D) -> Result<(), D::Error> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct NoFields {}
    NoFields::deserialize(from).map(|NoFields {}| ())
}

/// The version, the person and the reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Operation {
    /// The version to move.
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
    /// The command.
    pub command: Command,
    /// The signer of a command that grants or widens authority ([`AuthorityEffect`]); absent if it is unsigned. Under `real`
    /// and `human` the engine refuses such a command without it. With any other command it is ignored.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seal: Option<Box<SignedCall>>,
}

impl Request {
    /// An unsigned request.
    #[must_use]
    pub const fn unsigned(id: String, command: Command) -> Self {
        Self { id, command, seal: None }
    }
}

/// The engine's answer to one request. A client reads the replies to its own requests and expects others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "reply", deny_unknown_fields)]
#[non_exhaustive]
pub enum Reply {
    /// Done, and on disk: a crash does not undo it.
    Accepted {
        /// What was done, one sentence for the requester.
        text: String,
        /// The version it is about; absent if it is about none.
        version: Option<CapabilityId>,
    },
    /// Not done; nothing has changed.
    Refused {
        /// The class of the refusal, for programs to match on.
        code: Refusal,
        /// What failed and why, one sentence for the requester.
        text: String,
        /// A remedy, one sentence; absent if the sender has none.
        hint: Option<String>,
    },
    /// Answers [`Command::Stop`]: the cell is stopped, whether or not it could be recorded.
    Stopped {
        /// What was done, one sentence for the requester.
        text: String,
        /// Where the stop outlasts this engine.
        kept: StopPersistence,
    },
    /// Answers [`Command::Snapshot`].
    Snapshot {
        /// The state of the whole engine.
        snapshot: Box<super::snapshot::Snapshot>,
    },
    /// Answers [`Command::Question`].
    Question {
        /// The request as rendered for that person.
        question: Box<ApprovalDocument>,
    },
    /// Answers [`Command::Detail`].
    Detail {
        /// All data about the version.
        detail: Box<Detail>,
    },
    /// Answers [`Command::Film`].
    Film {
        /// The video of both versions.
        film: Box<Film>,
    },
    /// Answers [`Command::Registry`].
    Registry {
        /// The requested rows, with the total number.
        page: RegistryPage,
    },
    /// Answers [`Command::Audit`].
    Audit {
        /// The requested rows, with the head of the log.
        page: AuditPage,
    },
    /// Answers [`Command::Health`].
    Health {
        /// The buckets, with their basis.
        series: Box<HealthSeries>,
    },
    /// The result of checking the audit chain.
    Verified {
        /// Whether the chain is intact, and the findings.
        verified: AuditVerification,
    },
}

impl Reply {
    /// A refusal with the text and hint of an error.
    #[must_use]
    pub fn refused(code: Refusal, error: &impl Hint) -> Self {
        Self::Refused { code, text: error.to_string(), hint: error.hint().map(Cow::into_owned) }
    }
}

/// Where a stop is stored, so that it outlasts any end of the engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum StopPersistence {
    /// In the audit chain.
    OnRecord,
    /// In a file beside the record, which the next engine reads first.
    InMark,
    /// Only in the memory of this engine: a sudden end loses it.
    InMemory,
}

/// Why a command was refused: a closed set for programs, beside the sentence for people.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Refusal {
    /// A value in the command is not allowed.
    BadInput,
    /// There is no such version, family, approval request or alarm.
    NotFound,
    /// A version of this name is registered already, and never changes.
    Exists,
    /// The state does not allow it now.
    NotNow,
    /// What the request covers has changed since.
    Stale,
    /// The person, the role or the key may not do this.
    NotAllowed,
    /// The engine could not record it.
    Store,
    /// The engine is halted after a fault of its own.
    Holding,
    /// No engine has answered, so the outcome is unknown. Only a client reports this, never an engine.
    NoAnswer,
}

/// What the engine and its clients know of a command beside its content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandFacts<'a> {
    /// Its effect on authority over the arm, which decides who may send it.
    pub authority: AuthorityEffect,
    /// The person it names as requester; `None` if it names none.
    pub by: Option<&'a str>,
    /// Whether it only reads, concerns alarms, or stops the cell: a halted engine accepts it as well.
    pub is_harmless: bool,
    /// Whether it changes the live cell, so that it waits for the end of the sequence that runs.
    pub waits_for_sequence: bool,
}

impl<'a> CommandFacts<'a> {
    const fn of(authority: AuthorityEffect, by: Option<&'a str>) -> Self {
        let is_harmless = matches!(authority, AuthorityEffect::Reads);
        Self { authority, by, is_harmless, waits_for_sequence: false }
    }

    const fn harmless(self) -> Self {
        Self { is_harmless: true, ..self }
    }

    const fn between_sequences(self) -> Self {
        Self { waits_for_sequence: true, ..self }
    }
}

impl Command {
    /// What the engine and its clients know of it beside its content. Each command states its facts here alone.
    #[must_use]
    pub fn facts(&self) -> CommandFacts<'_> {
        use AuthorityEffect as Effect;
        match self {
            Self::Question { .. }
            | Self::Detail { .. }
            | Self::Film { .. }
            | Self::Registry { .. }
            | Self::Audit { .. }
            | Self::Health { .. }
            | Self::VerifyAudit
            | Self::Snapshot => CommandFacts::of(Effect::Reads, None),
            Self::Stop { by, .. } => CommandFacts::of(Effect::TakesAway, Some(by)).harmless(),
            Self::Shutdown => CommandFacts::of(Effect::TakesAway, None),
            Self::Rollback(operation)
            | Self::Vacate(operation)
            | Self::Restrict(operation)
            | Self::Reject(operation)
            | Self::Demote { operation, .. }
            | Self::Pause(operation) => CommandFacts::of(Effect::TakesAway, Some(&operation.by)),
            Self::Release { operation, .. }
            | Self::Repeat { operation, .. }
            | Self::Resume(operation)
            | Self::Rearm(operation)
            | Self::Anchor(operation)
            | Self::ReviewTries(operation)
            | Self::Continue(operation) => CommandFacts::of(Effect::Gives, Some(&operation.by)),
            Self::Register { by, .. } => CommandFacts::of(Effect::Gives, by.as_deref()),
            Self::ConfirmTime { by, .. } => CommandFacts::of(Effect::Gives, Some(by)),
            Self::Go { by, .. } | Self::Goal { by, .. } => {
                CommandFacts::of(Effect::Gives, Some(by)).between_sequences()
            }
            // A link that is down leaves a monitor without data.
            Self::Drift { .. } | Self::LiveFault { .. } => {
                CommandFacts::of(Effect::Gives, None).between_sequences()
            }
            // A reset alarm no longer blocks anything, and a shelved one is hidden.
            Self::ResetAlarm { by, .. } | Self::ShelveAlarm { by, .. } => {
                CommandFacts::of(Effect::Gives, Some(by)).harmless()
            }
            Self::AcknowledgeAlarm { by, .. } | Self::UnshelveAlarm { by, .. } => {
                CommandFacts::of(Effect::Neither, Some(by)).harmless()
            }
            Self::Note { by, .. } => CommandFacts::of(Effect::Neither, Some(by)),
            Self::Pace { .. } => CommandFacts::of(Effect::Neither, None),
            Self::Decide { .. } | Self::Person { .. } => CommandFacts::of(Effect::SignedItself, None),
        }
    }

    /// Whether it changes nothing, so that its answer need not be remembered.
    #[must_use]
    pub fn only_reads(&self) -> bool {
        self.facts().authority == AuthorityEffect::Reads
    }

    /// Whether it takes authority away: it stops the arm in any work.
    #[must_use]
    pub const fn stops_the_arm(&self) -> bool {
        matches!(
            self,
            Self::Rollback(_) | Self::Vacate(_) | Self::Restrict(_) | Self::Rearm(_) | Self::Shutdown
        )
    }

    /// Whether it only stops or tightens, unsigned: it is then right for any running engine, not only for the intended
    /// one.
    #[must_use]
    pub const fn stops_what_acts(&self) -> bool {
        matches!(
            self,
            Self::Stop { .. } | Self::Rollback(_) | Self::Vacate(_) | Self::Restrict(_) | Self::Pause(_)
        )
    }
}

#[cfg(test)]
mod tests;
