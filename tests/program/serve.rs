//! The engine as a service, and the outcome of a run without a screen: only what it judged.

use std::io::{BufRead, BufReader};
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use holdpoint::service::control_socket::socket_path;
use holdpoint::store::Layout;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::reported_error::assert_error;

/// A generous time limit.
const PATIENCE: Duration = Duration::from_mins(2);

/// A candidate that the static rules reject at once.
const REJECTED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/manifests/candidates/grasp-tool-frame");

fn program(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    let manager = ["NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"];
    manager.iter().fold(&mut command, |command, name| command.env_remove(name));
    command.args(arguments).stdin(Stdio::null());
    command
}

fn on(store: &Path, arguments: &[&str]) -> Output {
    program(arguments).arg("--data").arg(store).output().unwrap()
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// The versions of a store.
fn versions(store: &Path) -> Vec<String> {
    let listed = on(store, &["registry", "list", "--json"]);
    let listed: Value = serde_json::from_slice(&listed.stdout).unwrap();
    let rows = listed["versions"].as_array().unwrap();
    rows.iter().map(|row| row["version"].as_str().unwrap().to_owned()).collect()
}

/// A running program; it does not outlive the test.
struct ProgramProcess(Child);

impl ProgramProcess {
    fn start(command: &mut Command) -> Self {
        Self(command.stdout(Stdio::piped()).spawn().unwrap())
    }

    fn lines(&mut self) -> impl Iterator<Item = String> + use<> {
        BufReader::new(self.0.stdout.take().unwrap()).lines().map(Result::unwrap)
    }

    fn send_signal(&self, signal: Signal) {
        kill_process(Pid::from_raw(i32::try_from(self.0.id()).unwrap()).unwrap(), signal).unwrap();
    }

    /// Its exit code.
    fn code(&mut self) -> Option<i32> {
        self.0.wait().unwrap().code()
    }
}

impl Drop for ProgramProcess {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

/// The messages that a service manager receives.
struct Manager(UnixDatagram);

impl Manager {
    fn listen(path: &Path) -> Self {
        let socket = UnixDatagram::bind(path).unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        Self(socket)
    }

    /// All messages up to one with this beginning.
    fn until(&self, wanted: &str) -> Vec<String> {
        let mut messages = Vec::new();
        let mut buffer = [0; 4096];
        loop {
            let bytes = self.0.recv(&mut buffer).unwrap_or_else(|_| panic!("no {wanted}: {messages:?}"));
            messages.push(String::from_utf8(buffer[..bytes].to_vec()).unwrap());
            if messages.last().is_some_and(|last| last.starts_with(wanted)) {
                return messages;
            }
        }
    }
}

#[test]
fn a_service_notifies_its_manager_answers_and_ends_cleanly() {
    let root = tempfile::tempdir().unwrap();
    let (store, notify) = (root.path().join("store"), root.path().join("notify"));
    let manager = Manager::listen(&notify);
    let mut service = ProgramProcess::start(
        program(&["serve", "--pace", "max", "--jobs", "1", "--json"])
            .arg("--data")
            .arg(&store)
            .env("NOTIFY_SOCKET", &notify)
            .env("WATCHDOG_USEC", "5000000"),
    );
    assert_eq!(manager.until("READY=1"), ["READY=1"], "READY=1 comes first, once the engine answers");
    assert!(manager.until("STATUS=")[0].contains("sim, 4 of 4 "));
    // Alive repeatedly, and not only once.
    manager.until("WATCHDOG=1");
    let begun = Instant::now();
    manager.until("WATCHDOG=1");
    assert!(begun.elapsed() > Duration::from_millis(500), "not all the time either");

    let baselines = versions(&store);
    assert_eq!(baselines.len(), 4, "no own submission: {baselines:?}");
    let registered = on(&store, &["candidate", "register", REJECTED]);
    assert!(registered.status.success(), "{registered:?}");
    let wait = ["status", "grasp", "--until", "rejected", "--timeout", "60"];
    assert_eq!(on(&store, &wait).status.code(), Some(0), "it is judged by the service");

    let lines = service.lines();
    service.send_signal(Signal::TERM);
    manager.until("STOPPING=1");
    assert_eq!(service.code(), Some(0));
    assert!(!socket_path(&Layout::new(&store)).exists(), "its socket is removed");
    let kinds: Vec<String> = lines
        .map(|line| serde_json::from_str::<Value>(&line).unwrap())
        .map(|event| event["event"].as_str().unwrap().to_owned())
        .collect();
    assert_eq!(kinds[0], "engine-started");
    assert!(kinds.iter().any(|kind| kind == "sequence"), "the cell works on: {kinds:?}");
    assert_eq!(on(&store, &["audit", "verify"]).status.code(), Some(0));
}

#[test]
fn service_without_a_reader_or_a_manager_continues() {
    let root = tempfile::tempdir().unwrap();
    let store = root.path().join("store");
    let mut service = ProgramProcess::start(program(&["serve", "--quiet"]).arg("--data").arg(&store));
    let first = service.lines().next().unwrap();
    assert!(first.contains("engine"), "{first:?}");
    // The reader is gone by now; further events cannot be printed.
    let socket = socket_path(&Layout::new(&store));
    let begun = Instant::now();
    while !socket.exists() && begun.elapsed() < PATIENCE {
        std::thread::park_timeout(Duration::from_millis(5));
    }
    let registered = on(&store, &["candidate", "register", REJECTED]);
    assert!(registered.status.success(), "{registered:?}");
    assert_eq!(service.0.try_wait().unwrap(), None);
    service.send_signal(Signal::INT);
    assert_eq!(service.code(), Some(0));
}

#[test]
fn a_service_reports_why_it_cannot_start() {
    let root = tempfile::tempdir().unwrap();
    let store = root.path().join("store");
    let mut serve = program(&["serve", "--json", "--data"]);
    assert_error(&serve.arg(&store).env("NOTIFY_SOCKET", "manager").output().unwrap(), 2, "environment");
    assert!(!store.exists());
    let error = assert_error(&on(&store, &["serve", "--robot", "/nowhere.urdf", "--json"]), 2, "bad-file");
    assert_eq!(error["file"], "/nowhere.urdf");
}

#[test]
fn a_run_submits_nothing_and_reports_only_named_versions() {
    let root = tempfile::tempdir().unwrap();
    let store = root.path().join("store");
    let nothing = on(&store, &["run", "--plain"]);
    assert_eq!(nothing.status.code(), Some(5), "{}", text(&nothing));
    assert!(!text(&nothing).contains("outcome"), "{}", text(&nothing));
    assert_eq!(versions(&store).len(), 4, "the store holds what a cell is commissioned with");

    assert!(on(&store, &["candidate", "register", REJECTED]).status.success());
    let run = on(&store, &["run", "--plain"]);
    assert_eq!(run.status.code(), Some(1), "{}", text(&run));
    assert!(text(&run).contains("grasp@1.2.0 rejected"), "{}", text(&run));
    let again = on(&store, &["run", "--plain"]);
    assert_eq!(again.status.code(), Some(5), "history is not judged again: {}", text(&again));
}

#[test]
fn the_demonstration_leaves_the_users_store_alone() {
    let root = tempfile::tempdir().unwrap();
    let mut demo = ProgramProcess::start(
        program(&[])
            .env("XDG_DATA_HOME", root.path().join("share"))
            .env("HOME", root.path())
            .env("TMPDIR", root.path()),
    );
    let mut lines = demo.lines();
    assert!(lines.any(|line| line.contains("candidate align-improved")));
    demo.send_signal(Signal::TERM);
    let rest: Vec<String> = lines.collect();
    assert_eq!(demo.code(), Some(3), "{rest:?}");
    assert!(rest.iter().any(|line| line.contains("align@1.1.0 held")), "{rest:?}");
    let left: Vec<_> = std::fs::read_dir(root.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert!(left.is_empty(), "its store is removed, and no other exists: {left:?}");
}

#[test]
fn demonstration_without_new_candidates_confirms_no_version() {
    let root = tempfile::tempdir().unwrap();
    let store = root.path().join("store");
    for name in holdpoint::trials::embedded::names() {
        let registered = on(&store, &["candidate", "register", name]);
        assert!(registered.status.success(), "{}", text(&registered));
    }
    let demo = on(&store, &["demo"]);
    assert_eq!(demo.status.code(), Some(5), "{}", text(&demo));
    assert!(text(&demo).contains("every demonstration"));
    // Without a verb, a named store is not used for a demonstration.
    let error = assert_error(&on(&store, &["--json"]), 2, "usage");
    assert!(error["hint"].as_str().unwrap().contains("`holdpoint serve"), "{error}");
}
