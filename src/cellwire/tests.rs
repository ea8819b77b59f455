//! A server and its clients over socket pairs, with the fake cell: what passes, and what is refused.

use std::os::unix::net::UnixStream;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude};
use holdpoint_body::{Body as _, BodyError, Command, GuardVerdict, Interrupt, TaskKind};
use holdpoint_cell::{
    CellCopy, CellError, CellFactory as _, EpisodeSetup, InjectedFault, RobotCell as _, StateImage,
    TrialCell, WorkCall,
};

use crate::client::{CellCallError, ClientOptions, Connect, Deadlines, Peer, WireFactory};
use crate::endpoint::{Endpoint, EndpointStream};
use crate::fake_cell::{FakeFactory, Quirk, connect_to};
use crate::framing::{Line, WireError, encode};
use crate::messages::{
    Answer, Call, CellReply, CellRequest, Greeting, Hello, MESSAGE_BYTES_MAX, PROTOCOL, RELEASED_MAX, Role,
    ServerLimits, Welcome,
};
use crate::refusal::{CellRefusal, WatchdogStop};
use crate::server::{CellServer, ServerOptions};

const SHORT: Duration = Duration::from_millis(20);
pub(crate) const LONG: Duration = Duration::from_secs(20);

fn server(quirk: Quirk) -> Arc<CellServer> {
    Arc::new(CellServer::new(Arc::new(FakeFactory::new(quirk)), ServerOptions::default()).unwrap())
}

/// A server, and what it tells.
fn telling(quirk: Quirk) -> (Arc<CellServer>, Receiver<String>) {
    let (sender, notes) = channel();
    let sender = Mutex::new(sender);
    let tell = move |text: &str| drop(sender.lock().unwrap().send(text.to_owned()));
    let options = ServerOptions { notes: Box::new(tell), ..ServerOptions::default() };
    (Arc::new(CellServer::new(Arc::new(FakeFactory::new(quirk)), options).unwrap()), notes)
}

fn factory(server: &Arc<CellServer>) -> WireFactory {
    WireFactory::over("test".to_owned(), connect_to(server), ClientOptions::lockstep()).unwrap()
}

pub(crate) fn hello(role: Role) -> Hello {
    Hello { protocol: PROTOCOL, role, session: None, watchdog_ms: None, client: "test".to_owned() }
}

fn peer(server: &Arc<CellServer>, hello: &Hello) -> Result<Peer, CellCallError> {
    Peer::greet(&connect_to(server), hello).map(|(peer, _)| peer)
}

pub(crate) fn setup(seed: u64) -> EpisodeSetup {
    let factory = FakeFactory::new(Quirk::Honest);
    let [canonical, ..] = factory.distributions().unwrap();
    EpisodeSetup::sample(TaskKind::Grasp, &factory.spec().scene, &canonical, seed)
}

pub(crate) fn joints(first: f64, second: f64, max_speed_rad_s: f64) -> Command {
    Command::Joints { q: [first, second].into_iter().collect(), max_speed_rad_s }
}

/// Every number that a cell tells, bit for bit.
fn told(cell: &mut dyn TrialCell, guard: GuardVerdict) -> Vec<u8> {
    let observation = cell.observe(guard);
    let truth = crate::messages::Truth::from(cell.true_state());
    encode(&(observation, cell.telemetry(), truth, cell.inspect(), cell.tick(), cell.stop_declared()))
        .unwrap()
}

/// A run with all that a task does; what the cell tells in every tick, and the state at the end.
fn run(cell: &mut dyn TrialCell) -> (Vec<Vec<u8>>, StateImage) {
    cell.reset(&setup(7)).unwrap();
    let mut all = Vec::new();
    let verdicts = [GuardVerdict::Allowed, GuardVerdict::Clamped, GuardVerdict::Denied];
    for tick in 0..30_u64 {
        let verdict = verdicts[usize::try_from(tick % 3).unwrap()];
        all.push(told(cell, verdict));
        match tick {
            8 => cell.begin_task(TaskKind::Align),
            12 => cell.interrupt(Interrupt::Stop),
            15 => cell.interrupt(Interrupt::Release),
            20 => cell.inject(InjectedFault::CameraLost),
            25 => cell.end_task(),
            _ => {}
        }
        let goal = if tick < 15 { joints(1.0, -1.0, 0.7) } else { joints(-0.5, 0.25, 1.3) };
        let command = if tick % 5 == 0 { goal } else { Command::Hold };
        cell.step(&command).unwrap();
    }
    all.push(told(cell, GuardVerdict::Clamped));
    let state = cell.export().unwrap();
    (all, state)
}

