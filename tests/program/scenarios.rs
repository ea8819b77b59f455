//! The program runs its scenarios as a user would: exit code, verified audit, equal logs.
//!
//! The fast ones run here; all ten run in the checks of a change, with one shared cache.

use std::path::Path;
use std::process::{Command, Output};

use crate::quick_folder::quick_folder;

fn run(script: &str, data: &Path, seed: u64) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint"))
        .args(["run", "--headless", "--json", "--seed", &seed.to_string(), "--script"])
        .arg(format!("tests/scenarios/{script}.toml"))
        .arg("--data")
        .arg(data)
        .output()
        .unwrap()
}

fn audit_verifies(data: &Path) -> bool {
    let verify = Command::new(env!("CARGO_BIN_EXE_holdpoint"))
        .args(["audit", "verify", "--data"])
        .arg(data)
        .output()
        .unwrap();
    verify.status.success()
}

/// (scenario, exit code, text of its last state change).
const FAST: [(&str, i32, &str); 4] = [
    ("reject-interface", 1, "interface-signature-breaking"),
    ("reject-policy", 1, "policy-uncovered-high-risk"),
    ("reject-recovery", 1, "recovery-"),
    ("permission-exceeded", 1, "behavior-hard-stop"),
];

#[test]
fn scenarios_end_as_named_and_their_audit_verifies() {
    for (script, code, reason) in FAST {
        let data = quick_folder();
        let output = run(script, data.path(), 1);
        let log = String::from_utf8(output.stdout).unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{script}: {stderr}");
        let last = log.lines().rfind(|line| line.contains("state-changed")).unwrap();
        assert!(last.contains("\"rejected\"") && last.contains(reason), "{script}: {last}");
        assert!(audit_verifies(data.path()), "{script}: the audit chain does not verify");
    }
}

/// After the sandbox the record has the declared and the observed use of a version.
#[test]
fn declared_and_observed_permissions_are_on_record() {
    let data = quick_folder();
    assert_eq!(run("permission-exceeded", data.path(), 1).status.code(), Some(1));
    let explain = |json: &[&str]| {
        let mut explain = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
        let output = explain.args(["explain", "align@1.1.5", "--data"]).arg(data.path()).args(json).output();
        String::from_utf8(output.unwrap().stdout).unwrap()
    };
    let document: serde_json::Value = serde_json::from_str(explain(&["--json"]).trim()).unwrap();
    let decisions = document["decisions"].as_array().unwrap();
    let permissions: Vec<_> = decisions.iter().filter_map(|decision| decision.get("permissions")).collect();
    assert_eq!(permissions.len(), 1, "the sandbox's decision has them: {document:#}");
    assert_eq!(permissions[0]["declared"]["zones"], serde_json::json!(["work", "transit"]));
    assert_eq!(permissions[0]["exceeded"][0], "zone tray");
    assert!(permissions[0]["used"]["undeclared"].as_u64().unwrap() > 0);
    assert!(permissions[0]["tasks"].as_u64().unwrap() > 0);
    let text = explain(&[]);
    assert!(text.contains("zone tray"), "{text}");
}

#[test]
fn equal_scenarios_with_equal_seeds_give_equal_logs_for_any_number_of_workers() {
    let logs = [1, 2].map(|jobs| {
        let data = quick_folder();
        let output = Command::new(env!("CARGO_BIN_EXE_holdpoint"))
            .args(["run", "--headless", "--json", "--seed", "3", "--jobs", &jobs.to_string()])
            .args(["--script", "tests/scenarios/reject-recovery.toml", "--data"])
            .arg(data.path())
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(1));
        String::from_utf8(output.stdout).unwrap()
    });
    assert!(logs[0].lines().count() > 20, "the log is too short to compare");
    assert_eq!(logs[0], logs[1]);
}
