//! Scripted operation: scenario files, JSON lines.
//!
//! The same engine as behind any other front end; what is here reads events and gives commands.

pub mod script;

mod driver;
mod printer;
mod runs;

pub use runs::{RunPlain, RunScript, RunStage, run_plain, run_script, run_stage};
