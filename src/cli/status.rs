//! `holdpoint status`: shows, watches, and waits for a state.

mod pending_approval;
mod person_acts;
pub(super) mod report;

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};

use self::report::{StatusReport, UnverifiedAnswerRow, VersionRow};
use super::data;
use super::decide::{known_family, known_version};
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::lifecycle::State;
use holdpoint_protocol::command::Reply;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_registry::Views;
use holdpoint_service::control_socket::{Client, ControlSocketError, Subscription, UnverifiedOrigin};
use holdpoint_store::Layout;
use holdpoint_text::ErrorReason;

/// The longest wait, in seconds: one day.
pub const TIMEOUT_MAX_S: u32 = 86_400;

/// The time limit for an engine's sign of life, which comes from a thread of its own.
const HELLO_PATIENCE: Duration = Duration::from_millis(700);

/// The time limit for its snapshot, which comes between two slices of its work.
const LOOK_PATIENCE: Duration = Duration::from_secs(5);

/// The shortest interval between two looks at the engine. Its events of this time are read together.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// The longest interval between two looks while a running engine sends no event.
const LOOK_AT_LEAST_EVERY: Duration = Duration::from_secs(1);

/// The arguments of `status`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Exits with 0 if the state is reached, 1 if rejected, 3 after the time limit, 4 if rolled back.

Examples:
  holdpoint status
  holdpoint status --watch --json
  holdpoint status grasp@1.3.0 --until confirmed --timeout 600")]
pub struct StatusArgs {
    /// A version or a family [default: all].
    #[arg(value_name = "FAMILY[@VERSION]", value_parser = parse_subject)]
    pub subject: Option<StatusSubject>,
    /// Keeps printing changes.
    #[arg(long)]
    pub watch: bool,
    /// Waits for a state.
    #[arg(long, value_enum, value_name = "STATE", requires = "subject")]
    pub until: Option<AwaitedState>,
    /// The time limit of the wait, in seconds.
    #[arg(
        long,
        value_name = "S",
        requires = "until",
        default_value_t = 600,
        value_parser = clap::value_parser!(u32).range(1..=i64::from(TIMEOUT_MAX_S))
    )]
    pub timeout: u32,
}

/// The subject of a report or a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StatusSubject {
    /// All of a family.
    Family(Family),
    /// One version of a family.
    Version(CapabilityId),
}

impl std::fmt::Display for StatusSubject {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Family(family) => write!(f, "{family}"),
            Self::Version(version) => write!(f, "{version}"),
        }
    }
}

/// A state to wait for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum AwaitedState {
    /// Passed stage 2, the static checks.
    Validated,
    /// Passed stage 3, the sandbox.
    Sandboxed,
    /// Passed stage 4, shadow.
    Shadowed,
    /// Awaits approval.
    AwaitingApproval,
    /// Active, provisional or confirmed.
    Active,
    /// Active and past its provisional window.
    Confirmed,
    /// Returned to evaluation.
    Demoted,
    /// Rejected.
    Rejected,
    /// Rolled back.
    RolledBack,
    /// Replaced by a newer version.
    Superseded,
}

impl AwaitedState {
    /// The name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Validated => "validated",
            Self::Sandboxed => "sandboxed",
            Self::Shadowed => "shadowed",
            Self::AwaitingApproval => "awaiting-approval",
            Self::Active => "active",
            Self::Confirmed => "confirmed",
            Self::Demoted => "demoted",
            Self::Rejected => "rejected",
            Self::RolledBack => "rolled-back",
            Self::Superseded => "superseded",
        }
    }
}

pub(super) fn parse_subject(text: &str) -> Result<StatusSubject, String> {
    if text.contains('@') {
        text.parse()
            .map(StatusSubject::Version)
            .map_err(|error: holdpoint_governance::ids::CapabilityIdError| error.to_string())
    } else {
        Family::new(text).map(StatusSubject::Family).map_err(|error| error.to_string())
    }
}

