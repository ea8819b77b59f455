//! Which rule a reason belongs to, what was measured for it, and what would have to change.
//!
//! Counts are computed from the raw pairs and drills in the record by the rule's own statistics, never guessed: a
//! number of episodes is the smallest that brings the rule's bound within its limit.

use super::on_record::{DossierRecord, Noted};
use holdpoint_governance::behavior::{Component, ComponentName, component_of};
use holdpoint_governance::decision::{Dimension, ReasonCode};
use holdpoint_governance::evidence::{DrillKind, DrillTally, Drills, EpisodeValues};
use holdpoint_governance::phase::PhaseTallies;
use holdpoint_governance::rollback::RungFailure;
use holdpoint_governance::stats::{PairedCounts, binary_pairs};

/// The error rate of the one-sided upper bound that the behavioural rule asks for (design rule 3.4).
const UPPER_ALPHA: f64 = 0.05;

/// Whether a reason speaks for the version: nothing has to change for it.
#[must_use]
pub const fn is_in_favour(code: ReasonCode) -> bool {
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

/// The component a behavioural reason is about, as it was measured.
fn component<'a>(reason: &Noted, dossier: &'a DossierRecord) -> Option<&'a Component> {
    let behavior = dossier.behavior.as_ref().filter(|_| reason.is_about(Dimension::Behavior))?;
    let about = component_of(*reason.code.known()?, &reason.text)?;
    behavior.components.iter().find(|component| component.name == about)
}

/// What was measured for a reason, if the evidence tells more than the reason.
pub(super) fn measured(reason: &Noted, dossier: &DossierRecord) -> Option<String> {
    if let Some(component) = component(reason, dossier) {
        let n = dossier.behavior.as_ref().map_or(0, |behavior| behavior.pairs);
        let Component { name, worsening, lower, upper, tolerance } = component;
        let upper =
            upper.map_or_else(|| "no upper bound".to_owned(), |upper| format!("95 % bound {upper:.3}"));
        let name = name.name();
        return Some(format!(
            "{name} {worsening:+.3} over n = {n} pairs, at least {lower:.3}, {upper}, tolerance {tolerance:.3}"
        ));
    }
    if reason.is_about(Dimension::Recovery) && reason.code != ReasonCode::RecoveryNoData {
        let (candidate, active) = dossier.drills.as_ref()?;
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
        let shadow = dossier.shadow.as_ref()?;
        return Some(format!("n = {} shadow sequences", shadow.sequences));
    }
    None
}

