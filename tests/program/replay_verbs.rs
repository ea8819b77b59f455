//! The verbs `replay` and `recordings` on a recording that the sink wrote, without a terminal and without a viewer.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::Duration;

use holdpoint::governance::record::UpgradeEnd;
use holdpoint::protocol::clock::tick_of;
use holdpoint::protocol::event::Event;
use holdpoint::protocol::sink::{ClosedRecording, SinkReport};
use holdpoint::recordings::audit_record::{KIND, RecordingClosure};
use holdpoint::registry::Store;
use holdpoint::scene::{SceneConfig, SceneSink, read};
use holdpoint::store::{AuditBody, Transaction};
use serde_json::Value;

use crate::quick_folder::quick_folder;
use crate::reported_error::{assert_error, is_about};
use crate::{shift, upgrade};

/// Lets the sink record the hand-made upgrade, in a folder.
fn record(folder: &Path) -> ClosedRecording {
    let config = SceneConfig { recordings: Some(folder.to_owned()), ..SceneConfig::default() };
    let scenes = SceneSink::start(config).unwrap();
    let feed = scenes.feed();
    let recording = upgrade::recording();
    let mut frames = recording.pictures.into_iter().peekable();
    for event in recording.events {
        while let Some(frame) = frames.next_if(|frame| frame.at_ms < event.at_ms) {
            feed.video_frame(frame);
        }
        feed.events(&[event], shift::snapshot);
    }
    let reports = scenes.finish(Duration::from_mins(1));
    let closed = reports.iter().find_map(|report| match report {
        SinkReport::Closed(closed) => Some(closed.clone()),
        SinkReport::Failed { .. } | SinkReport::Serving { .. } | SinkReport::NotServing { .. } => None,
    });
    closed.unwrap_or_else(|| panic!("{reports:?}"))
}

fn output_of(data: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    command.arg("--data").arg(data).args(arguments).env_remove("DISPLAY").output().unwrap()
}

/// Runs the program: its exit code and what it printed.
fn holdpoint(data: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let output = output_of(data, arguments);
    let text = String::from_utf8(output.stdout).unwrap() + &String::from_utf8(output.stderr).unwrap();
    (output.status.code(), text)
}

#[test]
fn a_replay_prints_all_or_up_to_a_tick() {
    let root = quick_folder();
    let path = root.path().join(record(root.path()).file);
    let file = path.to_str().unwrap();
    let recording = read(&path).unwrap();
    let (code, text) = holdpoint(root.path(), &["replay", file, "--terminal"]);
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!((code, lines.len()), (Some(0), recording.events.len() + 2), "{text}");
    assert!(lines[0].starts_with("place@1.1.0"), "{text}");
    assert!(lines.last().unwrap().contains(UpgradeEnd::RolledBack.name()), "{text}");
    assert_eq!(holdpoint(root.path(), &["replay", file, "--plain"]), (Some(0), text));
    let (code, json) = holdpoint(root.path(), &["replay", file, "--json"]);
    let events: Vec<Event> = json.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!((code, events), (Some(0), recording.events.clone()));
    let to_ms = 800_000;
    let (code, json) =
        holdpoint(root.path(), &["replay", file, "--json", "--to", &tick_of(to_ms).to_string()]);
    let earlier = recording.events.iter().filter(|event| event.at_ms <= to_ms).count();
    assert_eq!((code, json.lines().count()), (Some(0), earlier));
    assert!(earlier > 5 && earlier < recording.events.len(), "{earlier}");
    let cut = root.path().join("cut.rrd");
    let to = tick_of(to_ms).to_string();
    let arguments = ["replay", file, "--to", &to, "--out", cut.to_str().unwrap()];
    assert_eq!(holdpoint(root.path(), &arguments).0, Some(0));
    assert_eq!(read(&cut).unwrap().events.len(), earlier);
    let error = assert_error(&output_of(root.path(), &[&arguments[..], &["--json"]].concat()), 2, "exists");
    assert!(is_about(&error, "cut.rrd"), "{error}");
}

