//! Joining the four dimensions: the composite score (reported, never gating) and `Psi`, the next permitted stage.
//!
//! Sources: paper equations 2 and 8, Procedure 2; readings X39 to X47; weights from readings 2.1.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use super::condition::Condition;
use super::decision::{
    Decision, DecisionAnswers, DecisionContext, DecisionMonitoring, DecisionRollback, Dimension, Kappa,
    Reason, ReasonCode,
};
use super::deployability::Deployability;
use super::finding::Finding;
use super::manifest::Manifest;
use super::outcome::{
    ActivationMode, Assessment, Basis, BehaviorOutcome, CheckResult, InterfaceOutcome, PolicyOutcome,
    Recommendation, RecoveryOutcome,
};
use super::profile::fields::Weights;
use super::recovery::names_cell_fault;
use super::time_excess::names_time_excess;

/// The four assessments of one candidate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kappas {
    /// `kappa_I`: callers of the active version can call the candidate (paper equation 5).
    pub interface: Assessment<InterfaceOutcome>,
    /// `kappa_P`: the modes it can reach are covered by policy and allowed.
    pub policy: Assessment<PolicyOutcome>,
    /// `kappa_B`: measured behavior against the active version's, on the same seeds.
    pub behavior: Assessment<BehaviorOutcome>,
    /// `kappa_R`: drilled recovery against the active version's.
    pub recovery: Assessment<RecoveryOutcome>,
}

impl Kappas {
    /// The four results in the common form, in the order I, P, B, R.
    #[must_use]
    pub fn checks(&self) -> [(Dimension, CheckResult); 4] {
        [
            (Dimension::Interface, self.interface.outcome.into()),
            (Dimension::Policy, self.policy.outcome.into()),
            (Dimension::Behavior, self.behavior.outcome.into()),
            (Dimension::Recovery, self.recovery.outcome.into()),
        ]
    }

    /// Every condition of the four, without repetition, in the order I, P, B, R.
    #[must_use]
    pub fn conditions(&self) -> Vec<Condition> {
        let lists = [
            &self.interface.conditions,
            &self.policy.conditions,
            &self.behavior.conditions,
            &self.recovery.conditions,
        ];
        let mut all: Vec<Condition> = Vec::new();
        for condition in lists.into_iter().flatten() {
            if !all.contains(condition) {
                all.push(condition.clone());
            }
        }
        all
    }

    /// The modes that restricted passes cap the activation at.
    #[must_use]
    pub fn caps(&self) -> BTreeSet<ActivationMode> {
        self.checks()
            .into_iter()
            .filter_map(|(_, check)| match check {
                CheckResult::PassRestricted(mode) => Some(mode),
                CheckResult::Pass
                | CheckResult::Review
                | CheckResult::Fail
                | CheckResult::Inconclusive
                | CheckResult::NoData
                | CheckResult::Skipped => None,
            })
            .collect()
    }

    /// Every reason of the four, in the order I, P, B, R.
    #[must_use]
    pub fn reasons(&self) -> Vec<Reason> {
        let lists =
            [&self.interface.reasons, &self.policy.reasons, &self.behavior.reasons, &self.recovery.reasons];
        lists.into_iter().flatten().cloned().collect()
    }
}

/// `composite = w_I kappa_I + w_P kappa_P + w_B kappa_B + w_R kappa_R`; `None` if one is missing.
#[must_use]
pub fn composite(weights: &Weights, kappas: [Option<Kappa>; 4]) -> Option<Kappa> {
    let [Some(i), Some(p), Some(b), Some(r)] = kappas else { return None };
    let Weights { interface, policy, behavior, recovery } = weights;
    Kappa::clamped(interface * i.get() + policy * p.get() + behavior * b.get() + recovery * r.get())
}

/// `Psi(kappas, Gamma)`: the next permitted stage, in Procedure 2's order.
///
/// I incompatible -> reject; P incompatible -> reject; an excess of time -> sandbox; a measured failure of B, or of R beyond
/// review -> sandbox; a fault of the cell in R -> sandbox; P review -> rollback-review; R incompatible -> sandbox (rollback-review if an
/// approver exists and rollback itself works); missing or inconclusive B or R -> sandbox; any restriction -> shadow; else activate.
/// A measured failure is not put to people: a review is about permissions, and cannot outweigh what was measured.
#[must_use]
pub fn psi(kappas: &Kappas, has_approver: bool, made_under: DecisionContext) -> Decision<Recommendation> {
    let (outcome, dimension) = recommend(kappas, has_approver);
    let mut reasons = Vec::new();
    if let Some(dimension) = dimension {
        reasons.extend(kappas.reasons().into_iter().filter(|reason| reason.dimension == dimension));
    }
    let missing = kappas.checks().into_iter().any(|(_, check)| {
        matches!(check, CheckResult::NoData | CheckResult::Inconclusive | CheckResult::Skipped)
    });
    if missing {
        reasons.push(Reason::new(Dimension::Composition, Finding::ValueMissing));
    }
    match outcome {
        Recommendation::Activate => {
            reasons.push(Reason::new(Dimension::Composition, Finding::EveryDimensionCompatible));
        }
        Recommendation::Shadow => {
            reasons.push(Reason::new(Dimension::Composition, Finding::CappedAtShadow));
        }
        Recommendation::Reject | Recommendation::Sandbox | Recommendation::RollbackReview => {}
    }
    // The other dimensions' reasons follow, so that the record is complete.
    for reason in kappas.reasons() {
        if !reasons.contains(&reason) {
            reasons.push(reason);
        }
    }
    let answers = DecisionAnswers {
        admitted: outcome != Recommendation::Reject,
        conditions: kappas.conditions(),
        monitoring: DecisionMonitoring::StageGuard.into(),
        rollback_when: DecisionRollback::NotActive.into(),
        deployment: Some(outcome.into()),
    };
    Decision::new(outcome, reasons, answers, &made_under)
}

