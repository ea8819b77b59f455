//! Errors of the command line: each says what is wrong and where, and the commands of its hint run as pasted.

use std::ffi::OsString;
use std::fs;
use std::io::Write as _;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, symlink};
use std::os::unix::net::UnixListener;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use holdpoint::cli::Cli;
use holdpoint::store::Layout;
use holdpoint_text::users::described_user;
use holdpoint_wording::program::candidate::{CheckSummary, check_summary, registered_already};
use rusqlite::Connection;
use serde_json::Value;

use crate::reported_error::{assert_error, is_about};

const IMPROVED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/manifests/candidates/grasp-improved");
const REJECTED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/scenarios/reject-interface.toml");

fn command(data: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    command.arg("--data").arg(data).args(arguments).env_remove("HOLDPOINT_PASSPHRASE_FILE");
    command
}

fn holdpoint(data: &Path, arguments: &[&str]) -> Output {
    command(data, arguments).output().unwrap()
}

#[track_caller]
fn succeeds(data: &Path, arguments: &[&str]) -> String {
    let output = holdpoint(data, arguments);
    assert!(output.status.success(), "{arguments:?}: {output:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// The error of a verb, and the commands of its hint, which parse.
#[track_caller]
fn fails(data: &Path, arguments: &[&str], exit: i32, codes: &str) -> (Value, Vec<String>) {
    let error = assert_error(&holdpoint(data, &[arguments, &["--json"]].concat()), exit, codes);
    let commands = commands_in(error["hint"].as_str().unwrap_or_default());
    (error, commands)
}

/// Splits as a shell would, as far as hints need it.
fn words(line: &str) -> Vec<OsString> {
    line.split('\'')
        .enumerate()
        .flat_map(|(index, part)| match index % 2 {
            0 => part.split_whitespace().map(OsString::from).collect::<Vec<_>>(),
            _ => vec![OsString::from(part)],
        })
        .collect()
}

/// The program's commands in a text, without quotation marks; each of them parses.
#[track_caller]
fn commands_in(text: &str) -> Vec<String> {
    let quoted = text.split('`').skip(1).step_by(2);
    let named: Vec<String> =
        quoted.filter(|code| code.starts_with("holdpoint ")).map(ToOwned::to_owned).collect();
    for command in &named {
        if let Err(error) = Cli::parse_line(words(command)) {
            panic!("{command}: {error}");
        }
    }
    // A hint repeats the store that the command line named.
    named.into_iter().map(|command| command.split(" --data ").next().unwrap_or_default().to_owned()).collect()
}

/// A store in a folder of its own, with the identity mara.
struct Fixture {
    root: tempfile::TempDir,
}

impl Fixture {
    fn new() -> Self {
        let fixture = Self { root: tempfile::tempdir().unwrap() };
        succeeds(&fixture.data(), &["identity", "new", "mara", "--unprotected"]);
        fixture
    }

    /// As [`Fixture::new`], with a candidate, which makes the families.
    fn with_candidate() -> Self {
        let fixture = Self::new();
        succeeds(&fixture.data(), &["candidate", "register", IMPROVED]);
        fixture
    }

    fn path(&self, name: &str) -> PathBuf {
        self.root.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    fn data(&self) -> PathBuf {
        self.path("store")
    }

    /// A copy of a good candidate, with this change of its manifest.
    fn candidate(&self, name: &str, from: &str, to: &str) -> String {
        let folder = self.path(name);
        fs::create_dir(&folder).unwrap();
        for file in ["manifest.toml", "submission.toml", "params.toml"] {
            fs::copy(Path::new(IMPROVED).join(file), folder.join(file)).unwrap();
        }
        let manifest = folder.join("manifest.toml");
        let text = fs::read_to_string(&manifest).unwrap();
        assert!(text.contains(from), "{from:?} is not in the manifest");
        fs::write(manifest, text.replacen(from, to, 1)).unwrap();
        self.text(name)
    }
}

#[test]
fn an_edited_store_is_never_called_sound() {
    let fixture = Fixture::with_candidate();
    let data = fixture.data();
    let text = succeeds(&data, &["store", "check"]);
    assert!(!commands_in(text.lines().next().unwrap()).is_empty(), "{text}");
    let report: Value = serde_json::from_str(&succeeds(&data, &["store", "check", "--json"])).unwrap();
    assert_eq!(report["not_checked"], serde_json::json!(["recordings"]));
    let connection = Connection::open(Layout::new(&data).database()).unwrap();
    connection.execute_batch("UPDATE family SET reason = 'edited' WHERE name = 'grasp'").unwrap();
    drop(connection);
    let output = holdpoint(&data, &["store", "check", "--json"]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let found = report["found"].as_array().unwrap();
    assert_eq!(report["good"], false);
    let advises = |one: &Value, command: &str| commands_in(one["text"].as_str().unwrap()) == [command];
    let is_edit = |one: &Value| one["good"] == false && advises(one, "holdpoint store rebuild --from-chain");
    assert!(found.iter().any(is_edit), "{report}");
}

#[test]
fn a_missing_key_is_named_with_its_file() {
    let fixture = Fixture::new();
    let data = fixture.data();
    fs::remove_file(data.join("keys/identities/mara.key")).unwrap();
    let note = ["cell", "note", "--as", "mara", "--reason", "x"];
    let (error, commands) = fails(&data, &note, 2, "bad-file");
    assert!(is_about(&error, "mara.key"), "{error}");
    assert_eq!(commands, ["holdpoint identity list"]);
    fs::remove_file(data.join("keys/store.key")).unwrap();
    let (error, commands) = fails(&data, &["identity", "new", "ben", "--unprotected"], 2, "bad-file");
    assert!(is_about(&error, "store.key"), "{error}");
    assert!(!error["error"].as_str().unwrap().contains("allowed"), "{error}");
    assert_eq!(commands, ["holdpoint store check"]);
}

#[test]
fn the_administrator_of_a_new_folder_is_made_by_the_command_of_the_hint() {
    let root = tempfile::tempdir().unwrap();
    let data = root.path().join("store");
    let (_, commands) = fails(&data, &["identity", "passphrase", "admin"], 2, "not-found");
    let [command] = commands.as_slice() else { panic!("{commands:?}") };
    let arguments: Vec<&str> = command.split_whitespace().skip(1).chain(["--unprotected"]).collect();
    succeeds(&data, &arguments);
    assert!(succeeds(&data, &["identity", "list"]).contains("admin"));
}

#[test]
fn a_witness_is_a_folder_with_one_name_and_at_least_one_head() {
    let fixture = Fixture::new();
    let data = fixture.data();
    let add = |folder: &str, exit: i32, codes: &str| {
        fails(&data, &["audit", "witness", "add", folder], exit, codes)
    };
    fs::write(fixture.path("file"), "").unwrap();
    fs::create_dir(fixture.path("witness")).unwrap();
    fs::create_dir(fixture.path("witness/below")).unwrap();
    symlink(fixture.path("witness"), fixture.path("link")).unwrap();
    let (error, commands) = add(&fixture.text("file"), 2, "bad-file");
    assert!(is_about(&error, "file") && commands.len() == 2, "{error}");
    add(&fixture.text("none"), 2, "bad-file");
    // The recorded name has no `..`, and a link is the same folder.
    succeeds(&data, &["audit", "witness", "add", &fixture.text("witness/below/..")]);
    let whole = fs::canonicalize(fixture.path("witness")).unwrap();
    let listed = holdpoint(&data, &["audit", "witness", "list", "--json"]);
    assert_eq!(listed.status.code(), Some(0), "{listed:?}");
    let listed: Value = serde_json::from_slice(&listed.stdout).unwrap();
    assert_eq!(listed["folder"], whole.to_str().unwrap());
    for again in ["witness", "link"] {
        let (_, commands) = add(&fixture.text(again), 2, "exists");
        assert_eq!(commands, ["holdpoint audit witness list"], "{again}");
    }
    // A folder in place of a checkpoint or a proof.
    let witness = fixture.text("witness");
    let (_, commands) = fails(&data, &["audit", "consistency", "--against", &witness], 2, "bad-file");
    assert!(commands[0].ends_with(".json"), "{commands:?}");
    for arguments in [["audit", "check-proof", &witness].as_slice(), &["audit", "verify", "--file", &witness]]
    {
        let (_, commands) = fails(&data, arguments, 2, "bad-file");
        assert!(!commands.is_empty(), "{arguments:?}");
    }
    // An emptied witness is no witness.
    for entry in
        fs::read_dir(&whole).unwrap().map(Result::unwrap).filter(|entry| entry.file_name() != "below")
    {
        for head in fs::read_dir(entry.path()).unwrap() {
            fs::remove_file(head.unwrap().path()).unwrap();
        }
    }
    let listed = holdpoint(&data, &["audit", "witness", "list", "--json"]);
    assert_eq!(listed.status.code(), Some(1), "{listed:?}");
    let row: Value = serde_json::from_slice(&listed.stdout).unwrap();
    assert_eq!(row["heads"], Value::Null, "{row}");
    succeeds(&data, &["audit", "witness", "remove", &fixture.text("link")]);
}

#[test]
fn a_profile_without_authorization_names_the_command_for_one() {
    let fixture = Fixture::new();
    let data = fixture.data();
    let started = holdpoint(&data, &["run", "--plain", "--profile", "human"]);
    assert_eq!(started.status.code(), Some(5), "{started:?}");
    let (_, commands) = fails(&data, &["run", "--plain", "--profile", "sim"], 3, "profile-not-authorized");
    assert_eq!(commands, ["holdpoint profile allow sim --by admin --reason 'the reason'"]);
}

#[test]
fn decisions_name_the_verb_that_was_meant_as_a_whole_command() {
    let fixture = Fixture::with_candidate();
    let data = fixture.data();
    let signature = ["--as", "mara", "--reason", "drops parts"];
    for (arguments, exit, codes, expected) in [
        (&["reject", "grasp@1.0.0"][..], 3, "not-now", "holdpoint rollback grasp"),
        (&["rollback", "grasp@1.0.0"], 2, "usage", "holdpoint rollback grasp"),
        (&["version", "demote", "grasp"], 2, "usage", "holdpoint version demote grasp@1.0.0"),
        (&["rollback", "grasp"], 3, "not-now", "holdpoint rollback grasp --stop-family"),
        (&["version", "demote", "grasp@1.0.0"], 3, "not-now", "holdpoint rollback grasp --stop-family"),
    ] {
        let (_, commands) = fails(&data, &[arguments, &signature].concat(), exit, codes);
        let whole = format!("{expected} --as mara --reason 'drops parts'");
        assert_eq!(commands, [whole], "{arguments:?}");
    }
    let start = ["start", "--as", "mara", "--reason", "empty"];
    assert_eq!(holdpoint(&data, &["stop"]).status.code(), Some(6));
    let (_, commands) = fails(&data, &start, 3, "not-now");
    assert_eq!(commands.last().unwrap(), "holdpoint start --stops 1 --as mara --reason empty");
    let status = succeeds(&data, &["status"]);
    let stopped = status.lines().find(|line| line.starts_with("STOPPED")).unwrap();
    let starts = commands_in(stopped);
    assert_eq!(starts.len(), 1, "{stopped}");
    assert!(starts[0].contains(" --as mara "), "a person whose role may start the cell: {stopped}");
    succeeds(&data, &[&start[..], &["--stops", "1"]].concat());
}

#[test]
fn a_socket_of_another_program_is_named() {
    let root = tempfile::tempdir().unwrap();
    let listener = UnixListener::bind(root.path().join("engine.sock")).unwrap();
    let other = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.write_all(b"220 ready\n").unwrap();
        stream
    });
    let (error, commands) = fails(root.path(), &["status"], 2, "control-socket/protocol");
    drop(other.join().unwrap());
    assert!(is_about(&error, "engine.sock"), "{error}");
    assert_eq!(commands, ["holdpoint store info"]);
}

#[test]
fn the_laboratory_is_another_program() {
    let root = tempfile::tempdir().unwrap();
    // The former names, too.
    for line in [&["lab", "experiment", "drift", "--out", "x"][..], &["experiment", "drift", "--out", "x"]] {
        let (error, _) = fails(root.path(), line, 2, "usage");
        let start = "`cargo run --release -p holdpoint-lab -- experiment drift --out x --json`";
        assert!(error["hint"].as_str().unwrap().contains(start), "{error}");
    }
    let (_, commands) = fails(root.path(), &["lab", "metrics"], 2, "usage");
    assert!(commands.len() == 1 && commands[0].starts_with("holdpoint metrics"), "{commands:?}");
}

/// The exit code of a program whose reader is gone.
fn unread(mut command: Command) -> Option<i32> {
    let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    child.wait().unwrap().code()
}

#[test]
fn the_exit_code_is_that_of_the_run_whatever_becomes_of_the_reader() {
    let fixture = Fixture::new();
    for json in [&[][..], &["--json"]] {
        let data = tempfile::tempdir().unwrap();
        let run = [&["scenario", "run", REJECTED][..], json].concat();
        assert_eq!(unread(command(data.path(), &run)), Some(1));
    }
    assert_eq!(unread(command(&fixture.data(), &["store", "check"])), Some(0));
    let connection = Connection::open(Layout::new(fixture.data()).database()).unwrap();
    connection.execute_batch("UPDATE audit_head SET seq = seq - 1").unwrap();
    drop(connection);
    assert_eq!(unread(command(&fixture.data(), &["store", "check"])), Some(1));
}

#[test]
fn an_unmet_expectation_has_its_own_code() {
    let root = tempfile::tempdir().unwrap();
    let script = root.path().join("script.toml");
    let steps = "profile = \"sim\"\n[[step]]\nregister = \"grasp-tool-frame\"\n\
                 [[step]]\nwait = { state = \"settled\", timeout_s = 20000 }\n\
                 [[step]]\nexpect = { state = \"active\" }\n";
    fs::write(&script, steps).unwrap();
    let run = ["scenario", "run", script.to_str().unwrap()];
    let output = holdpoint(&root.path().join("store"), &[&run[..], &["--json"]].concat());
    let error = assert_error(&output, 7, "expectation");
    let text = error["error"].as_str().unwrap();
    assert!(["rejected", "active"].iter().all(|state| text.contains(state)), "both states: {error}");
    let stdout = String::from_utf8(output.stdout).unwrap();
    let last: Value = serde_json::from_str(stdout.lines().next_back().unwrap()).unwrap();
    assert_eq!((&last["event"], &last["step"]), (&"expectation".into(), &3.into()), "{last}");
}

#[test]
fn a_candidate_check_names_the_field_the_state_and_the_profiles() {
    let fixture = Fixture::with_candidate();
    let data = fixture.data();
    let folder = fixture.candidate(
        "unmet",
        "family = \"park\"\nversion = \"^1\"",
        "family = \"park\"\nversion = \"^9\"",
    );
    let output = holdpoint(&data, &["candidate", "check", &folder, "--json"]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let unmet = &report["unmet_fallback"];
    assert_eq!(
        (&unmet["field"], &unmet["value"]),
        (&"recovery.fallback".into(), &"park ^9".into()),
        "{report}"
    );
    assert_eq!(unmet["there"], serde_json::json!(["park@1.0.0"]));
    let report: Value =
        serde_json::from_str(&succeeds(&data, &["candidate", "check", IMPROVED, "--json"])).unwrap();
    let state = report["registered"].as_str().unwrap();
    let text = succeeds(&data, &["candidate", "check", IMPROVED]);
    assert!(text.contains(&registered_already("grasp@1.1.0", state)), "{text}");
    assert!(
        text.lines().next_back().unwrap().starts_with(&check_summary(CheckSummary::Admitted("sim", ""))),
        "{text}"
    );
    // Registration and check answer alike about a family that does not exist.
    let folder = fixture.candidate("push", "name = \"grasp\"", "name = \"push\"");
    let (registered, commands) = fails(&data, &["candidate", "register", &folder], 2, "not-found");
    let (checked, _) = fails(&data, &["candidate", "check", &folder], 2, "bad-file");
    assert_eq!(registered["hint"], checked["hint"]);
    assert_eq!(commands, ["holdpoint version list"]);
}

#[test]
fn a_temporary_store_needs_no_home() {
    let mut run = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    run.args(["scenario", "run", REJECTED]).env_remove("HOME").env_remove("XDG_DATA_HOME");
    let output = run.output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{output:?}");
}

/// Only the superuser can run the program as another user, and only if that user can read it.
#[test]
fn a_store_of_another_user_is_named_with_its_owner() {
    const OTHER: u32 = 65_534;
    let fixture = Fixture::new();
    fs::set_permissions(fixture.root.path(), fs::Permissions::from_mode(0o755)).unwrap();
    if fs::metadata(fixture.data()).unwrap().uid() != 0 {
        return;
    }
    for arguments in [&["status"][..], &["run", "--plain"], &["identity", "list"]] {
        let mut other = command(&fixture.data(), &[arguments, &["--json"]].concat());
        let Ok(output) = other.uid(OTHER).gid(OTHER).current_dir("/").output() else { return };
        let error = assert_error(&output, 2, "store/io");
        assert!(error["error"].as_str().unwrap().contains(&described_user(0)), "the owner: {error}");
    }
}

#[test]
fn a_backup_names_what_it_lacks() {
    let fixture = Fixture::new();
    let text = succeeds(&fixture.data(), &["store", "backup", &fixture.text("copy")]);
    let commands = commands_in(&text);
    let arguments: Vec<&str> = commands[0].split_whitespace().skip(1).collect();
    assert!(arguments.contains(&"--with-keys"), "{text}");
    assert_eq!(commands_in(&succeeds(&fixture.data(), &arguments)), Vec::<String>::new(), "{arguments:?}");
}

/// The signal of a limit on a file's size ended the program without a message.
#[test]
fn a_limit_of_a_files_size_is_an_error() {
    let root = tempfile::tempdir().unwrap();
    let line =
        format!("ulimit -f 1; exec '{}' completions bash --json > out", env!("CARGO_BIN_EXE_holdpoint"));
    let output =
        std::process::Command::new("sh").args(["-c", &line]).current_dir(root.path()).output().unwrap();
    assert_error(&output, 2, "output");
}

/// On a full disk SQLite has no room for its shared memory, and a sound store was called damaged. A limit of a file's size has
/// the same effect.
#[test]
fn a_store_on_a_full_disk_is_read_and_keeps_a_stop() {
    let fixture = Fixture::with_candidate();
    let limited = |arguments: &[&str]| {
        let line = "ulimit -f 1; exec \"$0\" --data \"$@\"";
        let mut shell = Command::new("sh");
        shell.args(["-c", line, env!("CARGO_BIN_EXE_holdpoint")]).arg(fixture.data()).args(arguments);
        shell.output().unwrap()
    };
    for arguments in [&["status"][..], &["version", "list"], &["explain", "grasp@1.1.0"]] {
        let output = limited(arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {output:?}");
    }
    assert_eq!(limited(&["stop"]).status.code(), Some(6), "no engine confirms it");
    assert!(fixture.data().join("stop.asked").exists(), "the next engine finds it");
}
