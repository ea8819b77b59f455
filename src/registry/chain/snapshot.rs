//! Snapshots of the fold, so that the start of a store with a long chain does not read all of it.
//!
//! A snapshot is stored beside the checkpoint of the same record, whose signature covers its digest. A missing, damaged
//! or foreign snapshot, or one of an earlier version, is ignored: the chain is read from its first record. A start
//! skips records and receipts before a snapshot; `audit verify` and a rebuild always read them.

use std::collections::BTreeSet;
use std::fs::{self, OpenOptions};
use std::io::{self, Read, Seek as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;

use ed25519_dalek::VerifyingKey;
use rusqlite::{Connection, OptionalExtension};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::chain::fold::{CellStop, ChainedRow, Fold};
use crate::chain::row_images::ChainedTable;
use crate::chain::telemetry_seals::TelemetryAccount;
use holdpoint_audit::chain::Head;
use holdpoint_audit::checkpoint::{self, Checkpoint};
use holdpoint_audit::files::write_atomically;
use holdpoint_audit::merkle::Frontier;
use holdpoint_audit::profile_history::ProfileHistory;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::lifecycle::State;
use holdpoint_store::StoreError;
use holdpoint_text::file::{NO_LINK, regular};

/// Domain tag of a snapshot's digest.
const DOMAIN: &str = "holdpoint/fold-snapshot/v4";
/// Records between two snapshots; a shorter chain is read whole.
pub(crate) const EVERY_RECORDS: u64 = 32_768;
/// The largest snapshot that is written or read, bytes.
const BYTES_MAX: u64 = 512 << 20;
/// Bytes of a snapshot per read.
const PIECE_BYTES: usize = 1 << 16;
/// The ending of a snapshot's name.
const ENDING: &str = "fold";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SnapshotFile {
    seq: u64,
    hash: Digest,
    at_ms: u64,
    rows: Vec<(String, String, Digest, u64)>,
    states: Vec<(String, State, u64)>,
    order: Vec<String>,
    telemetry: TelemetryAccount,
    tree: Frontier,
    witnesses: BTreeSet<String>,
    cell: CellStop,
    profiles: ProfileHistory,
}

/// Writes a snapshot and removes the earlier ones. Returns its digest, which a checkpoint has to cover; `None` if it is
/// too large.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn write(fold: &Fold, folder: &Path) -> Result<Option<Digest>, StoreError> {
    let end = fold.end;
    let file = SnapshotFile {
        seq: end.seq,
        hash: end.hash,
        at_ms: end.at_ms,
        rows: fold
            .rows
            .iter()
            .map(|((table, key), row)| (table.name().to_owned(), key.clone(), row.digest, row.seq))
            .collect(),
        states: fold.states.iter().map(|(name, (state, version))| (name.clone(), *state, *version)).collect(),
        order: fold.order.clone(),
        telemetry: fold.telemetry.clone(),
        tree: fold.tree.clone(),
        witnesses: fold.witnesses.clone(),
        cell: fold.cell,
        profiles: fold.profiles.clone(),
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

/// The fold up to the newest snapshot that a checkpoint of this store covers, and that is of this chain; `None` without
/// one.
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
    let signed = checkpoint.fold.filter(|_| bound)?;
    let bytes = with_digest(&folder.join(name), signed)?;
    let file: SnapshotFile = serde_json::from_slice(&bytes).ok()?;
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
    let mut fold = Fold::empty();
    (fold.end, fold.since, fold.cell, fold.telemetry) = (end, end, file.cell, file.telemetry);
    (fold.order, fold.tree) = (file.order, file.tree);
    (fold.witnesses, fold.profiles) = (file.witnesses, file.profiles);
    for (table, key, digest, seq) in file.rows {
        fold.rows.insert((ChainedTable::named(&table)?, key), ChainedRow { digest, seq });
    }
    let states = file.states.into_iter();
    fold.states = states.map(|(name, state, version)| (name, (state, version))).collect();
    Some(fold)
}

/// A file's bytes, if they match the signature: the file is hashed piece by piece before it is loaded.
fn with_digest(path: &Path, signed: Digest) -> Option<Vec<u8>> {
    let mut file = OpenOptions::new().read(true).custom_flags(NO_LINK).open(path).and_then(regular).ok()?;
    let length = file.metadata().ok()?.len();
    if length > BYTES_MAX || digest_of(&mut file, length).ok()? != signed {
        return None;
    }
    file.rewind().ok()?;
    let mut bytes = Vec::new();
    file.take(length).read_to_end(&mut bytes).ok()?;
    (Digest::of_parts(DOMAIN, &[&bytes]) == signed).then_some(bytes)
}

/// [`Digest::of_parts`] of a file of this length.
fn digest_of(file: &mut impl Read, length: u64) -> io::Result<Digest> {
    let mut hasher = Sha256::new();
    hasher.update((DOMAIN.len() as u64).to_le_bytes());
    hasher.update(DOMAIN);
    hasher.update(length.to_le_bytes());
    let (mut file, mut piece) = (file.take(length), vec![0; PIECE_BYTES]);
    loop {
        let count = file.read(&mut piece)?;
        let Some(read) = piece.get(..count).filter(|read| !read.is_empty()) else { break };
        hasher.update(read);
    }
    Ok(Digest::from_bytes(hasher.finalize().into()))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn snapshot_is_loaded_only_with_its_signed_digest() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.fold");
        for length in [0, 1, PIECE_BYTES, PIECE_BYTES + 1] {
            let bytes = vec![7; length];
            fs::write(&path, &bytes).unwrap();
            let signed = Digest::of_parts(DOMAIN, &[&bytes]);
            assert_eq!(digest_of(&mut bytes.as_slice(), length as u64).unwrap(), signed);
            assert_eq!(with_digest(&path, signed), Some(bytes));
            assert_eq!(with_digest(&path, Digest::of_parts(DOMAIN, &[b"other"])), None);
        }
        // One byte more than the largest snapshot: not even hashed.
        let empty = Digest::of_parts(DOMAIN, &[b""]);
        fs::File::create(&path).unwrap().set_len(BYTES_MAX + 1).unwrap();
        assert_eq!(with_digest(&path, empty), None);
        let link = folder.path().join("b.fold");
        fs::write(&path, "").unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        assert_eq!((with_digest(&path, empty), with_digest(&link, empty)), (Some(Vec::new()), None));
    }
}
