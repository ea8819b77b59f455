//! The values of a check as they are counted, and what decides it.

use super::*;
use holdpoint_governance::evidence::HardStop;
use holdpoint_governance::finding::EvidenceGap;

fn pair(violation: bool) -> Pair {
    let values = EpisodeValues { time_s: 4.0, ..EpisodeValues::CLEAN };
    let candidate = EpisodeValues { violation, ..values };
    Pair { seed: 1, active: values, candidate, live_like: false }
}

fn component(
    name: ComponentName,
    worsening: f64,
    (lower, upper): (f64, Option<f64>),
    tolerance: f64,
) -> BehaviorComponent {
    BehaviorComponent { name, worsening, lower, upper, tolerance, success_loss_max: 0.05, upper_alpha: 0.05 }
}

#[test]
fn a_component_counts_the_episodes_that_are_bad() {
    let component = component(ComponentName::Violation, 0.5, (0.1, Some(0.9)), 0.05);
    let pairs = [pair(true), pair(false)];
    let found = component_finding(&component, &pairs, bound_of(&component, true));
    assert_eq!(found.values, ComponentValues::Episodes { candidate: 1, active: 0, of: 2 });
    assert_eq!(found.bound, None, "the mean decides");
    assert_eq!(weight(0.5, 0.05), Some(10.0));
    assert_eq!(weight(0.5, 0.0), None);
}

/// Regression: a recovery after a task that it alone lost made the candidate look worse than the verdict beside it.
#[test]
fn recovery_is_counted_where_both_versions_or_neither_do_the_task() {
    let component = component(ComponentName::Recovery, -0.25, (-0.5, Some(0.1)), 0.15);
    let mut pairs = [pair(false); 4];
    for pair in &mut pairs[..3] {
        pair.candidate.recovery = true;
    }
    (pairs[0].candidate.success, pairs[1].candidate.success) = (false, false);
    (pairs[2].active.recovery, pairs[3].active.recovery) = (true, true);
    let values = component_finding(&component, &pairs, None).values;
    assert_eq!(values, ComponentValues::Episodes { candidate: 1, active: 2, of: 4 });
}

#[test]
fn time_is_averaged_where_both_versions_succeed() {
    let component = component(ComponentName::Time, 0.1, (0.0, Some(0.2)), 0.25);
    let mut pairs = [pair(false), pair(false)];
    (pairs[0].candidate.time_s, pairs[1].active.time_s) = (5.0, 9.0);
    pairs[1].active.success = false;
    let values = component_finding(&component, &pairs, None).values;
    assert_eq!(values, ComponentValues::Mean { candidate: 5.0, active: 4.0 });
    let values = component_finding(&component, &[], None).values;
    assert_eq!(values, ComponentValues::Mean { candidate: 0.0, active: 0.0 });
}

/// Regression: such a row was marked as worse beside a mean that is tolerated.
#[test]
fn a_bound_decides_where_the_mean_is_tolerated() {
    let of = |lower, upper| {
        let component = component(ComponentName::Violation, 0.04, (lower, upper), 0.05);
        assert_eq!(
            bound_of(&component, false),
            bound_of(&BehaviorComponent { lower: 0.0, ..component }, false)
        );
        bound_of(&component, component.is_established())
    };
    assert_eq!(of(0.0, Some(0.045)), None);
    assert_eq!(of(0.0, Some(0.085)), Some(DecidingBound::NotExcluded(0.085)));
    assert_eq!(of(0.01, Some(0.085)), Some(DecidingBound::Established(0.01)));
    assert_eq!(of(0.0, None), Some(DecidingBound::Unbounded));
}

#[test]
fn the_gravest_finding_comes_first() {
    let reason = CheckReason { content: ReasonContent::default(), overrun: None };
    let found =
        |weight, verdict| WeighedFinding { finding: CheckFinding::Reason(reason.clone()), weight, verdict };
    let mut all = [
        found(Some(9.0), FindingVerdict::Tolerable),
        found(Some(1.0), FindingVerdict::Worse),
        found(None, FindingVerdict::Doubtful),
        found(Some(3.0), FindingVerdict::Worse),
    ];
    by_gravity(&mut all);
    assert_eq!(all.map(|found| found.weight), [Some(3.0), Some(1.0), None, Some(9.0)]);
}

