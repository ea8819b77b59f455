//! A scenario that was killed in the middle, run again on its store.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

const SCRIPT: &str = "tests/scenarios/reject-behavior.toml";

fn run(data: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    command.args(["run", "--headless", "--jobs", "1", "--script", SCRIPT, "--data"]).arg(data);
    command
}

#[test]
fn a_killed_script_goes_on_and_one_that_ended_names_the_way_to_begin_anew() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("store");
    let mut killed = run(&data).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(killed.stdout.take().unwrap()).lines().map_while(Result::ok);
    // In the middle of the sandbox.
    assert!(lines.any(|line| line.contains(" progress ")), "nothing was evaluated");
    killed.kill().unwrap();
    killed.wait().unwrap();

    let again = run(&data).output().unwrap();
    let said = String::from_utf8(again.stdout).unwrap();
    let wrong = String::from_utf8(again.stderr).unwrap();
    assert_eq!(again.status.code(), Some(1), "{said}{wrong}");
    assert!(said.contains("already registered by an interrupted run; it continues from validated"), "{said}");

    let third = run(&data).output().unwrap();
    let wrong = String::from_utf8(third.stderr).unwrap();
    assert_eq!((third.status.code(), wrong.matches("error: ").count()), (Some(2), 1), "{wrong}");
    assert!(wrong.contains("is registered already") && wrong.contains("leave out --data"), "{wrong}");
}
