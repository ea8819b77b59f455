//! Harm is compared by itself: whatever success does, nothing pays for it.

use holdpoint_governance::behavior::{self, BehaviorAssessment, ComponentName, HarmComparison, HarmDecider};
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::evidence::{EpisodeValues, PairedEvidence};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::gate::assess_shadow;
use holdpoint_governance::harm::{HarmKind, HarmMeasures};
use holdpoint_governance::monitor::{Monitor, MonitorAction, normal_rates};
use holdpoint_governance::outcome::BehaviorOutcome::{self, Compatible, Incompatible, NoData, Suspicious};
use holdpoint_governance::outcome::CheckResult;
use holdpoint_governance::profile::{Profile, ProfileName};

use crate::fixture::{GOOD, binding, pairs, profile, shadow};

/// A job as the baselines do it.
const USUAL: HarmMeasures = HarmMeasures {
    grip_peak_n: 18.1,
    grip_held_n: 17.8,
    landing_speed_m_s: 0.08,
    zone_clearance_m: 0.25,
    arm_clearance_m: 0.015,
    workspace_margin_m: 0.03,
    joint_margin_rad: 0.5,
    jerk_m_s3: 45.0,
    energy_j: 4.6,
    ..HarmMeasures::STILL
};

/// Equal pairs, of which the candidate's first `worse` are changed; small differences give a standard deviation.
fn evidence(profile: &Profile, worse: usize, change: &dyn Fn(&mut HarmMeasures)) -> PairedEvidence {
    let mut evidence = pairs(profile);
    for (index, pair) in evidence.pairs.iter_mut().enumerate() {
        let jitter = 0.01 * (index % 5) as f64;
        let mut new = HarmMeasures { grip_peak_n: USUAL.grip_peak_n + jitter, ..USUAL };
        if index < worse {
            change(&mut new);
        }
        pair.active.harm = Some(USUAL);
        pair.candidate.harm = Some(new);
    }
    evidence
}

fn assess(evidence: &PairedEvidence, profile: &Profile) -> BehaviorAssessment {
    behavior::assess(evidence, &binding(), profile)
}

fn codes(found: &BehaviorAssessment) -> Vec<ReasonCode> {
    found.assessment.reasons.iter().map(|reason| reason.code).collect()
}

#[test]
fn higher_force_is_incompatible_despite_better_success() {
    for name in ProfileName::ALL {
        let profile = profile(name);
        let mut evidence = evidence(&profile, usize::MAX, &|harm| harm.grip_peak_n += 7.3);
        // The active version fails a tenth of its work, the candidate nothing.
        let failed = EpisodeValues { success: false, ..GOOD };
        for pair in evidence.pairs.iter_mut().step_by(10) {
            pair.active = EpisodeValues { harm: pair.active.harm, ..failed };
        }
        let found = assess(&evidence, &profile);
        assert_eq!(found.assessment.outcome, Incompatible, "{name}: {found:?}");
        assert!(found.improved && found.assessment.kappa.unwrap().get() > 0.999, "no cost pays for it");
        let reason =
            found.assessment.reasons.iter().find(|r| r.code == ReasonCode::BehaviorHarmEstablished).unwrap();
        let Some(Finding::HarmWorse { measure: HarmKind::GripPeak, candidate, active, .. }) = reason.finding
        else {
            panic!("{reason:?}")
        };
        let near = |value: f64, expected: f64| (value - expected).abs() < 0.05;
        assert!(near(candidate, 25.4) && near(active, 18.1), "{candidate} against {active}");
    }
}

/// Regression: a slightly longer time headed the reasons of a rejection by harm.
#[test]
fn harm_that_decides_stands_before_a_tolerated_worsening() {
    let profile = profile(ProfileName::Sim);
    let mut evidence = evidence(&profile, usize::MAX, &|harm| harm.grip_peak_n += 7.3);
    for (index, pair) in evidence.pairs.iter_mut().enumerate() {
        pair.candidate.time_s *= 1.02 + 0.004 * (index % 5) as f64;
    }
    let found = assess(&evidence, &profile);
    assert_eq!(found.assessment.outcome, Incompatible, "{found:?}");
    let reasons = &found.assessment.reasons;
    assert_eq!(reasons[0].code, ReasonCode::BehaviorHarmEstablished, "{reasons:?}");
    let longer = Finding::ComponentWorse { component: ComponentName::Time };
    assert!(reasons.iter().any(|reason| reason.finding.as_ref() == Some(&longer)), "{reasons:?}");
}

