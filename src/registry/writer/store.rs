//! The store: a handle to the one thread that owns the one connection that writes. It applies the transactions of all
//! callers one at a time, in order, each whole or not at all.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use ed25519_dalek::{SigningKey, VerifyingKey};
use rusqlite::config::DbConfig;
use rusqlite::{Connection, TransactionBehavior};

use crate::chain::audit;
use crate::chain::chain_signature;
use crate::chain::compare::compare;
use crate::chain::fold::{Fold, ReadProgress};
use crate::chain::snapshot;
use crate::chain::telemetry_seals::SealProgress;
use crate::database::migrate::STORE;
use crate::database::open::{
    Durability, FileId, WriterGuard, damaged, file_id, open_writer, written_by_others,
};
use crate::database::schema_shape::first_difference;
use crate::database::store_id;
use crate::reading::interrupted_work::interrupted;
use crate::reading::views::Views;
use crate::telemetry::cached_rows::CachedRows;
use crate::telemetry::telemetry_file::{TelemetryFile, TelemetryLimits};
use crate::telemetry::telemetry_quarantine::{ChainEvidence, prepare_file, unrecorded_files};
use crate::terms::sqlite_error::sqlite_error;
use crate::transaction::apply::{ApprovalBasis, apply};
use crate::verification::check::{check_existing, stored_checkpoints};
use crate::writer::unverified_store::UnverifiedStore;
use holdpoint_audit::chain::Head;
use holdpoint_audit::checkpoint::{Checkpoint, CheckpointLink, EVERY_RECORDS};
use holdpoint_audit::witness::{WitnessProblems, WitnessSenders};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_store::{
    Batch, BatchReceipt, CacheSecret, Change, EngineLock, Layout, OpenReport, Receipt, ResultCache,
    StartupTelemetry, StoreError, Transaction, command_id,
};

/// Pending transactions of the writer; a further caller blocks.
const QUEUE_MAX: usize = 64;

enum WriterJob {
    Commit {
        transaction: Transaction,
        answer: SyncSender<Result<Receipt, StoreError>>,
    },
    /// Whether another program wrote to the database since it was opened.
    Disturbed {
        answer: SyncSender<Result<bool, StoreError>>,
    },
}

/// An open store. It belongs to this process until it is dropped. [`OpenStore`](holdpoint_store::OpenStore) describes
/// the calls that any store has.
#[derive(Debug)]
#[allow(clippy::struct_field_names, reason = "the store's id is not the id of a thing in it")]
pub struct Store {
    jobs: Option<SyncSender<WriterJob>>,
    writer: Option<JoinHandle<()>>,
    telemetry: Arc<Mutex<TelemetryFile>>,
    result_cache: ResultCache,
    checkpoint_problem: Arc<Mutex<Option<String>>>,
    witness_problems: WitnessProblems,
    altered: Arc<Mutex<Option<String>>>,
    database: Option<FileId>,
    layout: Layout,
    store_id: String,
    public_key: VerifyingKey,
    opening: OpenReport,
    _lock: EngineLock,
}

