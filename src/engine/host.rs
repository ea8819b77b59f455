//! The engine as a front end has it: on a thread of its own in the same process, or at work in another one.
//!
//! Requests go in through a bounded queue and are never waited for; what happened comes out through a bounded one,
//! of which a slow reader loses events and is told how many, but never an answer. Snapshots and pictures are the
//! newest ones only. The engine never waits for the front end, and a front end that is gone ends it: it approves
//! nothing alone.
//!
//! A panic on the engine's thread does not end the process: the pipeline holds with a latched alarm, and the host
//! goes on answering.

mod attached;
mod coming;
mod elsewhere;
mod publisher;
mod serving;
mod update;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, watch};

use self::attached::Attached;
use self::coming::Coming;
pub use self::elsewhere::EngineElsewhere;
use self::publisher::Publisher;
use self::serving::{Serving, said};
pub use self::update::{EndFault, OUTSTANDING_MAX, UPDATES_MAX, Update};
use super::Config;
use super::door::{Client, DoorError, Doubt, LiveViews, Seat, Seats, Signals};
use super::pump::Pump;
use crate::anteroom::{Anteroom, LOOK_PATIENCE, ReadWatch};
use crate::cell::Cell;
use crate::trial::cache::EpisodeCache;
use crate::world::switch::{AskedStop, Switch};
use holdpoint_governance::own_profile::ChosenProfile;
use holdpoint_protocol::command::{Command, Request};
use holdpoint_protocol::picture::Picture;
use holdpoint_protocol::seat::Sitting;
use holdpoint_protocol::sink::{MakeSink, Serve};
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_registry::Layout;

/// How long an engine in another process is waited for about the live scene: somebody sits at the screen.
const SCENE_PATIENCE: Duration = Duration::from_millis(500);

/// By how much evaluation stands back behind the front end's thread.
const NICE: i32 = 5;

/// What a host is started with.
pub struct HostConfig {
    pub data: PathBuf,
    pub profile: ChosenProfile,
    pub seed: u64,
    /// Workers for evaluation; 0 for one fewer than there are cores.
    pub jobs: usize,
    /// The robot's URDF file; absent for the built-in arm.
    pub robot: Option<PathBuf>,
    /// Simulated seconds of the live world in a second; absent for as fast as it computes.
    pub pace: Option<f64>,
    /// Who listens besides the front end: recordings, a live viewer.
    pub sinks: Vec<MakeSink>,
    /// For how long it works with nobody at a seat, before it ends in good order; absent for ever.
    pub alone_max: Option<Duration>,
    /// A second folder to listen in, for other accounts' seats.
    pub seats: Option<PathBuf>,
}

impl HostConfig {
    /// Workers: what was asked for, else one fewer than there are cores, so that the front end stays quick.
    #[must_use]
    pub fn workers(&self) -> usize {
        let spare = || std::thread::available_parallelism().map_or(1, usize::from).saturating_sub(1);
        if self.jobs == 0 { spare().max(1) } else { self.jobs }
    }
}

/// Why a request was not taken; it comes back with it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotTaken {
    /// Too many are under way; there is room again once some are answered.
    #[error("the engine is busy: {OUTSTANDING_MAX} requests wait already")]
    Busy(Box<Request>),
    /// There is no engine in this process: it has ended, or never came up.
    #[error("no engine is at work here")]
    Ended(Box<Request>),
}

/// An engine that did not end in time.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StopError {
    /// It is still at work; it ends by itself later, and approves nothing.
    #[error("the engine did not end within {0:?}")]
    Late(Duration),
    /// It ended with an error.
    #[error("{0}")]
    Failed(EndFault),
}

/// What the front end's thread reaches of the engine's without asking it.
#[derive(Default)]
struct Shared {
    switch: OnceLock<Arc<Switch>>,
    /// Whether nobody takes requests any more. Held while one is handed over, so that none is lost in between.
    ended: Mutex<bool>,
    /// Has the live scene served.
    serve: OnceLock<Serve>,
    /// Who looks at the engine.
    seats: OnceLock<Arc<Seats>>,
}