/// Runs the verb.
///
/// # Errors
/// [`CliError`].
pub(super) fn run(
    context: &CliContext,
    args: &StatusArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    data::require_own(&context.data)?;
    // An engine that answers has checked the tables and halts if they change, or reports that it has not checked
    // yet.
    let views = match Client::connect_within(&Layout::new(&context.data), HELLO_PATIENCE) {
        Ok(Some(_)) => data::open(&context.data)?,
        Ok(None) | Err(ControlSocketError::Silent { .. }) => data::open_checked(&context.data)?,
        Err(error) => return Err(super::verb_executor::socket_error(error)),
    };
    match &args.subject {
        None => {}
        Some(StatusSubject::Family(family)) => known_family(&views, family).map(drop)?,
        Some(StatusSubject::Version(version)) => known_version(&views, version)?,
    }
    let mut source = ReportSource {
        context,
        subject: args.subject.as_ref(),
        views,
        events: None,
        silent: None,
        doubt: None,
    };
    match &args.until {
        None if !args.watch => {
            let report = source.read()?;
            print(&report, &mut BTreeSet::new(), false, out)?;
            source
                .silent
                .take()
                .map_or(Ok(Exit::Confirmed), |error| Err(super::verb_executor::socket_error(error)))
        }
        None => watch(&mut source, out),
        Some(until) => {
            let target = target(&source.views, args.subject.as_ref())?;
            wait(&mut source, args, &target, *until, out)
        }
    }
}

/// The version to wait for: the named one, else the family's newest.
fn target(views: &Views, subject: Option<&StatusSubject>) -> Result<CapabilityId, CliError> {
    match subject {
        Some(StatusSubject::Version(version)) => Ok(version.clone()),
        Some(StatusSubject::Family(family)) => {
            let newest = views.family_in_order(family).map_err(CliError::usage)?.pop();
            newest.ok_or_else(|| {
                CliError::usage(format!("the family {:?} has no version", family.as_str()))
                    .with_details(ErrorReason::NotFound)
            })
        }
        None => Err(CliError::usage("--until needs a version or a family to wait for")),
    }
}

/// Prints changes until the reader is gone.
fn watch(source: &mut ReportSource<'_>, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let mut last = None;
    let mut printed = BTreeSet::new();
    loop {
        let report = source.read()?;
        if last.as_ref() != Some(&report) {
            print(&report, &mut printed, true, out)?;
            last = Some(report);
        }
        if out.is_gone() {
            return Ok(Exit::Confirmed);
        }
        source.pause(None);
    }
}

fn wait(
    source: &mut ReportSource<'_>,
    args: &StatusArgs,
    target: &CapabilityId,
    until: AwaitedState,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let deadline = Instant::now() + Duration::from_secs(u64::from(args.timeout));
    let mut last = None;
    let mut printed = BTreeSet::new();
    loop {
        let report = source.read()?;
        let row = report.versions.iter().find(|row| row.version == *target);
        let Some(row) = row else {
            return Err(CliError::internal(format!("{target} is no longer in the store")));
        };
        let ended = end(until, row);
        let state = row.state;
        let late = Instant::now() >= deadline;
        if last.as_ref() != Some(&report) && (args.watch || ended.is_some() || late) {
            print(&report, &mut printed, args.watch, out)?;
            last = Some(report);
        }
        match ended {
            Some(exit) => return Ok(exit),
            None if late => {
                let text = format!(
                    "held: {target} is {state} after {} s, and not yet {}",
                    args.timeout,
                    until.name()
                );
                return Err(CliError::from_engine_fault(text).with_details(ErrorReason::TimedOut));
            }
            None => source.pause(Some(deadline)),
        }
    }
}

/// The result of the wait, if it is over.
fn end(until: AwaitedState, row: &VersionRow) -> Option<Exit> {
    if is_reached(until, row) {
        return Some(Exit::Confirmed);
    }
    match row.state {
        State::Rejected => Some(Exit::Rejected),
        State::RolledBack => Some(Exit::RolledBack),
        State::Registered
        | State::Validated
        | State::Sandboxed
        | State::Shadowed
        | State::Active
        | State::Demoted
        | State::Superseded => None,
    }
}

