//! An engine's own pipeline runs upgrades; every decision must replay equally, and differ once evidence is edited. Numbers are
//! counted a second time, with SQL.

use std::path::Path;

use rusqlite::Connection;
use serde_json::Value;
use tempfile::TempDir;

use crate::decide::people::persons::enrolled;
use crate::decide::people::signers::tests::signed;
use crate::decide::pipeline::{Pipeline, PipelineSettings, SliceOutcome};
use crate::decide::store_identity::context_record;
use crate::live::fake_cell::StubFactory;
use crate::quick_folder::quick_folder;
use crate::test_pipeline::{SEEDS, pipeline_of, settings_in};
use crate::tests::assert_accepted;
use holdpoint_approvals::keyfile::KeyEncoding;
use holdpoint_body::disturbance::{DriftKind, Magnitude};
use holdpoint_explain::store_metrics::{RulesInForce, Since, StoreMetrics, observe_under};
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::metrics::Proportion;
use holdpoint_governance::metrics::store_metrics::{NotReplayable, ReplayOutcome};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::site_profile::{ProfileTexts, SiteProfile};
use holdpoint_protocol::command::{Command, Refusal, Reply};
use holdpoint_record::wall_clock::WallClock;
use holdpoint_registry::{Store, TelemetryViews, Views};
use holdpoint_runtime::capability::{self, Capability};
use holdpoint_sim::SimCells;
use holdpoint_store::Layout;
use holdpoint_trials::cell::Cell;

/// The slices within which an upgrade must complete.
const SLICES_MAX: usize = 20_000;

/// The profile `sim` with budgets that run in seconds.
fn small() -> Profile {
    let mut profile = Profile::builtin(ProfileName::Sim).unwrap();
    profile.evaluation.sandbox_pairs = 40;
    // So wide that every try takes these pairs.
    profile.tries.margin = 0.5;
    profile.evaluation.drills_per_kind = 20;
    profile
}

/// A profile with its policies, and its texts if they are a site's own.
type ProfileInForce = (Profile, PolicyTable, Option<ProfileTexts>);

fn small_profile() -> ProfileInForce {
    let profile = small();
    let table = PolicyTable::builtin(&profile).unwrap();
    (profile, table, None)
}

fn simulated() -> Cell {
    Cell::of(&SimCells, None).unwrap()
}

/// The rules reject it before any episode.
fn rejected_by_rules(profile: ProfileInForce) -> (TempDir, CapabilityId) {
    worked_in(StubFactory::exporting().into_cell(), profile, "grasp-tool-frame", false)
}

/// A store in which one candidate went as far as possible: until it is rejected, rolled back, or completes its window.
/// `drifts`: once it is active the cell's camera is knocked, and its monitor rolls it back.
fn worked_in(cell: Cell, profile: ProfileInForce, candidate: &str, drifts: bool) -> (TempDir, CapabilityId) {
    let (folder, mut pipeline, id) = registered(cell, profile, candidate);
    let mut is_drifting = false;
    for _ in 0..SLICES_MAX {
        let over = {
            let (_, lifecycle, _) = pipeline.record().version_table().version(&id).unwrap();
            match lifecycle.state {
                State::Rejected | State::Demoted | State::RolledBack | State::Superseded => true,
                State::Active if drifts && !is_drifting => {
                    let (kind, magnitude) = (Some(DriftKind::SensorNoise), Some(Magnitude::Strong));
                    assert_accepted(&pipeline.command(Command::Drift { kind, magnitude }));
                    is_drifting = true;
                    false
                }
                State::Active => !drifts && !lifecycle.flags.provisional,
                State::Registered | State::Validated | State::Sandboxed | State::Shadowed => false,
            }
        };
        if over {
            return (folder, id);
        }
        if matches!(pipeline.advance(), SliceOutcome::Idle { next_ms: None }) {
            break;
        }
    }
    panic!("{id} did not come to an end");
}

