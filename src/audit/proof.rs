//! Proofs that need no store: that a record is in the chain, and that today's chain continues an earlier one.
//!
//! Each is one small JSON document with its signed heads, checked with the store's public key alone. See
//! [`merkle`] for the tree.

use std::borrow::Cow;
use std::path::Path;

use ed25519_dalek::VerifyingKey;
use serde::{Deserialize, Serialize};

use super::ascii_json::ascii_json;
use super::checkpoint::Checkpoint;
use super::merkle;
use super::store_id;
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_text::file::read_text;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// The version of the form.
const VERSION: u32 = 1;
/// The largest proof that is read, bytes: a record's body has at most 4 MiB, and each of its bytes six as an escape.
const BYTES_MAX: u64 = 32 << 20;

/// The hash of a record, and the fields that it covers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProvedRecord {
    /// Its number, from 1 on.
    pub seq: u64,
    /// Hash of the record before.
    pub prev: Digest,
    /// Its own hash.
    pub hash: Digest,
    /// Virtual time, ms.
    pub at_ms: u64,
    pub kind: Lenient<RecordKind>,
    pub subject: String,
    /// JSON text.
    pub body: String,
}

impl ProvedRecord {
    fn expected_hash(&self) -> Digest {
        let Self { seq, prev, hash, at_ms, kind, subject, body } = self.clone();
        AuditRecord { seq, prev, hash, at_ms, kind, subject, body, wall_ms: 0 }.expected_hash()
    }
}

impl From<AuditRecord> for ProvedRecord {
    fn from(record: AuditRecord) -> Self {
        let AuditRecord { seq, prev, hash, at_ms, kind, subject, body, wall_ms: _ } = record;
        Self { seq, prev, hash, at_ms, kind, subject, body }
    }
}

/// A proof with its heads.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "proof", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Proof {
    /// A record is in the chain that ends at a signed head.
    Inclusion {
        version: u32,
        record: ProvedRecord,
        /// Hashes from the record's leaf to the root.
        path: Vec<Digest>,
        head: Box<Checkpoint>,
    },
    /// The chain that ends at a signed head begins with the one that ends at an earlier head.
    Consistency {
        version: u32,
        older: Box<Checkpoint>,
        /// Hashes as RFC 9162, 2.1.4.1, lists them.
        path: Vec<Digest>,
        newer: Box<Checkpoint>,
    },
}

/// A file that is no proof, or a proof that is invalid.
#[derive(Debug, thiserror::Error)]
pub enum ProofError {
    #[error("{0}")]
    NoProof(String),
    #[error("the proof does not hold: {0}")]
    Wrong(String),
}

impl Hint for ProofError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(ErrorReason::BadFile.into())
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        None
    }
}

/// Why no signed head proves it; each has its remedy as a hint.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ProofFault {
    #[error("{0}")]
    Unsound(String),
    #[error("an earlier version signed the end of the audit chain, without a tree")]
    EndWithoutTree,
    #[error("an earlier version signed that head, without a tree")]
    HeadWithoutTree,
    #[error("there is no record {seq}; the chain ends at record {end}")]
    NoRecord { seq: u64, end: u64 },
    #[error("no checkpoint was made at record {seq} ({})", nearest(.near))]
    NoHead { seq: u64, near: Vec<u64> },
    #[error("that head belongs to the store {0:?}")]
    OtherStore(String),
    #[error("that head was signed at record {seq}, and the chain ends at record {end}: it was cut off")]
    CutOff { seq: u64, end: u64 },
    #[error("nothing follows from the tree of no records")]
    NoRecords,
    #[error("that head is not one of this chain: history was rewritten")]
    Rewritten,
}

impl Hint for ProofFault {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::NoRecord { .. } | Self::NoHead { .. } => ErrorReason::NotFound.into(),
            Self::OtherStore(_) => ErrorReason::BadFile.into(),
            Self::Unsound(_)
            | Self::EndWithoutTree
            | Self::HeadWithoutTree
            | Self::CutOff { .. }
            | Self::NoRecords
            | Self::Rewritten => ErrorReason::StoreRefused.into(),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        let remedy = match self {
            Self::Unsound(_) => "`holdpoint audit verify` says what is wrong with the store",
            Self::EndWithoutTree => "start an engine on the store once: it signs the tree of its records",
            Self::HeadWithoutTree => "`holdpoint audit verify --against FILE` compares the chain with it",
            Self::NoRecord { .. } => "`holdpoint audit list` lists the records",
            Self::NoHead { .. } => "`--against FILE` takes one that was kept elsewhere",
            Self::OtherStore(_) => "name the other store with `--data`",
            Self::CutOff { .. } | Self::NoRecords | Self::Rewritten => {
                "`holdpoint audit verify --against FILE` says more"
            }
        };
        Some(remedy.into())
    }
}

/// The records of the nearest heads.
fn nearest(near: &[u64]) -> String {
    if near.is_empty() {
        return "there is none".to_owned();
    }
    let near: Vec<String> = near.iter().map(u64::to_string).collect();
    format!("the nearest: {}", near.join(", "))
}

fn unsound(problem: impl Into<String>) -> ProofFault {
    ProofFault::Unsound(problem.into())
}

/// The hashes of all records up to a signed head, from which proofs are made.
#[derive(Clone, Debug)]
pub struct SignedChain {
    end: Checkpoint,
    hashes: Vec<Digest>,
}

