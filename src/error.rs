//! How a command ends: exit codes, and errors with their hint.

use std::io::{self, Write};
use std::process::ExitCode;

use crate::cli::output::versioned;
use holdpoint_engine::StartError;
use holdpoint_governance::TextError;
use holdpoint_registry::StoreError;
use serde::{Deserialize, Serialize};

use holdpoint_text::{Hint, Problem, SafeText, Untrusted, WIDTH_MAX, sanitize};

/// How a command ended. The codes are a stable interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Exit {
    /// 0: confirmed, or done.
    Confirmed,
    /// 1: the candidate was rejected, or a check failed.
    Rejected,
    /// 2: the command line, a file or the machine is not as required.
    Usage,
    /// 3: on hold, or timed out.
    Held,
    /// 4: the version was rolled back.
    RolledBack,
    /// 5: nothing was judged, so there is no outcome.
    NothingJudged,
    /// 6: the answer is missing, or not authenticated as the engine's; the effect of the request is unknown.
    NotConfirmed,
    /// 70: a fault of this program.
    Internal,
}

impl Exit {
    /// All exit codes.
    pub const ALL: [Self; 8] = [
        Self::Confirmed,
        Self::Rejected,
        Self::Usage,
        Self::Held,
        Self::RolledBack,
        Self::NothingJudged,
        Self::NotConfirmed,
        Self::Internal,
    ];

    /// The process's exit code.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Confirmed => 0,
            Self::Rejected => 1,
            Self::Usage => 2,
            Self::Held => 3,
            Self::RolledBack => 4,
            Self::NothingJudged => 5,
            Self::NotConfirmed => 6,
            Self::Internal => 70,
        }
    }

    /// The label of the outcome of a version or a run.
    #[must_use]
    pub const fn outcome_label(self) -> &'static str {
        match self {
            Self::Confirmed => "confirmed",
            Self::Rejected => "rejected",
            Self::Usage => "usage",
            Self::Held => "held",
            Self::RolledBack => "rolled back",
            Self::NothingJudged => "nothing was judged",
            Self::NotConfirmed => "not confirmed",
            Self::Internal => "internal error",
        }
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit.code())
    }
}

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// An error that the caller can correct.
    #[error("{}", one_line(.message))]
    Usage {
        message: Untrusted,
        hint: Option<Untrusted>,
        /// See [`Hint::code`].
        reason: Option<&'static str>,
    },
    /// The version is on hold, or the time limit passed.
    #[error("{}", one_line(.message))]
    Held { message: Untrusted, hint: Option<Untrusted> },
    /// The answer is missing, or not authenticated as the engine's.
    #[error("{}", one_line(.message))]
    NotConfirmed { message: Untrusted, hint: Option<Untrusted> },
    /// The reader of the output is gone: a clean end.
    #[error("the reader of the output is gone")]
    ReaderGone,
    /// The output cannot be written.
    #[error("cannot write the output: {}", sanitize(&.0.to_string(), WIDTH_MAX))]
    Output(#[source] io::Error),
    /// A fault of this program.
    #[error("internal: {}", one_line(.0))]
    Internal(Untrusted),
}

impl CliError {
    /// An error that the caller can correct, with its hint if it has one.
    #[must_use]
    pub fn usage(error: impl Hint) -> Self {
        let (message, hint) = parts(&error);
        Self::Usage { message, hint, reason: error.code() }
    }

    /// The engine put the version on hold, or the time limit passed; with the hint of the error.
    #[must_use]
    pub fn from_engine_fault(error: impl Hint) -> Self {
        let (message, hint) = parts(&error);
        Self::Held { message, hint }
    }

    /// The effect of the request is unknown; with the hint of the error.
    #[must_use]
    pub fn not_confirmed(error: impl Hint) -> Self {
        let (message, hint) = parts(&error);
        Self::NotConfirmed { message, hint }
    }

