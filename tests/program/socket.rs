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

use holdpoint::engine::decide::pipeline::SliceOutcome;
use holdpoint::engine::{Config, Engine};
use holdpoint::governance::profile::ProfileName;
use holdpoint::governance::record::UpgradeEnd;
use holdpoint::governance::submission::Package;
use holdpoint::protocol::command::{Command, Operation, Refusal, Reply};
use holdpoint::protocol::event::{Event, EventKind};
use holdpoint::protocol::wire::{CALL_BYTES_MAX, ServerMessage};
use holdpoint::runtime::capability;
use holdpoint::service::control_socket::{
    ASKING_MAX, Client, ControlSocket, ControlSocketError, EVENTS_KEPT, IDLE_MAX, Notification,
    OBSERVERS_MAX, SignalHandling, socket_path,
};
use holdpoint::service::pump::Pump;
use holdpoint::store::Layout;
use holdpoint::trials::cache::EpisodeCache;
use holdpoint::trials::cell::Cell;
use holdpoint::trials::seeds::EpisodeSeeds;
use holdpoint_sim::SimCells;
use holdpoint_text::Hint as _;
use serde_json::{Value, json};

use crate::quick_folder::quick_folder;
use crate::reported_error::assert_error;

/// A generous time limit.
pub(crate) const PATIENCE: Duration = Duration::from_mins(1);

fn open_socket(folder: &Path) -> Result<ControlSocket, ControlSocketError> {
    let (cancel, switch) = (Arc::new(AtomicBool::new(false)), Arc::default());
    ControlSocket::open(&Layout::new(folder), cancel, switch, SignalHandling::Default)
}

/// The settings of an engine on the built-in cell.
pub(crate) fn config(data: &Path, profile: ProfileName, scripted: bool) -> Config<'_> {
    Config {
        data,
        profile: profile.into(),
        seeds: EpisodeSeeds::OfRun(1),
        jobs: 1,
        scripted,
        cell: Cell::of(&SimCells, None).unwrap(),
        cache: EpisodeCache::InStore,
    }
}

/// An engine on a thread of its own, with its socket, and what `prepare` returns before the engine is waited for.
pub(crate) fn prepared_engine<T: Send + 'static>(
    folder: &Path,
    profile: ProfileName,
    prepare: impl FnOnce(&mut Pump) -> T + Send + 'static,
) -> (JoinHandle<()>, T) {
    let folder = folder.to_owned();
    let (ready, is_ready) = channel();
    let thread = std::thread::spawn(move || {
        let mut pump = Pump::new(Engine::start(config(&folder, profile, false)).unwrap(), Vec::new());
        pump.open_socket(SignalHandling::Default).unwrap();
        ready.send(prepare(&mut pump)).unwrap();
        while !pump.engine().has_ended() {
            if matches!(pump.turn().0, SliceOutcome::Idle { .. }) {
                pump.wait(Duration::from_millis(5));
            }
        }
    });
    (thread, is_ready.recv_timeout(PATIENCE).unwrap())
}

/// An engine under `sim`.
pub(crate) fn engine(folder: &Path) -> JoinHandle<()> {
    prepared_engine(folder, ProfileName::Sim, |_| ()).0
}

pub(crate) fn client(folder: &Path) -> Client {
    Client::connect(&Layout::new(folder)).unwrap().expect("an engine answers")
}

fn scene_event(seq: u64, text: &str) -> Event {
    Event { seq, at_ms: seq, kind: EventKind::Scene { text: text.to_owned(), failed: false } }
}

/// A connection that sends raw lines.
pub(crate) struct RawConnection(BufReader<UnixStream>);

