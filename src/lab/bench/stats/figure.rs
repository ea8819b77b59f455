//! One figure of the study, and whether it agrees with the stated bound.

use serde::Serialize;

use holdpoint_governance::stats::{StatsError, clopper_pearson_lower, clopper_pearson_upper};

/// A figure is compared with the stated bound at this error rate: a true statement is refuted this seldom.
const REFUTE_ALPHA: f64 = 1e-4;

/// The stated bound of a rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum StatedBound {
    /// At most this rate of runs.
    AtMost(f64),
    /// At least this rate of runs.
    AtLeast(f64),
}

holdpoint_governance::closed_set! {
    /// The counted or averaged quantity of a figure.
    StudyMeasure, "measure of the study", {
        /// Pass rules: the verdict of the shortened run is not that of the full run.
        DiffersFromFullRun = "differs-from-full-run",
        RunsUsed = "runs-used",
        /// Pairs: the shortened evaluation rejects and the full budget does not.
        DiffersFromFullBudget = "differs-from-full-budget",
        RejectsEarly = "rejects-early",
        PairsUsed = "pairs-used",
        EqualCompatible = "equal-compatible",
        AnomaliesIncompatible = "anomalies-incompatible",
        /// More success and established harm to safety, and still compatible.
        TradeCompatible = "trade-compatible",
        EqualRejectedForHarm = "equal-rejected-for-harm",
        WorseFound = "worse-found",
        EqualFailsShadow = "equal-fails-shadow",
        WorseFailsShadow = "worse-fails-shadow",
        UnchangedRestricted = "unchanged-restricted",
        UnchangedRolledBack = "unchanged-rolled-back",
        DelayToRestriction = "delay-to-restriction",
        WorseRestricted = "worse-restricted",
        DelayToRollback = "delay-to-rollback",
        WorseRolledBack = "worse-rolled-back",
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StudyFigure {
    pub rule: &'static str,
    pub what: StudyMeasure,
    /// The conditions. This text also names the stream of samples: another text gives other numbers.
    pub under: String,
    /// Runs it was taken from.
    pub runs: u64,
    /// The rate (0 to 1), or the mean or median in `unit`.
    pub value: f64,
    /// `share`, `pairs` or `episodes`.
    pub unit: &'static str,
    /// The stated bound; absent if the figure is only reported.
    pub stated: Option<StatedBound>,
    /// Whether the runs leave the stated bound possible (exact bound at one in ten thousand); true without one.
    pub holds: bool,
}

/// A rate over runs, compared with its stated bound.
pub(super) fn rate(
    rule: &'static str,
    what: StudyMeasure,
    under: String,
    (events, runs): (u64, u64),
    stated: Option<StatedBound>,
) -> Result<StudyFigure, StatsError> {
    let holds = match stated {
        None => true,
        Some(StatedBound::AtMost(rate)) => clopper_pearson_lower(events, runs, REFUTE_ALPHA)? <= rate,
        Some(StatedBound::AtLeast(rate)) => clopper_pearson_upper(events, runs, REFUTE_ALPHA)? >= rate,
    };
    let value = events as f64 / runs as f64;
    Ok(StudyFigure { rule, what, under, runs, value, unit: "share", stated, holds })
}

/// A mean or median that is only reported.
pub(super) fn unjudged(
    rule: &'static str,
    what: StudyMeasure,
    under: String,
    runs: u64,
    value: f64,
    unit: &'static str,
) -> StudyFigure {
    StudyFigure { rule, what, under, runs, value, unit, stated: None, holds: true }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stated_rate_is_refuted_by_significant_counts() {
        for (events, runs, stated, holds) in [
            (0, 1_000, StatedBound::AtMost(0.0), true),
            (1, 1_000, StatedBound::AtMost(0.0), false),
            (15, 1_000, StatedBound::AtMost(0.01), true),
            (40, 1_000, StatedBound::AtMost(0.01), false),
            (990, 1_000, StatedBound::AtLeast(0.99), true),
            (940, 1_000, StatedBound::AtLeast(0.99), false),
        ] {
            let found =
                rate("r", StudyMeasure::RunsUsed, String::new(), (events, runs), Some(stated)).unwrap();
            assert_eq!(found.holds, holds, "{events} of {runs}, {stated:?}");
        }
    }
}
