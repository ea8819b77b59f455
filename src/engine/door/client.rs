//! The other side of the door, for verbs and consoles: synchronous, every wait bounded.

use std::io::{self, BufRead, BufReader, Read as _, Write as _};
use std::net::SocketAddr;
use std::os::unix::fs::MetadataExt as _;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::{DoorError, Doubt, Origin, socket, socket_path};
use holdpoint_approvals::{Nonce, SignedCall};
use holdpoint_protocol::command::{Command, Reply, Request};
use holdpoint_protocol::event::Event;
use holdpoint_protocol::picture::Picture;
use holdpoint_protocol::seat::Sitting;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::wire::{self, ANSWER_BYTES_MAX, Answer, CALL_BYTES_MAX, Call, PROTOCOL};
use holdpoint_registry::Layout;

/// How long the first line may take.
const HELLO_SECS: u64 = 5;

/// How long a reply may take: the engine answers between two slices of work, and a rollback is carried out first.
const REPLY_SECS: u64 = 120;

/// How long an engine that does not read is waited for with a word about a seat.
const SAY_MAX: Duration = Duration::from_millis(20);

/// A connection to a running engine, or to whoever answers in its place: see [`Client::doubt`].
#[derive(Debug)]
pub struct Client {
    lines: Lines,
    origin: Origin,
}

/// A stream of events from a running engine.
#[derive(Debug)]
pub struct Subscription {
    lines: Lines,
}

/// A seat at a running engine: what it shows, as it comes.
#[derive(Debug)]
pub struct Attachment {
    lines: Lines,
    origin: Origin,
    seat: u64,
}

/// What somebody who is attached is shown.
#[derive(Clone, Debug, PartialEq)]
pub enum Shown {
    Event(Box<Event>),
    /// So many events were dropped, because they were not read in time.
    Missed(u64),
    Snapshot(Box<Snapshot>),
    Picture(Box<Picture>),
    /// What happened before, oldest first, and how many events came before that. Told once, at the start.
    Past {
        events: Vec<Event>,
        earlier: u64,
    },
    /// The engine ends in good order: who ended it. Nothing comes after it.
    Ended {
        by: String,
    },
}

/// What a subscriber is told.
#[derive(Clone, Debug, PartialEq)]
pub enum Notification {
    Event(Box<Event>),
    /// So many events were dropped, because they were not read in time.
    Missed(u64),
}

impl Client {
    /// Connects to the engine that runs on a store; `None` if none does.
    ///
    /// # Errors
    /// [`DoorError`] if something answers that is not one's own engine of this version.
    pub fn connect(layout: &Layout) -> Result<Option<Self>, DoorError> {
        Self::connect_within(layout, Duration::from_secs(HELLO_SECS))
    }

    /// As [`Client::connect`], with so much patience.
    ///
    /// # Errors
    /// As [`Client::connect`]; [`DoorError::Silent`] if the engine is there and says nothing.
    pub fn connect_within(layout: &Layout, patience: Duration) -> Result<Option<Self>, DoorError> {
        let path = socket_path(layout);
        // No engine can listen at a path that is too long.
        if socket::check_length(&path).is_err() {
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
            Err(error) => return Err(DoorError::io("connect to", &path)(error)),
        };
        let peer = rustix::net::sockopt::socket_peercred(&stream)
            .map_err(|error| DoorError::io("look who serves", &path)(error.into()))?;
        if peer.uid != rustix::process::geteuid() && !owns(layout.folder(), peer.uid) {
            return Err(DoorError::Foreign { path, uid: peer.uid.as_raw() });
        }
        let process = peer.pid.as_raw_pid();
        let origin = Origin::of(process, layout.folder());
        let mut lines = Lines { path, process, reader: BufReader::new(stream), line: Vec::new() };
        let Some(hello) = lines.next(patience)? else { return Err(lines.silent()) };
        match hello {
            Answer::Hello { protocol: PROTOCOL, .. } => Ok(Some(Self { lines, origin })),
            Answer::Hello { protocol, version, .. } => {
                Err(lines.protocol(format!("version {version} speaks protocol {protocol}, not {PROTOCOL}")))
            }
            Answer::Closed { text } => Err(lines.closed(text)),
            _ => Err(lines.protocol("its first line is no hello".to_owned())),
        }
    }

