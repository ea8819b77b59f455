//! Completes and repairs files: few large chunks instead of many small ones, a footer, one file instead of segments.
//!
//! A new file is written beside the old one, synced and renamed, so that a kill leaves one of them.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use rerun::AnyValues;
use rerun::EntityPath;
use rerun::components::Text;
use rerun::log::Chunk;
use sha2::{Digest as _, Sha256};

use super::decoder_guard::guarded;
use super::drawing::{RecordingTail, paths, tail};
use super::file::{FramedWriter, message, opening, store};
use super::limits::{CHUNK_ROWS_MAX, READ_BYTES_MAX};
use super::reader::{RecordingContents, contents};
use super::rows::{PendingRows, RowIds};
use super::{ReadError, blueprint};
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_text::Untrusted;
use holdpoint_text::file::create_fresh;

/// A completed file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EndedFile {
    /// SHA-256 of its bytes.
    pub digest: Digest,
    pub bytes: u64,
    pub frames: u64,
}

/// Writes the segments of a recording as one file at `into`, which may be one of them; the others are removed.
///
/// # Errors
/// If a segment cannot be read or is damaged, or the file not be written.
pub fn join(
    stem: &str,
    segments: &[PathBuf],
    into: &Path,
    end: &RecordingTail,
) -> Result<EndedFile, ReadError> {
    guarded(into, || joined(stem, segments, into, end))
}

fn joined(
    stem: &str,
    segments: &[PathBuf],
    into: &Path,
    end: &RecordingTail,
) -> Result<EndedFile, ReadError> {
    let mut all = Vec::new();
    for segment in segments {
        all.extend(contents(segment)?.chunks);
    }
    let all = with_end(all, end);
    let ended = write_all(stem, all, into).map_err(|source| ReadError::file(into, source))?;
    for segment in segments.iter().filter(|segment| segment.as_path() != into) {
        // The next start finds and joins leftover segments.
        let _ = fs::remove_file(segment);
    }
    Ok(ended)
}

/// The chunks of a recording with the final properties in place of those of a segment.
fn with_end(mut chunks: Vec<Chunk>, end: &RecordingTail) -> Vec<Chunk> {
    let replaced = [paths::TAIL, END].map(EntityPath::parse_forgiving);
    chunks.retain(|chunk| !replaced.contains(chunk.entity_path()));
    let mut rows = PendingRows::new(RowIds::of_segment(LAST_SEGMENT));
    tail(&mut rows, end);
    let outcome = end.outcome.as_ref().map_or_else(|| "open".to_owned(), ToString::to_string);
    let outcome = Untrusted::new(outcome).line();
    let dropped = format!("{} video frames, {} events", end.dropped.0, end.dropped.1);
    let facts = AnyValues::default()
        .with_component::<Text>("outcome", [Text::from(outcome.as_str())])
        .with_component::<Text>("dropped", [Text::from(dropped)]);
    rows.always(END, &facts);
    chunks.extend(rows.take().0);
    chunks
}

/// The properties that are known at the end.
pub const END: &str = "__properties/end";

/// Ids of the final properties: after those of every segment.
const LAST_SEGMENT: u32 = 0xf_ffff;

/// Writes chunks as a completed file and renames it into place.
///
/// # Errors
/// If it cannot be written.
pub fn write_all(stem: &str, chunks: Vec<Chunk>, into: &Path) -> io::Result<EndedFile> {
    let beside = into.with_extension("rrd.part");
    let written = write_temporary(stem, chunks, &beside).and_then(|ended| {
        fs::rename(&beside, into)?;
        if let Some(folder) = into.parent() {
            File::open(folder)?.sync_all()?;
        }
        Ok(ended)
    });
    if written.is_err() {
        let _ = fs::remove_file(&beside);
    }
    written
}

