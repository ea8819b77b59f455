//! Seats at an engine: what is shown there, who sits, what fifty of them cost the engine, and what a sleeper gets.

use std::time::Instant;

use holdpoint::body::rehearsal::{DriftKind, Magnitude};
use holdpoint::engine::door::{Attachment, Client, DoorError, LET_GO_AFTER, Shown};
use holdpoint::engine::host::{Host, Update};
use holdpoint::protocol::command::{Command, Reply, Request};
use holdpoint::protocol::event::EventKind;
use holdpoint::protocol::seat::{SEAT_BYTES_MAX, Sitting};
use holdpoint::protocol::snapshot::Snapshot;
use holdpoint::registry::Layout;
use holdpoint::runtime::capability;

use crate::door::{PATIENCE, Raw, client};
use crate::host::Front;

fn sitting(who: &str, view: &str) -> Sitting {
    Sitting { who: Some(who.to_owned()), view: view.to_owned(), ..Sitting::default() }
}

/// The next snapshot that is as wanted; everything before it is passed over.
fn snapshot(seat: &mut Attachment, wanted: impl Fn(&Snapshot) -> bool) -> Snapshot {
    let until = Instant::now() + PATIENCE;
    while Instant::now() < until {
        if let Some(Shown::Snapshot(snapshot)) = seat.next(PATIENCE).unwrap()
            && wanted(&snapshot)
        {
            return *snapshot;
        }
    }
    panic!("no such snapshot came");
}

fn seated(snapshot: &Snapshot) -> Vec<(String, String)> {
    let said = snapshot.seats.iter().map(|one| one.sitting.clone());
    said.map(|one| (one.who.unwrap_or_default(), one.view)).collect()
}

#[test]
fn whoever_sits_down_is_shown_everything_and_seen_by_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let front = Front::start(folder.path(), Some(1.0));
    let mut ana = client(folder.path()).attach(sitting("ana", "Overview")).unwrap();
    let first = snapshot(&mut ana, |_| true);
    assert_eq!(first.families.len(), 4);
    let mut bert = client(folder.path()).attach(sitting("bert", "Audit")).unwrap();
    assert_eq!((ana.seat(), bert.seat()), (1, 2));
    let both = [("ana".to_owned(), "Overview".to_owned()), ("bert".to_owned(), "Audit".to_owned())];
    snapshot(&mut ana, |snapshot| seated(snapshot) == both);
    let own = bert.seat();
    let shown = snapshot(&mut bert, |snapshot| seated(snapshot) == both);
    let process = shown.seats.iter().find(|one| one.seat == own).and_then(|one| one.process);
    assert_eq!(process, Some(std::process::id()), "whose it is, the system says");
    // Whoever asks without a seat is told the same.
    let Reply::Snapshot { snapshot: asked } = client(folder.path()).ask(Command::Snapshot).unwrap() else {
        panic!("no snapshot")
    };
    assert_eq!(seated(&asked), both);
    // A word of one of them reaches the other, and so does the end of it.
    let mut says = bert.sayer().unwrap();
    says.say(sitting("bert", "Approvals"));
    snapshot(&mut ana, |snapshot| seated(snapshot).contains(&("bert".to_owned(), "Approvals".to_owned())));
    drop((bert, says));
    snapshot(&mut ana, |snapshot| snapshot.seats.len() == 1);
    // The live cell is shown as it moves.
    let until = Instant::now() + PATIENCE;
    while !matches!(ana.next(PATIENCE).unwrap(), Some(Shown::Picture(_))) {
        assert!(Instant::now() < until);
    }
    drop(front);
    let until = Instant::now() + PATIENCE;
    while ana.next(PATIENCE).is_ok() {
        assert!(Instant::now() < until, "the end of the engine is the end of the seat");
    }
}

