//! A chain so long that a start does not read all of it: from a snapshot of the fold that a signed checkpoint binds.

use std::fs;
use std::path::{Path, PathBuf};

use holdpoint_registry::{ExportScope, Store, Views, export_store, verify};
use holdpoint_store::AuditBody;
use rusqlite::Connection;

use crate::edits::make_full_store;
use crate::quick_folder::quick_folder;
use crate::support::*;

/// As many records as a snapshot is written after.
const RECORDS: u64 = 32_768;

/// A closed store with a long chain.
fn long(folder: &Path) {
    make_full_store(folder);
    let store = open(folder);
    for command in 0..=RECORDS / 256 {
        let mut transaction = transaction(&format!("many {command}"), 1, Vec::new());
        let one = AuditBody { ..transaction.audit[0].clone() };
        transaction.audit = vec![one; 256];
        store.commit(transaction).unwrap();
    }
}

fn snapshot(folder: &Path) -> PathBuf {
    let all: Vec<_> =
        fs::read_dir(folder.join("checkpoints")).unwrap().map(|entry| entry.unwrap().path()).collect();
    let mut snapshots =
        all.into_iter().filter(|path| path.extension().is_some_and(|ending| ending == "fold"));
    let found = snapshots.next().unwrap();
    assert_eq!(snapshots.next(), None);
    found
}

fn sql(folder: &Path, text: &str) {
    Connection::open(folder.join("holdpoint.db")).unwrap().execute_batch(text).unwrap();
}

#[test]
fn start_continues_from_a_snapshot_only_if_it_is_signed() {
    let folder = quick_folder();
    long(folder.path());
    let database = folder.path().join("holdpoint.db");
    let snapshot = snapshot(folder.path());
    let store = open(folder.path());
    shadowed(&store, "place@1.2.0");
    assert!(store.checkpoint_problem().is_none());
    drop(store);
    verify(&database, Some(open(folder.path()).public_key())).unwrap();
    Views::open_checked(&database).unwrap();

    // Rows are compared with it ...
    sql(folder.path(), "UPDATE version SET author = 'eve' WHERE name = 'grasp@1.1.0'");
    let error = unless_in_use(|| Store::open(folder.path())).unwrap_err();
    assert!(refusal(&error).1.contains("version \"grasp@1.1.0\""), "{error}");
    Views::open_checked(&database).unwrap_err();
    // ... also after an edit that makes it agree with the row.
    let whole = fs::read_to_string(&snapshot).unwrap();
    let row =
        whole.find("[\"version\",\"grasp@1.1.0\",\"").unwrap() + "[\"version\",\"grasp@1.1.0\",\"".len();
    let mut forged = whole.clone().into_bytes();
    forged[row] = if forged[row] == b'0' { b'1' } else { b'0' };
    fs::write(&snapshot, &forged).unwrap();
    let error = unless_in_use(|| Store::open(folder.path())).unwrap_err();
    assert!(refusal(&error).1.contains("version \"grasp@1.1.0\""), "{error}");
    sql(folder.path(), "UPDATE version SET author = 'bob' WHERE name = 'grasp@1.1.0'");

    // Without it, or with an unsigned one, the chain is read whole and found sound.
    drop(open(folder.path()));
    fs::remove_file(&snapshot).unwrap();
    drop(open(folder.path()));
    fs::write(&snapshot, &whole).unwrap();

    // A record before it that an index hides is still found missing.
    let copy = fs::read(&database).unwrap();
    crate::damage::hide(&database, "decision");
    let error = unless_in_use(|| Store::open(folder.path())).unwrap_err();
    assert!(refusal(&error).1.contains("audit_kind"), "{error}");
    fs::write(&database, copy).unwrap();

    // A start does not read the part before it; the verifier does.
    sql(
        folder.path(),
        "DROP TRIGGER audit_no_update; UPDATE audit SET subject = 'x' WHERE seq = 1000;
        CREATE TRIGGER audit_no_update BEFORE UPDATE ON audit
  BEGIN SELECT RAISE(ABORT, 'the audit chain is append-only'); END",
    );
    drop(open(folder.path()));
    let error = verify(&database, None).unwrap_err();
    assert_eq!(error.record(), Some(1000), "{error}");
    fs::remove_file(&snapshot).unwrap();
    let error = unless_in_use(|| Store::open(folder.path())).unwrap_err().to_string();
    assert!(error.contains("audit record 1000"), "{error}");
}

/// Exports and counts read the part that a start skips.
#[test]
fn an_edited_record_before_the_snapshot_is_neither_written_out_nor_counted() {
    let folder = quick_folder();
    long(folder.path());
    let database = folder.path().join("holdpoint.db");
    Views::open_records(&database).unwrap();
    sql(folder.path(), "DROP TRIGGER audit_no_update; UPDATE audit SET body = '[]' WHERE seq = 1000");
    for error in [
        Views::open_records(&database).map(drop).unwrap_err().to_string(),
        export_store(&database, ExportScope::Signed, None, &mut Vec::new()).unwrap_err().to_string(),
    ] {
        assert!(error.contains("audit record 1000 "), "{error}");
    }
    let mut bytes = Vec::new();
    assert!(export_store(&database, ExportScope::Unchecked, None, &mut bytes).unwrap() > RECORDS);
}
