//! Operation without a screen: scenario files, upgrades printed as they happen, the engine as a service.
//!
//! The same engine as behind any other front end; what is here reads events and gives commands.

pub mod script;

mod commands;
mod driver;
mod notify;
mod outcome;
mod plain;
mod printer;
mod runs;
mod service;

pub use plain::{PlainWork, RunPlain, run_plain};
pub use runs::{RunScript, RunStage, fresh_store, run_script, run_stage};
pub use service::{Service, serve};
