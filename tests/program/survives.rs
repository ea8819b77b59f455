//! A stop survives any end of its engine, any object in the place of its mark, and a process without a free file
//! descriptor.

use std::io::{BufRead as _, BufReader, Read as _};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use holdpoint::governance::record::RecordKind;
use holdpoint::registry::{Views, verify};
use holdpoint::service::control_socket::socket_path;
use holdpoint::store::{AuditFilter, Layout};
use holdpoint_wording::stop_after_unclean_end;
use serde_json::Value;

use crate::quick_folder::quick_folder;

/// A generous time limit.
const PATIENCE: Duration = Duration::from_mins(2);

/// An engine in another process; it does not outlive the test.
struct ServeProcess {
    child: Child,
    lines: std::io::Lines<BufReader<std::process::ChildStdout>>,
}

impl ServeProcess {
    /// Started, with its first events received. `limit` is its number of file descriptors.
    fn start(store: &Path, profile: &str, limit: Option<u32>) -> Self {
        let limit = limit.map_or_else(|| "unlimited".to_owned(), |limit| limit.to_string());
        let ulimit = if limit == "unlimited" { String::new() } else { format!("ulimit -n {limit}; ") };
        let serve = format!("{ulimit}exec \"$0\" serve --pace 10 --jobs 1 --json --no-recording \"$@\"");
        let mut child = Command::new("sh")
            .args(["-c", &serve, env!("CARGO_BIN_EXE_holdpoint"), "--profile", profile, "--data"])
            .arg(store)
            .env_remove("XDG_RUNTIME_DIR")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let mut process = Self { child, lines };
        process.until("engine-started");
        process
    }

    /// The first event of this kind that is still to come.
    fn until(&mut self, kind: &str) -> Value {
        for line in self.lines.by_ref() {
            let event: Value = serde_json::from_str(&line.unwrap()).unwrap_or_default();
            if event["event"] == kind {
                return event;
            }
        }
        panic!("it ended without {kind}");
    }

    fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    fn terminate(mut self, store: &Path) {
        let pid = self.child.id();
        rustix::process::kill_process(
            rustix::process::Pid::from_raw(i32::try_from(pid).unwrap()).unwrap(),
            rustix::process::Signal::TERM,
        )
        .unwrap();
        self.child.wait().unwrap();
        verify(&Layout::new(store).database(), None).unwrap();
    }
}

