//! The measurement behind a reason, and what would remove the reason.
//!
//! Counts are computed from the raw pairs and drills on record with the rule's own statistics. A number of episodes is the
//! smallest one that brings the rule's bound within its limit.

use super::lenient_bodies::{EvidenceFileRecord, ReasonRecord};
use crate::evidence_file::EvidenceFile;
use holdpoint_governance::behavior::{
    BehaviorAssessment, BehaviorComponent, ComponentName, HarmComparison, component_of,
};
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::evidence::{DrillKind, DrillTally};
use holdpoint_governance::explanation::{
    DrillComparison, EpisodeReduction, ReasonMeasurement, Remedy, RemedyAction,
};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::harm::HarmKind;
use holdpoint_governance::permission::{PermissionExcess, PermissionUse};
use holdpoint_governance::phase::PhaseTallies;
use holdpoint_governance::stats::{PairedCounts, binary_pairs};

/// Whether a reason supports the version, so that no change is needed.
#[must_use]
pub const fn is_in_favor(code: ReasonCode) -> bool {
    matches!(
        code,
        ReasonCode::InterfaceCompatible
            | ReasonCode::PolicyCompatible
            | ReasonCode::BehaviorCompatible
            | ReasonCode::RecoveryCompatible
            | ReasonCode::BehaviorImproved
            | ReasonCode::CompositionEligible
            | ReasonCode::ShadowClean
            | ReasonCode::GatePassed
            | ReasonCode::GateImproved
            | ReasonCode::GateImprovementWaived
            | ReasonCode::ApprovalGranted
            | ReasonCode::ApprovalNotNeeded
            | ReasonCode::MonitorHealthy
            | ReasonCode::MonitorConfirmed
    )
}

/// What would remove each of these reasons, in their order.
#[must_use]
pub fn remedies<'a>(
    evidence_file: &EvidenceFile,
    reasons: impl IntoIterator<Item = &'a Reason>,
) -> Vec<Remedy> {
    let value = serde_json::to_value(evidence_file).unwrap_or_default();
    let measured: EvidenceFileRecord = serde_json::from_value(value).unwrap_or_default();
    let records = reasons.into_iter().map(ReasonRecord::from);
    records.flat_map(|reason| all_remedies(&reason, &measured)).collect()
}

/// The measured component of a behavioral reason.
fn component<'a>(
    reason: &ReasonRecord,
    evidence_file: &'a EvidenceFileRecord,
) -> Option<&'a BehaviorComponent> {
    let behavior = evidence_file.behavior.as_ref().filter(|_| reason.is_about(Dimension::Behavior))?;
    let about = component_of(&reason.known()?)?;
    behavior.components.iter().find(|component| component.name == about)
}

/// The measurement behind a reason, if the evidence has more than the reason.
#[must_use]
pub fn measured(reason: &ReasonRecord, evidence_file: &EvidenceFileRecord) -> Option<ReasonMeasurement> {
    if let Some(component) = component(reason, evidence_file) {
        let pairs = evidence_file.behavior.as_ref().map_or(0, |behavior| behavior.pairs);
        return Some(ReasonMeasurement::Component { component: *component, pairs });
    }
    if reason.is_about(Dimension::Recovery) && reason.code != ReasonCode::RecoveryNoData {
        let (candidate, active) = evidence_file.drills.as_ref()?;
        let kinds = DrillKind::ALL.into_iter().map(|kind| DrillComparison {
            kind,
            phase: None,
            candidate: *candidate.of(kind),
            active: *active.of(kind),
        });
        let phases = PhaseTallies::places().map(|(kind, phase)| DrillComparison {
            kind,
            phase: Some(phase),
            candidate: *candidate.phases.of(kind, phase),
            active: *active.phases.of(kind, phase),
        });
        let kinds = kinds.filter(|drills| drills.candidate.feasible() > 0);
        let compared: Vec<_> = kinds.chain(phases.filter(|drills| drills.candidate.failed > 0)).collect();
        return (!compared.is_empty()).then_some(ReasonMeasurement::Drills(compared));
    }
    if reason.is_about(Dimension::Shadow) {
        let shadow = evidence_file.shadow.as_ref()?;
        return Some(ReasonMeasurement::ShadowSequences(shadow.sequences));
    }
    None
}