/// A pipeline on a new store, with this candidate registered.
fn registered(
    cell: Cell,
    (profile, table, own): ProfileInForce,
    candidate: &str,
) -> (TempDir, Pipeline, CapabilityId) {
    let folder = quick_folder();
    let settings = PipelineSettings { table, own, ..settings_in(cell, profile, SEEDS) };
    let mut pipeline = pipeline_of(folder.path(), settings, |_| WallClock::scripted(0, None));
    let path = Path::new(crate::MANIFESTS).join("candidates").join(candidate);
    let package = capability::read(&path).unwrap();
    let id = Capability::load(candidate, package.clone()).unwrap().id();
    assert_accepted(&pipeline.command(Command::Register { package, name: candidate.to_owned(), by: None }));
    (folder, pipeline, id)
}

/// Runs until the version has left these states.
fn worked_past(pipeline: &mut Pipeline, id: &CapabilityId, states: &[State]) -> State {
    for _ in 0..SLICES_MAX {
        let state = pipeline.record().version_table().version(id).unwrap().1.state;
        if !states.contains(&state) {
            return state;
        }
        assert_eq!(pipeline.advance(), SliceOutcome::Ran);
    }
    panic!("{id} goes nowhere");
}

#[test]
fn a_re_evaluation_in_shadow_is_replayed() {
    let (folder, mut pipeline, id) = registered(simulated(), small_profile(), "align-improved");
    worked_past(&mut pipeline, &id, &[State::Registered, State::Validated]);
    // As if it had done in the sandbox what the active version never does.
    for pair in &mut pipeline.live().evidence_files.edit(&id).pairs {
        (pair.active.success, pair.candidate.success) = (false, true);
    }
    worked_past(&mut pipeline, &id, &[State::Sandboxed]);
    let evidence_file = pipeline.live().evidence_files.of(&id).unwrap().clone();
    let again = evidence_file.again.expect("it was re-evaluated before the decision");
    assert_eq!(again.pairs.pairs.len(), 40);
    assert!(
        again.pairs.pairs.iter().all(|pair| evidence_file.pairs.iter().all(|other| other.seed != pair.seed))
    );
    let shadow = evidence_file.shadow.unwrap();
    assert_eq!(shadow.reasons[0].code, ReasonCode::ShadowWorkedAgain, "{:?}", shadow.reasons);
    drop(pipeline);
    let found = observed(folder.path());
    assert_eq!(found.metrics.replays.differs, 0, "{:?}", found.unequal);
    assert!(found.metrics.replays.equal >= 3, "{:?}", found.metrics.replays);
    // Evidence that differs is reported.
    let otherwise = edited(folder.path(), "shadow", |evidence| {
        evidence["again"]["behavior"]["assessment"]["outcome"] = "incompatible".into();
    });
    assert!(otherwise.metrics.replays.differs >= 1, "{:?}", otherwise.unequal);
    let without = edited(folder.path(), "shadow", |evidence| {
        evidence.as_object_mut().unwrap().remove("again");
    });
    assert!(without.metrics.replays.differs >= 1, "{:?}", without.unequal);
}

fn observed(folder: &Path) -> StoreMetrics {
    let views = Views::open(&folder.join("holdpoint.db")).unwrap();
    let telemetry = TelemetryViews::open(&folder.join("telemetry.db")).unwrap();
    let frames = vec![RulesInForce::of(small()).unwrap()];
    observe_under(&views, Some(&telemetry), Since::Record(1), environment(folder), frames).unwrap()
}

/// The environment of a store's cell.
fn environment(folder: &Path) -> Digest {
    let views = Views::open(&folder.join("holdpoint.db")).unwrap();
    context_record(&views).unwrap().unwrap().environment.unwrap()
}

/// The metrics without telemetry, with the known profiles.
fn known_as(folder: &Path, environment: Digest, frames: Vec<RulesInForce>) -> StoreMetrics {
    let views = Views::open(&folder.join("holdpoint.db")).unwrap();
    observe_under(&views, None, Since::Record(1), environment, frames).unwrap()
}