    /// Replaces the hint. Only errors that the caller can correct or wait for have one.
    #[must_use]
    pub fn with_hint(self, help: impl Into<Untrusted>) -> Self {
        let hint = Some(help.into());
        match self {
            Self::Usage { message, hint: _, reason } => Self::Usage { message, hint, reason },
            Self::Held { message, hint: _ } => Self::Held { message, hint },
            Self::NotConfirmed { message, hint: _ } => Self::NotConfirmed { message, hint },
            Self::ReaderGone | Self::Output(_) | Self::Internal(_) => self,
        }
    }

    /// A fault of this program, with the sentence of the error that showed it.
    #[must_use]
    pub fn internal(message: impl std::fmt::Display) -> Self {
        Self::Internal(message.to_string().into())
    }

    /// The error and its hint in one line, for a place other than the command line.
    #[must_use]
    pub fn into_problem(self) -> Problem {
        let hint = self.hint().map(|hint| one_line(hint).to_string());
        Problem::from((self.to_string(), hint))
    }

    /// The exit code.
    #[must_use]
    pub const fn exit(&self) -> Exit {
        match self {
            Self::Usage { .. } | Self::Output(_) => Exit::Usage,
            Self::Held { .. } => Exit::Held,
            Self::NotConfirmed { .. } => Exit::NotConfirmed,
            Self::ReaderGone => Exit::Confirmed,
            Self::Internal(_) => Exit::Internal,
        }
    }

    #[must_use]
    pub const fn hint(&self) -> Option<&Untrusted> {
        match self {
            Self::Usage { hint, .. } | Self::Held { hint, .. } | Self::NotConfirmed { hint, .. } => {
                hint.as_ref()
            }
            Self::ReaderGone | Self::Output(_) | Self::Internal(_) => None,
        }
    }

    /// Prints `error: ...` and, if there is one, `Hint: ...`; nothing if the reader of the output is gone. Ignores
    /// errors while printing: no other channel is left.
    pub fn print(&self, stderr: &mut dyn Write) {
        if matches!(self, Self::ReaderGone) {
            return;
        }
        let written = writeln!(stderr, "error: {self}").and_then(|()| match self.hint() {
            Some(hint) => writeln!(stderr, "{}", hint_line(hint)),
            None => Ok(()),
        });
        drop(written);
    }
}

/// An error for programs: one JSON document on a line of standard error.
#[derive(Serialize, Deserialize)]
pub(crate) struct ErrorDocument {
    pub(crate) error: String,
    pub(crate) hint: Option<String>,
    /// The exit code.
    code: u8,
    /// See [`Hint::code`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) reason: Option<String>,
}

impl ErrorDocument {
    fn print(&self, stderr: &mut dyn Write) {
        // No other channel is left for an error while printing.
        drop(serde_json::to_string(self).map(|line| writeln!(stderr, "{}", versioned(line))));
    }
}

impl CliError {
    /// Prints the error as JSON: `{"json_version": ..., "error": ..., "hint": ..., "code": ...}`, and `"reason"` if there is
    /// one.
    pub fn print_json(&self, stderr: &mut dyn Write) {
        if matches!(self, Self::ReaderGone) {
            return;
        }
        let hint = self.hint().map(|hint| one_line(hint).to_string());
        let reason = if let Self::Usage { reason, .. } = self { reason.map(ToOwned::to_owned) } else { None };
        ErrorDocument { error: self.to_string(), hint, code: self.exit().code(), reason }.print(stderr);
    }
}

impl From<io::Error> for CliError {
    fn from(error: io::Error) -> Self {
        if error.kind() == io::ErrorKind::BrokenPipe { Self::ReaderGone } else { Self::Output(error) }
    }
}

impl From<TextError> for CliError {
    fn from(error: TextError) -> Self {
        Self::usage(error)
    }
}

/// A hint on a line of its own.
pub(crate) fn hint_line(hint: &Untrusted) -> String {
    format!("Hint: {}", one_line(hint))
}

fn parts(error: &impl Hint) -> (Untrusted, Option<Untrusted>) {
    (error.to_string().into(), error.hint().map(|hint| hint.into_owned().into()))
}

