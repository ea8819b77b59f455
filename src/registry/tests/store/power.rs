//! Power cuts: a store's disk operations are recorded once, and the power fails at thousands of moments. Unflushed data
//! may be lost, in any order and torn; acknowledged data is kept, and the store opens.
//!
//! `HOLDPOINT_POWER_CUTS` is the number for each life (60), `HOLDPOINT_POWER_SEED` the seed (1). Each life also ends at
//! moments without any loss, as after `kill -9`: `HOLDPOINT_REPLAYED_KILLS` of them (20).

use std::path::Path;
use std::process::Command;

use holdpoint_registry::{Store, UnsignedRecords, check_invariants, rebuild, verify};
use holdpoint_store::{Batch, StoreError};
use rusqlite::Connection;

use crate::disk::{Loss, Trace};
use crate::edits::make_full_store;
use crate::kill::{acknowledged, one_step};
use crate::mutate::Random;
use crate::quick_folder::quick_folder;
use crate::released::schema_1;
use crate::support::*;

const CHILD: &str = "HOLDPOINT_POWER_CHILD";
/// After all records of the stores here, virtual time.
const LATER_MS: u64 = 1_000_000_000;

/// Three engines, one after the other, each with activations, rollbacks, telemetry and cached results; prints its
/// acknowledgments.
fn life(folder: &Path) {
    for engine in 0..3 {
        let store = Store::open(folder).unwrap();
        let start = store.opening().head.seq;
        if engine == 0 {
            bootstrap(&store, "grasp");
        }
        println!("ACK {}", store.views().unwrap().head().unwrap().seq);
        let ada = person(&store, "ada");
        for step in 0..6 {
            let receipt = one_step(&store, &ada, start, step).unwrap();
            println!("ACK {}", receipt.last_seq);
            let (version, body) = (id("grasp@1.0.0"), vec![7; 3_000]);
            let batch =
                Batch { version, stream: "live".into(), from_ms: step, to_ms: step + 1, rows: 1, body };
            store.append_telemetry(&batch).unwrap();
            if step % 3 == 2 {
                let sealed =
                    commit(&store, &format!("seal {start} {step}"), store.seal_telemetry().unwrap()).unwrap();
                println!("ACK {}", sealed.last_seq);
                store.result_cache().put(&digest(&format!("cell {start} {step}")), b"kept").unwrap();
            }
        }
    }
}

fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
}

/// This test again as a child in `folder`, recorded.
fn recorded(test: &str, folder: &Path) -> Option<Trace> {
    let mut child = Command::new(std::env::current_exe().unwrap());
    child.args([test, "--exact", "--nocapture", "--test-threads=1"]).env(CHILD, folder);
    Trace::record(folder, &mut child, acknowledged)
}

/// Ends a recorded life in every requested way, and checks the rest; `check` gets the acknowledged record.
fn ended(name: &str, trace: &Trace, check: impl Fn(&Path, u64, &str)) {
    let seed = number("HOLDPOINT_POWER_SEED", 1);
    for (loss, cases) in [
        (Loss::Unforced, number("HOLDPOINT_POWER_CUTS", 60)),
        (Loss::Nothing, number("HOLDPOINT_REPLAYED_KILLS", 20)),
    ] {
        for case in 0..cases {
            let mut random = Random::of_run(seed, case);
            let point = random.below(trace.cut_count());
            let folder = quick_folder();
            trace.play(point, loss, &mut random, folder.path());
            let when = format!("{name}, {loss:?}: seed {seed}, case {case}, moment {point}");
            check(folder.path(), trace.acknowledged(point), &when);
        }
        println!("{name}: seed {seed}, {cases} ends of {} moments, {loss:?} lost", trace.cut_count());
    }
}

