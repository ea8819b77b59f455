//! The shape of a database: its tables, indexes and triggers are those of a released schema, and no others.

use std::collections::BTreeMap;

use rusqlite::Connection;

use super::migrate::{Schema, migrate_to, version};

/// What a database is made of: kind and name, and the text that made it.
type SchemaParts = BTreeMap<(String, String), String>;

/// The first part of a database that is not as its schema makes it, `None` if there is none.
///
/// # Errors
/// If the database cannot be read.
pub(crate) fn first_difference(connection: &Connection, schema: &Schema) -> rusqlite::Result<Option<String>> {
    let mut released = Connection::open_in_memory()?;
    migrate_to(&mut released, schema, version(connection)?)?;
    let (expected, mut found) = (parts(&released)?, parts(connection)?);
    for ((kind, name), sql) in expected {
        match found.remove(&(kind.clone(), name.clone())) {
            Some(there) if there == sql => {}
            Some(_) => return Ok(Some(format!("the {kind} {name:?} is not as this program makes it"))),
            None => return Ok(Some(format!("the {kind} {name:?} is missing"))),
        }
    }
    Ok(found.into_keys().next().map(|(kind, name)| format!("the {kind} {name:?} is not of this program")))
}

fn parts(connection: &Connection) -> rusqlite::Result<SchemaParts> {
    let mut select = connection
        .prepare("SELECT type, name, coalesce(sql, '') || ' on ' || tbl_name FROM sqlite_schema")?;
    select.query_map([], |row| Ok(((row.get(0)?, row.get(1)?), row.get(2)?)))?.collect()
}