/// Whether a state is reached, or was passed.
fn is_reached(until: AwaitedState, row: &VersionRow) -> bool {
    use State as S;
    let up = |least: u8| {
        let height = match row.state {
            S::Validated => 1,
            S::Sandboxed => 2,
            S::Shadowed | S::Active | S::Superseded => 3,
            S::Registered | S::Demoted | S::Rejected | S::RolledBack => 0,
        };
        height >= least
    };
    match until {
        AwaitedState::Validated => up(1),
        AwaitedState::Sandboxed => up(2),
        AwaitedState::Shadowed => up(3),
        AwaitedState::AwaitingApproval => {
            row.awaiting_approval || matches!(row.state, S::Active | S::Superseded)
        }
        AwaitedState::Active => row.state == S::Active,
        AwaitedState::Confirmed if row.state == S::Superseded => row.confirmed,
        AwaitedState::Confirmed => row.state == S::Active && !row.provisional && !row.rollback_pending,
        AwaitedState::Demoted => row.state == S::Demoted,
        AwaitedState::Rejected => row.state == S::Rejected,
        AwaitedState::RolledBack => row.state == S::RolledBack,
        AwaitedState::Superseded => row.state == S::Superseded,
    }
}

/// Prints a report: all of it as JSON, or the lines that changed since the last report. One that is watched ends with what
/// concerns the whole cell, because a window shows the end.
fn print(
    report: &StatusReport,
    printed: &mut BTreeSet<String>,
    is_watched: bool,
    out: &mut CommandOutput<'_>,
) -> Result<(), CliError> {
    let (head, rows) = (report.head(), report.rows());
    let lines = if is_watched { [rows, head].concat() } else { [head, rows].concat() };
    out.answer(report, |out| {
        lines.iter().filter(|line| !printed.contains(*line)).try_for_each(|line| out.wrapped_line(line))
    })?;
    *printed = lines.into_iter().collect();
    out.flush()
}

/// The source of reports: the store, and its engine while one runs.
struct ReportSource<'a> {
    context: &'a CliContext,
    subject: Option<&'a StatusSubject>,
    views: Views,
    events: Option<Subscription>,
    /// Why the running engine did not answer last time.
    silent: Option<ControlSocketError>,
    /// Why the last answer is not known to come from the engine.
    doubt: Option<UnverifiedOrigin>,
}

