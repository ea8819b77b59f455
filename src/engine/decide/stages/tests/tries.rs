//! Tries: counted with their first pair and over restarts, spent until a person reviews them, the same under another number.

use std::path::Path;

use holdpoint_governance::finding::Finding;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::outcome::{Basis, BehaviorOutcome};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::submission::Package;
use holdpoint_governance::tries::{CountedTry, TryAuthor};
use holdpoint_protocol::command::{Command, Refusal, Reply};
use holdpoint_registry::Views;
use holdpoint_runtime::capability;
use holdpoint_store::AuditFilter;

use super::cell_faults::{operation, register};
use crate::decide::operations::has_tried;
use crate::decide::pipeline::SliceOutcome;
use crate::decide::stages::rollback::tests::RollbackBench;
use holdpoint_explain::store_metrics::{Since, observe};
use holdpoint_record::evidence_file::EvidenceFile;

/// The most slices until what is waited for.
const SLICES_MAX: usize = 20_000;

fn candidate(name: &str) -> Package {
    capability::read(&Path::new(crate::MANIFESTS).join("candidates").join(name)).unwrap()
}

fn retry(bench: &mut RollbackBench, id: &CapabilityId) {
    let repeat = Command::Repeat { operation: operation(id), stage: Stage::Sandbox };
    assert!(matches!(bench.pipeline.command(repeat), Reply::Accepted { .. }));
}

fn advance_until(bench: &mut RollbackBench, is_reached: impl Fn(&mut RollbackBench) -> bool) {
    for _ in 0..SLICES_MAX {
        if is_reached(bench) {
            return;
        }
        assert_eq!(bench.pipeline.advance(), SliceOutcome::Ran);
        assert_eq!(bench.pipeline.record().holding(), None);
    }
    panic!("it is not reached");
}

/// Whether a version is in a state, and no stage of it runs.
fn rests(bench: &RollbackBench, id: &CapabilityId, state: State) -> bool {
    let version = bench.pipeline.record().version_table().version(id).unwrap().1;
    version.state == state && version.flags.running.is_none()
}

fn evidence(bench: &mut RollbackBench, id: &CapabilityId) -> EvidenceFile {
    bench.pipeline.live().evidence_files.of(id).cloned().unwrap_or_default()
}

fn recorded(bench: &RollbackBench) -> Vec<(String, CountedTry)> {
    let filter = AuditFilter { kind: Some(RecordKind::TryCounted), ..AuditFilter::default() };
    let records = bench.pipeline.record().version_table().store().views().unwrap().audit(&filter).unwrap();
    let read = |body: &str| serde_json::from_str(body).unwrap();
    records.into_iter().map(|record| (record.subject, read(&record.body))).collect()
}

/// A record as if a version had been tried once more.
fn record_try(bench: &mut RollbackBench, id: &CapabilityId, number: u32) {
    let counted = CountedTry {
        subject: Digest::of_parts("test", &[&number.to_le_bytes()]),
        drawn: None,
        author: TryAuthor::default(),
        by_author: number,
        in_family: number,
        level: 0.01,
        pairs: 300,
        left: 0,
    };
    let body = serde_json::to_string(&counted).unwrap();
    bench.pipeline.live().record.note(RecordKind::TryCounted, id.to_string(), body).unwrap();
}

fn names(evidence_file: &EvidenceFile, finding: &Finding) -> bool {
    evidence_file.reasons.iter().any(|reason| reason.finding.as_ref() == Some(finding))
}

#[test]
fn a_try_is_counted_once_with_its_first_pair() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    // A formal rejection costs nothing.
    let formal = register(&mut bench, candidate("grasp-tool-frame"));
    advance_until(&mut bench, |bench| rests(bench, &formal, State::Rejected));
    let id = register(&mut bench, candidate("grasp-improved"));
    advance_until(&mut bench, |bench| !evidence(bench, &id).alone.is_empty());
    assert!(recorded(&bench).is_empty(), "its episodes alone are no try");
    advance_until(&mut bench, |bench| !recorded(bench).is_empty());
    let (version, counted) = recorded(&bench).remove(0);
    assert_eq!(version, id.to_string());
    let profile = bench.pipeline.live().context.profile.clone();
    assert_eq!((counted.by_author, counted.in_family, counted.author.name.as_str()), (1, 1, ""));
    assert_eq!(
        (counted.pairs, counted.left),
        (profile.evaluation.sandbox_pairs, profile.tries.per_author - 1)
    );
    let evidence_file = evidence(&mut bench, &id);
    assert!(evidence_file.pairs.is_empty() && evidence_file.counted.as_ref() == Some(&counted));
    // The engine ends with the try unfinished: it continues as the same one.
    let mut bench = bench.restart();
    advance_until(&mut bench, |bench| !evidence(bench, &id).pairs.is_empty());
    assert_eq!(recorded(&bench), [(version, counted.clone())]);
    assert_eq!(evidence(&mut bench, &id).counted, Some(counted));
}

