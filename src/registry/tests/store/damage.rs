//! Tampering and decay: every change of the files is found, or changes nothing that is read.

use std::fs;
use std::panic::catch_unwind;
use std::path::Path;

use holdpoint_audit::history_error::HistoryError;
use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::record::{AuditRecord, VersionSummary};
use holdpoint_registry::{Store, UnsignedRecords, Views, rebuild, verify};
use holdpoint_store::{
    AuditFilter, Change, EvidenceKind, RefusalCause, VerifyError, VersionDetail, VersionFilter,
};
use rusqlite::{Connection, params};

use crate::proofs::heads;
use crate::quick_folder::quick_folder;
use crate::support::*;

const BY: &str = "{\"user\":\"ada\"}";

/// A closed store with every kind of row, and its key.
pub fn make_store_with_approval(folder: &Path) -> ed25519_dalek::VerifyingKey {
    let store = open(folder);
    bootstrap(&store, "grasp");
    bootstrap(&store, "place");
    shadowed(&store, "grasp@1.1.0");
    let signed = approve(&store, &person(&store, "ada"), "grasp@1.1.0", 1);
    let alarm = Change::AlarmChange {
        alarm: "a1".into(),
        subject: "grasp@1.1.0".into(),
        state: AlarmState::Unacknowledged,
        priority: Priority::High,
        json: "{}".into(),
    };
    commit(&store, "put", vec![Change::PutApproval(Box::new(signed)), alarm]).unwrap();
    let mut changes = vec![consume("grasp@1.1.0", 1)];
    changes.extend(activation("grasp@1.1.0", ("grasp@1.0.0", 2), 1));
    changes.push(evidence("grasp@1.1.0", EvidenceKind::Activation, "activation"));
    commit(&store, "activate", changes).unwrap();
    *store.public_key()
}

pub const UNLOCK: &str =
    "DROP TRIGGER audit_no_delete; DROP TRIGGER audit_no_update; DROP TRIGGER audit_in_order;
    DROP TRIGGER version_kept; DROP TRIGGER version_identity; DROP TRIGGER version_terminal;
    DROP TRIGGER approval_once; DROP TRIGGER approval_kept;
    DROP TRIGGER person_kept; DROP TRIGGER person_identity; DROP TRIGGER person_revoked;
    DROP TRIGGER IF EXISTS person_confirmed; PRAGMA foreign_keys = OFF;";

/// Edits the chain, then corrects hashes and head, as an attacker with write access to the file can.
pub fn rewrite(folder: &Path, edit: &str) {
    let connection = Connection::open(folder.join("holdpoint.db")).unwrap();
    let mut select = connection.prepare("SELECT sql FROM sqlite_schema WHERE type = 'trigger'").unwrap();
    let triggers: Vec<String> = select.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect();
    drop(select);
    connection.execute_batch(UNLOCK).unwrap();
    connection.execute_batch(edit).unwrap();
    drop(connection);
    let mut records =
        Views::open(&folder.join("holdpoint.db")).unwrap().audit(&AuditFilter::default()).unwrap();
    let connection = Connection::open(folder.join("holdpoint.db")).unwrap();
    let mut prev = holdpoint_governance::ids::Digest::from_bytes([0; 32]);
    for record in &mut records {
        record.prev = prev;
        record.hash = record.expected_hash();
        prev = record.hash;
        let AuditRecord { seq, prev, hash, .. } = record;
        let sql = "UPDATE audit SET prev = ?2, hash = ?3 WHERE seq = ?1";
        connection.execute(sql, params![*seq, prev.bytes(), hash.bytes()]).unwrap();
    }
    connection
        .execute("UPDATE audit_head SET seq = ?1, hash = ?2", params![records.len(), prev.bytes()])
        .unwrap();
    let sql = "UPDATE command SET receipt = json_set(receipt, '$.head', (SELECT lower(hex(hash)) FROM audit WHERE seq = last_seq))";
    connection.execute_batch(sql).unwrap();
    connection.execute_batch(&triggers.join(";")).unwrap();
}

