//! Shadow in a cell whose state cannot be exported: a twin at the observed state, or outputs alone.

use holdpoint_governance::cell_ability::CellAbility;
use holdpoint_governance::decision::ReasonCode::{self, *};
use holdpoint_governance::distribution_shift::compare_with_sandbox;
use holdpoint_governance::evidence::{OutputSequence, ShadowEvidence, TwinDifference};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::gate::{ShadowAssessment, assess_shadow};
use holdpoint_governance::outcome::CheckResult;
use holdpoint_governance::profile::{Profile, ProfileName};

use crate::fixture::{binding, profile, shadow};

const MISSING: [CellAbility; 2] = [CellAbility::ExportState, CellAbility::SetObserved];

fn outputs(count: u32, output_divergence: f64) -> ShadowEvidence {
    ShadowEvidence {
        binding: binding(),
        sequences: Vec::new(),
        hard_stops: Vec::new(),
        outputs: (0..u64::from(count)).map(|seed| OutputSequence { seed, output_divergence }).collect(),
        missing: MISSING.to_vec(),
    }
}

fn codes(found: &ShadowAssessment) -> Vec<ReasonCode> {
    found.reasons.iter().map(|reason| reason.code).collect()
}

fn assess(evidence: &ShadowEvidence, profile: &Profile) -> ShadowAssessment {
    let mut found = assess_shadow(evidence, &binding(), profile);
    compare_with_sandbox(&mut found, evidence, &[], profile);
    found
}

#[test]
fn outputs_alone_pass_only_where_the_profile_permits_it() {
    let missing = MISSING.to_vec();
    for (name, check, finding) in [
        (ProfileName::Sim, CheckResult::Pass, Finding::OutputsAlone { missing: missing.clone() }),
        (ProfileName::Real, CheckResult::NoData, Finding::TwinMissing { missing: missing.clone() }),
        (ProfileName::Human, CheckResult::NoData, Finding::TwinMissing { missing }),
    ] {
        let profile = profile(name);
        let plain = profile.evaluation.shadow_sequences;
        let found = assess(&outputs(plain, 0.05), &profile);
        assert_eq!((found.check, found.sequences), (check, plain), "{name}: {found:?}");
        let findings: Vec<&Finding> =
            found.reasons.iter().filter_map(|reason| reason.finding.as_ref()).collect();
        assert_eq!(findings, [&finding], "{name}");
        assert!(found.output_divergence.is_some_and(|mean| (mean - 0.05).abs() < 1e-12), "{found:?}");
        assert_eq!((found.envelope_divergence, found.alignment), (None, None));
    }
}

#[test]
fn different_outputs_lengthen_shadow_and_decide_nothing() {
    let profile = profile(ProfileName::Sim);
    let settings = &profile.evaluation;
    let plain = assess(&outputs(settings.shadow_sequences, 0.9), &profile);
    assert_eq!(plain.check, CheckResult::Inconclusive);
    assert_eq!(codes(&plain), [ShadowOutputDivergence, ShadowNoData, ShadowOutputsAlone]);
    let longest = assess(&outputs(settings.shadow_sequences_max, 0.9), &profile);
    assert_eq!(longest.check, CheckResult::Pass);
    assert_eq!(codes(&longest), [ShadowOutputDivergence, ShadowOutputsAlone]);
    let few = assess(&outputs(settings.shadow_sequences - 1, 0.0), &profile);
    assert_eq!((few.check, codes(&few)), (CheckResult::Inconclusive, vec![ShadowNoData, ShadowOutputsAlone]));
}

#[test]
fn invalid_outputs_never_pass() {
    let profile = profile(ProfileName::Sim);
    let plain = profile.evaluation.shadow_sequences;
    let mut repeated = outputs(plain, 0.0);
    repeated.outputs[1].seed = 0;
    let mut mixed = outputs(plain, 0.0);
    mixed.sequences = shadow(&profile).sequences;
    for evidence in [outputs(plain, f64::NAN), outputs(plain, 1.5), repeated, mixed] {
        let found = assess(&evidence, &profile);
        assert_eq!((found.check, codes(&found)), (CheckResult::NoData, vec![ShadowNoData]));
    }
}

#[test]
fn the_largest_difference_of_a_twin_at_the_observed_state_is_stated() {
    let profile = profile(ProfileName::Real);
    let mut evidence = shadow(&profile);
    let differences = [(0.001, 0.002, None), (0.004, 0.001, Some(0.01)), (0.002, 0.0, Some(0.003))];
    for (sequence, (joints_rad, width_m, object_m)) in evidence.sequences.iter_mut().zip(differences) {
        sequence.twin_difference = Some(TwinDifference { joints_rad, width_m, object_m });
    }
    let found = assess(&evidence, &profile);
    assert_eq!((found.check, codes(&found)), (CheckResult::Pass, vec![ShadowClean, ShadowTwinObserved]));
    let expected =
        Finding::TwinObserved { sequences: 3, joints_rad: 0.004, width_m: 0.002, object_m: Some(0.01) };
    assert_eq!(found.reasons[1].finding, Some(expected));
    evidence.sequences[0].twin_difference =
        Some(TwinDifference { joints_rad: f64::NAN, width_m: 0.0, object_m: None });
    assert_eq!(assess(&evidence, &profile).check, CheckResult::NoData);
    let without = shadow(&profile);
    assert_eq!(codes(&assess(&without, &profile)), [ShadowClean]);
}

#[test]
fn evidence_of_older_builds_reads_without_the_new_fields() {
    let evidence = shadow(&profile(ProfileName::Sim));
    let json = serde_json::to_string(&evidence).unwrap();
    assert!(!json.contains("outputs") && !json.contains("missing") && !json.contains("twin_difference"));
    assert_eq!(serde_json::from_str::<ShadowEvidence>(&json).unwrap(), evidence);
}
