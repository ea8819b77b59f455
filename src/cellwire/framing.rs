//! Frames on a stream: a length of four bytes, most significant first, and as many bytes. Has the bounds and deadlines.
//!
//! A frame is a message in MessagePack or a part of a block. Knows no cell.

use std::io::{self, Read, Write};
use std::time::{Duration, Instant};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::messages::{BLOCK_BYTES_MAX, Block, MESSAGE_BYTES_MAX, sha256_hex};

/// Within this time a frame that began has to end.
pub const FRAME_WITHIN: Duration = Duration::from_secs(2);

/// Bytes that are read at once.
const CHUNK_BYTES: usize = 16 * 1024;

/// The shortest wait that a stream can be given.
const WAIT_LEAST: Duration = Duration::from_millis(1);

/// A stream that frames pass on.
pub trait WireStream: Read + Write + Send {
    /// From now on a read fails after this time.
    ///
    /// # Errors
    /// If the stream is not open.
    fn limit_read(&self, within: Option<Duration>) -> io::Result<()>;
    /// From now on a write fails after this time.
    ///
    /// # Errors
    /// If the stream is not open.
    fn limit_write(&self, within: Option<Duration>) -> io::Result<()>;
    /// Closes it for both sides.
    fn close(&self);
}

impl WireStream for Box<dyn WireStream> {
    fn limit_read(&self, within: Option<Duration>) -> io::Result<()> {
        (**self).limit_read(within)
    }
    fn limit_write(&self, within: Option<Duration>) -> io::Result<()> {
        (**self).limit_write(within)
    }
    fn close(&self) {
        (**self).close();
    }
}

/// Why a connection failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The other side closed it, or is gone.
    #[error("the connection was closed")]
    Closed,
    /// Nothing came in time.
    #[error("no answer within {within_ms} ms")]
    Deadline {
        /// The time.
        within_ms: u64,
    },
    /// A frame began, and did not end in time.
    #[error("a message was torn: {came} of {due} bytes came")]
    Torn {
        /// Bytes that came.
        came: u64,
        /// Bytes that were due.
        due: u64,
    },
    /// A frame or a block is larger than allowed.
    #[error("{bytes} bytes; at most {most} are allowed")]
    TooLarge {
        /// Its bytes.
        bytes: u64,
        /// The bound.
        most: u64,
    },
    /// The bytes are no such message.
    #[error("the bytes are no message: {0}")]
    Malformed(String),
    /// An answer has another number than the request.
    #[error("the answer to request {came} came; that to {due} was due")]
    Sequence {
        /// The number that was due.
        due: u64,
        /// The number that came.
        came: u64,
    },
    /// The other side contradicts itself, or answers something else than what was asked.
    #[error("the cell contradicts itself: {0}")]
    Lying(String),
    /// The hello was refused, or the connection was closed with a reason.
    #[error("{0}")]
    Refused(String),
    /// The system refuses.
    #[error("the connection failed: {0}")]
    System(String),
}

impl WireError {
    fn of_io(error: &io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::UnexpectedEof
            | io::ErrorKind::ConnectionReset
            | io::ErrorKind::ConnectionAborted
            | io::ErrorKind::BrokenPipe
            | io::ErrorKind::NotConnected => Self::Closed,
            _ => Self::System(error.to_string()),
        }
    }
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut)
}

