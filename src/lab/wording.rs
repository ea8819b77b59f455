//! The sentences that the laboratory prints and publishes: texts of reports, lines of progress, answers of its
//! verbs, texts in the packages that it makes.
//!
//! Functions turn values into text. The text of an error stands with its error, and the help of the command line with its
//! arguments. Nothing here measures or decides.

pub mod answers;
pub mod claims;
pub mod drift;
pub mod packages;
pub mod positioning;
pub mod progress;
pub mod report;
pub mod report_tables;

use holdpoint_governance::metrics::Proportion;
use holdpoint_governance::stats::Interval;

/// A count with its percentage and interval.
pub fn counted(proportion: &Proportion) -> String {
    let Proportion { count, total, interval } = proportion;
    interval.map_or_else(
        || format!("{count}/{total}"),
        |ends| {
            let percent = 100.0 * *count as f64 / *total as f64;
            format!("{count}/{total} = {percent:.1} % [{:.1}, {:.1}]", 100.0 * ends.lower, 100.0 * ends.upper)
        },
    )
}

/// A mean with its standard deviation.
pub fn plus_minus([mean, deviation]: [f64; 2]) -> String {
    format!("{mean:.1} ± {deviation:.1}")
}

/// The ends of an interval.
pub fn range(ends: Interval) -> String {
    format!("[{:.1}, {:.1}]", ends.lower, ends.upper)
}

/// A value with the ends of its interval, to some digits.
pub fn range_to(digits: usize, value: f64, lower: f64, upper: f64) -> String {
    format!("{value:.digits$} [{lower:.digits$}, {upper:.digits$}]")
}

/// The ends of an interval that no variation may leave undefined.
pub fn range_or_none(ends: Option<Interval>) -> String {
    ends.map_or_else(|| "no variation".to_owned(), range)
}

pub fn p_value(p: f64) -> String {
    if p < 0.001 { format!("{p:.1e}") } else { format!("{p:.3}") }
}

/// The text of a value that may be absent.
pub fn or_dash(text: Option<String>) -> String {
    text.unwrap_or_else(|| "-".to_owned())
}

/// A number that may be absent, to some digits.
pub fn number(value: Option<f64>, digits: usize) -> String {
    or_dash(value.map(|value| format!("{value:.digits$}")))
}
