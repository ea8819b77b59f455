//! The engine's clock over restarts: stored beside the database, so that a later engine resumes from the end of the last one
//! and not from its last record, which may be hours older.
//!
//! The file only advances the clock, by no more than the machine's clock has advanced since the last record, and by no more
//! than `AHEAD_MAX_MS`. Neither is in the chain, and any process that may write to the folder can change both. Without the
//! file or a valid advance, the clock resumes from the last record.

use std::fs::{File, OpenOptions};
use std::os::unix::fs::{FileExt as _, OpenOptionsExt as _};
use std::path::PathBuf;

use crate::wall_clock::wall_now;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_store::{Layout, RecordViews, StoreError};
use holdpoint_text::file::{NO_LINK, read_text, regular};

/// Interval between writes, ms of the clock: the most that a sudden end loses.
const EVERY_MS: u64 = 1_000;

/// How far ahead of the last record the file may put the clock, ms. A running cell has a record every few minutes; one that is
/// stopped over a long weekend has none.
const AHEAD_MAX_MS: u64 = 4 * 24 * 3_600_000;

/// Bytes of the file: a number of this many digits and the end of its line.
const BYTES: usize = 21;

/// The stored clock of the running engine.
pub struct PersistedClock {
    file: Option<File>,
    stored_ms: u64,
}

fn path(layout: &Layout) -> PathBuf {
    layout.folder().join("clock")
}

/// The time at which the clock of an engine on this store resumes, virtual ms.
///
/// # Errors
/// If the store cannot be read.
pub fn resumed_ms(layout: &Layout, views: &dyn RecordViews) -> Result<u64, StoreError> {
    let head = views.head()?;
    let written_ms = views.stamp(head.seq)?.and_then(|stamp| stamp.wall_ms);
    Ok(resumed(head.at_ms, read_stored(layout), written_ms, wall_now().map(WallTime::ms)))
}

fn resumed(head_ms: u64, stored_ms: Option<u64>, written_ms: Option<i64>, wall_ms: Option<i64>) -> u64 {
    let (Some(stored_ms), Some(written_ms), Some(wall_ms)) = (stored_ms, written_ms, wall_ms) else {
        return head_ms;
    };
    let passed_ms = u64::try_from(wall_ms.saturating_sub(written_ms)).unwrap_or(0);
    stored_ms.clamp(head_ms, head_ms.saturating_add(passed_ms.min(AHEAD_MAX_MS)))
}

/// The content of the file, if it has the form that an engine writes.
fn read_stored(layout: &Layout) -> Option<u64> {
    let text = read_text(&path(layout), BYTES as u64).ok()?;
    text.trim_end().parse().ok()
}

impl PersistedClock {
    /// Stores the clock of an engine that begins at `from_ms`. A file that cannot be written has no further effect.
    #[must_use]
    pub fn begin(layout: &Layout, from_ms: u64) -> Self {
        let file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .custom_flags(NO_LINK)
            .open(path(layout))
            .and_then(regular);
        Self { file: file.ok(), stored_ms: from_ms }
    }

    /// No stored clock: a script's is only in its record.
    #[must_use]
    pub const fn none() -> Self {
        Self { file: None, stored_ms: 0 }
    }

    /// Stores the time, once it is due.
    pub fn store_if_due(&mut self, now_ms: u64) {
        if now_ms.saturating_sub(self.stored_ms) >= EVERY_MS {
            self.store(now_ms);
        }
    }

    /// Stores the time.
    pub fn store(&mut self, now_ms: u64) {
        let Some(file) = &self.file else { return };
        self.stored_ms = now_ms;
        // One write in place: a reader sees the old or the new number, and a full disk keeps the old one.
        drop(file.write_all_at(format!("{now_ms:020}\n").as_bytes(), 0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stored_clock_advances_no_further_than_time_has_passed() {
        for (head, stored, written, wall, expected) in [
            (5_000, None, Some(1_000), Some(900_000), 5_000),
            (5_000, Some(65_000), Some(1_000), Some(900_000), 65_000),
            (5_000, Some(4_000), Some(1_000), Some(900_000), 5_000),
            (5_000, Some(u64::MAX), Some(1_000), Some(11_000), 15_000),
            (5_000, Some(65_000), Some(90_000), Some(11_000), 5_000),
            (5_000, Some(65_000), None, Some(11_000), 5_000),
            // Another process wrote both.
            (5_000, Some(u64::MAX), Some(1), Some(1_795_501_388_366), 5_000 + AHEAD_MAX_MS),
        ] {
            assert_eq!(resumed(head, stored, written, wall), expected);
        }
    }

    #[test]
    fn only_a_valid_stored_time_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let layout = Layout::new(folder.path());
        assert_eq!(read_stored(&layout), None);
        let mut clock = PersistedClock::begin(&layout, 100);
        clock.store_if_due(1_099);
        assert_eq!(read_stored(&layout), None);
        clock.store_if_due(1_100);
        assert_eq!(read_stored(&layout), Some(1_100));
        clock.store(u64::MAX);
        clock.store(1_200);
        assert_eq!(read_stored(&layout), Some(1_200));
        std::fs::write(path(&layout), "soon\n").unwrap();
        assert_eq!(read_stored(&layout), None);
        std::fs::remove_file(path(&layout)).unwrap();
        std::os::unix::fs::symlink("/dev/null", path(&layout)).unwrap();
        assert!(PersistedClock::begin(&layout, 0).file.is_none());
    }
}
