//! A recording's bytes: a header, one framed message after the other, and an end.
//!
//! Framed here and not by rerun's own encoder, which writes when it is dropped and adds a footer: an index of all
//! columns, whose order is left to chance, so that the same run would not give the same bytes, and which is a third
//! of a short recording. A viewer reads a file of this size from its beginning and needs no index.

use std::io::{self, Write};

use rerun::external::re_log_encoding::{
    Compression, CrateVersion, Encodable, EncodingOptions, MessageHeader, MessageKind, RRD_FOURCC,
    StreamHeader, ToTransport,
};
use rerun::external::re_log_types::{SetStoreInfo, StoreInfo, StoreSource};
use rerun::log::{Chunk, LogMsg};
use rerun::{StoreId, StoreKind};

use super::rows::Ids;

/// The application's id in every recording.
pub const APPLICATION: &str = "holdpoint";

/// What a torn or foreign message is to whoever writes: an error like any other.
fn other<E: std::fmt::Display>(error: E) -> io::Error {
    io::Error::other(error.to_string())
}

/// The store of a recording.
#[must_use]
pub fn store(name: &str) -> StoreId {
    StoreId::new(StoreKind::Recording, APPLICATION, name)
}

/// The message that begins a store.
pub fn opening(store: &StoreId, ids: &mut Ids) -> LogMsg {
    let source = StoreSource::Other(APPLICATION.to_owned());
    LogMsg::SetStoreInfo(SetStoreInfo { row_id: ids.plain(), info: StoreInfo::new(store.clone(), source) })
}

/// A chunk as a message.
///
/// # Errors
/// Where the chunk is not well formed.
pub fn message(store: &StoreId, chunk: &Chunk) -> io::Result<LogMsg> {
    Ok(LogMsg::ArrowMsg(store.clone(), chunk.to_arrow_msg().map_err(other)?))
}

/// Frames messages.
#[derive(Debug)]
pub struct Framed<W: Write> {
    out: W,
    written: u64,
    scratch: Vec<u8>,
}

impl<W: Write> Framed<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn begin(out: W) -> io::Result<Self> {
        let mut framed = Self { out, written: 0, scratch: Vec::new() };
        let options = EncodingOptions::PROTOBUF_COMPRESSED;
        framed.put(&StreamHeader { fourcc: RRD_FOURCC, version: CrateVersion::LOCAL.to_bytes(), options })?;
        Ok(framed)
    }

    /// Bytes so far.
    #[must_use]
    pub const fn written(&self) -> u64 {
        self.written
    }

    /// Writes a message.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn write(&mut self, message: &LogMsg) -> io::Result<()> {
        let transport = message.to_transport(Compression::LZ4).map_err(other)?;
        self.put(&transport)
    }

    /// Hands everything over to the system.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// Writes the mark of the end and hands the file back.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn finish(mut self) -> io::Result<W> {
        self.put(&MessageHeader { kind: MessageKind::End, len: 0 })?;
        self.out.flush()?;
        Ok(self.out)
    }

    fn put(&mut self, what: &dyn Encodable) -> io::Result<()> {
        let mut scratch = std::mem::take(&mut self.scratch);
        scratch.clear();
        what.to_rrd_bytes(&mut scratch).map_err(other)?;
        self.out.write_all(&scratch)?;
        self.written += scratch.len() as u64;
        self.scratch = scratch;
        Ok(())
    }
}
