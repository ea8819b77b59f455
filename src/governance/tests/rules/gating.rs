//! `Psi` and the gate against tables of circumstances.

use std::collections::BTreeSet;

use holdpoint_governance::ablation::{AblatedParts, AblationPart};
use holdpoint_governance::approval::{ApprovalOutcome, ApprovalResult, Requester};
use holdpoint_governance::composition::{Kappas, admits, psi};
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::ReasonCode::{self, *};
use holdpoint_governance::decision::{Dimension, Reason};
use holdpoint_governance::evidence::{EvidenceBinding, HardStop};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::gate::{self, GateInput, GateOutcome, GateResult, ShadowAssessment};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::outcome::{
    ActivationMode, Basis, BehaviorOutcome, InterfaceOutcome, PolicyOutcome, Recommendation, RecoveryOutcome,
};
use holdpoint_governance::policy::{PolicySource, PolicyTable};
use holdpoint_governance::profile::{FreezeWindow, Profile, ProfileName};
use holdpoint_governance::submission::{Provenance, Risk};
use holdpoint_governance::wall_time::{ClockMismatch, WallTime};

use crate::fixture::{at, binding, digest, kappas, made_under, profile, shadow};

fn recovery_fails(kappas: &mut Kappas, code: ReasonCode) {
    kappas.recovery.outcome = RecoveryOutcome::Incompatible;
    kappas.recovery.reasons = vec![Reason::coded(code, Dimension::Recovery, Finding::RecoveryReady)];
}

#[test]
fn psi_follows_the_order_of_procedure_2() {
    use PolicyOutcome::Review;
    use Recommendation::{Activate, Reject, RollbackReview, Sandbox, Shadow};
    type KappaChange = fn(&mut Kappas);
    let table: [(&str, KappaChange, Recommendation, Recommendation); 21] = [
        (
            "P review, B incompatible",
            |k| (k.policy.outcome, k.behavior.outcome) = (Review, BehaviorOutcome::Incompatible),
            Sandbox,
            Sandbox,
        ),
        (
            "P review, B estimated as incompatible",
            |k| {
                k.policy.outcome = Review;
                (k.behavior.outcome, k.behavior.basis) = (BehaviorOutcome::Incompatible, Basis::Estimated);
            },
            RollbackReview,
            RollbackReview,
        ),
        (
            "P review, B not measured yet",
            |k| (k.policy.outcome, k.behavior.outcome) = (Review, BehaviorOutcome::NoData),
            RollbackReview,
            RollbackReview,
        ),
        (
            "P review, R without rollback",
            |k| {
                k.policy.outcome = Review;
                recovery_fails(k, RecoveryRollbackBelowFloor);
            },
            Sandbox,
            Sandbox,
        ),
        (
            "P review, R incompatible",
            |k| {
                k.policy.outcome = Review;
                recovery_fails(k, RecoveryBelowThreshold);
            },
            Sandbox,
            RollbackReview,
        ),
        ("all compatible", |_| (), Activate, Activate),
        ("I incompatible", |k| k.interface.outcome = InterfaceOutcome::Incompatible, Reject, Reject),
        ("I no data", |k| k.interface.outcome = InterfaceOutcome::NoData, Reject, Reject),
        ("I conditional", |k| k.interface.outcome = InterfaceOutcome::Conditional, Shadow, Shadow),
        ("P incompatible", |k| k.policy.outcome = PolicyOutcome::Incompatible, Reject, Reject),
        ("P review", |k| k.policy.outcome = Review, RollbackReview, RollbackReview),
        ("P conditional", |k| k.policy.outcome = PolicyOutcome::Conditional, Shadow, Shadow),
        ("B incompatible", |k| k.behavior.outcome = BehaviorOutcome::Incompatible, Sandbox, Sandbox),
        ("B inconclusive", |k| k.behavior.outcome = BehaviorOutcome::Inconclusive, Sandbox, Sandbox),
        ("B no data", |k| k.behavior.outcome = BehaviorOutcome::NoData, Sandbox, Sandbox),
        ("B suspicious", |k| k.behavior.outcome = BehaviorOutcome::Suspicious, Shadow, Shadow),
        ("B estimated", |k| k.behavior.basis = Basis::Estimated, Shadow, Shadow),
        ("R fragile", |k| k.recovery.outcome = RecoveryOutcome::Fragile, Shadow, Shadow),
        ("R conditional", |k| k.recovery.outcome = RecoveryOutcome::Conditional, Shadow, Shadow),
        ("R incompatible", |k| recovery_fails(k, RecoveryBelowThreshold), Sandbox, RollbackReview),
        ("R without rollback", |k| recovery_fails(k, RecoveryRollbackBelowFloor), Sandbox, Sandbox),
    ];
    for (name, change, alone, with_approver) in table {
        let mut kappas = kappas(&profile(ProfileName::Sim), [1.0; 4]);
        change(&mut kappas);
        for (has_approver, expected) in [(false, alone), (true, with_approver)] {
            let decision = psi(&kappas, has_approver, made_under());
            let rejected = *decision.outcome() == Recommendation::Reject;
            assert_eq!(admits(kappas.interface.outcome, kappas.policy.outcome), !rejected, "{kappas:?}");
            assert_eq!(*decision.outcome(), expected, "{name}, approver {has_approver}");
            assert_eq!(decision.answers().admitted, expected != Reject, "{name}");
        }
    }
}