#[test]
fn every_tampering_is_found() {
    type ErrorCheck = fn(&VerifyError) -> bool;
    let table: [(&str, &str, ErrorCheck); 17] = [
        ("body", "UPDATE audit SET body = '[]' WHERE seq = 5", |e| {
            matches!(e, VerifyError::History(HistoryError::Record { seq: 5, .. }))
        }),
        ("kind", "UPDATE audit SET kind = 'x' WHERE seq = 6", |e| {
            matches!(e, VerifyError::History(HistoryError::Record { seq: 6, .. }))
        }),
        ("time", "UPDATE audit SET at_ms = 0 WHERE seq = 7", |e| {
            matches!(e, VerifyError::History(HistoryError::Record { seq: 7, .. }))
        }),
        ("hash", "UPDATE audit SET hash = zeroblob(32) WHERE seq = 8", |e| {
            matches!(e, VerifyError::History(HistoryError::Record { seq: 8, .. }))
        }),
        ("dropped", "DELETE FROM audit WHERE seq = 9", |e| {
            matches!(e, VerifyError::History(HistoryError::Record { seq: 9, .. }))
        }),
        ("first dropped", "DELETE FROM audit WHERE seq = 1", |e| {
            matches!(e, VerifyError::History(HistoryError::Record { seq: 1, .. }))
        }),
        (
            "reordered",
            "UPDATE audit SET seq = -seq WHERE seq IN (3, 4); UPDATE audit SET seq = 7 + seq WHERE seq < 0",
            |e| {
                matches!(
                    e,
                    VerifyError::History(HistoryError::Record { seq: 3, .. }) | VerifyError::Damaged(_)
                )
            },
        ),
        ("cut off", "DELETE FROM audit WHERE seq > 10", |e| {
            matches!(e, VerifyError::History(HistoryError::Record { seq: 11, .. }))
        }),
        (
            "cut off with its end",
            "DELETE FROM audit WHERE seq > 10; UPDATE audit_head SET seq = 10, hash = (SELECT hash FROM audit WHERE seq = 10)",
            |e| {
                matches!(
                    e,
                    VerifyError::State { .. } | VerifyError::History(HistoryError::Record { seq: 11, .. })
                )
            },
        ),
        ("state", "UPDATE version SET state = 'demoted' WHERE name = 'grasp@1.0.0'", state),
        ("bundle", "UPDATE version SET bundle_digest = candidate_digest WHERE name = 'grasp@1.0.0'", state),
        ("pointer", "UPDATE family SET active = 'grasp@1.0.0', pinned = NULL WHERE name = 'grasp'", state),
        ("evidence", "UPDATE evidence SET json = '{\"is\":\"good\"}' WHERE kind = 'gate'", state),
        ("activation", "DELETE FROM activation WHERE cause = 'gate'", state),
        ("approval used again", "UPDATE approval SET consumed_seq = NULL", state),
        (
            "approval's words",
            "UPDATE approval SET signed = replace(signed, '\"reason\":\"seen\"', '\"reason\":\"glad\"')",
            |e| matches!(e, VerifyError::History(HistoryError::Approval { .. })),
        ),
        ("alarm", "DELETE FROM alarm", state),
    ];
    for (name, edit, expected) in table {
        let folder = quick_folder();
        let key = make_store_with_approval(folder.path());
        let database = folder.path().join("holdpoint.db");
        verify(&database, Some(&key)).unwrap();
        let connection = Connection::open(&database).unwrap();
        connection.execute_batch(UNLOCK).unwrap();
        connection.execute_batch("PRAGMA ignore_check_constraints = ON").unwrap();
        connection.execute_batch(edit).unwrap();
        drop(connection);
        let error = verify(&database, Some(&key)).expect_err(name);
        assert!(expected(&error), "{name}: {error}");
    }
}

/// Removes the entries of some kind from the index of kinds: queries for such records find none.
pub(crate) fn hide(database: &Path, kind: &str) {
    index_otherwise(database, kind, |whole| format!("{whole} WHERE kind <> '{kind}'"));
}

/// Makes the index of kinds with another definition. Queries for records of the kind find none.
fn index_otherwise(database: &Path, kind: &str, definition: impl Fn(&str) -> String) {
    let connection = Connection::open(database).unwrap();
    let whole: String = connection
        .query_row("SELECT sql FROM sqlite_schema WHERE name = 'audit_kind'", [], |row| row.get(0))
        .unwrap();
    let set = |sql: &str| {
        let connection = Connection::open(database).unwrap();
        connection.execute_batch("PRAGMA writable_schema = ON").unwrap();
        connection.execute("UPDATE sqlite_schema SET sql = ?1 WHERE name = 'audit_kind'", [sql]).unwrap();
    };
    drop(connection);
    set(&definition(&whole));
    Connection::open(database).unwrap().execute_batch("REINDEX audit_kind").unwrap();
    set(&whole);
    let found: i64 = Connection::open(database)
        .unwrap()
        .query_row("SELECT count(*) FROM audit WHERE kind = ?1 AND seq > 0", [kind], |row| row.get(0))
        .unwrap();
    assert_eq!(found, 0, "it is hidden");
}