/// One line of a message: line breaks become spaces, and the length is limited.
fn one_line(message: &Untrusted) -> SafeText {
    let lines: Vec<&str> = message.raw().lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    sanitize(&lines.join(" "), WIDTH_MAX)
}

/// Prints what clap reports of the command line. Help and version are answers; the rest is a usage error.
pub(crate) fn print_usage(error: &clap::Error, json: bool) -> Exit {
    if json && error.use_stderr() {
        let text = error.render().to_string();
        let message = one_line(&text.trim_start_matches("error: ").to_owned().into()).to_string();
        let document = ErrorDocument { error: message, hint: None, code: Exit::Usage.code(), reason: None };
        document.print(&mut io::stderr().lock());
        return Exit::Usage;
    }
    // A closed pipe leaves no reader.
    drop(error.print());
    if error.use_stderr() { Exit::Usage } else { Exit::Confirmed }
}

/// The caller can correct a file that cannot be opened or read; other faults are the engine's.
pub(crate) fn start_error(error: StartError) -> CliError {
    match &error {
        StartError::Fault(_) => CliError::internal(error.sentence()),
        StartError::Store(StoreError::UnauthorizedProfile { .. } | StoreError::ScriptAfterLive) => {
            CliError::from_engine_fault(error)
        }
        StartError::Store(_)
        | StartError::VersionTable(_)
        | StartError::Profile(_)
        | StartError::Baseline(_)
        | StartError::Omitted(_)
        | StartError::OtherRobot { .. }
        | StartError::Sim(_)
        | StartError::Socket(_)
        | StartError::Thread(_) => CliError::usage(error),
    }
}

#[cfg(test)]
mod tests {
    use holdpoint_text::Problem;

    use super::*;

    fn printed(error: &CliError) -> String {
        let mut out = Vec::new();
        error.print(&mut out);
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn an_error_in_json_begins_with_the_version() {
        let mut out = Vec::new();
        CliError::usage("no file").print_json(&mut out);
        let document: serde_json::Value = serde_json::from_slice(&out).unwrap();
        assert_eq!(
            (&document["json_version"], &document["code"]),
            (&crate::cli::output::JSON_VERSION.into(), &2.into())
        );
        assert!(out.starts_with(b"{\"json_version\":"));
    }

    #[test]
    fn errors_print_one_line_and_a_hint() {
        for (error, text, code) in [
            (
                CliError::usage("no file \"x\"").with_hint("make one"),
                "error: no file \"x\"\nHint: make one\n",
                2,
            ),
            (
                CliError::from_engine_fault(Problem::new("none of that name").with_hint("see\n--help")),
                "error: none of that name\nHint: see --help\n",
                3,
            ),
            // Text that a message quotes never becomes the program's hint.
            (CliError::usage("no unit \"m\nHint: rm\""), "error: no unit \"m Hint: rm\"\n", 2),
            (
                CliError::usage("no unit \"m. Hint: rm\"").with_hint("see --help"),
                "error: no unit \"m. Hint: rm\"\nHint: see --help\n",
                2,
            ),
            (CliError::usage("bad \u{1b}[2J name"), "error: bad \\u{1b}[2J name\n", 2),
            (CliError::usage("first\n  second\n"), "error: first second\n", 2),
            (CliError::from_engine_fault("no answer"), "error: no answer\n", 3),
            (CliError::not_confirmed("no reply"), "error: no reply\n", 6),
            (CliError::internal("lost"), "error: internal: lost\n", 70),
            (CliError::from(io::Error::from(io::ErrorKind::BrokenPipe)), "", 0),
            (CliError::from(io::Error::other("disk full")), "error: cannot write the output: disk full\n", 2),
        ] {
            assert_eq!(printed(&error), text);
            assert_eq!(error.exit().code(), code, "{text}");
        }
    }

    #[test]
    fn codes_differ() {
        let codes: std::collections::BTreeSet<u8> = Exit::ALL.into_iter().map(Exit::code).collect();
        assert_eq!(codes.into_iter().collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5, 6, 70]);
    }
}