    /// Why what is answered here is not known to come from the engine; `None` if it is known to.
    #[must_use]
    pub fn doubt(&self) -> Option<Doubt> {
        self.origin.doubt()
    }

    /// Asks for something and waits for the reply. Where the connection breaks before it, the same request is
    /// sent once more over a new one: the engine carries out an id only once.
    ///
    /// # Errors
    /// [`DoorError`]; after [`DoorError::NoAnswer`] the outcome is not known.
    pub fn ask(&mut self, command: Command) -> Result<Reply, DoorError> {
        self.ask_sealed(command, None)
    }

    /// As [`Client::ask`], with somebody's signature under the command.
    ///
    /// # Errors
    /// As [`Client::ask`].
    pub fn ask_sealed(
        &mut self,
        command: Command,
        seal: Option<Box<SignedCall>>,
    ) -> Result<Reply, DoorError> {
        let id = Nonce::random()?.as_str().to_owned();
        self.ask_request(Request { id, command, seal })
    }

    /// As [`Client::ask`], for a request with an id of its own.
    ///
    /// # Errors
    /// As [`Client::ask`].
    pub fn ask_request(&mut self, request: Request) -> Result<Reply, DoorError> {
        let call = Call::Ask { request: Box::new(request) };
        match self.call(&call) {
            Err(DoorError::Ended { .. }) => {
                let layout = Layout::new(self.lines.path.parent().unwrap_or(Path::new("")));
                let Some(again) = Self::connect(&layout)? else {
                    return Err(DoorError::Ended { path: self.lines.path.clone() });
                };
                // What the engine was asked is asked of nobody else.
                if let (None, Some(doubt)) = (self.doubt(), again.doubt()) {
                    return Ok(doubt.unasked());
                }
                *self = again;
                self.call(&call)
            }
            other => other,
        }
    }

    /// How things stand, if the engine says so within `patience`. A connection that got no answer is of no more use.
    ///
    /// # Errors
    /// [`DoorError::Silent`] if it says nothing; else as [`Client::ask`].
    pub fn look(&mut self, patience: Duration) -> Result<Reply, DoorError> {
        let id = Nonce::random()?.as_str().to_owned();
        let request = Box::new(Request::unsigned(id, Command::Snapshot));
        self.lines.send(&Call::Ask { request })?;
        match self.lines.next(patience)? {
            Some(Answer::Reply { reply }) => Ok(*reply),
            Some(Answer::Closed { text }) => Err(self.lines.closed(text)),
            Some(_) => Err(self.lines.protocol("that is no reply".to_owned())),
            None => Err(self.lines.silent()),
        }
    }

    fn call(&mut self, call: &Call) -> Result<Reply, DoorError> {
        self.lines.send(call)?;
        match self.lines.expect(REPLY_SECS)? {
            Answer::Reply { reply } => Ok(*reply),
            Answer::Closed { text } => Err(self.lines.closed(text)),
            _ => Err(self.lines.protocol("that is no reply".to_owned())),
        }
    }

    /// Has the engine go on when nobody sits at it any more.
    ///
    /// # Errors
    /// As [`Client::ask`].
    pub fn keep(&mut self) -> Result<(), DoorError> {
        self.lines.send(&Call::Keep {})?;
        match self.lines.expect(HELLO_SECS)? {
            Answer::Kept => Ok(()),
            Answer::Closed { text } => Err(self.lines.closed(text)),
            _ => Err(self.lines.protocol("that is no answer to it".to_owned())),
        }
    }

