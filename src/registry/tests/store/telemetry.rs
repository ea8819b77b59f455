//! Telemetry batches, their seals, retention, and cached episodes.

use holdpoint_registry::{Batch, Change, EpisodeKey, Store, TelemetryLimits, VerifyError, verify};
use rusqlite::Connection;

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
fn sealed_batches_are_vouched_for() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    let kept = store.append_telemetry(&batch(1, 100)).unwrap();
    store.append_telemetry(&batch(2, 100)).unwrap();
    let seals = store.seal_telemetry().unwrap();
    assert_eq!((seals.len(), store.seal_telemetry().unwrap().len()), (2, 0));
    commit(&store, "seal", seals).unwrap();
    assert_eq!(store.telemetry_batch(kept.batch).unwrap(), Some(batch(1, 100)));
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
    assert_eq!(verify(&database, None).unwrap().batches_unseen, 2);
}

#[test]
fn the_oldest_go_first() {
    let folder = tempfile::tempdir().unwrap();
    let limits = TelemetryLimits { batch_bytes_max: 250, episode_bytes_max: 250 };
    let store = Store::open_with(folder.path(), limits).unwrap();
    bootstrap(&store, "grasp");
    let batches: Vec<_> =
        (0..4).map(|fill| store.append_telemetry(&batch(fill, 100)).unwrap().batch).collect();
    let there: Vec<_> = batches.iter().map(|n| store.telemetry_batch(*n).unwrap().is_some()).collect();
    assert_eq!(there, [false, false, true, true]);
    commit(&store, "seal", store.seal_telemetry().unwrap()).unwrap();
    let report = verify(&store.layout().database(), None).unwrap();
    assert_eq!((report.batches, report.batches_pruned), (2, 2));

    for seed in 0..2 {
        store.put_cached_episode(&key(seed), &[7; 100]).unwrap();
    }
    assert!(store.cached_episode(&key(0)).unwrap().is_some());
    store.put_cached_episode(&key(2), &[8; 100]).unwrap();
    let there: Vec<_> = (0..3).map(|seed| store.cached_episode(&key(seed)).unwrap().is_some()).collect();
    assert_eq!(there, [true, false, true], "the one longest unused goes");
}

#[test]
fn a_cached_episode_is_that_one_or_none() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    store.put_cached_episode(&key(1), b"first").unwrap();
    store.put_cached_episode(&key(1), b"second").unwrap();
    assert_eq!(store.cached_episode(&key(1)).unwrap().as_deref(), Some(b"second".as_slice()));
    let others = [
        key(2),
        EpisodeKey { bundle: digest("x"), ..key(1) },
        EpisodeKey { scenario: digest("x"), ..key(1) },
        EpisodeKey { engine_build: "2".into(), ..key(1) },
    ];
    for other in others {
        assert_eq!(store.cached_episode(&other).unwrap(), None, "{other:?}");
    }
    drop(store);
    let telemetry = folder.path().join("telemetry.db");
    Connection::open(telemetry).unwrap().execute_batch("UPDATE episode SET body = zeroblob(6)").unwrap();
    assert_eq!(open(folder.path()).cached_episode(&key(1)).unwrap(), None);
}

#[test]
fn bad_batches_are_refused() {
    let folder = tempfile::tempdir().unwrap();
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
