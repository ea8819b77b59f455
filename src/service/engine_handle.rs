//! The engine as a front end uses it: on a separate thread of this process, or in another process.
//!
//! Requests enter through a bounded queue without waiting. Events leave through a bounded queue: a slow reader loses events
//! and receives their count, but loses no answer. Only the newest snapshot and camera frame are available. The engine never
//! waits for the front end, and ends when its front end is gone.
//! A panic on the engine's thread halts the pipeline with a latched alarm; the host continues to answer.

mod engine_loop;
mod launch_config;
mod publisher;
mod remote_engine;
mod socket_transport;
mod starting_engine;
mod update;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, watch};

use self::engine_loop::{EngineLoop, panic_message};
pub use self::launch_config::{ConsoleAccess, LaunchConfig};
use self::publisher::Publisher;
pub use self::remote_engine::RemoteEngine;
use self::socket_transport::SocketTransport;
use self::starting_engine::StartingEngine;
pub use self::update::{EngineEndError, EngineUpdate, OUTSTANDING_MAX, UPDATES_MAX};
use super::control_socket::{
    Client, ConsoleRegistration, ConsoleRegistry, ControlSocketError, LiveViews, SignalHandling,
    UnverifiedOrigin,
};
use super::pump::Pump;
use crate::bootstrap::{BootstrapError, EngineBootstrap, LOOK_PATIENCE, ReadProgressFn};
use holdpoint_engine::Config;
use holdpoint_engine::live::stop_switch::{StopRequest, StopSwitch};
use holdpoint_protocol::account_role::AccountRole;
use holdpoint_protocol::command::{Command, Request};
use holdpoint_protocol::console_presence::ConsolePresence;
use holdpoint_protocol::sink::ServeScene;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::video_frame::VideoFrame;
use holdpoint_store::Layout;
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::cell::Cell;

/// How long the front end waits for an engine in another process to serve the live scene.
const SCENE_PATIENCE: Duration = Duration::from_millis(500);

/// The nice value of evaluation, so that the front end stays responsive.
const NICE: i32 = 5;

/// Why the engine did not take a request, with the request.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RequestRejected {
    #[error("the engine is busy: {OUTSTANDING_MAX} requests wait already")]
    Busy(Box<Request>),
    /// There is no engine in this process: it has ended, or never came up.
    #[error("no engine is running here")]
    Ended(Box<Request>),
}

/// An engine that did not end in time.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StopError {
    /// It still runs; it ends later and approves nothing.
    #[error("the engine did not end within {0:?}")]
    Late(Duration),
    #[error("{0}")]
    Failed(EngineEndError),
}

#[derive(Default)]
struct EngineShared {
    switch: OnceLock<Arc<StopSwitch>>,
    /// Whether the engine takes no more requests. Locked while one is handed over, so that none is lost.
    ended: Mutex<bool>,
    serve: OnceLock<ServeScene>,
    consoles: OnceLock<Arc<ConsoleRegistry>>,
}

impl EngineShared {
    fn ended(&self) -> MutexGuard<'_, bool> {
        self.ended.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A front end's engine, in this process or another one. Dropping it ends only an engine of this process, without waiting.
pub struct EngineHandle {
    /// Events and answers; bounded, see [`UPDATES_MAX`].
    pub updates: mpsc::Receiver<EngineUpdate>,
    /// The newest snapshot; absent until the engine is up.
    pub snapshots: watch::Receiver<Option<Arc<Snapshot>>>,
    /// The newest frame of the live cell; absent until it has moved.
    pub frames: watch::Receiver<Option<Arc<VideoFrame>>>,
    layout: Layout,
    transport: Transport,
}

enum Transport {
    Thread(InProcessEngine),
    Socket(SocketTransport),
    Starting(StartingEngine),
}

/// An engine on a thread of this process.
struct InProcessEngine {
    requests: SyncSender<Request>,
    outstanding: Arc<AtomicUsize>,
    shared: Arc<EngineShared>,
    thread: Option<JoinHandle<Result<(), EngineEndError>>>,
    /// This process's console, once the engine has a registry.
    console: Option<ConsoleRegistration>,
}

fn take_place(outstanding: &AtomicUsize) -> bool {
    let take = |count: usize| (count < OUTSTANDING_MAX).then_some(count + 1);
    outstanding.fetch_update(Ordering::AcqRel, Ordering::Acquire, take).is_ok()
}

impl InProcessEngine {
    fn submit(&self, request: Request) -> Result<(), RequestRejected> {
        let ended = self.shared.ended();
        if *ended || self.thread.is_none() {
            return Err(RequestRejected::Ended(Box::new(request)));
        }
        let stops = request.command.stops_the_arm();
        if let (Command::Stop { by, reason }, Some(switch)) = (&request.command, self.shared.switch.get()) {
            let (id, by, reason) = (request.id.clone(), by.clone(), reason.clone());
            switch.halt(StopRequest { id, by, reason, caller: holdpoint_record::caller::own() });
        }
        if !take_place(&self.outstanding) {
            return Err(RequestRejected::Busy(Box::new(request)));
        }
        if let Err(refused) = self.requests.try_send(request) {
            self.outstanding.fetch_sub(1, Ordering::AcqRel);
            return Err(match refused {
                TrySendError::Full(request) => RequestRejected::Busy(Box::new(request)),
                TrySendError::Disconnected(request) => RequestRejected::Ended(Box::new(request)),
            });
        }
        if stops && let Some(switch) = self.shared.switch.get() {
            switch.stop();
        }
        Ok(())
    }