impl Shared {
    fn ended(&self) -> MutexGuard<'_, bool> {
        self.ended.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The engine that a front end is at: on a thread of this process, or at work in another one. Dropping one of this process
/// ends it in an orderly way, without waiting for that; another one works on.
pub struct Host {
    /// What happened; bounded, see [`UPDATES_MAX`].
    pub updates: mpsc::Receiver<Update>,
    /// How things stand; absent until the engine is up.
    pub snapshots: watch::Receiver<Option<Arc<Snapshot>>>,
    /// What the live cell looks like; absent until it has moved.
    pub pictures: watch::Receiver<Option<Arc<Picture>>>,
    layout: Layout,
    way: Way,
}

/// How requests reach the engine.
enum Way {
    Thread(OwnEngine),
    Socket(Attached),
    Coming(Coming),
}

/// An engine on a thread of this process.
struct OwnEngine {
    requests: SyncSender<Request>,
    outstanding: Arc<AtomicUsize>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<Result<(), EndFault>>>,
    /// This process's own seat, once the engine has a book of them.
    seat: Option<Seat>,
}

/// Counts one request more, unless too many are on their way.
fn take_place(outstanding: &AtomicUsize) -> bool {
    let take = |count: usize| (count < OUTSTANDING_MAX).then_some(count + 1);
    outstanding.fetch_update(Ordering::AcqRel, Ordering::Acquire, take).is_ok()
}

impl OwnEngine {
    fn ask(&self, request: Request) -> Result<(), NotTaken> {
        // The thread that was never started takes nothing.
        let ended = self.shared.ended();
        if *ended || self.thread.is_none() {
            return Err(NotTaken::Ended(Box::new(request)));
        }
        let stops = request.command.stops_the_arm();
        if let (Command::Stop { by, reason }, Some(switch)) = (&request.command, self.shared.switch.get()) {
            let (id, by, reason) = (request.id.clone(), by.clone(), reason.clone());
            switch.halt(AskedStop { id, by, reason, caller: crate::caller::own() });
        }
        if !take_place(&self.outstanding) {
            return Err(NotTaken::Busy(Box::new(request)));
        }
        if let Err(refused) = self.requests.try_send(request) {
            self.outstanding.fetch_sub(1, Ordering::AcqRel);
            return Err(match refused {
                TrySendError::Full(request) => NotTaken::Busy(Box::new(request)),
                TrySendError::Disconnected(request) => NotTaken::Ended(Box::new(request)),
            });
        }
        if stops && let Some(switch) = self.shared.switch.get() {
            switch.stop();
        }
        Ok(())
    }

    fn stop(mut self, updates: &mut mpsc::Receiver<Update>, patience: Duration) -> Result<(), StopError> {
        let until = Instant::now() + patience;
        // A queue that is full is closed below, which ends the engine as well.
        let _ = self.ask(Request::unsigned("host-stop".to_owned(), Command::Shutdown));
        let Some(thread) = self.thread.take() else { return Ok(()) };
        drop(self);
        while !thread.is_finished() {
            if Instant::now() >= until {
                return Err(StopError::Late(patience));
            }
            // What still comes is not read by anybody.
            while updates.try_recv().is_ok() {}
            std::thread::sleep(Duration::from_millis(2));
        }
        match thread.join() {
            Ok(Ok(())) => Ok(()),
            Ok(Err(why)) => Err(StopError::Failed(why)),
            Err(_) => Err(StopError::Failed(EndFault::of("the engine's thread failed"))),
        }
    }
}

impl Host {
    /// Starts the thread and returns at once. Whether the engine came up is told by [`Update::Started`] or
    /// [`Update::Ended`].
    #[must_use]
    pub fn start(config: HostConfig) -> Self {
        Self::start_watched(config, Box::new(|_| ()))
    }

    /// As [`Self::start`]; `watch` looks on while the record is read.
    #[must_use]
    pub fn start_watched(config: HostConfig, watch: ReadWatch) -> Self {
        let (requests, asked) = sync_channel(OUTSTANDING_MAX);
        let (told, updates) = mpsc::channel(UPDATES_MAX);
        let (snapshot, snapshots) = watch::channel(None);
        let (picture, pictures) = watch::channel(None);
        let outstanding = Arc::new(AtomicUsize::new(0));
        let shared = Arc::new(Shared::default());
        let layout = Layout::new(config.data.clone());
        let publisher = Publisher::new(told, snapshot, Arc::clone(&outstanding));
        let own = Arc::clone(&shared);
        let views = LiveViews { snapshots: snapshots.clone(), pictures: pictures.clone() };
        let work = move || run((config, watch), &asked, publisher, (picture, views), &own);
        let thread = std::thread::Builder::new().name("engine".to_owned()).spawn(work).ok();
        let way = Way::Thread(OwnEngine { requests, outstanding, shared, thread, seat: None });
        Self { updates, snapshots, pictures, layout, way }
    }

