//! The rule of a reason, its measured values, and the change that would remove it.
//!
//! Counts are computed from the raw pairs and drills on record with the rule's own statistics. A number of episodes is the
//! smallest one that brings the rule's bound within its limit.

use super::lenient_bodies::{EvidenceFileRecord, ReasonRecord};
use holdpoint_governance::behavior::{BehaviorComponent, ComponentName, component_of};
use holdpoint_governance::decision::{Dimension, ReasonCode};
use holdpoint_governance::evidence::{DrillKind, DrillTallies, DrillTally, EpisodeValues};
use holdpoint_governance::phase::PhaseTallies;
use holdpoint_governance::rollback::RungFailure;
use holdpoint_governance::stats::{PairedCounts, binary_pairs};

/// The error rate of the one-sided upper bound in the behavioral rule (design rule 3.4).
const UPPER_ALPHA: f64 = 0.05;

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

/// The measured component of a behavioral reason.
fn component<'a>(
    reason: &ReasonRecord,
    evidence_file: &'a EvidenceFileRecord,
) -> Option<&'a BehaviorComponent> {
    let behavior = evidence_file.behavior.as_ref().filter(|_| reason.is_about(Dimension::Behavior))?;
    let about = component_of(&reason.known()?)?;
    behavior.components.iter().find(|component| component.name == about)
}

/// The measured values for a reason, if the evidence has more than the reason.
pub(super) fn measured(reason: &ReasonRecord, evidence_file: &EvidenceFileRecord) -> Option<String> {
    if let Some(component) = component(reason, evidence_file) {
        let n = evidence_file.behavior.as_ref().map_or(0, |behavior| behavior.pairs);
        let BehaviorComponent { name, worsening, lower, upper, tolerance } = component;
        let upper =
            upper.map_or_else(|| "no upper bound".to_owned(), |upper| format!("95 % bound {upper:.3}"));
        let name = name.name();
        return Some(format!(
            "{name} {worsening:+.3} over n = {n} pairs, at least {lower:.3}, {upper}, margin {tolerance:.3}"
        ));
    }
    if reason.is_about(Dimension::Recovery) && reason.code != ReasonCode::RecoveryNoData {
        let (candidate, active) = evidence_file.drills.as_ref()?;
        let share = |tally: &DrillTally| format!("{}/{}", tally.passed, tally.feasible());
        let kinds: Vec<String> = DrillKind::ALL
            .into_iter()
            .map(|kind| (kind.name(), candidate.of(kind), active.of(kind)))
            .filter(|(_, new, _)| new.feasible() > 0)
            .map(|(kind, new, old)| format!("{kind} {} (active {})", share(new), share(old)))
            .chain(PhaseTallies::places().filter_map(|(kind, phase)| {
                let (new, old) = (candidate.phases.of(kind, phase), active.phases.of(kind, phase));
                let failed = new.failed > 0;
                failed.then(|| format!("{kind} in {phase} {} (active {})", share(new), share(old)))
            }))
            .collect();
        return (!kinds.is_empty()).then(|| format!("drills passed: {}", kinds.join(", ")));
    }
    if reason.is_about(Dimension::Shadow) {
        let shadow = evidence_file.shadow.as_ref()?;
        return Some(format!("n = {} shadow sequences", shadow.sequences));
    }
    None
}

