//! Opens a database file, or refuses it without touching it.
//!
//! A foreign, newer, truncated or damaged file gives one error and stays unchanged. A new file is made under another
//! name and renamed when it is whole, so that a crash leaves either no store or a complete one.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{ErrorKind, Read};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use rusqlite::config::DbConfig;
use rusqlite::{Connection, OpenFlags};

use crate::database::migrate::{Schema, migrate};
use crate::terms::row_limit;
use crate::terms::sqlite_error::{is_disk_full, sqlite_error};
use holdpoint_audit::files::sync_folder;
use holdpoint_store::{RefusalCause, StoreError};
use holdpoint_text::file::kind_of;

/// The oldest SQLite without the WAL-reset bug.
const SQLITE_MIN: i32 = 3_051_003;
/// Bytes of an SQLite file header.
const HEADER_BYTES: usize = 100;

/// How strictly a database is flushed to disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Durability {
    /// Every commit survives power loss.
    Full,
    /// A power loss may take the newest commits, never the file.
    Normal,
}

/// Opens a database for writing; makes it if there is none. Drop the mark after the connection.
pub(crate) fn open_writer(
    path: &Path,
    schema: &Schema,
    durability: Durability,
) -> Result<(Connection, WriterGuard), StoreError> {
    check_library()?;
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => create(path, schema)?,
        Err(error) => return Err(StoreError::io("read", path)(error)),
        Ok(_) => inspect(path, schema)?,
    }
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let mut connection =
        Connection::open_with_flags(path, flags).map_err(sqlite_error("open its database"))?;
    configure(&connection)?;
    set(&connection, "journal_mode", "wal", "wal")?;
    match durability {
        Durability::Full => set(&connection, "synchronous", "FULL", "2")?,
        Durability::Normal => set(&connection, "synchronous", "NORMAL", "1")?,
    }
    set(&connection, "wal_autocheckpoint", "1000", "1000")?;
    set(&connection, "journal_size_limit", "67108864", "67108864")?;
    migrate(&mut connection, schema)?;
    Ok((connection, WriterGuard::mark(path)))
}

/// Opens a database for reading only. The file is checked first and never written.
pub(crate) fn open_reader(path: &Path, schema: &Schema) -> Result<Connection, StoreError> {
    check_library()?;
    // Closing any descriptor of a file drops all locks of the process on it (POSIX), SQLite's too. A file that is open
    // for writing here is therefore checked through SQLite alone; its header was checked when it was opened.
    if !file_id(path).is_some_and(|id| written_here().contains(&id)) {
        check_header(path, schema)?;
    }
    open_beside(path)
}

/// Opens a second connection for reading, beside one of [`open_reader`]. Does not open the file itself, which would
/// drop that connection's locks.
pub(crate) fn open_beside(path: &Path) -> Result<Connection, StoreError> {
    let connection = open_read_only(path)?;
    set(&connection, "query_only", "1", "1")?;
    Ok(connection)
}

/// Copies a database, at one moment, into a new file.
pub(crate) fn copy_into(path: &Path, schema: &Schema, to: &Path) -> Result<(), StoreError> {
    check_library()?;
    if !file_id(path).is_some_and(|id| written_here().contains(&id)) {
        check_header(path, schema)?;
    }
    let connection = open_read_only(path)?;
    let name = to.to_str().ok_or_else(|| StoreError::invalid("copy", to.display(), "a name in UTF-8"))?;
    connection.execute("VACUUM INTO ?1", [name]).map(drop).map_err(sqlite_error("copy its database"))
}

/// Device and number of a file.
pub(crate) type FileId = (u64, u64);

pub(crate) fn file_id(path: &Path) -> Option<FileId> {
    fs::symlink_metadata(path).ok().map(|found| (found.dev(), found.ino()))
}

/// Databases that this process has open for writing.
static WRITTEN: Mutex<BTreeSet<FileId>> = Mutex::new(BTreeSet::new());

fn written_here() -> MutexGuard<'static, BTreeSet<FileId>> {
    WRITTEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A database is open for writing in this process while this value lives.
