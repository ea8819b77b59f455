//! Checks the telemetry file before an engine uses it. A file of another form, or one that contradicts the audit chain,
//! is quarantined: renamed, and never removed. A new file takes over every batch that matches its seal.
//!
//! Owns the form of a telemetry file, and the names of quarantined ones.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::Path;

use rusqlite::{Connection, ErrorCode, OptionalExtension, params};
use rustix::fs::{CWD, RenameFlags, renameat_with};
use serde::Deserialize;

use crate::chain::fold::SealedBatch;
use crate::chain::telemetry_seals::{TelemetryAccount, sealed_digests};
use crate::database::migrate::{Schema, TELEMETRY, version};
use crate::database::open::{COMPANIONS, beside, check_header, damaged, make, open_sound, remove_database};
use crate::database::schema_shape::{first_difference, has_table};
use crate::telemetry::telemetry_file::{TelemetryLimits, UNSEALED_MAX, content_digest};
use crate::terms::sqlite_error::sqlite_error;
use holdpoint_audit::files::sync_folder;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::RecordKind;
use holdpoint_store::{BATCH_BYTES_MAX, Layout, QUARANTINED_MAX, QuarantinedFile, StoreError};
use holdpoint_text::file::kind_of;

/// Space in the file beyond the limits, bytes: free pages, keys, indices.
const SPARE_BYTES: u64 = 64 << 20;
/// The number of newest sealed batches, and of others selected at random, that a start compares with the chain.
const COMPARED: usize = 64;
/// Batches of one transaction when a new file takes over.
const TAKEN_AT_ONCE: usize = 64;
const NAMES_MAX: u32 = 1_000_000;
/// The longest description of a file's problem, characters.
const PROBLEM_CHARS_MAX: usize = 300;
/// Prefix and suffix of the names of quarantined files.
const NAME: (&str, &str) = ("telemetry-aside-", ".db");

/// Data from the rows of a sound telemetry file.
#[derive(Debug, Default)]
pub(crate) struct TelemetryContents {
    /// Numbers of the present batches, in order.
    pub(crate) numbers: Vec<u64>,
    /// Bytes of all batches.
    pub(crate) bytes: u64,
}

/// The chain's data, and where to read more of it.
#[derive(Clone, Copy)]
pub(crate) struct ChainEvidence<'a> {
    pub(crate) account: &'a TelemetryAccount,
    /// Seals among the records that this start reads.
    pub(crate) batches: &'a [SealedBatch],
    /// The store's database.
    pub(crate) connection: &'a Connection,
}

enum TelemetryFileState {
    Sound(TelemetryContents),
    Wrong(String),
}

/// Makes the telemetry file ready for writing. Returns its contents, and why an old file was quarantined, if so.
pub(crate) fn prepare_file(
    layout: &Layout,
    limits: TelemetryLimits,
    chain: ChainEvidence<'_>,
) -> Result<(TelemetryContents, Option<QuarantinedFile>), StoreError> {
    let path = layout.telemetry();
    let problem = match inspect_file(&path, limits, chain)? {
        TelemetryFileState::Sound(contents) => return Ok((contents, None)),
        TelemetryFileState::Wrong(problem) => problem,
    };
    // A name in the file may be of any length.
    let problem = problem.chars().take(PROBLEM_CHARS_MAX).collect();
    let part = path.with_extension("new");
    let has_part = take_over(&path, chain, &part)?;
    let file = quarantine(layout)?;
    if has_part {
        fs::rename(&part, &path).map_err(StoreError::io("rename", &part))?;
        sync_folder(layout.folder())?;
    }
    match inspect_file(&path, limits, chain)? {
        TelemetryFileState::Sound(contents) => Ok((contents, Some(QuarantinedFile { file, problem }))),
        TelemetryFileState::Wrong(problem) => Err(damaged(&path, &problem)),
    }
}

/// A problem of the file itself: `None` if it can be read and has this program's shape.
pub(crate) fn wrong_shape(connection: &Connection, schema: &Schema) -> rusqlite::Result<Option<String>> {
    let found = version(connection)?;
    if !(1..=schema.newest()).contains(&found) {
        return Ok(Some(format!("its schema is {found}, this program knows 1 to {}", schema.newest())));
    }
    first_difference(connection, schema)
}