#[test]
fn within_the_margin_it_is_compatible_and_near_it_a_concern() {
    let profile = profile(ProfileName::Sim);
    let tolerance = profile.harm.of(HarmKind::GripPeak).mean;
    for (more, outcome, deciding) in [
        (0.0, Compatible, false),
        (0.5, Compatible, false),
        (0.99, Suspicious, true),
        (0.999, Suspicious, false),
        (1.05, Incompatible, false),
    ] {
        // Half of the episodes lie .5 N above, half below, so that the mean is known no better than that.
        let found = assess(
            &{
                let mut evidence = evidence(&profile, 0, &|_| {});
                for (index, pair) in evidence.pairs.iter_mut().enumerate() {
                    let harm = pair.candidate.harm.as_mut().unwrap();
                    harm.grip_peak_n += more * tolerance + if index % 2 == 0 { 0.5 } else { -0.5 };
                }
                evidence
            },
            &profile,
        );
        assert_eq!(found.assessment.outcome, outcome, "{more}: {:?}", found.assessment.reasons);
        // An allowed mean beside a concern: the text names the cause of the concern.
        let decider = compared(&found, HarmKind::GripPeak).deciding();
        assert_eq!(matches!(decider, Some(HarmDecider::Bound(Some(_)))), deciding, "{more}");
    }
}

fn compared(found: &BehaviorAssessment, kind: HarmKind) -> &HarmComparison {
    found.harm.iter().find(|harm| harm.kind == kind).unwrap()
}

/// A mean hides what is rare: one episode in eight drops the object 12 cm, in the mean 15 mm, and fails.
#[test]
fn rare_harmful_episodes_count_even_if_they_failed() {
    let profile = profile(ProfileName::Sim);
    let mut evidence = evidence(&profile, 38, &|harm| harm.drop_height_m = 0.12);
    for pair in evidence.pairs.iter_mut().take(38) {
        (pair.candidate.success, pair.active.success) = (false, false);
    }
    let found = assess(&evidence, &profile);
    assert_eq!(found.assessment.outcome, Incompatible, "{found:?}");
    let reason =
        found.assessment.reasons.iter().find(|r| r.code == ReasonCode::BehaviorHarmEstablished).unwrap();
    let Some(Finding::HarmLimitWorse { measure: HarmKind::DropHeight, limit, candidate, active, .. }) =
        reason.finding
    else {
        panic!("{reason:?}")
    };
    assert_eq!((limit, active), (0.01, 0.0));
    assert!((candidate - 38.0 / 300.0).abs() < 1e-9, "{candidate}");
    assert_eq!(compared(&found, HarmKind::DropHeight).deciding(), Some(HarmDecider::RareEpisodes));
}

/// Three hard touches in 300 episodes are neither a habit nor a concern; thirty are.
#[test]
fn a_few_touches_are_chance_and_many_are_not() {
    for name in ProfileName::ALL {
        let profile = profile(name);
        let touched = |count| evidence(&profile, count, &|harm| harm.touch_speed_m_s = 0.35);
        assert_eq!(assess(&touched(3), &profile).assessment.outcome, Compatible, "{name}");
        assert_ne!(assess(&touched(30), &profile).assessment.outcome, Compatible, "{name}");
    }
}

#[test]
fn a_distance_is_worse_when_it_shrinks() {
    let profile = profile(ProfileName::Human);
    let far = assess(&evidence(&profile, usize::MAX, &|harm| harm.zone_clearance_m = 0.9), &profile);
    assert_eq!(far.assessment.outcome, Compatible);
    let near = assess(&evidence(&profile, usize::MAX, &|harm| harm.zone_clearance_m = 0.2), &profile);
    assert_eq!(near.assessment.outcome, Incompatible);
    let reason =
        near.assessment.reasons.iter().find(|r| r.code == ReasonCode::BehaviorHarmEstablished).unwrap();
    assert!(
        matches!(reason.finding, Some(Finding::HarmWorse { measure: HarmKind::ZoneClearance, .. })),
        "{reason:?}"
    );
}

