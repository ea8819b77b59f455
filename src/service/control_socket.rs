//! The engine's socket for other processes: a unix socket in the store's folder, JSON lines in both directions.
//!
//! The engine is synchronous and belongs to one thread; another thread serves the socket. Requests reach the engine through
//! three bounded queues, and it carries them out between two slices ([`ControlSocket::poll`]), those that take authority
//! away first. Its events go to every subscriber through a bounded ring ([`ControlSocket::publish`]); a slow subscriber
//! loses the oldest ones and receives their count. The process's own user may connect, and at a second socket the members
//! of a group ([`ControlSocket::serve_console_group`]).
//!
//! Must decide nothing, and must not block the engine except in [`ControlSocket::wait`].

mod accounts;
mod answer_origin;
mod attached_console;
mod call_line;
mod client;
mod connection_limits;
mod console_registry;
mod fd_reserve;
mod server;
mod socket_file;
mod stop_call;

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::{broadcast, oneshot};
use tokio_util::sync::CancellationToken;

pub use accounts::AccountRoles;
pub use answer_origin::{AnswerOrigin, UnverifiedOrigin};
pub use attached_console::{
    FRAME_INTERVAL_MS, LET_GO_AFTER, LiveViews, PAST_MAX, READS_WITHIN, SHOWN_TO_NOBODY,
};
pub use client::{Client, ConsoleConnection, ConsoleMessage, Notification, PresenceSender, Subscription};
pub use connection_limits::{
    ACCOUNT_CONNECTIONS_MAX, ACCOUNT_RECEIVERS_MAX, ASKING_MAX, BRAKING_MAX, IDLE_MAX, OBSERVERS_MAX,
    OWNER_RECEIVERS_MIN,
};
pub use console_registry::{ConsoleRegistration, ConsoleRegistry};
pub use socket_file::socket_path;
pub use stop_call::{NOT_CONFIRMED_HINT, StopCall, StopOutcome, not_confirmed};

use self::accounts::AllowedAccounts;
use self::connection_limits::ConnectionLimits;
use holdpoint_engine::Engine;
use holdpoint_engine::live::stop_mark::StopMarkWatch;
use holdpoint_engine::live::stop_switch::StopSwitch;
use holdpoint_protocol::command::{Caller, Command, Reply, Request};
use holdpoint_protocol::event::Event;
use holdpoint_protocol::sink::ServeScene;
use holdpoint_protocol::wire;
use holdpoint_store::Layout;
use holdpoint_text::users::described_user;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint, shell_word};

/// The most requests that wait for the engine; more than are answered at a time, so that only stops can fill the queue.
pub const REQUESTS_MAX: usize = 64;

/// How long one turn carries out requests that do not take authority away.
const OTHERS_MAX: Duration = Duration::from_millis(20);

/// The most events kept for a subscriber that reads slowly.
pub const EVENTS_KEPT: usize = 1024;

/// The socket cannot be opened or used.
#[derive(Debug, thiserror::Error)]
pub enum ControlSocketError {
    /// The socket's path does not fit.
    #[error("the socket's path {path:?} has {bytes} bytes; at most {allowed} are allowed")]
    PathTooLong {
        path: PathBuf,
        bytes: usize,
        /// How long it may be.
        allowed: usize,
    },
    /// Another kind of file has the socket's name, another engine answers there, or the folder is not this account's own.
    #[error("{path:?} {problem}")]
    Taken {
        path: PathBuf,
        problem: String,
        /// How to resolve it.
        hint: String,
    },
    /// Another process holds the lock of the folder of the second socket.
    #[error("{path:?} is locked by {holder}")]
    Locked {
        path: PathBuf,
        /// The process and its account.
        holder: String,
        /// How to resolve it.
        hint: String,
    },
    #[error("the socket {path:?} cannot be opened to its group: {problem}")]
    GroupRefused {
        path: PathBuf,
        problem: String,
        /// How to resolve it.
        hint: String,
    },
    #[error("cannot {what} {path:?}: {source}")]
    Io { what: &'static str, path: PathBuf, source: std::io::Error },
    #[error("{path:?} is served by user {}, not by you", described_user(*uid))]
    Foreign { path: PathBuf, uid: u32 },
    #[error(
        "the socket {path:?} is answered by another program, or by another version of holdpoint: {problem}"
    )]
    Protocol { path: PathBuf, problem: String },
    /// The engine closed the connection with a reason and a hint.
    #[error("the engine at {path:?} closed the connection: {text}")]
    Closed { path: PathBuf, text: String },
    #[error(
        "the engine at {path:?} did not answer within {secs} s; whether the command was carried out is not known"
    )]
    NoAnswer {
        path: PathBuf,
        /// How long the client waited, s.
        secs: u64,
    },
    #[error("the engine at {path:?}, process {process}, does not answer: {}", why_silent(*stopped))]
    Silent {
        path: PathBuf,
        process: i32,
        /// Whether a signal stopped it.
        stopped: bool,
    },
    #[error("the engine at {path:?} has ended")]
    Ended { path: PathBuf },
    #[error(transparent)]
    Random(#[from] holdpoint_approvals::ApprovalError),
}