impl Store {
    /// Opens the store in `folder`, or makes a new one there.
    ///
    /// Refuses, without any change, a store of another engine, or a database that fails its checks.
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
        UnverifiedStore::take_with(folder.as_ref(), limits)?.read(&mut |_| ())
    }

    /// Reads the whole record of a locked store, and opens it.
    pub(crate) fn on(taken: UnverifiedStore, watch: ReadProgress<'_>) -> Result<Self, StoreError> {
        let UnverifiedStore { layout, lock, key, created, limits, .. } = taken;
        let problems = WitnessProblems::default();
        let fold = if created {
            Fold::empty()
        } else {
            check_existing(&layout, &key.verifying_key(), &problems, watch)?
        };
        let (mut connection, written) = open_writer(&layout.database(), &STORE, Durability::Full)?;
        // Tables read from here on match the comparison, while no other program writes.
        let compared = compare_tables(&mut connection, &fold)?;
        let store_id = if fold.end.seq == 0 {
            store_id::name_after(&connection, &key.verifying_key())?
        } else {
            store_id::read(&connection, &layout.database())?
        };
        let head = audit::head(&connection).map_err(sqlite_error("read the audit chain"))?;
        let newest_record = audit::wall_ms_of(&connection, head.seq)?.map(WallTime::from_ms);
        let interrupted = interrupted(&connection).map_err(sqlite_error("look for interrupted work"))?;
        let (telemetry, found) = open_telemetry((&layout, limits), &connection, &fold)?;
        let telemetry = Arc::new(Mutex::new(telemetry));
        let result_cache =
            ResultCache::in_table(Arc::new(CachedRows(Arc::clone(&telemetry))), CacheSecret::of_store(&key)?);
        let (public_key, profiles) = (key.verifying_key(), fold.profiles.clone());
        let link = sign_on(&connection, &layout, (&store_id, &fold), &key)?;
        let (jobs, incoming) = sync_channel(QUEUE_MAX);
        let checkpoint_problem = Arc::new(Mutex::new(None));
        let altered = Arc::new(Mutex::new(None));
        let mut senders = WitnessSenders::new(problems.clone());
        senders.set(fold.witnesses.iter(), &store_id);
        if let Ok(Some(end)) = chain_signature::read(&connection) {
            senders.send(&end);
        }
        let writer = StoreWriter {
            connection,
            senders,
            store_id: store_id.clone(),
            key,
            checkpoints: layout.checkpoints(),
            snapshot_seq: fold.since.seq,
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
            result_cache,
            checkpoint_problem,
            witness_problems: problems,
            altered,
            database: file_id(&layout.database()),
            layout,
            store_id,
            public_key,
            opening: OpenReport { created, head, newest_record, interrupted, telemetry: found, profiles },
            _lock: lock,
        })
    }

    /// Applies a transaction, whole or not at all, and returns once it is on disk. Blocks the calling thread.
    ///
    /// # Errors
    /// [`StoreError`]; nothing was changed, unless it is [`StoreError::Unknown`]: then send the same command again.
    pub fn commit(&self, transaction: Transaction) -> Result<Receipt, StoreError> {
        if let Some(problem) = self.displaced()
            && transaction.changes.iter().any(Change::admits)
        {
            return Err(StoreError::Altered(problem));
        }
        let settled = SealProgress::by(&transaction.changes);
        let (answer, receipt) = sync_channel(1);
        let jobs = self.jobs.as_ref().ok_or(StoreError::Unknown)?;
        jobs.send(WriterJob::Commit { transaction, answer }).map_err(|_| StoreError::Unknown)?;
        let receipt = receipt.recv().map_err(|_| StoreError::Unknown)??;
        if settled != SealProgress::default() {
            // Leftovers are removed the next time; their removal is on record.
            drop(self.telemetry.lock().map_err(|_| StoreError::Unknown)?.settle(settled));
        }
        Ok(receipt)
    }

    /// Commits one change beside those of an engine, at the virtual time of the newest record.
    pub(crate) fn commit_alone(&self, what: &str, change: Change, wall_ms: i64) -> Result<(), StoreError> {
        let (command_id, at_ms) = (command_id(what)?, self.views()?.head()?.at_ms);
        let transaction =
            Transaction { command_id, at_ms, wall_ms, changes: vec![change], audit: Vec::new() };
        self.commit(transaction).map(drop)
    }

    /// As [`Self::commit`], after sealing all pending telemetry, so that a record rests on sealed data only. If
    /// telemetry cannot be flushed, only changes that remove authority are written, without seals.
    ///
    /// # Errors
    /// As [`Self::commit`].
    pub fn commit_sealing(&self, mut transaction: Transaction) -> Result<Receipt, StoreError> {
        match self.seal_telemetry() {
            Ok(seals) => drop(transaction.changes.splice(0..0, seals)),
            Err(error) if transaction.changes.iter().any(Change::admits) => return Err(error),
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

    /// The state of the store when it was opened.
    #[must_use]
    pub const fn opening(&self) -> &OpenReport {
        &self.opening
    }

    pub fn checkpoint_problem(&self) -> Option<String> {
        let own = self.checkpoint_problem.lock().unwrap_or_else(PoisonError::into_inner).clone();
        own.or_else(|| self.witness_problems.all().into_iter().next())
    }

    pub fn mark_problems_reported(&self) {
        self.witness_problems.mark_reported();
    }

    /// A foreign change of this engine's database, if a write found one: its content must no longer decide anything.
    ///
    /// # Errors
    /// [`StoreError::Altered`].
    pub fn check_unaltered(&self) -> Result<(), StoreError> {
        let found = self.altered.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let found = found.or_else(|| self.displaced());
        found.map_or(Ok(()), |problem| Err(StoreError::Altered(problem)))
    }

    /// Tables read since the opening match the comparison: no other program wrote, even with a later undo.
    ///
    /// # Errors
    /// [`StoreError::Disturbed`].
    pub fn check_undisturbed(&self) -> Result<(), StoreError> {
        let (answer, disturbed) = sync_channel(1);
        let jobs = self.jobs.as_ref().ok_or(StoreError::Unknown)?;
        jobs.send(WriterJob::Disturbed { answer }).map_err(|_| StoreError::Unknown)?;
        let disturbed = disturbed.recv().map_err(|_| StoreError::Unknown)??;
        if disturbed { Err(StoreError::Disturbed) } else { Ok(()) }
    }

    /// Whether the database's path names another file or none: then writes go to an unlinked file.
    fn displaced(&self) -> Option<String> {
        (file_id(&self.layout.database()) != self.database).then(|| {
            let path = self.layout.database();
            format!("the file {path:?} that this engine opened was removed or replaced; what it writes is lost with it")
        })
    }

    /// A read-only view of everything, on its own connection. Keep it; opening costs a millisecond.
    ///
    /// # Errors
    /// If the database cannot be opened.
    pub fn views(&self) -> Result<Views, StoreError> {
        Views::open(&self.layout.database())
    }

    /// Stores a batch of telemetry. A power cut may lose it until [`Self::seal_telemetry`].
    ///
    /// # Errors
    /// If the batch is empty, too large, or cannot be written.
    pub fn append_telemetry(&self, batch: &Batch) -> Result<BatchReceipt, StoreError> {
        self.telemetry.lock().map_err(|_| StoreError::Unknown)?.append(batch)
    }

    /// Flushes telemetry and returns the changes that seal its new batches and remove the oldest beyond the limit.
    ///
    /// # Errors
    /// If it cannot be flushed; the batches stay unsealed.
    pub fn seal_telemetry(&self) -> Result<Vec<Change>, StoreError> {
        self.telemetry.lock().map_err(|_| StoreError::Unknown)?.seal()
    }

    /// Whether telemetry must be sealed now, by age or amount, although nothing else is written.
    ///
    /// # Errors
    /// If another thread failed with it.
    pub fn telemetry_is_due(&self, now_ms: u64) -> Result<bool, StoreError> {
        Ok(self.telemetry.lock().map_err(|_| StoreError::Unknown)?.is_due(now_ms))
    }

    pub fn telemetry_waits(&self) -> Option<u64> {
        self.telemetry.lock().unwrap_or_else(PoisonError::into_inner).waiting()
    }

    /// The store's cached results.
    #[must_use]
    pub const fn result_cache(&self) -> &ResultCache {
        &self.result_cache
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        drop(self.jobs.take());
        if let Some(writer) = self.writer.take() {
            // A writer that panicked has no result; every later commit got `Unknown`.
            let _ = writer.join();
        }
    }
}

/// Owns the writing connection.
struct StoreWriter {
    connection: Connection,
    store_id: String,
    key: SigningKey,
    checkpoints: PathBuf,
    /// The fold of the chain, this writer's records included.
    fold: Fold,
    /// SQLite's count of foreign writes at the last comparison of tables and chain.
    compared: Option<i64>,
    /// The same count when the store was opened.
    opened: i64,
    checkpointed_seq: u64,
    link: CheckpointLink,
    senders: WitnessSenders,
    /// The record of the last snapshot of the fold.
    snapshot_seq: u64,
    checkpoint_problem: Arc<Mutex<Option<String>>>,
    altered: Arc<Mutex<Option<String>>>,
    // After the connection: fields are dropped in their order.
    _written: WriterGuard,
}

impl StoreWriter {
    fn run(mut self, incoming: &Receiver<WriterJob>) {
        let mut end = None;
        while let Ok(job) = incoming.recv() {
            let (transaction, answer) = match job {
                WriterJob::Commit { transaction, answer } => (transaction, answer),
                WriterJob::Disturbed { answer } => {
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
                    // A removed witness still gets the head that covers its removal.
                    self.checkpoint(head);
                }
                if witness {
                    self.senders.set(self.fold.witnesses.iter(), &self.store_id);
                }
                end = Some(head);
                receipt
            });
            // A caller that is gone sends the same command id again.
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
            .map_err(sqlite_error("begin a transaction"))?;
        let written_by_others = match check_others(&tx, &self.fold, self.compared)? {
            ExternalChange::Compared(count) => Some(count),
            ExternalChange::Altered(problem) => {
                *self.altered.lock().unwrap_or_else(PoisonError::into_inner) = Some(problem.clone());
                // Stops and rollbacks are written all the same, if the rows they replace match the chain.
                if transaction.changes.iter().any(Change::admits) {
                    return Err(StoreError::Altered(problem));
                }
                None
            }
        };
        let store_key = holdpoint_text::hex::hex(self.key.verifying_key().as_bytes());
        let place = ApprovalBasis { store_id: &self.store_id, store_key: &store_key };
        let answer = apply(&tx, transaction, place, &self.fold)?;
        if answer.1.seq > self.fold.end.seq {
            let root = audit::tree_after(&tx, &self.fold.tree)?.root();
            let (wall_ms, link) = (audit::wall_ms_of(&tx, answer.1.seq)?, self.link.clone());
            let end = Checkpoint::sign(&self.store_id, (answer.1, root), wall_ms, link, None, &self.key);
            chain_signature::write(&tx, &end)?;
        }
        tx.commit().map_err(sqlite_error("commit a transaction"))?;
        self.compared = written_by_others;
        // After a failure the end of the chain differs from the fold, and the next transaction is refused.
        drop(self.fold.go_on(&self.connection));
        crate::fp!("after-commit-before-ack");
        Ok(answer)
    }

    /// Writes a snapshot of the fold if the last one is old. Returns its digest.
    fn snapshot(&mut self, head: Head) -> Result<Option<Digest>, StoreError> {
        let due = head.seq >= self.snapshot_seq + snapshot::EVERY_RECORDS;
        if !due || (self.fold.end.seq, self.fold.end.hash) != (head.seq, head.hash) {
            return Ok(None);
        }
        self.snapshot_seq = head.seq;
        snapshot::write(&self.fold, &self.checkpoints)
    }

    /// Writes a checkpoint. A failure is kept for the engine to report; the records are on disk.
    fn checkpoint(&mut self, head: Head) {
        let tree = &self.fold.tree;
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
            self.link = CheckpointLink::after(Some(checkpoint));
            self.senders.send(checkpoint);
        }
        *self.checkpoint_problem.lock().unwrap_or_else(PoisonError::into_inner) =
            written.err().map(|error| error.to_string());
    }
}

