//! What an engine says of itself: stops without a person, its end, its answers, the recordings that it keeps.
//!
//! These are reasons, notes and answers; the text of a refusal stands with the refusal.

use std::fmt::Display;

use crate::counted;

/// The person of a stop whose record cannot be read.
pub const UNKNOWN_PERSON: &str = "an unknown person";

/// The reason of a stop whose record cannot be read.
pub const UNREADABLE_STOP: &str = "a record of a stop that cannot be read";

/// The reason of a stop by something that is in the place of a mark.
#[must_use]
pub fn mark_replaced(kind: impl Display) -> String {
    format!("{kind} is in the place of the mark of a stop")
}

/// The reason of a stop whose mark was removed before the engine could read it.
pub const MARK_REMOVED: &str =
    "a stop was requested in the store's folder, and its mark was removed before the engine had read it";

/// The reason of a stop because the store's folder has another name, or another folder has its name.
pub const FOLDER_AWAY: &str =
    "the store's folder was moved or replaced: a stop requested there does not reach this engine";

/// A sequence without a result because the arm was stopped.
pub const ARM_STOPPED: &str = "the arm was stopped";

/// The reason of a release that people approved.
pub const RELEASE_APPROVED: &str = "people approved its release";

/// The answer to an end that came before the start was complete.
pub const ENDS_BEFORE_START: &str = "the engine ends before its start is complete; nothing was carried out";

/// The answer to a stop that the engine took from the store's folder, with the cause for which it did not answer.
#[must_use]
pub fn stopped_by_mark(instead: &str) -> String {
    format!("the cell is stopped: the process that has the store took the stop from its folder ({instead})")
}

/// The author of an answer that comes from another process.
pub const OTHER_PROCESS: &str = "the engine in another process";

/// The cause of an end: a signal.
pub const ENDED_BY_SIGNAL: &str = "a signal to its process";

/// The cause of an end: its console is lost.
pub const ENDED_BY_LOSS: &str = "the loss of its console";

/// The cause of an end: no console for N seconds.
#[must_use]
pub fn ended_alone(secs: u64) -> String {
    format!("{secs} s without an attached console")
}

/// The cause of an end: its own process.
pub const ENDED_BY_STARTER: &str = "the process that started it";

/// An end on request, with its cause.
#[must_use]
pub fn ended_by(cause: &str) -> String {
    format!("it ended cleanly: {cause} ended it")
}

/// The processes of an answer that is not known to come from the engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AnsweringProcess {
    /// The process that answers, and the one that has the store, if there is one.
    Other(i32, Option<i32>),
    /// The kernel does not name them.
    Untold,
}

/// An answer that is not known to come from the engine.
#[must_use]
pub fn unverified(of: AnsweringProcess) -> String {
    let why = match of {
        AnsweringProcess::Other(answers, Some(holds)) => {
            format!("process {answers} answers at the socket, and process {holds} has the store")
        }
        AnsweringProcess::Other(answers, None) => {
            format!("process {answers} answers at the socket, and no process has the store")
        }
        AnsweringProcess::Untold => {
            "the kernel does not say, or not in time, whether the process that answers is the one that has the store"
                .to_owned()
        }
    };
    format!("this answer is not known to come from the engine: {why}")
}

/// The same for places with little room.
pub const UNVERIFIED: &str = "NOT KNOWN TO COME FROM THE ENGINE";

/// An answer that is not known to come from the engine, with its text.
#[must_use]
pub fn unverified_answer(doubt: impl Display, text: &str) -> String {
    format!("{doubt}; it says: {text}")
}

/// A recording without the re-runs that show the cause of a rejection.
#[must_use]
pub fn cause_not_recorded(version: impl Display, fault: &str) -> String {
    format!("{version}: the cause of its rejection is not in its recording: {fault}")
}

/// A recording whose digest does not go on record.
#[must_use]
pub fn not_recorded(file: &str, why: &str) -> String {
    format!("{file} is not recorded: {why}")
}

/// The address at which a scene viewer connects.
#[must_use]
pub fn serves_viewer(url: impl Display) -> String {
    format!("a viewer may connect to {url}")
}

/// A contradiction between a recording and the store's record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordingContradiction<'a> {
    /// Its name is of another version, or of none.
    OtherName,
    /// Its version is not registered.
    Unregistered,
    /// Its name has another digest.
    OtherDigest,
    /// There are as many recordings of upgrades with this end as there are such upgrades.
    Surplus {
        /// Upgrades with this end.
        ends: usize,
        /// Their end.
        outcome: &'a str,
        /// Recordings of them.
        recordings: usize,
    },
}

/// The contradiction of a recording of this version.
#[must_use]
pub fn recording_contradiction(of: RecordingContradiction<'_>, version: impl Display) -> String {
    match of {
        RecordingContradiction::OtherName => format!("its name is not that of a recording of {version}"),
        RecordingContradiction::Unregistered => format!("{version} is not registered"),
        RecordingContradiction::OtherDigest => format!("its name has not the digest of {version}"),
        RecordingContradiction::Surplus { ends, outcome, recordings } => {
            format!(
                "{} of {version} ended as {outcome}, with {} on record",
                counted(ends, "upgrade"),
                counted(recordings, "recording"),
            )
        }
    }
}