#[test]
fn cell_over_the_wire_tells_what_the_cell_in_the_process_tells() {
    let near = run(&mut FakeFactory::new(Quirk::Honest).cell());
    let factory = factory(&server(Quirk::Honest));
    let mut far = factory.trial().unwrap();
    assert!(run(far.as_mut()) == near, "bit for bit, with the state at the end");
    // An episode before has no effect.
    assert!(run(far.as_mut()) == near);
}

#[test]
fn description_passes_as_it_is() {
    let (near, server) = (FakeFactory::new(Quirk::Honest), server(Quirk::Honest));
    let far = factory(&server);
    assert_eq!(far.spec().digest(), near.spec().digest());
    assert_eq!(far.spec(), near.spec());
    assert_eq!((far.build_digest(), far.distributions()), ("fake-build", near.distributions()));
    let drift = Drift { kind: DriftKind::Combined, magnitude: Magnitude::Mild };
    let [canonical, ..] = near.distributions().unwrap();
    assert_eq!(far.with_drift(&canonical, &drift), near.with_drift(&canonical, &drift));
    let cell = far.trial().unwrap();
    assert_eq!((cell.fixtures(), cell.contact_points()), {
        let near = near.cell();
        (near.fixtures(), near.contact_points())
    });
}

#[test]
fn errors_of_the_cell_pass_as_they_are() {
    let factory = factory(&server(Quirk::Honest));
    let mut cell = factory.trial().unwrap();
    let mut heavy = setup(3);
    heavy.object.mass_kg = 2.0;
    let problem = "the object is too heavy".to_owned();
    assert_eq!(cell.reset(&heavy), Err(CellError::InvalidStart { seed: 3, problem }));
    let error = cell.step(&joints(f64::NAN, 0.0, 1.0)).unwrap_err();
    assert_eq!(error, BodyError::Command("a value is no number".to_owned()));
    assert!(matches!(cell.import(&StateImage::new(vec![1, 2]).unwrap()), Err(CellError::Snapshot(_))));
    // The connection stays.
    cell.reset(&setup(3)).unwrap();
    cell.step(&Command::Hold).unwrap();
    assert_eq!(cell.tick(), 1);
}

#[test]
fn film_and_observed_state_pass() {
    let factory = factory(&server(Quirk::Honest));
    let (mut cell, mut other) = (factory.trial().unwrap(), factory.trial().unwrap());
    cell.film();
    cell.reset(&setup(1)).unwrap();
    cell.step(&joints(0.5, 0.5, 1.0)).unwrap();
    cell.step(&Command::Hold).unwrap();
    let film = cell.take_film();
    assert_eq!(film.iter().map(|frame| frame.tick).collect::<Vec<_>>(), [1, 2]);
    assert_eq!(film.last().unwrap().seen, cell.telemetry());
    other.set_to(&cell.observed().unwrap()).unwrap();
    assert_eq!(other.telemetry().q, cell.telemetry().q);
}

#[test]
fn fork_continues_the_run_and_is_forgotten_when_it_is_dropped() {
    let server = server(Quirk::Honest);
    let factory = factory(&server);
    let (mut live, mut twin) = (factory.live().unwrap(), factory.trial().unwrap());
    let [canonical, ..] = factory.distributions().unwrap();
    live.await_work(&WorkCall { conditions: &canonical, seed: 5 }).unwrap();
    live.observe(GuardVerdict::Clamped);
    live.step(&joints(1.0, 1.0, 1.0)).unwrap();
    let copy = live.copy().unwrap();
    assert_eq!(copy.tick(), 1);
    assert_eq!(server.forks(), 1);
    twin.go_on_from(&copy).unwrap();
    assert_eq!(twin.export().unwrap(), live.export().unwrap());
    for _ in 0..5 {
        live.step(&Command::Hold).unwrap();
        twin.step(&Command::Hold).unwrap();
        assert_eq!(twin.telemetry(), live.telemetry());
    }
    twin.import(&live.export().unwrap()).unwrap();
    assert_eq!(twin.export().unwrap(), live.export().unwrap());
    drop(copy);
    // The next request of any cell releases it.
    twin.step(&Command::Hold).unwrap();
    assert_eq!(server.forks(), 0);
}