/// A connection that can forge the audit chain.
fn chain(folder: &Path) -> Connection {
    let connection = Connection::open(folder.join("holdpoint.db")).unwrap();
    connection.execute_batch("DROP TRIGGER audit_no_update").unwrap();
    connection
}

const fn counts(of: Proportion) -> (u64, u64) {
    (of.count, of.total)
}

/// Changes the evidence of one kind, computes the metrics, and restores the evidence.
fn edited(folder: &Path, kind: &str, change: impl FnOnce(&mut Value)) -> StoreMetrics {
    let connection = Connection::open(folder.join("holdpoint.db")).unwrap();
    let read = "SELECT seq, json FROM evidence WHERE kind = ?1 ORDER BY seq LIMIT 1";
    let (seq, json): (u64, String) =
        connection.query_row(read, [kind], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
    let mut evidence: Value = serde_json::from_str(&json).unwrap();
    change(&mut evidence);
    let write = "UPDATE evidence SET json = ?1 WHERE seq = ?2";
    assert_eq!(connection.execute(write, (evidence.to_string(), seq)).unwrap(), 1);
    let found = observed(folder);
    connection.execute(write, (json, seq)).unwrap();
    found
}

/// One decision fewer is equal, and it is named with its difference.
fn differs(found: &StoreMetrics, of: u64, named: &str) {
    assert_eq!(counts(found.metrics.auditability_observed), (of - 1, of), "{:?}", found.unequal);
    assert_eq!(found.metrics.replays.differs, 1, "{:?}", found.unequal);
    let ReplayOutcome::Differs { what } = &found.unequal[0].replay else { panic!("{:?}", found.unequal) };
    assert!(what.starts_with(named), "{what}");
}

#[test]
fn replayed_validation_decision_equals_the_record() {
    let (folder, id) = rejected_by_rules(small_profile());
    let found = observed(folder.path());
    assert_eq!(counts(found.metrics.auditability_observed), (1, 1), "{:?}", found.unequal);
    assert_eq!(found.metrics.screening_observed.blocked.get("validation"), Some(&1));
    let found = edited(folder.path(), "compat", |evidence| {
        evidence["kappas"]["interface"]["kappa"] = 0.96.into();
    });
    differs(&found, 1, "kappa_I.kappa is 0.96 on record");
    assert_eq!(found.unequal[0].version, id);

    // The same store under an unknown profile is not replayed, and counts as not equal.
    let environment = environment(folder.path());
    let unknown = known_as(folder.path(), environment, Vec::new());
    assert_eq!(counts(unknown.metrics.auditability_observed), (0, 1));
    assert_eq!(unknown.metrics.replayed_equal_observed.rate(), None);
    assert_eq!(unknown.unequal[0].replay, ReplayOutcome::NotReplayed { why: NotReplayable::ProfileUnknown });
    // A decision of another build is not a difference of this record.
    let other = Digest::of_parts("test", &[b"another build"]);
    let same = known_as(folder.path(), other, vec![RulesInForce::of(small()).unwrap()]);
    assert_eq!(counts(same.metrics.auditability_observed), (1, 1));

    // A changed rule has another result; by another build, that is not a difference.
    let changed = || {
        let mut changed = RulesInForce::of(small()).unwrap();
        changed.profile.thresholds.scale = 0.5;
        changed
    };
    differs(&known_as(folder.path(), environment, vec![changed()]), 1, "kappa_I");
    let found = known_as(folder.path(), other, vec![changed()]);
    assert_eq!(found.unequal[0].replay, ReplayOutcome::NotReplayed { why: NotReplayable::OtherBuild });
}

#[test]
fn edited_decision_differs_from_its_replay() {
    let (folder, _) = rejected_by_rules(small_profile());
    let connection = chain(folder.path());
    let read = "SELECT body FROM audit WHERE kind = 'decision'";
    let body: String = connection.query_row(read, [], |row| row.get(0)).unwrap();
    let write = |body: &str| {
        let write = "UPDATE audit SET body = ?1 WHERE kind = 'decision'";
        assert_eq!(connection.execute(write, [body]).unwrap(), 1);
        observed(folder.path())
    };
    type DecisionEdit = fn(&mut Value);
    let edits: [(DecisionEdit, &str); 3] = [
        (|decision| decision["outcome"] = "activate".into(), "decision.outcome is \"activate\" on record"),
        (
            |decision| decision["reasons"][0]["finding"]["name"] = "late".into(),
            "decision.reasons[0].finding.name is",
        ),
        (|decision| decision["answers"]["admitted"] = true.into(), "decision.answers.admitted is true"),
    ];
    for (edit, named) in edits {
        let mut decision: Value = serde_json::from_str(&body).unwrap();
        edit(&mut decision);
        differs(&write(&decision.to_string()), 1, named);
    }
    // A decision under a missing profile cannot be replayed; a malformed one cannot be read.
    let mut decision: Value = serde_json::from_str(&body).unwrap();
    decision["made_under"]["profile"] = Digest::of_parts("test", &[]).to_string().into();
    let found = write(&decision.to_string());
    assert_eq!(found.unequal[0].replay, ReplayOutcome::NotReplayed { why: NotReplayable::ProfileUnknown });
    let found = write("{}");
    assert_eq!(found.unequal[0].replay, ReplayOutcome::NotReplayed { why: NotReplayable::Unreadable });
    assert_eq!(counts(write(&body).metrics.auditability_observed), (1, 1));
}

#[test]
fn decision_under_a_site_profile_is_replayed_with_its_recorded_texts() {
    let (shipped_file, shipped) = Profile::builtin_text(ProfileName::Sim);
    let profile = shipped
        .replace("name = \"sim\"", "name = \"sim\"\nsite = \"line-4\"")
        .replace("retries_max = 3 ", "retries_max = 2 ");
    let (policy_file, policy) = Profile::builtin_policy(ProfileName::Sim);
    let texts = ProfileTexts {
        file: shipped_file.to_owned(),
        profile,
        policy_file: policy_file.to_owned(),
        policy: policy.to_owned(),
    };
    let own = SiteProfile::parse(texts.clone()).unwrap();
    let (folder, _) = rejected_by_rules((own.profile().clone(), own.table().clone(), Some(texts)));
    let environment = environment(folder.path());
    let found = known_as(folder.path(), environment, RulesInForce::known());
    assert_eq!(counts(found.metrics.auditability_observed), (1, 1), "{:?}", found.unequal);

    // Without its texts the requirements of the profile are unknown.
    let connection = chain(folder.path());
    let write = "UPDATE audit SET body = '{}' WHERE kind = 'profile-loaded'";
    assert_eq!(connection.execute(write, []).unwrap(), 1);
    let found = known_as(folder.path(), environment, RulesInForce::known());
    assert_eq!(found.unequal[0].replay, ReplayOutcome::NotReplayed { why: NotReplayable::ProfileUnknown });
}

#[test]
fn failed_evaluation_is_replayed_from_its_pairs_and_drills() {
    let (folder, _) = worked_in(simulated(), small_profile(), "align-no-stop", false);
    let found = observed(folder.path());
    assert_eq!(counts(found.metrics.auditability_observed), (2, 2), "{:?}", found.unequal);
    let found = edited(folder.path(), "sandbox", |evidence| {
        let tally = &mut evidence["drills"][0]["abort"];
        tally["passed"] = (tally["passed"].as_u64().unwrap() + 3).into();
    });
    differs(&found, 2, "recovery");
}

/// Batches that differ from the chain, also with corrected digests of their own, and batches that were sealed only after
/// their engine had ended.
fn edited_telemetry_is_in_no_number(whole: &Path, before: &StoreMetrics) {
    let tasks = before.metrics.success_observed.total;
    let of_version = "stream = 'live' AND id = (SELECT max(id) FROM batch WHERE stream = 'live')";
    for edit in [
        "body = CAST(json_set(CAST(body AS TEXT), '$.success', json(iif(CAST(body AS TEXT) ->> 'success', 'false', 'true')))
             AS BLOB)",
        "stream = 'monitor'",
        "version = 'nothing of this'",
        "from_ms = -1",
        "rows = rows + 1",
    ] {
        let folder = copied(whole);
        let sql = Connection::open(folder.path().join("telemetry.db")).unwrap();
        sql.execute_batch("PRAGMA ignore_check_constraints = 1").unwrap();
        let set = format!(
            "UPDATE batch SET {edit}, bytes = length(body), digest = '{}' WHERE {of_version}",
            "0".repeat(64)
        );
        assert_eq!(sql.execute(&set, []).unwrap(), 1, "{edit}");
        let found = observed(folder.path());
        assert_eq!(found.coverage.damaged_batches, 1, "{edit}");
        let live = found.coverage.live_tasks + found.coverage.other_tasks;
        assert_eq!(live + 1, before.coverage.live_tasks + before.coverage.other_tasks, "{edit}");
    }
    // A copy of a valid batch that waits for its seal: the next start finds it, and it does not count.
    let folder = copied(whole);
    let sql = Connection::open(folder.path().join("telemetry.db")).unwrap();
    let forge = format!(
        "INSERT INTO batch SELECT (SELECT max(id) + 1 FROM batch), version, stream, from_ms, to_ms, rows, digest, bytes,
         body FROM batch WHERE {of_version}"
    );
    assert_eq!(sql.execute(&forge, []).unwrap(), 1);
    drop(sql);
    assert_eq!(observed(folder.path()).coverage, before.coverage, "it is on no record");
    let store = Store::open(folder.path()).unwrap();
    let opening = store.opening().clone();
    assert_eq!((opening.telemetry.unsealed, opening.telemetry.aside.len()), (1, 0));
    let transaction = holdpoint_store::Transaction {
        command_id: "found".to_owned(),
        at_ms: opening.head.at_ms,
        wall_ms: 0,
        changes: opening.telemetry.changes,
        audit: Vec::new(),
    };
    store.commit(transaction).unwrap();
    drop(store);
    let found = observed(folder.path());
    assert_eq!((found.coverage.late_batches, found.coverage.damaged_batches), (1, 0));
    assert_eq!(found.metrics.success_observed.total, tasks);
    // A file of another shape is not read at all.
    let sql = Connection::open(folder.path().join("telemetry.db")).unwrap();
    sql.execute_batch("CREATE VIEW x AS SELECT 1").unwrap();
    let error = TelemetryViews::open(&folder.path().join("telemetry.db")).unwrap_err();
    assert!(error.to_string().contains("\"x\""), "the view is named: {error}");
}

