//! The store: a handle to the one thread that owns the one connection that writes.
//!
//! Callers may be many; transactions are applied one at a time, in the order they came, each whole or not at all.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use ed25519_dalek::{SigningKey, VerifyingKey};
use rusqlite::config::DbConfig;
use rusqlite::{Connection, TransactionBehavior};

use super::apply::{ApprovalBasis, apply};
use super::aside::{ChainSays, not_on_record, settle_file};
use super::audit::{self, ExportError, Head};
use super::change::{BatchReceipt, Change, Receipt, Transaction};
use super::check::{check_existing, kept_checkpoints};
use super::checkpoint::{Checkpoint, EVERY_RECORDS, Link};
use super::compare::compare;
use super::error::StoreError;
use super::fold::{Fold, ReadingWatch};
use super::kept::{KeptCells, KeptSecret};
use super::layout::{EngineLock, Layout};
use super::loosened::ProfileCourse;
use super::migrate::STORE;
use super::open::{
    Durability, FileId, WrittenHere, damaged, file_id, open_reader, open_writer, written_by_others,
};
use super::recovery::{Interrupted, interrupted};
use super::seals::{FoundTelemetry, Settled};
use super::shape::first_difference;
use super::signed;
use super::snapshot;
use super::store_id;
use super::taken::UnreadStore;
use super::telemetry::{Batch, TelemetryFile, TelemetryLimits};
use super::views::{ActiveVersions, Views};
use super::witness::{Problems, Senders};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::wall_time::WallTime;

/// Transactions that may wait for the writer; a caller beyond that waits itself.
const QUEUE_MAX: usize = 64;

/// What was found when the store was opened.
#[derive(Clone, Debug)]
pub struct Opening {
    /// Whether the store is new.
    pub created: bool,
    /// The end of the chain; virtual time must go on from its `at_ms`.
    pub head: Head,
    /// Wall time of the newest record; absent in a store of scripts alone.
    pub newest_record: Option<WallTime>,
    /// What an earlier engine left unfinished, for this one to finish or undo.
    pub interrupted: Vec<Interrupted>,
    /// What became of telemetry meanwhile, for this engine to put on record.
    pub telemetry: FoundTelemetry,
    /// How the profiles followed each other, by the chain.
    pub profiles: ProfileCourse,
}

/// What the writer is asked for.
enum Job {
    Commit {
        transaction: Transaction,
        answer: SyncSender<Result<Receipt, StoreError>>,
    },
    /// Whether another program wrote to the database since it was opened.
    Disturbed {
        answer: SyncSender<Result<bool, StoreError>>,
    },
}

/// An open store. It belongs to this process until it is dropped.
#[derive(Debug)]
#[allow(clippy::struct_field_names, reason = "the store's id is not the id of a thing in it")]
pub struct Store {
    jobs: Option<SyncSender<Job>>,
    writer: Option<JoinHandle<()>>,
    telemetry: Arc<Mutex<TelemetryFile>>,
    cells: KeptCells,
    checkpoint_problem: Arc<Mutex<Option<String>>>,
    witness_problems: Problems,
    altered: Arc<Mutex<Option<String>>>,
    /// The file that the writer has open.
    database: Option<FileId>,
    layout: Layout,
    store_id: String,
    public_key: VerifyingKey,
    opening: Opening,
    _lock: EngineLock,
}

