//! The text that approvers see before they decide, and how conditions affect an active version.

use std::path::Path;

use holdpoint_approvals::keyfile::KeyEncoding;
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::condition::Condition;
use holdpoint_governance::evidence::EpisodeValues;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::monitor::MonitorAction;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::submission::{InterfaceChange, InterfaceChangeKind, InterfacePart, Package};
use holdpoint_protocol::command::{Command, Operation, Reply};
use holdpoint_protocol::detail::VersionDiff;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::monitor_chart::ChartView;
use holdpoint_runtime::capability;
use holdpoint_store::AuditFilter;
use holdpoint_wording::{event as event_text, version_diff};
use serde_json::json;

use super::*;
use crate::decide::people::persons::enrolled;
use crate::decide::pipeline::Pipeline;
use crate::decide::stages::break_glass;
use crate::decide::stages::rollback::tests::RollbackBench;
use crate::tests::assert_accepted;

pub(crate) fn package(name: &str, changes: &[(&str, &str)]) -> Package {
    let mut package = capability::read(&Path::new(crate::MANIFESTS).join("candidates").join(name)).unwrap();
    for (from, to) in changes {
        assert!(package.manifest.contains(from), "{from}");
        package.manifest = package.manifest.replace(from, to);
    }
    package
}

fn profile(name: ProfileName) -> Profile {
    Profile::builtin(name).unwrap()
}

/// Registers a version, lets the rules validate it, and puts it before people.
pub(crate) fn request_activation(pipeline: &mut Pipeline, package: Package) -> CapabilityId {
    request_activation_by(pipeline, package, None)
}

/// As [`request_activation`], registered on a person's behalf.
pub(crate) fn request_activation_by(
    pipeline: &mut Pipeline,
    package: Package,
    by: Option<&str>,
) -> CapabilityId {
    let id = holdpoint_runtime::capability::Capability::load("test", package.clone()).unwrap().id();
    let register = holdpoint_protocol::command::Command::Register {
        package,
        name: "test".to_owned(),
        by: by.map(ToOwned::to_owned),
    };
    assert_accepted(&pipeline.command(register));
    pipeline.advance();
    let (version, lifecycle, _) = pipeline.record().version_table().version(&id).unwrap();
    assert_eq!(lifecycle.state, State::Validated);
    let mut move_on = |event| {
        let note = TransitionNote::because(Notice::StageBegins);
        pipeline.live().record.transition(&id.family, event, note).unwrap();
    };
    for stage in [Stage::Sandbox, Stage::Shadow] {
        move_on(LifecycleEvent::Start { version, stage });
        move_on(LifecycleEvent::Pass { version, stage });
    }
    move_on(LifecycleEvent::Start { version, stage: Stage::Activation });
    let Activation { context, record, evidence_files, approvals, .. } = pipeline.activation();
    approvals.request_approval(context, record, evidence_files, &id).unwrap();
    id
}

