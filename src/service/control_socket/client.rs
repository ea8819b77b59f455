//! The client's side of the socket, for commands and consoles: synchronous, every wait bounded.

use std::io::{self, BufRead, BufReader, Read as _, Write as _};
use std::net::SocketAddr;
use std::os::unix::fs::MetadataExt as _;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::{AnswerOrigin, ControlSocketError, UnverifiedOrigin, socket_file, socket_path};
use holdpoint_approvals::{Nonce, SignedCall};
use holdpoint_protocol::command::{Command, Reply, Request};
use holdpoint_protocol::console_presence::ConsolePresence;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::video_frame::VideoFrame;
use holdpoint_protocol::wire::{
    self, ANSWER_BYTES_MAX, CALL_BYTES_MAX, ClientMessage, PROTOCOL, ServerMessage,
};
use holdpoint_store::Layout;

/// How long the first line may take.
const HELLO_SECS: u64 = 5;

/// How long a reply may take: the engine answers between two slices, and carries out a rollback first.
const REPLY_SECS: u64 = 120;

/// How long the client waits to send its presence to an engine that does not read.
const SAY_MAX: Duration = Duration::from_millis(20);

/// A connection to a running engine, or to another process at its socket: see [`Client::unverified_origin`].
#[derive(Debug)]
pub struct Client {
    lines: LineReader,
    origin: AnswerOrigin,
}

/// A stream of events from a running engine.
#[derive(Debug)]
pub struct Subscription {
    lines: LineReader,
}

#[derive(Debug)]
pub struct ConsoleConnection {
    lines: LineReader,
    origin: AnswerOrigin,
    console: u64,
}

#[derive(Clone, Debug, PartialEq)]
pub enum ConsoleMessage {
    Event(Box<Event>),
    /// This number of events was dropped because the client read too slowly.
    Missed(u64),
    Snapshot(Box<Snapshot>),
    Picture(Box<VideoFrame>),
    /// Earlier events, oldest first, and the number of events before those. Sent once, at the start.
    Past {
        events: Vec<Event>,
        earlier: u64,
    },
    /// The engine ends cleanly, and who ended it. The last message.
    Ended {
        by: String,
    },
}

/// A message to a subscriber.
#[derive(Clone, Debug, PartialEq)]
pub enum Notification {
    Event(Box<Event>),
    /// This number of events was dropped because the client read too slowly.
    Missed(u64),
}

impl Client {
    /// Connects to the engine that runs on a store; `None` if none does.
    ///
    /// # Errors
    /// [`ControlSocketError`] if the socket belongs to another user, or speaks another version.
    pub fn connect(layout: &Layout) -> Result<Option<Self>, ControlSocketError> {
        Self::connect_within(layout, Duration::from_secs(HELLO_SECS))
    }

    /// As [`Client::connect`], with a limit on the wait.
    ///
    /// # Errors
    /// As [`Client::connect`]; [`ControlSocketError::Silent`] if the engine is there but does not respond.
    pub fn connect_within(layout: &Layout, patience: Duration) -> Result<Option<Self>, ControlSocketError> {
        let Some(lines) = LineReader::connect(layout, patience)? else { return Ok(None) };
        let origin = AnswerOrigin::of(lines.process, layout.folder());
        Ok(Some(Self { lines, origin }))
    }

    /// As [`Client::connect_within`], but sends a request before the client verifies which process answers. For a stop alone:
    /// it harms nothing at another process, and the verification may take a while.
    pub(super) fn connect_asking(
        layout: &Layout,
        request: Request,
        patience: Duration,
    ) -> Result<Option<Self>, ControlSocketError> {
        let Some(mut lines) = LineReader::connect(layout, patience)? else { return Ok(None) };
        lines.send(&ClientMessage::Ask { request: Box::new(request) })?;
        let origin = AnswerOrigin::of(lines.process, layout.folder());
        Ok(Some(Self { lines, origin }))
    }

    /// Why answers are not known to come from the engine; `None` if they are.
    #[must_use]
    pub fn unverified_origin(&self) -> Option<UnverifiedOrigin> {
        self.origin.unverified()
    }

    /// Sends a command and waits for the reply. If the connection breaks before it, the client sends the same request once
    /// more over a new one: the engine carries out an id only once.
    ///
    /// # Errors
    /// [`ControlSocketError`]; after [`ControlSocketError::NoAnswer`] the outcome is not known.
    pub fn send(&mut self, command: Command) -> Result<Reply, ControlSocketError> {
        self.send_signed(command, None)
    }

