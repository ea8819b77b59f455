//! The engine's door for other processes: a unix socket in the store's folder, JSON lines both ways.
//!
//! The engine is synchronous and belongs to one thread; the socket is served by another. Requests reach the
//! engine through three bounded queues and are carried out between two slices ([`Door::poll`]), what takes authority away
//! before anything else; what it tells goes to
//! every subscriber through a bounded ring ([`Door::publish`]), of which a slow one loses the oldest and is told
//! how many. Who may connect is the process's own user, and members of a group at a second socket ([`Door::serve_seats`]).
//!
//! Must not decide anything, and must not keep the engine waiting: nothing here blocks it but [`Door::wait`].

mod accounts;
mod attended;
mod classes;
mod client;
mod origin;
mod room;
mod seats;
mod server;
mod socket;
mod stop_call;

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::{broadcast, oneshot};
use tokio_util::sync::CancellationToken;

pub use attended::{LET_GO_AFTER, LiveViews, PAST_MAX, READS_WITHIN, SHOWN_TO_NOBODY};
pub use classes::{ASKING_MAX, BRAKING_MAX, IDLE_MAX, OBSERVERS_MAX};
pub use client::{Attachment, Client, Notification, Sayer, Shown, Subscription};
pub use origin::{Doubt, Origin};
pub use seats::{Seat, Seats};
pub use socket::socket_path;
pub use stop_call::{NOT_CONFIRMED_HINT, StopCall, StopOutcome, not_confirmed, stopped_by_mark};

use self::accounts::Accounts;
use self::classes::Classes;
use super::Engine;
use crate::stop_mark::MarkWatch;
use crate::world::switch::Switch;
use holdpoint_protocol::command::{Caller, Command, Reply, Request};
use holdpoint_protocol::event::Event;
use holdpoint_protocol::sink::Serve;
use holdpoint_protocol::wire;
use holdpoint_registry::Layout;
use holdpoint_text::Hint;

/// The most requests that wait for the engine; more than are answered at a time, so that only stops can fill it.
pub const REQUESTS_MAX: usize = 64;

/// For how long requests are carried out in one turn that do not take authority away.
const OTHERS_MAX: Duration = Duration::from_millis(20);

/// The most events kept for a subscriber that reads slowly.
pub const EVENTS_KEPT: usize = 1024;

/// The door cannot be opened or used.
#[derive(Debug, thiserror::Error)]
pub enum DoorError {
    /// The socket's path does not fit.
    #[error("the socket's path {path:?} has {bytes} bytes; at most {allowed} are allowed")]
    PathTooLong {
        path: PathBuf,
        bytes: usize,
        /// How long it may be.
        allowed: usize,
    },
    /// Something that is no socket has the socket's name, or another engine answers there.
    #[error("{path:?} {problem}")]
    Taken {
        path: PathBuf,
        problem: &'static str,
        /// What to do about it.
        hint: &'static str,
    },
    #[error("cannot {what} {path:?}: {source}")]
    Io { what: &'static str, path: PathBuf, source: std::io::Error },
    /// The other side belongs to somebody else.
    #[error("{path:?} is served by the user {uid}, not by you")]
    Foreign { path: PathBuf, uid: u32 },
    /// The other side does not speak this protocol.
    #[error("{path:?} answers something else than expected: {problem}")]
    Protocol { path: PathBuf, problem: String },
    /// The engine closed the connection and said why, and what to do.
    #[error("the engine at {path:?} closed the connection: {text}")]
    Closed { path: PathBuf, text: String },
    /// No answer in time.
    #[error(
        "the engine at {path:?} did not answer within {secs} s; whether the command was carried out is not known"
    )]
    NoAnswer {
        path: PathBuf,
        /// How long was waited, s.
        secs: u64,
    },
    /// An engine is there and says nothing.
    #[error("the engine at {path:?}, process {process}, does not answer: {}", why_silent(*stopped))]
    Silent {
        path: PathBuf,
        process: i32,
        /// Whether a signal stopped it.
        stopped: bool,
    },
    /// The engine ended meanwhile.
    #[error("the engine at {path:?} has ended")]
    Ended { path: PathBuf },
    /// The system gave no random numbers for a command's id.
    #[error(transparent)]
    Random(#[from] holdpoint_approvals::ApprovalError),
}

const fn why_silent(stopped: bool) -> &'static str {
    if stopped { "a signal stopped it" } else { "it is busy, or hangs" }
}

