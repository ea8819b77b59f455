//! Edited telemetry files: each is quarantined and kept, the sealed batches are taken over, and the engine continues.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;

use holdpoint_governance::store_finding::StoreFinding;
use holdpoint_registry::{Store, TelemetryLimits, check_store, verify};
use holdpoint_store::{Batch, BatchReceipt, Change, Layout, StoreError};
use rusqlite::Connection;

use crate::quick_folder::quick_folder;
use crate::support::*;

fn batch(fill: u8) -> Batch {
    Batch {
        version: id("grasp@1.0.0"),
        stream: "monitor".into(),
        from_ms: 1,
        to_ms: 2,
        rows: 3,
        body: vec![fill; 100],
    }
}

/// A closed store with five sealed batches.
fn make_sealed_store(folder: &Path) -> Layout {
    let store = open(folder);
    bootstrap(&store, "grasp");
    for fill in 0..5 {
        store.append_telemetry(&batch(fill)).unwrap();
    }
    commit(&store, "seal", store.seal_telemetry().unwrap()).unwrap();
    store.layout().clone()
}

fn sql(layout: &Layout, sql: &str) {
    Connection::open(layout.telemetry())
        .unwrap()
        .execute_batch(sql)
        .unwrap_or_else(|error| panic!("{sql}: {error}"));
}

/// The findings of a start, after all of them went on record and one more batch was stored and sealed.
struct Started {
    /// Quarantined files.
    aside: Vec<String>,
    problem: String,
    missing: u64,
    unsealed: u64,
    next: BatchReceipt,
}

fn start(layout: &Layout, command: &str) -> Started {
    let store = open(layout.folder());
    let found = store.opening().telemetry.clone();
    if !found.changes.is_empty() {
        commit(&store, &format!("{command} found"), found.changes).unwrap();
    }
    let next = store.append_telemetry(&batch(9)).unwrap();
    commit(&store, &format!("{command} sealed"), store.seal_telemetry().unwrap()).unwrap();
    Started {
        problem: found.aside.first().map_or_else(String::new, |aside| aside.problem.clone()),
        aside: found.aside.into_iter().map(|aside| aside.file).collect(),
        missing: found.missing,
        unsealed: found.unsealed,
        next,
    }
}

/// The shape of the file: a planted trigger never acts, and no sealed batch is lost.
#[test]
fn changed_telemetry_schema_is_quarantined_and_sealed_batches_are_kept() {
    for (edit, named) in [
        ("CREATE TRIGGER x AFTER INSERT ON batch BEGIN DELETE FROM batch WHERE id < 4; END", "\"x\""),
        ("CREATE TABLE x (a)", "\"x\""),
        ("CREATE VIEW x AS SELECT 1", "\"x\""),
        ("DROP INDEX batch_version", "\"batch_version\""),
        ("CREATE INDEX x ON batch (version)", "\"x\""),
        ("DROP TABLE cell", "cell"),
        ("ALTER TABLE cell ADD COLUMN x TEXT", "\"cell\""),
        ("ANALYZE", "sqlite_stat1"),
        ("PRAGMA user_version = 99", " 99,"),
        ("PRAGMA user_version = 0", " 0,"),
        ("PRAGMA application_id = 1", "0x00000001"),
        ("CREATE TABLE usage (id INTEGER PRIMARY KEY, batch_bytes INTEGER)", "\"usage\""),
    ] {
        let folder = quick_folder();
        let layout = make_sealed_store(folder.path());
        sql(&layout, edit);
        assert!(verify(&layout.database(), None).is_err(), "{edit}: not found by the verifier");
        let looked = check_store(layout.folder()).unwrap();
        assert!(
            looked.iter().any(|one| matches!(one, StoreFinding::WrongTelemetryFile { .. })),
            "{edit}: {looked:?}"
        );
        let bytes = fs::read(layout.telemetry()).unwrap();
        let started = start(&layout, "first");
        assert!(started.problem.contains(named), "{edit}: {}", started.problem);
        assert_eq!((started.missing, started.unsealed, started.next.batch), (0, 0, 6), "{edit}");
        assert_eq!(started.aside, ["telemetry-aside-1.db"], "{edit}");
        assert!(
            fs::read(layout.folder().join(&started.aside[0])).unwrap() == bytes,
            "{edit}: it was written to"
        );
        let report = verify(&layout.database(), None).unwrap_or_else(|error| panic!("{edit}: {error}"));
        assert_eq!((report.batches, report.batches_missed), (6, 0), "{edit}");
        // It is reported once.
        let started = start(&layout, "second");
        assert_eq!((started.aside.len(), started.next.batch), (0, 7), "{edit}: {}", started.problem);
    }
}

