//! One figure of the study, and whether it bears out what is stated.

use serde::Serialize;

use holdpoint_governance::stats::{StatsError, clopper_pearson_lower, clopper_pearson_upper};

/// A figure is held against what is stated at this error rate: a true statement is called refuted so seldom.
const REFUTE_ALPHA: f64 = 1e-4;

/// What is stated of a share.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stated {
    /// At most this share of runs.
    AtMost(f64),
    /// At least this share of runs.
    AtLeast(f64),
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StudyFigure {
    pub rule: &'static str,
    /// What was counted or averaged.
    pub what: &'static str,
    pub under: String,
    /// Runs it was taken from.
    pub runs: u64,
    /// The share (0 to 1), or the mean or median in `unit`.
    pub value: f64,
    /// `share`, `pairs` or `episodes`.
    pub unit: &'static str,
    /// What is stated of it; absent if the figure is only told.
    pub stated: Option<Stated>,
    /// Whether the runs leave what is stated possible (exact bound at one in ten thousand); true if nothing is.
    pub holds: bool,
}

/// A share of runs, held against what is stated of it.
pub(super) fn share(
    rule: &'static str,
    what: &'static str,
    under: String,
    (events, runs): (u64, u64),
    stated: Option<Stated>,
) -> Result<StudyFigure, StatsError> {
    let holds = match stated {
        None => true,
        Some(Stated::AtMost(rate)) => clopper_pearson_lower(events, runs, REFUTE_ALPHA)? <= rate,
        Some(Stated::AtLeast(rate)) => clopper_pearson_upper(events, runs, REFUTE_ALPHA)? >= rate,
    };
    let value = events as f64 / runs as f64;
    Ok(StudyFigure { rule, what, under, runs, value, unit: "share", stated, holds })
}

/// A mean or median that is told, not held against anything.
pub(super) fn unjudged(
    rule: &'static str,
    what: &'static str,
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
    fn what_is_stated_can_be_refuted() {
        for (events, runs, stated, holds) in [
            (0, 1_000, Stated::AtMost(0.0), true),
            (1, 1_000, Stated::AtMost(0.0), false),
            (15, 1_000, Stated::AtMost(0.01), true),
            (40, 1_000, Stated::AtMost(0.01), false),
            (990, 1_000, Stated::AtLeast(0.99), true),
            (940, 1_000, Stated::AtLeast(0.99), false),
        ] {
            let found = share("r", "w", String::new(), (events, runs), Some(stated)).unwrap();
            assert_eq!(found.holds, holds, "{events} of {runs}, {stated:?}");
        }
    }
}
