//! The right to decide, from outside: an administrator enrolls and revokes, whatever is in the folder of keys.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use serde_json::Value;
use tempfile::TempDir;

use crate::agent::AgentProcess;
use crate::old_stores::{OPEN_ROLES, copy_fixture, holdpoint, text};
use crate::quick_folder::quick_folder;
use crate::reported_error::assert_error;

/// A call that must end with this code; returns its output and errors.
#[track_caller]
fn ends(folder: &TempDir, call: &str, code: i32) -> String {
    let arguments: Vec<&str> = call.split(' ').collect();
    let output = holdpoint(folder, &arguments);
    let message = text(&output.stdout) + &text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{call}: {message}");
    message
}

/// A call that must fail with this exit code and these codes of its error, which it returns.
#[track_caller]
fn fails(folder: &TempDir, call: &str, exit: i32, codes: &str) -> Value {
    let arguments: Vec<&str> = call.split(' ').chain(["--json"]).collect();
    assert_error(&holdpoint(folder, &arguments), exit, codes)
}

#[track_caller]
fn assert_contains(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in {message}");
    }
}

/// The name and state of every person.
fn person_states(folder: &TempDir) -> Vec<(String, String)> {
    let output = holdpoint(folder, &["identity", "list", "--json"]);
    let list: Vec<Value> = serde_json::from_slice(&output.stdout).unwrap();
    let field = |one: &Value, name: &str| one[name].as_str().unwrap().to_owned();
    list.iter().map(|one| (field(one, "name"), field(one, "state"))).collect()
}

/// The administrator enrolled a person with this role.
#[track_caller]
fn assert_enrolled(folder: &TempDir, name: &str, role: &str) {
    let output = holdpoint(folder, &["identity", "list", "--json"]);
    let list: Vec<Value> = serde_json::from_slice(&output.stdout).unwrap();
    let row = list.iter().find(|one| one["name"] == name).unwrap();
    assert_eq!((&row["role"], &row["enrolled_by"]), (&role.into(), &"admin".into()), "{row}");
}

fn assert_states(folder: &TempDir, expected: &[(&str, &str)]) {
    let expected: Vec<_> =
        expected.iter().map(|(name, state)| ((*name).to_owned(), (*state).to_owned())).collect();
    assert_eq!(person_states(folder), expected);
}

fn file(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, text).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
    path
}

#[test]
fn only_an_act_of_an_administrator_enrolls_or_revokes_people() {
    let folder = quick_folder();
    ends(&folder, "identity new mara --role safety --unprotected", 0);
    ends(&folder, "identity new omar --unprotected --by admin", 0);
    assert_states(&folder, &[("admin", "enrolled"), ("mara", "enrolled"), ("omar", "enrolled")]);
    let mode = fs::metadata(folder.path().join("store/keys/identities/admin.key")).unwrap().permissions();
    assert_eq!(mode.mode() & 0o7777, 0o600);
    // A person who is not an administrator enrolls and revokes no one.
    fails(&folder, "identity new eve --unprotected --by mara", 3, "not-allowed/no-administrator");
    // A refused enrollment leaves nothing.
    assert_states(&folder, &[("admin", "enrolled"), ("mara", "enrolled"), ("omar", "enrolled")]);
    fails(&folder, "identity revoke omar --by mara --reason envy", 3, "not-allowed/no-administrator");
    fails(&folder, "identity revoke admin --by admin --reason tired", 3, "not-allowed/last-administrator");
    // A name and a key belong to a person permanently.
    ends(&folder, "identity revoke omar --by admin --reason left", 0);
    fails(&folder, "identity enroll omar --by admin --reason back", 3, "exists/name-taken");
    let keys = folder.path().join("store/keys/identities");
    for ending in ["key", "pub"] {
        fs::copy(keys.join(format!("mara.{ending}")), keys.join(format!("alias.{ending}"))).unwrap();
    }
    fails(&folder, "identity enroll alias --by admin --reason twin", 3, "exists/key-taken");
    let all = [("admin", "enrolled"), ("alias", "not-enrolled"), ("mara", "enrolled"), ("omar", "revoked")];
    assert_states(&folder, &all);
    // Public files are read for signing: edited, removed or added ones change nothing.
    let elsewhere = quick_folder();
    ends(&elsewhere, "identity new eve --unprotected", 0);
    fs::copy(elsewhere.path().join("store/keys/identities/eve.pub"), keys.join("eve.pub")).unwrap();
    fs::copy(keys.join("eve.pub"), keys.join("mara.pub")).unwrap();
    fs::remove_file(keys.join("omar.pub")).unwrap();
    fs::copy(keys.join("eve.pub"), keys.join("zoe.pub")).unwrap();
    ends(&folder, "audit verify", 0);
    let states = person_states(&folder);
    let state_of =
        |name: &str| states.iter().find(|(known, _)| known == name).map(|(_, state)| state.as_str());
    assert_eq!(
        (state_of("mara"), state_of("omar"), state_of("zoe")),
        (Some("enrolled"), Some("revoked"), Some("not-enrolled"))
    );
    // A key from elsewhere.
    ends(&elsewhere, "identity new cleo --role engineer --unprotected", 0);
    let public = elsewhere.path().join("store/keys/identities/cleo.pub");
    let call = format!("identity enroll cleo --public-key {} --by admin --reason hers", public.display());
    ends(&folder, &call, 0);
    assert_enrolled(&folder, "cleo", "engineer");
}