#[test]
fn forks_end_with_their_session() {
    let server = server(Quirk::Honest);
    let (first, second) = (factory(&server), factory(&server));
    let (mut cell, mut other) = (first.trial().unwrap(), second.trial().unwrap());
    let copy = cell.copy().unwrap();
    assert!(matches!(other.go_on_from(&copy), Err(CellError::Snapshot(_))), "it is another session's");
    let foreign = CellCopy::in_memory(3, "a state of another kind");
    assert!(matches!(cell.go_on_from(&foreign), Err(CellError::Snapshot(_))));
    cell.reset(&setup(1)).unwrap();
    // The copy keeps the session open, and no cell is left to release it.
    drop((copy, cell, first));
    let started = Instant::now();
    while server.forks() > 0 {
        assert!(started.elapsed() < LONG, "the session ended");
        std::thread::yield_now();
    }
    // A handle that was never given.
    let mut peer = peer(&server, &hello(Role::Trial)).unwrap();
    let asked = peer.ask(None, vec![77], Call::GoOnFrom { fork: 77 }, None, LONG);
    assert_eq!(asked, Err(CellCallError::Refused(CellRefusal::UnknownFork(77))));
    let many = peer.ask(None, vec![0; RELEASED_MAX + 1], Call::Scenery, None, LONG);
    assert!(matches!(many, Err(CellCallError::Refused(CellRefusal::Malformed(_)))), "{many:?}");
}

#[test]
fn hello_is_refused_by_field() {
    let server = server(Quirk::Honest);
    let refused = |hello: Hello| match peer(&server, &hello) {
        Err(CellCallError::Refused(refusal)) => refusal,
        other => panic!("{:?}", other.err()),
    };
    let newer = Hello { protocol: PROTOCOL + 1, ..hello(Role::Trial) };
    assert_eq!(refused(newer), CellRefusal::Version { server: PROTOCOL });
    for (wrong, field) in [
        (Hello { session: Some(1), ..hello(Role::Trial) }, "session"),
        (Hello { watchdog_ms: Some(100), ..hello(Role::Trial) }, "watchdog_ms"),
        (Hello { watchdog_ms: Some(1), ..hello(Role::Live) }, "watchdog_ms"),
        (Hello { client: "x".repeat(65), ..hello(Role::Control) }, "client"),
    ] {
        let refusal = refused(wrong);
        assert!(matches!(&refusal, CellRefusal::Hello { field: named, .. } if named == field), "{refusal:?}");
    }
    let live = peer(&server, &hello(Role::Live)).unwrap();
    assert_eq!(refused(hello(Role::Live)), CellRefusal::Taken);
    drop(live);
}

#[test]
fn call_of_another_role_is_refused_and_the_connection_stays() {
    let server = server(Quirk::Honest);
    let mut live = peer(&server, &hello(Role::Live)).unwrap();
    let mut control = peer(&server, &hello(Role::Control)).unwrap();
    let reset = || Call::Reset { setup: Box::new(setup(1)) };
    for (of_live, call, needs) in [
        (true, reset(), Role::Trial),
        (true, Call::TakeFilm, Role::Trial),
        (false, Call::Step { command: Command::Hold }, Role::Trial),
        (false, Call::EndTask, Role::Live),
    ] {
        let peer = if of_live { &mut live } else { &mut control };
        let asked = peer.ask(None, Vec::new(), call, None, LONG);
        assert_eq!(asked, Err(CellCallError::Refused(CellRefusal::Role { needs })));
        assert!(!peer.is_lost());
    }
    let fault = InjectedFault::JointStuck { joint: 9 };
    let asked = live.ask(None, Vec::new(), Call::Inject { fault }, None, LONG);
    assert!(
        matches!(asked, Err(CellCallError::Refused(CellRefusal::Body(BodyError::Command(_))))),
        "{asked:?}"
    );
}

