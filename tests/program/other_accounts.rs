//! An engine of one account, and a client of another one at the socket of the consoles: its role, its limits, its stops.
//!
//! Only root starts programs of other accounts. Without root the tests say that they were left out.

use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, chown};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command as Process, Stdio};
use std::time::Instant;

use holdpoint::governance::record::RecordKind;
use holdpoint::protocol::account_role::AccountRole;
use holdpoint::protocol::command::{Command, Refusal, Reply};
use holdpoint::protocol::console_presence::ConsolePresence;
use holdpoint::registry::Views;
use holdpoint::service::control_socket::{
    ACCOUNT_CONNECTIONS_MAX, ACCOUNT_RECEIVERS_MAX, Client, socket_path,
};
use holdpoint::store::{AuditFilter, Layout};
use serde_json::json;

use crate::reported_error::assert_error;
use crate::socket::{PATIENCE, RawConnection};

/// The account of the engine, the group of the consoles, and a group that the account is not in.
const ENGINE: u32 = 61_011;
const GROUP: u32 = 61_012;
const OTHER_GROUP: u32 = 61_013;

/// Folders of the engine's account, and a program that other accounts can start.
struct Machine {
    root: tempfile::TempDir,
    store: PathBuf,
    consoles: PathBuf,
}

impl Machine {
    /// `None` if this process may not start programs of other accounts.
    #[allow(clippy::print_stdout, reason = "the test's output names what was left out")]
    fn new() -> Option<Self> {
        if !rustix::process::geteuid().is_root() {
            println!("left out: only root starts programs of other accounts");
            return None;
        }
        let root = tempfile::tempdir().unwrap();
        fs::set_permissions(root.path(), Permissions::from_mode(0o755)).unwrap();
        let (store, consoles) = (root.path().join("store"), root.path().join("consoles"));
        for (folder, mode) in [(&store, 0o700), (&consoles, 0o750)] {
            fs::create_dir(folder).unwrap();
            chown(folder, Some(ENGINE), Some(GROUP)).unwrap();
            fs::set_permissions(folder, Permissions::from_mode(mode)).unwrap();
        }
        let status = Process::new("cp")
            .arg(env!("CARGO_BIN_EXE_holdpoint"))
            .arg(root.path().join("holdpoint"))
            .status();
        assert!(status.unwrap().success());
        Some(Self { root, store, consoles })
    }

    /// `holdpoint serve` of the engine's account.
    fn serve(&self, group: u32, more: &[&str]) -> Process {
        let mut serve = Process::new(self.root.path().join("holdpoint"));
        serve
            .args(["serve", "--json", "--pace", "1", "--no-recording", "--data"])
            .arg(&self.store)
            .arg("--seats")
            .arg(&self.consoles)
            .args(more)
            .env("HOME", self.root.path())
            .current_dir(self.root.path())
            .stdin(Stdio::null())
            .uid(ENGINE)
            .gid(group);
        serve
    }
}

/// A running engine; it does not outlive the test.
struct EngineProcess(Child);

impl EngineProcess {
    fn start(mut serve: Process, consoles: &Path) -> (Self, Client) {
        let engine = Self(serve.stdout(Stdio::null()).spawn().unwrap());
        let until = Instant::now() + PATIENCE;
        loop {
            if let Ok(Some(mut client)) = Client::connect(&Layout::new(consoles))
                && matches!(client.send(Command::Snapshot), Ok(Reply::Snapshot { snapshot }) if snapshot.reading.is_none())
            {
                return (engine, client);
            }
            assert!(Instant::now() < until, "the engine does not start");
            std::thread::park_timeout(std::time::Duration::from_millis(5));
        }
    }
}

