//! What an engine finds when it starts: its store, another engine, a foreign file.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use holdpoint_registry::Store;
use holdpoint_store::{RefusalCause, StoreError};
use holdpoint_text::Hint as _;
use rusqlite::Connection;

use crate::proofs::heads;
use crate::quick_folder::quick_folder;
use crate::support::*;

/// A closed store with a little history.
fn make_small_store(folder: &Path) {
    let store = open(folder);
    bootstrap(&store, "grasp");
    shadowed(&store, "grasp@1.1.0");
    commit(&store, "activate", activation("grasp@1.1.0", ("grasp@1.0.0", 2), 0)).unwrap();
}

#[test]
fn reopened_store_keeps_its_id_and_content() {
    let folder = quick_folder();
    let store = open(folder.path());
    assert!(store.opening().created);
    let (store_id, key) = (store.store_id().to_owned(), *store.public_key());
    drop(store);
    make_small_store(folder.path());
    let store = open(folder.path());
    assert!(!store.opening().created);
    assert_eq!((store.store_id(), *store.public_key()), (store_id.as_str(), key));
    assert_eq!(store.opening().head, store.views().unwrap().head().unwrap());
    let layout = store.layout();
    for path in [layout.store_key(), layout.lock()] {
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600, "{path:?}");
    }
    for folder in [layout.folder().to_owned(), layout.checkpoints(), layout.recordings(), layout.logs()] {
        assert!(folder.is_dir(), "{folder:?}");
    }
}

/// Nothing is written through a planted link in place of one of the store's folders.
#[test]
fn a_link_in_the_place_of_a_folder_is_refused() {
    for name in ["keys", "keys/identities", "checkpoints", "recordings", "logs", "compiled"] {
        let (folder, elsewhere) = (quick_folder(), quick_folder());
        make_small_store(folder.path());
        let place = folder.path().join(name);
        fs::create_dir_all(&place).unwrap();
        let there = elsewhere.path().join("there");
        fs::rename(&place, &there).unwrap();
        let before = fs::read_dir(&there).unwrap().count();
        std::os::unix::fs::symlink(&there, &place).unwrap();
        let error = Store::open(folder.path()).unwrap_err();
        assert!(matches!(&error, StoreError::Invalid { value, .. } if value.ends_with(name)), "{error}");
        assert_eq!(fs::read_dir(&there).unwrap().count(), before, "{name}");
        fs::remove_file(&place).unwrap();
        fs::rename(&there, &place).unwrap();
        open(folder.path());
    }
}

/// Writes to an unlinked file are lost: the engine activates nothing by it, and reports it.
#[test]
fn database_removed_or_replaced_under_a_running_engine_is_noticed() {
    type Displace = fn(&Path);
    let cases: [(&str, Displace); 3] = [
        ("removed", |database| fs::remove_file(database).unwrap()),
        ("moved away", |database| fs::rename(database, database.with_extension("away")).unwrap()),
        ("replaced by its copy", |database| {
            let copy = database.with_extension("copy");
            fs::copy(database, &copy).unwrap();
            fs::rename(&copy, database).unwrap();
        }),
    ];
    for (what, displace) in cases {
        let folder = quick_folder();
        let store = open(folder.path());
        bootstrap(&store, "grasp");
        store.check_unaltered().unwrap();
        displace(&store.layout().database());
        let error = store.check_unaltered().unwrap_err();
        assert!(matches!(error, StoreError::Altered(_)), "{what}: {error}");
        let refused = commit(&store, "more", vec![new_version("grasp@1.1.0", false)]).unwrap_err();
        assert!(matches!(refused, StoreError::Altered(_)), "{what}: {refused}");
    }
}

#[test]
fn an_in_use_error_names_the_process() {
    let folder = quick_folder();
    let first = open(folder.path());
    bootstrap(&first, "grasp");
    let error = Store::open(folder.path()).unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, StoreError::InUse { .. }), "{text}");
    assert!(text.contains(&format!("process {} since 20", std::process::id())), "{text}");
    // Reading needs no lock.
    assert_eq!(first.views().unwrap().families().unwrap().len(), 1);
    drop(first);
    open(folder.path());
}

