//! Evaluations of whole versions, on calibration seeds: in turns, in parts, and lost early.

use super::*;
use crate::cell::Cell;
use crate::trial::crew::Crew;
use crate::trial::seeds::CALIBRATION_FROM_RUN;
use crate::trial::undisturbed::Shelf;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::ProfileName;
use holdpoint_registry::Store;
use holdpoint_runtime::capability::{self, Capability};
use holdpoint_runtime::terms::SkillTerms;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

fn small() -> Profile {
    let mut profile = Profile::builtin(ProfileName::Sim).unwrap();
    profile.evaluation.sandbox_pairs = 50;
    profile.evaluation.drills_per_kind = 20;
    profile
}

fn binding() -> Binding {
    let digest = Digest::of_parts("test", &[]);
    Binding { candidate: digest, active: None, profile: digest, policy: digest, environment: digest }
}

/// Both versions on calibration seeds, from their folders under `manifests/`.
fn evaluate(candidate: &str, active: &str, profile: &Profile) -> (Evaluation, Vec<String>) {
    evaluate_in_parts(candidate, active, profile, usize::MAX)
}

fn evaluate_in_parts(
    candidate: &str,
    active: &str,
    profile: &Profile,
    part: usize,
) -> (Evaluation, Vec<String>) {
    let cell = Cell::builtin().unwrap();
    let table = Arc::new(PolicyTable::builtin(profile).unwrap());
    let terms = SkillTerms::new(profile, table, cell.geometry.clone(), cell.zones.clone());
    let party = |folder: &str| {
        let manifests = Path::new(crate::MANIFESTS);
        let path = manifests.join(folder);
        let version = Capability::load(folder, capability::read(&path).unwrap()).unwrap();
        let park = Capability::load("park", capability::read(&manifests.join("park/1.0.0")).unwrap());
        Party { version, terms: terms.clone(), fallback: park.ok() }
    };
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path()).unwrap();
    let cancel = AtomicBool::new(false);
    let lab = Lab {
        seed: CALIBRATION_FROM_RUN + 1,
        crew: &Crew::new(2),
        undisturbed: &Arc::new(Shelf::new()),
        part,
        cancel: &cancel,
        cell: &cell,
        cells: store.cells(),
    };
    let (candidate, active) = (party(candidate), party(active));
    let mut evaluation = Evaluation::new(Plan::sandbox(profile), binding(), Vec::new());
    let mut order = Vec::new();
    while evaluation.ended().is_none() {
        let step = evaluation.step(&lab, &candidate, &active, profile).unwrap();
        order.extend(step.map(|slice| slice.what));
    }
    (evaluation, order)
}

#[test]
fn pairs_and_drills_take_turns_until_the_budget_is_worked() {
    let profile = small();
    let (evaluation, order) = evaluate("align/1.0.0", "align/1.0.0", &profile);
    assert_eq!(evaluation.ended(), Some(EndReason::Full));
    let pairs = evaluation.paired().pairs;
    assert_eq!(pairs.len(), 50);
    assert!(pairs.iter().all(|pair| pair.active == pair.candidate), "one version against itself");
    let rehearsed = evaluation.rehearsed();
    assert_eq!(evaluation.done(), evaluation.plan.budget());
    for kind in DrillKind::ALL {
        assert!(rehearsed.candidate.of(kind).feasible() >= 20, "{kind:?}");
    }
    let first = ["paired episodes", "rollback drills", "paired episodes", "fallback drills"];
    assert_eq!(order[..4], first);
    assert_eq!(order.iter().filter(|what| *what == "paired episodes").count(), 3);
}

#[test]
fn a_candidate_that_cannot_stop_is_lost_early() {
    let profile = small();
    let (evaluation, _) = evaluate("candidates/align-no-stop", "align/1.0.0", &profile);
    assert!(matches!(
        evaluation.ended(),
        Some(EndReason::HardStop | EndReason::Curtailed | EndReason::FinitePopulation { .. })
    ));
    assert!(evaluation.done() < evaluation.plan.budget(), "{} done", evaluation.done());
    let (_, recovery) = evaluation.assess(&profile);
    assert_eq!(recovery.assessment.outcome, holdpoint_governance::outcome::RecoveryOutcome::Incompatible);
}

#[test]
fn parts_of_a_slice_change_no_result() {
    let mut profile = small();
    profile.evaluation.sandbox_pairs = 20;
    profile.evaluation.drills_per_kind = 10;
    let (whole, order) = evaluate("align/1.0.0", "align/1.0.0", &profile);
    let (parts, same) = evaluate_in_parts("align/1.0.0", "align/1.0.0", &profile, 3);
    assert_eq!(order, same);
    assert_eq!(whole.paired(), parts.paired());
    assert_eq!(whole.rehearsed(), parts.rehearsed());
}

#[test]
fn what_is_tried_again_does_not_exceed_the_budget() {
    let mut evaluation = Evaluation::new(Plan::sandbox(&small()), binding(), Vec::new());
    evaluation.drills_tried = [10, 20, 30, 40];
    assert_eq!((evaluation.tried(), evaluation.done()), (100, 10 + 3 * 20));
}

#[test]
fn a_hard_stop_before_the_first_pair_ends_it() {
    let evaluation = Evaluation::new(Plan::sandbox(&small()), binding(), vec![HardStop::MotionAfterStop]);
    assert_eq!(evaluation.ended(), Some(EndReason::HardStop));
}
