//! Telemetry and cached results: a second database file, whose newest batches a power cut may lose until they are
//! sealed and their digests enter the audit chain. [`ResultCache`](holdpoint_store::ResultCache) authenticates cached results.
//!
//! Batches are sealed in blocks: together with the next record of any kind, or once a block is full or its first batch
//! is old. So every record rests on telemetry that was sealed before it.
//!
//! Bounded: beyond the limits the oldest batches, once their removal is on record, and the least recently used cells
//! are removed.

use std::path::Path;

use rusqlite::config::DbConfig;
use rusqlite::{Connection, OptionalExtension, Row, Transaction, TransactionBehavior, params};

use crate::chain::telemetry_seals::{BatchState, SealProgress, TelemetryAccount, absent};
use crate::database::migrate::TELEMETRY;
use crate::database::open::{Durability, WriterGuard, open_writer};
use crate::telemetry::telemetry_quarantine::TelemetryContents;
use crate::terms::sqlite_error::sqlite_error;
use holdpoint_governance::ids::{CapabilityId, Digest, is_name};
use holdpoint_store::{
    BATCH_BYTES_MAX, BLOCK_BATCHES_MAX, Batch, BatchReceipt, Change, GAPS_MAX, QuarantinedFile,
    StartupTelemetry, StoreError,
};

/// How much the telemetry file keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TelemetryLimits {
    /// All batch bodies together, bytes.
    pub batch_bytes_max: u64,
    /// All cached results together, bytes.
    pub cell_bytes_max: u64,
}

impl Default for TelemetryLimits {
    fn default() -> Self {
        Self { batch_bytes_max: 1 << 30, cell_bytes_max: 256 << 20 }
    }
}

fn digest_of(batch: &Batch) -> Digest {
    let numbers = [batch.from_ms, batch.to_ms, batch.rows];
    batch_digest(&batch.version.to_string(), &batch.stream, numbers, &batch.body)
}

fn batch_digest(version: &str, stream: &str, [from_ms, to_ms, rows]: [u64; 3], body: &[u8]) -> Digest {
    let (from_ms, to_ms, rows) = (from_ms.to_le_bytes(), to_ms.to_le_bytes(), rows.to_le_bytes());
    let parts = [version.as_bytes(), stream.as_bytes(), &from_ms, &to_ms, &rows, body];
    Digest::of_parts("holdpoint/telemetry/v1", &parts)
}

#[derive(Debug)]
pub(crate) struct TelemetryFile {
    connection: Connection,
    limits: TelemetryLimits,
    /// Number of the next batch: from the chain and the rows, not from a stored counter.
    next: u64,
    batch_bytes: u64,
    /// Of the cached results, once requested.
    cells: Option<CacheUsage>,
    /// In order, with the virtual time of the last row, ms.
    unsealed: Vec<(BatchReceipt, u64)>,
    // After the connection: fields are dropped in their order.
    _written: WriterGuard,
}

#[derive(Clone, Copy, Debug)]
struct CacheUsage {
    /// Bytes of all of them.
    bytes: u64,
    /// When the last one was used, in uses.
    tick: i64,
}

/// The most batches between two seals; a caller with more forgot to seal.
pub(crate) const UNSEALED_MAX: usize = 4096;
/// The most pending batches if nothing else is written.
const WAITING_MAX: usize = 32;
/// The longest wait of a batch if nothing else is written; virtual time, ms.
const WAITS_MS_MAX: u64 = 5 * 60 * 1000;

impl TelemetryFile {
    /// Opens the checked file with these contents; makes it if there is none. `sealed` is the last batch of the chain.
    pub(crate) fn open(
        path: &Path,
        limits: TelemetryLimits,
        (contents, sealed): (&TelemetryContents, u64),
    ) -> Result<Self, StoreError> {
        let (connection, written) = open_writer(path, &TELEMETRY, Durability::Normal)?;
        // Triggers added while it is open have no effect either.
        for config in [DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER, DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW] {
            connection.set_db_config(config, false).map_err(sqlite_error("set up its database"))?;
        }
        let last = contents.numbers.last().copied().unwrap_or(0).max(sealed);
        Ok(Self {
            connection,
            limits,
            next: last.saturating_add(1),
            batch_bytes: contents.bytes,
            cells: None,
            unsealed: Vec::new(),
            _written: written,
        })
    }

