//! Why something was decided: the vocabulary of reasons, and what is said of them as a set.

use serde::{Deserialize, Serialize};

macro_rules! reason_codes {
    ($($(#[$doc:meta])* $name:ident = $text:literal,)*) => {
        /// Why something was decided: a closed set of stable names (used by scenario files and the audit record).
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, schemars::JsonSchema)]
        pub enum ReasonCode {
            $($(#[$doc])* #[serde(rename = $text)] $name,)*
        }

        impl ReasonCode {
            /// Every reason there is, in the order of declaration.
            pub const ALL: &'static [Self] = &[$(Self::$name,)*];

            /// The stable name, kebab-case.
            #[must_use]
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$name => $text,)* }
            }
        }
    };
}

reason_codes! {
    /// The interface is as before, or a proper refinement.
    InterfaceCompatible = "interface-compatible",
    /// A call valid for the active version is not valid for the candidate.
    InterfaceSignatureBreaking = "interface-signature-breaking",
    /// A caller would need an adapter; in records of older builds.
    InterfaceSignatureAdaptable = "interface-signature-adaptable",
    /// An output's type, unit or frame changed, or an output went away.
    InterfaceSchemaBreaking = "interface-schema-breaking",
    /// An output's form differs in a way an adapter could mend; in records of older builds.
    InterfaceSchemaAdaptable = "interface-schema-adaptable",
    /// A precondition was strengthened or a postcondition weakened, beyond mending.
    InterfaceConditionBreaking = "interface-condition-breaking",
    /// A precondition was strengthened within what the dispatcher checks before each call.
    InterfaceConditionAdaptable = "interface-condition-adaptable",
    /// A dependency has no version in the registry, or the dependencies form a cycle.
    InterfaceDependencyBreaking = "interface-dependency-breaking",
    /// A dependency is met by a registered version that is not the active one.
    InterfaceDependencyAdaptable = "interface-dependency-adaptable",
    /// The code's exports are not what the manifest says.
    InterfaceExportMismatch = "interface-export-mismatch",
    /// The version number promises more compatibility than was found.
    InterfaceVersionMislabelled = "interface-version-mislabelled",
    /// The interface differs where the submission declares no change, or the reverse.
    InterfaceUndeclaredChange = "interface-undeclared-change",
    /// Nothing was there to assess the interface with.
    InterfaceNoData = "interface-no-data",

    /// Every reachable mode is covered and allowed.
    PolicyCompatible = "policy-compatible",
    /// A mode the version can reach is forbidden by a policy.
    PolicyForbiddenMode = "policy-forbidden-mode",
    /// A reachable mode of high risk is covered by no policy.
    PolicyUncoveredHighRisk = "policy-uncovered-high-risk",
    /// A reachable mode is covered by no policy.
    PolicyUncoveredMode = "policy-uncovered-mode",
    /// Too small a share of the reachable modes is covered.
    PolicyBelowThreshold = "policy-below-threshold",
    /// The code needs a mode the manifest does not declare.
    PolicyUndeclaredImport = "policy-undeclared-import",
    /// The environment does not admit this profile.
    PolicyEnvironmentNotAdmitted = "policy-environment-not-admitted",
    /// The resources asked for do not fit the profile.
    PolicyResourcesExceeded = "policy-resources-exceeded",
    /// More authority than the profile grants by itself.
    PolicyAuthorityReview = "policy-authority-review",
    /// Allowed, but only in a tighter envelope than declared.
    PolicyTighterEnvelope = "policy-tighter-envelope",
    /// It may be used in simulation alone, by its own declaration.
    PolicySimulationOnly = "policy-simulation-only",
    /// A permission the active version does not have.
    PolicyNewPermission = "policy-new-permission",
    /// A permission of a higher level than the active version's.
    PolicyEscalation = "policy-escalation",
    /// There is no table for this profile, or it belongs to another policy.
    PolicyNoData = "policy-no-data",

    /// No component is worse beyond its tolerance.
    BehaviorCompatible = "behavior-compatible",
    /// The established worsening brings `kappa_B` below the threshold.
    BehaviorEstablishedWorse = "behavior-established-worse",
    /// A component may be worse than its tolerance; the evidence does not exclude it.
    BehaviorSuspicious = "behavior-suspicious",
    /// Success rose while a safety component is established as worse.
    BehaviorSafetyTraded = "behavior-safety-traded",
    /// A measure of harm is established as worse beyond its tolerance; the text names it with its unit.
    BehaviorHarmEstablished = "behavior-harm-established",
    /// A measure of harm may be worse beyond its tolerance; the evidence does not exclude it.
    BehaviorHarmSuspicious = "behavior-harm-suspicious",
    /// In whole sequences with it in its place the work, or what the skills after it do, is established as worse.
    BehaviorSequenceWorse = "behavior-sequence-worse",
    /// In whole sequences the work, or what the skills after it do, may be worse; or they could not be worked.
    BehaviorSequenceSuspicious = "behavior-sequence-suspicious",
    /// It asks for more speed or force than its manifest declares, in more episodes than the profile lets pass.
    BehaviorAsksMore = "behavior-asks-more",
    /// A component improved (reported apart, never counted).
    BehaviorImproved = "behavior-improved",
    /// An event was seen that ends an evaluation at once; the text names it.
    BehaviorHardStop = "behavior-hard-stop",
    /// A stopping rule ended the evaluation before its budget; the text names it.
    BehaviorEndedEarly = "behavior-ended-early",
    /// Fewer episodes than the budget.
    BehaviorInconclusive = "behavior-inconclusive",
    /// No usable episodes: none at all, of another version, implausible, or with a repeated seed.
    BehaviorNoData = "behavior-no-data",
    /// The values are declared or from earlier traces, not measured.
    BehaviorEstimated = "behavior-estimated",

    /// Recovery is as good as the active version's.
    RecoveryCompatible = "recovery-compatible",
    /// `kappa_R` is below the threshold.
    RecoveryBelowThreshold = "recovery-below-threshold",
    /// Recovery as a whole is below half the profile's floor.
    RecoveryFarBelowFloor = "recovery-far-below-floor",
    /// The rollback drills pass less often than the floor; never reviewable.
    RecoveryRollbackBelowFloor = "recovery-rollback-below-floor",
    /// Recovery is below the profile's floor.
    RecoveryFragile = "recovery-fragile",
    /// Recovery is above the floor and clearly below the active version's.
    RecoveryConditional = "recovery-conditional",
    /// One kind of drill passes less often, not established: a doubt to be settled.
    RecoveryLeaning = "recovery-leaning",
    /// The drills of one kind are established as passing less often than the active version's.
    RecoveryEstablishedWorse = "recovery-established-worse",
    /// The drills of one kind in one phase of the work pass in less than half of the floor.
    RecoveryPhaseFailing = "recovery-phase-failing",
    /// The drills of one kind in one phase are established as passing less often than the active version's.
    RecoveryPhaseWorse = "recovery-phase-worse",
    /// The active version's own drills pass too seldom: no reason for or against the candidate.
    RecoveryActiveWeak = "recovery-active-weak",
    /// A stopping rule ended the drills before their number; the text names it.
    RecoveryEndedEarly = "recovery-ended-early",
    /// A drill could not be carried out, or too few were.
    RecoveryNoData = "recovery-no-data",
    /// The predecessor cannot be loaded, or its digest differs.
    RecoveryPredecessorNotLoadable = "recovery-predecessor-not-loadable",
    /// The bound fallback is in no registry.
    RecoveryFallbackUnresolved = "recovery-fallback-unresolved",
    /// A recovery hook is not exported by the code.
    RecoveryHookMissing = "recovery-hook-missing",
    /// A failure signal the watcher does not know.
    RecoverySignalUnknown = "recovery-signal-unknown",

    /// Every dimension is compatible; nothing caps the recommendation.
    CompositionEligible = "composition-eligible",
    /// A restriction of one dimension caps the recommendation.
    CompositionRestricted = "composition-restricted",
    /// Something needed for the recommendation is missing.
    CompositionNoData = "composition-no-data",

    /// No governance signal differs between twin and live world.
    ShadowClean = "shadow-clean",
    /// Policy hits or watcher events are established as more frequent in the twin.
    ShadowGovernanceDivergence = "shadow-governance-divergence",
    /// A governance signal leans towards worse, not established: shadow is lengthened.
    ShadowLeaning = "shadow-leaning",
    /// In the live world the candidate is worse beside the active version than the sandbox showed.
    ShadowShifted = "shadow-shifted",
    /// It was worked again under the live world's own conditions, because it was not there what the sandbox showed.
    ShadowWorkedAgain = "shadow-worked-again",
    /// Outputs differ; shadow is lengthened, nothing is decided.
    ShadowOutputDivergence = "shadow-output-divergence",
    /// The twin leaves the band of the active version's traces; shadow is lengthened.
    ShadowEnvelopeDivergence = "shadow-envelope-divergence",
    /// Too few shadow sequences, or none usable.
    ShadowNoData = "shadow-no-data",

    /// Every demand of the gate is met.
    GatePassed = "gate-passed",
    /// At least one of the four dimensions, or shadow, failed.
    GateDimensionFailed = "gate-dimension-failed",
    /// A value is an estimate; the gate uses measured ones only.
    GateNotMeasured = "gate-not-measured",
    /// Evidence of another version, profile, policy or active version.
    GateStaleEvidence = "gate-stale-evidence",
    /// A dimension has no value, or a piece of evidence the gate needs is not there.
    GateNoData = "gate-no-data",
    /// A stage was skipped; allowed in experiments only.
    GateSkipped = "gate-skipped",
    /// Change is frozen at this time by a window of the profile.
    GateFrozen = "gate-frozen",
    /// The machine's clock is not believed, and no person has confirmed the time.
    GateClockDoubted = "gate-clock-doubted",
    /// The profile demands an improvement and none is established.
    GateNoImprovement = "gate-no-improvement",
    /// No improvement is established, and the profile waives it.
    GateImprovementWaived = "gate-improvement-waived",
    /// An improvement of success is established.
    GateImproved = "gate-improved",
    /// Shadow was worked for fewer sequences than a condition demands.
    GateShadowTooShort = "gate-shadow-too-short",
    /// A family it depends on has no active version that would do.
    GateDependencyUnmet = "gate-dependency-unmet",
    /// It may be activated in simulation alone, and this is no simulation.
    GateSimulationOnly = "gate-simulation-only",
    /// A site policy forbids this activation.
    GateSitePolicyForbids = "gate-site-policy-forbids",
    /// A hard stop was seen, which the runtime has to make impossible.
    GateHardLimit = "gate-hard-limit",
    /// A break-glass review of the family is open.
    GateReviewOpen = "gate-review-open",
    /// No enrolled person is on record as having registered the version, and people are nearby.
    GateRequesterUnknown = "gate-requester-unknown",
    /// The profile is closed to this version by a profile demotion.
    GateProfileClosed = "gate-profile-closed",
    /// The profile changed, with the program for one, and no administrator authorized it.
    GateProfileUnauthorized = "gate-profile-unauthorized",

    /// Enough distinct people approved, each independent and of a role that reaches the tier.
    ApprovalGranted = "approval-granted",
    /// The profile asks nobody for this.
    ApprovalNotNeeded = "approval-not-needed",
    /// The quorum is not reached yet and there is still time.
    ApprovalPending = "approval-pending",
    /// A person's signed refusal counted.
    ApprovalRefused = "approval-refused",
    /// Nobody answered in time; the version is held.
    ApprovalTimeout = "approval-timeout",
    /// The approval is over other evidence, another row version, profile or policy.
    ApprovalStale = "approval-stale",
    /// The approval's validity ended before it was used.
    ApprovalExpired = "approval-expired",
    /// The approver asked for it, or wrote it.
    ApprovalSelf = "approval-self",
    /// A second answer of the same person; it counts once.
    ApprovalDuplicate = "approval-duplicate",
    /// The approver's role does not reach this tier.
    ApprovalRole = "approval-role",
    /// The signature is not the approver's.
    ApprovalSignature = "approval-signature",
    /// The nonce was consumed by an earlier decision.
    ApprovalReplayed = "approval-replayed",
    /// One person approved in an emergency (break-glass); a review of the family opens.
    ApprovalBreakGlass = "approval-break-glass",

    /// Nothing out of the ordinary; the charts are quiet.
    MonitorHealthy = "monitor-healthy",
    /// A safety event; rolls back at once.
    MonitorSafetyTrip = "monitor-safety-trip",
    /// A rate is established as worse; rolls back.
    MonitorRateTrip = "monitor-rate-trip",
    /// A rate drifts; early warning, restricts.
    MonitorRateWarning = "monitor-rate-warning",
    /// A rate drifts under a version that is rollback-coupled; rolls back without asking.
    MonitorCoupledTrip = "monitor-coupled-trip",
    /// The live tasks are worse than the version's twins in shadow were. An alarm; it is worked again.
    MonitorShifted = "monitor-shifted",
    /// An active version was worked again under the live world's own conditions, because it was not what shadow showed.
    MonitorWorkedAgain = "monitor-worked-again",
    /// Telemetry is missing or not a number.
    MonitorTelemetryMissing = "monitor-telemetry-missing",
    /// Nobody answered an escalation by its deadline.
    MonitorEscalationUnanswered = "monitor-escalation-unanswered",
    /// An operator asked for the action.
    MonitorOperator = "monitor-operator",
    /// The provisional window passed without a trip.
    MonitorConfirmed = "monitor-confirmed",
}

