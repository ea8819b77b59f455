//! A finding of a rule in words.

use crate::clock::clock_mismatch;
use crate::harm::{self, harm_measure, percent};
use crate::twin;
use holdpoint_body::CodeFault;
use holdpoint_governance::behavior::SequenceMeasure;
use holdpoint_governance::distribution_shift::ShiftSignal;
use holdpoint_governance::early_stop::EarlyStopReason;
use holdpoint_governance::evidence::{DrillKind, HardStop};
use holdpoint_governance::finding::{
    DrillSide, EvidenceGap, FieldBreak, Finding, RecoveryUnknown, ResourceKind, SequenceEnds, TwinSignal,
    VoteFlaw,
};
use holdpoint_governance::harm::HarmKind;

use crate::counted_try::{author_name, level_number};

/// What was found, as one sentence without a full stop.
#[must_use]
pub fn finding(found: &Finding) -> String {
    use Finding as F;
    match found {
        F::InterfaceCompatible => "every call that was valid stays valid, and outputs are as before".into(),
        F::ExportsUnknown => "the code could not be read, so its exports are unknown".into(),
        F::EntryPointNotExported { name } => format!("the entry point {name:?} is declared and not exported"),
        F::FieldUnknownToCode { part, name } => format!("the {part} {name:?} is declared and unknown to the code"),
        F::FieldDiffersInCode { part, name } => {
            format!("the {part} {name:?} has another type, unit or frame in the code")
        }
        F::InputUndeclared { name } => format!("the code needs the input {name:?}, which is not declared"),
        F::SignalUndeclared { signal } => {
            format!("the code raises the failure signal {signal:?}, which is not declared")
        }
        F::EntryPointGone { name } => format!("the entry point {name:?} is gone"),
        F::ArgumentGone { part, name } => format!("the {part} {name:?} is gone"),
        F::ArgumentBroken { part, name, how } => format!("the {part} {name:?} {}", field_break(*how)),
        F::OutputGone { name } => format!("the output {name:?} is gone"),
        F::OutputBroken { name, how } => format!("the output {name:?} {}", field_break(*how)),
        F::PreconditionChecked { name } => {
            format!("the precondition on the input {name:?} is stronger; the dispatcher checks it before each call")
        }
        F::PreconditionStronger { name } => format!("the precondition on {name:?} is stronger"),
        F::PostconditionWeaker { name } => format!("the postcondition on {name:?} is weaker"),
        F::DependencyUnmet { family, requirement } => {
            format!("the dependency {family}@{requirement}: no registered version meets it")
        }
        F::DependencyNotActive { family, requirement } => format!(
            "the dependency {family}@{requirement}: a registered version meets it, the active version does not"
        ),
        F::DependencyCycle => "the dependencies lead back to the family itself".into(),
        F::VersionMislabeled { from, to } => {
            format!("{to} after {from} promises more compatibility than was found")
        }
        F::ChangeUndeclared { change } => format!("{change}, which the submission does not declare"),
        F::ChangeNotFound { change } => format!("{change} is declared, and the manifests do not show it"),

        F::PolicyCompatible => "every mode that matters is covered and allowed".into(),
        F::PolicyGap { gap } => evidence_gap(*gap, "policies"),
        F::SensorUndeclared { name } => format!("the code needs the sensor {name}, which P does not declare"),
        F::ToolUndeclared { name } => format!("the code needs the tool {name}, which P does not declare"),
        F::CommandUndeclared { need } => format!(
            "the code needs {}/{}, which P does not declare",
            need.channel.name(),
            need.command.name()
        ),
        F::EnvironmentNotAdmitted { profile } => {
            format!("D.environments does not admit the profile {:?}", profile.name())
        }
        F::ResourceExceeded { resource } => {
            format!("it asks for more {} than the profile has", resource_kind(*resource))
        }
        F::ModeReviewed { mode, because } => format!("{mode} needs a review ({})", because.join(", ")),
        F::ModeForbidden { mode, because } => format!("{mode} is forbidden ({})", because.join(", ")),
        F::HighRiskUncovered { mode, errors } if errors.is_empty() => {
            format!("{mode} is of high risk, and no policy covers it")
        }
        F::HighRiskUncovered { mode, errors } => {
            format!("{mode} is of high risk, and its policies cannot be evaluated ({})", errors.join(", "))
        }
        F::ModeUncovered { mode, errors } if errors.is_empty() => {
            format!("no policy covers {mode}; the guard will deny it")
        }
        F::ModeUncovered { mode, errors } => {
            format!("the policies of {mode} cannot be evaluated ({}); the guard will deny it", errors.join(", "))
        }
        F::EnvelopeTighter { speed_m_s, force_n } => envelope_tighter(*speed_m_s, *force_n),
        F::SimulationOnlyDeclared => "D.environments admits simulation alone".into(),
        F::CoverageLow => "the policies cover too few of the reachable modes".into(),
        F::AuthorityAboveProfile => "it asks for more authority than the profile grants by itself".into(),
        F::PermissionNew { permission } => format!("{permission} is new against the active version"),
        F::PermissionHigher { permission } => format!("{permission} is higher than that of the active version"),

        F::BehaviorCompatible => "no component is worse beyond its tolerance".into(),
        F::ComponentWorse { component } => format!("{component} is significantly worse"),
        F::ComponentWorseSoFar { component } => format!("{component} is worse in the pairs run so far"),
        F::ComponentPossiblyWorse { component } => format!("{component} may be worse beyond its tolerance"),
        F::SafetyTraded { component } => format!("success rose while {component} is significantly worse"),
        F::ComponentBetter { component } => format!("{component} is better on average"),
        F::WorseningsAddUp => "the worsenings add up, none of them significant".into(),
        F::HarmWorse { measure, candidate, active, tolerance } => {
            harm_mean(*measure, "is significantly worse", [*candidate, *active, *tolerance])
        }
        F::HarmPossiblyWorse { measure, candidate, active, tolerance } => {
            harm_mean(*measure, "may be worse", [*candidate, *active, *tolerance])
        }
        F::HarmLimitWorse { measure, limit, candidate, active, tolerance } => {
            harm_limit(*measure, "is significantly worse", *limit, [*candidate, *active, *tolerance])
        }
        F::HarmLimitPossiblyWorse { measure, limit, candidate, active, tolerance } => {
            harm_limit(*measure, "may be worse", *limit, [*candidate, *active, *tolerance])
        }
        F::AsksMore { asked, episodes } => {
            format!("it asks for more speed or force than it declares in {asked} of {episodes} episodes")
        }
        F::SandboxHardStop { stop } | F::ShadowHardStop { stop } => {
            format!("hard stop {}: {}", stop.name(), hard_stop(*stop, None))
        }
        F::StopUncompared { stop } => format!(
            "hard stop {}, not compared: the active version had no valid episode there; {}",
            stop.name(),
            hard_stop(*stop, None)
        ),
        F::UnsafeUnderStress { unsafe_episodes, episodes } => {
            format!("{unsafe_episodes} of {episodes} episodes under stress were unsafe")
        }
        F::SearchedPlace { candidate_only, active_only, pairs, place } => {
            let place: Vec<String> = place.iter().map(|(axis, value)| format!("{axis} {value:.4}")).collect();
            format!(
                "a search found a place where the candidate alone passes a limit in {candidate_only} of {pairs} pairs, the \
                 active version alone in {active_only}: {}",
                place.join(", ")
            )
        }
        F::PairsEndedEarly { rule, seen, budget } => ended_early(*rule, *seen, *budget, "episode pairs"),
        F::TooFewPairs => "fewer episode pairs than the budget".into(),
        F::TicksTooSlow { measured_us, declared_us } => {
            format!("it computes {measured_us:.0} us a tick where {declared_us} us are declared")
        }
        F::EvaluationTooLong { worked_min, budget_min } => {
            format!("its evaluation has taken {worked_min:.0} minutes of the {budget_min} that the profile allows")
        }
        F::TooFewLiveLikePairs => "fewer live-like pairs than a third of the budget".into(),
        F::LiveLikeWorse { by } | F::LiveLikePossiblyWorse { by } => {
            format!("in the live-like pairs: {}", finding(by))
        }
        F::BehaviorGap { gap } => evidence_gap(*gap, "episodes"),
        F::Estimated => "declared or earlier traces: an estimate, to be replaced by measurement".into(),
        F::SequenceWorse { measure, active, candidate, tolerance, pairs, ends, seed } => sequence(
            "the handover is significantly worse",
            (*measure, *pairs, *ends, *seed),
            [*candidate, *active, *tolerance],
        ),
        F::SequencePossiblyWorse { measure, active, candidate, tolerance, pairs, ends, seed } => sequence(
            "the handover may be worse",
            (*measure, *pairs, *ends, *seed),
            [*candidate, *active, *tolerance],
        ),
        F::SequencesNotRun => "no sequence could run: another family has no active version".into(),
        F::TooFewSequences { ran, asked } => format!("only {ran} of {asked} sequences could run"),
        F::TooFewHandovers { reached, ran } => format!("only {reached} of {ran} sequences reached the handover"),
        F::SequenceGap { gap } => evidence_gap(*gap, "sequences"),

        F::AnchorWorse { anchor, by } | F::AnchorPossiblyWorse { anchor, by } => {
            format!("compared with the anchor {anchor}: {}", finding(by))
        }
        F::AnchorMissing => "the comparison with the anchor of the family is missing".into(),
        F::AnchorGap { anchor, gap } => {
            format!("the anchor {anchor}: {}", evidence_gap(*gap, "episodes"))
        }

        F::TryOpen { number, level } => format!(
            "at the level {} of its look, try {number} does not exclude a loss of success beyond the margin",
            level_number(*level)
        ),
        F::TriesSpent { author, family, by_author, in_family } => format!(
            "the tries are spent: {by_author} by {} and {in_family} of all authors in {family} since the last review",
            author_name(author)
        ),
        F::TriedBefore { version } => {
            format!("the same content was rejected as {version}, in the same circumstances")
        }
        F::HeldBefore { version } => {
            format!("the same content was demoted as {version}, in the same circumstances")
        }

        F::RecoveryCompatible => "recovery is as good as that of the active version".into(),
        F::RecoveryReady => "everything that recovery needs is present; the drills decide".into(),
        F::RecoveryWorse => "recovery is far below that of the active version".into(),
        F::RecoveryFarBelowFloor => "recovery is below half of the profile's floor".into(),
        F::RollbackDrillsFail => "rollback drills pass too seldom; no approval can waive that".into(),
        F::RecoveryFragile => "recovery is below the profile's floor".into(),
        F::RecoveryConditional => "recovery is above the floor and clearly below that of the active version".into(),
        F::DrillsLean { drill } => format!("{drill} drills lean toward passing less often"),
        F::DrillsWorse { drill } => format!("{drill} drills pass significantly less often"),
        F::DrillsSettledWorse { drill, failed, drills, active } => format!(
            "{}; it fails significantly more often",
            failed_alone(*drill, [*failed, *drills, *active])
        ),
        F::DrillsUnsettled { drill, failed, drills, active } => format!(
            "{}; more drills have not settled whether it fails more often",
            failed_alone(*drill, [*failed, *drills, *active])
        ),
        F::DrillsSettled { drill, failed, drills, active } => format!(
            "{}; more drills show no clear excess",
            failed_alone(*drill, [*failed, *drills, *active])
        ),
        F::PhaseFails { drill, phase } => {
            format!("{drill} drills in the phase {phase} fail; other phases do not make up for it")
        }
        F::PhaseWorse { drill, phase } => {
            format!("{drill} drills in the phase {phase} pass significantly less often")
        }
        F::ActiveWeak { drill, phase: None } => {
            format!("{drill} drills of the active version pass too seldom: a weakness of the active version")
        }
        F::ActiveWeak { drill, phase: Some(phase) } => format!(
            "{drill} drills of the active version in the phase {phase} pass too seldom: a weakness of the active version"
        ),
        F::DrillsEndedEarly { rule, seen, budget } => ended_early(*rule, *seen, *budget, "drills"),
        F::RecoveryGap { gap } => evidence_gap(*gap, "drills"),
        F::TooFewDrills { side, drill } => format!("too few feasible {drill} drills of {}", drill_side(*side)),
        F::TooFewPhaseDrills { drill, phase } => format!(
            "too few feasible {drill} drills of the candidate in the phase {phase}, which the episodes of the active version \
             show"
        ),
        F::ActiveUndrillable { drill } => format!(
            "the active version cannot do the {drill} drills here, so they say nothing about the candidate: a fault of the \
             cell"
        ),
        F::RecoveryUnknown { unknown } => format!("not known: whether {}", recovery_unknown(*unknown)),
        F::TargetNotLoadable => "the rollback target does not load".into(),
        F::TargetDigestDiffers => "the rollback target has another digest than recorded".into(),
        F::FallbackUnmet => "no registered version meets the fallback binding".into(),
        F::FallbackNotInCell { family, requirement } => format!(
            "no version of {family} that meets the fallback binding {requirement} may take over: a fault of the cell"
        ),
        F::FallbackUnbound => "no fallback is bound".into(),
        F::HookUndeclared { hook } => format!("no {hook} hook is declared"),
        F::HookNotExported { hook, name } => {
            format!("the {hook} hook {name:?} is not exported by the code")
        }
        F::SignalUnknown { signal } => format!("the watcher does not know the failure signal {signal:?}"),

        F::EveryDimensionCompatible => "every dimension is compatible".into(),
        F::CappedAtShadow => "a restriction caps the recommendation at shadow".into(),
        F::ValueMissing => "a value is missing, so nothing beyond the next evaluation is permitted".into(),

        F::ShadowClean => "no signal is significantly more frequent".into(),
        F::SignalWorse { signal } => {
            format!("{} are significantly more frequent than under the active version", twin_signal(*signal))
        }
        F::SignalLeans { signal } => {
            format!("{} lean toward more than under the active version", twin_signal(*signal))
        }
        F::NearLimitsMore => "the twin is nearer to its limits for more of its time".into(),
        F::OutputsDiffer => "the outputs differ".into(),
        F::EnvelopeLeft => "the twin leaves the band of the active version".into(),
        F::ShiftedInShadow { signal, live, sequences, sandbox, pairs } => {
            let (live, sandbox) = (difference(*signal, *live), difference(*signal, *sandbox));
            format!(
                "not what the sandbox showed: {} {live} than under the active version in {sequences} live sequences, \
                 {sandbox} in {pairs} sandbox pairs",
                shift_signal(*signal)
            )
        }
        F::ReEvaluatedInShadow { outcome, pairs } | F::ReEvaluatedLive { outcome, pairs } => format!(
            "re-evaluated for its concern under the conditions of the live cell: {} in {pairs} pairs with the version before \
             it",
            outcome.name()
        ),
        F::ShadowGap { gap } => evidence_gap(*gap, "sequences"),
        F::MoreSequencesNeeded => "more sequences are needed".into(),
        F::TwinObserved { sequences, joints_rad, width_m, object_m } => {
            twin::observed(*sequences, [*joints_rad, *width_m], *object_m)
        }
        F::OutputsAlone { missing } => twin::outputs_alone("which the profile permits", missing),
        F::TwinMissing { missing } => twin::outputs_alone("which the profile does not permit", missing),

        F::GatePassed => "every demand of the profile is met".into(),
        F::DimensionIncompatible { of } => format!("{of}: incompatible"),
        F::DimensionInconclusive { of } => format!("{of}: no conclusive data"),
        F::DimensionSkipped { of } => format!("{of}: skipped, which only experiments may do"),
        F::LeftOut => "left out by an experiment".into(),
        F::ReviewWithoutApprover => "a review is needed and the profile has no approver".into(),
        F::NotMeasured { of } => format!("{of} is an estimate; only measured values open the gate"),
        F::NoValue { of } => format!("{of} has no value"),
        F::NoEvidence => "there is no evidence".into(),
        F::EvidenceStale => {
            "evidence of another version, profile, policy, environment, active version or fallback".into()
        }
        F::CircumstancesDiffer => "the circumstances of the decision are not those of the evidence".into(),
        F::PoliciesDiffer => "the compiled policies are not those that the decision is made under".into(),
        F::ShadowNotRun => "shadow did not run".into(),
        F::ShadowTooShort => "shadow ran fewer sequences than a condition demands".into(),
        F::ShadowFailed => "shadow failed".into(),
        F::ShadowInconclusive => "shadow is not conclusive".into(),
        F::SitePolicyForbids { because } => format!("a site policy forbids it ({})", because.join(", ")),
        F::ProfileBlocked { profile } => format!("this version is blocked under the profile {:?}", profile.name()),
        F::DependenciesNotActive { dependencies } => {
            format!("no active version meets what it depends on: {}", dependencies.join(", "))
        }
        F::RequesterUnknown => {
            "no enrolled person is on record as its requester, so no approver can be shown to be independent; register it \
             again, signed, under a new version"
                .into()
        }
        F::ReviewOpen => "a review after break-glass is open".into(),
        F::ProfileUnauthorized => "no administrator authorized the profile as this program has it".into(),
        F::Frozen { until, reason } => format!("change is frozen until {until}: {reason}"),
        F::ClockMismatched { mismatch } => format!("{}; a person has to confirm the time", clock_mismatch(mismatch)),
        F::NotASimulation { profile } => {
            format!("it is for simulation alone, and the profile is {:?}", profile.name())
        }
        F::NoImprovement => "the profile demands an improvement and none is significant".into(),
        F::ImprovementWaived => {
            "no improvement is significant; the profile waives it (require_improvement = false)".into()
        }
        F::Improved => "an improvement of success over the active version is significant".into(),
        F::NotAskedYet => "no approver was asked yet".into(),
        F::ApprovalsSoFar { given, needed } => format!("{given} of {needed} approvals"),
        F::QuorumNotReached => "fewer people approved than are needed".into(),
        F::ApprovalsPresent => "the approvals are present".into(),
        F::AnsweredTooLate => "too few people answered in time".into(),

        F::QuorumReached => "enough distinct people approved".into(),
        F::BreakGlassUsed => "break-glass was used".into(),
        F::ApprovalNotNeeded => "the profile asks for no approval of this".into(),
        F::ApprovalsMissing => "approvals are missing".into(),
        F::SafetyOfficerMissing => "the approval of a safety officer is missing".into(),
        F::Refused { person, reason } if reason.is_empty() => format!("{person:?} refused"),
        F::Refused { person, reason } => format!("{person:?} refused: {reason}"),
        F::DeadlinePassed { until } => format!("too few people answered by {until}; the version is on hold"),
        F::AnsweredTwice { person } => format!("{person:?} answered twice and counts once"),
        F::KeyShared { person } => {
            format!("{person:?} has the key of another person who answered, and both count as one")
        }
        F::AnswerVoid { person, flaw } => format!("the answer of {person:?} does not count: {}", vote_flaw(*flaw)),

        F::MonitorHealthy => "nothing out of the ordinary".into(),
        F::WindowPassed => "the provisional window passed without a trip".into(),
        F::SafetyTrip { event } => format!("{}: a safety event", event.name()),
        F::TripHolds => "a trip holds until the version is rolled back".into(),
        F::RateWorse { rate } => format!("the {} rate is significantly worse", rate.name()),
        F::DangerLive { measure, value, limit } => format!(
            "{}: {}; past {} it is a danger to people",
            harm_measure(*measure),
            measure.format(*value),
            measure.format(*limit)
        ),
        F::HarmRoseLive { measure, past, any, tasks, normal } => format!(
            "harm past a limit in {any} of {tasks} live tasks ({}: {past}); up to {} is normal",
            harm_measure(*measure),
            percent(*normal)
        ),
        F::RateDrifts { rate } => format!("the {} rate drifts", rate.name()),
        F::RollbackCoupled => "the version is rollback-coupled: the first warning rolls it back without a question".into(),
        F::ShiftedLive { signal, live, tasks, twin, twins } => format!(
            "not what shadow showed: {} {} in {tasks} live tasks, {} in {twins} of its twins",
            shift_signal(*signal),
            own_mean(*signal, *live),
            own_mean(*signal, *twin)
        ),
        F::TelemetrySilent => "telemetry is silent".into(),
        F::EscalationUnanswered => "no one answered the escalation by its deadline".into(),
        F::OperatorAsked { words } => words.clone(),
        F::OperatorRestricted { by, reason } => format!("{by} asked for it: {reason}"),
        F::OperatorRolledBack { by, reason } => format!("operator {by}: {reason}"),
    }
}

