//! Faults of a served cell. Within a sequence the arm comes to a standstill, the engine is stopped with an alarm, a person
//! starts the cell again, and nothing is lost. Prints a table of the times. Within a sandbox nothing is decided: the engine
//! is on hold, and the next one runs the sandbox again.
//!
//! The cell is a process of its own. A relay at the socket makes the fault at a moment at which the arm of the second task
//! moves, so that no time is waited for.

use std::io::{self, Read as _, Write as _};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Command as Process, Output};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use holdpoint::body::RATE_HZ;
use holdpoint::cells::PACED_CELLS;
use holdpoint::governance::alarms::AlarmState;
use holdpoint::governance::lifecycle::{Stage, State};
use holdpoint::governance::profile::ProfileName;
use holdpoint::governance::record::RecordKind;
use holdpoint::protocol::command::Command;
use holdpoint::protocol::event::{Event, EventKind};
use holdpoint::registry::Views;
use holdpoint::runtime::capability;
use holdpoint::service::engine_handle::LaunchConfig;
use holdpoint::store::{AuditFilter, Layout};
use holdpoint::trials::seeds::EpisodeSeeds;
use holdpoint::trials::site::LoadedSite;
use holdpoint_cellwire::client::ClientOptions;
use holdpoint_cellwire::framing::{decode, encode};
use holdpoint_cellwire::messages::{Answer, Call, CellReply, CellRequest, CellState, Greeting, Hello, Role};
use rustix::process::Signal;
use serde_json::Value;

use crate::cell_process::{CellProcess, site_at};
use crate::host::{Front, PATIENCE};
use crate::stop::{STANDSTILL_TICKS_MAX, assert_accepted};

/// What a busy machine may add to a declared time.
const SLACK: Duration = Duration::from_secs(1);

/// The same until a client has the engine's event: recorded, flushed and sent. After a cut it took .85 s with the machine to
/// itself, in a build without optimization, and 1.5 s at a load of 14 on two cores.
const EVENT_SLACK: Duration = Duration::from_secs(3);

/// A joint that is faster moves, rad/s; and for how many ticks without a pause.
const MOVES_RAD_S: f64 = 0.05;
const MOVES_TICKS: u32 = 12;

/// The faults, in the order in which one engine meets them.
const FAULTS: [Fault; 6] =
    [Fault::NotANumber, Fault::Cut, Fault::Slowed, Fault::Frozen, Fault::AnotherCell, Fault::Killed];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    /// An observation has a value that is no number.
    NotANumber,
    /// The connection is cut.
    Cut,
    /// Every answer comes later than client and watchdog wait.
    Slowed,
    /// The process is stopped by a signal.
    Frozen,
    /// The connection is cut, and at the next one the cell has another description.
    AnotherCell,
    /// The process is killed.
    Killed,
}

impl Fault {
    const fn name(self) -> &'static str {
        match self {
            Self::NotANumber => "NaN in an observation",
            Self::Cut => "connection cut",
            Self::Slowed => "answers slowed",
            Self::Frozen => "process frozen",
            Self::AnotherCell => "another description",
            Self::Killed => "process killed",
        }
    }

    /// What the reason of the stop says.
    const fn reason(self) -> &'static str {
        match self {
            Self::NotANumber => "observation.q",
            Self::Cut | Self::AnotherCell | Self::Killed => "connection was closed",
            Self::Slowed | Self::Frozen => "no answer within 250 ms",
        }
    }

    /// As [`Fault::reason`], for a trial cell, which is waited for longer.
    const fn trial_reason(self) -> &'static str {
        match self {
            Self::Slowed | Self::Frozen => "no answer within",
            Self::NotANumber | Self::Cut | Self::AnotherCell | Self::Killed => self.reason(),
        }
    }

    /// How long the client waits before it knows.
    fn known_within(self) -> Duration {
        let deadline = ClientOptions::paced().deadlines.step;
        if matches!(self, Self::Slowed | Self::Frozen) { deadline } else { Duration::ZERO }
    }
}

/// How long the cell waits before it stops its arm.
fn watchdog() -> Duration {
    Duration::from_millis(u64::from(ClientOptions::paced().watchdog_ms.unwrap()))
}

/// What the relay is to do.
#[derive(Default)]
struct Orders {
    fault: Option<(Role, Fault)>,
    /// Whether the description is another one.
    lies: bool,
}

/// Passes on what passes between an engine and a served cell, and makes the faults.
struct Relay {
    cell: PathBuf,
    process: Arc<Mutex<CellProcess>>,
    orders: Mutex<Orders>,
    fired: Mutex<Sender<Instant>>,
    /// A late answer may pass.
    late: Mutex<Receiver<()>>,
    /// The end of each connection of the live cell.
    ended: Mutex<Sender<()>>,
}