#[test]
fn gap_in_the_sequence_ends_the_connection() {
    let server = server(Quirk::Honest);
    let mut peer = peer(&server, &hello(Role::Trial)).unwrap();
    let line = peer.line();
    let request = |sequence| CellRequest { sequence, guard: None, release: Vec::new(), call: Call::Scenery };
    line.send(&request(1)).unwrap();
    assert_eq!(line.receive::<Answer>(LONG).unwrap().sequence, 1);
    line.send(&request(3)).unwrap();
    let Answer { reply, .. } = line.receive(LONG).unwrap();
    assert_eq!(reply, CellReply::Refused(CellRefusal::Sequence { due: 2, came: 3 }));
    assert_eq!(line.receive::<Answer>(LONG), Err(WireError::Closed));
}

#[test]
fn bytes_that_are_no_message_end_the_connection_and_no_other() {
    let server = server(Quirk::Honest);
    let huge = u32::try_from(MESSAGE_BYTES_MAX + 1).unwrap().to_be_bytes();
    for bytes in [&[0, 0, 0, 0][..], &[0, 0, 0, 2, 0xC1, 0xC1], &huge] {
        let mut peer = peer(&server, &hello(Role::Trial)).unwrap();
        peer.line().send_bytes(bytes).unwrap();
        let Answer { reply, .. } = peer.line().receive(LONG).unwrap();
        assert!(matches!(reply, CellReply::Refused(CellRefusal::Malformed(_))), "{reply:?}");
        assert_eq!(peer.line().receive::<Answer>(LONG), Err(WireError::Closed));
    }
    factory(&server).trial().unwrap().reset(&setup(1)).unwrap();
}

#[test]
fn watchdog_stops_an_arm_that_moves_and_says_so() {
    let (server, notes) = telling(Quirk::Honest);
    let options =
        ClientOptions { watchdog_ms: Some(400), deadlines: Deadlines { step: LONG, ..Deadlines::default() } };
    let factory = WireFactory::over("test".to_owned(), connect_to(&server), options).unwrap();
    let mut live = factory.live().unwrap();
    live.step(&joints(2.0, 2.0, 0.5)).unwrap();
    // Nothing is asked until the server has reported the stop.
    let told = notes.recv_timeout(LONG).unwrap();
    assert_eq!(told, WatchdogStop { silent_ms: 400, standstill_ticks: Some(0) }.told());
    let error = live.step(&Command::Hold).unwrap_err();
    assert_eq!(error, BodyError::Lost(told));
    live.interrupt(Interrupt::Release);
    live.step(&Command::Hold).unwrap();
    let [canonical, ..] = factory.distributions().unwrap();
    live.await_work(&WorkCall { conditions: &canonical, seed: 1 }).unwrap();
    live.step(&joints(2.0, 2.0, 0.5)).unwrap();
    live.interrupt(Interrupt::Stop);
    drop(live);
    assert!(notes.try_recv().is_err(), "an arm that was stopped is not stopped again");
}

#[test]
fn arm_stops_when_its_client_is_gone() {
    let (server, notes) = telling(Quirk::Honest);
    let mut live = factory(&server).live().unwrap();
    live.step(&joints(2.0, 2.0, 0.5)).unwrap();
    drop(live);
    notes.recv_timeout(LONG).expect("the cell reports the stop");
}

#[test]
fn cell_that_lies_is_asked_nothing_more() {
    for (quirk, word) in [(Quirk::TellsNaN, "telemetry.dq"), (Quirk::SkipsTicks, "tick 2 ")] {
        let factory = factory(&server(quirk));
        let mut cell = factory.trial().unwrap();
        cell.reset(&setup(1)).unwrap();
        let error = (0..5).find_map(|_| cell.step(&Command::Hold).err()).unwrap();
        assert!(error.to_string().contains(word), "{error}");
        assert_eq!(cell.step(&Command::Hold), Err(error));
        assert!(!cell.inspect());
        assert!(cell.observe(GuardVerdict::Allowed).q.len() == 2);
    }
    for (quirk, word) in [(Quirk::TellsThreeJoints, "2 joints"), (Quirk::NamesOthers, "\"object2\"")] {
        let error = factory(&server(quirk)).trial().err().unwrap();
        assert!(error.to_string().contains(word), "{error}");
    }
}

