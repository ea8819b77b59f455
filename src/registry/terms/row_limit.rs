//! The longest row that is read from a database. Without it, a crafted file could make every reader load up to SQLite's
//! own limit of a thousand million bytes.
//!
//! The limit applies to the values read from a row. A search by the key of a table without row ids loads whole rows on
//! its way, so `meta`, which is read before any check, is read from its beginning (`+key`).

use holdpoint_store::ROW_BYTES_MAX;
use rusqlite::limits::Limit;
use rusqlite::{Connection, ErrorCode};

/// The table of the chain, whose records are read one by one anyway.
const CHAIN: &str = "audit";

/// Sets the limit for a connection's reads and writes.
pub(crate) fn set(connection: &Connection) -> rusqlite::Result<()> {
    connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, ROW_BYTES_MAX).map(drop)
}

/// Restores SQLite's own limit for a connection: a rebuild replaces rows that are too long, and takes the memory that
/// they need.
pub(crate) fn lift(connection: &Connection) -> rusqlite::Result<()> {
    connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, i32::MAX).map(drop)
}

/// Whether a row was not read because of its length.
pub(crate) fn is_reached(error: &rusqlite::Error) -> bool {
    error.sqlite_error_code() == Some(ErrorCode::TooBig)
}

/// SQLite's error, with the limit if that is the cause.
pub(crate) fn error_message(error: &rusqlite::Error) -> String {
    if is_reached(error) {
        return format!("there is a text of more than {ROW_BYTES_MAX} bytes, and so many are read");
    }
    error.to_string()
}

/// As [`error_message`], of a row of this table.
pub(crate) fn error_message_for(table: &str, error: &rusqlite::Error) -> String {
    let message = error_message(error);
    if is_reached(error) { format!("its table {table}: {message}") } else { message }
}

/// The first text outside the chain that is too long, by the lengths in the rows' headers: no text is loaded.
pub(crate) fn first_too_long(connection: &Connection) -> rusqlite::Result<Option<String>> {
    let sql = "SELECT t.name, c.name FROM sqlite_schema t JOIN pragma_table_info(t.name) c
               WHERE t.type = 'table' AND t.name NOT LIKE 'sqlite_%' AND t.name <> ?1 ORDER BY t.name, c.cid";
    let mut select = connection.prepare(sql)?;
    let columns = select.query_map([CHAIN], |row| Ok((row.get(0)?, row.get(1)?)))?;
    for column in columns {
        let (table, column): (String, String) = column?;
        let name = |name: &str| format!("\"{}\"", name.replace('"', "\"\""));
        let sql = format!(
            "SELECT max(octet_length({})) FROM {} WHERE octet_length({0}) > {ROW_BYTES_MAX}",
            name(&column),
            name(&table)
        );
        if let Some(bytes) = connection.query_row(&sql, [], |row| row.get::<_, Option<u64>>(0))? {
            return Ok(Some(format!(
                "a text in the column {column} of its table {table} has {bytes} bytes, and at most {ROW_BYTES_MAX} are read"
            )));
        }
    }
    Ok(None)
}
