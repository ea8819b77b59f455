//! Copies of a store, and quick looks at one.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

use holdpoint_governance::ids::Digest;
use holdpoint_governance::store_finding::{OmissionCause, StoreFinding};
use holdpoint_registry::{
    BackupError, BackupParts, OmittedFile, RetainedRecording, Store, Views, backup, check_store, store_info,
    verify, verify_copy,
};
use holdpoint_store::{RefusalCause, StoreError, VerifyError};

use crate::edits::make_full_store;
use crate::proofs::public_key;
use crate::quick_folder::quick_folder;
use crate::support::*;

const ALL: BackupParts<'static> = BackupParts { keys: true, recordings: None };

#[test]
fn backup_is_complete_while_an_engine_writes() {
    let (folder, to) = (quick_folder(), quick_folder());
    make_full_store(folder.path());
    let store = open(folder.path());
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut number = 1;
            while !done.load(Ordering::Relaxed) {
                number += 1;
                store.commit(transaction(&format!("more {number}"), number, Vec::new())).unwrap();
            }
        });
        let mut records = 0;
        for nth in 0..5 {
            let copy = to.path().join(format!("copy-{nth}"));
            let report = backup(folder.path(), &copy, BackupParts::default()).unwrap();
            assert!(report.verified.records > records && report.verified.key_given, "{report:?}");
            records = report.verified.records;
            let alone = to.path().join(format!("copy-{nth}.db"));
            backup(folder.path(), &alone, BackupParts::default()).unwrap();
            assert!(verify_copy(&alone, Some(&public_key(folder.path()))).unwrap().records >= records);
        }
        done.store(true, Ordering::Relaxed);
    });
    drop(store);
    verify(&folder.path().join("holdpoint.db"), None).unwrap();
    assert_eq!(fs::read_dir(to.path()).unwrap().count(), 10, "nothing is left beside the copies");
}

#[test]
fn secrets_are_copied_only_on_request() {
    let (folder, to) = (quick_folder(), quick_folder());
    make_full_store(folder.path());
    let (without, with) = (to.path().join("without"), to.path().join("with"));
    assert!(!backup(folder.path(), &without, BackupParts::default()).unwrap().keys);
    let keys = |folder: &Path| -> Vec<String> {
        let mut names = Vec::new();
        for place in ["keys", "keys/identities"] {
            for entry in fs::read_dir(folder.join(place)).unwrap() {
                let path = entry.unwrap().path();
                if path.is_file() {
                    names.push(path.file_name().unwrap().to_str().unwrap().to_owned());
                }
            }
        }
        names.sort();
        names
    };
    assert_eq!(keys(&without), ["ada.pub", "admin.pub", "ben.pub", "store.pub"]);
    assert!(!without.join("recordings").exists());
    assert!(backup(folder.path(), &with, ALL).unwrap().keys);
    assert_eq!(keys(&with), keys(folder.path()));
    // The copy can be used as a store.
    let head = open(folder.path()).opening().head;
    let copied = open(&with);
    assert_eq!(copied.opening().head, head);
    shadowed(&copied, "place@1.2.0");
    drop(copied);
    verify(&with.join("holdpoint.db"), None).unwrap();
    // Without keys an engine cannot.
    assert!(unless_in_use(|| Store::open(&without)).map(drop).unwrap_err().to_string().contains("store.key"));
}

#[test]
fn backup_overwrites_nothing_and_copies_no_unsound_store() {
    let (folder, to) = (quick_folder(), quick_folder());
    make_full_store(folder.path());
    for name in ["folder", "file.db"] {
        let there = to.path().join(name);
        if name == "folder" {
            fs::create_dir(&there).unwrap();
        } else {
            fs::write(&there, "mine").unwrap();
        }
        let error = backup(folder.path(), &there, ALL).unwrap_err();
        assert!(matches!(&error, BackupError::Exists(path) if *path == there), "{error}");
    }
    assert_eq!(fs::read_to_string(to.path().join("file.db")).unwrap(), "mine");
    let connection = rusqlite::Connection::open(folder.path().join("holdpoint.db")).unwrap();
    connection.execute_batch("UPDATE family SET reason = 'edited'").unwrap();
    drop(connection);
    for name in ["other", "other.db"] {
        let error = backup(folder.path(), &to.path().join(name), ALL).unwrap_err();
        let BackupError::NotSound(found) = &error else { panic!("{error}") };
        assert!(matches!(**found, VerifyError::State { table: "family", .. }), "{error}");
    }
    assert!(backup(to.path(), &to.path().join("none"), ALL).is_err());
    assert_eq!(fs::read_dir(to.path()).unwrap().count(), 2, "nothing is left");
}

