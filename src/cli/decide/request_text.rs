//! Prints an approval request before the person answers: the engine's signed lines, then the unsigned current
//! state.

use std::io::Write;

use crate::cli::output::CommandOutput;
use crate::error::CliError;
use holdpoint_text::{WIDTH_MAX, sanitize};

/// Prints the request as the engine stated it, then the current state. With `--json` it is part of the one document
/// of the answer.
pub(super) fn print_request(
    lines: &[String],
    live: &[String],
    out: &mut CommandOutput<'_>,
) -> Result<(), CliError> {
    // The signature covers the lines as received; the terminal gets them without control characters.
    let safe = lines.iter().chain(live).map(|line| sanitize(line, WIDTH_MAX).into_string());
    if out.is_json() {
        let mut stderr = std::io::stderr().lock();
        for line in safe {
            writeln!(stderr, "{line}").map_err(CliError::Output)?;
        }
        return Ok(());
    }
    for line in safe {
        out.line(&line)?;
    }
    // Before the prompt for a passphrase.
    out.require_reader()
}
