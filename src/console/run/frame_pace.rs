//! The time of the next frame: at once after a key, else at the pace of the contents, and never without a change.
//!
//! Pure: times are arguments. Must not know what is drawn.

use holdpoint_service::control_socket::FRAME_INTERVAL_MS;

/// Frames for a key: the shortest time since the last one, ms. A key that follows a frame waits for it at most.
const KEY_INTERVAL_MS: u64 = 4;

/// Why a frame is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FrameReason {
    /// A message came, time passed, or the shown camera frame changed.
    Change,
    /// A key was pressed, or the size changed.
    Key,
}

/// The pace of frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FramePace {
    last_ms: Option<u64>,
    want: Option<FrameReason>,
}

impl FramePace {
    /// Requests a frame; the most urgent cause counts.
    pub fn want(&mut self, want: FrameReason) {
        self.want = self.want.max(Some(want));
    }

    /// The time of the next frame; absent if none is requested.
    #[must_use]
    pub fn due_ms(&self) -> Option<u64> {
        let interval_ms = match self.want? {
            FrameReason::Change => FRAME_INTERVAL_MS,
            FrameReason::Key => KEY_INTERVAL_MS,
        };
        Some(self.last_ms.map_or(0, |last_ms| last_ms.saturating_add(interval_ms)))
    }

    /// Whether a frame is due.
    #[must_use]
    pub fn is_due(&self, now_ms: u64) -> bool {
        self.due_ms().is_some_and(|due_ms| due_ms <= now_ms)
    }

    /// A frame was drawn.
    pub const fn frame_drawn(&mut self, now_ms: u64) {
        self.last_ms = Some(now_ms);
        self.want = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_drawn_first_and_unchanged_screens_never() {
        let mut pace = FramePace::default();
        assert_eq!(pace.due_ms(), None);
        pace.want(FrameReason::Change);
        assert!(pace.is_due(0));
        pace.frame_drawn(1_000);
        assert!(!pace.is_due(u64::MAX));
        pace.want(FrameReason::Change);
        assert_eq!(pace.due_ms(), Some(1_125));
        pace.want(FrameReason::Key);
        pace.want(FrameReason::Change);
        assert_eq!(pace.due_ms(), Some(1_004));
        assert!(!pace.is_due(1_003) && pace.is_due(1_004));
    }

    #[test]
    fn frame_rate_is_limited_by_the_reason_for_drawing() {
        for (want, frames_max) in [(FrameReason::Change, 8), (FrameReason::Key, 250)] {
            let mut pace = FramePace::default();
            let mut frames = 0;
            for now_ms in 1..=1_000 {
                pace.want(want);
                if pace.is_due(now_ms) {
                    pace.frame_drawn(now_ms);
                    frames += 1;
                }
            }
            assert!(frames <= frames_max && frames >= frames_max - 1, "{want:?}: {frames}");
        }
    }
}
