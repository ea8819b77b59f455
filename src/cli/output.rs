//! Printing: tables and lines for people, JSON lines for programs.
//!
//! Sanitizes all text, so a caller may pass foreign text unchanged. If the reader goes away (`| head`), the rest is not
//! printed; the verb goes on, so that its exit code stays that of its result.

use std::io::{self, IsTerminal, Write};

use comfy_table::{ContentArrangement, presets};
use serde::Serialize;

use crate::error::CliError;
use holdpoint_text::{ErrorReason, WIDTH_MAX, escape_json, sanitize};

/// The widest cell of a table, in columns.
const CELL_WIDTH_MAX: usize = 160;

/// The narrowest terminal that a table is fitted into; below it lines wrap.
const TABLE_WIDTH_MIN: u16 = 40;

/// The width of text if there is no terminal.
const WRAP_WIDTH: u16 = 80;

/// The version of the JSON that the verbs print, in every document as `json_version`. A changed shape raises it; an added
/// field does not.
pub const JSON_VERSION: u32 = 1;

/// A JSON document with the version in front; what is no object stays as it is.
pub(crate) fn versioned(json: String) -> String {
    match json.strip_prefix('{') {
        Some("}") => format!("{{\"json_version\":{JSON_VERSION}}}"),
        Some(fields) => format!("{{\"json_version\":{JSON_VERSION},{fields}"),
        None => json,
    }
}

/// Characters sanitized at a time; even as escapes they stay below the sanitizer's width.
const PIECE_CHARS: usize = 64;

/// A text in parts of at most [`PIECE_CHARS`] characters.
fn pieces(text: &str) -> impl Iterator<Item = &str> {
    let mut rest = text;
    std::iter::from_fn(move || {
        let end = rest.char_indices().nth(PIECE_CHARS).map_or(rest.len(), |(at, _)| at);
        let (piece, left) = rest.split_at_checked(end)?;
        rest = left;
        (!piece.is_empty()).then_some(piece)
    })
}

pub struct CommandOutput<'a> {
    sink: Box<dyn Write + 'a>,
    json: bool,
    width: Option<u16>,
    /// Whether the reader is gone.
    gone: bool,
}

/// Rows under a header, all of the same length.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TextTable {
    header: Vec<&'static str>,
    rows: Vec<Vec<String>>,
}

impl TextTable {
    /// A table without rows.
    #[must_use]
    pub fn new(header: &[&'static str]) -> Self {
        Self { header: header.to_vec(), rows: Vec::new() }
    }

    /// Adds a row; missing cells are empty, and cells beyond the header are dropped.
    pub fn row<T: Into<String>>(&mut self, cells: impl IntoIterator<Item = T>) {
        let mut row: Vec<String> = cells.into_iter().map(Into::into).take(self.header.len()).collect();
        row.resize(self.header.len(), String::new());
        self.rows.push(row);
    }

    /// Whether there are no rows.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }
}

impl CommandOutput<'static> {
    /// The standard output, locked for each line; tables fit the terminal, if it is one.
    ///
    /// The lock is not kept between lines: the console draws from another thread and would deadlock.
    #[must_use]
    pub fn stdout(json: bool) -> Self {
        let stdout = io::stdout();
        let width = if stdout.is_terminal() {
            terminal_size::terminal_size_of(&stdout).map(|(terminal_size::Width(width), _)| width)
        } else {
            None
        };
        Self { sink: Box::new(stdout), json, width, gone: false }
    }
}

impl<'a> CommandOutput<'a> {
    /// Any other writer, without a width.
    #[must_use]
    pub fn to(sink: impl Write + 'a, json: bool) -> Self {
        Self { sink: Box::new(sink), json, width: None, gone: false }
    }

    /// Whether answers are JSON.
    #[must_use]
    pub const fn is_json(&self) -> bool {
        self.json
    }

    /// Whether the reader is gone: nothing is printed any more.
    #[must_use]
    pub const fn is_gone(&self) -> bool {
        self.gone
    }

