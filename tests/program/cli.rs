//! The verbs that only read, on a store with content, in both output forms.

use std::ffi::OsString;
use std::path::Path;

use holdpoint::cli::{Cli, CliContext, CliError, CommandOutput, EngineVerb, EngineVerbs, Exit, dispatch};
use holdpoint::registry::Store;
use holdpoint::store::Batch;
use serde_json::Value;

use crate::store::{bootstrap, commit, shadowing, transaction};

/// An engine that must not be used here.
struct NoEngine;

impl EngineVerbs for NoEngine {
    fn run(
        &mut self,
        _: &CliContext,
        verb: EngineVerb<'_>,
        _: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError> {
        Err(CliError::internal(format!("asked for {verb:?}")))
    }
}

/// Runs a command line on a store; returns its exit code and output.
fn run_line(data: &Path, line: &str) -> (Exit, String) {
    let arguments =
        ["holdpoint", "--data", data.to_str().unwrap()].into_iter().chain(line.split_whitespace());
    let cli = Cli::parse_line(arguments.map(OsString::from)).unwrap();
    let mut bytes = Vec::new();
    let exit = dispatch(&cli, &mut NoEngine, &mut CommandOutput::to(&mut bytes, cli.json)).unwrap();
    (exit, String::from_utf8(bytes).unwrap())
}

fn json(data: &Path, line: &str) -> Value {
    let (exit, text) = run_line(data, &format!("{line} --json"));
    assert_eq!(exit, Exit::Confirmed, "{line}: {text}");
    serde_json::from_str(&text).unwrap()
}

fn filled() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path()).unwrap();
    bootstrap(&store, "grasp");
    commit(&store, "candidate", shadowing("grasp@1.1.0")).unwrap();
    folder
}

#[test]
fn the_registry_is_shown() {
    let folder = filled();
    let data = folder.path();
    for (view, expected) in [
        ("all", &["grasp@1.0.0", "grasp@1.1.0"][..]),
        ("active", &["grasp@1.0.0"]),
        ("candidates", &["grasp@1.1.0"]),
        ("history", &[]),
    ] {
        let list = json(data, &format!("registry list --view {view}"));
        let names: Vec<&str> =
            list["versions"].as_array().unwrap().iter().map(|row| row["version"].as_str().unwrap()).collect();
        assert_eq!(names, expected, "{view}");
        let (_, text) = run_line(data, &format!("registry list --view {view}"));
        assert!(expected.iter().all(|name| text.contains(name)), "{text}");
    }
    let list = json(data, "registry list --limit 1");
    assert_eq!((list["total"].as_u64(), list["versions"].as_array().unwrap().len()), (Some(2), 1));
    assert!(run_line(data, "registry list --limit 1").1.contains("1 more"));

    let detail = json(data, "registry show grasp@1.1.0");
    assert_eq!(detail["summary"]["state"], "shadowed");
    assert_eq!(detail["evidence"][0]["body"]["is"], "gate grasp@1.1.0");
    let (_, text) = run_line(data, "registry show grasp@1.1.0");
    assert!(text.contains("shadowed") && text.contains("gate"), "{text}");

    let history = json(data, "registry history grasp");
    assert_eq!(history["active"], "grasp@1.0.0");
    assert_eq!(history["activations"][0]["cause"], "bootstrap");
    assert!(run_line(data, "registry history grasp").1.contains("bootstrap"));
}

#[test]
fn the_audit_log_is_listed_exported_and_verified() {
    let folder = filled();
    let data = folder.path();
    let store = Store::open(data).unwrap();
    let batch = Batch {
        version: "grasp@1.0.0".parse().unwrap(),
        stream: "live".into(),
        from_ms: 1,
        to_ms: 2,
        rows: 1,
        body: vec![1],
    };
    store.append_telemetry(&batch).unwrap();
    let seals = store.seal_telemetry().unwrap();
    commit(&store, "seals", seals).unwrap();
    drop(store);
    let (_, text) = run_line(data, "audit list --all --json");
    let records: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let newest = records[0]["seq"].as_u64().unwrap();
    assert_eq!(records.len() as u64, newest, "the newest first, none left out");
    assert_eq!(run_line(data, "audit list --limit 2 --json").1.lines().count(), 2);
    // Telemetry digests are most of the records, and are omitted by default.
    let is_digest =
        |record: &&Value| record["kind"].as_str().is_some_and(|kind| kind.starts_with("telemetry-"));
    let seals = records.iter().filter(is_digest).count();
    assert!(seals > 0);
    let (_, listing) = run_line(data, "audit list --json");
    assert_eq!(listing.lines().count(), records.len() - seals);
    assert!(run_line(data, "audit list --limit 1").1.contains("--all"));
    assert_eq!(run_line(data, "audit export").1.lines().count() as u64, newest);
    assert_eq!(run_line(data, &format!("audit export --from {newest}")).1.lines().count(), 1);
    let verification = json(data, "audit verify");
    assert_eq!(
        (verification["sound"].as_bool(), verification["report"]["records"].as_u64()),
        (Some(true), Some(newest))
    );
    assert_eq!(verification["report"]["key_given"], true);
}

#[test]
fn a_forged_record_is_named_and_ends_with_a_rejection() {
    let folder = filled();
    let database = folder.path().join("holdpoint.db");
    let bytes = std::fs::read(&database).unwrap();
    // The bodies of evidence are stored as text: changing one word in place leaves the file well formed.
    let (from, to) = (b"gate grasp@1.1.0", b"gate grasp@9.9.9");
    let forged: Vec<u8> = {
        let mut bytes = bytes.clone();
        let places: Vec<usize> =
            (0..bytes.len() - from.len()).filter(|at| bytes[*at..].starts_with(from)).collect();
        assert!(!places.is_empty(), "the evidence is not in the file");
        for at in places {
            bytes[at..at + to.len()].copy_from_slice(to);
        }
        bytes
    };
    std::fs::write(&database, forged).unwrap();
    let (exit, text) = run_line(folder.path(), "audit verify");
    assert_eq!(exit, Exit::Rejected, "{text}");
    let (exit, text) = run_line(folder.path(), "audit verify --json");
    assert_eq!(exit, Exit::Rejected);
    assert_eq!(serde_json::from_str::<Value>(&text).unwrap()["sound"], false);
    // Restored, it is sound again.
    std::fs::write(&database, bytes).unwrap();
    assert_eq!(run_line(folder.path(), "audit verify").0, Exit::Confirmed);
}

#[test]
fn hostile_text_is_shown_escaped() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path()).unwrap();
    bootstrap(&store, "grasp");
    let mut hostile = transaction("hostile", 2, Vec::new());
    hostile.audit[0].body = "{\"reason\":\"\u{9b}2J\u{202e}\"}".into();
    store.commit(hostile).unwrap();
    for line in ["audit list", "audit list --json", "audit export", "registry show grasp@1.0.0 --json"] {
        let (_, text) = run_line(folder.path(), line);
        assert!(!text.contains(['\u{9b}', '\u{202e}', '\u{1b}']), "{line}: {text:?}");
    }
    assert!(run_line(folder.path(), "audit list --json").1.contains(r"\u009b"));
}