/// A candidate that asks for more than the active version. The approval request, its JSON, the plain stream and the
/// signed record have each new permission, the whole difference with both values, and the author's declarations.
#[test]
fn all_changes_are_shown_before_a_decision() {
    let more = [
        ("channels = [\"arm\"]", "channels = [\"arm\", \"gripper\"]"),
        ("commands = [\"stop\", \"tool-pose\"]", "commands = [\"gripper\", \"stop\", \"tool-pose\"]"),
        ("memory_kib = 256", "memory_kib = 512"),
        ("zones = [\"work\", \"transit\", \"tray\"]", "zones = [\"work\", \"tray\"]"),
        (
            "[outputs.duration]",
            "[outputs.corrections]\ntype = \"int\"\nrange = [0, 9]\nrequired = false\n\n[outputs.duration]",
        ),
    ];
    let mut package = package("align-improved", &more[..4]);
    package.submission.push_str(
        "\n[[interface_changes]]\npart = \"precondition\"\nname = \"holding\"\nchange = \"changed\"\n",
    );
    let mut bench = RollbackBench::resting(ProfileName::Human);
    let pipeline = &mut bench.pipeline;
    pipeline.drain_events();
    let id = request_activation(pipeline, package);
    let new = ["channel gripper", "command gripper", "memory 512 KiB (was 256 KiB)"];
    let changed = [
        ("manifest.permissions.channels", None, Some(json!("gripper"))),
        ("manifest.permissions.commands", None, Some(json!("gripper"))),
        ("manifest.permissions.zones", Some(json!("transit")), None),
        ("manifest.permissions.resources.memory_kib", Some(json!(256)), Some(json!(512))),
        ("params.corrections_max", Some(json!(1)), Some(json!(3))),
    ];
    let declared = InterfaceChange {
        part: InterfacePart::Precondition,
        name: "holding".to_owned(),
        change: InterfaceChangeKind::Changed,
    };
    // The question on screen.
    let question = pipeline.snapshot().prompts.remove(0);
    assert_eq!(
        (question.version.clone(), question.new_permissions.clone()),
        (id.clone(), new.map(String::from).to_vec())
    );
    let mut fields = question.changes.fields.clone();
    fields.retain(|one| changed.contains(&(one.field.as_str(), one.old.clone(), one.new.clone())));
    assert_eq!(fields.len(), changed.len(), "{:#?}", question.changes.fields);
    assert!(question.changes.declared.contains(&declared), "{:?}", question.changes.declared);
    let differences = version_diff::lines(&VersionDiff { fields, declared: vec![declared] });
    let texts: Vec<&str> = new.into_iter().chain(differences.iter().map(String::as_str)).collect();
    // JSON and the plain stream.
    let events = pipeline.drain_events();
    let kind = events.into_iter().find(|kind| matches!(kind, EventKind::ApprovalRequested { .. })).unwrap();
    let event = Event { seq: 1, at_ms: 0, kind };
    let (json, line) = (serde_json::to_string(&event).unwrap(), event_text::line(&event));
    for text in &texts {
        assert!(line.contains(text), "{text}: {line}");
    }
    assert!(new.iter().all(|text| json.contains(text)), "{json}");
    assert!(
        json.contains("\"field\":\"manifest.permissions.zones\",\"old\":\"transit\",\"new\":null"),
        "{json}"
    );
    // The record: the signed evidence has it, and the text on the screen is stored with the answer.
    let request =
        pipeline.record().version_table().store().views().unwrap().open_requests().unwrap().remove(0);
    let evidence_file: EvidenceFile = serde_json::from_str(&request.json).unwrap();
    assert_eq!(
        (evidence_file.new_permissions.clone(), evidence_file.digest().unwrap()),
        (question.new_permissions.clone(), question.evidence)
    );
    let without_permissions = EvidenceFile { new_permissions: Vec::new(), ..evidence_file.clone() };
    assert_ne!(without_permissions.digest().unwrap(), question.evidence, "the signature covers what is new");
    let identity = enrolled(pipeline.live().record, "ann", Role::Safety, KeyEncoding::Plain);
    let shown = crate::decide::people::signers::tests::question(pipeline, &question, "ann").unwrap();
    for text in &texts {
        // Parameters are folded into one line.
        let text = text.trim_start_matches("parameter ");
        assert!(shown.lines.iter().any(|line| line.contains(text)), "{text}: {:#?}", shown.lines);
    }
    let decide = shown.answer(&identity, ApprovalDecision::Approve, "read").unwrap();
    assert_accepted(&pipeline.command(decide));
    let filter = AuditFilter { kind: Some(RecordKind::Shown), ..AuditFilter::default() };
    let body =
        pipeline.record().version_table().store().views().unwrap().audit(&filter).unwrap().remove(0).body;
    for text in &texts {
        let text = text.trim_start_matches("parameter ");
        assert!(body.contains(text), "{text}: {body}");
    }
}

