//! What a replay knows: the recording, where the cursor is, and how it plays.

use std::sync::Arc;

use super::charts::Group;
use super::speed::Speed;
use super::timeline::{Cursor, Timeline};
use crate::line::EditLine;

/// How long an answer stands at the foot, ms.
pub const NOTICE_MS: u64 = 5_000;

/// An answer at the foot of the screen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReplayNotice {
    pub text: String,
    pub bad: bool,
    /// Until when, on the screen's clock, ms.
    pub until_ms: u64,
}

/// Everything a replay's screen is drawn from.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayModel {
    pub timeline: Arc<Timeline>,
    pub cursor: Cursor,
    pub playing: bool,
    pub speed: Speed,
    /// Whether playing skips what has no pictures.
    pub skips_gaps: bool,
    /// The group of charts that was chosen; by the stage if absent.
    pub charts: Option<usize>,
    /// Whether the help lies over the screen, and its first line that is shown.
    pub help: Option<u16>,
    /// The place to jump to that is being typed.
    pub typing: Option<EditLine>,
    /// The answer to the last key.
    pub notice: Option<ReplayNotice>,
    /// The screen's clock, ms; monotonic.
    pub now_ms: u64,
    /// Playing stands on an event until then, so that it can be read, ms of the screen's clock.
    pub rests_until_ms: u64,
    /// Recorded time that was played and is less than a ms, quarters of one.
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

    /// The group of charts that the stage at the cursor asks for; 0 if it is not recorded.
    #[must_use]
    pub fn charts_by_stage(&self) -> usize {
        let wanted = self.timeline.standing(self.cursor).charts();
        self.timeline.groups().iter().position(|group| group.about == wanted).unwrap_or(0)
    }

    /// The group of charts that is shown, and its place; absent if nothing was charted.
    #[must_use]
    pub fn shown_charts(&self) -> Option<(usize, &Group)> {
        let place = self.charts.unwrap_or_else(|| self.charts_by_stage());
        self.timeline.groups().get(place).map(|group| (place, group))
    }

    /// How much older than the cursor the picture is, ms; absent without a picture.
    #[must_use]
    pub fn picture_age_ms(&self) -> Option<u64> {
        let picture = self.timeline.picture(self.cursor.picture?)?;
        Some(self.cursor.at_ms.saturating_sub(picture.at_ms))
    }

    /// Says something at the foot for a while.
    pub fn tell(&mut self, text: impl Into<String>, bad: bool) {
        let until_ms = self.now_ms.saturating_add(NOTICE_MS);
        self.notice = Some(ReplayNotice { text: text.into(), bad, until_ms });
    }
}