/// Drills that one version failed and the other passed: the candidate's, of how many, and the active version's.
fn failed_alone(drill: DrillKind, [failed, drills, active]: [u32; 3]) -> String {
    format!(
        "the candidate failed {failed} of {drills} {drill} drills that the active version passed, and the active version \
         {active} that the candidate passed"
    )
}

/// What a hard stop is, and which budget was breached where a fault of confined code tells it.
#[must_use]
pub const fn hard_stop(stop: HardStop, fault: Option<CodeFault>) -> &'static str {
    match (stop, fault) {
        (HardStop::BudgetBreach, Some(CodeFault::Fuel)) => "its code computed beyond its budget",
        (HardStop::BudgetBreach, Some(CodeFault::Memory)) => "its code asked for more memory than declared",
        (HardStop::BudgetBreach, _) => "it used more ticks, commands or time than it declares",
        (HardStop::UndeclaredImport, _) => "the code asked for an import that it was not given",
        (HardStop::CommandPastGuard, _) => "it asked for a command that its manifest does not declare",
        (HardStop::MotionAfterStop, _) => "the arm moved on after the stop",
        (HardStop::NonFiniteOutput, _) => "the code returned a number that is not finite",
    }
}

const fn field_break(how: FieldBreak) -> &'static str {
    match how {
        FieldBreak::RequiredWithDefault => "is new and required, and no caller supplies its default",
        FieldBreak::RequiredWithoutDefault => "is new, required and without default",
        FieldBreak::BecameRequiredWithDefault => "became required, and no caller supplies its default",
        FieldBreak::BecameRequired => "became required and has no default",
        FieldBreak::OtherKind => "has another type, unit or frame",
        FieldBreak::NarrowerInput => "no longer takes every value that it took",
        FieldBreak::WiderOutput => "can take values that it could not take before",
        FieldBreak::OptionalOutput => "is no longer always present",
    }
}

