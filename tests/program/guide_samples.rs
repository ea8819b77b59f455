//! The sample outputs in the guide are what the program prints.
//!
//! A comment before a sample names the scenario that fills a store, or `none`, and the command:
//! `<!-- sample: reject-in-shadow | explain grasp@1.1.3 -->`. Each line of the sample is a line of the output, in that order.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Mutex;

use tempfile::TempDir;

use crate::folder_copy::FolderCopy;
use crate::quick_folder::quick_folder;

/// The fewest samples that the guide has: so many are checked.
const SAMPLES_MIN: usize = 5;

struct Sample {
    page: PathBuf,
    scenario: String,
    command: String,
    lines: Vec<String>,
}

fn pages(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            pages(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "md") {
            found.push(path);
        }
    }
}

fn samples(page: &Path) -> Vec<Sample> {
    let text = std::fs::read_to_string(page).unwrap();
    let mut found = Vec::new();
    for part in text.split("<!-- sample: ").skip(1) {
        let (marker, rest) = part.split_once(" -->").unwrap();
        let (scenario, command) = marker.split_once(" | ").unwrap();
        let (before, block) = rest.split_once("```text\n").unwrap();
        assert!(before.trim().is_empty(), "{}: no sample after {marker:?}", page.display());
        let (block, _) = block.split_once("```").unwrap();
        let lines = block.lines().map(|line| line.trim().to_owned()).filter(|line| !line.is_empty());
        found.push(Sample {
            page: page.to_owned(),
            scenario: scenario.to_owned(),
            command: command.to_owned(),
            lines: lines.collect(),
        });
    }
    found
}

fn holdpoint(arguments: &[&str], data: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint")).args(arguments).arg("--data").arg(data).output().unwrap()
}

/// A folder with a `store` as the scenario leaves it; a scenario runs once in a process.
pub fn filled_store(scenario: &str) -> TempDir {
    static FILLED: Mutex<BTreeMap<String, FolderCopy>> = Mutex::new(BTreeMap::new());
    if scenario == "none" {
        return quick_folder();
    }
    let mut filled = FILLED.lock().unwrap();
    let copy = filled.entry(scenario.to_owned()).or_insert_with(|| {
        let folder = quick_folder();
        let file = format!("tests/scenarios/{scenario}.toml");
        let output = holdpoint(&["scenario", "run", &file], &folder.path().join("store"));
        // A scenario ends with the outcome of its version.
        assert!(matches!(output.status.code(), Some(0 | 1 | 4)), "{output:?}");
        FolderCopy::of(folder.path())
    });
    copy.folder()
}

#[test]
fn samples_in_the_guide_are_what_the_program_prints() {
    let mut found = Vec::new();
    pages(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src/guide"), &mut found);
    let samples: Vec<Sample> = found.iter().flat_map(|page| samples(page)).collect();
    assert!(samples.len() >= SAMPLES_MIN, "{} samples are checked", samples.len());
    let mut stores: BTreeMap<String, TempDir> = BTreeMap::new();
    for sample in &samples {
        let folder = stores.entry(sample.scenario.clone()).or_insert_with_key(|name| filled_store(name));
        let data = folder.path().join("store");
        let output = holdpoint(&sample.command.split(' ').collect::<Vec<_>>(), &data);
        let text =
            String::from_utf8_lossy(&output.stdout).replace(&format!(" --data {}", data.display()), "");
        let mut left = text.lines().map(str::trim);
        for line in &sample.lines {
            assert!(
                left.any(|printed| printed == line),
                "{}: {line:?} is not in what `holdpoint {}` prints:\n{text}",
                sample.page.display(),
                sample.command
            );
        }
    }
}
