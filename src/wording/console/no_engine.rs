//! The texts in place of the views while no engine runs.

pub const HAS_ENDED: &str = "It has ended";
pub const WHAT_WORKS: &str = "What works from here:";
pub const STOPS_ELSEWHERE: &str = "stops the arm; the running engine is asked, and its answer is shown";
pub const ASKS_ANY: &str = "asks any running engine of this store to stop the arm";

#[must_use]
pub fn ends_this_console(key: &str) -> String {
    format!("{key}: ends this console, with exit code 2; no other engine ends by it")
}

#[must_use]
pub fn in_a_shell(status: &str, stop: &str) -> String {
    format!("in a shell, {status} shows the state, and {stop} stops the arm as well")
}