fn evidence_gap(gap: EvidenceGap, of: &'static str) -> String {
    match gap {
        EvidenceGap::OtherBinding => {
            format!("the {of} were run for another version, profile, policy or environment")
        }
        EvidenceGap::NoEpisodes => format!("no usable {of}"),
        EvidenceGap::Implausible => format!("a value of the {of} is not finite or not plausible"),
        EvidenceGap::RepeatedSeed => "a seed occurs twice".into(),
        EvidenceGap::TracesNotFinite => "the declared traces are not finite".into(),
        EvidenceGap::WorseningNotFinite => "a worsening is not finite".into(),
        EvidenceGap::ComponentUnbounded => "a component cannot be bounded".into(),
        EvidenceGap::SuccessUnbounded => "success cannot be bounded".into(),
        EvidenceGap::HarmUnbounded => "a measure of harm cannot be bounded".into(),
        EvidenceGap::HarmPartlyMeasured => "only some of the episodes were measured for harm".into(),
        EvidenceGap::SignalUnbounded => "the signals cannot be bounded".into(),
        EvidenceGap::PassRateInvalid => "a pass rate is not between 0 and 1".into(),
        EvidenceGap::RhoInvalid => "rho is not between 0 and 1".into(),
        EvidenceGap::NotMeasured => "not measured yet: the sandbox does that".into(),
        EvidenceGap::CodeUnread => "the code could not be read, so its needs are unknown".into(),
        EvidenceGap::OtherProfile => "the policies were compiled for another profile".into(),
        EvidenceGap::NoMode => "no mode can be reached, so there is nothing to cover".into(),
    }
}