impl Drop for ServeProcess {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

fn holdpoint(store: &Path, arguments: &[&str]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    program.env_remove("XDG_RUNTIME_DIR").args(arguments).arg("--data").arg(store).output().unwrap()
}

fn output_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

fn snapshot(store: &Path) -> Value {
    let output = holdpoint(store, &["status", "--json"]);
    serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", output_text(&output)))
}

fn records(store: &Path, kind: RecordKind) -> Vec<Value> {
    let filter = AuditFilter { kind: Some(kind), ..AuditFilter::default() };
    let rows = Views::open(&Layout::new(store).database()).unwrap().audit(&filter).unwrap();
    rows.iter().map(|record| serde_json::from_str(&record.body).unwrap()).collect()
}

/// With a folder in the place of the mark, another program at the database and a kill, an answered stop was once
/// forgotten.
#[test]
fn an_answered_stop_is_in_force_after_a_kill_with_any_object_at_its_mark() {
    let folder = quick_folder();
    let store = folder.path().join("store");
    let mut first = ServeProcess::start(&store, "sim", None);
    first.until("sequence");
    let mark = Layout::new(&store).stop_marks().places()[0].clone();
    std::fs::create_dir(&mark).unwrap();
    let other = rusqlite::Connection::open(Layout::new(&store).database()).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    let output = holdpoint(&store, &["stop", "--as", "ana", "--reason", "a hand", "--json"]);
    let answer: Value =
        serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", output_text(&output)));
    assert_eq!(
        (answer["reply"].as_str(), answer["kept"].as_str()),
        (Some("stopped"), Some("in-mark")),
        "{answer}"
    );
    first.kill();
    other.execute_batch("ROLLBACK").unwrap();
    drop(other);
    // The test removes the object again.
    std::fs::remove_dir(&mark).unwrap();
    let second = ServeProcess::start(&store, "sim", None);
    let status = snapshot(&store);
    assert!(status.to_string().contains("ana"), "{status}");
    let stops = records(&store, RecordKind::CellStopped);
    let codes: Vec<_> = stops.iter().map(|stop| (stop["by"].as_str(), stop["code"].as_str())).collect();
    assert_eq!(
        codes,
        [(Some("ana"), Some("unrecorded-stop")), (Some("the engine"), Some("unclean-end"))],
        "her stop, and then the kill"
    );
    let alarms = records(&store, RecordKind::AlarmChanged);
    assert!(alarms.iter().any(|alarm| alarm.to_string().contains("came-up-stopped")), "{alarms:?}");
    assert!(holdpoint(&store, &["status"]).stdout.windows(7).any(|window| window == b"STOPPED"));
    second.terminate(&store);
}

/// A killed engine once came up running, whatever was in the cell by then.
#[test]
fn after_a_sudden_end_the_cell_stays_stopped_under_every_profile() {
    for profile in ["sim", "real", "human"] {
        let folder = quick_folder();
        let store = folder.path().join("store");
        let mut first = ServeProcess::start(&store, profile, None);
        first.until("sequence");
        assert_eq!(records(&store, RecordKind::EngineBegan).len(), 1);
        first.kill();
        let second = ServeProcess::start(&store, profile, None);
        let stops = records(&store, RecordKind::CellStopped);
        assert_eq!(stops.len(), 1, "{stops:?}");
        assert_eq!(
            (stops[0]["by"].as_str(), stops[0]["code"].as_str()),
            (Some("the engine"), Some("unclean-end"))
        );
        let reason = stops[0]["reason"].as_str().unwrap();
        assert!(
            reason.len() > stop_after_unclean_end(None).len(),
            "with the time of the last record: {reason}"
        );
        let status: Value = serde_json::from_slice(&holdpoint(&store, &["status", "--json"]).stdout).unwrap();
        assert_eq!(status["stopped"]["by"], "the engine", "{status}");
        let alarms: Vec<Value> = records(&store, RecordKind::AlarmChanged);
        assert!(alarms.iter().any(|alarm| alarm.to_string().contains("came-up-stopped")), "{alarms:?}");
        if profile != "sim" {
            let unknown =
                holdpoint(&store, &["go", "--as", "ana", "--stops", "1", "--reason", "it is empty"]);
            assert!(!unknown.status.success(), "{}", output_text(&unknown));
        }
        // It ends cleanly, stopped; the kill is not counted twice.
        second.terminate(&store);
        let third = ServeProcess::start(&store, profile, None);
        assert_eq!(
            records(&store, RecordKind::CellStopped).len(),
            1,
            "it is stopped still, and not once more"
        );
        third.terminate(&store);
    }
}

#[test]
fn cell_runs_again_after_an_orderly_end() {
    let folder = quick_folder();
    let store = folder.path().join("store");
    let mut first = ServeProcess::start(&store, "sim", None);
    first.until("sequence");
    first.terminate(&store);
    let mut second = ServeProcess::start(&store, "real", None);
    second.until("sequence");
    second.terminate(&store);
    let ended = records(&store, RecordKind::EngineEnded);
    assert_eq!(ended.len(), 2);
    assert!(ended.iter().all(|end| end["orderly"] == true), "{ended:?}");
    let mut third = ServeProcess::start(&store, "real", None);
    third.until("sequence");
    assert!(records(&store, RecordKind::CellStopped).is_empty());
}

/// With 40 file descriptors and 60 silent connections, no client was answered.
#[test]
fn a_stop_is_answered_where_all_file_descriptors_are_used_up() {
    let folder = quick_folder();
    let store = folder.path().join("store");
    let mut engine = ServeProcess::start(&store, "sim", Some(40));
    engine.until("sequence");
    let path = socket_path(&Layout::new(&store));
    let mut idle: Vec<UnixStream> = (0..60).map(|_| UnixStream::connect(&path).unwrap()).collect();
    let begun = Instant::now();
    let output = holdpoint(&store, &["stop", "--as", "ana", "--json"]);
    let took = begun.elapsed();
    let answer: Value =
        serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", output_text(&output)));
    assert_eq!(
        (answer["reply"].as_str(), answer["kept"].as_str()),
        (Some("stopped"), Some("on-record")),
        "{answer}"
    );
    println!("a stop beside {} idle connections was answered after {took:?}", idle.len());
    assert!(took < PATIENCE);
    // The connections that gave way get a message.
    idle[0].set_read_timeout(Some(PATIENCE)).unwrap();
    let mut message = String::new();
    idle[0].read_to_string(&mut message).unwrap();
    assert!(message.contains("\"closed\""), "{message}");
    engine.terminate(&store);
}
