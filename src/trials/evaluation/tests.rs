//! Evaluations of whole versions, on calibration seeds: in turns, in parts, and lost early.

use super::*;
use crate::cell::Cell;
use crate::pair_spot::PairSpot;
use crate::seeds::CALIBRATION_FROM_RUN;
use crate::sequences::TrialTeam;
use crate::undisturbed_run::UndisturbedCache;
use crate::worker::Worker;
use crate::worker_pool::WorkerPool;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::evidence::HardStop;
use holdpoint_governance::finding::Finding;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::outcome::{BehaviorOutcome, RecoveryOutcome};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::recovery::DrillContrast;
use holdpoint_governance::tries::TryAuthor;
use holdpoint_registry::Store;
use holdpoint_runtime::capability::{self, Capability};
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_sim::SimCells;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

fn small() -> Profile {
    let mut profile = Profile::builtin(ProfileName::Sim).unwrap();
    profile.evaluation.sandbox_pairs = 50;
    profile.evaluation.drills_per_kind = 20;
    profile.evaluation.sandbox_sequences = 0;
    profile
}

fn binding() -> EvidenceBinding {
    let digest = Digest::of_parts("test", &[]);
    EvidenceBinding {
        candidate: digest,
        active: None,
        profile: digest,
        policy: digest,
        environment: digest,
        neighbours: None,
        anchor: None,
    }
}

/// A version from its folder under `manifests/`, with other texts in its package.
fn version(folder: &str, changes: &[(&str, &str)]) -> Capability {
    let mut package = capability::read(&Path::new(crate::MANIFESTS).join(folder)).unwrap();
    for (from, to) in changes {
        assert!(package.params.contains(from), "{folder} has no {from}");
        package.params = package.params.replacen(from, to, 1);
    }
    Capability::load(folder, package).unwrap()
}

/// Both versions on calibration seeds, from their folders under `manifests/`.
fn evaluate(candidate: &str, active: &str, profile: &Profile) -> (Evaluation, Vec<WorkUnit>) {
    evaluate_in_parts(candidate, active, profile, usize::MAX)
}

fn evaluate_in_parts(
    candidate: &str,
    active: &str,
    profile: &Profile,
    part: usize,
) -> (Evaluation, Vec<WorkUnit>) {
    evaluate_versions(&version(candidate, &[]), &version(active, &[]), profile, (part, 1))
}

fn evaluate_versions(
    candidate: &Capability,
    active: &Capability,
    profile: &Profile,
    at: (usize, u64),
) -> (Evaluation, Vec<WorkUnit>) {
    evaluate_beside(candidate, active, &[], profile, at)
}

fn evaluate_beside(
    candidate: &Capability,
    active: &Capability,
    beside: &[Capability],
    profile: &Profile,
    at: (usize, u64),
) -> (Evaluation, Vec<WorkUnit>) {
    evaluate_against([candidate, active], None, beside, profile, at)
}

/// Both versions, with an anchor to compare with as well or without.
fn evaluate_against(
    versions: [&Capability; 2],
    anchor: Option<&Capability>,
    beside: &[Capability],
    profile: &Profile,
    at: (usize, u64),
) -> (Evaluation, Vec<WorkUnit>) {
    evaluate_try(versions, anchor, beside, profile, at, (None, false))
}

