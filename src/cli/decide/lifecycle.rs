//! `holdpoint version retry | demote | block | unblock | restrict | unrestrict | answer | break-glass | reactivate | anchor
//! | review-tries`.
//!
//! Verbs that grant authority need an identity of the store; verbs that take it away accept any name.

use clap::Args;

use super::{
    SigningArgs, StatusSubject, VersionArgs, asking_engine, check_digest, data, identity, known_family,
    known_version, operation, parse_family, parse_short_digest, parse_subject, passphrase, request_text,
};
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::cli::verb_executor::VerbExecutor;
use crate::error::{CliError, Exit};
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::{Command, Operation};
use holdpoint_registry::Views;
use holdpoint_text::signing_options;
use holdpoint_wording::live::live_lines;
use holdpoint_wording::program::run as sentences;

/// The arguments of `version demote`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The rollback target becomes active; the version can be evaluated again. `holdpoint rollback FAMILY`
ends a version for good, `holdpoint version block` closes single profiles to it.

Example:
  holdpoint version demote grasp@1.3.0 --as mara --reason 'evaluate again with the new gripper'")]
pub struct DemoteArgs {
    /// The version, e.g. grasp@1.3.0.
    #[arg(value_name = "FAMILY@VERSION", value_parser = parse_subject)]
    pub version: StatusSubject,
    /// A profile to block the version under, as `version block` does; for scripts of earlier versions.
    #[arg(long, value_name = "PROFILE", hide = true)]
    pub profile: Vec<ProfileName>,
    /// The identity that asks for it, and its reason.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `version block` and `version unblock`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct ProfileBlockArgs {
    /// The version, e.g. grasp@1.3.0.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// A profile that it applies to; can be given several times.
    #[arg(long, value_name = "PROFILE", required = true)]
    pub profile: Vec<ProfileName>,
    /// The identity that asks for it, and its reason.
    #[command(flatten)]
    pub signature: SigningArgs,
}

impl From<ProfileBlockArgs> for DemoteArgs {
    fn from(args: ProfileBlockArgs) -> Self {
        let version = StatusSubject::Version(args.version);
        Self { version, profile: args.profile, signature: args.signature }
    }
}

impl From<ProfileBlockArgs> for ReleaseArgs {
    fn from(args: ProfileBlockArgs) -> Self {
        Self { version: args.version, profile: args.profile, signature: args.signature }
    }
}

/// The arguments of `resume`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct ResumeArgs {
    /// The family to resume.
    #[arg(value_parser = parse_family, conflicts_with = "all")]
    pub family: Option<Family>,
    /// Resumes every family.
    #[arg(long)]
    pub all: bool,
    /// The identity that signs, and its reason.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `version retry`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The version loses its gate pass and approvals. You can repeat shadow alone
while the evidence of the sandbox is still valid.

Example:
  holdpoint version retry grasp@1.3.0 --as mara --reason 'the new gripper is mounted'")]
pub struct RepeatArgs {
    /// The version: sandboxed, shadowed or demoted.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// The stage to run again: sandbox or shadow.
    #[arg(long, value_name = "STAGE", default_value = "sandbox", value_parser = parse_stage)]
    pub stage: Stage,
    /// The identity that asks for it, and its reason.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `version unrestrict`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The verb restores the envelope that the drift monitor or an operator tightened; under a
profile with approvals, approvers decide first.

Example:
  holdpoint version unrestrict grasp@1.3.0 --as mara --reason 'the lamp that blinded it is gone'")]
pub struct ReleaseArgs {
    /// The restricted version, e.g. grasp@1.3.0.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// A profile to unblock the version under, as `version unblock` does; for scripts of earlier versions.
    #[arg(long, value_name = "PROFILE", hide = true)]
    pub profile: Vec<ProfileName>,
    /// The identity that asks for it, and its reason.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `version break-glass`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Break-glass, under the profiles sim and real: one person activates a version
that waits for approvers or for the end of a freeze after shadow, never one
measured to be incompatible. Two others review it by its deadline (`holdpoint
approve` or `reject`), or it is demoted; until then it is flagged.

Example:
  holdpoint version break-glass grasp@1.3.0 --as mara --reason 'the old one drops every second part'")]
pub struct BreakGlassArgs {
    /// The version to activate, e.g. grasp@1.3.0.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// The first eight digits of the digest of the evidence that you read.
    #[arg(long, value_name = "DIGITS", value_parser = parse_short_digest)]
    pub digest: Option<String>,
    /// The identity that signs, and the emergency in words.
    #[command(flatten)]
    pub signature: SigningArgs,
}

fn parse_stage(text: &str) -> Result<Stage, String> {
    match text.parse::<Stage>() {
        Ok(stage @ (Stage::Sandbox | Stage::Shadow)) => Ok(stage),
        Ok(Stage::Validation | Stage::Activation) | Err(_) => {
            Err("only sandbox and shadow can be run again".to_owned())
        }
    }
}

/// The family to resume, or all; a person who names neither may not know how many others paused.
pub(super) fn family_to_resume(args: &ResumeArgs) -> Result<Option<&Family>, CliError> {
    if args.family.is_some() || args.all {
        return Ok(args.family.as_ref());
    }
    let signature = signing_options(&args.signature.identity, args.signature.reason.raw());
    Err(CliError::usage("resume needs a family, or --all for every family").with_hint(format!(
        "`holdpoint resume FAMILY {signature}` or `holdpoint resume --all {signature}`; `holdpoint status` shows what is \
         paused or on hold"
    )))
}

/// The version to demote; a family in its place is an error with the command for its active version.
fn version_to_demote<'a>(views: &Views, args: &'a DemoteArgs) -> Result<&'a CapabilityId, CliError> {
    let family = match &args.version {
        StatusSubject::Version(version) => return Ok(version),
        StatusSubject::Family(family) => family,
    };
    let active = known_family(views, family)?.active;
    let signature = signing_options(&args.signature.identity, args.signature.reason.raw());
    let text = format!("demote takes a version, and {family} is a family; `rollback` takes a family");
    let hint = match active {
        Some(active) => {
            format!(
                "`holdpoint version demote {active} {signature}` lets the active version be evaluated again"
            )
        }
        None => format!("`holdpoint version list --family {family}` names its versions; none is active"),
    };
    Err(CliError::usage(text).with_hint(hint))
}