#[derive(Debug)]
pub(crate) struct WriterGuard(Option<FileId>);

impl WriterGuard {
    fn mark(path: &Path) -> Self {
        let id = file_id(path);
        written_here().extend(id);
        Self(id)
    }
}

impl Drop for WriterGuard {
    fn drop(&mut self) {
        if let Some(id) = self.0 {
            written_here().remove(&id);
        }
    }
}

/// Refuses a library with the known corruption bug.
fn check_library() -> Result<(), StoreError> {
    if rusqlite::version_number() < SQLITE_MIN {
        return Err(StoreError::invalid("SQLite version", rusqlite::version(), "3.51.3 or newer"));
    }
    Ok(())
}

fn open_read_only(path: &Path) -> Result<Connection, StoreError> {
    let connection = read_only(path).map_err(|error| {
        if is_disk_full(&error) {
            sqlite_error("open its database")(error)
        } else {
            damaged(path, &row_limit::error_message(&error))
        }
    })?;
    configure(&connection)?;
    Ok(connection)
}

/// Opens a database for reading only, with SQLite's own error; the caller has checked its header.
pub(crate) fn open_sound(path: &Path) -> rusqlite::Result<Connection> {
    let connection = read_only(path)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW, false)?;
    connection
        .execute_batch("PRAGMA cell_size_check = 1; PRAGMA query_only = 1; PRAGMA busy_timeout = 5000")?;
    Ok(connection)
}

fn read_only(path: &Path) -> rusqlite::Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let open = |connection: rusqlite::Result<Connection>| -> rusqlite::Result<Connection> {
        let connection = connection?;
        row_limit::set(&connection)?;
        connection.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get::<_, i64>(0))?;
        Ok(connection)
    };
    open(Connection::open_with_flags(path, flags)).or_else(|error| {
        // A folder that cannot be written, or a full disk, has no shared-memory file; without a log none is needed.
        let has_log = fs::metadata(beside(path, "-wal")).is_ok_and(|log| log.len() > 0);
        let plain = path.to_str().is_some_and(|text| !text.contains(['?', '#', '%']));
        let cannot_share =
            error.sqlite_error_code() == Some(rusqlite::ErrorCode::CannotOpen) || is_disk_full(&error);
        if !cannot_share || has_log || !plain {
            return Err(error);
        }
        let uri = format!("file:{}?immutable=1", path.display());
        open(Connection::open_with_flags(uri, flags | OpenFlags::SQLITE_OPEN_URI))
    })
}

/// Settings of every connection.
fn configure(connection: &Connection) -> Result<(), StoreError> {
    row_limit::set(connection).map_err(sqlite_error("set up its database"))?;
    for (config, value) in [
        (DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true),
        (DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false),
        // No schema has views, and a view in place of a table could have endless rows.
        (DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW, false),
        (DbConfig::SQLITE_DBCONFIG_DQS_DML, false),
        (DbConfig::SQLITE_DBCONFIG_DQS_DDL, false),
        (DbConfig::SQLITE_DBCONFIG_WRITABLE_SCHEMA, false),
    ] {
        connection.set_db_config(config, value).map_err(sqlite_error("set up its database"))?;
    }
    for (pragma, value) in [
        ("foreign_keys", "1"),
        ("trusted_schema", "0"),
        ("cell_size_check", "1"),
        ("recursive_triggers", "1"),
        ("busy_timeout", "5000"),
    ] {
        set(connection, pragma, value, value)?;
    }
    connection.set_prepared_statement_cache_capacity(64);
    Ok(())
}

/// Sets a pragma and fails if it has no effect.
fn set(connection: &Connection, pragma: &'static str, value: &str, expected: &str) -> Result<(), StoreError> {
    let error = sqlite_error("set up its database");
    connection.execute_batch(&format!("PRAGMA {pragma} = {value}")).map_err(&error)?;
    let found: rusqlite::types::Value =
        connection.query_row(&format!("PRAGMA {pragma}"), [], |row| row.get(0)).map_err(&error)?;
    let found = match found {
        rusqlite::types::Value::Integer(number) => number.to_string(),
        rusqlite::types::Value::Text(text) => text,
        other => format!("{other:?}"),
    };
    if found == expected {
        return Ok(());
    }
    Err(StoreError::invalid(
        "file system",
        format!("{pragma} = {found}"),
        format!("one on which SQLite can set {pragma} = {expected} (a local one)"),
    ))
}

