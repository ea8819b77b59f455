//! Stores of released schemas: read unchanged, migrated to the newest schema, and still sound.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use holdpoint_governance::store_finding::StoreFinding;
use holdpoint_registry::{Views, verify};
use rusqlite::Connection;

use crate::quick_folder::quick_folder;
use crate::support::*;

/// A copy of the store of schema 1, made by a released program.
pub fn schema_1(folder: &Path) -> PathBuf {
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/store-4831bf5/store");
    let to = folder.join("store");
    copy(&from, &to);
    to
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let (from, to) = (entry.as_ref().unwrap().path(), to.join(entry.unwrap().file_name()));
        if from.is_dir() {
            copy(&from, &to);
        } else {
            fs::copy(&from, &to).unwrap();
            if to.extension().is_some_and(|extension| extension == "key") {
                fs::set_permissions(&to, fs::Permissions::from_mode(0o600)).unwrap();
            }
        }
    }
}

fn schema(database: &Path) -> u64 {
    let connection = Connection::open(database).unwrap();
    connection.query_row("PRAGMA user_version", [], |row| row.get(0)).unwrap()
}

#[test]
fn schema_1_is_read_unchanged_and_migrated_by_its_first_writer() {
    let folder = quick_folder();
    let store = schema_1(folder.path());
    let database = store.join("holdpoint.db");
    let before = verify(&database, None).unwrap();
    assert_eq!(Views::open(&database).unwrap().pointer_robots().unwrap(), []);
    assert_eq!(schema(&database), 1, "reading changes nothing");
    let looked = holdpoint_registry::check_store(&store).unwrap();
    assert!(looked.contains(&StoreFinding::SignedByCheckpoints), "{looked:?}");
    let opened = open(&store);
    assert_eq!(opened.opening().head.hash, before.head);
    assert_eq!(opened.views().unwrap().pointer_robots().unwrap(), [], "no record says with which robot");
    // The rows match their records; later ones name their robot.
    assert_eq!(verify(&database, None).unwrap(), before);
    drop(opened);
    assert_eq!(schema(&database), 4);
    drop(open(&store));
    assert_eq!(verify(&database, None).unwrap(), before);
}

/// Schema 2 had no persons: the migration enrolls no one, whatever keys are there.
#[test]
fn migrated_schema_2_trusts_only_its_first_administrator() {
    let folder = quick_folder();
    let store = schema_1(folder.path());
    let database = store.join("holdpoint.db");
    let connection = Connection::open(&database).unwrap();
    connection.execute_batch(include_str!("../../schema/store-2.sql")).unwrap();
    connection.pragma_update(None, "user_version", 2).unwrap();
    drop(connection);
    let before = verify(&database, None).unwrap();
    assert!(Views::open(&database).unwrap().persons().unwrap().is_empty());
    assert_eq!(schema(&database), 2, "reading changes nothing");
    let opened = open(&store);
    assert!(opened.persons().unwrap().is_empty());
    assert_eq!(opened.first_administrator(0).unwrap().as_deref(), Some("admin"));
    let names: Vec<_> = opened.persons().unwrap().all().map(|person| person.name.clone()).collect();
    assert_eq!(names, ["admin"]);
    drop(opened);
    assert_eq!(schema(&database), 4);
    let after = verify(&database, None).unwrap();
    assert_eq!((after.records, after.persons), (before.records + 1, 1));
}
