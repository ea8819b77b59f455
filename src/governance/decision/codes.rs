//! Why something was decided: the vocabulary of reasons, and rules about sets of them.

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
    /// An output's form differs in a way an adapter could repair; in records of older builds.
    InterfaceSchemaAdaptable = "interface-schema-adaptable",
    /// A precondition was strengthened or a postcondition weakened, beyond repair.
    InterfaceConditionBreaking = "interface-condition-breaking",
    /// A precondition was strengthened within what the dispatcher checks before each call.
    InterfaceConditionAdaptable = "interface-condition-adaptable",
    /// A dependency has no version in the registry, or the dependencies form a cycle.
    InterfaceDependencyBreaking = "interface-dependency-breaking",
    /// A dependency is met by a registered version that is not the active one.
    InterfaceDependencyAdaptable = "interface-dependency-adaptable",
    /// The code's exports differ from the manifest.
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
    /// Too few of the reachable modes are covered.
    PolicyBelowThreshold = "policy-below-threshold",
    /// The code needs a mode the manifest does not declare.
    PolicyUndeclaredImport = "policy-undeclared-import",
    /// The environment does not admit this profile.
    PolicyEnvironmentNotAdmitted = "policy-environment-not-admitted",
    /// The requested resources exceed the profile.
    PolicyResourcesExceeded = "policy-resources-exceeded",
    /// More authority than the profile grants by itself.
    PolicyAuthorityReview = "policy-authority-review",
    /// Allowed, but only in a tighter envelope than declared.
    PolicyTighterEnvelope = "policy-tighter-envelope",
    /// By its own declaration it is for simulation only.
    PolicySimulationOnly = "policy-simulation-only",
    /// A permission the active version does not have.
    PolicyNewPermission = "policy-new-permission",
    /// A permission of a higher level than the active version's.
    PolicyEscalation = "policy-escalation",
    /// There is no table for this profile, or it belongs to another policy.
    PolicyNoData = "policy-no-data",

    /// No component is worse beyond its margin.
    BehaviorCompatible = "behavior-compatible",
    /// The significant worsening brings `kappa_B` below the threshold.
    BehaviorEstablishedWorse = "behavior-established-worse",
    /// A component may be worse beyond its margin; the evidence does not exclude it.
    BehaviorSuspicious = "behavior-suspicious",
    /// Success rose while a safety component is significantly worse.
    BehaviorSafetyTraded = "behavior-safety-traded",
    /// A measure of harm is significantly worse beyond its margin; the text names it with its unit.
    BehaviorHarmEstablished = "behavior-harm-established",
    /// A measure of harm may be worse beyond its margin; the evidence does not exclude it.
    BehaviorHarmSuspicious = "behavior-harm-suspicious",
    /// In whole sequences with it, the work or the skills after it are significantly worse.
    BehaviorSequenceWorse = "behavior-sequence-worse",
    /// In whole sequences with it, the work or the skills after it may be worse; or none could run.
    BehaviorSequenceSuspicious = "behavior-sequence-suspicious",
    /// It is significantly worse than the family's anchor; the text names in what.
    BehaviorAnchorWorse = "behavior-anchor-worse",
    /// It may be worse than the family's anchor beyond a margin; the evidence does not exclude it.
    BehaviorAnchorSuspicious = "behavior-anchor-suspicious",
    /// It is significantly worse in the live-like pairs; the text names in what.
    BehaviorLiveLikeWorse = "behavior-live-like-worse",
    /// It may be worse in the live-like pairs beyond a wider margin; the evidence does not exclude it.
    BehaviorLiveLikeSuspicious = "behavior-live-like-suspicious",
    /// At the level of its try, the evidence does not exclude that success is lower by the margin.
    BehaviorTryOpen = "behavior-try-open",
    /// The tries of its author, or of its family, are spent until a person reviews them.
    BehaviorTriesSpent = "behavior-tries-spent",
    /// The same content was rejected or demoted before in the same circumstances; the text names the version.
    BehaviorTriedBefore = "behavior-tried-before",
    /// It asks for more speed or force than its manifest declares, in more episodes than the profile accepts.
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
    /// Its code takes far more processor time in a tick than its manifest declares.
    BehaviorTickTooSlow = "behavior-tick-too-slow",
    /// Its evaluation has taken the wall time that the profile allows for a candidate.
    BehaviorTimeSpent = "behavior-time-spent",

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
    /// One kind of drill passes less often, not significantly: a concern to settle.
    RecoveryLeaning = "recovery-leaning",
    /// The drills of one kind pass significantly less often than the active version's.
    RecoveryEstablishedWorse = "recovery-established-worse",
    /// The candidate alone failed drills of one kind, and more drills show no clear excess.
    RecoverySettled = "recovery-settled",
    /// The candidate alone failed drills of one kind, and the most drills have not settled it.
    RecoveryUnsettled = "recovery-unsettled",
    /// The drills of one kind in one phase of the work pass in less than half of the floor.
    RecoveryPhaseFailing = "recovery-phase-failing",
    /// The drills of one kind in one phase pass significantly less often than the active version's.
    RecoveryPhaseWorse = "recovery-phase-worse",
    /// The active version's own drills pass too seldom: no reason for or against the candidate.
    RecoveryActiveWeak = "recovery-active-weak",
    /// A stopping rule ended the drills before their number; the text names it.
    RecoveryEndedEarly = "recovery-ended-early",
    /// A drill could not be carried out, or too few were.
    RecoveryNoData = "recovery-no-data",
    /// The rollback target cannot be loaded, or its digest differs.
    RecoveryPredecessorNotLoadable = "recovery-predecessor-not-loadable",
    /// The bound fallback is in no registry.
    RecoveryFallbackUnresolved = "recovery-fallback-unresolved",
    /// A recovery hook is not exported by the code.
    RecoveryHookMissing = "recovery-hook-missing",
    /// A failure signal the watcher does not know.
    RecoverySignalUnknown = "recovery-signal-unknown",
    /// A fault of the cell: its active version cannot do the drills, or no fallback may take over.
    RecoveryCellFault = "recovery-cell-fault",

    /// Every dimension is compatible; nothing caps the recommendation.
    CompositionEligible = "composition-eligible",
    /// A restriction of one dimension caps the recommendation.
    CompositionRestricted = "composition-restricted",
    /// Something needed for the recommendation is missing.
    CompositionNoData = "composition-no-data",

    /// No governance signal differs between twin and live world.
    ShadowClean = "shadow-clean",
    /// Policy hits or watcher events are significantly more frequent in the twin.
    ShadowGovernanceDivergence = "shadow-governance-divergence",
    /// A governance signal leans toward worse, not significantly: shadow is lengthened.
    ShadowLeaning = "shadow-leaning",
    /// In the live world the candidate is worse beside the active version than the sandbox showed.
    ShadowShifted = "shadow-shifted",
    /// It was re-evaluated under the live world's own conditions, because it differed there from the sandbox.
    ShadowWorkedAgain = "shadow-worked-again",
    /// Outputs differ; shadow is lengthened, nothing is decided.
    ShadowOutputDivergence = "shadow-output-divergence",
    /// The twin leaves the band of the active version's traces; shadow is lengthened.
    ShadowEnvelopeDivergence = "shadow-envelope-divergence",
    /// Too few shadow sequences, or none usable.
    ShadowNoData = "shadow-no-data",
    /// The twin began at the observed state of the live cell, which cannot export its own.
    ShadowTwinObserved = "shadow-twin-observed",
    /// The cell has no twin; shadow rests on outputs alone, which the profile permits.
    ShadowOutputsAlone = "shadow-outputs-alone",
    /// The cell has no twin, and outputs alone are not enough under the profile; demoted.
    ShadowTwinMissing = "shadow-twin-missing",

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
    /// There is a clock mismatch, and no person has confirmed the time.
    GateClockDoubted = "gate-clock-doubted",
    /// The profile requires an improvement and none is significant.
    GateNoImprovement = "gate-no-improvement",
    /// No improvement is significant, and the profile waives it.
    GateImprovementWaived = "gate-improvement-waived",
    /// An improvement of success is significant.
    GateImproved = "gate-improved",
    /// Shadow ran for fewer sequences than a condition requires.
    GateShadowTooShort = "gate-shadow-too-short",
    /// A family it depends on has no active version that would do.
    GateDependencyUnmet = "gate-dependency-unmet",
    /// It may be activated only in simulation, and this is no simulation.
    GateSimulationOnly = "gate-simulation-only",
    /// A site policy forbids this activation.
    GateSitePolicyForbids = "gate-site-policy-forbids",
    /// A hard stop was seen, which the runtime has to make impossible.
    GateHardLimit = "gate-hard-limit",
    /// A break-glass review of the family is open.
    GateReviewOpen = "gate-review-open",
    /// No enrolled person is on record as having registered the version, and people are nearby.
    GateRequesterUnknown = "gate-requester-unknown",
    /// A profile demotion blocked this version under the profile.
    GateProfileClosed = "gate-profile-closed",
    /// The profile changed, with the program for one, and no administrator authorized it.
    GateProfileUnauthorized = "gate-profile-unauthorized",

    /// Enough distinct people approved, each independent and of a role that reaches the tier.
    ApprovalGranted = "approval-granted",
    /// The profile requires no approval.
    ApprovalNotNeeded = "approval-not-needed",
    /// The quorum is not reached yet and there is still time.
    ApprovalPending = "approval-pending",
    /// A person's signed refusal counted.
    ApprovalRefused = "approval-refused",
    /// No approver answered in time; the version stays on hold.
    ApprovalTimeout = "approval-timeout",
    /// The approval is over other evidence, another row version, profile or policy.
    ApprovalStale = "approval-stale",
    /// The approval's validity ended before it was used.
    ApprovalExpired = "approval-expired",
    /// The approver requested it or is its author.
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
    /// A rate is significantly worse; rolls back.
    MonitorRateTrip = "monitor-rate-trip",
    /// Live tasks are past a limit of harm more often than is normal for the version, in its whole life; rolls back.
    MonitorHarmTrip = "monitor-harm-trip",
    /// A rate drifts; early warning, restricts.
    MonitorRateWarning = "monitor-rate-warning",
    /// A rate drifts under a version that is rollback-coupled; rolls back without asking.
    MonitorCoupledTrip = "monitor-coupled-trip",
    /// The live tasks are worse than the version's twins in shadow. Raises an alarm; the version is re-evaluated.
    MonitorShifted = "monitor-shifted",
    /// An active version was re-evaluated under the live world's own conditions, because it differed from shadow.
    MonitorWorkedAgain = "monitor-worked-again",
    /// Telemetry is missing or not a number.
    MonitorTelemetryMissing = "monitor-telemetry-missing",
    /// No operator answered an escalation by its deadline.
    MonitorEscalationUnanswered = "monitor-escalation-unanswered",
    /// An operator asked for the action.
    MonitorOperator = "monitor-operator",
    /// The provisional window passed without a trip.
    MonitorConfirmed = "monitor-confirmed",
}

impl ReasonCode {
    /// Whether valid calls become invalid: a deviation that no adapter repairs.
    #[must_use]
    pub const fn is_breaking(self) -> bool {
        matches!(
            self,
            Self::InterfaceSignatureBreaking
                | Self::InterfaceSchemaBreaking
                | Self::InterfaceConditionBreaking
                | Self::InterfaceDependencyBreaking
        )
    }

    /// Whether it is about approvals or their absence.
    #[must_use]
    pub const fn is_from_people(self) -> bool {
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

    /// Whether it states a finding; an early end, an improvement and a missing value do not say what was wrong.
    #[must_use]
    pub const fn is_finding(self) -> bool {
        !matches!(
            self,
            Self::BehaviorEndedEarly
                | Self::RecoveryEndedEarly
                | Self::BehaviorImproved
                | Self::CompositionNoData
        )
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
}
