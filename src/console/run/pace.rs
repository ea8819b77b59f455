//! When the next frame is drawn: at once after a key, else at the pace of what is shown, and not at all if
//! nothing changed.
//!
//! Pure: times are arguments. Must not know what is drawn.

/// Frames for a person's key: so long after the last one at least, ms.
const KEY_INTERVAL_MS: u64 = 10;

/// Frames for what the engine tells: at most 15 a second.
const STORY_INTERVAL_MS: u64 = 67;

/// Frames while a moving picture is shown: at most 18 a second. Thirty cost 2.9 % of a core; the budget is 2 %.
const PICTURE_INTERVAL_MS: u64 = 55;

/// Why a frame is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Want {
    /// Something was told, or time passed.
    Story,
    /// The picture that is shown moved.
    Picture,
    /// Somebody pressed a key, or the size changed.
    Key,
}

/// The pace of frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FramePace {
    last_ms: Option<u64>,
    want: Option<Want>,
}

impl FramePace {
    /// A frame is wanted; the most urgent wish counts.
    pub fn want(&mut self, want: Want) {
        self.want = self.want.max(Some(want));
    }

    /// When the next frame is due; absent if none is wanted.
    #[must_use]
    pub fn due_ms(&self) -> Option<u64> {
        let interval_ms = match self.want? {
            Want::Story => STORY_INTERVAL_MS,
            Want::Picture => PICTURE_INTERVAL_MS,
            Want::Key => KEY_INTERVAL_MS,
        };
        Some(self.last_ms.map_or(0, |last_ms| last_ms.saturating_add(interval_ms)))
    }

    /// Whether a frame is due.
    #[must_use]
    pub fn is_due(&self, now_ms: u64) -> bool {
        self.due_ms().is_some_and(|due_ms| due_ms <= now_ms)
    }

    /// A frame was drawn.
    pub const fn drawn(&mut self, now_ms: u64) {
        self.last_ms = Some(now_ms);
        self.want = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_come_first_and_nothing_is_drawn_without_a_change() {
        let mut pace = FramePace::default();
        assert_eq!(pace.due_ms(), None);
        pace.want(Want::Story);
        assert!(pace.is_due(0));
        pace.drawn(1_000);
        assert!(!pace.is_due(u64::MAX));
        pace.want(Want::Story);
        assert_eq!(pace.due_ms(), Some(1_067));
        pace.want(Want::Picture);
        assert_eq!(pace.due_ms(), Some(1_055));
        pace.want(Want::Key);
        pace.want(Want::Story);
        assert_eq!(pace.due_ms(), Some(1_010));
        assert!(!pace.is_due(1_009) && pace.is_due(1_010));
    }

    #[test]
    fn frames_are_at_most_so_many_a_second() {
        for (want, frames_max) in [(Want::Story, 15), (Want::Picture, 19), (Want::Key, 100)] {
            let mut pace = FramePace::default();
            let mut frames = 0;
            for now_ms in 1..=1_000 {
                pace.want(want);
                if pace.is_due(now_ms) {
                    pace.drawn(now_ms);
                    frames += 1;
                }
            }
            assert!(frames <= frames_max && frames >= frames_max - 1, "{want:?}: {frames}");
        }
    }
}
