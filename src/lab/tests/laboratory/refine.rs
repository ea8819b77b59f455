//! The optimizer as its user sees it: the same candidate for any way of running, nothing overwritten, one clear
//! error.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

use holdpoint::cli::{Cli, CommandOutput, Exit, RealEngine, dispatch};
use holdpoint::governance::submission::Provenance;
use holdpoint::runtime::capability::{self, Capability};
use holdpoint_body::TaskKind;
use holdpoint_lab::parameter_search::journal::FILE;
use holdpoint_lab::parameter_search::settings::{RefineError, SearchSettings};
use holdpoint_lab::parameter_search::{RefineReport, refine};

use crate::reported_error::assert_error;

/// The quickest family, with the least effort that still finds an improvement.
fn settings(out: &Path, jobs: usize) -> SearchSettings<'_> {
    SearchSettings { task: TaskKind::Place, generations: 2, episodes: 2, seed: 3, jobs, out, version: None }
}

/// Runs to the end, or until `evaluations` were reported.
fn run(out: &Path, jobs: usize, evaluations: Option<usize>) -> Result<RefineReport, RefineError> {
    let cancel = AtomicBool::new(false);
    let mut reports = 0;
    refine(&settings(out, jobs), &cancel, &mut |_| {
        reports += 1;
        cancel.store(evaluations.is_some_and(|evaluations| reports >= evaluations), Ordering::Release);
    })
}

/// The files of a folder with their content.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entry = |entry: std::io::Result<fs::DirEntry>| {
        let entry = entry.unwrap();
        (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap())
    };
    fs::read_dir(folder).unwrap().map(entry).collect()
}

#[test]
fn interrupted_and_resumed_equals_uninterrupted_for_any_number_of_workers() {
    let (uninterrupted, interrupted) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let report = run(uninterrupted.path(), 2, None).unwrap();
    let expected = contents(&report.folder);
    assert!(report.practised.after.cost() < report.practised.before.cost(), "{report:?}");
    assert!(!report.changes.is_empty(), "{report:?}");

    // Interrupted twice, with another number of workers, and damaged in between.
    let journal = interrupted.path().join("place-refined.refine").join(FILE);
    let mut lines = 0;
    for after in [5, 14] {
        let error = run(interrupted.path(), 1, Some(after)).unwrap_err();
        let RefineError::Interrupted { evaluations, .. } = error else { panic!("{error}") };
        assert_eq!(evaluations as usize, after);
        assert!(!interrupted.path().join("place-refined").exists());
        let text = fs::read_to_string(&journal).unwrap();
        assert!(text.lines().count() > lines, "{text}");
        lines = text.lines().count();
        fs::write(&journal, &text[..text.len() - 30]).unwrap();
    }
    let resumed = run(interrupted.path(), 1, None).unwrap();
    assert_eq!(contents(&resumed.folder), expected);

    // The result stays, and the refusal simulates nothing.
    let again = run(uninterrupted.path(), 2, None).unwrap_err();
    assert!(matches!(again, RefineError::Exists(_)), "{again}");
    assert_eq!(contents(&report.folder), expected);

    // It is a candidate like any other.
    let package = capability::read(&report.folder).unwrap();
    let candidate = Capability::load("place-refined", package).unwrap();
    assert_eq!(candidate.id().to_string(), "place@1.1.0");
    assert_eq!(candidate.submission.provenance, Provenance::Optimiser);
    assert!(candidate.submission.summary.contains("2 generations"), "{}", candidate.submission.summary);
    let check = ["holdpoint", "candidate", "check"].map(OsString::from);
    let check = Cli::parse_line(check.into_iter().chain([report.folder.into_os_string()])).unwrap();
    let mut output = CommandOutput::to(std::io::sink(), false);
    let checked = dispatch(&check, &mut RealEngine, &mut output);
    assert_eq!(checked.map_err(|error| error.to_string()), Ok(Exit::Confirmed));
}

/// (arguments, reason, a value that the error names).
#[test]
fn bad_input_gets_one_clear_error() {
    let out = tempfile::tempdir().unwrap();
    fs::create_dir(out.path().join("align-refined")).unwrap();
    fs::write(out.path().join("file"), "").unwrap();
    let file = out.path().join("file").display().to_string();
    for (arguments, reason, value) in [
        (vec!["align"], "exists", "align-refined"),
        (vec!["grasp", "--version", "1.0.0"], "usage", "1.0.0"),
        (vec!["grasp", "--version", "new"], "usage", "'new'"),
        (vec!["grasp", "--generations", "0"], "usage", "1..=1000"),
        (vec!["grasp", "--episodes", "501"], "usage", "1..=500"),
        (vec!["grasp", "--jobs", "65"], "usage", "1..=64"),
        (vec!["grasp", "--seed", "-1"], "usage", "'-1'"),
        (vec!["park"], "usage", "'park'"),
        (vec!["grasp", "--out", &file], "bad-file", "grasp-refined.refine"),
    ] {
        // Nothing is written into the current folder unless it is named.
        let folder = if arguments.contains(&"--out") { &[][..] } else { &["--out", "."] };
        let output = Command::new(env!("CARGO_BIN_EXE_holdpoint-lab"))
            .current_dir(out.path())
            .args(["refine", "--json"])
            .args(&arguments)
            .args(folder)
            .output()
            .unwrap();
        let error = assert_error(&output, 2, reason);
        assert!(error["error"].as_str().unwrap().contains(value), "{arguments:?}: {error}");
        assert_eq!(String::from_utf8(output.stderr).unwrap().lines().count(), 1, "{arguments:?}");
    }
}
