//! The wall time of the newest record: it is signed, and goes back only if a person confirms the time.

use std::fs;

use holdpoint_audit::history_error::HistoryError;
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_registry::{Store, verify};
use holdpoint_store::{AuditBody, RefusalCause, Transaction, VerifyError};
use rusqlite::Connection;

use crate::edits::make_full_store;
use crate::quick_folder::quick_folder;
use crate::support::*;
use crate::verifiers::{export_lines, verify_by_both};

/// Edits like an attacker: past the triggers that protect records.
fn set_newest(folder: &std::path::Path, wall_ms: i64) {
    let connection = Connection::open(folder.join("holdpoint.db")).unwrap();
    let mut select = connection
        .prepare("SELECT name, sql FROM sqlite_schema WHERE type = 'trigger' AND tbl_name = 'audit'")
        .unwrap();
    let read = |row: &rusqlite::Row<'_>| Ok((row.get(0)?, row.get(1)?));
    let triggers: Vec<(String, String)> = select.query_map([], read).unwrap().map(Result::unwrap).collect();
    drop(select);
    for (name, _) in &triggers {
        connection.execute_batch(&format!("DROP TRIGGER {name}")).unwrap();
    }
    let sql = "UPDATE audit SET wall_ms = ?1 WHERE seq = (SELECT max(seq) FROM audit)";
    assert_eq!(connection.execute(sql, [wall_ms]).unwrap(), 1);
    for (_, sql) in &triggers {
        connection.execute_batch(sql).unwrap();
    }
}

/// An earlier wall time in the last record, with a file beside it, once moved a store's clock and ended a freeze.
#[test]
fn the_wall_time_of_the_newest_record_is_signed() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let (database, file) = (folder.path().join("holdpoint.db"), folder.path().join("export"));
    assert_eq!(open(folder.path()).opening().newest_record, Some(WallTime::from_ms(WALL_MS)));
    verify(&database, None).unwrap();
    let sound = export_lines(folder.path(), &file);
    verify_by_both(&file).unwrap();
    for wall_ms in [1, 0, WALL_MS + 1] {
        set_newest(folder.path(), wall_ms);
        let error = unless_in_use(|| Store::open(folder.path())).unwrap_err();
        assert_eq!(refusal(&error).0, RefusalCause::Damaged, "{error}");
        // The checkpoint of the newest record has its wall time.
        let error = verify(&database, None).unwrap_err();
        assert!(matches!(error, VerifyError::History(HistoryError::Checkpoint { .. })), "{error}");
    }
    set_newest(folder.path(), WALL_MS);
    drop(open(folder.path()));
    // Both verifiers find it in a file of the same records.
    let newest = sound.iter().rposition(|line| line.starts_with("{\"record\":")).unwrap();
    let mut edited = sound.clone();
    edited[newest] = edited[newest].replace(&format!("\"wall_ms\":{WALL_MS}"), "\"wall_ms\":1");
    assert_ne!(edited, sound);
    fs::write(&file, edited.join("\n") + "\n").unwrap();
    let error = verify_by_both(&file).unwrap_err();
    assert!(matches!(error, HistoryError::Checkpoint { .. } | HistoryError::Unsigned(_)), "{error}");
}

#[test]
fn wall_time_goes_back_only_if_a_person_confirms_it() {
    let folder = quick_folder();
    let store = open(folder.path());
    let record = |kind| vec![AuditBody { kind, subject: String::new(), body: "{}".to_owned() }];
    for (name, kind, wall_ms, expected) in [
        ("first", RecordKind::ShiftNote, WALL_MS, WALL_MS),
        ("earlier", RecordKind::ShiftNote, WALL_MS - 5_000, WALL_MS),
        ("none", RecordKind::ShiftNote, 0, WALL_MS),
        ("later", RecordKind::ShiftNote, WALL_MS + 9, WALL_MS + 9),
        ("confirmed", RecordKind::ClockConfirmed, WALL_MS - 5_000, WALL_MS - 5_000),
        ("after it", RecordKind::ShiftNote, WALL_MS - 4_000, WALL_MS - 4_000),
    ] {
        let transaction = Transaction { wall_ms, audit: record(kind), ..transaction(name, 1, Vec::new()) };
        let seq = store.commit(transaction).unwrap().last_seq;
        let found = store.views().unwrap().stamp(seq).unwrap().unwrap().wall_ms;
        assert_eq!(found, Some(expected), "{name}");
    }
    drop(store);
    assert_eq!(open(folder.path()).opening().newest_record, Some(WallTime::from_ms(WALL_MS - 4_000)));
    verify(&folder.path().join("holdpoint.db"), None).unwrap();
}
