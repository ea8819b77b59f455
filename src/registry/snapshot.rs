//! Snapshots of the fold, so that the start of a store with a long chain need not read all of it.
//!
//! A snapshot lies beside the checkpoint of the same record, and the checkpoint's signature covers its digest. One
//! that is missing, damaged, of another store or of an earlier version is no snapshot: the chain is read from its first record. Records and
//! receipts before a snapshot are not read at a start; `audit verify` and a rebuild read them always.

use std::collections::BTreeSet;
use std::fs;
use std::io::Read;
use std::path::Path;

use ed25519_dalek::VerifyingKey;
use rusqlite::{Connection, OptionalExtension};
use serde::{Deserialize, Serialize};

use super::audit::Head;
use super::checkpoint::{self, Checkpoint};
use super::error::StoreError;
use super::fold::{Fold, FoldParts, Vouched};
use super::layout::write_atomically;
use super::merkle::Frontier;
use super::rows::ChainedTable;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::lifecycle::State;

/// Domain tag of a snapshot's digest.
const DOMAIN: &str = "holdpoint/fold-snapshot/v2";
/// Records between two snapshots; a chain that is shorter is read as a whole.
pub(crate) const EVERY_RECORDS: u64 = 32_768;
/// The largest snapshot that is written or read, bytes.
const BYTES_MAX: u64 = 512 << 20;
/// The ending of a snapshot's name.
const ENDING: &str = "fold";

/// A snapshot as its file has it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    seq: u64,
    hash: Digest,
    at_ms: u64,
    rows: Vec<(String, String, Digest, u64)>,
    states: Vec<(String, State, u64)>,
    order: Vec<String>,
    tree: Frontier,
    witnesses: BTreeSet<String>,
}

/// Writes a snapshot and removes the earlier ones. Tells its digest, which a checkpoint has to cover; `None` if it
/// would be too large.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn write(fold: &Fold, folder: &Path) -> Result<Option<Digest>, StoreError> {
    let FoldParts { end, rows, states, order, tree, witnesses } = fold.parts();
    let file = File {
        seq: end.seq,
        hash: end.hash,
        at_ms: end.at_ms,
        rows: rows
            .iter()
            .map(|((table, key), row)| (table.name().to_owned(), key.clone(), row.digest, row.seq))
            .collect(),
        states: states.iter().map(|(name, (state, version))| (name.clone(), *state, *version)).collect(),
        order: order.to_vec(),
        tree: tree.clone(),
        witnesses: witnesses.clone(),
    };
    let bytes =
        serde_json::to_vec(&file).map_err(|error| StoreError::invalid("fold snapshot", end.seq, error))?;
    if bytes.len() as u64 > BYTES_MAX {
        return Ok(None);
    }
    let earlier = names(folder)?;
    write_atomically(&folder.join(name(end.seq)), &bytes)?;
    for name in earlier.iter().filter(|earlier| **earlier != name(end.seq)) {
        let path = folder.join(name);
        fs::remove_file(&path).map_err(StoreError::io("remove", &path))?;
    }
    Ok(Some(Digest::of_parts(DOMAIN, &[&bytes])))
}

/// The fold up to the newest snapshot that a checkpoint of this store binds, and that is of this chain; `None` if
/// there is none.
pub(crate) fn read(
    folder: &Path,
    connection: &Connection,
    store_id: &str,
    key: &VerifyingKey,
) -> Option<Fold> {
    let name = names(folder).ok()?.pop()?;
    let seq: u64 = name.strip_suffix(ENDING)?.strip_suffix('.')?.parse().ok()?;
    let checkpoint = Checkpoint::read(&folder.join(checkpoint::name(seq))).ok()?;
    let bound = checkpoint.store_id == store_id && checkpoint.seq == seq && checkpoint.is_signed_by(key);
    let bytes = bounded(&folder.join(name))?;
    if !bound || checkpoint.fold != Some(Digest::of_parts(DOMAIN, &[&bytes])) {
        return None;
    }
    let file: File = serde_json::from_slice(&bytes).ok()?;
    let end = Head { seq: file.seq, hash: file.hash, at_ms: file.at_ms };
    let there: Option<[u8; 32]> = connection
        .query_row("SELECT hash FROM audit WHERE seq = ?1", [seq], |row| row.get(0))
        .optional()
        .ok()?;
    if !file.tree.is_of(seq) || checkpoint.root != Some(file.tree.root()) {
        return None;
    }
    if (end.seq, end.hash) != (seq, checkpoint.head) || there != Some(*end.hash.bytes()) {
        return None;
    }
    let mut rows = std::collections::BTreeMap::new();
    for (table, key, digest, seq) in file.rows {
        rows.insert((ChainedTable::named(&table)?, key), Vouched { digest, seq });
    }
    let states = file.states.into_iter().map(|(name, state, version)| (name, (state, version))).collect();
    Some(Fold::from_parts(end, rows, states, file.order, (file.tree, file.witnesses)))
}

/// A file's bytes, if there are not too many.
fn bounded(path: &Path) -> Option<Vec<u8>> {
    if !fs::symlink_metadata(path).ok()?.is_file() {
        return None;
    }
    let mut bytes = Vec::new();
    fs::File::open(path).ok()?.take(BYTES_MAX + 1).read_to_end(&mut bytes).ok()?;
    (bytes.len() as u64 <= BYTES_MAX).then_some(bytes)
}

fn name(seq: u64) -> String {
    format!("{seq:012}.{ENDING}")
}

/// File names of all snapshots, oldest first.
fn names(folder: &Path) -> Result<Vec<String>, StoreError> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(StoreError::io("list", folder))? {
        let name = entry.map_err(StoreError::io("list", folder))?.file_name();
        if let Some(name) = name.to_str().filter(|name| name.ends_with(&format!(".{ENDING}"))) {
            names.push(name.to_owned());
        }
    }
    names.sort();
    Ok(names)
}
