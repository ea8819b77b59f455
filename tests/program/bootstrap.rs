//! Before the engine is up: the display while it reads its history, the refusals, a stop that works, and a damaged
//! record.

use std::path::Path;
use std::process::{Command as Process, Output};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use holdpoint::engine::StartError;
use holdpoint::governance::profile::ProfileName;
use holdpoint::governance::record::RecordKind;
use holdpoint::protocol::command::{Caller, Command, Refusal, Reply, Request, StopPersistence};
use holdpoint::protocol::console_presence::ConsolePresence;
use holdpoint::protocol::snapshot::Snapshot;
use holdpoint::registry::{Store, Views};
use holdpoint::runtime::capability;
use holdpoint::service::bootstrap::{EngineBootstrap, ReadProgressFn};
use holdpoint::service::control_socket::{Client, ControlSocketError, SignalHandling, socket_path};
use holdpoint::service::engine_handle::{EngineHandle, EngineUpdate, LaunchConfig};
use holdpoint::store::{AuditBody, AuditFilter, Layout, StoreError, Transaction};
use holdpoint_sim::SimCells;
use rusqlite::Connection;
use serde_json::Value;

use crate::host::{Front, PATIENCE};
use crate::quick_folder::quick_folder;
use crate::reported_error::assert_error;
use crate::socket::config;

/// Records that are added to a store, 256 a transaction.
const TRANSACTIONS: u64 = 40;

/// A store that an engine made, with a chain of more than ten thousand records. Returns their number.
fn long_store(folder: &Path) -> u64 {
    Front::start(folder, None).host.stop(PATIENCE).unwrap();
    let store = Store::open(folder).unwrap();
    let at_ms = store.opening().head.at_ms;
    let one = AuditBody {
        kind: RecordKind::Monitor,
        subject: "grasp@1.0.0".to_owned(),
        body: format!("{{\"text\":\"{}\"}}", "x".repeat(200)),
    };
    for number in 0..TRANSACTIONS {
        let audit = vec![one.clone(); 256];
        let command_id = format!("many {number}");
        store.commit(Transaction { command_id, at_ms, wall_ms: 0, changes: Vec::new(), audit }).unwrap();
    }
    store.views().unwrap().head().unwrap().seq
}

/// Observes the reading of the history, and pauses it at its first report until released.
fn pause_reading() -> (ReadProgressFn, Receiver<u64>, SyncSender<()>) {
    let (report, progress) = sync_channel(1);
    let (release, wait) = sync_channel(1);
    let mut waits = true;
    let watch = Box::new(move |read| {
        if std::mem::take(&mut waits) {
            report.send(read).unwrap();
            wait.recv().unwrap();
        }
    });
    (watch, progress, release)
}

fn start(folder: &Path, watch: ReadProgressFn) -> EngineHandle {
    let config = LaunchConfig {
        data: folder.to_owned(),
        profile: ProfileName::Sim.into(),
        seeds: holdpoint_trials::seeds::EpisodeSeeds::OfRun(1),
        jobs: 1,
        cells: std::sync::Arc::new(SimCells),
        robot: None,
        site: None,
        pace: Some(1.0),
        sinks: Vec::new(),
        alone_max: Some(Duration::from_hours(1)),
        console_access: None,
    };
    EngineHandle::start_watched(config, watch)
}

fn next(host: &mut EngineHandle) -> EngineUpdate {
    host.updates.blocking_recv().expect("the engine tells")
}

fn read_snapshot(client: &mut Client) -> Snapshot {
    match client.send(Command::Snapshot).unwrap() {
        Reply::Snapshot { snapshot } => *snapshot,
        other => panic!("{other:?}"),
    }
}

fn stops_on_record(layout: &Layout) -> Vec<String> {
    let filter = AuditFilter { kind: Some(RecordKind::CellStopped), ..AuditFilter::default() };
    let views = Views::open(&layout.database()).unwrap();
    views.audit(&filter).unwrap().into_iter().map(|record| record.body).collect()
}

fn register() -> Command {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests/candidates/align-improved");
    Command::Register {
        package: capability::read(&path).unwrap(),
        name: "align-improved".to_owned(),
        by: None,
    }
}

fn output_of(folder: &Path, arguments: &[&str]) -> Output {
    let mut process = Process::new(env!("CARGO_BIN_EXE_holdpoint"));
    process.args(arguments).arg("--data").arg(folder).output().unwrap()
}

