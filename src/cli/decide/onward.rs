//! `holdpoint repeat | release | restrict | continue | break-glass | rearm`: the ways on from where a version stands.
//!
//! Whoever lets something go on is named by an identity of the store; whoever narrows something gives any name.

use clap::Args;

use super::{
    SigningArgs, VersionArgs, check_digest, identity, known_version, operation, parse_short_digest,
    passphrase, shown,
};
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::cli::side::{Side, running};
use crate::error::{CliError, Exit};
use holdpoint_governance::approval::Answer;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::Command;
use holdpoint_protocol::question::live_lines;
use holdpoint_registry::Views;

/// The arguments of `demote`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Without --profile the version goes back to evaluation. With it the profiles
are closed to it; it keeps its state, unless it acts under one of them.

Examples:
  holdpoint demote grasp@1.3.0 --as mara --reason 'evaluate again with the new gripper'
  holdpoint demote grasp@1.3.0 --profile human --as mara --reason 'too fast beside people'")]
pub struct DemoteArgs {
    /// The version, e.g. grasp@1.3.0.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// A profile that is closed to it; can be given several times.
    #[arg(long, value_name = "PROFILE")]
    pub profile: Vec<ProfileName>,
    /// Who asks for it, and the reason that is kept.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `repeat`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Gate pass and approvals of the version are void with it. Shadow alone can
be repeated while the evidence of the sandbox still holds.

Example:
  holdpoint repeat grasp@1.3.0 --as mara --reason 'the new gripper is mounted'")]
pub struct RepeatArgs {
    /// The version: sandboxed, shadowed or demoted.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// The stage that is run again: sandbox or shadow.
    #[arg(long, value_name = "STAGE", default_value = "sandbox", value_parser = parse_stage)]
    pub stage: Stage,
    /// Who asks for it, and the reason that is kept.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `release`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Without --profile the envelope is lifted that a monitor or an operator
tightened; where activations need approval, people are asked first.

Examples:
  holdpoint release grasp@1.3.0 --as mara --reason 'the lamp that blinded it is gone'
  holdpoint release grasp@1.3.0 --profile human --as mara --reason 'measured beside people'")]
pub struct ReleaseArgs {
    /// The restricted version, e.g. grasp@1.3.0.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// A closed profile that is open to it again; can be given several times.
    #[arg(long, value_name = "PROFILE")]
    pub profile: Vec<ProfileName>,
    /// Who asks for it, and the reason that is kept.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `break-glass`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The emergency door of the profiles sim and real: one person lets in what
people or the calendar hold back after shadow, never what was measured to
be incompatible. Two others review it by its deadline (`holdpoint approve`
or `reject`), or it is taken off; it is flagged everywhere until then.

Example:
  holdpoint break-glass grasp@1.3.0 --as mara --reason 'the old one drops every second part'")]
pub struct BreakGlassArgs {
    /// The version that is held back, e.g. grasp@1.3.0.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// The first eight digits of the evidence digest that was read.
    #[arg(long, value_name = "DIGITS", value_parser = parse_short_digest)]
    pub digest: Option<String>,
    /// Who signs, and the emergency in words.
    #[command(flatten)]
    pub signature: SigningArgs,
}

fn parse_stage(text: &str) -> Result<Stage, String> {
    match text.parse::<Stage>() {
        Ok(stage @ (Stage::Sandbox | Stage::Shadow)) => Ok(stage),
        Ok(Stage::Validation | Stage::Activation) | Err(_) => {
            Err("sandbox and shadow can be repeated".to_owned())
        }
    }
}

pub(super) fn repeat(
    context: &CliContext,
    views: &Views,
    args: &RepeatArgs,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    known_version(views, &args.version)?;
    let who = identity(context, &args.signature)?;
    let operation = operation(&args.version, &args.signature);
    let mut side = Side::open(context)?;
    let exit = side.carry_out_as(context, &who, Command::Repeat { operation, stage: args.stage }, out)?;
    if side.is_own() && !out.is_json() {
        out.line("no engine is running; `holdpoint run` works the stage")?;
    }
    Ok(exit)
}

pub(super) fn release(
    context: &CliContext,
    views: &Views,
    args: &ReleaseArgs,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    known_version(views, &args.version)?;
    let who = identity(context, &args.signature)?;
    let operation = operation(&args.version, &args.signature);
    let mut side = Side::open(context)?;
    let command = Command::Release { operation, profiles: args.profile.clone() };
    side.carry_out_as(context, &who, command, out)?;
    let open = side.snapshot()?.prompts.iter().any(|prompt| prompt.version == args.version);
    Ok(if open { Exit::Held } else { Exit::Confirmed })
}

pub(super) fn restrict(
    context: &CliContext,
    views: &Views,
    args: &VersionArgs,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    known_version(views, &args.version)?;
    Side::open(context)?.carry_out(Command::Restrict(operation(&args.version, &args.signature)), out)
}

/// Only a running engine has a monitor that asks.
pub(super) fn go_on(
    context: &CliContext,
    views: &Views,
    args: &VersionArgs,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    known_version(views, &args.version)?;
    let who = identity(context, &args.signature)?;
    let Some(client) = running(context)? else {
        return Err(CliError::held("held: no engine is running on this store, so no monitor asks"));
    };
    let command = Command::Continue(operation(&args.version, &args.signature));
    Side::Running(client).carry_out_as(context, &who, command, out)
}

pub(super) fn rearm(
    context: &CliContext,
    views: &Views,
    args: &VersionArgs,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    known_version(views, &args.version)?;
    let who = identity(context, &args.signature)?;
    let command = Command::Rearm(operation(&args.version, &args.signature));
    Side::open(context)?.carry_out_as(context, &who, command, out)
}

/// One person signs alone; only a running engine knows what is held back.
pub(super) fn break_glass(
    context: &CliContext,
    views: &Views,
    args: &BreakGlassArgs,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    known_version(views, &args.version)?;
    let who = passphrase::kept(context, &args.signature.identity)?;
    let Some(client) = running(context)? else {
        let text = "held: no engine is running on this store, so nothing is held back that could be let in";
        return Err(CliError::held(text).with_hint("start one with `holdpoint run`"));
    };
    let mut side = Side::Running(client);
    let snapshot = side.snapshot()?;
    let Some(door) = snapshot.emergencies.iter().find(|door| door.version == args.version) else {
        let text = format!("held: the emergency door is not for {} now", args.version);
        let hint = "it is for what people or the calendar hold back after shadow, under sim and real";
        return Err(CliError::held(text).with_hint(hint));
    };
    let (question, bound) = side.question(door, &who.info().name)?;
    check_digest(args.digest.as_deref(), &bound)?;
    shown::told(&question.lines, &live_lines(door, &snapshot), out)?;
    let who = passphrase::unlock(who, args.signature.passphrase_file.as_deref())?;
    let command = question.answer(&who, Answer::Approve, args.signature.reason.raw());
    side.carry_out(command.map_err(CliError::internal)?, out)
}
