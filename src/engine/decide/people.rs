//! Approval requests and their answers.

pub mod approvals;
pub(crate) mod break_glass_approvals;
pub mod monitor_questions;
pub(crate) mod persons;
pub(crate) mod request_display;
pub(crate) mod signed_calls;
pub(crate) mod signers;
