//! Errors of the store.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use crate::approval_check::ApprovalFault;
use crate::store_terms::FIRST_ADMINISTRATOR;
use holdpoint_approvals::keyfile::KeyError;
use holdpoint_audit::files::FileError;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint, shell_word};

holdpoint_governance::closed_set! {
    /// Why a database, or a file beside it, is refused. Each cause has its own remedy.
    RefusalCause, "cause of a refusal", {
        /// It is damaged or cut short.
        Damaged = "damaged",
        /// The chain is whole, but the tables do not match it.
        NotTheChain = "not-the-chain",
        /// The chain is whole, but unsigned, or without some of its checkpoints.
        Unsigned = "unsigned",
        /// A rebuild would take unsigned records.
        TakesUnsigned = "takes-unsigned",
        /// An unsigned record changes a profile without an authorization.
        UnsignedProfile = "unsigned-profile",
        /// A witness has a newer or different head.
        Witness = "witness",
        /// The key beside it is not the store's.
        ForeignKey = "foreign-key",
        /// The two halves of the store's key do not match.
        KeyHalves = "key-halves",
        /// Another kind of entry has the name of its log.
        Log = "log",
        /// Another kind of entry has the name of its log's index.
        LogIndex = "log-index",
        /// A journal lies beside a database that has a log.
        Journal = "journal",
        /// A file among the checkpoints is not a checkpoint.
        Checkpoint = "checkpoint",
        /// The telemetry file is invalid.
        Telemetry = "telemetry",
        /// It is no database of this program.
        Foreign = "foreign",
        /// Another version made its schema.
        Schema = "schema",
        /// A newer version may have made its schema.
        NewerSchema = "newer-schema",
    }
}

holdpoint_governance::closed_set! {
    /// Why the store could not be read or written.
    StoreFailure, "failure of the store", {
        /// The system could not open, read or write a file.
        Io = "io",
        /// The database reported an error.
        Database = "database",
        /// The disk is full.
        DiskFull = "disk-full",
        /// A row is longer than any that this program writes.
        RowTooLong = "row-too-long",
        /// The change would violate an invariant of the registry.
        Invariant = "invariant",
        /// The virtual clock went back.
        ClockBack = "clock-back",
        /// The writer ended, and the outcome of the command is unknown.
        OutcomeUnknown = "outcome-unknown",
    }
}

impl RefusalCause {
    /// The remedy, as a hint.
    const fn remedy(self) -> &'static str {
        match self {
            Self::Damaged => "restore the folder from a backup, or choose another one with --data",
            Self::NotTheChain => {
                "`holdpoint store rebuild --from-chain` rebuilds the tables from the audit chain and keeps this file \
                 beside them"
            }
            Self::Unsigned => {
                "put the missing files back from a backup; without one, `holdpoint store rebuild --from-chain` goes \
                 on without them, on record, and names the unsigned records"
            }
            Self::TakesUnsigned => {
                "any program that can write the folder can have written them: restore a backup, or look at them with \
                 `holdpoint audit list` and take them, on record, with --take-unsigned"
            }
            Self::UnsignedProfile => {
                "any program that can write the folder can have written it, and a rebuild cannot take it: put the \
                 store back from a backup"
            }
            Self::Witness => {
                "put the newer store back; if its records are lost, move the witness's files of this store elsewhere \
                 and start again"
            }
            Self::ForeignKey => "put the key that the store was made with back into keys/, from a backup",
            Self::KeyHalves => {
                "put both files back from a backup; if store.key is the right one, remove this file: the next start \
                 derives it again"
            }
            Self::Log => {
                "restore it from a backup, or remove it; the newest records are lost then if they were in it"
            }
            Self::LogIndex => "remove it: SQLite makes it again",
            Self::Journal => {
                "move it elsewhere and look with `holdpoint audit verify` whether anything is missing"
            }
            Self::Checkpoint => {
                "put it back from a backup; if this store never wrote it, move it elsewhere; if the store wrote it \
                 and it is lost, move it elsewhere too, and `holdpoint store rebuild --from-chain` goes on without \
                 it, on record"
            }
            Self::Telemetry => {
                "the next start of an engine quarantines it, and a new file takes over all sealed batches"
            }
            Self::Foreign => {
                "choose another folder with --data; if a store was here, its file is damaged: restore it from a backup"
            }
            Self::Schema => "use the version of holdpoint that wrote it",
            Self::NewerSchema => "use the version of holdpoint that wrote it, or a newer one",
        }
    }
}

/// The longest text of a row, and the longest row, bytes. This program writes shorter ones.
pub const ROW_BYTES_MAX: i32 = 32 << 20;

