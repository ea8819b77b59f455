//! The names of the figures of `bench`, and what one sample of a figure is.

pub const CANDIDATE_READ: &str = "candidate, read and hash";
pub const MEAN_OF_CANDIDATES: &str = "mean of 50 candidates";
pub const STATIC_CHECK: &str = "static check, policies compiled";
pub const MEAN_OF_CHECKS: &str = "mean of 50 checks";
pub const STATIC_CHECK_COLD: &str = "static check, policies compiled first";
pub const COMPILATION_AND_CHECK: &str = "compilation and check";
pub const MEAN_OF_DECISIONS: &str = "mean of 500 decisions";
pub const MONITOR: &str = "monitor, one episode";
pub const MEAN_OF_EPISODES: &str = "mean of 500 episodes";
pub const MEAN_OVER_TICKS: &str = "mean over an episode's ticks";
pub const TICK_GUARD_AND_HARM: &str = "tick, guard and harm";
pub const SEQUENCE_WITH_TWIN: &str = "live sequence with its twin";
pub const AUDIT_COMMIT: &str = "audit commit, on disk (synchronous=FULL)";

/// The check of the audit chain, per ten thousand records.
#[must_use]
pub fn audit_verification(records: u64) -> String {
    format!("audit verification of 10,000 records, on {records}")
}
