//! The reasons that led to a decision, the strongest first, and what would remove them. The first is that of the rules, which
//! every view shows where there is room for one.

use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode, lead_reason};
use holdpoint_governance::explanation::{ReasonMeasurement, Remedy};
use holdpoint_governance::outcome::{CheckResult, StageOutcome};
use holdpoint_protocol::explanation::Ruling;

use crate::why::explained_decision::{DecisionReason, ExplainedDecision};
use holdpoint_record::rationale::lenient_bodies::{EvidenceFileRecord, ReasonRecord};
use holdpoint_record::rationale::remedy::{all_remedies, is_in_favor, is_within_margin};

/// A reason of a rule against the version, with its measurement.
#[derive(Clone, Copy)]
pub(super) struct RuleReason<'a> {
    pub(super) record: &'a ReasonRecord,
    pub(super) measured: Option<&'a ReasonMeasurement>,
}

/// The reasons against the version that led to the decision, the strongest first.
pub(super) fn decisive_reasons<'a>(
    decision: &'a ExplainedDecision,
    file: &EvidenceFileRecord,
    is_adverse: bool,
) -> Vec<RuleReason<'a>> {
    let rules = decision.reasons.iter().filter_map(|reason| match reason {
        DecisionReason::Rule { reason, measured } => {
            Some(RuleReason { record: reason, measured: measured.as_ref() })
        }
        DecisionReason::Remark(_) => None,
    });
    let known: Vec<Reason> = rules.clone().filter_map(|reason| reason.record.known()).collect();
    let lead = lead_reason(&known);
    let is_lead = |reason: &RuleReason<'_>| lead.is_some() && reason.record.known().as_ref() == lead;
    let is_against =
        |reason: &RuleReason<'_>| !reason.record.code.known().is_some_and(|code| is_in_favor(*code));
    let against: Vec<RuleReason<'a>> = rules.filter(is_against).collect();
    let mut decisive = if is_adverse {
        let named = narrowed(against, |reason| !is_marker(reason.record));
        let first = named.first().and_then(|reason| dimension(reason.record));
        let failed = failed_checks(&decision.ruling, file);
        let narrow = narrowed(named, |reason| {
            dimension(reason.record).is_some_and(|of| Some(of) == first || failed.contains(&of))
        });
        narrowed(narrow, |reason| !is_within_margin(reason.record, file))
    } else {
        against.into_iter().filter(|reason| !is_marker(reason.record)).collect()
    };
    let codes: Vec<Lenient<ReasonCode>> = decisive.iter().map(|reason| reason.record.code.clone()).collect();
    let place = |reason: &RuleReason<'_>| codes.iter().position(|code| *code == reason.record.code);
    // Without approvers, what a review is about rejects.
    let reviews_decide = decisive.iter().any(|reason| is_lead(reason) && is_for_review(reason.record));
    decisive.sort_by(|a, b| {
        let group =
            |of: &RuleReason<'_>| (!is_lead(of), !reviews_decide && is_for_review(of.record), place(of));
        group(a).cmp(&group(b)).then_with(|| excess(b).total_cmp(&excess(a)))
    });
    decisive
}

