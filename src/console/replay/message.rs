//! The messages of a replay at the foot of its screen.

use std::fmt;

use super::jump::JumpError;
use super::views::secs;
use crate::formatters::duration;

/// The answer to a key, or a report about playing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ReplayMessage {
    NoFrameAfter,
    NoFrameBefore,
    NoEventAfter,
    NoEventBefore,
    NoDecisionAfter,
    NoDecisionBefore,
    NoFailure,
    NoCharts,
    GapsSkipped,
    GapsPlayed,
    /// Playing has reached the end.
    End,
    /// Playing has skipped a gap of this length, ms.
    Skipped(u64),
    /// The jump target lies outside the recording, which has these limits, ms.
    Outside {
        from_ms: u64,
        to_ms: u64,
    },
    /// The typed text is no jump target.
    NoTarget(JumpError),
}

impl ReplayMessage {
    /// Whether something was refused.
    #[must_use]
    pub const fn is_bad(&self) -> bool {
        matches!(self, Self::NoTarget(_))
    }
}

impl fmt::Display for ReplayMessage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NoFrameAfter => "no frame after this one",
            Self::NoFrameBefore => "no frame before this one",
            Self::NoEventAfter => "no event after this",
            Self::NoEventBefore => "no event before this",
            Self::NoDecisionAfter => "no decision after this",
            Self::NoDecisionBefore => "no decision before this",
            Self::NoFailure => "nothing goes wrong in this recording",
            Self::NoCharts => "this recording holds no charts",
            Self::GapsSkipped => "gaps are skipped while playing",
            Self::GapsPlayed => "gaps are played through",
            Self::End => "end of the recording; g goes to its beginning",
            Self::Skipped(ms) => {
                return write!(f, "skipped {} without frames; s plays them through", duration(*ms));
            }
            Self::Outside { from_ms, to_ms } => {
                return write!(f, "the recording goes from {} to {}", secs(*from_ms), secs(*to_ms));
            }
            Self::NoTarget(error) => return fmt::Display::fmt(error, f),
        })
    }
}
