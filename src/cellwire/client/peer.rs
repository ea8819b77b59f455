//! The client's end of one connection: a request, then its answer. After a failure the connection stays lost.

use std::time::Duration;

use holdpoint_body::GuardVerdict;

use super::Connect;
use crate::framing::{Line, WireError, WireStream};
use crate::messages::{Answer, Call, CellReply, CellRequest, Greeting, Hello, PROTOCOL, Welcome};
use crate::refusal::CellRefusal;

/// Within this time a server has to answer a hello.
const WELCOME_WITHIN: Duration = Duration::from_secs(10);

/// Why a call has no effect.
#[derive(Clone, Debug, PartialEq)]
pub enum CellCallError {
    /// The cell refuses it; the connection stays.
    Refused(CellRefusal),
    /// The connection is lost.
    Lost(WireError),
}

impl From<WireError> for CellCallError {
    fn from(error: WireError) -> Self {
        Self::Lost(error)
    }
}

/// See the module comment.
pub struct Peer {
    line: Line<Box<dyn WireStream>>,
    /// The number of the next request.
    next: u64,
    lost: Option<WireError>,
}

/// The error of an answer to another question.
pub(super) fn unexpected(reply: &CellReply) -> WireError {
    let name = match reply {
        CellReply::Seen(_) => "seen",
        CellReply::Fork { .. } => "fork",
        CellReply::Block(_) => "block",
        CellReply::Scenery { .. } => "scenery",
        CellReply::Distribution(_) => "distribution",
        CellReply::Observed(_) => "observed",
        CellReply::Refused(_) => "refused",
    };
    WireError::Lying(format!("it answers \"{name}\", which was not asked"))
}

impl Peer {
    /// Connects and says hello.
    ///
    /// # Errors
    /// If no server answers, or the hello is refused.
    pub fn greet(connect: &Connect, hello: &Hello) -> Result<(Self, Welcome), CellCallError> {
        let stream = connect().map_err(|error| WireError::System(error.to_string()))?;
        let mut line = Line::new(stream)?;
        line.send(hello)?;
        match line.receive(WELCOME_WITHIN)? {
            Greeting::Welcome(welcome) if welcome.protocol == PROTOCOL => {
                Ok((Self { line, next: 1, lost: None }, welcome))
            }
            Greeting::Welcome(welcome) => {
                Err(CellCallError::Refused(CellRefusal::Version { server: welcome.protocol }))
            }
            Greeting::Refused(refusal) => Err(CellCallError::Refused(refusal)),
        }
    }

    /// Whether the connection is lost.
    #[must_use]
    pub const fn is_lost(&self) -> bool {
        self.lost.is_some()
    }

    /// Gives the connection up, so that the cell stops its arm; returns the reason.
    pub fn lose(&mut self, error: WireError) -> WireError {
        self.line.close();
        self.lost.get_or_insert(error).clone()
    }

    /// Asks, and waits for the answer; `block` are the bytes that the call announces.
    ///
    /// # Errors
    /// [`CellCallError`]; a refusal is never a reply.
    pub fn ask(
        &mut self,
        guard: Option<GuardVerdict>,
        release: Vec<u64>,
        call: Call,
        block: Option<&[u8]>,
        within: Duration,
    ) -> Result<CellReply, CellCallError> {
        if let Some(error) = &self.lost {
            return Err(error.clone().into());
        }
        let request = CellRequest { sequence: self.next, guard, release, call };
        let reply = match self.exchange(&request, block, within) {
            Ok(reply) => reply,
            Err(error) => return Err(self.lose(error).into()),
        };
        self.next += 1;
        match reply {
            CellReply::Refused(refusal) if refusal.closes() => {
                let told = refusal.clone().into_body_error().to_string();
                self.lose(WireError::Refused(told));
                Err(CellCallError::Refused(refusal))
            }
            CellReply::Refused(refusal) => Err(CellCallError::Refused(refusal)),
            reply => Ok(reply),
        }
    }

    fn exchange(
        &mut self,
        request: &CellRequest,
        block: Option<&[u8]>,
        within: Duration,
    ) -> Result<CellReply, WireError> {
        self.line.send(request)?;
        if let Some(bytes) = block {
            self.line.send_block(bytes)?;
        }
        let Answer { sequence, reply } = self.line.receive(within)?;
        if sequence == request.sequence {
            Ok(reply)
        } else {
            Err(WireError::Sequence { due: request.sequence, came: sequence })
        }
    }

    /// Asks for bytes.
    ///
    /// # Errors
    /// As [`Peer::ask`].
    pub fn ask_block(&mut self, call: Call, within: Duration) -> Result<Vec<u8>, CellCallError> {
        let reply = self.ask(None, Vec::new(), call, None, within)?;
        self.follow(&reply, within)
    }

    /// Reads the bytes that a reply announces.
    ///
    /// # Errors
    /// [`CellCallError::Lost`].
    pub fn follow(&mut self, reply: &CellReply, within: Duration) -> Result<Vec<u8>, CellCallError> {
        let read = match reply {
            CellReply::Block(block) => self.line.receive_block(block, within),
            other => Err(unexpected(other)),
        };
        read.map_err(|error| self.lose(error).into())
    }

    /// The stream, for checks of the other side.
    pub const fn line(&mut self) -> &mut Line<Box<dyn WireStream>> {
        &mut self.line
    }
}
