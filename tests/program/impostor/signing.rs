//! A client signs no request for an impostor, and a console reads nothing from one.

use std::sync::atomic::Ordering;

use holdpoint::protocol::command::{Command, Refusal, Reply, Request};
use holdpoint::protocol::console_presence::ConsolePresence;
use holdpoint::service::control_socket::Client;
use holdpoint::service::engine_handle::{EngineHandle, EngineUpdate};

use super::{GenuineEngine, Impostor, LIE, output_text, until};
use crate::reported_error::assert_error;

/// Only a verified engine gets a signature: a `go` was once signed over stops that an impostor had hidden.
#[test]
fn client_signs_no_request_for_an_impostor() {
    let folder = tempfile::tempdir().unwrap();
    let engine = GenuineEngine::start(folder.path());
    let impostor = Impostor::start(&engine.layout());
    for verb in [&["go"][..], &["confirm-time"], &["resume", "grasp"], &["rearm", "grasp@1.0.0"]] {
        let output = engine.verb(&[verb, &["--as", "admin", "--reason", "all is clear", "--json"]].concat());
        assert_error(&output, 6, "not-confirmed/nothing-signed");
        assert!(!output_text(&output).contains(LIE), "{verb:?}: {}", output_text(&output));
    }
    drop(impostor);
    engine.end();
}

/// A console attached to the engine once read registry, evidence and verification from an impostor, over its second
/// connection.
#[test]
fn a_console_at_the_engine_reads_only_from_the_engine() {
    let folder = tempfile::tempdir().unwrap();
    let engine = GenuineEngine::start(folder.path());
    let client = Client::connect(&engine.layout()).unwrap().unwrap();
    let mut console = EngineHandle::attach(engine.layout(), client, ConsolePresence::default()).unwrap();
    assert_eq!(console.unverified_origin(), None);
    // Its requests use a connection that the first request opens.
    let impostor = Impostor::start(&engine.layout());
    until("the name is not taken", || impostor.takeovers.load(Ordering::Acquire) > 0);
    // The name has no socket for a moment while the impostor takes it: then there is no answer, and the request is repeated.
    let reply = loop {
        console.submit(Request::unsigned("read".to_owned(), Command::VerifyAudit)).unwrap();
        let reply = loop {
            match console.updates.blocking_recv().unwrap() {
                EngineUpdate::Answer { reply, .. } => break reply,
                EngineUpdate::Ended(result) => panic!("{result:?}"),
                _ => {}
            }
        };
        if !matches!(reply, Reply::Refused { code: Refusal::NoAnswer, .. }) {
            break reply;
        }
    };
    let Reply::Refused { code: Refusal::NotAllowed, text, .. } = &reply else { panic!("{reply:?}") };
    assert!(text.contains("no request") && !text.contains(LIE), "{text}");
    drop((console, impostor));
    engine.end();
}
