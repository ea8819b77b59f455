//! The loss of a running engine's socket or database disables neither the stop nor an answered one.

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::net::UnixListener;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use holdpoint::engine::decide::halt::recall;
use holdpoint::governance::record::RecordKind;
use holdpoint::protocol::command::{Command, Reply, StopPersistence};
use holdpoint::registry::Views;
use holdpoint::service::control_socket::{Client, socket_path};
use holdpoint::store::{AuditFilter, Layout};

use crate::quick_folder::quick_folder;
use crate::socket::{PATIENCE, client, engine};

/// The first place of an unrecorded stop.
fn mark(layout: &Layout) -> PathBuf {
    layout.stop_marks().places()[0].clone()
}

/// A process that removes or replaces the socket cannot prevent a stop.
#[test]
fn a_removed_socket_is_created_again() {
    let folder = quick_folder();
    let running = engine(folder.path());
    let layout = Layout::new(folder.path());
    let socket = socket_path(&layout);
    let remove = || fs::remove_file(&socket).unwrap();
    // Left by an ended process.
    let replace = || {
        fs::remove_file(&socket).unwrap();
        drop(UnixListener::bind(&socket).unwrap());
    };
    let plant_folder = || {
        fs::remove_file(&socket).unwrap();
        fs::create_dir(&socket).unwrap();
    };
    let link = || {
        fs::remove_file(&socket).unwrap();
        symlink("/nowhere/at/all", &socket).unwrap();
    };
    let displacements: [(&str, &dyn Fn()); 4] =
        [("removed", &remove), ("replaced", &replace), ("a folder", &plant_folder), ("a link", &link)];
    for (what, displace) in displacements {
        displace();
        let until = Instant::now() + PATIENCE;
        let mut connection = loop {
            if let Ok(Some(connection)) = Client::connect(&layout) {
                break connection;
            }
            assert!(Instant::now() < until, "{what}: no engine answers");
            std::thread::park_timeout(Duration::from_millis(5));
        };
        let stop = Command::Stop { by: "ana".to_owned(), reason: what.to_owned() };
        let reply = connection.send(stop).unwrap();
        assert!(matches!(reply, Reply::Stopped { .. }), "{what}: {reply:?}");
        assert_eq!(socket.metadata().unwrap().permissions().mode() & 0o777, 0o600);
    }
    let reply = client(folder.path()).send(Command::Shutdown).unwrap();
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    running.join().unwrap();
    assert!(!socket.exists());
}

/// A program that locks the database cannot prevent the stop of the arm or its report; the missing record follows
/// when it can be written.
#[test]
fn a_stop_is_answered_while_another_program_has_the_database() {
    let folder = quick_folder();
    let running = engine(folder.path());
    let mut connection = client(folder.path());
    let other = rusqlite::Connection::open(Layout::new(folder.path()).database()).unwrap();
    other.execute_batch("BEGIN EXCLUSIVE").unwrap();
    let began = Instant::now();
    let stop = Command::Stop { by: "ana".to_owned(), reason: "a person is in the cell".to_owned() };
    let reply = connection.send(stop).unwrap();
    assert!(matches!(&reply, Reply::Stopped { kept: StopPersistence::InMark, .. }), "{reply:?}");
    // Less than the time for which a write waits for another program.
    assert!(began.elapsed() < Duration::from_secs(5), "{:?}", began.elapsed());
    other.execute_batch("ROLLBACK").unwrap();
    let until = Instant::now() + PATIENCE;
    loop {
        let Reply::Snapshot { snapshot } = connection.send(Command::Snapshot).unwrap() else {
            panic!("no snapshot")
        };
        if snapshot.stopped.as_ref().is_some_and(|stopped| stopped.by.contains("ana")) {
            break;
        }
        assert!(Instant::now() < until, "{:?}", snapshot.stopped);
        std::thread::park_timeout(Duration::from_millis(5));
    }
    drop(other);
    assert!(matches!(connection.send(Command::Shutdown).unwrap(), Reply::Accepted { .. }));
    running.join().unwrap();
}

/// A stop that was answered while nothing could be written is in force after the next start, however the engine
/// ended, and on record as soon as possible.
#[test]
fn a_stop_that_could_not_be_written_outlasts_the_engine() {
    let folder = quick_folder();
    let layout = Layout::new(folder.path());
    let running = engine(folder.path());
    let mut connection = client(folder.path());
    let other = rusqlite::Connection::open(layout.database()).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    let stop = Command::Stop { by: "ana".to_owned(), reason: "a person is in the cell".to_owned() };
    let reply = connection.send(stop).unwrap();
    assert!(matches!(&reply, Reply::Stopped { kept: StopPersistence::InMark, .. }), "{reply:?}");
    let until = Instant::now() + PATIENCE;
    while !mark(&layout).is_file() {
        assert!(Instant::now() < until, "it is not kept beside the database");
        std::thread::park_timeout(Duration::from_millis(5));
    }
    // A reader of the store without the engine, or after its sudden end, sees the stop.
    assert!(recall(&Views::open(&layout.database()).unwrap()).unwrap().is_some());
    other.execute_batch("ROLLBACK").unwrap();
    drop(other);
    // After a clean end it was recorded before the end.
    assert!(matches!(connection.send(Command::Shutdown).unwrap(), Reply::Accepted { .. }));
    running.join().unwrap();
    assert!(!mark(&layout).exists(), "it is on record by now");
    let recalled = recall(&Views::open(&layout.database()).unwrap()).unwrap();
    assert_eq!(recalled.map(|stopped| stopped.by), Some("ana".to_owned()));
}

/// A mark beside the database stops the next engine, which records it; an unreadable mark does, too.
#[test]
fn a_stop_beside_the_database_stops_the_next_engine() {
    for text in ["{\"by\":\"ana\",\"caller\":{\"kind\":\"script\"},\"reason\":\"x\"}", "what is this"] {
        let folder = quick_folder();
        let layout = Layout::new(folder.path());
        let first = engine(folder.path());
        assert!(matches!(client(folder.path()).send(Command::Shutdown).unwrap(), Reply::Accepted { .. }));
        first.join().unwrap();
        fs::write(mark(&layout), text).unwrap();
        let second = engine(folder.path());
        let Reply::Snapshot { snapshot } = client(folder.path()).send(Command::Snapshot).unwrap() else {
            panic!("no snapshot")
        };
        assert!(snapshot.stopped.is_some(), "{text}");
        assert!(!mark(&layout).exists(), "{text}: it is on record");
        assert!(matches!(client(folder.path()).send(Command::Shutdown).unwrap(), Reply::Accepted { .. }));
        second.join().unwrap();
        let views = Views::open(&layout.database()).unwrap();
        assert!(recall(&views).unwrap().is_some());
        let stops = AuditFilter { kind: Some(RecordKind::CellStopped), ..AuditFilter::default() };
        let stops = views.audit(&stops).unwrap();
        assert!(stops.len() == 1 && stops[0].body.contains("\"code\":\"unrecorded-stop\""), "{stops:?}");
    }
}