/// What would remove the reasons that decide; those for a review only if the first is one.
pub(super) fn reason_remedies(reasons: &[RuleReason<'_>], file: &EvidenceFileRecord) -> Vec<Remedy> {
    let reviews_decide = reasons.first().is_some_and(|first| is_for_review(first.record));
    let deciding = reasons.iter().filter(|reason| reviews_decide || !is_for_review(reason.record));
    deciding.flat_map(|reason| all_remedies(reason.record, file)).collect()
}

/// What would change a decision: the remedies of what decided against the version, or of all but the checks that passed.
pub(in crate::why) fn decision_remedies(
    decision: &ExplainedDecision,
    file: &EvidenceFileRecord,
) -> Vec<Remedy> {
    if rejects(&decision.ruling) {
        return reason_remedies(&decisive_reasons(decision, file, true), file);
    }
    let checks = file.assessments().map(|kappas| kappas.checks());
    let has_passed = |of: Dimension| checks.is_some_and(|checks| checks.contains(&(of, CheckResult::Pass)));
    let open = decision.reasons.iter().filter_map(|reason| match reason {
        DecisionReason::Rule { reason, .. } => Some(reason),
        DecisionReason::Remark(_) => None,
    });
    let open = open.filter(|reason| !dimension(reason).is_some_and(has_passed));
    open.flat_map(|reason| all_remedies(reason, file)).collect()
}

/// Whether a stage ends with this ruling for the version, by its own rule.
fn rejects(ruling: &Ruling) -> bool {
    match ruling {
        Ruling::Registration(outcome) | Ruling::Validation(outcome) => *outcome == StageOutcome::Reject,
        // The sandbox again is what a version gets that failed in it.
        Ruling::Sandbox(outcome) => *outcome == StageOutcome::Reject || *outcome == StageOutcome::Sandbox,
        Ruling::Shadow(outcome) => *outcome == StageOutcome::Fail,
        Ruling::Activation(outcome) => *outcome == StageOutcome::Reject || *outcome == StageOutcome::Demote,
        Ruling::Monitor(_) | Ruling::Rollback(_) | Ruling::People(_) => false,
    }
}

/// The items that fit; all of them if none does.
fn narrowed<T: Copy>(all: Vec<T>, fits: impl Fn(&T) -> bool) -> Vec<T> {
    let fitting: Vec<T> = all.iter().copied().filter(|item| fits(item)).collect();
    if fitting.is_empty() { all } else { fitting }
}

fn dimension(reason: &ReasonRecord) -> Option<Dimension> {
    reason.dimension.as_ref()?.known().copied()
}

/// The compatibilities that failed, where the decision is about them.
fn failed_checks(ruling: &Ruling, file: &EvidenceFileRecord) -> Vec<Dimension> {
    let is_about_them =
        matches!(ruling, Ruling::Registration(_) | Ruling::Validation(_) | Ruling::Sandbox(_));
    let Some(kappas) = file.assessments().filter(|_| is_about_them) else { return Vec::new() };
    let failed = kappas.checks().into_iter().filter(|(_, check)| *check == CheckResult::Fail);
    failed.map(|(of, _)| of).collect()
}

/// Whether a reason only marks what other reasons cause, what is not measured yet, or a weakness of the active version.
fn is_marker(reason: &ReasonRecord) -> bool {
    matches!(
        reason.code.known(),
        Some(
            ReasonCode::BehaviorEndedEarly
                | ReasonCode::RecoveryEndedEarly
                | ReasonCode::BehaviorNoData
                | ReasonCode::CompositionNoData
                | ReasonCode::CompositionRestricted
                | ReasonCode::RecoveryActiveWeak
        )
    )
}

/// Whether people may accept what the reason found.
fn is_for_review(reason: &ReasonRecord) -> bool {
    matches!(
        reason.code.known(),
        Some(
            ReasonCode::PolicyAuthorityReview
                | ReasonCode::PolicyEscalation
                | ReasonCode::PolicyNewPermission
                | ReasonCode::PolicyTighterEnvelope
                | ReasonCode::PolicyUncoveredMode
        )
    )
}

/// How far a reason is past its limit, as a share of it; past a limit of 0, the value. What has no number is past all, and
/// so is a component that decides alone. A component within its limit is below 0.
fn excess(reason: &RuleReason<'_>) -> f64 {
    let share = |value: f64, limit: f64| {
        if limit == 0.0 { value.abs() } else { ((value - limit) / limit).abs() }
    };
    match (reason.measured, reason.record.evidence, reason.record.limit) {
        (Some(ReasonMeasurement::Component { component, .. }), ..) if component.decides_alone() => {
            f64::INFINITY
        }
        (Some(ReasonMeasurement::Component { component, .. }), ..) => {
            (component.worsening - component.tolerance) / component.tolerance
        }
        (_, Some(value), Some(limit)) => share(value, limit),
        _ => f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::behavior::{BehaviorComponent, ComponentName};

    fn reason(code: &str, dimension: &str, text: &str, numbers: Option<(f64, f64)>) -> DecisionReason {
        let value = serde_json::json!({
            "code": code, "dimension": dimension, "text": text,
            "evidence": numbers.map(|(value, _)| value), "limit": numbers.map(|(_, limit)| limit),
        });
        DecisionReason::Rule { reason: Box::new(serde_json::from_value(value).unwrap()), measured: None }
    }

    fn texts(ruling: Ruling, reasons: Vec<DecisionReason>, is_adverse: bool) -> Vec<String> {
        let decision = ExplainedDecision::new(7, 0, ruling, reasons);
        let decisive = decisive_reasons(&decision, &EvidenceFileRecord::default(), is_adverse);
        decisive.iter().map(|reason| reason.record.older_text.clone()).collect()
    }

    /// Regression: the first reason against a version stood on line 76 of its explanation, behind what spoke for it.
    #[test]
    fn reasons_of_the_deciding_check_come_alone_the_leading_one_and_then_the_larger_excess() {
        let reasons = || {
            vec![
                reason("shadow-governance-divergence", "shadow", "failures", Some((0.041, 0.0))),
                reason("shadow-governance-divergence", "shadow", "hits", Some((0.021, 0.0))),
                reason("shadow-governance-divergence", "shadow", "events", Some((0.146, 0.0))),
                reason("composition-eligible", "composition", "eligible", None),
                reason("policy-escalation", "policy", "more speed", None),
            ]
        };
        let ruling = || Ruling::Shadow(StageOutcome::Fail.into());
        assert_eq!(texts(ruling(), reasons(), true), ["failures", "events", "hits"]);
        assert_eq!(texts(ruling(), reasons(), false), ["failures", "events", "hits", "more speed"]);
    }

    /// Regression: the component furthest within its limit came first.
    #[test]
    fn a_component_within_its_limit_comes_after_one_past_it() {
        let of = |name, worsening, tolerance| {
            let (lower, upper, success_loss_max, upper_alpha) = (0.01, None, 0.05, 0.05);
            let component =
                BehaviorComponent { name, worsening, lower, upper, tolerance, success_loss_max, upper_alpha };
            let DecisionReason::Rule { reason, .. } =
                reason("behavior-established-worse", "behavior", "worse", None)
            else {
                panic!("a rule's reason")
            };
            let measured = ReasonMeasurement::Component { component, pairs: 300 };
            excess(&RuleReason { record: &reason, measured: Some(&measured) })
        };
        let (time, retry) = (of(ComponentName::Time, 0.026, 0.6), of(ComponentName::Retry, 1.6, 1.5));
        assert!(time < 0.0 && retry > 0.0, "{time} {retry}");
        assert!(of(ComponentName::Violation, 0.02, 0.05) > retry, "it decides alone");
        assert!(of(ComponentName::Success, 0.05, 0.15) > retry, "as a loss of five points does");
    }

    #[test]
    fn what_people_may_accept_comes_after_what_rejects() {
        let reasons = vec![
            reason("policy-uncovered-high-risk", "policy", "high risk", None),
            reason("policy-authority-review", "policy", "a review", None),
            reason("policy-below-threshold", "policy", "coverage", Some((0.75, 0.9))),
            reason("composition-no-data", "composition", "missing", None),
        ];
        let ruling = Ruling::Validation(StageOutcome::Reject.into());
        let decision = ExplainedDecision::new(7, 0, ruling, reasons);
        let file = EvidenceFileRecord::default();
        let decisive = decisive_reasons(&decision, &file, true);
        let texts: Vec<&str> = decisive.iter().map(|reason| reason.record.older_text.as_str()).collect();
        assert_eq!(texts, ["high risk", "coverage", "a review"]);
        assert_eq!(reason_remedies(&decisive, &file).len(), 2, "what people may accept did not reject it");
        assert_eq!(decision_remedies(&decision, &file).len(), 2, "the whole explanation asks for as much");
    }

    /// Regression: the overview named the review that rejected a version, and its explanation began with another reason.
    #[test]
    fn where_a_review_rejects_it_comes_first_as_in_every_view() {
        let reasons = vec![
            reason("policy-authority-review", "policy", "a review", None),
            reason("policy-escalation", "policy", "more authority", None),
            reason("composition-no-data", "composition", "missing", None),
            reason("recovery-fallback-unresolved", "recovery", "no fallback", None),
        ];
        let check = |outcome: &str| {
            let none = serde_json::json!([]);
            serde_json::json!({
                "outcome": outcome, "kappa": null, "basis": "measured", "reasons": none, "conditions": none,
            })
        };
        let kappas = serde_json::json!({
            "interface": check("compatible"), "policy": check("incompatible"),
            "behavior": check("no-data"), "recovery": check("incompatible"),
        });
        let file = EvidenceFileRecord { kappas: Some(kappas), ..EvidenceFileRecord::default() };
        assert!(file.assessments().is_some());
        let ruling = Ruling::Validation(StageOutcome::Reject.into());
        let decision = ExplainedDecision::new(7, 0, ruling, reasons);
        let decisive = decisive_reasons(&decision, &file, true);
        let texts: Vec<&str> = decisive.iter().map(|reason| reason.record.older_text.as_str()).collect();
        assert_eq!(texts, ["a review", "more authority", "no fallback"]);
        assert_eq!(reason_remedies(&decisive, &file).len(), 3, "the review rejected it, too");
    }

    #[test]
    fn a_mark_is_shown_where_it_is_all_there_is() {
        let reasons = || vec![reason("composition-no-data", "composition", "missing", None)];
        let ruling = || Ruling::Sandbox(StageOutcome::Sandbox.into());
        assert_eq!(texts(ruling(), reasons(), true), ["missing"]);
        assert_eq!(texts(ruling(), reasons(), false), Vec::<String>::new());
    }
}
