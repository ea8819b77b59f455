//! How a command ends: exit codes, and errors with their hint, and their reason for programs.

use std::io::{self, Write};
use std::path::Path;
use std::process::ExitCode;

use crate::cli::output::versioned;
use holdpoint_engine::StartError;
use holdpoint_governance::TextError;
use holdpoint_protocol::command::Refusal;
use holdpoint_service::bootstrap::BootstrapError;
use holdpoint_service::control_socket::ControlSocketError;
use holdpoint_store::StoreError;
use serde::{Deserialize, Serialize};

use holdpoint_text::{
    ErrorDetails, ErrorReason, Hint, Problem, SafeText, Untrusted, WIDTH_MAX, escape_json, sanitize,
    shell_word,
};

macro_rules! exits {
    ($($(#[$doc:meta])* $name:ident = $code:literal, $meaning:literal, $label:literal;)+) => {
        /// How a command ended. The codes are a stable interface.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Exit { $($(#[$doc])* $name),+ }

        impl Exit {
            /// All exit codes.
            pub const ALL: [Self; [$($code),+].len()] = [$(Self::$name),+];

            /// The process's exit code.
            #[must_use]
            pub const fn code(self) -> u8 {
                match self { $(Self::$name => $code),+ }
            }

            /// What the code means, in one line.
            #[must_use]
            pub const fn meaning(self) -> &'static str {
                match self { $(Self::$name => $meaning),+ }
            }

            /// The label of the outcome of a version or a run.
            #[must_use]
            pub const fn outcome_label(self) -> &'static str {
                match self { $(Self::$name => $label),+ }
            }
        }
    };
}

// The code, its meaning, and the label of an outcome.
exits! {
    /// Confirmed, or done.
    Confirmed = 0, "confirmed, or done", "confirmed";
    /// The candidate was rejected, or a check failed.
    Rejected = 1, "the candidate was rejected, or a check failed", "rejected";
    /// The command line, a file or the machine is not as required.
    Usage = 2, "usage: the command line, a file or the machine is not as required", "usage";
    /// On hold, demoted, or timed out.
    Held = 3, "on hold, demoted, or timed out", "held";
    /// The version was rolled back.
    RolledBack = 4, "rolled back", "rolled back";
    /// Nothing was judged, so there is no outcome.
    NothingJudged = 5, "nothing was judged: no version was submitted", "nothing was judged";
    /// The answer is missing, or not authenticated as the engine's; the effect of the request is unknown.
    NotConfirmed = 6, "not confirmed by the engine; the effect of the request is unknown", "not confirmed";
    /// An expectation of a scenario does not hold.
    Unmet = 7, "not as expected: an expectation of the scenario does not hold", "not as expected";
    /// A fault of this program.
    Internal = 70, "internal: a fault of this program", "internal error";
    /// Another process prevents it for now; a later try may succeed.
    Busy = 75, "busy: another process prevents it for now", "busy";
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit.code())
    }
}

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// An expectation of a scenario does not hold.
    #[error("{}", one_line(.message))]
    Unmet { message: Untrusted, hint: Option<Untrusted>, details: ErrorDetails },
    /// An error that the caller can correct.
    #[error("{}", one_line(.message))]
    Usage { message: Untrusted, hint: Option<Untrusted>, details: ErrorDetails },
    /// The version is on hold, or the time limit passed.
    #[error("{}", one_line(.message))]
    Held { message: Untrusted, hint: Option<Untrusted>, details: ErrorDetails },
    /// The answer is missing, or not authenticated as the engine's.
    #[error("{}", one_line(.message))]
    NotConfirmed { message: Untrusted, hint: Option<Untrusted>, details: ErrorDetails },
    /// Another process prevents it for now.
    #[error("{}", one_line(.message))]
    Busy { message: Untrusted, hint: Option<Untrusted>, details: ErrorDetails },
    /// The reader of the output is gone: a clean end.
    #[error("the reader of the output is gone")]
    ReaderGone,
    /// The output cannot be written.
    #[error("cannot write the output: {}", sanitize(&.0.to_string(), WIDTH_MAX))]
    Output(#[source] io::Error),
    /// A fault of this program.
    #[error("internal: {}", one_line(.message))]
    Internal { message: Untrusted, details: ErrorDetails },
}

impl CliError {
    /// An error that the caller can correct, with its hint if it has one. Its reason is `usage` if its type states none.
    #[must_use]
    pub fn usage(error: impl Hint) -> Self {
        let (message, hint, details) = parts(&error, ErrorReason::Usage);
        Self::Usage { message, hint, details }
    }