/// No number beside the rows decides anything.
#[test]
fn edited_sequence_numbers_have_no_effect() {
    for edit in [
        "UPDATE sqlite_sequence SET seq = 9223372036854775807",
        "UPDATE sqlite_sequence SET seq = 1000000",
        "UPDATE sqlite_sequence SET seq = -1",
        "UPDATE sqlite_sequence SET seq = 'x'",
        "DELETE FROM sqlite_sequence",
        "INSERT INTO sqlite_sequence VALUES ('batch', 9223372036854775807)",
    ] {
        let folder = quick_folder();
        let layout = make_sealed_store(folder.path());
        sql(&layout, edit);
        let started = start(&layout, "first");
        assert_eq!((started.aside.len(), started.missing, started.next.batch), (0, 0, 6), "{edit}");
        assert_eq!(verify(&layout.database(), None).unwrap().batches, 6, "{edit}");
    }
}

/// The use counter of cells may have any number in an edited file.
#[test]
fn cells_with_an_edited_use_counter_stay_usable() {
    for used in ["9223372036854775807", "-9223372036854775808"] {
        let folder = quick_folder();
        let store = open(folder.path());
        store.result_cache().put(&digest("one"), b"one").unwrap();
        let layout = store.layout().clone();
        drop(store);
        sql(&layout, &format!("UPDATE cell SET used = {used}"));
        let store = open(folder.path());
        store.result_cache().put(&digest("two"), b"two").unwrap();
        for (key, body) in [("one", b"one"), ("two", b"two")] {
            let found = store.result_cache().get(&digest(key));
            assert!(
                matches!(&found, holdpoint_store::CacheLookup::Found { body: cached, .. } if cached == body),
                "{found:?}"
            );
        }
    }
}

/// Batches with a number of no engine: none of them becomes a gap, or delays the numbers of the following ones.
#[test]
fn forged_numbers_make_no_gaps() {
    let copied =
        "INSERT INTO batch SELECT {id}, version, stream, from_ms, to_ms, rows, digest, bytes, body FROM batch
                  WHERE id = 1";
    for number in [0, -1, 7, 1_000_000, i64::MAX - 1, i64::MAX] {
        let folder = quick_folder();
        let layout = make_sealed_store(folder.path());
        sql(&layout, &copied.replace("{id}", &number.to_string()));
        let started = start(&layout, "first");
        assert_eq!((started.aside.len(), started.missing, started.next.batch), (1, 0, 6), "{number}");
        let report = verify(&layout.database(), None).unwrap();
        assert_eq!((report.batches, report.batches_missed), (6, 0), "{number}");
        assert_eq!(start(&layout, "second").missing, 0, "{number}");
    }
    // A batch that was moved there is missing, and nothing else is.
    let folder = quick_folder();
    let layout = make_sealed_store(folder.path());
    sql(&layout, "UPDATE batch SET id = 1000000 WHERE id = 3");
    let started = start(&layout, "first");
    assert_eq!((started.aside.len(), started.missing, started.next.batch), (1, 1, 6));
    let report = verify(&layout.database(), None).unwrap();
    assert_eq!((report.batches, report.batches_missed), (5, 1));
}

/// An attacker who edits a batch also corrects its own digest; the chain's digest stays.
#[test]
fn batch_that_differs_from_its_seal_is_found_by_the_start() {
    let folder = quick_folder();
    let layout = make_sealed_store(folder.path());
    sql(&layout, "UPDATE batch SET body = zeroblob(100), digest = replace(digest, 'a', 'b') WHERE id = 2");
    let started = start(&layout, "first");
    assert!(started.problem.contains("batch 2 "), "{}", started.problem);
    assert_eq!((started.aside.len(), started.missing, started.next.batch), (1, 1, 6));
    let report = verify(&layout.database(), None).unwrap();
    assert_eq!((report.batches, report.batches_missed), (5, 1));
}

