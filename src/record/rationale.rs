//! Why an evaluation came out as it did, from its evidence file: recorded with decisions, shown to approvers, and explained.
//!
//! Owns the sentences about checks, the episodes that show them, and what would have to change. Judges nothing.

pub mod check_explanation;
pub mod episode_selection;
pub mod lenient_bodies;
pub mod remedy;