    pub(crate) fn append(&mut self, batch: &Batch) -> Result<BatchReceipt, StoreError> {
        check_body("telemetry batch", &batch.body, batch.rows > 0)?;
        if !is_name(&batch.stream) {
            return Err(StoreError::invalid(
                "telemetry stream",
                &batch.stream,
                "a name: a-z, 0-9, '.', '_', '-'",
            ));
        }
        if batch.to_ms < batch.from_ms
            || i64::try_from(batch.to_ms).is_err()
            || i64::try_from(batch.rows).is_err()
        {
            return Err(StoreError::invalid("telemetry batch to", batch.to_ms, "not before its start"));
        }
        if self.unsealed.len() >= UNSEALED_MAX {
            return Err(StoreError::invalid("unsealed batches", UNSEALED_MAX, "fewer; seal them first"));
        }
        let digest = digest_of(batch);
        // Between two seals there may be twice as much.
        let limit = self.limits.batch_bytes_max.saturating_mul(2);
        if self.batch_bytes > limit {
            let used = format!("{} bytes", self.batch_bytes);
            return Err(StoreError::invalid("telemetry of", used, "less; seal it first"));
        }
        let number = self.next;
        if i64::try_from(number).is_err() {
            return Err(StoreError::invalid("batch number", number, "at most 2^63-1"));
        }
        self.write("keep telemetry", |tx| {
            tx.prepare_cached(
                "INSERT INTO batch (id, version, stream, from_ms, to_ms, rows, digest, bytes, body)
                 VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, length(?8), ?8)",
            )?
            .execute(params![
                number,
                batch.version.to_string(),
                batch.stream,
                batch.from_ms,
                batch.to_ms,
                batch.rows,
                digest.to_string(),
                batch.body
            ])
        })?;
        self.next = number.saturating_add(1);
        self.batch_bytes = self.batch_bytes.saturating_add(batch.body.len() as u64);
        let receipt =
            BatchReceipt { version: batch.version.clone(), batch: number, digest, rows: batch.rows };
        self.unsealed.push((receipt.clone(), batch.to_ms));
        Ok(receipt)
    }

    /// The latest virtual time of a pending batch, ms; `None` without one.
    pub(crate) fn waiting(&self) -> Option<u64> {
        self.unsealed.iter().map(|(_, to_ms)| *to_ms).max()
    }

    /// Whether pending batches must be sealed now, although nothing else is written.
    pub(crate) fn is_due(&self, now_ms: u64) -> bool {
        let first = self.unsealed.first();
        self.unsealed.len() >= WAITING_MAX
            || first.is_some_and(|(_, to_ms)| now_ms.saturating_sub(*to_ms) >= WAITS_MS_MAX)
    }

    /// Flushes everything and returns the changes that put it into the audit chain; batches stay pending until then.
    pub(crate) fn seal(&self) -> Result<Vec<Change>, StoreError> {
        if self.unsealed.is_empty() {
            return Ok(Vec::new());
        }
        let busy: i64 = self
            .connection
            .query_row("PRAGMA wal_checkpoint(FULL)", [], |row| row.get(0))
            .map_err(sqlite_error("force telemetry to disk"))?;
        if busy != 0 {
            return Err(StoreError::invalid("telemetry file", "busy", "no other writer"));
        }
        let mut changes: Vec<Change> = Vec::new();
        for block in self.unsealed.chunks(BLOCK_BATCHES_MAX) {
            let batches = block.iter().map(|(receipt, _)| receipt.clone()).collect();
            changes.push(Change::SealTelemetryBlock { batches, found: false });
        }
        let through = self.over_limit().map_err(sqlite_error("measure telemetry"))?;
        changes.extend(through.map(|through| Change::PruneTelemetry { through }));
        Ok(changes)
    }

    /// The last of the oldest batches to remove for the size limit; the newest stays.
    fn over_limit(&self) -> rusqlite::Result<Option<u64>> {
        let mut over = self.batch_bytes.saturating_sub(self.limits.batch_bytes_max);
        if over == 0 {
            return Ok(None);
        }
        let sql = "SELECT id, length(body) FROM batch WHERE id < (SELECT max(id) FROM batch) ORDER BY id";
        let mut select = self.connection.prepare_cached(sql)?;
        let mut rows = select.query([])?;
        let mut through = None;
        while over > 0
            && let Some(row) = rows.next()?
        {
            through = Some(row.get(0)?);
            over = over.saturating_sub(row.get(1)?);
        }
        Ok(through)
    }

    /// These changes are on record: sealed batches are no longer pending, and removed ones are deleted.
    pub(crate) fn settle(&mut self, settled: SealProgress) -> Result<(), StoreError> {
        let SealProgress { sealed, pruned } = settled;
        self.unsealed.retain(|(receipt, _)| receipt.batch > sealed);
        if pruned == 0 {
            return Ok(());
        }
        let removed: u64 = self.write("remove old telemetry", |tx| {
            let sum = "SELECT coalesce(sum(length(body)), 0) FROM batch WHERE id <= ?1";
            let removed = tx.query_row(sum, [pruned], |row| row.get(0))?;
            tx.execute("DELETE FROM batch WHERE id <= ?1", [pruned])?;
            Ok(removed)
        })?;
        self.batch_bytes = self.batch_bytes.saturating_sub(removed);
        Ok(())
    }

    /// Compares the file with the chain's records about it. Batches of unknown versions are not this store's, and are
    /// left out.
    pub(crate) fn startup_report(
        &self,
        there: Vec<u64>,
        account: &TelemetryAccount,
        aside: Vec<QuarantinedFile>,
        is_known: impl Fn(&CapabilityId) -> bool,
    ) -> Result<StartupTelemetry, StoreError> {
        let mut changes = Vec::new();
        let oldest = there.first().copied();
        let gaps = account.gaps(&there, oldest, GAPS_MAX);
        if account.is_before_removals()
            && let Some(oldest) = oldest
        {
            changes.push(Change::PruneTelemetry { through: oldest.saturating_sub(1).min(account.sealed()) });
        }
        let missing = gaps.iter().fold(0_u64, |sum, [first, last]| {
            sum.saturating_add(last.saturating_sub(*first).saturating_add(1))
        });
        if !gaps.is_empty() || !aside.is_empty() {
            changes.push(Change::MissTelemetry { gaps, aside: aside.clone() });
        }
        let mut unsealed = Vec::new();
        for number in there.into_iter().filter(|number| *number > account.sealed()).take(UNSEALED_MAX) {
            let Some(batch) = self.content(number)? else { continue };
            if is_known(&batch.version) {
                let Batch { version, rows, .. } = &batch;
                let receipt = BatchReceipt {
                    version: version.clone(),
                    batch: number,
                    digest: digest_of(&batch),
                    rows: *rows,
                };
                unsealed.push(receipt);
            }
        }
        let count = unsealed.len() as u64;
        for block in unsealed.chunks(BLOCK_BATCHES_MAX) {
            changes.push(Change::SealTelemetryBlock { batches: block.to_vec(), found: true });
        }
        Ok(StartupTelemetry { changes, missing, unsealed: count, aside })
    }

    /// A batch's row; `None` if there is none, or no engine wrote it.
    fn content(&self, number: u64) -> Result<Option<Batch>, StoreError> {
        let sql = "SELECT version, stream, from_ms, to_ms, rows, body FROM batch WHERE id = ?1";
        let read = |row: &rusqlite::Row<'_>| -> rusqlite::Result<Option<Batch>> {
            let Ok(version) = row.get::<_, String>(0)?.parse() else { return Ok(None) };
            let (Ok(from_ms), Ok(to_ms), Ok(rows)) = (row.get(2), row.get(3), row.get(4)) else {
                return Ok(None);
            };
            Ok(Some(Batch { version, stream: row.get(1)?, from_ms, to_ms, rows, body: row.get(5)? }))
        };
        self.connection
            .prepare_cached(sql)
            .and_then(|mut select| select.query_row([number], read).optional())
            .map(Option::flatten)
            .map_err(sqlite_error("read telemetry"))
    }

    /// A cached cell's row: its MAC and its body, not yet authenticated.
    pub(crate) fn cell(&mut self, key: &Digest) -> Result<Option<(String, Vec<u8>)>, StoreError> {
        let key = key.to_string();
        let mut known = self.cell_use()?;
        let found = self.write("read a cached result", |tx| {
            let found: Option<(String, Vec<u8>)> = tx
                .prepare_cached("SELECT mac, body FROM cell WHERE key = ?1")?
                .query_row([&key], |row| Ok((row.get(0)?, row.get(1)?)))
                .optional()?;
            if found.is_some() {
                known.tick += 1;
                let sql = "UPDATE cell SET used = ?2 WHERE key = ?1";
                tx.prepare_cached(sql)?.execute(params![key, known.tick])?;
            }
            Ok(found)
        })?;
        self.cells = Some(known);
        Ok(found)
    }

    /// Stores a cell with its MAC; removes the least recently used beyond the limit.
    pub(crate) fn put_cell(&mut self, key: &Digest, mac: &str, body: &[u8]) -> Result<(), StoreError> {
        check_body("cached result", body, true)?;
        let key = key.to_string();
        let limit = self.limits.cell_bytes_max;
        let mut known = self.cell_use()?;
        self.write("keep a cell", |tx| {
            known.bytes = known.bytes.saturating_sub(remove_cell(tx, &key)?);
            known.tick += 1;
            tx.prepare_cached(
                "INSERT INTO cell (key, mac, bytes, used, body) VALUES (?1, ?2, length(?4), ?3, ?4)",
            )?
            .execute(params![key, mac, known.tick, body])?;
            known.bytes = known.bytes.saturating_add(body.len() as u64);
            while known.bytes > limit {
                let oldest: Option<String> = tx
                    .prepare_cached("SELECT key FROM cell WHERE key <> ?1 ORDER BY used LIMIT 1")?
                    .query_row([&key], |row| row.get(0))
                    .optional()?;
                match oldest {
                    Some(oldest) => known.bytes = known.bytes.saturating_sub(remove_cell(tx, &oldest)?),
                    None => break,
                }
            }
            Ok(())
        })?;
        self.cells = Some(known);
        Ok(())
    }

    /// Usage of the cached results. Read once: only this process writes cells.
    fn cell_use(&mut self) -> Result<CacheUsage, StoreError> {
        if let Some(known) = self.cells {
            return Ok(known);
        }
        let mut known: CacheUsage = self.write("count the cached results", |tx| {
            let sql = "SELECT coalesce(sum(length(body)), 0), coalesce(max(used), 0) FROM cell";
            tx.query_row(sql, [], |row| Ok(CacheUsage { bytes: row.get(0)?, tick: row.get(1)? }))
        })?;
        if known.tick < 0 || known.tick > i64::MAX / 2 {
            // No engine reaches this count: the file was edited.
            self.write("count the cached results", |tx| tx.execute("UPDATE cell SET used = 0", []))?;
            known.tick = 0;
        }
        self.cells = Some(known);
        Ok(known)
    }

    /// Deletes every cached result.
    pub(crate) fn void_cells(&mut self) -> Result<(), StoreError> {
        self.write("delete the cached results", |tx| tx.execute("DELETE FROM cell", []))?;
        self.cells = None;
        Ok(())
    }

    fn write<T>(
        &mut self,
        what: &'static str,
        change: impl FnOnce(&Transaction<'_>) -> rusqlite::Result<T>,
    ) -> Result<T, StoreError> {
        let run = || {
            let tx = self.connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            let answer = change(&tx)?;
            tx.commit()?;
            Ok(answer)
        };
        run().map_err(sqlite_error(what))
    }
}

