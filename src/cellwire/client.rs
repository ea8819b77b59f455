//! Cells at an endpoint, as a factory: the engine uses them as any other cell.
//!
//! One connection is the factory's own and keeps the session; each cell has another. A cell whose connection is lost fails
//! every tick. New work, or a new episode, connects it again.

mod cell;
mod peer;

use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use holdpoint_body::BodyError;
use holdpoint_body::disturbance::Drift;
use holdpoint_cell::{CellError, CellFactory, CellSpec, Distribution, LiveCell, TrialCell};

use crate::endpoint::Endpoint;
use crate::framing::{WireError, WireStream, decode};
use crate::messages::{Call, CellReply, FactoryDescription, Hello, PROTOCOL, RELEASED_MAX, Role, Welcome};
use crate::refusal::CellRefusal;

pub use cell::WireCell;
pub use peer::{CellCallError, Peer};

/// How long an answer is waited for. In lockstep and in trials no time counts, and a tick is a call like others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Deadlines {
    /// A tick of a live cell with a watchdog, and what is drawn between two of them.
    pub step: Duration,
    /// Any other call.
    pub call: Duration,
    /// Work that is presented.
    pub work: Duration,
}

impl Default for Deadlines {
    fn default() -> Self {
        Self {
            step: Duration::from_millis(250),
            call: Duration::from_secs(10),
            work: Duration::from_mins(10),
        }
    }
}

/// How a client connects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClientOptions {
    /// The watchdog of the live cell, ms between two commands; none in lockstep.
    pub watchdog_ms: Option<u32>,
    /// How long an answer is waited for.
    pub deadlines: Deadlines,
}

impl ClientOptions {
    /// For a script: no time counts.
    #[must_use]
    pub fn lockstep() -> Self {
        Self { watchdog_ms: None, deadlines: Deadlines::default() }
    }

    /// For an engine at the pace of a clock: the cell stops its arm after 250 ms without a command.
    #[must_use]
    pub fn paced() -> Self {
        Self { watchdog_ms: Some(250), deadlines: Deadlines::default() }
    }
}

/// Opens a connection.
pub type Connect = Box<dyn Fn() -> io::Result<Box<dyn WireStream>> + Send + Sync>;

/// What the cells of a factory share.
struct Shared {
    /// Where they are, for messages.
    name: String,
    connect: Connect,
    options: ClientOptions,
    /// SHA-256 of the description, in hexadecimal digits.
    digest: String,
    description: FactoryDescription,
    spec: Arc<CellSpec>,
    session: AtomicU64,
    /// The connection that keeps the session.
    control: Mutex<Peer>,
    /// Forks that no cell needs any more, with their session.
    released: Mutex<Vec<(u64, u64)>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The cells at an endpoint.
pub struct WireFactory {
    shared: Arc<Shared>,
}

impl WireFactory {
    /// Connects to an endpoint and reads its description.
    ///
    /// # Errors
    /// [`CellError::File`] with the endpoint for a cell that is not there, speaks another version, or describes itself
    /// wrongly.
    pub fn connect(endpoint: &Endpoint, options: ClientOptions) -> Result<Self, CellError> {
        let (name, endpoint) = (endpoint.to_string(), endpoint.clone());
        let connect = move || -> io::Result<Box<dyn WireStream>> {
            Ok(Box::new(endpoint.connect(options.deadlines.call)?))
        };
        Self::over(name, Box::new(connect), options)
    }

    /// As [`Self::connect`], over connections of the caller's own.
    ///
    /// # Errors
    /// As [`Self::connect`].
    pub fn over(name: String, connect: Connect, options: ClientOptions) -> Result<Self, CellError> {
        let refused = |error: CellCallError| match error {
            CellCallError::Refused(refusal) => {
                CellError::file(&name, "cell", refusal.into_cell_error().to_string())
            }
            CellCallError::Lost(error) => CellError::file(&name, "cell", error.to_string()),
        };
        let (mut control, welcome) =
            Peer::greet(&connect, &hello(Role::Control, None, None)).map_err(refused)?;
        let within = options.deadlines.call;
        let bytes = control.ask_block(Call::Describe, within).map_err(refused)?;
        if crate::messages::sha256_hex(&bytes) != welcome.description {
            return Err(CellError::file(&name, "description", "it does not have the digest of the hello"));
        }
        let described: FactoryDescription = decode(&bytes).map_err(|error| refused(error.into()))?;
        described.spec.check(&name)?;
        for distribution in &described.distributions {
            distribution.check(&name)?;
        }
        if described.build != welcome.build {
            return Err(CellError::file(&name, "build", "description and hello name different builds"));
        }
        let shared = Shared {
            spec: Arc::new(described.spec.clone()),
            digest: welcome.description,
            session: AtomicU64::new(welcome.session),
            control: Mutex::new(control),
            released: Mutex::default(),
            description: described,
            name,
            connect,
            options,
        };
        Ok(Self { shared: Arc::new(shared) })
    }

