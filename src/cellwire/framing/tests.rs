//! Messages and frames: what is written is read, and nothing else is.

use std::io::Write as _;
use std::os::unix::net::UnixStream;

use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude};
use holdpoint_body::{
    Body as _, BodyError, Command, FailureSignal, GuardVerdict, Interrupt, JointVec, Pose, TaskKind,
};
use holdpoint_cell::{CellError, CellFactory as _, InjectedFault, RobotCell as _};
use proptest::prelude::*;

use super::{Line, WireError, decode, encode};
use crate::endpoint::EndpointStream;
use crate::fake_cell::{FakeFactory, Quirk};
use crate::messages::{
    Answer, BLOCK_BYTES_MAX, Block, Call, CellReply, CellRequest, CellState, FactoryDescription, Greeting,
    Hello, MESSAGE_BYTES_MAX, Role, Truth,
};
use crate::refusal::{CellRefusal, WatchdogStop};
use crate::tests::{LONG, hello, joints, setup};

fn line_pair() -> (Line<EndpointStream>, UnixStream) {
    let (own, other) = UnixStream::pair().unwrap();
    (Line::new(EndpointStream::Unix(own)).unwrap(), other)
}

#[test]
fn frames_are_bounded_and_whole() {
    let (mut line, mut other) = line_pair();
    other.write_all(&[0, 0, 0, 9, 1, 2, 3]).unwrap();
    drop(other);
    assert_eq!(line.receive::<Answer>(LONG), Err(WireError::Torn { came: 7, due: 13 }));

    let (mut line, mut other) = line_pair();
    other.write_all(&[0, 0]).unwrap();
    drop(other);
    assert_eq!(line.receive::<Answer>(LONG), Err(WireError::Torn { came: 2, due: 4 }));

    let (mut line, mut other) = line_pair();
    other.write_all(&[0xFF; 4]).unwrap();
    let most = MESSAGE_BYTES_MAX as u64;
    assert_eq!(line.receive::<Answer>(LONG), Err(WireError::TooLarge { bytes: u64::from(u32::MAX), most }));

    let (mut line, _other) = line_pair();
    let long = Answer {
        sequence: 1,
        reply: CellReply::Refused(CellRefusal::Snapshot("x".repeat(MESSAGE_BYTES_MAX))),
    };
    assert!(matches!(line.send(&long), Err(WireError::TooLarge { .. })));
}

#[test]
fn block_is_whole_or_refused() {
    let bytes: Vec<u8> = (0..2 * MESSAGE_BYTES_MAX + 5).map(|i| u8::try_from(i % 251).unwrap()).collect();
    let sent = bytes.clone();
    let (mut line, other) = line_pair();
    let writer = std::thread::spawn(move || {
        let mut other = Line::new(EndpointStream::Unix(other)).unwrap();
        other.send_block(&sent).unwrap();
        other.send(&1_u8).unwrap();
        other.send_block(&sent[..100]).unwrap();
        other.send_block(&sent[..100]).unwrap();
        other
    });
    assert!(line.receive_block(&Block::of(&bytes), LONG).unwrap() == bytes);
    assert_eq!(line.receive::<u8>(LONG), Ok(1));
    let other_bytes = Block::of(&bytes[1..101]);
    assert!(matches!(line.receive_block(&other_bytes, LONG), Err(WireError::Malformed(_))));
    let shorter = Block::of(&bytes[..99]);
    assert!(matches!(line.receive_block(&shorter, LONG), Err(WireError::Malformed(_))));
    let huge = Block { bytes: BLOCK_BYTES_MAX as u64 + 1, ..shorter };
    assert!(matches!(line.receive_block(&huge, LONG), Err(WireError::TooLarge { .. })));
    drop(writer.join().unwrap());
}

