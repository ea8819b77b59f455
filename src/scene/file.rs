//! A recording's bytes: a header, framed messages, and in completed files a footer that indexes them.
//!
//! Framed here because rerun's own encoder does not fit: it orders a footer's parts at random, so equal runs would
//! differ. It also writes when it is dropped, and keeps a footer in memory for files that may never end.

use std::collections::BTreeMap;
use std::io::{self, Write};

use rerun::external::arrow::datatypes::Schema;
use rerun::external::re_chunk_store::Span;
use rerun::external::re_log_encoding::{
    Compression, CrateVersion, Encodable, EncodingOptions, MessageHeader, MessageKind, RRD_FOURCC,
    RawRrdManifest, RrdFooter, RrdManifestBuilder, StreamFooter, StreamHeader, ToTransport,
};
use rerun::external::re_log_types::{SetStoreInfo, StoreInfo, StoreSource};
use rerun::log::{Chunk, LogMsg};
use rerun::{StoreId, StoreKind};

use super::rows::RowIds;

/// The application's id in every recording.
pub const APPLICATION: &str = "holdpoint";

/// A torn or foreign message as an I/O error.
fn io_error<E: std::fmt::Display>(error: E) -> io::Error {
    io::Error::other(error.to_string())
}

/// The store of a recording.
#[must_use]
pub fn store(name: &str) -> StoreId {
    StoreId::new(StoreKind::Recording, APPLICATION, name)
}

/// The message that begins a store.
pub fn opening(store: &StoreId, ids: &mut RowIds) -> LogMsg {
    let source = StoreSource::Other(APPLICATION.to_owned());
    LogMsg::SetStoreInfo(SetStoreInfo { row_id: ids.plain(), info: StoreInfo::new(store.clone(), source) })
}

/// A chunk as a message.
///
/// # Errors
/// If the chunk is not well formed.
pub fn message(store: &StoreId, chunk: &Chunk) -> io::Result<LogMsg> {
    Ok(LogMsg::ArrowMsg(store.clone(), chunk.to_arrow_msg().map_err(io_error)?))
}

#[derive(Debug)]
pub struct FramedWriter<W: Write> {
    out: W,
    written: u64,
    scratch: Vec<u8>,
    /// The content of the footer; absent for a file that may end at any time.
    manifests: Option<BTreeMap<StoreId, RrdManifestBuilder>>,
}

impl<W: Write> FramedWriter<W> {
    /// Begins a file that may end at any time.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn open_ended(out: W) -> io::Result<Self> {
        Self::begin(out, None)
    }

    /// Begins a file with a footer.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn indexed(out: W) -> io::Result<Self> {
        Self::begin(out, Some(BTreeMap::new()))
    }

    fn begin(out: W, manifests: Option<BTreeMap<StoreId, RrdManifestBuilder>>) -> io::Result<Self> {
        let mut framed = Self { out, written: 0, scratch: Vec::new(), manifests };
        let options = EncodingOptions::PROTOBUF_COMPRESSED;
        framed.put(&StreamHeader { fourcc: RRD_FOURCC, version: CrateVersion::LOCAL.to_bytes(), options })?;
        Ok(framed)
    }

    #[must_use]
    pub const fn written(&self) -> u64 {
        self.written
    }

    /// Writes a message.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&mut self, message: &LogMsg) -> io::Result<()> {
        let transport = message.to_transport(Compression::LZ4).map_err(io_error)?;
        let start = self.written + MessageHeader::ENCODED_SIZE_BYTES as u64;
        self.put(&transport)?;
        if let (Some(manifests), LogMsg::ArrowMsg(store, arrow)) = (&mut self.manifests, message) {
            let batch =
                Chunk::from_arrow_msg(arrow).and_then(|chunk| chunk.to_chunk_batch()).map_err(io_error)?;
            let span = Span { start, len: self.written.saturating_sub(start) };
            let manifest = manifests.entry(store.clone()).or_default();
            manifest.append(&batch, span, transport.byte_size_uncompressed()).map_err(io_error)?;
        }
        Ok(())
    }

    /// Flushes everything to the system.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// Writes the footer, if there is one, and returns the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(mut self) -> io::Result<W> {
        if let Some(manifests) = self.manifests.take() {
            let mut footer = RrdFooter::default().to_transport(()).map_err(io_error)?;
            for (store, manifest) in manifests {
                let manifest = ordered(manifest.build(store).map_err(io_error)?);
                footer.manifests.push(manifest.to_transport(()).map_err(io_error)?);
            }
            let mut bytes = Vec::new();
            footer.to_rrd_bytes(&mut bytes).map_err(io_error)?;
            self.put(&MessageHeader { kind: MessageKind::End, len: bytes.len() as u64 })?;
            let start = self.written;
            self.put_bytes(&bytes)?;
            self.put(&StreamFooter::from_rrd_footer_bytes(start, &bytes))?;
        }
        self.out.flush()?;
        Ok(self.out)
    }

    fn put(&mut self, what: &dyn Encodable) -> io::Result<()> {
        let mut scratch = std::mem::take(&mut self.scratch);
        scratch.clear();
        what.to_rrd_bytes(&mut scratch).map_err(io_error)?;
        let put = self.put_bytes(&scratch);
        self.scratch = scratch;
        put
    }

    fn put_bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.written += bytes.len() as u64;
        Ok(())
    }
}

/// The same index with its columns in order; its own digest of them does not depend on the order.
fn ordered(mut manifest: RawRrdManifest) -> RawRrdManifest {
    let mut fields = manifest.sorbet_schema.fields().to_vec();
    fields.sort();
    manifest.sorbet_schema = Schema::new_with_metadata(fields, manifest.sorbet_schema.metadata().clone());
    manifest
}
