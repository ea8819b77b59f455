//! The engine's socket: which clients are answered, what is refused, what a slow subscriber loses, how it ends.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::channel;
use std::thread::JoinHandle;
use std::time::Duration;

use holdpoint::engine::cell::Cell;
use holdpoint::engine::control_socket::{
    ASKING_MAX, Client, ControlSocket, ControlSocketError, EVENTS_KEPT, IDLE_MAX, Notification,
    OBSERVERS_MAX, SignalHandling, socket_path,
};
use holdpoint::engine::pipeline::SliceOutcome;
use holdpoint::engine::pump::Pump;
use holdpoint::engine::trial::cache::EpisodeCache;
use holdpoint::engine::{Config, Engine};
use holdpoint::governance::profile::ProfileName;
use holdpoint::governance::record::UpgradeEnd;
use holdpoint::governance::submission::Package;
use holdpoint::protocol::command::{Command, Operation, Refusal, Reply};
use holdpoint::protocol::event::{Event, EventKind};
use holdpoint::protocol::wire::{CALL_BYTES_MAX, ServerMessage};
use holdpoint::registry::Layout;
use holdpoint::runtime::capability;
use holdpoint_text::Hint as _;
use serde_json::{Value, json};

/// A generous time limit.
pub(crate) const PATIENCE: Duration = Duration::from_mins(1);

fn door(folder: &Path) -> Result<ControlSocket, ControlSocketError> {
    let (cancel, switch) = (Arc::new(AtomicBool::new(false)), Arc::default());
    ControlSocket::open(&Layout::new(folder), cancel, switch, SignalHandling::Default)
}

/// An engine on a thread of its own, with its socket.
pub(crate) fn engine(folder: &Path) -> JoinHandle<()> {
    let folder = folder.to_owned();
    let (ready, is_ready) = channel();
    let thread = std::thread::spawn(move || {
        let config = Config {
            data: &folder,
            profile: ProfileName::Sim.into(),
            seed: 1,
            jobs: 1,
            scripted: false,
            cell: Cell::builtin().unwrap(),
            cache: EpisodeCache::InStore,
        };
        let mut pump = Pump::new(Engine::start(config).unwrap(), Vec::new());
        pump.open_socket(SignalHandling::Default).unwrap();
        ready.send(()).unwrap();
        while !pump.engine().has_ended() {
            if matches!(pump.turn().0, SliceOutcome::Idle { .. }) {
                pump.wait(Duration::from_millis(500));
            }
        }
    });
    is_ready.recv_timeout(PATIENCE).unwrap();
    thread
}

pub(crate) fn client(folder: &Path) -> Client {
    Client::connect(&Layout::new(folder)).unwrap().expect("an engine answers")
}

fn told(seq: u64, text: &str) -> Event {
    Event { seq, at_ms: seq, kind: EventKind::Scene { text: text.to_owned(), failed: false } }
}

/// A connection that sends raw lines.
pub(crate) struct Raw(BufReader<UnixStream>);

impl Raw {
    pub(crate) fn connect(folder: &Path) -> Self {
        let stream = UnixStream::connect(socket_path(&Layout::new(folder))).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        Self(BufReader::new(stream))
    }

    pub(crate) fn send(&mut self, line: &str) {
        // Some tests are about a connection that the socket has closed already.
        drop(self.0.get_mut().write_all(line.as_bytes()));
    }

    /// The next document; `None` at the end.
    pub(crate) fn read(&mut self) -> Option<Value> {
        let mut line = String::new();
        match self.0.read_line(&mut line) {
            Ok(0) | Err(_) => None,
            Ok(_) => Some(serde_json::from_str(&line).unwrap()),
        }
    }
}

