//! What an error is, for programs: a code of a closed set, and the values that belong to it.
//!
//! An error type states its details beside its sentence, so no layer has to read the sentence.

use std::path::Path;

use crate::Untrusted;

/// Makes the set with its list and its names.
macro_rules! error_reasons {
    ($($(#[$doc:meta])* $member:ident = $name:literal),+ $(,)?) => {
        /// The kind of an error of a verb. The names are a stable interface.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum ErrorReason { $($(#[$doc])* $member),+ }

        impl ErrorReason {
            /// All reasons, in the order of the guide's table.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$member),+];

            /// The name in JSON.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$member => $name),+ }
            }
        }
    };
}

error_reasons! {
    /// An argument or an option is not allowed.
    Usage = "usage",
    /// A value in a request is not allowed.
    BadInput = "bad-input",
    /// A file or a folder cannot be read, or its content is not allowed.
    BadFile = "bad-file",
    /// A file or a folder cannot be written.
    CannotWrite = "cannot-write",
    /// The version, family, person, record or file does not exist.
    NotFound = "not-found",
    /// It exists already, and nothing replaces it.
    Exists = "exists",
    /// The present state does not allow it.
    NotNow = "not-now",
    /// It covers something that has changed since.
    Stale = "stale",
    /// The person, or the person's role or key, may not do it.
    NotAllowed = "not-allowed",
    /// A passphrase is missing, wrong or not allowed.
    Passphrase = "passphrase",
    /// The ssh-agent cannot be used, or does not sign.
    SshAgent = "ssh-agent",
    /// An administrator must authorize the profile first.
    ProfileNotAuthorized = "profile-not-authorized",
    /// A script may not use a store that an engine used for a real cell.
    ScriptAfterLive = "script-after-live",
    /// The store is for another robot.
    OtherRobot = "other-robot",
    /// The seeds of the store are secret; none can be chosen.
    SecretSeeds = "secret-seeds",
    /// The folder has no store.
    NoStore = "no-store",
    /// Another process has the store open.
    StoreInUse = "store-in-use",
    /// The store's files are not accepted, and stay unchanged.
    StoreRefused = "store-refused",
    /// Another program wrote to the store meanwhile.
    StoreAltered = "store-altered",
    /// The store could not be read or written.
    Store = "store",
    /// The engine is halted after a fault of its own.
    Holding = "holding",
    /// No engine answered.
    NoAnswer = "no-answer",
    /// The answer is missing, or not authenticated as the engine's.
    NotConfirmed = "not-confirmed",
    /// The engine's socket cannot be opened or used.
    ControlSocket = "control-socket",
    /// The compiler for a skill is missing, or failed.
    Toolchain = "toolchain",
    /// The machine lacks something: a terminal, a display, a program, a variable, a thread.
    Environment = "environment",
    /// It was done, and no version of the family is active any more.
    SafeStopped = "safe-stopped",
    /// The time limit passed.
    TimedOut = "timed-out",
    /// An expectation of the scenario does not hold.
    Expectation = "expectation",
    /// The user or a signal ended it.
    Interrupted = "interrupted",
    /// The output cannot be written.
    Output = "output",
    /// A fault of this program.
    Internal = "internal",
}

/// The values of an error for programs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ErrorDetails {
    pub reason: ErrorReason,
    /// The finer cause: a name of the closed set that belongs to the reason.
    pub cause: Option<&'static str>,
    /// The file or folder that the error is about, if it is known.
    pub place: Option<Box<FilePlace>>,
}

/// A file, and a field in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilePlace {
    pub file: Untrusted,
    pub field: Option<Untrusted>,
}

impl From<ErrorReason> for ErrorDetails {
    fn from(reason: ErrorReason) -> Self {
        Self { reason, cause: None, place: None }
    }
}

impl ErrorDetails {
    /// An error about a file, as the message names it.
    #[must_use]
    pub fn of_file(reason: ErrorReason, file: impl Into<Untrusted>) -> Self {
        let place = Some(Box::new(FilePlace { file: file.into(), field: None }));
        Self { reason, cause: None, place }
    }

    /// An error about the file or folder of this path.
    #[must_use]
    pub fn of_path(reason: ErrorReason, path: &Path) -> Self {
        Self::of_file(reason, path.display().to_string())
    }

    /// An error in a field of a file.
    #[must_use]
    pub fn of_field(file: impl Into<Untrusted>, field: impl Into<Untrusted>) -> Self {
        let place = FilePlace { file: file.into(), field: Some(field.into()) };
        Self { reason: ErrorReason::BadFile, cause: None, place: Some(Box::new(place)) }
    }

    /// With the finer cause.
    #[must_use]
    pub fn with_cause(self, cause: &'static str) -> Self {
        Self { cause: Some(cause), ..self }
    }
}
