//! A relay between a check and an honest server, which changes what passes on each connection.
//!
//! Without a change it passes everything on, but for a message that is torn: it closes the connection then.

use std::io;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use holdpoint_cell::{CellFactory as _, CellSpec};

use crate::client::Connect;
use crate::endpoint::EndpointStream;
use crate::fake_cell::{FakeFactory, Quirk};
use crate::framing::{Line, WireError, WireStream, decode, encode};
use crate::messages::{
    Answer, BLOCK_BYTES_MAX, Block, Call, CellReply, CellRequest, CellState, FactoryDescription, Greeting,
    Hello, Role, Welcome, sha256_hex,
};
use crate::refusal::CellRefusal;
use crate::server::{CellServer, ServerOptions};
use crate::tests::{LONG, hello};

/// After this time without a hello a server that speaks first does so.
const SILENCE: Duration = Duration::from_secs(1);

/// What a relay changes.
pub(super) enum Change {
    /// The hello of a client.
    Hello(fn(&mut Link, &mut Hello)),
    /// The answer to a hello.
    Greeting(fn(&mut Link, &mut Greeting)),
    /// The answer to a hello that is taken.
    Welcome(fn(&mut Link, &mut Welcome)),
    /// The description; its digest in the welcome is then that of the changed one.
    Description(fn(&mut FactoryDescription)),
    /// A request.
    Request(fn(&mut Link, &mut CellRequest)),
    /// What came of a request.
    Reply(fn(&mut Link, &CellRequest, &mut CellReply)),
    /// The state that answers a request.
    Seen(fn(&mut Link, &CellRequest, &mut CellState)),
    /// The bytes that answer a request.
    Bytes(fn(&mut Link, &CellRequest, &mut Vec<u8>)),
    /// A state that comes with another digest gets its own.
    MendedImage,
    /// A hello that cannot be read is taken for a good one.
    AnyHello,
    /// Bytes that are no request, and that this is true of, are taken for a good one.
    Unread(fn(&[u8]) -> bool),
    /// A message that is too long is taken for a good one.
    TooLong,
    /// The server speaks before a hello came.
    SpeaksFirst,
}

/// One connection, as a relay remembers it.
pub(super) struct Link {
    /// Counts the connections from 1.
    pub(super) number: u64,
    /// What the client asked for.
    pub(super) role: Role,
    /// The session that it asked for.
    pub(super) joins: Option<u64>,
    /// The watchdog that it asked for.
    pub(super) watchdog_ms: Option<u32>,
    /// The seeds of the episodes so far.
    pub(super) seeds: Vec<u64>,
    /// The newest state that the cell told.
    pub(super) last: Option<CellState>,
    /// The name of the call before.
    pub(super) before: &'static str,
    /// The number of the request before.
    pub(super) sequence: u64,
    /// Whether a state was kept here.
    pub(super) has_forked: bool,
    /// A mark of the change.
    pub(super) is_marked: bool,
    /// What the honest cell is.
    pub(super) spec: Arc<CellSpec>,
    /// What all connections share.
    pub(super) memory: Arc<Memory>,
}

impl Link {
    /// The newest state as a reply.
    pub(super) fn last_seen(&self) -> CellReply {
        CellReply::Seen(Box::new(self.last.clone().unwrap()))
    }
}

/// What connections share, for changes that need it.
#[derive(Default)]
pub(super) struct Memory {
    /// A session.
    pub(super) session: AtomicU64,
    /// A count.
    pub(super) count: AtomicU64,
}

impl Memory {
    /// Counts one more; returns how many there are.
    pub(super) fn count(&self) -> u64 {
        self.count.fetch_add(1, Ordering::Relaxed) + 1
    }
}

/// See the module comment.
pub(super) struct Relay {
    server: Arc<CellServer>,
    spec: Arc<CellSpec>,
    changes: Vec<Change>,
    /// The changed description, if it is.
    description: Option<Vec<u8>>,
    connections: AtomicU64,
    memory: Arc<Memory>,
}

/// A request that every server takes on a new connection.
fn good_request() -> Vec<u8> {
    encode(&CellRequest { sequence: 1, guard: None, release: Vec::new(), call: Call::Scenery }).unwrap()
}