/// What would remove a reason; `None` if it supports the version, or if no change of the version removes it.
#[must_use]
pub fn remedy(reason: &ReasonRecord, evidence_file: &EvidenceFileRecord) -> Option<Remedy> {
    use ReasonCode as Code;
    use RemedyAction as Action;
    // A code of another build is shown with its number against its limit.
    let Some(code) = reason.code.known() else { return Some(resolve(reason)) };
    let act_on = |action| Remedy::ActOn(action, reason.content());
    let remedy = match code {
        Code::BehaviorEstablishedWorse | Code::BehaviorSuspicious | Code::BehaviorSafetyTraded => {
            match component(reason, evidence_file) {
                Some(found) => return worsening_remedy(*code, found, evidence_file),
                None => resolve(reason),
            }
        }
        Code::BehaviorHarmEstablished | Code::BehaviorHarmSuspicious => act_on(Action::CauseNoMoreHarm),
        Code::BehaviorAnchorWorse | Code::BehaviorAnchorSuspicious => act_on(Action::MatchAnchor),
        Code::BehaviorLiveLikeWorse | Code::BehaviorLiveLikeSuspicious => resolve(reason),
        Code::BehaviorSequenceWorse | Code::BehaviorSequenceSuspicious => act_on(Action::PreserveHandover),
        Code::BehaviorAsksMore => Remedy::Act(Action::DeclareRequests),
        Code::BehaviorNoData | Code::CompositionNoData => Remedy::Act(Action::RunNextStage),
        // The early end of an evaluation is not a cause; the cause is a separate reason.
        Code::BehaviorEndedEarly | Code::RecoveryEndedEarly => return None,
        // It concerns the active version; no change of the candidate would remove it.
        Code::RecoveryActiveWeak => return None,
        // More drills settled it in the version's favor.
        Code::RecoverySettled => return None,
        Code::BehaviorInconclusive => act_on(Action::RunMoreEpisodes),
        Code::BehaviorTickTooSlow => Remedy::Act(Action::TakeLessTickTime),
        Code::BehaviorTimeSpent => Remedy::Act(Action::TakeLessEvaluationTime),
        Code::BehaviorTriesSpent => Remedy::Act(Action::ReviewTries),
        Code::BehaviorHardStop => Remedy::Act(Action::AvoidHardStop),
        Code::RecoveryRollbackBelowFloor => rollback_drills(reason, evidence_file),
        Code::RecoveryBelowThreshold
        | Code::RecoveryFarBelowFloor
        | Code::RecoveryFragile
        | Code::RecoveryConditional => weakest_drills(reason, evidence_file),
        Code::RecoveryPhaseFailing => act_on(Action::PassDrillsInPhase),
        Code::RecoveryEstablishedWorse
        | Code::RecoveryPhaseWorse
        | Code::RecoveryLeaning
        | Code::RecoveryUnsettled => act_on(Action::PassDrillsAsOften),
        Code::RecoveryNoData
        | Code::ShadowNoData
        | Code::ShadowTwinMissing
        | Code::GateNoData
        | Code::InterfaceNoData
        | Code::PolicyNoData => act_on(Action::SupplyEvidence),
        Code::RecoveryHookMissing => act_on(Action::ExportHook),
        Code::RecoveryFallbackUnresolved => Remedy::Act(Action::BindFallback),
        Code::RecoveryCellFault => act_on(Action::RepairCell),
        Code::RecoverySignalUnknown => act_on(Action::DeclareKnownSignals),
        Code::RecoveryPredecessorNotLoadable => Remedy::Act(Action::RestoreTarget),
        Code::InterfaceVersionMislabelled => act_on(Action::RaiseVersionNumber),
        Code::InterfaceUndeclaredChange => act_on(Action::DeclareInterfaceChange),
        Code::InterfaceExportMismatch => act_on(Action::AlignManifestAndCode),
        Code::InterfaceDependencyBreaking | Code::InterfaceDependencyAdaptable => {
            act_on(Action::NameMetDependency)
        }
        Code::InterfaceSignatureAdaptable
        | Code::InterfaceSchemaAdaptable
        | Code::InterfaceConditionAdaptable => act_on(Action::DeclareAsBefore),
        Code::InterfaceSignatureBreaking
        | Code::InterfaceSchemaBreaking
        | Code::InterfaceConditionBreaking => act_on(Action::DeclareAsActive),
        Code::PolicyUncoveredHighRisk | Code::PolicyUncoveredMode | Code::PolicyBelowThreshold => {
            act_on(Action::CoverByPolicy)
        }
        Code::PolicyForbiddenMode => act_on(Action::ExcludeMode),
        Code::PolicyUndeclaredImport => act_on(Action::DeclarePermission),
        Code::PolicyEnvironmentNotAdmitted => act_on(Action::AdmitProfile),
        Code::PolicyAuthorityReview | Code::PolicyEscalation | Code::PolicyNewPermission => {
            act_on(Action::RequestLess)
        }
        Code::ApprovalPending => missing_people(reason),
        Code::ApprovalRefused => Remedy::Act(Action::RegisterAgain),
        Code::ApprovalTimeout => Remedy::Act(Action::AnswerRequest),
        Code::GateClockDoubted => Remedy::Act(Action::ConfirmTime),
        Code::GateFrozen => Remedy::Act(Action::EndFreeze),
        Code::GateProfileUnauthorized => Remedy::Act(Action::SignProfile),
        Code::GateNoImprovement => Remedy::Act(Action::Improve),
        Code::GateStaleEvidence => Remedy::Act(Action::RunStagesAgain),
        Code::ShadowGovernanceDivergence => act_on(Action::MatchLiveSignals),
        Code::MonitorWorkedAgain | Code::ShadowWorkedAgain => Remedy::Act(Action::MatchPredecessorLive),
        Code::MonitorShifted => Remedy::Act(Action::MatchTwins),
        Code::ShadowShifted => Remedy::Act(Action::MatchSandbox),
        Code::ShadowOutputDivergence | Code::ShadowEnvelopeDivergence | Code::ShadowLeaning => {
            act_on(Action::WaitForShadow)
        }
        Code::MonitorSafetyTrip => Remedy::Act(Action::AvoidSafetyEvents),
        Code::GateShadowTooShort => act_on(Action::RunShadowLonger),
        Code::GateDependencyUnmet => act_on(Action::ActivateDependency),
        Code::PolicySimulationOnly | Code::GateSimulationOnly => act_on(Action::AdmitOtherProfiles),
        Code::MonitorRateTrip
        | Code::MonitorRateWarning
        | Code::MonitorCoupledTrip
        | Code::MonitorHarmTrip => act_on(Action::KeepRate),
        Code::MonitorTelemetryMissing => act_on(Action::DeliverTelemetry),
        Code::MonitorEscalationUnanswered => Remedy::Act(Action::AnswerEscalation),
        Code::MonitorOperator => Remedy::Act(Action::OperatorDecides),
        Code::PolicyResourcesExceeded
        | Code::PolicyTighterEnvelope
        | Code::BehaviorEstimated
        | Code::BehaviorTryOpen
        | Code::BehaviorTriedBefore
        | Code::GateDimensionFailed
        | Code::GateNotMeasured
        | Code::GateSkipped
        | Code::GateSitePolicyForbids
        | Code::GateHardLimit
        | Code::GateReviewOpen
        | Code::GateRequesterUnknown
        | Code::GateProfileClosed
        | Code::ApprovalStale
        | Code::ApprovalExpired
        | Code::ApprovalSelf
        | Code::ApprovalDuplicate
        | Code::ApprovalRole
        | Code::ApprovalSignature
        | Code::ApprovalReplayed
        | Code::ApprovalBreakGlass => resolve(reason),
        // They support the version, or only state that another reason caps it.
        Code::InterfaceCompatible
        | Code::PolicyCompatible
        | Code::BehaviorCompatible
        | Code::RecoveryCompatible
        | Code::BehaviorImproved
        | Code::CompositionEligible
        | Code::ShadowClean
        | Code::GatePassed
        | Code::GateImproved
        | Code::GateImprovementWaived
        | Code::ApprovalGranted
        | Code::ApprovalNotNeeded
        | Code::MonitorHealthy
        | Code::MonitorConfirmed
        | Code::ShadowTwinObserved
        | Code::ShadowOutputsAlone
        | Code::CompositionRestricted => return None,
    };
    Some(remedy)
}

