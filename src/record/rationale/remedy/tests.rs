//! Compares the numbers of remedies with the rule's own bounds.

use super::*;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::explanation::ReasonContent;
use holdpoint_governance::permission::PeakQuantity;

fn reason(code: &str, dimension: &str, text: &str, evidence: f64, limit: f64) -> ReasonRecord {
    let value = serde_json::json!({
        "code": code, "dimension": dimension, "text": text, "evidence": evidence, "limit": limit,
    });
    serde_json::from_value(value).unwrap()
}

/// An evidence file of 120 pairs; in `worse` of them only the candidate has a violation.
fn file_with_violations(worse: usize) -> EvidenceFileRecord {
    let values = |violation: bool| {
        serde_json::json!({
            "success": true, "violation": violation, "anomaly": false, "recovery": false, "intervention": false,
            "timeout": false, "near_violation": false, "retries": 0, "time_s": 1.0, "unsafe_continuation_ms": 0.0,
        })
    };
    let pairs: Vec<_> = (0..120)
        .map(|i| serde_json::json!({ "seed": i, "candidate": values(i < worse), "active": values(false) }))
        .collect();
    let counts = PairedCounts { pairs: 120, candidate_only: worse as u64, active_only: 0 };
    let bound = binary_pairs(counts, 0.05).unwrap();
    let tally = |passed, failed| serde_json::json!({ "passed": passed, "failed": failed, "infeasible": 0 });
    let drills = |rollback: serde_json::Value| {
        serde_json::json!({
            "rollback": rollback, "abort": tally(40, 0), "fallback": tally(0, 0), "detect": tally(0, 0),
        })
    };
    let evidence_file: EvidenceFileRecord = serde_json::from_value(serde_json::json!({
        "kappas": {},
        "field": "of a later build",
        "pairs": pairs,
        "behavior": {
            "assessment": {
                "outcome": "suspicious", "kappa": null, "basis": "measured", "reasons": [], "conditions": [],
            },
            "established": null, "active": null, "candidate": null, "improved": false,
            "pairs": 120,
            "components": [{
                "name": "violation", "worsening": bound.mean, "lower": 0.0, "upper": bound.upper,
                "tolerance": 0.05,
            }],
        },
        "drills": [drills(tally(26, 14)), drills(tally(40, 0))],
    }))
    .unwrap();
    assert!(
        evidence_file.behavior.is_some() && evidence_file.drills.is_some() && evidence_file.pairs.is_some()
    );
    evidence_file
}

/// Unknown forms of another build are ignored, and its unknown codes are shown as they are.
#[test]
fn unknown_forms_of_another_build_are_ignored() {
    let evidence_file: EvidenceFileRecord = serde_json::from_value(serde_json::json!({
        "kappas": {}, "behavior": { "form": "of a later build" }, "drills": 7, "pairs": "none",
    }))
    .unwrap();
    assert!(evidence_file.is_one() && evidence_file.behavior.is_none());
    assert!(evidence_file.drills.is_none() && evidence_file.pairs.is_none());
    let record = reason("behavior-of-a-later-build", "behavior", "violation is worse", 0.1, 0.05);
    assert_eq!(record.code.known(), None);
    let content = ReasonContent {
        finding: None,
        older_text: "violation is worse".to_owned(),
        evidence: Some(0.1),
        limit: Some(0.05),
    };
    assert_eq!(remedy(&record, &evidence_file), Some(Remedy::Resolve(content)));
}