impl Store {
    /// Opens the store in `folder`, or makes a new one there.
    ///
    /// Refuses (and changes nothing of) a store that another engine has, or whose database is foreign, newer, cut
    /// short, damaged, or not what its chain and checkpoints say.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn open(folder: impl AsRef<Path>) -> Result<Self, StoreError> {
        Self::open_with(folder, TelemetryLimits::default())
    }

    /// As [`Self::open`], with other limits on telemetry.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn open_with(folder: impl AsRef<Path>, limits: TelemetryLimits) -> Result<Self, StoreError> {
        UnreadStore::take_with(folder.as_ref(), limits)?.read(&mut |_| ())
    }

    /// Reads the whole record of a store that was taken, and opens it.
    pub(crate) fn on(taken: UnreadStore, watch: ReadingWatch<'_>) -> Result<Self, StoreError> {
        let UnreadStore { layout, lock, key, created, limits, .. } = taken;
        let problems = Problems::default();
        let fold = if created {
            Fold::empty()
        } else {
            check_existing(&layout, &key.verifying_key(), &problems, watch)?
        };
        let (mut connection, written) = open_writer(&layout.database(), &STORE, Durability::Full)?;
        // What is read of the tables from here on is what was compared here, as long as nobody else writes.
        let compared = hold_against(&mut connection, &fold)?;
        let store_id = if fold.end().seq == 0 {
            store_id::name_after(&connection, &key.verifying_key())?
        } else {
            store_id::read(&connection, &layout.database())?
        };
        let head = audit::head(&connection).map_err(StoreError::sql("read the audit chain"))?;
        let newest_record = audit::wall_ms_of(&connection, head.seq)?.map(WallTime::from_ms);
        let interrupted = interrupted(&connection).map_err(StoreError::sql("look for interrupted work"))?;
        let (telemetry, found) = open_telemetry((&layout, limits), &connection, &fold)?;
        let telemetry = Arc::new(Mutex::new(telemetry));
        let cells = KeptCells::in_table(Arc::clone(&telemetry), KeptSecret::of_store(&key)?);
        let (public_key, profiles) = (key.verifying_key(), fold.profiles().clone());
        let link = sign_on(&connection, &layout, (&store_id, &fold), &key)?;
        let (jobs, incoming) = sync_channel(QUEUE_MAX);
        let checkpoint_problem = Arc::new(Mutex::new(None));
        let altered = Arc::new(Mutex::new(None));
        let mut senders = Senders::new(problems.clone());
        senders.set(fold.witnesses().iter(), &store_id);
        if let Ok(Some(end)) = signed::read(&connection) {
            senders.send(&end);
        }
        let writer = StoreWriter {
            connection,
            senders,
            store_id: store_id.clone(),
            key,
            checkpoints: layout.checkpoints(),
            snapshot_seq: fold.since(),
            fold,
            compared: Some(compared),
            opened: compared,
            checkpointed_seq: head.seq,
            link,
            checkpoint_problem: Arc::clone(&checkpoint_problem),
            altered: Arc::clone(&altered),
            _written: written,
        };
        let writer = thread::Builder::new()
            .name("store-writer".to_owned())
            .spawn(move || writer.run(&incoming))
            .map_err(StoreError::io("start the writer of", layout.folder()))?;
        Ok(Self {
            jobs: Some(jobs),
            writer: Some(writer),
            telemetry,
            cells,
            checkpoint_problem,
            witness_problems: problems,
            altered,
            database: file_id(&layout.database()),
            layout,
            store_id,
            public_key,
            opening: Opening { created, head, newest_record, interrupted, telemetry: found, profiles },
            _lock: lock,
        })
    }

    /// Applies a transaction, whole or not at all, and returns once it is on disk. Blocks; call it from a thread
    /// that may.
    ///
    /// # Errors
    /// [`StoreError`]; nothing was changed, except that after [`StoreError::Unknown`] the outcome is not known and
    /// the same command may be sent again.
    pub fn commit(&self, transaction: Transaction) -> Result<Receipt, StoreError> {
        if let Some(problem) = self.displaced()
            && transaction.changes.iter().any(Change::lets_in)
        {
            return Err(StoreError::Altered(problem));
        }
        let settled = Settled::by(&transaction.changes);
        let (answer, receipt) = sync_channel(1);
        let jobs = self.jobs.as_ref().ok_or(StoreError::Unknown)?;
        jobs.send(Job::Commit { transaction, answer }).map_err(|_| StoreError::Unknown)?;
        let receipt = receipt.recv().map_err(|_| StoreError::Unknown)??;
        if settled != Settled::default() {
            // What could not be removed is removed the next time; that it goes is on record.
            drop(self.telemetry.lock().map_err(|_| StoreError::Unknown)?.settle(settled));
        }
        Ok(receipt)
    }

    /// As [`Self::commit`], with seals for all telemetry that waits for one, before everything else: what is on record
    /// rests on nothing that could still be changed. Where telemetry cannot be forced to disk, only what takes
    /// authority away is written, without.
    ///
    /// # Errors
    /// As [`Self::commit`].
    pub fn commit_sealing(&self, mut transaction: Transaction) -> Result<Receipt, StoreError> {
        match self.seal_telemetry() {
            Ok(seals) => drop(transaction.changes.splice(0..0, seals)),
            Err(error) if transaction.changes.iter().any(Change::lets_in) => return Err(error),
            Err(_) => {}
        }
        self.commit(transaction)
    }

    /// The store's id; approvals are bound to it.
    #[must_use]
    pub fn store_id(&self) -> &str {
        &self.store_id
    }

    /// The key that verifies the store's checkpoints.
    #[must_use]
    pub const fn public_key(&self) -> &VerifyingKey {
        &self.public_key
    }

    #[must_use]
    pub const fn layout(&self) -> &Layout {
        &self.layout
    }

    /// What was found when it was opened.
    #[must_use]
    pub const fn opening(&self) -> &Opening {
        &self.opening
    }

    /// Why the last checkpoint could not be written here or at a witness, if so. The records themselves are on disk.
    #[must_use]
    pub fn checkpoint_problem(&self) -> Option<String> {
        let own = self.checkpoint_problem.lock().unwrap_or_else(PoisonError::into_inner).clone();
        own.or_else(|| self.witness_problems.all().into_iter().next())
    }

    /// What [`Self::checkpoint_problem`] says is on record: witnesses that the start found silent get heads again.
    pub fn problems_are_told(&self) {
        self.witness_problems.told();
    }

    /// What another program did to the database of this engine, if a write found anything: nothing must be decided on
    /// what it holds from then on.
    ///
    /// # Errors
    /// [`StoreError::Altered`].
    pub fn unaltered(&self) -> Result<(), StoreError> {
        let found = self.altered.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let found = found.or_else(|| self.displaced());
        found.map_or(Ok(()), |problem| Err(StoreError::Altered(problem)))
    }

    /// What was read of the tables since the opening is what was compared then: no other program wrote to the database.
    /// What one changed and put back is found by no comparison; that it was there is.
    ///
    /// # Errors
    /// [`StoreError::Disturbed`].
    pub fn undisturbed(&self) -> Result<(), StoreError> {
        let (answer, disturbed) = sync_channel(1);
        let jobs = self.jobs.as_ref().ok_or(StoreError::Unknown)?;
        jobs.send(Job::Disturbed { answer }).map_err(|_| StoreError::Unknown)?;
        let disturbed = disturbed.recv().map_err(|_| StoreError::Unknown)??;
        if disturbed { Err(StoreError::Disturbed) } else { Ok(()) }
    }

    /// Whether another file has the name of the database by now, or none: what is written is in a file that nobody finds
    /// any more.
    fn displaced(&self) -> Option<String> {
        (file_id(&self.layout.database()) != self.database).then(|| {
            let path = self.layout.database();
            format!("the file {path:?} that this engine opened was removed or replaced; what it writes is lost with it")
        })
    }

    /// Everything there is to read, on a connection of its own that cannot write. Keep it; opening costs a
    /// millisecond.
    ///
    /// # Errors
    /// If the database cannot be opened.
    pub fn views(&self) -> Result<Views, StoreError> {
        Views::open(&self.layout.database())
    }

    /// Who is active, and nothing else: the view the dispatcher gets.
    ///
    /// # Errors
    /// If the database cannot be opened.
    pub fn active_view(&self) -> Result<ActiveVersions, StoreError> {
        ActiveVersions::open(&self.layout.database())
    }

    /// Writes the audit chain from `from_seq` on as JSON lines; see [`Views::export`].
    ///
    /// # Errors
    /// [`ExportError`].
    pub fn export(&self, from_seq: u64, out: &mut dyn Write) -> Result<u64, ExportError> {
        let connection = open_reader(&self.layout.database(), &STORE)
            .map_err(|error| ExportError::Write(std::io::Error::other(error)))?;
        audit::export(&connection, from_seq, out)
    }

    /// Keeps a batch of telemetry. It may be lost to a power cut until [`Self::seal_telemetry`].
    ///
    /// # Errors
    /// If the batch is empty, too large, or cannot be written.
    pub fn append_telemetry(&self, batch: &Batch) -> Result<BatchReceipt, StoreError> {
        self.telemetry.lock().map_err(|_| StoreError::Unknown)?.append(batch)
    }

    /// Forces telemetry to disk and returns the changes that put its new batches into the audit chain, and those that
    /// remove the oldest ones beyond the limit.
    ///
    /// # Errors
    /// If it cannot be forced to disk; the batches stay unsealed.
    pub fn seal_telemetry(&self) -> Result<Vec<Change>, StoreError> {
        self.telemetry.lock().map_err(|_| StoreError::Unknown)?.seal()
    }

    /// Whether telemetry has waited so long, or is so much, that it is sealed although nothing else is written.
    ///
    /// # Errors
    /// If another thread failed with it.
    pub fn telemetry_is_due(&self, now_ms: u64) -> Result<bool, StoreError> {
        Ok(self.telemetry.lock().map_err(|_| StoreError::Unknown)?.is_due(now_ms))
    }

    /// The latest virtual time of telemetry that waits for its seal, ms; `None` if none does.
    #[must_use]
    pub fn telemetry_waits(&self) -> Option<u64> {
        self.telemetry.lock().unwrap_or_else(PoisonError::into_inner).waiting()
    }

    /// A batch's rows, checked against their digest; `None` if it was removed for age.
    ///
    /// # Errors
    /// If it cannot be read or was changed.
    pub fn telemetry_batch(&self, batch: u64) -> Result<Option<Batch>, StoreError> {
        self.telemetry.lock().map_err(|_| StoreError::Unknown)?.read(batch)
    }

    /// What the store keeps of work that need not be done again.
    #[must_use]
    pub const fn cells(&self) -> &KeptCells {
        &self.cells
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        drop(self.jobs.take());
        if let Some(writer) = self.writer.take() {
            // A writer that panicked has no more to say; every later commit was answered with `Unknown`.
            let _ = writer.join();
        }
    }
}