/// A frame with its length.
fn framed(bytes: &[u8]) -> Vec<u8> {
    [&u32::try_from(bytes.len()).unwrap().to_be_bytes()[..], bytes].concat()
}

/// The bytes of a state that a request announces, whatever their digest.
fn follow(client: &mut Line<EndpointStream>, asked: &CellRequest) -> Result<Vec<u8>, WireError> {
    let mut bytes = Vec::new();
    if let Call::Import { image } = &asked.call
        && image.bytes <= BLOCK_BYTES_MAX as u64
    {
        while (bytes.len() as u64) < image.bytes {
            bytes.extend(client.receive_bytes(LONG)?);
        }
    }
    Ok(bytes)
}

impl Relay {
    pub(super) fn new(changes: Vec<Change>) -> Arc<Self> {
        let factory = FakeFactory::new(Quirk::Honest);
        let spec = Arc::clone(factory.spec());
        let mut described = FactoryDescription {
            spec: (*spec).clone(),
            build: factory.build_digest().to_owned(),
            distributions: factory.distributions().unwrap(),
        };
        let mut description = None;
        for change in &changes {
            if let Change::Description(change) = change {
                change(&mut described);
                description = Some(encode(&described).unwrap());
            }
        }
        let server = CellServer::new(Arc::new(factory), ServerOptions::default()).unwrap();
        Arc::new(Self {
            server: Arc::new(server),
            spec,
            changes,
            description,
            connections: AtomicU64::new(0),
            memory: Arc::default(),
        })
    }

    /// Connections to the server, each through a thread of the relay.
    pub(super) fn connect(self: &Arc<Self>) -> Connect {
        let relay = Arc::clone(self);
        Box::new(move || -> io::Result<Box<dyn WireStream>> {
            let (own, other) = UnixStream::pair()?;
            let relay = Arc::clone(&relay);
            let number = relay.connections.fetch_add(1, Ordering::Relaxed) + 1;
            // A connection that fails on one side ends on both.
            thread::spawn(move || drop(relay.pass(other, number)));
            Ok(Box::new(EndpointStream::Unix(own)))
        })
    }

    fn pass(&self, stream: UnixStream, number: u64) -> Result<(), WireError> {
        let mut client = Line::new(EndpointStream::Unix(stream))?;
        let (own, other) = UnixStream::pair().map_err(|error| WireError::System(error.to_string()))?;
        let server = Arc::clone(&self.server);
        thread::spawn(move || server.attend(EndpointStream::Unix(other)));
        let mut server = Line::new(EndpointStream::Unix(own))?;
        let mut link = Link {
            number,
            role: Role::Control,
            joins: None,
            watchdog_ms: None,
            seeds: Vec::new(),
            last: None,
            before: "",
            sequence: 0,
            has_forked: false,
            is_marked: false,
            spec: Arc::clone(&self.spec),
            memory: Arc::clone(&self.memory),
        };
        self.greet(&mut link, &mut client, &mut server)?;
        loop {
            self.exchange(&mut link, &mut client, &mut server)?;
        }
    }

    fn greet(
        &self,
        link: &mut Link,
        client: &mut Line<EndpointStream>,
        server: &mut Line<EndpointStream>,
    ) -> Result<(), WireError> {
        let speaks_first = self.changes.iter().any(|change| matches!(change, Change::SpeaksFirst));
        let bytes = match client.receive_bytes(if speaks_first { SILENCE } else { LONG }) {
            Err(WireError::Deadline { .. }) if speaks_first => {
                return client.send(&Greeting::Refused(CellRefusal::Taken)).and(Err(WireError::Closed));
            }
            received => received?,
        };
        let onward = match decode::<Hello>(&bytes) {
            Ok(mut hello) => {
                (link.role, link.joins, link.watchdog_ms) = (hello.role, hello.session, hello.watchdog_ms);
                for change in &self.changes {
                    if let Change::Hello(change) = change {
                        change(link, &mut hello);
                    }
                }
                encode(&hello)?
            }
            Err(_) if self.changes.iter().any(|change| matches!(change, Change::AnyHello)) => {
                encode(&hello(Role::Control))?
            }
            Err(_) => bytes,
        };
        server.send_bytes(&framed(&onward))?;
        let mut greeting: Greeting = server.receive(LONG)?;
        if let (Greeting::Welcome(welcome), Some(description)) = (&mut greeting, &self.description) {
            welcome.description = sha256_hex(description);
        }
        for change in &self.changes {
            match (change, &mut greeting) {
                (Change::Greeting(change), greeting) => change(link, greeting),
                (Change::Welcome(change), Greeting::Welcome(welcome)) => change(link, welcome),
                _ => {}
            }
        }
        client.send(&greeting)?;
        match greeting {
            Greeting::Welcome(_) => Ok(()),
            Greeting::Refused(_) => Err(WireError::Closed),
        }
    }