pub(in crate::cli) fn demote(
    context: &CliContext,
    args: &DemoteArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let views = data::open(&context.data)?;
    let version = version_to_demote(&views, args)?;
    known_version(&views, version)?;
    let (operation, profiles) = (operation(version, &args.signature), args.profile.clone());
    VerbExecutor::open(context)?.execute(Command::Demote { operation, profiles }, out)
}

pub(in crate::cli) fn repeat(
    context: &CliContext,
    args: &RepeatArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    known_version(&data::open(&context.data)?, &args.version)?;
    let who = identity(context, &args.signature)?;
    let operation = operation(&args.version, &args.signature);
    let mut executor = VerbExecutor::open(context)?;
    let exit = executor.execute_as(context, &who, Command::Repeat { operation, stage: args.stage }, out)?;
    if executor.is_own() && !out.is_json() {
        out.line(sentences::STAGE_WAITS)?;
    }
    Ok(exit)
}

pub(in crate::cli) fn release(
    context: &CliContext,
    args: &ReleaseArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    known_version(&data::open(&context.data)?, &args.version)?;
    let who = identity(context, &args.signature)?;
    let operation = operation(&args.version, &args.signature);
    let mut executor = VerbExecutor::open(context)?;
    let command = Command::Release { operation, profiles: args.profile.clone() };
    executor.execute_as(context, &who, command, out)?;
    let open = executor.snapshot()?.prompts.iter().any(|prompt| prompt.version == args.version);
    Ok(if open { Exit::Held } else { Exit::Confirmed })
}

pub(in crate::cli) fn restrict(
    context: &CliContext,
    args: &VersionArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    known_version(&data::open(&context.data)?, &args.version)?;
    VerbExecutor::open(context)?.execute(Command::Restrict(operation(&args.version, &args.signature)), out)
}

/// Only a running engine has a drift monitor that escalates.
pub(in crate::cli) fn go_on(
    context: &CliContext,
    args: &VersionArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    known_version(&data::open(&context.data)?, &args.version)?;
    let who = identity(context, &args.signature)?;
    let command = Command::Continue(operation(&args.version, &args.signature));
    asking_engine(context)?.execute_as(context, &who, command, out)
}

/// A signed act on one version that the store's engine carries out, running or not.
pub(in crate::cli) fn signed_act(
    context: &CliContext,
    args: &VersionArgs,
    act: fn(Operation) -> Command,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    known_version(&data::open(&context.data)?, &args.version)?;
    let who = identity(context, &args.signature)?;
    let command = act(operation(&args.version, &args.signature));
    VerbExecutor::open(context)?.execute_as(context, &who, command, out)
}

/// One person signs alone; only a running engine knows which versions wait.
pub(in crate::cli) fn break_glass(
    context: &CliContext,
    args: &BreakGlassArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    known_version(&data::open(&context.data)?, &args.version)?;
    let who = passphrase::stored_identity(context, &args.signature.identity)?;
    let mut executor = asking_engine(context)?;
    let snapshot = executor.snapshot()?;
    let Some(request) = snapshot.emergencies.iter().find(|request| request.version == args.version) else {
        let text = format!("held: break-glass does not apply to {} now", args.version);
        let hint =
            "under sim and real, it applies after shadow to a version that waits for approvers or a freeze";
        return Err(CliError::from_engine_fault(text).with_hint(hint));
    };
    let (question, facts) = executor.question(request, &who.info().name)?;
    check_digest(args.digest.as_deref(), &facts)?;
    request_text::print_request(&question.lines, &live_lines(request, &snapshot), out)?;
    let who = passphrase::unlock(who, args.signature.passphrase_file.as_deref())?;
    let command = question.answer(&who, ApprovalDecision::Approve, args.signature.reason.raw());
    executor.execute(command.map_err(CliError::internal)?, out)
}