/// Owns the connection that writes.
struct StoreWriter {
    connection: Connection,
    store_id: String,
    key: SigningKey,
    checkpoints: PathBuf,
    /// What the chain says, this writer's records included.
    fold: Fold,
    /// SQLite's count of what others wrote to the database, when the tables were last held against the chain.
    compared: Option<i64>,
    /// The same count when the store was opened.
    opened: i64,
    checkpointed_seq: u64,
    /// Of the next checkpoint.
    link: Link,
    senders: Senders,
    /// The record of the last snapshot of the fold.
    snapshot_seq: u64,
    checkpoint_problem: Arc<Mutex<Option<String>>>,
    altered: Arc<Mutex<Option<String>>>,
    // After the connection: fields are dropped in their order.
    _written: WrittenHere,
}

impl StoreWriter {
    fn run(mut self, incoming: &Receiver<Job>) {
        let mut end = None;
        while let Ok(job) = incoming.recv() {
            let (transaction, answer) = match job {
                Job::Commit { transaction, answer } => (transaction, answer),
                Job::Disturbed { answer } => {
                    let now = written_by_others(&self.connection);
                    let _ = answer.send(now.map(|now| now != self.opened));
                    continue;
                }
            };
            let result = self.commit(&transaction).map(|(receipt, head)| {
                let witness =
                    transaction.changes.iter().any(|change| matches!(change, Change::SetWitness { .. }));
                if head.seq > self.checkpointed_seq
                    && (witness
                        || transaction.is_signed_at_once()
                        || head.seq >= self.checkpointed_seq + EVERY_RECORDS)
                {
                    // The last that a witness gets is the head under which its removal is on record.
                    self.checkpoint(head);
                }
                if witness {
                    self.senders.set(self.fold.witnesses().iter(), &self.store_id);
                }
                end = Some(head);
                receipt
            });
            // A caller that went away asks again with the same command id.
            let _ = answer.send(result);
        }
        if let Some(head) = end.filter(|head| head.seq > self.checkpointed_seq) {
            self.checkpoint(head);
        }
    }

