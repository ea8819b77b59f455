//! The verb on a store with recordings: listed, verified, removed with a record.

use super::*;
use holdpoint_recordings::audit_record::{KIND, RecordingClosure};
use holdpoint_registry::Store;
use holdpoint_store::{AuditBody, Transaction};
use holdpoint_text::ErrorReason;

const FILE: &str = "grasp-1.1.0-0123abcd.rrd";
const SECOND: &str = "grasp-1.1.0-0123abcd.2.rrd";
const OPEN: &str = "place-1.1.0-0123abcd.rrd";

/// A store with three recordings of which two are on record.
fn store() -> (tempfile::TempDir, CliContext) {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let folder = store.layout().recordings();
    let mut audit = Vec::new();
    for (file, on_record) in [(FILE, true), (SECOND, true), (OPEN, false)] {
        std::fs::write(folder.join(file), file).unwrap();
        let recorded = RecordingClosure {
            file: file.to_owned(),
            sha256: recording_folder::digest(&folder.join(file)).unwrap(),
            bytes: file.len() as u64,
            pictures: 3,
            dropped_pictures: 0,
            dropped_events: 0,
            outcome: holdpoint_governance::record::UpgradeEnd::Confirmed.into(),
        };
        if on_record {
            let body = serde_json::to_string(&recorded).unwrap();
            audit.push(AuditBody { kind: KIND, subject: "grasp@1.1.0".to_owned(), body });
        }
    }
    let transaction =
        Transaction { command_id: "test".to_owned(), at_ms: 1, wall_ms: 0, changes: Vec::new(), audit };
    store.commit(transaction).unwrap();
    drop(store);
    let context = CliContext { data: root.path().to_owned(), data_given: true, json: false };
    (root, context)
}

fn run_verb(context: &CliContext, verb: RecordingsVerb, json: bool) -> (Result<Exit, CliError>, String) {
    let mut output = Vec::new();
    let result = run(context, &RecordingsArgs { verb }, &mut CommandOutput::to(&mut output, json));
    (result, String::from_utf8(output).unwrap())
}

fn keep_none(dry_run: bool) -> RecordingsVerb {
    RecordingsVerb::Prune(PruneArgs { keep: Some(0), older_than: None, max_mib: None, dry_run })
}

/// The JSON documents of an output, without the version that each begins with.
fn rows(text: &str) -> Vec<Value> {
    let row = |line| {
        let mut row: serde_json::Map<String, Value> = serde_json::from_str(line).unwrap();
        assert_eq!(row.remove("json_version"), Some(crate::cli::output::JSON_VERSION.into()), "{line}");
        Value::Object(row)
    };
    text.lines().map(row).collect()
}

#[test]
fn recordings_are_listed_with_their_records() {
    let (_root, context) = store();
    let (ended, text) = run_verb(&context, RecordingsVerb::List, false);
    assert_eq!(ended.unwrap(), Exit::Confirmed);
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines[1].starts_with("grasp@1.1.0 "), "{text}");
    assert!(lines[1].contains("yes") && lines[1].ends_with(FILE) && lines[2].ends_with(SECOND), "{text}");
    assert!(lines[3].starts_with("place@1.1.0 ") && lines[3].contains(" no "), "{text}");
    assert!(lines[4].starts_with("3 files, "), "{text}");
    let (_, text) = run_verb(&context, RecordingsVerb::List, true);
    let listed = rows(&text);
    let [first, .., open] = listed.as_slice() else { panic!("{text}") };
    assert_eq!((&first["version"], &first["on_record"]), (&json!("grasp@1.1.0"), &json!(true)));
    assert_eq!((&first["outcome"], &open["outcome"]), (&json!("confirmed"), &Value::Null));
}

