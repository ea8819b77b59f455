//! Witnesses: folders elsewhere that get every new checkpoint, so that the next start detects a store that was cut back
//! or restored from an older copy.
//!
//! Only the chain's records name the folders: the store reads them, and sends its heads. A witness has one folder for
//! each store, made when the witness is added and never again: if a mount is missing, nothing is written under its mount
//! point. Each has its own thread and a bounded queue, because a network folder may hang.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use ed25519_dalek::VerifyingKey;

use super::checkpoint::{self, Checkpoint};
use super::files::{FileError, sync_folder, write_atomically};
use super::head_copies::{ChainPoint, HEADS_MAX, HeadFault, check_copy};
use holdpoint_governance::ids::is_name;

pub const WITNESSES_MAX: usize = 8;
/// The most pending heads of one witness. A head stands for all before it, so that skipping one loses nothing.
const QUEUE_MAX: usize = 64;
/// A head that is pending longer is reported.
const SLOW: Duration = Duration::from_secs(30);
/// How long an end waits for heads on their way to a witness.
const END_WAIT: Duration = Duration::from_secs(3);
/// How long a start waits for a witness's head.
const READ_WAIT: Duration = Duration::from_secs(10);
/// Files of a witness that a start reads until one is a head signed by the store.
const LOOKED_AT_MAX: usize = HEADS_MAX;
const PATH_BYTES_MAX: usize = 1024;

/// Witnesses that cannot be written or read at present, each with the reason.
#[derive(Clone, Debug, Default)]
pub struct WitnessProblems(Arc<Mutex<UnreachableWitnesses>>);

#[derive(Debug, Default)]
struct UnreachableWitnesses {
    /// Those that the start could not read. A later write does not make up for the missing head.
    unheard: BTreeMap<String, String>,
    /// Those that did not accept the last head.
    unwritten: BTreeMap<String, String>,
    /// Those of `unheard` that no record names yet: a new head there would hide the missing one.
    untold: BTreeSet<String>,
}

impl WitnessProblems {
    fn locked(&self) -> MutexGuard<'_, UnreachableWitnesses> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn record_unreachable(&self, folder: &str, problem: String) {
        let mut silent = self.locked();
        silent.unheard.insert(folder.to_owned(), problem);
        silent.untold.insert(folder.to_owned());
    }

    fn set(&self, folder: &str, problem: Option<String>) {
        match problem {
            Some(problem) => drop(self.locked().unwritten.insert(folder.to_owned(), problem)),
            None => drop(self.locked().unwritten.remove(folder)),
        }
    }

    fn forget(&self, folder: &str) {
        self.set(folder, None);
        let mut silent = self.locked();
        silent.unheard.remove(folder);
        silent.untold.remove(folder);
    }

    /// The start's findings are on record: from now on all witnesses get heads.
    pub fn mark_reported(&self) {
        self.locked().untold.clear();
    }

    fn is_unreported(&self, folder: &str) -> bool {
        self.locked().untold.contains(folder)
    }

    /// All of them, in the order of the folders.
    #[must_use]
    pub fn all(&self) -> Vec<String> {
        let silent = self.locked();
        let found = silent.unwritten.iter().chain(&silent.unheard);
        found.map(|(folder, problem)| format!("the witness {folder:?}: {problem}")).collect()
    }
}

/// A witness's folder for the heads of one store.
#[must_use]
pub fn folder_of(witness: &str, store_id: &str) -> PathBuf {
    Path::new(witness).join(store_id)
}

/// The path of a witness in its record's form.
///
/// # Errors
/// If it is not an absolute path, or is an address.
pub fn check_path(path: &str) -> Result<(), FileError> {
    let bad = |allowed: &str| Err(FileError::invalid("witness", path, allowed));
    let address = path.contains("://") || (path.contains('@') && path.contains(':'));
    if address {
        return bad(
            "a folder; this program uses no network, so name one that other software synchronizes (a mount of NFS or \
            sshfs, a clone that git pushes, a synchronized folder)",
        );
    }
    if !Path::new(path).is_absolute() || path.len() > PATH_BYTES_MAX || path.chars().any(char::is_control) {
        return bad("an absolute path of at most 1024 bytes without control characters");
    }
    Ok(())
}

