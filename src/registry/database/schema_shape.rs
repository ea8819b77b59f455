//! The shape of a database: exactly the tables, indexes and triggers of a released schema.

use std::collections::BTreeMap;

use rusqlite::Connection;

use crate::database::migrate::{Schema, migrate_to, version};

/// A part of a database: kind and name, and its SQL text.
type SchemaParts = BTreeMap<(String, String), String>;

/// The first part of a database that differs from its schema, `None` if all match.
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

/// Whether a table exists with the newest schema's definition.
///
/// # Errors
/// If the database cannot be read.
pub(crate) fn has_table(connection: &Connection, schema: &Schema, name: &str) -> rusqlite::Result<bool> {
    let mut newest = Connection::open_in_memory()?;
    migrate_to(&mut newest, schema, schema.newest())?;
    let key = ("table".to_owned(), name.to_owned());
    let (expected, found) = (parts(&newest)?, parts(connection)?);
    Ok(found.contains_key(&key) && found.get(&key) == expected.get(&key))
}

fn parts(connection: &Connection) -> rusqlite::Result<SchemaParts> {
    let mut select = connection
        .prepare("SELECT type, name, coalesce(sql, '') || ' on ' || tbl_name FROM sqlite_schema")?;
    select.query_map([], |row| Ok(((row.get(0)?, row.get(1)?), row.get(2)?)))?.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::database::migrate::{STORE, TELEMETRY};

    const SCHEMAS: [&Schema; 2] = [&STORE, &TELEMETRY];

    /// The parts of an early schema that every later step keeps.
    fn mark(connection: &Connection, schema: &Schema) {
        if schema.application_id == STORE.application_id {
            connection.execute_batch("INSERT INTO meta (key, value) VALUES ('mark', 'kept')").unwrap();
        }
    }

    #[test]
    fn every_released_schema_is_migrated_step_by_step() {
        for schema in SCHEMAS {
            for from in 1..=schema.newest() {
                let mut connection = Connection::open_in_memory().unwrap();
                migrate_to(&mut connection, schema, from).unwrap();
                mark(&connection, schema);
                for step in from..=schema.newest() {
                    migrate_to(&mut connection, schema, step).unwrap();
                    assert_eq!(version(&connection).unwrap(), step);
                    assert_eq!(first_difference(&connection, schema).unwrap(), None, "{from} to {step}");
                }
                let id: i32 = connection.query_row("PRAGMA application_id", [], |row| row.get(0)).unwrap();
                assert_eq!(id, schema.application_id);
                if schema.application_id == STORE.application_id {
                    let query = "SELECT count(*) FROM meta WHERE key = 'mark' AND value = 'kept'";
                    assert_eq!(connection.query_row(query, [], |row| row.get::<_, u64>(0)).unwrap(), 1);
                }
                // The result of the steps does not depend on the first one.
                let mut at_once = Connection::open_in_memory().unwrap();
                migrate_to(&mut at_once, schema, schema.newest()).unwrap();
                assert_eq!(parts(&connection).unwrap(), parts(&at_once).unwrap());
            }
        }
    }

    #[test]
    fn a_step_that_fails_is_undone_as_a_whole() {
        let failing = Schema {
            application_id: STORE.application_id,
            steps: &[
                "CREATE TABLE one (a TEXT) STRICT",
                "CREATE TABLE two (a TEXT) STRICT; INSERT INTO one VALUES ('x'); SELECT * FROM nothing",
            ],
        };
        let mut connection = Connection::open_in_memory().unwrap();
        migrate_to(&mut connection, &failing, 2).unwrap_err();
        assert_eq!(version(&connection).unwrap(), 1);
        assert_eq!(first_difference(&connection, &failing).unwrap(), None);
        assert_eq!(
            connection.query_row("SELECT count(*) FROM one", [], |row| row.get::<_, u64>(0)).unwrap(),
            0
        );
    }
}