/// The change that would remove a reason; `None` if it supports the version.
pub(super) fn change(reason: &ReasonRecord, evidence_file: &EvidenceFileRecord) -> Option<String> {
    use ReasonCode as Code;
    // A code of another build is shown with its number against its limit.
    let Some(code) = reason.code.known() else { return Some(limit_sentence(reason)) };
    let text = match code {
        Code::BehaviorEstablishedWorse | Code::BehaviorSuspicious | Code::BehaviorSafetyTraded => {
            component(reason, evidence_file).map_or_else(|| limit_sentence(reason), |found| behavior_sentence(found, evidence_file))
        }
        Code::BehaviorHarmEstablished | Code::BehaviorHarmSuspicious => {
            format!("it may harm no more than the active version does, beyond the margin: {}", limit_sentence(reason))
        }
        Code::BehaviorSequenceWorse | Code::BehaviorSequenceSuspicious => {
            format!("it has to leave the arm and the object as the skills after it need them: {}", limit_sentence(reason))
        }
        Code::BehaviorAsksMore => {
            "its manifest has to declare every request of its code, or its code has to request no more".to_owned()
        }
        Code::BehaviorNoData | Code::CompositionNoData => {
            "it has to be measured: the next stage does that".to_owned()
        }
        // The early end of an evaluation is not a cause; the cause is a separate reason.
        Code::BehaviorEndedEarly | Code::RecoveryEndedEarly => return None,
        // It concerns the active version; no change of the candidate would remove it.
        Code::RecoveryActiveWeak => return None,
        Code::BehaviorInconclusive => format!("more paired episodes are needed: {}", limit_sentence(reason)),
        Code::BehaviorHardStop => {
            "the manifest has to declare every permission in use, and the event must not occur: one ends an evaluation"
                .to_owned()
        }
        Code::RecoveryRollbackBelowFloor => drills(reason, evidence_file),
        Code::RecoveryBelowThreshold
        | Code::RecoveryFarBelowFloor
        | Code::RecoveryFragile
        | Code::RecoveryConditional => weakest(reason, evidence_file),
        Code::RecoveryPhaseFailing => format!("they have to pass in that phase too: {}", limit_sentence(reason)),
        Code::RecoveryEstablishedWorse | Code::RecoveryPhaseWorse | Code::RecoveryLeaning => {
            format!("they have to pass as often as the active version's: {}", limit_sentence(reason))
        }
        Code::RecoveryNoData
        | Code::ShadowNoData
        | Code::GateNoData
        | Code::InterfaceNoData
        | Code::PolicyNoData => {
            format!("evidence is missing: {}", reason.text())
        }
        Code::RecoveryHookMissing => format!("export the hook: {}", reason.text()),
        Code::RecoveryFallbackUnresolved => "bind a fallback that is registered and may take over".to_owned(),
        Code::RecoverySignalUnknown => format!("declare failure signals the watcher knows: {}", reason.text()),
        Code::RecoveryPredecessorNotLoadable => {
            "the rollback target has to load with its recorded digest".to_owned()
        }
        Code::InterfaceVersionMislabelled => format!("raise the version number by more: {}", reason.text()),
        Code::InterfaceUndeclaredChange => {
            format!("declare it in submission.toml, [[interface_changes]]: {}", reason.text())
        }
        Code::InterfaceExportMismatch => format!("manifest and code have to agree: {}", reason.text()),
        Code::InterfaceDependencyBreaking | Code::InterfaceDependencyAdaptable => {
            format!("name a dependency the registry can meet: {}", reason.text())
        }
        Code::InterfaceSignatureAdaptable
        | Code::InterfaceSchemaAdaptable
        | Code::InterfaceConditionAdaptable => {
            format!("declare it as before, and callers need not change: {}", reason.text())
        }
        Code::InterfaceSignatureBreaking
        | Code::InterfaceSchemaBreaking
        | Code::InterfaceConditionBreaking => {
            format!("declare it as the active version does (type, unit, frame, range): {}", reason.text())
        }
        Code::PolicyUncoveredHighRisk | Code::PolicyUncoveredMode | Code::PolicyBelowThreshold => {
            format!("a policy has to cover it, or the manifest must not reach it: {}", reason.text())
        }
        Code::PolicyForbiddenMode => format!("the manifest must not reach it: {}", reason.text()),
        Code::PolicyUndeclaredImport => format!("declare the permission, or do not use it: {}", reason.text()),
        Code::PolicyEnvironmentNotAdmitted => format!("admit this profile in [deployment]: {}", reason.text()),
        Code::PolicyAuthorityReview | Code::PolicyEscalation | Code::PolicyNewPermission => {
            format!("ask for less, or have people review it: {}", reason.text())
        }
        Code::ApprovalPending => missing_people(reason),
        Code::ApprovalRefused => "approvers would have to approve a new registration".to_owned(),
        Code::ApprovalTimeout => {
            "approvers have to answer by the deadline; `holdpoint resume` asks again".to_owned()
        }
        Code::GateClockDoubted => {
            "a person has to confirm the time (`holdpoint confirm-time`); `holdpoint resume` asks the gate again".to_owned()
        }
        Code::GateFrozen => "the freeze has to end".to_owned(),
        Code::GateProfileUnauthorized => {
            "an administrator has to sign the profile: `holdpoint profile allow`".to_owned()
        }
        Code::GateNoImprovement => "an improvement over the active version has to be significant".to_owned(),
        Code::GateStaleEvidence => "the stages have to be run again under the present context".to_owned(),
        Code::ShadowGovernanceDivergence => {
            format!(
                "the twin may not have more policy hits or watcher events than the live cell: {}",
                limit_sentence(reason)
            )
        }
        Code::MonitorWorkedAgain | Code::ShadowWorkedAgain => {
            "it may be no worse than the version before it under the conditions of the live cell".to_owned()
        }
        Code::MonitorShifted => "its live behavior has to match its twins in shadow".to_owned(),
        Code::ShadowShifted => {
            "its live behavior has to match the sandbox, or it has to be evaluated where the two differ".to_owned()
        }
        Code::ShadowOutputDivergence | Code::ShadowEnvelopeDivergence | Code::ShadowLeaning => {
            format!("it only lengthens shadow: {}", limit_sentence(reason))
        }
        Code::MonitorSafetyTrip => "no safety event: the first one rolls a version back".to_owned(),
        Code::GateShadowTooShort => format!("shadow has to run longer: {}", limit_sentence(reason)),
        Code::GateDependencyUnmet => {
            format!("the version it depends on has to become active first: {}", reason.text())
        }
        Code::PolicySimulationOnly | Code::GateSimulationOnly => {
            format!("admit other profiles in [deployment]: {}", reason.text())
        }
        Code::MonitorRateTrip | Code::MonitorRateWarning | Code::MonitorCoupledTrip => {
            format!("the rate has to stay as it was measured before activation: {}", limit_sentence(reason))
        }
        Code::MonitorTelemetryMissing => format!("telemetry has to arrive: {}", limit_sentence(reason)),
        Code::MonitorEscalationUnanswered => {
            "an operator has to answer an escalation by its deadline".to_owned()
        }
        Code::MonitorOperator => "an operator requested it".to_owned(),
        Code::PolicyResourcesExceeded
        | Code::PolicyTighterEnvelope
        | Code::BehaviorEstimated
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
        | Code::ApprovalBreakGlass => limit_sentence(reason),
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
        | Code::CompositionRestricted => return None,
    };
    Some(text)
}