    /// Has the live scene served at an address. Tells whether there is somebody who draws it.
    ///
    /// # Errors
    /// As [`Client::ask`].
    pub fn serve_scene(&mut self, address: SocketAddr) -> Result<bool, DoorError> {
        self.lines.send(&Call::Scene { address })?;
        match self.lines.expect(HELLO_SECS)? {
            Answer::Scene { served } => Ok(served),
            Answer::Closed { text } => Err(self.lines.closed(text)),
            _ => Err(self.lines.protocol("that is no answer to it".to_owned())),
        }
    }

    /// Turns the connection into a seat.
    ///
    /// # Errors
    /// As [`Client::ask`]; [`DoorError::Closed`] if the engine shows itself to nobody, or every seat is taken.
    pub fn attach(mut self, sitting: Sitting) -> Result<Attachment, DoorError> {
        self.lines.send(&Call::Attach { sitting })?;
        match self.lines.expect(HELLO_SECS)? {
            Answer::Attached { seat } => Ok(Attachment { lines: self.lines, origin: self.origin, seat }),
            Answer::Closed { text } => Err(self.lines.closed(text)),
            _ => Err(self.lines.protocol("that is no seat".to_owned())),
        }
    }

    /// Turns the connection into a stream of events.
    ///
    /// # Errors
    /// As [`Client::ask`].
    pub fn subscribe(mut self) -> Result<Subscription, DoorError> {
        self.lines.send(&Call::Subscribe {})?;
        match self.lines.expect(HELLO_SECS)? {
            Answer::Subscribed => Ok(Subscription { lines: self.lines }),
            Answer::Closed { text } => Err(self.lines.closed(text)),
            _ => Err(self.lines.protocol("that is no subscription".to_owned())),
        }
    }
}

impl Subscription {
    /// What was told next; `None` if nothing was within `at_most`.
    ///
    /// # Errors
    /// [`DoorError::Ended`] if the engine has ended; else as [`Client::ask`].
    pub fn next(&mut self, at_most: Duration) -> Result<Option<Notification>, DoorError> {
        match self.lines.next(at_most)? {
            None => Ok(None),
            Some(Answer::Event { event }) => Ok(Some(Notification::Event(event))),
            Some(Answer::Lagged { missed }) => Ok(Some(Notification::Missed(missed))),
            Some(Answer::Closed { text }) => Err(self.lines.closed(text)),
            Some(_) => Err(self.lines.protocol("that is no event".to_owned())),
        }
    }
}

impl Attachment {
    /// The number of the seat.
    #[must_use]
    pub const fn seat(&self) -> u64 {
        self.seat
    }

    /// Process id of the engine.
    #[must_use]
    pub const fn process(&self) -> i32 {
        self.lines.process
    }

    /// As [`Client::doubt`].
    #[must_use]
    pub fn doubt(&self) -> Option<Doubt> {
        self.origin.doubt()
    }

    /// What is shown next; `None` if nothing was within `at_most`.
    ///
    /// # Errors
    /// [`DoorError::Ended`] if the engine has ended; else as [`Client::ask`].
    pub fn next(&mut self, at_most: Duration) -> Result<Option<Shown>, DoorError> {
        Ok(match self.lines.next(at_most)? {
            None => None,
            Some(Answer::Event { event }) => Some(Shown::Event(event)),
            Some(Answer::Lagged { missed }) => Some(Shown::Missed(missed)),
            Some(Answer::Snapshot { snapshot }) => Some(Shown::Snapshot(snapshot)),
            Some(Answer::Picture { picture }) => Some(Shown::Picture(picture)),
            Some(Answer::Past { events, earlier }) => Some(Shown::Past { events, earlier }),
            Some(Answer::Ended { by }) => Some(Shown::Ended { by }),
            Some(Answer::Closed { text }) => return Err(self.lines.closed(text)),
            Some(
                Answer::Hello { .. }
                | Answer::Reply { .. }
                | Answer::Subscribed
                | Answer::Attached { .. }
                | Answer::Kept
                | Answer::Scene { .. },
            ) => {
                return Err(self.lines.protocol("nothing of that is for a seat".to_owned()));
            }
        })
    }

