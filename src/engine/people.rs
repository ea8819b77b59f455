//! People: what they are asked and what they answer.

pub mod approvals;
pub(crate) mod asking;
pub(crate) mod emergencies;
pub(crate) mod persons;
pub mod questions;
pub(crate) mod signed_calls;
pub(crate) mod signers;
