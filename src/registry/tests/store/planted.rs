//! Data planted beside the record: receipts of later commands, views in place of tables, files in the store's folders
//! under names like the store's own.

use std::fs;
use std::path::Path;

use holdpoint_registry::{BackupParts, Store, UnsignedRecords, Views, backup, rebuild, verify};
use holdpoint_store::{Change, EvidenceKind, RefusalCause, StoreError, command_id};
use rusqlite::{Connection, params};

use crate::quick_folder::quick_folder;
use crate::support::*;

fn more(text: &str) -> Change {
    evidence("grasp@1.1.0", EvidenceKind::Gate, text)
}

/// A copy of a closed store.
fn twin_of(folder: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    fs::set_permissions(to, fs::metadata(folder).unwrap().permissions()).unwrap();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let to = to.join(path.file_name().unwrap());
        if path.is_dir() { twin_of(&path, &to) } else { assert!(fs::copy(&path, &to).is_ok()) }
    }
}

fn edit(folder: &Path, sql: &str) {
    let database = Connection::open(folder.join("holdpoint.db")).unwrap();
    database.execute_batch(sql).unwrap();
}

/// A command with a planted receipt runs all the same.
#[test]
fn planted_receipt_without_records_suppresses_no_command() {
    let folder = quick_folder();
    crate::edits::make_full_store(folder.path());
    let transaction = |id: &str| transaction(id, 1_000_000, vec![more("planted")]);
    let twin = quick_folder();
    twin_of(folder.path(), &twin.path().join("store"));
    // An attacker learns the command's later digest from a copy.
    let tried = open(&twin.path().join("store"));
    tried.commit(transaction("known")).unwrap();
    drop(tried);
    let known: String = Connection::open(twin.path().join("store/holdpoint.db"))
        .unwrap()
        .query_row("SELECT digest FROM command WHERE id = 'known'", [], |row| row.get(0))
        .unwrap();
    let database = Connection::open(folder.path().join("holdpoint.db")).unwrap();
    let (seq, head): (u64, String) = database
        .query_row("SELECT seq, lower(hex(hash)) FROM audit_head", [], |row| Ok((row.get(0)?, row.get(1)?)))
        .unwrap();
    for (id, digest) in [("known", known.as_str()), ("refused", &"0".repeat(64))] {
        let receipt = format!(
            r#"{{"command_id":"{id}","first_seq":0,"head":"{head}","last_seq":0,"row_versions":[]}}"#
        );
        database
            .execute(
                "INSERT INTO command (id, digest, last_seq, receipt) VALUES (?1, ?2, ?3, ?4)",
                params![id, digest, seq, receipt],
            )
            .unwrap();
    }
    drop(database);
    let store = open(folder.path());
    for id in ["known", "refused"] {
        let done = store.commit(transaction(id)).unwrap();
        assert!(done.first_seq > seq, "{id} was swallowed: {done:?}");
        // A second send gets the answer.
        assert_eq!(store.commit(transaction(id)).unwrap(), done);
    }
    drop(store);
    verify(&folder.path().join("holdpoint.db"), None).unwrap();
    assert_ne!(command_id("engine").unwrap(), command_id("engine").unwrap());
}

/// A view with endless rows is refused before its first row is read; otherwise this never ends.
#[test]
fn a_view_in_place_of_a_table_is_never_read() {
    const ENDLESS: &str =
        "(WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT count(*) FROM c) > 0";
    for table in ["meta", "audit", "command", "version"] {
        let folder = quick_folder();
        crate::edits::make_full_store(folder.path());
        let database = Connection::open(folder.path().join("holdpoint.db")).unwrap();
        let triggers: Vec<String> = database
            .prepare("SELECT name FROM sqlite_schema WHERE type = 'trigger'")
            .unwrap()
            .query_map([], |row| row.get(0))
            .unwrap()
            .map(Result::unwrap)
            .collect();
        for name in triggers {
            database.execute_batch(&format!("DROP TRIGGER {name}")).unwrap();
        }
        database
            .execute_batch(&format!(
                "ALTER TABLE {table} RENAME TO hidden; CREATE VIEW {table} AS SELECT * FROM hidden WHERE {ENDLESS}"
            ))
            .unwrap();
        drop(database);
        let path = folder.path().join("holdpoint.db");
        assert!(Store::open(folder.path()).is_err(), "{table}");
        assert!(verify(&path, None).is_err(), "{table}");
        assert!(Views::open_checked(&path).is_err(), "{table}");
        // The store's id is also in its checkpoints; the chain is nowhere else.
        let rebuilt = rebuild(folder.path(), UnsignedRecords::Refuse, "{}", 0);
        assert_eq!(rebuilt.is_ok(), table == "meta", "{table}: {rebuilt:?}");
        if rebuilt.is_ok() {
            drop(open(folder.path()));
        }
    }
}