fn inspect_file(
    path: &Path,
    limits: TelemetryLimits,
    chain: ChainEvidence<'_>,
) -> Result<TelemetryFileState, StoreError> {
    let wrong = |problem: &str| Ok(TelemetryFileState::Wrong(problem.to_owned()));
    for ending in COMPANIONS {
        let companion = beside(path, ending);
        match fs::symlink_metadata(&companion) {
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(StoreError::io("read", &companion)(error)),
            Ok(found) if !found.is_file() => {
                let kind = kind_of(&found);
                return wrong(&format!("beside it, telemetry.db{ending} is {kind}, and no file of its own"));
            }
            // The index of a log holds no data, and neither does an empty log.
            Ok(found) if ending != "-shm" && found.len() > 0 && fs::symlink_metadata(path).is_err() => {
                return wrong(&format!("it is gone, and telemetry.db{ending} is still there"));
            }
            Ok(_) => {}
        }
    }
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            return Ok(TelemetryFileState::Sound(TelemetryContents::default()));
        }
        Err(error) => return Err(StoreError::io("read", path)(error)),
        Ok(found) if !found.is_file() => {
            return wrong(&format!("it is {}, and no file of its own", kind_of(&found)));
        }
        Ok(found) if found.len() > bytes_max(limits) => {
            return wrong(&format!(
                "it has {} bytes, and no engine writes more than {}",
                found.len(),
                bytes_max(limits)
            ));
        }
        Ok(_) => {}
    }
    match check_header(path, &TELEMETRY) {
        Err(StoreError::Refused { problem, .. }) => return Ok(TelemetryFileState::Wrong(problem)),
        Err(error) => return Err(error),
        Ok(()) => {}
    }
    let connection = match open_sound(path) {
        Ok(connection) => connection,
        Err(error) => return of_file(error).map(TelemetryFileState::Wrong),
    };
    match read_contents(&connection, limits, chain) {
        Ok(Ok(contents)) => Ok(TelemetryFileState::Sound(contents)),
        Ok(Err(problem)) => Ok(TelemetryFileState::Wrong(problem)),
        Err(error) => of_file(error).map(TelemetryFileState::Wrong),
    }
}

fn bytes_max(limits: TelemetryLimits) -> u64 {
    // Between two seals there may be twice as much, and removed pages stay in the file.
    limits.batch_bytes_max.saturating_add(limits.cell_bytes_max).saturating_mul(4).saturating_add(SPARE_BYTES)
}

/// Describes an error of the file itself. A failing disk, a lock or a missing permission is not one.
fn of_file(error: rusqlite::Error) -> Result<String, StoreError> {
    match error.sqlite_error_code() {
        None | Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase | ErrorCode::Unknown) => {
            Ok(format!("it cannot be read: {error}"))
        }
        Some(_) => Err(sqlite_error("read its telemetry")(error)),
    }
}

fn read_contents(
    connection: &Connection,
    limits: TelemetryLimits,
    chain: ChainEvidence<'_>,
) -> rusqlite::Result<Result<TelemetryContents, String>> {
    if let Some(problem) = wrong_shape(connection, &TELEMETRY)? {
        return Ok(Err(problem));
    }
    let sealed = chain.account.sealed();
    let mut contents = TelemetryContents::default();
    let (mut next, mut unsealed_bytes) = (sealed.saturating_add(1), 0_u64);
    let mut select = connection.prepare("SELECT id, length(body) FROM batch ORDER BY id")?;
    let mut rows = select.query([])?;
    while let Some(row) = rows.next()? {
        let (number, bytes): (i64, i64) = (row.get(0)?, row.get(1)?);
        let (Ok(number), Ok(bytes)) = (u64::try_from(number), u64::try_from(bytes)) else {
            return Ok(Err(format!("it has a batch {number}")));
        };
        if number == 0 || bytes > BATCH_BYTES_MAX as u64 {
            return Ok(Err(format!("it has a batch {number} of {bytes} bytes")));
        }
        if number > sealed {
            // An engine numbers without a gap.
            if number != next {
                return Ok(Err(format!(
                    "it has a batch {number}, and the audit chain ends at batch {sealed}"
                )));
            }
            next = next.saturating_add(1);
            unsealed_bytes = unsealed_bytes.saturating_add(bytes);
            let count = number - sealed;
            if count > UNSEALED_MAX as u64 || unsealed_bytes > limits.batch_bytes_max.saturating_mul(2) {
                return Ok(Err(format!("it has {count} unsealed batches, {unsealed_bytes} bytes")));
            }
        }
        contents.numbers.push(number);
        contents.bytes = contents.bytes.saturating_add(bytes);
    }
    for SealedBatch { seq, batch, digest } in compared(chain.batches) {
        if content_digest(connection, batch)?.is_some_and(|found| found != digest) {
            return Ok(Err(format!("its batch {batch} is not what audit record {seq} sealed")));
        }
    }
    Ok(Ok(contents))
}

