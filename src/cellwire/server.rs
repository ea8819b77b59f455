//! Offers the cells of a factory: connections, sessions, and the forks that they keep.
//!
//! Each connection is one cell, and has a thread of its own. The live cell is one client's at a time. Forks belong to a
//! session, so that trial cells continue from a state of the live cell; they end with its last connection.

mod connection;
mod watchdog;

use std::collections::HashMap;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

use holdpoint_cell::{CellCopy, CellFactory};

use crate::endpoint::EndpointListener;
use crate::framing::{WireError, WireStream, encode};
use crate::messages::{
    BLOCK_BYTES_MAX, FORKS_MAX, FactoryDescription, MESSAGE_BYTES_MAX, Role, ServerLimits, sha256_hex,
};
use crate::refusal::CellRefusal;

/// Tells the person at the server what happened, one line each.
pub type NoteSink = Box<dyn Fn(&str) + Send + Sync>;

/// How a server works.
pub struct ServerOptions {
    /// The most connections at once.
    pub connections_max: usize,
    /// Where it tells what happened.
    pub notes: NoteSink,
}

impl Default for ServerOptions {
    /// 128 connections: 64 workers, their twins, and some more. Notes are dropped.
    fn default() -> Self {
        Self { connections_max: 128, notes: Box::new(|_| {}) }
    }
}

/// Cells that are offered to other processes.
pub struct CellServer {
    factory: Arc<dyn CellFactory>,
    description: Vec<u8>,
    /// SHA-256 of the description, in hexadecimal digits.
    digest: String,
    options: ServerOptions,
    state: Mutex<ServerState>,
}

#[derive(Default)]
struct ServerState {
    connections: usize,
    live_is_taken: bool,
    sessions: HashMap<u64, CellSession>,
    /// The handle of the newest fork; no handle is used twice.
    newest_fork: u64,
}

#[derive(Default)]
struct CellSession {
    connections: usize,
    forks: HashMap<u64, Arc<CellCopy>>,
}

impl CellServer {
    /// Offers the cells of a factory.
    ///
    /// # Errors
    /// If its distributions cannot be read, or its description is no message.
    pub fn new(factory: Arc<dyn CellFactory>, options: ServerOptions) -> Result<Self, WireError> {
        let failed = |error: holdpoint_cell::CellError| WireError::Refused(error.to_string());
        let description = FactoryDescription {
            spec: (**factory.spec()).clone(),
            build: factory.build_digest().to_owned(),
            distributions: factory.distributions().map_err(failed)?,
        };
        let description = encode(&description)?;
        let digest = sha256_hex(&description);
        Ok(Self { factory, description, digest, options, state: Mutex::default() })
    }

    /// Takes connections until the listener fails.
    ///
    /// # Errors
    /// The failure of the listener.
    pub fn run(self: &Arc<Self>, listener: &EndpointListener) -> io::Result<()> {
        loop {
            match listener.accept() {
                Ok(stream) => {
                    let server = Arc::clone(self);
                    thread::Builder::new()
                        .name("cell-connection".to_owned())
                        .spawn(move || server.attend(stream))?;
                }
                Err(error)
                    if matches!(
                        error.kind(),
                        io::ErrorKind::ConnectionAborted | io::ErrorKind::Interrupted
                    ) => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Works for one connection until it ends.
    pub fn attend<S: WireStream>(&self, stream: S) {
        match connection::attend(self, stream) {
            Ok(()) | Err(WireError::Closed) => {}
            Err(error) => self.note(&format!("a connection ended: {error}")),
        }
    }

    fn note(&self, text: &str) {
        (self.options.notes)(text);
    }

    /// How many states are kept, of all sessions.
    #[must_use]
    pub fn forks(&self) -> usize {
        self.lock().sessions.values().map(|session| session.forks.len()).sum()
    }

    fn bounds() -> ServerLimits {
        ServerLimits {
            message_bytes: MESSAGE_BYTES_MAX as u64,
            block_bytes: BLOCK_BYTES_MAX as u64,
            forks: FORKS_MAX as u64,
        }
    }

    fn lock(&self) -> MutexGuard<'_, ServerState> {
        // A thread that panicked left whole values: each change is one call.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives a connection its place.
    fn admit(&self, role: Role, session: Option<u64>) -> Result<ConnectionSlot<'_>, CellRefusal> {
        let mut state = self.lock();
        if state.connections >= self.options.connections_max {
            let most = self.options.connections_max as u64;
            return Err(CellRefusal::Full { what: "connections".to_owned(), most });
        }
        if role == Role::Live && state.live_is_taken {
            return Err(CellRefusal::Taken);
        }
        let number = match session {
            Some(number) if state.sessions.contains_key(&number) => number,
            Some(_) => {
                let allowed = "a session that has an open connection, or none".to_owned();
                return Err(CellRefusal::Hello { field: "session".to_owned(), allowed });
            }
            // Not to be guessed, and never that of a server before this one.
            None => getrandom::u64().map_err(|error| CellRefusal::Hello {
                field: "session".to_owned(),
                allowed: format!("none can be made: {error}"),
            })?,
        };
        state.connections += 1;
        state.live_is_taken |= role == Role::Live;
        state.sessions.entry(number).or_default().connections += 1;
        Ok(ConnectionSlot { server: self, role, session: number })
    }
}

/// The place of a connection; it is given back when it is dropped.
struct ConnectionSlot<'a> {
    server: &'a CellServer,
    role: Role,
    session: u64,
}

impl ConnectionSlot<'_> {
    /// Keeps a state under a new handle.
    fn keep(&self, copy: CellCopy) -> Result<u64, CellRefusal> {
        let mut state = self.server.lock();
        state.newest_fork += 1;
        let fork = state.newest_fork;
        let session = state.sessions.entry(self.session).or_default();
        if session.forks.len() >= FORKS_MAX {
            return Err(CellRefusal::Full { what: "forks".to_owned(), most: FORKS_MAX as u64 });
        }
        session.forks.insert(fork, Arc::new(copy));
        Ok(fork)
    }

    /// The state of a handle.
    fn fork(&self, fork: u64) -> Result<Arc<CellCopy>, CellRefusal> {
        let state = self.server.lock();
        let found = state.sessions.get(&self.session).and_then(|session| session.forks.get(&fork));
        found.cloned().ok_or(CellRefusal::UnknownFork(fork))
    }

    /// Forgets states. A handle that is not known was forgotten before.
    fn release(&self, forks: &[u64]) {
        let mut state = self.server.lock();
        let session = state.sessions.entry(self.session).or_default();
        let dropped: Vec<_> = forks.iter().filter_map(|fork| session.forks.remove(fork)).collect();
        drop(state);
        // A state may be large: it is given back outside the lock.
        drop(dropped);
    }
}

impl Drop for ConnectionSlot<'_> {
    fn drop(&mut self) {
        let mut state = self.server.lock();
        state.connections = state.connections.saturating_sub(1);
        if self.role == Role::Live {
            state.live_is_taken = false;
        }
        let ended = state.sessions.get_mut(&self.session).is_some_and(|session| {
            session.connections = session.connections.saturating_sub(1);
            session.connections == 0
        });
        let session = if ended { state.sessions.remove(&self.session) } else { None };
        drop(state);
        drop(session);
    }
}
