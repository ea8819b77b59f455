//! `holdpoint approve | reject | rollback | pause | resume`; `lifecycle.rs` has the verbs about one version, and `stop.rs`
//! has `stop | start`.
//!
//! Approvals and refusals are signed with the identity's key. Verbs that stop something name the requester and need
//! no key: stopping must never be harder than continuing. The engine checks each request again and may refuse it.

mod lifecycle;
mod request_text;

use std::path::PathBuf;

use clap::Args;

pub use lifecycle::{BreakGlassArgs, DemoteArgs, ProfileBlockArgs, ReleaseArgs, RepeatArgs, ResumeArgs};
pub(super) use lifecycle::{break_glass, demote, go_on, release, repeat, restrict, signed_act};

use super::data;
use super::passphrase;
use super::status::{StatusSubject, parse_subject};
use super::stop;
use super::verb_executor::{VerbExecutor, print_action_reply, require_verified_engine, running};
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_approvals::keyfile::Protection;
use holdpoint_approvals::{Identity, LockedIdentity, SignedFacts};
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::ids::{CapabilityId, Family, is_name};
use holdpoint_protocol::command::{Command, Operation, Refusal, Reply};
use holdpoint_protocol::snapshot::{ApprovalRequestView, RequestKind, Snapshot};
use holdpoint_registry::Views;
use holdpoint_store::FamilyStatus;
use holdpoint_text::{ErrorReason, Untrusted, is_visible, signing_options};
use holdpoint_wording::live::live_lines;

/// The longest reason, in bytes.
pub const REASON_BYTES_MAX: usize = 1_000;

/// Help for verbs that take authority away: an operator needs no enrolled identity to stop something.
pub(super) const ANY_NAME: &str = "Your name; the verb takes authority away, so any name is accepted";

/// The identity and the reason of a decision.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct SigningArgs {
    /// The identity that signs (see `holdpoint identity`).
    #[arg(long = "as", value_name = "IDENTITY", value_parser = parse_identity)]
    pub identity: String,
    /// The reason; stored in the audit log.
    #[arg(long, value_name = "TEXT", value_parser = parse_reason)]
    pub reason: Untrusted,
    /// Reads the passphrase of the identity's key from this file (mode 0600) instead of the terminal. The variable
    /// `HOLDPOINT_PASSPHRASE_FILE` can name the file, too.
    #[arg(long, value_name = "FILE")]
    pub passphrase_file: Option<PathBuf>,
}

/// The arguments of `approve`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The short digest binds the approval to the evidence you have read;
`holdpoint status` prints it. The profile `human` requires it.

Example:
  holdpoint approve grasp@1.3.0 --digest 9f3c2a10 --as mara --reason 'drills and shadow read'")]
pub struct ApproveArgs {
    /// The candidate, e.g. grasp@1.3.0.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// The first eight digits of the digest of the evidence that you read.
    #[arg(long, value_name = "DIGITS", value_parser = parse_short_digest)]
    pub digest: Option<String>,
    /// The identity that signs, and its reason.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of the verbs about one version.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Example:
  holdpoint reject grasp@1.3.0 --as mara --reason 'grip force too high for this part'")]
pub struct VersionArgs {
    /// The version, e.g. grasp@1.3.0.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// The identity that signs, and its reason.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `rollback`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
If the family has no rollback target, the verb changes nothing and says so;
--stop-family then deactivates the last version.

Example:
  holdpoint rollback grasp --as mara --reason 'drops parts since noon'")]
pub struct FamilyArgs {
    /// The family, e.g. grasp.
    #[arg(value_name = "FAMILY", value_parser = parse_subject)]
    pub family: StatusSubject,
    /// Deactivates the last version, too: the family is safe-stopped until an operator reactivates a version.
    #[arg(long)]
    pub stop_family: bool,
    /// The identity that signs, and its reason.
    #[command(flatten)]
    pub signature: SigningArgs,
}

/// The arguments of `pause`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct PauseArgs {
    /// One family [default: all]. Candidates registered later are not paused.
    #[arg(value_parser = parse_family)]
    pub family: Option<Family>,
    /// The identity that signs, and its reason.
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
        return Err("a reason of visible characters is needed".to_owned());
    }
    stop::parse_why(text)
}

