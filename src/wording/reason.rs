//! A reason of a decision in words.

use holdpoint_governance::decision::Reason;

use super::finding;

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
