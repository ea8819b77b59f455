//! Every state of a version times every command: the effect, compared with the guide's table, and no dead end.
//!
//! With `HOLDPOINT_WRITE_STANDINGS=1` the test rewrites the guide's table.

use std::fmt::Write as _;
use std::path::Path;

use holdpoint_approvals::Identity;
use holdpoint_approvals::keyfile::KeyEncoding;
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage, State, VersionFlags};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Command, Operation, Reply};
use holdpoint_protocol::snapshot::RequestKind;
use holdpoint_store::AuditFilter;

use crate::decide::people::persons::enrolled;
use crate::decide::stages::activation::tests::{package, request_activation};
use crate::decide::stages::rollback::tests::RollbackBench;
use crate::live::{monitors::terms_of, station::LiveFault};
use holdpoint_record::evidence_binding::trial_subject;
use holdpoint_record::version_table::TransitionNote;

const GUIDE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../guide/reference/states-and-verbs.md");
const BEGIN: &str = "<!-- standings -->\n";
const END: &str = "<!-- end of standings -->\n";

pub(super) fn operation(version: &CapabilityId) -> Operation {
    Operation { version: version.clone(), by: "ada".to_owned(), reason: "a test".to_owned() }
}

type NamedOperation = (&'static str, fn(Operation) -> Command);

const VERBS: [NamedOperation; 15] = [
    ("reject", Command::Reject),
    ("demote", |operation| Command::Demote { operation, profiles: Vec::new() }),
    ("demote --profile human", |operation| Command::Demote { operation, profiles: vec![ProfileName::Human] }),
    ("release --profile human", |operation| Command::Release {
        operation,
        profiles: vec![ProfileName::Human],
    }),
    ("rollback", Command::Rollback),
    ("rollback --stop-family", Command::Vacate),
    ("restrict", Command::Restrict),
    ("release", |operation| Command::Release { operation, profiles: Vec::new() }),
    ("continue", Command::Continue),
    ("pause", Command::Pause),
    ("resume", Command::Resume),
    ("repeat", |operation| Command::Repeat { operation, stage: Stage::Sandbox }),
    ("repeat --stage shadow", |operation| Command::Repeat { operation, stage: Stage::Shadow }),
    ("rearm", Command::Rearm),
    ("anchor", Command::Anchor),
];

pub(super) type Setting = (&'static str, fn(&mut RollbackBench) -> CapabilityId);

pub(super) const CANDIDATE: &str = "align-improved";

fn apply(bench: &mut RollbackBench, id: &CapabilityId, event: LifecycleEvent) {
    bench
        .pipeline
        .live()
        .record
        .transition(&id.family, event, TransitionNote::because(Notice::StageBegins))
        .unwrap();
}

pub(super) fn done(bench: &mut RollbackBench, command: Command) {
    let reply = bench.pipeline.command(command.clone());
    assert!(matches!(reply, Reply::Accepted { .. }), "{command:?}: {reply:?}");
}

fn number(bench: &RollbackBench, id: &CapabilityId) -> holdpoint_governance::lifecycle::VersionRef {
    bench.pipeline.record().version_table().version(id).unwrap().0
}

fn close(id: &CapabilityId, profile: ProfileName) -> Command {
    Command::Demote { operation: operation(id), profiles: vec![profile] }
}

/// A profile of the class that the versions were activated under, with the people of `human`.
fn profile_with_approvers() -> Profile {
    let human = Profile::builtin(ProfileName::Human).unwrap();
    Profile {
        approval: human.approval,
        activation: human.activation,
        ..Profile::builtin(ProfileName::Sim).unwrap()
    }
}

fn baseline() -> CapabilityId {
    "align@1.0.0".parse().unwrap()
}

pub(super) const SETTINGS: [Setting; 29] = [
    ("registered", |bench| bench.pass(CANDIDATE, &[])),
    ("validated", |bench| bench.pass(CANDIDATE, &Stage::ALL[..1])),
    ("sandboxed", |bench| bench.pass(CANDIDATE, &Stage::ALL[..2])),
    ("shadowed", |bench| bench.pass(CANDIDATE, &Stage::ALL[..3])),
    ("shadowed, put on hold by the gate or after an unanswered question", |bench| {
        let id = bench.pass(CANDIDATE, &Stage::ALL[..3]);
        bench.pipeline.live().evidence_files.edit(&id).held = true;
        id
    }),
    ("shadowed, people are asked", |bench| request_activation(&mut bench.pipeline, package(CANDIDATE, &[]))),
    ("shadowed, paused while people were asked", |bench| {
        let id = request_activation(&mut bench.pipeline, package(CANDIDATE, &[]));
        done(bench, Command::Pause(operation(&id)));
        id
    }),
    ("shadowed, paused while people were asked, and resumed", |bench| {
        let id = request_activation(&mut bench.pipeline, package(CANDIDATE, &[]));
        done(bench, Command::Pause(operation(&id)));
        done(bench, Command::Resume(operation(&id)));
        id
    }),
    ("shadowed, blocked under a profile", |bench| {
        let id = bench.pass(CANDIDATE, &Stage::ALL[..3]);
        done(bench, close(&id, ProfileName::Human));
        id
    }),
    ("sandbox running", |bench| {
        let id = bench.pass(CANDIDATE, &Stage::ALL[..1]);
        let version = number(bench, &id);
        apply(bench, &id, LifecycleEvent::Start { version, stage: Stage::Sandbox });
        id
    }),
    ("shadow running", |bench| {
        let id = bench.pass(CANDIDATE, &Stage::ALL[..2]);
        let version = number(bench, &id);
        apply(bench, &id, LifecycleEvent::Start { version, stage: Stage::Shadow });
        id
    }),
    ("a candidate, paused", |bench| {
        let id = bench.pass(CANDIDATE, &Stage::ALL[..2]);
        done(bench, Command::Pause(operation(&id)));
        id
    }),
    ("active, provisional", |bench| bench.activate(CANDIDATE)),
    ("active, provisional, paused", |bench| {
        let id = bench.activate(CANDIDATE);
        done(bench, Command::Pause(operation(&id)));
        id
    }),
    ("active, blocked under another profile", |bench| {
        let id = bench.activate(CANDIDATE);
        done(bench, close(&id, ProfileName::Human));
        id
    }),
    ("active, restricted", |bench| {
        let id = bench.activate(CANDIDATE);
        done(bench, Command::Restrict(operation(&id)));
        id
    }),
    ("active, restricted, people are asked to lift the restriction", |bench| {
        let id = bench.activate(CANDIDATE);
        let resting = RollbackBench::resting(ProfileName::Sim);
        *bench = std::mem::replace(bench, resting).reopened(profile_with_approvers());
        done(bench, Command::Restrict(operation(&id)));
        done(bench, Command::Release { operation: operation(&id), profiles: Vec::new() });
        id
    }),
    ("active, its rollback under way", |bench| {
        let id = bench.activate(CANDIDATE);
        let version = number(bench, &id);
        apply(bench, &id, LifecycleEvent::BeginRollback { version });
        id
    }),
    ("active, its monitor asks", |bench| {
        let id = bench.activate(CANDIDATE);
        bench.pipeline.live().world.cell.fault = Some(LiveFault::TelemetryLost);
        let due_ms = bench.pipeline.next_deadline_ms().unwrap();
        bench.pipeline.jump_to(due_ms);
        assert!(bench.pipeline.live().look_at_monitors().unwrap());
        id
    }),
    ("active by break-glass, unreviewed", |bench| {
        let id = bench.pass(CANDIDATE, &Stage::ALL);
        bench.enter(&id, |version| LifecycleEvent::ActivateUnreviewed {
            version,
            until: holdpoint_governance::wall_time::WallTime::SCRIPT_EPOCH.plus_ms(1_000_000),
        });
        id
    }),
    ("active, confirmed", |bench| {
        let id = bench.activate(CANDIDATE);
        let version = number(bench, &id);
        apply(bench, &id, LifecycleEvent::Confirm { version });
        id
    }),
    ("active, the last of its family", |_| baseline()),
    ("demoted", |bench| {
        let id = bench.activate(CANDIDATE);
        done(bench, Command::Demote { operation: operation(&id), profiles: Vec::new() });
        id
    }),
    ("demoted, the family is stopped", |bench| {
        let id = bench.activate(CANDIDATE);
        done(bench, Command::Demote { operation: operation(&id), profiles: Vec::new() });
        done(bench, Command::Vacate(operation(&baseline())));
        id
    }),
    ("demoted, the last version of a stopped family", |bench| {
        done(bench, Command::Vacate(operation(&baseline())));
        baseline()
    }),
    ("superseded, the rollback target of the active one", |bench| {
        bench.activate(CANDIDATE);
        baseline()
    }),
    ("superseded, the family is stopped", |bench| {
        let id = bench.activate(CANDIDATE);
        let version = number(bench, &id);
        apply(bench, &id, LifecycleEvent::BeginRollback { version });
        let cause = Some(holdpoint_store::ActiveCause::Vacate);
        let note = TransitionNote { cause, ..TransitionNote::because(Notice::StageBegins) };
        let event = LifecycleEvent::FailRollback { version };
        bench.pipeline.live().record.transition(&id.family, event, note).unwrap();
        baseline()
    }),
    ("rejected", |bench| {
        let id = bench.pass(CANDIDATE, &[]);
        done(bench, Command::Reject(operation(&id)));
        id
    }),
    ("rolled back", |bench| {
        let id = bench.activate(CANDIDATE);
        bench.by_operator(&id);
        id
    }),
];

/// The state of a version, as far as a command can change it.
#[derive(Clone, PartialEq)]
struct ObservedState {
    state: State,
    flags: VersionFlags,
    closed: usize,
    held: bool,
    has_question: bool,
    stopped: bool,
    anchor: bool,
}

fn observed_state(bench: &mut RollbackBench, id: &CapabilityId) -> ObservedState {
    let live = bench.pipeline.live();
    let entry = live.record.version_table().family(&id.family).unwrap();
    let (_, version, _) = entry.find(id).unwrap();
    ObservedState {
        state: version.state,
        flags: version.flags,
        closed: version.closed.len(),
        held: live.evidence_files.is_held(id),
        has_question: live.monitors.has_question(id),
        stopped: entry.state.safe_stopped,
        anchor: live.record.version_table().anchor(&id.family).is_some_and(|anchor| anchor.id() == *id),
    }
}

fn change(before: &ObservedState, after: &ObservedState) -> String {
    let mut changes = Vec::new();
    if before.state != after.state {
        changes.push(format!("becomes {}", after.state));
    }
    if after.stopped && !before.stopped {
        changes.push("the family stops".to_owned());
    }
    let (was, is) = (before.flags, after.flags);
    for (was, is, on, off) in [
        (was.paused, is.paused, "is paused", "is resumed"),
        (was.restricted, is.restricted, "is restricted", "gets its full envelope"),
        (was.awaiting_approval, is.awaiting_approval, "people are asked", "the approval request is void"),
        (before.held, after.held, "is on hold", "continues"),
        (before.has_question, after.has_question, "is asked about", "the question is closed"),
        (before.anchor, after.anchor, "becomes the family's anchor", "is its anchor no more"),
    ] {
        if was != is && after.state == before.state {
            changes.push(if is { on.to_owned() } else { off.to_owned() });
        }
    }
    if let Some(stage) = is.running.filter(|_| was.running != is.running) {
        changes.push(format!("{stage} runs again"));
    }
    match after.closed.cmp(&before.closed) {
        std::cmp::Ordering::Less => changes.push("is unblocked under the profile".to_owned()),
        std::cmp::Ordering::Equal => {}
        std::cmp::Ordering::Greater => changes.push("is blocked under the profile".to_owned()),
    }
    changes.join(", ")
}

struct TableRow {
    state: &'static str,
    done: Vec<(&'static str, String)>,
    needs_option: Vec<&'static str>,
    refused: Vec<&'static str>,
}

fn row(name: &'static str, set: fn(&mut RollbackBench) -> CapabilityId) -> TableRow {
    let mut row = TableRow { state: name, done: Vec::new(), needs_option: Vec::new(), refused: Vec::new() };
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let mut id = set(&mut bench);
    for (verb, command) in VERBS {
        let before = observed_state(&mut bench, &id);
        match bench.pipeline.command(command(operation(&id))) {
            Reply::Accepted { .. } => {
                let moved = change(&before, &observed_state(&mut bench, &id));
                assert!(!moved.is_empty(), "{verb} on {name} is accepted and changes nothing");
                row.done.push((verb, moved));
                bench = RollbackBench::resting(ProfileName::Sim);
                id = set(&mut bench);
            }
            Reply::Refused { text, hint, .. } => {
                assert!(!text.is_empty());
                assert!(
                    observed_state(&mut bench, &id) == before,
                    "{verb} on {name} is refused and changes the state"
                );
                let needs_option = hint.is_some_and(|hint| hint.contains("--stop-family"));
                if needs_option { row.needs_option.push(verb) } else { row.refused.push(verb) }
            }
            other => panic!("{verb} on {name}: {other:?}"),
        }
        assert_eq!(bench.pipeline.record().holding(), None, "{verb} on {name}");
    }
    let emergencies = bench.pipeline.snapshot().emergencies;
    if emergencies.iter().any(|emergency| emergency.version == id) {
        row.done.push(("break-glass", "active, if the gate finds nothing else against it".to_owned()));
    } else {
        row.refused.push("break-glass");
    }
    row
}

fn table(rows: &[TableRow]) -> String {
    let mut text =
        String::from("| state of a version | commands and their effects | refused |\n| --- | --- | --- |\n");
    for row in rows {
        let done = row.done.iter().map(|(verb, moved)| format!("`{verb}`: {moved}"));
        let needs_option =
            row.needs_option.iter().map(|verb| format!("`{verb}`: asks for `--stop-family` first"));
        let done: Vec<String> = done.chain(needs_option).collect();
        let refused: Vec<String> = row.refused.iter().map(|verb| format!("`{verb}`")).collect();
        let done = if done.is_empty() { "none: this state is final".to_owned() } else { done.join("; ") };
        let _ = writeln!(text, "| {} | {done} | {} |", row.state, refused.join(", "));
    }
    text
}

#[test]
#[allow(clippy::disallowed_methods, reason = "the environment asks for a rewrite of the guide")]
fn the_guide_lists_what_every_verb_does_in_every_state() {
    let rows: Vec<TableRow> = SETTINGS.iter().map(|(name, set)| row(name, *set)).collect();
    for row in &rows {
        let over = matches!(row.state, "rejected" | "rolled back");
        let onward = row.done.iter().any(|(verb, _)| {
            !matches!(*verb, "reject" | "demote --profile human" | "release --profile human" | "pause")
        });
        // In a stopped family a stage has no version to compare with: an operator must reactivate one first.
        let last = row.state == "demoted, the last version of a stopped family";
        assert!(!last || row.done.iter().any(|(verb, _)| *verb == "rearm"), "no command helps");
        // A registered version advances by itself; the rollback target acts again after its successor.
        let by_itself = ["registered", "superseded, the rollback target of the active one"];
        let onward = onward || by_itself.contains(&row.state);
        assert_eq!(onward, !over, "{} is a dead end, or is not over", row.state);
    }
    let table = table(&rows);
    let guide = std::fs::read_to_string(Path::new(GUIDE)).unwrap();
    let (head, rest) = guide.split_once(BEGIN).unwrap();
    let (found, tail) = rest.split_once(END).unwrap();
    if std::env::var("HOLDPOINT_WRITE_STANDINGS").is_ok() {
        std::fs::write(GUIDE, format!("{head}{BEGIN}\n{table}\n{END}{tail}")).unwrap();
        return;
    }
    assert_eq!(found.trim(), table.trim(), "HOLDPOINT_WRITE_STANDINGS=1 rewrites the guide's table");
}

fn records(bench: &RollbackBench, kind: RecordKind) -> usize {
    let filter = AuditFilter { kind: Some(kind), ..AuditFilter::default() };
    bench.pipeline.record().version_table().store().views().unwrap().audit(&filter).unwrap().len()
}

/// Regression: a restriction could not be lifted, so the version could never be confirmed.
#[test]
fn unrestricted_version_is_confirmed_after_a_new_provisional_window() {
    let (mut bench, id) = RollbackBench::with_active(CANDIDATE);
    done(&mut bench, Command::Restrict(operation(&id)));
    assert!(bench.pipeline.live().monitors.of(&id).unwrap().restricted);
    done(&mut bench, Command::Release { operation: operation(&id), profiles: Vec::new() });
    let needed = bench.pipeline.snapshot().families[0].provisional.map(|(_, needed)| needed).unwrap();
    let watched = bench.pipeline.live().monitors.of(&id).unwrap().clone();
    assert!(!watched.restricted && !watched.monitor.is_restricted());
    assert_eq!((watched.monitor.provisional_left(), watched.monitor.escalation()), (needed, None));
    assert_eq!(records(&bench, RecordKind::MonitorAnswer), 1);
    for _ in 0..200 {
        bench.pipeline.advance();
        if !bench.pipeline.record().version_table().version(&id).unwrap().1.flags.provisional {
            break;
        }
    }
    let (_, version, _) = bench.pipeline.record().version_table().version(&id).unwrap();
    assert!(version.state == State::Active && !version.flags.provisional, "{version:?}");
}

/// Where activations are bound to people, a restriction is lifted by them alone: none of their answers is left out.
#[test]
fn approvers_lift_a_restriction_where_activations_need_them() {
    let (bench, id) = RollbackBench::resting_with_active(CANDIDATE);
    let mut bench = bench.reopened(profile_with_approvers());
    done(&mut bench, Command::Restrict(operation(&id)));
    let restricted = |bench: &RollbackBench| {
        bench.pipeline.record().version_table().version(&id).unwrap().1.flags.restricted
    };
    let release = || Command::Release { operation: operation(&id), profiles: Vec::new() };
    let people: Vec<Identity> = ["carl", "dora", "emil"]
        .into_iter()
        .map(|name| enrolled(bench.pipeline.live().record, name, Role::Safety, KeyEncoding::Plain))
        .collect();
    let answer = |bench: &mut RollbackBench, who: &Identity, answer: ApprovalDecision| {
        let requests = bench.pipeline.snapshot().prompts;
        assert_eq!(requests.iter().map(|prompt| prompt.purpose).collect::<Vec<_>>(), [RequestKind::Release]);
        let command =
            crate::decide::people::signers::tests::signed(&mut bench.pipeline, &requests[0], who, answer)
                .unwrap();
        done(bench, command);
    };

    done(&mut bench, release());
    let reply = bench.pipeline.command(release());
    assert!(matches!(reply, Reply::Refused { .. }), "asked twice: {reply:?}");
    answer(&mut bench, &people[0], ApprovalDecision::Reject);
    assert!(restricted(&bench) && bench.pipeline.snapshot().prompts.is_empty());

    done(&mut bench, release());
    let deadline_ms = bench.pipeline.record().engine_ms_at(bench.pipeline.snapshot().prompts[0].until);
    bench.pipeline.jump_to(deadline_ms);
    while bench.pipeline.look_at_deadlines().unwrap() {}
    assert!(restricted(&bench) && bench.pipeline.snapshot().prompts.is_empty(), "silence lifts nothing");

    done(&mut bench, release());
    let needed = usize::try_from(bench.pipeline.snapshot().prompts[0].needed).unwrap();
    for who in &people[..needed] {
        assert!(restricted(&bench), "{needed} are needed");
        answer(&mut bench, who, ApprovalDecision::Approve);
    }
    assert!(!restricted(&bench) && bench.pipeline.snapshot().prompts.is_empty());
    assert!(!bench.pipeline.live().monitors.of(&id).unwrap().restricted);
}

/// Regression: the monitor counted the version whose task ends a sequence as silent when the clock was rounded down
/// behind its telemetry, and rolled it back.
#[test]
fn version_that_runs_last_is_not_counted_as_silent() {
    let (mut bench, id) = RollbackBench::with_active("place-robust");
    for _ in 0..60 {
        bench.pipeline.advance();
        let codes: Vec<_> =
            bench.pipeline.live().monitors.iter().filter_map(|watched| watched.escalation_reason).collect();
        assert!(!codes.contains(&ReasonCode::MonitorTelemetryMissing), "{codes:?}");
        if !bench.pipeline.record().version_table().version(&id).unwrap().1.flags.provisional {
            return;
        }
    }
    panic!("it is not confirmed");
}

/// A profile demotion was in memory alone: an engine that came up again knew nothing of it.
#[test]
fn blocked_profile_is_recorded_and_blocked_after_a_restart() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = bench.pass(CANDIDATE, &Stage::ALL[..3]);
    let close = |profiles| Command::Demote { operation: operation(&id), profiles };
    done(&mut bench, close(vec![ProfileName::Real, ProfileName::Human]));
    assert_eq!(bench.pipeline.record().version_table().version(&id).unwrap().1.state, State::Shadowed);
    assert_eq!(records(&bench, RecordKind::ProfilesSet), 1);
    let reply = bench.pipeline.command(close(vec![ProfileName::Human]));
    assert!(matches!(reply, Reply::Refused { .. }), "{reply:?}");
    let mut bench = bench.restart();
    let closed = |bench: &RollbackBench| {
        let candidates = bench.pipeline.snapshot().candidates;
        candidates.into_iter().find(|view| view.version == id).unwrap().closed
    };
    assert_eq!(closed(&bench), [ProfileName::Real, ProfileName::Human]);
    done(&mut bench, Command::Release { operation: operation(&id), profiles: vec![ProfileName::Human] });
    assert_eq!(closed(&bench.restart()), [ProfileName::Real]);
}

/// Regression: one command deactivated the last version of a family.
#[test]
fn only_one_verb_deactivates_the_last_version() {
    let (mut bench, id) = RollbackBench::resting_with_active(CANDIDATE);
    done(&mut bench, Command::Demote { operation: operation(&id), profiles: Vec::new() });
    for command in [
        Command::Rollback(operation(&baseline())),
        Command::Demote { operation: operation(&baseline()), profiles: Vec::new() },
        Command::Demote { operation: operation(&baseline()), profiles: vec![ProfileName::Sim] },
    ] {
        let reply = bench.pipeline.command(command.clone());
        assert!(matches!(reply, Reply::Refused { .. }), "{command:?}: {reply:?}");
        assert_eq!(bench.pipeline.record().active_of(&id.family).unwrap().id(), baseline(), "{command:?}");
    }
    done(&mut bench, Command::Vacate(operation(&baseline())));
    assert!(bench.pipeline.record().active_of(&id.family).is_none());
    // A version without one to compare it with waits, and does not loop.
    let other = bench.pass("align-low-transit", &Stage::ALL[..1]);
    for _ in 0..50 {
        bench.pipeline.advance();
    }
    let (_, version, _) = bench.pipeline.record().version_table().version(&other).unwrap();
    assert_eq!((version.state, version.flags.running), (State::Validated, None));
}

/// Regression: without an answer the version was put on hold, and `resume` was refused.
#[test]
fn a_version_on_hold_can_be_resumed() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = bench.pass(CANDIDATE, &Stage::ALL[..3]);
    bench.pipeline.live().evidence_files.edit(&id).held = true;
    done(&mut bench, Command::Resume(operation(&id)));
    assert!(!bench.pipeline.live().evidence_files.is_held(&id));
    assert_eq!(records(&bench, RecordKind::Resumed), 1);
    let reply = bench.pipeline.command(Command::Resume(operation(&id)));
    assert!(matches!(reply, Reply::Refused { .. }), "{reply:?}");
}

/// Regression: a restriction was reported as done although no monitor watched the version.
#[test]
fn an_unmonitored_version_can_be_restricted() {
    let (mut bench, id) = RollbackBench::resting_with_active(CANDIDATE);
    bench.pipeline.live().monitors.remove(&id.family);
    let speed = |bench: &mut RollbackBench| {
        let live = bench.pipeline.live();
        let version = live.record.capability(&id).unwrap();
        let version_table = live.record.version_table();
        let terms = terms_of(live.context, version_table, live.evidence_files, live.monitors, &version);
        terms.envelope().tool_speed_max_m_s
    };
    let full = speed(&mut bench);
    let measured = |bench: &mut RollbackBench| {
        let live = bench.pipeline.live();
        let version = live.record.capability(&id).unwrap();
        trial_subject(live.context, live.record.version_table(), live.evidence_files, &version)
            .terms
            .envelope()
            .tool_speed_max_m_s
    };
    done(&mut bench, Command::Restrict(operation(&id)));
    assert!(speed(&mut bench) < full);
    assert!(
        (measured(&mut bench) - full).abs() < f64::EPSILON,
        "a comparison uses the version without its restriction"
    );
    let again = bench.pipeline.command(Command::Restrict(operation(&id)));
    assert!(matches!(again, Reply::Refused { .. }), "{again:?}");
}

/// A version not reviewed by its deadline is rolled back; the review stays open, over a restart too, and blocks.
#[test]
fn a_late_review_demotes_the_version_and_stays_open() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = bench.pass(CANDIDATE, &Stage::ALL);
    let until = bench.pipeline.record().wall_now().plus_ms(5_000);
    bench.enter(&id, |version| LifecycleEvent::ActivateUnreviewed { version, until });
    assert!(bench.pipeline.look_at_deadlines().unwrap(), "people are asked");
    let snapshot = bench.pipeline.snapshot();
    assert_eq!((snapshot.prompts.len(), snapshot.prompts[0].needed), (1, 2));
    assert_eq!(snapshot.families[0].review.as_ref().map(|review| review.overdue), Some(false));
    let until_ms = bench.pipeline.record().engine_ms_at(until);
    bench.pipeline.jump_to(until_ms);
    while bench.pipeline.look_at_deadlines().unwrap() {}
    let review_state = |bench: &RollbackBench| {
        let state = bench.pipeline.record().version_table().version(&id).unwrap().1.state;
        let snapshot = bench.pipeline.snapshot();
        let review = snapshot.families[0].review.clone().unwrap();
        (state, review.overdue, snapshot.prompts.len())
    };
    assert_eq!(review_state(&bench), (State::Demoted, true, 1));
    let mut bench = bench.restart();
    while bench.pipeline.look_at_deadlines().unwrap() {}
    assert_eq!(review_state(&bench), (State::Demoted, true, 1));
    let views = bench.pipeline.record().version_table().store().views().unwrap();
    assert_eq!(views.open_reviews().unwrap(), [(id.clone(), until)]);
    drop(views);
    let other = bench.pass("align-low-transit", &Stage::ALL);
    let event = LifecycleEvent::Activate { version: number(&bench, &other) };
    let refused = bench.pipeline.live().record.transition(
        &id.family,
        event,
        TransitionNote::because(Notice::StageBegins),
    );
    assert!(refused.is_err(), "a promotion while a review is open");
}
