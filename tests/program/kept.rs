//! Cached results through the program: their key, an attack that edits them, and its report.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

use rusqlite::Connection;

fn holdpoint(home: &Path, words: &[&str]) -> Output {
    let config = home.join("config");
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    command.args(words).env("HOME", home).env("XDG_CONFIG_HOME", config).output().unwrap()
}

fn run(home: &Path, script: &str, more: &[&str]) -> Output {
    let words = ["run", "--headless", "--json", "--seed", "3", "--script", script];
    holdpoint(home, &[&words, more].concat())
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// One error with these words, and exit code 2.
fn refuses(home: &Path, words: &[&str], expected: &[&str]) {
    let output = holdpoint(home, words);
    let text = said(&output);
    assert_eq!(output.status.code(), Some(2), "{words:?}: {text}");
    assert_eq!(text.matches("error: ").count(), 1, "{words:?}: {text}");
    for word in expected {
        assert!(text.contains(word), "{words:?}: {word:?} is not in {text:?}");
    }
}

const QUICK: &str = "tests/scenarios/reject-interface.toml";
const HARD_GRIP: &str = "tests/scenarios/reject-behavior.toml";

#[test]
fn the_key_of_a_shared_folder_is_outside_it_and_its_owners() {
    let root = tempfile::tempdir().unwrap();
    let home = root.path();
    let path = |name: &str| home.join(name).to_str().unwrap().to_owned();
    let run = ["run", "--headless", "--script", QUICK];
    let with = |more: &[&str], expected: &[&str]| refuses(home, &[&run, more].concat(), expected);
    let (cells, inside) = (path("cells"), path("cells/cells.key"));
    with(&["--cache", &cells, "--cache-key", &inside], &["cells.key", "outside the folder"]);
    with(&["--cache-key", &path("any.key")], &["--cache-key", "--cache"]);
    refuses(home, &["run", "--plain", "--cache-key", &path("any.key")], &["--cache-key", "--cache"]);
    fs::write(path("open.key"), "00".repeat(32)).unwrap();
    fs::set_permissions(path("open.key"), fs::Permissions::from_mode(0o644)).unwrap();
    with(&["--cache", &cells, "--cache-key", &path("open.key")], &["open.key", "0644"]);
    fs::write(path("short.key"), "no key").unwrap();
    fs::set_permissions(path("short.key"), fs::Permissions::from_mode(0o600)).unwrap();
    with(&["--cache", &cells, "--cache-key", &path("short.key")], &["short.key", "64 hexadecimal digits"]);
    let pool = ["experiment", "per-candidate", "--pool", "manifests/pool", "--cache-key", &inside];
    refuses(home, &pool, &["--cache-key", "--out"]);

    let kept = holdpoint(home, &[&run[..], &["--cache", &cells]].concat());
    assert_eq!(kept.status.code(), Some(1), "{}", said(&kept));
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
fn a_poisoned_store_does_not_let_a_bad_candidate_through() {
    let root = tempfile::tempdir().unwrap();
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
    let filled = run(root.path(), fill.to_str().unwrap(), &["--data", data]);
    assert_eq!(filled.status.code(), Some(3), "it is held: {}", said(&filled));
    let database = Path::new(data).join("telemetry.db");
    let kept = Connection::open(&database).unwrap();
    let edited = kept
        .execute(
            "UPDATE cell SET bytes = length(changed), body = CAST(changed AS BLOB) FROM (
               SELECT key AS edited, replace(replace(replace(replace(CAST(body AS TEXT),
                 '\"success\":true', '\"success\":false'), '\"violation\":false', '\"violation\":true'),
                 '\"anomaly\":false', '\"anomaly\":true'), '\"recovery\":false', '\"recovery\":true') AS changed
               FROM cell) WHERE key = edited AND CAST(body AS TEXT) <> changed",
            [],
        )
        .unwrap();
    assert!(edited >= 280, "{edited} episodes were edited");
    drop(kept);
    // The scenario itself expects the rejection of the candidate by its behavior.
    let attacked = run(root.path(), HARD_GRIP, &["--data", data]);
    assert_eq!(attacked.status.code(), Some(1), "{}", said(&attacked));
    let explained = holdpoint(root.path(), &["explain", "grasp-hard-grip", "--data", data]);
    let text = String::from_utf8(explained.stdout).unwrap().replace("\n      ", " ");
    assert!(text.contains("had no MAC or a wrong one"), "{text}");
    let verified = holdpoint(root.path(), &["audit", "verify", "--data", data]);
    assert!(verified.status.success(), "{}", said(&verified));
}

/// The log is the same with and without cached results, for any number of workers; the record names the cached
/// ones.
#[test]
fn what_is_kept_changes_no_event() {
    let root = tempfile::tempdir().unwrap();
    let path = |name: &str| root.path().join(name).to_str().unwrap().to_owned();
    let cells = path("cells");
    let run = |store: &str, more: &[&str]| {
        let output =
            run(root.path(), HARD_GRIP, &[&["--data", &path(store), "--no-recording"], more].concat());
        assert_eq!(output.status.code(), Some(1), "{}", said(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let without = run("a", &["--jobs", "1"]);
    assert_eq!(run("b", &["--cache", &cells, "--jobs", "2"]), without, "nothing was kept yet");
    assert_eq!(run("c", &["--cache", &cells, "--jobs", "1"]), without);
    assert_eq!(run("d", &["--cache", &cells, "--jobs", "2"]), without);
    let kept = |store: &str| {
        let output =
            holdpoint(root.path(), &["explain", "grasp-hard-grip", "--json", "--data", &path(store)]);
        let told: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let of_all: Vec<_> =
            told["decisions"].as_array().unwrap().iter().map(|one| one["kept"].clone()).collect();
        of_all.into_iter().find(|kept| !kept.is_null())
    };
    assert_eq!(kept("b"), None);
    let used = kept("c").unwrap();
    assert_eq!((&used["place"], &used["refused"]), (&"folder".into(), &0.into()));
    let episodes = &used["blocks"][0];
    assert_eq!((&episodes["work"], &episodes["own"]), (&"episodes".into(), &0.into()));
    assert!(!episodes["rerun"].as_array().unwrap().is_empty(), "{episodes}");
    assert_eq!(kept("d").unwrap()["blocks"][0]["digest"], episodes["digest"], "the same was taken");
}