#[test]
fn spent_tries_wait_for_a_review() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let first: CapabilityId = "grasp@1.0.0".parse().unwrap();
    let spent = bench.pipeline.live().context.profile.tries.per_author;
    for number in 1..=spent {
        record_try(&mut bench, &first, number);
    }
    // A restart reads the count from the record.
    let mut bench = bench.restart();
    let id = register(&mut bench, candidate("grasp-improved"));
    let finding = Finding::TriesSpent {
        author: String::new(),
        family: id.family.clone(),
        by_author: spent,
        in_family: spent,
    };
    for _ in 0..2 {
        advance_until(&mut bench, |bench| rests(bench, &id, State::Demoted));
        let evidence_file = evidence(&mut bench, &id);
        assert!(names(&evidence_file, &finding), "{:?}", evidence_file.reasons);
        assert!(evidence_file.alone.is_empty() && evidence_file.pairs.is_empty(), "nothing was run");
        // Without a review the next one ends likewise.
        retry(&mut bench, &id);
    }
    let review = |bench: &mut RollbackBench| bench.pipeline.command(Command::ReviewTries(operation(&id)));
    assert!(matches!(review(&mut bench), Reply::Accepted { .. }));
    let again = review(&mut bench);
    assert!(matches!(again, Reply::Refused { code: Refusal::NotNow, .. }), "nothing is counted: {again:?}");
    advance_until(&mut bench, |bench| evidence(bench, &id).counted.is_some());
    assert_eq!(evidence(&mut bench, &id).counted.unwrap().by_author, 1);
    // So is the review.
    let bench = bench.restart();
    let tries = bench.pipeline.record().version_table().tries(&id.family).unwrap();
    assert_eq!(tries.open().len(), 1);
}

/// The same content under another version number.
fn renumbered(package: &Package) -> Package {
    let number = capability::Capability::load("test", package.clone()).unwrap().id().version.to_string();
    Package { manifest: package.manifest.replacen(&number, "1.1.9", 1), ..package.clone() }
}

/// Names are free: versions that no author signed count for one author, whatever name they state.
#[test]
fn unsigned_versions_under_other_names_are_tries_of_one_author() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let package = candidate("grasp-improved");
    let stated = capability::Capability::load("test", package.clone()).unwrap().submission.author.clone();
    let by = |package: &Package, name: &str| Package {
        submission: package.submission.replacen(&stated, name, 1),
        ..package.clone()
    };
    let first = register(&mut bench, by(&package, "nova"));
    let second = register(&mut bench, by(&renumbered(&package), "vega"));
    for (id, name) in [(&first, "nova"), (&second, "vega")] {
        assert_eq!(bench.pipeline.record().capability(id).unwrap().submission.author, name);
        let table = bench.pipeline.record().version_table();
        assert_eq!(table.try_author(id).unwrap(), TryAuthor::default());
    }
}

/// A version on hold passes its verdict on: another number gives the content no other draw.
#[test]
fn the_same_content_under_another_number_is_on_hold_too() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let package = candidate("grasp-improved");
    let first = register(&mut bench, package.clone());
    advance_until(&mut bench, |bench| !evidence(bench, &first).pairs.is_empty());
    let demote = Command::Demote { operation: operation(&first), profiles: Vec::new() };
    assert!(matches!(bench.pipeline.command(demote), Reply::Accepted { .. }));
    advance_until(&mut bench, |bench| rests(bench, &first, State::Demoted));
    let kappas = bench.pipeline.live().evidence_files.edit(&first).kappas.as_mut().unwrap();
    (kappas.behavior.outcome, kappas.behavior.basis) = (BehaviorOutcome::Inconclusive, Basis::Measured);
    let second = register(&mut bench, renumbered(&package));
    advance_until(&mut bench, |bench| rests(bench, &second, State::Demoted));
    let evidence_file = evidence(&mut bench, &second);
    let finding = Finding::HeldBefore { version: first };
    assert!(names(&evidence_file, &finding), "{:?}", evidence_file.reasons);
    assert!(evidence_file.alone.is_empty() && evidence_file.pairs.is_empty(), "nothing was run");
    assert_eq!(recorded(&bench).len(), 1, "it is no other try");
}

#[test]
fn the_same_content_under_another_number_has_its_verdict() {
    let mut bench = RollbackBench::new();
    let package = candidate("align-no-stop");
    let renumbered = renumbered(&package);
    let first = register(&mut bench, package);
    advance_until(&mut bench, |bench| rests(bench, &first, State::Rejected));
    let is_counted = evidence(&mut bench, &first).counted.is_some();
    assert!(is_counted && !evidence(&mut bench, &first).pairs.is_empty(), "it was measured");
    // What was measured is known after a restart.
    let mut bench = bench.restart();
    let second = register(&mut bench, renumbered);
    assert_ne!(second, first);
    advance_until(&mut bench, |bench| rests(bench, &second, State::Rejected));
    let evidence_file = evidence(&mut bench, &second);
    let finding = Finding::TriedBefore { version: first };
    assert!(names(&evidence_file, &finding), "{:?}", evidence_file.reasons);
    assert!(evidence_file.alone.is_empty() && evidence_file.pairs.is_empty(), "nothing was run");
    assert_eq!(recorded(&bench).len(), 1, "it is no other try");
    // Both verdicts follow from the record.
    let views = Views::open(&bench.folder().join("holdpoint.db")).unwrap();
    let environment = bench.pipeline.live().context.cell.digest();
    let found = observe(&views, None, Since::Record(1), environment).unwrap();
    assert_eq!((found.metrics.replays.differs, found.metrics.replays.equal), (0, 4), "{:?}", found.unequal);
}

#[test]
fn who_tried_is_known_by_version() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = register(&mut bench, candidate("grasp-improved"));
    let author = bench.pipeline.record().capability(&id).unwrap().submission.author.clone();
    let baseline: CapabilityId = "grasp@1.0.0".parse().unwrap();
    let has_tried =
        |bench: &RollbackBench, who: &str| has_tried(bench.pipeline.record(), &baseline, who).unwrap();
    let by_author = has_tried(&bench, &author);
    record_try(&mut bench, &id, 1);
    let bench = bench.restart();
    assert!(has_tried(&bench, &author), "{author} wrote the version that was tried");
    assert!(!has_tried(&bench, "ada"));
    assert!(!by_author, "{author} had not tried before");
}
