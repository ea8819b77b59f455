//! Witnesses: folders elsewhere that get every new checkpoint, so that a store that is cut back or put back to an earlier
//! state is found by its next start.
//!
//! Which folders they are is on record in the chain, and nowhere else. A witness has one folder for each store, which is
//! made when the witness is added and never again: where a mount is gone, nothing is written under its mount point. Each
//! is written by a thread of its own with a bounded queue, for a network folder may hang.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use ed25519_dalek::VerifyingKey;
use serde::Deserialize;

use super::change::Change;
use super::checkpoint::{self, Checkpoint};
use super::copies::{ChainAt, HEADS_MAX, check_copy};
use super::error::StoreError;
use super::layout::{sync_folder, write_atomically};
use super::migrate::STORE;
use super::open::open_reader;
use holdpoint_governance::ids::is_name;
use holdpoint_governance::record::RecordKind;

/// The most witnesses of one store.
pub const WITNESSES_MAX: usize = 8;
/// Heads that may wait for one witness. A head stands for all before it, so that one left off is no loss.
const QUEUE_MAX: usize = 64;
/// A head that waits longer for its witness is told.
const SLOW: Duration = Duration::from_secs(30);
/// How long an end waits for heads that are still on their way to a witness.
const END_WAIT: Duration = Duration::from_secs(3);
/// How long a start waits for what a witness has.
const READ_WAIT: Duration = Duration::from_secs(10);
/// Files of a witness that a start looks at until one is a head that the store signed.
const LOOKED_AT_MAX: usize = HEADS_MAX;
/// The longest path, bytes.
const PATH_BYTES_MAX: usize = 1024;

/// The witnesses that cannot be written or read at present, each with why.
#[derive(Clone, Debug, Default)]
pub(crate) struct Problems(Arc<Mutex<Silent>>);

#[derive(Debug, Default)]
struct Silent {
    /// Those that the start could not ask. That a head is written there later does not make up for what it did not say.
    unheard: BTreeMap<String, String>,
    /// Those that did not take the last head.
    unwritten: BTreeMap<String, String>,
    /// Those of `unheard` that nobody was told of yet: a head that is sent there would hide what is missing.
    untold: BTreeSet<String>,
}

impl Problems {
    fn locked(&self) -> MutexGuard<'_, Silent> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn unheard(&self, folder: &str, problem: String) {
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

    /// What the start found is on record: from now on all of them get heads.
    pub(crate) fn told(&self) {
        self.locked().untold.clear();
    }

    fn is_untold(&self, folder: &str) -> bool {
        self.locked().untold.contains(folder)
    }

    /// All of them, in the order of the folders.
    pub(crate) fn all(&self) -> Vec<String> {
        let silent = self.locked();
        let found = silent.unwritten.iter().chain(&silent.unheard);
        found.map(|(folder, problem)| format!("the witness {folder:?}: {problem}")).collect()
    }
}

/// Where a witness keeps the heads of one store.
pub(crate) fn folder_of(witness: &str, store_id: &str) -> PathBuf {
    Path::new(witness).join(store_id)
}

