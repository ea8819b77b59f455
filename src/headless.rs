//! Operation without a screen: scenario files, upgrades printed as they happen, the engine as a service.
//!
//! The same engine as behind every other front end; this module reads events and sends commands.

pub mod script;
pub mod scripted_approver;

mod commands;
mod driver;
mod exit_status;
mod notify;
mod printer;
mod scenario_run;
mod service;
mod stage_stream;

pub(crate) use scenario_run::cell;
pub use scenario_run::{RunScript, RunStage, fresh_store, run_script, run_stage};
pub use service::{ServiceSetup, serve};
pub use stage_stream::{PlainWork, RunPlain, run_plain};
