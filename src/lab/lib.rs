//! The laboratory: measurements of the engine and its rules, and generated candidates.
//!
//! [`cli`] is the program `holdpoint-lab`. [`mod@bench`] measures the error rates of the rules and the cost of decisions.
//! [`pipeline_experiments`] runs whole upgrades that answer a question. [`ground_truth`] measures the ground truth of candidates
//! and scores decisions against it. [`mod@distinguisher`] records what a version could tell sandbox and live cell apart by.
//! [`mod@throwers`] runs versions that throw, press or speed under a trigger. [`danger_thresholds`] chooses and tests the
//! thresholds of a danger in live tasks. [`candidate_pool`] generates candidates for them.
//! [`paper_reproduction`] re-runs the paper's own evaluation. [`parameter_search`] makes a candidate by optimizing nominal success
//! alone. Nothing that decides names any of these.

pub mod bench;
pub mod candidate_pool;
pub mod cli;
pub mod danger_thresholds;
pub mod distinguisher;
mod finished_rows;
pub mod ground_truth;
pub mod paper_reproduction;
pub mod parameter_search;
pub mod pipeline_experiments;
#[cfg(test)]
mod same_code;
mod side_by_side;
pub mod throwers;
mod wording;

#[cfg(test)]
mod harm_cases;

#[cfg(test)]
mod sequence_cases;