fn parse_short_digest(text: &str) -> Result<String, String> {
    if text.len() == 8 && text.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte)) {
        Ok(text.to_owned())
    } else {
        Err("eight hexadecimal digits (0-9, a-f) are needed".to_owned())
    }
}

pub(super) fn approve(
    context: &CliContext,
    args: &ApproveArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let views = data::open(&context.data)?;
    known_version(&views, &args.version)?;
    let who = passphrase::stored_identity(context, &args.signature.identity)?;
    let mut executor = asking_engine(context)?;
    let snapshot = executor.snapshot()?;
    let Some(prompt) = open_request(&snapshot, &args.version) else {
        let text = format!("held: nothing waits for a decision on {}", args.version);
        return Err(
            CliError::from_engine_fault(text).with_hint(format!("see `holdpoint status {}`", args.version))
        );
    };
    if prompt.purpose == RequestKind::Emergency {
        let text = format!("held: {} waits for a break-glass activation by one person", args.version);
        let signature = signing_options(&args.signature.identity, args.signature.reason.raw());
        let hint =
            format!("`holdpoint version break-glass {} {signature}` is the only verb for that", args.version);
        return Err(CliError::from_engine_fault(text).with_hint(hint));
    }
    let (question, facts) = executor.question(prompt, &who.info().name)?;
    check_digest(args.digest.as_deref(), &facts)?;
    request_text::print_request(&question.lines, &live_lines(prompt, &snapshot), out)?;
    let who = passphrase::unlock(who, args.signature.passphrase_file.as_deref())?;
    let command = question.answer(&who, ApprovalDecision::Approve, args.signature.reason.raw());
    executor.execute(command.map_err(CliError::internal)?, out)?;
    // An approval that is insufficient or does not count leaves the version on hold. A sufficient one waits for the
    // end of one sequence at most.
    let is_open = open_request(&executor.snapshot()?, &args.version).is_some_and(|prompt| !prompt.granted);
    Ok(if is_open { Exit::Held } else { Exit::Confirmed })
}

/// Binds the approval to the named evidence; a profile with people nearby requires it.
fn check_digest(digest: Option<&str>, facts: &SignedFacts) -> Result<(), CliError> {
    let expected = facts.evidence.short();
    match digest {
        Some(digest) if digest == expected => Ok(()),
        Some(digest) => {
            let text = format!("held: {} waits with the evidence {expected}, not {digest}", facts.version);
            Err(CliError::from_engine_fault(text)
                .with_hint("read the evidence again, then approve its digest")
                .with_details(ErrorReason::Stale))
        }
        None if facts.profile.is_beside_people() => {
            let text =
                format!("the profile {:?} needs --digest with the evidence that was read", facts.profile);
            Err(CliError::usage(text).with_hint(format!("`holdpoint status {}` shows it", facts.version)))
        }
        None => Ok(()),
    }
}

pub(super) fn reject(
    context: &CliContext,
    args: &VersionArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let views = data::open(&context.data)?;
    known_version(&views, &args.version)?;
    let mut executor = VerbExecutor::open(context)?;
    let snapshot = executor.snapshot()?;
    let signature = &args.signature;
    let who = passphrase::stored_identity(context, &signature.identity).ok();
    if let (Some(prompt), Some(who)) = (open_request(&snapshot, &args.version), who) {
        // Stopping must never be harder than continuing: without a passphrase prompt or an enrolled key, the
        // rejection goes by name.
        let can_unlock = who.protection() != Protection::Passphrase
            || passphrase::is_available(signature.passphrase_file.as_deref());
        if can_unlock {
            let persons = views.persons().map_err(CliError::usage)?;
            let is_enrolled = persons.enrolled().any(|person| person.info() == *who.info());
            if is_enrolled {
                return reject_request(&mut executor, prompt, &snapshot, (who, signature), out);
            }
        }
    }
    executor.execute(Command::Reject(operation(&args.version, &args.signature)), out)
}

