//! `holdpoint explain`: why a version stands where it stands, from the store alone.
//!
//! Prints what [`holdpoint_engine::explain`] reads; must not judge. Lines are wrapped to the terminal, and nothing of it is
//! left off in JSON.

use std::path::Path;

use clap::Args;

use super::data;
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_engine::embedded;
use holdpoint_engine::explain;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::kept::KeptUse;
use holdpoint_governance::permission::PermissionUse;
use holdpoint_governance::words::Word;
use holdpoint_protocol::explained::{Explained, Explanation};
use holdpoint_runtime::capability::PackageError;

/// The arguments of `explain`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint explain align@1.1.0
  holdpoint explain grasp-improved --json")]
pub struct ExplainArgs {
    /// The version, or the folder of a candidate that was registered.
    #[arg(value_name = "VERSION|FOLDER")]
    pub subject: String,
}

/// Reads and prints.
///
/// # Errors
/// If there is no store, or no such version in it.
pub fn run(context: &CliContext, args: &ExplainArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let views = data::open_checked(&context.data)?;
    let id = version(&args.subject)?;
    let Some(explanation) = explain::explain(&views, &id).map_err(CliError::usage)? else {
        let text = format!("{id} is not in the store {:?}", context.data);
        return Err(CliError::usage(text).with_hint("see `holdpoint registry list`"));
    };
    let missing = super::profile_on_record::missing(&views);
    out.answer(&explanation, |out| {
        show(&explanation, out)?;
        missing.map_or(Ok(()), |why| out.line(&format!("profile: gate-profile-unauthorized: {why}")))
    })?;
    Ok(Exit::Confirmed)
}

/// A version by its name, or by the folder it was submitted from.
fn version(subject: &str) -> Result<CapabilityId, CliError> {
    if let Ok(id) = subject.parse() {
        return Ok(id);
    }
    // What cannot be read is no candidate's folder; what is wrong in one that can is said.
    let known = |path: &Path| match embedded::read(path) {
        Err(PackageError::Folder { .. } | PackageError::Read { .. } | PackageError::NotText { .. }) => None,
        read => Some(read),
    };
    let read = known(Path::new(subject)).or_else(|| known(&Path::new("manifests/candidates").join(subject)));
    let Some(read) = read else {
        let text = format!("{subject:?} is neither a version nor a candidate's folder");
        return Err(CliError::usage(text).with_hint("a version is <family>@<version>, such as align@1.1.0"));
    };
    read.map(|candidate| candidate.id()).map_err(CliError::usage)
}

fn show(explanation: &Explanation, out: &mut Output<'_>) -> Result<(), CliError> {
    let Explanation { version, state, author, decisions } = explanation;
    out.paragraph("", &format!("{version} by {author} is {state}"))?;
    if decisions.is_empty() {
        return out.paragraph("", "nothing has been decided about it yet");
    }
    for decision in decisions {
        out.line("")?;
        one(decision, out)?;
    }
    Ok(())
}

fn one(decision: &Explained, out: &mut Output<'_>) -> Result<(), CliError> {
    let Explained { record, at_ms, ruling, rule, said, reasons, change, permissions, kept, then } = decision;
    let (stage, outcome) = (ruling.stage(), ruling.outcome());
    out.paragraph("", &format!("{stage}: {outcome} (record {record}, {:.3} s)", *at_ms as f64 / 1000.0))?;
    out.paragraph("  ", &format!("rule  {}: {}", rule.name(), rule.source()))?;
    for text in said {
        out.paragraph("  ", &format!("in short  {text}"))?;
    }
    for reason in reasons {
        let mark = match (&reason.code, reason.in_favour) {
            (None, _) => "-",
            (Some(_), true) => "+",
            (Some(_), false) => "!",
        };
        let code = reason.code.as_ref().map_or_else(String::new, |code| format!("{code}: "));
        let numbers = match (reason.evidence, reason.limit) {
            (Some(found), Some(limit)) => format!(" [{found:.3} against {limit:.3}]"),
            _ => String::new(),
        };
        let text = reason
            .code
            .as_ref()
            .and_then(Word::known)
            .map_or_else(|| reason.text.as_str().into(), |code| code.told(&reason.text));
        out.paragraph("  ", &format!("{mark} {code}{text}{numbers}"))?;
        if let Some(measured) = &reason.measured {
            out.paragraph("      ", measured)?;
        }
        if reason.code.is_some() && !reason.in_favour {
            out.paragraph("      ", &format!("{}: {}", reason.rule.name(), reason.rule.source()))?;
        }
    }
    for text in change {
        out.paragraph("  ", &format!("to change  {text}"))?;
    }
    for text in permissions.iter().flat_map(PermissionUse::lines) {
        out.paragraph("  ", &format!("permissions  {text}"))?;
    }
    for text in kept.iter().flat_map(KeptUse::lines) {
        out.paragraph("  ", &format!("kept  {text}"))?;
    }
    for text in then {
        out.paragraph("  ", &format!("then  {text}"))?;
    }
    Ok(())
}
