//! The anchor, the loss of success that rejects, and drills that settle: rules of version 2.

use std::collections::BTreeMap;

use holdpoint_governance::behavior;
use holdpoint_governance::comparison_evidence::ComparisonEvidence;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::early_stop::EarlyStopReason;
use holdpoint_governance::evidence::{
    AnchorEpisode, AnchorEvidence, DrillKind, EpisodeValues, PairedEvidence, RecoveryEvidence,
};
use holdpoint_governance::outcome::{BehaviorOutcome, RecoveryOutcome};
use holdpoint_governance::profile::{Profile, ProfileName, RecoverySettings};
use holdpoint_governance::recovery::{
    DrillContrast, SETTLED_DRILLS_MAX, SETTLED_KINDS, Settlement, clean_drills,
};
use holdpoint_governance::stats::{PairedCounts, binary_pairs};

use crate::fixture::{GOOD, Uniform, binding, comparison, pairs, profile, recovery};

const FAILED: EpisodeValues = EpisodeValues { success: false, recovery: true, ..GOOD };

fn anchor(episodes: impl IntoIterator<Item = (u64, EpisodeValues)>) -> AnchorEvidence {
    let episodes = episodes.into_iter().map(|(seed, values)| AnchorEpisode { seed, values }).collect();
    AnchorEvidence { version: "grasp@1.0.0".parse().unwrap(), episodes }
}

fn failing(profile: &Profile, active: usize, candidate: usize) -> PairedEvidence {
    let mut evidence = pairs(profile);
    evidence.pairs.iter_mut().take(active).for_each(|pair| pair.active = FAILED);
    evidence.pairs.iter_mut().take(candidate).for_each(|pair| pair.candidate = FAILED);
    evidence
}

#[test]
fn a_lost_success_is_no_recovery_as_well() {
    let profile = profile(ProfileName::Sim);
    let found = behavior::assess(&failing(&profile, 0, 12), &binding(), &profile);
    let worsening = |name| found.components.iter().find(|one| one.name == name).unwrap().worsening;
    assert!((worsening(behavior::ComponentName::Success) - 0.04).abs() < 1e-12);
    assert!(worsening(behavior::ComponentName::Recovery).abs() < 1e-12);
}

#[test]
fn five_points_of_success_reject_and_four_do_not() {
    for name in ProfileName::ALL {
        let profile = profile(name);
        let budget = profile.evaluation.sandbox_pairs;
        // The fewest pairs of which as many are 5 of 100.
        let loss_max = profile.behavior.success_loss_max;
        let limit = (1..budget).find(|lost| f64::from(*lost) >= loss_max * f64::from(budget)).unwrap();
        for (lost, rejects) in [(4 * limit / 5, false), (limit - 1, false), (limit, true), (2 * limit, true)]
        {
            let (lost, points) = (usize::try_from(lost).unwrap(), lost);
            let evidence = failing(&profile, 0, lost);
            let found = behavior::assess(&evidence, &binding(), &profile).assessment;
            assert_eq!(found.outcome == BehaviorOutcome::Incompatible, rejects, "{name} {points}: {found:?}");
            // Exact curtailment says the same as soon as the rest cannot matter.
            assert_eq!(behavior::is_lost(&evidence, &binding(), &profile), rejects, "{name} {points}");
        }
    }
}

fn against(evidence: &PairedEvidence, anchor: Option<&AnchorEvidence>, profile: &Profile) -> BehaviorOutcome {
    let drills = recovery([100; 4], [100; 4]);
    let all = ComparisonEvidence { has_anchor: anchor.is_some(), anchor, ..comparison(evidence, &drills) };
    let (found, _) = all.assess(&binding(), EarlyStopReason::Full, profile);
    let named = found.assessment.reasons.iter().any(|reason| {
        matches!(reason.code, ReasonCode::BehaviorAnchorWorse | ReasonCode::BehaviorAnchorSuspicious)
    });
    assert!(!named || anchor.is_some());
    found.assessment.outcome
}