impl Hint for DoorError {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::PathTooLong { .. } => Some("choose a shorter folder with --data".into()),
            Self::Taken { hint, .. } => Some((*hint).into()),
            Self::Silent { process, stopped: true, .. } => {
                Some(format!("`kill -CONT {process}` lets it go on; nothing moves the arm meanwhile").into())
            }
            Self::Protocol { .. } => Some("use the same version of holdpoint".into()),
            Self::Random(error) => error.hint(),
            Self::Closed { .. }
            | Self::Io { .. }
            | Self::Foreign { .. }
            | Self::NoAnswer { .. }
            | Self::Silent { stopped: false, .. }
            | Self::Ended { .. } => None,
        }
    }
}

impl DoorError {
    fn io(what: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { what, path, source }
    }
}

/// Whether the process's signals to end (SIGTERM, SIGINT, SIGHUP) are taken by the door.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signals {
    /// They make [`Door::endings_asked`] count; the process goes on until its loop ends.
    Taken,
    /// They do what they did.
    Left,
}

/// What comes in from the socket's thread.
enum Incoming {
    /// What is asked, whose process asks, and where the answer goes.
    Request(Box<Request>, Caller, oneshot::Sender<Reply>),
    /// Something else is to be looked at.
    Wake,
}

/// A request that came before the engine was up.
struct EarlyRequest {
    request: Box<Request>,
    caller: Caller,
    answer: oneshot::Sender<Reply>,
    since: Instant,
}

/// The engine's side of the door. Closes it when dropped.
pub struct Door {
    incoming: Receiver<Incoming>,
    /// What takes authority away: taken before anything else.
    braking: Receiver<Incoming>,
    /// What every verb asks first, and costs little.
    looking: Receiver<Incoming>,
    /// Whether the next turn is a look's.
    looks_next: bool,
    /// Whether a wake is on its way.
    woken: Arc<AtomicBool>,
    waiting: Option<Incoming>,
    later: Vec<(String, oneshot::Sender<Reply>)>,
    /// What waits for the engine to come up.
    early: Vec<EarlyRequest>,
    events: broadcast::Sender<Arc<str>>,
    endings: Arc<AtomicUsize>,
    stop: CancellationToken,
    thread: Option<JoinHandle<()>>,
    socket: PathBuf,
    seats: Arc<Seats>,
    shown: Arc<attended::Shown>,
    /// What happened last, for whoever attaches later.
    past: Arc<Mutex<attended::Past>>,
    scenes: Scenes,
    /// For a second socket.
    server: server::DoorServer,
    /// The socket of other accounts' seats: its folder, its name, and who serves it.
    seats_socket: Option<(socket::SeatsFolder, PathBuf, JoinHandle<()>)>,
    /// How often the socket's name was taken, and how often of these the engine was told.
    names_taken: (Arc<AtomicU64>, u64),
    /// Sees a stop that is asked for by a mark in the store's folder. Ends before the socket's name is free.
    marks: Option<MarkWatch>,
}

/// How the live scene is served; empty as long as it cannot be.
pub type Scenes = Arc<OnceLock<Serve>>;

impl Door {
    /// Opens the door of the store that the caller's engine has. A socket left by an engine that is gone is
    /// removed. A second signal to end sets `cancel`, which interrupts the slice that runs.
    ///
    /// A request to stop the cell stops the arm through `switch` when it is read, before the engine has it.
    ///
    /// # Errors
    /// [`DoorError`].
    pub fn open(
        layout: &Layout,
        cancel: Arc<AtomicBool>,
        switch: Arc<Switch>,
        signals: Signals,
    ) -> Result<Self, DoorError> {
        let socket = socket_path(layout);
        let listener = socket::bind(&socket, socket::Openness::Owner)?;
        let marks = MarkWatch::start(layout.clone(), Arc::clone(&switch))
            .map_err(DoorError::io("watch", layout.folder()))?;
        let (sender, incoming) = sync_channel(REQUESTS_MAX);
        let (brakes, braking) = sync_channel(REQUESTS_MAX);
        let (looks, looking) = sync_channel(REQUESTS_MAX);
        let woken = Arc::<AtomicBool>::default();
        let (events, _) = broadcast::channel(EVENTS_KEPT);
        let endings = Arc::new(AtomicUsize::new(0));
        let stop = CancellationToken::new();
        let (seats, shown) = (Arc::<Seats>::default(), Arc::<attended::Shown>::default());
        let past = Arc::<Mutex<attended::Past>>::default();
        let scenes = Scenes::default();
        let names_taken = Arc::<AtomicU64>::default();
        let serve = server::DoorServer {
            requests: sender,
            braking: brakes,
            looking: looks,
            woken: Arc::clone(&woken),
            events: events.clone(),
            endings: Arc::clone(&endings),
            cancel,
            switch,
            stop: stop.clone(),
            classes: Classes::default(),
            seats: Arc::clone(&seats),
            shown: Arc::clone(&shown),
            past: Arc::clone(&past),
            scenes: Arc::clone(&scenes),
            names_taken: Arc::clone(&names_taken),
            accounts: Accounts::Owner { uid: rustix::process::geteuid().as_raw() },
            marks: layout.stop_marks(),
        };
        let server = serve.clone();
        let thread = serve.start(listener, signals).map_err(DoorError::io("serve", &socket))?;
        Ok(Self {
            incoming,
            braking,
            looking,
            looks_next: true,
            woken,
            waiting: None,
            later: Vec::new(),
            early: Vec::new(),
            events,
            endings,
            stop,
            thread: Some(thread),
            socket,
            seats,
            shown,
            past,
            scenes,
            server,
            seats_socket: None,
            names_taken: (names_taken, 0),
            marks: Some(marks),
        })
    }