    /// A way to say what is looked at, while somebody else reads what is shown.
    ///
    /// # Errors
    /// If the system gives no second handle of the connection.
    pub fn sayer(&self) -> Result<Sayer, DoorError> {
        let stream = self.lines.reader.get_ref().try_clone();
        Ok(Sayer { stream: stream.map_err(DoorError::io("use", &self.lines.path))? })
    }
}

/// Says what somebody who is attached looks at.
#[derive(Debug)]
pub struct Sayer {
    stream: UnixStream,
}

impl Sayer {
    /// Says it. An engine that does not read is not waited for: others see an older word of this seat then.
    pub fn say(&mut self, sitting: Sitting) {
        let Ok(line) = wire::line(&Call::Sit { sitting }) else { return };
        let within = self.stream.set_write_timeout(Some(SAY_MAX));
        // A connection that is gone is told by the end of what is shown.
        drop(within.and_then(|()| self.stream.write_all(line.as_bytes())));
    }
}

/// Lines of bounded length over a socket.
#[derive(Debug)]
struct Lines {
    path: PathBuf,
    /// Who serves the socket.
    process: i32,
    reader: BufReader<UnixStream>,
    /// What was read of a line that is not complete.
    line: Vec<u8>,
}

impl Lines {
    fn send(&mut self, call: &Call) -> Result<(), DoorError> {
        let line = wire::line(call).map_err(|error| self.protocol(error.to_string()))?;
        if line.len() > CALL_BYTES_MAX {
            let text = format!("the request has {} bytes; at most {CALL_BYTES_MAX} are allowed", line.len());
            return Err(DoorError::io("send to", &self.path)(io::Error::other(text)));
        }
        let path = self.path.clone();
        let stream = self.reader.get_mut();
        stream
            .set_write_timeout(Some(Duration::from_secs(HELLO_SECS)))
            .and_then(|()| stream.write_all(line.as_bytes()))
            .map_err(|error| broken("send to", path, error))
    }

    fn expect(&mut self, secs: u64) -> Result<Answer, DoorError> {
        match self.next(Duration::from_secs(secs))? {
            Some(answer) => Ok(answer),
            None => Err(DoorError::NoAnswer { path: self.path.clone(), secs }),
        }
    }

    fn next(&mut self, at_most: Duration) -> Result<Option<Answer>, DoorError> {
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
                    let parsed = serde_json::from_slice(&self.line);
                    self.line.clear();
                    return parsed.map(Some).map_err(|error| self.protocol(error.to_string()));
                }
                Ok(_) if self.line.len() > ANSWER_BYTES_MAX => {
                    return Err(self.protocol("a line is too long".to_owned()));
                }
                Ok(_) => return Err(DoorError::Ended { path }),
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

    fn silent(&self) -> DoorError {
        DoorError::Silent {
            path: self.path.clone(),
            process: self.process,
            stopped: is_stopped(self.process),
        }
    }

    fn closed(&self, text: String) -> DoorError {
        DoorError::Closed { path: self.path.clone(), text }
    }

    fn protocol(&self, problem: String) -> DoorError {
        DoorError::Protocol { path: self.path.clone(), problem }
    }
}

/// Whether a folder is an account's, and nobody else may write to it: whose socket lies there was put there by that account.
fn owns(folder: &Path, account: rustix::process::Uid) -> bool {
    std::fs::metadata(folder).is_ok_and(|found| found.uid() == account.as_raw() && found.mode() & 0o022 == 0)
}

/// Whether a signal stopped a process (its state is T), as far as the system tells.
fn is_stopped(process: i32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    stat.rsplit_once(')').is_some_and(|(_, rest)| rest.trim_start().starts_with('T'))
}

/// A connection that broke is an engine that ended, as far as a client can know.
fn broken(what: &'static str, path: PathBuf, error: io::Error) -> DoorError {
    match error.kind() {
        io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionReset | io::ErrorKind::UnexpectedEof => {
            DoorError::Ended { path }
        }
        _ => DoorError::Io { what, path, source: error },
    }
}
