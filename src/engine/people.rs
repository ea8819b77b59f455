//! People: what they are asked and what they answer.

pub mod approvals;
pub mod questions;