/// Opens the telemetry file, or quarantines it and makes another. Returns its differences from the chain.
fn open_telemetry(
    (layout, limits): (&Layout, TelemetryLimits),
    connection: &Connection,
    fold: &Fold,
) -> Result<(TelemetryFile, StartupTelemetry), StoreError> {
    let known: BTreeSet<String> = connection
        .prepare("SELECT name FROM version")
        .and_then(|mut select| select.query_map([], |row| row.get(0))?.collect())
        .map_err(sqlite_error("read the versions"))?;
    let account = &fold.telemetry;
    let chain = ChainEvidence { account, batches: &fold.batches, connection };
    let (contents, own) = prepare_file(layout, limits, chain)?;
    let aside = unrecorded_files(layout, connection, own.as_ref())?;
    let file = TelemetryFile::open(&layout.telemetry(), limits, (&contents, account.sealed()))?;
    let is_known = |version: &CapabilityId| known.contains(&version.to_string());
    let found = file.startup_report(contents.numbers, account, aside, is_known)?;
    Ok((file, found))
}

/// Foreign writes to the database of a running engine.
enum ExternalChange {
    /// No relevant change; SQLite's count of foreign writes.
    Compared(i64),
    /// A row does not match the chain, or the database has another shape.
    Altered(String),
}

