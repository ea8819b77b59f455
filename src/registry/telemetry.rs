//! Telemetry and kept cells: a second database file that may lose its newest batches to a power cut, until they are
//! sealed; then their digests can enter the audit chain. What a cell may be believed for is [`super::kept`]'s.
//!
//! Batches are sealed in blocks: whatever waits is sealed together with the next record of any kind, or once a block
//! is full or its first batch is old. So a record never rests on telemetry that is not sealed before it.
//!
//! Bounded: the oldest batches and the cells longest unused are removed beyond the limits; batches once it is on record
//! that they go.

use std::collections::BTreeSet;
use std::path::Path;

use rusqlite::{Connection, OptionalExtension, Transaction, TransactionBehavior, params};

use super::change::{BLOCK_BATCHES_MAX, BatchReceipt, Change, GAPS_MAX};
use super::columns::parsed;
use super::error::StoreError;
use super::migrate::TELEMETRY;
use super::open::{Durability, WrittenHere, open_reader, open_writer};
use super::seals::{BatchState, FoundTelemetry, Settled, TelemetryAccount, absent};
use holdpoint_governance::ids::{CapabilityId, Digest, is_name};

/// How much the telemetry file keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TelemetryLimits {
    /// All batch bodies together, bytes.
    pub batch_bytes_max: u64,
    /// All kept cells together, bytes.
    pub cell_bytes_max: u64,
}

impl Default for TelemetryLimits {
    fn default() -> Self {
        Self { batch_bytes_max: 1 << 30, cell_bytes_max: 256 << 20 }
    }
}

/// The largest batch or cell, bytes.
pub(crate) const BODY_BYTES_MAX: usize = 4 << 20;

/// Rows of telemetry of one stream, encoded by the caller (postcard or JSON).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Batch {
    /// The version they are about.
    pub version: CapabilityId,
    /// Which stream, a name, e.g. `monitor` or `sandbox`.
    pub stream: String,
    /// Virtual time of the first row, ms.
    pub from_ms: u64,
    /// Virtual time of the last row, ms.
    pub to_ms: u64,
    /// Number of rows, at least 1.
    pub rows: u64,
    /// The rows, at most 4 MiB.
    pub body: Vec<u8>,
}

/// What an episode's result depends on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EpisodeKey {
    /// Digest of what ran.
    pub bundle: Digest,
    /// Digest of the scenario with its perturbations.
    pub scenario: Digest,
    pub seed: u64,
    /// The engine's build: name, version and whatever else changes results.
    pub engine_build: String,
}

impl EpisodeKey {
    /// What it is kept under.
    #[must_use]
    pub fn digest(&self) -> Digest {
        let seed = self.seed.to_le_bytes();
        let parts =
            [self.bundle.bytes().as_slice(), self.scenario.bytes(), &seed, self.engine_build.as_bytes()];
        Digest::of_parts("holdpoint/episode-key/v2", &parts)
    }
}

impl Batch {
    fn digest(&self) -> Digest {
        batch_digest(
            &self.version.to_string(),
            &self.stream,
            [self.from_ms, self.to_ms, self.rows],
            &self.body,
        )
    }
}

/// The digest of a batch's fields.
fn batch_digest(version: &str, stream: &str, [from_ms, to_ms, rows]: [u64; 3], body: &[u8]) -> Digest {
    let (from_ms, to_ms, rows) = (from_ms.to_le_bytes(), to_ms.to_le_bytes(), rows.to_le_bytes());
    let parts = [version.as_bytes(), stream.as_bytes(), &from_ms, &to_ms, &rows, body];
    Digest::of_parts("holdpoint/telemetry/v1", &parts)
}

#[derive(Debug)]
pub(crate) struct TelemetryFile {
    connection: Connection,
    limits: TelemetryLimits,
    /// In order, with the virtual time of the last row, ms.
    unsealed: Vec<(BatchReceipt, u64)>,
    // After the connection: fields are dropped in their order.
    _written: WrittenHere,
}

