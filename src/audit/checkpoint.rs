//! Signed checkpoints: the holder of one can prove that the chain up to it was not rewritten or cut off.
//!
//! Each is a small JSON file outside the database, `checkpoints/<seq>.json`, signed with the store's key. They form
//! their own chain: each has a number and the digest of the one before, so that a removal in the middle is noticed. The
//! signed end in the database follows from the newest. Copies on another machine also bind a holder of that key.

use std::fs;
use std::path::Path;

use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};
use serde::{Deserialize, Serialize};

use super::chain::Head;
use super::files::{FileError, write_atomically};
use holdpoint_governance::ids::Digest;
use holdpoint_text::file::read_text;
use holdpoint_text::hex::{hex, unhex};

/// Domain tag of a checkpoint's signature.
const DOMAIN: &str = "holdpoint/checkpoint/v1";
/// Domain tag of a checkpoint that binds a snapshot of the fold as well.
const DOMAIN_WITH_FOLD: &str = "holdpoint/checkpoint/v2";
/// Domain tag of a checkpoint that follows from another.
const DOMAIN_LINKED: &str = "holdpoint/checkpoint/v3";
/// Domain tag of a checkpoint that holds the head of the tree over the records.
const DOMAIN_TREE: &str = "holdpoint/checkpoint/v4";
/// Domain tag of a checkpoint that holds the wall time of its record as well.
const DOMAIN_TIMED: &str = "holdpoint/checkpoint/v5";
const DOMAIN_DIGEST: &str = "holdpoint/checkpoint-digest/v1";
/// The predecessor digest of a store's first checkpoint.
const NONE_BEFORE: Digest = Digest::from_bytes([0; 32]);
/// Records between two checkpoints.
pub const EVERY_RECORDS: u64 = 256;
/// Checkpoints kept; older ones are removed. If there are fewer, the first of all is among them.
const KEPT_MAX: usize = 1000;
pub const FILE_BYTES_MAX: u64 = 4096;

/// The place of a checkpoint among the checkpoints of its store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CheckpointLink {
    /// The first is 1.
    pub number: u64,
    /// Digest of the one before, zeros if there was none.
    pub previous: Digest,
    /// A rebuild continued although some earlier ones were missing.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub gap: bool,
    /// The number of earlier versions' unlinked checkpoints when the first linked one was made.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub earlier: u64,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks for it")]
const fn is_zero(count: &u64) -> bool {
    *count == 0
}

impl CheckpointLink {
    /// The link from the newest checkpoint.
    #[must_use]
    pub fn after(newest: Option<&Checkpoint>) -> Self {
        Self {
            number: newest.map_or(0, Checkpoint::number).saturating_add(1),
            previous: newest.map_or(NONE_BEFORE, Checkpoint::digest),
            gap: false,
            earlier: newest.and_then(|newest| newest.link.as_ref()).map_or(0, |link| link.earlier),
        }
    }

    /// The link from these checkpoints, oldest first. Counts unlinked ones of earlier versions if none is linked yet.
    #[must_use]
    pub fn after_all(checkpoints: &[StoredCheckpoint]) -> Self {
        let newest = checkpoints.last().map(|stored| &stored.checkpoint);
        let link = Self::after(newest);
        if newest.is_some_and(|newest| newest.root.is_some()) {
            return link;
        }
        Self { earlier: count_earlier(checkpoints), ..link }
    }

    /// Whether both stand at the same place and follow from the same one.
    fn is_at(&self, other: &Self) -> bool {
        (self.number, self.previous) == (other.number, other.previous)
    }
}

/// The end of the chain at some moment, signed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Checkpoint {
    /// The store whose key signed it.
    pub store_id: String,
    /// The last record.
    pub seq: u64,
    /// Its virtual time, ms.
    pub at_ms: u64,
    /// Its hash.
    pub head: Digest,
    /// Digest of the snapshot of the fold beside it, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fold: Option<Digest>,
    /// Absent in unlinked checkpoints of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub link: Option<CheckpointLink>,
    /// Root of the Merkle tree over the records up to `seq` (RFC 9162). Absent in checkpoints of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub root: Option<Digest>,
    /// Wall time of the record, ms since 1970; compared with the record's own. Absent in scripts, and in checkpoints of
    /// earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall_ms: Option<i64>,
    /// ed25519 signature, 128 hexadecimal digits.
    pub signature: String,
}