/// What would have to change for a reason to go away; `None` if it speaks for the version.
pub(super) fn change(reason: &Noted, dossier: &DossierRecord) -> Option<String> {
    use ReasonCode as Code;
    // What another build wrote is told with its number against its limit.
    let Some(code) = reason.code.known() else { return Some(against(reason)) };
    let text = match code {
        Code::BehaviorEstablishedWorse | Code::BehaviorSuspicious | Code::BehaviorSafetyTraded => {
            component(reason, dossier).map_or_else(|| against(reason), |found| behaviour(found, dossier))
        }
        Code::BehaviorHarmEstablished | Code::BehaviorHarmSuspicious => {
            format!("it may harm no more than the active version does, beyond the tolerance: {}", against(reason))
        }
        Code::BehaviorSequenceWorse | Code::BehaviorSequenceSuspicious => {
            format!("it has to leave the arm and the object as the skills after it need them: {}", against(reason))
        }
        Code::BehaviorAsksMore => {
            "its manifest has to declare what its code asks for, or its code has to ask for no more".to_owned()
        }
        Code::BehaviorNoData | Code::CompositionNoData => {
            "it has to be measured: the next stage does that".to_owned()
        }
        // The end of an evaluation is no demand of its own: what ended it stands beside it.
        Code::BehaviorEndedEarly | Code::RecoveryEndedEarly => return None,
        // Of the version that is active: nothing of the candidate would change it.
        Code::RecoveryActiveWeak => return None,
        Code::BehaviorInconclusive => format!("more paired episodes are needed: {}", against(reason)),
        Code::BehaviorHardStop => {
            "what the version uses has to be declared, and the event made impossible: one of them ends an evaluation"
                .to_owned()
        }
        Code::RecoveryRollbackBelowFloor => drills(reason, dossier),
        Code::RecoveryBelowThreshold
        | Code::RecoveryFarBelowFloor
        | Code::RecoveryFragile
        | Code::RecoveryConditional => weakest(reason, dossier),
        Code::RecoveryPhaseFailing => format!("they have to pass in that phase too: {}", against(reason)),
        Code::RecoveryEstablishedWorse | Code::RecoveryPhaseWorse | Code::RecoveryLeaning => {
            format!("they have to pass as often as the active version's: {}", against(reason))
        }
        Code::RecoveryNoData
        | Code::ShadowNoData
        | Code::GateNoData
        | Code::InterfaceNoData
        | Code::PolicyNoData => {
            format!("evidence is missing: {}", reason.text)
        }
        Code::RecoveryHookMissing => format!("export the hook: {}", reason.text),
        Code::RecoveryFallbackUnresolved => "bind a fallback that is registered and may take over".to_owned(),
        Code::RecoverySignalUnknown => format!("declare failure signals the watcher knows: {}", reason.text),
        Code::RecoveryPredecessorNotLoadable => {
            "the predecessor has to load and be true to its digest".to_owned()
        }
        Code::InterfaceVersionMislabelled => format!("raise the version number by more: {}", reason.text),
        Code::InterfaceUndeclaredChange => {
            format!("declare it in submission.toml, [[interface_changes]]: {}", reason.text)
        }
        Code::InterfaceExportMismatch => format!("manifest and code have to say the same: {}", reason.text),
        Code::InterfaceDependencyBreaking | Code::InterfaceDependencyAdaptable => {
            format!("name a dependency the registry can meet: {}", reason.text)
        }
        Code::InterfaceSignatureAdaptable
        | Code::InterfaceSchemaAdaptable
        | Code::InterfaceConditionAdaptable => {
            format!("declare it as before, and callers need not change: {}", reason.text)
        }
        Code::InterfaceSignatureBreaking
        | Code::InterfaceSchemaBreaking
        | Code::InterfaceConditionBreaking => {
            format!("declare it as the active version does (type, unit, frame, range): {}", reason.text)
        }
        Code::PolicyUncoveredHighRisk | Code::PolicyUncoveredMode | Code::PolicyBelowThreshold => {
            format!("a policy has to cover it, or the manifest must not reach it: {}", reason.text)
        }
        Code::PolicyForbiddenMode => format!("the manifest must not reach it: {}", reason.text),
        Code::PolicyUndeclaredImport => format!("declare the permission, or do not use it: {}", reason.text),
        Code::PolicyEnvironmentNotAdmitted => format!("admit this profile in [deployment]: {}", reason.text),
        Code::PolicyAuthorityReview | Code::PolicyEscalation | Code::PolicyNewPermission => {
            format!("ask for less, or have people review it: {}", reason.text)
        }
        Code::ApprovalPending => missing_people(reason),
        Code::ApprovalRefused => "people would have to approve a new registration".to_owned(),
        Code::ApprovalTimeout => {
            "people have to answer by the deadline; `holdpoint resume` asks again".to_owned()
        }
        Code::GateClockDoubted => {
            "a person has to confirm the time (`holdpoint confirm-time`); `holdpoint resume` asks the gate again".to_owned()
        }
        Code::GateFrozen => "the freeze has to end".to_owned(),
        Code::GateProfileUnauthorized => {
            "an administrator has to sign the profile: `holdpoint profile allow`".to_owned()
        }
        Code::GateNoImprovement => "an improvement over the active version has to be established".to_owned(),
        Code::GateStaleEvidence => "the stages have to be run again under what holds now".to_owned(),
        Code::ShadowGovernanceDivergence => {
            format!(
                "the twin may not have more policy hits or watcher events than the live world: {}",
                against(reason)
            )
        }
        Code::MonitorWorkedAgain | Code::ShadowWorkedAgain => {
            "beside the version before it, under the live cell's own conditions, it may be no worse".to_owned()
        }
        Code::MonitorShifted => "it has to be live what its twins in shadow were".to_owned(),
        Code::ShadowShifted => {
            "it has to be in the live world what it was in the sandbox, or be tried where the two differ".to_owned()
        }
        Code::ShadowOutputDivergence | Code::ShadowEnvelopeDivergence | Code::ShadowLeaning => {
            format!("it only lengthens shadow: {}", against(reason))
        }
        Code::MonitorSafetyTrip => "no safety event: the first one takes a version off".to_owned(),
        Code::GateShadowTooShort => format!("shadow has to be worked longer: {}", against(reason)),
        Code::GateDependencyUnmet => {
            format!("the version it depends on has to become active first: {}", reason.text)
        }
        Code::PolicySimulationOnly | Code::GateSimulationOnly => {
            format!("admit other profiles in [deployment]: {}", reason.text)
        }
        Code::MonitorRateTrip | Code::MonitorRateWarning | Code::MonitorCoupledTrip => {
            format!("the rate has to stay as it was measured before activation: {}", against(reason))
        }
        Code::MonitorTelemetryMissing => format!("telemetry has to arrive: {}", against(reason)),
        Code::MonitorEscalationUnanswered => {
            "somebody has to answer an escalation by its deadline".to_owned()
        }
        Code::MonitorOperator => "a person asked for it".to_owned(),
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
        | Code::ApprovalBreakGlass => against(reason),
        // They speak for the version, or only say that another reason caps it.
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

/// What would have to be otherwise for a rung to hold.
pub(super) const fn of_failure(failure: RungFailure) -> &'static str {
    match failure {
        RungFailure::HookFailed => "the safe-abort hook has to bring the arm to a stand in its declared time",
        RungFailure::NoStandstill => {
            "every joint has to stand within a second of the interrupt: look at the arm"
        }
        RungFailure::RetreatBlocked => "the way up has to be free: look at the arm",
        RungFailure::PredecessorMissing => "there has to be a superseded version to go back to",
        RungFailure::DigestMismatch => {
            "the predecessor in the store has to be what was registered: verify the audit"
        }
        RungFailure::PolicyMismatch => "the policies in force have to be those of the profile",
        RungFailure::StoreFailed => "the store has to be readable and writable",
        RungFailure::PredecessorFailed => "the predecessor has to give a command that its guard passes",
        RungFailure::NotRecovered => "the predecessor has to work without a safety event",
    }
}

/// The reason with its number against its limit.
fn against(reason: &Noted) -> String {
    match (reason.evidence, reason.limit) {
        (Some(found), Some(limit)) => format!("{} ({found:.3} against a limit of {limit:.3})", reason.text),
        _ => reason.text.clone(),
    }
}

fn behaviour(component: &Component, dossier: &DossierRecord) -> String {
    let Component { name, worsening, upper, tolerance, .. } = component;
    let name = name.name();
    let bound = upper.map_or_else(|| "unbounded".to_owned(), |upper| format!("95 % bound {upper:.3}"));
    let fewer = fewer(component, dossier)
        .map_or_else(String::new, |(fewer, all)| format!(": {fewer} fewer of {all} episodes"));
    format!("{name} {worsening:+.3} ({bound}) must be at most {tolerance:.3}{fewer}")
}

/// How many episodes fewer may be worse for the upper bound to come within the tolerance. Absent for what is not
/// counted per episode (time, retries).
fn fewer(component: &Component, dossier: &DossierRecord) -> Option<(u64, u64)> {
    let bad: fn(&EpisodeValues) -> bool = match component.name {
        ComponentName::Success => |values| !values.success,
        ComponentName::Violation => |values| values.violation,
        ComponentName::Anomaly => |values| values.anomaly,
        ComponentName::Recovery => |values| values.recovery,
        ComponentName::Time | ComponentName::Retry => return None,
    };
    let counts = PairedCounts::of(
        dossier.pairs.iter().flatten().map(|pair| (bad(&pair.candidate), bad(&pair.active))),
    );
    let fits = |fewer: u64| {
        let counts = PairedCounts { candidate_only: counts.candidate_only.checked_sub(fewer)?, ..counts };
        let bound = binary_pairs(counts, UPPER_ALPHA).ok()?;
        Some(bound.upper <= component.tolerance)
    };
    (0..=counts.candidate_only).find(|less| fits(*less) == Some(true)).map(|less| (less, counts.pairs))
}

/// `rollback drills passed 26 of 40; 28 are needed`.
fn drills(reason: &Noted, dossier: &DossierRecord) -> String {
    let (Some((candidate, _)), Some(floor)) = (&dossier.drills, reason.limit) else { return against(reason) };
    let (passed, all) = (candidate.rollback.passed, candidate.rollback.feasible());
    match needed(floor, all) {
        Some(needed) => format!("rollback drills passed {passed} of {all}; {needed} are needed"),
        None => against(reason),
    }
}

/// The fewest of `all` whose share is at least `floor`.
fn needed(floor: f64, all: u32) -> Option<u32> {
    (0..=all).find(|passed| all > 0 && f64::from(*passed) / f64::from(all) >= floor)
}

/// The drills that pull recovery down.
fn weakest(reason: &Noted, dossier: &DossierRecord) -> String {
    let share = |tally: &DrillTally| f64::from(tally.passed) / f64::from(tally.feasible());
    let lowest = |drills: &Drills| {
        let tallies = DrillKind::ALL.map(|kind| (kind.name(), *drills.of(kind)));
        let held = tallies.into_iter().filter(|(_, tally)| tally.feasible() > 0);
        held.min_by(|(_, a), (_, b)| share(a).total_cmp(&share(b)))
    };
    let low = dossier.drills.as_ref().and_then(|(candidate, _)| lowest(candidate));
    let limit = reason.limit.map_or_else(String::new, |limit| format!(", at least {limit:.3} is needed"));
    let found = reason.evidence.map_or_else(String::new, |found| format!(" {found:.3}{limit}"));
    match low {
        Some((kind, tally)) => {
            let (passed, all) = (tally.passed, tally.feasible());
            format!("recovery{found}; weakest are the {kind} drills, {passed} of {all} passed")
        }
        None => against(reason),
    }
}

/// `approval by 1 more person`.
fn missing_people(reason: &Noted) -> String {
    match reason.evidence {
        Some(missing) if missing >= 0.5 => {
            let people = if missing < 1.5 { "operator" } else { "operators" };
            format!("approval by {missing:.0} more {people}")
        }
        _ => against(reason),
    }
}

#[cfg(test)]
mod tests;
