//! Errors of a cell; each names what to correct in the file or the episode.

use holdpoint_body::BodyError;
use thiserror::Error;

/// A failure of the cell itself, never of the skill under test.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum CellError {
    /// A description file is wrong.
    #[error("{file}: {element}: {problem}")]
    File {
        /// The file, or `builtin:<name>`.
        file: String,
        /// The element or key inside it.
        element: String,
        /// What is wrong, with the value in quotes and what is allowed.
        problem: String,
    },
    /// The episode could not be started as sampled: the object slips out of the hand, a start pose is out of reach, or the
    /// cell cannot do a condition. It is no result of the skill.
    #[error("seed {seed}: no valid start: {problem}")]
    InvalidStart {
        /// The episode's seed.
        seed: u64,
        /// What failed.
        problem: String,
    },
    /// The world could not carry out a tick: the episode is void.
    #[error(transparent)]
    Body(#[from] BodyError),
    /// Bytes that are not a snapshot of this world.
    #[error("snapshot refused: {0}")]
    Snapshot(String),
    /// The cell has no such ability.
    #[error("this cell cannot {0}")]
    Unable(&'static str),
    /// A worker of the pool panicked.
    #[error("worker failed on item {item}: {message}")]
    Worker {
        /// Index of the item that it ran.
        item: u64,
        /// The panic's message.
        message: String,
    },
}

impl CellError {
    /// An error in a description file.
    #[must_use]
    pub fn file(file: &str, element: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::File { file: file.to_owned(), element: element.into(), problem: problem.into() }
    }
}