impl Checkpoint {
    /// Signs the end of a chain, whose records have a tree with this root and whose last has this wall time, ms since 1970.
    #[must_use]
    pub fn sign(
        store_id: &str,
        (head, root): (Head, Digest),
        wall_ms: Option<i64>,
        link: CheckpointLink,
        fold: Option<Digest>,
        key: &SigningKey,
    ) -> Self {
        let mut checkpoint = Self {
            store_id: store_id.to_owned(),
            seq: head.seq,
            at_ms: head.at_ms,
            head: head.hash,
            fold,
            link: Some(link),
            root: Some(root),
            wall_ms,
            signature: String::new(),
        };
        checkpoint.signature = hex(&key.sign(checkpoint.bytes().bytes()).to_bytes());
        checkpoint
    }

    fn bytes(&self) -> Digest {
        let (seq, at_ms) = (self.seq.to_le_bytes(), self.at_ms.to_le_bytes());
        let end: [&[u8]; 4] = [self.store_id.as_bytes(), &seq, &at_ms, self.head.bytes()];
        if let Some(link) = &self.link {
            let (number, gap) = (link.number.to_le_bytes(), [u8::from(link.gap)]);
            let fold: &[u8] = self.fold.as_ref().map_or(&[], |fold| fold.bytes());
            if let Some(root) = &self.root {
                let earlier = link.earlier.to_le_bytes();
                let linked = [number.as_slice(), link.previous.bytes(), &gap, &earlier, root.bytes(), fold];
                let wall_ms = self.wall_ms.map(i64::to_le_bytes);
                let (domain, timed): (&str, &[&[u8]]) = match &wall_ms {
                    None => (DOMAIN_TREE, &[]),
                    Some(wall_ms) => (DOMAIN_TIMED, &[wall_ms]),
                };
                return Digest::of_parts(domain, &[end.as_slice(), &linked, timed].concat());
            }
            let parts = [end[0], end[1], end[2], end[3], &number, link.previous.bytes(), &gap, fold];
            return Digest::of_parts(DOMAIN_LINKED, &parts);
        }
        match &self.fold {
            None => Digest::of_parts(DOMAIN, &end),
            Some(fold) => Digest::of_parts(DOMAIN_WITH_FOLD, &[end[0], end[1], end[2], end[3], fold.bytes()]),
        }
    }

    /// Its number, 0 for those of earlier versions.
    #[must_use]
    pub fn number(&self) -> u64 {
        self.link.as_ref().map_or(0, |link| link.number)
    }

    /// The digest for the next one's link: of all fields, the signature included.
    #[must_use]
    pub fn digest(&self) -> Digest {
        Digest::of_parts(DOMAIN_DIGEST, &[self.bytes().bytes(), self.signature.as_bytes()])
    }

    fn check_follows(&self, before: Option<&Self>) -> Result<(), String> {
        if self.root.is_none() && self.wall_ms.is_some() {
            return Err("it has a wall time, and no tree head with which it is signed".to_owned());
        }
        if self.root.is_none() && before.is_some_and(|before| before.root.is_some()) {
            return Err("it has no tree head, although the one before has".to_owned());
        }
        // No checkpoint follows the largest number.
        let last = before.is_some_and(|before| before.number() == u64::MAX);
        match &self.link {
            None => match before {
                Some(before) if before.link.is_some() => Err("it follows from no other".to_owned()),
                Some(_) | None => Ok(()),
            },
            Some(link) if link.gap || (!last && link.is_at(&CheckpointLink::after(before))) => Ok(()),
            Some(link) if link.number.saturating_sub(1) > before.map_or(0, Self::number) => {
                Err(format!("checkpoint number {}, which was before it, is missing", link.number - 1))
            }
            Some(link) => {
                Err(format!("checkpoint number {} does not follow from the one before", link.number))
            }
        }
    }

    /// Whether this key made the signature (strict ed25519).
    #[must_use]
    pub fn is_signed_by(&self, key: &VerifyingKey) -> bool {
        unhex::<64>(&self.signature).filter(|bytes| hex(bytes) == self.signature).is_some_and(|bytes| {
            key.verify_strict(self.bytes().bytes(), &Signature::from_bytes(&bytes)).is_ok()
        })
    }

    /// Whether this store made it, and this key signed it. Without a key, the signature is not checked.
    ///
    /// # Errors
    /// The problem.
    pub fn check_origin(&self, store_id: &str, key: Option<&VerifyingKey>) -> Result<(), String> {
        if self.store_id != store_id {
            return Err(format!("it belongs to the store {:?}", self.store_id));
        }
        if key.is_some_and(|key| !self.is_signed_by(key)) {
            return Err("its signature does not match the public key".to_owned());
        }
        Ok(())
    }

