//! A reason of a decision in words.

use holdpoint_governance::decision::Reason;

use super::finding;

/// What was found, as one sentence without a full stop. A record of an older build has its sentence, which stays as it is.
#[must_use]
pub fn reason(reason: &Reason) -> String {
    reason.finding.as_ref().map_or_else(|| reason.older_text.clone(), finding)
}

/// The code, the sentence and the numbers, e.g. `behavior-improved: success is better on average [0.120 against 0.000]`.
#[must_use]
pub fn line(of: &Reason) -> String {
    let text = reason(of);
    match (of.evidence, of.limit) {
        (Some(found), Some(limit)) => format!("{}: {text} [{found:.3} against {limit:.3}]", of.code),
        _ => format!("{}: {text}", of.code),
    }
}