/// The newest batches, and unpredictable others.
fn compared(batches: &[SealedBatch]) -> Vec<SealedBatch> {
    let (older, newest) = batches.split_at(batches.len().saturating_sub(COMPARED));
    let mut chosen = newest.to_vec();
    let mut places = BTreeSet::new();
    let mut drawn = [0_u8; COMPARED * 8];
    if !older.is_empty() && getrandom::fill(&mut drawn).is_ok() {
        for number in drawn.chunks_exact(8) {
            let number = number.iter().fold(0_u64, |number, byte| (number << 8) | u64::from(*byte));
            // Uneven by less than 2^-32 for every number of batches that fits into memory.
            places.insert(usize::try_from(number % older.len() as u64).unwrap_or(0));
        }
    }
    chosen.extend(places.into_iter().filter_map(|place| older.get(place)));
    chosen
}

/// Fills a new file with every batch that matches its seal; unreadable ones are absent. Returns whether there is one.
fn take_over(path: &Path, chain: ChainEvidence<'_>, part: &Path) -> Result<bool, StoreError> {
    let is_file = fs::symlink_metadata(path).is_ok_and(|found| found.is_file())
        && COMPANIONS.iter().all(|ending| {
            fs::symlink_metadata(beside(path, ending)).map_or(true, |companion| companion.is_file())
        });
    let Some(source) = is_file.then(|| open_sound(path).ok()).flatten() else { return Ok(false) };
    // A table of another shape may be anything, even a view with endless rows.
    if !has_table(&source, &TELEMETRY, "batch").unwrap_or(false) {
        return Ok(false);
    }
    let error = sqlite_error("take over telemetry");
    let sealed = sealed_digests(chain.connection).map_err(&error)?;
    remove_database(part)?;
    let mut into = make(part, &TELEMETRY)?;
    let wanted: Vec<(u64, Digest)> =
        sealed.into_iter().filter(|(number, _)| !chain.account.is_pruned(*number, None)).collect();
    for some in wanted.chunks(TAKEN_AT_ONCE) {
        let tx = into.transaction().map_err(&error)?;
        for (number, digest) in some {
            if content_digest(&source, *number).ok().flatten() == Some(*digest)
                && let Ok(Some(row)) = stored_batch(&source, *number)
            {
                let StoredBatchRow { version, stream, from_ms, to_ms, rows, body } = row;
                tx.prepare_cached(
                    "INSERT INTO batch (id, version, stream, from_ms, to_ms, rows, digest, bytes, body)
                     VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, length(?8), ?8)",
                )
                .and_then(|mut insert| {
                    let digest = digest.to_string();
                    insert.execute(params![number, version, stream, from_ms, to_ms, rows, digest, body])
                })
                .map_err(&error)?;
            }
        }
        tx.commit().map_err(&error)?;
    }
    into.close().map_err(|(_, source)| error(source))?;
    File::open(part).and_then(|file| file.sync_all()).map_err(StoreError::io("write", part))?;
    Ok(true)
}

/// The columns of a batch, unchecked.
struct StoredBatchRow {
    version: String,
    stream: String,
    from_ms: i64,
    to_ms: i64,
    rows: i64,
    body: Vec<u8>,
}

fn stored_batch(connection: &Connection, number: u64) -> rusqlite::Result<Option<StoredBatchRow>> {
    connection
        .prepare_cached("SELECT version, stream, from_ms, to_ms, rows, body FROM batch WHERE id = ?1")?
        .query_row([number], |row| {
            let (version, stream, from_ms) = (row.get(0)?, row.get(1)?, row.get(2)?);
            Ok(StoredBatchRow {
                version,
                stream,
                from_ms,
                to_ms: row.get(3)?,
                rows: row.get(4)?,
                body: row.get(5)?,
            })
        })
        .optional()
}