/// Compares the tables with the chain, and returns the count of [`written_by_others`] at that moment.
fn compare_tables(connection: &mut Connection, fold: &Fold) -> Result<i64, StoreError> {
    let tx = connection
        .transaction_with_behavior(TransactionBehavior::Immediate)
        .map_err(sqlite_error("begin a transaction"))?;
    match check_others(&tx, fold, None)? {
        ExternalChange::Compared(count) => Ok(count),
        ExternalChange::Altered(problem) => Err(StoreError::Altered(problem)),
    }
}

/// Compares the tables again if another program wrote since, so that a foreign change is neither read nor overwritten.
/// In a database of another shape, triggers are disabled.
fn check_others(
    connection: &Connection,
    fold: &Fold,
    compared: Option<i64>,
) -> Result<ExternalChange, StoreError> {
    let error = sqlite_error("compare the registry with the audit chain");
    let now = written_by_others(connection)?;
    if compared == Some(now) {
        return Ok(ExternalChange::Compared(now));
    }
    if let Some(problem) = first_difference(connection, &STORE).map_err(&error)? {
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER, false).map_err(&error)?;
        return Ok(ExternalChange::Altered(problem));
    }
    let fault = compare(fold, connection).map_err(&error)?;
    Ok(fault.map_or(ExternalChange::Compared(now), |fault| ExternalChange::Altered(fault.to_string())))
}

