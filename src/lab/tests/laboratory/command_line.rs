//! The command line of the laboratory: folders that it writes, errors, and the study of the rules.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use crate::reported_error::assert_error;

/// The laboratory in a folder, with JSON.
fn laboratory(folder: &Path, line: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdpoint-lab"));
    command.current_dir(folder).args(line).arg("--json").output().unwrap()
}

#[test]
fn experiments_write_only_into_a_named_folder() {
    let root = tempfile::tempdir().unwrap();
    for line in [
        "refine grasp",
        "experiment drift",
        "experiment e1",
        "experiment sensors",
        "experiment danger",
        "experiment demonstrations",
        "experiment distinguisher",
        "experiment throwers",
        "pool generate --seed 1",
    ] {
        let words: Vec<&str> = line.split(' ').collect();
        let error = assert_error(&laboratory(root.path(), &words), 2, "usage");
        assert!(error["error"].as_str().unwrap().contains("--out"), "{line}: {error}");
        assert_eq!(fs::read_dir(root.path()).unwrap().count(), 0, "{line}");
    }
}

#[test]
fn a_key_of_cached_cells_needs_their_folder() {
    let root = tempfile::tempdir().unwrap();
    let pool = concat!(env!("CARGO_MANIFEST_DIR"), "/../../manifests/pool");
    let line = ["experiment", "per-candidate", "--pool", pool, "--cache-key", "cells.key"];
    let error = assert_error(&laboratory(root.path(), &line), 2, "usage");
    assert!(error["error"].as_str().unwrap().contains("--cache-key"), "{error}");
}

#[test]
fn a_limit_of_a_files_size_is_an_error() {
    let root = tempfile::tempdir().unwrap();
    let pool = concat!(env!("CARGO_MANIFEST_DIR"), "/../../manifests/pool");
    let line = format!(
        "ulimit -f 1; exec '{}' pool show '{pool}' --json > out",
        env!("CARGO_BIN_EXE_holdpoint-lab")
    );
    let output = Command::new("sh").args(["-c", &line]).current_dir(root.path()).output().unwrap();
    assert_error(&output, 2, "output");
}

/// The rules with stated error rates, by their names in the study.
const STUDIED: [&str; 6] = [
    "exact curtailment",
    "finite population, pass rule",
    "finite population, pairs",
    "kappa_B",
    "shadow",
    "monitor",
];

#[test]
fn a_short_study_refutes_no_stated_rate() {
    // A refuted rate ends with another code than 0.
    let run = laboratory(Path::new("."), &["bench", "stats", "--runs", "100"]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let report: Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!((report["runs"].as_u64(), report["tables"].as_array().map(Vec::len)), (Some(100), Some(9)));
    let findings = report["findings"].as_array().unwrap();
    for rule in STUDIED {
        let of = findings.iter().filter(|finding| finding["rule"] == rule);
        let stated = of.clone().filter(|finding| !finding["stated"].is_null()).count();
        assert!(stated > 0 && stated < of.count(), "{rule} has stated and other figures");
    }
    let value = |what: &str, under: &str| {
        let found =
            findings.iter().find(|f| f["what"] == what && f["under"].as_str().unwrap().starts_with(under));
        found.unwrap_or_else(|| panic!("{what}, {under}"))["value"].as_f64().unwrap()
    };
    // The findings of the study, with margins of more than four standard errors at a hundred runs.
    assert!(value("equal-compatible", "align-improved, 300 pairs") > 0.9);
    assert!(value("equal-compatible", "align-improved, 120 pairs") < 0.97);
    assert!(value("anomalies-incompatible", "place-robust, 300 pairs") > 0.95);
    assert!(value("delay-to-rollback", "sim, 20 twins, failures 0.05 and +0.4") < 60.0);
    // Under `real` and `human` a provisional version is rolled back by the warning that restricts it under `sim`.
    for (under, is_coupled) in [("sim, 20", false), ("real, 30", true), ("human, 40", true)] {
        let under = format!("{under} twins, failures 0.05 and +0.2");
        let [restricted, rolled_back] =
            ["delay-to-restriction", "delay-to-rollback"].map(|what| value(what, &under));
        assert_eq!(rolled_back == restricted, is_coupled, "{under}");
    }
}
