//! Signed heads that were kept elsewhere. They reveal a store that was cut back, rewritten, or replaced by an earlier
//! copy.
//!
//! A copy is a checkpoint's file, a file of `store export` or `audit proof`, a database, or a folder: of checkpoints,
//! of a whole store, or of a witness. The store must have signed each head in it, and its chain must begin with it. The
//! caller reads databases: see [`ReadSignedEnd`].

use std::fs;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use ed25519_dalek::VerifyingKey;

use super::checkpoint::{BadCheckpointFile, Checkpoint, FILE_BYTES_MAX, names};
use super::export_line::{ExportLine, next_line};
use super::proof::Proof;
use holdpoint_governance::ids::Digest;
use holdpoint_text::file;

/// The most heads that are read from one folder or file; the newest count.
pub const HEADS_MAX: usize = 10_000;

/// A signed head and where it was found.
#[derive(Clone, Debug)]
pub struct HeadCopy {
    /// The file, with the line in one of several heads.
    pub file: String,
    pub checkpoint: Checkpoint,
}

/// Why a head that was kept elsewhere is not one of a chain.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HeadFault {
    #[error("{0}")]
    Unreadable(String),
    #[error("it belongs to the store {0:?}")]
    OtherStore(String),
    #[error("its signature does not match the store's public key")]
    NotSigned,
    /// All heads of this store at a witness have another signer.
    #[error("it is of this store, and signed with another key than the store has now")]
    OtherKey,
    #[error("it was signed at record {seq}, and the chain ends at record {end}: {} cut off", missing(*.seq, *.end))]
    CutOff { seq: u64, end: u64 },
    #[error("record {0}, which it was signed at, cannot be read")]
    RecordUnreadable(u64),
    #[error("record {0} is not the one that it was signed at: history was rewritten")]
    RecordRewritten(u64),
    #[error("the records up to {0} are not those that it was signed over: history was rewritten")]
    TreeRewritten(u64),
}

/// The number of records after `end`, with its verb.
fn missing(seq: u64, end: u64) -> String {
    match seq.saturating_sub(end) {
        1 => "1 record was".to_owned(),
        more => format!("{more} records were"),
    }
}

/// The chain's data at a record: its hash, and the root of the tree up to it if known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChainPoint {
    pub hash: Digest,
    /// The root of the tree up to it.
    pub root: Option<Digest>,
}

/// Reads the signed end of a database file, `None` if it has none.
pub type ReadSignedEnd<'a> = &'a dyn Fn(&Path) -> Result<Option<Checkpoint>, String>;

/// Reads every head of a file or folder. If a folder has none, reads those of this store below it: a witness has one
/// folder for each store.
///
/// # Errors
/// The first file that is bad, or that there is no head.
pub fn read_copies(
    path: &Path,
    store_id: &str,
    read_signed_end: ReadSignedEnd<'_>,
) -> Result<Vec<HeadCopy>, BadCheckpointFile> {
    let bad = |problem: &str| BadCheckpointFile::at(path, problem);
    let found = fs::metadata(path).map_err(|error| BadCheckpointFile::at(path, error))?;
    let copies = if found.is_dir() {
        let mut copies = Vec::new();
        for folder in [path.join("checkpoints"), path.to_owned(), path.join(store_id)] {
            if copies.is_empty() && folder.is_dir() {
                copies = read_folder(&folder)?;
            }
        }
        let database = path.join("holdpoint.db");
        if database.is_file() {
            copies.extend(read_database(&database, read_signed_end)?);
        }
        copies
    } else if found.is_file() {
        read_file(path, read_signed_end)?
    } else {
        return Err(bad("it is neither a file nor a folder"));
    };
    if copies.is_empty() {
        return Err(bad("it holds no signed head"));
    }
    Ok(copies)
}

/// The heads in the files of a folder, the newest up to the limit.
fn read_folder(folder: &Path) -> Result<Vec<HeadCopy>, BadCheckpointFile> {
    newest_files(folder)?.iter().map(|file| read_one(file)).collect()
}

fn newest_files(folder: &Path) -> Result<Vec<PathBuf>, BadCheckpointFile> {
    let listed = names(folder).map_err(|error| BadCheckpointFile::at(folder, error))?;
    let newest = listed.iter().skip(listed.len().saturating_sub(HEADS_MAX));
    Ok(newest.map(|name| folder.join(name)).collect())
}

/// The heads in the files of a witness, the newest up to the limit, and its files that are not heads.
///
/// # Errors
/// If the folder cannot be listed.
pub fn read_witness(folder: &Path) -> Result<(Vec<HeadCopy>, Vec<BadCheckpointFile>), BadCheckpointFile> {
    let (mut heads, mut strays) = (Vec::new(), Vec::new());
    for file in newest_files(folder)? {
        match read_one(&file) {
            Ok(head) => heads.push(head),
            Err(stray) => strays.push(stray),
        }
    }
    if heads.is_empty() {
        let problem = "it holds no signed head, although it got one when it was added";
        strays.push(BadCheckpointFile::at(folder, problem));
    }
    Ok((heads, strays))
}