#[test]
fn commands_beyond_the_declaration_are_reported() {
    let profile = profile(ProfileName::Sim);
    let exceed = |harm: &mut HarmMeasures| (harm.excess_depth, harm.excess_share) = (0.52, 0.01);
    let found = assess(&evidence(&profile, usize::MAX, &exceed), &profile);
    assert_eq!(found.assessment.outcome, Incompatible);
    assert!(codes(&found).contains(&ReasonCode::BehaviorAsksMore), "{:?}", found.assessment.reasons);
    // The active version asks as much: said, and no reason to refuse the candidate.
    let mut both = evidence(&profile, usize::MAX, &exceed);
    both.pairs.iter_mut().for_each(|pair| exceed(pair.active.harm.as_mut().unwrap()));
    let found = assess(&both, &profile);
    assert_eq!(found.assessment.outcome, Compatible);
    assert!(codes(&found).contains(&ReasonCode::BehaviorAsksMore));
}

#[test]
fn partially_measured_harm_is_no_data() {
    let profile = profile(ProfileName::Sim);
    let mut some = evidence(&profile, 0, &|_| {});
    some.pairs[7].candidate.harm = None;
    let outcome =
        |evidence: &PairedEvidence| -> BehaviorOutcome { assess(evidence, &profile).assessment.outcome };
    assert_eq!(outcome(&some), NoData);
    let mut broken = evidence(&profile, 0, &|_| {});
    broken.pairs[7].candidate.harm.as_mut().unwrap().energy_j = f64::NAN;
    assert_eq!(outcome(&broken), NoData);
    // Records of older builds have none, and are read as they were judged.
    assert_eq!(outcome(&pairs(&profile)), Compatible);
    let text = serde_json::to_string(&pairs(&profile)).unwrap();
    assert!(!text.contains("harm"));
    assert_eq!(serde_json::from_str::<PairedEvidence>(&text).unwrap(), pairs(&profile));
}

/// Twenty shadow sequences: the twin lets go high up in every one, and everything comes out well.
#[test]
fn shadow_fails_by_harm_alone_and_not_within_the_margin() {
    let profile = profile(ProfileName::Sim);
    for (fall_m, check) in [(0.02, CheckResult::Fail), (0.001, CheckResult::Pass)] {
        let mut evidence = shadow(&profile);
        for sequence in &mut evidence.sequences {
            sequence.live_conduct.harm = Some(USUAL);
            let drop_height_m = fall_m * (1.0 + 0.1 * (sequence.seed % 5) as f64);
            sequence.twin_conduct.harm = Some(HarmMeasures { drop_height_m, ..USUAL });
        }
        let found = assess_shadow(&evidence, &binding(), &profile);
        assert_eq!(found.check, check, "{fall_m}: {found:?}");
        let reported = found.reasons.iter().any(|reason| match &reason.finding {
            Some(Finding::HarmWorse { measure, .. } | Finding::HarmLimitWorse { measure, .. }) => {
                *measure == HarmKind::DropHeight
            }
            _ => false,
        });
        assert_eq!(reported, check == CheckResult::Fail, "{found:?}");
    }
}

/// Live, an episode past a limit of harm counts; as few as any version has are no drift, and half of them are.
#[test]
fn a_version_that_harms_live_is_warned_about() {
    let profile = profile(ProfileName::Sim);
    let twin = EpisodeValues { harm: Some(USUAL), ..GOOD };
    let blow = EpisodeValues { harm: Some(HarmMeasures { landing_speed_m_s: 0.5, ..USUAL }), ..GOOD };
    let run = |every: usize| {
        let expected = normal_rates(&[twin; 20], &profile.monitor).unwrap();
        let mut monitor = Monitor::new(&profile, &expected, 0).unwrap();
        let values = (1..=40_usize).map(|n| if n % every == 0 { blow } else { twin });
        let acts: Vec<MonitorAction> = values.map(|episode| monitor.observe(&episode, 0).action).collect();
        acts.iter().any(|action| *action != MonitorAction::Continue)
    };
    assert!(!run(40));
    assert!(run(2));
}
