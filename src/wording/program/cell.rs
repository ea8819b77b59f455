//! What `cell` prints: the endpoint of a served cell, the verdict about each promise, the times of an exchange.

use std::fmt::Display;

/// A cell that is served.
#[must_use]
pub fn listens(robot: impl Display, endpoint: impl Display) -> String {
    format!("the cell of {robot} listens at {endpoint}")
}

/// A promise that the cell keeps, or its problem.
#[must_use]
pub fn checked_promise(promise: &str, problem: Option<&str>) -> String {
    problem.map_or_else(|| format!("ok     {promise}"), |problem| format!("WRONG  {promise}: {problem}"))
}

/// The times of one exchange of a tick, us: the median, the 99th percentile and the longest; and the ones over a tick.
#[must_use]
pub fn exchange_times(
    ticks: impl Display,
    [p50_us, p99_us, max_us]: [impl Display; 3],
    overruns: impl Display,
) -> String {
    format!(
        "one exchange of a tick, of {ticks}: p50 {p50_us} us, p99 {p99_us} us, longest {max_us} us, {overruns} over a tick"
    )
}

/// The broken promises of all.
#[must_use]
pub fn broken_promises(broken: usize, all: usize) -> String {
    format!("{broken} of {all} promises are broken")
}
