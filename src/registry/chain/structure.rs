//! SQLite's own check of the structure of the store's file, as far as no other check has covered it.
//!
//! SQLite does not check what the fold has read anyway: a record's hash covers its content, and one pass over each of
//! the two indexes of the chain compares it with the records.

use std::hash::{BuildHasher, RandomState};
use std::path::Path;

use rusqlite::Connection;

use crate::chain::fold::{CellStop, Fold};
use crate::database::open::open_beside;
use crate::terms::row_limit;
use holdpoint_governance::record::{RecordKind, RecordRef};

/// The table of the chain: nearly all of a store's file.
const CHAIN: &str = "audit";
const CHAIN_INDEXES: [(&str, &str); 2] = [("audit_subject", "subject"), ("audit_kind", "kind")];

/// The structure of the part that a start reads and writes. If the fold continues from a snapshot, earlier records are
/// not checked here; `verify` does.
///
/// # Errors
/// What is wrong, in SQLite's words.
pub(crate) fn check_at_start(connection: &Connection, fold: &Fold) -> Result<(), String> {
    check_cell(connection, fold)?;
    // Only a check of the whole file covers free pages.
    if fold.since.seq == 0 || has_free_pages(connection).map_err(unreadable)? {
        return whole_file(connection);
    }
    for table in tables(connection).map_err(unreadable)? {
        if table != CHAIN {
            of_table(connection, "quick_check", &table)?;
        }
    }
    // A missing entry hides a record, such as a stop, from queries by kind or subject.
    for (index, column) in CHAIN_INDEXES {
        let sql = format!("SELECT count({column}) FROM audit INDEXED BY {index}");
        let entries: u64 = connection.query_row(&sql, [], |row| row.get(0)).map_err(unreadable)?;
        if entries != fold.end.seq {
            return Err(format!("wrong # of entries in index {index}"));
        }
    }
    Ok(())
}

/// The kind of a record finds a stop of the cell, and how its last engine ended: the index must match the chain for
/// these kinds.
fn check_cell(connection: &Connection, fold: &Fold) -> Result<(), String> {
    let number = |sql: &str, after: u64| -> Result<u64, String> {
        let found = connection.query_row(sql, [after], |row| row.get::<_, Option<u64>>(0));
        found.map(Option::unwrap_or_default).map_err(unreadable)
    };
    let by_kind = |which: &str, kind: RecordKind| {
        let kind = kind.name();
        format!("SELECT {which}(seq) FROM audit INDEXED BY audit_kind WHERE kind = '{kind}' AND seq > ?1")
    };
    let released = number(&by_kind("max", RecordKind::CellReleased), 0)?;
    let stopped = number(&by_kind("min", RecordKind::CellStopped), released)?;
    let ended = number(&by_kind("max", RecordKind::EngineEnded), 0)?;
    let began = number(&by_kind("max", RecordKind::EngineBegan), ended)?;
    if fold.cell == (CellStop { released, stopped, began }) {
        return Ok(());
    }
    Err("the index \"audit_kind\" differs from its table".to_owned())
}

/// The structure of the whole file, and every index but those of the chain against its table. On its own connection,
/// because another one reads the records meanwhile.
///
/// # Errors
/// What is wrong.
pub(crate) fn check_file(database: &Path) -> Result<(), String> {
    let connection = open_beside(database).map_err(|error| error.to_string())?;
    whole_file(&connection)?;
    for table in tables(&connection).map_err(unreadable)? {
        if table != CHAIN {
            of_table(&connection, "integrity_check", &table)?;
        }
    }
    Ok(())
}

/// The indexes of the chain against its records. `fold` covers the whole chain, with index sums.
///
/// # Errors
/// What is wrong.
pub(crate) fn check_indexes(connection: &Connection, fold: &Fold) -> Result<(), String> {
    let Some(indexes) = &fold.indexes else {
        return Err("the sums of the indexes are missing".to_owned());
    };
    let differing = indexes.differing(connection, fold.end.seq).map_err(unreadable)?;
    differing.map_or(Ok(()), |index| Err(format!("the index {index:?} differs from its table")))
}

