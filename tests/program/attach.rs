//! Attached consoles: what they show, who is attached, the cost of fifty, and the data of a slow one.

use std::time::Instant;

use holdpoint::body::disturbance::{DriftKind, Magnitude};
use holdpoint::protocol::command::{Command, Reply, Request};
use holdpoint::protocol::console_presence::ConsolePresence;
use holdpoint::protocol::event::EventKind;
use holdpoint::protocol::snapshot::Snapshot;
use holdpoint::runtime::capability;
use holdpoint::service::control_socket::{
    Client, ConsoleConnection, ConsoleMessage, ControlSocketError, LET_GO_AFTER, OBSERVERS_MAX,
};
use holdpoint::service::engine_handle::{EngineHandle, EngineUpdate};
use holdpoint::store::Layout;

use crate::host::Front;
use crate::quick_folder::quick_folder;
use crate::socket::{PATIENCE, RawConnection, client};

fn presence(who: &str, view: &str) -> ConsolePresence {
    ConsolePresence { who: Some(who.to_owned()), view: view.to_owned(), ..ConsolePresence::default() }
}

/// The next snapshot that matches; earlier ones are skipped.
fn snapshot(console: &mut ConsoleConnection, predicate: impl Fn(&Snapshot) -> bool) -> Snapshot {
    let until = Instant::now() + PATIENCE;
    while Instant::now() < until {
        if let Some(ConsoleMessage::Snapshot(snapshot)) = console.next(PATIENCE).unwrap()
            && predicate(&snapshot)
        {
            return *snapshot;
        }
    }
    panic!("no such snapshot came");
}

fn attendees(snapshot: &Snapshot) -> Vec<(String, String)> {
    let presences = snapshot.seats.iter().map(|one| one.sitting.clone());
    presences.map(|one| (one.who.unwrap_or_default(), one.view)).collect()
}

#[test]
fn an_attached_console_is_shown_everything_and_seen_by_others() {
    let folder = quick_folder();
    let front = Front::start(folder.path(), Some(1.0));
    let mut ana = client(folder.path()).attach(presence("ana", "Overview")).unwrap();
    let first = snapshot(&mut ana, |_| true);
    assert_eq!(first.families.len(), 4);
    let mut bert = client(folder.path()).attach(presence("bert", "Audit")).unwrap();
    assert_eq!((ana.console_number(), bert.console_number()), (1, 2));
    let both = [("ana".to_owned(), "Overview".to_owned()), ("bert".to_owned(), "Audit".to_owned())];
    snapshot(&mut ana, |snapshot| attendees(snapshot) == both);
    let own = bert.console_number();
    let bert_snapshot = snapshot(&mut bert, |snapshot| attendees(snapshot) == both);
    let process = bert_snapshot.seats.iter().find(|one| one.seat == own).and_then(|one| one.process);
    assert_eq!(process, Some(std::process::id()), "the system names its process");
    // A client without an attached console gets the same.
    let Reply::Snapshot { snapshot: current } = client(folder.path()).send(Command::Snapshot).unwrap() else {
        panic!("no snapshot")
    };
    assert_eq!(attendees(&current), both);
    // A message of one reaches the other, and so does its end.
    let mut sender = bert.presence_sender().unwrap();
    sender.send_presence(presence("bert", "Approvals"));
    snapshot(&mut ana, |snapshot| attendees(snapshot).contains(&("bert".to_owned(), "Approvals".to_owned())));
    drop((bert, sender));
    snapshot(&mut ana, |snapshot| snapshot.seats.len() == 1);
    // The live cell is shown as it moves.
    let until = Instant::now() + PATIENCE;
    while !matches!(ana.next(PATIENCE).unwrap(), Some(ConsoleMessage::Picture(_))) {
        assert!(Instant::now() < until);
    }
    drop(front);
    let until = Instant::now() + PATIENCE;
    while ana.next(PATIENCE).is_ok() {
        assert!(Instant::now() < until, "the end of the engine detaches the console");
    }
}

