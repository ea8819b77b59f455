//! Recordings of upgrades: files in a folder, plain values, and the audit records about them.
//!
//! Knows neither the store nor the file format, which the scene crate writes and reads. It folds the audit records it
//! is given. [`viewer`] finds and starts the program that shows a recording.

pub mod audit_record;
pub mod episode_recording;
pub mod recording;
pub mod recording_folder;
pub mod viewer;
