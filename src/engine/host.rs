//! The engine on a thread of its own, for a front end in the same process.
//!
//! Requests go in through a bounded queue and are never waited for; what happened comes out through a bounded one,
//! of which a slow reader loses events and is told how many, but never an answer. Snapshots and pictures are the
//! newest ones only. The engine never waits for the front end, and a front end that is gone ends it: it approves
//! nothing alone.
//!
//! A panic on the engine's thread does not end the process: the pipeline holds with a latched alarm, and the host
//! goes on answering.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use holdpoint_sim::robot::RobotModel;
use tokio::sync::{mpsc, watch};

use super::command::{Command, Reply, Request};
use super::door::Door;
use super::event::Event;
use super::picture::Picture;
use super::snapshot::Snapshot;
use super::{Config, Engine, service};
use crate::governance::profile::ProfileName;
use crate::pipeline::cache::EpisodeCache;
use crate::pipeline::cell::Cell;
use crate::pipeline::manager::Progress;
use crate::pipeline::pacer::Switch;
use crate::registry::Layout;

/// The most requests that are on their way or not yet answered.
pub const OUTSTANDING_MAX: usize = 64;

/// The most updates that wait for the front end.
pub const UPDATES_MAX: usize = 256;

/// Least time between two snapshots, but for those after an answer.
const SNAPSHOT_EVERY: Duration = Duration::from_millis(50);

/// How long an idle engine waits for a request before it looks at its clock, its socket and the live world.
const PAUSE_MAX: Duration = Duration::from_millis(15);

/// How long it waits while the arm is being stopped.
const PAUSE_STOPPING: Duration = Duration::from_millis(2);

/// By how much evaluation stands back behind the front end's thread.
const NICE: i32 = 5;

/// What a host is started with.
#[derive(Clone, Debug)]
pub struct HostConfig {
    /// The store's folder.
    pub data: PathBuf,
    /// The profile.
    pub profile: ProfileName,
    /// The run's seed.
    pub seed: u64,
    /// Workers for evaluation; 0 for one fewer than there are cores.
    pub jobs: usize,
    /// The robot's URDF file; absent for the built-in arm.
    pub robot: Option<PathBuf>,
    /// Simulated seconds of the live world in a second; absent for as fast as it computes.
    pub pace: Option<f64>,
}

impl HostConfig {
    /// Workers: what was asked for, else one fewer than there are cores, so that the front end stays quick.
    #[must_use]
    pub fn workers(&self) -> usize {
        let spare = || std::thread::available_parallelism().map_or(1, usize::from).saturating_sub(1);
        if self.jobs == 0 { spare().max(1) } else { self.jobs }
    }
}

/// What the engine's thread tells.
#[derive(Debug)]
pub enum Update {
    /// The engine is up.
    Started,
    /// What happened, in order.
    Events(Vec<Event>),
    /// The answer to a request.
    Answer {
        /// The request's id.
        id: String,
        /// What was answered.
        reply: Reply,
    },
    /// The front end was too slow: so many events were not told.
    Lagged {
        /// How many.
        missed: u64,
    },
    /// The engine has ended; nothing comes after it.
    Ended(Result<(), String>),
}

/// A request that was not taken: too many are under way, or the engine has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the engine is busy: {OUTSTANDING_MAX} requests wait already, or it has ended")]
pub struct Busy;

/// An engine that did not end in time.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StopError {
    /// It is still at work; it ends by itself later, and approves nothing.
    #[error("the engine did not end within {0:?}")]
    Late(Duration),
    /// It ended with an error.
    #[error("{0}")]
    Failed(String),
}

