//! The one place where sentences for people are made: from codes, findings and typed values.
//!
//! Rules and engine carry values, records keep them, and each front end asks here for the words. Nothing here decides, and
//! nothing reads a sentence back.

pub mod approval;
pub mod event;
mod finding;
mod harm;
pub mod live;
mod reason;

pub use finding::{finding, hard_stop};
pub use harm::{harm_comparison, harm_decider, sequence_measure};
pub use reason::{line, reason};

#[cfg(test)]
mod tests;