/// One of each call, with values that a careless decoder would change.
fn calls() -> Vec<Call> {
    let factory = FakeFactory::new(Quirk::Honest);
    let [canonical, ..] = factory.distributions().unwrap();
    let observed = factory.cell().observed().unwrap();
    let pose = Pose { position: [-0.0, f64::MIN_POSITIVE, 1e300], rotation: [0.0, 0.0, 0.0, 1.0] };
    let commands = [
        Command::Hold,
        Command::ToolPose { pose, max_speed_m_s: 0.25 },
        joints(0.1, 5e-324, 1.0),
        Command::Gripper { width_m: 0.04, speed_m_s: 0.1, force_n: 20.0 },
        Command::Stop,
        Command::Done,
        Command::Fail { signal: FailureSignal::GraspMissed },
    ];
    let mut all: Vec<Call> = commands.into_iter().map(|command| Call::Step { command }).collect();
    all.extend([
        Call::Describe,
        Call::Drift {
            of: Box::new(canonical.clone()),
            drift: Drift { kind: DriftKind::ActuatorDelay, magnitude: Magnitude::Strong },
        },
        Call::Observe { guard: GuardVerdict::Denied },
        Call::Interrupt { interrupt: Interrupt::Release },
        Call::BeginTask { task: TaskKind::Place },
        Call::EndTask,
        Call::Scenery,
        Call::Observed,
        Call::Fork,
        Call::Export,
        Call::Inject { fault: InjectedFault::JointRunaway { joint: 1 } },
        Call::Inject { fault: InjectedFault::CameraLost },
        Call::AwaitWork { conditions: Box::new(canonical), seed: u64::MAX },
        Call::Reset { setup: Box::new(setup(11)) },
        Call::GoOnFrom { fork: 3 },
        Call::Import { image: Block::of(b"state") },
        Call::SetTo { observed: Box::new(observed) },
        Call::Film,
        Call::TakeFilm,
    ]);
    all
}

fn replies() -> Vec<CellReply> {
    let mut cell = FakeFactory::new(Quirk::Honest).cell();
    let observation = cell.observe(GuardVerdict::Clamped);
    let seen = CellState {
        tick: 3,
        observation: Some(observation.clone()),
        telemetry: cell.telemetry(),
        done: true,
        stop_declared: Some(2),
        object: cell.shown_object(),
        truth: cell.truth().map(Truth::from),
    };
    let [canonical, ..] = FakeFactory::new(Quirk::Honest).distributions().unwrap();
    let stop = WatchdogStop { silent_ms: 20, standstill_ticks: None };
    let refusals = [
        CellRefusal::Version { server: 1 },
        CellRefusal::Hello { field: "client".to_owned(), allowed: "a name".to_owned() },
        CellRefusal::Malformed("no message".to_owned()),
        CellRefusal::Sequence { due: 1, came: 2 },
        CellRefusal::Role { needs: Role::Live },
        CellRefusal::Taken,
        CellRefusal::Full { what: "forks".to_owned(), most: 4 },
        CellRefusal::UnknownFork(9),
        CellRefusal::Stopped(stop),
        CellRefusal::File { file: "f".to_owned(), element: "e".to_owned(), problem: "p".to_owned() },
        CellRefusal::InvalidStart { seed: 4, problem: "out of reach".to_owned() },
        CellRefusal::Body(BodyError::Diverged { tick: 4, what: "a joint".to_owned() }),
        CellRefusal::Snapshot("other robot".to_owned()),
        CellRefusal::Unable("export its state".to_owned()),
    ];
    let mut all: Vec<CellReply> = refusals.into_iter().map(CellReply::Refused).collect();
    all.extend([
        CellReply::Seen(Box::new(seen)),
        CellReply::Fork { fork: 1, tick: 2 },
        CellReply::Block(Block::of(b"state")),
        CellReply::Scenery { fixtures: cell.fixtures(), contacts: cell.contact_points() },
        CellReply::Distribution(Box::new(canonical)),
        CellReply::Observed(None),
        CellReply::Observed(Some(Box::new(observation))),
    ]);
    all
}