/// Everything that would remove a reason: first a declaration that is too low, where it may be the cause.
#[must_use]
pub fn all_remedies(reason: &ReasonRecord, evidence_file: &EvidenceFileRecord) -> Vec<Remedy> {
    let raises = low_declarations(reason, evidence_file);
    let own = remedy(reason, evidence_file);
    // The values say more than that something has to be declared.
    let own = own.filter(|own| raises.is_empty() || *own != Remedy::Act(RemedyAction::DeclareRequests));
    raises.into_iter().chain(own).collect()
}

/// The declarations that the code asks beyond, for a reason that clamped commands may cause.
fn low_declarations(reason: &ReasonRecord, evidence_file: &EvidenceFileRecord) -> Vec<Remedy> {
    if !may_be_by_clamping(reason) {
        return Vec::new();
    }
    let excesses = evidence_file.permissions.as_ref().map(PermissionUse::excesses).unwrap_or_default();
    let raise = |excess| match excess {
        PermissionExcess::Asked { quantity, asked, declared } => {
            Some(Remedy::RaiseDeclaration { quantity, asked, declared })
        }
        PermissionExcess::Command(_)
        | PermissionExcess::Zone(_)
        | PermissionExcess::Peak { .. }
        | PermissionExcess::Budget { .. }
        | PermissionExcess::Fault { .. }
        | PermissionExcess::Sensor(_)
        | PermissionExcess::Tool(_) => None,
    };
    excesses.into_iter().filter_map(raise).collect()
}

