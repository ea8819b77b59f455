//! `holdpoint stop | start`, `holdpoint cell goal | note`: stops the cell at any time, starts it again, and sets its goal.
//!
//! A stop needs no identity, no key and no reason. A start needs an identity of the store and a reason.

use clap::Args;

use super::decide::{REASON_BYTES_MAX, SigningArgs, identity, parse_identity};
use super::verb_executor::{VerbExecutor, print_action_reply};
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::clock::clock_time;
use holdpoint_protocol::command::{Command, Reply, StopPersistence};
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_service::control_socket::{NOT_CONFIRMED_HINT, StopCall, StopOutcome, not_confirmed};
use holdpoint_store::Layout;
use holdpoint_text::{ErrorReason, Untrusted};
use holdpoint_wording::program::engine::stopped_by_mark;
use holdpoint_wording::program::run as sentences;
use holdpoint_wording::program::status::{after_record, stopped_by};

/// The arguments of `stop`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The arm stops in the current tick and stays stopped until `holdpoint start`, even after a restart
of the engine. This is not a certified emergency stop.

Exit code 0 means that the process that has the store confirmed the stop. With 6 the stop is not
confirmed: press the emergency stop of the cell.

Examples:
  holdpoint stop
  holdpoint stop --as mara --reason 'a person is in the cell'")]
pub struct StopArgs {
    /// The name of the person who stops; optional, any name is accepted.
    #[arg(long = "as", value_name = "NAME", value_parser = parse_identity)]
    pub who: Option<String>,
    /// The reason; stored in the audit log.
    #[arg(long, value_name = "TEXT", value_parser = parse_why)]
    pub reason: Option<Untrusted>,
}

/// The arguments of `start`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Before you start the cell you must know of every stop. Under `sim`, a single stop of your own
needs no --stops. Otherwise the verb prints persons and reasons; give their number with --stops.
A later stop keeps the cell stopped.

Examples:
  holdpoint start --as mara --reason 'the cell is empty, the fence is closed'
  holdpoint start --as mara --stops 1 --reason 'the operator of the night is out of the cell'
  holdpoint start --as mara --stops 2 --reason 'both are out of the cell'")]
