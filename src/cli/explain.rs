//! `holdpoint explain`: why a version, or the active and the newest version of a family, is in its state, from the store
//! alone.
//!
//! Prints the result of [`holdpoint_explain::why`]; judges nothing. Without an option it prints the deciding reasons
//! on one screen; `--full` and JSON have everything.

use std::path::Path;

use clap::Args;

use super::data;
use super::decide::unknown_version;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_explain::why;
use holdpoint_governance::explanation::ExplanationSummary;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_protocol::explanation::{DecisionExplanation, ExplainedReason, Explanation, Ruling};
use holdpoint_registry::Views;
use holdpoint_runtime::capability::PackageError;
use holdpoint_text::ErrorReason;
use holdpoint_trials::embedded;
use holdpoint_wording::explanation::{cached_results, permission_use};
use holdpoint_wording::explanation_summary::{
    SummaryLines, omitted_reasons, repeated_reasons, summary_lines,
};
use holdpoint_wording::measured_and_limit;
use holdpoint_wording::program::profile::not_authorized;
use holdpoint_wording::program::version::NOTHING_DECIDED;

/// The most lines of the short form.
const LINES_MAX: usize = 25;

/// The width of the short form if there is no terminal.
const COLUMNS: u16 = 100;

/// The most reasons against the version, and the most changes, that the short form prints.
const REASONS_MAX: usize = 8;
const CHANGES_MAX: usize = 3;

/// The most lines of one text of the short form.
const TEXT_LINES_MAX: usize = 2;

/// The arguments of `explain`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint explain align@1.1.0
  holdpoint explain align@1.1.0 --full
  holdpoint explain align
  holdpoint explain grasp-improved --json")]
pub struct ExplainArgs {
    /// A version, the folder of a registered candidate, or a family: its active and its newest version.
    #[arg(value_name = "FAMILY[@VERSION]|FOLDER")]
    pub subject: String,
    /// Print every decision with its rule, all reasons and the permissions used.
    #[arg(long)]
    pub full: bool,
}

/// Reads and prints.
///
/// # Errors
/// If there is no store, or no such version in it.
pub fn run(context: &CliContext, args: &ExplainArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let views = data::open_checked(&context.data)?;
    let ids = versions(&views, &args.subject)?;
    let missing = super::profile_authorization::missing(&views);
    for (index, id) in ids.iter().enumerate() {
        if index > 0 && !out.is_json() {
            out.line("")?;
        }
        if args.full || out.is_json() {
            let found = why::explain(&views, id).map_err(CliError::usage)?;
            let explanation = found.ok_or_else(|| unknown_version(id))?;
            out.answer(&explanation, |out| show(&explanation, out))?;
        } else {
            let found = why::summarize(&views, id).map_err(CliError::usage)?;
            let summary = found.ok_or_else(|| unknown_version(id))?;
            show_summary(context, summary, out)?;
        }
    }
    if let Some(why) = missing.filter(|_| !out.is_json()) {
        out.line(&not_authorized(&why))?;
    }
    Ok(Exit::Confirmed)
}

/// A version by name or by the folder it was submitted from, or the active and the newest version of a family.
fn versions(views: &Views, subject: &str) -> Result<Vec<CapabilityId>, CliError> {
    if let Ok(id) = subject.parse() {
        return Ok(vec![id]);
    }
    // An unreadable path is not a candidate's folder; errors in a readable one are reported.
    let known = |path: &Path| match embedded::read(path) {
        Err(PackageError::Folder { .. } | PackageError::Read { .. } | PackageError::NotText { .. }) => None,
        read => Some(read),
    };
    let read = known(Path::new(subject)).or_else(|| known(&Path::new("manifests/candidates").join(subject)));
    if let Some(read) = read {
        return read.map(|candidate| vec![candidate.id()]).map_err(CliError::usage);
    }
    let of_family = family_versions(views, subject)?;
    if of_family.is_empty() {
        let text =
            format!("{subject:?} is neither a version, a family of the store, nor a candidate's folder");
        return Err(CliError::usage(text)
            .with_hint(
                "a version is <family>@<version>, such as align@1.1.0; `holdpoint version list` names all",
            )
            .with_details(ErrorReason::NotFound));
    }
    Ok(of_family)
}

/// The active version of a family, and its newest if that is another one; none of a family that is not in the store.
fn family_versions(views: &Views, name: &str) -> Result<Vec<CapabilityId>, CliError> {
    let Ok(family) = Family::new(name) else { return Ok(Vec::new()) };
    let families = views.families().map_err(CliError::usage)?;
    let mut all: Vec<CapabilityId> = families
        .into_iter()
        .find(|known| known.name == name)
        .and_then(|known| known.active)
        .into_iter()
        .collect();
    let newest = views.family_in_order(&family).map_err(CliError::usage)?.pop();
    all.extend(newest.filter(|newest| !all.contains(newest)));
    Ok(all)
}

