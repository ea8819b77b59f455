//! Telemetry batches, their seals, retention, and cached results.

use holdpoint_approvals::keyfile;
use holdpoint_registry::{Store, TelemetryLimits, verify};
use holdpoint_store::{Batch, CacheLookup, CacheSecret, Change, EpisodeKey, StoreError, VerifyError};
use rusqlite::Connection;

use crate::quick_folder::quick_folder;
use crate::support::*;

fn batch(fill: u8, bytes: usize) -> Batch {
    Batch {
        version: id("grasp@1.0.0"),
        stream: "monitor".into(),
        from_ms: 1,
        to_ms: 2,
        rows: 3,
        body: vec![fill; bytes],
    }
}

fn key(seed: u64) -> EpisodeKey {
    EpisodeKey { bundle: digest("b"), scenario: digest("s"), seed, engine_build: "1".into() }
}

#[test]
fn sealed_batches_are_verified() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    let receipt = store.append_telemetry(&batch(1, 100)).unwrap();
    store.append_telemetry(&batch(2, 100)).unwrap();
    let seals = store.seal_telemetry().unwrap();
    assert_eq!(seals.len(), 1, "one record seals both");
    commit(&store, "seal", seals).unwrap();
    assert_eq!(store.seal_telemetry().unwrap().len(), 0, "nothing waits any more");
    assert_eq!(stored_batch(&store, receipt.batch), Some(batch(1, 100)));
    let (database, telemetry) = (store.layout().database(), store.layout().telemetry());
    assert_eq!(verify(&database, None).unwrap().batches, 2);
    drop(store);
    for (what, sql) in [
        ("changed", "UPDATE batch SET body = zeroblob(100) WHERE id = 1"),
        ("removed", "DELETE FROM batch WHERE id = 2"),
    ] {
        Connection::open(&telemetry).unwrap().execute_batch(sql).unwrap();
        let error = verify(&database, None).expect_err(what);
        assert!(matches!(error, VerifyError::Telemetry { .. }), "{what}: {error}");
    }
    std::fs::remove_file(&telemetry).unwrap();
    let error = verify(&database, None).expect_err("the whole file");
    assert!(matches!(error, VerifyError::Telemetry { batch: 1, .. }), "{error}");
    // A database that was copied away names the parts that it could not check.
    let copy = quick_folder();
    std::fs::copy(&database, copy.path().join("holdpoint.db")).unwrap();
    assert_eq!(
        holdpoint_registry::verify_copy(&copy.path().join("holdpoint.db"), None).unwrap().batches_unseen,
        2
    );
}

/// The next start reports missing batches once; then they are on record, and no others may go missing.
#[test]
fn missing_batches_are_recorded_by_the_next_start() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    for fill in 0..5 {
        store.append_telemetry(&batch(fill, 100)).unwrap();
    }
    commit(&store, "seal", store.seal_telemetry().unwrap()).unwrap();
    let (database, telemetry) = (store.layout().database(), store.layout().telemetry());
    drop(store);
    let lose = |sql: &str| Connection::open(&telemetry).unwrap().execute_batch(sql).unwrap();
    lose("DELETE FROM batch WHERE id IN (1, 3)");
    assert!(verify(&database, None).is_err());
    let store = open(folder.path());
    let found = store.opening().telemetry.clone();
    assert_eq!((found.missing, found.unsealed), (2, 0));
    commit(&store, "missed", found.changes).unwrap();
    drop(store);
    let report = verify(&database, None).unwrap();
    assert_eq!((report.batches, report.batches_missed, report.batches_pruned), (3, 2, 0));
    assert_eq!(open(folder.path()).opening().telemetry.missing, 0, "one report");
    lose("DELETE FROM batch WHERE id = 2");
    let error = verify(&database, None).expect_err("between two that are known to be missing");
    assert!(matches!(error, VerifyError::Telemetry { batch: 2, .. }), "{error}");
    assert_eq!(open(folder.path()).opening().telemetry.missing, 1);
}

/// Batches that an engine stored and did not seal are sealed as found; a batch of an unknown version is not this
/// store's.
#[test]
fn unsealed_batches_are_sealed_by_the_next_start() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    store.append_telemetry(&batch(1, 100)).unwrap();
    let planted = Batch { version: id("grasp@9.9.9"), ..batch(2, 100) };
    store.append_telemetry(&planted).unwrap();
    drop(store);
    let store = open(folder.path());
    let found = store.opening().telemetry.clone();
    assert_eq!((found.missing, found.unsealed), (0, 1));
    let is_found = |change: &Change| matches!(change, Change::SealTelemetryBlock { found: true, .. });
    assert!(found.changes.iter().all(is_found), "{:?}", found.changes);
    commit(&store, "found", found.changes).unwrap();
    assert_eq!(verify(&store.layout().database(), None).unwrap().batches, 1);
}