/// Any failure of the registry, the audit chain or the telemetry file. Nothing was changed, except after
/// [`StoreError::Unknown`]: then the outcome is not known, and the command may be retried with the same id.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    #[error("cannot {what} {path:?}: {source}")]
    Io { what: &'static str, path: PathBuf, source: std::io::Error },
    /// Another user owns the store's folder and does not share it.
    #[error("the store {path:?} belongs to user {owner}, and this process runs as user {own}")]
    OtherUser {
        path: PathBuf,
        /// By name, or by number.
        owner: String,
        own: String,
    },
    #[error("the store {path:?} is in use by {owner}")]
    InUse {
        path: PathBuf,
        /// The first engine: its process id and start.
        owner: String,
    },
    /// The file is foreign, newer than this program, cut short or damaged. It was not modified.
    #[error("{path:?} cannot be opened as a Holdpoint store: {problem}. Nothing was changed")]
    Refused { path: PathBuf, problem: String, cause: RefusalCause },
    #[error("the store could not {what}: {source}")]
    Database { what: &'static str, source: Box<dyn std::error::Error + Send + Sync> },
    /// The disk is full. The transaction was undone.
    #[error("the disk is full: the store could not {what}; nothing was changed")]
    DiskFull { what: &'static str },
    #[error(
        "the store could not {what}: its database has a row of more than {ROW_BYTES_MAX} bytes, and so many are read"
    )]
    RowTooLong { what: &'static str },
    #[error("there is no {what} {name:?} in the store")]
    NotFound {
        /// The kind of entry.
        what: &'static str,
        name: String,
    },
    #[error("the {what} {name:?} is in the store already")]
    Exists { what: &'static str, name: String },
    /// Another command changed the version first.
    #[error("{version} has changed: expected {expected}, found {found}")]
    Stale {
        version: CapabilityId,
        /// State and row version the caller knew.
        expected: String,
        /// State and row version it has.
        found: String,
    },
    #[error("the approval {nonce} cannot be used: {problem}")]
    Approval { nonce: String, problem: ApprovalFault },
    #[error("{name:?} is neither enrolled nor revoked: {problem}")]
    Person { name: String, problem: String },
    /// A family's active pointer was set with another robot.
    #[error("{family} was made active with the robot {recorded}, not with {given}")]
    OtherRobot {
        family: String,
        /// Digest of the robot on record.
        recorded: String,
        /// Digest of the robot it was to be activated with.
        given: String,
    },
    /// A profile that needs an administrator's authorization, without one right before it.
    #[error("the profile {named} is not authorized: {problem}")]
    UnauthorizedProfile {
        /// Its name for `holdpoint profile allow`.
        named: String,
        problem: String,
    },
    /// A script on a store that an engine used for a real cell, where robots or people are at risk.
    #[error("no script uses this store: an engine that was no script's used it under real or human")]
    ScriptAfterLive,
    /// Another program wrote to the database of a running engine. Nothing is written over it.
    #[error("the store was changed behind the engine: {0}")]
    Altered(String),
    #[error(
        "another program wrote to the database while the engine started, so its data may differ from the record"
    )]
    Disturbed,
    #[error("the command id {0:?} was already used for a different command")]
    CommandReused(String),
    #[error("the change is refused: {0}")]
    Invariant(String),
    #[error("{what} {value:?} is not allowed: {allowed}")]
    Invalid { what: &'static str, value: String, allowed: String },
    #[error("a key is missing or cannot be used: {source}")]
    Key { path: PathBuf, source: KeyError },
    /// The virtual clock went back.
    #[error(
        "the clock went back: the last record is from {last_ms} ms, this one from {found_ms} ms; holding"
    )]
    ClockBack {
        /// Virtual time of the last record, ms.
        last_ms: u64,
        /// Virtual time of the refused transaction, ms.
        found_ms: u64,
    },
    #[error("the store's writer has ended; the outcome of the command is not known")]
    Unknown,
    /// A test asked for a failure here.
    #[error("failpoint {0:?}")]
    Failpoint(&'static str),
}

impl From<FileError> for StoreError {
    fn from(error: FileError) -> Self {
        match error {
            FileError::Io { what, path, source } => Self::Io { what, path, source },
            FileError::Invalid { what, value, allowed } => Self::Invalid { what, value, allowed },
        }
    }
}

impl StoreError {
    /// Whether a start was refused without a failure: because of the profile, a script, or another program that writes
    /// to the store.
    #[must_use]
    pub const fn refuses_start(&self) -> bool {
        matches!(self, Self::UnauthorizedProfile { .. } | Self::ScriptAfterLive | Self::Altered(_))
    }
}

