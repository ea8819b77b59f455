//! The one place where sentences for people are made: from codes, findings, notices and typed values.
//!
//! Rules and engine carry values, records keep them, and each front end asks here for the words. Nothing here decides, and
//! nothing reads a sentence back.

pub mod alarm;
pub mod approval;
pub mod check;
mod clock;
pub mod command_effect;
mod condition;
pub mod console;
mod count;
mod counted_try;
pub mod coverage;
pub mod event;
pub mod explanation;
pub mod explanation_summary;
pub mod film;
mod finding;
mod harm;
pub mod health;
pub mod live;
pub mod lookup;
mod notice;
mod past_limit;
mod policy_hit;
pub mod program;
mod reason;
pub mod request;
pub mod scene;
pub mod seeds;
pub mod stage;
mod task_failure;
mod twin;
pub mod version_diff;
mod version_status;

pub use clock::{clock_mismatch, record_time};
pub use condition::condition_of_use;
pub use count::counted;
pub use counted_try::counted_try;
pub use finding::{finding, hard_stop};
pub use harm::{harm_comparison, harm_decider, sequence_measure};
pub use notice::{admission_refusal, coded, notice, notice_sentence, operator_act, stop_after_unclean_end};
pub use reason::{line, measured_and_limit, reason};
pub use task_failure::failure_cause;
pub use version_status::{status_cause, status_end, version_status};

#[cfg(test)]
mod tests;