/// Telemetry is pending until the next record of any kind, a full block or its time, whichever comes first.
#[test]
fn telemetry_block_is_due_by_count_or_by_time() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    assert!(!store.telemetry_is_due(u64::MAX).unwrap(), "nothing waits");
    for fill in 0..31 {
        store.append_telemetry(&batch(fill, 10)).unwrap();
        assert!(!store.telemetry_is_due(300_001).unwrap());
        assert!(store.telemetry_is_due(300_002).unwrap(), "five minutes after the first one");
    }
    store.append_telemetry(&batch(31, 10)).unwrap();
    assert!(store.telemetry_is_due(2).unwrap(), "a block is full");
    let receipt = store.commit_sealing(transaction("next", 2, Vec::new())).unwrap();
    assert_eq!(receipt.first_seq + 1, receipt.last_seq, "32 batches are one record");
    assert_eq!(store.telemetry_waits(), None);
    assert_eq!(verify(&store.layout().database(), None).unwrap().batches, 32);
}

#[test]
fn oldest_telemetry_is_removed_first() {
    let folder = quick_folder();
    let limits = TelemetryLimits { batch_bytes_max: 250, cell_bytes_max: 250 };
    let store = Store::open_with(folder.path(), limits).unwrap();
    bootstrap(&store, "grasp");
    let batches: Vec<_> =
        (0..4).map(|fill| store.append_telemetry(&batch(fill, 100)).unwrap().batch).collect();
    assert!(store.append_telemetry(&batch(4, 200)).is_ok(), "up to twice the limit between two seals");
    let error = store.append_telemetry(&batch(5, 1)).unwrap_err();
    assert!(matches!(error, StoreError::Invalid { what: "telemetry of", .. }), "{error}");
    let there = || -> Vec<bool> { batches.iter().map(|n| stored_batch(&store, *n).is_some()).collect() };
    assert_eq!(there(), [true; 4], "nothing goes before it is on record");
    commit(&store, "seal", store.seal_telemetry().unwrap()).unwrap();
    assert_eq!(there(), [false; 4]);
    let report = verify(&store.layout().database(), None).unwrap();
    assert_eq!((report.batches, report.batches_pruned, report.batches_missed), (1, 4, 0));
    assert_eq!(report.batches_missing.map(|missing| (missing.first, missing.last)), Some((1, 4)));

    let (cache, is_there) = (store.result_cache(), |seed| cached_cell(&store, seed).is_some());
    for seed in 0..2 {
        cache.put(&key(seed).digest(), &[7; 100]).unwrap();
    }
    assert!(is_there(0));
    cache.put(&key(2).digest(), &[8; 100]).unwrap();
    assert_eq!([0, 1, 2].map(is_there), [true, false, true], "the one longest unused goes");
}

/// The cached body of an episode, and whether this opening of the store ran it.
fn cached_cell(store: &Store, seed: u64) -> Option<(Vec<u8>, bool)> {
    match store.result_cache().get(&key(seed).digest()) {
        CacheLookup::Found { body, own } => Some((body, own)),
        CacheLookup::Nothing | CacheLookup::Refused => None,
    }
}

#[test]
fn cached_episode_is_exact_or_absent() {
    let folder = quick_folder();
    let store = open(folder.path());
    store.result_cache().put(&key(1).digest(), b"first").unwrap();
    store.result_cache().put(&key(1).digest(), b"second").unwrap();
    assert_eq!(cached_cell(&store, 1), Some((b"second".to_vec(), true)));
    let others = [
        key(2),
        EpisodeKey { bundle: digest("x"), ..key(1) },
        EpisodeKey { scenario: digest("x"), ..key(1) },
        EpisodeKey { engine_build: "2".into(), ..key(1) },
    ];
    for other in others {
        assert_eq!(store.result_cache().get(&other.digest()), CacheLookup::Nothing, "{other:?}");
    }
    drop(store);
    assert_eq!(cached_cell(&open(folder.path()), 1), Some((b"second".to_vec(), false)));
}

/// A write by an attacker with access to the file and without the secret.
#[test]
fn edited_cell_is_ignored() {
    for (what, sql) in [
        ("body", "UPDATE cell SET body = CAST('edited' AS BLOB)"),
        ("body with a digest anyone can compute", "UPDATE cell SET body = x'3132', bytes = 2, mac = key"),
        ("code", "UPDATE cell SET mac = replace(mac, substr(mac, 1, 1), 'g')"),
        ("no hexadecimal code", "UPDATE cell SET mac = printf('%64s', '')"),
    ] {
        let folder = quick_folder();
        let store = open(folder.path());
        store.result_cache().put(&key(1).digest(), b"second").unwrap();
        drop(store);
        Connection::open(folder.path().join("telemetry.db")).unwrap().execute_batch(sql).unwrap();
        assert_eq!(open(folder.path()).result_cache().get(&key(1).digest()), CacheLookup::Refused, "{what}");
    }
}