    fn exchange(
        &self,
        link: &mut Link,
        client: &mut Line<EndpointStream>,
        server: &mut Line<EndpointStream>,
    ) -> Result<(), WireError> {
        let mut asked: Option<CellRequest> = None;
        let onward = match client.receive_bytes(LONG) {
            Ok(bytes) => match decode::<CellRequest>(&bytes) {
                Ok(request) => {
                    let image = follow(client, &request)?;
                    let onward = self.changed_request(link, request.clone(), &image)?;
                    asked = Some(request);
                    onward
                }
                Err(_) => {
                    let is_taken = self
                        .changes
                        .iter()
                        .any(|change| matches!(change, Change::Unread(is_taken) if is_taken(&bytes)));
                    framed(&if is_taken { good_request() } else { bytes })
                }
            },
            Err(WireError::TooLarge { bytes, .. }) => {
                let is_taken = self.changes.iter().any(|change| matches!(change, Change::TooLong));
                // The server refuses it by its length.
                let length = u32::try_from(bytes).unwrap().to_be_bytes().to_vec();
                if is_taken { framed(&good_request()) } else { length }
            }
            Err(error) => return Err(error),
        };
        server.send_bytes(&onward)?;
        let Answer { sequence, mut reply } = server.receive(LONG)?;
        let mut block = match &reply {
            CellReply::Block(block) => server.receive_block(block, LONG)?,
            _ => Vec::new(),
        };
        if let Some(asked) = &asked {
            self.change_reply(link, asked, &mut reply, &mut block);
            remember(link, asked, &reply);
        }
        let closes = matches!(&reply, CellReply::Refused(refusal) if refusal.closes());
        client.send(&Answer { sequence, reply })?;
        client.send_block(&block)?;
        if closes { Err(WireError::Closed) } else { Ok(()) }
    }

    /// The frames of a request after the changes.
    fn changed_request(
        &self,
        link: &mut Link,
        mut request: CellRequest,
        image: &[u8],
    ) -> Result<Vec<u8>, WireError> {
        for change in &self.changes {
            match (change, &mut request) {
                (Change::Request(change), request) => change(link, request),
                (Change::MendedImage, CellRequest { call: Call::Import { image: announced }, .. })
                    if !image.is_empty() =>
                {
                    *announced = Block::of(image);
                }
                _ => {}
            }
        }
        let mut frames = framed(&encode(&request)?);
        if !image.is_empty() {
            frames.extend(framed(image));
        }
        Ok(frames)
    }

    fn change_reply(&self, link: &mut Link, asked: &CellRequest, reply: &mut CellReply, block: &mut Vec<u8>) {
        if let (Call::Describe, Some(description)) = (&asked.call, &self.description) {
            block.clone_from(description);
            *reply = CellReply::Block(Block::of(block));
        }
        for change in &self.changes {
            match (change, &mut *reply) {
                (Change::Reply(change), reply) => change(link, asked, reply),
                (Change::Seen(change), CellReply::Seen(seen)) => change(link, asked, seen),
                (Change::Bytes(change), CellReply::Block(announced)) => {
                    change(link, asked, block);
                    *announced = Block::of(block);
                }
                _ => {}
            }
        }
    }
}

/// Keeps what later changes need.
fn remember(link: &mut Link, asked: &CellRequest, reply: &CellReply) {
    (link.before, link.sequence) = (asked.call.name(), asked.sequence);
    link.has_forked |= matches!(reply, CellReply::Fork { .. });
    if let CellReply::Seen(seen) = reply {
        link.last = Some(CellState::clone(seen));
        if let Call::Reset { setup } = &asked.call {
            link.seeds.push(setup.seed);
        }
    }
}
