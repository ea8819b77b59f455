//! Checkpoints as a linked list, and the end that every transaction signs.

use std::fs;
use std::path::{Path, PathBuf};

use holdpoint_approvals::keyfile;
use holdpoint_audit::checkpoint::Checkpoint;
use holdpoint_audit::history_error::HistoryError;
use holdpoint_governance::record::RecordKind;
use holdpoint_registry::{Store, UnsignedRecords, Views, rebuild, verify};
use holdpoint_store::{AuditBody, AuditFilter, RefusalCause, StoreError, Transaction, VerifyError};
use holdpoint_text::Hint as _;
use rusqlite::Connection;

use crate::damage::rewrite;
use crate::edits::make_full_store;
use crate::proofs::public_key;
use crate::quick_folder::quick_folder;
use crate::released::schema_1;
use crate::support::*;

const BY: &str = "{\"user\":\"ada\"}";
const EDIT: &str = "UPDATE audit SET body = '{\"edited\":1}' WHERE kind = 'decision' AND seq = 5";

/// Files of checkpoints, oldest first.
fn files(folder: &Path) -> Vec<PathBuf> {
    let all = fs::read_dir(folder.join("checkpoints")).unwrap().map(|entry| entry.unwrap().path());
    let mut all: Vec<_> = all.filter(|path| path.extension().is_some_and(|it| it == "json")).collect();
    all.sort();
    all
}

fn sql(folder: &Path, text: &str) {
    Connection::open(folder.join("holdpoint.db")).unwrap().execute_batch(text).unwrap();
}

/// The error of a start, which leaves the store unchanged.
fn refused(folder: &Path) -> StoreError {
    let before = fs::read(folder.join("holdpoint.db")).unwrap();
    let error = unless_in_use(|| Store::open(folder)).map(drop).unwrap_err();
    assert!(error.hint().is_some(), "{error}");
    assert_eq!(fs::read(folder.join("holdpoint.db")).unwrap(), before);
    error
}

/// The number of the last record.
fn last(folder: &Path) -> u64 {
    let connection = Connection::open(folder.join("holdpoint.db")).unwrap();
    connection.query_row("SELECT max(seq) FROM audit", [], |row| row.get(0)).unwrap()
}

/// Whether no signature covers the records after, or up to, a number.
fn is_unsigned_at(error: &StoreError, seq: u64) -> bool {
    let (cause, problem) = refusal(error);
    cause == RefusalCause::Unsigned && problem.ends_with(&format!(" {seq}"))
}

/// Sound or not, with and without the key.
fn not_sound(folder: &Path) -> VerifyError {
    let (key, _) = holdpoint_approvals::keyfile::read_public(&folder.join("keys").join("store.pub")).unwrap();
    let database = folder.join("holdpoint.db");
    verify(&database, None).unwrap_err();
    verify(&database, Some(&key)).unwrap_err()
}

#[test]
fn rewritten_chain_is_refused_without_its_checkpoints() {
    let folder = quick_folder();
    make_full_store(folder.path());
    rewrite(folder.path(), EDIT);
    for file in files(folder.path()) {
        fs::remove_file(file).unwrap();
    }
    let last = last(folder.path());
    let is_damaged = |error: &StoreError| {
        let (cause, problem) = refusal(error);
        cause == RefusalCause::Damaged && problem.contains(&format!("audit record {last} "))
    };
    let error = refused(folder.path());
    assert!(is_damaged(&error), "{error}");
    assert!(
        matches!(not_sound(folder.path()), VerifyError::History(HistoryError::Record { seq, .. }) if seq == last)
    );
    Views::open_checked(&folder.path().join("holdpoint.db")).unwrap_err();
    let error = rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7).unwrap_err();
    assert!(is_damaged(&error), "{error}");
    // Nor without the signed end in the database.
    sql(folder.path(), "DELETE FROM meta WHERE key = 'signed_end'");
    let error = refused(folder.path());
    assert!(is_unsigned_at(&error, last), "{error}");
    assert!(matches!(not_sound(folder.path()), VerifyError::History(HistoryError::Unsigned(_))));
    Views::open_checked(&folder.path().join("holdpoint.db")).unwrap_err();
}