#[test]
fn refused_enrollment_leaves_no_file_and_no_record() {
    let folder = quick_folder();
    let oak = file(folder.path(), "oak", "under the oak\n");
    let elm = file(folder.path(), "elm", "under the elm\n");
    let (oak, elm) = (oak.display(), elm.display());
    ends(&folder, &format!("identity passphrase admin --new-passphrase-file {oak}"), 2);
    ends(&folder, "identity new rig --unprotected", 0);
    ends(&folder, &format!("identity passphrase admin --new-passphrase-file {oak}"), 0);
    let keys = folder.path().join("store/keys/identities");
    let files = || {
        let mut names: Vec<_> =
            fs::read_dir(&keys).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = files();
    let new = format!("identity new mara --passphrase-file {elm} --by admin");
    // Without the administrator's passphrase, with a wrong one, with a missing file, by an unknown person.
    for (call, exit, codes) in [
        (new.clone(), 2, "passphrase/needed"),
        (format!("{new} --by-passphrase-file {elm}"), 2, "passphrase/wrong"),
        (format!("{new} --by-passphrase-file nowhere"), 2, "bad-file"),
        (format!("identity new mara --passphrase-file {elm} --by eve"), 2, "not-found"),
        (format!("identity new mara --passphrase-file {elm} --by rig"), 3, "not-allowed/no-administrator"),
    ] {
        fails(&folder, &call, exit, codes);
        assert_eq!(files(), before, "{call}");
    }
    // So the name is free for the correct call.
    ends(&folder, &format!("{new} --by-passphrase-file {oak}"), 0);
    assert_enrolled(&folder, "mara", "operator");
    ends(&folder, "audit verify", 0);
}

#[test]
fn a_store_of_an_earlier_version_trusts_no_file() {
    let folder = copy_fixture(OPEN_ROLES);
    assert!(person_states(&folder).iter().all(|(_, state)| state == "not-enrolled"));
    // Only the first opening makes the administrator.
    let error = fails(&folder, "resume align --as omar --reason back", 3, "not-allowed");
    assert_contains(error["hint"].as_str().unwrap(), &["`holdpoint identity enroll omar --by admin"]);
    let states = person_states(&folder);
    assert!(states.contains(&("admin".to_owned(), "enrolled".to_owned())), "{states:?}");
    assert!(states.iter().all(|(name, state)| name == "admin" || state == "not-enrolled"), "{states:?}");
    let records = ends(&folder, "audit list --kind person-enrolled --json", 0);
    assert_contains(&records, &["earlier version"]);
    // Last used under a profile with approvals.
    fails(&folder, "identity enroll omar --by admin --reason known", 3, "not-allowed/no-passphrase");
    let oak = file(folder.path(), "oak", "under the oak\n");
    let oak = oak.display();
    ends(&folder, &format!("identity passphrase admin --new-passphrase-file {oak}"), 0);
    let enrol =
        |who: &str| format!("identity enroll {who} --by admin --reason known --passphrase-file {oak}");
    ends(&folder, &enrol("omar"), 0);
    // A role outside the set must be chosen again.
    ends(&folder, &enrol("mara --role safety"), 0);
    let states = person_states(&folder);
    for name in ["mara", "omar"] {
        assert!(states.contains(&(name.to_owned(), "enrolled".to_owned())), "{name}: {states:?}");
    }
    ends(&folder, "audit verify", 0);
}

#[test]
fn under_human_the_first_administrator_needs_a_passphrase_first() {
    let folder = quick_folder();
    let script = file(folder.path(), "human.toml", "profile = \"human\"\n[[step]]\npass = { for_s = 1 }\n");
    let oak = file(folder.path(), "oak", "under the oak\n");
    let (script, oak) = (script.display(), oak.display());
    // It judged nothing.
    ends(&folder, &format!("run --headless --script {script}"), 5);
    let message = ends(&folder, &format!("identity new ben --passphrase-file {oak}"), 0);
    assert_contains(&message, &["`holdpoint identity enroll ben --by admin --reason TEXT`"]);
    let enrol = format!("identity enroll ben --by admin --reason joins --passphrase-file {oak}");
    fails(&folder, &enrol, 3, "not-allowed/no-passphrase");
    let before = fs::read_to_string(folder.path().join("store/keys/identities/admin.pub")).unwrap();
    ends(&folder, &format!("identity passphrase admin --new-passphrase-file {oak}"), 0);
    ends(&folder, &enrol, 0);
    assert_eq!(fs::read_to_string(folder.path().join("store/keys/identities/admin.pub")).unwrap(), before);
    assert_states(&folder, &[("admin", "enrolled"), ("ben", "enrolled")]);
}

#[test]
fn key_readable_by_others_is_named_with_the_remedy() {
    let folder = quick_folder();
    ends(&folder, "identity new mara --unprotected", 0);
    let key = folder.path().join("store/keys/identities/mara.key");
    fs::set_permissions(&key, fs::Permissions::from_mode(0o644)).unwrap();
    let message = ends(&folder, "identity list", 1);
    assert_contains(&message, &["0644", "`chmod 600 store/keys/identities/mara.key`"]);
    let list = holdpoint(&folder, &["identity", "list", "--json"]);
    assert_eq!((list.status.code(), text(&list.stderr).as_str()), (Some(1), ""));
    let rows: Vec<Value> = serde_json::from_slice(&list.stdout).unwrap();
    assert_eq!(rows[1]["protection"], Value::Null);
    assert!(rows[1]["problem"].as_str().unwrap().contains("0644"), "{rows:?}");
    fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).unwrap();
    ends(&folder, "identity list", 0);
}