/// The path of a witness as it goes on record.
///
/// # Errors
/// If it is no absolute path, or an address.
pub(crate) fn check_path(path: &str) -> Result<(), StoreError> {
    let bad = |allowed: &str| Err(StoreError::invalid("witness", path, allowed));
    let address = path.contains("://") || (path.contains('@') && path.contains(':'));
    if address {
        return bad(
            "a folder; this program speaks to no network, so name one that something else carries there (a mount of \
             NFS or sshfs, a clone that git pushes, a synchronised folder)",
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
pub(crate) fn prepare(witness: &str, head: &Checkpoint) -> Result<(), StoreError> {
    let root = Path::new(witness);
    if !root.is_dir() {
        return Err(StoreError::invalid("witness", witness, "a folder that is there"));
    }
    if !is_name(&head.store_id) {
        return Err(StoreError::invalid("store id", &head.store_id, "a name: a-z, 0-9, '.', '_', '-'"));
    }
    let folder = folder_of(witness, &head.store_id);
    if !folder.is_dir() {
        fs::create_dir(&folder).map_err(StoreError::io("make the folder of a witness", &folder))?;
        sync_folder(root)?;
    }
    put(&folder, head)
}

fn put(folder: &Path, head: &Checkpoint) -> Result<(), StoreError> {
    let text =
        serde_json::to_string(head).map_err(|error| StoreError::invalid("checkpoint", head.seq, error))?;
    let path = folder.join(checkpoint::name(head.seq));
    // A testimony is never replaced by one that says otherwise.
    if let Ok(there) = Checkpoint::read(&path)
        && there.store_id == head.store_id
        && there.head != head.head
    {
        return Err(StoreError::invalid("head of a witness", path.display(), "the head that it got before"));
    }
    write_atomically(&path, text.as_bytes())
}

/// The folders that get every checkpoint of a store, as its records say.
///
/// # Errors
/// If the store cannot be read.
pub fn witnesses(database: &Path) -> Result<BTreeSet<String>, StoreError> {
    #[derive(Deserialize)]
    struct WitnessOnRecord {
        change: Change,
    }
    let error = StoreError::sql("read the audit chain");
    let connection = open_reader(database, &STORE)?;
    let mut select =
        connection.prepare("SELECT seq, body FROM audit WHERE kind = ?1 ORDER BY seq").map_err(&error)?;
    let mut rows = select.query([RecordKind::WitnessSet.name()]).map_err(&error)?;
    let mut found = BTreeSet::new();
    while let Some(row) = rows.next().map_err(&error)? {
        let (seq, body): (u64, String) = (row.get(0).map_err(&error)?, row.get(1).map_err(&error)?);
        let read: WitnessOnRecord =
            serde_json::from_str(&body).map_err(|it| StoreError::invalid("audit record", seq, it))?;
        if let Change::SetWitness { folder, present, .. } = read.change {
            if present {
                found.insert(folder);
            } else {
                found.remove(&folder);
            }
        }
    }
    Ok(found)
}

/// Whether a witness takes heads of a store; looks, and writes nothing.
///
/// # Errors
/// What is wrong with it.
pub fn look_at_witness(witness: &str, store_id: &str) -> Result<u64, String> {
    let folder = folder_of(witness, store_id);
    let names = checkpoint::names(&folder).map_err(|error| described(&error, &folder))?;
    let access = rustix::fs::Access::WRITE_OK | rustix::fs::Access::EXEC_OK;
    rustix::fs::access(&folder, access).map_err(|error| format!("it cannot be written: {error}"))?;
    Ok(names.len() as u64)
}

/// Sends heads to every witness.
#[derive(Debug, Default)]
pub(crate) struct Senders {
    threads: Vec<Sender>,
    problems: Problems,
}

#[derive(Debug)]
struct Sender {
    witness: String,
    heads: SyncSender<Checkpoint>,
    ended: Receiver<()>,
    /// Since when a head waits, if one does.
    waits: Arc<Mutex<Option<Instant>>>,
}

impl Senders {
    pub(crate) fn new(problems: Problems) -> Self {
        Self { threads: Vec::new(), problems }
    }

    /// Sends to these folders from now on, and to no others.
    pub(crate) fn set<'a>(&mut self, witnesses: impl Iterator<Item = &'a String>, store_id: &str) {
        let wanted: Vec<&String> = witnesses.collect();
        let (kept, gone) = std::mem::take(&mut self.threads)
            .into_iter()
            .partition(|it: &Sender| wanted.contains(&&it.witness));
        self.threads = kept;
        for sender in gone {
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

    /// Sends a head; never waits. Where the start found something missing, only once that is on record.
    pub(crate) fn send(&self, head: &Checkpoint) {
        for sender in self.threads.iter().filter(|sender| !self.problems.is_untold(&sender.witness)) {
            let since =
                *sender.waits.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(Instant::now);
            let problem = match sender.heads.try_send(head.clone()) {
                Ok(()) if since.elapsed() < SLOW => continue,
                Ok(()) => format!("it has taken no head for {} s", since.elapsed().as_secs()),
                Err(TrySendError::Full(_)) => {
                    format!(
                        "it has not taken the last {QUEUE_MAX} heads; whatever it is mounted from may hang"
                    )
                }
                Err(TrySendError::Disconnected(_)) => "what writes it has ended".to_owned(),
            };
            self.problems.set(&sender.witness, Some(problem));
        }
    }
}

impl Drop for Senders {
    fn drop(&mut self) {
        self.threads.drain(..).for_each(end);
    }
}

/// Lets a sender finish. One that hangs is left behind: it ends with the process.
fn end(sender: Sender) {
    drop(sender.heads);
    match sender.ended.recv_timeout(END_WAIT) {
        Ok(()) | Err(RecvTimeoutError::Disconnected | RecvTimeoutError::Timeout) => {}
    }
}

fn start(witness: &str, store_id: &str, problems: Problems) -> std::io::Result<Sender> {
    let (heads, incoming) = sync_channel::<Checkpoint>(QUEUE_MAX);
    let (done, ended) = sync_channel(1);
    let (name, folder) = (witness.to_owned(), folder_of(witness, store_id));
    let waits = Arc::new(Mutex::new(None));
    let waits_there = Arc::clone(&waits);
    thread::Builder::new().name("witness".to_owned()).spawn(move || {
        while let Ok(mut head) = incoming.recv() {
            // The newest of those that wait stands for the others; each has its file where there is time for it.
            let mut waiting = vec![];
            while let Ok(next) = incoming.try_recv() {
                waiting.push(std::mem::replace(&mut head, next));
            }
            let written =
                put(&folder, &head).and_then(|()| waiting.iter().try_for_each(|it| put(&folder, it)));
            *waits_there.lock().unwrap_or_else(PoisonError::into_inner) = None;
            problems.set(&name, written.err().map(|error| described(&error, &folder)));
        }
        // Nobody may wait for it any more.
        let _ = done.send(());
    })?;
    Ok(Sender { witness: witness.to_owned(), heads, ended, waits })
}

fn described(error: &StoreError, folder: &Path) -> String {
    if folder.is_dir() {
        return error.to_string();
    }
    format!("{error}; the folder of this store is not there: what it is mounted from may be gone")
}

/// What a start found at a witness.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Testimony {
    /// The newest head there is of this chain.
    Agrees,
    /// It cannot be asked.
    Silent(String),
    /// The store signed a head that is not of this chain.
    Against { file: String, problem: String },
}

/// Asks a witness for the newest head that this store signed.
pub(crate) fn ask(
    witness: &str,
    (store_id, key): (&str, &VerifyingKey),
    end: u64,
    chain_at: impl FnOnce(u64) -> Option<ChainAt>,
) -> Testimony {
    let (answer, newest) = sync_channel(1);
    let (folder, key_there, id) = (folder_of(witness, store_id), *key, store_id.to_owned());
    let asked = thread::Builder::new().name("witness".to_owned()).spawn(move || {
        // A start that did not wait for it has gone on.
        let _ = answer.send(newest_signed(&folder, &id, &key_there));
    });
    let found = match asked {
        Ok(_) => newest.recv_timeout(READ_WAIT),
        Err(error) => return Testimony::Silent(error.to_string()),
    };
    match found {
        Err(_) => Testimony::Silent(format!("it did not answer within {} s", READ_WAIT.as_secs())),
        Ok(Err(NoTestimony::Unreadable(problem))) => Testimony::Silent(problem),
        Ok(Err(NoTestimony::OtherKey(file))) => {
            let problem =
                "it is of this store, and signed with another key than the store has now".to_owned();
            Testimony::Against { file, problem }
        }
        Ok(Ok((file, head))) => match check_copy(&head, (store_id, Some(key)), end, chain_at) {
            Ok(()) => Testimony::Agrees,
            Err(problem) => Testimony::Against { file, problem },
        },
    }
}

/// Why a witness has nothing to say of a chain.
enum NoTestimony {
    Unreadable(String),
    /// All that it has of this store is signed with another key: the first such file.
    OtherKey(String),
}

/// The newest head in a folder that this store signed; beside one, what it did not sign proves nothing and is passed over.
fn newest_signed(
    folder: &Path,
    store_id: &str,
    key: &VerifyingKey,
) -> Result<(String, Checkpoint), NoTestimony> {
    let names = checkpoint::names(folder).map_err(|error| NoTestimony::Unreadable(error.to_string()))?;
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
        Some(file) => NoTestimony::OtherKey(file),
        // The first head is put there when the witness is added, before that is on record.
        None if names.is_empty() => NoTestimony::Unreadable(
            "it is empty, although it got a head when it was added; what it had is gone".to_owned(),
        ),
        None => NoTestimony::Unreadable("this store signed none of its newest files".to_owned()),
    })
}

/// Asks every witness, and notes those that are silent.
///
/// # Errors
/// The first that speaks against the chain.
pub(crate) fn ask_all<'a>(
    witnesses: impl Iterator<Item = &'a String>,
    by: (&str, &VerifyingKey),
    end: u64,
    chain_at: impl Fn(u64) -> Option<ChainAt>,
    problems: &Problems,
) -> Result<(), (String, String)> {
    for witness in witnesses {
        match ask(witness, by, end, &chain_at) {
            Testimony::Agrees => {}
            Testimony::Silent(problem) => problems.unheard(witness, problem),
            Testimony::Against { file, problem } => return Err((file, problem)),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::ids::Digest;

    #[test]
    fn a_testimony_is_written_once_and_not_replaced_by_another() {
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
        let error = put(folder.path(), &head("other")).unwrap_err().to_string();
        assert!(error.contains("the head that it got before"), "{error}");
        assert_eq!(fs::read(&path).unwrap(), testimony);
        // Nothing is written through a link that somebody put where the file is made.
        let elsewhere = folder.path().join("elsewhere");
        fs::write(&elsewhere, "mine").unwrap();
        std::os::unix::fs::symlink(&elsewhere, path.with_extension("part")).unwrap();
        put(folder.path(), &head("one")).unwrap();
        assert_eq!(fs::read_to_string(&elsewhere).unwrap(), "mine");
    }
}