    /// As [`Client::send`], with a request signature.
    ///
    /// # Errors
    /// As [`Client::send`].
    pub fn send_signed(
        &mut self,
        command: Command,
        seal: Option<Box<SignedCall>>,
    ) -> Result<Reply, ControlSocketError> {
        let id = Nonce::random()?.as_str().to_owned();
        self.send_request(Request { id, command, seal })
    }

    /// As [`Client::send`], for a complete request.
    ///
    /// # Errors
    /// As [`Client::send`].
    pub fn send_request(&mut self, request: Request) -> Result<Reply, ControlSocketError> {
        let call = ClientMessage::Ask { request: Box::new(request) };
        match self.call(&call) {
            Err(ControlSocketError::Ended { .. }) => {
                let layout = Layout::new(self.lines.path.parent().unwrap_or(Path::new("")));
                let Some(again) = Self::connect(&layout)? else {
                    return Err(ControlSocketError::Ended { path: self.lines.path.clone() });
                };
                // A request for the engine is sent to no other process.
                if let (None, Some(origin)) = (self.unverified_origin(), again.unverified_origin()) {
                    return Ok(origin.unasked());
                }
                *self = again;
                self.call(&call)
            }
            other => other,
        }
    }

    /// The state, if the engine answers within `patience`. A connection without an answer is unusable.
    ///
    /// # Errors
    /// [`ControlSocketError::Silent`] if it does not respond; else as [`Client::send`].
    pub fn look(&mut self, patience: Duration) -> Result<Reply, ControlSocketError> {
        let id = Nonce::random()?.as_str().to_owned();
        let request = Box::new(Request::unsigned(id, Command::Snapshot));
        self.lines.send(&ClientMessage::Ask { request })?;
        match self.lines.next(patience)? {
            Some(ServerMessage::Reply { reply }) => Ok(*reply),
            Some(_) => Err(self.lines.protocol("that is no reply".to_owned())),
            None => Err(self.lines.silent()),
        }
    }

    fn call(&mut self, call: &ClientMessage) -> Result<Reply, ControlSocketError> {
        self.lines.send(call)?;
        self.reply()
    }

    /// Waits for the reply to a request that was sent.
    pub(super) fn reply(&mut self) -> Result<Reply, ControlSocketError> {
        match self.lines.expect(REPLY_SECS)? {
            ServerMessage::Reply { reply } => Ok(*reply),
            _ => Err(self.lines.protocol("that is no reply".to_owned())),
        }
    }

    /// Keeps the engine running when no console is attached to it.
    ///
    /// # Errors
    /// As [`Client::send`].
    pub fn keep_engine_running(&mut self) -> Result<(), ControlSocketError> {
        self.lines.send(&ClientMessage::Keep {})?;
        match self.lines.expect(HELLO_SECS)? {
            ServerMessage::Kept => Ok(()),
            _ => Err(self.lines.protocol("that is no answer to it".to_owned())),
        }
    }

    /// Serves the live scene at an address. Returns whether the engine has a renderer for it.
    ///
    /// # Errors
    /// As [`Client::send`].
    pub fn serve_scene(&mut self, address: SocketAddr) -> Result<bool, ControlSocketError> {
        self.lines.send(&ClientMessage::Scene { address })?;
        match self.lines.expect(HELLO_SECS)? {
            ServerMessage::Scene { served } => Ok(served),
            _ => Err(self.lines.protocol("that is no answer to it".to_owned())),
        }
    }

    /// Attaches a console over this connection.
    ///
    /// # Errors
    /// As [`Client::send`]; [`ControlSocketError::Closed`] if the engine accepts no console, or no further one.
    pub fn attach(mut self, presence: ConsolePresence) -> Result<ConsoleConnection, ControlSocketError> {
        self.lines.send(&ClientMessage::Attach { sitting: presence })?;
        match self.lines.expect(HELLO_SECS)? {
            ServerMessage::Attached { seat } => {
                Ok(ConsoleConnection { lines: self.lines, origin: self.origin, console: seat })
            }
            _ => Err(self.lines.protocol("the answer to `attach` is of another kind".to_owned())),
        }
    }

    /// Turns the connection into a stream of events.
    ///
    /// # Errors
    /// As [`Client::send`].
    pub fn subscribe(mut self) -> Result<Subscription, ControlSocketError> {
        self.lines.send(&ClientMessage::Subscribe {})?;
        match self.lines.expect(HELLO_SECS)? {
            ServerMessage::Subscribed => Ok(Subscription { lines: self.lines }),
            _ => Err(self.lines.protocol("that is no subscription".to_owned())),
        }
    }
}