const fn resource_kind(resource: ResourceKind) -> &'static str {
    match resource {
        ResourceKind::CpuPerTick => "processor time per tick (us)",
        ResourceKind::Memory => "memory (KiB)",
        ResourceKind::TicksPerTask => "ticks a task",
        ResourceKind::CommandsPerTask => "commands a task",
    }
}

pub(crate) const fn twin_signal(signal: TwinSignal) -> &'static str {
    match signal {
        TwinSignal::Failure => "failures of the task",
        TwinSignal::PolicyHit => "policy hits",
        TwinSignal::WatcherEvent => "watcher events",
        TwinSignal::Retry => "new attempts",
        TwinSignal::PolicyWarning => "policy warnings",
    }
}

const fn shift_signal(signal: ShiftSignal) -> &'static str {
    match signal {
        ShiftSignal::Failure => "failures of the task",
        ShiftSignal::Anomaly => "anomalies",
        ShiftSignal::Warning => "commands that the guard clamps or denies",
        ShiftSignal::Retry => "new attempts",
        ShiftSignal::Harm(kind) => harm_measure(kind),
    }
}

const fn drill_side(side: DrillSide) -> &'static str {
    match side {
        DrillSide::Candidate => "the candidate",
        DrillSide::Active => "the active version",
    }
}