/// Everything the gate looks at, changeable one by one.
struct Case {
    profile: Profile,
    table: PolicyTable,
    kappas: Kappas,
    shadow: Option<ShadowAssessment>,
    bindings: Vec<EvidenceBinding>,
    approval: Option<ApprovalResult>,
    blocked_under: BTreeSet<ProfileName>,
    unmet: Vec<String>,
    review_open: bool,
    requester: Requester,
    profile_authorized: bool,
    improved: bool,
    now: WallTime,
    clock_doubt: Option<ClockMismatch>,
    policy: Digest,
    omitted: AblatedParts,
}

impl Case {
    fn new(name: ProfileName) -> Self {
        let profile = profile(name);
        let table = PolicyTable::builtin(&profile).unwrap();
        let current = EvidenceBinding { policy: table.digest, ..binding() };
        let mut evidence = shadow(&profile);
        evidence.binding = current;
        Self {
            kappas: kappas(&profile, [1.0; 4]),
            shadow: Some(gate::assess_shadow(&evidence, &current, &profile)),
            bindings: vec![current; 3],
            approval: None,
            blocked_under: BTreeSet::new(),
            unmet: Vec::new(),
            review_open: false,
            requester: Requester::Script,
            profile_authorized: true,
            improved: false,
            now: at(100),
            clock_doubt: None,
            policy: table.digest,
            profile,
            table,
            omitted: AblatedParts::default(),
        }
    }

    fn evaluate(&self) -> GateResult {
        let current = EvidenceBinding { policy: self.policy, ..binding() };
        let input = GateInput {
            kappas: &self.kappas,
            shadow: self.shadow.as_ref(),
            bindings: &self.bindings,
            current: &current,
            improved: self.improved,
            approval: self.approval.as_ref(),
            risk: Risk::Medium,
            requester: &self.requester,
            provenance: Provenance::Llm,
            blocked_under: &self.blocked_under,
            unmet: &self.unmet,
            review_open: self.review_open,
            profile_authorized: self.profile_authorized,
            now: self.now,
            clock_doubt: self.clock_doubt,
            row_version: 7,
            made_under: holdpoint_governance::decision::DecisionContext {
                policy: self.policy,
                ..made_under()
            },
            omitted: self.omitted,
        };
        gate::evaluate(&input, &self.table, &self.profile)
    }
}