/// A store with a closed recording whose digest is on record.
fn store(root: &Path) -> PathBuf {
    let store = Store::open(root).unwrap();
    let folder = store.layout().recordings();
    let closed = record(&folder);
    let closure = RecordingClosure {
        file: closed.file.clone(),
        sha256: closed.digest,
        bytes: closed.bytes,
        pictures: closed.frames,
        dropped_pictures: closed.dropped.0,
        dropped_events: closed.dropped.1,
        outcome: closed.outcome,
    };
    let body = serde_json::to_string(&closure).unwrap();
    let audit = vec![AuditBody { kind: KIND, subject: closed.version.to_string(), body }];
    let command_id = "closed".to_owned();
    store.commit(Transaction { command_id, at_ms: 1, wall_ms: 0, changes: Vec::new(), audit }).unwrap();
    folder.join(closed.file)
}

#[test]
fn one_changed_byte_is_found_before_it_is_opened() {
    let root = quick_folder();
    let path = store(root.path());
    // The last line sums up.
    let last = |text: &str| serde_json::from_str::<Value>(text.lines().last().unwrap()).unwrap();
    let verify = ["recordings", "verify", "--json"];
    let (code, text) = holdpoint(root.path(), &verify);
    let summary = last(&text);
    assert_eq!((code, &summary["recordings"], &summary["bad"]), (Some(0), &1.into(), &0.into()), "{text}");
    let (code, text) = holdpoint(root.path(), &["recordings", "list", "--json"]);
    let listed: Value = serde_json::from_str(&text).unwrap();
    assert_eq!((code, &listed["version"]), (Some(0), &Value::from("place@1.1.0")));
    assert_eq!(listed["outcome"], UpgradeEnd::RolledBack.name());
    assert_eq!(holdpoint(root.path(), &["replay", "place@1.1.0", "--plain"]).0, Some(0));
    let elsewhere = quick_folder();
    let backup = |name: &str| {
        let to = elsewhere.path().join(name);
        let (code, text) =
            holdpoint(root.path(), &["store", "backup", to.to_str().unwrap(), "--with-recordings", "--json"]);
        (code, last(&text)["report"].clone())
    };
    let (code, report) = backup("good");
    assert_eq!((code, &report["recordings"]), (Some(0), &1.into()), "{report}");
    let all = ["audit", "verify", "--all", "--json"];
    let (code, text) = holdpoint(&elsewhere.path().join("good"), &all);
    assert_eq!((code, &last(&text)["recordings"]), (Some(0), &1.into()), "{text}");
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let (code, text) = holdpoint(root.path(), &verify);
    assert_eq!((code, &last(&text)["bad"]), (Some(1), &1.into()), "{text}");
    assert_eq!(holdpoint(root.path(), &["replay", "place@1.1.0", "--plain"]).0, Some(1));
    let (code, text) = holdpoint(root.path(), &["replay", "place@1.1.0", "--json"]);
    assert_eq!((code, &last(&text)["sound"]), (Some(1), &false.into()), "{text}");
    let left_out = |(code, report): (Option<i32>, Value)| {
        assert_eq!((code, &report["left_out"][0]["bad"]), (Some(1), &true.into()), "{report}");
        report["left_out"][0]["why"].as_str().unwrap().to_owned()
    };
    assert_eq!(left_out(backup("edited")), "other-digest");
    // To read it to its end would take hours.
    std::fs::File::create(&path).unwrap().set_len(1 << 40).unwrap();
    for arguments in [&verify[..], &all, &["replay", "place@1.1.0", "--plain"]] {
        let (code, text) = holdpoint(root.path(), arguments);
        assert!(code == Some(1) && text.contains("1099511627776 bytes"), "{arguments:?}: {text}");
    }
    assert_eq!(left_out(backup("stretched")), "other-size");
}