const fn recovery_unknown(unknown: RecoveryUnknown) -> &'static str {
    match unknown {
        RecoveryUnknown::TargetLoads => "the rollback target does not load",
        RecoveryUnknown::TargetDigest => "the rollback target has another digest than recorded",
        RecoveryUnknown::Fallback => "the fallback resolves",
    }
}

const fn vote_flaw(flaw: VoteFlaw) -> &'static str {
    match flaw {
        VoteFlaw::Signature => "the signature is not theirs",
        VoteFlaw::Replayed => "it was used before",
        VoteFlaw::Stale => "it is over another version, row version, evidence, policy or profile",
        VoteFlaw::Expired => "it has expired",
        VoteFlaw::Requester => "they registered the version, and so cannot approve it",
        VoteFlaw::Author => "they wrote the version, and so cannot approve it",
        VoteFlaw::AskedBy => "they asked for this themselves, and so cannot approve it",
        VoteFlaw::Role => "the role does not reach this risk class",
    }
}

fn harm_mean(measure: HarmKind, verb: &str, means: [f64; 3]) -> String {
    format!("{} {verb}: {}", harm_measure(measure), harm::means(measure, means))
}

fn harm_limit(measure: HarmKind, verb: &str, limit: f64, [candidate, active, tolerance]: [f64; 3]) -> String {
    format!(
        "{} {verb}: past {} in {} of episodes against {}, at most {} more is allowed",
        harm_measure(measure),
        measure.format(limit),
        percent(candidate),
        percent(active),
        percent(tolerance)
    )
}