#[test]
fn losses_against_the_anchor_do_not_add_up() {
    let profile = profile(ProfileName::Sim);
    // The active version lost 12 of 300 already, the candidate 12 others: 4 points and 4 points.
    let mut evidence = failing(&profile, 12, 12);
    evidence.pairs.iter_mut().rev().take(12).for_each(|pair| pair.candidate = FAILED);
    let whole = anchor(evidence.pairs.iter().map(|pair| (pair.seed, GOOD)));
    assert_ne!(against(&evidence, None, &profile), BehaviorOutcome::Incompatible);
    assert_eq!(against(&evidence, Some(&whole), &profile), BehaviorOutcome::Incompatible);
    // An anchor that is as bad is no reason.
    let bad = anchor(evidence.pairs.iter().map(|pair| (pair.seed, pair.candidate)));
    assert_ne!(against(&evidence, Some(&bad), &profile), BehaviorOutcome::Incompatible);
    // An anchor that was not run is missing evidence.
    let drills = recovery([100; 4], [100; 4]);
    let missing = ComparisonEvidence { has_anchor: true, ..comparison(&evidence, &drills) };
    let (found, _) = missing.assess(&binding(), EarlyStopReason::Full, &profile);
    assert_eq!(found.assessment.outcome, BehaviorOutcome::Inconclusive);
    // One episode of it missing is, too.
    let short = anchor(evidence.pairs.iter().skip(1).map(|pair| (pair.seed, GOOD)));
    assert_eq!(against(&evidence, Some(&short), &profile), BehaviorOutcome::Inconclusive);
}

fn contrast(paired: u32, candidate_failed: u32, active_failed: u32) -> DrillContrast {
    let kind = DrillKind::Abort;
    DrillContrast { kind, paired, candidate_failed, active_failed, alone: 0, alone_failed: 0 }
}

#[test]
fn drills_are_settled() {
    let profile = profile(ProfileName::Sim);
    let clean = clean_drills(&profile.recovery);
    assert_eq!(clean, 114, "one failure in 50 has a chance of .9 to show");
    for (drills, candidate, active, settlement) in [
        (40, 0, 0, Settlement::Open),
        (clean, 0, 0, Settlement::Clean),
        (clean, 0, 9, Settlement::Clean),
        (40, 1, 0, Settlement::Open),
        (clean, 1, 0, Settlement::Open),
        (60, 5, 0, Settlement::Open),
        (60, 6, 0, Settlement::Worse),
        (300, 1, 0, Settlement::NotWorse),
        (SETTLED_DRILLS_MAX, 4, 0, Settlement::Held),
        // Both fail as often: not worse, whatever the number.
        (SETTLED_DRILLS_MAX, 9, 9, Settlement::NotWorse),
    ] {
        let found = contrast(drills, candidate, active);
        assert_eq!(found.settlement(&profile.recovery), settlement, "{found:?}");
    }
    let evidence = pairs(&profile);
    let assess = |failed: u32, drills: u32| {
        let mut tallies: RecoveryEvidence = recovery([100; 4], [100; 4]);
        for kind in SETTLED_KINDS {
            for of in [&mut tallies.candidate, &mut tallies.active] {
                of.of_mut(kind).passed = drills;
            }
        }
        let abort = tallies.candidate.of_mut(DrillKind::Abort);
        (abort.passed, abort.failed, abort.failed_alone) = (drills - failed, failed, failed);
        let all = ComparisonEvidence { is_settling: true, ..comparison(&evidence, &tallies) };
        let (_, found) = all.assess(&binding(), EarlyStopReason::Full, &profile);
        (found.assessment.outcome, found.assessment.reasons[0].code)
    };
    assert_eq!(assess(0, clean).0, RecoveryOutcome::Compatible);
    assert_eq!(assess(6, 120), (RecoveryOutcome::Incompatible, ReasonCode::RecoveryEstablishedWorse));
    assert_eq!(assess(5, SETTLED_DRILLS_MAX), (RecoveryOutcome::NoData, ReasonCode::RecoveryUnsettled));
    assert_eq!(assess(0, 40).0, RecoveryOutcome::NoData);
}

