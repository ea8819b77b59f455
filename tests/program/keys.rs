//! Passphrase-protected keys, without a terminal: created, changed, listed, and used by the verbs that sign.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use crate::reported_error::{assert_error, is_about};

fn holdpoint(data: &Path, arguments: &[&str], variable: Option<&Path>) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    command.arg("--data").arg(data).args(arguments).env_remove("HOLDPOINT_PASSPHRASE_FILE");
    if let Some(file) = variable {
        command.env("HOLDPOINT_PASSPHRASE_FILE", file);
    }
    command.output().unwrap()
}

#[track_caller]
fn ends(output: &Output, code: i32, parts: &[&str]) -> String {
    let text =
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{text}");
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
    text
}

#[test]
fn a_key_is_made_changed_and_used_by_passphrase_files() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("store");
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        path
    };
    let (oak, elm, short) =
        (file("oak", "under the oak\n"), file("elm", "under the elm\n"), file("short", "short\n"));
    let [oak_text, elm_text, short_text] = [&oak, &elm, &short].map(|path| path.to_str().unwrap());
    let run = |arguments: &[&str]| holdpoint(&data, arguments, None);
    let fails = |arguments: &[&str], exit: i32, codes: &str| {
        assert_error(&run(&[arguments, &["--json"]].concat()), exit, codes)
    };

    // Without a terminal an option must supply the passphrase.
    fails(&["identity", "new", "mara"], 2, "passphrase/needed");
    fails(&["identity", "new", "mara", "--passphrase-file", short_text], 2, "passphrase/too-short");
    assert!(!data.exists(), "nothing was made");
    let output = run(&["identity", "new", "mara", "--passphrase-file", oak_text]);
    let text = ends(&output, 0, &["mara"]);
    assert!(!text.contains("oak"), "{text}");
    ends(&run(&["identity", "new", "rig", "--unprotected"]), 0, &["rig"]);
    let key = data.join("keys/identities/mara.key");
    assert_eq!(fs::metadata(&key).unwrap().permissions().mode() & 0o7777, 0o600);
    let key_text = fs::read_to_string(&key).unwrap();
    let head = "holdpoint-key 1\nkdf argon2id\nmemory-kib 65536\npasses 3\nlanes 4\nsalt ";
    assert!(key_text.starts_with(head), "{key_text}");
    let list: Vec<Value> = serde_json::from_slice(&run(&["identity", "list", "--json"]).stdout).unwrap();
    let row =
        |one: &Value| ["name", "role", "protection"].map(|field| one[field].as_str().unwrap().to_owned());
    assert_eq!(
        list.iter().map(row).collect::<Vec<_>>(),
        [
            ["admin", "admin", "unprotected"],
            ["mara", "operator", "passphrase"],
            ["rig", "operator", "unprotected"]
        ]
    );
    ends(&run(&["identity", "list"]), 0, &["PROTECTION", "unprotected"]);

    // A verb that signs.
    fails(&["stop"], 6, "no-answer");
    let go = ["go", "--as", "mara", "--stops", "1", "--reason", "checked"];
    let with = |path| [go.as_slice(), &["--passphrase-file", path]].concat();
    fails(&go, 2, "passphrase/needed");
    fails(&with(elm_text), 2, "passphrase/wrong");
    fs::set_permissions(&oak, fs::Permissions::from_mode(0o644)).unwrap();
    let error = fails(&with(oak_text), 2, "bad-file");
    assert!(is_about(&error, oak_text), "{error}");
    fs::set_permissions(&oak, fs::Permissions::from_mode(0o600)).unwrap();
    ends(&run(&["status"]), 0, &["STOPPED"]);
    ends(&run(&with(oak_text)), 0, &[]);
    fails(&["stop"], 6, "no-answer");
    ends(&holdpoint(&data, &go, Some(&oak)), 0, &[]);

    // A new passphrase, none, and one again: the key stays the same.
    let change = |options: &[&str]| run(&[&["identity", "passphrase", "mara"], options].concat());
    let cannot_change = |options: &[&str], codes: &str| {
        assert_error(&change(&[options, &["--json"]].concat()), 2, codes);
    };
    cannot_change(&["--passphrase-file", elm_text, "--new-passphrase-file", elm_text], "passphrase/wrong");
    assert_eq!(fs::read_to_string(&key).unwrap(), key_text);
    let change_output = change(&["--passphrase-file", oak_text, "--new-passphrase-file", elm_text]);
    ends(&change_output, 0, &[]);
    cannot_change(&["--passphrase-file", oak_text, "--remove"], "passphrase/wrong");
    ends(&change(&["--passphrase-file", elm_text, "--remove"]), 0, &[]);
    cannot_change(&["--passphrase-file", elm_text, "--remove"], "passphrase/not-set");
    ends(&change(&["--new-passphrase-file", oak_text]), 0, &[]);
    let list: Vec<Value> = serde_json::from_slice(&run(&["identity", "list", "--json"]).stdout).unwrap();
    assert_eq!((&list[1]["name"], &list[1]["protection"]), (&"mara".into(), &"passphrase".into()));

    // The error for a damaged file names the field and the allowed values.
    fs::write(&key, key_text.replace("memory-kib 65536", "memory-kib 4194304000")).unwrap();
    let error = fails(&with(oak_text), 2, "bad-file");
    assert!(is_about(&error, "mara.key") && error["field"] == "memory-kib", "{error}");
}