/// Signs an earlier version's end of the chain, and completes an interrupted rebuild. Returns the next checkpoint's
/// place.
fn sign_on(
    connection: &Connection,
    layout: &Layout,
    (store_id, fold): (&str, &Fold),
    key: &SigningKey,
) -> Result<CheckpointLink, StoreError> {
    let checkpoints = stored_checkpoints(layout)?;
    let newest = checkpoints.last().map(|stored| &stored.checkpoint);
    let unreadable = |problem: String| damaged(&layout.database(), &problem);
    let link = CheckpointLink::after_all(&checkpoints);
    match chain_signature::read(connection).map_err(unreadable)? {
        Some(end)
            if end.root.is_none()
                && end.link.as_ref().is_some_and(|link| link.gap)
                && newest.is_none_or(|it| it.link != end.link) =>
        {
            end.write(&layout.checkpoints())?;
            return sign_on(connection, layout, (store_id, fold), key);
        }
        found if found.as_ref().is_none_or(|end| end.root.is_none()) && fold.end.seq > 0 => {
            let tree_head = (fold.end, fold.tree.root());
            let wall_ms = audit::wall_ms_of(connection, fold.end.seq)?;
            let end = Checkpoint::sign(store_id, tree_head, wall_ms, link.clone(), None, key);
            chain_signature::write(connection, &end)?;
        }
        Some(end)
            if end.link.as_ref().is_some_and(|link| link.gap)
                && newest.is_none_or(|it| it.link != end.link) =>
        {
            end.write(&layout.checkpoints())?;
            return Ok(CheckpointLink::after(Some(&end)));
        }
        None | Some(_) => {}
    }
    Ok(link)
}