fn show(explanation: &Explanation, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let Explanation { version, state, author, decisions } = explanation;
    out.paragraph("", &format!("{version} by {author} is {state}"))?;
    if decisions.is_empty() {
        return out.paragraph("", NOTHING_DECIDED);
    }
    for (index, decision) in decisions.iter().enumerate() {
        out.line("")?;
        one(decision, sandbox_before(decision, decisions.get(..index).unwrap_or_default()), out)?;
    }
    Ok(())
}

/// The decision of the sandbox whose reasons a decision of shadow repeats.
fn sandbox_before<'a>(
    decision: &DecisionExplanation,
    earlier: &'a [DecisionExplanation],
) -> Option<&'a DecisionExplanation> {
    if !matches!(decision.ruling, Ruling::Shadow(_)) {
        return None;
    }
    earlier.iter().rev().find(|earlier| matches!(earlier.ruling, Ruling::Sandbox(_)))
}

/// Prints a decision; what `before` has as well is counted.
fn one(
    decision: &DecisionExplanation,
    before: Option<&DecisionExplanation>,
    out: &mut CommandOutput<'_>,
) -> Result<(), CliError> {
    let DecisionExplanation { record, at_ms, ruling, rule, said, reasons, change, permissions, kept, then } =
        decision;
    let (stage, outcome) = (ruling.stage(), ruling.outcome());
    out.paragraph("", &format!("{stage}: {outcome} (record {record}, {:.3} s)", *at_ms as f64 / 1000.0))?;
    out.paragraph("  ", &format!("rule  {}: {}", rule.name(), rule.source()))?;
    let said_before = before.map_or(&[][..], |before| &before.said[..]);
    for text in said.iter().filter(|text| !said_before.contains(text)) {
        out.paragraph("  ", &format!("in short  {text}"))?;
    }
    let known = |reason: &&ExplainedReason| before.is_some_and(|before| before.reasons.contains(*reason));
    for reason in reasons.iter().filter(|reason| !known(reason)) {
        let mark = match (&reason.code, reason.in_favour) {
            (None, _) => "-",
            (Some(_), true) => "+",
            (Some(_), false) => "!",
        };
        let code = reason.code.as_ref().map_or_else(String::new, |code| format!("{code}: "));
        let numbers = measured_and_limit(reason.evidence, reason.limit);
        let text = &reason.text;
        out.paragraph("  ", &format!("{mark} {code}{text}{numbers}"))?;
        if let Some(measured) = &reason.measured {
            out.paragraph("      ", measured)?;
        }
        if reason.code.is_some() && !reason.in_favour {
            out.paragraph("      ", &format!("{}: {}", reason.rule.name(), reason.rule.source()))?;
        }
    }
    let repeated = reasons.iter().filter(known).count();
    if let Some(before) = before.filter(|_| repeated > 0) {
        out.paragraph("  ", &format!("= {}", repeated_reasons(repeated, before.record)))?;
    }
    let change_before = before.map_or(&[][..], |before| &before.change[..]);
    for text in change.iter().filter(|text| !change_before.contains(text)) {
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

/// Prints the short form: the reasons first, in at most [`LINES_MAX`] lines.
fn show_summary(
    context: &CliContext,
    mut summary: ExplanationSummary,
    out: &mut CommandOutput<'_>,
) -> Result<(), CliError> {
    // Only a build with the console replays recordings.
    summary.has_recording &= cfg!(feature = "console");
    let data = context.data_given.then(|| context.data.display().to_string());
    let SummaryLines { head, against, details, changes, end, commands } =
        summary_lines(&summary, data.as_deref());
    let block = |indent: &str, text: &str| {
        let mut lines = out.wrapped(indent, text, COLUMNS);
        if lines.len() > TEXT_LINES_MAX {
            lines.truncate(TEXT_LINES_MAX);
            if let Some(last) = lines.last_mut() {
                // The mark takes the place of the last word.
                last.truncate(last.rfind(' ').unwrap_or(0));
                last.push_str(" …");
            }
        }
        lines
    };
    let head = block("", &head);
    let end = if end.is_empty() { Vec::new() } else { block("", &end) };
    let rest: Vec<String> = [&details[..], &changes[..changes.len().min(CHANGES_MAX)]]
        .concat()
        .iter()
        .flat_map(|text| block("", text))
        .chain(end)
        .collect();
    let mut shown = against.len().min(REASONS_MAX);
    let reasons = loop {
        let omitted = against.len() - shown;
        let mut lines: Vec<String> =
            against.iter().take(shown).flat_map(|reason| block("  ", reason)).collect();
        if omitted > 0 {
            lines.extend(block("  ", &omitted_reasons(omitted)));
        }
        if shown <= 1 || head.len() + lines.len() + rest.len() + commands.len() <= LINES_MAX {
            break lines;
        }
        shown -= 1;
    };
    for line in head.iter().chain(&reasons).chain(&rest) {
        out.line(line)?;
    }
    for command in commands {
        out.line(&format!("next: {command}"))?;
    }
    Ok(())
}