    /// An expectation does not hold. Its reason is `expectation` if its type states none.
    #[must_use]
    pub fn unmet(error: impl Hint) -> Self {
        let (message, hint, details) = parts(&error, ErrorReason::Expectation);
        Self::Unmet { message, hint, details }
    }

    /// The engine put the version on hold, or the time limit passed; with the hint of the error. Its reason is `not-now`
    /// if its type states none.
    #[must_use]
    pub fn from_engine_fault(error: impl Hint) -> Self {
        let (message, hint, details) = parts(&error, ErrorReason::NotNow);
        Self::Held { message, hint, details }
    }

    /// The effect of the request is unknown; with the hint of the error. Its reason is `not-confirmed` if its type states
    /// none.
    #[must_use]
    pub fn not_confirmed(error: impl Hint) -> Self {
        let (message, hint, details) = parts(&error, ErrorReason::NotConfirmed);
        Self::NotConfirmed { message, hint, details }
    }

    /// Another process prevents it for now; with the hint of the error. Its reason is `not-now` if its type states none.
    #[must_use]
    pub fn busy(error: impl Hint) -> Self {
        let (message, hint, details) = parts(&error, ErrorReason::NotNow);
        Self::Busy { message, hint, details }
    }

    /// A fault of this program, with the sentence of the error that showed it.
    #[must_use]
    pub fn internal(message: impl std::fmt::Display) -> Self {
        Self::Internal { message: message.to_string().into(), details: ErrorReason::Internal.into() }
    }

    /// As [`CliError::internal`], with the error's hint in the sentence and its own reason.
    #[must_use]
    pub fn fault(error: impl Hint) -> Self {
        let details = error.details().unwrap_or_else(|| ErrorReason::Internal.into());
        Self::Internal { message: error.sentence().into(), details }
    }

    /// Replaces the hint. Only errors that the caller can correct or wait for have one.
    #[must_use]
    pub fn with_hint(self, help: impl Into<Untrusted>) -> Self {
        let hint = Some(help.into());
        match self {
            Self::Unmet { message, hint: _, details } => Self::Unmet { message, hint, details },
            Self::Usage { message, hint: _, details } => Self::Usage { message, hint, details },
            Self::Held { message, hint: _, details } => Self::Held { message, hint, details },
            Self::NotConfirmed { message, hint: _, details } => Self::NotConfirmed { message, hint, details },
            Self::Busy { message, hint: _, details } => Self::Busy { message, hint, details },
            Self::ReaderGone | Self::Output(_) | Self::Internal { .. } => self,
        }
    }

    /// Adds `--data` to each command in the hint, so that it runs on the named store as pasted.
    #[must_use]
    pub fn with_store_in_hint(self, folder: &Path) -> Self {
        let Some(hint) = self.hint() else { return self };
        let option = format!(" --data {}", shell_word(&folder.to_string_lossy()));
        let mut text = String::new();
        for (index, part) in hint.raw().split('`').enumerate() {
            if index > 0 {
                text.push('`');
            }
            text.push_str(part);
            let is_command = index % 2 == 1 && part.starts_with("holdpoint ");
            if is_command && !part.contains("--data") && !part.contains(" help") {
                text.push_str(&option);
            }
        }
        self.with_hint(text)
    }

    /// Replaces the reason and its values. An error of the output keeps its own.
    #[must_use]
    pub fn with_details(self, new: impl Into<ErrorDetails>) -> Self {
        let details = new.into();
        match self {
            Self::Unmet { message, hint, details: _ } => Self::Unmet { message, hint, details },
            Self::Usage { message, hint, details: _ } => Self::Usage { message, hint, details },
            Self::Held { message, hint, details: _ } => Self::Held { message, hint, details },
            Self::NotConfirmed { message, hint, details: _ } => Self::NotConfirmed { message, hint, details },
            Self::Busy { message, hint, details: _ } => Self::Busy { message, hint, details },
            Self::Internal { message, details: _ } => Self::Internal { message, details },
            Self::ReaderGone | Self::Output(_) => self,
        }
    }

    /// The reason `bad-file`, about this file or folder.
    #[must_use]
    pub fn with_bad_file(self, path: &Path) -> Self {
        self.with_details(ErrorDetails::of_path(ErrorReason::BadFile, path))
    }

    /// The reason `cannot-write`, about this file or folder; `exists` if a file is in its place.
    #[must_use]
    pub fn with_unwritable(self, path: &Path, error: &io::Error) -> Self {
        let exists = error.kind() == io::ErrorKind::AlreadyExists;
        let reason = if exists { ErrorReason::Exists } else { ErrorReason::CannotWrite };
        self.with_details(ErrorDetails::of_path(reason, path))
    }

