//! A copy of a recording that ends at a tick, for viewing an earlier moment.

use std::path::Path;

use rerun::external::arrow::array::BooleanArray;
use rerun::log::Chunk;

use super::ReadError;
use super::compact::{END, write_all};
use super::decoder_guard::guarded;
use super::drawing::paths;
use super::reader::{contents, head};
use super::rows::TICK;

/// Writes a copy of the recording at `path`, without rows after `tick`, to `out`.
///
/// # Errors
/// If the recording cannot be read or is damaged, or the copy not be written.
pub fn until(path: &Path, tick: u64, out: &Path) -> Result<(), ReadError> {
    guarded(path, || copied(path, tick, out))
}

fn copied(path: &Path, tick: u64, out: &Path) -> Result<(), ReadError> {
    let chunks = contents(path)?.chunks;
    let head = head(&chunks).ok_or_else(|| ReadError::foreign(path, "it does not say whose it is"))?;
    let last = i64::try_from(tick).unwrap_or(i64::MAX);
    // The end of the upgrade came later.
    let end = [paths::TAIL, END].map(rerun::EntityPath::parse_forgiving);
    let retained = chunks.into_iter().filter(|chunk| !end.contains(chunk.entity_path()));
    let retained = retained.filter_map(|chunk| before(&chunk, last)).collect();
    let stem = format!(
        "{}-until-{tick}",
        holdpoint_recordings::recording_folder::file_stem(&head.about.version, &head.about.digest)
    );
    write_all(&stem, retained, out).map_err(|source| ReadError::file(out, source))?;
    Ok(())
}

/// The rows of a chunk up to a tick; `None` if there are none.
fn before(chunk: &Chunk, last: i64) -> Option<Chunk> {
    if chunk.is_static() {
        return Some(chunk.clone());
    }
    let column = chunk.timelines().get(&TICK.into())?;
    let mask: Vec<bool> = column.times_raw().iter().map(|tick| *tick <= last).collect();
    let retained = chunk.filtered(&BooleanArray::from(mask))?;
    (!retained.is_empty()).then_some(retained)
}
