//! The lines of `status`: the engine, a stopped cell, acts of people, families, versions, requests, questions, alarms.

use std::fmt::Display;

use holdpoint_governance::alarms::Shelving;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::snapshot::{RequestKind, StartupProgressView, StoppedView};
use holdpoint_text::signing_options;

use super::alarms::shelving;
use super::listed_or;
use super::run::startup_progress;
use crate::counted;
use crate::event::stop_author;

/// The engine of a store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EngineLine<'a> {
    /// It did not answer, and the store is read instead.
    Silent,
    /// It reads its record.
    ComingUp(StartupProgressView),
    /// It runs.
    Running,
    /// It is halted, for this reason.
    Halted(&'a str),
    /// This process has the store and no socket.
    NotAnswering(&'a str),
    /// None runs.
    NotRunning,
}

/// The engine of a store, and its profile or the last one.
#[must_use]
pub fn engine(of: EngineLine<'_>, profile: &str) -> String {
    match of {
        EngineLine::Silent => {
            format!("engine   SILENT, last profile {profile}: the following lines come from the store")
        }
        EngineLine::ComingUp(reading) => {
            let reading = startup_progress(Some(reading));
            format!("engine   coming up, profile {profile}; {reading}: only `stop` works yet")
        }
        EngineLine::Running => format!("engine   running, profile {profile}"),
        EngineLine::Halted(why) => format!("engine   HALTED, profile {profile}: {why}"),
        EngineLine::NotAnswering(owner) => format!(
            "engine   NOT ANSWERING: {owner} has the store open and has no socket; last profile {profile}"
        ),
        EngineLine::NotRunning => format!("engine   not running, last profile {profile}"),
    }
}

/// The site file of a store.
#[must_use]
pub fn site_file(file: impl Display, digest: &str) -> String {
    format!("site     {file}, digest {digest}")
}

/// An answer that is not known to come from the engine.
#[must_use]
pub fn warning(doubt: &str) -> String {
    format!("WARNING  {doubt}")
}

/// The newest record of a store whose engine did not answer: its number, kind, subject and time.
#[must_use]
pub fn last_record(seq: u64, kind: impl Display, subject: impl Display, at: &str) -> String {
    format!("record   the last is number {seq}, {kind} {subject}, at {at}")
}

/// A profile that no administrator authorized.
#[must_use]
pub fn not_authorized(why: &str) -> String {
    format!("profile  NOT AUTHORIZED: {why}")
}

/// The time of a stop for the reader, by its virtual time, ms, and the wall time of its record.
pub type StopMoment<'a> = &'a dyn Fn(u64, Option<WallTime>) -> String;

/// All persons who stopped the cell, and the command that starts it as this person for this reason. `moment` has the
/// times as the reader knows them.
#[must_use]
pub fn stopped(of: &StoppedView, (by, reason): (&str, &str), moment: StopMoment<'_>) -> String {
    let (stops, signature) = (stopped_by(of, moment), signing_options(by, reason));
    format!(
        "{stops}; `holdpoint start --stops {} {signature}` starts it and confirms that you know of all stops",
        of.stops
    )
}

/// All persons who stopped the cell, with their times and reasons.
#[must_use]
pub fn stopped_by(of: &StoppedView, moment: StopMoment<'_>) -> String {
    let why = |reason: &str| if reason.is_empty() { String::new() } else { format!(": {reason:?}") };
    let (author, since) = (stop_author(&of.by, &of.caller), moment(of.since_ms, of.wall));
    let mut line = format!("STOPPED  by {author}, since {since}{}", why(&of.reason));
    if of.unnamed > 0 {
        line.push_str(&format!(", and {}", counted(of.unnamed, "more time")));
    }
    for stop in &of.again {
        let author = stop_author(&stop.by, &stop.caller);
        line.push_str(&format!(", and by {author}, {}{}", moment(stop.at_ms, stop.wall), why(&stop.reason)));
    }
    line
}

/// The time of a stop that is not on record: after that of the newest record.
#[must_use]
pub fn after_record(time: &str) -> String {
    format!("after {time}")
}

/// The reason of a start where the person gives none.
pub const CELL_IS_EMPTY: &str = "the cell is empty";

/// An act of a person about the whole cell.
#[derive(Clone, Copy, Debug)]
pub enum CellAct<'a> {
    /// The goal was set.
    Goal(&'a str),
    /// The cell was started.
    Start,
    /// A note was left.
    Note,
}

/// An act of a person about the whole cell, with its time and its reason or text.
#[must_use]
pub fn cell_act(of: CellAct<'_>, by: impl Display, when: &str, reason: impl Display) -> String {
    match of {
        CellAct::Goal(goal) => format!("goal     {goal}, set by {by} at {when}: {reason}"),
        CellAct::Start => format!("started  by {by} at {when}: {reason}"),
        CellAct::Note => format!("note     by {by} at {when}: {reason}"),
    }
}

/// A family: its active version, the target of a rollback.
#[must_use]
pub fn family(name: impl Display, active: impl Display, rollback_target: impl Display) -> String {
    format!("family   {name}: active {active}, rollback target {rollback_target}")
}

/// A provisional version, with its episodes of the needed ones.
#[must_use]
pub fn provisional(episodes: Option<(u32, u32)>) -> String {
    episodes.map_or_else(
        || ", provisional".to_owned(),
        |(worked, needed)| format!(", provisional {worked} of {needed} episodes"),
    )
}

/// The stage of a version: it runs, or it has no engine that runs it.
#[must_use]
pub fn stage_at_work(stage: Stage, is_interrupted: bool) -> String {
    if is_interrupted { format!(", {stage} interrupted") } else { format!(", running {stage}") }
}

/// A promotion that a person paused.
pub const PROMOTION_PAUSED: &str = ", its promotion paused";

/// A version whose approvals are missing.
pub const AWAITING_APPROVAL: &str = "awaiting approval";

/// A version that the ladder takes from control.
pub const ROLLED_BACK_NOW: &str = "being rolled back";

/// A version that one person activated.
pub const UNREVIEWED: &str = "UNREVIEWED break-glass activation";

/// Evidence that no longer counts, by the names of what is another one.
#[must_use]
pub fn stale_evidence(causes: &[&str]) -> String {
    format!(", STALE evidence (another {})", causes.join(", "))
}

/// The progress of a stage: all of it, and a part of it if it has parts.
#[must_use]
pub fn progress(what: &str, (done, budget): (u64, u64), part: Option<(u64, u64)>) -> String {
    match part {
        Some((part, of)) => format!(", {what} {part} of {of}, {done} of {budget} in all"),
        None => format!(", {what} {done} of {budget}"),
    }
}

/// A version that one person may activate.
#[must_use]
pub fn waits_for_approvers(version: impl Display) -> String {
    format!(
        "on hold  {version} waits for approvers or a freeze; `holdpoint version break-glass` activates it"
    )
}

/// A question of a drift monitor, with the reason and the deadline, s.
#[must_use]
pub fn drift_question(version: impl Display, reason: &str, by_s: u64) -> String {
    format!(
        "question {version}: its drift monitor escalates ({reason}); without an answer by {by_s} s it is rolled back"
    )
}

/// An alarm, with its text and its shelving.
#[must_use]
pub fn alarm(
    priority: impl Display,
    alarm: &str,
    state: impl Display,
    text: &str,
    shelf: Option<&Shelving>,
) -> String {
    let shelf = shelf.map_or_else(String::new, |shelf| format!("  [{}]", shelving(shelf)));
    format!("alarm    {priority} {alarm}, {state}: {text}{shelf}")
}

/// The state of an approval request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ApprovalProgress {
    /// Enough persons approved.
    Granted,
    /// No engine asks.
    OnRecord,
    /// An engine asks.
    Asked,
}

