//! The simulated evaluations, line by line, so that an interrupted search continues.
//!
//! Owns `evaluations.jsonl`. A line is written when its episodes are done and carries a checksum; a line that is
//! torn, damaged or of another version is no line, and its episodes are simulated again. Must not know what a
//! score is worth.

use std::collections::HashMap;
use std::fs::{self, File, OpenOptions};
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::objective::Score;
use super::settings::RefineError;
use holdpoint_governance::ids::Digest;

/// The file's name in its folder.
pub const FILE: &str = "evaluations.jsonl";

/// The largest file: more than a hundred thousand lines, which is more than the longest search has.
const BYTES_MAX: u64 = 64 * 1024 * 1024;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct JournalLine {
    key: Digest,
    score: Score,
    check: Digest,
}

impl JournalLine {
    fn new(key: Digest, score: Score) -> Self {
        Self { key, score, check: check(&key, &score) }
    }
}

fn check(key: &Digest, score: &Score) -> Digest {
    let Score { episodes, successes, ticks } = score;
    let parts: [&[u8]; 4] =
        [key.bytes(), &episodes.to_le_bytes(), &successes.to_le_bytes(), &ticks.to_le_bytes()];
    Digest::of_parts("holdpoint.refine.line.v1", &parts)
}

/// Kept scores, open for more.
pub struct Journal {
    known: HashMap<Digest, Score>,
    file: File,
    path: PathBuf,
}

impl Journal {
    /// Opens the journal of a folder, which is made if there is none.
    ///
    /// # Errors
    /// If the folder or file cannot be used, or the file is larger than any search makes it.
    pub fn open(folder: &Path) -> Result<Self, RefineError> {
        fs::create_dir_all(folder).map_err(RefineError::io("make the folder", folder))?;
        let path = folder.join(FILE);
        let mut file = OpenOptions::new()
            .read(true)
            .append(true)
            .create(true)
            .open(&path)
            .map_err(RefineError::io("open", &path))?;
        let bytes = file.metadata().map_err(RefineError::io("read", &path))?.len();
        if bytes > BYTES_MAX {
            return Err(RefineError::JournalTooLarge { path, bytes, allowed: BYTES_MAX });
        }
        let mut text = Vec::new();
        (&mut file).take(BYTES_MAX).read_to_end(&mut text).map_err(RefineError::io("read", &path))?;
        let known = text.split(|byte| *byte == b'\n').filter_map(sound).collect();
        if text.last().is_some_and(|byte| *byte != b'\n') {
            // A torn line must not swallow the next one.
            file.write_all(b"\n").map_err(RefineError::io("write", &path))?;
        }
        Ok(Self { known, file, path })
    }

    #[must_use]
    pub fn get(&self, key: &Digest) -> Option<Score> {
        self.known.get(key).copied()
    }

    /// Keeps a score.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn put(&mut self, key: Digest, score: Score) -> Result<(), RefineError> {
        let write = |file: &mut File| {
            let mut line = serde_json::to_vec(&JournalLine::new(key, score))?;
            line.push(b'\n');
            // One write: a process that dies leaves a whole line or a torn last one.
            file.write_all(&line)
        };
        write(&mut self.file).map_err(RefineError::io("write", &self.path))?;
        self.known.insert(key, score);
        Ok(())
    }
}

fn sound(line: &[u8]) -> Option<(Digest, Score)> {
    let JournalLine { key, score, check: stored } = serde_json::from_slice(line).ok()?;
    (check(&key, &score) == stored).then_some((key, score))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(name: &str) -> Digest {
        Digest::of_parts("holdpoint.test.v1", &[name.as_bytes()])
    }

    #[test]
    fn journal_restores_scores_and_drops_damaged_lines() {
        let folder = tempfile::tempdir().unwrap();
        let score = |ticks| Score { episodes: 4, successes: 3, ticks };
        let mut journal = Journal::open(folder.path()).unwrap();
        for (name, ticks) in [("a", 100), ("b", 200), ("c", 300)] {
            journal.put(key(name), score(ticks)).unwrap();
        }
        drop(journal);
        let file = folder.path().join(FILE);
        let text = fs::read_to_string(&file).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        for (damaged, expected) in [
            (text.clone(), [true, true, true]),
            // A changed number, still JSON.
            (text.replace("\"ticks\":200", "\"ticks\":201"), [true, false, true]),
            (format!("{}\n\u{0}\u{1b}[2J\n{}\n", lines[0], lines[2]), [true, false, true]),
            // Torn in the last line, and in the first.
            (text[..text.len() - 9].to_owned(), [true, true, false]),
            (text[20..].to_owned(), [false, true, true]),
            (String::new(), [false, false, false]),
        ] {
            fs::write(&file, &damaged).unwrap();
            let mut journal = Journal::open(folder.path()).unwrap();
            let found = ["a", "b", "c"].map(|name| journal.get(&key(name)).is_some());
            assert_eq!(found, expected, "{damaged:?}");
            // And it goes on from there.
            journal.put(key("d"), score(400)).unwrap();
            let again = Journal::open(folder.path()).unwrap();
            assert_eq!(again.get(&key("d")), Some(score(400)), "{damaged:?}");
            assert_eq!(again.get(&key("a")), expected[0].then(|| score(100)), "{damaged:?}");
        }
    }

    #[test]
    fn a_folder_that_cannot_be_used_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("taken");
        fs::write(&taken, "").unwrap();
        let error = Journal::open(&taken).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("taken"), "{error}");
        let huge = folder.path().join("huge");
        fs::create_dir(&huge).unwrap();
        File::create(huge.join(FILE)).unwrap().set_len(BYTES_MAX + 1).unwrap();
        let error = Journal::open(&huge).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains(&BYTES_MAX.to_string()), "{error}");
    }
}