    /// What a program reads of it; absent if nothing is printed.
    #[must_use]
    pub fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Unmet { details, .. }
            | Self::Usage { details, .. }
            | Self::Held { details, .. }
            | Self::NotConfirmed { details, .. }
            | Self::Busy { details, .. }
            | Self::Internal { details, .. } => Some(details.clone()),
            Self::Output(_) => Some(ErrorReason::Output.into()),
            Self::ReaderGone => None,
        }
    }

    /// The error and its hint in one line, for a place other than the command line.
    #[must_use]
    pub fn into_problem(self) -> Problem {
        let hint = self.hint().map(|hint| one_line(hint).to_string());
        let problem = Problem::from((self.to_string(), hint));
        match self.details() {
            Some(details) => problem.with_details(details),
            None => problem,
        }
    }

    /// The exit code.
    #[must_use]
    pub const fn exit(&self) -> Exit {
        match self {
            Self::Unmet { .. } => Exit::Unmet,
            Self::Usage { .. } | Self::Output(_) => Exit::Usage,
            Self::Held { .. } => Exit::Held,
            Self::NotConfirmed { .. } => Exit::NotConfirmed,
            Self::Busy { .. } => Exit::Busy,
            Self::ReaderGone => Exit::Confirmed,
            Self::Internal { .. } => Exit::Internal,
        }
    }

    #[must_use]
    pub const fn hint(&self) -> Option<&Untrusted> {
        match self {
            Self::Unmet { hint, .. }
            | Self::Usage { hint, .. }
            | Self::Held { hint, .. }
            | Self::NotConfirmed { hint, .. }
            | Self::Busy { hint, .. } => hint.as_ref(),
            Self::ReaderGone | Self::Output(_) | Self::Internal { .. } => None,
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

/// An error for programs: one JSON document on a line of standard error. The guide's page `errors-and-exit-codes` lists the
/// reasons.
#[derive(Serialize, Deserialize)]
pub(crate) struct ErrorDocument {
    pub(crate) error: String,
    pub(crate) hint: Option<String>,
    /// The exit code.
    code: u8,
    /// The name of an [`ErrorReason`]; empty in a document of an earlier version.
    #[serde(default)]
    pub(crate) reason: String,
    /// See [`ErrorDetails::cause`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cause: Option<String>,
    /// See [`ErrorDetails::place`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    file: Option<String>,
    /// The field in the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    field: Option<String>,
}

impl ErrorDocument {
    fn new(error: String, hint: Option<String>, code: u8, details: ErrorDetails) -> Self {
        let ErrorDetails { reason, cause, place } = details;
        let (reason, cause) = (reason.name().to_owned(), cause.map(ToOwned::to_owned));
        let text = |text: &Untrusted| text.raw().to_owned();
        let file = place.as_ref().map(|place| text(&place.file));
        let field = place.as_ref().and_then(|place| place.field.as_ref().map(text));
        Self { error, hint, code, reason, cause, file, field }
    }

    fn print(&self, stderr: &mut dyn Write) {
        // No other channel is left for an error while printing.
        drop(serde_json::to_string(self).map(|line| writeln!(stderr, "{}", escape_json(&versioned(line)))));
    }
}

impl CliError {
    /// Prints the error as JSON: `{"json_version": ..., "error": ..., "hint": ..., "code": ..., "reason": ...}`, and
    /// `"cause"`, `"file"` and `"field"` if they are known.
    pub fn print_json(&self, stderr: &mut dyn Write) {
        let Some(details) = self.details() else { return };
        let hint = self.hint().map(|hint| one_line(hint).to_string());
        ErrorDocument::new(self.to_string(), hint, self.exit().code(), details).print(stderr);
    }
}

/// The reason of an engine's refusal: the same name as in the reply.
pub(crate) const fn refusal_reason(code: Refusal) -> ErrorReason {
    match code {
        Refusal::BadInput => ErrorReason::BadInput,
        Refusal::NotFound => ErrorReason::NotFound,
        Refusal::Exists => ErrorReason::Exists,
        Refusal::NotNow => ErrorReason::NotNow,
        Refusal::Stale => ErrorReason::Stale,
        Refusal::NotAllowed => ErrorReason::NotAllowed,
        Refusal::Store => ErrorReason::Store,
        Refusal::Holding => ErrorReason::Holding,
        Refusal::NoAnswer => ErrorReason::NoAnswer,
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

/// Message, hint, and details; `default` is the reason of an error whose type states none.
fn parts(error: &impl Hint, default: ErrorReason) -> (Untrusted, Option<Untrusted>, ErrorDetails) {
    let details = error.details().unwrap_or_else(|| default.into());
    (error.to_string().into(), error.hint().map(|hint| hint.into_owned().into()), details)
}

/// One line of a message: line breaks become spaces, and the length is limited.
fn one_line(message: &Untrusted) -> SafeText {
    let lines: Vec<&str> = message.raw().lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    sanitize(&lines.join(" "), WIDTH_MAX)
}

/// Prints what clap reports of the command line. Help and version are answers; the rest is a usage error.
#[must_use]
pub fn print_usage(error: &clap::Error, json: bool) -> Exit {
    if json && error.use_stderr() {
        let text = error.render().to_string();
        let message = one_line(&text.trim_start_matches("error: ").to_owned().into()).to_string();
        let document = ErrorDocument::new(message, None, Exit::Usage.code(), ErrorReason::Usage.into());
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
        StartError::Fault(_) => CliError::fault(error),
        StartError::Store(StoreError::UnauthorizedProfile { .. } | StoreError::ScriptAfterLive) => {
            CliError::from_engine_fault(error)
        }
        StartError::Store(_)
        | StartError::VersionTable(_)
        | StartError::Profile(_)
        | StartError::Baseline(_)
        | StartError::Omitted(_)
        | StartError::OtherRobot { .. }
        | StartError::Cell(_) => CliError::usage(error),
    }
}

/// As [`start_error`], for an engine that starts behind its socket.
pub(crate) fn bootstrap_error(error: BootstrapError) -> CliError {
    match error {
        BootstrapError::Start(error) => start_error(error),
        BootstrapError::Socket(ControlSocketError::Locked { .. }) => CliError::busy(error),
        BootstrapError::Socket(_) | BootstrapError::Thread(_) => CliError::usage(error),
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
    fn an_error_in_json_keeps_its_reason_and_values_through_every_layer() {
        let json = |error: &CliError| -> serde_json::Value {
            let mut out = Vec::new();
            error.print_json(&mut out);
            serde_json::from_slice(&out).unwrap()
        };
        let in_use = StoreError::InUse { path: "/data".into(), owner: "process 7".to_owned() };
        let document = json(&start_error(StartError::Store(in_use)));
        assert_eq!((&document["reason"], &document["file"]), (&"store-in-use".into(), &"/data".into()));
        let value = TextError::value("own.toml", "", "approval.quorum_low", "0", "1 to 16");
        let document = json(&CliError::from(value));
        assert_eq!(
            (&document["reason"], &document["file"], &document["field"]),
            (&"bad-file".into(), &"own.toml".into(), &"approval.quorum_low".into())
        );
        // A path is the same text in JSON, without characters that a terminal acts on.
        let mut out = Vec::new();
        CliError::usage("bad").with_bad_file(Path::new("a\u{202e}b")).print_json(&mut out);
        assert!(out.is_ascii(), "{out:?}");
        let document: serde_json::Value = serde_json::from_slice(&out).unwrap();
        assert_eq!(document["file"], "a\u{202e}b");
        // An error without a type of its own has the reason of its exit code.
        for (error, reason) in [
            (CliError::usage("text"), "usage"),
            (CliError::from_engine_fault("text"), "not-now"),
            (CliError::not_confirmed("text"), "not-confirmed"),
            (CliError::internal("text"), "internal"),
            (CliError::from(io::Error::other("disk full")), "output"),
            (
                CliError::usage(CliError::usage("text").with_details(ErrorReason::Stale).into_problem()),
                "stale",
            ),
        ] {
            assert_eq!(json(&error)["reason"], reason, "{error}");
        }
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
            (CliError::unmet("step 2: it is not so"), "error: step 2: it is not so\n", 7),
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
    fn commands_in_a_hint_repeat_the_named_store() {
        let error = CliError::usage("text")
            .with_hint("`holdpoint status` shows it, `ls -l` or `holdpoint help go` too");
        let hint = error.with_store_in_hint(Path::new("my store")).hint().unwrap().raw().to_owned();
        assert_eq!(hint, "`holdpoint status --data 'my store'` shows it, `ls -l` or `holdpoint help go` too");
        let named = CliError::usage("text").with_hint("`holdpoint status --data x`");
        assert_eq!(
            named.with_store_in_hint(Path::new("y")).hint().unwrap().raw(),
            "`holdpoint status --data x`"
        );
    }

    #[test]
    fn exit_codes_are_distinct() {
        let codes: std::collections::BTreeSet<u8> = Exit::ALL.into_iter().map(Exit::code).collect();
        assert_eq!(codes.into_iter().collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5, 6, 7, 70, 75]);
    }
}