/// `Psi` at the end of shadow: the deployment outcome is what shadow leaves of it.
#[must_use]
pub fn psi_after_shadow(
    kappas: &Kappas,
    has_approver: bool,
    made_under: DecisionContext,
    check: CheckResult,
) -> Decision<Recommendation> {
    let decision = psi(kappas, has_approver, made_under);
    let before = Deployability::from(*decision.outcome());
    decision.with_deployment(before.after_shadow(check))
}

/// Whether interface and policy admit a version to the sandbox, which is all that is known without running it: `Psi`
/// then does not reject it, whatever the other checks give.
#[must_use]
pub fn admits(interface: InterfaceOutcome, policy: PolicyOutcome) -> bool {
    !blocked(interface.into()) && !blocked(policy.into())
}

const fn blocked(check: CheckResult) -> bool {
    match check {
        CheckResult::Fail | CheckResult::NoData | CheckResult::Inconclusive | CheckResult::Skipped => true,
        CheckResult::Pass | CheckResult::PassRestricted(_) | CheckResult::Review => false,
    }
}

fn recommend(kappas: &Kappas, has_approver: bool) -> (Recommendation, Option<Dimension>) {
    let [(_, interface), (_, policy), (_, behavior), (_, recovery)] = kappas.checks();
    if blocked(interface) {
        return (Recommendation::Reject, Some(Dimension::Interface));
    }
    if blocked(policy) {
        return (Recommendation::Reject, Some(Dimension::Policy));
    }
    if names_time_excess(&kappas.behavior) {
        return (Recommendation::Sandbox, Some(Dimension::Behavior));
    }
    let measured_failure = behavior == CheckResult::Fail && kappas.behavior.basis == Basis::Measured;
    if !measured_failure && names_cell_fault(&kappas.recovery) {
        // The cell's fault is the reason, not what the evaluation lacks because of it.
        return (Recommendation::Sandbox, Some(Dimension::Recovery));
    }
    let unrecoverable = recovery == CheckResult::Fail
        && kappas.recovery.basis == Basis::Measured
        && !(has_approver && recovery_is_reviewable(&kappas.recovery));
    if policy == CheckResult::Review && !measured_failure && !unrecoverable {
        return (Recommendation::RollbackReview, Some(Dimension::Policy));
    }
    if blocked(behavior) {
        // An evaluation that ended early on a failed recovery leaves behavior short of its budget: the failure is the
        // reason, not the missing data.
        let failed = behavior != CheckResult::Fail && recovery == CheckResult::Fail;
        let dimension = if failed { Dimension::Recovery } else { Dimension::Behavior };
        return (Recommendation::Sandbox, Some(dimension));
    }
    if has_approver && recovery_is_reviewable(&kappas.recovery) {
        return (Recommendation::RollbackReview, Some(Dimension::Recovery));
    }
    if blocked(recovery) {
        return (Recommendation::Sandbox, Some(Dimension::Recovery));
    }
    let estimated = [kappas.behavior.basis, kappas.recovery.basis].contains(&Basis::Estimated);
    if !kappas.caps().is_empty() || estimated {
        return (Recommendation::Shadow, None);
    }
    (Recommendation::Activate, None)
}

/// Whether a recovery failure may be put to people: not if rollback itself is what fails.
#[must_use]
pub fn recovery_is_reviewable(recovery: &Assessment<RecoveryOutcome>) -> bool {
    recovery.outcome == RecoveryOutcome::Incompatible
        && recovery.basis == Basis::Measured
        && !recovery.reasons.iter().any(|reason| {
            matches!(
                reason.code,
                ReasonCode::RecoveryRollbackBelowFloor | ReasonCode::RecoveryPredecessorNotLoadable
            )
        })
}

/// The largest tool speed, m/s, and force, N, that the manifest declares and the conditions leave, for display.
#[must_use]
pub fn envelope(manifest: &Manifest, conditions: &[Condition]) -> (f64, f64) {
    let declared = (manifest.permissions.max_speed_m_s, manifest.permissions.max_force_n);
    conditions.iter().fold(declared, |(speed, force), condition| match condition {
        Condition::TighterEnvelope { speed_max_m_s, force_max_n } => {
            (speed.min(*speed_max_m_s), force.min(*force_max_n))
        }
        Condition::SimulationOnly
        | Condition::StricterThresholds { .. }
        | Condition::ShadowFirst { .. }
        | Condition::ApprovalRequired { .. }
        | Condition::CheckedCall { .. }
        | Condition::RollbackCoupled => (speed, force),
    })
}