/// The same, as a counted try or without. `leaves`: with the first sequences, the versions beside it lose their places.
fn evaluate_try(
    versions: [&Capability; 2],
    anchor: Option<&Capability>,
    beside: &[Capability],
    profile: &Profile,
    (part, seed): (usize, u64),
    (counted, leaves): (Option<CountedTry>, bool),
) -> (Evaluation, Vec<WorkUnit>) {
    let [candidate, active] = versions;
    let cell = Cell::of(&SimCells, None).unwrap();
    let table = Arc::new(PolicyTable::builtin(profile).unwrap());
    let terms = SkillTerms::new(profile, table, cell.geometry.clone(), cell.zones.clone());
    let party = |version: &Capability| TrialSubject {
        version: version.clone(),
        terms: terms.clone(),
        fallback: Some(self::version("park/1.0.0", &[])),
    };
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path()).unwrap();
    let cancel = AtomicBool::new(false);
    let mut lab = TrialLab {
        seeds: crate::seeds::SeedSource::OfRun(CALIBRATION_FROM_RUN + seed),
        worker_pool: &WorkerPool::new(2),
        undisturbed: &Arc::new(UndisturbedCache::new()),
        part,
        cancel: &cancel,
        cell: &cell,
        cache: store.result_cache(),
        team: TrialTeam::excluding(&cell.spec.tasks, active.bundle.task(), beside.iter().map(party)),
        anchor: anchor.map(party),
    };
    let (candidate, active) = (party(candidate), party(active));
    let plan = EvaluationPlan::sandbox(profile).with_anchor(anchor.is_some());
    let plan = counted.as_ref().map_or(plan, |counted| plan.with_pairs(counted.pairs));
    let mut evaluation = Evaluation::new(plan, binding(), SceneStops::default());
    evaluation.counted = counted;
    let mut order = Vec::new();
    while evaluation.ended().is_none() {
        let step = evaluation.step(&lab, &candidate, &active, profile).unwrap();
        order.extend(step.map(|slice| slice.what));
        if leaves && order.last() == Some(&WorkUnit::WholeSequences) {
            lab.team = TrialTeam::default();
        }
        assert!(order.len() < 1_000, "it does not end");
    }
    (evaluation, order)
}

#[test]
fn pairs_and_drills_alternate_until_the_budget_is_used() {
    let profile = small();
    let (evaluation, order) = evaluate("align/1.0.0", "align/1.0.0", &profile);
    assert_eq!(evaluation.ended(), Some(EarlyStopReason::Full));
    let pairs = evaluation.paired().pairs;
    assert_eq!(pairs.len(), 50);
    assert!(pairs.iter().all(|pair| pair.active == pair.candidate), "one version against itself");
    assert_eq!(pairs.iter().filter(|pair| pair.live_like).count(), 17, "a third, rounded up");
    let rehearsed = evaluation.rehearsed();
    assert_eq!(evaluation.done(), evaluation.plan.budget());
    for kind in DrillKind::ALL {
        assert!(rehearsed.candidate.of(kind).feasible() >= 20, "{kind:?}");
    }
    use WorkUnit::{FallbackDrills, PairedEpisodes, RollbackDrills};
    let first = [PairedEpisodes, RollbackDrills, PairedEpisodes, FallbackDrills];
    assert_eq!(order[..4], first);
    assert_eq!(order.iter().filter(|what| **what == WorkUnit::PairedEpisodes).count(), 3);
}

#[test]
fn evaluation_of_a_candidate_that_cannot_stop_ends_early() {
    let profile = small();
    let (evaluation, _) = evaluate("candidates/align-no-stop", "align/1.0.0", &profile);
    assert!(matches!(
        evaluation.ended(),
        Some(
            EarlyStopReason::HardStop | EarlyStopReason::Curtailed | EarlyStopReason::FinitePopulation { .. }
        )
    ));
    assert!(evaluation.done() < evaluation.plan.budget(), "{} done", evaluation.done());
    let (_, recovery) = evaluation.assess(&profile);
    assert_eq!(recovery.assessment.outcome, RecoveryOutcome::Incompatible);
}

/// Gives up before its hand is at the object, as every grasp of a robot does that cannot reach it.
const HASTY: (&str, &str) = ("timeout_secs = 7.0", "timeout_secs = 1.0");

#[test]
fn active_version_that_cannot_be_drilled_does_not_reject_a_candidate() {
    let (candidate, active) = (version("grasp/1.0.0", &[]), version("grasp/1.0.0", &[HASTY]));
    let (evaluation, _) = evaluate_versions(&candidate, &active, &small(), (usize::MAX, 1));
    let (_, recovery) = evaluation.assess(&small());
    assert_eq!(recovery.assessment.outcome, RecoveryOutcome::NoData, "{:?}", recovery.assessment.reasons);
    let fault = Some(Finding::ActiveUndrillable { drill: DrillKind::Rollback });
    assert!(recovery.assessment.reasons.iter().any(|reason| reason.finding == fault));
    // The same drills reject it where they are counted against it alone.
    let ended = evaluation.ended().unwrap();
    let alone = recovery::assess_early_stop(&evaluation.rehearsed(), &binding(), &small(), ended);
    assert_eq!(alone.assessment.outcome, RecoveryOutcome::Incompatible, "{:?}", evaluation.rehearsed());
}