fn millis(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

/// A message as bytes.
///
/// # Errors
/// [`WireError::Malformed`] for a value that MessagePack lacks; no message of this crate has one.
pub fn encode<T: Serialize>(message: &T) -> Result<Vec<u8>, WireError> {
    let mut bytes = Vec::new();
    append(&mut bytes, message)?;
    Ok(bytes)
}

/// Adds a message to bytes.
fn append<T: Serialize>(bytes: &mut Vec<u8>, message: &T) -> Result<(), WireError> {
    rmp_serde::encode::write_named(bytes, message).map_err(|error| WireError::Malformed(error.to_string()))
}

/// Reads one message from bytes, all of them.
///
/// # Errors
/// [`WireError::Malformed`].
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, WireError> {
    let mut reader = rmp_serde::Deserializer::new(io::Cursor::new(bytes));
    reader.set_max_depth(DEPTH_MAX);
    let message = T::deserialize(&mut reader).map_err(|error| WireError::Malformed(error.to_string()))?;
    let read = reader.position();
    if read != bytes.len() as u64 {
        return Err(WireError::Malformed(format!("{} bytes follow the message", bytes.len() as u64 - read)));
    }
    Ok(message)
}

/// The deepest nesting of a message.
const DEPTH_MAX: usize = 64;

/// One end of a connection.
pub struct Line<S> {
    stream: S,
    /// Bytes that came; those before `taken` are read.
    inbox: Vec<u8>,
    taken: usize,
    /// A frame that is written.
    outbox: Vec<u8>,
    /// The limit that the stream has.
    limit: Option<Duration>,
}

impl<S: WireStream> Line<S> {
    /// Takes a stream.
    ///
    /// # Errors
    /// If it is not open.
    pub fn new(stream: S) -> Result<Self, WireError> {
        stream.limit_write(Some(FRAME_WITHIN)).map_err(|error| WireError::of_io(&error))?;
        stream.limit_read(Some(FRAME_WITHIN)).map_err(|error| WireError::of_io(&error))?;
        Ok(Self { stream, inbox: Vec::new(), taken: 0, outbox: Vec::new(), limit: Some(FRAME_WITHIN) })
    }

    /// Closes the connection for both sides.
    pub fn close(&self) {
        self.stream.close();
    }

    /// Sends a message.
    ///
    /// # Errors
    /// [`WireError`]; the connection is then useless.
    pub fn send<T: Serialize>(&mut self, message: &T) -> Result<(), WireError> {
        self.outbox.clear();
        self.outbox.extend_from_slice(&[0; 4]);
        append(&mut self.outbox, message)?;
        self.send_outbox()
    }

    /// Sends the bytes of a block that a message announced.
    ///
    /// # Errors
    /// As [`Line::send`].
    pub fn send_block(&mut self, bytes: &[u8]) -> Result<(), WireError> {
        for part in bytes.chunks(MESSAGE_BYTES_MAX) {
            self.outbox.clear();
            self.outbox.extend_from_slice(&[0; 4]);
            self.outbox.extend_from_slice(part);
            self.send_outbox()?;
        }
        Ok(())
    }

    /// Sends a frame as it is, whatever it says: for checks of the other side.
    ///
    /// # Errors
    /// As [`Line::send`].
    pub fn send_bytes(&mut self, bytes: &[u8]) -> Result<(), WireError> {
        self.stream.write_all(bytes).map_err(|error| WireError::of_io(&error))
    }

    fn send_outbox(&mut self) -> Result<(), WireError> {
        let bytes = self.outbox.len().saturating_sub(4);
        if bytes > MESSAGE_BYTES_MAX {
            return Err(WireError::TooLarge { bytes: bytes as u64, most: MESSAGE_BYTES_MAX as u64 });
        }
        let length = u32::try_from(bytes).unwrap_or(u32::MAX).to_be_bytes();
        if let Some(head) = self.outbox.get_mut(..4) {
            head.copy_from_slice(&length);
        }
        match self.stream.write_all(&self.outbox) {
            Ok(()) => Ok(()),
            Err(error) if is_timeout(&error) => Err(WireError::Deadline { within_ms: millis(FRAME_WITHIN) }),
            Err(error) => Err(WireError::of_io(&error)),
        }
    }

    /// Waits for a message.
    ///
    /// # Errors
    /// [`WireError::Deadline`] if none began in time: another call may follow. After any other error the connection is
    /// useless.
    pub fn receive<T: DeserializeOwned>(&mut self, within: Duration) -> Result<T, WireError> {
        let frame = self.frame(within)?;
        let read = decode(self.inbox.get(frame.clone()).unwrap_or_default());
        self.taken = frame.end;
        read
    }

    /// Waits for a frame, whatever it says.
    ///
    /// # Errors
    /// As [`Line::receive`].
    pub fn receive_bytes(&mut self, within: Duration) -> Result<Vec<u8>, WireError> {
        let frame = self.frame(within)?;
        let bytes = self.inbox.get(frame.clone()).unwrap_or_default().to_vec();
        self.taken = frame.end;
        Ok(bytes)
    }

    /// Reads the bytes of a block that a message announced.
    ///
    /// # Errors
    /// [`WireError`]; the connection is then useless.
    pub fn receive_block(&mut self, block: &Block, within: Duration) -> Result<Vec<u8>, WireError> {
        let most = BLOCK_BYTES_MAX as u64;
        if block.bytes > most {
            return Err(WireError::TooLarge { bytes: block.bytes, most });
        }
        // It grows with what comes, not with what is announced.
        let mut bytes = Vec::new();
        while (bytes.len() as u64) < block.bytes {
            let frame = self.frame(within)?;
            let part = self.inbox.get(frame.clone()).unwrap_or_default();
            if part.is_empty() || (bytes.len() + part.len()) as u64 > block.bytes {
                return Err(WireError::Malformed(format!(
                    "a block of {} bytes has other parts",
                    block.bytes
                )));
            }
            bytes.extend_from_slice(part);
            self.taken = frame.end;
        }
        if sha256_hex(&bytes) != block.sha256 {
            return Err(WireError::Malformed("a block does not have the digest given with it".to_owned()));
        }
        Ok(bytes)
    }

    /// The place of the next frame in the inbox.
    fn frame(&mut self, within: Duration) -> Result<std::ops::Range<usize>, WireError> {
        self.compact();
        if self.inbox.is_empty() {
            self.fill(within)?;
        }
        let until = Instant::now() + FRAME_WITHIN;
        let bytes = loop {
            if let Some(head) = self.inbox.first_chunk::<4>() {
                break u32::from_be_bytes(*head) as usize;
            }
            self.fill_on(until, 4)?;
        };
        if bytes > MESSAGE_BYTES_MAX {
            return Err(WireError::TooLarge { bytes: bytes as u64, most: MESSAGE_BYTES_MAX as u64 });
        }
        while self.inbox.len() < 4 + bytes {
            self.fill_on(until, 4 + bytes)?;
        }
        Ok(4..4 + bytes)
    }

    /// Forgets what is read.
    fn compact(&mut self) {
        if self.taken >= self.inbox.len() {
            self.inbox.clear();
        } else if self.taken > 0 {
            self.inbox.drain(..self.taken);
        }
        self.taken = 0;
    }

    /// Reads on in a frame that began.
    fn fill_on(&mut self, until: Instant, due: usize) -> Result<(), WireError> {
        let torn = |came: usize| WireError::Torn { came: came as u64, due: due as u64 };
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(torn(self.inbox.len()));
        }
        match self.fill(left) {
            Err(WireError::Deadline { .. } | WireError::Closed) => Err(torn(self.inbox.len())),
            other => other,
        }
    }

    /// Reads what comes next, at least one byte.
    fn fill(&mut self, within: Duration) -> Result<(), WireError> {
        let within = within.max(WAIT_LEAST);
        if self.limit != Some(within) {
            self.stream.limit_read(Some(within)).map_err(|error| WireError::of_io(&error))?;
            self.limit = Some(within);
        }
        let start = self.inbox.len();
        self.inbox.resize(start + CHUNK_BYTES, 0);
        let room = self.inbox.get_mut(start..).unwrap_or_default();
        let read = loop {
            match self.stream.read(room) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                read => break read,
            }
        };
        self.inbox.truncate(start + *read.as_ref().unwrap_or(&0));
        match read {
            Ok(0) => Err(WireError::Closed),
            Ok(_) => Ok(()),
            Err(error) if is_timeout(&error) => Err(WireError::Deadline { within_ms: millis(within) }),
            Err(error) => Err(WireError::of_io(&error)),
        }
    }
}

#[cfg(test)]
mod tests;
