//! Recordings of upgrades: files in a folder, plain values, and what the audit chain says of them.
//!
//! Knows neither the format of the files (that is the scene crate's, which writes and reads them) nor the store: it
//! folds the audit records it is given. [`viewer`] finds and starts the program that shows a recording.

pub mod film;
pub mod folder;
pub mod record;
pub mod recording;
pub mod viewer;