    fn stop(
        mut self,
        updates: &mut mpsc::Receiver<EngineUpdate>,
        patience: Duration,
    ) -> Result<(), StopError> {
        let until = Instant::now() + patience;
        // A full queue is closed below, which ends the engine as well.
        let _ = self.submit(Request::unsigned("host-stop".to_owned(), Command::Shutdown));
        let Some(thread) = self.thread.take() else { return Ok(()) };
        drop(self);
        while !thread.is_finished() {
            if Instant::now() >= until {
                return Err(StopError::Late(patience));
            }
            // The front end no longer reads updates.
            while updates.try_recv().is_ok() {}
            std::thread::sleep(Duration::from_millis(2));
        }
        match thread.join() {
            Ok(Ok(())) => Ok(()),
            Ok(Err(why)) => Err(StopError::Failed(why)),
            Err(_) => Err(StopError::Failed(EngineEndError::of("the engine's thread failed"))),
        }
    }
}

impl EngineHandle {
    /// Starts the thread and returns at once; [`EngineUpdate::Started`] or [`EngineUpdate::Ended`] reports the result.
    #[must_use]
    pub fn start(config: LaunchConfig) -> Self {
        Self::start_watched(config, Box::new(|_| ()))
    }

    /// As [`Self::start`]; `watch` observes the reading of the record.
    #[must_use]
    pub fn start_watched(config: LaunchConfig, watch: ReadProgressFn) -> Self {
        let (requests, incoming) = sync_channel(OUTSTANDING_MAX);
        let (update_sender, updates) = mpsc::channel(UPDATES_MAX);
        let (snapshot_sender, snapshots) = watch::channel(None);
        let (frame_sender, frames) = watch::channel(None);
        let outstanding = Arc::new(AtomicUsize::new(0));
        let shared = Arc::new(EngineShared::default());
        let layout = Layout::new(config.data.clone());
        let publisher = Publisher::new(update_sender, snapshot_sender, Arc::clone(&outstanding));
        let own = Arc::clone(&shared);
        let views = LiveViews { snapshots: snapshots.clone(), frames: frames.clone() };
        let work = move || run((config, watch), &incoming, publisher, (frame_sender, views), &own);
        let thread = std::thread::Builder::new().name("engine".to_owned()).spawn(work).ok();
        let transport =
            Transport::Thread(InProcessEngine { requests, outstanding, shared, thread, console: None });
        Self { updates, snapshots, frames, layout, transport }
    }

    /// Attaches to the engine of a store in another process. Leaving it does not end that engine.
    ///
    /// # Errors
    /// [`ControlSocketError`] if it accepts no console, or has ended meanwhile.
    pub fn attach(
        layout: Layout,
        client: Client,
        sitting: ConsolePresence,
    ) -> Result<Self, ControlSocketError> {
        let (update_sender, updates) = mpsc::channel(UPDATES_MAX);
        let (snapshot_sender, snapshots) = watch::channel(None);
        let (frame_sender, frames) = watch::channel(None);
        let transport = Transport::Socket(SocketTransport::start(
            &layout,
            client,
            sitting,
            (update_sender, snapshot_sender, frame_sender),
        )?);
        Ok(Self { updates, snapshots, frames, layout, transport })
    }