    /// Sits down at the engine that is at work on a store, in another process. What it shows comes as from one of this
    /// process; leaving ends nothing.
    ///
    /// # Errors
    /// [`DoorError`] if it shows itself to nobody, or is gone meanwhile.
    pub fn attach(layout: Layout, client: Client, sitting: Sitting) -> Result<Self, DoorError> {
        let (told, updates) = mpsc::channel(UPDATES_MAX);
        let (snapshot, snapshots) = watch::channel(None);
        let (picture, pictures) = watch::channel(None);
        let way = Way::Socket(Attached::start(&layout, client, sitting, (told, snapshot, picture))?);
        Ok(Self { updates, snapshots, pictures, layout, way })
    }

    /// Sits down at whatever engine is at work on a store, in another process; `None` if none is.
    ///
    /// # Errors
    /// As [`Host::attach`]; [`DoorError::Silent`] if one is there and says nothing.
    pub fn find(layout: &Layout, sitting: Sitting) -> Result<Option<Self>, DoorError> {
        let client = Client::connect(layout)?;
        client.map(|client| Self::attach(layout.clone(), client, sitting)).transpose()
    }

    /// The store's files.
    #[must_use]
    pub const fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Whether the engine is another process's.
    #[must_use]
    pub const fn is_attached(&self) -> bool {
        matches!(self.way, Way::Socket(_))
    }

    /// Process id of the engine, if it is another process's.
    #[must_use]
    pub const fn process(&self) -> Option<i32> {
        match &self.way {
            Way::Socket(attached) => Some(attached.process()),
            Way::Thread(_) | Way::Coming(_) => None,
        }
    }

    /// Why what another process shows is not known to come from the engine that has the store.
    #[must_use]
    pub fn doubt(&self) -> Option<Doubt> {
        match &self.way {
            Way::Socket(attached) => attached.doubt(),
            Way::Thread(_) | Way::Coming(_) => None,
        }
    }

    /// An engine that is being started in another process: what is asked of it waits.
    #[must_use]
    pub fn coming(layout: Layout) -> Self {
        let (told, updates) = mpsc::channel(UPDATES_MAX);
        let (snapshots, pictures) = (watch::channel(None).1, watch::channel(None).1);
        let way = Way::Coming(Coming::new(told));
        Self { updates, snapshots, pictures, layout, way }
    }

    /// What was asked while the engine was being started. Nothing more waits from now on.
    #[must_use]
    pub fn take_waiting(&self) -> Vec<Request> {
        match &self.way {
            Way::Coming(coming) => coming.take(),
            Way::Thread(_) | Way::Socket(_) => Vec::new(),
        }
    }

    /// Has an engine of another process go on when nobody sits at it any more. Waits for its word.
    ///
    /// # Errors
    /// [`DoorError`]; it may end then, once nobody sits there.
    pub fn keep(&self) -> Result<(), DoorError> {
        match &self.way {
            Way::Socket(_) => match Client::connect(&self.layout)? {
                Some(mut client) => client.keep(),
                None => Err(DoorError::Ended { path: crate::door::socket_path(&self.layout) }),
            },
            Way::Thread(_) | Way::Coming(_) => Ok(()),
        }
    }

    /// Hands a request over. Its answer comes as [`Update::Answer`], or the request as [`Update::Returned`] if the engine
    /// ends before it takes it. Never waits; an operator's stop or abort stops
    /// the arm here and now, before the engine has read it. A stop does so even if the engine is busy, and is put on
    /// record then without an answer.
    ///
    /// # Errors
    /// [`NotTaken`]; nothing was handed over then.
    pub fn ask(&self, request: Request) -> Result<(), NotTaken> {
        match &self.way {
            Way::Thread(own) => own.ask(request),
            Way::Socket(attached) => attached.ask(request),
            Way::Coming(coming) => coming.ask(request),
        }
    }

    /// Says what whoever sits here looks at. Gives back the number of the seat; absent before the engine is up.
    pub fn sit(&mut self, sitting: Sitting) -> Option<u64> {
        match &mut self.way {
            Way::Thread(own) => {
                let seats = own.shared.seats.get()?;
                if let Some(seat) = &own.seat {
                    seat.say(sitting);
                } else {
                    own.seat = Some(seats.sit(Some(std::process::id()), sitting));
                }
                own.seat.as_ref().map(Seat::number)
            }
            Way::Socket(attached) => Some(attached.sit(sitting)),
            Way::Coming(_) => None,
        }
    }

