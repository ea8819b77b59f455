//! Proofs from a store: that a record is in its chain, and that its chain continues an earlier one.

use std::borrow::Cow;
use std::path::Path;

use rusqlite::{Connection, OptionalExtension};

use crate::chain::audit;
use crate::chain::chain_signature;
use crate::database::migrate::STORE;
use crate::database::open::open_reader;
use crate::terms::sqlite_error::sqlite_error;
use holdpoint_audit::checkpoint::{Checkpoint, StoredCheckpoint, read_all};
use holdpoint_audit::proof::{Proof, ProofFault, SignedChain};
use holdpoint_governance::ids::Digest;
use holdpoint_store::StoreError;
use holdpoint_text::{ErrorDetails, Hint};

/// A proof that cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ProveError {
    #[error(transparent)]
    Unreadable(#[from] StoreError),
    /// No signed head proves it.
    #[error("there is no proof: {0}")]
    Impossible(#[from] ProofFault),
}

impl Hint for ProveError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Unreadable(error) => error.details(),
            Self::Impossible(fault) => fault.details(),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Unreadable(error) => error.hint(),
            Self::Impossible(fault) => fault.hint(),
        }
    }
}

/// One moment of a store: its newest signed head and the hashes of all records up to it.
fn signed_chain(database: &Path) -> Result<(Connection, SignedChain), ProveError> {
    let connection = open_reader(database, &STORE)?;
    let failed = sqlite_error("read the audit chain");
    connection.execute_batch("BEGIN").map_err(&failed)?;
    let Some(end) = chain_signature::read(&connection).map_err(ProofFault::Unsound)? else {
        return Err(ProofFault::EndWithoutTree.into());
    };
    let mut hashes = Vec::new();
    let mut read = || -> rusqlite::Result<()> {
        let mut select = connection.prepare("SELECT hash FROM audit WHERE seq <= ?1 ORDER BY seq")?;
        let mut rows = select.query([end.seq])?;
        while let Some(row) = rows.next()? {
            hashes.push(Digest::from_bytes(row.get(0)?));
        }
        Ok(())
    };
    read().map_err(&failed)?;
    let chain = SignedChain::new(end, hashes)?;
    Ok((connection, chain))
}

/// Proves that a record is in the signed chain of a store.
///
/// # Errors
/// [`ProveError`].
pub fn prove_record(database: &Path, seq: u64) -> Result<Proof, ProveError> {
    let (connection, chain) = signed_chain(database)?;
    let sql = format!("SELECT {} FROM audit WHERE seq = ?1", audit::COLUMNS);
    let record = connection.query_row(&sql, [seq], audit::read).optional();
    let Some(record) = record.map_err(sqlite_error("read the audit chain"))? else {
        return Err(ProofFault::NoRecord { seq, end: chain.end().seq }.into());
    };
    Ok(chain.prove_record(record)?)
}

/// Proves that the chain of a store continues an earlier signed head.
///
/// # Errors
/// [`ProveError`].
pub fn prove_consistency(database: &Path, older: &Checkpoint) -> Result<Proof, ProveError> {
    let (_, chain) = signed_chain(database)?;
    Ok(chain.prove_consistency(older)?)
}

/// A store's signed head at a record.
///
/// # Errors
/// [`ProveError::Impossible`] with the nearest heads that there are.
pub fn stored_head(folder: &Path, seq: u64) -> Result<Checkpoint, ProveError> {
    let checkpoints = read_all(&folder.join("checkpoints")).map_err(|bad| {
        ProofFault::Unsound(format!("the checkpoint {:?} is bad: {}", bad.file, bad.problem))
    })?;
    let seq_of = |stored: &StoredCheckpoint| stored.checkpoint.seq;
    if let Some(stored) = checkpoints.iter().find(|stored| seq_of(stored) == seq) {
        return Ok(stored.checkpoint.clone());
    }
    let before = checkpoints.iter().rev().map(seq_of).find(|head_seq| *head_seq < seq);
    let after = checkpoints.iter().map(seq_of).find(|head_seq| *head_seq > seq);
    let near = before.into_iter().chain(after).collect();
    Err(ProofFault::NoHead { seq, near }.into())
}
