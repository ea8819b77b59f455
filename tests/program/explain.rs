//! `holdpoint explain` on the stores of scenarios, compared with the expected output.

use std::path::Path;
use std::process::{Command, Output};

use crate::reported_error::assert_error;

/// The program with arguments and a store.
fn holdpoint(arguments: &[&str], data: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint")).args(arguments).arg("--data").arg(data).output().unwrap()
}

fn stdout_text(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// Scenarios without simulation: their stores do not depend on the physics.
const GOLDEN: [(&str, &str, &str); 2] = [
    ("reject-interface", "grasp-tool-frame", include_str!("explain/reject-interface.txt")),
    ("reject-policy", "grasp-direct-bus", include_str!("explain/reject-policy.txt")),
];

#[test]
fn the_output_matches_the_golden_files() {
    for (scenario, candidate, expected) in GOLDEN {
        let data = tempfile::tempdir().unwrap();
        let script = format!("tests/scenarios/{scenario}.toml");
        holdpoint(&["run", "--headless", "--script", &script, "--seed", "101"], data.path());
        let text = stdout_text(&holdpoint(&["explain", candidate], data.path()));
        assert_eq!(text, expected, "{scenario}");
        assert!(text.lines().all(|line| line.chars().count() <= 80), "{scenario}: wider than 80 columns");
        let json = stdout_text(&holdpoint(&["explain", candidate, "--json"], data.path()));
        let value: serde_json::Value = serde_json::from_str(&json).unwrap();
        let decisions = value["decisions"].as_array().unwrap();
        assert!(!decisions.is_empty());
        // JSON has every decision.
        for reason in decisions.iter().flat_map(|decision| decision["reasons"].as_array().unwrap()) {
            assert!(reason["code"].as_str().unwrap().contains('-') && reason["rule"]["source"].is_string());
        }
    }
}

#[test]
fn a_missing_subject_fails() {
    let data = tempfile::tempdir().unwrap();
    assert_error(&holdpoint(&["explain", "align@1.1.0", "--json"], data.path()), 2, "no-store");
    holdpoint(&["run", "--headless", "--script", "tests/scenarios/reject-interface.toml"], data.path());
    for subject in ["align@9.9.9", "no-such-folder"] {
        let error = assert_error(&holdpoint(&["explain", subject, "--json"], data.path()), 2, "not-found");
        assert!(error["error"].as_str().unwrap().contains(subject) && error["hint"].is_string(), "{error}");
    }
    let baseline = stdout_text(&holdpoint(&["explain", "grasp@1.0.0", "--json"], data.path()));
    let baseline: serde_json::Value = serde_json::from_str(&baseline).unwrap();
    assert_eq!(baseline["decisions"], serde_json::json!([]));
}