/// A version for simulation alone runs there, and is rolled back before it gets another arm.
#[test]
fn simulation_only_version_controls_no_other_arm() {
    let package = package("grasp-improved", &[("[\"sim\", \"real\", \"human\"]", "[\"sim\"]")]);
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = bench.activate_package(package, &[Condition::SimulationOnly]);
    let runs_task = |pipeline: &mut Pipeline| {
        let report = pipeline.live().sequence(None).unwrap();
        report.tasks.iter().any(|done| done.id == id)
    };
    let active =
        |pipeline: &Pipeline| pipeline.record().active_of(&id.family).map(|active| active.id().to_string());
    assert!(runs_task(&mut bench.pipeline), "it runs in simulation");
    bench = bench.reopened(profile(ProfileName::Sim));
    assert_eq!(active(&bench.pipeline), Some(id.to_string()));
    for name in [ProfileName::Real, ProfileName::Human] {
        bench = bench.reopened(profile(name));
        assert_eq!(active(&bench.pipeline).as_deref(), Some("grasp@1.0.0"), "{name}");
        let state = bench.pipeline.record().version_table().version(&id).unwrap().1.state;
        assert_eq!(state, State::Demoted, "{name}");
        assert!(!runs_task(&mut bench.pipeline), "{name}");
    }
}

fn operation(version: &CapabilityId) -> Operation {
    Operation { version: version.clone(), by: "ada".to_owned(), reason: "a test".to_owned() }
}

fn block(bench: &mut RollbackBench, id: &CapabilityId, name: ProfileName) {
    let demote = Command::Demote { operation: operation(id), profiles: vec![name] };
    assert_accepted(&bench.pipeline.command(demote));
}

fn runs_task(bench: &mut RollbackBench, id: &CapabilityId) -> bool {
    (0..8).any(|_| {
        let report = bench.pipeline.live().sequence(None).unwrap();
        report.tasks.iter().any(|done| done.id == *id)
    })
}

fn active(bench: &RollbackBench, id: &CapabilityId) -> Option<String> {
    bench.pipeline.record().active_of(&id.family).map(|active| active.id().to_string())
}

/// A block under a profile once stopped only candidates: an active version kept running under it.
#[test]
fn a_blocked_version_does_not_run_under_the_profile() {
    let (mut bench, id) = RollbackBench::resting_with_active("grasp-improved");
    block(&mut bench, &id, ProfileName::Human);
    assert!(runs_task(&mut bench, &id), "it runs where it is not blocked");
    bench = bench.reopened(profile(ProfileName::Sim));
    assert_eq!(active(&bench, &id), Some(id.to_string()));
    bench = bench.reopened(profile(ProfileName::Human));
    assert_eq!(active(&bench, &id).as_deref(), Some("grasp@1.0.0"));
    assert_eq!(bench.pipeline.record().version_table().version(&id).unwrap().1.state, State::Demoted);
    assert!(!runs_task(&mut bench, &id));
}

/// If a full disk interrupts a rollback, the version stays active, and it once ran its next task without its monitor.
#[test]
fn a_version_whose_rollback_has_begun_gets_no_task() {
    let (mut bench, id) = RollbackBench::with_active("align-improved");
    assert!(runs_task(&mut bench, &id));
    let version = bench.pipeline.record().version_table().version(&id).unwrap().0;
    let note = TransitionNote::because(Notice::StageBegins);
    let begin = LifecycleEvent::BeginRollback { version };
    bench.pipeline.live().record.transition(&id.family, begin, note).unwrap();
    assert!(!runs_task(&mut bench, &id));
}