#[test]
fn the_anchor_runs_the_seeds_of_the_pairs_after_them() {
    let mut profile = small();
    profile.evaluation.sandbox_pairs = 20;
    profile.evaluation.drills_per_kind = 10;
    let (same, better) = (version("align/1.0.0", &[]), version("candidates/align-improved", &[]));
    let (evaluation, order) = evaluate_against([&same, &same], Some(&same), &[], &profile, (usize::MAX, 1));
    assert_eq!(order.iter().filter(|what| **what == WorkUnit::AnchorEpisodes).count(), 1, "{order:?}");
    assert_eq!(evaluation.done(), evaluation.plan.budget());
    let anchored: Vec<_> =
        evaluation.anchor().unwrap().episodes.iter().map(|of| (of.seed, of.values)).collect();
    let paired: Vec<_> = evaluation.paired().pairs.iter().map(|pair| (pair.seed, pair.active)).collect();
    assert_eq!(anchored, paired, "it is the active version");
    assert_ne!(evaluation.assess(&profile).0.assessment.outcome, BehaviorOutcome::Incompatible);
    // A candidate as bad as the active version is worse than the anchor, and nothing more is run for it.
    profile.evaluation.sandbox_pairs = 60;
    let (evaluation, order) = evaluate_against([&same, &same], Some(&better), &[], &profile, (usize::MAX, 1));
    assert_eq!(order.last(), Some(&WorkUnit::AnchorEpisodes), "{order:?}");
    let (behavior, _) = evaluation.assess(&profile);
    assert_eq!(behavior.assessment.outcome, BehaviorOutcome::Incompatible);
    assert_eq!(behavior.assessment.reasons[0].code, ReasonCode::BehaviorAnchorWorse);
}

/// Regression: an open margin ended the evaluation before the rest of it, so that no try had a second look.
#[test]
fn an_open_try_has_its_second_look_after_the_rest() {
    let mut profile = small();
    profile.evaluation.drills_per_kind = 10;
    profile.evaluation.sandbox_sequences = 2;
    // Without a difference, 30 pairs exclude a loss of 10.4 of 100, and 90 pairs one of 4.8.
    let counted = CountedTry {
        subject: Digest::of_parts("test", &[]),
        drawn: None,
        author: TryAuthor::default(),
        by_author: 1,
        in_family: 1,
        level: 0.05,
        pairs: 30,
        left: 11,
    };
    let same = version("align/1.0.0", &[]);
    let team = [version("grasp/1.0.0", &[]), version("place/1.0.0", &[])];
    // Without a place, no sequence can run.
    for beside in [&team[..], &team[..1]] {
        let at = (usize::MAX, 1);
        let (evaluation, order) =
            evaluate_try([&same, &same], Some(&same), beside, &profile, at, (Some(counted.clone()), false));
        assert_eq!(evaluation.ended(), Some(EarlyStopReason::Full));
        let pairs = evaluation.paired().pairs;
        assert_eq!((pairs.len(), counted.second_look()), (90, 90), "{order:?}");
        // One without a result is replaced by a live-like one.
        let live_like = |pairs: &[Pair]| pairs.iter().filter(|pair| pair.live_like).count();
        assert!((10..13).contains(&live_like(&pairs[..30])) && (30..34).contains(&live_like(&pairs)));
        assert_eq!(evaluation.anchor().unwrap().episodes.len(), 90, "{order:?}");
        let place = |of: WorkUnit| order.iter().position(|what| *what == of).unwrap();
        let later = order.iter().rposition(|what| *what == WorkUnit::PairedEpisodes).unwrap();
        assert!(place(WorkUnit::AnchorEpisodes) < later, "{order:?}");
        let is_open = |evaluation: &Evaluation| {
            let (behavior, _) = evaluation.assess(&profile);
            behavior.assessment.reasons.iter().any(|reason| reason.code == ReasonCode::BehaviorTryOpen)
        };
        assert!(!is_open(&evaluation), "{:?}", evaluation.assess(&profile).0.assessment);
        assert_eq!(evaluation.done(), evaluation.plan.budget());
        if beside.len() == team.len() {
            assert!(place(WorkUnit::WholeSequences) < later, "{order:?}");
        }
    }
}