impl Hint for StoreError {
    fn details(&self) -> Option<ErrorDetails> {
        let failed =
            |failure: StoreFailure| ErrorDetails::from(ErrorReason::Store).with_cause(failure.name());
        Some(match self {
            Self::Io { path, .. } | Self::OtherUser { path, .. } => {
                ErrorDetails::of_path(ErrorReason::Store, path).with_cause(StoreFailure::Io.name())
            }
            Self::InUse { path, .. } => ErrorDetails::of_path(ErrorReason::StoreInUse, path),
            Self::Refused { path, cause, .. } => {
                ErrorDetails::of_path(ErrorReason::StoreRefused, path).with_cause(cause.name())
            }
            Self::Database { .. } => failed(StoreFailure::Database),
            Self::DiskFull { .. } => failed(StoreFailure::DiskFull),
            Self::RowTooLong { .. } => failed(StoreFailure::RowTooLong),
            Self::Invariant(_) => failed(StoreFailure::Invariant),
            Self::ClockBack { .. } => failed(StoreFailure::ClockBack),
            Self::Unknown => failed(StoreFailure::OutcomeUnknown),
            Self::NotFound { .. } => ErrorReason::NotFound.into(),
            Self::Exists { .. } => ErrorReason::Exists.into(),
            Self::Stale { .. } => ErrorReason::Stale.into(),
            Self::Approval { .. } | Self::Person { .. } => ErrorReason::NotAllowed.into(),
            Self::OtherRobot { .. } => ErrorReason::OtherRobot.into(),
            Self::UnauthorizedProfile { .. } => ErrorReason::ProfileNotAuthorized.into(),
            Self::ScriptAfterLive => ErrorReason::ScriptAfterLive.into(),
            Self::Altered(_) | Self::Disturbed => ErrorReason::StoreAltered.into(),
            Self::CommandReused(_) | Self::Invalid { .. } => ErrorReason::BadInput.into(),
            Self::Key { path, source } => {
                source.details().unwrap_or_else(|| ErrorDetails::of_path(ErrorReason::BadFile, path))
            }
            Self::Failpoint(_) => ErrorReason::Internal.into(),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::OtherUser { owner, .. } => {
                Some(format!("run the command as {owner}, or name a folder of your own with --data DIR").into())
            }
            Self::InUse { .. } => Some("send commands to that engine, or end it first".into()),
            Self::Refused { cause, .. } => Some(cause.remedy().into()),
            Self::DiskFull { .. } => Some("free some space and retry".into()),
            Self::Stale { .. } => Some("look at it again and decide again".into()),
            Self::Key { path, source } => source.hint().or_else(|| {
                Some(
                    format!("put {} back from a backup; `holdpoint store check` then looks at all keys", path.display())
                        .into(),
                )
            }),
            Self::Approval { problem: ApprovalFault::Damaged(_), .. } => {
                Some("restore it from a backup; without one it is lost".into())
            }
            Self::Unknown => Some("restart and retry it".into()),
            Self::Disturbed => {
                Some("find the program that writes there, run `holdpoint audit verify`, and start again".into())
            }
            Self::Altered(_) => Some(
                "end the engine; `holdpoint store rebuild --from-chain` then rebuilds the tables from the audit chain"
                    .into(),
            ),
            Self::OtherRobot { .. } => Some(
                "start with the robot it was made with, or choose another store with `--data`: what was measured on \
                 one robot says nothing of another"
                    .into(),
            ),
            Self::UnauthorizedProfile { named, .. } => Some(
                format!(
                    "`holdpoint profile allow {} --by {FIRST_ADMINISTRATOR} --reason 'the reason'` shows the change and \
                    signs it as an administrator, for the next start",
                    shell_word(named)
                )
                .into(),
            ),
            Self::ScriptAfterLive => Some(
                "leave --data out, or name another folder: the script then has a store of its own".into(),
            ),
            Self::Io { .. }
            | Self::Database { .. }
            | Self::RowTooLong { .. }
            | Self::NotFound { .. }
            | Self::Exists { .. }
            | Self::Approval { .. }
            | Self::Person { .. }
            | Self::CommandReused(_)
            | Self::Invariant(_)
            | Self::Invalid { .. }
            | Self::ClockBack { .. }
            | Self::Failpoint(_) => None,
        }
    }
}

impl StoreError {
    /// Wraps an I/O error.
    pub fn io(what: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { what, path, source }
    }

    pub fn invalid(what: &'static str, value: impl ToString, allowed: impl ToString) -> Self {
        Self::Invalid { what, value: value.to_string(), allowed: allowed.to_string() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_error_keeps_its_message_and_its_details() {
        let errors: [fn() -> FileError; 2] = [
            || FileError::Io {
                what: "read",
                path: PathBuf::from("a"),
                source: std::io::ErrorKind::NotFound.into(),
            },
            || FileError::Invalid { what: "witness", value: "a".to_owned(), allowed: "a path".to_owned() },
        ];
        for error in errors {
            let (of_file, of_store) = (error(), StoreError::from(error()));
            assert_eq!(of_file.to_string(), of_store.to_string());
            assert_eq!((of_file.details(), of_file.hint()), (of_store.details(), of_store.hint()));
        }
    }
}