/// Signs the refusal of the displayed request. If the request is unavailable or has changed, the signature covers
/// no displayed text; the refusal still counts.
fn reject_request(
    executor: &mut VerbExecutor,
    prompt: &ApprovalRequestView,
    snapshot: &Snapshot,
    (who, signature): (LockedIdentity, &SigningArgs),
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let question = executor.question(prompt, &who.info().name).ok();
    if let Some((question, _)) = &question {
        request_text::print_request(&question.lines, &live_lines(prompt, snapshot), out)?;
    }
    let who = passphrase::unlock(who, signature.passphrase_file.as_deref())?;
    let reason = signature.reason.raw();
    if let Some((question, _)) = question {
        let command = question.answer(&who, ApprovalDecision::Reject, reason).map_err(CliError::internal)?;
        let reply = executor.send(command)?;
        if !matches!(reply, Reply::Refused { code: Refusal::Stale, .. }) {
            return print_action_reply(&reply, out);
        }
    }
    executor.execute(prompt.refuse(&who, reason).map_err(CliError::internal)?, out)
}

pub(super) fn rollback(
    context: &CliContext,
    args: &FamilyArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let views = data::open(&context.data)?;
    let family = family_to_roll_back(&views, args)?;
    known_family(&views, family)?;
    let mut executor = VerbExecutor::open(context)?;
    let snapshot = executor.snapshot()?;
    let view = snapshot.families.iter().find(|view| view.family == *family);
    let Some(active) = view.and_then(|view| view.active.clone()) else {
        let text = format!("held: {family} is safe-stopped, no version is active");
        return Err(CliError::from_engine_fault(text)
            .with_hint(format!("`holdpoint version list --family {family}` shows what can be reactivated")));
    };
    let operation = operation(&active, &args.signature);
    let command = if args.stop_family { Command::Vacate(operation) } else { Command::Rollback(operation) };
    let exit = executor.execute(command, out)?;
    let after = executor.snapshot()?.families.into_iter().find(|view| view.family == *family);
    if after.is_none_or(|view| view.active.is_none()) {
        // Deactivated without a successor: a stop, not a rollback.
        let text = format!("held: safe-stopped, no version of {family} is active");
        return Err(CliError::from_engine_fault(text).with_details(ErrorReason::SafeStopped));
    }
    Ok(exit)
}

/// The family of a rollback, which ends the active version; a version in its place is an error with the command.
fn family_to_roll_back<'a>(views: &Views, args: &'a FamilyArgs) -> Result<&'a Family, CliError> {
    let version = match &args.family {
        StatusSubject::Family(family) => return Ok(family),
        StatusSubject::Version(version) => version,
    };
    known_version(views, version)?;
    let family = &version.family;
    let text =
        format!("rollback takes a family, and {version} is a version; it ends the version that is active");
    let signature = signing_options(&args.signature.identity, args.signature.reason.raw());
    let hint = if args.stop_family {
        format!(
            "`holdpoint rollback {family} --stop-family {signature}` rolls back the active version of {family}"
        )
    } else {
        format!("`holdpoint rollback {family} {signature}` rolls back the active version of {family}")
    };
    Err(CliError::usage(text).with_hint(hint))
}

#[derive(Clone, Copy)]
enum PauseChange<'a> {
    Pause,
    /// The identity that answers for it.
    Resume(&'a Identity),
}

pub(super) fn pause(
    context: &CliContext,
    args: &PauseArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    set_paused(context, (args.family.as_ref(), &args.signature), PauseChange::Pause, out)
}

pub(super) fn resume(
    context: &CliContext,
    args: &ResumeArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let subject = (lifecycle::family_to_resume(args)?, &args.signature);
    // Only an identity of the store may let a version continue.
    let who = identity(context, &args.signature)?;
    set_paused(context, subject, PauseChange::Resume(&who), out)
}

