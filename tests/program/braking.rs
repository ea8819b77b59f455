//! A request that takes authority away waits for no reader, no slice and no record.
//!
//! `HOLDPOINT_BRAKES=200` measures with a version that has all its evidence. It prints the median, the 99th
//! percentile and the worst time from the request to the stop command, and to the answer, which comes when it is on
//! record.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use holdpoint::engine::live::stop_switch::StopSwitch;
use holdpoint::governance::ids::CapabilityId;
use holdpoint::governance::profile::ProfileName;
use holdpoint::protocol::command::{Command, Reply, StopPersistence};
use holdpoint::protocol::event::EventKind;
use holdpoint::registry::verify;
use holdpoint::runtime::capability;
use holdpoint::service::control_socket::Client;
use holdpoint::store::Layout;

use crate::host::{Front, operation};
use crate::quick_folder::quick_folder;
use crate::socket::{PATIENCE, client, prepared_engine};

/// The number of connections that send requests without pause.
const READERS: usize = 32;

/// The number of connections that read without pause: fewer than the limit.
const OBSERVERS: usize = 20;

/// The time from the request to the stop command.
const BRAKE_LIMIT: Duration = Duration::from_millis(250);

/// An engine on a thread of its own, whose live cell runs at the pace of a clock, and its switch.
fn start_engine(folder: &Path) -> (JoinHandle<()>, Arc<StopSwitch>) {
    prepared_engine(folder, ProfileName::Sim, |pump| {
        pump.pace_live_world(Some(1.0), Arc::new(|_| ()));
        pump.engine().switch()
    })
}

/// Connections that send requests as fast as the engine answers, until [`Readers::end`].
struct Readers {
    running: Arc<AtomicBool>,
    threads: Vec<JoinHandle<u64>>,
}

impl Readers {
    /// Starts [`READERS`] connections: each eighth verifies the audit chain, the others request a version in full.
    fn start(folder: &Path, version: &str) -> Self {
        let version: CapabilityId = version.parse().unwrap();
        Self::start_with(folder, READERS, |number| match number % 8 {
            7 => Command::VerifyAudit,
            _ => Command::Detail { version: version.clone() },
        })
    }

    fn start_with(folder: &Path, count: usize, command: impl Fn(usize) -> Command) -> Self {
        let running = Arc::new(AtomicBool::new(true));
        let reader = |number: usize| {
            let request = command(number);
            let (running, layout) = (Arc::clone(&running), Layout::new(folder));
            std::thread::spawn(move || {
                let mut answered = 0;
                let mut connection = None;
                while running.load(Ordering::Acquire) {
                    let client = connection.take().or_else(|| Client::connect(&layout).ok().flatten());
                    let Some(mut client) = client else { continue };
                    if client.send(request.clone()).is_ok() {
                        answered += 1;
                        connection = Some(client);
                    }
                }
                answered
            })
        };
        let threads = (0..count).map(reader).collect();
        Self { running, threads }
    }

    /// The number of answers.
    fn end(self) -> u64 {
        self.running.store(false, Ordering::Release);
        self.threads.into_iter().map(|thread| thread.join().unwrap()).sum()
    }
}

fn wait_until(timeout_message: &str, condition: impl Fn() -> bool) {
    let until = Instant::now() + PATIENCE;
    while !condition() {
        assert!(Instant::now() < until, "{timeout_message}");
        std::thread::park_timeout(Duration::from_millis(5));
    }
}

/// Sends a request; returns the time to the stop command, and to the answer.
fn time_request(folder: &Path, switch: &StopSwitch, command: Command) -> (Duration, Duration, Reply) {
    let mut connection = client(folder);
    wait_until("no task runs", || switch.is_at_work() && !switch.lets_nothing_work());
    let start = Instant::now();
    let reply = connection.send(command).unwrap();
    let answer_time = start.elapsed();
    let brake_time = switch.braked_at().and_then(|at| at.checked_duration_since(start));
    (brake_time.unwrap_or_else(|| panic!("the arm got no stop command: {reply:?}")), answer_time, reply)
}