#[test]
fn a_seat_takes_words_about_itself_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let _front = Front::start(folder.path(), Some(1.0));
    let long = "v".repeat(SEAT_BYTES_MAX + 1);
    let closed = |lines: &[&str]| -> String {
        let mut raw = Raw::connect(folder.path());
        for line in lines {
            raw.send(&format!("{line}\n"));
        }
        while let Some(answer) = raw.read() {
            if answer["answer"] == "closed" {
                return answer["text"].as_str().unwrap().to_owned();
            }
        }
        panic!("it was not closed with a word");
    };
    let attach = r#"{"call":"attach","sitting":{"view":"Overview"}}"#;
    for (lines, text) in [
        (vec![r#"{"call":"sit","sitting":{"view":"Overview"}}"#], "`attach` comes first"),
        (vec![attach, r#"{"call":"subscribe"}"#], "takes `sit` alone"),
        (vec![attach, "{}"], "no call"),
        (vec![&format!(r#"{{"call":"attach","sitting":{{"view":"{long}"}}}}"#)], "view has at most"),
        (
            vec![attach, &format!(r#"{{"call":"sit","sitting":{{"view":"","who":"{long}"}}}}"#)],
            "who is a name",
        ),
    ] {
        assert!(closed(&lines).contains(text), "{lines:?}");
    }
}

/// Two consoles count their requests from the same number: what one of them asked must not be taken for the other's.
#[test]
fn what_is_asked_at_two_seats_is_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let _front = Front::start(folder.path(), Some(1.0));
    let layout = Layout::new(folder.path());
    let host = |who: &str| {
        let client = Client::connect(&layout).unwrap().unwrap();
        Host::attach(layout.clone(), client, sitting(who, "Overview")).unwrap()
    };
    let (mut ana, mut bert) = (host("ana"), host("bert"));
    assert!(ana.is_attached());
    let answered = |host: &mut Host, command: Command| {
        host.ask(Request::unsigned("console-2".to_owned(), command)).unwrap();
        loop {
            match host.updates.blocking_recv().unwrap() {
                Update::Answer { id, reply } => {
                    assert_eq!(id, "console-2");
                    return reply;
                }
                Update::Ended(ended) => panic!("{ended:?}"),
                _ => {}
            }
        }
    };
    assert!(matches!(answered(&mut ana, Command::Pace { times: Some(2.0) }), Reply::Accepted { .. }));
    assert!(matches!(answered(&mut bert, Command::Pace { times: Some(3.0) }), Reply::Accepted { .. }));
    let stop = Command::Stop { by: "bert".to_owned(), reason: String::new() };
    assert!(matches!(answered(&mut bert, stop), Reply::Stopped { .. }));
}

/// A stop waited behind what the same console had asked before, which was answered after the sequence alone.
#[test]
fn a_stop_waits_for_nothing_that_was_asked_before_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut front = Front::start(folder.path(), Some(0.05));
    front.picture(|_| true);
    let layout = Layout::new(folder.path());
    let client = Client::connect(&layout).unwrap().unwrap();
    let mut host = Host::attach(layout.clone(), client, sitting("ana", "Overview")).unwrap();
    let drift = Command::Drift { kind: Some(DriftKind::SensorNoise), magnitude: Some(Magnitude::Mild) };
    host.ask(Request::unsigned("slow".to_owned(), drift)).unwrap();
    let stop = Command::Stop { by: "ana".to_owned(), reason: String::new() };
    host.ask(Request::unsigned("stop".to_owned(), stop)).unwrap();
    loop {
        match host.updates.blocking_recv().unwrap() {
            Update::Answer { id, reply } => {
                assert_eq!(id, "stop", "{reply:?}");
                assert!(matches!(reply, Reply::Stopped { .. }), "{reply:?}");
                break;
            }
            Update::Ended(ended) => panic!("{ended:?}"),
            _ => {}
        }
    }
}

/// The engine works for nobody's eyes: fifty that look on change nothing of an evaluation, and one that reads nothing of it
/// gets what is newest once it reads.
#[test]
fn fifty_look_on_while_a_version_is_judged_and_one_of_them_sleeps() {
    let folder = tempfile::tempdir().unwrap();
    let mut front = Front::start(folder.path(), Some(1.0));
    let attach = |number: usize| {
        client(folder.path()).attach(sitting(&format!("looker-{number}"), "Overview")).unwrap()
    };
    let mut sleeper = attach(0);
    let package = capability::read(std::path::Path::new("manifests/candidates/grasp-hard-grip")).unwrap();
    let command = Command::Register { package, name: "grasp-hard-grip".to_owned(), by: None };
    let lookers: Vec<_> = (1..50)
        .map(|number| {
            let mut seat = attach(number);
            std::thread::spawn(move || {
                let (mut snapshots, mut missed) = (0, 0);
                loop {
                    match seat.next(PATIENCE).unwrap().expect("something is shown in time") {
                        Shown::Snapshot(_) => snapshots += 1,
                        Shown::Missed(some) => missed += some,
                        Shown::Picture(_) | Shown::Past { .. } | Shown::Ended { .. } => {}
                        Shown::Event(event) => {
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
    for looker in lookers {
        let (snapshots, missed) = looker.join().unwrap();
        assert!(snapshots > 0, "nothing was shown, {missed} events were missed");
    }
    let now = front.snapshot();
    assert!(now.candidates.iter().all(|one| one.state.is_terminal()), "it was judged");
    // One that slept for longer than it may has lost its seat, and takes another one.
    let until = Instant::now() + PATIENCE;
    let fresh = loop {
        assert!(Instant::now() < until, "no such snapshot came");
        match sleeper.next(PATIENCE) {
            Ok(Some(Shown::Snapshot(shown)))
                if shown.at_ms >= now.at_ms
                    && shown.seats.iter().any(|one| one.sitting.who.as_deref() == Some("looker-0")) =>
            {
                break shown;
            }
            Ok(_) => {}
            Err(_) => sleeper = attach(0),
        }
    };
    assert!(fresh.candidates.iter().all(|one| one.state.is_terminal()));
}

/// A console that was stopped was shown as present for ever, and its connection was never closed.
#[test]
fn whoever_never_reads_is_shown_as_such_and_let_go() {
    let folder = tempfile::tempdir().unwrap();
    let _front = Front::start(folder.path(), Some(1.0));
    let mut sleeper = Raw::connect(folder.path());
    sleeper.send("{\"call\":\"attach\",\"sitting\":{\"who\":\"sleeper\",\"view\":\"Overview\"}}\n");
    let mut ana = client(folder.path()).attach(sitting("ana", "Overview")).unwrap();
    let reads = |snapshot: &Snapshot| {
        let seat = snapshot.seats.iter().find(|one| one.sitting.who.as_deref() == Some("sleeper"));
        seat.map(|seat| !seat.not_reading)
    };
    snapshot(&mut ana, |snapshot| reads(snapshot) == Some(true));
    let begun = Instant::now();
    snapshot(&mut ana, |snapshot| reads(snapshot) == Some(false));
    snapshot(&mut ana, |snapshot| reads(snapshot).is_none());
    assert!(begun.elapsed() >= LET_GO_AFTER, "it had {:?}", begun.elapsed());
    // Whoever reads is not touched by it.
    snapshot(&mut ana, |snapshot| snapshot.seats.len() == 1);
    drop(sleeper);
}

/// A seat took the orderly end of its engine for a crash.
#[test]
fn an_orderly_end_is_told_with_whose_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let _front = Front::start(folder.path(), Some(1.0));
    let mut ana = client(folder.path()).attach(sitting("ana", "Overview")).unwrap();
    snapshot(&mut ana, |_| true);
    // Whoever asks may be answered by the end itself.
    drop(client(folder.path()).ask(Command::Shutdown));
    let by = loop {
        if let Some(Shown::Ended { by }) = ana.next(PATIENCE).unwrap() {
            break by;
        }
    };
    assert_eq!(by, "ana", "she sits in the process that asked");
    assert!(matches!(ana.next(PATIENCE), Err(DoorError::Ended { .. })));
}

/// A seat knew nothing of what had happened before it came.
#[test]
fn what_happened_before_is_told_at_once_and_nothing_twice() {
    let folder = tempfile::tempdir().unwrap();
    let mut front = Front::start(folder.path(), None);
    let stop = Command::Stop { by: "bert".to_owned(), reason: "a hand".to_owned() };
    assert!(matches!(front.carry_out(stop), Reply::Stopped { .. }));
    front.until(|kind| matches!(kind, EventKind::ArmStands { .. }));
    let mut ana = client(folder.path()).attach(sitting("ana", "Overview")).unwrap();
    let Some(Shown::Past { events, earlier: 0 }) = ana.next(PATIENCE).unwrap() else {
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
        if let Some(Shown::Event(event)) = ana.next(PATIENCE).unwrap() {
            assert_eq!(event.seq, last + 1, "{event:?}");
            break;
        }
    }
}