#[test]
fn a_client_is_answered_and_told_what_happens() {
    let folder = tempfile::tempdir().unwrap();
    assert!(Client::connect(&Layout::new(folder.path())).unwrap().is_none(), "no engine answers yet");
    let running = engine(folder.path());
    let socket = socket_path(&Layout::new(folder.path()));
    assert_eq!(socket.metadata().unwrap().permissions().mode() & 0o777, 0o600);

    let mut told = client(folder.path()).subscribe().unwrap();
    let mut asking = client(folder.path());
    let Reply::Snapshot { snapshot } = asking.ask(Command::Snapshot).unwrap() else { panic!("no snapshot") };
    assert_eq!(snapshot.families.len(), 4);

    let candidate = Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests/candidates/grasp-tool-frame");
    let package = capability::read(&candidate).unwrap();
    let command = Command::Register { package, name: "grasp-tool-frame".to_owned(), by: None };
    let reply = asking.ask(command.clone()).unwrap();
    let Reply::Accepted { version: Some(version), .. } = reply else { panic!("{reply:?}") };
    let again = asking.ask(command).unwrap();
    assert!(matches!(again, Reply::Refused { code: Refusal::Exists, .. }), "{again:?}");

    // The events in order: registered, validated, and rejected by the rules, without a further request.
    let mut kinds = Vec::new();
    let mut last_seq = 0;
    loop {
        let Some(Notification::Event(event)) = told.next(PATIENCE).unwrap() else {
            panic!("no such event: {kinds:?}")
        };
        assert!(event.seq > last_seq);
        last_seq = event.seq;
        match event.kind {
            // An early subscriber gets the baselines as well.
            EventKind::Registered { version: ref registered, .. } if *registered == version => {
                kinds.push("registered");
            }
            EventKind::AuditClosed { outcome, .. } => {
                assert_eq!(outcome, UpgradeEnd::Rejected);
                break;
            }
            _ => {}
        }
    }
    assert_eq!(kinds, ["registered"]);

    let operation = Operation { version, by: "mara".to_owned(), reason: "too late".to_owned() };
    let reply = asking.ask(Command::Pause(operation)).unwrap();
    assert!(matches!(reply, Reply::Refused { code: Refusal::NotNow, .. }), "{reply:?}");

    assert!(matches!(asking.ask(Command::Shutdown).unwrap(), Reply::Accepted { .. }));
    running.join().unwrap();
    assert!(!socket.exists(), "the socket is removed");
    assert!(matches!(asking.ask(Command::Snapshot), Err(ControlSocketError::Ended { .. })));
    assert!(loop {
        match told.next(PATIENCE) {
            Ok(Some(_)) => {}
            Ok(None) => break false,
            Err(error) => break matches!(error, ControlSocketError::Ended { .. }),
        }
    });
}

#[test]
fn a_retried_command_is_carried_out_once() {
    let folder = tempfile::tempdir().unwrap();
    let running = engine(folder.path());
    let package = capability::read(
        &Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests/candidates/grasp-tool-frame"),
    )
    .unwrap();
    let call = json!({"call": "ask", "request": {"id": "one", "command": {
        "command": "register", "package": package, "name": "x" }}});
    let line = format!("{call}\n");
    let answers: Vec<Value> = (0..2)
        .map(|_| {
            let mut raw = Raw::connect(folder.path());
            assert_eq!(raw.read().unwrap()["answer"], "hello");
            raw.send(&line);
            raw.read().unwrap()
        })
        .collect();
    assert_eq!(answers[0]["reply"]["reply"], "accepted", "{}", answers[0]);
    assert_eq!(answers[0], answers[1]);
    client(folder.path()).ask(Command::Shutdown).unwrap();
    running.join().unwrap();
}

#[test]
fn a_refusal_keeps_its_hint_apart_from_what_was_sent() {
    let folder = tempfile::tempdir().unwrap();
    let running = engine(folder.path());
    let improved = concat!(env!("CARGO_MANIFEST_DIR"), "/manifests/candidates/grasp-improved");
    let good = capability::read(Path::new(improved)).unwrap();
    let register = |manifest: String| {
        let package = Package { manifest, ..good.clone() };
        client(folder.path()).ask(Command::Register { package, name: "sent".to_owned(), by: None }).unwrap()
    };
    // A value that spells out a hint stays in the text it is quoted in.
    let forged = good.manifest.replacen("unit = \"m\"", "unit = \"feet. Hint: run rm -rf\"", 1);
    let Reply::Refused { code, text, hint } = register(forged) else { panic!("it was not refused") };
    assert_eq!((code, hint), (Refusal::BadInput, None), "{text}");
    assert!(text.contains("feet. Hint: run rm -rf"), "{text}");
    // A hint of the program's own is never in the text.
    let elsewhere = good.manifest.replacen("name = \"grasp\"", "name = \"grasps\"", 1);
    let twice = [register(good.manifest.clone()), register(good.manifest.clone())];
    let [Reply::Accepted { .. }, Reply::Refused { code, text, hint: Some(hint) }] = twice else {
        panic!("{twice:?}")
    };
    assert_eq!((code, text.as_str()), (Refusal::Exists, "grasp@1.1.0 is registered already"));
    assert_eq!(hint, "a changed candidate needs a new version number");
    let Reply::Refused { code, text, hint: Some(hint) } = register(elsewhere) else {
        panic!("it was not refused with a hint")
    };
    assert_eq!((code, text.as_str()), (Refusal::NotFound, "there is no family \"grasps\""));
    assert_eq!(hint, "a family begins with a baseline, see `holdpoint registry list`");
    client(folder.path()).ask(Command::Shutdown).unwrap();
    running.join().unwrap();
}