/// Makes a store's folder in a witness and puts its newest head there.
///
/// # Errors
/// If it cannot be written.
pub fn prepare(witness: &str, head: &Checkpoint) -> Result<(), FileError> {
    let root = Path::new(witness);
    if !root.is_dir() {
        return Err(FileError::invalid("witness", witness, "a folder that is there"));
    }
    if !is_name(&head.store_id) {
        return Err(FileError::invalid("store id", &head.store_id, "a name: a-z, 0-9, '.', '_', '-'"));
    }
    let folder = folder_of(witness, &head.store_id);
    if !folder.is_dir() {
        fs::create_dir(&folder).map_err(FileError::io("make the folder of a witness", &folder))?;
        sync_folder(root)?;
    }
    put(&folder, head)
}

fn put(folder: &Path, head: &Checkpoint) -> Result<(), FileError> {
    let text =
        serde_json::to_string(head).map_err(|error| FileError::invalid("checkpoint", head.seq, error))?;
    let path = folder.join(checkpoint::name(head.seq));
    // An existing head is never replaced by a different one.
    if let Ok(there) = Checkpoint::read(&path)
        && there.store_id == head.store_id
        && there.head != head.head
    {
        return Err(FileError::invalid("head of a witness", path.display(), "the head that it got before"));
    }
    write_atomically(&path, text.as_bytes())
}

/// Whether a witness accepts heads of a store; reads only.
///
/// # Errors
/// What is wrong with it.
pub fn check_witness(witness: &str, store_id: &str) -> Result<u64, String> {
    let folder = folder_of(witness, store_id);
    let names = checkpoint::names(&folder).map_err(|error| described(&error, &folder))?;
    let access = rustix::fs::Access::WRITE_OK | rustix::fs::Access::EXEC_OK;
    rustix::fs::access(&folder, access).map_err(|error| format!("it cannot be written: {error}"))?;
    Ok(names.len() as u64)
}

/// As [`check_witness`]; a witness without a head is a problem, too, because it got one when it was added.
///
/// # Errors
/// What is wrong with it.
pub fn witness_heads(witness: &str, store_id: &str) -> Result<u64, String> {
    match check_witness(witness, store_id)? {
        0 => Err("0 heads: emptied? It got a head when it was added".to_owned()),
        heads => Ok(heads),
    }
}

/// Sends heads to every witness.
#[derive(Debug, Default)]
pub struct WitnessSenders {
    threads: Vec<WitnessSender>,
    problems: WitnessProblems,
}

#[derive(Debug)]
struct WitnessSender {
    witness: String,
    heads: SyncSender<Checkpoint>,
    ended: Receiver<()>,
    /// When the oldest pending head was sent, if there is one.
    waits: Arc<Mutex<Option<Instant>>>,
}

impl WitnessSenders {
    /// Sends to no folder yet; failures become these problems.
    #[must_use]
    pub fn new(problems: WitnessProblems) -> Self {
        Self { threads: Vec::new(), problems }
    }

