//! `holdpoint explain`: why a version is in its state, from the store alone.
//!
//! Prints the result of [`holdpoint_engine::explain`]; judges nothing. Wraps lines to the terminal; JSON has
//! everything.

use std::path::Path;

use clap::Args;

use super::data;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_engine::embedded;
use holdpoint_engine::explain;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::explanation::{DecisionExplanation, Explanation};
use holdpoint_runtime::capability::PackageError;
use holdpoint_text::ErrorReason;
use holdpoint_wording::explanation::{cached_results, permission_use};

/// The arguments of `explain`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint explain align@1.1.0
  holdpoint explain grasp-improved --json")]
pub struct ExplainArgs {
    /// The version, or the folder of a registered candidate.
    #[arg(value_name = "VERSION|FOLDER")]
    pub subject: String,
}

/// Reads and prints.
///
/// # Errors
/// If there is no store, or no such version in it.
pub fn run(context: &CliContext, args: &ExplainArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let views = data::open_checked(&context.data)?;
    let id = version(&args.subject)?;
    let Some(explanation) = explain::explain(&views, &id).map_err(CliError::usage)? else {
        let text = format!("{id} is not in the store {:?}", context.data);
        let error = CliError::usage(text).with_hint("see `holdpoint registry list`");
        return Err(error.with_details(ErrorReason::NotFound));
    };
    let missing = super::profile_authorization::missing(&views);
    out.answer(&explanation, |out| {
        show(&explanation, out)?;
        missing.map_or(Ok(()), |why| out.line(&format!("profile: gate-profile-unauthorized: {why}")))
    })?;
    Ok(Exit::Confirmed)
}

/// A version by name, or by the folder it was submitted from.
fn version(subject: &str) -> Result<CapabilityId, CliError> {
    if let Ok(id) = subject.parse() {
        return Ok(id);
    }
    // An unreadable path is not a candidate's folder; errors in a readable one are reported.
    let known = |path: &Path| match embedded::read(path) {
        Err(PackageError::Folder { .. } | PackageError::Read { .. } | PackageError::NotText { .. }) => None,
        read => Some(read),
    };
    let read = known(Path::new(subject)).or_else(|| known(&Path::new("manifests/candidates").join(subject)));
    let Some(read) = read else {
        let text = format!("{subject:?} is neither a version nor a candidate's folder");
        return Err(CliError::usage(text)
            .with_hint("a version is <family>@<version>, such as align@1.1.0")
            .with_details(ErrorReason::NotFound));
    };
    read.map(|candidate| candidate.id()).map_err(CliError::usage)
}

fn show(explanation: &Explanation, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
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

fn one(decision: &DecisionExplanation, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let DecisionExplanation { record, at_ms, ruling, rule, said, reasons, change, permissions, kept, then } =
        decision;
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
        let text = &reason.text;
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
    for text in permissions.iter().flat_map(permission_use) {
        out.paragraph("  ", &format!("permissions  {text}"))?;
    }
    for text in kept.iter().flat_map(cached_results) {
        out.paragraph("  ", &format!("kept  {text}"))?;
    }
    for text in then {
        out.paragraph("  ", &format!("then  {text}"))?;
    }
    Ok(())
}
