//! Signed checkpoints: who holds one can tell that the chain up to it was not rewritten or cut off.
//!
//! Each is a small JSON file outside the database, `checkpoints/<seq>.json`, signed with the store's key. Copy them
//! away from the machine to bind also whoever holds that key.

use std::fs;
use std::path::Path;

use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};
use serde::{Deserialize, Serialize};

use super::audit::Head;
use super::error::StoreError;
use super::layout::write_atomically;
use holdpoint_approvals::keyfile::{hex, unhex};
use holdpoint_governance::ids::Digest;

/// Domain tag of a checkpoint's signature.
const DOMAIN: &str = "holdpoint/checkpoint/v1";
/// Domain tag of a checkpoint that binds a snapshot of the fold as well.
const DOMAIN_WITH_FOLD: &str = "holdpoint/checkpoint/v2";
/// Records between two checkpoints.
pub(crate) const EVERY_RECORDS: u64 = 256;
/// Checkpoints kept; older ones are removed.
const KEPT_MAX: usize = 1000;
/// The largest checkpoint file, bytes.
const FILE_BYTES_MAX: u64 = 4096;

/// The end of the chain at some moment, signed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Checkpoint {
    pub store_id: String,
    pub seq: u64,
    /// Its virtual time, ms.
    pub at_ms: u64,
    pub head: Digest,
    /// Digest of the snapshot of the fold that lies beside it, if one does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fold: Option<Digest>,
    /// ed25519 signature, 128 hexadecimal digits.
    pub signature: String,
}

impl Checkpoint {
    /// Signs the end of a chain.
    #[must_use]
    pub fn sign(store_id: &str, head: Head, fold: Option<Digest>, key: &SigningKey) -> Self {
        let mut checkpoint = Self {
            store_id: store_id.to_owned(),
            seq: head.seq,
            at_ms: head.at_ms,
            head: head.hash,
            fold,
            signature: String::new(),
        };
        checkpoint.signature = hex(&key.sign(checkpoint.bytes().bytes()).to_bytes());
        checkpoint
    }

    fn bytes(&self) -> Digest {
        let (seq, at_ms) = (self.seq.to_le_bytes(), self.at_ms.to_le_bytes());
        let end: [&[u8]; 4] = [self.store_id.as_bytes(), &seq, &at_ms, self.head.bytes()];
        match &self.fold {
            None => Digest::of_parts(DOMAIN, &end),
            Some(fold) => Digest::of_parts(DOMAIN_WITH_FOLD, &[end[0], end[1], end[2], end[3], fold.bytes()]),
        }
    }

    /// Whether this key made the signature (strict ed25519).
    #[must_use]
    pub fn is_signed_by(&self, key: &VerifyingKey) -> bool {
        unhex::<64>(&self.signature).is_some_and(|bytes| {
            key.verify_strict(self.bytes().bytes(), &Signature::from_bytes(&bytes)).is_ok()
        })
    }

    /// Writes it beside the others and removes the oldest beyond the limit.
    pub(crate) fn write(&self, folder: &Path) -> Result<(), StoreError> {
        let text = serde_json::to_string(self)
            .map_err(|error| StoreError::invalid("checkpoint", self.seq, error))?;
        write_atomically(&folder.join(name(self.seq)), text.as_bytes())?;
        let names = names(folder)?;
        for name in names.iter().take(names.len().saturating_sub(KEPT_MAX)) {
            let path = folder.join(name);
            fs::remove_file(&path).map_err(StoreError::io("remove", &path))?;
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
        let text = fs::read_to_string(path).map_err(|error| error.to_string())?;
        serde_json::from_str(&text).map_err(|error| error.to_string())
    }
}

/// The file name of a record's checkpoint.
pub(crate) fn name(seq: u64) -> String {
    format!("{seq:012}.json")
}

/// File names of all checkpoints, oldest first.
pub(crate) fn names(folder: &Path) -> Result<Vec<String>, StoreError> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(StoreError::io("list", folder))? {
        let name = entry.map_err(StoreError::io("list", folder))?.file_name();
        if let Some(name) = name.to_str().filter(|name| name.ends_with(".json")) {
            names.push(name.to_owned());
        }
    }
    names.sort();
    Ok(names)
}
