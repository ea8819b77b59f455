//! Sudden death: a child that uses the store is killed at a random moment; acknowledged data is kept and every
//! invariant holds. `HOLDPOINT_KILLS` sets the number of kills (5). With the `failpoints` feature it also dies at each
//! named place of a transaction.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use holdpoint_approvals::{Identity, Nonce};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_registry::{Store, check_invariants, failpoint, verify};
use holdpoint_store::{AuditFilter, Change, Receipt, StoreError};

use crate::quick_folder::quick_folder;
use crate::support::*;

const CHILD: &str = "HOLDPOINT_KILL_CHILD";
/// The number of kills of one store; then its chain is long enough, and a new one begins.
const KILLS_OF_A_STORE: u64 = 25;

/// This test again, as a child that works in `folder`.
fn child(test: &str, folder: &Path, wrap: Option<&str>, failpoint: &str) -> Child {
    let program = std::env::current_exe().unwrap();
    let mut command = match wrap {
        None => Command::new(program),
        Some(wrap) => {
            let mut shell = Command::new("sh");
            shell.args(["-c", wrap, "sh"]).arg(program);
            shell
        }
    };
    command
        .args([test, "--exact", "--nocapture", "--test-threads=1"])
        .env(CHILD, folder)
        .env("HOLDPOINT_FAILPOINT", failpoint)
        .stdout(Stdio::piped())
        .stderr(Stdio::null());
    command.spawn().unwrap()
}

/// The number after `ACK` in a line of the child.
pub fn acknowledged(line: &str) -> Option<u64> {
    line.split("ACK ").nth(1)?.trim().parse().ok()
}

/// Registers, activates and rolls back forever; prints `ACK <seq>` after each commit, `FAILED` if one fails.
fn work(folder: &Path) {
    let store = Store::open(folder).unwrap();
    let start = store.opening().head.seq;
    if store.views().unwrap().context().unwrap().is_none() {
        bootstrap(&store, "grasp");
    }
    let ada = person(&store, "ada");
    for step in 0u64.. {
        match one_step(&store, &ada, start, step) {
            Ok(receipt) => println!("ACK {}", receipt.last_seq),
            Err(error) => {
                println!("FAILED {error:?}");
                return;
            }
        }
    }
}

/// An approved activation, or every other time its rollback.
pub fn one_step(store: &Store, ada: &Identity, start: u64, step: u64) -> Result<Receipt, StoreError> {
    let views = store.views()?;
    let status = views.families()?.remove(0);
    let row_version = |version: &CapabilityId| views.version(version).unwrap().unwrap().summary.row_version;
    let active = status.active.unwrap();
    let command = format!("{start} {step}");
    match status.pinned {
        Some(pinned) if step % 2 == 1 => {
            let (new, old) = (active.to_string(), pinned.to_string());
            commit(store, &command, rollback((&new, row_version(&active)), (&old, row_version(&pinned))))
        }
        _ => {
            let name = format!("grasp@2.{start}.{step}");
            let nonce = Nonce::random().unwrap();
            let mut approval = approval(store, &name, 0);
            approval.nonce = nonce.clone();
            let signed = Box::new(ada.sign(over(approval, ada)).unwrap());
            let put = vec![Change::PutApproval(signed)];
            let old = active.to_string();
            let mut changes = vec![Change::ConsumeApproval {
                nonce: nonce.to_string(),
                evidence_digest: digest(&format!("gate {name}")),
                at: Some(WallTime::from_ms(WALL_MS)),
            }];
            changes.extend(activation(&name, (&old, row_version(&active)), 1));
            commit(store, &format!("{command} shadowed"), shadowing(&name))?;
            commit(store, &format!("{command} put"), put)?;
            commit(store, &command, changes)
        }
    }
}

/// After a death: the chain reaches the acknowledged record and the invariants hold, also for the next engine.
pub fn check(folder: &Path, last_ack: u64, when: &str) {
    let database = folder.join("holdpoint.db");
    let report = verify(&database, None).unwrap_or_else(|error| panic!("{when}: {error}"));
    assert!(report.records >= last_ack, "{when}: {last_ack} was acknowledged, {} are there", report.records);
    let store = Store::open(folder).unwrap_or_else(|error| panic!("{when}: {error}"));
    let views = store.views().unwrap();
    assert_eq!(check_invariants(views.connection()).unwrap(), [], "{when}");
    assert_eq!(views.head().unwrap().seq, report.records, "{when}");
}