/// A pipe with a recording's name was once skipped silently.
#[test]
fn non_file_with_the_name_of_a_recording_is_reported() {
    const PIPE: &str = "align-1.1.0-0123abcd.rrd";
    let (root, context) = store();
    let folder = Layout::new(root.path()).recordings();
    drop(std::os::unix::net::UnixListener::bind(folder.join(PIPE)).unwrap());
    std::fs::remove_file(folder.join(SECOND)).unwrap();
    std::fs::create_dir(folder.join(SECOND)).unwrap();
    let (ended, text) = run_verb(&context, RecordingsVerb::List, false);
    assert_eq!(ended.unwrap(), Exit::Confirmed);
    assert!(
        text.contains(&holdpoint_wording::counted(2, "file")) && text.contains(PIPE) && text.contains(SECOND),
        "{text}"
    );
    let (_, text) = run_verb(&context, RecordingsVerb::List, true);
    for no_file in
        [json!({ "file": PIPE, "no_file": "a socket" }), json!({ "file": SECOND, "no_file": "a folder" })]
    {
        assert!(rows(&text).contains(&no_file), "{text}");
    }
    let (ended, text) = run_verb(&context, RecordingsVerb::Verify, true);
    assert_eq!(ended.unwrap(), Exit::Rejected, "{text}");
    assert!(
        rows(&text).contains(&json!({ "file": PIPE, "standing": "no file", "detail": "a socket" })),
        "{text}"
    );
    let second: Vec<Value> = rows(&text).into_iter().filter(|row| row["file"] == SECOND).collect();
    let [second] = second.as_slice() else { panic!("{text}") };
    assert!(second["standing"] == "missing" && second["detail"].to_string().contains("a folder"), "{text}");
}

#[test]
fn changed_or_missing_recording_is_found() {
    let (root, context) = store();
    let folder = Layout::new(root.path()).recordings();
    let (ended, text) = run_verb(&context, RecordingsVerb::Verify, true);
    assert_eq!(ended.unwrap(), Exit::Confirmed, "{text}");
    let summary = json!({ "sound": true, "recordings": 3, "bad": 0, "not_on_record": 1 });
    assert_eq!(rows(&text).last(), Some(&summary));
    std::fs::write(folder.join(FILE), "longer than what was recorded").unwrap();
    let (_, text) = run_verb(&context, RecordingsVerb::Verify, true);
    let longer = rows(&text).into_iter().find(|row| row["file"] == FILE).unwrap();
    let detail = longer["detail"].as_str().unwrap();
    assert!(longer["standing"] == "differs" && detail.contains("29") && detail.contains("24"), "{longer}");
    std::fs::write(folder.join(FILE), FILE.to_uppercase()).unwrap();
    std::fs::remove_file(folder.join(SECOND)).unwrap();
    let (ended, text) = run_verb(&context, RecordingsVerb::Verify, true);
    assert_eq!(ended.unwrap(), Exit::Rejected, "{text}");
    let found = rows(&text);
    for (file, result) in [
        (FILE, RecordingCheck::Differs),
        (SECOND, RecordingCheck::Missing),
        (OPEN, RecordingCheck::NotOnRecord),
    ] {
        assert!(found.iter().any(|row| row["file"] == file && row["standing"] == result.name()), "{text}");
    }
    let last = found.last().unwrap();
    assert_eq!((&last["sound"], &last["bad"]), (&json!(false), &json!(2)));
}

#[test]
fn recorded_removal_is_not_reported_as_missing() {
    let (root, context) = store();
    let layout = Layout::new(root.path());
    let open_store = prune::take_store(root.path()).unwrap();
    let files = shelved(&layout.recordings()).unwrap();
    for filed in files.iter().filter(|filed| filed.file != OPEN) {
        prune::remove(&open_store, &filed.name.version, filed, "too old").unwrap();
        assert!(!filed.path.exists());
    }
    drop(open_store);
    let (ended, text) = run_verb(&context, RecordingsVerb::Verify, false);
    assert_eq!((ended.unwrap(), text.lines().count()), (Exit::Confirmed, 2), "{text}");
    let record = on_record(&crate::cli::data::open(root.path()).unwrap()).unwrap();
    let removed = record.0[FILE].removed.clone().unwrap();
    assert_eq!((removed.reason.as_str(), removed.bytes), ("too old", FILE.len() as u64));
    assert_eq!(removed.sha256, record.recorded(FILE).unwrap().sha256);
    assert!(holdpoint_registry::verify(&layout.database(), None).is_ok());
}

#[test]
fn pruning_spares_open_and_unknown_upgrades_and_a_store_in_use() {
    let (root, context) = store();
    let (ended, text) = run_verb(&context, keep_none(false), false);
    // No version of these is registered here, so their upgrades are unknown.
    assert_eq!((ended.unwrap(), text.as_str()), (Exit::Confirmed, "0 files, 0 B, removed\n"));
    let engine = Store::open(root.path()).unwrap();
    let error = run_verb(&context, keep_none(false), false).0.unwrap_err();
    assert_eq!(error.exit(), Exit::Usage);
    assert_eq!(error.details().unwrap().reason, ErrorReason::StoreInUse, "{error}");
    assert_eq!(run_verb(&context, keep_none(true), false).0.unwrap(), Exit::Confirmed);
    drop(engine);
    assert_eq!(shelved(&Layout::new(root.path()).recordings()).unwrap().len(), 3);
}
