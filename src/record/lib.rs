//! What is on record of the versions of a store, for the engine that decides about them and for explanations.
//!
//! Owns the version table, which alone changes a state; the evidence files with their rationale; the context, the terms and
//! the bindings of decisions; the check of a version without a run; and the bodies of records that several parts read.
//! Decides nothing. Must not run an episode, know a stage or an approval request, or name an engine.

pub mod caller;
pub mod check;
pub mod clock_mismatch;
pub mod context;
pub mod difference;
pub mod evidence_binding;
pub mod evidence_file;
pub mod evidence_view;
pub mod live_task_record;
pub mod persisted_clock;
pub mod rationale;
pub mod recorded_decision;
pub mod shift_note;
pub mod store_robot;
pub mod untested;
pub mod version_concern;
pub mod version_origin;
pub mod version_table;
pub mod wall_clock;

/// The longest reason that a person gives, and the longest name of a person, bytes.
pub const REASON_BYTES_MAX: usize = 4096;