    /// Requires that a reader got everything so far: a person must see a text before they sign it.
    ///
    /// # Errors
    /// If the reader is gone, or as [`CommandOutput::line`].
    pub fn require_reader(&mut self) -> Result<(), CliError> {
        self.flush()?;
        if self.gone {
            let text =
                "the reader of the output is gone, so the text to sign was not shown; nothing was signed";
            return Err(CliError::usage(text).with_details(ErrorReason::Output));
        }
        Ok(())
    }

    /// Notes that the reader is gone, which is no error of the verb.
    fn unless_gone(&mut self, written: io::Result<()>) -> Result<(), CliError> {
        match written {
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {
                self.gone = true;
                Ok(())
            }
            written => Ok(written?),
        }
    }

    /// Writes a line of safe text.
    fn put(&mut self, line: std::fmt::Arguments<'_>) -> Result<(), CliError> {
        if self.gone {
            return Ok(());
        }
        let written = writeln!(self.sink, "{line}");
        self.unless_gone(written)
    }

    /// One line for people.
    ///
    /// # Errors
    /// [`CliError::Output`].
    pub fn line(&mut self, text: &str) -> Result<(), CliError> {
        self.put(format_args!("{}", sanitize(text, WIDTH_MAX)))
    }

    /// Text for people, indented and wrapped to the terminal, or to 80 columns if there is none. Lines after the
    /// first are indented by four more columns. Nothing is left out.
    ///
    /// # Errors
    /// As [`CommandOutput::line`].
    pub fn paragraph(&mut self, indent: &str, text: &str) -> Result<(), CliError> {
        for line in self.wrapped(indent, text, WRAP_WIDTH) {
            self.put(format_args!("{line}"))?;
        }
        Ok(())
    }

    /// One line for people; on a terminal it is wrapped between words. One with a command stays whole, so that the command can
    /// be copied.
    ///
    /// # Errors
    /// As [`CommandOutput::line`].
    pub fn wrapped_line(&mut self, text: &str) -> Result<(), CliError> {
        let is_wrapped = self.width.is_some() && !text.contains('`');
        if is_wrapped { self.paragraph("", text) } else { self.line(text) }
    }

    /// The lines of a paragraph, for a caller that counts them; without a terminal they have at most `width` columns.
    #[must_use]
    pub fn wrapped(&self, indent: &str, text: &str, width: u16) -> Vec<String> {
        let width = usize::from(self.width.unwrap_or(width).max(TABLE_WIDTH_MIN));
        let further = format!("{indent}    ");
        let options = textwrap::Options::new(width).initial_indent(indent).subsequent_indent(&further);
        // Foreign text is sanitized before it is measured, in pieces, so that no limit cuts it.
        let safe: String = pieces(text).map(|piece| sanitize(piece, WIDTH_MAX).into_string()).collect();
        textwrap::wrap(&safe, options).iter().map(|line| line.trim_end().to_owned()).collect()
    }

    /// One JSON document on one line, without terminal control characters.
    ///
    /// # Errors
    /// As [`CommandOutput::line`], or [`CliError::Internal`] if the value has no JSON form.
    pub fn json<T: Serialize>(&mut self, value: &T) -> Result<(), CliError> {
        let json = versioned(serde_json::to_string(value).map_err(CliError::internal)?);
        self.put(format_args!("{}", escape_json(&json)))
    }

    /// A table for people.
    ///
    /// # Errors
    /// As [`CommandOutput::line`].
    pub fn table(&mut self, table: &TextTable) -> Result<(), CliError> {
        let mut drawn = comfy_table::Table::new();
        drawn.load_preset(presets::NOTHING);
        match self.width {
            Some(width) if width >= TABLE_WIDTH_MIN => {
                drawn.set_content_arrangement(ContentArrangement::Dynamic).set_width(width);
            }
            Some(_) | None => {
                drawn.set_content_arrangement(ContentArrangement::Disabled);
            }
        }
        drawn.set_header(table.header.iter().map(|title| title.to_uppercase()));
        for row in &table.rows {
            drawn.add_row(row.iter().map(|cell| sanitize(cell, CELL_WIDTH_MAX).into_string()));
        }
        for column in drawn.column_iter_mut() {
            column.set_padding((0, 2));
        }
        for line in drawn.lines() {
            self.put(format_args!("{}", line.trim_end()))?;
        }
        Ok(())
    }