/// Neither a rollback nor an operator reactivates a blocked version.
#[test]
fn no_rollback_activates_a_blocked_version() {
    let (mut bench, id) = RollbackBench::resting_with_active("grasp-improved");
    let before: CapabilityId = "grasp@1.0.0".parse().unwrap();
    for id in [&id, &before] {
        block(&mut bench, id, ProfileName::Human);
    }
    bench = bench.reopened(profile(ProfileName::Human));
    assert_eq!(active(&bench, &id), None, "the family is stopped");
    let rearm = || Command::Rearm(operation(&before));
    let reply = bench.pipeline.command(rearm());
    let Reply::Refused { hint: Some(hint), .. } = &reply else { panic!("{reply:?}") };
    let command = "holdpoint version unblock grasp@1.0.0 --profile human --as ada --reason 'a test'";
    assert_eq!(*hint, format!("`{command}` unblocks it"));
    let unblock = Command::Release { operation: operation(&before), profiles: vec![ProfileName::Human] };
    for command in [unblock, rearm()] {
        assert_accepted(&bench.pipeline.command(command));
    }
    assert!(runs_task(&mut bench, &before));
}

/// An operator who rolls back the last version learns first that no version follows.
#[test]
fn a_blocked_rollback_target_does_not_take_over() {
    let (mut bench, id) = RollbackBench::resting_with_active("align-improved");
    block(&mut bench, &"align@1.0.0".parse().unwrap(), ProfileName::Sim);
    let reply = bench.pipeline.command(Command::Rollback(operation(&id)));
    assert!(matches!(&reply, Reply::Refused { hint: Some(hint), .. } if hint.contains("--stop-family")));
    assert_eq!(active(&bench, &id), Some(id.to_string()));
}

/// No sequence runs a blocked version, whatever blocked it; a version activated by break-glass runs until its review.
#[test]
fn no_sequence_runs_a_blocked_version() {
    for unreviewed in [false, true] {
        let mut bench = RollbackBench::resting(ProfileName::Sim);
        let id = bench.pass("grasp-improved", &Stage::ALL);
        let version = bench.pipeline.record().version_table().version(&id).unwrap().0;
        let event = LifecycleEvent::Close { version, profile: ProfileName::Sim };
        let note = TransitionNote::because(Notice::StageBegins);
        bench.pipeline.live().record.transition(&id.family, event, note).unwrap();
        bench.enter(&id, |version| {
            if unreviewed {
                LifecycleEvent::ActivateUnreviewed {
                    version,
                    until: holdpoint_governance::wall_time::WallTime::SCRIPT_EPOCH.plus_ms(1_000_000),
                }
            } else {
                LifecycleEvent::Activate { version }
            }
        });
        assert_eq!(runs_task(&mut bench, &id), unreviewed);
        if unreviewed {
            let people = ["carl", "dora"].map(ToOwned::to_owned).into();
            let outcome = ApprovalOutcome::Granted {
                people,
                until: holdpoint_governance::wall_time::WallTime::SCRIPT_EPOCH.plus_ms(1_000_000),
                break_glass: false,
            };
            let upheld = ApprovalResult { outcome, reasons: Vec::new() };
            let mut live = bench.pipeline.live();
            break_glass::settle_review(&mut live, &mut Approvals::default(), &id, &upheld).unwrap();
            assert!(runs_task(&mut bench, &id), "upholding it unblocks the version");
        }
    }
}

const BAD: EpisodeValues = EpisodeValues { anomaly: true, time_s: 2.0, ..EpisodeValues::CLEAN };