/// A part that an experiment leaves out is not required, is reported, and leaves everything else as strict as before.
#[test]
fn an_ablated_part_is_not_required_but_reported() {
    let skipped = |result: &GateResult| {
        let all = result.decision.reasons().iter();
        all.filter(|reason| reason.code == GateSkipped).map(|reason| reason.dimension).collect::<Vec<_>>()
    };
    for (part, dimensions) in [
        (AblationPart::Validation, vec![Dimension::Interface, Dimension::Policy]),
        (AblationPart::Sandbox, vec![Dimension::Behavior, Dimension::Recovery]),
        (AblationPart::Recovery, vec![Dimension::Recovery]),
        (AblationPart::Shadow, vec![Dimension::Shadow]),
    ] {
        let mut case = Case::new(ProfileName::Sim);
        let omitted = AblatedParts::of(&[part]);
        case.kappas = omitted.fill_ablated(case.kappas.clone());
        if part == AblationPart::Shadow {
            case.shadow = None;
        }
        let demanded = case.evaluate();
        assert!(demanded.passed.is_none(), "{part}: a gap is no pass");
        case.omitted = omitted;
        let result = case.evaluate();
        assert!(result.passed.is_some(), "{part}: {:?}", result.decision.reasons());
        assert_eq!(skipped(&result), dimensions, "{part}");
        case.kappas.behavior.outcome = BehaviorOutcome::Incompatible;
        let measured = !matches!(part, AblationPart::Sandbox);
        assert_eq!(case.evaluate().passed.is_none(), measured, "{part}: the rest is judged as ever");
    }
}

fn granted(people: &[&str]) -> ApprovalResult {
    ApprovalResult {
        outcome: ApprovalOutcome::Granted {
            people: people.iter().map(ToString::to_string).collect(),
            until: at(200),
            break_glass: false,
        },
        reasons: Vec::new(),
    }
}

#[test]
fn activation_modes_follow_the_profile() {
    use ActivationMode::{ApprovalBound, Conditional, Full, RollbackCoupled};
    for (name, modes) in [
        (ProfileName::Sim, vec![Full]),
        (ProfileName::Real, vec![RollbackCoupled]),
        (ProfileName::Human, vec![ApprovalBound, RollbackCoupled]),
    ] {
        let mut case = Case::new(name);
        case.approval = Some(granted(&["ann", "bob"]));
        let result = case.evaluate();
        let passed = result.passed.expect("passes");
        assert_eq!(passed.terms().modes, modes.into_iter().collect(), "{name:?}");
        assert_eq!(passed.terms().provisional_episodes, case.profile.activation.provisional_episodes);
    }
    let mut case = Case::new(ProfileName::Sim);
    case.kappas.interface.outcome = InterfaceOutcome::Conditional;
    assert_eq!(case.evaluate().passed.unwrap().terms().modes, [Conditional].into());
}