    /// Listens in a second folder as well, for the group of that folder.
    ///
    /// # Errors
    /// [`DoorError`]: others may write to the folder, or it is another engine's.
    pub fn serve_seats(&mut self, folder: &Path) -> Result<(), DoorError> {
        let taken = socket::SeatsFolder::take(folder)?;
        let path = socket_path(&Layout::new(folder));
        let listener = taken.bind(&path)?;
        let server = server::DoorServer { accounts: Accounts::Seats, ..self.server.clone() };
        let thread = server.start(listener, Signals::Left).map_err(DoorError::io("serve", &path))?;
        self.seats_socket = Some((taken, path, thread));
        Ok(())
    }

    /// Has the engine shown to whoever attaches, from now on.
    pub fn show(&self, views: LiveViews) {
        self.shown.set(views);
    }

    /// Where it is put how the live scene is served, once it can be.
    #[must_use]
    pub fn scenes(&self) -> Scenes {
        Arc::clone(&self.scenes)
    }

    /// Who looks at the engine.
    #[must_use]
    pub fn seats(&self) -> Arc<Seats> {
        Arc::clone(&self.seats)
    }

    /// Before there is an engine: `answer` is given every request that waits, whose it is and for how long it has
    /// waited; what it does not answer waits on.
    pub(crate) fn poll_early(
        &mut self,
        mut answer: impl FnMut(&Request, &Caller, Duration) -> Option<Reply>,
    ) {
        while let Some(next) = self.next_brake().or_else(|| self.next_other()) {
            if let Incoming::Request(request, caller, answer) = next {
                note_ending(&self.seats, &request, &caller);
                self.early.push(EarlyRequest { request, caller, answer, since: Instant::now() });
            }
        }
        for early in std::mem::take(&mut self.early) {
            match answer(&early.request, &early.caller, early.since.elapsed()) {
                Some(mut reply) => {
                    if let Reply::Snapshot { snapshot } = &mut reply {
                        self.seats.show_in(snapshot);
                    }
                    drop(early.answer.send(reply));
                }
                None => self.early.push(early),
            }
        }
    }

    /// Hands every request that waits to the engine, without blocking. Returns how many there were.
    pub fn poll(&mut self, engine: &mut Engine) -> usize {
        let mut done = 0;
        self.answer_later(engine);
        let mut early = std::mem::take(&mut self.early);
        early.sort_by_key(|early| !early.request.command.takes_authority_away());
        for EarlyRequest { request, caller, answer, .. } in early {
            self.hand_over(engine, *request, caller, answer);
            done += 1;
        }
        // A bound, so that a busy client cannot keep the engine from its work.
        let until = Instant::now() + OTHERS_MAX;
        while done < REQUESTS_MAX {
            let next = match self.next_brake() {
                Some(brake) => brake,
                // Whatever only reads waits until the arm stands, and what it stands for is done.
                None if engine.is_braking() || Instant::now() >= until => break,
                None => match self.next_other() {
                    Some(other) => other,
                    None => break,
                },
            };
            if let Incoming::Request(request, caller, answer) = next {
                self.hand_over(engine, *request, caller, answer);
                done += 1;
            }
        }
        done
    }