    fn commit(&mut self, transaction: &Transaction) -> Result<(Receipt, Head), StoreError> {
        let tx = self
            .connection
            .transaction_with_behavior(TransactionBehavior::Immediate)
            .map_err(StoreError::sql("begin a transaction"))?;
        let written_by_others = match check_others(&tx, &self.fold, self.compared)? {
            Others::Compared(count) => Some(count),
            Others::Altered(problem) => {
                *self.altered.lock().unwrap_or_else(PoisonError::into_inner) = Some(problem.clone());
                // What stops the robot or takes a version off is written all the same, where the rows it replaces
                // are what the chain says.
                if transaction.changes.iter().any(Change::lets_in) {
                    return Err(StoreError::Altered(problem));
                }
                None
            }
        };
        let store_key = holdpoint_approvals::keyfile::hex(self.key.verifying_key().as_bytes());
        let place = ApprovalBasis { store_id: &self.store_id, store_key: &store_key };
        let answer = apply(&tx, transaction, place, &self.fold)?;
        if answer.1.seq > self.fold.end().seq {
            let root = audit::tree_after(&tx, self.fold.tree())?.root();
            let (wall_ms, link) = (audit::wall_ms_of(&tx, answer.1.seq)?, self.link.clone());
            let end = Checkpoint::sign(&self.store_id, (answer.1, root), wall_ms, link, None, &self.key);
            signed::write(&tx, &end)?;
        }
        tx.commit().map_err(StoreError::sql("commit a transaction"))?;
        self.compared = written_by_others;
        // Where it fails, the end of the chain is not the fold's any more, and the next transaction is refused for it.
        drop(self.fold.go_on(&self.connection));
        crate::fp!("after-commit-before-ack");
        Ok(answer)
    }

