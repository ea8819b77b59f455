//! A scenario that was killed in the middle, run again on its store.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::quick_folder::quick_folder;
use crate::reported_error::assert_error;

const SCRIPT: &str = "tests/scenarios/reject-behavior.toml";

fn run(data: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    command.args(["run", "--headless", "--jobs", "1", "--script", SCRIPT, "--data"]).arg(data);
    command
}

#[test]
fn a_killed_script_continues_and_an_ended_one_names_the_remedy() {
    let folder = quick_folder();
    let data = folder.path().join("store");
    let mut child = run(&data).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok);
    // In the middle of the sandbox.
    assert!(lines.any(|line| line.contains(" progress ")), "nothing was evaluated");
    child.kill().unwrap();
    child.wait().unwrap();

    let again = run(&data).output().unwrap();
    let stdout = String::from_utf8(again.stdout).unwrap();
    let stderr = String::from_utf8(again.stderr).unwrap();
    assert_eq!(again.status.code(), Some(1), "{stdout}{stderr}");
    assert!(stdout.contains("interrupted run") && stdout.contains("from validated"), "{stdout}");

    let third = run(&data).arg("--json").output().unwrap();
    let error = assert_error(&third, 2, "exists");
    assert!(error["hint"].as_str().unwrap().contains("--data"), "{error}");
}