fn write_temporary(stem: &str, chunks: Vec<Chunk>, beside: &Path) -> io::Result<EndedFile> {
    let file = BufWriter::new(DigestingWriter { file: create_fresh(beside)?, sum: Sha256::new(), bytes: 0 });
    let mut framed = FramedWriter::indexed(file)?;
    let store = store(stem);
    let mut ids = RowIds::of_segment(LAST_SEGMENT + 1);
    for layout in blueprint::messages()? {
        framed.write(&layout)?;
    }
    framed.write(&opening(&store, &mut ids))?;
    let frames = frame_count(&chunks);
    for chunk in few(chunks)? {
        framed.write(&message(&store, &chunk.with_id(ids.chunk()))?)?;
    }
    let summed = framed.finish()?.into_inner().map_err(io::IntoInnerError::into_error)?;
    summed.file.sync_all()?;
    Ok(EndedFile { digest: Digest::from_bytes(summed.sum.finalize().into()), bytes: summed.bytes, frames })
}

/// The same rows in few chunks, ordered by entity.
fn few(chunks: Vec<Chunk>) -> io::Result<Vec<Chunk>> {
    let other = |error: rerun::log::ChunkError| io::Error::other(error.to_string());
    let mut entities: BTreeMap<(EntityPath, bool), Vec<Chunk>> = BTreeMap::new();
    for chunk in chunks {
        let key = (chunk.entity_path().clone(), !chunk.is_static());
        let parts = entities.entry(key).or_default();
        let joined = match parts.last() {
            Some(last) if last.concatenable(&chunk) => {
                Some(Chunk::concat_and_sort(last, &chunk).map_err(other)?)
            }
            _ => None,
        };
        if joined.is_some() {
            parts.pop();
        }
        let mut rest = joined.unwrap_or(chunk);
        while rest.num_rows() > CHUNK_ROWS_MAX {
            parts.push(rest.row_sliced_deep(0, CHUNK_ROWS_MAX));
            rest = rest.row_sliced_deep(CHUNK_ROWS_MAX, rest.num_rows());
        }
        parts.push(rest);
    }
    Ok(entities.into_values().flatten().collect())
}

/// Video frames in a recording.
fn frame_count(chunks: &[Chunk]) -> u64 {
    let path = EntityPath::parse_forgiving(paths::FRAME);
    chunks.iter().filter(|chunk| *chunk.entity_path() == path).map(|chunk| chunk.num_rows() as u64).sum()
}

/// Counts and sums what passes.
struct DigestingWriter {
    file: File,
    sum: Sha256,
    bytes: u64,
}

impl Write for DigestingWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write(bytes)?;
        self.sum.update(bytes.get(..written).unwrap_or(bytes));
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// The state of a file at a start.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FileAtStart {
    /// The file is complete, with this outcome.
    Ended(EndedFile, Lenient<UpgradeEnd>),
    /// The file is readable and its upgrade may continue.
    Open,
}

/// Reads a file of an earlier session and repairs it if a kill left it without an end.
///
/// # Errors
/// If it cannot be read or written, or is damaged.
pub fn mend(stem: &str, path: &Path, dropped: (u64, u64)) -> Result<FileAtStart, ReadError> {
    guarded(path, || repair(stem, path, dropped))
}

fn repair(stem: &str, path: &Path, dropped: (u64, u64)) -> Result<FileAtStart, ReadError> {
    let RecordingContents { chunks, tail } = contents(path)?;
    let Some(tail) = tail else {
        let chunks = with_end(chunks, &RecordingTail { outcome: None, dropped });
        write_all(stem, chunks, path).map_err(|source| ReadError::file(path, source))?;
        return Ok(FileAtStart::Open);
    };
    let Some(outcome) = tail.outcome else { return Ok(FileAtStart::Open) };
    let frames = frame_count(&chunks);
    let bytes =
        holdpoint_text::file::read(path, READ_BYTES_MAX).map_err(|source| ReadError::file(path, source))?;
    let digest = Digest::from_bytes(Sha256::digest(&bytes).into());
    Ok(FileAtStart::Ended(EndedFile { digest, bytes: bytes.len() as u64, frames }, outcome))
}
