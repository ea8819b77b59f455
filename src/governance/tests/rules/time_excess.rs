//! An excess of time leads the decision, and leaves the version where it can be evaluated again.

use holdpoint_governance::composition::psi;
use holdpoint_governance::decision::ReasonCode::{BehaviorTickTooSlow, BehaviorTimeSpent};
use holdpoint_governance::gate::assess_shadow;
use holdpoint_governance::outcome::{CheckResult, PolicyOutcome, Recommendation, RecoveryOutcome};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::time_excess::TimeExcess;

use crate::fixture::{binding, kappas, made_under, profile, shadow};

#[test]
fn an_excess_of_time_leads_the_decision_and_is_put_to_no_one() {
    let profile = profile(ProfileName::Human);
    for (excess, code) in [
        (TimeExcess::of_tick(9_500.0, 1_000, &profile).unwrap(), BehaviorTickTooSlow),
        (TimeExcess::of_evaluation(u64::MAX, &profile).unwrap(), BehaviorTimeSpent),
    ] {
        let mut open = kappas(&profile, [1.0; 4]);
        open.behavior = excess.behavior(&profile);
        for (policy, recovery) in [
            (PolicyOutcome::Compatible, RecoveryOutcome::Compatible),
            (PolicyOutcome::Review, RecoveryOutcome::Compatible),
            (PolicyOutcome::Compatible, RecoveryOutcome::Incompatible),
        ] {
            (open.policy.outcome, open.recovery.outcome) = (policy, recovery);
            for has_approver in [false, true] {
                let decision = psi(&open, has_approver, made_under());
                assert_eq!(*decision.outcome(), Recommendation::Sandbox, "{policy} {recovery}");
                assert_eq!(decision.reasons()[0].code, code);
            }
        }
        // It hides no fault of interface or policy.
        open.policy.outcome = PolicyOutcome::Incompatible;
        let decision = psi(&open, true, made_under());
        assert_eq!(*decision.outcome(), Recommendation::Reject);
    }
}

#[test]
fn a_re_evaluation_that_did_not_end_leaves_shadow_open() {
    let profile = profile(ProfileName::Sim);
    let mut found = assess_shadow(&shadow(&profile), &binding(), &profile);
    assert_eq!(found.check, CheckResult::Pass);
    TimeExcess::Evaluation { worked_ms: 3_600_000 }.leave_open(&mut found, &profile);
    assert_eq!((found.check, found.reasons[0].code), (CheckResult::Inconclusive, BehaviorTimeSpent));
}