fn read_one(path: &Path) -> Result<HeadCopy, BadCheckpointFile> {
    let file = path.display().to_string();
    match Checkpoint::read(path) {
        Ok(checkpoint) => Ok(HeadCopy { file, checkpoint }),
        Err(problem) => Err(BadCheckpointFile { file, problem }),
    }
}

fn read_database(
    path: &Path,
    read_signed_end: ReadSignedEnd<'_>,
) -> Result<Option<HeadCopy>, BadCheckpointFile> {
    let file = path.display().to_string();
    match read_signed_end(path) {
        Ok(end) => Ok(end.map(|checkpoint| HeadCopy { file, checkpoint })),
        Err(problem) => Err(BadCheckpointFile { file, problem }),
    }
}

fn read_file(path: &Path, read_signed_end: ReadSignedEnd<'_>) -> Result<Vec<HeadCopy>, BadCheckpointFile> {
    let mut start = [0; 16];
    let mut start_of = file::open(path).map_err(|error| BadCheckpointFile::at(path, error))?;
    if start_of.read_exact(&mut start).is_ok() && &start == b"SQLite format 3\0" {
        return read_database(path, read_signed_end).map(|copy| copy.into_iter().collect());
    }
    if fs::metadata(path).is_ok_and(|found| found.len() <= FILE_BYTES_MAX)
        && let Ok(copy) = read_one(path)
    {
        return Ok(vec![copy]);
    }
    if let Ok(proof) = Proof::read(path) {
        let held = |checkpoint| HeadCopy { file: path.display().to_string(), checkpoint };
        return Ok(proof.heads().into_iter().cloned().map(held).collect());
    }
    read_lines(path)
}

/// The heads in a file of JSON lines.
fn read_lines(path: &Path) -> Result<Vec<HeadCopy>, BadCheckpointFile> {
    let named = |number: usize| format!("{}:{number}", path.display());
    let bad = |number: usize, problem: String| BadCheckpointFile { file: named(number), problem };
    let mut reader = BufReader::new(file::open(path).map_err(|error| bad(1, error.to_string()))?);
    let mut copies = std::collections::VecDeque::new();
    for number in 1.. {
        let line = next_line(&mut reader).map_err(|problem| bad(number, problem))?;
        let Some(line) = line else { break };
        // Most lines are records; only head lines are read whole.
        if !line.starts_with(b"{\"head\":") && !line.starts_with(b"{\"end\":") && number > 1 {
            continue;
        }
        match ExportLine::parse(&line) {
            Ok(ExportLine::Head(checkpoint) | ExportLine::End(checkpoint)) => {
                copies.push_back(HeadCopy { file: named(number), checkpoint });
                if copies.len() > HEADS_MAX {
                    copies.pop_front();
                }
            }
            Ok(ExportLine::Export(_) | ExportLine::Record(_) | ExportLine::Approval(_)) => {}
            Err(_) if number == 1 => {
                let problem = "it is no checkpoint, proof, database or exported store";
                return Err(BadCheckpointFile::at(path, problem));
            }
            Err(problem) => return Err(bad(number, problem)),
        }
    }
    Ok(copies.into())
}

/// Whether this store signed a copy and its chain, which ends at record `end`, begins with it.
///
/// # Errors
/// [`HeadFault`].
pub fn check_copy(
    checkpoint: &Checkpoint,
    (store_id, key): (&str, Option<&VerifyingKey>),
    end: u64,
    chain_at: impl FnOnce(u64) -> Option<ChainPoint>,
) -> Result<(), HeadFault> {
    let seq = checkpoint.seq;
    if checkpoint.store_id != store_id {
        return Err(HeadFault::OtherStore(checkpoint.store_id.clone()));
    }
    if key.is_some_and(|key| !checkpoint.is_signed_by(key)) {
        return Err(HeadFault::NotSigned);
    }
    if seq > end {
        return Err(HeadFault::CutOff { seq, end });
    }
    if seq == 0 {
        return Ok(());
    }
    match chain_at(seq) {
        None => Err(HeadFault::RecordUnreadable(seq)),
        Some(at) if at.hash != checkpoint.head => Err(HeadFault::RecordRewritten(seq)),
        Some(ChainPoint { root: Some(root), .. }) if checkpoint.root.is_some_and(|signed| signed != root) => {
            Err(HeadFault::TreeRewritten(seq))
        }
        Some(_) => Ok(()),
    }
}