#[test]
fn messages_are_read_as_they_were_written() {
    let requests = calls().into_iter().enumerate().map(|(index, call)| CellRequest {
        sequence: index as u64,
        guard: (index % 2 == 0).then_some(GuardVerdict::Clamped),
        release: if index % 3 == 0 { vec![1, u64::MAX] } else { Vec::new() },
        call,
    });
    for request in requests {
        let bytes = encode(&request).unwrap();
        assert_eq!(decode::<CellRequest>(&bytes).as_ref(), Ok(&request));
        // Equal numbers may differ in bits.
        assert!(encode(&decode::<CellRequest>(&bytes).unwrap()).unwrap() == bytes, "{request:?}");
        assert!(bytes.len() < MESSAGE_BYTES_MAX / 16);
    }
    for reply in replies() {
        let answer = Answer { sequence: u64::MAX, reply };
        let bytes = encode(&answer).unwrap();
        assert_eq!(decode::<Answer>(&bytes).as_ref(), Ok(&answer));
        assert!(encode(&decode::<Answer>(&bytes).unwrap()).unwrap() == bytes, "{answer:?}");
    }
    let greeting = Greeting::Refused(CellRefusal::Taken);
    assert_eq!(decode::<Greeting>(&encode(&greeting).unwrap()), Ok(greeting));
    let nan = f64::from_bits(0x7FF8_0000_0000_0123);
    let command = Command::Joints { q: JointVec::from_iter([nan]), max_speed_rad_s: nan };
    let Command::Joints { q, .. } = decode(&encode(&command).unwrap()).unwrap() else {
        panic!("another command")
    };
    assert_eq!(q.first().unwrap().to_bits(), nan.to_bits());
}

#[test]
fn what_is_not_known_is_no_message() {
    #[derive(serde::Serialize)]
    struct More<'a> {
        sequence: u64,
        call: &'a str,
        unknown: bool,
    }
    let known = encode(&More { sequence: 1, call: "scenery", unknown: true }).unwrap();
    assert!(
        matches!(decode::<CellRequest>(&known), Err(WireError::Malformed(text)) if text.contains("unknown"))
    );
    let mut bytes = encode(&hello(Role::Trial)).unwrap();
    assert_eq!(decode::<Hello>(&bytes), Ok(hello(Role::Trial)));
    bytes.push(0);
    assert!(
        matches!(decode::<Hello>(&bytes), Err(WireError::Malformed(text)) if text.contains("1 bytes follow"))
    );
}

#[test]
fn refusal_of_a_cell_comes_back_as_its_error() {
    for error in [
        CellError::file("cell.toml", "robot", "missing"),
        CellError::InvalidStart { seed: 3, problem: "out of reach".to_owned() },
        CellError::Body(BodyError::Diverged { tick: 1, what: "a joint".to_owned() }),
        CellError::Snapshot("of another robot".to_owned()),
        CellError::Unable("break on demand"),
    ] {
        assert_eq!(CellRefusal::of_cell(error.clone()).into_cell_error(), error);
    }
    let told = CellRefusal::Snapshot("red\u{1b}[31m".to_owned()).into_cell_error().to_string();
    assert!(!told.contains('\u{1b}'), "{told}");
}

proptest! {
    /// Whatever comes, reading it ends in a message or an error.
    #[test]
    fn decoder_takes_any_bytes(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let _ = decode::<CellRequest>(&bytes);
        let _ = decode::<Answer>(&bytes);
        let _ = decode::<Greeting>(&bytes);
        let _ = decode::<FactoryDescription>(&bytes);
    }

    /// A message of which a byte is changed or bytes are missing is another message, or none.
    #[test]
    fn decoder_takes_damaged_messages(
        index in 0_usize..26,
        at in 0_usize..4000,
        byte in any::<u8>(),
        cut in any::<bool>(),
    ) {
        let calls = calls();
        let call = calls[index % calls.len()].clone();
        let request = CellRequest { sequence: 1, guard: None, release: Vec::new(), call };
        let mut bytes = encode(&request).unwrap();
        let at = at % bytes.len();
        if cut {
            bytes.truncate(at);
            prop_assert!(decode::<CellRequest>(&bytes).is_err());
        } else {
            bytes[at] = byte;
            let _ = decode::<CellRequest>(&bytes);
        }
    }
}