    /// JSON if it was requested, else the output of `show`.
    ///
    /// # Errors
    /// As [`CommandOutput::json`].
    pub fn answer<T: Serialize>(
        &mut self,
        value: &T,
        show: impl FnOnce(&mut Self) -> Result<(), CliError>,
    ) -> Result<(), CliError> {
        if self.json { self.json(value) } else { show(self) }
    }

    /// The writer itself, for writers of safe text (completion scripts, exports).
    pub fn sink(&mut self) -> &mut dyn Write {
        &mut self.sink
    }

    /// Writes the buffered output.
    ///
    /// # Errors
    /// As [`CommandOutput::line`].
    pub fn flush(&mut self) -> Result<(), CliError> {
        if self.gone {
            return Ok(());
        }
        let flushed = self.sink.flush();
        self.unless_gone(flushed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn printed(json: bool, print: impl FnOnce(&mut CommandOutput<'_>) -> Result<(), CliError>) -> String {
        let mut bytes = Vec::new();
        print(&mut CommandOutput::to(&mut bytes, json)).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn tables_are_aligned_and_sanitized() {
        let mut table = TextTable::new(&["name", "state"]);
        table.row(["grasp@1.0.0", "active"]);
        table.row(["漢字\u{202e}\u{1b}[2J", "hidden\nline", "left off"]);
        table.row(["short"]);
        let text = printed(false, |out| out.table(&table));
        assert_eq!(
            text,
            "NAME                   STATE\n\
             grasp@1.0.0            active\n\
             漢字\\u{202e}\\u{1b}[2J  hidden\\u{a}line\n\
             short\n"
        );
    }

    #[test]
    fn paragraphs_are_wrapped_and_complete() {
        let words: Vec<String> = (0..200).map(|i| format!("word{i}")).collect();
        let text = printed(false, |out| out.paragraph("  ", &words.join(" ")));
        assert!(text.lines().all(|line| line.len() <= 80 && line.starts_with("  ")), "{text}");
        assert_eq!(text.split_whitespace().collect::<Vec<_>>(), words);
        assert_eq!(printed(false, |out| out.paragraph("", "a\u{1b}[2Jb")), "a\\u{1b}[2Jb\n");
    }

    #[test]
    fn a_line_is_wrapped_on_a_terminal_alone() {
        let text = "word ".repeat(30).trim_end().to_owned();
        for (width, lines) in [(None, 1), (Some(80), 2)] {
            let mut bytes = Vec::new();
            CommandOutput { width, ..CommandOutput::to(&mut bytes, false) }.wrapped_line(&text).unwrap();
            let shown = String::from_utf8(bytes).unwrap();
            assert_eq!(shown.lines().count(), lines, "{shown}");
            assert!(shown.split_whitespace().all(|word| word == "word"), "{shown}");
        }
        let command = format!("`{text}` starts it");
        let mut bytes = Vec::new();
        CommandOutput { width: Some(80), ..CommandOutput::to(&mut bytes, false) }
            .wrapped_line(&command)
            .unwrap();
        assert_eq!(String::from_utf8(bytes).unwrap(), format!("{command}\n"));
    }

    #[test]
    fn json_is_one_safe_line() {
        let value = serde_json::json!({"reason": "\u{9b}2J\u{202e}"});
        let text = printed(true, |out| out.answer(&value, |out| out.line("never")));
        assert_eq!(text, "{\"json_version\":1,\"reason\":\"\\u009b2J\\u202e\"}\n");
    }

    #[test]
    fn closed_pipe_is_no_error_and_nothing_is_signed_unread() {
        struct ClosedPipe;
        impl Write for ClosedPipe {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(io::ErrorKind::BrokenPipe.into())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let mut out = CommandOutput::to(ClosedPipe, false);
        assert!(!out.is_gone());
        out.line("text").unwrap();
        out.paragraph("", "text").unwrap();
        out.json(&1).unwrap();
        out.flush().unwrap();
        assert!(out.is_gone());
        assert_eq!(out.require_reader().unwrap_err().exit(), crate::error::Exit::Usage);
    }
}