/// Page size of a new database, bytes. Reading a whole chain of 1 KB records takes a quarter less CPU time than with
/// SQLite's 4096; a larger page saves little more and makes every commit write more.
const PAGE_BYTES: &str = "16384";

/// Makes a complete, empty database under another name and renames it into place.
fn create(path: &Path, schema: &Schema) -> Result<(), StoreError> {
    let part = path.with_extension("new");
    remove_database(&part)?;
    let connection = make(&part, schema)?;
    connection.close().map_err(|(_, error)| sqlite_error("make its database")(error))?;
    File::open(&part).and_then(|file| file.sync_all()).map_err(StoreError::io("write", &part))?;
    fs::rename(&part, path).map_err(StoreError::io("rename", &part))?;
    Ok(path.parent().map_or(Ok(()), sync_folder)?)
}

/// Makes a complete, empty database, in the mode that writers use.
pub(crate) fn make(path: &Path, schema: &Schema) -> Result<Connection, StoreError> {
    let mut connection = Connection::open(path).map_err(sqlite_error("make its database"))?;
    configure(&connection)?;
    set(&connection, "journal_mode", "delete", "delete")?;
    set(&connection, "synchronous", "FULL", "2")?;
    // Only an empty database accepts it.
    set(&connection, "page_size", PAGE_BYTES, PAGE_BYTES)?;
    migrate(&mut connection, schema)?;
    // A later change of the mode needs a journal, and a kill would leave that one hot.
    set(&connection, "journal_mode", "wal", "wal")?;
    Ok(connection)
}

/// SQLite's companion files, by the suffixes of their names.
pub(crate) const COMPANIONS: [&str; 3] = ["-wal", "-shm", "-journal"];

/// A companion file of a database.
pub(crate) fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    PathBuf::from(name)
}

/// Removes a database and its companion files, if it exists.
pub(crate) fn remove_database(path: &Path) -> Result<(), StoreError> {
    for ending in COMPANIONS {
        remove_if_there(&beside(path, ending))?;
    }
    remove_if_there(path)
}

fn remove_if_there(path: &Path) -> Result<(), StoreError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(StoreError::io("remove", path)(error)),
        Ok(()) | Err(_) => Ok(()),
    }
}

/// Merges a database's log into the database, and removes the log.
pub(crate) fn truncate_log(path: &Path) -> Result<(), StoreError> {
    let error = sqlite_error("write the log into the database");
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(path, flags).map_err(&error)?;
    let busy: i64 =
        connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |row| row.get(0)).map_err(&error)?;
    if busy != 0 {
        return Err(damaged(path, "another program reads it"));
    }
    connection.close().map_err(|(_, source)| error(source))?;
    for ending in ["-wal", "-shm"] {
        remove_if_there(&beside(path, ending))?;
    }
    Ok(())
}