    /// A cell of a role, with its ports.
    fn cell(&self, role: Role) -> Result<WireCell, CellError> {
        WireCell::new(Arc::clone(&self.shared), role)
    }
}

fn hello(role: Role, session: Option<u64>, watchdog_ms: Option<u32>) -> Hello {
    let client = concat!("holdpoint ", env!("CARGO_PKG_VERSION")).to_owned();
    Hello { protocol: PROTOCOL, role, session, watchdog_ms, client }
}

impl Shared {
    /// A new connection of the session; of a new session if the server was started again.
    fn join(&self, role: Role) -> Result<Peer, CellCallError> {
        match self.join_session(role) {
            Err(CellCallError::Refused(CellRefusal::Hello { field, .. })) if field == "session" => {
                let mut control = lock(&self.control);
                let (peer, welcome) = Peer::greet(&self.connect, &hello(Role::Control, None, None))?;
                self.compare(&welcome)?;
                self.session.store(welcome.session, Ordering::Release);
                *control = peer;
                drop(control);
                self.join_session(role)
            }
            joined => joined,
        }
    }

    fn join_session(&self, role: Role) -> Result<Peer, CellCallError> {
        let watchdog_ms = self.options.watchdog_ms.filter(|_| role == Role::Live);
        let session = Some(self.session.load(Ordering::Acquire));
        let (peer, welcome) = Peer::greet(&self.connect, &hello(role, session, watchdog_ms))?;
        self.compare(&welcome)?;
        if welcome.watchdog_ms != watchdog_ms {
            return Err(WireError::Lying("it has another watchdog than was asked for".to_owned()).into());
        }
        Ok(peer)
    }

    /// Whether this is still the cell that was described.
    fn compare(&self, welcome: &Welcome) -> Result<(), WireError> {
        if welcome.description != self.digest {
            return Err(WireError::Lying("its description is another than at the start".to_owned()));
        }
        if welcome.build != self.description.build {
            return Err(WireError::Lying("its build is another than at the start".to_owned()));
        }
        Ok(())
    }

    /// Handles to release with the next request.
    fn take_released(&self) -> Vec<u64> {
        let session = self.session.load(Ordering::Acquire);
        let mut released = lock(&self.released);
        let from = released.len().saturating_sub(RELEASED_MAX);
        let taken = released.split_off(from);
        drop(released);
        // Those of a session that ended are gone with it.
        taken.into_iter().filter(|(of, _)| *of == session).map(|(_, fork)| fork).collect()
    }

    /// The error of a call, with the place of the cell.
    fn body_error(&self, error: CellCallError) -> BodyError {
        match error {
            CellCallError::Refused(refusal) => refusal.into_body_error(),
            CellCallError::Lost(error) => BodyError::Lost(format!("the cell at {}: {error}", self.name)),
        }
    }

    fn cell_error(&self, error: CellCallError) -> CellError {
        match error {
            CellCallError::Refused(refusal) => refusal.into_cell_error(),
            lost @ CellCallError::Lost(_) => CellError::Body(self.body_error(lost)),
        }
    }
}

impl CellFactory for WireFactory {
    fn spec(&self) -> &Arc<CellSpec> {
        &self.shared.spec
    }

    fn build_digest(&self) -> &str {
        &self.shared.description.build
    }

    fn distributions(&self) -> Result<[Distribution; 3], CellError> {
        Ok(self.shared.description.distributions.clone())
    }

    fn with_drift(&self, of: &Distribution, drift: &Drift) -> Result<Distribution, CellError> {
        let call = Call::Drift { of: Box::new(of.clone()), drift: *drift };
        let shared = &self.shared;
        let reply = lock(&shared.control).ask(None, Vec::new(), call, None, shared.options.deadlines.call);
        match reply.map_err(|error| shared.cell_error(error))? {
            CellReply::Distribution(drifted) => {
                drifted.check(&shared.name)?;
                Ok(*drifted)
            }
            other => Err(shared.cell_error(peer::unexpected(&other).into())),
        }
    }

    fn live(&self) -> Result<Box<dyn LiveCell>, CellError> {
        Ok(Box::new(self.cell(Role::Live)?))
    }

    fn trial(&self) -> Result<Box<dyn TrialCell>, CellError> {
        Ok(Box::new(self.cell(Role::Trial)?))
    }
}
