//! A reason of a decision in words.

use holdpoint_governance::decision::Reason;
use holdpoint_governance::explanation::ReasonContent;
use holdpoint_governance::finding::Finding;

use super::finding;
use crate::check::number;
use crate::harm::percent;

/// What was found, as one sentence without a full stop. A record of an older build has its sentence, which stays as it is.
#[must_use]
pub fn reason(reason: &Reason) -> String {
    reason.finding.as_ref().map_or_else(|| reason.older_text.clone(), finding)
}

/// The code, the sentence and the numbers, e.g. `behavior-improved: success is better on average [measured 0.120, limit
/// 0.000]`.
#[must_use]
pub fn line(of: &Reason) -> String {
    format!("{}: {}{}", of.code, reason(of), measured_and_limit(of.evidence, of.limit))
}

/// The measured value and the limit it was compared with, behind a sentence; empty if one is absent. The limit is a number
/// of the rules, never a value of the active version.
#[must_use]
pub fn measured_and_limit(measured: Option<f64>, limit: Option<f64>) -> String {
    match (measured, limit) {
        (Some(measured), Some(limit)) => format!(" [measured {measured:.3}, limit {limit:.3}]"),
        _ => String::new(),
    }
}

/// A sentence with the number of its reason and the limit of the rules, each in its unit. `before` and `after` stand around
/// the limit: a number alone does not tell on which side of it a version has to be.
pub(crate) fn with_limit(text: String, of: &ReasonContent, [before, after]: [&str; 2]) -> String {
    use Finding as F;
    let (Some(value), Some(limit)) = (of.evidence, of.limit) else { return text };
    let found = of.finding.as_ref();
    let numbers = match found {
        // Its sentence has both.
        Some(F::DangerLive { .. }) => return text,
        Some(F::HarmRoseLive { .. }) => {
            evidence([value, limit], &format!("in 1 of {} versions at most", number(limit)))
        }
        Some(F::RateWorse { .. }) => evidence([value, limit], &after_tasks(limit)),
        // Recorded as a logarithm.
        Some(F::RateDrifts { .. }) => evidence([value.exp(), limit.exp()], &after_tasks(limit.exp())),
        Some(F::ShiftedInShadow { .. } | F::ShiftedLive { .. }) => {
            format!("p value {value:.4}, significant up to {limit:.4}")
        }
        Some(F::SignalLeans { .. }) => {
            format!("{} more; it counts from {}", number(value), number(limit))
        }
        Some(F::DrillsLean { .. } | F::DrillsWorse { .. } | F::PhaseWorse { .. }) => {
            format!("{} pass, {} of the active version's", percent(value), percent(limit))
        }
        Some(F::EnvelopeTighter { speed_m_s, .. }) => {
            let unit = if *speed_m_s == Some(limit) { "m/s" } else { "N" };
            format!("it declares {} {unit}; at most {} {unit} is allowed", number(value), number(limit))
        }
        _ => format!("{}; {before}{}{after}", in_unit(found, value), in_unit(found, limit)),
    };
    format!("{text} ({numbers})")
}

/// The evidence of a monitor that a rate is above normal, where it acts, and how rarely a normal rate comes to that.
fn evidence([found, limit]: [f64; 2], by_chance: &str) -> String {
    format!(
        "evidence {}; the monitor acts at {}, which a normal rate reaches {by_chance}",
        number(found),
        number(limit)
    )
}

fn after_tasks(tasks: f64) -> String {
    format!("after {} tasks or more on average", number(tasks))
}

/// A number of a finding with its unit.
fn in_unit(of: Option<&Finding>, value: f64) -> String {
    use Finding as F;
    match of {
        Some(F::HarmWorse { measure, .. } | F::HarmPossiblyWorse { measure, .. }) => measure.format(value),
        Some(F::HarmLimitWorse { .. } | F::HarmLimitPossiblyWorse { .. } | F::AsksMore { .. }) => {
            percent(value)
        }
        Some(
            F::AnchorWorse { by, .. }
            | F::AnchorPossiblyWorse { by, .. }
            | F::LiveLikeWorse { by }
            | F::LiveLikePossiblyWorse { by },
        ) => in_unit(Some(by), value),
        Some(F::TelemetrySilent) => format!("{} ms", number(value)),
        Some(F::TicksTooSlow { .. }) => format!("{} us", number(value)),
        Some(F::EvaluationTooLong { .. }) => format!("{} min", number(value)),
        _ => number(value),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::harm::HarmKind;
    use holdpoint_governance::monitor::Rate;

    /// Regression: `(5423; at most 2000 is allowed)`, `(0.500 against a limit of 0.250)`: of what?
    #[test]
    fn a_number_beside_its_limit_says_what_it_is() {
        let of = |finding: Finding, evidence, limit| {
            let content = ReasonContent {
                finding: Some(finding),
                older_text: String::new(),
                evidence: Some(evidence),
                limit: Some(limit),
            };
            with_limit("found".to_owned(), &content, ["limit ", ""])
        };
        let rate = Rate::ALL[0];
        let measure = HarmKind::GripPeak;
        let rose = Finding::HarmRoseLive { measure, past: 9, any: 9, tasks: 1_296, normal: 0.005 };
        assert_eq!(
            of(rose, 103.2, 100.0),
            "found (evidence 103; the monitor acts at 100, which a normal rate reaches in 1 of 100 versions at most)"
        );
        assert_eq!(
            of(Finding::RateWorse { rate }, 5_423.0, 2_000.0),
            "found (evidence 5423; the monitor acts at 2000, which a normal rate reaches after 2000 tasks or more on average)"
        );
        let drifts = of(Finding::RateDrifts { rate }, 200.0_f64.ln(), 148.0_f64.ln());
        assert!(drifts.starts_with("found (evidence 200; the monitor acts at 148, "), "{drifts}");
        let tighter = |speed_m_s, force_n| Finding::EnvelopeTighter { speed_m_s, force_n };
        assert_eq!(
            of(tighter(Some(0.25), None), 0.5, 0.25),
            "found (it declares 0.5 m/s; at most 0.25 m/s is allowed)"
        );
        // A finding of an older build has both; the number is that of the force.
        assert_eq!(
            of(tighter(Some(0.25), Some(25.0)), 35.0, 25.0),
            "found (it declares 35 N; at most 25 N is allowed)"
        );
        assert_eq!(of(Finding::TelemetrySilent, 61.0, 50.0), "found (61 ms; limit 50 ms)");
        let danger = Finding::DangerLive { measure, value: 71.0, limit: 60.0 };
        assert_eq!(of(danger, 71.0, 60.0), "found");
        let harm = Finding::HarmWorse { measure, candidate: 70.0, active: 24.0, tolerance: 5.0 };
        let by = Finding::LiveLikeWorse { by: Box::new(harm) };
        let [found, limit] = [40.0, 5.0].map(|value| measure.format(value));
        assert_eq!(of(by, 40.0, 5.0), format!("found ({found}; limit {limit})"));
    }
}
