//! Scripted operation: scenario files, JSON lines.
//!
//! The same engine as behind any other front end; what is here reads events and gives commands.

pub mod script;

mod drive;

pub use drive::{RunPlain, RunScript, run_plain, run_script};
