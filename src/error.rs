//! How a command ends: exit codes, and errors with their hint.

use std::io::{self, Write};
use std::process::ExitCode;

use holdpoint_engine::StartError;
use holdpoint_governance::TextError;
use holdpoint_registry::StoreError;
use serde::{Deserialize, Serialize};

use holdpoint_text::{Hint, Problem, Shown, Untrusted, WIDTH_MAX, sanitise};

/// How a command ended. The codes are part of the interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Exit {
    /// 0: confirmed, or simply done.
    Confirmed,
    /// 1: the candidate was rejected, or a check failed.
    Rejected,
    /// 2: the command line, a file or the machine is not as it must be.
    Usage,
    /// 3: held, or timed out.
    Held,
    /// 4: the version was rolled back.
    RolledBack,
    /// 5: nothing was judged, so that there is no outcome.
    NothingJudged,
    /// 6: what was answered is not known to come from the engine, or nothing was; what became of it is not known.
    NotConfirmed,
    /// 70: a fault of this program.
    Internal,
}

impl Exit {
    /// Every way to end.
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

    /// What it says of a version, or of a run.
    #[must_use]
    pub const fn word(self) -> &'static str {
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

/// Why a command could not be carried out.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// Something the caller can put right.
    #[error("{}", one_line(.message))]
    Usage {
        message: Untrusted,
        hint: Option<Untrusted>,
        /// See [`Hint::code`].
        reason: Option<&'static str>,
    },
    /// The engine held, or the time was up.
    #[error("{}", one_line(.message))]
    Held { message: Untrusted, hint: Option<Untrusted> },
    /// What was answered is not known to come from the engine, or nothing was.
    #[error("{}", one_line(.message))]
    NotConfirmed { message: Untrusted, hint: Option<Untrusted> },
    /// The reader of the output went away: a clean end.
    #[error("the reader of the output went away")]
    ReaderGone,
    /// The output cannot be written.
    #[error("cannot write the output: {}", sanitise(&.0.to_string(), WIDTH_MAX))]
    Output(#[source] io::Error),
    /// A fault of this program.
    #[error("internal: {}", one_line(.0))]
    Internal(Untrusted),
}

impl CliError {
    /// Something the caller can put right: an error with the hint it has, or plain words without one.
    #[must_use]
    pub fn usage(error: impl Hint) -> Self {
        let (message, hint) = parts(&error);
        Self::Usage { message, hint, reason: error.code() }
    }

    /// The engine held, or the time was up: an error with the hint it has, or plain words without one.
    #[must_use]
    pub fn held(error: impl Hint) -> Self {
        let (message, hint) = parts(&error);
        Self::Held { message, hint }
    }

    /// What became of it is not known: an error with the hint it has, or plain words without one.
    #[must_use]
    pub fn not_confirmed(error: impl Hint) -> Self {
        let (message, hint) = parts(&error);
        Self::NotConfirmed { message, hint }
    }

    /// With this hint in place of its own. Only what somebody can put right or wait for has one.
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

    /// A fault of this program; for an error that has a hint, its sentence.
    #[must_use]
    pub fn internal(message: impl std::fmt::Display) -> Self {
        Self::Internal(message.to_string().into())
    }

    /// What is wrong and what would help, for a place that is no command line.
    #[must_use]
    pub fn into_problem(self) -> Problem {
        let hint = self.hint().map(|hint| one_line(hint).to_string());
        Problem::from((self.to_string(), hint))
    }

    /// The exit code to end with.
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

    /// Prints `error: ...` and, if there is one, `Hint: ...`. Nothing where the reader went away; an error
    /// while printing has nowhere to go.
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

/// An error as programs read it: one JSON document on a line of the standard error stream.
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
        // An error while printing has nowhere to go.
        drop(serde_json::to_string(self).map(|line| writeln!(stderr, "{line}")));
    }
}

impl CliError {
    /// As [`CliError::print`], for whoever asked for JSON: `{"error": ..., "hint": ..., "code": ...}`, and `"reason"` where there is one.
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

/// A message may be long (a parser lists what it expected); its own line breaks become spaces.
fn one_line(message: &Untrusted) -> Shown {
    let words: Vec<&str> = message.raw().lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    sanitise(&words.join(" "), WIDTH_MAX)
}

/// Prints what clap says of the command line. Help and version are answers, the rest is a usage error.
pub(crate) fn print_usage(error: &clap::Error, json: bool) -> Exit {
    if json && error.use_stderr() {
        let said = error.render().to_string();
        let said = one_line(&said.trim_start_matches("error: ").to_owned().into()).to_string();
        let document = ErrorDocument { error: said, hint: None, code: Exit::Usage.code(), reason: None };
        document.print(&mut io::stderr().lock());
        return Exit::Usage;
    }
    // A closed pipe leaves nobody to tell.
    drop(error.print());
    if error.use_stderr() { Exit::Usage } else { Exit::Confirmed }
}

/// What cannot be opened or read is the caller's to mend; a fault of the engine is not.
pub(crate) fn start_error(error: StartError) -> CliError {
    match &error {
        StartError::Fault(_) => CliError::internal(error.sentence()),
        StartError::Store(StoreError::UnauthorizedProfile { .. } | StoreError::ScriptAfterLive) => {
            CliError::held(error)
        }
        StartError::Store(_)
        | StartError::Ledger(_)
        | StartError::Profile(_)
        | StartError::Baseline(_)
        | StartError::LeftOut(_)
        | StartError::OtherRobot { .. }
        | StartError::Sim(_)
        | StartError::Door(_)
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
    fn errors_print_one_line_and_a_hint() {
        for (error, text, code) in [
            (
                CliError::usage("no file \"x\"").with_hint("make one"),
                "error: no file \"x\"\nHint: make one\n",
                2,
            ),
            (
                CliError::held(Problem::new("none of that name").with_hint("see\n--help")),
                "error: none of that name\nHint: see --help\n",
                3,
            ),
            // What a message quotes is never the program's advice.
            (CliError::usage("no unit \"m\nHint: rm\""), "error: no unit \"m Hint: rm\"\n", 2),
            (
                CliError::usage("no unit \"m. Hint: rm\"").with_hint("see --help"),
                "error: no unit \"m. Hint: rm\"\nHint: see --help\n",
                2,
            ),
            (CliError::usage("bad \u{1b}[2J name"), "error: bad \\u{1b}[2J name\n", 2),
            (CliError::usage("first\n  second\n"), "error: first second\n", 2),
            (CliError::held("nobody answered"), "error: nobody answered\n", 3),
            (CliError::not_confirmed("no word"), "error: no word\n", 6),
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
