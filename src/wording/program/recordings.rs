//! What `recordings` and `replay` print: files beside their records, removals, opened viewers, an episode as lines.

use std::fmt::Display;

use crate::counted;

/// A recording with another digest than on record.
#[must_use]
pub fn other_digest(found: impl Display, recorded: impl Display) -> String {
    format!("its SHA-256 is {found}, {recorded} was recorded at closure")
}

/// A recording with another size than on record, bytes.
#[must_use]
pub fn other_size(found: u64, recorded: u64) -> String {
    format!("it has {found} bytes, {recorded} were recorded at closure")
}

/// A recording that has no record of its closure.
pub const NO_RECORD: &str = "its upgrade is open, or was closed without it";

/// A recording that is missing, and the other kind of file with its name, if there is one.
#[must_use]
pub fn missing(in_its_place: Option<&str>) -> String {
    let other = in_its_place.map_or_else(String::new, |what| format!("; {what} has its name"));
    format!("it was recorded at closure, and no removal is on record{other}")
}

/// A file of another kind in a list of verified recordings.
#[must_use]
pub fn other_file(name: &str, what: &str) -> String {
    format!("{name}  skipped: it is {what}, not a recording")
}

/// A file of another kind in a list of recordings.
#[must_use]
pub fn skipped(name: &str, what: &str) -> String {
    format!("skipped: {name} is {what}, not a recording")
}

/// The result of the check of one recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordingCheck {
    /// It is as recorded.
    Matches,
    /// It has another digest or size than on record.
    Differs,
    /// It has no record.
    NotOnRecord,
    /// It is on record and missing.
    Missing,
}

impl RecordingCheck {
    /// Its name as a value.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Matches => "matches",
            Self::Differs => "differs",
            Self::NotOnRecord => "not on record",
            Self::Missing => "missing",
        }
    }

    /// Whether the recording is not as recorded.
    #[must_use]
    pub const fn is_bad(self) -> bool {
        matches!(self, Self::Differs | Self::Missing)
    }
}

/// A checked recording, with its result, in capitals if it is bad, and what is to say of it.
#[must_use]
pub fn checked(file: &str, result: RecordingCheck, detail: &str) -> String {
    let name = result.name();
    let label = if result.is_bad() { name.to_uppercase() } else { name.to_owned() };
    let detail = if detail.is_empty() { String::new() } else { format!(": {detail}") };
    format!("{file}  {label}{detail}")
}

/// The result of a check of all recordings: all, the bad ones, the ones that are not on record.
#[must_use]
pub fn checked_all(all: usize, bad: usize, not_on_record: usize) -> String {
    let label = if bad == 0 { "sound" } else { "not sound" };
    let rest = if not_on_record > 0 { format!(", {not_on_record} not on record") } else { String::new() };
    format!("{label}: {}, {bad} not as recorded{rest}", counted(all, "recording"))
}

/// A recording that is kept because its record is of other bytes.
#[must_use]
pub fn kept(file: &str) -> String {
    format!("kept {file}: it differs from the digest recorded at closure")
}

/// The cause for which a recording is kept, as a value.
pub const KEPT_REASON: &str = "differs from its recorded digest";

/// A removed recording, or one that would be removed.
#[must_use]
pub fn removed(dry_run: bool, file: &str, size: &str, reason: &str) -> String {
    let label = if dry_run { "would remove" } else { "removed" };
    format!("{label} {file} ({size}): {reason}")
}

/// The removed files together.
#[must_use]
pub fn removed_all(dry_run: bool, files: usize, size: &str) -> String {
    let label = if dry_run { "would be removed" } else { "removed" };
    format!("{}, {size}, {label}", counted(files, "file"))
}

/// The limit for which recordings are removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RemovalLimit {
    /// Only the newest N upgrades are kept.
    Newest(usize),
    /// Older ones, by the number of days, are removed.
    Days(u64),
    /// All together have at most N MiB.
    Mebibytes(u64),
}

/// The reason of a removal; it stands in the record of it.
#[must_use]
pub fn removal_reason(of: RemovalLimit) -> String {
    match of {
        RemovalLimit::Newest(keep) => format!("only the {keep} newest are kept"),
        RemovalLimit::Days(days) => format!("written more than {} ago", counted(days, "day")),
        RemovalLimit::Mebibytes(mib) => format!("all together are limited to {mib} MiB"),
    }
}

/// A recording that differs from its record.
#[must_use]
pub fn differs_from_record(problem: impl Display) -> String {
    format!("DIFFERS FROM ITS RECORD: {problem}")
}

/// Recordings that a scene viewer shows.
#[must_use]
pub fn opened(version: impl Display, files: usize, process: impl Display) -> String {
    let count = if files == 1 { String::new() } else { format!(", {files} files") };
    format!("opened in rerun {version}{count} (process {process})")
}

/// An episode that may differ from the judged one.
#[must_use]
pub fn other_episode(doubt: impl Display) -> String {
    format!("NOT THE JUDGED EPISODE: {doubt}")
}

/// One world of a re-run: its name, its version, its end, and whether it went as recorded, if that was checked.
#[must_use]
pub fn world(name: &str, version: impl Display, ended: impl Display, as_recorded: Option<bool>) -> String {
    let checked = match as_recorded {
        Some(true) => ", as recorded",
        Some(false) => ", NOT AS RECORDED",
        None => "",
    };
    format!("{name} {version}: {ended}{checked}")
}

/// The heading of the values of a world, with its limits.
#[must_use]
pub fn moments_heading(speed_m_s: impl Display, grip_n: impl Display, contact_n: impl Display) -> String {
    format!(
        "  time s   speed m/s (max {speed_m_s:.2})   grip N (max {grip_n:.1})   contact N (max {contact_n:.1})"
    )
}