#[test]
fn record_hidden_by_an_index_is_reported_missing() {
    let folder = quick_folder();
    let key = make_store_with_approval(folder.path());
    let database = folder.path().join("holdpoint.db");
    hide(&database, "decision");
    let error = verify(&database, Some(&key)).unwrap_err();
    assert!(matches!(&error, VerifyError::Damaged(text) if text.contains("audit_kind")), "{error}");
    let error = Store::open(folder.path()).unwrap_err();
    assert!(refusal(&error).1.contains("audit_kind"), "{error}");

    // The same number of entries, some of them changed.
    let folder = quick_folder();
    let key = make_store_with_approval(folder.path());
    let database = folder.path().join("holdpoint.db");
    index_otherwise(&database, "decision", |whole| {
        whole.replace("(kind,", "(CASE kind WHEN 'decision' THEN 'drift' ELSE kind END,")
    });
    let error = verify(&database, Some(&key)).unwrap_err();
    assert!(matches!(&error, VerifyError::Damaged(text) if text.contains("\"audit_kind\"")), "{error}");
    // A rebuild from the records repairs false indexes.
    let rebuilt = unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7)).unwrap();
    assert!(rebuilt.is_some());
    verify(&database, Some(&key)).unwrap();
    let again = unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7)).unwrap();
    assert!(again.is_none(), "nothing is left to repair");
}

/// As many entries as records, with a stop of the cell under another kind: a query would not find the stop.
#[test]
fn stop_hidden_by_an_index_is_found_at_the_start() {
    let folder = quick_folder();
    make_store_with_approval(folder.path());
    let store = open(folder.path());
    let mut stop = transaction("stop", store.opening().head.at_ms + 1, Vec::new());
    stop.audit = vec![holdpoint_store::AuditBody {
        kind: holdpoint_governance::record::RecordKind::CellStopped,
        subject: String::new(),
        body: "{\"by\":\"ana\"}".to_owned(),
    }];
    store.commit(stop).unwrap();
    drop(store);
    open(folder.path());
    let database = folder.path().join("holdpoint.db");
    index_otherwise(&database, "cell-stopped", |whole| {
        whole.replace("(kind,", "(CASE kind WHEN 'cell-stopped' THEN 'drift' ELSE kind END,")
    });
    let error = Store::open(folder.path()).unwrap_err();
    let (cause, problem) = refusal(&error);
    assert!(cause == RefusalCause::NotTheChain && problem.contains("\"audit_kind\""), "{error}");
    assert!(Views::open_checked(&database).is_err(), "nor is it shown");
    assert!(unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7)).unwrap().is_some());
    open(folder.path());
}

/// The same for an index of another table than the chain's.
#[test]
fn a_false_index_is_repaired_by_a_rebuild() {
    let folder = quick_folder();
    let key = make_store_with_approval(folder.path());
    let database = folder.path().join("holdpoint.db");
    let (name, whole): (String, String) = Connection::open(&database)
        .unwrap()
        .query_row("SELECT name, sql FROM sqlite_schema WHERE name = 'evidence_version'", [], |row| {
            Ok((row.get(0)?, row.get(1)?))
        })
        .unwrap();
    let set = |sql: &str| {
        let connection = Connection::open(&database).unwrap();
        connection.execute_batch("PRAGMA writable_schema = ON").unwrap();
        connection
            .execute("UPDATE sqlite_schema SET sql = ?1 WHERE name = ?2", [sql, name.as_str()])
            .unwrap();
    };
    set(&whole.replace("(version", "(version || 'x'"));
    Connection::open(&database).unwrap().execute_batch(&format!("REINDEX {name}")).unwrap();
    set(&whole);
    let error = verify(&database, Some(&key)).unwrap_err();
    assert!(matches!(&error, VerifyError::Damaged(_)), "{error}");
    assert!(unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7)).unwrap().is_some());
    verify(&database, Some(&key)).unwrap();
}

fn state(error: &VerifyError) -> bool {
    matches!(error, VerifyError::State { .. })
}

#[test]
fn rewritten_chain_is_found_by_its_checkpoints() {
    let folder = quick_folder();
    let key = make_store_with_approval(folder.path());
    let database = folder.path().join("holdpoint.db");
    let records = verify(&database, Some(&key)).unwrap().records;
    rewrite(folder.path(), "UPDATE audit SET body = '{\"edited\":1}' WHERE kind = 'decision' AND seq = 5");
    let error = verify(&database, Some(&key)).unwrap_err();
    let signed = heads(folder.path()).into_iter().map(|(_, head)| head.seq).find(|seq| *seq >= 5).unwrap();
    assert!(
        matches!(error, VerifyError::History(HistoryError::Record { seq, .. }) if seq == signed),
        "{error}"
    );
    // Removing them does not help either.
    fs::remove_dir_all(folder.path().join("checkpoints")).unwrap();
    let error = verify(&database, Some(&key)).unwrap_err();
    assert!(
        matches!(error, VerifyError::History(HistoryError::Record { seq, .. }) if seq == records),
        "{error}"
    );
}

