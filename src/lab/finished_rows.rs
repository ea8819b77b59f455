//! Rows of finished items: a line of JSON each, written as soon as the item is finished.
//!
//! A cache is bound to one key and one build. The rows outlive both: those of an interrupted run are not lost, and those of
//! several runs make one report. Must not compute a figure.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use holdpoint_engine::build_digest::decided_by;
use holdpoint_text::file::read_text;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::pipeline_experiments::{ExperimentError, write_atomically};

/// The most bytes of one file.
const BYTES_MAX: u64 = 64 << 20;

/// One line.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FinishedRow<S, R> {
    /// Digest of everything that decides.
    decided_by: String,
    setting: S,
    result: R,
}

/// A file of rows, open for more.
pub(crate) struct RowFile {
    path: PathBuf,
    /// In order, each once: a cached result that is read again adds no row.
    lines: Mutex<BTreeSet<String>>,
}

impl RowFile {
    /// Opens a file with the rows of earlier runs, if there is one. Makes its folder.
    ///
    /// # Errors
    /// If the file cannot be read, or the folder cannot be made.
    pub(crate) fn open(path: PathBuf) -> Result<Self, ExperimentError> {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(ExperimentError::file(folder))?;
        }
        let lines = if path.exists() {
            text_of(&path)?.lines().map(str::to_owned).collect()
        } else {
            BTreeSet::new()
        };
        Ok(Self { path, lines: Mutex::new(lines) })
    }

    /// Writes the row of an item that this build finished.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(crate) fn add<S: Serialize, R: Serialize>(
        &self,
        setting: &S,
        result: &R,
    ) -> Result<(), ExperimentError> {
        let row = FinishedRow { decided_by: decided_by(holdpoint_sim::BUILD), setting, result };
        let line = serde_json::to_string(&row)?;
        let mut lines = self
            .lines
            .lock()
            .map_err(|_| ExperimentError::Unexpected("another worker panicked".to_owned()))?;
        if lines.insert(line) {
            let text: String = lines.iter().flat_map(|line| [line.as_str(), "\n"]).collect();
            write_atomically(&self.path, text.as_bytes())?;
        }
        Ok(())
    }
}

/// The results of one build with one setting.
#[derive(Debug, PartialEq)]
pub(crate) struct RowGroup<S, R> {
    pub(crate) decided_by: String,
    pub(crate) setting: S,
    pub(crate) results: Vec<R>,
}

/// The rows of several files; a row that several files have counts once.
///
/// # Errors
/// If a file cannot be read, a line is no row of this experiment, or there is no row.
pub(crate) fn read<S, R>(files: &[PathBuf]) -> Result<Vec<RowGroup<S, R>>, ExperimentError>
where
    S: DeserializeOwned + PartialEq,
    R: DeserializeOwned,
{
    let (mut seen, mut groups) = (BTreeSet::new(), Vec::<RowGroup<S, R>>::new());
    for file in files {
        for (at, line) in text_of(file)?.lines().enumerate() {
            if !seen.insert(line.to_owned()) {
                continue;
            }
            let row: FinishedRow<S, R> = serde_json::from_str(line).map_err(|error| {
                let (file, number) = (file.display(), at + 1);
                ExperimentError::Text(format!("{file}, line {number}, is no row of this experiment: {error}"))
            })?;
            let FinishedRow { decided_by, setting, result } = row;
            let of_group =
                |group: &&mut RowGroup<S, R>| group.decided_by == decided_by && group.setting == setting;
            match groups.iter_mut().find(of_group) {
                Some(group) => group.results.push(result),
                None => groups.push(RowGroup { decided_by, setting, results: vec![result] }),
            }
        }
    }
    if groups.is_empty() {
        return Err(ExperimentError::Text("the files have no row".to_owned()));
    }
    Ok(groups)
}

fn text_of(path: &Path) -> Result<String, ExperimentError> {
    read_text(path, BYTES_MAX).map_err(ExperimentError::file(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_several_files_are_grouped_by_setting_and_counted_once() {
        let folder = tempfile::tempdir().unwrap();
        let files = ["one", "two"].map(|name| folder.path().join(name));
        for (file, rows) in files.iter().zip([[(400, 1), (400, 2)], [(400, 2), (9, 3)]]) {
            for (setting, result) in rows {
                // Reopens the file for each row, and adds each row twice.
                let open = RowFile::open(file.clone()).unwrap();
                open.add(&setting, &result).unwrap();
                open.add(&setting, &result).unwrap();
            }
            assert_eq!(text_of(file).unwrap().lines().count(), 2);
        }
        let group = |setting: u64, results: &[u64]| RowGroup {
            decided_by: decided_by(holdpoint_sim::BUILD),
            setting,
            results: results.to_vec(),
        };
        let found = read::<u64, u64>(&files).unwrap();
        assert_eq!(found, [group(400, &[1, 2]), group(9, &[3])]);
    }

    #[test]
    fn row_of_another_build_stays_and_is_another_group() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rows");
        std::fs::write(&file, "{\"decided_by\":\"before\",\"setting\":1,\"result\":7}\n").unwrap();
        RowFile::open(file.clone()).unwrap().add(&1, &7).unwrap();
        let builds: Vec<String> =
            read::<u64, u64>(&[file]).unwrap().into_iter().map(|group| group.decided_by).collect();
        assert_eq!(builds.len(), 2);
        assert!(builds.contains(&"before".to_owned()));
    }

    #[test]
    fn line_that_is_no_row_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rows");
        std::fs::write(&file, "{\"decided_by\":\"x\",\"setting\":1,\"result\":2}\n{}\n").unwrap();
        let Err(ExperimentError::Text(problem)) = read::<u64, u64>(std::slice::from_ref(&file)) else {
            panic!("it is read")
        };
        assert!(problem.contains("line 2"), "{problem}");
        std::fs::write(&file, "").unwrap();
        assert!(matches!(read::<u64, u64>(&[file]), Err(ExperimentError::Text(_))));
    }
}