/// Every way to damage or replace the database; each is refused, says why, and leaves the file as it was.
#[test]
fn other_files_are_refused_and_left_alone() {
    type FileDamage = fn(&Path);
    let table: [(&str, FileDamage, RefusalCause); 10] = [
        ("empty", |db| fs::write(db, b"").unwrap(), RefusalCause::Damaged),
        ("header only", |db| fs::write(db, &fs::read(db).unwrap()[..100]).unwrap(), RefusalCause::Damaged),
        ("half", |db| fs::write(db, &fs::read(db).unwrap()[..8192]).unwrap(), RefusalCause::Damaged),
        (
            "one byte less",
            |db| {
                let bytes = fs::read(db).unwrap();
                fs::write(db, &bytes[..bytes.len() - 1]).unwrap();
            },
            RefusalCause::Damaged,
        ),
        ("text", |db| fs::write(db, "hello ".repeat(100)).unwrap(), RefusalCause::Foreign),
        (
            "another program's",
            |db| {
                fs::remove_file(db).unwrap();
                Connection::open(db).unwrap().execute_batch("CREATE TABLE t (x)").unwrap();
            },
            RefusalCause::Foreign,
        ),
        (
            "newer",
            |db| {
                Connection::open(db).unwrap().pragma_update(None, "user_version", 99).unwrap();
            },
            RefusalCause::NewerSchema,
        ),
        (
            "a folder",
            |db| {
                fs::remove_file(db).unwrap();
                fs::create_dir(db).unwrap();
            },
            RefusalCause::Foreign,
        ),
        (
            "a link",
            |db| {
                let there = db.with_extension("real");
                fs::rename(db, &there).unwrap();
                std::os::unix::fs::symlink(there, db).unwrap();
            },
            RefusalCause::Foreign,
        ),
        ("gone", |db| fs::remove_file(db).unwrap(), RefusalCause::Damaged),
    ];
    for (name, make, cause) in table {
        let folder = quick_folder();
        make_small_store(folder.path());
        let database = folder.path().join("holdpoint.db");
        make(&database);
        let before = fs::read(&database).ok();
        let error = Store::open(folder.path()).expect_err(name);
        assert!(refusal(&error).0 == cause && error.hint().is_some(), "{name}: {error}");
        assert_eq!(fs::read(&database).ok(), before, "{name}");
    }
}

#[test]
fn an_older_copy_is_noticed() {
    let folder = quick_folder();
    make_small_store(folder.path());
    let database = folder.path().join("holdpoint.db");
    let old = fs::read(&database).unwrap();
    let store = open(folder.path());
    commit(&store, "later", rollback(("grasp@1.1.0", 5), ("grasp@1.0.0", 3))).unwrap();
    drop(store);
    fs::write(&database, old).unwrap();
    let error = Store::open(folder.path()).unwrap_err();
    let named = format!("audit record {} ", heads(folder.path()).pop().unwrap().1.seq);
    let (cause, problem) = refusal(&error);
    assert!(cause == RefusalCause::Damaged && problem.contains(&named), "{error}");
}

#[test]
fn broken_registries_and_keys_are_refused() {
    type StoreDamage = fn(&Path);
    let table: [(&str, StoreDamage, &str); 5] = [
        (
            "no active version",
            |folder| {
                run(folder, "UPDATE version SET state = 'demoted', provisional = 0 WHERE state = 'active'");
            },
            "version \"grasp@1.1.0\"",
        ),
        (
            "record dropped",
            |folder| run(folder, "DROP TRIGGER audit_no_delete; DELETE FROM audit WHERE seq = 7"),
            "audit record 7 ",
        ),
        (
            "tail dropped",
            |folder| {
                run(
                    folder,
                    "DROP TRIGGER audit_no_delete; DELETE FROM audit WHERE seq = (SELECT max(seq) FROM audit)",
                );
            },
            "ends at",
        ),
        ("key gone", |folder| fs::remove_file(folder.join("keys/store.key")).unwrap(), "key"),
        (
            "key for all",
            |folder| {
                fs::set_permissions(folder.join("keys/store.key"), fs::Permissions::from_mode(0o644))
                    .unwrap();
            },
            "chmod",
        ),
    ];
    for (name, make, message) in table {
        let folder = quick_folder();
        make_small_store(folder.path());
        make(folder.path());
        let error = Store::open(folder.path()).expect_err(name).sentence();
        assert!(error.contains(message), "{name}: {error}");
    }
}

fn run(folder: &Path, sql: &str) {
    Connection::open(folder.join("holdpoint.db")).unwrap().execute_batch(sql).unwrap();
}

#[test]
fn a_folder_that_cannot_be_used_is_named() {
    let folder = quick_folder();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    for path in [file.join("store"), Path::new("/proc/holdpoint").to_owned()] {
        let error = Store::open(&path).unwrap_err();
        assert!(matches!(&error, StoreError::Io { path: named, .. } if named.starts_with(&path)), "{error}");
    }
}

