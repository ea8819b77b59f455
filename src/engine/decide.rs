//! Takes candidates through the stages, and writes what was decided.
//!
//! Owns the pipeline with its stages and its snapshot, the people who are asked, the operations of people, and what is
//! written to the record: decisions, alarms, stops. The rules in governance judge; this room gives them evidence, and writes
//! their decisions. Must not move the arm but through `live`, run an episode but through `trials`, or know a socket or a console.

pub(crate) mod alarms;
pub mod clock_mismatch;
pub mod evaluation_keys;
pub(crate) mod goal;
pub mod halt;
pub(crate) mod health;
pub(crate) mod operations;
pub(crate) mod paper_calls;
pub mod people;
pub mod pipeline;
pub mod recorder;
pub(crate) mod restart;
pub(crate) mod session_tally;
pub(crate) mod shift_note;
pub mod stages;
pub mod store_identity;
