//! Takes candidates through the stages, and writes what was decided.
//!
//! Owns the pipeline with its stages, the people who are asked, the operations of people, the monitors, and the record:
//! versions, evidence, alarms, stops. The rules in governance judge; this room gives them evidence, and writes their
//! decisions. Must not move the arm but through `live`, run an episode but through `trials`, or know a socket or a console.

pub(crate) mod alarms;
pub mod check;
pub mod clock_mismatch;
pub mod context;
pub mod evaluation_keys;
pub(crate) mod evidence_binding;
pub mod evidence_file;
pub(crate) mod goal;
pub mod halt;
pub(crate) mod health;
pub mod monitors;
pub(crate) mod operations;
pub(crate) mod paper_calls;
pub mod people;
pub mod pipeline;
pub(crate) mod recorded_decision;
pub mod recorder;
pub(crate) mod restart;
pub(crate) mod shift_note;
pub mod stages;
pub mod store_identity;
pub mod store_robot;
pub mod version_concern;
pub(crate) mod version_origin;
pub mod version_table;
pub mod wall_clock;