impl ReasonCode {
    /// Whether it says that calls which were valid do not stay valid: a deviation no adapter carries.
    #[must_use]
    pub const fn is_breaking(self) -> bool {
        match self {
            Self::InterfaceSignatureBreaking
            | Self::InterfaceSchemaBreaking
            | Self::InterfaceConditionBreaking
            | Self::InterfaceDependencyBreaking => true,
            Self::InterfaceCompatible
            | Self::InterfaceSignatureAdaptable
            | Self::InterfaceSchemaAdaptable
            | Self::InterfaceConditionAdaptable
            | Self::InterfaceDependencyAdaptable
            | Self::InterfaceExportMismatch
            | Self::InterfaceVersionMislabelled
            | Self::InterfaceUndeclaredChange
            | Self::InterfaceNoData
            | Self::PolicyCompatible
            | Self::PolicyForbiddenMode
            | Self::PolicyUncoveredHighRisk
            | Self::PolicyUncoveredMode
            | Self::PolicyBelowThreshold
            | Self::PolicyUndeclaredImport
            | Self::PolicyEnvironmentNotAdmitted
            | Self::PolicyResourcesExceeded
            | Self::PolicyAuthorityReview
            | Self::PolicyTighterEnvelope
            | Self::PolicySimulationOnly
            | Self::PolicyNewPermission
            | Self::PolicyEscalation
            | Self::PolicyNoData
            | Self::BehaviorCompatible
            | Self::BehaviorEstablishedWorse
            | Self::BehaviorSuspicious
            | Self::BehaviorSafetyTraded
            | Self::BehaviorHarmEstablished
            | Self::BehaviorHarmSuspicious
            | Self::BehaviorSequenceWorse
            | Self::BehaviorSequenceSuspicious
            | Self::BehaviorAsksMore
            | Self::BehaviorImproved
            | Self::BehaviorHardStop
            | Self::BehaviorEndedEarly
            | Self::BehaviorInconclusive
            | Self::BehaviorNoData
            | Self::BehaviorEstimated
            | Self::RecoveryCompatible
            | Self::RecoveryBelowThreshold
            | Self::RecoveryFarBelowFloor
            | Self::RecoveryRollbackBelowFloor
            | Self::RecoveryFragile
            | Self::RecoveryConditional
            | Self::RecoveryLeaning
            | Self::RecoveryEstablishedWorse
            | Self::RecoveryPhaseFailing
            | Self::RecoveryPhaseWorse
            | Self::RecoveryActiveWeak
            | Self::RecoveryEndedEarly
            | Self::RecoveryNoData
            | Self::RecoveryPredecessorNotLoadable
            | Self::RecoveryFallbackUnresolved
            | Self::RecoveryHookMissing
            | Self::RecoverySignalUnknown
            | Self::CompositionEligible
            | Self::CompositionRestricted
            | Self::CompositionNoData
            | Self::ShadowClean
            | Self::ShadowGovernanceDivergence
            | Self::ShadowLeaning
            | Self::ShadowShifted
            | Self::ShadowWorkedAgain
            | Self::ShadowOutputDivergence
            | Self::ShadowEnvelopeDivergence
            | Self::ShadowNoData
            | Self::GatePassed
            | Self::GateDimensionFailed
            | Self::GateNotMeasured
            | Self::GateStaleEvidence
            | Self::GateNoData
            | Self::GateSkipped
            | Self::GateFrozen
            | Self::GateClockDoubted
            | Self::GateNoImprovement
            | Self::GateImprovementWaived
            | Self::GateImproved
            | Self::GateShadowTooShort
            | Self::GateDependencyUnmet
            | Self::GateSimulationOnly
            | Self::GateSitePolicyForbids
            | Self::GateHardLimit
            | Self::GateReviewOpen
            | Self::GateRequesterUnknown
            | Self::GateProfileClosed
            | Self::GateProfileUnauthorized
            | Self::ApprovalGranted
            | Self::ApprovalNotNeeded
            | Self::ApprovalPending
            | Self::ApprovalRefused
            | Self::ApprovalTimeout
            | Self::ApprovalStale
            | Self::ApprovalExpired
            | Self::ApprovalSelf
            | Self::ApprovalDuplicate
            | Self::ApprovalRole
            | Self::ApprovalSignature
            | Self::ApprovalReplayed
            | Self::ApprovalBreakGlass
            | Self::MonitorHealthy
            | Self::MonitorShifted
            | Self::MonitorWorkedAgain
            | Self::MonitorSafetyTrip
            | Self::MonitorRateTrip
            | Self::MonitorRateWarning
            | Self::MonitorCoupledTrip
            | Self::MonitorTelemetryMissing
            | Self::MonitorEscalationUnanswered
            | Self::MonitorOperator
            | Self::MonitorConfirmed => false,
        }
    }