#[test]
fn a_key_of_an_ssh_agent_is_enrolled_and_signs() {
    use std::process::Command;
    let folder = quick_folder();
    let Some(agent) = AgentProcess::with_key(folder.path(), "mara@desk") else { return };
    let socket = agent.socket();
    let with = |call: &str, socket: Option<&Path>| {
        let mut process = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
        process.current_dir(folder.path()).args(["--data", "store"]).args(call.split(' '));
        match socket {
            Some(socket) => process.env("SSH_AUTH_SOCK", socket),
            None => process.env_remove("SSH_AUTH_SOCK"),
        };
        process.output().unwrap()
    };
    let succeeds = |call: &str| {
        let output = with(call, Some(&socket));
        let message = text(&output.stdout) + &text(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{call}: {message}");
        message
    };
    let fails = |call: &str, socket: Option<&Path>, codes: &str| {
        assert_error(&with(&format!("{call} --json"), socket), 2, codes);
    };
    let enrol = |key: &str| {
        format!("identity enroll mara --ssh-agent {key} --role engineer --by admin --reason hers")
    };
    fails(&enrol("eve@desk"), Some(&socket), "ssh-agent/no-key");
    fails(&enrol("mara@desk"), None, "ssh-agent/not-named");
    succeeds(&enrol("mara@desk"));
    assert_enrolled(&folder, "mara", "engineer");
    let keys = folder.path().join("store/keys/identities");
    assert!(keys.join("mara.agent").exists() && !keys.join("mara.key").exists());
    let message = succeeds("identity list");
    assert!(message.lines().any(|row| row.starts_with("mara") && row.contains("elsewhere")), "{message}");
    // She is accountable, and the agent signs.
    ends(&folder, "stop", 6);
    let go = "go --stops 1 --as mara --reason empty";
    fails(go, None, "ssh-agent/not-named");
    succeeds(go);
    let records = ends(&folder, "audit list --kind asked --json", 0);
    assert_contains(&records, &["mara", "verified"]);
    agent.forget();
    ends(&folder, "stop", 6);
    fails(go, Some(&socket), "ssh-agent/no-key");
    ends(&folder, "audit verify", 0);
}