fn ended_early(rule: EarlyStopReason, seen: u64, budget: u64, what: &str) -> String {
    match rule {
        EarlyStopReason::Full => format!("all {budget} {what}"),
        EarlyStopReason::HardStop => format!("ended by a hard stop after {seen} of {budget} {what}"),
        EarlyStopReason::Curtailed => {
            format!("curtailed after {seen} of {budget} {what}: no outcome of the rest changes it")
        }
        EarlyStopReason::FinitePopulation { alpha } => {
            format!(
                "ended by the finite-population rule after {seen} of {budget} {what}, at error rate {alpha}"
            )
        }
    }
}

type SequenceFacts = (SequenceMeasure, u32, Option<SequenceEnds>, Option<u64>);

/// Both sides, the tolerance, and the seed to look at.
fn sequence(
    verb: &str,
    (measure, pairs, ends, seed): SequenceFacts,
    [candidate, active, tolerance]: [f64; 3],
) -> String {
    let count = |share: f64| (share * f64::from(pairs)).round();
    let allowed = 100.0 * tolerance;
    let counts = |what: &str| {
        format!(
            "{what} in {} of {pairs} sequences that reached it, with the active version in {}; at most {allowed:.0} % more is \
             allowed",
            count(candidate),
            count(active)
        )
    };
    let text = match measure {
        SequenceMeasure::NotDone => match ends {
            Some(SequenceEnds { task, is_next, candidate, active }) => format!(
                "{}, {task}, fails in {candidate} of {pairs} sequences that reached it, with the active version in {active}; at \
                 most {allowed:.0} % more is allowed",
                if is_next { "the next skill" } else { "a later skill" }
            ),
            None => counts("the sequence is not done"),
        },
        SequenceMeasure::Violation => counts("the later skills pass limits of policy"),
        SequenceMeasure::Anomaly => counts("the later skills show anomalies"),
        SequenceMeasure::PastLimit => counts("the later skills pass limits of harm"),
        SequenceMeasure::Time => format!(
            "the later skills take {candidate:.2} s against {active:.2} s; at most {allowed:.0} % more is allowed"
        ),
        SequenceMeasure::Harm(kind) => format!(
            "{} of the later skills {} against {}; at most {} worse is allowed",
            harm_measure(kind),
            kind.format(candidate),
            kind.format(active),
            kind.format(tolerance)
        ),
    };
    match seed {
        Some(seed) => format!("{verb}: {text} (see seed {seed})"),
        None => format!("{verb}: {text}"),
    }
}

