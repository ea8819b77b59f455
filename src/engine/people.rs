//! People: what they are asked and what they answer.

pub mod approvals;
pub(crate) mod emergencies;
pub mod questions;
pub(crate) mod signers;
