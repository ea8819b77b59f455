//! `holdpoint cell goal | note | confirm-time | serve | check`: what people tell the live cell, and cells as processes.

use clap::{Args, Subcommand};

use super::cell_process::{self, CellCheckArgs, CellServeArgs};
use super::confirm_time::{self, ConfirmTimeArgs};
use super::output::CommandOutput;
use super::stop::{self, GoalArgs, NoteArgs};
use crate::cli::context::CliContext;
use crate::error::{CliError, Exit};

/// The arguments of `cell`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint cell goal align --as mara --reason 'the tray is being cleaned'
  holdpoint cell note --as mara --reason 'the tray was changed at six'")]
pub struct CellArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: CellVerb,
}

/// The verbs of `cell`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum CellVerb {
    /// Set the goal of the agent in the live cell.
    Goal(GoalArgs),
    /// Leave a note for the next shift.
    Note(NoteArgs),
    /// Confirm the machine's clock after a clock mismatch; until then nothing is activated.
    ConfirmTime(ConfirmTimeArgs),
    /// Offer the simulated cell to engines as a process of its own.
    Serve(CellServeArgs),
    /// Check a cell of another process against the cell protocol, promise by promise.
    Check(CellCheckArgs),
}

/// Runs the verb.
///
/// # Errors
/// As the verb.
pub fn run(context: &CliContext, args: &CellArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    match &args.verb {
        CellVerb::Goal(args) => stop::goal(context, args, out),
        CellVerb::Note(args) => stop::note(context, args, out),
        CellVerb::ConfirmTime(args) => confirm_time::run(context, args, out),
        CellVerb::Serve(args) => cell_process::serve(args, out),
        CellVerb::Check(args) => cell_process::check(args, out),
    }
}