/// Acknowledged data is kept, the invariants hold, and the next engine runs on it and can be followed by another.
fn goes_on(folder: &Path, acknowledged: u64, when: &str) {
    let store =
        unless_in_use(|| Store::open(folder)).unwrap_or_else(|error| panic!("{when}: bricked: {error}"));
    let views = store.views().unwrap();
    let head = views.head().unwrap().seq;
    assert!(head >= acknowledged, "{when}: {acknowledged} was acknowledged, {head} are there");
    assert_eq!(check_invariants(views.connection()).unwrap(), [], "{when}");
    if views.context().unwrap().is_none() {
        bootstrap(&store, "grasp");
    }
    let after = transaction("after", LATER_MS, vec![new_version("grasp@9.0.0", false)]);
    store.commit(after).unwrap_or_else(|error| panic!("{when}: {error}"));
    assert_eq!(store.checkpoint_problem(), None, "{when}");
    let key = *store.public_key();
    drop((views, store));
    drop(unless_in_use(|| Store::open(folder)).unwrap_or_else(|error| panic!("{when}: bricked: {error}")));
    verify(&folder.join("holdpoint.db"), Some(&key)).unwrap_or_else(|error| panic!("{when}: {error}"));
}

#[test]
fn power_cut_at_any_moment_loses_no_acknowledged_record() {
    if let Ok(folder) = std::env::var(CHILD) {
        return life(Path::new(&folder));
    }
    let folder = quick_folder();
    let test = "power::power_cut_at_any_moment_loses_no_acknowledged_record";
    let Some(trace) = recorded(test, folder.path()) else { return };
    assert!(
        trace.acknowledged(trace.cut_count() - 1) > 80 && trace.cut_count() > 800,
        "{}",
        trace.cut_count()
    );
    ended("a life", &trace, goes_on);
    // The check can fail: it does on a disk that flushes nothing.
    let lost = (0..40).filter(|case| {
        let mut random = Random::of_run(1, *case);
        let point = random.below(trace.cut_count());
        let folder = quick_folder();
        trace.play(point, Loss::Anything, &mut random, folder.path());
        let opened = Store::open(folder.path());
        opened.is_err()
            || opened
                .is_ok_and(|store| store.views().unwrap().head().unwrap().seq < trace.acknowledged(point))
    });
    assert!(lost.count() > 10, "a disk that lies is not noticed");
}

#[test]
fn a_power_cut_in_a_rebuild_leaves_a_store_that_can_be_rebuilt() {
    if let Ok(folder) = std::env::var(CHILD) {
        drop(rebuild(Path::new(&folder), UnsignedRecords::Refuse, "{}", 0).unwrap());
        return;
    }
    let folder = quick_folder();
    make_full_store(folder.path());
    let least = verify(&folder.path().join("holdpoint.db"), None).unwrap().records;
    Connection::open(folder.path().join("holdpoint.db"))
        .unwrap()
        .execute_batch("UPDATE family SET reason = 'edited' WHERE name = 'grasp'")
        .unwrap();
    let test = "power::a_power_cut_in_a_rebuild_leaves_a_store_that_can_be_rebuilt";
    let Some(trace) = recorded(test, folder.path()) else { return };
    ended("a rebuild", &trace, |folder, _, when| {
        match unless_in_use(|| Store::open(folder)).map(drop) {
            Ok(()) => {}
            Err(StoreError::Refused { .. }) => {
                let rebuilt = unless_in_use(|| rebuild(folder, UnsignedRecords::Refuse, "{}", 0));
                assert!(rebuilt.unwrap_or_else(|error| panic!("{when}: {error}")).is_some(), "{when}");
            }
            Err(error) => panic!("{when}: {error}"),
        }
        goes_on(folder, least, when);
    });
}

#[test]
fn power_cut_during_a_migration_loses_no_record() {
    if let Ok(folder) = std::env::var(CHILD) {
        drop(open(Path::new(&folder)));
        return;
    }
    let folder = quick_folder();
    let store = schema_1(folder.path());
    let least = verify(&store.join("holdpoint.db"), None).unwrap().records;
    let test = "power::power_cut_during_a_migration_loses_no_record";
    let Some(trace) = recorded(test, &store) else { return };
    ended("an old store", &trace, |folder, _, when| goes_on(folder, least, when));
}