/// Batches between two seals at most; more than that is a caller that forgot to seal.
const UNSEALED_MAX: usize = 4096;
/// Batches that wait at most, where nothing else is written.
const WAITING_MAX: usize = 32;
/// How long a batch waits at most, where nothing else is written; virtual time, ms.
const WAITS_MS_MAX: u64 = 5 * 60 * 1000;

impl TelemetryFile {
    /// Opens the file; makes it if there is none.
    pub(crate) fn open(path: &Path, limits: TelemetryLimits) -> Result<Self, StoreError> {
        let (connection, written) = open_writer(path, &TELEMETRY, Durability::Normal)?;
        Ok(Self { connection, limits, unsealed: Vec::new(), _written: written })
    }

    /// Keeps a batch.
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
        let digest = batch.digest();
        // Between two seals there may be twice as much.
        let limit = self.limits.batch_bytes_max.saturating_mul(2);
        let used: u64 = self
            .connection
            .query_row("SELECT batch_bytes FROM usage", [], |row| row.get(0))
            .map_err(StoreError::sql("read telemetry"))?;
        if used > limit {
            return Err(StoreError::invalid("telemetry of", format!("{used} bytes"), "less; seal it first"));
        }
        let number = self.write("keep telemetry", |tx| {
            tx.prepare_cached(
                "INSERT INTO batch (version, stream, from_ms, to_ms, rows, digest, bytes, body)
                 VALUES (?1, ?2, ?3, ?4, ?5, ?6, length(?7), ?7)",
            )?
            .execute(params![
                batch.version.to_string(),
                batch.stream,
                batch.from_ms,
                batch.to_ms,
                batch.rows,
                digest.to_string(),
                batch.body
            ])?;
            let number = tx.last_insert_rowid();
            tx.prepare_cached("UPDATE usage SET batch_bytes = batch_bytes + ?1")?
                .execute([batch.body.len()])?;
            Ok(number)
        })?;
        let batch_number = u64::try_from(number)
            .map_err(|_| StoreError::invalid("batch number", number, "a positive one"))?;
        let receipt =
            BatchReceipt { version: batch.version.clone(), batch: batch_number, digest, rows: batch.rows };
        self.unsealed.push((receipt.clone(), batch.to_ms));
        Ok(receipt)
    }

    /// The latest virtual time of a batch that waits to be sealed, ms; `None` if none does.
    pub(crate) fn waiting(&self) -> Option<u64> {
        self.unsealed.iter().map(|(_, to_ms)| *to_ms).max()
    }

    /// Whether what waits has to be sealed now, although nothing else is written.
    pub(crate) fn is_due(&self, now_ms: u64) -> bool {
        let first = self.unsealed.first();
        self.unsealed.len() >= WAITING_MAX
            || first.is_some_and(|(_, to_ms)| now_ms.saturating_sub(*to_ms) >= WAITS_MS_MAX)
    }

    /// Forces everything to disk and returns what puts it into the audit chain; it waits until it is there.
    pub(crate) fn seal(&self) -> Result<Vec<Change>, StoreError> {
        if self.unsealed.is_empty() {
            return Ok(Vec::new());
        }
        let busy: i64 = self
            .connection
            .query_row("PRAGMA wal_checkpoint(FULL)", [], |row| row.get(0))
            .map_err(StoreError::sql("force telemetry to disk"))?;
        if busy != 0 {
            return Err(StoreError::invalid("telemetry file", "busy", "no other writer"));
        }
        let mut changes: Vec<Change> = Vec::new();
        for block in self.unsealed.chunks(BLOCK_BATCHES_MAX) {
            let batches = block.iter().map(|(receipt, _)| receipt.clone()).collect();
            changes.push(Change::SealTelemetryBlock { batches, found: false });
        }
        let through = self.over_limit().map_err(StoreError::sql("measure telemetry"))?;
        changes.extend(through.map(|through| Change::PruneTelemetry { through }));
        Ok(changes)
    }

    /// The last of the oldest batches that have to go for the others to be within the limit; the newest stays.
    fn over_limit(&self) -> rusqlite::Result<Option<u64>> {
        let used: u64 = self.connection.query_row("SELECT batch_bytes FROM usage", [], |row| row.get(0))?;
        let mut over = used.saturating_sub(self.limits.batch_bytes_max);
        if over == 0 {
            return Ok(None);
        }
        let sql = "SELECT id, bytes FROM batch WHERE id < (SELECT max(id) FROM batch) ORDER BY id";
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

    /// What these changes say is on record now: what they seal waits no more, what they remove goes.
    pub(crate) fn settle(&mut self, settled: Settled) -> Result<(), StoreError> {
        let Settled { sealed, pruned } = settled;
        self.unsealed.retain(|(receipt, _)| receipt.batch > sealed);
        if pruned == 0 {
            return Ok(());
        }
        self.write("remove old telemetry", |tx| {
            tx.execute("DELETE FROM batch WHERE id <= ?1", [pruned])?;
            tx.execute("UPDATE usage SET batch_bytes = (SELECT coalesce(sum(bytes), 0) FROM batch)", [])?;
            Ok(())
        })
    }

    /// Compares the file with what the chain says of it. Batches of versions that there are not are none of this
    /// store's, and are left out.
    pub(crate) fn found(
        &self,
        account: &TelemetryAccount,
        is_known: impl Fn(&CapabilityId) -> bool,
    ) -> Result<FoundTelemetry, StoreError> {
        let error = StoreError::sql("compare telemetry with the audit chain");
        let numbers = || -> rusqlite::Result<Vec<u64>> {
            let mut select = self.connection.prepare("SELECT id FROM batch ORDER BY id")?;
            let numbers = select.query_map([], |row| row.get(0))?;
            numbers.collect()
        };
        let there = numbers().map_err(&error)?;
        let mut changes = Vec::new();
        let oldest = there.first().copied();
        let gaps = account.gaps(&there, oldest, GAPS_MAX);
        if account.is_before_removals()
            && let Some(oldest) = oldest
        {
            changes.push(Change::PruneTelemetry { through: oldest.saturating_sub(1).min(account.sealed()) });
        }
        let missing = gaps.iter().map(|[first, last]| last - first + 1).sum();
        if !gaps.is_empty() {
            changes.push(Change::MissTelemetry { gaps });
        }
        let mut unsealed = Vec::new();
        for number in there.into_iter().filter(|number| *number > account.sealed()).take(UNSEALED_MAX) {
            let Some(batch) = self.content(number)? else { continue };
            if is_known(&batch.version) {
                let Batch { version, rows, .. } = &batch;
                let receipt = BatchReceipt {
                    version: version.clone(),
                    batch: number,
                    digest: batch.digest(),
                    rows: *rows,
                };
                unsealed.push(receipt);
            }
        }
        let count = unsealed.len() as u64;
        for block in unsealed.chunks(BLOCK_BATCHES_MAX) {
            changes.push(Change::SealTelemetryBlock { batches: block.to_vec(), found: true });
        }
        Ok(FoundTelemetry { changes, missing, unsealed: count })
    }

    /// A batch as it lies there; `None` if there is none, or it is about no version.
    fn content(&self, number: u64) -> Result<Option<Batch>, StoreError> {
        let sql = "SELECT version, stream, from_ms, to_ms, rows, body FROM batch WHERE id = ?1";
        let read = |row: &rusqlite::Row<'_>| -> rusqlite::Result<Option<Batch>> {
            let Ok(version) = row.get::<_, String>(0)?.parse() else { return Ok(None) };
            let [from_ms, to_ms, rows] = [row.get(2)?, row.get(3)?, row.get(4)?];
            Ok(Some(Batch { version, stream: row.get(1)?, from_ms, to_ms, rows, body: row.get(5)? }))
        };
        self.connection
            .prepare_cached(sql)
            .and_then(|mut select| select.query_row([number], read).optional())
            .map(Option::flatten)
            .map_err(StoreError::sql("read telemetry"))
    }

    /// A batch's rows, checked against their digest; `None` if it was removed.
    pub(crate) fn read(&self, batch: u64) -> Result<Option<Batch>, StoreError> {
        let sql = "SELECT version, stream, from_ms, to_ms, rows, digest, body FROM batch WHERE id = ?1";
        type Found = (String, Batch);
        let found: Option<Found> = self
            .connection
            .prepare_cached(sql)
            .and_then(|mut select| {
                select
                    .query_row([batch], |row| {
                        let version: String = row.get(0)?;
                        let version = version.parse().map_err(|error| {
                            rusqlite::Error::FromSqlConversionFailure(
                                0,
                                rusqlite::types::Type::Text,
                                Box::new(error),
                            )
                        })?;
                        let batch = Batch {
                            version,
                            stream: row.get(1)?,
                            from_ms: row.get(2)?,
                            to_ms: row.get(3)?,
                            rows: row.get(4)?,
                            body: row.get(6)?,
                        };
                        Ok((row.get(5)?, batch))
                    })
                    .optional()
            })
            .map_err(StoreError::sql("read telemetry"))?;
        match found {
            Some((digest, found)) if found.digest().to_string() != digest => Err(StoreError::invalid(
                "telemetry batch",
                batch,
                "unchanged; its content does not match its digest",
            )),
            Some((_, found)) => Ok(Some(found)),
            None => Ok(None),
        }
    }

    /// A kept cell as it lies there: its code and its body. Nobody may believe it for that.
    pub(crate) fn cell(&mut self, key: &Digest) -> Result<Option<(String, Vec<u8>)>, StoreError> {
        let key = key.to_string();
        self.write("read a kept cell", |tx| {
            let found: Option<(String, Vec<u8>)> = tx
                .prepare_cached("SELECT mac, body FROM cell WHERE key = ?1")?
                .query_row([&key], |row| Ok((row.get(0)?, row.get(1)?)))
                .optional()?;
            if found.is_some() {
                let tick = next_tick(tx)?;
                tx.prepare_cached("UPDATE cell SET used = ?2 WHERE key = ?1")?.execute(params![key, tick])?;
            }
            Ok(found)
        })
    }

    /// Keeps a cell with its code; removes those longest unused beyond the limit.
    pub(crate) fn put_cell(&mut self, key: &Digest, mac: &str, body: &[u8]) -> Result<(), StoreError> {
        check_body("kept cell", body, true)?;
        let key = key.to_string();
        let limit = self.limits.cell_bytes_max;
        self.write("keep a cell", |tx| {
            remove_cell(tx, &key)?;
            let tick = next_tick(tx)?;
            tx.prepare_cached(
                "INSERT INTO cell (key, mac, bytes, used, body) VALUES (?1, ?2, length(?4), ?3, ?4)",
            )?
            .execute(params![key, mac, tick, body])?;
            tx.prepare_cached("UPDATE usage SET cell_bytes = cell_bytes + ?1")?.execute([body.len()])?;
            while used(tx, "SELECT cell_bytes FROM usage")? > limit {
                let oldest: Option<String> = tx
                    .prepare_cached("SELECT key FROM cell WHERE key <> ?1 ORDER BY used LIMIT 1")?
                    .query_row([&key], |row| row.get(0))
                    .optional()?;
                match oldest {
                    Some(oldest) => remove_cell(tx, &oldest)?,
                    None => break,
                }
            }
            Ok(())
        })
    }

    /// Throws every kept cell away.
    pub(crate) fn void_cells(&mut self) -> Result<(), StoreError> {
        self.write("throw the kept cells away", |tx| {
            tx.execute("DELETE FROM cell", [])?;
            tx.execute("UPDATE usage SET cell_bytes = 0", [])?;
            Ok(())
        })
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
        run().map_err(StoreError::sql(what))
    }
}

