//! Faults of the cell demote a candidate and never reject it. A family without a task takes no new version.
//! Registration refuses a zone that the cell does not have.

use std::path::Path;

use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::finding::Finding;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::outcome::RecoveryOutcome;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Operation, Refusal, Reply};
use holdpoint_runtime::capability::{self, Capability};

use crate::decide::pipeline::SliceOutcome;
use crate::decide::stages::rollback::tests::RollbackBench;
use crate::decide::stages::validation;
use holdpoint_record::check::RegisteredVersions;

/// The most slices until a candidate without a usable fallback is demoted, before any episode.
const SLICES_MAX: usize = 60;

/// A package with one text of its manifest replaced.
fn package(folder: &str, from: &str, to: &str) -> Package {
    let mut package = capability::read(&Path::new(crate::MANIFESTS).join(folder)).unwrap();
    assert!(package.manifest.contains(from), "{folder} has no {from}");
    package.manifest = package.manifest.replacen(from, to, 1);
    package
}

fn with_fallback(family: &str, requirement: &str) -> Package {
    let to = format!("family = \"{family}\"\nversion = \"{requirement}\"");
    package("candidates/align-improved", "family = \"park\"\nversion = \"^1\"", &to)
}

pub(super) fn register(bench: &mut RollbackBench, package: Package) -> CapabilityId {
    let reply = bench.pipeline.command(Command::Register { package, name: "test".to_owned(), by: None });
    let Reply::Accepted { version: Some(id), .. } = reply else { panic!("{reply:?}") };
    id
}

pub(super) fn operation(id: &CapabilityId) -> Operation {
    Operation { version: id.clone(), by: "ada".to_owned(), reason: "a test".to_owned() }
}

/// Runs until a version is demoted and no stage of it runs.
fn run_until_demoted(bench: &mut RollbackBench, id: &CapabilityId) {
    for _ in 0..SLICES_MAX {
        assert_eq!(bench.pipeline.advance(), SliceOutcome::Ran);
        assert_eq!(bench.pipeline.record().holding(), None);
        let version = bench.pipeline.record().version_table().version(id).unwrap().1;
        if version.state == State::Demoted && version.flags.running.is_none() {
            return;
        }
    }
    panic!("{id} was not demoted");
}

#[test]
fn a_fallback_that_may_not_take_over_demotes_the_candidate_each_time() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let improved = capability::read(&Path::new(crate::MANIFESTS).join("candidates/grasp-improved")).unwrap();
    let waiting = register(&mut bench, improved);
    assert!(matches!(bench.pipeline.command(Command::Pause(operation(&waiting))), Reply::Accepted { .. }));
    let requirement = format!("={}", waiting.version);
    let id = register(&mut bench, with_fallback("grasp", &requirement));
    run_until_demoted(&mut bench, &id);
    // The fault is there still when the sandbox is repeated.
    let repeat = Command::Repeat { operation: operation(&id), stage: Stage::Sandbox };
    assert!(matches!(bench.pipeline.command(repeat), Reply::Accepted { .. }));
    run_until_demoted(&mut bench, &id);
    let evidence_file = bench.pipeline.live().evidence_files.of(&id).cloned().unwrap();
    let fault = Finding::FallbackNotInCell { family: waiting.family.clone(), requirement };
    assert_eq!(evidence_file.reasons[0].finding, Some(fault.clone()), "{:?}", evidence_file.reasons);
    assert!(evidence_file.pairs.is_empty() && evidence_file.alone.is_empty(), "nothing was run");
    // The check of the folder names the same.
    let views = bench.pipeline.record().version_table().store().views().unwrap();
    let candidate = bench.pipeline.record().capability(&id).unwrap();
    let versions = RegisteredVersions::of(&*views).unwrap();
    let named = versions.cell_faults(&candidate);
    assert_eq!((named.len(), &named[0].finding), (1, &Some(fault)));
    assert_eq!((versions.recovery(&candidate), versions.unmet_fallback(&candidate)), (Vec::new(), None));
}

#[test]
fn a_fallback_that_was_never_registered_is_the_author_s_fault() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let live = bench.pipeline.live();
    for package in [with_fallback("grasp", "^9"), with_fallback("push", "^1")] {
        let candidate = Capability::load("test", package).unwrap();
        let found = validation::assess(live.context, live.record.version_table(), &candidate);
        let recovery = found.kappas.recovery;
        assert_eq!(recovery.outcome, RecoveryOutcome::Incompatible);
        assert_eq!(recovery.reasons[0].code, ReasonCode::RecoveryFallbackUnresolved);
    }
}

/// Regression: a second version of the fallback passed the check, and was rejected because it binds no fallback.
#[test]
fn a_version_of_the_fallback_is_refused_at_its_registration() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let package = package("park/1.0.0", "version = \"1.0.0\"", "version = \"2.0.0\"");
    let id = Capability::load("test", package.clone()).unwrap().id();
    let reply = bench.pipeline.command(Command::Register { package, name: "park-2".to_owned(), by: None });
    let Reply::Refused { code, hint, .. } = reply else { panic!("{reply:?}") };
    assert_eq!(code, Refusal::BadInput);
    assert!(hint.is_some());
    assert!(bench.pipeline.record().version_table().version(&id).is_err(), "nothing is registered");
}

#[test]
fn a_zone_that_the_cell_does_not_have_is_refused_at_the_registration() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let package = package("candidates/align-improved", "zones = [\"work\"", "zones = [\"shelf\"");
    let reply = bench.pipeline.command(Command::Register { package, name: "shelf".to_owned(), by: None });
    let Reply::Refused { code, text, .. } = reply else { panic!("{reply:?}") };
    assert_eq!(code, Refusal::BadInput);
    assert!(text.contains("\"shelf\""), "{text}");
}