impl ReportSource<'_> {
    fn read(&mut self) -> Result<StatusReport, CliError> {
        let snapshot = match self.snapshot() {
            Err(error @ ControlSocketError::Silent { .. }) => {
                self.silent = Some(error);
                None
            }
            answer => {
                self.silent = None;
                answer.map_err(super::verb_executor::socket_error)?
            }
        };
        let report = StatusReport::new(&self.views, snapshot.as_ref(), self.silent.as_ref(), self.subject)?;
        Ok(StatusReport { unverified: self.doubt.map(UnverifiedAnswerRow::from), ..report })
    }

    /// The engine's snapshot. If the engine starts, ends or is silent, the store's data remain.
    fn snapshot(&mut self) -> Result<Option<Snapshot>, ControlSocketError> {
        let layout = Layout::new(&self.context.data);
        let Some(mut client) = Client::connect_within(&layout, HELLO_PATIENCE)? else {
            (self.events, self.doubt) = (None, None);
            return Ok(None);
        };
        self.doubt = client.unverified_origin();
        match client.look(LOOK_PATIENCE) {
            Ok(Reply::Snapshot { snapshot }) => {
                if self.events.is_none() {
                    self.events = client.subscribe().ok();
                }
                Ok(Some(*snapshot))
            }
            Ok(_) | Err(ControlSocketError::NoAnswer { .. } | ControlSocketError::Ended { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Waits for events of the engine, or for a while. The next read shows what they are about, so that a look, which costs
    /// the engine a snapshot, is not made for each of them. Nothing is waited for past the deadline.
    fn pause(&mut self, deadline: Option<Instant>) {
        let begun = Instant::now();
        let end = |pause| pause_end(begun, pause, deadline);
        let Some(events) = &mut self.events else {
            return std::thread::sleep(end(LOOK_EVERY).saturating_duration_since(begun));
        };
        let mut until = end(LOOK_AT_LEAST_EVERY);
        loop {
            match events.next(until.saturating_duration_since(Instant::now())) {
                Ok(Some(_)) => until = end(LOOK_EVERY),
                Ok(None) => return,
                Err(_) => {
                    self.events = None;
                    return;
                }
            }
            if Instant::now() >= until {
                return;
            }
        }
    }
}

/// The end of a pause, which is not after the deadline.
fn pause_end(begun: Instant, pause: Duration, deadline: Option<Instant>) -> Instant {
    let end = begun + pause;
    deadline.map_or(end, |deadline| end.min(deadline))
}

#[cfg(test)]
mod tests {
    use super::report::FamilyStatusRow;
    use super::*;
    use holdpoint_governance::ids::Digest;
    use holdpoint_governance::lifecycle::{Stage, VersionFlags};
    use holdpoint_governance::notice::{Notice, OperatorAct};
    use holdpoint_governance::tries::{CountedTry, TryAuthor};
    use holdpoint_governance::version_status::{Obstacle, RecordedChanges, StatusFacts, VersionStatus};

    fn row(state: State, provisional: bool) -> VersionRow {
        VersionRow {
            version: "grasp@1.1.0".parse().unwrap(),
            state,
            running: None,
            paused: false,
            awaiting_approval: false,
            provisional,
            restricted: false,
            rollback_pending: false,
            unreviewed: false,
            held: false,
            confirmed: false,
            closed: Vec::new(),
            stale: Vec::new(),
            kappas: [None; 4],
            progress: None,
            counted: None,
            status: status(state, VersionFlags { provisional, ..VersionFlags::default() }),
            reason: None,
        }
    }

    fn status(state: State, flags: VersionFlags) -> VersionStatus {
        VersionStatus::of(&StatusFacts {
            state,
            flags: &flags,
            held: false,
            reasons: &[],
            obstacle: None,
            recorded: &RecordedChanges::default(),
        })
    }

    /// A wait took up to a second longer than its limit.
    #[test]
    fn pause_ends_with_the_wait() {
        let begun = Instant::now();
        let after = |secs| begun + Duration::from_secs(secs);
        let end = |deadline| pause_end(begun, Duration::from_secs(2), deadline);
        assert_eq!([end(None), end(Some(after(1))), end(Some(after(3)))], [after(2), after(1), after(2)]);
    }

    #[test]
    fn stale_evidence_shows_its_cause() {
        use holdpoint_governance::evidence::StaleCause;
        let fresh = row(State::Shadowed, false);
        assert!(!fresh.line().contains("STALE"));
        let stale = VersionRow { stale: vec![StaleCause::Profile, StaleCause::ActiveVersion], ..fresh };
        for part in ["STALE", "another profile", "active-version"] {
            assert!(stale.line().contains(part), "{}", stale.line());
        }
        let json = serde_json::to_value(&stale).unwrap();
        assert_eq!(json["stale"], serde_json::json!(["profile", "active-version"]));
    }

    #[test]
    fn a_counted_try_shows_its_price() {
        let counted = CountedTry {
            subject: Digest::of_parts("test", &[]),
            drawn: None,
            author: TryAuthor::default(),
            by_author: 2,
            in_family: 2,
            level: 0.0038,
            pairs: 300,
            left: 10,
        };
        let tried = VersionRow { counted: Some(counted), ..row(State::Validated, false) };
        let shown = "[try 2 of grasp by unsigned authors: level 0.0038, 300 or 900 pairs; 10 tries left before a review]";
        assert!(tried.line().ends_with(shown), "{}", tried.line());
        assert!(!row(State::Validated, false).line().contains("try"));
    }

    #[test]
    fn a_paused_provisional_version_is_shown_as_active() {
        let version = VersionRow { paused: true, ..row(State::Active, true) };
        for flag in [" active,", "promotion paused", "provisional"] {
            assert!(version.line().contains(flag), "{}", version.line());
        }
        let (by, reason) = ("mia".to_owned(), "an odd noise".to_owned());
        let flags = VersionFlags { paused: true, ..VersionFlags::default() };
        let cause = Some(Notice::OperatorDid { act: OperatorAct::Paused, by, reason }.into());
        let status = VersionStatus { cause, ..status(State::Sandboxed, flags) };
        let paused = VersionRow { paused: true, status, ..row(State::Sandboxed, false) };
        for part in ["sandboxed, paused", "(paused by mia: an odd noise)"] {
            assert!(paused.line().contains(part), "{}", paused.line());
        }
        let at_work = VersionRow { running: Some(Stage::Shadow), ..row(State::Sandboxed, false) };
        assert!(at_work.line().contains("running shadow"), "{}", at_work.line());
        let status = VersionStatus { obstacle: Some(Obstacle::EngineAbsent), ..at_work.status.clone() };
        let interrupted = VersionRow { status, ..at_work };
        assert!(!interrupted.line().contains("running shadow"), "{}", interrupted.line());
        let family = FamilyStatusRow {
            family: "grasp".to_owned(),
            active: Some(version.version),
            rollback_target: None,
            safe_stopped: None,
            provisional_episodes: None,
            provisional: true,
            promotion_paused: true,
        };
        for flag in ["active grasp@1.1.0", "promotion paused", "provisional"] {
            assert!(family.line().contains(flag), "{}", family.line());
        }
    }

    #[test]
    fn status_wait_ends_by_the_state_of_the_version() {
        use State as S;
        for (until, state, provisional, expected) in [
            (AwaitedState::Validated, S::Registered, false, None),
            (AwaitedState::Validated, S::Validated, false, Some(Exit::Confirmed)),
            (AwaitedState::Validated, S::Shadowed, false, Some(Exit::Confirmed)),
            (AwaitedState::Sandboxed, S::Demoted, false, None),
            (AwaitedState::Active, S::Active, true, Some(Exit::Confirmed)),
            (AwaitedState::Active, S::Rejected, false, Some(Exit::Rejected)),
            (AwaitedState::Active, S::RolledBack, false, Some(Exit::RolledBack)),
            (AwaitedState::Confirmed, S::Active, true, None),
            (AwaitedState::Confirmed, S::Active, false, Some(Exit::Confirmed)),
            (AwaitedState::Confirmed, S::Superseded, false, None),
            (AwaitedState::Active, S::Superseded, false, None),
            (AwaitedState::Shadowed, S::Superseded, false, Some(Exit::Confirmed)),
            (AwaitedState::Rejected, S::Rejected, false, Some(Exit::Confirmed)),
            (AwaitedState::RolledBack, S::RolledBack, false, Some(Exit::Confirmed)),
            (AwaitedState::RolledBack, S::Rejected, false, Some(Exit::Rejected)),
        ] {
            assert_eq!(end(until, &row(state, provisional)), expected, "{until:?} {state:?}");
        }
        // Two good versions of one family wait: the second replaces the first, which was confirmed.
        let replaced = VersionRow { confirmed: true, ..row(S::Superseded, false) };
        assert_eq!(end(AwaitedState::Confirmed, &replaced), Some(Exit::Confirmed));
        let waiting = VersionRow { awaiting_approval: true, ..row(S::Shadowed, false) };
        assert_eq!(end(AwaitedState::AwaitingApproval, &waiting), Some(Exit::Confirmed));
        assert_eq!(end(AwaitedState::AwaitingApproval, &row(S::Shadowed, false)), None);
    }
}