impl SignedChain {
    /// The chain that ends at this head, with the hash of each record from the first one on.
    ///
    /// # Errors
    /// [`ProofFault::EndWithoutTree`], and [`ProofFault::Unsound`] if the head was signed over other records.
    pub fn new(end: Checkpoint, hashes: Vec<Digest>) -> Result<Self, ProofFault> {
        if end.root.is_none() {
            return Err(ProofFault::EndWithoutTree);
        }
        if hashes.len() as u64 != end.seq || end.root != Some(merkle::root(&hashes)) {
            return Err(unsound("the records are not those whose tree was signed"));
        }
        Ok(Self { end, hashes })
    }

    /// The head at which it ends.
    #[must_use]
    pub const fn end(&self) -> &Checkpoint {
        &self.end
    }

    /// Proves that a record is in the chain.
    ///
    /// # Errors
    /// [`ProofFault`].
    pub fn prove_record(self, record: AuditRecord) -> Result<Proof, ProofFault> {
        let seq = record.seq;
        let index = seq.checked_sub(1).and_then(|index| usize::try_from(index).ok());
        let path = index.and_then(|index| merkle::inclusion(&self.hashes, index));
        let Some(path) = path else {
            return Err(ProofFault::NoRecord { seq, end: self.end.seq });
        };
        let head = Box::new(self.end);
        let proof = Proof::Inclusion { version: VERSION, record: record.into(), path, head };
        proof.check_tree().map_err(unsound)?;
        Ok(proof)
    }

    /// Proves that the chain continues an earlier signed head.
    ///
    /// # Errors
    /// [`ProofFault`].
    pub fn prove_consistency(self, older: &Checkpoint) -> Result<Proof, ProofFault> {
        if older.root.is_none() {
            return Err(ProofFault::HeadWithoutTree);
        }
        if older.store_id != self.end.store_id {
            return Err(ProofFault::OtherStore(older.store_id.clone()));
        }
        if older.seq > self.end.seq {
            return Err(ProofFault::CutOff { seq: older.seq, end: self.end.seq });
        }
        let size = usize::try_from(older.seq).unwrap_or(usize::MAX);
        let Some(path) = merkle::consistency(&self.hashes, size) else {
            return Err(ProofFault::NoRecords);
        };
        let (older, newer) = (Box::new(older.clone()), Box::new(self.end));
        let proof = Proof::Consistency { version: VERSION, older, path, newer };
        proof.check_tree().map_err(|_| ProofFault::Rewritten)?;
        Ok(proof)
    }
}

impl Proof {
    /// Reads a proof from its file; the file must have exactly the bytes that were written.
    ///
    /// # Errors
    /// [`ProofError::NoProof`].
    pub fn read(path: &Path) -> Result<Self, ProofError> {
        let no_proof = |problem: &str| ProofError::NoProof(format!("{path:?} is not a proof: {problem}"));
        let text = read_text(path, BYTES_MAX).map_err(|error| no_proof(&error.to_string()))?;
        let line = text.strip_suffix('\n').ok_or_else(|| no_proof("it does not end with a line feed"))?;
        Self::parse(line).map_err(|problem| no_proof(&problem))
    }

    /// Reads a proof from its text, one line without its end.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let proof: Self = serde_json::from_str(text).map_err(|error| error.to_string())?;
        if proof.text().map_err(|error| error.to_string())? != text {
            return Err("it is not as it was written".to_owned());
        }
        Ok(proof)
    }

    /// Its text, one line without its end.
    ///
    /// # Errors
    /// If it has no JSON form.
    pub fn text(&self) -> Result<String, serde_json::Error> {
        ascii_json(self)
    }

    /// The signed heads in it.
    #[must_use]
    pub fn heads(&self) -> Vec<&Checkpoint> {
        match self {
            Self::Inclusion { head, .. } => vec![head],
            Self::Consistency { older, newer, .. } => vec![older, newer],
        }
    }

    /// Checks the proof, and that this key signed its heads.
    ///
    /// # Errors
    /// [`ProofError::Wrong`].
    pub fn check(&self, key: &VerifyingKey) -> Result<(), ProofError> {
        for head in self.heads() {
            store_id::check_key(&head.store_id, key).map_err(ProofError::Wrong)?;
            if !head.is_signed_by(key) {
                let problem = format!("the head at record {} is not signed with this key", head.seq);
                return Err(ProofError::Wrong(problem));
            }
        }
        self.check_tree().map_err(ProofError::Wrong)
    }

    fn check_tree(&self) -> Result<(), String> {
        let tree_of = |head: &Checkpoint| -> Result<(u64, Digest), String> {
            let root = head.root.ok_or_else(|| format!("the head at record {} has no tree", head.seq))?;
            Ok((head.seq, root))
        };
        match self {
            Self::Inclusion { version, record, path, head } => {
                check_version(*version)?;
                if record.hash != record.expected_hash() {
                    return Err("the record's content does not match its hash".to_owned());
                }
                let (size, root) = tree_of(head)?;
                let index = record.seq.checked_sub(1).ok_or("records begin with 1")?;
                if !merkle::includes(&record.hash, index, (size, &root), path) {
                    return Err(format!("record {} is not shown to be below the signed head", record.seq));
                }
                Ok(())
            }
            Self::Consistency { version, older, path, newer } => {
                check_version(*version)?;
                if older.store_id != newer.store_id {
                    return Err("the heads are of two stores".to_owned());
                }
                let ((size, root), (later_size, later_root)) = (tree_of(older)?, tree_of(newer)?);
                // Two heads at one record must be the same head.
                let heads_agree = older.seq != newer.seq || older.head == newer.head;
                if !heads_agree || !merkle::begins((size, &root), (later_size, &later_root), path) {
                    return Err("the newer head is not shown to go on from the older one".to_owned());
                }
                Ok(())
            }
        }
    }
}

fn check_version(version: u32) -> Result<(), String> {
    if version == VERSION {
        return Ok(());
    }
    Err(format!("it is of version {version}; this program reads version {VERSION}"))
}
