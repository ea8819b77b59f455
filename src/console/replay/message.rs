//! The messages of a replay at the foot of its screen.

use std::fmt;

use super::jump::JumpError;
use super::views::secs;
use crate::formatters::duration;
use holdpoint_wording::console::replay as wording;

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
            Self::NoFrameAfter => wording::NO_FRAME_AFTER,
            Self::NoFrameBefore => wording::NO_FRAME_BEFORE,
            Self::NoEventAfter => wording::NO_EVENT_AFTER,
            Self::NoEventBefore => wording::NO_EVENT_BEFORE,
            Self::NoDecisionAfter => wording::NO_DECISION_AFTER,
            Self::NoDecisionBefore => wording::NO_DECISION_BEFORE,
            Self::NoFailure => wording::NO_FAILURE,
            Self::NoCharts => wording::NO_CHARTS,
            Self::GapsSkipped => wording::GAPS_SKIPPED,
            Self::GapsPlayed => wording::GAPS_PLAYED,
            Self::End => wording::END,
            Self::Skipped(ms) => {
                return f.write_str(&wording::skipped(&duration(*ms)));
            }
            Self::Outside { from_ms, to_ms } => {
                return f.write_str(&wording::span(&secs(*from_ms), &secs(*to_ms)));
            }
            Self::NoTarget(error) => return fmt::Display::fmt(error, f),
        })
    }
}