impl Subscription {
    /// The next message; `None` if there was none within `at_most`.
    ///
    /// # Errors
    /// [`ControlSocketError::Ended`] if the engine has ended; else as [`Client::send`].
    pub fn next(&mut self, at_most: Duration) -> Result<Option<Notification>, ControlSocketError> {
        match self.lines.next(at_most)? {
            None => Ok(None),
            Some(ServerMessage::Event { event }) => Ok(Some(Notification::Event(event))),
            Some(ServerMessage::Lagged { missed }) => Ok(Some(Notification::Missed(missed))),
            Some(_) => Err(self.lines.protocol("that is no event".to_owned())),
        }
    }
}

impl ConsoleConnection {
    /// The number of this console.
    #[must_use]
    pub const fn console_number(&self) -> u64 {
        self.console
    }

    /// Process id of the engine.
    #[must_use]
    pub const fn process(&self) -> i32 {
        self.lines.process
    }

    /// As [`Client::unverified_origin`].
    #[must_use]
    pub fn unverified_origin(&self) -> Option<UnverifiedOrigin> {
        self.origin.unverified()
    }

    /// The next message; `None` if there was none within `at_most`.
    ///
    /// # Errors
    /// [`ControlSocketError::Ended`] if the engine has ended; else as [`Client::send`].
    pub fn next(&mut self, at_most: Duration) -> Result<Option<ConsoleMessage>, ControlSocketError> {
        Ok(match self.lines.next(at_most)? {
            None => None,
            Some(ServerMessage::Event { event }) => Some(ConsoleMessage::Event(event)),
            Some(ServerMessage::Lagged { missed }) => Some(ConsoleMessage::Missed(missed)),
            Some(ServerMessage::Snapshot { snapshot }) => Some(ConsoleMessage::Snapshot(snapshot)),
            Some(ServerMessage::Picture { picture }) => Some(ConsoleMessage::Picture(picture)),
            Some(ServerMessage::Past { events, earlier }) => Some(ConsoleMessage::Past { events, earlier }),
            Some(ServerMessage::Ended { by }) => Some(ConsoleMessage::Ended { by }),
            Some(
                ServerMessage::Hello { .. }
                | ServerMessage::Reply { .. }
                | ServerMessage::Subscribed
                | ServerMessage::Attached { .. }
                | ServerMessage::Kept
                | ServerMessage::Scene { .. }
                | ServerMessage::Closed { .. },
            ) => {
                return Err(self.lines.protocol("an attached console receives no such message".to_owned()));
            }
        })
    }

    /// A handle that sends the presence, while another thread reads the messages.
    ///
    /// # Errors
    /// If the system gives no second handle of the connection.
    pub fn presence_sender(&self) -> Result<PresenceSender, ControlSocketError> {
        let stream = self.lines.reader.get_ref().try_clone();
        Ok(PresenceSender { stream: stream.map_err(ControlSocketError::io("use", &self.lines.path))? })
    }
}

/// Sends the presence of an attached console.
#[derive(Debug)]
pub struct PresenceSender {
    stream: UnixStream,
}

impl PresenceSender {
    /// Sends the presence. Does not wait for an engine that does not read: other consoles then see an older presence.
    pub fn send_presence(&mut self, presence: ConsolePresence) {
        let Ok(line) = wire::line(&ClientMessage::Sit { sitting: presence }) else { return };
        let within = self.stream.set_write_timeout(Some(SAY_MAX));
        // The end of the messages reports a lost connection.
        drop(within.and_then(|()| self.stream.write_all(line.as_bytes())));
    }
}

/// Lines of bounded length over a socket.
#[derive(Debug)]
struct LineReader {
    path: PathBuf,
    /// Who serves the socket.
    process: i32,
    reader: BufReader<UnixStream>,
    /// The read part of an incomplete line.
    line: Vec<u8>,
}

impl LineReader {
    /// Connects to the process that serves the socket, and reads its greeting; `None` if no process serves it.
    fn connect(layout: &Layout, patience: Duration) -> Result<Option<Self>, ControlSocketError> {
        let path = socket_path(layout);
        // No engine can listen at a path that is too long.
        if socket_file::check_length(&path).is_err() {
            return Ok(None);
        }
        let stream = match UnixStream::connect(&path) {
            Ok(stream) => stream,
            Err(error)
                if matches!(
                    error.kind(),
                    io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused | io::ErrorKind::NotADirectory
                ) =>
            {
                return Ok(None);
            }
            Err(error) => return Err(ControlSocketError::io("connect to", &path)(error)),
        };
        let peer = rustix::net::sockopt::socket_peercred(&stream)
            .map_err(|error| ControlSocketError::io("look who serves", &path)(error.into()))?;
        if peer.uid != rustix::process::geteuid() && !owns(layout.folder(), peer.uid) {
            return Err(ControlSocketError::Foreign { path, uid: peer.uid.as_raw() });
        }
        let process = peer.pid.as_raw_pid();
        let mut lines = Self { path, process, reader: BufReader::new(stream), line: Vec::new() };
        let Some(hello) = lines.next(patience)? else { return Err(lines.silent()) };
        match hello {
            ServerMessage::Hello { protocol: PROTOCOL, .. } => Ok(Some(lines)),
            ServerMessage::Hello { protocol, version, .. } => {
                Err(lines.protocol(format!("version {version} speaks protocol {protocol}, not {PROTOCOL}")))
            }
            _ => Err(lines.protocol("its first line is no hello".to_owned())),
        }
    }

