//! The order of the reasons about behavior: what decides stands first.
//!
//! Moves reasons and changes none. A front end shows the first one as the headline.

use super::BehaviorComponent;
use crate::decision::Reason;
use crate::finding::Finding;

/// The place of a reason in its list; within a place the larger share of what is tolerated comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum ReasonPlace {
    /// It states how much was measured.
    Extent,
    /// It makes the version incompatible by itself.
    DecidesAlone,
    /// Success rose with it, so that no tolerance holds.
    Traded,
    /// It counts in the sum of all significant worsenings. Far within its tolerance it decides next to nothing.
    InSum,
    /// It decides no incompatibility.
    Aside,
}

impl BehaviorComponent {
    /// Whether the worsening makes a version incompatible by itself, also within its tolerance.
    #[must_use]
    pub fn decides_alone(&self) -> bool {
        self.is_established() && self.name.blocks_alone_at(self.worsening, self.success_loss_max)
    }
}

/// Orders the reasons: what decides alone first, then the others by their worsening as a share of their tolerance.
/// Reasons that are no significant worsening keep their order.
pub(super) fn deciding_first(reasons: &mut [Reason], components: &[BehaviorComponent]) {
    reasons.sort_by(|a, b| {
        let (a_place, b_place) = (place(a, components), place(b, components));
        a_place.cmp(&b_place).then_with(|| match a_place {
            ReasonPlace::DecidesAlone | ReasonPlace::InSum => share(b).total_cmp(&share(a)),
            ReasonPlace::Extent | ReasonPlace::Traded | ReasonPlace::Aside => std::cmp::Ordering::Equal,
        })
    });
}

fn place(reason: &Reason, components: &[BehaviorComponent]) -> ReasonPlace {
    match &reason.finding {
        Some(Finding::PairsEndedEarly { .. } | Finding::TooFewPairs) => ReasonPlace::Extent,
        Some(Finding::HarmWorse { .. } | Finding::HarmLimitWorse { .. }) => ReasonPlace::DecidesAlone,
        Some(Finding::ComponentWorse { component } | Finding::ComponentWorseSoFar { component }) => {
            let alone = components.iter().any(|found| found.name == *component && found.decides_alone());
            if alone { ReasonPlace::DecidesAlone } else { ReasonPlace::InSum }
        }
        Some(Finding::SafetyTraded { .. }) => ReasonPlace::Traded,
        Some(_) | None => ReasonPlace::Aside,
    }
}

/// The worsening as a share of what is tolerated; infinite where nothing is, or where there is no number.
fn share(reason: &Reason) -> f64 {
    match (reason.evidence, reason.limit) {
        (Some(worsening), Some(tolerance)) if tolerance > 0.0 => worsening / tolerance,
        _ => f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::{ComponentName, reason};
    use crate::harm::HarmKind;

    fn component(name: ComponentName, worsening: f64, tolerance: f64) -> BehaviorComponent {
        let upper = Some(2.0 * worsening);
        BehaviorComponent {
            name,
            worsening,
            lower: 0.5 * worsening,
            upper,
            tolerance,
            success_loss_max: 0.05,
            upper_alpha: 0.05,
        }
    }

    fn worse(of: &BehaviorComponent) -> Reason {
        reason(Finding::ComponentWorse { component: of.name }).with(of.worsening, of.tolerance)
    }

    fn ordered(mut reasons: Vec<Reason>, components: &[BehaviorComponent]) -> Vec<Reason> {
        deciding_first(&mut reasons, components);
        reasons
    }

    /// Regression: time, 2.6 % of 60 % longer, was the headline of a rejection by harm.
    #[test]
    fn what_decides_stands_before_what_is_tolerated() {
        let time = component(ComponentName::Time, 0.026, 0.6);
        let retry = component(ComponentName::Retry, 0.9, 0.6);
        let anomaly = component(ComponentName::Anomaly, 0.02, 0.05);
        let components = [time, retry, anomaly];
        let measure = HarmKind::GripPeak;
        let harm = Finding::HarmWorse { measure, candidate: 70.0, active: 24.0, tolerance: 5.0 };
        let harm = reason(harm).with(40.0, 5.0);
        let better = reason(Finding::ComponentBetter { component: ComponentName::Success }).with(0.1, 0.0);
        let reasons = vec![better.clone(), worse(&time), worse(&retry), worse(&anomaly), harm.clone()];
        let expected = vec![harm, worse(&anomaly), worse(&retry), worse(&time), better];
        assert_eq!(ordered(reasons, &components), expected);
    }

    #[test]
    fn an_early_end_heads_the_list_and_a_trade_stands_before_the_sum() {
        let recovery = component(ComponentName::Recovery, 0.02, 0.15);
        let few = reason(Finding::TooFewPairs).with(100.0, 300.0);
        let traded = reason(Finding::SafetyTraded { component: ComponentName::Recovery }).with(0.02, 0.0);
        let reasons = vec![worse(&recovery), traded.clone(), few.clone()];
        assert_eq!(ordered(reasons, &[recovery]), [few, traded, worse(&recovery)]);
    }

    #[test]
    fn reasons_that_decide_no_incompatibility_keep_their_order() {
        let possible = |component| reason(Finding::ComponentPossiblyWorse { component });
        let reasons = vec![
            possible(ComponentName::Time).with(0.7, 0.6),
            possible(ComponentName::Violation).with(0.9, 0.05),
            reason(Finding::BehaviorCompatible).with(0.95, 0.9),
        ];
        assert_eq!(ordered(reasons.clone(), &[]), reasons);
    }
}