/// What is left of a store's telemetry, to read; also while an engine has it.
#[derive(Debug)]
pub struct TelemetryViews {
    connection: Connection,
}

/// A batch with its number, or `None` where its content does not match its digest.
pub type NumberedBatch = (u64, Option<Batch>);

impl TelemetryViews {
    /// Opens a store's telemetry file for reading.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        Ok(Self { connection: open_reader(path, &TELEMETRY)? })
    }

    /// Calls `visit` with each batch of a stream up to the number `to_batch`, in order, one at a time.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn each_batch(
        &self,
        stream: &str,
        to_batch: u64,
        mut visit: impl FnMut(NumberedBatch),
    ) -> Result<(), StoreError> {
        let sql = "SELECT id, version, stream, from_ms, to_ms, rows, body, digest FROM batch
                   WHERE stream = ?1 AND id <= ?2 ORDER BY id";
        let to_batch = i64::try_from(to_batch).unwrap_or(i64::MAX);
        let mut read = || {
            let mut select = self.connection.prepare_cached(sql)?;
            let mut rows = select.query(params![stream, to_batch])?;
            while let Some(row) = rows.next()? {
                let digest: String = row.get(7)?;
                let batch = Batch {
                    version: parsed(row, 1)?,
                    stream: row.get(2)?,
                    from_ms: row.get(3)?,
                    to_ms: row.get(4)?,
                    rows: row.get(5)?,
                    body: row.get(6)?,
                };
                let matches = batch.digest().to_string() == digest;
                visit((row.get(0)?, matches.then_some(batch)));
            }
            Ok(())
        };
        read().map_err(StoreError::sql("read telemetry"))
    }

    /// The numbers of all batches that are there.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn numbers(&self) -> Result<BTreeSet<u64>, StoreError> {
        self.connection
            .prepare("SELECT id FROM batch")
            .and_then(|mut select| select.query_map([], |row| row.get(0))?.collect())
            .map_err(StoreError::sql("read telemetry"))
    }
}