/// Another entry in place of the file, or beside it, is quarantined unchanged; a link's target is left alone.
#[test]
fn non_file_in_place_of_telemetry_is_quarantined() {
    type Put = fn(&Path);
    let pipe: Put = |path| {
        assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
    };
    let link: Put = |path| {
        let elsewhere = path.with_file_name("elsewhere");
        fs::write(&elsewhere, "mine").unwrap();
        symlink(&elsewhere, path).unwrap();
    };
    let folder_there: Put = |path| fs::create_dir(path).unwrap();
    let text: Put = |path| fs::write(path, "no database").unwrap();
    let sparse: Put = |path| fs::File::create(path).unwrap().set_len(30 << 30).unwrap();
    for (what, put) in
        [("pipe", pipe), ("link", link), ("folder", folder_there), ("text", text), ("sparse", sparse)]
    {
        let folder = quick_folder();
        let layout = make_sealed_store(folder.path());
        fs::remove_file(layout.telemetry()).unwrap();
        put(&layout.telemetry());
        let started = start(&layout, "first");
        assert_eq!((started.aside.len(), started.missing, started.next.batch), (1, 5, 6), "{what}");
        assert!(fs::symlink_metadata(layout.folder().join(&started.aside[0])).is_ok(), "{what}");
        let elsewhere = fs::read_to_string(layout.folder().join("elsewhere"));
        assert!(what != "link" || elsewhere.unwrap() == "mine", "{what}");
    }
    for ending in ["-wal", "-shm"] {
        for (what, put) in [("pipe", pipe), ("link", link), ("folder", folder_there)] {
            let folder = quick_folder();
            let layout = make_sealed_store(folder.path());
            put(&layout.folder().join(format!("telemetry.db{ending}")));
            let started = start(&layout, "first");
            let named = [ending, what].iter().all(|part| started.problem.contains(part));
            assert!(named, "{what}{ending}: {}", started.problem);
            assert_eq!((started.aside.len(), started.next.batch), (1, 6), "{what}{ending}");
        }
    }
    // The log of a missing file never becomes that of the next one.
    let folder = quick_folder();
    let layout = make_sealed_store(folder.path());
    let store = open(folder.path());
    store.append_telemetry(&batch(7)).unwrap();
    let log = fs::read(layout.folder().join("telemetry.db-wal")).unwrap();
    drop(store);
    fs::remove_file(layout.telemetry()).unwrap();
    fs::write(layout.folder().join("telemetry.db-wal"), log).unwrap();
    let started = start(&layout, "first");
    assert_eq!((started.missing, started.next.batch), (5, 6));
    assert_eq!(started.aside, ["telemetry-aside-1.db"]);
    assert!(layout.folder().join("telemetry-aside-1.db-wal").is_file());
}

/// A start that could not record its quarantine leaves that to the next one.
#[test]
fn unrecorded_quarantine_is_recorded_by_the_next_start() {
    let folder = quick_folder();
    let layout = make_sealed_store(folder.path());
    sql(&layout, "CREATE TABLE x (a)");
    drop(open(folder.path()));
    let started = start(&layout, "second");
    assert_eq!((started.aside.len(), started.missing), (1, 0));
    assert_eq!(start(&layout, "third").aside.len(), 0);
    let refused = open(folder.path());
    let aside =
        vec![holdpoint_store::QuarantinedFile { file: "../holdpoint.db".into(), problem: String::new() }];
    let error =
        commit(&refused, "foreign", vec![Change::MissTelemetry { gaps: Vec::new(), aside }]).unwrap_err();
    assert!(matches!(error, StoreError::Invalid { .. }), "{error}");
}

/// Many unsealed bytes displace no sealed batch.
#[test]
fn forged_bytes_remove_no_sealed_batch() {
    let folder = quick_folder();
    let limits = TelemetryLimits { batch_bytes_max: 600, cell_bytes_max: 600 };
    let layout = make_sealed_store(folder.path());
    sql(
        &layout,
        "INSERT INTO batch SELECT 6, version, stream, from_ms, to_ms, rows, digest, 1300, zeroblob(1300) FROM batch
         WHERE id = 1",
    );
    let store = Store::open_with(folder.path(), limits).unwrap();
    let found = &store.opening().telemetry;
    assert_eq!((found.aside.len(), found.missing, found.unsealed), (1, 0, 0));
    assert_eq!(stored_batch(&store, 1), Some(batch(0)));
}