/// The condition under which a rung would hold.
pub(super) const fn of_failure(failure: RungFailure) -> &'static str {
    match failure {
        RungFailure::HookFailed => {
            "the safe-abort hook has to bring the arm to a standstill in its declared time"
        }
        RungFailure::NoStandstill => {
            "every joint has to be at standstill within a second of the interrupt: inspect the arm"
        }
        RungFailure::RetreatBlocked => "the way up has to be free: inspect the arm",
        RungFailure::PredecessorMissing => "there has to be a superseded version as the rollback target",
        RungFailure::DigestMismatch => {
            "the rollback target in the store has to match its registration: verify the audit"
        }
        RungFailure::PolicyMismatch => "the policies in force have to be those of the profile",
        RungFailure::StoreFailed => "the store has to be readable and writable",
        RungFailure::PredecessorFailed => "the rollback target has to give a command that its guard passes",
        RungFailure::NotRecovered => "the rollback target has to run without a safety event",
    }
}

/// The reason with its number against its limit.
fn limit_sentence(reason: &ReasonRecord) -> String {
    match (reason.evidence, reason.limit) {
        (Some(found), Some(limit)) => format!("{} ({found:.3} against a limit of {limit:.3})", reason.text()),
        _ => reason.text(),
    }
}

fn behavior_sentence(component: &BehaviorComponent, evidence_file: &EvidenceFileRecord) -> String {
    let BehaviorComponent { name, worsening, upper, tolerance, .. } = component;
    let name = name.name();
    let bound = upper.map_or_else(|| "unbounded".to_owned(), |upper| format!("95 % bound {upper:.3}"));
    let fewer = fewer(component, evidence_file)
        .map_or_else(String::new, |(fewer, all)| format!(": {fewer} fewer of {all} episodes"));
    format!("{name} {worsening:+.3} ({bound}) must be at most {tolerance:.3}{fewer}")
}