fn check_body(what: &'static str, body: &[u8], has_rows: bool) -> Result<(), StoreError> {
    if body.is_empty() || body.len() > BODY_BYTES_MAX || !has_rows {
        let size = format!("of {} bytes", body.len());
        return Err(StoreError::invalid(what, size, "1 byte to 4 MiB with at least one row"));
    }
    Ok(())
}

fn used(tx: &Transaction<'_>, sql: &str) -> rusqlite::Result<u64> {
    tx.prepare_cached(sql)?.query_row([], |row| row.get(0))
}

fn next_tick(tx: &Transaction<'_>) -> rusqlite::Result<i64> {
    tx.prepare_cached("UPDATE usage SET tick = tick + 1 RETURNING tick")?.query_row([], |row| row.get(0))
}

fn remove_cell(tx: &Transaction<'_>, key: &str) -> rusqlite::Result<()> {
    let bytes: Option<i64> = tx
        .prepare_cached("DELETE FROM cell WHERE key = ?1 RETURNING bytes")?
        .query_row([key], |row| row.get(0))
        .optional()?;
    if let Some(bytes) = bytes {
        tx.prepare_cached("UPDATE usage SET cell_bytes = cell_bytes - ?1")?.execute([bytes])?;
    }
    Ok(())
}

/// Compares one batch with the digest the chain holds.
pub(crate) fn check_batch(
    connection: &Connection,
    batch: u64,
    digest: Digest,
    account: &TelemetryAccount,
) -> rusqlite::Result<BatchState> {
    let sql = "SELECT version, stream, from_ms, to_ms, rows, body FROM batch WHERE id = ?1";
    let found = connection
        .prepare_cached(sql)?
        .query_row([batch], |row| {
            let (version, stream): (String, String) = (row.get(0)?, row.get(1)?);
            let body: Vec<u8> = row.get(5)?;
            Ok(batch_digest(&version, &stream, [row.get(2)?, row.get(3)?, row.get(4)?], &body))
        })
        .optional()?;
    if let Some(found) = found {
        let bad = BatchState::Bad("its content does not match its digest in the chain");
        return Ok(if found == digest { BatchState::Matches } else { bad });
    }
    let oldest: Option<u64> = connection.query_row("SELECT min(id) FROM batch", [], |row| row.get(0))?;
    Ok(absent(account, batch, oldest))
}