    /// Sends to these folders from now on, and to no others.
    pub fn set<'a>(&mut self, witnesses: impl Iterator<Item = &'a String>, store_id: &str) {
        let wanted: Vec<&String> = witnesses.collect();
        let (retained, removed) = std::mem::take(&mut self.threads)
            .into_iter()
            .partition(|it: &WitnessSender| wanted.contains(&&it.witness));
        self.threads = retained;
        for sender in removed {
            let witness = sender.witness.clone();
            end(sender);
            self.problems.forget(&witness);
        }
        for witness in wanted {
            if self.threads.iter().any(|it| it.witness == *witness) {
                continue;
            }
            match start(witness, store_id, self.problems.clone()) {
                Ok(sender) => self.threads.push(sender),
                Err(error) => self.problems.set(witness, Some(error.to_string())),
            }
        }
    }

    /// Sends a head; never waits. If the start found something missing, only after that is on record.
    pub fn send(&self, head: &Checkpoint) {
        for sender in self.threads.iter().filter(|sender| !self.problems.is_unreported(&sender.witness)) {
            let since =
                *sender.waits.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(Instant::now);
            let problem = match sender.heads.try_send(head.clone()) {
                Ok(()) if since.elapsed() < SLOW => continue,
                Ok(()) => format!("it has accepted no head for {} s", since.elapsed().as_secs()),
                Err(TrySendError::Full(_)) => {
                    format!(
                        "it has not taken the last {QUEUE_MAX} heads; whatever it is mounted from may hang"
                    )
                }
                Err(TrySendError::Disconnected(_)) => "its sender has ended".to_owned(),
            };
            self.problems.set(&sender.witness, Some(problem));
        }
    }
}

impl Drop for WitnessSenders {
    fn drop(&mut self) {
        self.threads.drain(..).for_each(end);
    }
}

/// Lets a sender finish. A hanging one is abandoned: it ends with the process.
fn end(sender: WitnessSender) {
    drop(sender.heads);
    match sender.ended.recv_timeout(END_WAIT) {
        Ok(()) | Err(RecvTimeoutError::Disconnected | RecvTimeoutError::Timeout) => {}
    }
}

fn start(witness: &str, store_id: &str, problems: WitnessProblems) -> std::io::Result<WitnessSender> {
    let (heads, incoming) = sync_channel::<Checkpoint>(QUEUE_MAX);
    let (done, ended) = sync_channel(1);
    let (name, folder) = (witness.to_owned(), folder_of(witness, store_id));
    let waits = Arc::new(Mutex::new(None));
    let waits_there = Arc::clone(&waits);
    thread::Builder::new().name("witness".to_owned()).spawn(move || {
        while let Ok(mut head) = incoming.recv() {
            // The newest pending head stands for the others; each gets its file if there is time.
            let mut waiting = vec![];
            while let Ok(next) = incoming.try_recv() {
                waiting.push(std::mem::replace(&mut head, next));
            }
            let written =
                put(&folder, &head).and_then(|()| waiting.iter().try_for_each(|it| put(&folder, it)));
            *waits_there.lock().unwrap_or_else(PoisonError::into_inner) = None;
            problems.set(&name, written.err().map(|error| described(&error, &folder)));
        }
        // The caller may have stopped waiting.
        let _ = done.send(());
    })?;
    Ok(WitnessSender { witness: witness.to_owned(), heads, ended, waits })
}

