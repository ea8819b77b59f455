//! `holdpoint approve | reject | rollback | demote | pause | resume`, what leads on from there (`onward.rs`), and what
//! `stop | go` come to.
//!
//! Approvals and refusals of what waits are signed with the identity's key; the verbs that stop something name who
//! asked and need no key, because stopping must never be harder than going on. The engine re-validates every one of
//! these and may refuse it; nothing here confers a right.

mod onward;
mod shown;

use std::path::PathBuf;

use clap::Args;

pub use onward::{BreakGlassArgs, DemoteArgs, ReleaseArgs, RepeatArgs};

use super::confirm_time::{self, ConfirmTimeArgs};
use super::data;
use super::passphrase;
use super::side::{Side, known_engine, running, told};
use super::stop::{self, GoArgs, GoalArgs, NoteArgs, StopArgs};
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_approvals::keyfile::Protection;
use holdpoint_approvals::{BoundFacts, Identity, KeptIdentity};
use holdpoint_governance::approval::Answer;
use holdpoint_governance::ids::{CapabilityId, Family, is_name};
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::{Command, Operation, Refusal, Reply};
use holdpoint_protocol::question::live_lines;
use holdpoint_protocol::snapshot::{PromptView, Purpose, Snapshot};
use holdpoint_registry::Views;
use holdpoint_text::{Untrusted, is_visible};

/// The longest reason, in bytes.
pub const REASON_BYTES_MAX: usize = 1_000;

/// What the help of verbs that take authority away says of who asks: nobody must look for an identity first.
pub(super) const ANY_NAME: &str = "Who asks for it; it takes authority away, so any name will do";

/// One decision that was asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AskedDecision {
    /// To approve a candidate that waits for approval.
    Approve(ApproveArgs),
    /// To reject a candidate for good.
    Reject(VersionArgs),
    /// To take a family's active version off.
    Rollback(FamilyArgs),
    /// To send a version back to evaluation, or to close profiles to it.
    Demote(DemoteArgs),
    /// To take up no further stage.
    Pause(PauseArgs),
    /// To take up stages again.
    Resume(PauseArgs),
    /// To stop the cell.
    Stop(StopArgs),
    /// To let the stopped cell work again.
    Go(GoArgs),
    /// To give the agent a goal.
    Goal(GoalArgs),
    /// To confirm the time.
    ConfirmTime(ConfirmTimeArgs),
    /// To leave a note.
    Note(NoteArgs),
    /// To evaluate a version again.
    Repeat(RepeatArgs),
    /// To lift a restriction, or to open a profile again.
    Release(ReleaseArgs),
    /// To tighten the envelope of an active version.
    Restrict(VersionArgs),
    /// To answer a monitor's question with "go on".
    Continue(VersionArgs),
    /// To let a version in alone, in an emergency.
    BreakGlass(BreakGlassArgs),
    /// To make a superseded version of a stopped family active again.
    Rearm(VersionArgs),
}

/// Who decides, and why.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct SigningArgs {
    /// The identity that answers for it and signs (see `holdpoint identity`).
    #[arg(long = "as", value_name = "IDENTITY", value_parser = parse_identity)]
    pub identity: String,
    /// Why; goes into the audit log.
    #[arg(long, value_name = "TEXT", value_parser = parse_reason)]
    pub reason: Untrusted,
    /// Takes the passphrase of the identity's key from this file (mode 0600) and not from the terminal. The variable
    /// `HOLDPOINT_PASSPHRASE_FILE` names one as well.
    #[arg(long, value_name = "FILE")]
    pub passphrase_file: Option<PathBuf>,
}

/// The arguments of `approve`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The short digest binds the approval to the evidence you have read;
`holdpoint status` prints it. The profile `human` demands it.

Example:
  holdpoint approve grasp@1.3.0 --digest 9f3c2a10 --as mara --reason 'drills and shadow read'")]