#[test]
fn lost_cell_fails_every_tick_until_a_new_start() {
    let server = server(Quirk::Honest);
    let (closers, connect) = closing(&server);
    let factory = WireFactory::over("test".to_owned(), connect, ClientOptions::lockstep()).unwrap();
    let mut cell = factory.trial().unwrap();
    cell.reset(&setup(1)).unwrap();
    closers.lock().unwrap().last().unwrap().shutdown(std::net::Shutdown::Both).unwrap();
    let error = cell.step(&Command::Hold).unwrap_err();
    assert!(matches!(error, BodyError::Lost(_)), "{error}");
    assert!(cell.observe(GuardVerdict::Allowed).gripper_width_m.is_nan(), "nothing that a rule could pass");
    assert!(cell.step(&Command::Hold).is_err());
    cell.reset(&setup(1)).unwrap();
    cell.step(&Command::Hold).unwrap();
    // Server and session are gone, too: the start makes a new session.
    for stream in closers.lock().unwrap().iter() {
        let _ = stream.shutdown(std::net::Shutdown::Both);
    }
    assert!(cell.step(&Command::Hold).is_err());
    cell.reset(&setup(1)).unwrap();
    cell.step(&Command::Hold).unwrap();
}

/// Connections whose streams a test can close.
fn closing(server: &Arc<CellServer>) -> (Arc<Mutex<Vec<UnixStream>>>, Connect) {
    let closers: Arc<Mutex<Vec<UnixStream>>> = Arc::default();
    let (kept, server) = (Arc::clone(&closers), Arc::clone(server));
    let connect = move || -> std::io::Result<Box<dyn crate::framing::WireStream>> {
        let (own, other) = UnixStream::pair()?;
        kept.lock().unwrap().push(own.try_clone()?);
        let server = Arc::clone(&server);
        std::thread::spawn(move || server.attend(EndpointStream::Unix(other)));
        Ok(Box::new(EndpointStream::Unix(own)))
    };
    (closers, Box::new(connect))
}

#[test]
fn frozen_cell_is_given_up_at_the_deadline() {
    let (own, other) = UnixStream::pair().unwrap();
    let own = Mutex::new(Some(own));
    let connect: Connect = Box::new(move || {
        let stream = own.lock().unwrap().take().ok_or(std::io::ErrorKind::NotConnected)?;
        Ok(Box::new(EndpointStream::Unix(stream)))
    });
    // It greets, and answers nothing.
    let frozen = std::thread::spawn(move || {
        let mut line = Line::new(EndpointStream::Unix(other)).unwrap();
        line.receive_bytes(LONG).unwrap();
        let bounds = ServerLimits { message_bytes: 1, block_bytes: 1, forks: 1 };
        let (description, build) = (String::new(), String::new());
        let welcome = Welcome {
            protocol: PROTOCOL,
            session: 1,
            description,
            build,
            rate_hz: 240,
            watchdog_ms: None,
            bounds,
        };
        line.send(&Greeting::Welcome(welcome)).unwrap();
        line
    });
    let (mut peer, _) = Peer::greet(&connect, &hello(Role::Trial)).unwrap();
    let mut line = frozen.join().unwrap();
    let lost = CellCallError::Lost(WireError::Deadline { within_ms: 20 });
    assert_eq!(peer.ask(None, Vec::new(), Call::Scenery, None, SHORT), Err(lost.clone()));
    // It is not asked again, and sees that it is given up.
    assert_eq!(peer.ask(None, Vec::new(), Call::Scenery, None, LONG), Err(lost));
    assert_eq!(line.receive::<CellRequest>(LONG).unwrap().sequence, 1);
    assert_eq!(line.receive::<CellRequest>(LONG), Err(WireError::Closed));
}

#[test]
fn endpoint_is_listened_at_and_its_file_is_for_one_user() {
    use std::os::unix::fs::PermissionsExt as _;
    let path = std::env::temp_dir().join(format!("holdpoint-cellwire-{}.sock", std::process::id()));
    let endpoint = Endpoint::Unix(path.clone());
    let listener = endpoint.listen().unwrap();
    assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    assert!(endpoint.listen().is_err(), "another process listens already");
    drop(listener);
    // The file of a socket without a listener is replaced.
    let listener = endpoint.listen().unwrap();
    let server = server(Quirk::Honest);
    std::thread::spawn(move || server.run(&listener));
    let factory = WireFactory::connect(&endpoint, ClientOptions::lockstep()).unwrap();
    assert_eq!(factory.spec().robot.name, "fake");
    std::fs::remove_file(&path).unwrap();
    let error = WireFactory::connect(&endpoint, ClientOptions::lockstep()).err().unwrap();
    assert!(error.to_string().contains("holdpoint-cellwire"), "{error}");
}