#[test]
fn kill_at_any_moment_loses_no_acknowledged_record() {
    if let Ok(folder) = std::env::var(CHILD) {
        return work(Path::new(&folder));
    }
    let kills: u64 = std::env::var("HOLDPOINT_KILLS").map_or(5, |text| text.parse().unwrap());
    let seed: u64 = std::env::var("HOLDPOINT_KILL_SEED").map_or(7, |text| text.parse().unwrap());
    let mut folder = quick_folder();
    let test = "kill::kill_at_any_moment_loses_no_acknowledged_record";
    let mut random = seed;
    let mut last_ack = 0;
    let mut placed = 0;
    let mut places = failpoint::PLACES.iter().cycle();
    for cycle in 0..kills {
        if cycle > 0 && cycle % KILLS_OF_A_STORE == 0 {
            (folder, last_ack) = (quick_folder(), 0);
        }
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        // At a named place if the build has them (every other time), else after some acknowledgement.
        let place = if failpoint::ENABLED && cycle % 2 == 1 { places.next() } else { None };
        let failpoint = place.map_or(String::new(), |place| format!("{place}=kill@{}", 1 + (random >> 60)));
        placed += u64::from(place.is_some());
        let mut child = child(test, folder.path(), None, &failpoint);
        let mut acks_left = if place.is_some() { u64::MAX } else { 1 + (random >> 33) % 12 };
        for line in BufReader::new(child.stdout.take().unwrap()).lines() {
            let line = line.unwrap();
            assert!(!line.contains("FAILED"), "cycle {cycle} {failpoint}: {line}");
            let Some(ack) = acknowledged(&line) else { continue };
            last_ack = ack;
            acks_left -= 1;
            if acks_left == 0 {
                child.kill().unwrap();
            }
            assert!(acks_left != u64::MAX - 500, "cycle {cycle}: {failpoint} was never reached");
            acks_left = acks_left.max(1);
        }
        let status = child.wait().unwrap();
        assert_eq!(
            std::os::unix::process::ExitStatusExt::signal(&status),
            Some(9),
            "cycle {cycle} {failpoint}"
        );
        check(folder.path(), last_ack, &format!("seed {seed}, cycle {cycle} {failpoint}"));
    }
    println!("kills of the store: seed {seed}, {kills} kills, {placed} of them at a named place");
}

/// A full disk: the error is reported, acknowledged data is kept, and the store continues once there is space.
#[test]
fn full_disk_loses_no_acknowledged_record() {
    if let Ok(folder) = std::env::var(CHILD) {
        return work(Path::new(&folder));
    }
    let folder = tempfile::tempdir().unwrap();
    let test = "kill::full_disk_loses_no_acknowledged_record";
    // Files of at most 1.2 MiB, some 75 pages: the log cannot grow beyond that.
    let wrap = "trap '' XFSZ; ulimit -f 2400; exec \"$@\"";
    let mut child = child(test, folder.path(), Some(wrap), "");
    let mut last_ack = 0;
    let mut failed = None;
    for line in BufReader::new(child.stdout.take().unwrap()).lines() {
        let line = line.unwrap();
        last_ack = acknowledged(&line).unwrap_or(last_ack);
        failed = failed.or_else(|| line.split("FAILED ").nth(1).map(str::to_owned));
    }
    child.wait().unwrap();
    let failed = failed.expect("the limit was reached");
    assert!(failed.starts_with("Database {") || failed.starts_with("DiskFull {"), "{failed}");
    check(folder.path(), last_ack, "disk full");
    let store = open(folder.path());
    let before = store.views().unwrap().head().unwrap().seq;
    commit(&store, "again", vec![new_version("grasp@3.0.0", false)]).unwrap();
    let records =
        store.views().unwrap().audit(&AuditFilter { from_seq: before + 1, ..Default::default() }).unwrap();
    assert_eq!(records[0].kind, holdpoint_governance::record::RecordKind::VersionRegistered);
}