#[test]
fn gate_outcomes_and_reasons_by_case() {
    use GateOutcome::{AwaitApproval, Demote, Hold, Pass, Reject};
    use ProfileName::{Human, Real, Sim};
    type CaseChange = fn(&mut Case);
    let refused =
        ApprovalResult { outcome: ApprovalOutcome::Refused { person: "ann".into() }, reasons: Vec::new() };
    let timed_out = ApprovalResult { outcome: ApprovalOutcome::TimedOut, reasons: Vec::new() };
    let table: [(&str, ProfileName, CaseChange, GateOutcome, ReasonCode); 26] = [
        ("nothing", Sim, |_| (), Pass, GatePassed),
        (
            "I fails",
            Sim,
            |c| c.kappas.interface.outcome = InterfaceOutcome::Incompatible,
            Reject,
            GateDimensionFailed,
        ),
        ("B estimated", Sim, |c| c.kappas.behavior.basis = Basis::Estimated, Demote, GateNotMeasured),
        ("B no data", Sim, |c| c.kappas.behavior.outcome = BehaviorOutcome::NoData, Demote, GateNoData),
        ("B no value", Sim, |c| c.kappas.behavior.kappa = None, Demote, GateNoData),
        ("R inconclusive", Sim, |c| c.kappas.recovery.outcome = RecoveryOutcome::NoData, Demote, GateNoData),
        (
            "R fails",
            Sim,
            |c| recovery_fails(&mut c.kappas, RecoveryBelowThreshold),
            Reject,
            GateDimensionFailed,
        ),
        (
            "P review, no approver",
            Sim,
            |c| c.kappas.policy.outcome = PolicyOutcome::Review,
            Reject,
            GateDimensionFailed,
        ),
        ("no shadow", Sim, |c| c.shadow = None, Demote, GateNoData),
        ("no evidence", Sim, |c| c.bindings.clear(), Demote, GateNoData),
        ("stale evidence", Sim, |c| c.bindings[1].active = Some(digest("older")), Demote, GateStaleEvidence),
        ("other policies", Sim, |c| c.policy = digest("other"), Demote, GateStaleEvidence),
        (
            "frozen",
            Sim,
            |c| {
                c.profile.freeze =
                    vec![FreezeWindow { from: at(50), until: at(101), reason: "audit".into() }];
            },
            Hold,
            GateFrozen,
        ),
        (
            "a clock that was set",
            Sim,
            |c| c.clock_doubt = Some(ClockMismatch::Jumped { by_ms: 9_000 }),
            Hold,
            GateClockDoubted,
        ),
        ("unmet", Sim, |c| c.unmet = vec!["align@^2".into()], Hold, GateDependencyUnmet),
        (
            "no requester on record it, people nearby",
            Human,
            |c| c.requester = Requester::Unknown,
            Hold,
            GateRequesterUnknown,
        ),
        (
            "no requester on record it, and a review on a real cell",
            Real,
            |c| {
                c.requester = Requester::Unknown;
                c.profile.approval.quorum_medium = 1;
            },
            Hold,
            GateRequesterUnknown,
        ),
        ("review open", Sim, |c| c.review_open = true, Hold, GateReviewOpen),
        ("no one signed", Real, |c| c.profile_authorized = false, Hold, GateProfileUnauthorized),
        ("profile blocked", Real, |c| c.blocked_under = [Real].into(), Hold, GateProfileClosed),
        ("no gain", Sim, |c| c.profile.activation.require_improvement = true, Demote, GateNoImprovement),
        (
            "site policy",
            Sim,
            |c| {
                let text = "forbid (principal, action == Action::\"activate\", resource);";
                c.table.activations = PolicyTable::compile(&c.profile, &[PolicySource { file: "s", text }])
                    .unwrap()
                    .activations;
            },
            Reject,
            GateSitePolicyForbids,
        ),
        ("no one asked", Human, |_| (), AwaitApproval, ApprovalPending),
        ("one of two", Human, |c| c.approval = Some(granted(&["ann"])), AwaitApproval, ApprovalPending),
        (
            "asked under other rules",
            Human,
            |c| {
                c.approval =
                    Some(ApprovalResult { outcome: ApprovalOutcome::NotNeeded, reasons: Vec::new() });
            },
            AwaitApproval,
            ApprovalPending,
        ),
        ("both", Human, |c| c.approval = Some(granted(&["ann", "bob"])), Pass, GatePassed),
    ];
    for (name, profile, change, outcome, code) in table {
        let mut case = Case::new(profile);
        change(&mut case);
        let result = case.evaluate();
        assert_eq!(*result.decision.outcome(), outcome, "{name}: {:?}", result.decision.reasons());
        assert!(result.decision.has(code), "{name}: {:?}", result.decision.reasons());
        assert_eq!(result.passed.is_some(), outcome == Pass, "{name}");
        assert_eq!(result.decision.answers().admitted, outcome == Pass, "{name}");
    }
    for (answer, outcome) in [(refused, Reject), (timed_out, Hold)] {
        let mut case = Case::new(Human);
        case.approval = Some(answer);
        assert_eq!(*case.evaluate().decision.outcome(), outcome);
    }
}

#[test]
fn gate_pass_is_valid_only_for_its_row_context_and_time() {
    let mut case = Case::new(ProfileName::Human);
    case.approval = Some(granted(&["ann", "bob"]));
    let passed = case.evaluate().passed.unwrap();
    let under = *passed.made_under();
    let other = holdpoint_governance::decision::DecisionContext { evidence: digest("other"), ..under };
    for (row_version, made_under, now_s, holds) in
        [(7, under, 199, true), (8, under, 100, false), (7, other, 100, false), (7, under, 200, false)]
    {
        assert_eq!(passed.holds(row_version, &made_under, at(now_s)), holds, "{row_version} {now_s}");
    }
}