/// Files without exactly a checkpoint's name are neither counted nor removed, however many there are.
#[test]
fn foreign_files_among_the_checkpoints_displace_no_checkpoint() {
    let folder = quick_folder();
    crate::edits::make_full_store(folder.path());
    let checkpoints = folder.path().join("checkpoints");
    let named = || {
        let mut names: Vec<String> = fs::read_dir(&checkpoints)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    };
    let own: Vec<String> = named().into_iter().filter(|name| name.ends_with(".json")).collect();
    assert!(!own.is_empty());
    let foreign = (0..1_100).map(|at| format!("zz{at:04}.json"));
    let odd =
        ["!mine.json", ".json", "000.json", "000000000072.json.json", "+00000000007.json"].map(str::to_owned);
    let foreign: Vec<String> = foreign.chain(odd).collect();
    for name in &foreign {
        fs::write(checkpoints.join(name), "").unwrap();
    }
    let store = open(folder.path());
    commit(&store, "more", vec![more("more")]).unwrap();
    drop(store);
    let there = named();
    for name in own.iter().chain(&foreign) {
        assert!(there.contains(name), "{name} was removed");
    }
    drop(open(folder.path()));
    // An invalid file with a checkpoint's name is named, with a remedy.
    fs::write(checkpoints.join("000000000099.json"), "{}").unwrap();
    let refused = Store::open(folder.path()).unwrap_err();
    assert!(
        matches!(&refused, StoreError::Refused { path, cause: RefusalCause::Checkpoint, .. }
            if path.ends_with("000000000099.json")),
        "{refused}"
    );
}

/// The end of the chain is in the chain and under its signature: a row that differs is repaired.
#[test]
fn wrong_end_is_repaired_from_the_chain() {
    for sql in
        ["UPDATE audit_head SET seq = seq + 1", "UPDATE audit_head SET id = 2", "DELETE FROM audit_head"]
    {
        let folder = quick_folder();
        crate::edits::make_full_store(folder.path());
        edit(folder.path(), &format!("PRAGMA ignore_check_constraints = 1; {sql}"));
        let refused = Store::open(folder.path()).unwrap_err();
        assert_eq!(refusal(&refused).0, RefusalCause::NotTheChain, "{sql}: {refused}");
        rebuild(folder.path(), UnsignedRecords::Refuse, "{}", 0).unwrap().unwrap();
        drop(open(folder.path()));
        verify(&folder.path().join("holdpoint.db"), None).unwrap();
    }
}

#[test]
fn a_journal_beside_a_database_with_a_log_is_named() {
    let folder = quick_folder();
    crate::edits::make_full_store(folder.path());
    let journal = folder.path().join("holdpoint.db-journal");
    fs::write(&journal, [0xd9, 0xd5, 0x05, 0xf9, 0x20, 0xa1, 0x63, 0xd7, 0, 0, 0, 1]).unwrap();
    let refused = Store::open(folder.path()).unwrap_err();
    assert!(refused.to_string().contains("-journal"), "{refused}");
    fs::remove_file(&journal).unwrap();
    drop(open(folder.path()));
}

/// Only an existing file with exactly such a name is reported as quarantined.
#[test]
fn files_named_like_quarantined_telemetry_stop_no_start() {
    let folder = quick_folder();
    crate::edits::make_full_store(folder.path());
    let odd =
        ["99999999.db", "4294967295.db", "+5.db", "+5.db-wal", "007.db", "0.db", "6.db-wal", "1.db.bak"];
    for ending in odd {
        fs::write(folder.path().join(format!("telemetry-aside-{ending}")), "").unwrap();
    }
    let before = verify(&folder.path().join("holdpoint.db"), None).unwrap();
    let store = open(folder.path());
    drop(store);
    let after = verify(&folder.path().join("holdpoint.db"), None).unwrap();
    assert_eq!(format!("{before:?}"), format!("{after:?}"), "a record was written");
}

/// A link in place of a copied folder adds nothing to the copy, such as keys.
#[test]
fn a_copy_follows_no_link() {
    let folder = quick_folder();
    crate::edits::make_full_store(folder.path());
    std::os::unix::fs::symlink("keys", folder.path().join("profiles")).unwrap();
    let to = quick_folder();
    let refused = backup(folder.path(), &to.path().join("copy"), BackupParts::default()).unwrap_err();
    assert!(refused.to_string().contains("profiles"), "{refused}");
    assert!(!to.path().join("copy").exists(), "half a copy is left under its name");
}
