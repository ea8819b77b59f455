//! The verb without a scene crate: its files, their check, and the viewer's start.

use super::*;
use holdpoint_recordings::audit_record::{KIND, RecordingClosure};
use holdpoint_registry::Store;
use holdpoint_store::{AuditBody, Transaction};

const FILES: [&str; 2] = ["grasp-1.1.0-0123abcd.rrd", "grasp-1.1.0-0123abcd.2.rrd"];

/// A store with a recording in two segments; the first is on record.
fn store() -> (tempfile::TempDir, CliContext) {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let folder = store.layout().recordings();
    for file in FILES {
        std::fs::write(folder.join(file), file).unwrap();
    }
    let recorded = RecordingClosure {
        file: FILES[0].to_owned(),
        sha256: recording_folder::digest(&folder.join(FILES[0])).unwrap(),
        bytes: FILES[0].len() as u64,
        pictures: 1,
        dropped_pictures: 0,
        dropped_events: 0,
        outcome: holdpoint_governance::record::UpgradeEnd::Confirmed.into(),
    };
    let body = serde_json::to_string(&recorded).unwrap();
    let audit = vec![AuditBody { kind: KIND, subject: "grasp@1.1.0".to_owned(), body }];
    let command_id = "test".to_owned();
    store.commit(Transaction { command_id, at_ms: 1, wall_ms: 0, changes: Vec::new(), audit }).unwrap();
    let context = CliContext { data: root.path().to_owned(), data_given: true, json: false };
    (root, context)
}

fn args(upgrade: &str, more: &[&str]) -> ReplayArgs {
    use clap::Parser as _;
    let line = ["holdpoint", "replay", upgrade].into_iter().chain(more.iter().copied());
    let Some(crate::cli::Verb::Replay(args)) = crate::cli::Cli::try_parse_from(line).unwrap().verb else {
        panic!("another verb")
    };
    args
}

/// A viewer that writes down its arguments.
fn viewer_in(folder: &Path) -> ProcessEnvironment {
    let path = folder.join("rerun");
    let text = "#!/bin/sh\n[ \"$1\" = --version ] && echo 'rerun-cli 0.36.3' && exit 0\nfor f; do echo \"$f\"; done > \"$0.asked\"\n";
    std::fs::write(&path, text).unwrap();
    std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    ProcessEnvironment { path: Some(folder.into()), has_screen: true, has_terminal: false }
}

fn run_replay(
    context: &CliContext,
    args: &ReplayArgs,
    environment: &ProcessEnvironment,
) -> (Result<Exit, CliError>, String) {
    let mut output = Vec::new();
    let result = replay(context, args, environment, &mut CommandOutput::to(&mut output, context.json));
    (result, String::from_utf8(output).unwrap())
}

#[test]
fn all_segments_of_a_version_are_opened_in_the_viewer() {
    let (root, context) = store();
    let environment = viewer_in(root.path());
    let (ended, text) = run_replay(&context, &args("grasp@1.1.0", &[]), &environment);
    assert_eq!(ended.unwrap(), Exit::Confirmed, "{text}");
    assert!(text.contains("0.36.3") && text.contains("2 files"), "{text}");
    let arguments = std::fs::read_to_string(root.path().join("rerun.asked")).unwrap();
    let files: Vec<PathBuf> = arguments.lines().skip(5).map(PathBuf::from).collect();
    let folder = Layout::new(root.path()).recordings().canonicalize().unwrap();
    assert_eq!(files, FILES.map(|file| folder.join(file)));
    assert!(Layout::new(root.path()).logs().join(viewer::LOG_NAME).is_file());
}

#[test]
fn recording_with_another_digest_opens_only_with_force() {
    let (root, context) = store();
    let environment = viewer_in(root.path());
    let file = Layout::new(root.path()).recordings().join(FILES[0]);
    std::fs::write(&file, "changed").unwrap();
    for upgrade in ["grasp@1.1.0", file.to_str().unwrap()] {
        let (ended, text) = run_replay(&context, &args(upgrade, &[]), &environment);
        assert_eq!(ended.unwrap(), Exit::Rejected, "{text}");
        assert!(text.starts_with("DIFFERS ") && text.contains("--force"), "{text}");
        assert!(!root.path().join("rerun.asked").exists());
    }
    // In another folder the files have no record.
    let copy = root.path().join("copy.rrd");
    std::fs::copy(&file, &copy).unwrap();
    assert_eq!(
        run_replay(&context, &args(copy.to_str().unwrap(), &[]), &environment).0.unwrap(),
        Exit::Confirmed
    );
    let (ended, text) = run_replay(&context, &args("grasp@1.1.0", &["--force"]), &environment);
    assert_eq!(ended.unwrap(), Exit::Confirmed);
    assert!(text.contains("DIFFERS ") && text.contains("rerun 0.36.3"), "{text}");
}

#[test]
fn a_missing_part_is_named_with_a_hint() {
    let (root, context) = store();
    let mut environment = viewer_in(root.path());
    for upgrade in ["place@9.0.0", "none.rrd"] {
        let error = run_replay(&context, &args(upgrade, &[]), &environment).0.unwrap_err();
        assert!(
            error.exit() == Exit::Usage && error.to_string().contains(&format!("{upgrade:?}")),
            "{error}"
        );
    }
    environment.has_screen = false;
    let error = run_replay(&context, &args("grasp@1.1.0", &[]), &environment).0.unwrap_err();
    assert!(error.to_string().contains("DISPLAY"), "{error}");
    let hint = error.hint().unwrap().raw();
    assert!(hint.contains("--terminal") && !hint.contains(viewer::INSTALL), "{hint}");
    environment.path = None;
    let error = run_replay(&context, &args("grasp@1.1.0", &[]), &environment).0.unwrap_err();
    let hint = error.hint().unwrap().raw();
    assert!(hint.contains("--terminal") && hint.contains(viewer::INSTALL), "{hint}");
}

#[test]
fn a_viewer_that_ends_at_once_fails() {
    let (root, context) = store();
    let environment = viewer_in(root.path());
    let text = "#!/bin/sh\n[ \"$1\" = --version ] && echo 'rerun-cli 0.36.3' && exit 0\nexit 1\n";
    std::fs::write(root.path().join("rerun"), text).unwrap();
    let error = run_replay(&context, &args("grasp@1.1.0", &[]), &environment).0.unwrap_err();
    assert_eq!(error.details().unwrap().reason, ErrorReason::Environment, "{error}");
    assert!(Layout::new(root.path()).logs().join(viewer::LOG_NAME).is_file(), "it was started");
}

#[test]
fn a_tick_ends_with_its_last_millisecond() {
    for tick in [0, 1, 2, 239, 240, 28_800, 1_000_003] {
        let end = end_of_tick_ms(tick);
        let tick_of = holdpoint_protocol::clock::tick_of;
        assert!(tick_of(end) <= tick && tick_of(end + 1) > tick, "{tick} ends at {end} ms");
    }
}