/// Before the sandbox, and in records without measurements, a reason was both the deciding fact and a finding.
#[test]
fn the_deciding_fact_is_not_repeated_as_a_finding() {
    let reason = Reason::new(Dimension::Behavior, Finding::BehaviorGap { gap: EvidenceGap::NotMeasured });
    let other = Reason::new(Dimension::Behavior, Finding::Estimated);
    let of = |reason| CheckFinding::Reason(check_reason(&EvidenceFile::default(), reason));
    let [first, estimate] = [&reason, &other].map(of);
    let why = base_rationale(&EvidenceFile::default(), &[reason, other], Dimension::Behavior);
    assert_eq!(why.fact, DecidingFact::Against { finding: first, reason: None });
    let found: Vec<&CheckFinding> = why.findings.iter().map(|found| &found.finding).collect();
    assert_eq!(found, [&estimate]);
}

/// Regression: a force declared too low was "rollback drills 0 of 10, 7 are needed".
#[test]
fn failed_drills_name_a_declaration_that_is_too_low() {
    use holdpoint_governance::manifest::Permissions;
    use holdpoint_governance::permission::{PeakQuantity, PermissionsUsed};
    use holdpoint_runtime::capability::Capability;
    use holdpoint_trials::embedded;

    let name = embedded::names().next().unwrap();
    let version = Capability::load(name, embedded::package(name).unwrap()).unwrap();
    let declared = Permissions { max_force_n: 12.0, ..version.manifest.permissions.clone() };
    let used = PermissionsUsed { asked_force_n: 18.0, ..PermissionsUsed::default() };
    let permissions = Some(PermissionUse::new(&declared, &version.bundle.interface(), &used, 20));
    let file = EvidenceFile { permissions, ..EvidenceFile::default() };
    let drills = Reason::new(Dimension::Recovery, Finding::RollbackDrillsFail).with(0.0, 0.7);
    assert_eq!(asked_beyond(&file).len(), 1, "{:?}", asked_beyond(&file));
    let raise = Remedy::RaiseDeclaration { quantity: PeakQuantity::Force, asked: 18.0, declared: 12.0 };
    assert_eq!(remedies(&file, [&drills]).first(), Some(&raise));
    assert_eq!(remedies(&EvidenceFile::default(), [&drills]).len(), 1, "only what the drills need");
}

/// Regression: an explanation named 40 of 120 failed episodes, but not that the version's code traps in them.
#[test]
fn faults_of_code_come_first() {
    use holdpoint_body::CodeFault;
    use holdpoint_governance::permission::PermissionsUsed;
    use holdpoint_runtime::capability::Capability;
    use holdpoint_trials::embedded;

    let name = embedded::names().next().unwrap();
    let version = Capability::load(name, embedded::package(name).unwrap()).unwrap();
    let with = |fault| {
        let used = PermissionsUsed { faults: [(fault, 40)].into(), ..PermissionsUsed::default() };
        let (declared, code) = (&version.manifest.permissions, version.bundle.interface());
        let permissions = Some(PermissionUse::new(declared, &code, &used, 120));
        EvidenceFile { permissions, ..EvidenceFile::default() }
    };
    let stop = HardStop::BudgetBreach;
    let reason = Reason::new(Dimension::Behavior, Finding::SandboxHardStop { stop });
    let why = rationale(&with(CodeFault::Trap), std::slice::from_ref(&reason), Dimension::Behavior);
    assert_eq!(why.faults, [CodeFaultCount { fault: CodeFault::Trap, failed: 40, tasks: 120 }]);
    let why = rationale(&with(CodeFault::Fuel), &[reason], Dimension::Behavior);
    let DecidingFact::Against { finding: CheckFinding::Reason(reason), .. } = &why.fact else {
        panic!("{:?}", why.fact)
    };
    assert_eq!(reason.overrun, Some(CodeFault::Fuel));
}

#[test]
fn an_unassessed_version_has_no_rationale() {
    assert!(rationales(&EvidenceFile::default(), &[]).is_empty());
}