pub struct ApproveArgs {
    /// The candidate, e.g. grasp@1.3.0.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// The first eight digits of the evidence digest that was read.
    #[arg(long, value_name = "DIGITS", value_parser = parse_short_digest)]
    pub digest: Option<String>,
    /// Who signs, and the reason that is kept.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of the verbs about one version.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint reject grasp@1.3.0 --as mara --reason 'grip force too high for this part'
  holdpoint restrict grasp@1.3.0 --as mara --reason 'a visitor is in the hall'
  holdpoint continue grasp@1.3.0 --as mara --reason 'the link is known to be slow'
  holdpoint rearm grasp@1.0.0 --as mara --reason 'the gripper is mended'")]
pub struct VersionArgs {
    /// The version, e.g. grasp@1.3.0.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// Who signs, and the reason that is kept.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `rollback`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Where nobody would take over, the verb changes nothing and says so;
--stop-family takes the last version off all the same.

Example:
  holdpoint rollback grasp --as mara --reason 'drops parts since noon'")]
pub struct FamilyArgs {
    /// The family, e.g. grasp.
    #[arg(value_parser = parse_family)]
    pub family: Family,
    /// Takes the last version off too: no version of the family acts until somebody re-arms it.
    #[arg(long)]
    pub stop_family: bool,
    /// Who signs, and the reason that is kept.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `pause` and `resume`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint pause --as mara --reason 'maintenance'
  holdpoint resume grasp --as mara --reason 'maintenance done'")]
pub struct PauseArgs {
    /// One family; all if none is named. What is registered later is not paused.
    #[arg(value_parser = parse_family)]
    pub family: Option<Family>,
    /// Who signs, and the reason that is kept.
    #[command(flatten)]
    pub signature: SigningArgs,
}

pub(super) fn parse_family(text: &str) -> Result<Family, String> {
    Family::new(text).map_err(|error| error.to_string())
}

pub(super) fn parse_identity(text: &str) -> Result<String, String> {
    if is_name(text) {
        Ok(text.to_owned())
    } else {
        Err("1 to 64 characters of a-z, 0-9, '.', '_' and '-' are allowed".to_owned())
    }
}

pub(super) fn parse_reason(text: &str) -> Result<Untrusted, String> {
    if !is_visible(text) {
        return Err("a reason is needed, of characters that can be seen".to_owned());
    }
    if text.len() > REASON_BYTES_MAX {
        return Err(format!("{} bytes are too many; up to {REASON_BYTES_MAX} are allowed", text.len()));
    }
    Ok(text.into())
}

fn parse_short_digest(text: &str) -> Result<String, String> {
    if text.len() == 8 && text.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte)) {
        Ok(text.to_owned())
    } else {
        Err("eight hexadecimal digits (0-9, a-f) are needed".to_owned())
    }
}

/// Does what was asked for.
///
/// # Errors
/// [`CliError`]; nothing has changed then.
pub(super) fn run(
    context: &CliContext,
    asked: &AskedDecision,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    // What does not exist is said before an engine is opened, so that the store stays as it was.
    let views = || data::open(&context.data);
    match asked {
        AskedDecision::Approve(args) => approve(context, &views()?, args, out),
        AskedDecision::Reject(args) => reject(context, &views()?, args, out),
        AskedDecision::Rollback(args) => rollback(context, &views()?, args, out),
        AskedDecision::Demote(args) => {
            known_version(&views()?, &args.version)?;
            let operation = operation(&args.version, &args.signature);
            let profiles = args.profile.clone();
            Side::open(context)?.carry_out(Command::Demote { operation, profiles }, out)
        }
        AskedDecision::Repeat(args) => onward::repeat(context, &views()?, args, out),
        AskedDecision::Release(args) => onward::release(context, &views()?, args, out),
        AskedDecision::Restrict(args) => onward::restrict(context, &views()?, args, out),
        AskedDecision::Continue(args) => onward::go_on(context, &views()?, args, out),
        AskedDecision::BreakGlass(args) => onward::break_glass(context, &views()?, args, out),
        AskedDecision::Rearm(args) => onward::rearm(context, &views()?, args, out),
        AskedDecision::Pause(args) => pause(context, &views()?, args, Pausing::Pause, out),
        AskedDecision::Resume(args) => {
            // Going on needs somebody who can be named for it.
            let who = identity(context, &args.signature)?;
            pause(context, &views()?, args, Pausing::Resume(&who), out)
        }
        AskedDecision::Stop(args) => stop::stop(context, args, out),
        AskedDecision::Go(args) => stop::go(context, args, out),
        AskedDecision::Goal(args) => stop::goal(context, args, out),
        AskedDecision::ConfirmTime(args) => confirm_time::run(context, args, out),
        AskedDecision::Note(args) => stop::note(context, args, out),
    }
}

fn approve(
    context: &CliContext,
    views: &Views,
    args: &ApproveArgs,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    known_version(views, &args.version)?;
    let who = passphrase::kept(context, &args.signature.identity)?;
    let Some(client) = running(context)? else {
        let text = "held: no engine is running on this store, so nothing waits for an approval";
        return Err(CliError::held(text)
            .with_hint("start one with `holdpoint run`; it asks again on the evidence as stored"));
    };
    let mut side = Side::Running(client);
    let snapshot = side.snapshot()?;
    let Some(prompt) = open_prompt(&snapshot, &args.version) else {
        let text = format!("held: nothing waits for a decision on {}", args.version);
        return Err(CliError::held(text).with_hint(format!("see `holdpoint status {}`", args.version)));
    };
    if prompt.purpose == Purpose::Emergency {
        let text = format!("held: one person would let {} in by the emergency door", args.version);
        return Err(
            CliError::held(text).with_hint("`holdpoint break-glass` is for that, and nothing else is")
        );
    }
    let (question, bound) = side.question(prompt, &who.info().name)?;
    check_digest(args.digest.as_deref(), &bound)?;
    shown::told(&question.lines, &live_lines(prompt, &snapshot), out)?;
    let who = passphrase::unlock(who, args.signature.passphrase_file.as_deref())?;
    let command = question.answer(&who, Answer::Approve, args.signature.reason.raw());
    side.carry_out(command.map_err(CliError::internal)?, out)?;
    // An approval that is not enough, or does not count, leaves the version held. One that is waits for a sequence at
    // most.
    let waits = open_prompt(&side.snapshot()?, &args.version).is_some_and(|prompt| !prompt.granted);
    Ok(if waits { Exit::Held } else { Exit::Confirmed })
}

/// The approval is bound to the evidence that was read, if it was named; a profile with people nearby asks for it.
fn check_digest(given: Option<&str>, asked: &BoundFacts) -> Result<(), CliError> {
    let waits = asked.evidence.short();
    match given {
        Some(given) if given == waits => Ok(()),
        Some(given) => {
            let text = format!("held: {} waits with the evidence {waits}, not {given}", asked.version);
            Err(CliError::held(text).with_hint("read it again, then approve that"))
        }
        None if asked.profile == ProfileName::Human => {
            let text =
                format!("the profile {:?} needs --digest with the evidence that was read", asked.profile);
            Err(CliError::usage(text).with_hint("`holdpoint status` shows it"))
        }
        None => Ok(()),
    }
}

fn reject(
    context: &CliContext,
    views: &Views,
    args: &VersionArgs,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    known_version(views, &args.version)?;
    let mut side = Side::open(context)?;
    let snapshot = side.snapshot()?;
    let signature = &args.signature;
    let who = passphrase::kept(context, &signature.identity).ok();
    if let (Some(prompt), Some(who)) = (open_prompt(&snapshot, &args.version), who) {
        // Stopping must never be harder than going on: whose passphrase cannot be asked for, or whose key nobody
        // enrolled, rejects by name.
        let can_ask = who.protection() != Protection::Passphrase
            || passphrase::can_ask(signature.passphrase_file.as_deref());
        if can_ask {
            let enrolled = views.persons().map_err(CliError::usage)?;
            let signs = enrolled.enrolled().any(|person| person.info() == *who.info());
            if signs {
                return refuse(&mut side, prompt, &snapshot, (who, signature), out);
            }
        }
    }
    side.carry_out(Command::Reject(operation(&args.version, &args.signature)), out)
}

/// Refuses over what is shown of the question. Where it cannot be had, or is another one meanwhile, the refusal is signed
/// over nothing that was shown: it counts all the same.
fn refuse(
    side: &mut Side,
    prompt: &PromptView,
    snapshot: &Snapshot,
    (who, signature): (KeptIdentity, &SigningArgs),
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    let question = side.question(prompt, &who.info().name).ok();
    if let Some((question, _)) = &question {
        shown::told(&question.lines, &live_lines(prompt, snapshot), out)?;
    }
    let who = passphrase::unlock(who, signature.passphrase_file.as_deref())?;
    let reason = signature.reason.raw();
    if let Some((question, _)) = question {
        let command = question.answer(&who, Answer::Reject, reason).map_err(CliError::internal)?;
        let reply = side.ask(command)?;
        if !matches!(reply, Reply::Refused { code: Refusal::Stale, .. }) {
            return told(&reply, out);
        }
    }
    side.carry_out(prompt.refuse(&who, reason).map_err(CliError::internal)?, out)
}

fn rollback(
    context: &CliContext,
    views: &Views,
    args: &FamilyArgs,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    known_family(views, &args.family)?;
    let mut side = Side::open(context)?;
    let snapshot = side.snapshot()?;
    let family = snapshot.families.iter().find(|view| view.family == args.family);
    let Some(active) = family.and_then(|view| view.active.clone()) else {
        return Err(CliError::held(format!("held: {} is safe-stopped, no version is active", args.family)));
    };
    let operation = operation(&active, &args.signature);
    let command = if args.stop_family { Command::Vacate(operation) } else { Command::Rollback(operation) };
    let exit = side.carry_out(command, out)?;
    let family = side.snapshot()?.families.into_iter().find(|view| view.family == args.family);
    if family.is_none_or(|view| view.active.is_none()) {
        // Taken off, and nobody took over: that is a stop, not a rollback.
        return Err(CliError::held(format!("held: safe-stopped, no version of {} is active", args.family)));
    }
    Ok(exit)
}

#[derive(Clone, Copy)]
enum Pausing<'a> {
    Pause,
    /// And who answers for it.
    Resume(&'a Identity),
}

/// Pauses what is on its way, or resumes what is paused: of one family, or of all.
fn pause(
    context: &CliContext,
    views: &Views,
    args: &PauseArgs,
    pausing: Pausing<'_>,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    if let Some(family) = &args.family {
        known_family(views, family)?;
    }
    let mut side = Side::open(context)?;
    let fits = |view: &&holdpoint_protocol::snapshot::CandidateView| {
        let of_family = args.family.as_ref().is_none_or(|family| view.version.family == *family);
        let stands = match pausing {
            Pausing::Pause => view.state.may_pause(&view.flags),
            Pausing::Resume(_) => view.state.may_resume(&view.flags, view.held),
        };
        of_family && stands
    };
    let versions: Vec<CapabilityId> =
        side.snapshot()?.candidates.iter().filter(fits).map(|view| view.version.clone()).collect();
    if versions.is_empty() {
        let of = args.family.as_ref().map_or_else(String::new, |family| format!(" of {family}"));
        return Err(CliError::held(match pausing {
            Pausing::Pause => format!("nothing was paused: no version{of} is on its way"),
            Pausing::Resume(_) => format!("nothing was resumed: no version{of} is paused or held"),
        }));
    }
    for version in versions {
        let operation = operation(&version, &args.signature);
        match pausing {
            Pausing::Pause => side.carry_out(Command::Pause(operation), out)?,
            Pausing::Resume(who) => side.carry_out_as(context, who, Command::Resume(operation), out)?,
        };
    }
    Ok(Exit::Confirmed)
}