/// A true cell under another key is not the cell of that key.
#[test]
fn cell_under_another_key_is_ignored() {
    let folder = quick_folder();
    let store = open(folder.path());
    for seed in [1, 2] {
        store.result_cache().put(&key(seed).digest(), format!("episode {seed}").as_bytes()).unwrap();
    }
    drop(store);
    let swap = "UPDATE cell SET key = 'x' || substr(key, 2) WHERE key = ?1";
    let connection = Connection::open(folder.path().join("telemetry.db")).unwrap();
    let (one, two) = (key(1).digest().to_string(), key(2).digest().to_string());
    connection.execute(swap, [&one]).unwrap();
    connection.execute("UPDATE cell SET key = ?1 WHERE key = ?2", [&one, &two]).unwrap();
    drop(connection);
    assert_eq!(open(folder.path()).result_cache().get(&key(1).digest()), CacheLookup::Refused);
}

#[test]
fn voided_cells_are_removed_and_new_ones_stay() {
    let folder = quick_folder();
    let store = open(folder.path());
    store.result_cache().put(&key(1).digest(), b"one").unwrap();
    store.result_cache().invalidate().unwrap();
    assert_eq!(cached_cell(&store, 1), None);
    store.result_cache().put(&key(2).digest(), b"two").unwrap();
    assert!(cached_cell(&store, 2).is_some());
}

/// Episodes of the schema without MACs are no evidence: they are removed, and batches stay.
#[test]
fn episodes_of_an_older_schema_are_ignored() {
    let folder = quick_folder();
    let path = folder.path().join("telemetry.db");
    drop(open(folder.path()));
    std::fs::remove_file(&path).unwrap();
    let older = Connection::open(&path).unwrap();
    older.execute_batch(include_str!("../../schema/telemetry-1.sql")).unwrap();
    older.pragma_update(None, "application_id", 0x4850_5432).unwrap();
    older.pragma_update(None, "user_version", 1).unwrap();
    let row = "INSERT INTO episode (key, digest, bytes, used, body) VALUES (?1, ?1, 2, 1, x'3132')";
    older.execute(row, [key(1).digest().to_string()]).unwrap();
    older.execute_batch("UPDATE usage SET episode_bytes = 2").unwrap();
    drop(older);
    let store = open(folder.path());
    assert_eq!(store.result_cache().get(&key(1).digest()), CacheLookup::Nothing);
    drop(store);
    let now = Connection::open(&path).unwrap();
    let cells: i64 = now.query_row("SELECT count(*) FROM cell", [], |row| row.get(0)).unwrap();
    assert_eq!(cells, 0);
}

#[test]
fn bad_batches_are_refused() {
    let folder = quick_folder();
    let store = open(folder.path());
    let bad = [
        ("empty", Batch { body: vec![], ..batch(0, 1) }),
        ("no rows", Batch { rows: 0, ..batch(0, 1) }),
        ("too large", batch(0, (4 << 20) + 1)),
        ("backwards", Batch { from_ms: 3, ..batch(0, 1) }),
        ("stream", Batch { stream: "../x".into(), ..batch(0, 1) }),
        ("time", Batch { to_ms: u64::MAX, ..batch(0, 1) }),
    ];
    for (name, batch) in bad {
        assert!(store.append_telemetry(&batch).is_err(), "{name}");
    }
    assert_eq!(store.seal_telemetry().unwrap().len(), 0);
    let unknown =
        Change::SealTelemetry { version: id("grasp@9.9.9"), batch: 1, digest: digest("x"), rows: 1 };
    assert!(commit(&store, "seal", vec![unknown]).is_err());
}

/// A foreign key in a store's folder authenticates nothing.
#[test]
fn a_stores_secret_is_derived_from_the_key_that_signs_its_records() {
    let folder = quick_folder();
    let store = open(folder.path());
    let planted = keyfile::generate().unwrap();
    let own = store.result_cache().secret().derived("test").unwrap();
    assert_ne!(own, CacheSecret::of_store(&planted).unwrap().derived("test").unwrap());
    keyfile::write_secret(&store.layout().keys().join("cells.key"), &planted).unwrap();
    drop(store);
    assert_eq!(open(folder.path()).result_cache().secret().derived("test").unwrap(), own);
}