fn register(folder: &Path, candidate: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests/candidates").join(candidate);
    let package = capability::read(&path).unwrap();
    let reply =
        client(folder).send(Command::Register { package, name: candidate.to_owned(), by: None }).unwrap();
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
}

/// A store in which a candidate became active, with all its evidence.
fn prepare_store(folder: &Path) {
    let mut front = Front::start(folder, None);
    register(folder, "align-improved");
    front.until(|kind| matches!(kind, EventKind::Activated { .. }));
    front.host.stop(crate::host::PATIENCE).unwrap();
}

fn copy(from: &Path, to: &Path) {
    let copied = std::process::Command::new("cp").arg("-a").arg(from.join(".")).arg(to).status().unwrap();
    assert!(copied.success());
}

/// With 31 readers a rollback once took 19 to 27 s, while the version stayed active.
#[test]
fn stop_and_rollback_wait_for_no_reader_and_no_slice() {
    let measured = std::env::var("HOLDPOINT_BRAKES").map(|text| text.parse().unwrap());
    let prepared = quick_folder();
    if measured.is_ok() {
        prepare_store(prepared.path());
    }
    let measurements = measured.clone().unwrap_or(4);
    let (mut brake_times, mut answer_times, mut reads) = (Vec::new(), Vec::new(), 0);
    while brake_times.len() < measurements {
        let folder = quick_folder();
        copy(prepared.path(), folder.path());
        let (engine, switch) = start_engine(folder.path());
        let (read_version, first_command) = if measured.is_ok() {
            ("align@1.1.0", Command::Rollback(operation("align@1.1.0")))
        } else {
            ("align@1.0.0", Command::Vacate(operation("align@1.0.0")))
        };
        // A candidate is evaluated meanwhile: slices and commits are under way.
        register(folder.path(), "grasp-improved");
        let readers = Readers::start(folder.path(), read_version);
        for command in [first_command, Command::Vacate(operation("place@1.0.0"))] {
            let (brake_time, answer_time, answer) = time_request(folder.path(), &switch, command);
            assert!(matches!(answer, Reply::Accepted { .. }), "{answer:?}");
            brake_times.push(brake_time);
            answer_times.push(answer_time);
        }
        let stop = Command::Stop { by: "ana".to_owned(), reason: "a hand".to_owned() };
        let (brake_time, answer_time, answer) = time_request(folder.path(), &switch, stop);
        assert!(
            matches!(
                answer,
                Reply::Stopped { kept: StopPersistence::OnRecord | StopPersistence::InMark, .. }
            ),
            "{answer:?}"
        );
        brake_times.push(brake_time);
        answer_times.push(answer_time);
        reads += readers.end();
        client(folder.path()).send(Command::Shutdown).unwrap();
        engine.join().unwrap();
        verify(&Layout::new(folder.path()).database(), None).unwrap();
        println!("{} of {measurements} measured", brake_times.len());
    }
    for (what, times) in [("the stop command", &mut brake_times), ("answered", &mut answer_times)] {
        times.sort_unstable();
        let percentile = |percent: usize| times[(times.len() * percent / 100).min(times.len() - 1)];
        println!(
            "{what}: median {:?}, p99 {:?}, worst {:?} of {}; {reads} questions answered meanwhile",
            percentile(50),
            percentile(99),
            percentile(100),
            times.len()
        );
    }
    let p99 = brake_times[(brake_times.len() * 99 / 100).min(brake_times.len() - 1)];
    assert!(p99 <= BRAKE_LIMIT, "{brake_times:?}");
    assert!(reads > 0, "no reader was active");
}

/// Connections that requested the snapshot without pause once had every other request refused.
#[test]
fn constant_snapshot_requests_block_no_other_request() {
    let folder = quick_folder();
    let (engine, _) = start_engine(folder.path());
    register(folder.path(), "grasp-improved");
    let readers = Readers::start_with(folder.path(), OBSERVERS, |_| Command::Snapshot);
    for number in 0..20 {
        let (by, text) = ("ana".to_owned(), format!("note {number}"));
        let reply = client(folder.path()).send(Command::Note { by, text }).unwrap();
        assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    }
    assert!(readers.end() > 0);
    client(folder.path()).send(Command::Shutdown).unwrap();
    engine.join().unwrap();
}