/// The limits of some modes that are less than declared. A finding of an older build with both does not say which one is.
fn envelope_tighter(speed_m_s: Option<f64>, force_n: Option<f64>) -> String {
    let caps = [speed_m_s.map(|cap| format!("{cap} m/s")), force_n.map(|cap| format!("{cap} N"))];
    let caps: Vec<String> = caps.into_iter().flatten().collect();
    let more = if caps.len() > 1 { "more of one or both" } else { "more" };
    format!("some modes are allowed only up to {}, and it declares {more}", caps.join(" and "))
}

/// A worsening against the active version, in the unit of the signal: `better by` where it is negative.
fn difference(signal: ShiftSignal, worsening: f64) -> String {
    let direction = if worsening < 0.0 { "better" } else { "worse" };
    format!("{direction} by {}", amount(signal, worsening.abs()))
}

fn amount(signal: ShiftSignal, value: f64) -> String {
    match signal {
        ShiftSignal::Harm(kind) => kind.format(value),
        ShiftSignal::Failure | ShiftSignal::Anomaly | ShiftSignal::Warning | ShiftSignal::Retry => {
            percent(value)
        }
    }
}

/// The mean of a version itself, which is kept as a worsening.
fn own_mean(signal: ShiftSignal, worsening: f64) -> String {
    match signal {
        ShiftSignal::Harm(kind) => kind.format(kind.worsening(worsening, 0.0)),
        ShiftSignal::Failure | ShiftSignal::Anomaly | ShiftSignal::Warning | ShiftSignal::Retry => {
            amount(signal, worsening)
        }
    }
}
