//! Recordings of whole upgrades, through the program: their content, their robustness, and that they change
//! nothing.

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use holdpoint::governance::record::UpgradeEnd;
use holdpoint::protocol::event::{Event, EventKind};
use holdpoint::recordings::recording::Recording;
use holdpoint::recordings::recording_folder;
use holdpoint::registry::Views;
use holdpoint::scene::{self, SceneConfig, SceneSink};
use holdpoint::store::Layout;

use crate::quick_folder::quick_folder;

/// A generous time limit.
const PATIENCE: Duration = Duration::from_mins(5);

const IN_SHADOW: &str = "reject-in-shadow";
const IN_SANDBOX: &str = "reject-recovery";

fn holdpoint() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    command.stdin(Stdio::null()).env_remove("HOLDPOINT_TEST_DISK");
    command
}

fn script(name: &str, data: &Path, cache: &Path) -> Command {
    let mut command = holdpoint();
    command.args(["run", "--headless", "--json", "--seed", "3", "--script"]);
    command.arg(format!("tests/scenarios/{name}.toml")).arg("--data").arg(data);
    command.arg("--cache").arg(cache.join("cells")).arg("--cache-key").arg(cache.join("cells.key"));
    command
}

fn events(output: &Output) -> Vec<Event> {
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
}

/// Without events about the recordings themselves.
fn decisions(events: &[Event]) -> Vec<Event> {
    let about_scenes =
        |event: &&Event| matches!(event.kind, EventKind::RecordingKept { .. } | EventKind::Scene { .. });
    events.iter().filter(|event| !about_scenes(event)).cloned().collect()
}

fn failures(events: &[Event]) -> Vec<String> {
    let failed = |event: &Event| match &event.kind {
        EventKind::Scene { text, failed: true } => Some(text.clone()),
        _ => None,
    };
    events.iter().filter_map(failed).collect()
}

fn only_recording(data: &Path) -> (PathBuf, Recording) {
    let files = recording_folder::list(&Layout::new(data).recordings()).unwrap();
    assert_eq!(files.len(), 1, "{files:?}");
    let path = files[0].path.clone();
    let recording = scene::read(&path).unwrap();
    (path, recording)
}

#[test]
fn recording_holds_the_events_of_the_upgrade_and_changes_no_decision() {
    let cache = quick_folder();
    let fresh = quick_folder;
    let plain = fresh();
    let without =
        events(&script(IN_SHADOW, plain.path(), cache.path()).arg("--no-recording").output().unwrap());
    assert!(without.len() > 20, "{without:?}");
    assert!(recording_folder::list(&Layout::new(plain.path()).recordings()).unwrap().is_empty());

    let data = fresh();
    let with = events(&script(IN_SHADOW, data.path(), cache.path()).output().unwrap());
    assert_eq!(decisions(&with), without, "a recording changes no decision and no time");
    assert_eq!(failures(&with), Vec::<String>::new());
    let (path, recording) = only_recording(data.path());
    let closure = with.iter().find_map(|event| match &event.kind {
        EventKind::RecordingKept { file, digest, bytes, pictures, dropped, .. } => {
            Some((file.clone(), *digest, *bytes, *pictures, *dropped))
        }
        _ => None,
    });
    let (file, digest, bytes, frame_count, dropped) = closure.expect("an event has its digest");
    assert_eq!(path.file_name().unwrap().to_str().unwrap(), file);
    assert_eq!(recording_folder::digest(&path).unwrap(), digest);
    assert_eq!(std::fs::metadata(&path).unwrap().len(), bytes);
    assert_eq!((recording.pictures.len() as u64, recording.dropped), (frame_count, (0, 0)));
    assert_eq!(dropped, [0, 0]);
    assert!(bytes < 2 << 20, "{bytes} bytes");

    assert_eq!(recording.outcome, Some(UpgradeEnd::Rejected.into()));
    assert!(recording.pictures.iter().any(|frame| frame.twin.is_some()), "the twin is in it");
    assert!(recording.pictures.windows(2).all(|pair| pair[0].at_ms <= pair[1].at_ms));
    let own_decisions = |events: &[Event]| -> Vec<Event> {
        let ours = |event: &&Event| matches!(&event.kind, EventKind::Decided { version, .. } if *version == recording.about.version);
        events.iter().filter(ours).cloned().collect()
    };
    assert!(own_decisions(&with).len() >= 3);
    assert_eq!(
        own_decisions(&recording.events),
        own_decisions(&with),
        "decisions read back as they were reported"
    );
    let names: Vec<&str> = recording.series.iter().map(|series| series.name.as_str()).collect();
    for name in ["kappa/B", "shadow/output", "tool/speed", "tool/force"] {
        assert!(names.contains(&name), "{names:?}");
    }
    let verification =
        holdpoint().args(["recordings", "verify", "--data"]).arg(data.path()).output().unwrap();
    assert!(verification.status.success(), "{verification:?}");

    // Foreign files beside it are unsigned: under no recording's name, under another version's, under its own.
    let planted =
        ["evil.rrd".to_owned(), file.replace(".rrd", ".2.rrd"), "grasp-9.9.9-deadbeef.rrd".to_owned()];
    for name in &planted {
        std::fs::copy(&path, path.with_file_name(name)).unwrap();
    }
    let again = holdpoint().args(["run", "--plain", "--data"]).arg(data.path()).output().unwrap();
    let stdout = String::from_utf8_lossy(&again.stdout).into_owned();
    let views = Views::open(&Layout::new(data.path()).database()).unwrap();
    let on_record = holdpoint::service::recordings::on_record(&views).unwrap().0;
    assert_eq!(on_record.keys().collect::<Vec<_>>(), [&file], "{stdout}");
    for name in &planted {
        std::fs::remove_file(path.with_file_name(name)).unwrap();
    }

    // A version that passed the sandbox has camera frames of the live cell only.
    assert!(recording.films.is_empty(), "{:?}", recording.films);
}