    /// Attaches to the engine of a store in another process; `None` if none runs.
    ///
    /// # Errors
    /// As [`EngineHandle::attach`]; [`ControlSocketError::Silent`] if one is there but does not respond.
    pub fn find(layout: &Layout, sitting: ConsolePresence) -> Result<Option<Self>, ControlSocketError> {
        let client = Client::connect(layout)?;
        client.map(|client| Self::attach(layout.clone(), client, sitting)).transpose()
    }

    pub const fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Whether the engine runs in another process.
    #[must_use]
    pub const fn is_attached(&self) -> bool {
        matches!(self.transport, Transport::Socket(_))
    }

    /// Process id of the engine, if it runs in another process.
    #[must_use]
    pub const fn process(&self) -> Option<i32> {
        match &self.transport {
            Transport::Socket(attached) => Some(attached.process()),
            Transport::Thread(_) | Transport::Starting(_) => None,
        }
    }

    /// Why data of another process is not known to come from the engine that has the store.
    #[must_use]
    pub fn unverified_origin(&self) -> Option<UnverifiedOrigin> {
        match &self.transport {
            Transport::Socket(attached) => attached.unverified_origin(),
            Transport::Thread(_) | Transport::Starting(_) => None,
        }
    }

    /// An engine that another process is starting: requests wait for it.
    #[must_use]
    pub fn starting(layout: Layout) -> Self {
        let (update_sender, updates) = mpsc::channel(UPDATES_MAX);
        let (snapshots, frames) = (watch::channel(None).1, watch::channel(None).1);
        let transport = Transport::Starting(StartingEngine::new(update_sender));
        Self { updates, snapshots, frames, layout, transport }
    }

    /// Takes the requests made during the start. No more wait from now on.
    #[must_use]
    pub fn take_waiting(&self) -> Vec<Request> {
        match &self.transport {
            Transport::Starting(coming) => coming.take(),
            Transport::Thread(_) | Transport::Socket(_) => Vec::new(),
        }
    }

    /// Keeps the engine of another process running without an attached console. Waits for its answer.
    ///
    /// # Errors
    /// [`ControlSocketError`]; the engine may then end once no console is attached.
    pub fn keep_engine_running(&self) -> Result<(), ControlSocketError> {
        match &self.transport {
            Transport::Socket(_) => match Client::connect(&self.layout)? {
                Some(mut client) => client.keep_engine_running(),
                None => {
                    Err(ControlSocketError::Ended { path: crate::control_socket::socket_path(&self.layout) })
                }
            },
            Transport::Thread(_) | Transport::Starting(_) => Ok(()),
        }
    }

    /// Hands a request over without waiting. The answer comes as [`EngineUpdate::Answer`], or the request as
    /// [`EngineUpdate::Returned`] if the engine ends first. An operator's stop or abort stops the arm at once, before the engine
    /// reads it. A stop does so even if the engine is busy; it is then recorded without an answer.
    ///
    /// # Errors
    /// [`RequestRejected`]; the request was not handed over.
    pub fn submit(&self, request: Request) -> Result<(), RequestRejected> {
        match &self.transport {
            Transport::Thread(own) => own.submit(request),
            Transport::Socket(attached) => attached.submit(request),
            Transport::Starting(coming) => coming.submit(request),
        }
    }

    /// Sends the presence of this console. Returns its number; absent before the engine is up.
    pub fn set_presence(&mut self, sitting: ConsolePresence) -> Option<u64> {
        match &mut self.transport {
            Transport::Thread(own) => {
                let consoles = own.shared.consoles.get()?;
                if let Some(console) = &own.console {
                    console.set_presence(sitting);
                } else {
                    let (caller, role) = (holdpoint_record::caller::own(), AccountRole::Administrator);
                    own.console = Some(consoles.attach(&caller, role, sitting));
                }
                own.console.as_ref().map(ConsoleRegistration::number)
            }
            Transport::Socket(attached) => Some(attached.set_presence(sitting)),
            Transport::Starting(_) => None,
        }
    }