const fn why_silent(stopped: bool) -> &'static str {
    if stopped { "a signal stopped it" } else { "it is busy, or hangs" }
}

impl Hint for ControlSocketError {
    fn details(&self) -> Option<ErrorDetails> {
        let unusable = |cause| ErrorDetails::from(ErrorReason::ControlSocket).with_cause(cause);
        Some(match self {
            Self::PathTooLong { .. } => unusable("path-too-long"),
            Self::Taken { path, .. } => {
                ErrorDetails::of_path(ErrorReason::ControlSocket, path).with_cause("taken")
            }
            Self::Locked { path, .. } => {
                ErrorDetails::of_path(ErrorReason::ControlSocket, path).with_cause("locked")
            }
            Self::GroupRefused { .. } => unusable("group"),
            Self::Io { .. } => unusable("io"),
            Self::Foreign { .. } => unusable("foreign"),
            Self::Protocol { path, .. } => {
                ErrorDetails::of_path(ErrorReason::ControlSocket, path).with_cause("protocol")
            }
            Self::Closed { .. } => unusable("closed"),
            Self::NoAnswer { .. } | Self::Silent { .. } | Self::Ended { .. } => ErrorReason::NoAnswer.into(),
            Self::Random(error) => return error.details(),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::PathTooLong { .. } => Some("choose a shorter folder with --data".into()),
            Self::Taken { hint, .. } | Self::Locked { hint, .. } | Self::GroupRefused { hint, .. } => {
                Some(hint.clone().into())
            }
            Self::Silent { process, stopped: true, .. } => {
                Some(format!("`kill -CONT {process}` resumes it; nothing moves the arm meanwhile").into())
            }
            Self::Protocol { path, .. } => {
                let folder = path.parent().unwrap_or(Path::new(".")).display().to_string();
                Some(
                    format!(
                        "`holdpoint store info --data {}` names the process that has the store: end it, or use its version",
                        shell_word(&folder)
                    )
                    .into(),
                )
            }
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

impl ControlSocketError {
    fn io(what: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { what, path, source }
    }
}

/// Whether the socket handles the process's termination signals (SIGTERM, SIGINT, SIGHUP).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SignalHandling {
    /// They make [`ControlSocket::end_signals`] count; the process continues until its loop ends.
    Handled,
    /// Their previous handling stays.
    Default,
}

enum SocketMessage {
    /// A request, its process, and the channel for the answer.
    Request(Box<Request>, Caller, oneshot::Sender<Reply>),
    /// The engine should check another source.
    Wake,
}

/// A request from before the engine was up.
struct EarlyRequest {
    request: Box<Request>,
    caller: Caller,
    answer: oneshot::Sender<Reply>,
    since: Instant,
}

/// The engine's side of the socket. Closes it when dropped.
pub struct ControlSocket {
    incoming: Receiver<SocketMessage>,
    /// Requests that take authority away, taken first.
    braking: Receiver<SocketMessage>,
    /// Cheap requests that every client sends first.
    looking: Receiver<SocketMessage>,
    /// Whether the next turn takes a cheap request.
    looks_next: bool,
    waiting: Option<SocketMessage>,
    later: Vec<(String, oneshot::Sender<Reply>)>,
    /// Requests that wait for the engine to come up.
    early: Vec<EarlyRequest>,
    thread: Option<JoinHandle<()>>,
    socket: PathBuf,
    /// What both sides share.
    server: server::ControlSocketServer,
    /// The socket for consoles of other accounts: its folder, its name, and its thread.
    console_socket: Option<(socket_file::ConsoleSocketFolder, PathBuf, JoinHandle<()>)>,
    /// How often another program took the socket's name, as far as the engine knows.
    names_known: u64,
    /// Detects a stop requested by a mark in the store's folder. Ends before the socket's name is free.
    marks: Option<StopMarkWatch>,
}

/// Serves the live scene; empty as long as this is impossible.
pub type SceneServerSlot = Arc<OnceLock<ServeScene>>;

impl ControlSocket {
    /// Opens the socket of the store that the caller's engine has locked, and removes the socket of an earlier engine. A
    /// second termination signal sets `cancel`, which interrupts the running slice.
    ///
    /// A request to stop the cell stops the arm through `switch` when it is read, before the engine receives it.
    ///
    /// # Errors
    /// [`ControlSocketError`].
    pub fn open(
        layout: &Layout,
        cancel: Arc<AtomicBool>,
        switch: Arc<StopSwitch>,
        signals: SignalHandling,
    ) -> Result<Self, ControlSocketError> {
        let socket = socket_path(layout);
        let listener = socket_file::bind(&socket, socket_file::SocketAccess::Owner)?;
        let marks = StopMarkWatch::start(layout.clone(), Arc::clone(&switch))
            .map_err(ControlSocketError::io("watch", layout.folder()))?;
        let (sender, incoming) = sync_channel(REQUESTS_MAX);
        let (brakes, braking) = sync_channel(REQUESTS_MAX);
        let (looks, looking) = sync_channel(REQUESTS_MAX);
        let (events, _) = broadcast::channel(EVENTS_KEPT);
        let server = server::ControlSocketServer {
            requests: sender,
            braking: brakes,
            looking: looks,
            woken: Arc::default(),
            events,
            endings: Arc::default(),
            cancel,
            switch,
            stop: CancellationToken::new(),
            classes: ConnectionLimits::default(),
            consoles: Arc::default(),
            shown: Arc::default(),
            past: Arc::default(),
            scenes: SceneServerSlot::default(),
            names_taken: Arc::default(),
            accounts: AllowedAccounts::Owner { uid: rustix::process::geteuid().as_raw() },
            marks: layout.stop_marks(),
        };
        let thread =
            server.clone().start(listener, signals).map_err(ControlSocketError::io("serve", &socket))?;
        Ok(Self {
            incoming,
            braking,
            looking,
            looks_next: true,
            waiting: None,
            later: Vec::new(),
            early: Vec::new(),
            thread: Some(thread),
            socket,
            server,
            console_socket: None,
            names_known: 0,
            marks: Some(marks),
        })
    }

    /// Listens in a second folder as well, for the members of that folder's group.
    ///
    /// # Errors
    /// [`ControlSocketError`]: other users may write to the folder, its group cannot get the socket, or another engine uses
    /// it.
    pub fn serve_console_group(
        &mut self,
        folder: &Path,
        roles: AccountRoles,
    ) -> Result<(), ControlSocketError> {
        let taken = socket_file::ConsoleSocketFolder::take(folder)?;
        let path = socket_path(&Layout::new(folder));
        let listener = taken.bind(&path)?;
        let owner = rustix::process::geteuid().as_raw();
        let accounts = AllowedAccounts::ConsoleGroup { owner, roles: Arc::new(roles) };
        let server = server::ControlSocketServer { accounts, ..self.server.clone() };
        let thread = server
            .start(listener, SignalHandling::Default)
            .map_err(ControlSocketError::io("serve", &path))?;
        self.console_socket = Some((taken, path, thread));
        Ok(())
    }

    /// From now on shows the engine to every console that attaches.
    pub fn show(&self, views: LiveViews) {
        self.server.shown.set(views);
    }

    /// The slot for the function that serves the live scene.
    #[must_use]
    pub fn scenes(&self) -> SceneServerSlot {
        Arc::clone(&self.server.scenes)
    }

    /// The attached consoles.
    #[must_use]
    pub fn consoles(&self) -> Arc<ConsoleRegistry> {
        Arc::clone(&self.server.consoles)
    }

    /// Before the engine is up: passes `answer` every waiting request, its caller and its waiting time. A request without
    /// an answer keeps waiting.
    pub(crate) fn poll_early(
        &mut self,
        mut answer: impl FnMut(&Request, &Caller, Duration) -> Option<Reply>,
    ) {
        while let Some(next) = self.next_brake().or_else(|| self.next_other()) {
            if let SocketMessage::Request(request, caller, answer) = next {
                note_ending(&self.server.consoles, &request, &caller);
                self.early.push(EarlyRequest { request, caller, answer, since: Instant::now() });
            }
        }
        for early in std::mem::take(&mut self.early) {
            match answer(&early.request, &early.caller, early.since.elapsed()) {
                Some(mut reply) => {
                    if let Reply::Snapshot { snapshot } = &mut reply {
                        self.server.consoles.show_in(snapshot);
                    }
                    drop(early.answer.send(reply));
                }
                None => self.early.push(early),
            }
        }
    }

    /// Passes every waiting request to the engine, without blocking. Returns their number.
    pub fn poll(&mut self, engine: &mut Engine) -> usize {
        let mut done = 0;
        self.answer_later(engine);
        let mut early = std::mem::take(&mut self.early);
        early.sort_by_key(|early| !early.request.command.takes_authority_away());
        for EarlyRequest { request, caller, answer, .. } in early {
            self.hand_over(engine, *request, caller, answer);
            done += 1;
        }
        // A bound, so that a busy client cannot keep the engine from its slices.
        let until = Instant::now() + OTHERS_MAX;
        while done < REQUESTS_MAX {
            let next = match self.next_brake() {
                Some(brake) => brake,
                // Requests that only read wait until the arm is at standstill and the cause is handled.
                None if engine.is_braking() || Instant::now() >= until => break,
                None => match self.next_other() {
                    Some(other) => other,
                    None => break,
                },
            };
            if let SocketMessage::Request(request, caller, answer) = next {
                self.hand_over(engine, *request, caller, answer);
                done += 1;
            }
        }
        done
    }

    fn next_brake(&self) -> Option<SocketMessage> {
        self.braking.try_recv().ok()
    }

    /// Takes cheap requests and others in turn: a client that reads evidence without pause delays no other command's start,
    /// and a client that polls without pause delays no command's end.
    fn next_other(&mut self) -> Option<SocketMessage> {
        let look = |socket: &Self| socket.looking.try_recv().ok();
        let other = |socket: &mut Self| {
            let next = socket.waiting.take().or_else(|| socket.incoming.try_recv().ok());
            if let Some(SocketMessage::Wake) = next {
                socket.server.woken.store(false, Ordering::Release);
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
        note_ending(&self.server.consoles, &request, &caller);
        // The client may be gone; the engine carries out the request all the same.
        match engine.offer_for(request, caller) {
            Some(mut reply) => {
                if let Reply::Snapshot { snapshot } = &mut reply {
                    self.server.consoles.show_in(snapshot);
                }
                drop(answer.send(reply));
            }
            None => self.later.push((id, answer)),
        }
    }

    /// Answers requests that waited for the end of a sequence.
    pub(crate) fn answer_later(&mut self, engine: &Engine) {
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
        // Held only while a new console copies the backlog.
        let mut past = self.server.past.lock().unwrap_or_else(PoisonError::into_inner);
        for event in events {
            past.note(event);
        }
        if self.server.events.receiver_count() == 0 {
            return;
        }
        for event in events {
            if let Ok(line) = wire::line(&wire::ServerMessage::Event { event: Box::new(event.clone()) }) {
                // Having no subscriber is no error.
                drop(self.server.events.send(line.into()));
            }
        }
    }

    /// Waits until a message arrives, or for `at_most`.
    pub fn wait(&mut self, at_most: Duration) {
        if self.waiting.is_some() {
            return;
        }
        match self.incoming.recv_timeout(at_most) {
            Ok(next) => self.waiting = Some(next),
            Err(RecvTimeoutError::Timeout) => {}
            // The socket's thread has ended; the loop must not spin.
            Err(RecvTimeoutError::Disconnected) => std::thread::sleep(at_most),
        }
    }

    /// How often another program has taken the socket's name, if it did so since the last call.
    pub(crate) fn name_taken_anew(&mut self) -> Option<u64> {
        let now = self.server.names_taken.load(Ordering::Acquire);
        (std::mem::replace(&mut self.names_known, now) != now).then_some(now)
    }

    /// How many signals asked the process to end.
    #[must_use]
    pub fn end_signals(&self) -> usize {
        self.server.endings.load(Ordering::Acquire)
    }

    #[must_use]
    pub fn socket(&self) -> &Path {
        &self.socket
    }
}

/// Records the caller of a shutdown as the one who ends the engine.
fn note_ending(consoles: &ConsoleRegistry, request: &Request, caller: &Caller) {
    if !matches!(request.command, Command::Shutdown) {
        return;
    }
    consoles.note_ending(|| {
        let process = match caller {
            Caller::Process { process, .. } => *process,
            Caller::Script => None,
        };
        process.and_then(|process| consoles.named(process)).unwrap_or_else(|| caller.to_string())
    });
}

impl Drop for ControlSocket {
    fn drop(&mut self) {
        drop(self.marks.take());
        self.server.stop.cancel();
        // Their connections answer the waiting requests: the engine ends.
        self.waiting = None;
        self.early.clear();
        let queues = [&self.incoming, &self.braking, &self.looking];
        while queues.iter().any(|queue| queue.try_recv().is_ok()) {}
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
        // The locks of the store and of the console folder are still held, so the names are this engine's own.
        drop(std::fs::remove_file(&self.socket));
        if let Some((_folder, path, thread)) = self.console_socket.take() {
            drop(thread.join());
            drop(std::fs::remove_file(path));
        }
    }
}