/// Removing the database does not allow a new history signed by the same store.
#[test]
fn no_new_history_begins_in_place_of_a_removed_one() {
    let folder = quick_folder();
    make_small_store(folder.path());
    let layout = holdpoint_store::Layout::new(folder.path());
    let before = fs::read(layout.store_key()).unwrap();
    let refused = |left: &str| {
        let error = Store::open(folder.path()).expect_err(left);
        let (cause, problem) = refusal(&error);
        assert!(cause == RefusalCause::Damaged && problem.contains(left), "{error}");
    };
    let removed = |path: &Path| fs::remove_file(path).unwrap();
    removed(&layout.database());
    refused("checkpoints");
    for entry in fs::read_dir(layout.checkpoints()).unwrap() {
        removed(&entry.unwrap().path());
    }
    refused("telemetry");
    removed(&layout.telemetry());
    fs::create_dir_all(layout.compiled()).unwrap();
    fs::write(layout.compiled().join("form"), "x").unwrap();
    refused("compiled forms");
    removed(&layout.compiled().join("form"));
    // The rest was never signed: the new store is another one, and the key is kept for a restore from a backup.
    let store = open(folder.path());
    assert!(store.opening().created);
    assert_ne!(fs::read(layout.store_key()).unwrap(), before);
    assert_eq!(fs::read(layout.keys().join("store.key.aside-1")).unwrap(), before);
}

/// A stop mark stays beside the database even if its text cannot be written.
#[test]
fn stop_mark_is_set_even_if_its_text_cannot_be_written() {
    let folder = quick_folder();
    let layout = holdpoint_store::Layout::new(folder.path());
    layout.create().unwrap();
    let marks = layout.stop_marks();
    assert_eq!(marks.found(), None);
    // Nothing can be written beside it first, as on a full disk.
    for place in &marks.places()[..2] {
        fs::create_dir(place.with_extension("part")).unwrap();
    }
    marks.keep("{}").unwrap();
    assert_eq!(marks.found().as_deref(), Some("{}"));
    marks.keep("{\"by\":\"bo\"}").unwrap();
    marks.remove();
    assert_eq!(marks.found(), None);
}

#[test]
fn incomplete_new_database_is_created_again() {
    let folder = quick_folder();
    fs::write(folder.path().join("holdpoint.new"), "half").unwrap();
    assert!(open(folder.path()).opening().created);
    make_small_store(folder.path());
}

/// The lines of the kernel's list of locks that are this process's on a file. The list is read in pieces, and a
/// concurrent change can omit lines: a lock is absent if none of many reads has it.
#[cfg(target_os = "linux")]
fn locks(path: &std::path::Path) -> usize {
    use std::os::unix::fs::MetadataExt as _;
    let inode = format!(":{}", std::fs::metadata(path).unwrap().ino());
    let own = std::process::id().to_string();
    let is_ours = |line: &&str| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        fields.contains(&own.as_str()) && fields.iter().any(|field| field.ends_with(&inode))
    };
    let reading = |_| std::fs::read_to_string("/proc/locks").unwrap().lines().filter(is_ours).count();
    (0..50).map(reading).find(|count| *count > 0).unwrap_or(0)
}

/// A descriptor of the database, opened and closed beside SQLite's, once dropped its locks. Another program's
/// connection could then delete the log under the engine, and a kill lost acknowledged data.
#[test]
#[cfg(target_os = "linux")]
fn reader_releases_no_lock_of_the_writer() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    let layout = store.layout().clone();
    assert!(locks(&layout.database()) > 0, "a writer holds its database");
    for _ in 0..3 {
        let views = store.views().unwrap();
        assert!(locks(&layout.database()) > 0, "a reader beside it");
        drop(views);
        store.views().unwrap().export(0, &mut Vec::new()).unwrap();
        holdpoint_registry::verify(&layout.database(), None).unwrap();
        assert!(locks(&layout.database()) > 0, "a reader that is gone");
        assert!(locks(&layout.telemetry()) > 0, "the telemetry's reader");
    }
}

/// A link or a pipe in place of the lock's file is refused, and its target stays unchanged.
#[test]
fn the_lock_is_a_file_of_its_own() {
    let folder = quick_folder();
    make_small_store(folder.path());
    let (lock, key) = (folder.path().join("engine.lock"), folder.path().join("keys/store.key"));
    let before = fs::read(&key).unwrap();
    fs::remove_file(&lock).unwrap();
    std::os::unix::fs::symlink(&key, &lock).unwrap();
    let is_refused =
        || matches!(Store::open(folder.path()), Err(StoreError::Io { path, .. }) if path == lock);
    assert!(is_refused());
    assert_eq!(fs::read(&key).unwrap(), before);
    fs::remove_file(&lock).unwrap();
    rustix::fs::mkfifoat(rustix::fs::CWD, &lock, rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR).unwrap();
    assert!(is_refused());
    fs::remove_file(&lock).unwrap();
    drop(open(folder.path()));
}