fn check_body(what: &'static str, body: &[u8], has_rows: bool) -> Result<(), StoreError> {
    if body.is_empty() || body.len() > BATCH_BYTES_MAX || !has_rows {
        let size = format!("of {} bytes", body.len());
        return Err(StoreError::invalid(what, size, "1 byte to 4 MiB with at least one row"));
    }
    Ok(())
}

fn remove_cell(tx: &Transaction<'_>, key: &str) -> rusqlite::Result<u64> {
    let bytes: Option<u64> = tx
        .prepare_cached("DELETE FROM cell WHERE key = ?1 RETURNING length(body)")?
        .query_row([key], |row| row.get(0))
        .optional()?;
    Ok(bytes.unwrap_or(0))
}

/// Digest of a batch's row; `None` if there is no such batch.
pub(crate) fn content_digest(connection: &Connection, batch: u64) -> rusqlite::Result<Option<Digest>> {
    let sql = format!("{STORED_BATCH_SQL} WHERE id = ?1");
    connection.prepare_cached(&sql)?.query_row([batch], stored_digest).optional()
}

/// The hashed fields of a batch, and the longest accepted body: no engine writes a longer one.
pub(crate) const STORED_BATCH_SQL: &str = "SELECT id, version, stream, from_ms, to_ms, rows,
    CASE WHEN length(body) <= 4194304 THEN body ELSE x'' END FROM batch";
const _: () = assert!(BATCH_BYTES_MAX == 4_194_304);

/// The digest of a row of [`STORED_BATCH_SQL`].
pub(crate) fn stored_digest(row: &Row<'_>) -> rusqlite::Result<Digest> {
    let number = |column: usize| row.get::<_, i64>(column).map(i64::cast_unsigned);
    let (version, stream) = (row.get_ref(1)?.as_str()?, row.get_ref(2)?.as_str()?);
    Ok(batch_digest(version, stream, [number(3)?, number(4)?, number(5)?], row.get_ref(6)?.as_blob()?))
}

/// Compares one batch with the digest the chain holds.
pub(crate) fn check_batch(
    connection: &Connection,
    batch: u64,
    digest: Digest,
    account: &TelemetryAccount,
) -> rusqlite::Result<BatchState> {
    let found = content_digest(connection, batch)?;
    if let Some(found) = found {
        let bad = BatchState::Bad("its content does not match its digest in the chain");
        return Ok(if found == digest { BatchState::Matches } else { bad });
    }
    let oldest: Option<u64> = connection.query_row("SELECT min(id) FROM batch", [], |row| row.get(0))?;
    Ok(absent(account, batch, oldest))
}