#[test]
fn shadow_by_governance_signals() {
    use holdpoint_governance::outcome::CheckResult;
    let profile = profile(ProfileName::Sim);
    type EvidenceChange = fn(&mut holdpoint_governance::evidence::ShadowEvidence);
    let table: [(&str, EvidenceChange, CheckResult, ReasonCode); 8] = [
        ("clean", |_| (), CheckResult::Pass, ShadowClean),
        ("one hit", |e| e.sequences[0].twin_policy_hit = true, CheckResult::Pass, ShadowClean),
        (
            "many hits",
            |e| e.sequences.iter_mut().take(10).for_each(|s| s.twin_policy_hit = true),
            CheckResult::Fail,
            ShadowGovernanceDivergence,
        ),
        (
            "hits in both",
            |e| e.sequences.iter_mut().for_each(|s| (s.twin_policy_hit, s.live_policy_hit) = (true, true)),
            CheckResult::Pass,
            ShadowClean,
        ),
        (
            "other outputs",
            |e| e.sequences.iter_mut().for_each(|s| s.output_divergence = 0.9),
            CheckResult::Inconclusive,
            ShadowOutputDivergence,
        ),
        ("few", |e| e.sequences.truncate(19), CheckResult::Inconclusive, ShadowNoData),
        ("no number", |e| e.sequences[3].envelope_divergence = f64::NAN, CheckResult::NoData, ShadowNoData),
        ("hard stop", |e| e.hard_stops.push(HardStop::BudgetBreach), CheckResult::Fail, GateHardLimit),
    ];
    for (name, change, check, code) in table {
        let mut evidence = shadow(&profile);
        change(&mut evidence);
        let found = gate::assess_shadow(&evidence, &binding(), &profile);
        assert_eq!(found.check, check, "{name}: {found:?}");
        assert!(found.reasons.iter().any(|reason| reason.code == code), "{name}: {found:?}");
    }
    // At the full length, output divergence is reported and decides nothing.
    let mut long = shadow(&profile);
    let first = long.sequences[0];
    long.sequences = (0..60)
        .map(|seed| holdpoint_governance::evidence::ShadowSequence { seed, output_divergence: 0.9, ..first })
        .collect();
    assert_eq!(gate::assess_shadow(&long, &binding(), &profile).check, CheckResult::Pass);
}

/// The recorded deployment outcome of a candidate (paper section 4.5), at each deciding rule.
#[test]
fn the_four_deployment_outcomes_are_on_record() {
    use holdpoint_governance::composition::psi_after_shadow;
    use holdpoint_governance::deployability::Deployability::{
        Conditionally, EvaluationOnly, Fully, Incompatible,
    };
    use holdpoint_governance::outcome::CheckResult;
    type OutcomeChange = fn(&mut Kappas);
    let of = |change: OutcomeChange| {
        let mut kappas = kappas(&profile(ProfileName::Sim), [1.0; 4]);
        change(&mut kappas);
        kappas
    };
    let cases: [(OutcomeChange, _); 5] = [
        (|_| (), Fully),
        (|k| k.behavior.outcome = BehaviorOutcome::Suspicious, Conditionally),
        (|k| k.recovery.outcome = RecoveryOutcome::Fragile, Conditionally),
        (|k| k.behavior.outcome = BehaviorOutcome::Incompatible, EvaluationOnly),
        (|k| k.interface.outcome = InterfaceOutcome::Incompatible, Incompatible),
    ];
    for (change, expected) in cases {
        let decision = psi(&of(change), false, made_under());
        assert_eq!(decision.answers().deployment, Some(expected));
        let written = serde_json::to_value(&decision).unwrap();
        assert_eq!(written["answers"]["deployment"], expected.name());
    }
    // A candidate that does not pass shadow stays for evaluation.
    for (check, expected) in [(CheckResult::Pass, Fully), (CheckResult::Fail, EvaluationOnly)] {
        let decision = psi_after_shadow(&of(|_| ()), false, made_under(), check);
        assert_eq!(decision.answers().deployment, Some(expected), "{check:?}");
    }
    type At = fn(&mut Case);
    let at: [(ProfileName, At, _); 5] = [
        (ProfileName::Sim, |_| (), Fully),
        (ProfileName::Real, |_| (), Conditionally),
        (ProfileName::Human, |_| (), Conditionally),
        (ProfileName::Sim, |c| c.shadow = None, EvaluationOnly),
        (ProfileName::Sim, |c| c.kappas.policy.outcome = PolicyOutcome::Incompatible, Incompatible),
    ];
    for (name, change, expected) in at {
        let mut case = Case::new(name);
        change(&mut case);
        assert_eq!(case.evaluate().decision.answers().deployment, Some(expected), "{name:?}");
    }
}