/// Renames the file and its companion files to an unused name, and returns that name.
fn quarantine(layout: &Layout) -> Result<String, StoreError> {
    let path = layout.telemetry();
    let is_free = |name: &Path| {
        let companions = COMPANIONS.iter().map(|ending| beside(name, ending));
        companions.chain([name.to_owned()]).all(|name| fs::symlink_metadata(name).is_err())
    };
    let named = |nth: u32| format!("{}{nth}{}", NAME.0, NAME.1);
    let name = (1..=NAMES_MAX).map(named).find(|name| is_free(&layout.folder().join(name)));
    let name = name.ok_or_else(|| {
        StoreError::invalid("quarantined telemetry", NAMES_MAX, "fewer; move some of it elsewhere")
    })?;
    let to = layout.folder().join(&name);
    // A new file must never find the log of another one beside it, so the logs go first.
    let moves = COMPANIONS.iter().map(|ending| (beside(&path, ending), beside(&to, ending)));
    for (from, to) in moves.chain([(path.clone(), to.clone())]) {
        match renameat_with(CWD, &from, CWD, &to, RenameFlags::NOREPLACE) {
            Ok(()) | Err(rustix::io::Errno::NOENT) => {}
            Err(error) => return Err(StoreError::io("quarantine", &from)(error.into())),
        }
    }
    sync_folder(layout.folder())?;
    Ok(name)
}

#[derive(Deserialize)]
struct MissedBatchesBody {
    change: MissedBatchesChange,
}

#[derive(Deserialize)]
struct MissedBatchesChange {
    #[serde(default)]
    aside: Vec<QuarantinedFile>,
}

/// Quarantined files that no record names yet; the problem of this start's own one is known.
pub(crate) fn unrecorded_files(
    layout: &Layout,
    connection: &Connection,
    own: Option<&QuarantinedFile>,
) -> Result<Vec<QuarantinedFile>, StoreError> {
    let mut there: BTreeMap<u32, String> = BTreeMap::new();
    let folder = layout.folder();
    for entry in fs::read_dir(folder).map_err(StoreError::io("list", folder))? {
        let name = entry.map_err(StoreError::io("list", folder))?.file_name();
        let Some(name) = name.to_str() else { continue };
        // A log or an index alone is not a quarantined file.
        if is_quarantine_name(name)
            && let Some(Ok(nth)) = nth_of(name).map(str::parse)
        {
            there.insert(nth, name.to_owned());
        }
    }
    // If only the log of a missing file existed, it alone was quarantined.
    if let Some(own) = own
        && let Some(Ok(nth)) = nth_of(&own.file).map(str::parse)
    {
        there.insert(nth, own.file.clone());
    }
    if there.is_empty() {
        return Ok(Vec::new());
    }
    let error = sqlite_error("read the records of quarantined files");
    let mut select = connection.prepare("SELECT body FROM audit WHERE kind = ?1").map_err(&error)?;
    let bodies: rusqlite::Result<Vec<String>> = select
        .query_map([RecordKind::TelemetryMissed.to_string()], |row| row.get(0))
        .and_then(Iterator::collect);
    let mut named: BTreeSet<String> = BTreeSet::new();
    for body in bodies.map_err(&error)? {
        if let Ok(MissedBatchesBody { change }) = serde_json::from_str(&body) {
            named.extend(change.aside.into_iter().map(|aside| aside.file));
        }
    }
    let unnamed = there.into_values().filter(|file| !named.contains(file)).take(QUARANTINED_MAX);
    let files = unnamed.map(|file| {
        own.filter(|own| own.file == file).cloned().unwrap_or_else(|| QuarantinedFile {
            file,
            problem: "no record says why it is there: an earlier start was cut off, or another program put it there"
                .to_owned(),
        })
    });
    Ok(files.collect())
}

fn nth_of(name: &str) -> Option<&str> {
    name.strip_prefix(NAME.0).and_then(|rest| rest.strip_suffix(NAME.1))
}

/// Whether a name is exactly that of a quarantined file.
pub(crate) fn is_quarantine_name(name: &str) -> bool {
    nth_of(name)
        .and_then(|nth| nth.parse().ok().filter(|number: &u32| number.to_string() == nth))
        .is_some_and(|number| (1..=NAMES_MAX).contains(&number))
}
