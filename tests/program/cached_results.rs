//! Cached results through the program: their key, an attack that edits them, and its report.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

use rusqlite::Connection;

use crate::quick_folder::quick_folder;
use crate::reported_error::{assert_error, is_about};

fn holdpoint(home: &Path, arguments: &[&str]) -> Output {
    let config = home.join("config");
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    command.args(arguments).env("HOME", home).env("XDG_CONFIG_HOME", config).output().unwrap()
}

fn run(home: &Path, script: &str, more: &[&str]) -> Output {
    let arguments = ["run", "--headless", "--json", "--seed", "3", "--script", script];
    holdpoint(home, &[&arguments, more].concat())
}

fn stderr_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Exit code 2, and an error with this reason.
#[track_caller]
fn refuses(home: &Path, arguments: &[&str], reason: &str) -> serde_json::Value {
    assert_error(&holdpoint(home, &[arguments, &["--json"]].concat()), 2, reason)
}

const QUICK: &str = "tests/scenarios/reject-interface.toml";
const HARD_GRIP: &str = "tests/scenarios/reject-behavior.toml";

#[test]
fn the_key_of_a_shared_folder_is_outside_it_and_its_owners() {
    let root = quick_folder();
    let home = root.path();
    let path = |name: &str| home.join(name).to_str().unwrap().to_owned();
    let run = ["run", "--headless", "--script", QUICK];
    let with = |more: &[&str], reason: &str| refuses(home, &[&run, more].concat(), reason);
    let (cells, inside) = (path("cells"), path("cells/cells.key"));
    with(&["--cache", &cells, "--cache-key", &inside], "bad-input");
    with(&["--cache-key", &path("any.key")], "usage");
    refuses(home, &["run", "--plain", "--cache-key", &path("any.key")], "usage");
    fs::write(path("open.key"), "00".repeat(32)).unwrap();
    fs::set_permissions(path("open.key"), fs::Permissions::from_mode(0o644)).unwrap();
    let error = with(&["--cache", &cells, "--cache-key", &path("open.key")], "bad-file");
    assert!(is_about(&error, "open.key"), "{error}");
    fs::write(path("short.key"), "no key").unwrap();
    fs::set_permissions(path("short.key"), fs::Permissions::from_mode(0o600)).unwrap();
    let error = with(&["--cache", &cells, "--cache-key", &path("short.key")], "bad-file");
    assert!(is_about(&error, "short.key"), "{error}");

    let output = holdpoint(home, &[&run[..], &["--cache", &cells]].concat());
    assert_eq!(output.status.code(), Some(1), "{}", stderr_text(&output));
    let key = home.join("config/holdpoint/cells.key");
    assert_eq!(
        fs::metadata(key).unwrap().permissions().mode() & 0o777,
        0o600,
        "the operator's own, by default"
    );
}

/// The store's own rows, edited so that the baseline fails: the comparison let `grasp-hard-grip` pass sandbox,
/// shadow and gate.
/// sandbox, shadow and gate.
#[test]
fn forged_cached_results_do_not_pass_a_bad_candidate() {
    let root = quick_folder();
    let data = root.path().join("store");
    let data = data.to_str().unwrap();
    let fill = root.path().join("fill.toml");
    fs::write(
        &fill,
        "profile = \"sim\"\n\
         [[step]]\nregister = \"manifests/candidates/grasp-improved\"\n\
         [[step]]\nwait = { state = \"sandboxed\", timeout_s = 20000 }\n\
         [[step]]\ndemote = { as = \"ada\", reason = \"it has filled the store\" }\n",
    )
    .unwrap();
    let fill_output = run(root.path(), fill.to_str().unwrap(), &["--data", data, "--no-recording"]);
    assert_eq!(fill_output.status.code(), Some(3), "it is held: {}", stderr_text(&fill_output));
    let database = Path::new(data).join("telemetry.db");
    let connection = Connection::open(&database).unwrap();
    let edited_rows = connection
        .execute(
            "UPDATE cell SET bytes = length(changed), body = CAST(changed AS BLOB) FROM (
               SELECT key AS edited, replace(replace(replace(replace(CAST(body AS TEXT),
                 '\"success\":true', '\"success\":false'), '\"violation\":false', '\"violation\":true'),
                 '\"anomaly\":false', '\"anomaly\":true'), '\"recovery\":false', '\"recovery\":true') AS changed
               FROM cell) WHERE key = edited AND CAST(body AS TEXT) <> changed",
            [],
        )
        .unwrap();
    assert!(edited_rows >= 280, "{edited_rows} episodes were edited");
    drop(connection);
    // The scenario itself expects the rejection of the candidate by its behavior.
    let run_output = run(root.path(), HARD_GRIP, &["--data", data, "--no-recording"]);
    assert_eq!(run_output.status.code(), Some(1), "{}", stderr_text(&run_output));
    let explanation = holdpoint(root.path(), &["explain", "grasp-hard-grip", "--json", "--data", data]);
    let explanation: serde_json::Value = serde_json::from_slice(&explanation.stdout).unwrap();
    let mut decisions = explanation["decisions"].as_array().unwrap().iter();
    assert!(
        decisions.any(|one| one["kept"]["refused"].as_u64().is_some_and(|refused| refused > 0)),
        "{explanation}"
    );
    let verification = holdpoint(root.path(), &["audit", "verify", "--data", data]);
    assert!(verification.status.success(), "{}", stderr_text(&verification));
}

/// The log is the same with and without cached results, for any number of workers; the record names the cached
/// ones.
#[test]
fn caching_changes_no_event() {
    let root = quick_folder();
    let path = |name: &str| root.path().join(name).to_str().unwrap().to_owned();
    let cells = path("cells");
    let run = |store: &str, more: &[&str]| {
        let output =
            run(root.path(), HARD_GRIP, &[&["--data", &path(store), "--no-recording"], more].concat());
        assert_eq!(output.status.code(), Some(1), "{}", stderr_text(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let without = run("a", &["--jobs", "1"]);
    assert_eq!(run("b", &["--cache", &cells, "--jobs", "2"]), without, "nothing was kept yet");
    assert_eq!(run("c", &["--cache", &cells, "--jobs", "1"]), without);
    assert_eq!(run("d", &["--cache", &cells, "--jobs", "2"]), without);
    let cache_entry = |store: &str| {
        let output =
            holdpoint(root.path(), &["explain", "grasp-hard-grip", "--json", "--data", &path(store)]);
        let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let entries: Vec<_> =
            document["decisions"].as_array().unwrap().iter().map(|one| one["kept"].clone()).collect();
        entries.into_iter().find(|entry| !entry.is_null())
    };
    assert_eq!(cache_entry("b"), None);
    let usage = cache_entry("c").unwrap();
    assert_eq!((&usage["place"], &usage["refused"]), (&"folder".into(), &0.into()));
    let episodes = &usage["blocks"][0];
    assert_eq!((&episodes["work"], &episodes["own"]), (&"episodes".into(), &0.into()));
    assert!(!episodes["rerun"].as_array().unwrap().is_empty(), "{episodes}");
    assert_eq!(cache_entry("d").unwrap()["blocks"][0]["digest"], episodes["digest"], "the same was taken");
}