    /// Has the live scene served to viewers at this address from now on. Tells whether somebody was there to do it;
    /// what came of it is told as an event. One of another process is asked, and waited for.
    #[must_use]
    pub fn serve_scene(&self, address: std::net::SocketAddr) -> bool {
        match &self.way {
            Way::Thread(own) => own.shared.serve.get().is_some_and(|serve| serve(address)),
            Way::Socket(_) => {
                let client = Client::connect_within(&self.layout, SCENE_PATIENCE).ok().flatten();
                client.is_some_and(|mut client| client.serve_scene(address).unwrap_or(false))
            }
            Way::Coming(_) => false,
        }
    }

    /// Whatever engine is at work on the store, if this process has none.
    #[must_use]
    pub fn elsewhere(&self) -> EngineElsewhere {
        EngineElsewhere::new(self.layout.clone())
    }

    /// The folder of the store's identities.
    #[must_use]
    pub fn identities(&self) -> PathBuf {
        self.layout.identities()
    }

    /// The folder of the store's scene recordings.
    #[must_use]
    pub fn recordings(&self) -> PathBuf {
        self.layout.recordings()
    }

    /// The folder of the store's logs.
    #[must_use]
    pub fn logs(&self) -> PathBuf {
        self.layout.logs()
    }

    /// Ends an engine of this process in an orderly way: the arm is stopped, nothing is approved or activated. One of another
    /// process is left as it is.
    ///
    /// # Errors
    /// [`StopError`] if it takes longer than `patience`, or ended with an error.
    pub fn stop(self, patience: Duration) -> Result<(), StopError> {
        let Self { mut updates, way, .. } = self;
        match way {
            Way::Thread(own) => own.stop(&mut updates, patience),
            Way::Socket(_) | Way::Coming(_) => Ok(()),
        }
    }
}

fn run(
    begun_with: (HostConfig, ReadWatch),
    asked: &Receiver<Request>,
    mut publisher: Publisher,
    (picture, views): (watch::Sender<Option<Arc<Picture>>>, LiveViews),
    shared: &Shared,
) -> Result<(), EndFault> {
    // Threads that are started from here inherit it. Where it is refused, evaluation is only less modest.
    let _ = rustix::process::nice(NICE);
    let mut early = EarlyDoor { asked, waiting: Vec::new(), publisher: &mut publisher, shared };
    let started = catch_unwind(AssertUnwindSafe(|| start(begun_with, &mut early, (picture, views))));
    let waiting = early.waiting;
    let started =
        started.unwrap_or_else(|panic| Err(EndFault::of(format!("the start failed: {}", said(&*panic)))));
    let mut untaken = Vec::new();
    let ended = match started {
        Ok(Some(pump)) => {
            // It is set once, here.
            if let Some(serve) = pump.serve() {
                drop(shared.serve.set(serve));
            }
            publisher.say(Update::Started);
            let first = waiting.into_iter().map(|(request, _)| request).collect();
            Serving::new(pump, asked, first).run(&mut publisher);
            Ok(())
        }
        Ok(None) => Ok(()),
        Err(why) => {
            untaken.extend(waiting.into_iter().map(|(request, _)| request));
            Err(why)
        }
    };
    if ended.is_err() {
        publisher.withdraw();
    }
    publisher.flush();
    {
        let mut over = shared.ended();
        *over = true;
        untaken.extend(asked.try_iter());
    }
    // Room for as many is kept: none of them was answered.
    for request in untaken {
        publisher.say(Update::Returned(Box::new(request)));
    }
    publisher.say(Update::Ended(ended.clone()));
    ended
}

/// The front end, before there is an engine.
struct EarlyDoor<'a> {
    asked: &'a Receiver<Request>,
    /// What it asked that waits for the engine, and since when.
    waiting: Vec<(Request, Instant)>,
    publisher: &'a mut Publisher,
    shared: &'a Shared,
}

impl EarlyDoor<'_> {
    /// Answers what can be answered. Tells whether the front end is gone.
    fn requests(&mut self, anteroom: &mut Anteroom<'_>) -> bool {
        loop {
            match self.asked.try_recv() {
                Ok(request) => self.waiting.push((request, Instant::now())),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => return true,
            }
        }
        for (request, since) in std::mem::take(&mut self.waiting) {
            match anteroom.answer(&request, since.elapsed()) {
                Some(reply) => self.publisher.answer(request.id, reply),
                None => self.waiting.push((request, since)),
            }
        }
        self.publisher.is_lost()
    }
}