fn verb(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let output = output_of(folder, arguments);
    let bytes = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8(bytes).unwrap())
}

#[test]
fn while_the_record_is_read_only_views_and_stops_work() {
    let folder = quick_folder();
    let layout = Layout::new(folder.path());
    let records = long_store(folder.path());
    assert!(records > 10_000);
    let (watch, progress, release) = pause_reading();
    let mut host = start(folder.path(), watch);
    let read = progress.recv_timeout(PATIENCE).unwrap();
    assert!((1..records).contains(&read), "{read}");

    let mut client = Client::connect(&layout).unwrap().unwrap();
    let snapshot = read_snapshot(&mut client);
    let reading = snapshot.reading.unwrap();
    assert_eq!((reading.read, reading.of), (read, records));
    assert!(snapshot.families.iter().any(|family| family.active.is_some()), "{:?}", snapshot.families);
    // The attached operator is known from the start, and that the engine ends with them.
    let console = Client::connect(&layout).unwrap().unwrap().attach(ConsolePresence::default()).unwrap();
    let snapshot = read_snapshot(&mut client);
    assert_eq!((snapshot.seats.len(), snapshot.ends_alone_s), (1, Some(60 * 60)));
    drop(console);
    let (code, message) = verb(folder.path(), &["status", "--json"]);
    assert_eq!(code, Some(0), "{message}");
    let status: Value = serde_json::from_str(&message).unwrap();
    assert_eq!(status["reading"], serde_json::json!({ "read": read, "of": records }));

    // No request runs: from the socket, from a verb that decides, from the front end itself.
    let refused = |reply: &Reply| match reply {
        Reply::Refused { code: Refusal::NotNow, text, .. } => text.contains(&format!(" of {records} ")),
        _ => false,
    };
    let reply = client.send(register()).unwrap();
    assert!(refused(&reply), "{reply:?}");
    let reject = ["reject", "grasp@1.0.0", "--as", "ana", "--reason", "no", "--json"];
    assert_error(&output_of(folder.path(), &reject), 3, "not-now");
    host.submit(Request::unsigned("own".to_owned(), register())).unwrap();
    let EngineUpdate::Answer { id, reply } = next(&mut host) else { panic!("an answer arrives") };
    assert!(id == "own" && refused(&reply), "{reply:?}");

    let by = || ("ana".to_owned(), "a person is in the cell".to_owned());
    let (who, reason) = by();
    let reply = client.send(Command::Stop { by: who, reason }).unwrap();
    assert!(matches!(&reply, Reply::Stopped { kept: StopPersistence::InMark, .. }), "{reply:?}");
    assert_eq!(read_snapshot(&mut client).stopped.map(|stopped| (stopped.by, stopped.reason)), Some(by()));
    assert_eq!(
        stops_on_record(&layout),
        Vec::<String>::new(),
        "nothing is written before the end of the reading"
    );

    release.send(()).unwrap();
    while !matches!(next(&mut host), EngineUpdate::Started) {}
    let snapshot = read_snapshot(&mut client);
    assert_eq!(snapshot.reading, None);
    let stopped = snapshot.stopped.unwrap();
    let Caller::Process { process, .. } = &stopped.caller else { panic!("{:?}", stopped.caller) };
    assert_eq!((stopped.by.clone(), *process), (by().0, Some(std::process::id())));
    let on_record = stops_on_record(&layout);
    assert!(on_record.len() == 1 && on_record[0].contains(&by().1), "{on_record:?}");
    assert_eq!(snapshot.live.sequences, 0, "it started stopped");
    assert_eq!(snapshot.candidates, Vec::new(), "a refused request did not run later");
    host.stop(PATIENCE).unwrap();
}