    fn next_brake(&self) -> Option<Incoming> {
        self.braking.try_recv().ok()
    }

    /// Looks and whatever else there is, in turn: whoever reads evidence without pause keeps no verb from beginning, and
    /// whoever looks without pause keeps none from ending.
    fn next_other(&mut self) -> Option<Incoming> {
        let look = |door: &Self| door.looking.try_recv().ok();
        let other = |door: &mut Self| {
            let next = door.waiting.take().or_else(|| door.incoming.try_recv().ok());
            if let Some(Incoming::Wake) = next {
                door.woken.store(false, Ordering::Release);
            }
            next
        };
        self.looks_next = !self.looks_next;
        if self.looks_next { other(self).or_else(|| look(self)) } else { look(self).or_else(|| other(self)) }
    }

    fn hand_over(
        &mut self,
        engine: &mut Engine,
        request: Request,
        caller: Caller,
        answer: oneshot::Sender<Reply>,
    ) {
        let id = request.id.clone();
        note_ending(&self.seats, &request, &caller);
        // Whoever asked may be gone; what was asked is done all the same.
        match engine.offer_for(request, caller) {
            Some(mut reply) => {
                if let Reply::Snapshot { snapshot } = &mut reply {
                    self.seats.show_in(snapshot);
                }
                drop(answer.send(reply));
            }
            None => self.later.push((id, answer)),
        }
    }

    /// Answers what had to wait for the end of a sequence.
    fn answer_later(&mut self, engine: &Engine) {
        for (id, answer) in std::mem::take(&mut self.later) {
            match engine.answer_of(&id) {
                Some(reply) => drop(answer.send(reply)),
                None => self.later.push((id, answer)),
            }
        }
    }

    pub fn publish(&self, events: &[Event]) {
        if events.is_empty() {
            return;
        }
        // Held for as long as it takes to copy what is kept, when somebody attaches.
        let mut past = self.past.lock().unwrap_or_else(PoisonError::into_inner);
        for event in events {
            past.note(event);
        }
        if self.events.receiver_count() == 0 {
            return;
        }
        for event in events {
            if let Ok(line) = wire::line(&wire::Answer::Event { event: Box::new(event.clone()) }) {
                // No subscriber left in between is no error.
                drop(self.events.send(line.into()));
            }
        }
    }

    /// Waits until something came in, or for `at_most`.
    pub fn wait(&mut self, at_most: Duration) {
        if self.waiting.is_some() {
            return;
        }
        match self.incoming.recv_timeout(at_most) {
            Ok(next) => self.waiting = Some(next),
            Err(RecvTimeoutError::Timeout) => {}
            // Nobody serves the socket any more; the loop must not spin for that.
            Err(RecvTimeoutError::Disconnected) => std::thread::sleep(at_most),
        }
    }

    /// How often another program took the socket's name by now, if it did since this was asked last.
    pub(crate) fn name_taken_anew(&mut self) -> Option<u64> {
        let (count, told) = &mut self.names_taken;
        let now = count.load(Ordering::Acquire);
        (std::mem::replace(told, now) != now).then_some(now)
    }

    /// How often a signal asked the process to end.
    #[must_use]
    pub fn endings_asked(&self) -> usize {
        self.endings.load(Ordering::Acquire)
    }

    #[must_use]
    pub fn socket(&self) -> &Path {
        &self.socket
    }
}

/// Whoever asks for the end is whom it was ended by.
fn note_ending(seats: &Seats, request: &Request, caller: &Caller) {
    if !matches!(request.command, Command::Shutdown) {
        return;
    }
    seats.note_ending(|| {
        let process = match caller {
            Caller::Process { process, .. } => *process,
            Caller::Script => None,
        };
        process.and_then(|process| seats.named(process)).unwrap_or_else(|| caller.to_string())
    });
}

impl Drop for Door {
    fn drop(&mut self) {
        drop(self.marks.take());
        self.stop.cancel();
        // Requests that wait are answered by their connections: the engine ends.
        self.waiting = None;
        self.early.clear();
        let queues = [&self.incoming, &self.braking, &self.looking];
        while queues.iter().any(|queue| queue.try_recv().is_ok()) {}
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
        // The store's lock is still held, and that of the seats' folder: the names are this engine's own.
        drop(std::fs::remove_file(&self.socket));
        if let Some((_folder, path, thread)) = self.seats_socket.take() {
            drop(thread.join());
            drop(std::fs::remove_file(path));
        }
    }
}