/// Whether the guard may be the cause of what was found, because it clamps commands to the declaration: drills fail, or the
/// excess itself is measured.
fn may_be_by_clamping(reason: &ReasonRecord) -> bool {
    let of_excess = matches!(
        reason.finding,
        Some(
            Finding::HarmWorse { measure: HarmKind::ExcessDepth | HarmKind::ExcessShare, .. }
                | Finding::HarmLimitWorse { measure: HarmKind::ExcessDepth | HarmKind::ExcessShare, .. }
        )
    );
    let of_drills = matches!(
        reason.code.known(),
        Some(
            ReasonCode::BehaviorAsksMore
                | ReasonCode::RecoveryBelowThreshold
                | ReasonCode::RecoveryFarBelowFloor
                | ReasonCode::RecoveryRollbackBelowFloor
                | ReasonCode::RecoveryFragile
                | ReasonCode::RecoveryConditional
                | ReasonCode::RecoveryLeaning
                | ReasonCode::RecoveryEstablishedWorse
                | ReasonCode::RecoveryPhaseFailing
                | ReasonCode::RecoveryPhaseWorse
        )
    );
    of_excess || of_drills
}

/// The finding is the case no longer: all that is known of a reason whose code names no action.
fn resolve(reason: &ReasonRecord) -> Remedy {
    Remedy::Resolve(reason.content())
}

/// What would remove a worsening. `None` if it is within its margin, and others have to change.
fn worsening_remedy(
    code: ReasonCode,
    found: &BehaviorComponent,
    evidence_file: &EvidenceFileRecord,
) -> Option<Remedy> {
    let is_within = match code {
        // The mean is what counts of a significant worsening; its upper bound excludes nothing here.
        ReasonCode::BehaviorEstablishedWorse | ReasonCode::BehaviorSafetyTraded => {
            found.worsening < found.limit()
        }
        _ => found.is_within_tolerance(),
    };
    if !is_within {
        return Some(Remedy::WorsenLess { component: *found, fewer: fewer(found, evidence_file) });
    }
    if code == ReasonCode::BehaviorSafetyTraded || found.decides_alone() {
        return Some(Remedy::EndSignificance(*found));
    }
    let behavior = evidence_file.behavior.as_ref()?;
    (!is_tolerated(found, behavior)).then_some(Remedy::Act(RemedyAction::ReduceSum))
}