/// A copy of a store's folder.
fn copied(whole: &Path) -> TempDir {
    let folder = quick_folder();
    let copied = std::process::Command::new("cp").arg("-a").arg(whole.join(".")).arg(folder.path()).status();
    assert!(copied.unwrap().success());
    folder
}

#[test]
fn replayed_upgrade_equals_the_record_and_its_rates_equal_telemetry() {
    let (folder, id) = worked_in(simulated(), small_profile(), "align-improved", true);
    let found = observed(folder.path());
    let metrics = &found.metrics;
    let (equal, all) = counts(metrics.auditability_observed);
    assert!(all >= 5, "validation, sandbox, shadow, gate and monitor decided: {all}");
    assert_eq!(equal, all, "{:?}", found.unequal);
    assert_eq!(counts(metrics.rsr_observed), (1, 1));

    let sql = Connection::open(folder.path().join("telemetry.db")).unwrap();
    let count = |what: &str| -> u64 {
        let sum = format!("SELECT count(*) FROM batch WHERE stream = 'live' AND version = ?1 AND {what}");
        sql.query_row(&sum, [id.to_string()], |row| row.get(0)).unwrap()
    };
    let tasks = count("1");
    assert!(tasks > 0, "nothing was worked under it");
    let holds = |field: &str| count(&format!("json_extract(CAST(body AS TEXT), '$.{field}')"));
    assert_eq!(counts(metrics.success_observed), (holds("success"), tasks));
    assert_eq!(counts(metrics.pvr_observed.hard), (holds("violation"), tasks));
    let near =
        "(json_extract(CAST(body AS TEXT), '$.violation') OR json_extract(CAST(body AS TEXT), '$.near'))";
    assert_eq!(counts(metrics.pvr_observed.near), (count(near), tasks));
    assert_eq!(metrics.unsafe_continuation_observed.total, tasks);
    assert_eq!(metrics.uar_observed.total, 1);

    edited_telemetry_is_in_no_number(folder.path(), &found);

    // Each piece of evidence has its own decision; later ones refer to it by its digest.
    let found = edited(folder.path(), "shadow", |evidence| {
        let sequence = &mut evidence["sequences"][0];
        sequence["output_divergence"] = 0.9.into();
    });
    assert!(found.metrics.replays.differs >= 1, "{:?}", found.unequal);
    assert!(counts(found.metrics.auditability_observed).0 < all);

    // The action of a monitor depends on the tasks in telemetry: another recorded action does not follow from them.
    let connection = chain(folder.path());
    let forge = "UPDATE audit SET body = json_set(body, '$.action', 'escalate') WHERE kind = 'monitor'";
    let forged = connection.execute(forge, []).unwrap();
    assert!(forged >= 1, "the monitor took no action");
    let found = observed(folder.path());
    assert_eq!(found.metrics.replays.differs, forged as u64, "{:?}", found.unequal);
}

