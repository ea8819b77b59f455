//! `holdpoint stop | go | goal`: stops the cell, at any time and without ceremony, lets it work again, and says what it
//! works towards.
//!
//! Stopping needs no identity, no key and no reason. Going on is a person's word: an identity of the store, and why.

use clap::Args;

use super::decide::{REASON_BYTES_MAX, SigningArgs, identity, parse_identity};
use super::side::{Side, told};
use super::status::report::stopped_line;
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_engine::door::{NOT_CONFIRMED_HINT, StopCall, StopOutcome, not_confirmed, stopped_by_mark};
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::{Command, Reply, StopKept};
use holdpoint_registry::Layout;
use holdpoint_text::Untrusted;

/// The arguments of `stop`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The arm is stopped in the tick that runs, whatever is under way, and stays stopped, over restarts
as well, until `holdpoint go`. This is no certified emergency stop.

Exit code 0 says that the process that has the store stopped it; 6 that nobody confirmed it: press
the emergency stop of the cell.

Examples:
  holdpoint stop
  holdpoint stop --as mara --reason 'somebody is in the cell'")]
pub struct StopArgs {
    /// Who stops it; any name will do, and none as well.
    #[arg(long = "as", value_name = "NAME", value_parser = parse_identity)]
    pub who: Option<String>,
    /// Why; goes into the audit log.
    #[arg(long, value_name = "TEXT", value_parser = parse_why)]
    pub reason: Option<Untrusted>,
}

/// The arguments of `go`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Whoever lets go has to know of every stop. One of your own is let go at once; of any other who did
and why is printed, and --stops says how many are known. A stop that comes meanwhile is not let go.

Examples:
  holdpoint go --as mara --reason 'the cell is empty, the fence is closed'
  holdpoint go --as mara --stops 1 --reason 'the operator of the night is out of the cell'
  holdpoint go --as mara --stops 2 --reason 'both are out of the cell'")]
pub struct GoArgs {
    /// How many stops of this standstill are known; needed where not one alone stopped it, of the same name.
    #[arg(long, value_name = "N")]
    pub stops: Option<u64>,
    /// Who answers for it, and why.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `goal`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
A goal is pick-align-place, or the last primitive to work: grasp, align, place. It holds from the
next sequence on, over restarts as well. A candidate of a family that the goal leaves out meets no
task in shadow.

Examples:
  holdpoint goal align --as mara --reason 'the tray is being cleaned'
  holdpoint goal pick-align-place --as mara --reason 'the tray is back'")]
pub struct GoalArgs {
    /// What the agent works towards.
    pub goal: String,
    /// Who sets it, and why.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `note`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The reason is the note: it stays on record, stands in the log and is a mark in `health`.

Example:
  holdpoint note --as mara --reason 'the tray was changed at six; first blocks stuck'")]
pub struct NoteArgs {
    /// Whose it is, and what it says.
    #[command(flatten)]
    pub signature: SigningArgs,
}

fn parse_why(text: &str) -> Result<Untrusted, String> {
    if text.len() > REASON_BYTES_MAX {
        return Err(format!("{} bytes are too many; up to {REASON_BYTES_MAX} are allowed", text.len()));
    }
    Ok(text.into())
}

/// Stops the cell. Nothing is looked up before; nothing counts but what the process says that has the store.
pub(super) fn stop(context: &CliContext, args: &StopArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let by = args.who.clone().unwrap_or_default();
    let reason = args.reason.as_ref().map_or_else(String::new, |reason| reason.raw().to_owned());
    let call = StopCall::new(by, reason).map_err(CliError::internal)?;
    let layout = Layout::new(&context.data);
    let mut outcome = call.ask(&layout);
    if matches!(outcome, StopOutcome::NoEngine) {
        if !layout.database().exists() {
            call.withdraw(&layout);
            return Err(no_engine(context, "there is no store either"));
        }
        match Side::own(context) {
            Ok(mut side) => {
                let kept = match side.ask_request(call.request()) {
                    Ok(Reply::Stopped { kept, .. }) if kept != StopKept::InMemory => {
                        "the next engine there comes up stopped".to_owned()
                    }
                    Ok(_) => "the stop could not be kept".to_owned(),
                    Err(error) => format!("the stop could not be kept: {error}"),
                };
                return Err(no_engine(context, &kept));
            }
            // One may have come up meanwhile; it takes the mark.
            Err(error) => match call.ask(&layout) {
                StopOutcome::NoEngine => return Err(no_engine(context, &error.to_string())),
                other => outcome = other,
            },
        }
    }
    match outcome {
        StopOutcome::Answered(reply) => told(&reply, out),
        StopOutcome::Marked(instead) => {
            told(&Reply::Stopped { text: stopped_by_mark(&instead), kept: StopKept::InMark }, out)
        }
        StopOutcome::NoEngine => Err(CliError::internal("no engine, and none could be opened")),
        StopOutcome::NotConfirmed(why) => {
            Err(CliError::not_confirmed(not_confirmed(&why)).with_hint(NOT_CONFIRMED_HINT))
        }
    }
}

/// Whoever names another folder than that of the cell's engine, or whose engine is gone, has stopped no arm.
fn no_engine(context: &CliContext, and: &str) -> CliError {
    let text = format!("no engine is at work on {:?}, so this stopped no arm; {and}", context.data);
    CliError::not_confirmed(text).with_hint(
        "press the emergency stop of the cell; if its engine works on another folder, name that: `holdpoint stop --data DIR`",
    )
}

/// Lets the stopped cell work again.
pub(super) fn go(context: &CliContext, args: &GoArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let signature = &args.signature;
    // Going on needs somebody who can be named for it.
    let who = identity(context, signature)?;
    let by = signature.identity.clone();
    let reason = signature.reason.raw().to_owned();
    let mut side = Side::open(context)?;
    let snapshot = side.snapshot()?;
    let stopped = snapshot.stopped;
    // Whoever stopped a cell says any name: near people the stops that are known are counted by whoever lets it go.
    let is_own = stopped.as_ref().is_some_and(|stopped| stopped.stops == 1 && stopped.by == by)
        && snapshot.profile == ProfileName::Sim;
    let stops = args.stops.unwrap_or(u64::from(is_own));
    if !out.is_json() {
        if let Some(stopped) = &stopped {
            out.line(&stopped_line(stopped))?;
        }
        for prompt in snapshot.prompts.iter().filter(|prompt| prompt.granted) {
            out.line(&format!("{} is approved and takes control once the cell works", prompt.version))?;
        }
    }
    // What comes after this look is not known, and the engine refuses.
    let since_ms = stopped.map_or(0, |stopped| stopped.since_ms);
    side.carry_out_as(context, &who, Command::Go { by, reason, since_ms, stops }, out)
}

/// Leaves a note for those who come after.
pub(super) fn note(context: &CliContext, args: &NoteArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let signature = &args.signature;
    let who = identity(context, signature)?;
    let (by, text) = (signature.identity.clone(), signature.reason.raw().to_owned());
    Side::open(context)?.carry_out_as(context, &who, Command::Note { by, text }, out)
}

/// Gives the agent of the live cell a goal.
pub(super) fn goal(context: &CliContext, args: &GoalArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let signature = &args.signature;
    let who = identity(context, signature)?;
    let (by, reason) = (signature.identity.clone(), signature.reason.raw().to_owned());
    let command = Command::Goal { goal: args.goal.clone(), by, reason };
    Side::open(context)?.carry_out_as(context, &who, command, out)
}