/// The conditions of an activation set its monitor, also after a restart; they end at the confirmation.
#[test]
fn conditions_of_an_activation_reach_its_monitor() {
    let strict = [Condition::StricterThresholds { factor: 0.5 }, Condition::RollbackCoupled];
    let first_action = |conditions: &[Condition]| {
        let mut bench = RollbackBench::resting(ProfileName::Sim);
        let id = bench.activate_package(package("align-improved", &[]), conditions);
        let view = bench.pipeline.snapshot().live.monitors.remove(0);
        let mut watched = bench.pipeline.live().monitors.of(&id).unwrap().clone();
        let (tick, action) = (1_u32..1_000)
            .map(|tick| (tick, watched.monitor.observe(&BAD, u64::from(tick)).action))
            .find(|(_, action)| *action != MonitorAction::Continue)
            .unwrap();
        (bench, id, view, (tick, action))
    };
    let (_, _, plain, (plain_tick, _)) = first_action(&[]);
    let (mut bench, id, view, (strict_tick, strict_action)) = first_action(&strict);
    assert_eq!((plain.factor, plain.coupled, view.factor, view.coupled), (1.0, false, 0.5, true));
    for (plain_chart, strict_chart) in plain.charts.iter().zip(&view.charts) {
        assert_eq!(strict_chart.limit, plain_chart.limit / 2.0, "the limit of {:?}", plain_chart.rate);
    }
    assert_eq!(strict_action, MonitorAction::Rollback);
    assert!(strict_tick < plain_tick, "{strict_tick} against {plain_tick} episodes");
    let live = bench.pipeline.live();
    live.monitors.of_mut(&id).unwrap().monitor.confirmed().unwrap();
    live.evidence_files.edit(&id).conditions.retain(Condition::outlives_confirmation);
    assert!(live.evidence_files.of(&id).unwrap().conditions.is_empty());
    let view = bench.pipeline.snapshot().live.monitors.remove(0);
    assert_eq!((view.factor, view.coupled, view.charts[0].limit), (1.0, false, plain.charts[0].limit));
}

/// An operator who stops the cell in a task, or restricts a version, intervenes. Only the intervention charts of that
/// version change, and its window counts no episode.
#[test]
fn an_intervention_counts_for_its_version() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = bench.activate_package(package("align-improved", &[]), &[]);
    let named = |chart: ChartView| (format!("{} {}", chart.rate, chart.level), chart.value);
    let charts = |bench: &RollbackBench| {
        let live = bench.pipeline.snapshot().live;
        let charts = live.monitors.into_iter().find(|view| view.version == id).unwrap().charts;
        charts.into_iter().map(named).collect::<Vec<_>>()
    };
    let changed_charts = |before: &[(String, f64)], after: &[(String, f64)]| -> Vec<String> {
        let pairs = before.iter().zip(after);
        pairs
            .filter(|((_, before), (_, after))| before.to_bits() != after.to_bits())
            .map(|((name, _), _)| name.clone())
            .collect()
    };
    let intervention_charts = ["intervention trip", "intervention warning"];
    let before = charts(&bench);
    let operation = Operation { version: id.clone(), by: "ann".to_owned(), reason: "a test".to_owned() };
    assert_accepted(&bench.pipeline.command(holdpoint_protocol::command::Command::Restrict(operation)));
    let restricted = charts(&bench);
    let mut changed = changed_charts(&before, &restricted);
    changed.sort();
    assert_eq!(changed, intervention_charts);
    // The operator stops the cell during grasp: the intervention does not count for align.
    bench.pipeline.switch().latch();
    let report = bench.pipeline.live().sequence(None).unwrap();
    let first = &report.tasks[0];
    assert!(
        first.record.intervention && first.record.recovery && !first.record.success,
        "{:?}",
        first.record
    );
    assert_eq!(charts(&bench), restricted);
    let (mut bench, id) = RollbackBench::resting_with_active("grasp-improved");
    let charts = |bench: &RollbackBench| {
        let view = bench.pipeline.snapshot().live.monitors.remove(0);
        (view.episodes, view.charts.into_iter().map(named).collect::<Vec<_>>())
    };
    let before = charts(&bench);
    bench.pipeline.switch().latch();
    assert_eq!(bench.pipeline.live().sequence(None).unwrap().tasks[0].id, id);
    let after = charts(&bench);
    let mut changed = changed_charts(&before.1, &after.1);
    changed.sort();
    assert_eq!((after.0, changed), (before.0, intervention_charts.map(String::from).to_vec()));
}