    /// Serves the live scene to viewers at this address. Returns whether the engine has a renderer; an event reports the
    /// result. Waits for an engine in another process.
    #[must_use]
    pub fn serve_scene(&self, address: std::net::SocketAddr) -> bool {
        match &self.transport {
            Transport::Thread(own) => own.shared.serve.get().is_some_and(|serve| serve(address)),
            Transport::Socket(_) => {
                let client = Client::connect_within(&self.layout, SCENE_PATIENCE).ok().flatten();
                client.is_some_and(|mut client| client.serve_scene(address).unwrap_or(false))
            }
            Transport::Starting(_) => false,
        }
    }

    /// The engine of another process on the store, if this process has none.
    #[must_use]
    pub fn remote_engine(&self) -> RemoteEngine {
        RemoteEngine::new(self.layout.clone())
    }

    pub fn identities(&self) -> PathBuf {
        self.layout.identities()
    }

    /// The folder of the store's scene recordings.
    #[must_use]
    pub fn recordings(&self) -> PathBuf {
        self.layout.recordings()
    }

    pub fn logs(&self) -> PathBuf {
        self.layout.logs()
    }

    /// Ends an engine of this process cleanly: stops the arm, activates nothing. Does not end one of another process.
    ///
    /// # Errors
    /// [`StopError`] if it takes longer than `patience`, or ended with an error.
    pub fn stop(self, patience: Duration) -> Result<(), StopError> {
        let Self { mut updates, transport, .. } = self;
        match transport {
            Transport::Thread(own) => own.stop(&mut updates, patience),
            Transport::Socket(_) | Transport::Starting(_) => Ok(()),
        }
    }
}

fn run(
    launch: (LaunchConfig, ReadProgressFn),
    incoming: &Receiver<Request>,
    mut publisher: Publisher,
    (frame_sender, views): (watch::Sender<Option<Arc<VideoFrame>>>, LiveViews),
    shared: &EngineShared,
) -> Result<(), EngineEndError> {
    let _ = rustix::process::nice(NICE);
    let mut early = EarlyFrontEnd { incoming, waiting: Vec::new(), publisher: &mut publisher, shared };
    let started = catch_unwind(AssertUnwindSafe(|| start(launch, &mut early, (frame_sender, views))));
    let waiting = early.waiting;
    let started = started.unwrap_or_else(|panic| {
        Err(EngineEndError::of(format!("the start failed: {}", panic_message(&*panic))))
    });
    let mut untaken = Vec::new();
    let ended = match started {
        Ok(Some(pump)) => {
            if let Some(serve) = pump.serve() {
                drop(shared.serve.set(serve));
            }
            publisher.send_update(EngineUpdate::Started);
            let first = waiting.into_iter().map(|(request, _)| request).collect();
            EngineLoop::new(pump, incoming, first).run(&mut publisher);
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
        untaken.extend(incoming.try_iter());
    }
    for request in untaken {
        publisher.send_update(EngineUpdate::Returned(Box::new(request)));
    }
    publisher.send_update(EngineUpdate::Ended(ended.clone()));
    ended
}

struct EarlyFrontEnd<'a> {
    incoming: &'a Receiver<Request>,
    waiting: Vec<(Request, Instant)>,
    publisher: &'a mut Publisher,
    shared: &'a EngineShared,
}

impl EarlyFrontEnd<'_> {
    /// Answers waiting requests if possible. Returns whether the front end is gone.
    fn requests(&mut self, bootstrap: &mut EngineBootstrap<'_>) -> bool {
        loop {
            match self.incoming.try_recv() {
                Ok(request) => self.waiting.push((request, Instant::now())),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => return true,
            }
        }
        for (request, since) in std::mem::take(&mut self.waiting) {
            match bootstrap.answer(&request, since.elapsed()) {
                Some(reply) => self.publisher.answer(request.id, reply),
                None => self.waiting.push((request, since)),
            }
        }
        self.publisher.is_lost()
    }
}