impl RawConnection {
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
fn a_client_is_answered_and_receives_events() {
    let folder = quick_folder();
    assert!(Client::connect(&Layout::new(folder.path())).unwrap().is_none(), "no engine answers yet");
    let running = engine(folder.path());
    let socket = socket_path(&Layout::new(folder.path()));
    assert_eq!(socket.metadata().unwrap().permissions().mode() & 0o777, 0o600);

    let mut subscription = client(folder.path()).subscribe().unwrap();
    let mut connection = client(folder.path());
    let Reply::Snapshot { snapshot } = connection.send(Command::Snapshot).unwrap() else {
        panic!("no snapshot")
    };
    assert_eq!(snapshot.families.len(), 4);

    let candidate = Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests/candidates/grasp-tool-frame");
    let package = capability::read(&candidate).unwrap();
    let command = Command::Register { package, name: "grasp-tool-frame".to_owned(), by: None };
    let reply = connection.send(command.clone()).unwrap();
    let Reply::Accepted { version: Some(version), .. } = reply else { panic!("{reply:?}") };
    let again = connection.send(command).unwrap();
    assert!(matches!(again, Reply::Refused { code: Refusal::Exists, .. }), "{again:?}");

    // The events in order: registered, validated, and rejected by the rules, without a further request.
    let mut kinds = Vec::new();
    let mut last_seq = 0;
    loop {
        let Some(Notification::Event(event)) = subscription.next(PATIENCE).unwrap() else {
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
    let reply = connection.send(Command::Pause(operation)).unwrap();
    assert!(matches!(reply, Reply::Refused { code: Refusal::NotNow, .. }), "{reply:?}");

    assert!(matches!(connection.send(Command::Shutdown).unwrap(), Reply::Accepted { .. }));
    running.join().unwrap();
    assert!(!socket.exists(), "the socket is removed");
    assert!(matches!(connection.send(Command::Snapshot), Err(ControlSocketError::Ended { .. })));
    assert!(loop {
        match subscription.next(PATIENCE) {
            Ok(Some(_)) => {}
            Ok(None) => break false,
            Err(error) => break matches!(error, ControlSocketError::Ended { .. }),
        }
    });
}

#[test]
fn a_retried_command_is_carried_out_once() {
    let folder = quick_folder();
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
            let mut raw = RawConnection::connect(folder.path());
            assert_eq!(raw.read().unwrap()["answer"], "hello");
            raw.send(&line);
            raw.read().unwrap()
        })
        .collect();
    assert_eq!(answers[0]["reply"]["reply"], "accepted", "{}", answers[0]);
    assert_eq!(answers[0], answers[1]);
    client(folder.path()).send(Command::Shutdown).unwrap();
    running.join().unwrap();
}

#[test]
fn hint_of_a_refusal_is_separate_from_sent_text() {
    let folder = quick_folder();
    let running = engine(folder.path());
    let improved = concat!(env!("CARGO_MANIFEST_DIR"), "/manifests/candidates/grasp-improved");
    let good = capability::read(Path::new(improved)).unwrap();
    let register = |manifest: String| {
        let package = Package { manifest, ..good.clone() };
        client(folder.path()).send(Command::Register { package, name: "sent".to_owned(), by: None }).unwrap()
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
    assert!(
        code == Refusal::Exists && text.contains("grasp@1.1.0") && !text.contains(hint.as_str()),
        "{text}"
    );
    let Reply::Refused { code, text, hint: Some(hint) } = register(elsewhere) else {
        panic!("it was not refused with a hint")
    };
    assert!(code == Refusal::NotFound && text.contains("\"grasps\"") && !text.contains(&hint), "{text}");
    assert!(hint.contains("`holdpoint version list"), "{hint}");
    client(folder.path()).send(Command::Shutdown).unwrap();
    running.join().unwrap();
}

#[test]
fn an_invalid_call_closes_only_its_own_connection() {
    let folder = quick_folder();
    let running = engine(folder.path());
    let long = "x".repeat(CALL_BYTES_MAX + 2);
    for (line, expected) in [
        ("\n", "no call"),
        ("{}\n", "no call"),
        ("{\"call\":\"subscribe\",\"surprise\":1}\n", "no call"),
        ("\u{0}\u{1}\n", "no call"),
        (long.as_str(), "more than"),
    ] {
        let mut raw = RawConnection::connect(folder.path());
        assert_eq!(raw.read().unwrap()["answer"], "hello");
        raw.send(line);
        let answer = raw.read().unwrap();
        assert_eq!(answer["answer"], "closed", "{line:.60}");
        assert!(answer["text"].as_str().unwrap().contains(expected), "{answer}");
        assert_eq!(raw.read(), None);
    }
    // A request with what is not allowed is answered, and the connection stays.
    let mut raw = RawConnection::connect(folder.path());
    raw.read().unwrap();
    for (request, parts) in [
        (
            json!({"id": "a", "command": {"command": "open-the-gate"}}),
            ["\"request.command.command\"", "\"open-the-gate\"", "snapshot"],
        ),
        (
            json!({"id": "a", "command": {"command": "drift", "kind": "tide", "magnitude": ""}}),
            ["\"request.command.kind\"", "\"tide\"", "sensor_noise"],
        ),
        (
            json!({"id": "a", "command": {"command": "snapshot", "surprise": 1}}),
            ["\"request.command.surprise\"", "is unknown", "command"],
        ),
        (json!({"command": {"command": "snapshot"}}), ["\"request.id\"", "is missing", "field"]),
    ] {
        raw.send(&format!("{}\n", json!({"call": "ask", "request": request})));
        let reply = raw.read().unwrap()["reply"].clone();
        assert_eq!((&reply["reply"], &reply["code"]), (&json!("refused"), &json!("bad-input")), "{reply}");
        let text = reply["text"].as_str().unwrap();
        assert!(parts.iter().all(|part| text.contains(part)), "{text}");
        assert!(reply["hint"].as_str().unwrap().contains("holdpoint schema command"), "{reply}");
    }
    // An id without a limit is refused by itself.
    for id in [String::new(), "i".repeat(129)] {
        raw.send(&format!(
            "{}\n",
            json!({"call": "ask", "request": {"id": id, "command": {"command": "snapshot"}}})
        ));
        assert_eq!(raw.read().unwrap()["reply"]["code"], "bad-input");
    }
    client(folder.path()).send(Command::Shutdown).unwrap();
    running.join().unwrap();
}

/// Regression: a request that waited for the arm to stop was answered `not-now`, because the engine ended before its answer.
#[test]
fn a_shutdown_during_a_sequence_is_accepted() {
    let folder = quick_folder();
    let (running, ()) = prepared_engine(folder.path(), ProfileName::Sim, |pump| {
        pump.pace_live_world(Some(1.0), Arc::new(|_| ()));
        // The first slice begins a sequence, which takes seconds at this pace.
        pump.turn();
    });
    let reply = client(folder.path()).send(Command::Shutdown).unwrap();
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    running.join().unwrap();
}

#[test]
fn a_slow_subscriber_gets_the_count_it_missed() {
    let folder = quick_folder();
    let socket = open_socket(folder.path()).unwrap();
    let mut slow = client(folder.path()).subscribe().unwrap();
    // Far more than the ring and the socket's buffers hold.
    let (count, text) = (30_000, "x".repeat(200));
    for seq in 1..=count {
        socket.publish(&[scene_event(seq, &text)]);
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
fn silent_connections_keep_no_client_out() {
    let folder = quick_folder();
    let mut socket = open_socket(folder.path()).unwrap();
    let mut silent: Vec<RawConnection> = (0..2 * IDLE_MAX)
        .map(|_| {
            let mut raw = RawConnection::connect(folder.path());
            assert_eq!(raw.read().unwrap()["answer"], "hello");
            raw
        })
        .collect();
    let mut connection = client(folder.path());
    let request = std::thread::spawn(move || connection.send(Command::Snapshot));
    socket.wait(PATIENCE);
    drop(socket);
    assert!(matches!(request.join().unwrap().unwrap(), Reply::Refused { code: Refusal::NotNow, .. }));
    let answer = silent[0].read().unwrap();
    assert_eq!(answer["answer"], "closed", "the one that was silent longest gave way: {answer}");
}

#[test]
fn subscribers_are_limited() {
    let folder = quick_folder();
    let _socket = open_socket(folder.path()).unwrap();
    let subscribe = || {
        let mut raw = RawConnection::connect(folder.path());
        assert_eq!(raw.read().unwrap()["answer"], "hello");
        raw.send("{\"call\":\"subscribe\"}\n");
        let answer = raw.read().unwrap();
        (raw, answer)
    };
    let mut open: Vec<RawConnection> = (0..OBSERVERS_MAX)
        .map(|_| {
            let (raw, answer) = subscribe();
            assert_eq!(answer["answer"], "subscribed");
            raw
        })
        .collect();
    let (_, refusal) = subscribe();
    assert_eq!(refusal["answer"], "closed", "{refusal}");
    // One that leaves makes room, as soon as the engine has noticed.
    open.pop();
    let until = std::time::Instant::now() + PATIENCE;
    while subscribe().1["answer"] != "subscribed" {
        assert!(std::time::Instant::now() < until);
    }
}

/// A client that requests more than can be answered gets a message at once.
#[test]
fn excess_requests_get_a_refusal() {
    let folder = quick_folder();
    // The engine never reaches the request.
    let _socket = open_socket(folder.path()).unwrap();
    let mut crowd: Vec<RawConnection> = (0..=ASKING_MAX)
        .map(|id| {
            let mut raw = RawConnection::connect(folder.path());
            assert_eq!(raw.read().unwrap()["answer"], "hello");
            let request = format!("{{\"id\":\"{id}\",\"command\":{{\"command\":\"snapshot\"}}}}");
            raw.send(&format!("{{\"call\":\"ask\",\"request\":{request}}}\n"));
            raw.0.get_mut().set_nonblocking(true).unwrap();
            raw
        })
        .collect();
    // The socket decides which of them was one too many.
    let until = std::time::Instant::now() + PATIENCE;
    let refusal = loop {
        if let Some(answer) = crowd.iter_mut().find_map(RawConnection::read) {
            break answer;
        }
        assert!(std::time::Instant::now() < until);
        std::thread::park_timeout(Duration::from_millis(5));
    };
    let text = refusal["reply"]["text"].as_str().unwrap();
    assert!(refusal["reply"]["code"] == "not-now" && text.contains(&ASKING_MAX.to_string()), "{refusal}");
}

#[test]
fn a_waiting_request_is_refused_at_the_end() {
    let folder = quick_folder();
    let mut socket = open_socket(folder.path()).unwrap();
    let mut connection = client(folder.path());
    let request = std::thread::spawn(move || connection.send(Command::Snapshot));
    // The request is there; the engine never reaches it.
    socket.wait(PATIENCE);
    drop(socket);
    let reply = request.join().unwrap().unwrap();
    assert!(matches!(reply, Reply::Refused { code: Refusal::NotNow, .. }), "{reply:?}");
}

#[test]
fn only_a_dead_engines_socket_is_replaced() {
    let folder = quick_folder();
    let socket = socket_path(&Layout::new(folder.path()));
    // A leftover socket file: bound once, without a listener.
    drop(std::os::unix::net::UnixListener::bind(&socket).unwrap());
    assert!(socket.exists());
    assert!(Client::connect(&Layout::new(folder.path())).unwrap().is_none());
    let first = open_socket(folder.path()).unwrap();
    let problem = || match open_socket(folder.path()).err() {
        Some(ControlSocketError::Taken { problem, .. }) => problem,
        other => panic!("{other:?}"),
    };
    assert!(problem().contains("another engine"), "{}", problem());
    assert!(Client::connect(&Layout::new(folder.path())).unwrap().is_some());
    drop(first);
    assert!(!socket.exists());
    // A regular file of that name is not removed.
    std::fs::write(&socket, "mine").unwrap();
    assert!(problem().contains("a socket"), "{}", problem());
    assert_eq!(std::fs::read_to_string(&socket).unwrap(), "mine");
}

#[test]
fn a_too_long_path_is_an_error() {
    let folder = quick_folder();
    let deep = folder.path().join("d".repeat(120));
    std::fs::create_dir(&deep).unwrap();
    let error = open_socket(&deep).err().unwrap();
    assert!(matches!(error, ControlSocketError::PathTooLong { allowed: 107, .. }), "{error}");
    assert!(error.hint().is_some_and(|hint| hint.contains("--data")), "{error}");
    assert!(Client::connect(&Layout::new(&deep)).unwrap().is_none());
}

#[test]
fn every_answer_survives_the_wire() {
    for answer in [
        ServerMessage::Hello { protocol: 1, version: "0.1.0".to_owned(), process: 7 },
        ServerMessage::Subscribed,
        ServerMessage::Event { event: Box::new(scene_event(1, "\u{1b}[2J\n")) },
        ServerMessage::Lagged { missed: 3 },
        ServerMessage::Closed { text: "why".to_owned() },
        ServerMessage::Past { events: vec![scene_event(1, "\u{1b}[2J\n")], earlier: 7 },
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
    let folder = quick_folder();
    let running = engine(folder.path());
    let run = |line: &str, json: bool| {
        let mut process = std::process::Command::new(env!("CARGO_BIN_EXE_holdpoint"));
        process.arg("--data").arg(folder.path()).args(line.split_whitespace());
        if json {
            process.arg("--json");
        }
        process.output().unwrap()
    };
    // The verb, its exit code, the reason of its error or nothing, and a word of what it prints. All refusals because of a
    // version's state have one reason, so only the word tells them apart.
    for (line, code, reason, expected) in [
        ("candidate register grasp-tool-frame", 0, "", "is registered"),
        ("candidate register grasp-tool-frame", 2, "exists", ""),
        ("identity new mara --role engineer --unprotected", 0, "", "mara"),
        ("status grasp --until validated --timeout 60", 1, "", "rejected"),
        ("status", 0, "", "profile sim"),
        ("approve grasp@1.0.0 --as mara --reason read --digest 0123abcd", 3, "not-now", "nothing waits"),
        ("pause grasp --as mara --reason look", 3, "not-now", "is advancing"),
        ("restrict align@1.0.0 --as unknown-person --reason visitor", 0, "", "restricted"),
        ("release align@1.0.0 --as unknown-person --reason left", 2, "not-found", ""),
        ("release align@1.0.0 --as mara --reason left", 0, "", "full envelope"),
        ("release align@1.0.0 --as mara --reason left", 3, "not-now", "not restricted"),
        ("continue align@1.0.0 --as mara --reason known", 3, "not-now", "monitor asks"),
        ("demote align@1.0.0 --profile human --as mara --reason fast", 0, "", "align@1.0.0: human"),
        ("release align@1.0.0 --profile human --as mara --reason slow", 0, "", "align@1.0.0: none"),
        ("repeat align@1.0.0 --as mara --reason again", 3, "not-now", "state active"),
        ("break-glass align@1.0.0 --as mara --reason now", 3, "not-now", "not apply"),
        ("demote grasp@1.0.0 --as mara --reason again", 3, "not-now", "last version"),
        ("rollback grasp --as mara --reason drops", 3, "not-now", "--stop-family"),
        ("rollback grasp --stop-family --as mara --reason drops", 3, "safe-stopped", ""),
        ("rollback grasp --as mara --reason drops", 3, "not-now", "safe-stopped"),
        ("status grasp@1.0.0 --until confirmed --timeout 1", 3, "", "demoted"),
        ("rearm grasp@1.0.0 --as mara --reason repaired", 0, "", "active again"),
        ("rollback place --stop-family --as unknown-person --reason drops", 3, "safe-stopped", ""),
        ("status place@1.0.0 --until demoted --timeout 1", 0, "", "SAFE-STOPPED"),
        ("audit verify", 0, "", "sound"),
    ] {
        let output = run(line, !reason.is_empty());
        let text = String::from_utf8([output.stdout.as_slice(), output.stderr.as_slice()].concat()).unwrap();
        if reason.is_empty() {
            assert_eq!(output.status.code(), Some(code), "{line}: {text}");
        } else {
            assert_error(&output, code, reason);
        }
        assert!(text.contains(expected), "{line}: {text}");
    }
    let is_running = || {
        let report: Value = serde_json::from_slice(&run("status", true).stdout).unwrap();
        report["engine_running"].as_bool()
    };
    assert_eq!(is_running(), Some(true));
    client(folder.path()).send(Command::Shutdown).unwrap();
    running.join().unwrap();
    assert_eq!(is_running(), Some(false));
}
