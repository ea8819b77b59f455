//! Tables rebuilt from the chain: equal to the old ones, with the damaged file beside them and a record of it.

use std::fs;
use std::path::Path;

use holdpoint_audit::rebuild_report::RebuildReport;
use holdpoint_governance::record::RecordKind;
use holdpoint_registry::{Store, UnsignedRecords, Views, rebuild, verify};
use holdpoint_store::{AuditFilter, RefusalCause, StoreError, VersionFilter};
use rusqlite::Connection;
use rusqlite::types::Value;

use crate::edits::{Dice, columns, edit, make_full_store, names, put_back, seed};
use crate::quick_folder::quick_folder;
use crate::released::schema_1;
use crate::support::*;

const BY: &str = "{\"user\":\"ada\"}";
/// Repaired edits.
const MENDED: usize = 150;

/// All contents of the tables that the chain covers.
fn contents(database: &Path) -> Vec<(String, Vec<Vec<Value>>)> {
    let connection = Connection::open(database).unwrap();
    let tables = [
        "meta",
        "context",
        "version",
        "family",
        "activation",
        "evidence",
        "approval_request",
        "approval",
        "alarm",
        "person",
    ];
    let of = |table: &str| {
        // Not every schema has persons.
        let there = "SELECT count(*) FROM sqlite_schema WHERE name = ?1";
        if connection.query_row(there, [table], |row| row.get::<_, u64>(0)).unwrap() == 0 {
            return Vec::new();
        }
        // The end is signed again.
        let but = if table == "meta" { "WHERE key <> 'signed_end'" } else { "" };
        let mut select = connection.prepare(&format!("SELECT * FROM {table} {but} ORDER BY 1")).unwrap();
        let count = select.column_count();
        let rows = select.query_map([], |row| (0..count).map(|index| row.get(index)).collect()).unwrap();
        rows.map(Result::unwrap).collect()
    };
    tables.iter().map(|table| ((*table).to_owned(), of(table))).collect()
}

fn sql(folder: &Path, text: &str) {
    let connection = Connection::open(folder.join("holdpoint.db")).unwrap();
    connection.execute_batch("PRAGMA foreign_keys = OFF; PRAGMA ignore_check_constraints = ON").unwrap();
    connection.execute_batch(text).unwrap();
}

fn mended(folder: &Path) -> RebuildReport {
    unless_in_use(|| rebuild(folder, UnsignedRecords::Refuse, BY, 7)).unwrap().unwrap()
}

#[test]
fn rebuild_restores_every_edited_row_and_is_recorded() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let database = folder.path().join("holdpoint.db");
    let (whole, before) = (fs::read(&database).unwrap(), contents(&database));
    let head = verify(&database, None).unwrap().head;
    let checkpoints = folder.path().join("checkpoints");
    let checkpoint_names = names(&checkpoints);
    let all = columns(&Connection::open(&database).unwrap());
    let tables: Vec<_> = all.iter().filter(|(table, _)| table != "audit").collect();
    let mut dice = Dice(seed());
    let mut edits = 0;
    for (table, column) in tables.iter().cycle() {
        if edits == MENDED {
            break;
        }
        let done = edit(&database, &mut dice, table, column);
        let at_all = (table.as_str(), column.as_str()) != ("command", "digest");
        if let Some(what) = done.filter(|_| at_all) {
            let damaged = fs::read(&database).unwrap();
            match unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7)) {
                // Records may be missing behind an end that names more.
                Err(StoreError::Refused { .. }) if table == "audit_head" => {}
                Err(error) => panic!("{what}: {error}"),
                Ok(None) => panic!("{what}: nothing was found"),
                Ok(Some(rebuilt)) => {
                    assert_eq!(rebuilt.from_hash, head, "{what}");
                    assert_eq!(fs::read(folder.path().join(&rebuilt.kept_as)).unwrap(), damaged, "{what}");
                    let after = contents(&database);
                    if column == "signed" {
                        assert_eq!(rebuilt.lost.len(), 1, "{what}");
                    } else {
                        assert_eq!((&after, &rebuilt.lost), (&before, &Vec::new()), "{what}");
                    }
                    verify(&database, None).unwrap_or_else(|error| panic!("{what}: {error}"));
                    let store = open(folder.path());
                    let views = store.views().unwrap();
                    for version in views.versions(&VersionFilter::default()).unwrap().0 {
                        views.approvals(&version.version).unwrap_or_else(|error| panic!("{what}: {error}"));
                    }
                    drop((views, store));
                    fs::remove_file(folder.path().join(&rebuilt.kept_as)).unwrap();
                }
            }
            edits += 1;
        }
        fs::write(&database, &whole).unwrap();
        put_back(&checkpoints, &checkpoint_names);
    }
}