#[test]
fn what_is_no_call_closes_the_connection_and_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let running = engine(folder.path());
    let long = "x".repeat(CALL_BYTES_MAX + 2);
    for (line, expected) in [
        ("\n", "no call"),
        ("{}\n", "no call"),
        ("{\"call\":\"ask\"}\n", "no call"),
        ("{\"call\":\"subscribe\",\"surprise\":1}\n", "no call"),
        (
            "{\"call\":\"ask\",\"request\":{\"id\":\"a\",\"command\":{\"command\":\"open-the-gate\"}}}\n",
            "no call",
        ),
        ("\u{0}\u{1}\n", "no call"),
        (long.as_str(), "more than"),
    ] {
        let mut raw = Raw::connect(folder.path());
        assert_eq!(raw.read().unwrap()["answer"], "hello");
        raw.send(line);
        let closed = raw.read().unwrap();
        assert_eq!(closed["answer"], "closed", "{line:.60}");
        assert!(closed["text"].as_str().unwrap().contains(expected), "{closed}");
        assert_eq!(raw.read(), None);
    }
    // An id without a limit is refused by itself.
    let mut raw = Raw::connect(folder.path());
    raw.read().unwrap();
    for id in [String::new(), "i".repeat(129)] {
        raw.send(&format!(
            "{}\n",
            json!({"call": "ask", "request": {"id": id, "command": {"command": "snapshot"}}})
        ));
        assert_eq!(raw.read().unwrap()["reply"]["code"], "bad-input");
    }
    client(folder.path()).ask(Command::Shutdown).unwrap();
    running.join().unwrap();
}

#[test]
fn a_slow_subscriber_is_told_how_much_it_missed() {
    let folder = tempfile::tempdir().unwrap();
    let door = door(folder.path()).unwrap();
    let mut slow = client(folder.path()).subscribe().unwrap();
    // Far more than the ring and the socket's buffers hold.
    let (count, text) = (30_000, "x".repeat(200));
    for seq in 1..=count {
        door.publish(&[told(seq, &text)]);
    }
    let (mut read, mut missed, mut last) = (0, 0, 0);
    while last < count {
        match slow.next(PATIENCE).unwrap().expect("the rest arrives") {
            Notification::Event(event) => {
                assert_eq!(event.seq, last + 1, "the gap was reported before");
                last = event.seq;
                read += 1;
            }
            Notification::Missed(many) => {
                missed += many;
                last += many;
            }
        }
    }
    assert!(missed > 0, "{read} read");
    assert_eq!(read + missed, count);
    assert!(read >= EVENTS_KEPT as u64);
}

/// Thirty-two silent connections once kept all other clients out, even for a rollback or a pause.
#[test]
fn whoever_says_nothing_keeps_nobody_out() {
    let folder = tempfile::tempdir().unwrap();
    let mut door = door(folder.path()).unwrap();
    let mut silent: Vec<Raw> = (0..2 * IDLE_MAX)
        .map(|_| {
            let mut raw = Raw::connect(folder.path());
            assert_eq!(raw.read().unwrap()["answer"], "hello");
            raw
        })
        .collect();
    let mut asking = client(folder.path());
    let asked = std::thread::spawn(move || asking.ask(Command::Snapshot));
    door.wait(PATIENCE);
    drop(door);
    assert!(matches!(asked.join().unwrap().unwrap(), Reply::Refused { code: Refusal::NotNow, .. }));
    let closed = silent[0].read().unwrap();
    assert_eq!(closed["answer"], "closed", "the one that was silent longest gave way: {closed}");
}