/// A candidate with its whole evidence waits for one approver. The store refuses a decision that was changed after its
/// signature, by break-glass and in the ordinary way, and the engine runs on. The unchanged one leads to the swap in the
/// number of transactions that `src/ARCHITECTURE.md` states, without those of alarms.
#[test]
fn changed_decision_is_refused_and_the_signed_one_activates_in_four_transactions() {
    let mut profile = small();
    (profile.approval.quorum_low, profile.approval.quorum_medium, profile.approval.quorum_high) = (1, 1, 1);
    let table = PolicyTable::builtin(&profile).unwrap();
    let (folder, mut pipeline, id) = registered(simulated(), (profile, table, None), "align-improved");
    for _ in 0..SLICES_MAX {
        if !pipeline.snapshot().prompts.is_empty() {
            break;
        }
        pipeline.advance();
    }
    let ann = enrolled(pipeline.live().record, "ann", Role::Safety, KeyEncoding::Plain);
    let waits = pipeline.snapshot();
    let decide =
        |pipeline: &mut Pipeline, request| signed(pipeline, request, &ann, ApprovalDecision::Approve);
    for request in [&waits.emergencies[0], &waits.prompts[0]] {
        let command = decide(&mut pipeline, request).unwrap();
        let mut changed = serde_json::to_value(&command).unwrap();
        changed["signed"]["approval"]["reason"] = "another reason".into();
        let reply = pipeline.command(serde_json::from_value(changed).unwrap());
        assert!(matches!(reply, Reply::Refused { code: Refusal::NotAllowed, .. }), "{reply:?}");
        let after = pipeline.snapshot();
        assert_eq!((after.holding, after.prompts.len()), (None, 1));
        assert!(after.prompts[0].approved_by.is_empty());
    }
    let sql = Connection::open(Layout::new(folder.path()).database()).unwrap();
    let transactions = || -> u64 {
        let counted =
            "SELECT count(*) FROM command WHERE EXISTS (SELECT 1 FROM audit WHERE kind <> 'alarm-changed'
             AND seq BETWEEN json_extract(receipt, '$.first_seq') AND json_extract(receipt, '$.last_seq'))";
        sql.query_row(counted, [], |row| row.get(0)).unwrap()
    };
    let command = decide(&mut pipeline, &waits.prompts[0]).unwrap();
    let before = transactions();
    assert_accepted(&pipeline.command(command));
    assert_eq!(pipeline.record().active_of(&id.family).unwrap().id(), id);
    assert_eq!(transactions() - before, 4);
}