#[test]
fn signed_end_of_another_store_or_chain_is_refused() {
    let (folder, other) = (quick_folder(), quick_folder());
    make_full_store(folder.path());
    make_full_store(other.path());
    let put = |text: &str| {
        let connection = Connection::open(folder.path().join("holdpoint.db")).unwrap();
        connection.execute("UPDATE meta SET value = ?1 WHERE key = 'signed_end'", [text]).unwrap();
    };
    let end = |folder: &Path| fs::read_to_string(files(folder).last().unwrap()).unwrap();
    let whole = end(folder.path());
    put(&end(other.path()));
    assert_eq!(refusal(&refused(folder.path())).0, RefusalCause::Unsigned);
    let mut forged: Checkpoint = serde_json::from_str(&whole).unwrap();
    forged.at_ms += 1;
    put(&serde_json::to_string(&forged).unwrap());
    assert_eq!(refusal(&refused(folder.path())).0, RefusalCause::Unsigned);
    // An earlier end does not sign later records.
    let earlier = &files(folder.path())[1];
    put(&fs::read_to_string(earlier).unwrap());
    let error = refused(folder.path());
    assert!(is_unsigned_at(&error, Checkpoint::read(earlier).unwrap().seq), "{error}");
    put(&whole);
    drop(open(folder.path()));
}

#[test]
fn missing_checkpoint_is_reported() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let all = files(folder.path());
    assert!(all.len() >= 3, "{all:?}");
    let texts: Vec<_> = all.iter().map(|file| fs::read(file).unwrap()).collect();
    let put_back = || all.iter().zip(&texts).for_each(|(file, text)| fs::write(file, text).unwrap());
    for missing in [0..1, 1..2, all.len() - 2..all.len(), 0..all.len()] {
        all[missing.clone()].iter().for_each(|file| fs::remove_file(file).unwrap());
        assert_eq!(refusal(&refused(folder.path())).0, RefusalCause::Unsigned, "{missing:?}");
        assert!(
            matches!(not_sound(folder.path()), VerifyError::History(HistoryError::Unsigned(_))),
            "{missing:?}"
        );
        put_back();
        drop(open(folder.path()));
    }
    // One in place of another.
    fs::write(&all[1], &texts[2]).unwrap();
    let error = refused(folder.path());
    assert!(
        matches!(&error, StoreError::Refused { path, cause: RefusalCause::Checkpoint, .. } if *path == all[1]),
        "{error}"
    );
    put_back();
    // The newest alone: the end in the database is the same checkpoint.
    fs::remove_file(all.last().unwrap()).unwrap();
    let store = open(folder.path());
    shadowed(&store, "place@1.2.0");
    drop(store);
    verify(&folder.path().join("holdpoint.db"), None).unwrap();
}

#[test]
fn a_rebuild_records_missing_checkpoints() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let database = folder.path().join("holdpoint.db");
    let all = files(folder.path());
    fs::remove_file(&all[1]).unwrap();
    refused(folder.path());
    let rebuilt = unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7)).unwrap().unwrap();
    assert_eq!((rebuilt.unsigned, rebuilt.differed.len()), (0, 0));
    assert!(!rebuilt.problem.is_empty());
    assert_eq!(unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7)).unwrap(), None);
    let newest = Checkpoint::read(files(folder.path()).last().unwrap()).unwrap();
    assert!(newest.link.unwrap().gap);
    verify(&database, None).unwrap();
    // As if it had been killed before the checkpoint of the rebuild was written.
    fs::remove_file(files(folder.path()).last().unwrap()).unwrap();
    let store = open(folder.path());
    shadowed(&store, "place@1.2.0");
    drop(store);
    drop(open(folder.path()));
    verify(&database, None).unwrap();

    // If no signature covers the records at the end, the error has their number.
    let records = verify(&database, None).unwrap().records;
    let before = Checkpoint::read(&files(folder.path())[2]).unwrap().seq;
    for file in &files(folder.path())[3..] {
        fs::remove_file(file).unwrap();
    }
    sql(folder.path(), "DELETE FROM meta WHERE key = 'signed_end'");
    refused(folder.path());
    let error = unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7)).unwrap_err();
    let (cause, problem) = refusal(&error);
    let named = format!("records {} to {records} (", before + 1);
    assert!(cause == RefusalCause::TakesUnsigned && problem.contains(&named), "{error}");
    refused(folder.path());
    let rebuilt = unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Take, BY, 7)).unwrap().unwrap();
    assert_eq!(rebuilt.unsigned, records - before);
    assert_eq!(verify(&database, None).unwrap().taken_unsigned, [(before + 1, records)]);
    let filter = AuditFilter { newest_first: true, limit: 1, ..AuditFilter::default() };
    let record = &Views::open_checked(&database).unwrap().audit(&filter).unwrap()[0];
    assert!(record.body.contains(&format!("\"unsigned\":{}", records - before)), "{}", record.body);
    drop(open(folder.path()));
}

