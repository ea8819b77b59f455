//! What `store` prints: copies, a check of all parts, a rebuild from the chain.

use std::fmt::Display;

use super::recordings::{NO_RECORD, missing};
use crate::counted;
use holdpoint_governance::store_finding::OmissionCause;

/// The rows of `store info` whose names are more than one word.
pub const SIGNED_AT_RECORD: &str = "signed at record";
pub const ROOT_OF_TREE: &str = "root of the tree";
pub const FIRST_RECORD: &str = "first record";
pub const LAST_RECORD: &str = "last record";
pub const IN_USE_BY: &str = "in use by";
pub const NO_PROCESS: &str = "no process";

/// A sound copy: its records, its size in words, its files, its place.
#[must_use]
pub fn copied(records: u64, size: &str, files: usize, to: impl Display) -> String {
    let (records, files) = (counted(records, "record"), counted(files, "file"));
    format!("copied {records}, {size} in {files}, to {to}; the copy is sound")
}

/// The recordings of a copy.
#[must_use]
pub fn copied_recordings(recordings: usize) -> String {
    format!("with {}, each with its recorded digest", counted(recordings, "recording"))
}

/// A file that is not in a copy.
#[must_use]
pub fn left_out(bad: bool, file: impl Display, why: OmissionCause) -> String {
    let label = if bad { "LEFT OUT" } else { "left out" };
    let why = match why {
        OmissionCause::NotOnRecord => NO_RECORD.to_owned(),
        OmissionCause::NoFileName => "its name on record is not a file name".to_owned(),
        OmissionCause::Missing => missing(None),
        OmissionCause::Unreadable => "it is a link, no file, or cannot be read".to_owned(),
        OmissionCause::OtherSize => "it has another size than was recorded at closure".to_owned(),
        OmissionCause::OtherDigest => "it has another SHA-256 than was recorded at closure".to_owned(),
    };
    format!("{label}  {file}: {why}")
}

/// What a copy lacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CopyGap {
    /// The recordings.
    Recordings,
    /// The secret keys.
    Keys,
    /// Both.
    KeysAndRecordings,
}

/// What a copy lacks, and the command for another copy with everything.
#[must_use]
pub fn copy_lacks(gap: CopyGap, other: &str) -> String {
    let (lacks, options) = match gap {
        CopyGap::Recordings => ("the recordings", "--with-keys --with-recordings"),
        CopyGap::Keys => ("the secret keys, without which no engine starts on it", "--with-keys"),
        CopyGap::KeysAndRecordings => (
            "the secret keys, without which no engine starts on it, and the recordings",
            "--with-keys --with-recordings",
        ),
    };
    format!("the copy lacks {lacks}; `holdpoint store backup {other} {options}` makes one with everything")
}

/// The part that a check of the store leaves out.
pub const RECORDINGS_NOT_CHECKED: &str =
    "not checked: the recordings; `holdpoint audit verify --all` checks them, too";

/// A rebuild of a store whose tables are right.
pub const NOTHING_TO_REBUILD: &str = "the tables match the audit log; nothing was done";

/// A rebuilt store, and the place of the damaged file.
#[must_use]
pub fn rebuilt(records: u64, damaged_file: impl Display) -> String {
    format!("rebuilt from {}; the damaged file is {damaged_file}", counted(records, "record"))
}

/// The first difference that a rebuild found.
#[must_use]
pub fn first_found(problem: impl Display) -> String {
    format!("first found: {problem}")
}

/// Unsigned records that a rebuild took.
#[must_use]
pub fn took_unsigned(first: u64, last: u64) -> String {
    format!("taken   {first} to {last} although they are unsigned: nothing vouches for these records")
}

/// A row that was made again, with the columns that differed.
#[must_use]
pub fn repaired(table: impl Display, key: &str, problem: impl Display, columns: &[String]) -> String {
    let columns = if columns.is_empty() { String::new() } else { format!(" ({})", columns.join(", ")) };
    format!("repaired  {table} {key:?}: {problem}{columns}")
}

/// A text that the chain does not have.
#[must_use]
pub fn lost(table: impl Display, key: &str) -> String {
    format!("lost    a text of {table} {key:?}; a mark replaces it")
}