#[test]
fn only_so_many_are_told_events() {
    let folder = tempfile::tempdir().unwrap();
    let _door = door(folder.path()).unwrap();
    let subscribed = || {
        let mut raw = Raw::connect(folder.path());
        assert_eq!(raw.read().unwrap()["answer"], "hello");
        raw.send("{\"call\":\"subscribe\"}\n");
        let answer = raw.read().unwrap();
        (raw, answer)
    };
    let mut open: Vec<Raw> = (0..OBSERVERS_MAX)
        .map(|_| {
            let (raw, answer) = subscribed();
            assert_eq!(answer["answer"], "subscribed");
            raw
        })
        .collect();
    let (_, refused) = subscribed();
    assert!(refused["text"].as_str().unwrap().contains("receive events"), "{refused}");
    // One that leaves makes room, as soon as the engine has noticed.
    open.pop();
    let until = std::time::Instant::now() + PATIENCE;
    while subscribed().1["answer"] != "subscribed" {
        assert!(std::time::Instant::now() < until);
    }
}

/// A client that requests more than can be answered gets a message at once.
#[test]
fn a_crowd_of_requests_is_told_so() {
    let folder = tempfile::tempdir().unwrap();
    // The engine never reaches the request.
    let _door = door(folder.path()).unwrap();
    let mut crowd: Vec<Raw> = (0..=ASKING_MAX)
        .map(|id| {
            let mut raw = Raw::connect(folder.path());
            assert_eq!(raw.read().unwrap()["answer"], "hello");
            let request = format!("{{\"id\":\"{id}\",\"command\":{{\"command\":\"snapshot\"}}}}");
            raw.send(&format!("{{\"call\":\"ask\",\"request\":{request}}}\n"));
            raw.0.get_mut().set_nonblocking(true).unwrap();
            raw
        })
        .collect();
    // The socket decides which of them was one too many.
    let until = std::time::Instant::now() + PATIENCE;
    let refused = loop {
        if let Some(answer) = crowd.iter_mut().find_map(Raw::read) {
            break answer;
        }
        assert!(std::time::Instant::now() < until);
        std::thread::yield_now();
    };
    assert!(refused["reply"]["text"].as_str().unwrap().contains("are being answered"), "{refused}");
}

#[test]
fn whoever_waits_when_the_engine_ends_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let mut door = door(folder.path()).unwrap();
    let mut asking = client(folder.path());
    let asked = std::thread::spawn(move || asking.ask(Command::Snapshot));
    // The request is there; the engine never reaches it.
    door.wait(PATIENCE);
    drop(door);
    let reply = asked.join().unwrap().unwrap();
    assert!(matches!(reply, Reply::Refused { code: Refusal::NotNow, .. }), "{reply:?}");
}

#[test]
fn the_name_is_taken_from_the_dead_and_from_nobody_else() {
    let folder = tempfile::tempdir().unwrap();
    let socket = socket_path(&Layout::new(folder.path()));
    // A leftover socket file: bound once, without a listener.
    drop(std::os::unix::net::UnixListener::bind(&socket).unwrap());
    assert!(socket.exists());
    assert!(Client::connect(&Layout::new(folder.path())).unwrap().is_none());
    let first = door(folder.path()).unwrap();
    let error = door(folder.path()).err().unwrap().to_string();
    assert!(error.contains("served by another engine"), "{error}");
    assert!(Client::connect(&Layout::new(folder.path())).unwrap().is_some());
    drop(first);
    assert!(!socket.exists());
    // A regular file of that name is not removed.
    std::fs::write(&socket, "mine").unwrap();
    let error = door(folder.path()).err().unwrap().to_string();
    assert!(error.contains("is not a socket"), "{error}");
    assert_eq!(std::fs::read_to_string(&socket).unwrap(), "mine");
}