#[test]
fn a_third_of_the_pairs_is_live_like_at_places_that_a_seed_chooses() {
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let plan = EvaluationPlan::sandbox(&profile);
    let of_seeds: Vec<Vec<bool>> = (0..50).map(|seed| plan.live_like_places(seed)).collect();
    for places in &of_seeds {
        assert_eq!((places.len(), places.iter().filter(|place| **place).count()), (300, 100));
    }
    assert_ne!(of_seeds[0], of_seeds[1]);
    // Five standard deviations of 50 in three to either side.
    let often = |place: usize| of_seeds.iter().filter(|places| places[place]).count();
    assert!((0..300).all(|place| (1..=33).contains(&often(place))));
    assert_eq!(EvaluationPlan::confirmation(&profile).live_like, 100);
    assert_eq!(plan.with_pairs(460).live_like, 154, "a third of the pairs of a later try");
    assert!(!EvaluationPlan::re_evaluation(&profile).live_like_places(0).contains(&true));
}

#[test]
fn live_like_pairs_begin_where_the_team_leaves_the_task() {
    let mut profile = small();
    profile.evaluation.sandbox_pairs = 20;
    profile.evaluation.drills_per_kind = 10;
    let beside = [version("grasp/1.0.0", &[]), version("place/1.0.0", &[])];
    let align = version("align/1.0.0", &[]);
    let (evaluation, _) = evaluate_beside(&align, &align, &beside, &profile, (usize::MAX, 1));
    let pairs = evaluation.paired().pairs;
    let cell = Cell::of(&SimCells, None).unwrap();
    let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
    let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
    let subject = |version: &Capability| TrialSubject {
        version: version.clone(),
        terms: terms.clone(),
        fallback: None,
    };
    let team = TrialTeam::excluding(&cell.spec.tasks, align.bundle.task(), beside.iter().map(subject));
    let align = subject(&align);
    let mut worker = Worker::new();
    for pair in &pairs {
        let spot = PairSpot { seed: pair.seed, live_like: pair.live_like };
        let record = spot.run(&mut worker, &cell, &team, &align);
        assert_eq!((record.seed, record.values()), (pair.seed, Some(pair.active)), "{spot:?}");
        let other = PairSpot { live_like: !pair.live_like, ..spot };
        assert_ne!(spot.scenario(&cell, &team, &align), other.scenario(&cell, &team, &align));
        // The versions before it are part of what determines a live-like one.
        let alone = spot.scenario(&cell, &TrialTeam::default(), &align);
        assert_eq!(alone != spot.scenario(&cell, &team, &align), pair.live_like);
    }
    assert_eq!(pairs.iter().filter(|pair| pair.live_like).count(), 7);
}

#[test]
fn a_hook_that_fails_is_drilled_until_that_is_settled() {
    let profile = small();
    let (evaluation, order) = evaluate("grasp/1.0.0", "grasp/1.0.0", &profile);
    let rehearsed = evaluation.rehearsed();
    for kind in SETTLED_KINDS {
        let found = DrillContrast::of(kind, &rehearsed);
        assert!((114..124).contains(&found.drills()) && found.paired < 40, "{found:?}");
        assert_eq!((found.failed(), found.active_failed), (0, 0), "one version against itself: {found:?}");
    }
    let (_, late) = order.split_at(order.len() - 16);
    let in_turns = [WorkUnit::RollbackDrills, WorkUnit::AbortDrills].repeat(8);
    assert_eq!(late, in_turns, "they come last, on the same places: {order:?}");
}

