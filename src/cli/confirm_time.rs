//! `holdpoint cell confirm-time`: a person confirms the machine's clock.

use clap::Args;

use super::context::CliContext;
use super::decide::{SigningArgs, identity};
use super::output::CommandOutput;
use super::verb_executor::VerbExecutor;
use crate::error::{CliError, Exit};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::Command;

/// The arguments of `confirm-time`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Approvals, escalations, freezes, reviews and shelved alarms end by the machine's clock. If the
clock was set while an engine ran, or is behind the newest record, nothing is activated until a
person confirms the time. Compare it with another clock first, and set it right if it is wrong.

Example:
  holdpoint cell confirm-time --as mara --reason 'the time service had lost its server; it agrees with my watch'")]
pub struct ConfirmTimeArgs {
    /// The time to confirm, with its zone [default: the machine's clock].
    #[arg(long, value_name = "TIME")]
    pub time: Option<WallTime>,
    /// The identity that confirms it, and how the person knows.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// Confirms the time.
pub(super) fn run(
    context: &CliContext,
    args: &ConfirmTimeArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let signature = &args.signature;
    // Only an identity of the store may let the engine continue.
    let who = identity(context, signature)?;
    let (by, reason) = (signature.identity.clone(), signature.reason.raw().to_owned());
    let mut executor = VerbExecutor::open(context)?;
    let snapshot = executor.snapshot()?;
    let clock_time = snapshot.clock_doubt.as_ref().map_or(snapshot.time, |doubt| doubt.said);
    if let Some(doubt) = snapshot.clock_doubt.filter(|_| !out.is_json()) {
        out.line(&format!("{}; it says {}", doubt.text, doubt.said))?;
    }
    let time = args.time.unwrap_or(clock_time);
    executor.execute_as(context, &who, Command::ConfirmTime { by, reason, time }, out)
}