/// A running engine. Dropping it ends the engine in an orderly way, without waiting for that.
pub struct Host {
    requests: SyncSender<Request>,
    outstanding: Arc<AtomicUsize>,
    switch: Arc<OnceLock<Arc<Switch>>>,
    /// What happened; bounded, see [`UPDATES_MAX`].
    pub updates: mpsc::Receiver<Update>,
    /// How things stand; absent until the engine is up.
    pub snapshots: watch::Receiver<Option<Arc<Snapshot>>>,
    /// What the live cell looks like; absent until it has moved.
    pub pictures: watch::Receiver<Option<Arc<Picture>>>,
    layout: Layout,
    thread: Option<JoinHandle<Result<(), String>>>,
}

impl Host {
    /// Starts the thread and returns at once. Whether the engine came up is told by [`Update::Started`] or
    /// [`Update::Ended`].
    #[must_use]
    pub fn start(config: HostConfig) -> Self {
        let (requests, asked) = sync_channel(OUTSTANDING_MAX);
        let (told, updates) = mpsc::channel(UPDATES_MAX);
        let (snapshot, snapshots) = watch::channel(None);
        let (picture, pictures) = watch::channel(None);
        let outstanding = Arc::new(AtomicUsize::new(0));
        let switch = Arc::new(OnceLock::new());
        let layout = Layout::new(config.data.clone());
        let outlet = Outlet {
            updates: told,
            snapshot,
            outstanding: Arc::clone(&outstanding),
            answers: VecDeque::new(),
            missed: 0,
            changed: true,
            published: None,
        };
        let shared = Arc::clone(&switch);
        let work = move || run(&config, &asked, outlet, picture, &shared);
        let thread = std::thread::Builder::new().name("engine".to_owned()).spawn(work).ok();
        Self { requests, outstanding, switch, updates, snapshots, pictures, layout, thread }
    }

    /// Hands a request over. Its answer comes as [`Update::Answer`]. Never waits; an operator's abort stops the arm
    /// here and now, before the engine has read it.
    ///
    /// # Errors
    /// [`Busy`]; nothing was handed over then.
    pub fn ask(&self, request: Request) -> Result<(), Busy> {
        let stops = request.command.stops_the_arm();
        let take = |count: usize| (count < OUTSTANDING_MAX).then_some(count + 1);
        self.outstanding.fetch_update(Ordering::AcqRel, Ordering::Acquire, take).map_err(|_| Busy)?;
        if let Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) = self.requests.try_send(request) {
            self.outstanding.fetch_sub(1, Ordering::AcqRel);
            return Err(Busy);
        }
        if stops && let Some(switch) = self.switch.get() {
            switch.stop();
        }
        Ok(())
    }

    /// The folder of the store's identities.
    #[must_use]
    pub fn identities(&self) -> PathBuf {
        self.layout.identities()
    }

    /// Ends the engine in an orderly way: the arm is stopped, nothing is approved or activated.
    ///
    /// # Errors
    /// [`StopError`] where it takes longer than `patience`, or ended with an error.
    pub fn stop(mut self, patience: Duration) -> Result<(), StopError> {
        let until = Instant::now() + patience;
        // A queue that is full is closed below, which ends the engine as well.
        let _ = self.ask(Request { id: "host-stop".to_owned(), command: Command::Shutdown });
        let Some(thread) = self.thread.take() else { return Ok(()) };
        let (closed, _) = sync_channel(0);
        drop(std::mem::replace(&mut self.requests, closed));
        while !thread.is_finished() {
            if Instant::now() >= until {
                return Err(StopError::Late(patience));
            }
            // What still comes is not read by anybody.
            while self.updates.try_recv().is_ok() {}
            std::thread::sleep(Duration::from_millis(2));
        }
        match thread.join() {
            Ok(Ok(())) => Ok(()),
            Ok(Err(text)) => Err(StopError::Failed(text)),
            Err(_) => Err(StopError::Failed("the engine's thread failed".to_owned())),
        }
    }
}

/// The engine's side of the channels.
struct Outlet {
    updates: mpsc::Sender<Update>,
    snapshot: watch::Sender<Option<Arc<Snapshot>>>,
    outstanding: Arc<AtomicUsize>,
    answers: VecDeque<(String, Reply)>,
    missed: u64,
    changed: bool,
    published: Option<Instant>,
}