#[test]
fn slice_size_changes_no_result() {
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
fn retries_do_not_exceed_the_budget() {
    let mut evaluation = Evaluation::new(EvaluationPlan::sandbox(&small()), binding(), SceneStops::default());
    evaluation.drills_tried = [10, 20, 30, 40];
    // Of rollbacks and aborts more are wanted than of the others.
    assert_eq!((evaluation.tried(), evaluation.done()), (100, 10 + 20 + 30 + 20));
}

#[test]
fn hard_stop_before_the_first_pair_ends_the_evaluation() {
    let evaluation = Evaluation::new(
        EvaluationPlan::sandbox(&small()),
        binding(),
        SceneStops { own: vec![HardStop::MotionAfterStop], ..SceneStops::default() },
    );
    assert_eq!(evaluation.ended(), Some(EarlyStopReason::HardStop));
}

/// What the drills make of variants of the baselines over so many seeds, with few pairs, which are not looked at.
fn recoveries(folder: &str, changes: &[(&str, &str)], seeds: u64) -> Vec<(RecoveryOutcome, Vec<ReasonCode>)> {
    let mut profile = Profile::builtin(ProfileName::Sim).unwrap();
    profile.evaluation.sandbox_pairs = 20;
    profile.evaluation.sandbox_sequences = 0;
    let (candidate, active) = (version(folder, changes), version(folder, &[]));
    let recovery = |seed| {
        let (evaluation, _) = evaluate_versions(&candidate, &active, &profile, (usize::MAX, seed));
        let rehearsed = evaluation.rehearsed();
        let found = recovery::assess_early_stop(
            &rehearsed,
            &binding(),
            &profile,
            evaluation.ended().unwrap_or(EarlyStopReason::Full),
        );
        let assessment = found.assessment;
        (assessment.outcome, assessment.reasons.iter().map(|reason| reason.code).collect())
    };
    (1..=seeds).map(recovery).collect()
}

/// Written down before the run: each is incompatible under every seed.
const BAD_HOOKS: [(&str, (&str, &str)); 5] = [
    ("grasp/1.0.0", ("abort = \"hold\"", "abort = \"release\"")),
    ("place/1.0.0", ("abort = \"hold\"", "abort = \"release\"")),
    ("grasp/1.0.0", ("rollback = \"handover\"", "rollback = \"stay\"")),
    ("align/1.0.0", ("rollback = \"handover\"", "rollback = \"stay\"")),
    ("place/1.0.0", ("rollback = \"handover\"", "rollback = \"stay\"")),
];

/// Written down before the run: none is incompatible, or without evidence, under any seed.
const HONEST: [(&str, (&str, &str)); 5] = [
    ("grasp/1.0.0", ("approach_speed_m_s = 0.35", "approach_speed_m_s = 0.25")),
    ("grasp/1.0.0", ("close_speed_m_s = 0.12", "close_speed_m_s = 0.08")),
    ("grasp/1.0.0", ("approach_height_m = 0.1", "approach_height_m = 0.13")),
    ("grasp/1.0.0", ("settle_secs = 0.1", "settle_secs = 0.25")),
    ("grasp/1.0.0", ("safe_height_m = 0.12", "safe_height_m = 0.15")),
];

fn judge_packages(seeds: u64) {
    for (folder, change) in BAD_HOOKS {
        for (outcome, codes) in recoveries(folder, &[change], seeds) {
            assert_eq!(outcome, RecoveryOutcome::Incompatible, "{folder} {change:?}: {codes:?}");
        }
    }
    for (folder, change) in HONEST {
        for (outcome, codes) in recoveries(folder, &[change], seeds) {
            let passes = !matches!(outcome, RecoveryOutcome::Incompatible | RecoveryOutcome::NoData);
            assert!(passes, "{folder} {change:?}: {outcome:?} {codes:?}");
            let in_a_phase = |code: &ReasonCode| {
                matches!(code, ReasonCode::RecoveryPhaseFailing | ReasonCode::RecoveryPhaseWorse)
            };
            assert!(!codes.iter().any(in_a_phase), "{folder} {change:?}: {codes:?}");
        }
    }
}

/// Under one seed, or as many as `HOLDPOINT_JUDGED_SEEDS` says: ten evaluations each.
#[test]
fn packages_with_bad_hooks_fail_and_honest_ones_pass() {
    let seeds = std::env::var("HOLDPOINT_JUDGED_SEEDS").ok().and_then(|text| text.parse().ok());
    judge_packages(seeds.unwrap_or(1));
}

/// An align that trusts the object to hang in the middle of the hand.
const TRUSTING: (&str, &str) = ("measure_pictures = 4", "measure_pictures = 0");

/// Holds the object 22 mm above its middle, where the baseline holds it 6 mm above.
const HIGH: (&str, &str) = ("grasp_offset_m = 0.006", "grasp_offset_m = 0.022");

fn with_sequences() -> Profile {
    let mut profile = small();
    profile.evaluation.sandbox_pairs = 150;
    profile.evaluation.drills_per_kind = 40;
    profile.evaluation.sandbox_sequences = 40;
    profile
}

/// A grasp that holds the object high, and what its whole sandbox says of it beside an align.
fn held_high(align: &[(&str, &str)], part: usize) -> (Evaluation, Vec<WorkUnit>) {
    let beside = [version("align/1.0.0", align), version("place/1.0.0", &[])];
    let (candidate, active) = (version("grasp/1.0.0", &[HIGH]), version("grasp/1.0.0", &[]));
    evaluate_beside(&candidate, &active, &beside, &with_sequences(), (part, 1))
}

#[test]
fn a_handover_that_is_bad_for_the_next_skill_alone_is_found_by_sequences() {
    let profile = with_sequences();
    let (evaluation, order) = held_high(&[TRUSTING], usize::MAX);
    let own = behavior::assess_early_stop(&evaluation.paired(), &binding(), &profile, EarlyStopReason::Full);
    assert_eq!(own.assessment.outcome, BehaviorOutcome::Compatible, "{:?}", own.assessment.reasons);
    let sequences = evaluation.sequences().unwrap();
    assert_eq!((sequences.pairs.len(), sequences.beside.len()), (40, 2));
    let first = order.iter().position(|what| *what == WorkUnit::WholeSequences).unwrap();
    assert!(order[first..].iter().all(|what| *what == WorkUnit::WholeSequences), "they come last: {order:?}");
    assert_eq!(evaluation.done(), evaluation.plan.budget());
    let (found, _) = evaluation.assess(&profile);
    assert_eq!(found.assessment.outcome, BehaviorOutcome::Incompatible);
    let reason = &found.assessment.reasons[0];
    assert_eq!(reason.code, ReasonCode::BehaviorSequenceWorse);
    let ends = match &reason.finding {
        Some(Finding::SequenceWorse { ends, .. }) => ends.unwrap(),
        other => panic!("{other:?}"),
    };
    assert_eq!((ends.task, ends.is_next), (holdpoint_body::TaskKind::Align, true));

    let (parts, _) = held_high(&[TRUSTING], 3);
    assert_eq!(parts.sequences(), evaluation.sequences(), "parts of a slice change no result");
}

#[test]
fn a_handover_that_the_next_skill_corrects_passes() {
    let (evaluation, _) = held_high(&[], usize::MAX);
    let (found, _) = evaluation.assess(&with_sequences());
    assert_eq!(found.assessment.outcome, BehaviorOutcome::Compatible, "{:?}", found.assessment.reasons);
    assert!(!found.sequences.is_empty());
}

#[test]
fn no_sequence_runs_for_a_rejected_candidate_or_an_empty_place() {
    let mut profile = with_sequences();
    profile.evaluation.sandbox_pairs = 50;
    let slam = ("close_speed_m_s = 0.12", "close_speed_m_s = 0.6");
    let beside = [version("align/1.0.0", &[]), version("place/1.0.0", &[])];
    let (candidate, active) = (version("grasp/1.0.0", &[slam]), version("grasp/1.0.0", &[]));
    let (evaluation, _) = evaluate_beside(&candidate, &active, &beside, &profile, (usize::MAX, 1));
    let (found, _) = evaluation.assess(&profile);
    assert_eq!(found.assessment.outcome, BehaviorOutcome::Incompatible);
    assert_eq!(evaluation.sequences(), None);

    let profile = with_sequences();
    let (evaluation, _) = evaluate_beside(&active, &active, &beside[..1], &profile, (usize::MAX, 1));
    assert_eq!(evaluation.ended(), Some(EarlyStopReason::Full));
    let (found, _) = evaluation.assess(&profile);
    assert_eq!(found.assessment.outcome, BehaviorOutcome::Suspicious);
    let reason = &found.assessment.reasons[0];
    assert_eq!(reason.code, ReasonCode::BehaviorSequenceSuspicious);
    assert_eq!(reason.finding, Some(Finding::SequencesNotRun));
}

/// Regression: the evaluation ran slices without work, and without an end.
#[test]
fn a_team_that_loses_its_places_ends_the_sequences() {
    let mut profile = small();
    profile.evaluation.sandbox_pairs = 20;
    profile.evaluation.drills_per_kind = 10;
    profile.evaluation.sandbox_sequences = 20;
    let same = version("align/1.0.0", &[]);
    let team = [version("grasp/1.0.0", &[]), version("place/1.0.0", &[])];
    let at = (usize::MAX, 1);
    let (evaluation, order) = evaluate_try([&same, &same], None, &team, &profile, at, (None, true));
    assert_eq!(order.iter().filter(|what| **what == WorkUnit::WholeSequences).count(), 2, "{order:?}");
    assert_eq!(evaluation.ended(), Some(EarlyStopReason::Full));
    assert!(evaluation.sequences().unwrap().pairs.is_empty(), "they were of another team");
    let (found, _) = evaluation.assess(&profile);
    let not_run = Some(Finding::SequencesNotRun);
    assert!(found.assessment.reasons.iter().any(|reason| reason.finding == not_run), "{found:?}");
}

/// Seconds of processor time that this process has used, where the system tells it.
fn processor_secs() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    after.skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// What sequences add to the cost of a whole evaluation but for its search, family by family, with nothing kept; where
/// `HOLDPOINT_SEQUENCE_COST` asks for it.
#[test]
fn sequences_cost_is_measured_on_request() {
    if std::env::var("HOLDPOINT_SEQUENCE_COST").is_err() {
        return;
    }
    let all = ["grasp/1.0.0", "align/1.0.0", "place/1.0.0"].map(|folder| version(folder, &[]));
    let better = ["grasp-improved", "align-improved", "place-robust"];
    for (own, better) in all.iter().zip(better) {
        let candidate = version(&format!("candidates/{better}"), &[]);
        let seconds = |sequences| {
            let mut profile = Profile::builtin(ProfileName::Sim).unwrap();
            profile.evaluation.sandbox_sequences = sequences;
            let begun = processor_secs();
            evaluate_beside(&candidate, own, &all, &profile, (usize::MAX, 1));
            processor_secs() - begun
        };
        let (without, with) = (seconds(0), seconds(50));
        println!("{}: {without:.2} s without, {with:.2} s with 50", own.id());
    }
}

/// Regression: drills of one kind were counted against the budget of all kinds of work.
#[test]
fn every_kind_of_work_counts_against_its_own_budget() {
    let plan = EvaluationPlan::sandbox(&Profile::builtin(ProfileName::Sim).unwrap());
    let (candidate, active) = (DrillTallies::default(), DrillTallies::default());
    let mut progress = EvaluationProgress {
        pairs: 0,
        pairs_tried: 0,
        drills: RecoveryEvidence {
            binding: binding(),
            candidate,
            active,
            settling: SettlingTallies::default(),
        },
        drills_tried: [0; DrillKind::ALL.len()],
        anchored: 0,
        sequences: 0,
        sequences_tried: 0,
        turns: 0,
    };
    let mut ended = Vec::new();
    while let Some(slice) = progress.next(&plan).filter(|slice| !slice.is_late()) {
        progress.suppose(&plan, slice);
        let part = progress.part(&plan, slice);
        assert!(part.done > 0 && part.done <= part.budget, "{slice:?}: {part:?}");
        assert!(part.budget < plan.budget(), "{slice:?}: {part:?}");
        if part.done == part.budget {
            ended.push((slice, part.budget));
        }
    }
    assert!(ended.contains(&(NextSlice::Pairs, u64::from(plan.pairs))), "{ended:?}");
    for kind in DrillKind::ALL {
        assert!(ended.contains(&(NextSlice::Drills(kind), u64::from(plan.drills))), "{ended:?}");
    }
}