    /// Writes a snapshot of the fold if the last one is long ago. Tells its digest.
    fn snapshot(&mut self, head: Head) -> Result<Option<Digest>, StoreError> {
        let due = head.seq >= self.snapshot_seq + snapshot::EVERY_RECORDS;
        if !due || (self.fold.end().seq, self.fold.end().hash) != (head.seq, head.hash) {
            return Ok(None);
        }
        self.snapshot_seq = head.seq;
        snapshot::write(&self.fold, &self.checkpoints)
    }

    /// Writes a checkpoint; a failure is kept for the engine to raise, the records are on disk.
    fn checkpoint(&mut self, head: Head) {
        let tree = self.fold.tree();
        let root = if tree.size() == head.seq {
            Ok(tree.root())
        } else {
            Err(StoreError::Altered(format!("the records up to {} could not be read back", head.seq)))
        };
        let written = root.and_then(|root| {
            let fold = self.snapshot(head)?;
            let (wall_ms, link) = (audit::wall_ms_of(&self.connection, head.seq)?, self.link.clone());
            let checkpoint = Checkpoint::sign(&self.store_id, (head, root), wall_ms, link, fold, &self.key);
            checkpoint.write(&self.checkpoints)?;
            Ok(checkpoint)
        });
        if let Ok(checkpoint) = &written {
            self.checkpointed_seq = head.seq;
            self.link = Link::after(Some(checkpoint));
            self.senders.send(checkpoint);
        }
        *self.checkpoint_problem.lock().unwrap_or_else(PoisonError::into_inner) =
            written.err().map(|error| error.to_string());
    }
}