/// An existing entry under the name of a new copy stays.
#[test]
fn backup_removes_no_existing_entry() {
    let (folder, to) = (quick_folder(), quick_folder());
    make_full_store(folder.path());
    let there = |name: &str| to.path().join(name);
    fs::create_dir(there("photos.part")).unwrap();
    fs::write(there("photos.part").join("mine.txt"), "mine").unwrap();
    fs::write(there("notes.db.part"), "mine").unwrap();
    fs::write(there("other.db.part-wal"), "mine").unwrap();
    for name in ["photos", "notes.db"] {
        let error = backup(folder.path(), &there(name), ALL).unwrap_err();
        let BackupError::PartExists(path) = &error else { panic!("{error}") };
        assert_eq!(*path, there(&format!("{name}.part")));
        assert!(!there(name).exists());
    }
    backup(folder.path(), &there("other.db"), ALL).unwrap();
    for name in ["photos.part/mine.txt", "notes.db.part", "other.db.part-wal"] {
        assert_eq!(fs::read_to_string(there(name)).unwrap(), "mine", "{name}");
    }
    assert_eq!(fs::read_dir(to.path()).unwrap().count(), 4, "nothing is left");
}

#[test]
fn no_copy_is_made_in_the_store() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let link = quick_folder();
    std::os::unix::fs::symlink(folder.path(), link.path().join("store")).unwrap();
    let before = fs::read_dir(folder.path()).unwrap().count();
    for place in [
        folder.path().join("inside"),
        folder.path().join("keys/in"),
        folder.path().join("checkpoints/in.db"),
        folder.path().join("keys/../inside"),
        link.path().join("store/inside"),
    ] {
        let error = backup(folder.path(), &place, ALL).unwrap_err();
        assert!(matches!(error, BackupError::Inside(_)), "{place:?}: {error}");
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), before);
}