    /// Whether its tree head and its wall time, if it has them, are those of its record.
    ///
    /// # Errors
    /// The problem.
    pub fn check_record(&self, root: Option<Digest>, wall_ms: Option<i64>) -> Result<(), String> {
        if self.root.is_some() && self.root != root {
            return Err("its tree head is not the one of these records".to_owned());
        }
        if self.wall_ms.is_some() && self.wall_ms != wall_ms {
            return Err("its wall time is not the one of its record".to_owned());
        }
        Ok(())
    }

    /// Writes it beside the others and removes the oldest beyond the limit.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn write(&self, folder: &Path) -> Result<(), FileError> {
        let text =
            serde_json::to_string(self).map_err(|error| FileError::invalid("checkpoint", self.seq, error))?;
        write_atomically(&folder.join(name(self.seq)), text.as_bytes())?;
        let names = names(folder)?;
        for name in names.iter().take(names.len().saturating_sub(KEPT_MAX)) {
            let path = folder.join(name);
            fs::remove_file(&path).map_err(FileError::io("remove", &path))?;
        }
        Ok(())
    }

    /// Reads one file.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn read(path: &Path) -> Result<Self, String> {
        let found = fs::symlink_metadata(path).map_err(|error| error.to_string())?;
        if !found.is_file() || found.len() > FILE_BYTES_MAX {
            return Err(format!("it is not a file of at most {FILE_BYTES_MAX} bytes"));
        }
        let text = read_text(path, FILE_BYTES_MAX).map_err(|error| error.to_string())?;
        serde_json::from_str(&text).map_err(|error| error.to_string())
    }
}

/// A checkpoint and the name of its file.
#[derive(Clone, Debug)]
pub struct StoredCheckpoint {
    pub file: String,
    pub checkpoint: Checkpoint,
}

#[derive(Clone, Debug)]
pub struct BadCheckpointFile {
    pub file: String,
    pub problem: String,
}

impl BadCheckpointFile {
    pub(crate) fn at(path: &Path, problem: impl ToString) -> Self {
        Self { file: path.display().to_string(), problem: problem.to_string() }
    }
}

/// Reads all checkpoints, oldest first; a missing folder has none.
///
/// # Errors
/// The first bad one.
pub fn read_all(folder: &Path) -> Result<Vec<StoredCheckpoint>, BadCheckpointFile> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let listed = names(folder).map_err(|error| BadCheckpointFile::at(folder, error))?;
    let read = |file: String| match Checkpoint::read(&folder.join(&file)) {
        Ok(checkpoint) if name(checkpoint.seq) == file => Ok(StoredCheckpoint { file, checkpoint }),
        Ok(checkpoint) => {
            Err(BadCheckpointFile { problem: format!("it is of record {}", checkpoint.seq), file })
        }
        Err(problem) => Err(BadCheckpointFile { file, problem }),
    };
    listed.into_iter().map(read).collect()
}

/// Each is linked to the one before, from the last gap that a rebuild signed on; only those removed for age are
/// missing.
///
/// # Errors
/// The first that is not.
pub fn check_links(checkpoints: &[StoredCheckpoint]) -> Result<(), BadCheckpointFile> {
    let since =
        checkpoints.iter().rposition(|stored| stored.checkpoint.link.as_ref().is_some_and(|link| link.gap));
    let since = since.unwrap_or(0);
    for (index, StoredCheckpoint { file, checkpoint }) in checkpoints.iter().enumerate().skip(since) {
        if index == 0 && checkpoints.len() >= KEPT_MAX {
            continue;
        }
        let before = index.checked_sub(1).and_then(|before| checkpoints.get(before));
        checkpoint
            .check_follows(before.map(|before| &before.checkpoint))
            .map_err(|problem| BadCheckpointFile { file: file.clone(), problem })?;
    }
    let counted = checkpoints.iter().rev().find_map(|it| it.checkpoint.link.as_ref().map(|link| (it, link)));
    match counted {
        Some((newest, link)) => check_earlier(link, checkpoints)
            .map_err(|problem| BadCheckpointFile { file: newest.file.clone(), problem }),
        None => Ok(()),
    }
}

/// Number of unlinked checkpoints of earlier versions.
#[must_use]
pub fn count_earlier(checkpoints: &[StoredCheckpoint]) -> u64 {
    checkpoints.iter().filter(|stored| stored.checkpoint.link.is_none()).count() as u64
}