/// The events of a run with a viewer that connects and reads nothing.
fn viewed(mut run: Command) -> Vec<Event> {
    let port = free_port();
    let mut child =
        run.arg("--view").arg(format!("127.0.0.1:{port}")).stdout(Stdio::piped()).spawn().unwrap();
    let stalled = connect(port);
    let text = std::io::read_to_string(child.stdout.as_mut().unwrap()).unwrap();
    child.wait().unwrap();
    drop(stalled);
    text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
}

/// A full disk, and an address in use.
#[test]
fn a_recording_that_fails_changes_no_decision() {
    let (cache, data, full) = (quick_folder(), quick_folder(), quick_folder());
    let kept = events(&script(IN_SANDBOX, data.path(), cache.path()).output().unwrap());
    assert!(kept.len() > 20 && failures(&kept).is_empty(), "{kept:?}");
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let mut run = script(IN_SANDBOX, full.path(), cache.path());
    run.arg("--view").arg(&address).env("HOLDPOINT_TEST_DISK", "full");
    let failed = events(&run.output().unwrap());
    assert_eq!(decisions(&failed), decisions(&kept));
    let messages = failures(&failed);
    assert!(messages.iter().any(|text| text.contains("os error 28")), "{messages:?}");
    assert!(messages.iter().any(|text| text.contains(&address)), "{messages:?}");
}

