//! Commands on the input of a run without a screen.

use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// Runs with these lines on its input, which then ends.
fn plain(data: &Path, arguments: &[&str], lines: &str) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_holdpoint"))
        .args(["run", "--jobs", "1", "--no-recording"])
        .args(arguments)
        .arg("--data")
        .arg(data)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // A run that reads no commands may have ended before the write.
    let mut input = child.stdin.take().unwrap();
    drop(input.write_all(lines.as_bytes()));
    drop(input);
    child.wait_with_output().unwrap()
}

fn output_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

#[test]
fn verbs_are_carried_out_line_by_line_beside_the_engine() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("store");
    let lines = "# a remark\nhelp\nfly\n:status\nidentity new mara --unprotected\n\
                 goal grasp --as mara --reason 'only the first'\nstatus --family \"omar\n";
    let output = plain(&data, &["--plain"], lines);
    let text = output_text(&output);
    // The refused line, and the three verbs that ran, in the order in which they were typed.
    assert!(text.contains("\"fly\""), "{text}");
    let typed = [
        "> status",
        "> identity new mara --unprotected",
        "> cell goal grasp --as mara --reason only the first",
    ];
    let order = typed.map(|line| text.find(line).unwrap_or_else(|| panic!("{line:?} is not in {text}")));
    assert!(order.is_sorted(), "{text}");
    // The line with an open quote ran nothing.
    assert_eq!(text.matches("> status").count(), 1, "{text}");
    assert_eq!(output.status.code(), Some(5), "{text}");
    assert!(data.join("keys/identities/mara.key").is_file(), "{text}");
    // The actions are on record, as from a shell.
    let listed = Command::new(env!("CARGO_BIN_EXE_holdpoint"))
        .args(["audit", "list", "--kind", "goal-set", "--data"])
        .arg(&data)
        .output()
        .unwrap();
    assert!(output_text(&listed).contains("goal-set"), "{}", output_text(&listed));
}

#[test]
fn typed_stop_is_immediate_and_quit_ends() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("store");
    let output =
        plain(&data, &["--plain"], "register manifests/candidates/align-improved\nstop --reason 'a hand'\n");
    let text = output_text(&output);
    assert!(text.contains("> stop --reason a hand") && text.contains("> candidate register"), "{text}");
    let folder = tempfile::tempdir().unwrap();
    let output = plain(&folder.path().join("store"), &["--plain"], "quit\nstatus\n");
    assert!(!output_text(&output).contains("> status"), "{}", output_text(&output));
}

/// A script's input before its last line was once dropped silently.
#[test]
fn quit_ends_after_the_earlier_typed_commands() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("store");
    let lines = "identity new mara --unprotected\ngoal grasp --as mara --reason 'only the first'\nstatus\nquit\nfly\n";
    let text = output_text(&plain(&data, &["--plain"], lines));
    for part in ["identity mara", "> cell goal grasp", "> status", "earlier commands"] {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
    assert!(!text.contains("fly"), "{text}");
}

/// Chosen for lack of a terminal: the input belongs to another program, such as a loop in a shell.
#[test]
fn without_the_flag_the_input_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let output = plain(&folder.path().join("store"), &[], "status\n");
    let text = output_text(&output);
    assert!(!text.contains("> status") && output.status.code() == Some(5), "{text}");
}