#[test]
fn checkpoints_of_another_store_are_refused() {
    let (ours, theirs) = (quick_folder(), quick_folder());
    let (our_key, their_key) =
        (make_store_with_approval(ours.path()), make_store_with_approval(theirs.path()));
    let database = ours.path().join("holdpoint.db");
    let error = verify(&database, Some(&their_key)).unwrap_err();
    assert!(matches!(error, VerifyError::History(HistoryError::Unsigned(_))), "{error}");
    for entry in fs::read_dir(theirs.path().join("checkpoints")).unwrap() {
        let entry = entry.unwrap();
        fs::copy(entry.path(), ours.path().join("checkpoints").join(entry.file_name())).unwrap();
    }
    for key in [Some(&our_key), None] {
        let error = verify(&database, key).unwrap_err();
        assert!(matches!(error, VerifyError::History(HistoryError::Checkpoint { .. })), "{error}");
    }
    let copied = quick_folder();
    fs::copy(&database, copied.path().join("copy.db")).unwrap();
    let report = holdpoint_registry::verify_copy(&copied.path().join("copy.db"), Some(&our_key)).unwrap();
    assert_eq!(report.checkpoints, 0, "a copy alone has none");
}

/// The readable content of a store.
pub fn contents(database: &Path) -> Result<String, String> {
    let read = || {
        let views = Views::open(database)?;
        let versions = views.versions(&VersionFilter::default())?;
        // Nothing vouches for the machine's time of a record.
        let without_wall = |mut detail: VersionDetail| {
            detail.summary.changed_at = None;
            detail
        };
        let detail = |of: &VersionSummary| views.version(&of.version).map(|found| found.map(without_wall));
        let details: Result<Vec<_>, _> = versions.0.iter().map(detail).collect();
        let records: Vec<_> =
            views.audit(&AuditFilter::default())?.iter().map(|record| record.hash).collect();
        let (families, alarms, context) = (views.families()?, views.alarms()?, views.context()?);
        Ok(format!(
            "{details:?} {records:?} {families:?} {alarms:?} {context:?} {:?}",
            views.open_requests()?
        ))
    };
    read().map_err(|error: holdpoint_store::StoreError| error.to_string())
}

/// Flips one bit at a time: verification finds it, or all reads are unchanged. Nothing panics.
#[test]
fn flipped_bits_are_found_or_harmless() {
    const FLIPS: usize = 200;
    let folder = quick_folder();
    let key = make_store_with_approval(folder.path());
    let database = folder.path().join("holdpoint.db");
    let good = fs::read(&database).unwrap();
    let before = contents(&database).unwrap();
    // Most of this small file is free space, where a flip changes nothing.
    let used: Vec<usize> = (0..good.len()).filter(|byte| good[*byte] != 0).collect();
    let mut found = 0;
    let mut seed = 0x9E37_79B9_7F4A_7C15_u64;
    for flip in 0..FLIPS {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        let bit = usize::try_from(seed % (used.len() as u64 * 8)).unwrap();
        let bit = used[bit / 8] * 8 + bit % 8;
        let mut bad = good.clone();
        bad[bit / 8] ^= 1 << (bit % 8);
        fs::write(&database, &bad).unwrap();
        let verified = catch_unwind(|| verify(&database, Some(&key)));
        let verified = verified.unwrap_or_else(|_| panic!("flip {flip} of bit {bit}: verify panicked"));
        let opened = catch_unwind(|| Store::open(folder.path()).is_ok());
        assert!(opened.is_ok(), "flip {flip} of bit {bit}: open panicked");
        fs::write(&database, &bad).unwrap();
        match verified {
            Err(_) => found += 1,
            Ok(_) => assert_eq!(contents(&database).as_ref(), Ok(&before), "flip {flip} of bit {bit}"),
        }
    }
    assert!(found > FLIPS / 4, "only {found} of {FLIPS} flips were found");
}

/// An attacker with write access to the file can put the largest number there.
#[test]
fn record_with_the_largest_number_does_not_break_the_verifier() {
    let root = crate::quick_folder::quick_folder();
    let store = crate::verifiers::sample_stores(root.path()).remove(2);
    let last = "json('18446744073709551615')";
    rewrite(
        &store,
        &format!(
            "UPDATE audit SET body = json_set(body, '$.change.unsigned', 1, '$.change.from_seq', {last})
             WHERE kind = 'store-rebuilt'"
        ),
    );
    let error = verify(&store.join("holdpoint.db"), None).unwrap_err();
    assert!(matches!(error, VerifyError::History(HistoryError::Record { .. })), "{error}");
}