/// An approval request.
#[derive(Clone, Copy, Debug)]
pub struct ApprovalLine<'a> {
    /// Its version.
    pub version: &'a CapabilityId,
    /// The first digits of the evidence.
    pub evidence: &'a str,
    /// Its purpose.
    pub purpose: RequestKind,
    /// The approvals that it needs.
    pub needed: u32,
    /// The persons who approved.
    pub approved_by: &'a [String],
    /// Permissions that the active version does not have.
    pub new_permissions: &'a [String],
    /// The deadline.
    pub until: WallTime,
    /// The moment of the line.
    pub now: WallTime,
}

/// An approval request in its state.
#[must_use]
pub fn approval_request(of: &ApprovalLine<'_>, state: ApprovalProgress) -> String {
    let ApprovalLine { version, evidence, purpose, needed, approved_by, new_permissions, until, now } = *of;
    let have = listed_or(approved_by, "no one yet");
    let new = if new_permissions.is_empty() {
        String::new()
    } else {
        format!("; new permissions: {}", new_permissions.join(", "))
    };
    let purpose = match purpose {
        RequestKind::Activation | RequestKind::Emergency => "",
        RequestKind::Release => " (its release)",
        RequestKind::Review => " (the review of its break-glass activation)",
    };
    let people = if needed == 1 { "one person".to_owned() } else { format!("{needed} people") };
    let until = until.as_deadline(now);
    match state {
        ApprovalProgress::Granted => format!(
            "granted  {version} over the evidence {evidence}{purpose}: approved by {have}; it takes effect after the \
             current sequence{new}"
        ),
        ApprovalProgress::OnRecord => format!(
            "waiting  {version} for an engine, which asks {people} to approve the evidence {evidence}{purpose} by \
             {until}; on record as approved by {have}{new}"
        ),
        ApprovalProgress::Asked => format!(
            "waiting  {version} for {people} to approve the evidence {evidence}{purpose} by {until}; approved by \
             {have}{new}"
        ),
    }
}