    /// Whether it is about what people answered, or that they did not.
    #[must_use]
    pub const fn is_of_people(self) -> bool {
        matches!(
            self,
            Self::ApprovalGranted
                | Self::ApprovalNotNeeded
                | Self::ApprovalPending
                | Self::ApprovalRefused
                | Self::ApprovalTimeout
                | Self::ApprovalStale
                | Self::ApprovalExpired
                | Self::ApprovalSelf
                | Self::ApprovalDuplicate
                | Self::ApprovalRole
                | Self::ApprovalSignature
                | Self::ApprovalReplayed
                | Self::ApprovalBreakGlass
        )
    }

    /// Whether it tells what was found: that an evaluation ended early, that something is better, and that something is still
    /// missing tell nobody what was wrong.
    #[must_use]
    pub const fn tells_what_was_found(self) -> bool {
        !matches!(
            self,
            Self::BehaviorEndedEarly
                | Self::RecoveryEndedEarly
                | Self::BehaviorImproved
                | Self::CompositionNoData
        )
    }

    /// What a reason with this code says to people. What is on record as better is better in the mean of the pairs: no bound
    /// stands behind it. What is on record as worse by less than nothing is better.
    #[must_use]
    pub fn told(self, text: &str) -> std::borrow::Cow<'_, str> {
        match self {
            Self::BehaviorImproved => std::borrow::Cow::Owned(format!("{text} on average")),
            Self::ShadowShifted if text.contains(", by -") => {
                let now = "the active version's by ";
                let said = text.replace(&format!("worse than {now}-"), &format!("better than {now}"));
                let before = if said == text { ", better by " } else { ", by " };
                std::borrow::Cow::Owned(said.replace(", by -", before))
            }
            _ => std::borrow::Cow::Borrowed(text),
        }
    }
}