impl Drop for EngineProcess {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

fn is_not_allowed(reply: &Reply) -> bool {
    matches!(reply, Reply::Refused { code: Refusal::NotAllowed, .. })
}

#[test]
fn the_role_of_an_account_limits_its_commands_and_every_account_stops() {
    let Some(machine) = Machine::new() else { return };
    let layout = Layout::new(&machine.consoles);
    for role in AccountRole::ALL {
        // Root is another account here; the first role is that of an account without one.
        let given = format!("--account=0={role}");
        let more = if role == AccountRole::default() { vec![] } else { vec![given.as_str()] };
        let (mut engine, mut client) = EngineProcess::start(machine.serve(GROUP, &more), &machine.consoles);
        assert!(client.unverified_origin().is_none(), "the engine holds the lock of the folder");
        let files = [machine.store.clone(), socket_path(&Layout::new(&machine.store)), socket_path(&layout)];
        let modes = files.map(|path| fs::metadata(path).unwrap().mode() & 0o777);
        assert_eq!(modes, [0o700, 0o600, 0o660]);
        assert_eq!(fs::metadata(socket_path(&layout)).unwrap().gid(), GROUP);
        let note = Command::Note { by: "ana".to_owned(), text: "lens cleaned".to_owned() };
        let reply = client.send(note).unwrap();
        assert_eq!(is_not_allowed(&reply), role < AccountRole::Operator, "{role}: {reply:?}");
        assert_eq!(client.keep_engine_running().is_err(), role < AccountRole::Operator, "{role}");
        let console = Client::connect(&layout).unwrap().unwrap().attach(ConsolePresence::default()).unwrap();
        let mut client = Client::connect(&layout).unwrap().unwrap();
        let Reply::Snapshot { snapshot } = client.send(Command::Snapshot).unwrap() else {
            panic!("no snapshot")
        };
        let accounts: Vec<_> = snapshot.seats.iter().filter_map(|one| one.account.clone()).collect();
        assert_eq!(accounts.iter().map(|one| (one.uid, one.role)).collect::<Vec<_>>(), [(0, role)]);
        drop(console);
        let stop = Command::Stop { by: "ana".to_owned(), reason: "a test".to_owned() };
        let reply = client.send(stop).unwrap();
        assert!(matches!(reply, Reply::Stopped { .. }), "{role}: {reply:?}");
        let reply = client.send(Command::Shutdown).unwrap();
        assert_eq!(is_not_allowed(&reply), role < AccountRole::Administrator, "{role}: {reply:?}");
        if role == AccountRole::Administrator {
            assert!(engine.0.wait().unwrap().success());
        }
    }
    let stops = AuditFilter { kind: Some(RecordKind::CellStopped), ..AuditFilter::default() };
    let stops = Views::open(&Layout::new(&machine.store).database()).unwrap().audit(&stops).unwrap();
    assert!(stops.iter().any(|stop| stop.body.contains("\"uid\":0,")), "the record names the account");
}

#[test]
fn an_account_with_many_connections_can_still_stop() {
    let Some(machine) = Machine::new() else { return };
    let (_engine, _client) = EngineProcess::start(machine.serve(GROUP, &[]), &machine.consoles);
    let ask = |id: &str, command: serde_json::Value| {
        let mut connection = RawConnection::connect(&machine.consoles);
        let call = json!({ "call": "ask", "request": { "id": id, "command": command } });
        connection.send(&format!("{call}\n"));
        assert_eq!(connection.read().unwrap()["answer"], "hello");
        connection.read().unwrap()
    };
    let _crowd: Vec<RawConnection> =
        (1..ACCOUNT_CONNECTIONS_MAX).map(|_| RawConnection::connect(&machine.consoles)).collect();
    let answer = ask("look", json!({ "command": "snapshot" }));
    assert_eq!(answer["answer"], "closed", "{answer}");
    let answer = ask("stop", json!({ "command": "stop", "by": "ana", "reason": "a test" }));
    assert_eq!(answer["reply"]["reply"], "stopped", "{answer}");
}

#[test]
fn an_observer_has_few_receivers_and_short_lines() {
    let Some(machine) = Machine::new() else { return };
    let (_engine, _client) = EngineProcess::start(machine.serve(GROUP, &[]), &machine.consoles);
    let answer = |line: &str| {
        let mut connection = RawConnection::connect(&machine.consoles);
        connection.send(&format!("{line}\n"));
        assert_eq!(connection.read().unwrap()["answer"], "hello");
        let answer = connection.read().unwrap()["answer"].as_str().unwrap().to_owned();
        (connection, answer)
    };
    let receivers: Vec<_> = (0..=ACCOUNT_RECEIVERS_MAX).map(|_| answer(r#"{"call":"subscribe"}"#)).collect();
    let answers: Vec<&str> = receivers.iter().map(|(_, answer)| answer.as_str()).collect();
    assert_eq!(answers, [vec!["subscribed"; ACCOUNT_RECEIVERS_MAX], vec!["closed"]].concat());
    let note = json!({ "command": "note", "by": "ana", "text": "x".repeat(64 << 10) });
    let call = json!({ "call": "ask", "request": { "id": "a", "command": note } });
    assert_eq!(answer(&call.to_string()).1, "closed");
}

#[test]
fn an_engine_outside_the_group_of_the_consoles_does_not_start() {
    let Some(machine) = Machine::new() else { return };
    let output = machine.serve(OTHER_GROUP, &[]).output().unwrap();
    let error = assert_error(&output, 2, "control-socket/group");
    // The account has no name, which `usermod` would need.
    let (text, hint) = (error["error"].as_str().unwrap(), error["hint"].as_str().unwrap());
    assert!(hint.contains("`sudo chgrp ") && !text.contains("chgrp"), "{error}");
    assert!(!socket_path(&Layout::new(&machine.consoles)).exists());
}
