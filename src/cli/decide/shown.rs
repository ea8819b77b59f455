//! What is told about a decision before it is signed: it goes on record with the decision, word for word.

use std::io::Write;

use crate::cli::output::Output;
use crate::error::CliError;
use holdpoint_protocol::snapshot::{PromptView, Purpose};
use holdpoint_text::{WIDTH_MAX, sanitise};

/// Tells the decision, and answers what was told. With `--json` it goes beside the answer, which is one document.
pub(super) fn told(prompt: &PromptView, out: &mut Output<'_>) -> Result<String, CliError> {
    let lines = lines(prompt);
    if out.is_json() {
        let mut stderr = std::io::stderr().lock();
        lines.iter().try_for_each(|line| writeln!(stderr, "{line}"))?;
    } else {
        lines.iter().try_for_each(|line| out.line(line))?;
        // Before a passphrase is asked for.
        out.flush()?;
    }
    Ok(lines.join("\n"))
}

fn lines(prompt: &PromptView) -> Vec<String> {
    let PromptView { version, evidence, profile, author, needed, .. } = prompt;
    let asked = match prompt.purpose {
        Purpose::Activation => format!("Promote {version} to active, profile {profile}?"),
        Purpose::Release => format!("Release {version}: lift its restriction?"),
        Purpose::Review => format!("Was it right to let {version} in alone, in an emergency?"),
        Purpose::Emergency => format!("EMERGENCY: let {version} in alone, profile {profile}?"),
    };
    let listed = |items: &[String]| if items.is_empty() { "none".to_owned() } else { items.join(", ") };
    let replaces = prompt.replaces.as_ref().map_or_else(|| "nothing".to_owned(), ToString::to_string);
    let mut lines = vec![
        asked,
        format!("Evidence {}, candidate {}; made by {author}", evidence.short(), prompt.candidate.short()),
        format!(
            "In place of {replaces}; {needed} people are needed, approved by {}",
            listed(&prompt.approved_by)
        ),
        format!("New permissions: {}", listed(&prompt.new_permissions)),
    ];
    lines.extend(prompt.changes.lines().iter().map(|line| format!("Change: {line}")));
    lines.extend(prompt.conditions.iter().map(|condition| format!("Condition: {condition}")));
    lines.extend(prompt.why.iter().map(|line| format!("Why: {line}")));
    lines.extend(prompt.untested.iter().map(|line| format!("Not tested: {line}")));
    lines.push(format!("If things get worse: {}", prompt.on_drift));
    if !prompt.about.is_empty() && prompt.about != prompt.on_drift {
        lines.push(prompt.about.clone());
    }
    lines.into_iter().map(|line| sanitise(&line, WIDTH_MAX).into_string()).collect()
}
