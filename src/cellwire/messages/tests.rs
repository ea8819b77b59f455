//! The golden bytes, and the page of the protocol.

use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::thread;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Answer, CellRequest, Greeting, Hello};
use crate::endpoint::EndpointStream;
use crate::fake_cell::{FakeFactory, Quirk};
use crate::framing::{Line, WireError, decode, encode};
use crate::server::{CellServer, ServerOptions};
use crate::tests::LONG;

fn bytes(digits: &str) -> Vec<u8> {
    let pairs = digits.as_bytes().chunks(2);
    pairs.map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

fn lines(text: &str) -> impl Iterator<Item = &str> {
    text.lines().filter(|line| !line.is_empty() && !line.starts_with('#'))
}

/// Reads the bytes as a message, and writes it again.
fn again<T: Serialize + DeserializeOwned>(golden: &[u8]) -> Vec<u8> {
    encode(&decode::<T>(golden).unwrap()).unwrap()
}

#[test]
fn golden_bytes_are_those_of_the_messages() {
    let mut count = 0;
    for line in lines(include_str!("../transcripts/messages.txt")) {
        let [kind, name, digits] = line.split(' ').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let golden = bytes(digits);
        let written = match kind {
            "hello" => again::<Hello>(&golden),
            "greeting" => again::<Greeting>(&golden),
            "request" => again::<CellRequest>(&golden),
            "answer" => again::<Answer>(&golden),
            _ => panic!("{kind}"),
        };
        assert!(written == golden, "{kind} {name}: {written:02x?}");
        count += 1;
    }
    assert!(count >= 25, "{count} messages");
}

#[test]
fn golden_conversations_are_those_of_a_server() {
    let mut open: Option<Line<EndpointStream>> = None;
    let mut count = 0;
    for line in lines(include_str!("../transcripts/conversations.txt")) {
        if let Some(title) = line.strip_prefix("== ") {
            let factory = Arc::new(FakeFactory::new(Quirk::Honest));
            let server = CellServer::new(factory, ServerOptions::default()).unwrap();
            let (own, other) = UnixStream::pair().unwrap();
            thread::spawn(move || server.attend(EndpointStream::Unix(other)));
            open = Some(Line::new(EndpointStream::Unix(own)).expect(title));
            count += 1;
            continue;
        }
        let talk = open.as_mut().unwrap();
        match line.split_once(' ').unwrap_or((line, "")) {
            (">", digits) => {
                let message = bytes(digits);
                let length = u32::try_from(message.len()).unwrap().to_be_bytes();
                talk.send_bytes(&[&length[..], &message].concat()).unwrap();
            }
            ("<", digits) => {
                let came = talk.receive_bytes(LONG).unwrap();
                assert!(came == bytes(digits), "{line}: {:?}", decode::<Answer>(&came));
            }
            ("<*", _) => assert!(matches!(talk.receive(LONG), Ok(Greeting::Welcome(_)))),
            ("x", _) => assert_eq!(talk.receive_bytes(LONG), Err(WireError::Closed)),
            _ => panic!("{line}"),
        }
    }
    assert_eq!(count, 4);
}

/// The names in the first column of a table below a heading of the page.
fn names_below(heading: &str) -> Vec<String> {
    let page = include_str!("../../guide/reference/cell-protocol.md");
    let (_, below) = page.split_once(&format!("\n## {heading}\n")).unwrap();
    let rows = below.lines().skip_while(|line| !line.starts_with("| ---")).skip(1);
    let cells = rows.take_while(|line| line.starts_with('|')).filter_map(|line| line.split('`').nth(1));
    let mut names: Vec<String> = cells.map(str::to_owned).collect();
    names.sort();
    names
}

/// The variants of an enum as serde names them: from the error of one that is not known.
fn variants<T: DeserializeOwned + std::fmt::Debug>() -> Vec<String> {
    let error = decode::<T>(&encode(&"no such variant").unwrap()).unwrap_err().to_string();
    let (_, listed) = error.split_once("expected one of ").unwrap();
    let mut names: Vec<String> = listed.split('`').skip(1).step_by(2).map(str::to_owned).collect();
    names.sort();
    names
}

#[test]
fn page_lists_every_message() {
    assert_eq!(names_below("Requests"), variants::<super::Call>());
    assert_eq!(names_below("Answers"), variants::<super::CellReply>());
    assert_eq!(names_below("Refusals"), variants::<crate::refusal::CellRefusal>());
}
