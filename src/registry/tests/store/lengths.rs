//! Texts and files longer than any that the program writes: each is refused before it is loaded, and named.

use std::fs::{self, File};
use std::path::Path;
use std::time::{Duration, Instant};

use holdpoint_registry::{
    BackupParts, DatabaseLocation, ExportScope, Store, UnsignedRecords, VerifyOptions, Views, backup,
    check_store, export_store, rebuild, store_info, verify, verify_against, verify_copy,
};
use holdpoint_store::Layout;
use rusqlite::Connection;

use crate::damage::UNLOCK;
use crate::edits::make_full_store;
use crate::quick_folder::quick_folder;
use crate::support::*;

/// The longest text that is read.
const LIMIT: &str = "33554432";

/// Puts a text of 34 MB somewhere, with direct SQL.
fn lengthen(database: &Path, edit: &str) {
    let connection = Connection::open(database).unwrap();
    connection.execute_batch(UNLOCK).unwrap();
    connection.execute_batch("PRAGMA ignore_check_constraints = 1").unwrap();
    let changed = connection.execute(&edit.replace("$LONG", "hex(zeroblob(17000000))"), []).unwrap();
    assert!(changed > 0, "{edit}");
}

#[test]
fn a_text_that_is_too_long_is_refused_with_its_table() {
    for (edit, named) in [
        ("UPDATE meta SET value = $LONG WHERE key = 'store_id'", "table meta"),
        ("UPDATE meta SET value = $LONG WHERE key = 'signed_end'", "table meta"),
        ("UPDATE evidence SET json = $LONG WHERE seq = (SELECT max(seq) FROM evidence)", "table evidence"),
        ("UPDATE version SET manifest = $LONG WHERE name = 'grasp@1.1.0'", "table version"),
        (
            "UPDATE command SET receipt = $LONG WHERE last_seq = 1 OR id = (SELECT max(id) FROM command)",
            "table command",
        ),
        ("UPDATE audit SET body = $LONG WHERE seq = 9", "audit record 9"),
    ] {
        let (folder, to) = (quick_folder(), quick_folder());
        make_full_store(folder.path());
        let database = folder.path().join("holdpoint.db");
        lengthen(&database, edit);
        let copied = to.path().join("copy");
        for error in [
            unless_in_use(|| Store::open(folder.path())).map(drop).unwrap_err().to_string(),
            verify(&database, None).unwrap_err().to_string(),
            verify_copy(&database, None).unwrap_err().to_string(),
            Views::open_checked(&database).map(drop).unwrap_err().to_string(),
            backup(folder.path(), &copied, BackupParts::default()).unwrap_err().to_string(),
        ] {
            assert!(error.contains(named) && error.contains(LIMIT), "{edit}: {error}");
            assert!(error.len() < 1000, "{edit}: the error has {} bytes", error.len());
        }
        assert!(!copied.exists());
        // A less thorough check may miss it, and never loads it.
        for error in [
            store_info(folder.path()).err().map(|error| error.to_string()),
            check_store(folder.path()).err().map(|error| error.to_string()),
            export_store(&database, ExportScope::Unchecked, None, &mut std::io::sink())
                .err()
                .map(|it| it.to_string()),
        ] {
            let error = error.unwrap_or_else(|| LIMIT.to_owned());
            assert!(error.contains(LIMIT) && error.len() < 1000, "{edit}: {error:.1000}");
        }
    }
}

/// A rebuild can replace a text that is too long for a reader: it restores the chain's value.
#[test]
fn rebuild_repairs_texts_that_are_too_long() {
    for edit in [
        "UPDATE meta SET value = $LONG WHERE key = 'store_id'",
        "UPDATE family SET reason = $LONG WHERE name = 'grasp'",
        "UPDATE version SET author = $LONG WHERE name = 'grasp@1.0.0'",
        "UPDATE evidence SET json = $LONG WHERE seq = (SELECT max(seq) FROM evidence)",
        "INSERT INTO command (id, digest, last_seq, receipt) VALUES ('zz', '0', 1, $LONG)",
        "INSERT INTO command (id, digest, last_seq, receipt) VALUES ($LONG, '0', 1, '{}')",
    ] {
        let folder = quick_folder();
        make_full_store(folder.path());
        let database = folder.path().join("holdpoint.db");
        lengthen(&database, edit);
        unless_in_use(|| Store::open(folder.path())).map(drop).unwrap_err();
        let rebuilt =
            unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, "{\"user\":\"ada\"}", 7));
        assert!(rebuilt.unwrap_or_else(|error| panic!("{edit}: {error}")).is_some(), "{edit}");
        verify(&database, None).unwrap();
        open(folder.path());
    }
}

#[test]
fn a_copy_with_a_text_that_is_too_long_is_named() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let (database, copy) = (folder.path().join("holdpoint.db"), folder.path().join("copy.db"));
    fs::copy(&database, &copy).unwrap();
    lengthen(&copy, "UPDATE meta SET value = $LONG WHERE key = 'signed_end'");
    let against = [copy];
    let options =
        VerifyOptions { key: None, against: &against, place: DatabaseLocation::Store, tell: &|_, _, _| {} };
    let error = verify_against(&database, &options).unwrap_err().to_string();
    assert!(error.contains("copy.db") && error.contains("table meta") && error.contains(LIMIT), "{error}");
}

#[test]
fn a_large_file_among_keys_and_profiles_is_refused_by_its_size() {
    for name in ["keys/huge.pub", "keys/identities/huge.pub", "profiles/huge.toml", "keys/store.key"] {
        let (folder, to) = (quick_folder(), quick_folder());
        make_full_store(folder.path());
        fs::create_dir_all(Layout::new(folder.path()).profiles()).unwrap();
        let path = folder.path().join(name);
        let file = File::options().create(true).truncate(false).write(true).open(&path).unwrap();
        for bytes in [64 * 1024 + 1, 1 << 40] {
            file.set_len(bytes).unwrap();
            let begun = Instant::now();
            let parts = BackupParts { keys: true, recordings: None };
            let error = backup(folder.path(), &to.path().join("copy"), parts).unwrap_err().to_string();
            assert!(
                error.contains(name) && error.contains("65536") && error.contains(&bytes.to_string()),
                "{error}"
            );
            assert!(begun.elapsed() < Duration::from_secs(20));
            assert_eq!(fs::read_dir(to.path()).unwrap().count(), 0);
        }
    }
}