/// Pauses or resumes candidates of one family, or of all.
fn set_paused(
    context: &CliContext,
    (family, signature): (Option<&Family>, &SigningArgs),
    pausing: PauseChange<'_>,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let views = data::open(&context.data)?;
    if let Some(family) = family {
        known_family(&views, family)?;
    }
    let mut executor = VerbExecutor::open(context)?;
    let fits = |view: &&holdpoint_protocol::snapshot::CandidateView| {
        let of_family = family.is_none_or(|family| view.version.family == *family);
        let may_change = match pausing {
            PauseChange::Pause => view.state.may_pause(&view.flags),
            PauseChange::Resume(_) => view.state.may_resume(&view.flags, view.held),
        };
        of_family && may_change
    };
    let versions: Vec<CapabilityId> =
        executor.snapshot()?.candidates.iter().filter(fits).map(|view| view.version.clone()).collect();
    if versions.is_empty() {
        let of = family.map_or_else(String::new, |family| format!(" of {family}"));
        return Err(CliError::from_engine_fault(match pausing {
            PauseChange::Pause => format!("nothing was paused: no version{of} is advancing"),
            PauseChange::Resume(_) => format!("nothing was resumed: no version{of} is paused or on hold"),
        }));
    }
    for version in versions {
        let operation = operation(&version, signature);
        match pausing {
            PauseChange::Pause => executor.execute(Command::Pause(operation), out)?,
            PauseChange::Resume(who) => executor.execute_as(context, who, Command::Resume(operation), out)?,
        };
    }
    Ok(Exit::Confirmed)
}

/// An identity of the store, with its opened key, for a request to the engine.
pub(super) fn identity(context: &CliContext, signature: &SigningArgs) -> Result<Identity, CliError> {
    require_verified_engine(context)?;
    let locked = passphrase::stored_identity(context, &signature.identity)?;
    passphrase::unlock(locked, signature.passphrase_file.as_deref())
}

fn operation(version: &CapabilityId, signature: &SigningArgs) -> Operation {
    Operation {
        version: version.clone(),
        by: signature.identity.clone(),
        reason: signature.reason.raw().to_owned(),
    }
}

fn open_request<'a>(snapshot: &'a Snapshot, version: &CapabilityId) -> Option<&'a ApprovalRequestView> {
    snapshot.prompts.iter().find(|prompt| prompt.version == *version)
}

/// The running engine. Without one, no question to a person is open.
fn asking_engine(context: &CliContext) -> Result<VerbExecutor, CliError> {
    running(context)?.map(VerbExecutor::Running).ok_or_else(|| {
        CliError::from_engine_fault("held: no engine is running on this store, so nothing waits for a person")
            .with_hint("start one with `holdpoint run`; it asks again, for the stored evidence")
            .with_details(ErrorReason::NoAnswer)
    })
}

/// Asked before an engine opens, so that an unknown name leaves the store unchanged.
pub(super) fn known_version(views: &Views, version: &CapabilityId) -> Result<(), CliError> {
    let known = views.version(version).map_err(CliError::usage)?;
    known.map(drop).ok_or_else(|| unknown_version(version))
}

pub(super) fn unknown_version(version: &CapabilityId) -> CliError {
    CliError::usage(format!("there is no version {:?}", version.to_string()))
        .with_hint("`holdpoint version list` names all")
        .with_details(ErrorReason::NotFound)
}

pub(super) fn known_family(views: &Views, family: &Family) -> Result<FamilyStatus, CliError> {
    let families = views.families().map_err(CliError::usage)?;
    let names: Vec<String> = families.iter().map(|known| known.name.clone()).collect();
    families.into_iter().find(|known| known.name == family.as_str()).ok_or_else(|| {
        CliError::usage(format!("there is no family {:?}; there are {}", family.as_str(), names.join(", ")))
            .with_hint("`holdpoint version list` names all versions")
            .with_details(ErrorReason::NotFound)
    })
}
