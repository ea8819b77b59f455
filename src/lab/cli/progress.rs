//! Progress of an experiment, on standard error.

use std::io::Write as _;

use holdpoint_text::{WIDTH_MAX, sanitize};

/// Prints a line of progress. Progress is only information: losing it loses no result.
pub(super) fn tell(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{}", sanitize(line, WIDTH_MAX));
}

/// The lines of a printed report, each with one blank between its cells.
#[cfg(test)]
pub(super) fn lines_of_cells(printed: &[u8]) -> Vec<String> {
    let cells = |line: &str| line.split_whitespace().map(str::to_owned).collect::<Vec<_>>().join(" ");
    String::from_utf8_lossy(printed).lines().map(cells).collect()
}