/// A connection, as the relay remembers it.
struct Link {
    role: Role,
    /// Tasks that began since the work was presented.
    tasks: u32,
    /// For each joint, for how many ticks it has moved without a pause, with the sign of its speed.
    moves: Vec<(bool, u32)>,
    is_slowed: bool,
}

fn receive(stream: &mut UnixStream) -> io::Result<Vec<u8>> {
    let mut head = [0; 4];
    stream.read_exact(&mut head)?;
    let mut bytes = vec![0; usize::try_from(u32::from_be_bytes(head)).unwrap()];
    stream.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn send(stream: &mut UnixStream, bytes: &[u8]) -> io::Result<()> {
    let head = u32::try_from(bytes.len()).unwrap().to_be_bytes();
    stream.write_all(&[&head[..], bytes].concat())
}

/// Passes as many bytes on as a block has.
fn pass_block(from: &mut UnixStream, to: &mut UnixStream, bytes: u64) -> io::Result<()> {
    let mut passed = 0;
    while passed < bytes {
        let part = receive(from)?;
        passed += part.len() as u64;
        send(to, &part)?;
    }
    Ok(())
}

impl Link {
    fn asked(&mut self, request: &CellRequest) {
        match request.call {
            Call::AwaitWork { .. } => self.tasks = 0,
            Call::BeginTask { .. } => self.tasks += 1,
            _ => {}
        }
    }

    /// Whether the arm of the second task moves.
    fn is_under_way(&mut self, seen: &CellState) -> bool {
        let speeds = &seen.telemetry.dq;
        self.moves.resize(speeds.len(), (false, 0));
        for (moves, speed) in self.moves.iter_mut().zip(speeds) {
            let goes_on = speed.abs() > MOVES_RAD_S && (moves.1 == 0 || moves.0 == speed.is_sign_positive());
            *moves = (speed.is_sign_positive(), if goes_on { moves.1 + 1 } else { 0 });
        }
        self.tasks == 2 && self.moves.iter().any(|moves| moves.1 >= MOVES_TICKS)
    }
}

impl Relay {
    /// Listens at `front` for ever, for the cell of this process.
    fn listen(self: Arc<Self>, front: &Path) {
        let listener = UnixListener::bind(front).unwrap();
        thread::spawn(move || {
            for client in listener.incoming() {
                let (client, relay) = (client.unwrap(), Arc::clone(&self));
                thread::spawn(move || relay.attend(client));
            }
        });
    }

    fn attend(&self, mut client: UnixStream) {
        let Ok(mut cell) = UnixStream::connect(&self.cell) else { return };
        let mut link = Link { role: Role::Control, tasks: 0, moves: Vec::new(), is_slowed: false };
        // A connection that fails on one side ends on both.
        let _ = self.pass(&mut link, &mut client, &mut cell);
        for stream in [&client, &cell] {
            let _ = stream.shutdown(Shutdown::Both);
        }
        if link.role == Role::Live {
            let _ = self.ended.lock().unwrap().send(());
        }
    }

    fn pass(&self, link: &mut Link, client: &mut UnixStream, cell: &mut UnixStream) -> io::Result<()> {
        self.greet(link, client, cell)?;
        loop {
            self.exchange(link, client, cell)?;
        }
    }

    fn greet(&self, link: &mut Link, client: &mut UnixStream, cell: &mut UnixStream) -> io::Result<()> {
        let bytes = receive(client)?;
        link.role = decode::<Hello>(&bytes).unwrap().role;
        send(cell, &bytes)?;
        let mut greeting: Greeting = decode(&receive(cell)?).unwrap();
        if let Greeting::Welcome(welcome) = &mut greeting
            && self.orders.lock().unwrap().lies
        {
            welcome.description = "0".repeat(64);
        }
        send(client, &encode(&greeting).unwrap())
    }

    fn exchange(&self, link: &mut Link, client: &mut UnixStream, cell: &mut UnixStream) -> io::Result<()> {
        let bytes = receive(client)?;
        let request: CellRequest = decode(&bytes).unwrap();
        link.asked(&request);
        send(cell, &bytes)?;
        if let Call::Import { image } = &request.call {
            pass_block(client, cell, image.bytes)?;
        }
        let mut answer: Answer = decode(&receive(cell)?).unwrap();
        if let CellReply::Seen(seen) = &mut answer.reply {
            self.look_at(link, &request, seen)?;
        }
        if link.is_slowed {
            self.late.lock().unwrap().recv().map_err(|_| io::ErrorKind::ConnectionAborted)?;
        }
        send(client, &encode(&answer).unwrap())?;
        if let CellReply::Block(block) = &answer.reply {
            pass_block(cell, client, block.bytes)?;
        }
        Ok(())
    }

    /// Makes the fault that is ordered for the connection: in a live cell once its arm moves, in a trial cell at its next
    /// tick.
    fn look_at(&self, link: &mut Link, request: &CellRequest, seen: &mut CellState) -> io::Result<()> {
        let is_step = matches!(request.call, Call::Step { .. });
        if !(is_step && (link.role == Role::Trial || link.is_under_way(seen))) {
            return Ok(());
        }
        let Some(observation) = &mut seen.observation else { return Ok(()) };
        let ordered = self.orders.lock().unwrap().fault.take_if(|(role, _)| *role == link.role);
        let Some((_, fault)) = ordered else { return Ok(()) };
        self.fired.lock().unwrap().send(Instant::now()).unwrap();
        match fault {
            Fault::NotANumber => observation.q[0] = f64::NAN,
            Fault::Slowed => link.is_slowed = true,
            Fault::Frozen => self.process.lock().unwrap().signal(Signal::STOP),
            Fault::Killed => self.process.lock().unwrap().signal(Signal::KILL),
            Fault::AnotherCell => {
                self.orders.lock().unwrap().lies = true;
                return Err(io::ErrorKind::ConnectionAborted.into());
            }
            Fault::Cut => return Err(io::ErrorKind::ConnectionAborted.into()),
        }
        Ok(())
    }
}

/// A line of the table.
struct Row {
    fault: &'static str,
    /// From the fault to the standstill; absent where the arm ended with its process.
    standstill_ms: Option<u128>,
    stopped_ms: u128,
}

/// An engine at a site whose cells are those of a process, with the relay between them.
struct FaultyCell {
    front: Front,
    folder: PathBuf,
    process: Arc<Mutex<CellProcess>>,
    relay: Arc<Relay>,
    fired: Receiver<Instant>,
    late: Sender<()>,
    ended: Receiver<()>,
    /// All events so far.
    told: Vec<Event>,
}

impl FaultyCell {
    fn start(folder: &Path, store: &Path) -> Self {
        let process = Arc::new(Mutex::new(CellProcess::in_folder(folder)));
        let (fired_sender, fired) = channel();
        let (late, late_receiver) = channel();
        let (ended_sender, ended) = channel();
        let relay = Arc::new(Relay {
            cell: folder.join("cell.sock"),
            process: Arc::clone(&process),
            orders: Mutex::default(),
            fired: Mutex::new(fired_sender),
            late: Mutex::new(late_receiver),
            ended: Mutex::new(ended_sender),
        });
        let endpoint = folder.join("relay.sock");
        Arc::clone(&relay).listen(&endpoint);
        let site = site_at(folder, &format!("unix:{}", endpoint.display()));
        let front = start_engine(&site, store);
        Self { front, folder: folder.to_owned(), process, relay, fired, late, ended, told: Vec::new() }
    }

    /// Only what comes from now on is looked at.
    fn forget_events(&mut self) {
        self.told.append(&mut self.front.events);
    }

    /// Waits until the engine has stopped the cell for this reason, with an alarm.
    fn until_stopped(&mut self, reason: &str) {
        self.front.until(|kind| matches!(kind, EventKind::CellStopped { by, .. } if by == "the engine"));
        let stopped = self.front.snapshot().stopped.unwrap();
        assert!(stopped.by == "the engine" && stopped.reason.contains(reason), "{reason}: {stopped:?}");
        let is_raised = |kind: &EventKind| {
            let EventKind::Alarm { alarm, state, .. } = kind else { return false };
            alarm == "cell-lost" && *state == AlarmState::Unacknowledged
        };
        self.front.until(is_raised);
    }

    /// A person starts the cell again; it works a whole sequence.
    fn start_again(&mut self) {
        self.start_cell();
        self.front.until(|kind| matches!(kind, EventKind::Sequence { success: true, .. }));
        assert_eq!(self.front.snapshot().stopped, None);
        self.forget_events();
    }

    fn start_cell(&mut self) {
        self.forget_events();
        assert_accepted(&self.front.go());
    }

    /// When the arm was at standstill, by the cell's own note: the note came, and the brake took this many ticks.
    fn standstill(&self, since: Instant) -> Instant {
        let process = self.process.lock().unwrap();
        let (at, ticks) = loop {
            let (at, note) = process.notes.recv_timeout(PATIENCE).unwrap();
            let after = note.split_once("it stood still ").and_then(|(_, rest)| rest.split_once(" ticks"));
            if let Some(ticks) = after.and_then(|(ticks, _)| ticks.parse::<u64>().ok()) {
                break (at, ticks);
            }
        };
        assert!(ticks <= STANDSTILL_TICKS_MAX, "{ticks} ticks");
        assert!(at - since <= watchdog() + SLACK, "{:?}", at - since);
        at + Duration::from_millis(ticks * 1000 / u64::from(RATE_HZ))
    }

    /// One fault, from the moment that it happens until a person has started the cell.
    fn meet(&mut self, fault: Fault) -> Row {
        while self.ended.try_recv().is_ok() {}
        self.relay.orders.lock().unwrap().fault = Some((Role::Live, fault));
        let fired = self.fired.recv_timeout(PATIENCE).unwrap();
        self.until_stopped(fault.reason());
        let stopped_after = fired.elapsed();
        assert!(stopped_after <= fault.known_within() + EVENT_SLACK, "{fault:?}: {stopped_after:?}");
        let (last, sequence) = self.last_sequence();
        assert!(
            sequence.len() == 2 && sequence[0] && !sequence[1],
            "{fault:?}: sequence {last}: {sequence:?}"
        );
        let mut since = fired;
        if fault == Fault::Frozen {
            // What is frozen stops nothing; neither does its simulated arm move. The cell stops its arm once it runs.
            since = Instant::now();
            self.process.lock().unwrap().signal(Signal::CONT);
        }
        let standstill = (fault != Fault::Killed).then(|| self.standstill(since) - fired);
        if fault == Fault::Slowed {
            self.late.send(()).unwrap();
        }
        // The live cell of this connection is free again.
        self.ended.recv_timeout(PATIENCE).unwrap();
        match fault {
            Fault::Killed => {
                let again = CellProcess::in_folder(&self.folder);
                *self.process.lock().unwrap() = again;
            }
            Fault::AnotherCell => {
                self.start_cell();
                self.until_stopped("its description is another than at the start");
                self.relay.orders.lock().unwrap().lies = false;
            }
            Fault::NotANumber | Fault::Cut | Fault::Slowed | Fault::Frozen => {}
        }
        self.start_again();
        Row {
            fault: fault.name(),
            standstill_ms: standstill.map(|time| time.as_millis()),
            stopped_ms: stopped_after.as_millis(),
        }
    }

    /// The sequence that ended last: its number, and for each of its tasks whether it was done.
    fn last_sequence(&self) -> (u64, Vec<bool>) {
        let ended = self.front.events.iter().rev().find_map(|event| match &event.kind {
            EventKind::Sequence { index, tasks, .. } => {
                Some((*index, tasks.iter().map(|task| task.success).collect()))
            }
            _ => None,
        });
        ended.unwrap()
    }
}

/// An engine whose caller works the trials, so that a fault of a trial cell is known before one of the live cell.
fn start_engine(site: &str, store: &Path) -> Front {
    Front::start_at(LaunchConfig {
        data: store.to_owned(),
        profile: ProfileName::Sim.into(),
        seeds: EpisodeSeeds::OfRun(1),
        jobs: 1,
        cells: Arc::new(PACED_CELLS),
        robot: None,
        site: Some(Arc::new(LoadedSite::read(Path::new(site)).unwrap())),
        pace: None,
        sinks: Vec::new(),
        alone_max: None,
        console_access: None,
    })
}

fn holdpoint(arguments: &[&str], store: &Path) -> Output {
    let mut program = Process::new(env!("CARGO_BIN_EXE_holdpoint"));
    program.args(arguments).arg("--data").arg(store).output().unwrap()
}

fn bodies(store: &Path, kind: RecordKind) -> Vec<Value> {
    let filter = AuditFilter { kind: Some(kind), ..AuditFilter::default() };
    let rows = Views::open(&Layout::new(store).database()).unwrap().audit(&filter).unwrap();
    rows.iter().map(|record| serde_json::from_str(&record.body).unwrap()).collect()
}

#[test]
fn a_faulty_cell_stands_and_the_engine_stops_with_an_alarm_until_a_person_starts_it() {
    let root = tempfile::tempdir().unwrap();
    let store = root.path().join("store");
    let mut cell = FaultyCell::start(root.path(), &store);
    let rows: Vec<Row> = FAULTS.into_iter().map(|fault| cell.meet(fault)).collect();
    println!("fault, standstill ms, stopped ms, alarm code, engine state");
    for Row { fault, standstill_ms, stopped_ms } in &rows {
        let standstill = standstill_ms.map_or_else(|| "-".to_owned(), |ms| ms.to_string());
        println!("{fault}, {standstill}, {stopped_ms}, cell-lost, stopped");
    }
    cell.forget_events();
    let indexes: Vec<u64> = cell
        .told
        .iter()
        .filter_map(|event| match event.kind {
            EventKind::Sequence { index, .. } => Some(index),
            _ => None,
        })
        .collect();
    let count = indexes.len() as u64;
    assert_eq!(indexes, (0..count).collect::<Vec<_>>(), "no sequence is missing");
    cell.front.host.stop(PATIENCE).unwrap();
    // The cell that lies is stopped twice: for the lost connection, and for its description.
    let stops = bodies(&store, RecordKind::CellStopped);
    let releases = bodies(&store, RecordKind::CellReleased);
    assert_eq!((stops.len(), releases.len()), (FAULTS.len() + 1, FAULTS.len() + 1), "{stops:?}");
    assert!(stops.iter().all(|stop| stop["by"] == "the engine"), "{stops:?}");
    assert!(releases.iter().all(|release| release["by"] == "ana"), "{releases:?}");
    let ends = bodies(&store, RecordKind::EngineEnded);
    assert!(ends.iter().all(|end| end["orderly"] == true), "{ends:?}");
    let verified = holdpoint(&["audit", "verify"], &store);
    assert!(verified.status.success(), "{}", String::from_utf8_lossy(&verified.stdout));
}

#[test]
fn a_trial_cell_lost_in_a_sandbox_decides_nothing_and_the_next_engine_runs_it_again() {
    let root = tempfile::tempdir().unwrap();
    let store = root.path().join("store");
    let mut cell = FaultyCell::start(root.path(), &store);
    let site = root.path().join("site.toml").display().to_string();
    let candidate = Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests/candidates/align-improved");
    let package = capability::read(&candidate).unwrap();
    let name = "align-improved".to_owned();
    assert_accepted(&cell.front.carry_out(Command::Register { package, name, by: None }));
    for fault in FAULTS {
        cell.front.until(|kind| matches!(kind, EventKind::StageStarted { stage: Stage::Sandbox, .. }));
        while cell.ended.try_recv().is_ok() {}
        cell.relay.orders.lock().unwrap().fault = Some((Role::Trial, fault));
        cell.fired.recv_timeout(PATIENCE).unwrap();
        cell.front.until(|kind| matches!(kind, EventKind::Fault { .. }));
        let snapshot = cell.front.snapshot();
        let why = snapshot.holding.unwrap();
        assert!(why.contains(fault.trial_reason()), "{fault:?}: {why}");
        let alarm = snapshot.alarms.iter().find(|alarm| alarm.alarm == "engine-fault").unwrap();
        assert_eq!(alarm.state, AlarmState::Unacknowledged, "{fault:?}");
        match fault {
            Fault::Frozen => cell.process.lock().unwrap().signal(Signal::CONT),
            Fault::Slowed => cell.late.send(()).unwrap(),
            Fault::NotANumber | Fault::Cut | Fault::AnotherCell | Fault::Killed => {}
        }
        let is_decided = |event: &Event| {
            matches!(event.kind, EventKind::StateChanged { to: State::Sandboxed | State::Rejected, .. })
        };
        assert!(!cell.front.events.iter().any(is_decided), "{fault:?}: {:?}", cell.front.events);
        cell.front.host.stop(PATIENCE).unwrap();
        // The live cell is free for the next engine.
        cell.ended.recv_timeout(PATIENCE).unwrap();
        if fault == Fault::Killed {
            let again = CellProcess::in_folder(root.path());
            *cell.process.lock().unwrap() = again;
        }
        if fault == Fault::AnotherCell {
            let refused = holdpoint(&["site", "check", &site], Path::new("/nowhere"));
            let told = String::from_utf8_lossy(&refused.stderr);
            assert!(!refused.status.success() && told.contains("description"), "{told}");
            cell.relay.orders.lock().unwrap().lies = false;
        }
        cell.front = start_engine(&site, &store);
    }
    let is_further =
        |kind: &EventKind| matches!(kind, EventKind::Progress { stage: Stage::Sandbox, done: 1.., .. });
    cell.front.until(is_further);
    cell.front.host.stop(PATIENCE).unwrap();
    let verified = holdpoint(&["audit", "verify"], &store);
    assert!(verified.status.success(), "{}", String::from_utf8_lossy(&verified.stdout));
}
