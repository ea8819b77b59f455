//! The verb by which a person confirms what the machine's clock says.

use clap::Args;

use super::context::CliContext;
use super::decide::{SigningArgs, identity};
use super::output::Output;
use super::side::Side;
use crate::error::{CliError, Exit};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::Command;

/// The arguments of `confirm-time`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Approvals, questions, freezes, reviews and shelves end by the machine's clock. Where it was set while
an engine ran, or is behind the newest record, nothing is activated before a person confirms the time.
Hold it against another clock first; set it right if it is wrong, and confirm it then.

Example:
  holdpoint confirm-time --as mara --reason 'the time service had lost its server; it agrees with my watch'")]
pub struct ConfirmTimeArgs {
    /// The time that is confirmed, with its zone; what the machine's clock says, if it is not given.
    #[arg(long, value_name = "TIME")]
    pub time: Option<WallTime>,
    /// Who confirms it, and how they know.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// Confirms the time.
pub(super) fn run(
    context: &CliContext,
    args: &ConfirmTimeArgs,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    let signature = &args.signature;
    // Going on needs somebody who can be named for it.
    let who = identity(context, signature)?;
    let (by, reason) = (signature.identity.clone(), signature.reason.raw().to_owned());
    let mut side = Side::open(context)?;
    let snapshot = side.snapshot()?;
    let said = snapshot.clock_doubt.as_ref().map_or(snapshot.time, |doubt| doubt.said);
    if let Some(doubt) = snapshot.clock_doubt.filter(|_| !out.is_json()) {
        out.line(&format!("{}; it says {}", doubt.text, doubt.said))?;
    }
    let time = args.time.unwrap_or(said);
    side.carry_out_as(context, &who, Command::ConfirmTime { by, reason, time }, out)
}