#[test]
fn the_number_of_episodes_is_the_smallest_that_does() {
    for worse in [3, 10, 25] {
        let evidence_file = file_with_violations(worse);
        let component = &evidence_file.behavior.as_ref().unwrap().components[0];
        let reduction = fewer(component, &evidence_file).unwrap();
        assert_eq!(reduction.of, 120);
        let less = reduction.fewer;
        let upper = |worse: u64| {
            let counts = PairedCounts { pairs: 120, candidate_only: worse, active_only: 0 };
            binary_pairs(counts, 0.05).unwrap().upper
        };
        let left = worse as u64 - less;
        assert!(upper(left) <= 0.05, "{worse}: {left} are left");
        assert!(less == 0 || upper(left + 1) > 0.05, "{worse}: one fewer would do as well");
        let record =
            reason("behavior-suspicious", "behavior", "violation may be worse beyond its margin", 0.1, 0.05);
        let expected = Remedy::WorsenLess { component: *component, fewer: Some(reduction) };
        assert_eq!(remedy(&record, &evidence_file), Some(expected));
    }
}

/// Regression: "time +0.243 must be at most 0.600" stood among the changes that a rejection asked for.
#[test]
fn a_worsening_within_its_margin_is_no_change_beside_others_that_decide() {
    let mut evidence_file = file_with_violations(25);
    let time = |tolerance| BehaviorComponent {
        name: ComponentName::Time,
        worsening: 0.243,
        lower: 0.2,
        upper: Some(0.3),
        tolerance,
        success_loss_max: 0.05,
        upper_alpha: 0.05,
    };
    let worse = reason("behavior-established-worse", "behavior", "time is significantly worse", 0.243, 0.6);
    let add = |evidence_file: &mut EvidenceFileRecord, component| {
        evidence_file.behavior.as_mut().unwrap().components.push(component);
    };
    add(&mut evidence_file, time(0.6));
    let violation = &mut evidence_file.behavior.as_mut().unwrap().components[0];
    violation.lower = 0.1;
    assert_eq!(remedy(&worse, &evidence_file), None, "the violations decide");
    assert!(is_within_margin(&worse, &evidence_file));
    // Alone it decides nothing; with others the sum does.
    evidence_file.behavior.as_mut().unwrap().components.remove(0);
    assert_eq!(remedy(&worse, &evidence_file), None);
    let attempts = BehaviorComponent { name: ComponentName::Retry, worsening: 0.5, ..time(0.6) };
    add(&mut evidence_file, attempts);
    assert_eq!(remedy(&worse, &evidence_file), Some(Remedy::Act(RemedyAction::ReduceSum)));
    assert!(!is_within_margin(&worse, &evidence_file));
    // Past its margin it decides, whatever its upper bound is.
    evidence_file.behavior.as_mut().unwrap().components.clear();
    add(&mut evidence_file, time(0.24));
    let expected = Remedy::WorsenLess { component: time(0.24), fewer: None };
    assert_eq!(remedy(&worse, &evidence_file), Some(expected));
    evidence_file.behavior.as_mut().unwrap().components.clear();
    add(&mut evidence_file, BehaviorComponent { upper: Some(0.9), ..time(0.6) });
    assert_eq!(
        remedy(&worse, &evidence_file),
        None,
        "few pairs bound it from above badly, and it is tolerated"
    );
}

/// No violation is accepted once it is significant, however small the worsening.
#[test]
fn a_significant_violation_within_its_margin_has_to_end() {
    let mut evidence_file = file_with_violations(3);
    let violation = &mut evidence_file.behavior.as_mut().unwrap().components[0];
    (violation.lower, violation.upper) = (0.001, Some(0.049));
    let component = *violation;
    let worse =
        reason("behavior-established-worse", "behavior", "violation is significantly worse", 0.025, 0.05);
    assert_eq!(remedy(&worse, &evidence_file), Some(Remedy::EndSignificance(component)));
}

/// The traded component is the worse one, not the success it was traded for.
#[test]
fn a_traded_component_is_the_one_that_is_worse() {
    let evidence_file = file_with_violations(10);
    let text = "success rose while violation is established as worse";
    let record = reason("behavior-safety-traded", "behavior", text, 0.08, 0.0);
    let component = evidence_file.behavior.as_ref().unwrap().components[0];
    assert_eq!(component.name, ComponentName::Violation);
    let expected = ReasonMeasurement::Component { component, pairs: 120 };
    assert_eq!(measured(&record, &evidence_file), Some(expected));
    let record = reason("behavior-suspicious", "behavior", "violation, in other words", 0.08, 0.0);
    assert_eq!(measured(&record, &evidence_file), None);
}