/// Whether a worsening within its margin decided nothing: others decide, or all significant ones together lie within what
/// the sum of them allows.
#[must_use]
pub fn is_tolerated(found: &BehaviorComponent, behavior: &BehaviorAssessment) -> bool {
    let significant = || behavior.components.iter().filter(|of| of.is_established());
    let decides =
        |of: &BehaviorComponent| of.decides_alone() || (of.is_established() && of.worsening > of.tolerance);
    // Each share is that of the worsening which alone brings the value to its threshold.
    let sum: f64 = significant().map(|of| of.worsening.max(0.0) / of.tolerance).sum();
    !decides(found)
        && (significant().any(decides)
            || behavior.harm.iter().any(HarmComparison::is_established)
            || sum <= 1.0)
}

/// Whether a reason is a worsening within its margin, beside others that decide.
#[must_use]
pub fn is_within_margin(reason: &ReasonRecord, evidence_file: &EvidenceFileRecord) -> bool {
    let worsened = matches!(
        reason.code.known(),
        Some(
            ReasonCode::BehaviorEstablishedWorse
                | ReasonCode::BehaviorSuspicious
                | ReasonCode::BehaviorSafetyTraded
        )
    );
    worsened && remedy(reason, evidence_file).is_none()
}

/// How many fewer episodes may be worse for the upper bound to lie within the margin. Absent for values that are not counted
/// per episode (time, retries).
fn fewer(component: &BehaviorComponent, evidence_file: &EvidenceFileRecord) -> Option<EpisodeReduction> {
    if matches!(component.name, ComponentName::Time | ComponentName::Retry) {
        return None;
    }
    let pairs = evidence_file.pairs.iter().flatten();
    let counts = PairedCounts::of(pairs.filter_map(|pair| component.name.is_bad_in(pair)));
    let fits = |fewer: u64| {
        let counts = PairedCounts { candidate_only: counts.candidate_only.checked_sub(fewer)?, ..counts };
        let bound = binary_pairs(counts, component.upper_alpha).ok()?;
        let is_alone = component.name == ComponentName::Success && component.decides_alone();
        Some(if is_alone { bound.mean < component.limit() } else { bound.upper <= component.tolerance })
    };
    let fewer = (0..=counts.candidate_only).find(|fewer| fits(*fewer) == Some(true))?;
    Some(EpisodeReduction { fewer, of: counts.pairs })
}

/// How many rollback drills have to pass.
fn rollback_drills(reason: &ReasonRecord, evidence_file: &EvidenceFileRecord) -> Remedy {
    let (Some((candidate, _)), Some(floor)) = (&evidence_file.drills, reason.limit) else {
        return resolve(reason);
    };
    let (passed, all) = (candidate.rollback.passed, candidate.rollback.feasible());
    match needed(floor, all) {
        Some(needed) => Remedy::PassRollbackDrills { passed, all, needed },
        None => resolve(reason),
    }
}

/// The fewest of `all` whose share is at least `floor`.
fn needed(floor: f64, all: u32) -> Option<u32> {
    (0..=all).find(|passed| all > 0 && f64::from(*passed) / f64::from(all) >= floor)
}

/// The drills that lower recovery most.
fn weakest_drills(reason: &ReasonRecord, evidence_file: &EvidenceFileRecord) -> Remedy {
    let share = |tally: &DrillTally| f64::from(tally.passed) / f64::from(tally.feasible());
    let weakest = evidence_file.drills.as_ref().and_then(|(candidate, _)| {
        let tallies = DrillKind::ALL.map(|kind| (kind, *candidate.of(kind)));
        let feasible = tallies.into_iter().filter(|(_, tally)| tally.feasible() > 0);
        feasible.min_by(|(_, a), (_, b)| share(a).total_cmp(&share(b)))
    });
    match weakest {
        Some((weakest, tally)) => {
            Remedy::StrengthenRecovery { weakest, tally, recovery: reason.evidence, least: reason.limit }
        }
        None => resolve(reason),
    }
}

/// How many operators have to approve.
fn missing_people(reason: &ReasonRecord) -> Remedy {
    match reason.evidence {
        Some(missing) if missing >= 0.5 => {
            #[allow(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a few people, at least one"
            )]
            let missing = missing.round() as u32;
            Remedy::Approve { missing }
        }
        _ => resolve(reason),
    }
}

#[cfg(test)]
mod tests;