/// Somebody of the store, whose key opens, for something that is asked of the engine.
pub(super) fn identity(context: &CliContext, signature: &SigningArgs) -> Result<Identity, CliError> {
    known_engine(context)?;
    let kept = passphrase::kept(context, &signature.identity)?;
    passphrase::unlock(kept, signature.passphrase_file.as_deref())
}

fn operation(version: &CapabilityId, signature: &SigningArgs) -> Operation {
    Operation {
        version: version.clone(),
        by: signature.identity.clone(),
        reason: signature.reason.raw().to_owned(),
    }
}

fn open_prompt<'a>(snapshot: &'a Snapshot, version: &CapabilityId) -> Option<&'a PromptView> {
    snapshot.prompts.iter().find(|prompt| prompt.version == *version)
}

pub(super) fn known_version(views: &Views, version: &CapabilityId) -> Result<(), CliError> {
    if views.version(version).map_err(CliError::usage)?.is_some() {
        return Ok(());
    }
    let text = format!("there is no version {:?} in the store", version.to_string());
    Err(CliError::usage(text).with_hint("`holdpoint registry list` names all"))
}

pub(super) fn known_family(views: &Views, family: &Family) -> Result<(), CliError> {
    let families = views.families().map_err(CliError::usage)?;
    if families.iter().any(|known| known.name == family.as_str()) {
        return Ok(());
    }
    let names: Vec<&str> = families.iter().map(|known| known.name.as_str()).collect();
    Err(CliError::usage(format!("there is no family {:?}; there are {}", family.as_str(), names.join(", "))))
}
