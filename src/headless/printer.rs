//! Prints events and notes as lines, for people or as JSON.

use std::io::{self, Write};

use crate::error::CliError;
use holdpoint_protocol::event::Event;
use holdpoint_text::ErrorReason;
use holdpoint_wording::event as event_text;

/// Prints; once the reader is gone, nothing more is printed.
pub(super) struct Printer<'a> {
    out: &'a mut dyn Write,
    json: bool,
    gone: bool,
}

impl<'a> Printer<'a> {
    pub(super) const fn new(out: &'a mut dyn Write, json: bool) -> Self {
        Self { out, json, gone: false }
    }

    /// Whether the reader is gone.
    pub(super) const fn is_gone(&self) -> bool {
        self.gone
    }

    fn line(&mut self, line: &str) -> Result<(), CliError> {
        if self.gone {
            return Ok(());
        }
        match writeln!(self.out, "{line}").and_then(|()| self.out.flush()) {
            Ok(()) => Ok(()),
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {
                self.gone = true;
                Ok(())
            }
            Err(error) => {
                Err(CliError::internal(format!("cannot print: {error}")).with_details(ErrorReason::Output))
            }
        }
    }

    pub(super) fn event(&mut self, event: &Event) -> Result<(), CliError> {
        if self.json {
            let line = serde_json::to_string(event).map_err(CliError::internal)?;
            return self.line(&holdpoint_text::escape_json(&line));
        }
        self.line(&event_text::line(event))
    }

    /// An expectation of a scenario that does not hold, as a document among the events; people read it as the error.
    pub(super) fn unmet(&mut self, step: usize, text: &str) -> Result<(), CliError> {
        if !self.json {
            return Ok(());
        }
        let line = serde_json::json!({ "event": "expectation", "step": step, "text": text }).to_string();
        self.line(&holdpoint_text::escape_json(&line))
    }

    /// A note of the run itself, between the events.
    pub(super) fn note(&mut self, text: &str) -> Result<(), CliError> {
        if self.json {
            let line = serde_json::json!({ "event": "note", "text": text }).to_string();
            return self.line(&line);
        }
        self.line(&format!("         {text}"))
    }
}
