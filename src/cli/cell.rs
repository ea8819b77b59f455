//! `holdpoint cell goal | note | confirm-time`: what people tell the live cell.

use clap::{Args, Subcommand};

use super::confirm_time::ConfirmTimeArgs;
use super::decide::RequestedDecision;
use super::stop::{GoalArgs, NoteArgs};

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
}

impl CellVerb {
    /// The request to the engine.
    #[must_use]
    pub fn decision(&self) -> RequestedDecision {
        match self {
            Self::Goal(args) => RequestedDecision::Goal(args.clone()),
            Self::Note(args) => RequestedDecision::Note(args.clone()),
            Self::ConfirmTime(args) => RequestedDecision::ConfirmTime(args.clone()),
        }
    }
}
