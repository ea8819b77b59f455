//! The difference between a decision on record and its replay, in words.

use std::fmt::Display;

/// A value that differs, with both sides.
#[must_use]
pub fn differs(at: &str, recorded: impl Display, again: impl Display) -> String {
    format!("{at} is {recorded} on record and {again} when replayed")
}

/// A store without decisions.
#[must_use]
pub fn no_decisions(to_record: u64) -> String {
    format!("no decisions up to record {to_record}")
}

/// The numbers of decisions that a re-run found the same, different and not possible, the causes of the last, and the
/// number of evaluations that it ran.
#[must_use]
pub fn rerun_totals(
    to_record: u64,
    [same, different, impossible]: [u64; 3],
    causes: &[String],
    evaluations: u64,
) -> String {
    let causes = if causes.is_empty() { String::new() } else { format!(" ({})", causes.join(", ")) };
    format!(
        "decisions up to record {to_record}: {same} same, {different} different, {impossible} not possible{causes}; \
         evaluations run again: {evaluations}"
    )
}

/// The level of a counted try, as a place of a difference.
pub const TRY_LEVEL: &str = "level of the try";

/// The pairs of a counted try, as a place of a difference.
pub const TRY_PAIRS: &str = "pairs of the try";

/// The behavior of a re-evaluation, as a place of a difference.
pub const LIVE_BEHAVIOR: &str = "behavior in the live cell's conditions";

/// An action of a monitor that no task supports.
pub const NO_TASK_SUPPORTS: &str = "no live task on record supports the action";

/// Evidence in a store that has another digest on record.
pub const OTHER_EVIDENCE_ON_RECORD: &str = "the evidence is not the one whose digest is on record";

/// Evidence that has another digest in the decision.
pub const OTHER_EVIDENCE_IN_DECISION: &str = "the evidence is not the one the decision names by its digest";

/// A re-evaluation without a cause.
pub const NEEDLESS_RE_EVALUATION: &str = "it was re-evaluated, and is not inconclusive";