#[test]
fn an_attached_console_sends_only_its_presence() {
    let folder = quick_folder();
    let _front = Front::start(folder.path(), Some(1.0));
    let long = "v".repeat(65);
    let closed = |lines: &[&str]| -> String {
        let mut raw = RawConnection::connect(folder.path());
        for line in lines {
            raw.send(&format!("{line}\n"));
        }
        while let Some(answer) = raw.read() {
            if answer["answer"] == "closed" {
                return answer["text"].as_str().unwrap().to_owned();
            }
        }
        panic!("it was not closed with a message");
    };
    let attach = r#"{"call":"attach","sitting":{"view":"Overview"}}"#;
    for (lines, text) in [
        (vec![r#"{"call":"sit","sitting":{"view":"Overview"}}"#], "`attach` comes"),
        (vec![attach, r#"{"call":"subscribe"}"#], "only `sit`"),
        (vec![attach, "{}"], "no call"),
        (vec![&format!(r#"{{"call":"attach","sitting":{{"view":"{long}"}}}}"#)], "view is"),
        (vec![attach, &format!(r#"{{"call":"sit","sitting":{{"view":"","who":"{long}"}}}}"#)], "who is"),
    ] {
        assert!(closed(&lines).contains(text), "{lines:?}");
    }
}

/// Two consoles count their requests from the same number: their answers must not be mixed up.
#[test]
fn answers_to_two_consoles_are_not_mixed_up() {
    let folder = quick_folder();
    let _front = Front::start(folder.path(), Some(1.0));
    let layout = Layout::new(folder.path());
    let host = |who: &str| {
        let client = Client::connect(&layout).unwrap().unwrap();
        EngineHandle::attach(layout.clone(), client, presence(who, "Overview")).unwrap()
    };
    let (mut ana, mut bert) = (host("ana"), host("bert"));
    assert!(ana.is_attached());
    let reply_to = |host: &mut EngineHandle, command: Command| {
        host.submit(Request::unsigned("console-2".to_owned(), command)).unwrap();
        loop {
            match host.updates.blocking_recv().unwrap() {
                EngineUpdate::Answer { id, reply } => {
                    assert_eq!(id, "console-2");
                    return reply;
                }
                EngineUpdate::Ended(result) => panic!("{result:?}"),
                _ => {}
            }
        }
    };
    assert!(matches!(reply_to(&mut ana, Command::Pace { times: Some(2.0) }), Reply::Accepted { .. }));
    assert!(matches!(reply_to(&mut bert, Command::Pace { times: Some(3.0) }), Reply::Accepted { .. }));
    let stop = Command::Stop { by: "bert".to_owned(), reason: String::new() };
    assert!(matches!(reply_to(&mut bert, stop), Reply::Stopped { .. }));
}

/// A stop once waited behind the same console's earlier request, which was answered only after the sequence.
#[test]
fn a_stop_does_not_wait_for_earlier_requests() {
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), Some(0.05));
    front.video_frame(|_| true);
    let layout = Layout::new(folder.path());
    let client = Client::connect(&layout).unwrap().unwrap();
    let mut host = EngineHandle::attach(layout.clone(), client, presence("ana", "Overview")).unwrap();
    let drift = Command::Drift { kind: Some(DriftKind::SensorNoise), magnitude: Some(Magnitude::Mild) };
    host.submit(Request::unsigned("slow".to_owned(), drift)).unwrap();
    let stop = Command::Stop { by: "ana".to_owned(), reason: String::new() };
    host.submit(Request::unsigned("stop".to_owned(), stop)).unwrap();
    loop {
        match host.updates.blocking_recv().unwrap() {
            EngineUpdate::Answer { id, reply } => {
                assert_eq!(id, "stop", "{reply:?}");
                assert!(matches!(reply, Reply::Stopped { .. }), "{reply:?}");
                break;
            }
            EngineUpdate::Ended(result) => panic!("{result:?}"),
            _ => {}
        }
    }
}

/// An evaluation has the same results beside the most consoles that an engine admits. A console that reads nothing gets the
/// newest data once it reads.
#[test]
fn as_many_observers_as_allowed_and_a_sleeping_one_change_no_evaluation() {
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), Some(1.0));
    let attach = |number: usize| {
        client(folder.path()).attach(presence(&format!("looker-{number}"), "Overview")).unwrap()
    };
    let mut sleeper = attach(0);
    let package = capability::read(std::path::Path::new("manifests/candidates/grasp-hard-grip")).unwrap();
    let command = Command::Register { package, name: "grasp-hard-grip".to_owned(), by: None };
    let observers: Vec<_> = (1..OBSERVERS_MAX)
        .map(|number| {
            let mut console = attach(number);
            std::thread::spawn(move || {
                let (mut snapshots, mut missed) = (0, 0);
                loop {
                    match console.next(PATIENCE).unwrap().expect("something is shown in time") {
                        ConsoleMessage::Snapshot(_) => snapshots += 1,
                        ConsoleMessage::Missed(some) => missed += some,
                        ConsoleMessage::Picture(_)
                        | ConsoleMessage::Past { .. }
                        | ConsoleMessage::Ended { .. } => {}
                        ConsoleMessage::Event(event) => {
                            if matches!(event.kind, EventKind::AuditClosed { .. }) {
                                return (snapshots, missed);
                            }
                        }
                    }
                }
            })
        })
        .collect();
    assert!(matches!(front.carry_out(command), Reply::Accepted { .. }));
    front.until(|kind| matches!(kind, EventKind::AuditClosed { .. }));
    for observer in observers {
        let (snapshots, missed) = observer.join().unwrap();
        assert!(snapshots > 0, "nothing was shown, {missed} events were missed");
    }
    let now = front.snapshot();
    assert!(now.candidates.iter().all(|one| one.state.is_terminal()), "it was judged");
    // One that slept beyond the limit is detached, and attaches again.
    let until = Instant::now() + PATIENCE;
    let fresh = loop {
        assert!(Instant::now() < until, "no such snapshot came");
        match sleeper.next(PATIENCE) {
            Ok(Some(ConsoleMessage::Snapshot(latest)))
                if latest.at_ms >= now.at_ms
                    && latest.seats.iter().any(|one| one.sitting.who.as_deref() == Some("looker-0")) =>
            {
                break latest;
            }
            Ok(_) => {}
            Err(_) => sleeper = attach(0),
        }
    };
    assert!(fresh.candidates.iter().all(|one| one.state.is_terminal()));
}

/// A suspended console was once shown as present forever, and its connection was never closed.
#[test]
fn a_console_that_never_reads_is_marked_and_detached() {
    let folder = quick_folder();
    let _front = Front::start(folder.path(), Some(1.0));
    let mut sleeper = RawConnection::connect(folder.path());
    sleeper.send("{\"call\":\"attach\",\"sitting\":{\"who\":\"sleeper\",\"view\":\"Overview\"}}\n");
    let mut ana = client(folder.path()).attach(presence("ana", "Overview")).unwrap();
    let reads = |snapshot: &Snapshot| {
        let console = snapshot.seats.iter().find(|one| one.sitting.who.as_deref() == Some("sleeper"));
        console.map(|console| !console.not_reading)
    };
    snapshot(&mut ana, |snapshot| reads(snapshot) == Some(true));
    let begun = Instant::now();
    snapshot(&mut ana, |snapshot| reads(snapshot) == Some(false));
    snapshot(&mut ana, |snapshot| reads(snapshot).is_none());
    assert!(begun.elapsed() >= LET_GO_AFTER, "it had {:?}", begun.elapsed());
    // A reading console is not affected.
    snapshot(&mut ana, |snapshot| snapshot.seats.len() == 1);
    drop(sleeper);
}

/// A console once took the orderly end of its engine for a crash.
#[test]
fn orderly_end_names_its_requester() {
    let folder = quick_folder();
    let _front = Front::start(folder.path(), Some(1.0));
    let mut ana = client(folder.path()).attach(presence("ana", "Overview")).unwrap();
    snapshot(&mut ana, |_| true);
    // The end itself may be the answer to a request.
    drop(client(folder.path()).send(Command::Shutdown));
    let by = loop {
        if let Some(ConsoleMessage::Ended { by }) = ana.next(PATIENCE).unwrap() {
            break by;
        }
    };
    assert_eq!(by, "ana", "she is attached in the process that asked");
    assert!(matches!(ana.next(PATIENCE), Err(ControlSocketError::Ended { .. })));
}

/// A console once knew nothing of the events before it attached.
#[test]
fn an_attaching_console_gets_past_events_once() {
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), None);
    let stop = Command::Stop { by: "bert".to_owned(), reason: "a hand".to_owned() };
    assert!(matches!(front.carry_out(stop), Reply::Stopped { .. }));
    front.until(|kind| matches!(kind, EventKind::ArmStands { .. }));
    let mut ana = client(folder.path()).attach(presence("ana", "Overview")).unwrap();
    let Some(ConsoleMessage::Past { events, earlier: 0 }) = ana.next(PATIENCE).unwrap() else {
        panic!("the past comes first")
    };
    assert!(
        events.iter().any(|event| matches!(&event.kind, EventKind::CellStopped { by, .. } if by == "bert"))
    );
    let last = events.last().unwrap().seq;
    let since_ms = front.snapshot().stopped.unwrap().since_ms;
    let go = Command::Go { by: "bert".to_owned(), reason: "it is empty".to_owned(), since_ms, stops: 1 };
    assert!(matches!(front.carry_out(go), Reply::Accepted { .. }));
    loop {
        if let Some(ConsoleMessage::Event(event)) = ana.next(PATIENCE).unwrap() {
            assert_eq!(event.seq, last + 1, "{event:?}");
            break;
        }
    }
}