    fn send(&mut self, call: &ClientMessage) -> Result<(), ControlSocketError> {
        let line = wire::line(call).map_err(|error| self.protocol(error.to_string()))?;
        if line.len() > CALL_BYTES_MAX {
            let text = format!("the request has {} bytes; at most {CALL_BYTES_MAX} are allowed", line.len());
            return Err(ControlSocketError::io("send to", &self.path)(io::Error::other(text)));
        }
        let path = self.path.clone();
        let stream = self.reader.get_mut();
        stream
            .set_write_timeout(Some(Duration::from_secs(HELLO_SECS)))
            .and_then(|()| stream.write_all(line.as_bytes()))
            .map_err(|error| broken("send to", path, error))
    }

    fn expect(&mut self, secs: u64) -> Result<ServerMessage, ControlSocketError> {
        match self.next(Duration::from_secs(secs))? {
            Some(answer) => Ok(answer),
            None => Err(ControlSocketError::NoAnswer { path: self.path.clone(), secs }),
        }
    }

    /// The next message; the last one of a connection that the engine closes is an error.
    fn next(&mut self, at_most: Duration) -> Result<Option<ServerMessage>, ControlSocketError> {
        let until = Instant::now() + at_most;
        loop {
            // A timeout of zero would mean none.
            let left = until.saturating_duration_since(Instant::now()).max(Duration::from_millis(1));
            let path = self.path.clone();
            self.reader
                .get_ref()
                .set_read_timeout(Some(left))
                .map_err(|error| broken("read from", path.clone(), error))?;
            let room = (ANSWER_BYTES_MAX + 1 - self.line.len().min(ANSWER_BYTES_MAX)) as u64;
            match self.reader.by_ref().take(room).read_until(b'\n', &mut self.line) {
                Ok(_) if self.line.last() == Some(&b'\n') => {
                    let parsed: serde_json::Result<ServerMessage> = serde_json::from_slice(&self.line);
                    self.line.clear();
                    return match parsed {
                        Ok(ServerMessage::Closed { text }) => Err(ControlSocketError::Closed { path, text }),
                        parsed => parsed.map(Some).map_err(|error| self.protocol(error.to_string())),
                    };
                }
                Ok(_) if self.line.len() > ANSWER_BYTES_MAX => {
                    return Err(self.protocol("a line is too long".to_owned()));
                }
                Ok(_) => return Err(ControlSocketError::Ended { path }),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {
                    if Instant::now() >= until {
                        return Ok(None);
                    }
                }
                Err(error) => return Err(broken("read from", path, error)),
            }
        }
    }

    fn silent(&self) -> ControlSocketError {
        ControlSocketError::Silent {
            path: self.path.clone(),
            process: self.process,
            stopped: is_stopped(self.process),
        }
    }

    fn protocol(&self, problem: String) -> ControlSocketError {
        ControlSocketError::Protocol { path: self.path.clone(), problem }
    }
}

/// Whether a folder belongs to an account and no other may write to it, so that this account created the socket in it.
fn owns(folder: &Path, account: rustix::process::Uid) -> bool {
    std::fs::metadata(folder).is_ok_and(|found| found.uid() == account.as_raw() && found.mode() & 0o022 == 0)
}

/// Whether a signal stopped a process (its state is T), as far as the system reports it.
fn is_stopped(process: i32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    stat.rsplit_once(')').is_some_and(|(_, rest)| rest.trim_start().starts_with('T'))
}

/// A client cannot distinguish a broken connection from an engine that ended.
fn broken(what: &'static str, path: PathBuf, error: io::Error) -> ControlSocketError {
    match error.kind() {
        io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionReset | io::ErrorKind::UnexpectedEof => {
            ControlSocketError::Ended { path }
        }
        _ => ControlSocketError::Io { what, path, source: error },
    }
}
