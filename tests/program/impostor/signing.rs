//! What a person signs and reads beside an impostor.

use std::sync::atomic::Ordering;

use holdpoint::engine::control_socket::Client;
use holdpoint::engine::engine_handle::{EngineHandle, EngineUpdate};
use holdpoint::protocol::command::{Command, Reply, Request};
use holdpoint::protocol::console_presence::ConsolePresence;

use super::{Impostor, LIE, Served, said, until};

/// Only a verified engine gets a signature: a `go` was once signed over stops that an impostor had hidden.
#[test]
fn nothing_is_signed_for_an_impostor() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path());
    let impostor = Impostor::start(&served.layout());
    for verb in [&["go"][..], &["confirm-time"], &["resume", "grasp"], &["rearm", "grasp@1.0.0"]] {
        let done = served.verb(&[verb, &["--as", "admin", "--reason", "all is clear"]].concat());
        assert_eq!(done.status.code(), Some(6), "{verb:?}: {}", said(&done));
        assert!(said(&done).contains("nothing was signed"), "{verb:?}: {}", said(&done));
        assert!(!said(&done).contains(LIE), "{verb:?}: {}", said(&done));
    }
    drop(impostor);
    served.end();
}

/// A console attached to the engine once read registry, evidence and verification from an impostor, over its second
/// connection.
#[test]
fn a_console_at_the_engine_reads_only_from_the_engine() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path());
    let client = Client::connect(&served.layout()).unwrap().unwrap();
    let mut console = EngineHandle::attach(served.layout(), client, ConsolePresence::default()).unwrap();
    assert_eq!(console.unverified_origin(), None);
    // Its requests use a connection that the first request opens.
    let impostor = Impostor::start(&served.layout());
    until("the name is not taken", || impostor.taken.load(Ordering::Acquire) > 0);
    console.ask(Request::unsigned("read".to_owned(), Command::VerifyAudit)).unwrap();
    let reply = loop {
        match console.updates.blocking_recv().unwrap() {
            EngineUpdate::Answer { reply, .. } => break reply,
            EngineUpdate::Ended(ended) => panic!("{ended:?}"),
            _ => {}
        }
    };
    let Reply::Refused { text, .. } = &reply else { panic!("{reply:?}") };
    assert!(text.contains("sent it no request") && !text.contains(LIE), "{text}");
    drop((console, impostor));
    served.end();
}