/// The most common rejection can be watched from the recording's first moment. A run with a viewer that stalls has the
/// same decisions and the same bytes.
#[test]
fn a_rejection_in_the_sandbox_shows_its_reason() {
    let cache = quick_folder();
    for (name, drills) in [("reject-behavior", false), ("reject-recovery", true)] {
        let data = quick_folder();
        let run_events = events(&script(name, data.path(), cache.path()).output().unwrap());
        assert_eq!(failures(&run_events), Vec::<String>::new());
        let (path, recording) = only_recording(data.path());
        let (first_ms, _) = recording.span_ms().unwrap();
        assert_eq!(recording.films[0].from_ms, first_ms, "{name}: {:?}", recording.films);
        assert_eq!(recording.pictures[0].at_ms, first_ms, "{name}");
        let is_sequential = recording
            .films
            .windows(2)
            .all(|pair| pair[0].until_ms < pair[1].from_ms && !pair[1].title.is_empty());
        assert!(is_sequential, "{name}: {:?}", recording.films);
        for film in &recording.films {
            let within = |at_ms: u64| (film.from_ms..=film.until_ms).contains(&at_ms);
            let frames = recording.pictures.iter().filter(|frame| within(frame.at_ms));
            assert!(frames.clone().count() > 30, "{name}: {film:?}");
            assert!(frames.clone().all(|frame| frame.twin.is_some()), "{name}: {film:?}");
            assert!(!film.ended.is_empty(), "{name}: {film:?}");
            assert!(film.failures.iter().all(|failure| within(failure.at_ms)), "{name}: {film:?}");
        }
        assert!(
            recording.films.iter().any(|film| !film.failures.is_empty()),
            "{name}: {:?}",
            recording.films
        );
        assert_eq!(recording.films.iter().any(|film| film.title.contains("drill")), drills, "{name}");
        let again = quick_folder();
        let viewed_events = viewed(script(name, again.path(), cache.path()));
        assert_eq!(decisions(&viewed_events), decisions(&run_events), "{name}: a viewer changes nothing");
        let bytes = |path: &Path| std::fs::read(path).unwrap();
        assert!(bytes(&path) == bytes(&only_recording(again.path()).0), "{name}: same seed, same bytes");
    }
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Connects and then neither reads nor writes.
fn connect(port: u16) -> std::net::TcpStream {
    let until = Instant::now() + PATIENCE;
    loop {
        match std::net::TcpStream::connect(("127.0.0.1", port)) {
            Ok(stream) => return stream,
            Err(error) => assert!(Instant::now() < until, "the scene is not served: {error}"),
        }
        std::thread::park_timeout(Duration::from_millis(5));
    }
}

#[test]
fn a_recording_cut_by_a_kill_is_read_and_repaired_at_the_next_start() {
    let (data, cache) = (quick_folder(), quick_folder());
    let mut run = script(IN_SHADOW, data.path(), cache.path());
    let mut child = run.stdout(Stdio::null()).spawn().unwrap();
    let folder = Layout::new(data.path()).recordings();
    let until = Instant::now() + PATIENCE;
    let mut read_bytes = 60_000;
    let path = loop {
        let files = recording_folder::list(&folder).unwrap();
        let grown = files.iter().find(|file| {
            let is_longer = file.bytes > read_bytes;
            read_bytes = read_bytes.max(file.bytes);
            // Part of the live cell's run is in it.
            is_longer && scene::read(&file.path).is_ok_and(|read| read.pictures.len() > 100)
        });
        if let Some(file) = grown {
            break file.path.clone();
        }
        assert!(child.try_wait().unwrap().is_none(), "the run ended before it was killed: {files:?}");
        assert!(Instant::now() < until, "{files:?}");
        std::thread::park_timeout(Duration::from_millis(5));
    };
    // SIGKILL.
    child.kill().unwrap();
    child.wait().unwrap();
    let torn = scene::read(&path).unwrap();
    assert!(torn.pictures.len() > 100 && torn.outcome.is_none());

    let config = SceneConfig { recordings: Some(folder.clone()), ..SceneConfig::default() };
    let reports = SceneSink::start(config).unwrap().finish(PATIENCE);
    assert_eq!(reports, Vec::new(), "the upgrade continues: nothing of it is closed");
    assert_eq!(scene::read(&path).unwrap(), torn, "nothing of it is lost");

    // The next engine continues the upgrade beside another one: in a segment of its own, until it is closed.
    let again = script("reject-interface", data.path(), cache.path()).output().unwrap();
    assert_eq!(again.status.code(), Some(1), "{}", String::from_utf8_lossy(&again.stderr));
    let files = recording_folder::list(&folder).unwrap();
    let segments: Vec<Recording> = files.iter().map(|file| scene::read(&file.path).unwrap()).collect();
    let ours = segments.iter().filter(|segment| segment.about.version == torn.about.version);
    let frames: Vec<_> = ours.flat_map(|segment| &segment.pictures).collect();
    // Episodes that were not on record at the kill are re-run at the same virtual times: of two camera frames with
    // one time, that of the later session is read.
    assert!(frames.len() > torn.pictures.len(), "{} of {}", frames.len(), torn.pictures.len());
    let verified = holdpoint().args(["recordings", "verify", "--data"]).arg(data.path()).output().unwrap();
    assert!(verified.status.success(), "{verified:?}");
}
