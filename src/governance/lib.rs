//! The rules: pure functions over plain data. No I/O, no clock, no randomness, no async.
//!
//! Texts and values come in, decisions with their reasons go out; whoever calls opens the files,
//! measures the episodes and keeps the time.

pub mod alarms;
pub mod approval;
pub mod behavior;
pub mod composition;
pub mod decision;
pub mod ended;
pub mod evidence;
pub mod exports;
pub mod gate;
pub mod ids;
pub mod interface;
pub mod lifecycle;
pub mod manifest;
pub mod metrics;
pub mod mode;
pub mod monitor;
pub mod outcome;
pub mod policy;
mod policy_table;
pub mod profile;
pub mod record;
pub mod recovery;
pub mod rollback;
pub mod stats;
pub mod submission;
pub mod text_error;
pub mod value_type;
pub mod vocabulary;
pub mod words;

pub use text_error::TextError;