#[test]
fn rebuild_record_names_the_user_and_the_rows() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let database = folder.path().join("holdpoint.db");
    assert_eq!(
        unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7)).unwrap(),
        None,
        "there is nothing to repair"
    );
    sql(folder.path(), "UPDATE version SET permissions = '[1]', author = 'eve' WHERE name = 'grasp@1.1.0'");
    let refused = unless_in_use(|| Store::open(folder.path())).unwrap_err();
    assert!(refused.to_string().contains("(author, permissions)"), "{refused}");
    assert!(Views::open_checked(&database).is_err());
    sql(folder.path(), "DROP TRIGGER audit_no_delete; DELETE FROM alarm");
    let rebuilt = mended(folder.path());
    let differed: Vec<_> = rebuilt
        .differed
        .iter()
        .map(|row| (row.table.as_str(), row.key.as_str(), row.columns.clone()))
        .collect();
    assert_eq!(
        differed,
        [
            ("version", "grasp@1.1.0", vec!["author".to_owned(), "permissions".to_owned()]),
            ("alarm", "a1", vec![]),
        ]
    );
    let views = Views::open_checked(&database).unwrap();
    let filter = AuditFilter { kind: Some(RecordKind::StoreRebuilt), ..AuditFilter::default() };
    let records = views.audit(&filter).unwrap();
    assert_eq!(records.len(), 1);
    for part in
        ["\"user\":\"ada\"", "permissions", "store-rebuilt", &rebuilt.kept_as, &rebuilt.from_hash.to_string()]
    {
        assert!(records[0].body.contains(part), "{part}: {}", records[0].body);
    }
    drop(views);
    // The store continues, and another rebuild begins where this one ended.
    let store = open(folder.path());
    shadowed(&store, "place@1.2.0");
    let busy = rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7).unwrap_err();
    assert!(matches!(busy, StoreError::InUse { .. }), "{busy}");
    drop(store);
    sql(folder.path(), "UPDATE family SET standing = NULL");
    let again = mended(folder.path());
    assert_eq!(again.differed.len(), 1);
    verify(&database, None).unwrap();
}

#[test]
fn rebuild_refuses_a_damaged_chain() {
    let folder = quick_folder();
    make_full_store(folder.path());
    sql(folder.path(), "DROP TRIGGER audit_no_update; UPDATE audit SET body = '{}' WHERE seq = 9");
    let before = fs::read(folder.path().join("holdpoint.db")).unwrap();
    let error = rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7).unwrap_err();
    let (cause, problem) = refusal(&error);
    assert!(cause == RefusalCause::Damaged && problem.contains("audit record 9"), "{error}");
    assert_eq!(fs::read(folder.path().join("holdpoint.db")).unwrap(), before);
}

/// Records of the first schema repeat no texts: a text that the chain lacks is lost by name, or refused by name.
#[test]
fn store_of_schema_1_is_rebuilt_from_its_records() {
    let store = |text: &str| {
        let folder = quick_folder();
        let store = schema_1(folder.path());
        let before = contents(&store.join("holdpoint.db"));
        sql(&store, text);
        (folder, store, before)
    };
    let mendable = "DROP TRIGGER version_terminal; DROP TRIGGER version_identity;
        UPDATE version SET state = 'active', author = 'eve', permissions = '{}' WHERE state = 'rejected';
        UPDATE family SET active = pinned, pinned = NULL WHERE pinned IS NOT NULL;
        UPDATE approval SET who = 'eve'; UPDATE alarm SET state = 'normal'; DELETE FROM activation";
    let mendable = mendable.replace(
        "WHERE state = 'rejected'",
        "WHERE name = (SELECT name FROM version WHERE state = 'rejected' LIMIT 1)",
    );
    let (_folder, folder, before) =
        store(&format!("DROP TRIGGER approval_once; DROP INDEX one_active; {mendable}"));
    let rebuilt = mended(&folder);
    assert_eq!(rebuilt.lost, []);
    let after = contents(&folder.join("holdpoint.db"));
    for ((table, before), (_, after)) in before.iter().zip(&after) {
        // Schema 2 has a column more, which no record of schema 1 fills.
        let after: Vec<Vec<Value>> =
            after.iter().map(|row| row[..before.first().map_or(row.len(), Vec::len)].to_vec()).collect();
        assert_eq!(&after, before, "{table}");
    }
    verify(&folder.join("holdpoint.db"), None).unwrap();
    drop(open(&folder));

    let (_folder, folder, _) = store("UPDATE evidence SET json = '{}' WHERE kind = 'sandbox'");
    let rebuilt = mended(&folder);
    assert!(
        !rebuilt.lost.is_empty() && rebuilt.lost.iter().all(|(table, _)| table == "evidence"),
        "{:?}",
        rebuilt.lost
    );
    verify(&folder.join("holdpoint.db"), None).unwrap();
    sql(&folder, "UPDATE family SET reason = 'x'");
    mended(&folder);
    verify(&folder.join("holdpoint.db"), None).unwrap();

    let (_folder, folder, _) = store("UPDATE family SET standing = '{}' WHERE name = 'grasp'");
    let error = unless_in_use(|| rebuild(&folder, UnsignedRecords::Refuse, BY, 7)).unwrap_err();
    let (cause, problem) = refusal(&error);
    assert!(cause == RefusalCause::Damaged && problem.contains("family \"grasp\""), "{error}");
    assert!(!folder.join("holdpoint.rebuilt").exists());
}
