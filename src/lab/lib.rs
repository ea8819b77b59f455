//! The laboratory: measurements of the engine and its rules, and generated candidates.
//!
//! [`mod@bench`] times the engine and measures the error rates of its rules. [`experiment`] runs whole upgrades that
//! answer a question. [`truth`] measures the ground truth of candidates and scores decisions against it. [`pool`]
//! generates candidates for them. [`paper`] re-runs the paper's own evaluation. [`refine`] makes a candidate by
//! optimizing nominal success alone. Nothing that decides names any of these.

pub mod bench;
pub mod candidate_pool;
pub mod ground_truth;
pub mod paper_reproduction;
pub mod parameter_search;
pub mod pipeline_experiments;
pub mod same_code;
pub mod scripted_approver;

#[cfg(test)]
mod harm_cases;

#[cfg(test)]
mod sequence_cases;
