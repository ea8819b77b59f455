//! The state of a replay: the recording, the cursor, and the playing.

use std::sync::Arc;

use super::charts::ChartSection;
use super::message::ReplayMessage;
use super::speed::Speed;
use super::timeline::{Timeline, TimelineCursor};
use crate::line::EditLine;

/// How long an answer is shown at the foot, ms.
pub const NOTICE_MS: u64 = 5_000;

/// An answer at the foot of the screen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReplayNotice {
    pub message: ReplayMessage,
    /// Until when, on the screen's clock, ms.
    pub until_ms: u64,
}

/// The data for a replay's screen.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayModel {
    pub timeline: Arc<Timeline>,
    pub cursor: TimelineCursor,
    pub playing: bool,
    pub speed: Speed,
    /// Whether playing skips gaps without frames.
    pub skips_gaps: bool,
    /// The group of charts that was chosen; by the stage if absent.
    pub charts: Option<usize>,
    /// Whether the help lies over the screen, and its first line that is shown.
    pub help: Option<u16>,
    /// The jump target that is being typed.
    pub typing: Option<EditLine>,
    /// The answer to the last key.
    pub notice: Option<ReplayNotice>,
    /// The screen's clock, ms; monotonic.
    pub now_ms: u64,
    /// Playing pauses on an event until this time, so that it can be read, ms of the screen's clock.
    pub rests_until_ms: u64,
    /// Played time of less than one ms, in quarters of a ms.
    pub carried_quarters: u64,
}

impl ReplayModel {
    /// A replay at its first moment, paused.
    #[must_use]
    pub fn new(timeline: Timeline, speed: Speed) -> Self {
        let cursor = timeline.at(timeline.span_ms().0);
        Self {
            timeline: Arc::new(timeline),
            cursor,
            playing: false,
            speed,
            skips_gaps: true,
            charts: None,
            help: None,
            typing: None,
            notice: None,
            now_ms: 0,
            rests_until_ms: 0,
            carried_quarters: 0,
        }
    }

    /// The group of charts for the stage at the cursor; 0 if it is not recorded.
    #[must_use]
    pub fn charts_by_stage(&self) -> usize {
        let wanted = self.timeline.version_status(self.cursor).charts();
        self.timeline.groups().iter().position(|group| group.about == wanted).unwrap_or(0)
    }

    /// The group of charts on the screen, and its place; absent if there are no charts.
    #[must_use]
    pub fn shown_charts(&self) -> Option<(usize, &ChartSection)> {
        let place = self.charts.unwrap_or_else(|| self.charts_by_stage());
        self.timeline.groups().get(place).map(|group| (place, group))
    }

    /// How much older than the cursor the frame is, ms; absent without a frame.
    #[must_use]
    pub fn frame_age_ms(&self) -> Option<u64> {
        let frame = self.timeline.frame(self.cursor.frame?)?;
        Some(self.cursor.at_ms.saturating_sub(frame.at_ms))
    }

    /// Shows a message at the foot for a while.
    pub fn show_notice(&mut self, message: ReplayMessage) {
        let until_ms = self.now_ms.saturating_add(NOTICE_MS);
        self.notice = Some(ReplayNotice { message, until_ms });
    }
}
