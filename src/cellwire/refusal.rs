//! Why a cell refuses a call, as a message and as the errors of the ports.
//!
//! The texts of a refusal are foreign: they are made safe to print where an error of this program is made of them.

use holdpoint_body::BodyError;
use holdpoint_cell::CellError;
use holdpoint_text::Untrusted;
use serde::{Deserialize, Serialize};

use crate::messages::{PROTOCOL, Role};

/// The longest text of a refusal that is shown, columns.
const REFUSAL_WIDTH_MAX: usize = 200;

/// Why a call has no effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CellRefusal {
    /// The client speaks another version; the connection is closed.
    Version {
        /// That of the server.
        server: u32,
    },
    /// A value of the hello is not allowed; the connection is closed.
    Hello {
        /// The field.
        field: String,
        /// What is allowed.
        allowed: String,
    },
    /// The bytes are no message; the connection is closed.
    Malformed(String),
    /// A request is missing or came twice; the connection is closed.
    Sequence {
        /// The number that was due.
        due: u64,
        /// The number that came.
        came: u64,
    },
    /// A role that this connection does not have.
    Role {
        /// The role that the call needs.
        needs: Role,
    },
    /// The live cell is another client's; the connection is closed.
    Taken,
    /// The server keeps as many connections or forks as it can.
    Full {
        /// Of what.
        what: String,
        /// How many.
        most: u64,
    },
    /// The session has no fork of this handle.
    UnknownFork(u64),
    /// The watchdog stopped the arm. Only a release, or new work, lets it move again.
    Stopped(WatchdogStop),
    /// The description or the episode is wrong.
    File {
        /// The file.
        file: String,
        /// The element or key inside it.
        element: String,
        /// What is wrong.
        problem: String,
    },
    /// The episode could not be started.
    InvalidStart {
        /// Its seed.
        seed: u64,
        /// What failed.
        problem: String,
    },
    /// The body could not carry out a tick.
    Body(BodyError),
    /// Bytes that are no state of this cell.
    Snapshot(String),
    /// The cell has no such ability.
    Unable(String),
}

/// What the watchdog did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WatchdogStop {
    /// How long no command came, ms.
    pub silent_ms: u32,
    /// Ticks from the stop to the standstill; absent if the arm did not come to rest.
    pub standstill_ticks: Option<u64>,
}

impl WatchdogStop {
    /// A sentence for a person.
    #[must_use]
    pub fn told(self) -> String {
        let Self { silent_ms, standstill_ticks } = self;
        let end = standstill_ticks.map_or_else(
            || "it did not come to rest".to_owned(),
            |ticks| format!("it stood still {ticks} ticks later"),
        );
        format!("the cell stopped the arm by itself: no command for {silent_ms} ms; {end}")
    }
}

/// The abilities that a cell may lack, as [`CellError::Unable`] names them.
const ABILITIES: [&str; 4] =
    ["export its state", "break on demand", "be set to an observation", "present such a drift"];

impl CellRefusal {
    /// Why a cell refuses.
    #[must_use]
    pub fn of_cell(error: CellError) -> Self {
        match error {
            CellError::File { file, element, problem } => Self::File { file, element, problem },
            CellError::InvalidStart { seed, problem } => Self::InvalidStart { seed, problem },
            CellError::Body(error) => Self::Body(error),
            CellError::Snapshot(problem) => Self::Snapshot(problem),
            CellError::Unable(ability) => Self::Unable(ability.to_owned()),
            CellError::Worker { .. } => Self::Body(BodyError::Failed(error.to_string())),
        }
    }

    /// The same as the ports give it, with texts that are safe to print.
    #[must_use]
    pub fn into_cell_error(self) -> CellError {
        match self {
            Self::File { file, element, problem } => {
                CellError::File { file: safe(file), element: safe(element), problem: safe(problem) }
            }
            Self::InvalidStart { seed, problem } => CellError::InvalidStart { seed, problem: safe(problem) },
            Self::Snapshot(problem) => CellError::Snapshot(safe(problem)),
            Self::UnknownFork(fork) => {
                CellError::Snapshot(format!("the cell has no fork \"{fork}\" any more"))
            }
            Self::Full { what, most } => {
                CellError::Snapshot(format!("the cell keeps at most {most} {}", safe(what)))
            }
            Self::Unable(ability) => {
                let known = ABILITIES.iter().find(|known| **known == ability);
                CellError::Unable(known.copied().unwrap_or("do that"))
            }
            other => CellError::Body(other.into_body_error()),
        }
    }

    /// The same as a failure of a tick.
    #[must_use]
    pub fn into_body_error(self) -> BodyError {
        match self {
            Self::Body(BodyError::Command(problem)) => BodyError::Command(safe(problem)),
            Self::Body(BodyError::Diverged { tick, what }) => BodyError::Diverged { tick, what: safe(what) },
            Self::Body(BodyError::Failed(problem)) => BodyError::Failed(safe(problem)),
            Self::Body(BodyError::Lost(problem)) => BodyError::Lost(safe(problem)),
            Self::Version { server } => BodyError::Failed(format!(
                "the cell speaks protocol \"{server}\"; this build speaks {PROTOCOL}"
            )),
            Self::Hello { field, allowed } => {
                BodyError::Failed(format!("the cell refuses {}; allowed: {}", safe(field), safe(allowed)))
            }
            Self::Malformed(problem) => {
                BodyError::Failed(format!("the cell cannot read the message: {}", safe(problem)))
            }
            Self::Sequence { due, came } => {
                BodyError::Failed(format!("the cell was due request {due}, and got {came}"))
            }
            Self::Role { needs } => BodyError::Failed(format!("the call needs a {} cell", needs.name())),
            Self::Taken => BodyError::Failed("the live cell is another client's".to_owned()),
            Self::Stopped(stop) => BodyError::Lost(stop.told()),
            other @ (Self::Full { .. }
            | Self::UnknownFork(_)
            | Self::File { .. }
            | Self::InvalidStart { .. }
            | Self::Snapshot(_)
            | Self::Unable(_)) => BodyError::Failed(other.into_cell_error().to_string()),
        }
    }

    /// Whether the server closes the connection after it.
    #[must_use]
    pub const fn closes(&self) -> bool {
        match self {
            Self::Version { .. }
            | Self::Hello { .. }
            | Self::Malformed(_)
            | Self::Sequence { .. }
            | Self::Taken => true,
            Self::Role { .. }
            | Self::Full { .. }
            | Self::UnknownFork(_)
            | Self::Stopped(_)
            | Self::File { .. }
            | Self::InvalidStart { .. }
            | Self::Body(_)
            | Self::Snapshot(_)
            | Self::Unable(_) => false,
        }
    }
}

fn safe(text: String) -> String {
    Untrusted::new(text).display(REFUSAL_WIDTH_MAX).to_string()
}