fn described(error: &FileError, folder: &Path) -> String {
    if folder.is_dir() {
        return error.to_string();
    }
    format!("{error}; the folder of this store is not there: what it is mounted from may be gone")
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum WitnessFinding {
    /// The newest head there is of this chain.
    Agrees,
    /// It cannot be read.
    Silent(String),
    /// The store signed a head that is not of this chain.
    Contradicts { file: String, fault: HeadFault },
}

/// Reads the newest head that this store signed from a witness.
fn compare_witness(
    witness: &str,
    (store_id, key): (&str, &VerifyingKey),
    end: u64,
    chain_at: impl FnOnce(u64) -> Option<ChainPoint>,
) -> WitnessFinding {
    let (answer, newest) = sync_channel(1);
    let (folder, key_there, id) = (folder_of(witness, store_id), *key, store_id.to_owned());
    let reader = thread::Builder::new().name("witness".to_owned()).spawn(move || {
        // The start no longer waits for it.
        let _ = answer.send(newest_signed(&folder, &id, &key_there));
    });
    let found = match reader {
        Ok(_) => newest.recv_timeout(READ_WAIT),
        Err(error) => return WitnessFinding::Silent(error.to_string()),
    };
    match found {
        Err(_) => WitnessFinding::Silent(format!("it did not answer within {} s", READ_WAIT.as_secs())),
        Ok(Err(WitnessFailure::Unreadable(problem))) => WitnessFinding::Silent(problem),
        Ok(Err(WitnessFailure::OtherKey(file))) => {
            WitnessFinding::Contradicts { file, fault: HeadFault::OtherKey }
        }
        Ok(Ok((file, head))) => match check_copy(&head, (store_id, Some(key)), end, chain_at) {
            Ok(()) => WitnessFinding::Agrees,
            Err(fault) => WitnessFinding::Contradicts { file, fault },
        },
    }
}

/// Why a witness has no head of a chain.
enum WitnessFailure {
    Unreadable(String),
    /// Another key signed all its files of this store: the first such file.
    OtherKey(String),
}

/// The newest head in a folder that this store signed; other files prove nothing and are skipped.
fn newest_signed(
    folder: &Path,
    store_id: &str,
    key: &VerifyingKey,
) -> Result<(String, Checkpoint), WitnessFailure> {
    let names = checkpoint::names(folder).map_err(|error| WitnessFailure::Unreadable(error.to_string()))?;
    let mut other = None;
    for name in names.iter().rev().take(LOOKED_AT_MAX) {
        let path = folder.join(name);
        if let Ok(head) = Checkpoint::read(&path)
            && head.store_id == store_id
        {
            if head.is_signed_by(key) {
                return Ok((path.display().to_string(), head));
            }
            other.get_or_insert_with(|| path.display().to_string());
        }
    }
    Err(match other {
        Some(file) => WitnessFailure::OtherKey(file),
        // Adding a witness writes the first head there, before the addition is on record.
        None if names.is_empty() => WitnessFailure::Unreadable(
            "it is empty, although it got a head when it was added: its files are lost".to_owned(),
        ),
        None => WitnessFailure::Unreadable("this store signed none of its newest files".to_owned()),
    })
}

/// Reads every witness, and notes the silent ones.
///
/// # Errors
/// The first that contradicts the chain.
pub fn compare_witnesses<'a>(
    witnesses: impl Iterator<Item = &'a String>,
    by: (&str, &VerifyingKey),
    end: u64,
    chain_at: impl Fn(u64) -> Option<ChainPoint>,
    problems: &WitnessProblems,
) -> Result<(), (String, HeadFault)> {
    for witness in witnesses {
        match compare_witness(witness, by, end, &chain_at) {
            WitnessFinding::Agrees => {}
            WitnessFinding::Silent(problem) => problems.record_unreachable(witness, problem),
            WitnessFinding::Contradicts { file, fault } => return Err((file, fault)),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::ids::Digest;

    #[test]
    fn witness_file_is_written_once_and_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let head = |text: &str| Checkpoint {
            store_id: "a".repeat(32),
            seq: 7,
            at_ms: 0,
            head: Digest::of_parts("test", &[text.as_bytes()]),
            fold: None,
            link: None,
            wall_ms: None,
            root: None,
            signature: "0".repeat(128),
        };
        put(folder.path(), &head("one")).unwrap();
        let path = folder.path().join(checkpoint::name(7));
        let testimony = fs::read(&path).unwrap();
        put(folder.path(), &head("one")).unwrap();
        let error = put(folder.path(), &head("other")).unwrap_err();
        let there = path.display().to_string();
        assert!(matches!(&error, FileError::Invalid { value, .. } if *value == there), "{error}");
        assert_eq!(fs::read(&path).unwrap(), testimony);
        // Nothing is written through a planted link in place of the file.
        let elsewhere = folder.path().join("elsewhere");
        fs::write(&elsewhere, "mine").unwrap();
        std::os::unix::fs::symlink(&elsewhere, path.with_extension("part")).unwrap();
        put(folder.path(), &head("one")).unwrap();
        assert_eq!(fs::read_to_string(&elsewhere).unwrap(), "mine");
    }
}