impl Outlet {
    /// Tells events; those that do not fit are counted. Room for every answer is kept.
    fn tell(&mut self, events: Vec<Event>) {
        if events.is_empty() {
            return;
        }
        self.changed = true;
        let count = events.len() as u64;
        if self.updates.capacity() <= OUTSTANDING_MAX + 2 {
            self.missed = self.missed.saturating_add(count);
            return;
        }
        self.tell_missed();
        if self.updates.try_send(Update::Events(events)).is_err() {
            self.missed = self.missed.saturating_add(count);
        }
    }

    fn tell_missed(&mut self) {
        if self.missed > 0
            && self.updates.capacity() > OUTSTANDING_MAX
            && self.updates.try_send(Update::Lagged { missed: self.missed }).is_ok()
        {
            self.missed = 0;
        }
    }

    fn answer(&mut self, id: String, reply: Reply) {
        self.changed = true;
        self.published = None;
        self.answers.push_back((id, reply));
        self.flush();
    }

    /// Sends what waits. An answer that does not fit yet waits here; there are never more than were asked for.
    fn flush(&mut self) {
        while let Some((id, reply)) = self.answers.pop_front() {
            match self.updates.try_send(Update::Answer { id, reply }) {
                Ok(()) => {
                    self.outstanding.fetch_sub(1, Ordering::AcqRel);
                }
                Err(mpsc::error::TrySendError::Full(Update::Answer { id, reply })) => {
                    self.answers.push_front((id, reply));
                    break;
                }
                Err(_) => break,
            }
        }
        self.tell_missed();
    }

    /// Publishes a snapshot where something changed, at most some twenty a second.
    fn publish(&mut self, engine: &Engine) {
        let due = self.published.is_none_or(|published| published.elapsed() >= SNAPSHOT_EVERY);
        if self.changed && due {
            self.snapshot.send_replace(Some(Arc::new(engine.snapshot())));
            self.changed = false;
            self.published = Some(Instant::now());
        }
    }

    /// Nobody looks any more.
    fn is_lost(&self) -> bool {
        self.updates.is_closed()
    }
}

/// The engine's thread.
fn run(
    config: &HostConfig,
    asked: &Receiver<Request>,
    mut outlet: Outlet,
    picture: watch::Sender<Option<Arc<Picture>>>,
    switch: &OnceLock<Arc<Switch>>,
) -> Result<(), String> {
    // Threads that are started from here inherit it. Where it is refused, evaluation is only less modest.
    let _ = rustix::process::nice(NICE);
    let started = catch_unwind(AssertUnwindSafe(|| start(config, picture)));
    let started = started.unwrap_or_else(|panic| Err(format!("the start failed: {}", said(&*panic))));
    let ended = match started {
        Ok((engine, door)) => {
            if let Some(own) = engine.switch() {
                // Set once, here.
                drop(switch.set(own));
            }
            // A full queue of a front end that does not read yet is no error.
            drop(outlet.updates.try_send(Update::Started));
            Serving { engine, door, asked, waiting: Vec::new(), trial: Trial::new() }.run(&mut outlet);
            Ok(())
        }
        Err(text) => Err(text),
    };
    outlet.flush();
    drop(outlet.updates.try_send(Update::Ended(ended.clone())));
    ended
}

fn start(
    config: &HostConfig,
    picture: watch::Sender<Option<Arc<Picture>>>,
) -> Result<(Engine, Door), String> {
    let model = match &config.robot {
        None => RobotModel::builtin("arm7"),
        Some(path) => RobotModel::load(path),
    };
    let mut engine = Engine::start(Config {
        data: &config.data,
        profile: config.profile,
        seed: config.seed,
        jobs: config.workers(),
        scripted: false,
        cell: model.and_then(Cell::new).map_err(|error| error.to_string())?,
        cache: EpisodeCache::InStore,
    })
    .map_err(|error| error.to_string())?;
    let easel = move |taken: Picture| {
        picture.send_replace(Some(Arc::new(taken)));
    };
    engine.pace_live_world(config.pace, Arc::new(easel));
    let door = service::open(&engine).map_err(|error| error.to_string())?;
    Ok((engine, door))
}