#[test]
fn store_with_checkpoints_of_an_earlier_version_continues_from_them() {
    let folder = quick_folder();
    let store = schema_1(folder.path());
    let earlier = files(&store);
    let opened = open(&store);
    opened.commit(transaction("one more", opened.opening().head.at_ms, Vec::new())).unwrap();
    drop(opened);
    let first = Checkpoint::read(files(&store).last().unwrap()).unwrap();
    let link = first.link.clone().unwrap();
    assert_eq!(link.number, 1);
    assert_eq!(link.previous, Checkpoint::read(earlier.last().unwrap()).unwrap().digest());
    drop(open(&store));
    verify(&store.join("holdpoint.db"), None).unwrap();
    // The last of them is expected from then on.
    fs::remove_file(earlier.last().unwrap()).unwrap();
    assert_eq!(refusal(&refused(&store)).0, RefusalCause::Unsigned);
    assert!(matches!(not_sound(&store), VerifyError::History(HistoryError::Unsigned(_))));

    // A store of an earlier version with removed checkpoints is unsigned.
    let folder = quick_folder();
    let store = schema_1(folder.path());
    for file in files(&store) {
        fs::remove_file(file).unwrap();
    }
    let error = refused(&store);
    assert!(is_unsigned_at(&error, last(&store)), "{error}");
    not_sound(&store);
}

/// An attacker who replaces the unreadable key of the store by another one has made another store.
#[test]
fn replaced_store_key_is_refused() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let (database, keys) = (folder.path().join("holdpoint.db"), folder.path().join("keys"));
    let ours = public_key(folder.path());
    let id = open(folder.path()).store_id().to_owned();
    let own = keyfile::generate().unwrap();
    fs::remove_file(keys.join("store.key")).unwrap();
    keyfile::write_secret(&keys.join("store.key"), &own).unwrap();
    let error = refused(folder.path());
    assert!(
        matches!(&error, StoreError::Refused { path, cause: RefusalCause::KeyHalves, .. }
            if path.ends_with("store.pub")),
        "{error}"
    );
    fs::remove_file(keys.join("store.pub")).unwrap();
    keyfile::write_public(&keys.join("store.pub"), &own.verifying_key(), "").unwrap();
    // Signs everything of the store again.
    for file in files(folder.path()) {
        let old = Checkpoint::read(&file).unwrap();
        let head = holdpoint_audit::chain::Head { seq: old.seq, hash: old.head, at_ms: old.at_ms };
        let new = Checkpoint::sign(
            &old.store_id,
            (head, old.root.unwrap()),
            old.wall_ms,
            old.link.unwrap(),
            old.fold,
            &own,
        );
        fs::write(&file, serde_json::to_string(&new).unwrap()).unwrap();
    }
    let rebuilt = unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Take, BY, 7)).unwrap_err();
    for error in [refused(folder.path()), rebuilt] {
        let (cause, problem) = refusal(&error);
        assert!(cause == RefusalCause::ForeignKey && problem.contains(&id), "{error}");
    }
    let error = not_sound(folder.path());
    assert!(
        matches!(&error, VerifyError::History(HistoryError::Unsigned(problem)) if problem.contains(&id)),
        "{error}"
    );
    assert!(verify(&database, Some(&ours)).is_err());
}

/// An answered stop was once lost with the database's log: the end of the chain is signed right after it.
#[test]
fn chain_end_is_signed_after_a_stop_and_not_after_every_record() {
    let folder = quick_folder();
    let store = Store::open(folder.path()).unwrap();
    let newest = || {
        let names = fs::read_dir(store.layout().checkpoints()).unwrap();
        let seq = |name: String| name.strip_suffix(".json")?.parse::<u64>().ok();
        names.filter_map(|entry| seq(entry.unwrap().file_name().into_string().unwrap())).max()
    };
    for (nth, kind, signed) in [(1, RecordKind::Monitor, false), (2, RecordKind::CellStopped, true)] {
        let (subject, body) = (String::new(), "{}".to_owned());
        let audit = vec![AuditBody { kind, subject, body }];
        let transaction = transaction(&format!("command {nth}"), nth, Vec::new());
        store.commit(Transaction { audit, ..transaction }).unwrap();
        let end = store.views().unwrap().head().unwrap().seq;
        assert_eq!(newest() == Some(end), signed, "{kind}: {end}");
    }
}