/// Each number by which failures are settled changes how they are.
#[test]
fn settling_depends_on_each_number_of_the_profile() {
    let shipped = profile(ProfileName::Sim).recovery;
    let changes: [(RecoverySettings, [u32; 3], Settlement, Settlement); 4] = [
        (
            RecoverySettings { settle_excess_max: 0.05, ..shipped },
            [60, 0, 0],
            Settlement::Open,
            Settlement::Clean,
        ),
        (
            RecoverySettings { settle_worse_alpha: 0.001, ..shipped },
            [60, 6, 0],
            Settlement::Worse,
            Settlement::Open,
        ),
        (
            RecoverySettings { settle_same_alpha: 0.001, ..shipped },
            [300, 1, 0],
            Settlement::NotWorse,
            Settlement::Open,
        ),
        (
            RecoverySettings { settle_held_alpha: 0.05, ..shipped },
            [SETTLED_DRILLS_MAX, 4, 0],
            Settlement::Held,
            Settlement::NotWorse,
        ),
    ];
    for (changed, [drills, candidate, active], before, after) in changes {
        let found = contrast(drills, candidate, active);
        assert_eq!([found.settlement(&shipped), found.settlement(&changed)], [before, after], "{found:?}");
    }
}

/// Drills of one slice, and of the base number.
const SLICE: u32 = 10;
const BASE: u32 = 40;

/// One more drill of both at every contrast, or one more of the candidate alone.
fn drilled(
    all: BTreeMap<[u32; 5], f64>,
    candidate: f64,
    active: f64,
    is_paired: bool,
) -> BTreeMap<[u32; 5], f64> {
    let mut next: BTreeMap<[u32; 5], f64> = BTreeMap::new();
    for ([paired, new, old, alone, failed], share) in all {
        let ends = if is_paired {
            [
                ([paired + 1, new + 1, old, alone, failed], candidate),
                ([paired + 1, new, old + 1, alone, failed], active),
                ([paired + 1, new, old, alone, failed], 1.0 - candidate - active),
            ]
        } else {
            [
                ([paired, new, old, alone + 1, failed + 1], candidate),
                ([paired, new, old, alone + 1, failed], 1.0 - candidate),
                ([0; 5], 0.0),
            ]
        };
        for (counts, chance) in ends {
            if share * chance > 1e-12 {
                *next.entry(counts).or_default() += share * chance;
            }
        }
    }
    next
}

/// How drills of one kind end whose candidate alone fails with one probability and the active version alone with
/// another: worse, held, settled with a failure, clean. Exact: every path of counts with its probability.
fn ends(candidate: f64, active: f64) -> [f64; 4] {
    let settings = profile(ProfileName::Sim).recovery;
    let mut open = BTreeMap::from([([0; 5], 1.0)]);
    for _ in 0..BASE {
        open = drilled(open, candidate, active, true);
    }
    let mut ends = [0.0; 4];
    while !open.is_empty() {
        let (mut pairs, mut alone) = (BTreeMap::new(), BTreeMap::new());
        for (counts, share) in open {
            let [paired, candidate_failed, active_failed, of_alone, alone_failed] = counts;
            let found = DrillContrast {
                alone: of_alone,
                alone_failed,
                ..contrast(paired, candidate_failed, active_failed)
            };
            match found.settlement(&settings) {
                Settlement::Open if found.is_paired_next() => drop(pairs.insert(counts, share)),
                Settlement::Open => drop(alone.insert(counts, share)),
                Settlement::Worse => ends[0] += share,
                Settlement::Held => ends[1] += share,
                Settlement::NotWorse => ends[2] += share,
                Settlement::Clean => ends[3] += share,
            }
        }
        for _ in 0..SLICE {
            pairs = drilled(pairs, candidate, active, true);
            alone = drilled(alone, candidate, active, false);
        }
        open = pairs;
        for (counts, share) in alone {
            *open.entry(counts).or_default() += share;
        }
    }
    ends
}