#[test]
fn drills_are_counted() {
    let evidence_file = file_with_violations(0);
    let record = reason("recovery-rollback-below-floor", "recovery", "too seldom", 0.65, 0.7);
    let expected = Remedy::PassRollbackDrills { passed: 26, all: 40, needed: 28 };
    assert_eq!(remedy(&record, &evidence_file), Some(expected));
    let record = reason("recovery-fragile", "recovery", "below the floor", 0.66, 0.7);
    let tally = |passed| DrillTally { passed, failed: 40 - passed, infeasible: 0, failed_alone: 0 };
    let expected = Remedy::StrengthenRecovery {
        weakest: DrillKind::Rollback,
        tally: tally(26),
        recovery: Some(0.66),
        least: Some(0.7),
    };
    assert_eq!(remedy(&record, &evidence_file), Some(expected));
    let drills =
        |kind, passed| DrillComparison { kind, phase: None, candidate: tally(passed), active: tally(40) };
    let expected =
        ReasonMeasurement::Drills(vec![drills(DrillKind::Rollback, 26), drills(DrillKind::Abort, 40)]);
    assert_eq!(measured(&record, &evidence_file), Some(expected));
}

/// The named values stand first, and in place of the general advice to declare.
#[test]
fn a_declaration_that_is_too_low_is_named() {
    let mut evidence_file = file_with_violations(0);
    let permissions = serde_json::json!({
        "declared": {
            "channels": ["gripper"], "commands": ["gripper"], "zones": ["work"], "sensors": [], "tools": [],
            "max_speed_m_s": 0.4, "max_force_n": 12.0, "authority": 1,
            "resources": { "cpu_us_per_tick": 50, "memory_kib": 256 },
        },
        "used": { "asked_force_n": 18.0, "force_max_n": 14.0 },
        "sensors_read": [], "tools_read": [], "tasks": 7, "exceeded": [], "unused": [],
    });
    evidence_file.permissions = Some(serde_json::from_value(permissions).unwrap());
    let raise = Remedy::RaiseDeclaration { quantity: PeakQuantity::Force, asked: 18.0, declared: 12.0 };
    let drills = reason("recovery-rollback-below-floor", "recovery", "too seldom", 0.65, 0.7);
    let own = Remedy::PassRollbackDrills { passed: 26, all: 40, needed: 28 };
    assert_eq!(all_remedies(&drills, &evidence_file), [raise.clone(), own]);
    let asks = reason("behavior-asks-more", "behavior", "it asks for more", 0.5, 0.05);
    assert_eq!(all_remedies(&asks, &evidence_file), [raise]);
    let slow = reason("behavior-suspicious", "behavior", "time, in other words", 0.08, 0.05);
    assert_eq!(all_remedies(&slow, &evidence_file).len(), 1, "clamping explains no other reason");
}

#[test]
fn missing_approvals_are_counted() {
    for missing in [1_u32, 2] {
        let record = reason("approval-pending", "approval", "waits", f64::from(missing), 2.0);
        let found = remedy(&record, &EvidenceFileRecord::default());
        assert_eq!(found, Some(Remedy::Approve { missing }));
    }
}

/// Every reason either supports the version or has a remedy, also without evidence.
#[test]
fn reasons_support_or_have_a_remedy() {
    let mut without = Vec::new();
    for code in ReasonCode::ALL {
        let record = reason(code.as_str(), "gate", "what was found", 1.0, 2.0);
        if remedy(&record, &EvidenceFileRecord::default()).is_none() {
            without.push(*code);
        }
    }
    assert!(without.contains(&ReasonCode::GatePassed) && !without.contains(&ReasonCode::GateFrozen));
    assert!(without.len() < 22, "{without:?}");
    assert!(ReasonCode::ALL.iter().filter(|code| is_in_favor(**code)).all(|code| without.contains(code)));
}
