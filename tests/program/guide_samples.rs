//! The sample outputs in the guide are what the program prints.
//!
//! Every block of the language `text` in the guide is output. The comment before it says where the output is from:
//!
//! - `<!-- sample: reject-in-shadow | explain grasp@1.1.3 -->` names the scenario that fills a store, or `none`, and the
//!   command. The command `scenario run` is the run of that scenario itself.
//! - `<!-- screen: console__palette_80x24 -->` names a snapshot of a screen.
//!
//! Each line of the sample is a line of the output, in that order; `…` matches any text.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Mutex;

use regex::Regex;
use tempfile::TempDir;

use crate::folder_copy::FolderCopy;
use crate::quick_folder::quick_folder;

/// The fewest samples that the guide has: so many are checked.
const SAMPLES_MIN: usize = 12;

/// What the run of a scenario printed, beside the store that it filled.
const PRINTED: &str = "printed";

/// The output that a sample is a part of.
#[derive(Debug)]
enum Source {
    Command {
        scenario: String,
        command: String,
    },
    /// The name of a snapshot.
    Screen(String),
}

impl Source {
    /// Reads a comment; `None` if it is about something else.
    fn parse(line: &str) -> Option<Self> {
        let comment = line.strip_prefix("<!-- ")?.strip_suffix(" -->")?;
        if let Some(screen) = comment.strip_prefix("screen: ") {
            return Some(Self::Screen(screen.to_owned()));
        }
        let (scenario, command) = comment.strip_prefix("sample: ")?.split_once(" | ")?;
        Some(Self::Command { scenario: scenario.to_owned(), command: command.to_owned() })
    }

    /// The whole output.
    fn text(&self, stores: &mut BTreeMap<String, TempDir>) -> String {
        let (scenario, command) = match self {
            Self::Command { scenario, command } => (scenario, command),
            Self::Screen(name) => {
                let file = format!("tests/screens/snapshots/screens__{name}.snap");
                return fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap();
            }
        };
        let folder = stores.entry(scenario.clone()).or_insert_with_key(|name| filled_store(name));
        if command == "scenario run" {
            return fs::read_to_string(folder.path().join(PRINTED)).unwrap();
        }
        let data = folder.path().join("store");
        let output = holdpoint(&command.split(' ').collect::<Vec<_>>(), &data);
        String::from_utf8_lossy(&output.stdout).replace(&format!(" --data {}", data.display()), "")
    }
}

struct Sample {
    page: PathBuf,
    source: Source,
    lines: Vec<String>,
}

fn pages(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            pages(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "md") {
            found.push(path);
        }
    }
}

fn samples(page: &Path) -> Vec<Sample> {
    let text = fs::read_to_string(page).unwrap();
    let mut lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
    let (mut found, mut above) = (Vec::new(), "");
    while let Some(line) = lines.next() {
        if line == "```text" {
            let source = Source::parse(above)
                .unwrap_or_else(|| panic!("{}: no source of the sample below {above:?}", page.display()));
            let block = lines.by_ref().take_while(|line| *line != "```").map(str::to_owned);
            found.push(Sample { page: page.to_owned(), source, lines: block.collect() });
        }
        above = line;
    }
    found
}

/// Whether a printed line is that of a sample.
fn is_line_of(sample: &str, printed: &str) -> bool {
    let parts: Vec<String> = sample.split('…').map(regex::escape).collect();
    Regex::new(&format!("^{}$", parts.join(".*"))).unwrap().is_match(printed)
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
        fs::write(folder.path().join(PRINTED), &output.stdout).unwrap();
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
    for Sample { page, source, lines } in &samples {
        let text = source.text(&mut stores);
        let mut left = text.lines().map(str::trim);
        for line in lines {
            assert!(
                left.any(|printed| is_line_of(line, printed)),
                "{}: {line:?} is not in the output of {source:?}:\n{text}",
                page.display()
            );
        }
    }
}

#[test]
fn only_the_mask_of_a_sample_stands_for_other_text() {
    for (sample, printed, is_same) in [
        ("limit 35 N.", "limit 35 N.", true),
        ("limit 35 N.", "limit 35 Nm", false),
        ("created in …", "created in /home/ana", true),
        ("created in … by ana", "created in /home/ana", false),
        ("created", "created in /home/ana", false),
    ] {
        assert_eq!(is_line_of(sample, printed), is_same, "{sample:?} and {printed:?}");
    }
}
