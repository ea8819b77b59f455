//! What is told of a question before it is answered: the engine's lines, which are signed, then what nobody signs.

use std::io::Write;

use crate::cli::output::Output;
use crate::error::CliError;
use holdpoint_text::{WIDTH_MAX, sanitise};

/// Tells the question as the engine put it, then how things stand at this moment. With `--json` it goes beside the answer,
/// which is one document.
pub(super) fn told(lines: &[String], live: &[String], out: &mut Output<'_>) -> Result<(), CliError> {
    // What is signed are the lines as they came; what a terminal gets of them moves no cursor.
    let safe = lines.iter().chain(live).map(|line| sanitise(line, WIDTH_MAX).into_string());
    if out.is_json() {
        let mut stderr = std::io::stderr().lock();
        for line in safe {
            writeln!(stderr, "{line}")?;
        }
        return Ok(());
    }
    for line in safe {
        out.line(&line)?;
    }
    // Before a passphrase is asked for.
    out.flush()
}