/// The loop: requests between slices, from the front end and from the socket.
struct Serving<'a> {
    engine: Engine,
    door: Door,
    asked: &'a Receiver<Request>,
    /// Requests whose answer comes after the sequence that runs.
    waiting: Vec<String>,
    trial: Trial,
}

impl Serving<'_> {
    fn run(&mut self, outlet: &mut Outlet) {
        let mut next = None;
        loop {
            let lost = self.requests(next.take(), outlet);
            if (lost || outlet.is_lost()) && !self.engine.has_ended() {
                self.guarded("an end", |serving| {
                    serving
                        .engine
                        .submit(Request { id: "front-end-lost".to_owned(), command: Command::Shutdown });
                });
                if !self.engine.has_ended() {
                    // Even the end failed: what is on disk is whole, and nothing more is begun.
                    return;
                }
            }
            let mut progress = Progress::Worked;
            self.guarded("a slice", |serving| {
                serving.trial.at_slice();
                progress = serving.engine.advance();
            });
            let events = self.engine.drain_events();
            self.trial.note(&events);
            self.door.publish(&events);
            outlet.tell(events);
            self.answer_waiting(outlet);
            outlet.flush();
            if progress == Progress::Worked {
                outlet.changed = true;
            }
            self.guarded("a snapshot", |serving| outlet.publish(&serving.engine));
            if self.engine.has_ended() {
                return;
            }
            if progress != Progress::Worked {
                next = self.wait();
            }
        }
    }

    /// Does something; a panic in it makes the engine hold, and the loop goes on.
    fn guarded(&mut self, what: &str, work: impl FnOnce(&mut Self)) {
        let done = catch_unwind(AssertUnwindSafe(|| work(self)));
        if let Err(panic) = done {
            let text = format!("the engine failed in {what}: {}", said(&*panic));
            // Holding writes an alarm; where even that fails, the alarm is at least in the book or the fault is told.
            drop(catch_unwind(AssertUnwindSafe(|| self.engine.fail(&text))));
        }
    }

    /// Carries out what was asked meanwhile. Tells whether the front end is gone.
    fn requests(&mut self, first: Option<Request>, outlet: &mut Outlet) -> bool {
        let mut next = first;
        for _ in 0..OUTSTANDING_MAX {
            let request = match next.take() {
                Some(request) => request,
                None => match self.asked.try_recv() {
                    Ok(request) => request,
                    Err(std::sync::mpsc::TryRecvError::Empty) => break,
                    Err(std::sync::mpsc::TryRecvError::Disconnected) => return true,
                },
            };
            let id = request.id.clone();
            let mut reply = None;
            let mut done = false;
            self.guarded("a request", |serving| {
                reply = serving.engine.offer(request);
                done = true;
            });
            match reply {
                Some(reply) => outlet.answer(id, reply),
                None if done => self.waiting.push(id),
                None => outlet.answer(id, failed()),
            }
        }
        self.guarded("a request", |serving| service::step_requests(&mut serving.engine, &mut serving.door));
        false
    }

    fn answer_waiting(&mut self, outlet: &mut Outlet) {
        for id in std::mem::take(&mut self.waiting) {
            match self.engine.answer_of(&id) {
                Some(reply) => outlet.answer(id, reply),
                None => self.waiting.push(id),
            }
        }
    }

    /// Waits for a request, but not for long.
    fn wait(&self) -> Option<Request> {
        let pause = if self.waiting.is_empty() { PAUSE_MAX } else { PAUSE_STOPPING };
        // The loop sees a front end that is gone by itself.
        self.asked.recv_timeout(pause).ok()
    }
}