#[test]
fn an_edited_row_ends_the_engine_before_it_starts() {
    let folder = quick_folder();
    let layout = Layout::new(folder.path());
    let records = long_store(folder.path());
    let edit = "UPDATE version SET author = 'eve' WHERE name LIKE 'grasp@%'";
    Connection::open(layout.database()).unwrap().execute_batch(edit).unwrap();
    let (watch, progress, release) = pause_reading();
    let mut host = start(folder.path(), watch);
    progress.recv_timeout(PATIENCE).unwrap();
    let mut client = Client::connect(&layout).unwrap().unwrap();
    assert!(read_snapshot(&mut client).reading.is_some());
    let mut console = Client::connect(&layout).unwrap().unwrap().attach(ConsolePresence::default()).unwrap();
    release.send(()).unwrap();
    let EngineUpdate::Ended(Err(why)) = next(&mut host) else { panic!("it started") };
    assert!(why.text.contains("\"grasp@") && why.text.contains("author"), "{why}");
    assert_eq!(host.snapshots.borrow().as_ref(), None, "the snapshot is withdrawn");
    // The operator sees the reason, and not only that the engine is gone.
    let last = loop {
        if let Err(error) = console.next(PATIENCE) {
            break error;
        }
    };
    let why = why.to_string();
    assert!(matches!(&last, ControlSocketError::Closed { text, .. } if *text == why), "{last}");
    assert!(!socket_path(&layout).exists() && Client::connect(&layout).unwrap().is_none());
    drop(host);
    assert_eq!(Views::open(&layout.database()).unwrap().head().unwrap().seq, records);
}

/// An edit that is reverted between the comparison of the tables and the first write is found by no comparison.
#[test]
fn no_engine_starts_if_another_program_wrote_meanwhile() {
    let folder = quick_folder();
    Front::start(folder.path(), None).host.stop(PATIENCE).unwrap();
    let database = Layout::new(folder.path()).database();
    let start_engine = |meanwhile: &dyn Fn()| {
        let config = config(folder.path(), ProfileName::Sim, false);
        let mut bootstrap = EngineBootstrap::open(config, SignalHandling::Default, Box::new(|_| ())).unwrap();
        while !bootstrap.turn() {}
        meanwhile();
        bootstrap.enter().map(drop)
    };
    start_engine(&|| ()).unwrap();
    let result = start_engine(&|| {
        let connection = Connection::open(&database).unwrap();
        for profile in ["human", "sim"] {
            connection.execute("UPDATE context SET profile = ?1", [profile]).unwrap();
        }
    });
    assert!(matches!(result, Err(StartError::Store(StoreError::Disturbed))), "{result:?}");
    start_engine(&|| ()).unwrap();
    let (code, message) = verb(folder.path(), &["audit", "verify"]);
    assert_eq!(code, Some(0), "{message}");
}

#[test]
fn an_engine_ends_on_request_while_it_reads() {
    let folder = quick_folder();
    long_store(folder.path());
    let (watch, progress, release) = pause_reading();
    let mut host = start(folder.path(), watch);
    progress.recv_timeout(PATIENCE).unwrap();
    let mut client = Client::connect(&Layout::new(folder.path())).unwrap().unwrap();
    assert!(matches!(client.send(Command::Shutdown).unwrap(), Reply::Accepted { .. }));
    assert!(matches!(next(&mut host), EngineUpdate::Ended(Ok(()))));
    release.send(()).unwrap();
}

#[test]
fn an_engine_that_a_signal_stopped_is_named_soon_and_the_store_is_shown() {
    let folder = quick_folder();
    let data = folder.path().join("store");
    let mut engine = Process::new(env!("CARGO_BIN_EXE_holdpoint"))
        .args(["serve", "--quiet", "--data"])
        .arg(&data)
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let until = Instant::now() + PATIENCE;
    let runs = |status: &Value| status["engine_running"] == true && status["reading"].is_null();
    while !serde_json::from_str::<Value>(&verb(&data, &["status", "--json"]).1)
        .is_ok_and(|status| runs(&status))
    {
        assert!(Instant::now() < until, "the engine does not start");
    }
    let signal = |name: &str| {
        assert!(Process::new("kill").args([name, &engine.id().to_string()]).status().unwrap().success());
    };
    signal("-STOP");
    let begun = Instant::now();
    let output = output_of(&data, &["status", "--json"]);
    let took = begun.elapsed();
    signal("-CONT");
    let error = assert_error(&output, 3, "no-answer");
    assert!(error["hint"].as_str().unwrap().contains("kill -CONT"), "{error}");
    let status: Value = serde_json::from_slice(&output.stdout).unwrap();
    let process = format!("process {}", engine.id());
    assert!(status["silent"].as_str().unwrap().contains(&process), "{status}");
    assert!(status["last_record"]["seq"].is_u64(), "{status}");
    assert!(status["families"].as_array().unwrap().iter().any(|one| one["family"] == "grasp"), "{status}");
    // It waits for less than two seconds by itself; the rest is for a busy machine.
    assert!(took < Duration::from_secs(6), "{took:?}");
    signal("-TERM");
    assert_eq!(engine.wait().unwrap().code(), Some(0));
}