/// The counted checkpoints of earlier versions exist, except those removed for age.
fn check_earlier(link: &CheckpointLink, checkpoints: &[StoredCheckpoint]) -> Result<(), String> {
    let there = count_earlier(checkpoints);
    if link.gap || there >= link.earlier || checkpoints.len() >= KEPT_MAX {
        return Ok(());
    }
    Err(format!("there are {there} checkpoints of earlier versions; one is missing of {}", link.earlier))
}

/// The signed end in the database follows the newest checkpoint, or is the newest one.
///
/// # Errors
/// What is wrong with it.
pub fn check_newest(end: &Checkpoint, checkpoints: &[StoredCheckpoint]) -> Result<(), String> {
    let newest = checkpoints.last().map(|stored| &stored.checkpoint);
    match newest {
        Some(newest) if newest.link == end.link && (newest.seq, newest.head) == (end.seq, end.head) => Ok(()),
        Some(_) | None => end.check_follows(newest),
    }?;
    end.link.as_ref().map_or(Ok(()), |link| check_earlier(link, checkpoints))
}

/// The file name of a record's checkpoint.
#[must_use]
pub fn name(seq: u64) -> String {
    format!("{seq:012}.json")
}

/// Whether a file has the name of a checkpoint, to the letter.
fn is_name(file: &str) -> bool {
    file.strip_suffix(".json").and_then(|seq| seq.parse().ok()).is_some_and(|seq| name(seq) == file)
}

/// File names of all checkpoints, oldest first. Files under other names are ignored: neither counted, removed nor
/// expected.
///
/// # Errors
/// If the folder cannot be listed.
pub fn names(folder: &Path) -> Result<Vec<String>, FileError> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(FileError::io("list", folder))? {
        let name = entry.map_err(FileError::io("list", folder))?.file_name();
        if let Some(name) = name.to_str().filter(|name| is_name(name)) {
            names.push(name.to_owned());
        }
    }
    names.sort();
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chain(count: u64) -> Vec<StoredCheckpoint> {
        let key = SigningKey::from_bytes(&[7; 32]);
        let mut checkpoints: Vec<StoredCheckpoint> = Vec::new();
        for seq in 1..=count {
            let link = CheckpointLink::after(checkpoints.last().map(|stored| &stored.checkpoint));
            let head = Head { seq, hash: Digest::from_bytes([1; 32]), at_ms: seq };
            let checkpoint =
                Checkpoint::sign("a", (head, Digest::from_bytes([3; 32])), Some(5), link, None, &key);
            checkpoints.push(StoredCheckpoint { file: name(seq), checkpoint });
        }
        checkpoints
    }

    #[test]
    fn missing_checkpoint_is_found_unless_it_was_removed_by_age() {
        let checkpoints = chain(KEPT_MAX as u64 + 5);
        check_links(&checkpoints).unwrap();
        check_links(&checkpoints[5..]).unwrap();
        assert!(check_links(&checkpoints[6..]).unwrap_err().problem.contains("number 6,"));
        let mut without = checkpoints[5..].to_vec();
        without.remove(500);
        assert!(check_links(&without).is_err());
    }

    #[test]
    fn every_field_of_a_checkpoint_is_signed() {
        let key = SigningKey::from_bytes(&[7; 32]);
        let whole = chain(2).remove(1).checkpoint;
        let edits: [fn(&mut Checkpoint); 14] = [
            |c| c.store_id = "b".into(),
            |c| c.seq = 9,
            |c| c.at_ms = 9,
            |c| c.head = Digest::from_bytes([2; 32]),
            |c| c.fold = Some(Digest::from_bytes([2; 32])),
            |c| c.link = None,
            |c| c.link.as_mut().unwrap().number = 9,
            |c| c.link.as_mut().unwrap().gap = true,
            |c| c.link.as_mut().unwrap().earlier = 1,
            |c| c.link.as_mut().unwrap().previous = Digest::from_bytes([2; 32]),
            |c| c.root = Some(Digest::from_bytes([2; 32])),
            |c| c.root = None,
            |c| c.wall_ms = Some(4),
            |c| c.wall_ms = None,
        ];
        assert!(whole.is_signed_by(&key.verifying_key()));
        for (index, edit) in edits.into_iter().enumerate() {
            let mut edited = whole.clone();
            edit(&mut edited);
            assert!(!edited.is_signed_by(&key.verifying_key()), "edit {index}");
        }
        assert!(
            !Checkpoint { signature: whole.signature.to_uppercase(), ..whole }
                .is_signed_by(&key.verifying_key())
        );
    }
}
