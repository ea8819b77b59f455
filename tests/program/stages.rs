//! One stage of one candidate: `candidate compat`, `sandbox` and `shadow`, each on record and none beyond.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value;

use crate::quick_folder::quick_folder;
use crate::reported_error::assert_error;

fn on(store: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint")).args(arguments).arg("--data").arg(store).output().unwrap()
}

fn register(store: &Path, name: &str) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests/candidates").join(name);
    let output = on(store, &["candidate", "register", folder.to_str().unwrap()]);
    assert!(output.status.success(), "{output:?}");
}

fn state(store: &Path, version: &str) -> String {
    let shown = on(store, &["registry", "show", version, "--json"]);
    let shown: Value = serde_json::from_slice(&shown.stdout).unwrap();
    shown["summary"]["state"].as_str().unwrap().to_owned()
}

/// The exit code and the error text.
fn code_and_stderr(output: &Output) -> (Option<i32>, String) {
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn single_stage_run_starts_no_other_stage() {
    let folder = quick_folder();
    let store = folder.path();
    register(store, "grasp-improved");
    let version = "grasp@1.1.0";
    assert_eq!(state(store, version), "registered");
    // No stage is skipped.
    assert_error(&on(store, &["candidate", "shadow", version, "--json"]), 3, "not-now");
    assert_eq!(state(store, version), "registered");

    let (code, message) = code_and_stderr(&on(store, &["candidate", "compat", version]));
    assert_eq!((code, state(store, version).as_str()), (Some(0), "validated"), "{message}");
    let (code, message) = code_and_stderr(&on(store, &["candidate", "sandbox", version, "--jobs", "2"]));
    assert_eq!((code, state(store, version).as_str()), (Some(0), "sandboxed"), "{message}");
    // A passed stage is not silently run again.
    assert_error(&on(store, &["candidate", "sandbox", version, "--json"]), 3, "not-now");
    assert_eq!(state(store, version), "sandboxed");
    let verified = on(store, &["audit", "verify"]);
    assert!(verified.status.success(), "{verified:?}");
}

#[test]
fn a_stage_that_rejects_ends_with_the_code_of_a_rejection() {
    let folder = quick_folder();
    let store = folder.path();
    register(store, "grasp-tool-frame");
    let version = "grasp@1.2.0";
    let (code, message) = code_and_stderr(&on(store, &["candidate", "compat", version]));
    assert_eq!((code, state(store, version).as_str()), (Some(1), "rejected"), "{message}");
    assert_error(&on(store, &["candidate", "sandbox", "grasp@9.9.9", "--json"]), 2, "not-found");
}

/// The seeds of a stage are secret. Its key is revealed at its end, and gives the same results without the store's secret.
#[test]
fn stage_with_secret_seeds_is_made_again_on_a_copy_without_keys() {
    let [folder, elsewhere] = [(); 2].map(|()| quick_folder());
    let (store, copy) = (folder.path(), elsewhere.path().join("copy"));
    register(store, "align-no-stop");
    let (code, message) = code_and_stderr(&on(store, &["candidate", "compat", "align@1.1.3"]));
    assert_eq!(code, Some(0), "{message}");
    let (code, message) =
        code_and_stderr(&on(store, &["candidate", "sandbox", "align@1.1.3", "--jobs", "2"]));
    assert_eq!(code, Some(1), "{message}");
    let backup = on(store, &["store", "backup", copy.to_str().unwrap()]);
    assert!(backup.status.success(), "{backup:?}");
    drop(folder);

    let made_again = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
        command.args(["audit", "rerun", "--json", "--data"]).arg(&copy);
        let output = command.env("HOME", elsewhere.path()).env_remove("XDG_DATA_HOME").output().unwrap();
        let report: Value =
            serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {output:?}"));
        (output.status.code(), report)
    };
    let (code, report) = made_again();
    assert_eq!((code, report["evaluations"].as_u64()), (Some(0), Some(1)), "{report}");
    let sandbox = &report["decisions"][1];
    assert!(sandbox["runs"].as_u64() >= Some(20) && sandbox["replay"] == "equal", "{report}");

    let connection = rusqlite::Connection::open(copy.join("holdpoint.db")).unwrap();
    let read = "SELECT json FROM evidence WHERE kind = 'sandbox'";
    let json: String = connection.query_row(read, [], |row| row.get(0)).unwrap();
    let mut evidence: Value = serde_json::from_str(&json).unwrap();
    let pair = &mut evidence["pairs"][3];
    pair["active"]["success"] = (!pair["active"]["success"].as_bool().unwrap()).into();
    let named = format!("pair 4 (seed {}).active.success is ", pair["seed"]);
    let write = "UPDATE evidence SET json = ?1 WHERE kind = 'sandbox'";
    assert_eq!(connection.execute(write, [evidence.to_string()]).unwrap(), 1);
    drop(connection);
    let (code, report) = made_again();
    assert_eq!(code, Some(1), "{report}");
    assert!(report["decisions"][1]["what"].as_str().unwrap().starts_with(&named), "{report}");
}

/// The bodies of the records of a kind, newest first.
fn bodies(store: &Path, kind: &str) -> Vec<Value> {
    let listed = on(store, &["audit", "list", "--kind", kind, "--json"]);
    let record = |line: &str| serde_json::from_str::<Value>(line).unwrap();
    let body = |line: &str| serde_json::from_str(record(line)["body"].as_str().unwrap()).unwrap();
    String::from_utf8(listed.stdout).unwrap().lines().map(body).collect()
}

/// Regression: ctrl-c left the cell stopped, as a kill does.
#[test]
fn interrupted_stage_ends_cleanly_and_leaves_no_stopped_cell() {
    let folder = quick_folder();
    let (store, version) = (folder.path(), "grasp@1.1.3");
    register(store, "grasp-soft-grip");
    let (code, message) = code_and_stderr(&on(store, &["candidate", "compat", version]));
    assert_eq!(code, Some(0), "{message}");
    let ended = bodies(store, "engine-ended").len();
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    command.args(["candidate", "sandbox", version, "--jobs", "1", "--data"]).arg(store);
    let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok);
    assert!(lines.any(|line| line.contains(" progress ")), "nothing was evaluated");
    let pid = rustix::process::Pid::from_raw(i32::try_from(child.id()).unwrap()).unwrap();
    rustix::process::kill_process(pid, rustix::process::Signal::INT).unwrap();
    let last = lines.last();
    assert_eq!(child.wait().unwrap().code(), Some(3), "{last:?}");
    let orderly: Vec<bool> = bodies(store, "engine-ended").iter().map(|end| end["orderly"] == true).collect();
    assert_eq!((orderly.len(), orderly.first()), (ended + 1, Some(&true)), "{orderly:?}");
    // The next engine on the store starts with a cell that works.
    assert_error(&on(store, &["candidate", "shadow", version, "--json"]), 3, "not-now");
    assert!(bodies(store, "cell-stopped").is_empty());
}