/// A copied recording matches its record, or is left out and reported; one that grew without end is not read.
#[test]
fn copied_recordings_have_their_recorded_digests() {
    let (folder, to) = (quick_folder(), quick_folder());
    make_full_store(folder.path());
    let place = folder.path().join("recordings");
    let of = |text: &str| -> Digest {
        use sha2::Digest as _;
        Digest::from_bytes(sha2::Sha256::digest(text).into())
    };
    let names =
        ["good.rrd", "cut.rrd", "swapped.rrd", "gone.rrd", "link.rrd", "pipe.rrd", "endless.rrd", "../keys"];
    let on_record: Vec<RetainedRecording> = names
        .iter()
        .map(|file| RetainedRecording { file: (*file).to_owned(), sha256: of("scene"), bytes: 5 })
        .collect();
    for (name, text) in
        [("good.rrd", "scene"), ("cut.rrd", "scen"), ("swapped.rrd", "Scene"), ("open.rrd", "x")]
    {
        fs::write(place.join(name), text).unwrap();
    }
    std::os::unix::fs::symlink(place.join("good.rrd"), place.join("link.rrd")).unwrap();
    assert!(Command::new("mkfifo").arg(place.join("pipe.rrd")).status().unwrap().success());
    fs::File::create(place.join("endless.rrd")).unwrap().set_len(1 << 40).unwrap();
    let recordings_of = |_: &Views| Ok(on_record.clone());
    let parts = BackupParts { keys: false, recordings: Some(&recordings_of) };
    let copy = to.path().join("copy");
    let report = backup(folder.path(), &copy, parts).unwrap();
    assert_eq!(report.recordings, 1);
    let bad: Vec<(&str, OmissionCause)> =
        report.left_out.iter().filter(|left| left.bad).map(|left| (left.file.as_str(), left.why)).collect();
    let causes = [
        OmissionCause::OtherSize,
        OmissionCause::OtherDigest,
        OmissionCause::Missing,
        OmissionCause::Unreadable,
        OmissionCause::Unreadable,
        OmissionCause::OtherSize,
        OmissionCause::NoFileName,
    ];
    assert_eq!(bad, names[1..].iter().copied().zip(causes).collect::<Vec<_>>());
    let others: Vec<&OmittedFile> = report.left_out.iter().filter(|left| !left.bad).collect();
    assert!(others.len() == 1 && others[0].file == "open.rrd", "{others:?}");
    let copied: Vec<_> =
        fs::read_dir(copy.join("recordings")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(copied, ["good.rrd"]);
}

/// Anything but a regular file in place of the database or its companions is reported, with a remedy.
#[test]
fn non_file_in_place_of_the_database_is_named() {
    for (name, expected) in [
        ("holdpoint.db", RefusalCause::Foreign),
        ("holdpoint.db-wal", RefusalCause::Log),
        ("holdpoint.db-shm", RefusalCause::LogIndex),
    ] {
        for kind in ["a named pipe", "a folder", "a link"] {
            let folder = quick_folder();
            make_full_store(folder.path());
            let path = folder.path().join(name);
            drop(fs::remove_file(&path));
            match kind {
                "a named pipe" => assert!(Command::new("mkfifo").arg(&path).status().unwrap().success()),
                "a folder" => fs::create_dir(&path).unwrap(),
                _ => std::os::unix::fs::symlink("/dev/null", &path).unwrap(),
            }
            let database = folder.path().join("holdpoint.db");
            let opened = unless_in_use(|| Store::open(folder.path())).map(drop).unwrap_err();
            let views = holdpoint_registry::Views::open(&database).map(drop).unwrap_err();
            for error in [opened, views] {
                let StoreError::Refused { path, problem, cause } = &error else { panic!("{error}") };
                assert!(*cause == expected && path.ends_with(name) && problem.contains(kind), "{error}");
            }
        }
    }
}

#[test]
fn quick_check_finds_evident_problems() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let bad = || -> Vec<StoreFinding> {
        let found = check_store(folder.path()).unwrap();
        found.into_iter().filter(|one| !one.is_good()).collect()
    };
    assert_eq!(bad(), Vec::<StoreFinding>::new());
    let info = store_info(folder.path()).unwrap();
    assert_eq!((info.signed_at, info.in_use_by), (Some(info.records), None));
    let store = open(folder.path());
    assert!(store_info(folder.path()).unwrap().in_use_by.is_some());
    drop(store);
    let sql = |text: &str| {
        let connection = rusqlite::Connection::open(folder.path().join("holdpoint.db")).unwrap();
        connection.execute_batch(text).unwrap();
    };
    sql("CREATE INDEX stray ON version (author); UPDATE audit_head SET seq = seq - 1");
    let key = folder.path().join("keys").join("store.key");
    let mode = std::os::unix::fs::PermissionsExt::from_mode;
    fs::set_permissions(&key, mode(0o644)).unwrap();
    let found = bad();
    let is_expected: [fn(&StoreFinding) -> bool; 4] = [
        |one| matches!(one, StoreFinding::WrongTables { .. }),
        |one| matches!(one, StoreFinding::CutChain { records, recorded_end, .. } if recorded_end + 1 == *records),
        |one| matches!(one, StoreFinding::OtherSignedEnd),
        |one| matches!(one, StoreFinding::OpenSecretKey { problem } if problem.contains("chmod 600")),
    ];
    for (nth, is_expected) in is_expected.iter().enumerate() {
        assert!(found.iter().any(is_expected), "{nth}: {found:#?}");
    }
}