/// Checks a file's header alone: ours, not newer, not cut short.
pub(crate) fn check_header(path: &Path, schema: &Schema) -> Result<(), StoreError> {
    let found = fs::symlink_metadata(path).map_err(StoreError::io("read", path))?;
    if !found.is_file() {
        let problem = format!("it is {}, and no file of its own", kind_of(&found));
        return Err(refused(path, &problem, RefusalCause::Foreign));
    }
    for (ending, cause) in
        COMPANIONS.into_iter().zip([RefusalCause::Log, RefusalCause::LogIndex, RefusalCause::Log])
    {
        let companion = beside(path, ending);
        if let Ok(found) = fs::symlink_metadata(&companion)
            && !found.is_file()
        {
            let problem = format!("it is {}, where SQLite keeps a file of its own", kind_of(&found));
            return Err(refused(&companion, &problem, cause));
        }
    }
    // This program's databases have a log; SQLite would replay a journal, which a reader cannot do.
    let journal = beside(path, "-journal");
    if fs::metadata(&journal).is_ok_and(|found| found.len() > 0) {
        let problem = "it is a rollback journal, and this program leaves none beside its databases";
        return Err(refused(&journal, problem, RefusalCause::Journal));
    }
    let mut header = [0u8; HEADER_BYTES];
    let mut file = File::open(path).map_err(StoreError::io("read", path))?;
    match file.read_exact(&mut header) {
        Ok(()) => {}
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
            return Err(damaged(path, &format!("it is cut short: it has {} bytes", found.len())));
        }
        Err(error) => return Err(StoreError::io("read", path)(error)),
    }
    if &header[..16] != b"SQLite format 3\0" {
        return Err(refused(path, "it is not an SQLite database", RefusalCause::Foreign));
    }
    let u32_at = |at: usize| u32::from_be_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    if i64::from(u32_at(68)) != i64::from(schema.application_id) {
        let problem = format!("it belongs to another program (application id {:#010x})", u32_at(68));
        return Err(refused(path, &problem, RefusalCause::Foreign));
    }
    let newest = schema.newest();
    if u32_at(60) == 0 || u32_at(60) as usize > newest {
        let problem = format!("its schema is {}, this program knows 1 to {newest}", u32_at(60));
        return Err(refused(path, &problem, RefusalCause::NewerSchema));
    }
    // With a write-ahead log the file may lag behind; `quick_check` then sees what is missing.
    let log = beside(path, "-wal");
    let log_bytes = fs::metadata(&log).map_or(0, |log| log.len());
    let page_bytes = match u64::from(u16::from_be_bytes([header[16], header[17]])) {
        1 => 65_536,
        bytes => bytes,
    };
    let whole = page_bytes * u64::from(u32_at(28));
    if log_bytes == 0 && found.len() < whole {
        return Err(damaged(path, &format!("it is cut short: {} of {whole} bytes are there", found.len())));
    }
    Ok(())
}

/// Checks an existing file, read-only: header and version. The caller checks its structure, once.
fn inspect(path: &Path, schema: &Schema) -> Result<(), StoreError> {
    check_header(path, schema)?;
    let connection = open_read_only(path)?;
    let version: i64 = connection
        .query_row("PRAGMA user_version", [], |row| row.get(0))
        .map_err(|error| damaged(path, &error.to_string()))?;
    if usize::try_from(version).is_ok_and(|version| (1..=schema.newest()).contains(&version)) {
        return Ok(());
    }
    Err(refused(path, &format!("its schema is {version}"), RefusalCause::Schema))
}

/// SQLite's own check of a file's structure.
///
/// # Errors
/// What is wrong, in SQLite's words.
pub(crate) fn quick_check(connection: &Connection) -> Result<(), String> {
    let answer: Result<String, _> = connection.query_row("PRAGMA quick_check(1)", [], |row| row.get(0));
    match answer {
        Ok(answer) if answer == "ok" => Ok(()),
        Ok(answer) => Err(format!("it is damaged: {answer}")),
        Err(error) => Err(format!("it is damaged: {}", row_limit::error_message(&error))),
    }
}

/// A file that is damaged or cut short.
pub(crate) fn damaged(path: &Path, problem: &str) -> StoreError {
    refused(path, problem, RefusalCause::Damaged)
}

/// A file whose chain is whole, but whose tables do not match it.
pub(crate) fn not_the_chain(path: &Path, problem: &str) -> StoreError {
    refused(path, problem, RefusalCause::NotTheChain)
}

pub(crate) fn refused(path: &Path, problem: &str, cause: RefusalCause) -> StoreError {
    StoreError::Refused { path: path.to_owned(), problem: problem.to_owned(), cause }
}

/// SQLite's count of writes by other connections.
pub(crate) fn written_by_others(connection: &Connection) -> Result<i64, StoreError> {
    connection
        .prepare_cached("PRAGMA data_version")
        .and_then(|mut pragma| pragma.query_row([], |row| row.get(0)))
        .map_err(sqlite_error("ask what others wrote"))
}