/// Shows how things stand by the rows while the record is read, then starts the engine. `None` if it was told to end
/// before.
fn start(
    (config, watch): (HostConfig, ReadWatch),
    early: &mut EarlyDoor<'_>,
    (picture, views): (watch::Sender<Option<Arc<Picture>>>, LiveViews),
) -> Result<Option<Pump>, EndFault> {
    let jobs = config.workers();
    let begun = Instant::now();
    let engine_config = Config {
        data: &config.data,
        profile: config.profile,
        seed: config.seed,
        jobs,
        scripted: false,
        cell: Cell::of(config.robot.as_deref()).map_err(|error| EndFault::of(error.to_string()))?,
        cache: EpisodeCache::InStore,
    };
    let mut anteroom = Anteroom::open(engine_config, Signals::Taken, watch).map_err(EndFault::from)?;
    if let Some(folder) = &config.seats {
        anteroom.serve_seats(folder).map_err(EndFault::from)?;
    }
    // It is set once, here.
    drop(early.shared.switch.set(anteroom.switch()));
    anteroom.show(views);
    let (seats, scenes) = (anteroom.seats(), anteroom.scenes());
    if let Some(alone_max) = config.alone_max {
        seats.end_alone_after(alone_max);
    }
    early.publisher.seat(Arc::clone(&seats));
    drop(early.shared.seats.set(anteroom.seats()));
    while !anteroom.turn() {
        if early.requests(&mut anteroom) || anteroom.has_ended() || seats.left_alone().is_some() {
            return Ok(None);
        }
        if anteroom.has_records() && begun.elapsed() >= LOOK_PATIENCE {
            early.publisher.show(|| anteroom.snapshot());
        }
    }
    if anteroom.has_ended() {
        return Ok(None);
    }
    let (engine, door) = anteroom.enter().map_err(EndFault::from)?;
    let mut pump = Pump::with_door(engine, door, config.sinks);
    // It is set once, here.
    drop(pump.serve().map(|serve| scenes.set(serve)));
    let others = pump.pictures();
    let pictures = move |taken: Picture| {
        if let Some(take) = &others {
            take(taken.clone());
        }
        picture.send_replace(Some(Arc::new(taken)));
    };
    pump.pace_live_world(config.pace, Arc::new(pictures));
    Ok(Some(pump))
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_protocol::command::Reply;
    use holdpoint_registry::Store;

    fn config(data: PathBuf, jobs: usize) -> HostConfig {
        HostConfig {
            data,
            profile: holdpoint_governance::profile::ProfileName::Sim.into(),
            seed: 1,
            jobs,
            robot: None,
            pace: None,
            sinks: Vec::new(),
            alone_max: None,
            seats: None,
        }
    }

    #[test]
    fn jobs_leave_a_core() {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        assert_eq!(config(PathBuf::new(), 0).workers(), (cores - 1).max(1));
        assert_eq!(config(PathBuf::new(), 3).workers(), 3);
    }

    /// A stop that was asked of an engine that never came up was answered with "busy", or not at all.
    #[test]
    fn what_nobody_takes_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let _held = Store::open(folder.path()).unwrap();
        let mut host = Host::start(config(folder.path().to_owned(), 1));
        let stop = |id: &str| {
            Request::unsigned(id.to_owned(), Command::Stop { by: "ana".to_owned(), reason: String::new() })
        };
        // It may be handed over before the start has failed, or not.
        let mut back = match host.ask(stop("early")) {
            Ok(()) => Vec::new(),
            Err(NotTaken::Ended(request)) => vec![*request],
            Err(busy) => panic!("{busy}"),
        };
        let why = loop {
            match host.updates.blocking_recv() {
                Some(Update::Returned(request)) => back.push(*request),
                Some(Update::Ended(ended)) => break ended.unwrap_err(),
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(back, [stop("early")]);
        assert!(why.in_use && why.text.contains("is in use by"), "{why}");
        for count in 0..=OUTSTANDING_MAX {
            let asked = host.ask(stop(&count.to_string()));
            assert_eq!(asked, Err(NotTaken::Ended(Box::new(stop(&count.to_string())))), "never busy");
        }
        // The store is held, but by no engine: there is nobody who could stop anything.
        assert!(matches!(host.elsewhere().ask(stop("late").command), Reply::Refused { .. }));
        assert_eq!(host.stop(Duration::from_mins(1)), Err(StopError::Failed(why)));
    }
}
