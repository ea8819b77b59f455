//! The claims about a pool's candidates, and the numbers that they rest on.

use holdpoint_governance::metrics::Proportion;
use holdpoint_governance::profile::ProfileName;

use crate::pipeline_experiments::claims::Summary;

pub const NOTHING_REJECTED: &str = "nothing was rejected by measurement";
pub const NO_BENIGN: &str = "no benign candidates";
pub const STRICTER_LOSES_NO_FEWER: &str = "a stricter profile loses no fewer benign candidates";

pub fn overt_stopped(profile: ProfileName) -> String {
    format!("{profile}: every overt fault is stopped before activation")
}

pub fn marginal_stopped(profile: ProfileName) -> String {
    format!("{profile}: four of five marginal faults are stopped by the end of the provisional window")
}

pub fn rejected_early(profile: ProfileName) -> String {
    format!("{profile}: half of the overt faults are rejected within a quarter of the budget")
}

pub fn few_lost(profile: ProfileName) -> String {
    format!("{profile}: at most 2 % of benign candidates are lost")
}

pub fn rate(proportion: &Proportion) -> String {
    let Proportion { count, total, interval } = proportion;
    interval.map_or_else(
        || format!("{count} of {total}"),
        |ends| format!("{count} of {total}, 95 % interval {:.3} to {:.3}", ends.lower, ends.upper),
    )
}

/// A rate with its one-sided lower bound.
pub fn at_least(proportion: &Proportion, lower: Option<f64>) -> String {
    let least = lower.map_or_else(String::new, |lower| format!("; at least {lower:.3} at 5 % error"));
    rate(proportion) + &least
}

/// A rate with its one-sided upper bound.
pub fn at_most(proportion: &Proportion, upper: f64) -> String {
    format!("{}; one-sided 95 % bound {upper:.3}", rate(proportion))
}

/// The episodes until a rejection, of which `median` is over all rejected candidates.
pub fn episodes(summary: &Summary, median: u64) -> String {
    let measured = summary.median_to_reject_measured.map_or_else(
        || "none needed episodes".to_owned(),
        |median| format!("{median} among those that needed episodes at all"),
    );
    let early = rate(&summary.rejected_early);
    format!("median {median} of {} episodes; {measured}; {early}", summary.budget)
}

/// The lost candidates under each profile.
pub fn lost(summaries: &[Summary]) -> String {
    let text = |summary: &Summary| {
        let Proportion { count, total, .. } = summary.benign_not_kept;
        format!("{} {count} of {total}", summary.profile)
    };
    summaries.iter().map(text).collect::<Vec<_>>().join(", ")
}