impl std::fmt::Display for ReasonCode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A text that names no reason of this build.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a reason; e.g. \"interface-signature-breaking\" is one")]
pub struct ReasonCodeError(pub String);

impl std::str::FromStr for ReasonCode {
    type Err = ReasonCodeError;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::ALL
            .iter()
            .copied()
            .find(|code| code.as_str() == text)
            .ok_or_else(|| ReasonCodeError(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reason_codes_are_distinct_and_round_trip() {
        let mut seen = std::collections::BTreeSet::new();
        for code in ReasonCode::ALL {
            assert!(seen.insert(code.as_str()), "{code} twice");
            assert_eq!(code.is_breaking(), code.as_str().ends_with("-breaking"), "{code}");
            assert!(crate::ids::is_name(code.as_str()), "{code}");
            assert_eq!(code.as_str().parse::<ReasonCode>().unwrap(), *code);
            assert_eq!(serde_json::to_string(code).unwrap(), format!("\"{code}\""));
        }
        assert!("no-such-reason".parse::<ReasonCode>().is_err());
    }

    #[test]
    fn worse_by_less_than_nothing_is_told_as_better() {
        for (on_record, told) in [
            (
                "force worse than the active version's by -4.1 N in 40 live sequences, by -10.1 N in 300 sandbox pairs",
                "force better than the active version's by 4.1 N in 40 live sequences, by 10.1 N in 300 sandbox pairs",
            ),
            (
                "force worse than the active version's by 4.1 N in 40 live sequences, by -10.1 N in 300 sandbox pairs",
                "force worse than the active version's by 4.1 N in 40 live sequences, better by 10.1 N in 300 sandbox pairs",
            ),
            (
                "force worse than the active version's by 4.1 N in 40 live sequences, by 0.1 N in 300 sandbox pairs",
                "force worse than the active version's by 4.1 N in 40 live sequences, by 0.1 N in 300 sandbox pairs",
            ),
        ] {
            assert_eq!(ReasonCode::ShadowShifted.told(on_record), told);
        }
    }
}