/// The curve of the guide (design/statistics.md): a hook that fails in 1 of `one_in` places.
#[test]
fn detection_curve_of_failing_hooks() {
    println!("one in  rejected  held  settled  unseen");
    let mut curve = Vec::new();
    for one_in in [10.0, 20.0, 50.0, 100.0, 200.0] {
        let found = ends(1.0 / one_in, 0.0);
        println!("{one_in:6}  {:.3}     {:.3} {:.3}    {:.3}", found[0], found[1], found[2], found[3]);
        assert!((found.iter().sum::<f64>() - 1.0).abs() < 1e-6);
        curve.push(found);
    }
    let unseen: Vec<f64> = curve.iter().map(|found| found[3]).collect();
    assert!(unseen[0] < 1e-4 && unseen[2] < 0.1, "{unseen:?}");
    assert!(curve[0][0] > 0.999 && curve[1][0] > 0.99, "one in ten and in twenty are rejected: {curve:?}");
    assert!(curve[2][0] + curve[2][1] > 0.8, "one in fifty does not pass: {curve:?}");
    // Equal hooks: by the stated error rate.
    let settings = profile(ProfileName::Sim).recovery;
    for rate in [0.0, 0.005, 0.01, 0.02, 0.05, 0.1] {
        let equal = ends(rate, rate);
        println!("equal hooks, {rate}: {equal:.4?}");
        let stated = [settings.settle_worse_alpha, settings.settle_held_alpha];
        assert!(equal[0] <= stated[0] && equal[1] <= stated[1], "{rate}: {equal:?}");
    }
}

#[test]
fn upper_bounds_have_the_error_rate_of_the_profile() {
    let shipped = profile(ProfileName::Sim);
    let mut strict = shipped.clone();
    strict.evaluation.upper_alpha = 0.001;
    let evidence = failing(&shipped, 0, 3);
    let upper = |profile: &Profile| {
        let found = behavior::assess(&evidence, &binding(), profile);
        found.components.iter().find(|one| one.name == behavior::ComponentName::Success).unwrap().upper
    };
    assert!(upper(&strict).unwrap() > upper(&shipped).unwrap());
}

/// `behavior.success_loss_max` of the shipped profiles.
const SUCCESS_LOSS_MAX: f64 = 0.05;

/// Whether counts of lost and gained successes reject.
fn rejects(counts: PairedCounts, alpha: f64) -> bool {
    let net = (counts.candidate_only as f64 - counts.active_only as f64) / counts.pairs as f64;
    net >= SUCCESS_LOSS_MAX && binary_pairs(counts, alpha).unwrap().lower > 0.0
}

/// The table of the guide (design/statistics.md): the share of series of versions, each worse than the one before by the
/// same share of its successes, that are stopped at their first, second, third step, and never in five.
#[test]
fn creeping_losses_are_stopped() {
    const SERIES: usize = 2_000;
    let alpha = 0.05 / 6.0;
    let mut random = Uniform(42);
    for (step, flips) in [(0.04, 0.0), (0.05, 0.0), (0.06, 0.0), (0.04, 0.03), (0.05, 0.03), (0.06, 0.03)] {
        let mut stopped = [0_usize; 6];
        for _ in 0..SERIES {
            // Each version loses successes of the one before for good; `flips` of its episodes end the other way by chance.
            let mut episodes: Vec<[bool; 3]> = (0..300).map(|_| [random.next() < 0.8; 3]).collect();
            let mut end = 5;
            for version in 0..5 {
                for [_, _, own] in &mut episodes {
                    *own = *own && random.next() >= step;
                }
                let shown: Vec<[bool; 3]> =
                    episodes.iter().map(|[a, b, own]| [*a, *b, *own != (random.next() < flips)]).collect();
                let counts = |with: usize| PairedCounts::of(shown.iter().map(|e| (!e[2], !e[with])));
                if rejects(counts(1), alpha) || rejects(counts(0), alpha) {
                    end = version;
                    break;
                }
                for (episode, shown) in episodes.iter_mut().zip(&shown) {
                    episode[1] = shown[2];
                }
            }
            stopped[end] += 1;
        }
        let share = |steps: &[usize]| steps.iter().sum::<usize>() as f64 / SERIES as f64;
        println!(
            "steps of {step}, {flips} by chance: first {:.3}, by the second {:.3}, by the third {:.3}, never in five {:.3}",
            share(&stopped[..1]),
            share(&stopped[..2]),
            share(&stopped[..3]),
            share(&stopped[5..])
        );
        assert!(share(&stopped[..3]) > 0.9, "{step}: {stopped:?}");
        assert_eq!(stopped[5], 0, "no series of five passes");
    }
}
