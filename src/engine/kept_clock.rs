//! The engine's clock over its ends: kept beside the database, so that a later engine goes on from where the last one
//! stood, and not from its last record, which may lie hours before.
//!
//! The file is worth no more than this: it moves the clock on, never back, by no more than the machine's clock has gone
//! on since the last record, and by no more than [`AHEAD_MAX_MS`]: file and time of the machine are in no chain, and whoever
//! may write in the folder writes both. Without it, or without that proof, the clock goes on from the last record.

use std::fs::{File, OpenOptions};
use std::os::unix::fs::{FileExt as _, OpenOptionsExt as _};
use std::path::PathBuf;

use crate::wall_clock::wall_now;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_registry::{Layout, StoreError, Views};
use holdpoint_text::file::{NO_LINK, read_text, regular};

/// How often it is kept, ms of the clock: the most that a sudden end takes back.
const EVERY_MS: u64 = 1_000;

/// How far ahead of the last record the file may put the clock, ms: a cell that works has a record every few minutes, one
/// that stands stopped over a long weekend has none.
const AHEAD_MAX_MS: u64 = 4 * 24 * 3_600_000;

/// Bytes of the file: a number of this many digits and the end of its line.
const BYTES: usize = 21;

/// The clock of the engine at work, as it is kept.
pub(crate) struct KeptClock {
    file: Option<File>,
    kept_ms: u64,
}

fn path(layout: &Layout) -> PathBuf {
    layout.folder().join("clock")
}

/// Where the clock of an engine on this store goes on from, virtual ms.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn resumed_ms(layout: &Layout, views: &Views) -> Result<u64, StoreError> {
    let head = views.head()?;
    let written_ms = views.stamp(head.seq)?.and_then(|stamp| stamp.wall_ms);
    Ok(resumed(head.at_ms, kept(layout), written_ms, wall_now().map(WallTime::ms)))
}

fn resumed(head_ms: u64, kept_ms: Option<u64>, written_ms: Option<i64>, wall_ms: Option<i64>) -> u64 {
    let (Some(kept_ms), Some(written_ms), Some(wall_ms)) = (kept_ms, written_ms, wall_ms) else {
        return head_ms;
    };
    let passed_ms = u64::try_from(wall_ms.saturating_sub(written_ms)).unwrap_or(0);
    kept_ms.clamp(head_ms, head_ms.saturating_add(passed_ms.min(AHEAD_MAX_MS)))
}

/// What the file says, if it is one that an engine writes.
fn kept(layout: &Layout) -> Option<u64> {
    let text = read_text(&path(layout), BYTES as u64).ok()?;
    text.trim_end().parse().ok()
}

impl KeptClock {
    /// Keeps the clock of an engine that begins at `from_ms`. Where the file cannot be written nothing is kept, and nothing
    /// else depends on it.
    pub(crate) fn begin(layout: &Layout, from_ms: u64) -> Self {
        let file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .custom_flags(NO_LINK)
            .open(path(layout))
            .and_then(regular);
        Self { file: file.ok(), kept_ms: from_ms }
    }

    /// No clock: a script's stands in its record alone.
    pub(crate) const fn none() -> Self {
        Self { file: None, kept_ms: 0 }
    }

    /// Keeps the time, once it is due.
    pub(crate) fn look(&mut self, now_ms: u64) {
        if now_ms.saturating_sub(self.kept_ms) >= EVERY_MS {
            self.keep(now_ms);
        }
    }

    /// Keeps the time.
    pub(crate) fn keep(&mut self, now_ms: u64) {
        let Some(file) = &self.file else { return };
        self.kept_ms = now_ms;
        // One write in place: whoever reads it has the old or the new number, and a disk that is full keeps the old one.
        drop(file.write_all_at(format!("{now_ms:020}\n").as_bytes(), 0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kept_clock_moves_on_never_back_and_no_further_than_time_has_passed() {
        for (head, kept, written, wall, expected) in [
            (5_000, None, Some(1_000), Some(900_000), 5_000),
            (5_000, Some(65_000), Some(1_000), Some(900_000), 65_000),
            (5_000, Some(4_000), Some(1_000), Some(900_000), 5_000),
            (5_000, Some(u64::MAX), Some(1_000), Some(11_000), 15_000),
            (5_000, Some(65_000), Some(90_000), Some(11_000), 5_000),
            (5_000, Some(65_000), None, Some(11_000), 5_000),
            // Both were written by somebody else.
            (5_000, Some(u64::MAX), Some(1), Some(1_795_501_388_366), 5_000 + AHEAD_MAX_MS),
        ] {
            assert_eq!(resumed(head, kept, written, wall), expected);
        }
    }

    #[test]
    fn what_is_kept_is_read_and_anything_else_is_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let layout = Layout::new(folder.path());
        assert_eq!(kept(&layout), None);
        let mut clock = KeptClock::begin(&layout, 100);
        clock.look(1_099);
        assert_eq!(kept(&layout), None);
        clock.look(1_100);
        assert_eq!(kept(&layout), Some(1_100));
        clock.keep(u64::MAX);
        clock.keep(1_200);
        assert_eq!(kept(&layout), Some(1_200));
        std::fs::write(path(&layout), "soon\n").unwrap();
        assert_eq!(kept(&layout), None);
        std::fs::remove_file(path(&layout)).unwrap();
        std::os::unix::fs::symlink("/dev/null", path(&layout)).unwrap();
        assert!(KeptClock::begin(&layout, 0).file.is_none());
    }
}