fn failed() -> Reply {
    Reply::Refused {
        code: super::command::Refusal::Holding,
        text: "the engine failed on it and holds".to_owned(),
        hint: Some("end the engine, look at `holdpoint audit verify`, and start it again".to_owned()),
    }
}

/// What a panic said.
fn said(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    crate::text::Untrusted::new(text.unwrap_or_else(|| "no message".to_owned())).line().into_string()
}

/// A panic on purpose, for tests of a build that checks itself: `HOLDPOINT_TEST_PANIC=engine` fails the first slice
/// after a registration, once.
struct Trial {
    armed: bool,
    due: bool,
}

impl Trial {
    fn new() -> Self {
        let asked = std::env::var_os("HOLDPOINT_TEST_PANIC").is_some_and(|value| value == "engine");
        Self { armed: cfg!(debug_assertions) && asked, due: false }
    }

    fn note(&mut self, events: &[Event]) {
        let registered = |event: &Event| {
            // The first versions of the cell are registered at the start and are not meant.
            matches!(&event.kind, super::event::EventKind::Registered { parent: Some(_), .. })
        };
        self.due |= self.armed && events.iter().any(registered);
    }

    fn at_slice(&mut self) {
        if self.due {
            (self.armed, self.due) = (false, false);
            fall_over();
        }
    }
}

#[cfg(debug_assertions)]
#[allow(clippy::panic, reason = "a panic is what is tried")]
fn fall_over() {
    panic!("a panic on purpose");
}

#[cfg(not(debug_assertions))]
const fn fall_over() {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::event::EventKind;

    fn outlet() -> (Outlet, mpsc::Receiver<Update>) {
        let (updates, receiver) = mpsc::channel(UPDATES_MAX);
        let outlet = Outlet {
            updates,
            snapshot: watch::channel(None).0,
            outstanding: Arc::new(AtomicUsize::new(OUTSTANDING_MAX)),
            answers: VecDeque::new(),
            missed: 0,
            changed: false,
            published: None,
        };
        (outlet, receiver)
    }

    fn event(seq: u64) -> Event {
        Event { seq, at_ms: 0, kind: EventKind::Fault { text: "test".to_owned() } }
    }

    #[test]
    fn a_slow_reader_loses_events_and_no_answer() {
        let (mut outlet, mut receiver) = outlet();
        for seq in 0..1_000 {
            outlet.tell(vec![event(seq)]);
        }
        for id in 0..OUTSTANDING_MAX {
            outlet.answer(id.to_string(), failed());
        }
        outlet.tell(vec![event(1_000)]);
        let (mut events, mut answers, mut missed) = (0, 0, 0);
        for _ in 0..2 {
            while let Ok(update) = receiver.try_recv() {
                match update {
                    Update::Events(some) => events += some.len() as u64,
                    Update::Answer { .. } => answers += 1,
                    Update::Lagged { missed: some } => missed += some,
                    Update::Started | Update::Ended(_) => {}
                }
            }
            outlet.flush();
        }
        while let Ok(Update::Lagged { missed: some }) = receiver.try_recv() {
            missed += some;
        }
        assert_eq!(answers, OUTSTANDING_MAX);
        assert_eq!(events + missed, 1_001);
        assert!(missed > 0);
        assert_eq!(outlet.outstanding.load(Ordering::Acquire), 0);
    }

    #[test]
    fn jobs_leave_a_core() {
        let config = |jobs| HostConfig {
            data: PathBuf::new(),
            profile: ProfileName::Sim,
            seed: 1,
            jobs,
            robot: None,
            pace: None,
        };
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        assert_eq!(config(0).workers(), (cores - 1).max(1));
        assert_eq!(config(3).workers(), 3);
    }
}