pub struct StartArgs {
    /// The number of stops that you know of; required unless, under `sim`, the only stop is yours.
    #[arg(long, value_name = "N")]
    pub stops: Option<u64>,
    /// The identity that starts the cell, and its reason.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `cell goal`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
A goal is pick-align-place, or the last primitive to run: grasp, align, place. It applies from
the next sequence on, even after a restart of the engine. A candidate of a family outside the
goal gets no task in shadow.

Examples:
  holdpoint cell goal align --as mara --reason 'the tray is being cleaned'
  holdpoint cell goal pick-align-place --as mara --reason 'the tray is back'")]
pub struct GoalArgs {
    /// The goal of the agent.
    pub goal: String,
    /// The identity that sets it, and its reason.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `cell note`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The reason is the note: it is stored in the audit log, shown in the log and marked in `health`.

Example:
  holdpoint cell note --as mara --reason 'the tray was changed at six; first blocks stuck'")]
pub struct NoteArgs {
    /// The author's identity, and the text.
    #[command(flatten)]
    pub signature: SigningArgs,
}

pub(super) fn parse_why(text: &str) -> Result<Untrusted, String> {
    if text.len() > REASON_BYTES_MAX {
        return Err(format!("{} bytes are too many; up to {REASON_BYTES_MAX} are allowed", text.len()));
    }
    Ok(text.into())
}

/// Stops the cell without any check before. Only the answer of the process that has the store counts.
pub(super) fn stop(
    context: &CliContext,
    args: &StopArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let by = args.who.clone().unwrap_or_default();
    let reason = args.reason.as_ref().map_or_else(String::new, |reason| reason.raw().to_owned());
    let call = StopCall::new(by, reason).map_err(CliError::internal)?;
    let layout = Layout::new(&context.data);
    let mut outcome = call.send(&layout);
    if matches!(outcome, StopOutcome::NoEngine) {
        if !layout.database().exists() {
            call.withdraw(&layout);
            return Err(no_engine(context, "there is no store either"));
        }
        match VerbExecutor::own(context) {
            Ok(mut executor) => {
                let text = match executor.send_request(call.request()) {
                    Ok(Reply::Stopped { kept, .. }) if kept != StopPersistence::InMemory => {
                        "the next engine there starts stopped".to_owned()
                    }
                    Ok(_) => "the stop could not be stored".to_owned(),
                    Err(error) => format!("the stop could not be stored: {error}"),
                };
                return Err(no_engine(context, &text));
            }
            // An engine may have started meanwhile; it reads the mark.
            Err(error) => match call.send(&layout) {
                StopOutcome::NoEngine => return Err(no_engine(context, &error.to_string())),
                other => outcome = other,
            },
        }
    }
    match outcome {
        StopOutcome::Answered(reply) => print_action_reply(&reply, out),
        StopOutcome::Marked(instead) => print_action_reply(
            &Reply::Stopped { text: stopped_by_mark(&instead), kept: StopPersistence::InMark },
            out,
        ),
        StopOutcome::NoEngine => Err(CliError::internal("no engine, and none could be opened")),
        StopOutcome::NotConfirmed(why) => {
            Err(CliError::not_confirmed(not_confirmed(&why)).with_hint(NOT_CONFIRMED_HINT))
        }
    }
}

/// The named folder is not that of the cell's engine, or its engine is gone: no arm was stopped.
fn no_engine(context: &CliContext, and: &str) -> CliError {
    let text = format!("no engine runs on {:?}, so no arm was stopped; {and}", context.data);
    CliError::not_confirmed(text)
        .with_hint(
            "press the emergency stop of the cell; if its engine uses another folder, run `holdpoint stop --data DIR`",
        )
        .with_details(ErrorReason::NoAnswer)
}

/// A stop's time for people: that of its record, or without one the engine's. Without an engine, one that only a mark keeps
/// came after the newest record.
pub(super) fn stop_moment(
    (at_ms, wall): (u64, Option<WallTime>),
    engine: Option<&Snapshot>,
    newest: Option<(u64, WallTime)>,
) -> String {
    match (wall, engine, newest) {
        (Some(time), ..) => time.label(),
        (None, Some(engine), _) => engine.moment(at_ms),
        (None, None, Some((newest_ms, time))) if newest_ms == at_ms => after_record(&time.label()),
        (None, None, _) => clock_time(at_ms),
    }
}

/// Starts the stopped cell.
pub(super) fn start(
    context: &CliContext,
    args: &StartArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let signature = &args.signature;
    // Only an identity of the store may start the cell.
    let who = identity(context, signature)?;
    let by = signature.identity.clone();
    let reason = signature.reason.raw().to_owned();
    let mut executor = VerbExecutor::open(context)?;
    let snapshot = executor.snapshot()?;
    let stopped = snapshot.stopped.clone();
    // A stop accepts any name, so under `human` the start must state the number of known stops.
    let is_own = stopped.as_ref().is_some_and(|stopped| stopped.stops == 1 && stopped.by == by)
        && snapshot.profile == ProfileName::Sim;
    let stops = args.stops.unwrap_or(u64::from(is_own));
    if !out.is_json() {
        if let Some(stopped) = &stopped {
            let moment = |at_ms, wall| stop_moment((at_ms, wall), Some(&snapshot), None);
            out.line(&stopped_by(stopped, &moment))?;
        }
        for prompt in snapshot.prompts.iter().filter(|prompt| prompt.granted) {
            out.line(&sentences::takes_control(&prompt.version))?;
        }
    }
    // The engine refuses if another stop arrives after this check.
    let since_ms = stopped.map_or(0, |stopped| stopped.since_ms);
    let exit = executor.execute_as(context, &who, Command::Go { by, reason, since_ms, stops }, out)?;
    if executor.is_own() && !out.is_json() {
        out.line(sentences::START_WAITS)?;
    }
    Ok(exit)
}

/// Leaves a note for the next shift.
pub(super) fn note(
    context: &CliContext,
    args: &NoteArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let signature = &args.signature;
    let who = identity(context, signature)?;
    let (by, text) = (signature.identity.clone(), signature.reason.raw().to_owned());
    VerbExecutor::open(context)?.execute_as(context, &who, Command::Note { by, text }, out)
}

/// Sets the goal of the agent in the live cell.
pub(super) fn goal(
    context: &CliContext,
    args: &GoalArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let signature = &args.signature;
    let who = identity(context, signature)?;
    let (by, reason) = (signature.identity.clone(), signature.reason.raw().to_owned());
    let command = Command::Goal { goal: args.goal.clone(), by, reason };
    VerbExecutor::open(context)?.execute_as(context, &who, command, out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_engine::decide::halt;
    use holdpoint_governance::record::RecordKind;
    use holdpoint_registry::Store;
    use holdpoint_store::{AuditBody, Transaction};

    /// Without an engine a stop came with the engine's time, `00:00:17`, which reads as a time of day.
    #[test]
    fn stops_on_record_have_the_wall_time_of_their_records() {
        let folder = tempfile::tempdir().unwrap();
        let stop = |name: &str, records: &[(RecordKind, u64, i64)]| {
            let store = Store::open(folder.path().join(name)).unwrap();
            for &(kind, at_ms, wall_ms) in records {
                let record = AuditBody { kind, subject: String::new(), body: "{}".to_owned() };
                let command_id = format!("command at {at_ms}");
                let (changes, audit) = (Vec::new(), vec![record]);
                store.commit(Transaction { command_id, at_ms, wall_ms, changes, audit }).unwrap();
            }
            let stopped = halt::recall(&store.views().unwrap()).unwrap().unwrap();
            (stopped.since_ms, stopped.wall)
        };
        let wall = |secs: i64| WallTime::from_ms(1_795_501_000_000 + secs * 1_000);
        let stopped = RecordKind::CellStopped;
        // A script's stop has virtual time alone.
        let of_script = stop("script", &[(stopped, 18_000, 0)]);
        assert_eq!(stop_moment(of_script, None, None), clock_time(18_000));
        let on_record = stop(
            "cell",
            &[
                (stopped, 5_000, wall(5).ms()),
                (RecordKind::CellReleased, 6_000, wall(6).ms()),
                (stopped, 17_000, wall(900).ms()),
            ],
        );
        assert_eq!(on_record, (17_000, Some(wall(900))));
        assert_eq!(stop_moment(on_record, None, None), wall(900).label());
        // That of a mark comes after the newest record.
        let of_mark = stop_moment((19_000, None), None, Some((19_000, wall(950))));
        assert_eq!(of_mark, after_record(&wall(950).label()));
    }
}