/// How many fewer episodes may be worse for the upper bound to lie within the margin. Absent for values that are not counted
/// per episode (time, retries).
fn fewer(component: &BehaviorComponent, evidence_file: &EvidenceFileRecord) -> Option<(u64, u64)> {
    let bad: fn(&EpisodeValues) -> bool = match component.name {
        ComponentName::Success => |values| !values.success,
        ComponentName::Violation => |values| values.violation,
        ComponentName::Anomaly => |values| values.anomaly,
        ComponentName::Recovery => |values| values.recovery,
        ComponentName::Time | ComponentName::Retry => return None,
    };
    let counts = PairedCounts::of(
        evidence_file.pairs.iter().flatten().map(|pair| (bad(&pair.candidate), bad(&pair.active))),
    );
    let fits = |fewer: u64| {
        let counts = PairedCounts { candidate_only: counts.candidate_only.checked_sub(fewer)?, ..counts };
        let bound = binary_pairs(counts, UPPER_ALPHA).ok()?;
        Some(bound.upper <= component.tolerance)
    };
    (0..=counts.candidate_only).find(|less| fits(*less) == Some(true)).map(|less| (less, counts.pairs))
}

/// `rollback drills passed 26 of 40; 28 are needed`.
fn drills(reason: &ReasonRecord, evidence_file: &EvidenceFileRecord) -> String {
    let (Some((candidate, _)), Some(floor)) = (&evidence_file.drills, reason.limit) else {
        return limit_sentence(reason);
    };
    let (passed, all) = (candidate.rollback.passed, candidate.rollback.feasible());
    match needed(floor, all) {
        Some(needed) => format!("rollback drills passed {passed} of {all}; {needed} are needed"),
        None => limit_sentence(reason),
    }
}

/// The fewest of `all` whose share is at least `floor`.
fn needed(floor: f64, all: u32) -> Option<u32> {
    (0..=all).find(|passed| all > 0 && f64::from(*passed) / f64::from(all) >= floor)
}

/// The drills that lower recovery.
fn weakest(reason: &ReasonRecord, evidence_file: &EvidenceFileRecord) -> String {
    let share = |tally: &DrillTally| f64::from(tally.passed) / f64::from(tally.feasible());
    let lowest = |drills: &DrillTallies| {
        let tallies = DrillKind::ALL.map(|kind| (kind.name(), *drills.of(kind)));
        let feasible = tallies.into_iter().filter(|(_, tally)| tally.feasible() > 0);
        feasible.min_by(|(_, a), (_, b)| share(a).total_cmp(&share(b)))
    };
    let low = evidence_file.drills.as_ref().and_then(|(candidate, _)| lowest(candidate));
    let limit = reason.limit.map_or_else(String::new, |limit| format!(", at least {limit:.3} is needed"));
    let found = reason.evidence.map_or_else(String::new, |found| format!(" {found:.3}{limit}"));
    match low {
        Some((kind, tally)) => {
            let (passed, all) = (tally.passed, tally.feasible());
            format!("recovery{found}; weakest are the {kind} drills, {passed} of {all} passed")
        }
        None => limit_sentence(reason),
    }
}

/// `approval by 1 more person`.
fn missing_people(reason: &ReasonRecord) -> String {
    match reason.evidence {
        Some(missing) if missing >= 0.5 => {
            let people = if missing < 1.5 { "operator" } else { "operators" };
            format!("approval by {missing:.0} more {people}")
        }
        _ => limit_sentence(reason),
    }
}

#[cfg(test)]
mod tests;