/// Each condition changes what the gate does: without it the same circumstances pass.
#[test]
fn conditions_act_at_the_gate() {
    let with = |name, condition: Option<Condition>| {
        let mut case = Case::new(name);
        case.kappas.behavior.conditions.extend(condition);
        case.evaluate()
    };
    for (name, condition, outcome, code) in [
        (ProfileName::Real, Condition::SimulationOnly, GateOutcome::Reject, GateSimulationOnly),
        (ProfileName::Sim, Condition::ShadowFirst { sequences: 21 }, GateOutcome::Demote, GateShadowTooShort),
        (
            ProfileName::Sim,
            Condition::ApprovalRequired { quorum: 1 },
            GateOutcome::AwaitApproval,
            ApprovalPending,
        ),
    ] {
        assert_eq!(*with(name, None).decision.outcome(), GateOutcome::Pass, "{condition:?}");
        let result = with(name, Some(condition.clone()));
        assert_eq!(*result.decision.outcome(), outcome, "{condition:?}");
        assert!(result.decision.has(code), "{condition:?}: {:?}", result.decision.reasons());
        assert!(result.passed.is_none());
    }
    // Met, they stand in the terms; what bounds the use makes the activation a conditional one.
    use ActivationMode::{ApprovalBound, Conditional};
    for (condition, answered, mode) in [
        (Condition::SimulationOnly, false, Some(Conditional)),
        (Condition::ShadowFirst { sequences: 20 }, false, None),
        (Condition::StricterThresholds { factor: 0.5 }, false, Some(Conditional)),
        (Condition::TighterEnvelope { speed_max_m_s: 0.1, force_max_n: 5.0 }, false, Some(Conditional)),
        (Condition::ApprovalRequired { quorum: 1 }, true, Some(ApprovalBound)),
    ] {
        let mut case = Case::new(ProfileName::Sim);
        case.kappas.behavior.conditions.push(condition.clone());
        case.approval = answered.then(|| granted(&["ann"]));
        let passed = case.evaluate().passed.expect("passes");
        assert!(passed.terms().conditions.contains(&condition), "{condition:?}");
        let modes = mode.map_or([ActivationMode::Full].into(), |mode| [mode].into());
        assert_eq!(passed.terms().modes, modes, "{condition:?}");
    }
}

/// A site's policy can require approval of activations for which the profile requires none.
#[test]
fn site_policy_can_require_an_approval() {
    let text = "@review(\"learnt versions\") permit (principal, action == Action::\"activate\", resource) \
                when { context.provenance == \"llm\" };";
    let mut case = Case::new(ProfileName::Real);
    assert_eq!(*case.evaluate().decision.outcome(), GateOutcome::Pass);
    case.table.activations =
        PolicyTable::compile(&case.profile, &[PolicySource { file: "s", text }]).unwrap().activations;
    assert_eq!(*case.evaluate().decision.outcome(), GateOutcome::AwaitApproval);
    case.approval = Some(granted(&["ann"]));
    let passed = case.evaluate().passed.expect("passes");
    assert!(passed.terms().modes.contains(&ActivationMode::ApprovalBound));
    assert!(passed.terms().conditions.contains(&Condition::ApprovalRequired { quorum: 1 }));
}

/// Whether success improved is in the decision, and so is that the profile does without.
#[test]
fn improvement_is_demanded_or_waived_on_record() {
    for (demanded, improved, outcome, code) in [
        (false, false, GateOutcome::Pass, GateImprovementWaived),
        (false, true, GateOutcome::Pass, GateImproved),
        (true, true, GateOutcome::Pass, GateImproved),
        (true, false, GateOutcome::Demote, GateNoImprovement),
    ] {
        let mut case = Case::new(ProfileName::Sim);
        let shipped = include_str!("../../../../profiles/sim.toml");
        let text =
            shipped.replace("require_improvement = false", &format!("require_improvement = {demanded}"));
        case.profile = Profile::parse("sim.toml", &text).unwrap();
        case.improved = improved;
        let result = case.evaluate();
        assert_eq!(*result.decision.outcome(), outcome, "{demanded} {improved}");
        assert!(result.decision.has(code), "{demanded} {improved}: {:?}", result.decision.reasons());
    }
}