/// Every page, and every row without the constraints on records: hashes cover their content.
fn whole_file(connection: &Connection) -> Result<(), String> {
    let ignore = |on: &str| {
        connection.execute_batch(&format!("PRAGMA ignore_check_constraints = {on}")).map_err(unreadable)
    };
    ignore("1")?;
    let checked = pragma(connection, "quick_check(1)");
    ignore("0")?;
    checked?;
    for table in tables(connection).map_err(unreadable)? {
        if table != CHAIN {
            of_table(connection, "quick_check", &table)?;
        }
    }
    Ok(())
}

fn unreadable(error: rusqlite::Error) -> String {
    row_limit::error_message(&error)
}

fn has_free_pages(connection: &Connection) -> rusqlite::Result<bool> {
    connection.query_row("PRAGMA freelist_count", [], |row| row.get::<_, i64>(0)).map(|count| count > 0)
}

fn tables(connection: &Connection) -> rusqlite::Result<Vec<String>> {
    let mut select = connection.prepare(
        "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite_%' ORDER BY name",
    )?;
    select.query_map([], |row| row.get(0))?.collect()
}

fn of_table(connection: &Connection, check: &str, table: &str) -> Result<(), String> {
    pragma(connection, &format!("{check}(\"{}\")", table.replace('"', "\"\"")))
}

fn pragma(connection: &Connection, check: &str) -> Result<(), String> {
    let answer: String =
        connection.query_row(&format!("PRAGMA {check}"), [], |row| row.get(0)).map_err(unreadable)?;
    if answer == "ok" { Ok(()) } else { Err(answer) }
}

/// Kind and subject of every record, as in the indexes of the chain: the sum of their hashes under a random key, so
/// that no other entries with the same sum can be made.
#[derive(Clone, Debug, Default)]
pub(crate) struct IndexSums {
    key: RandomState,
    subjects: u64,
    kinds: u64,
}

impl IndexSums {
    pub(crate) fn add(&mut self, record: &RecordRef<'_>) {
        self.subjects = self.subjects.wrapping_add(self.hash(record.subject, record.seq));
        self.kinds = self.kinds.wrapping_add(self.hash(record.kind, record.seq));
    }

    fn hash(&self, text: &str, seq: u64) -> u64 {
        self.key.hash_one((text, seq))
    }

    /// The index without exactly one entry for each record, in its order; `None` if both have them.
    fn differing(&self, connection: &Connection, records: u64) -> rusqlite::Result<Option<&'static str>> {
        for ((index, column), sum) in CHAIN_INDEXES.into_iter().zip([self.subjects, self.kinds]) {
            if self.of_index(connection, index, column)? != Some((records, sum)) {
                return Ok(Some(index));
            }
        }
        Ok(None)
    }

    /// Entries of an index and their sum; `None` if they are not in order.
    fn of_index(
        &self,
        connection: &Connection,
        index: &str,
        column: &str,
    ) -> rusqlite::Result<Option<(u64, u64)>> {
        let mut select =
            connection.prepare(&format!("SELECT {column}, seq FROM audit INDEXED BY {index}"))?;
        let mut rows = select.query([])?;
        let (mut count, mut sum) = (0, 0_u64);
        let mut last = (String::new(), 0);
        while let Some(row) = rows.next()? {
            let (text, seq) = (row.get_ref(0)?.as_str()?, row.get::<_, u64>(1)?);
            if count > 0 && (last.0.as_str(), last.1) >= (text, seq) {
                return Ok(None);
            }
            if last.0 != text {
                text.clone_into(&mut last.0);
            }
            last.1 = seq;
            count += 1;
            sum = sum.wrapping_add(self.hash(text, seq));
        }
        Ok(Some((count, sum)))
    }
}