/// Opens the telemetry file, or puts it aside and makes another. Tells what is in it beside what the chain says.
fn open_telemetry(
    (layout, limits): (&Layout, TelemetryLimits),
    connection: &Connection,
    fold: &Fold,
) -> Result<(TelemetryFile, FoundTelemetry), StoreError> {
    let known: BTreeSet<String> = connection
        .prepare("SELECT name FROM version")
        .and_then(|mut select| select.query_map([], |row| row.get(0))?.collect())
        .map_err(StoreError::sql("read the versions"))?;
    let account = fold.telemetry();
    let chain = ChainSays { account, batches: &fold.batches, connection };
    let (contents, own) = settle_file(layout, limits, chain)?;
    let aside = not_on_record(layout, connection, own.as_ref())?;
    let file = TelemetryFile::open(&layout.telemetry(), limits, (&contents, account.sealed()))?;
    let is_known = |version: &CapabilityId| known.contains(&version.to_string());
    let found = file.found(contents.numbers, account, aside, is_known)?;
    Ok((file, found))
}

/// What others did to the database of a running engine.
enum Others {
    /// Nothing that matters; SQLite's count of what they wrote.
    Compared(i64),
    /// A row is not what the chain says, or the database has another shape.
    Altered(String),
}

/// Holds the tables against the chain as they are now, and tells the count of [`written_by_others`] at that moment.
fn hold_against(connection: &mut Connection, fold: &Fold) -> Result<i64, StoreError> {
    let tx = connection
        .transaction_with_behavior(TransactionBehavior::Immediate)
        .map_err(StoreError::sql("begin a transaction"))?;
    match check_others(&tx, fold, None)? {
        Others::Compared(count) => Ok(count),
        Others::Altered(problem) => Err(StoreError::Altered(problem)),
    }
}

/// If another program wrote to the database since the tables were last compared, they are compared again: what was
/// changed behind the engine's back is neither read nor written over. Where the database has another shape, triggers
/// act no more: one that came in could change what is written.
fn check_others(connection: &Connection, fold: &Fold, compared: Option<i64>) -> Result<Others, StoreError> {
    let error = StoreError::sql("compare the registry with the audit chain");
    let now = written_by_others(connection)?;
    if compared == Some(now) {
        return Ok(Others::Compared(now));
    }
    if let Some(problem) = first_difference(connection, &STORE).map_err(&error)? {
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER, false).map_err(&error)?;
        return Ok(Others::Altered(problem));
    }
    let fault = compare(fold, connection).map_err(&error)?;
    Ok(fault.map_or(Others::Compared(now), |fault| Others::Altered(fault.to_string())))
}

/// Signs where the chain ends, in a store of an earlier version, and finishes a rebuild that was ended before its
/// checkpoint was written. Tells where the next checkpoint stands.
fn sign_on(
    connection: &Connection,
    layout: &Layout,
    (store_id, fold): (&str, &Fold),
    key: &SigningKey,
) -> Result<Link, StoreError> {
    let kept = kept_checkpoints(layout)?;
    let newest = kept.last().map(|kept| &kept.checkpoint);
    let unreadable = |problem: String| damaged(&layout.database(), &problem);
    let link = Link::after_all(&kept);
    match signed::read(connection).map_err(unreadable)? {
        Some(end)
            if end.root.is_none()
                && end.link.as_ref().is_some_and(|link| link.gap)
                && newest.is_none_or(|it| it.link != end.link) =>
        {
            end.write(&layout.checkpoints())?;
            return sign_on(connection, layout, (store_id, fold), key);
        }
        found if found.as_ref().is_none_or(|end| end.root.is_none()) && fold.end().seq > 0 => {
            let tree_head = (fold.end(), fold.tree().root());
            let wall_ms = audit::wall_ms_of(connection, fold.end().seq)?;
            let end = Checkpoint::sign(store_id, tree_head, wall_ms, link.clone(), None, key);
            signed::write(connection, &end)?;
        }
        Some(end)
            if end.link.as_ref().is_some_and(|link| link.gap)
                && newest.is_none_or(|it| it.link != end.link) =>
        {
            end.write(&layout.checkpoints())?;
            return Ok(Link::after(Some(&end)));
        }
        None | Some(_) => {}
    }
    Ok(link)
}