/// Shows the unverified state while the record is read, then starts the engine. `None` if a request ended it before.
fn start(
    (config, watch): (LaunchConfig, ReadProgressFn),
    early: &mut EarlyFrontEnd<'_>,
    (frame_sender, views): (watch::Sender<Option<Arc<VideoFrame>>>, LiveViews),
) -> Result<Option<Pump>, EngineEndError> {
    let (jobs, robot) = (config.workers(), config.robot.as_deref());
    let site_file = config.site.as_ref().map(|site| site.file.as_path());
    let begun = Instant::now();
    let engine_config = Config {
        data: &config.data,
        profile: config.profile,
        seeds: config.seeds,
        jobs,
        scripted: false,
        cell: Cell::at(&*config.cells, robot, config.site.as_ref())
            .map_err(|error| EngineEndError::without_cell(robot.or(site_file), &error))?,
        cache: EpisodeCache::InStore,
    };
    let mut bootstrap =
        EngineBootstrap::open(engine_config, SignalHandling::Handled, watch).map_err(EngineEndError::from)?;
    if let Some(access) = config.console_access {
        bootstrap.serve_console_group(&access.folder, access.roles).map_err(BootstrapError::from)?;
    }
    drop(early.shared.switch.set(bootstrap.switch()));
    bootstrap.show(views);
    let (consoles, scenes) = (bootstrap.consoles(), bootstrap.scenes());
    if let Some(alone_max) = config.alone_max {
        consoles.end_alone_after(alone_max);
    }
    early.publisher.set_consoles(Arc::clone(&consoles));
    drop(early.shared.consoles.set(bootstrap.consoles()));
    while !bootstrap.turn() {
        if early.requests(&mut bootstrap) || bootstrap.has_ended() || consoles.unattended_for().is_some() {
            return Ok(None);
        }
        if bootstrap.has_records() && begun.elapsed() >= LOOK_PATIENCE {
            early.publisher.show(|| bootstrap.snapshot());
        }
    }
    if bootstrap.has_ended() {
        return Ok(None);
    }
    let (engine, socket) = bootstrap.enter().map_err(EngineEndError::from)?;
    let mut pump = Pump::with_socket(engine, socket, config.sinks);
    drop(pump.serve().map(|serve| scenes.set(serve)));
    let others = pump.frame_sink();
    let sink = move |frame: VideoFrame| {
        if let Some(take) = &others {
            take(frame.clone());
        }
        frame_sender.send_replace(Some(Arc::new(frame)));
    };
    pump.pace_live_world(config.pace, Arc::new(sink));
    Ok(Some(pump))
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_protocol::command::Reply;
    use holdpoint_registry::Store;
    use holdpoint_trials::seeds::EpisodeSeeds;

    fn config(data: PathBuf, jobs: usize) -> LaunchConfig {
        LaunchConfig {
            data,
            profile: holdpoint_governance::profile::ProfileName::Sim.into(),
            seeds: EpisodeSeeds::OfRun(1),
            jobs,
            cells: Arc::new(holdpoint_sim::SimCells),
            robot: None,
            site: None,
            pace: None,
            sinks: Vec::new(),
            alone_max: None,
            console_access: None,
        }
    }

    #[test]
    fn default_worker_count_leaves_one_core_free() {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        assert_eq!(config(PathBuf::new(), 0).workers(), (cores - 1).max(1));
        assert_eq!(config(PathBuf::new(), 3).workers(), 3);
    }

    /// A stop for an engine that never came up was answered with "busy", or not at all.
    #[test]
    fn requests_to_an_engine_that_does_not_start_are_returned() {
        let folder = tempfile::tempdir().unwrap();
        let _held = Store::open(folder.path()).unwrap();
        let mut host = EngineHandle::start(config(folder.path().to_owned(), 1));
        let stop = |id: &str| {
            Request::unsigned(id.to_owned(), Command::Stop { by: "ana".to_owned(), reason: String::new() })
        };
        let mut back = match host.submit(stop("early")) {
            Ok(()) => Vec::new(),
            Err(RequestRejected::Ended(request)) => vec![*request],
            Err(busy) => panic!("{busy}"),
        };
        let why = loop {
            match host.updates.blocking_recv() {
                Some(EngineUpdate::Returned(request)) => back.push(*request),
                Some(EngineUpdate::Ended(ended)) => break ended.unwrap_err(),
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(back, [stop("early")]);
        assert!(why.in_use, "{why}");
        for count in 0..=OUTSTANDING_MAX {
            let result = host.submit(stop(&count.to_string()));
            assert_eq!(result, Err(RequestRejected::Ended(Box::new(stop(&count.to_string())))), "never busy");
        }
        assert!(matches!(host.remote_engine().send(stop("late").command), Reply::Refused { .. }));
        assert_eq!(host.stop(Duration::from_mins(1)), Err(StopError::Failed(why)));
    }
}