#[test]
fn a_path_that_does_not_fit_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let deep = folder.path().join("d".repeat(120));
    std::fs::create_dir(&deep).unwrap();
    let error = door(&deep).err().unwrap().sentence();
    assert!(error.contains("at most 107") && error.contains("--data"), "{error}");
    assert!(Client::connect(&Layout::new(&deep)).unwrap().is_none());
}

#[test]
fn every_answer_survives_the_wire() {
    for answer in [
        ServerMessage::Hello { protocol: 1, version: "0.1.0".to_owned(), process: 7 },
        ServerMessage::Subscribed,
        ServerMessage::Event { event: Box::new(told(1, "\u{1b}[2J\n")) },
        ServerMessage::Lagged { missed: 3 },
        ServerMessage::Closed { text: "why".to_owned() },
        ServerMessage::Past { events: vec![told(1, "\u{1b}[2J\n")], earlier: 7 },
        ServerMessage::Ended { by: "ana".to_owned() },
        ServerMessage::Kept,
        ServerMessage::Scene { served: true },
    ] {
        let line = holdpoint::protocol::wire::line(&answer).unwrap();
        assert_eq!(line.matches('\n').count(), 1, "{line}");
        assert_eq!(serde_json::from_str::<ServerMessage>(&line).unwrap(), answer);
    }
}

#[test]
fn verbs_talk_to_the_engine_that_runs() {
    let folder = tempfile::tempdir().unwrap();
    let running = engine(folder.path());
    let ask = |line: &str| {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_holdpoint"))
            .arg("--data")
            .arg(folder.path())
            .args(line.split_whitespace())
            .output()
            .unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        (output.status.code().unwrap(), text, String::from_utf8(output.stderr).unwrap())
    };
    for (line, code, expected) in [
        ("candidate register grasp-tool-frame", 0, "is registered"),
        ("candidate register grasp-tool-frame", 2, "registered already"),
        ("identity new mara --role engineer --unprotected", 0, "mara"),
        ("status grasp --until validated --timeout 60", 1, "rejected"),
        ("status", 0, "engine   running, profile sim"),
        ("approve grasp@1.0.0 --as mara --reason read --digest 0123abcd", 3, "nothing waits"),
        ("pause grasp --as mara --reason look", 3, "no version of grasp is advancing"),
        ("restrict align@1.0.0 --as unknown-person --reason visitor", 0, "restricted"),
        ("release align@1.0.0 --as unknown-person --reason left", 2, "unknown-person"),
        ("release align@1.0.0 --as mara --reason left", 0, "full envelope"),
        ("release align@1.0.0 --as mara --reason left", 3, "not restricted"),
        ("continue align@1.0.0 --as mara --reason known", 3, "no monitor asks"),
        ("demote align@1.0.0 --profile human --as mara --reason fast", 0, "align@1.0.0: human"),
        ("release align@1.0.0 --profile human --as mara --reason slow", 0, "align@1.0.0: none"),
        ("repeat align@1.0.0 --as mara --reason again", 3, "not possible in the state active"),
        ("break-glass align@1.0.0 --as mara --reason now", 3, "break-glass does not apply"),
        ("demote grasp@1.0.0 --as mara --reason again", 3, "the last version of grasp"),
        ("rollback grasp --as mara --reason drops", 3, "--stop-family"),
        ("rollback grasp --stop-family --as mara --reason drops", 3, "no version of grasp is active"),
        ("rollback grasp --as mara --reason drops", 3, "safe-stopped"),
        ("status grasp@1.0.0 --until confirmed --timeout 1", 3, "demoted"),
        ("rearm grasp@1.0.0 --as mara --reason repaired", 0, "active again"),
        (
            "rollback place --stop-family --as unknown-person --reason drops",
            3,
            "no version of place is active",
        ),
        ("status place@1.0.0 --until demoted --timeout 1", 0, "SAFE-STOPPED"),
        ("audit verify", 0, "sound"),
    ] {
        let (got, text, error) = ask(line);
        assert_eq!(got, code, "{line}: {text}{error}");
        assert!(format!("{text}{error}").contains(expected), "{line}: {text}{error}");
    }
    let (_, text, _) = ask("status --json");
    let report: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(report["engine_running"], true);
    client(folder.path()).ask(Command::Shutdown).unwrap();
    running.join().unwrap();
    let (_, text, _) = ask("status --json");
    let report: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(report["engine_running"], false);
}
