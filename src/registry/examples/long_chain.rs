//! Prints what a long chain costs at a start, in the verifier, and in a rebuild, for stores of 10^4, 10^5 and 10^6
//! records of about 1 KB, or of as many as it is given.
//! `cargo run --release --example long_chain -- 10000 100000 1000000`
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test says what it expects by failing"
)]
#![allow(clippy::print_stdout, reason = "its output is its purpose")]

#[path = "../tests/store/support.rs"]
#[allow(dead_code, reason = "the tests use the rest")]
mod store;

use std::fs;
use std::path::Path;
use std::time::Instant;

use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::record::RecordKind;
use holdpoint_registry::names::EvidenceKind;
use holdpoint_registry::{
    AuditBody, BackupParts, Change, Store, StoreError, Transaction, Views, backup, export_store,
    prove_record, rebuild, verify,
};
use rusqlite::Connection;
use store::{bootstrap, evidence, shadowed};

/// Records of a transaction: one in four is the store's own.
const OWN: u64 = 64;
const CALLERS: u64 = 192;

/// Fills a store up to so many records.
fn fill(store: &Store, records: u64) -> Result<(), StoreError> {
    bootstrap(store, "grasp");
    shadowed(store, "grasp@1.1.0");
    let text = "x".repeat(700);
    let mut number = 0;
    while store.views()?.head()?.seq < records {
        number += 1;
        let alarm = |nth: u64| Change::AlarmChange {
            alarm: format!("alarm-{nth}"),
            subject: "grasp@1.1.0".into(),
            state: AlarmState::Unacknowledged,
            priority: Priority::High,
            json: format!("{{\"number\":{number},\"text\":\"{text}\"}}"),
        };
        let mut changes: Vec<Change> = (1..OWN).map(alarm).collect();
        changes.push(evidence("grasp@1.1.0", EvidenceKind::Monitor, &format!("{number} {text}")));
        let one = AuditBody {
            kind: RecordKind::Monitor,
            subject: "grasp@1.1.0".into(),
            body: format!("{{\"text\":\"{text}{}\"}}", &text[..100]),
        };
        let audit = (0..CALLERS).map(|_| one.clone()).collect();
        store.commit(Transaction {
            command_id: format!("fill {number}"),
            at_ms: number,
            wall_ms: 0,
            changes,
            audit,
        })?;
    }
    Ok(())
}

/// CPU time of this process so far, s.
fn cpu_s() -> f64 {
    let stat = fs::read_to_string("/proc/self/stat").unwrap();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
    let ticks: f64 = fields[11..13].iter().map(|field| field.parse::<f64>().unwrap()).sum();
    ticks / 100.0
}

fn timed<T>(what: &str, work: impl FnOnce() -> T) -> T {
    let (wall, cpu) = (Instant::now(), cpu_s());
    let done = work();
    println!("  {what}: {:.2} s, {:.2} s of CPU", wall.elapsed().as_secs_f64(), cpu_s() - cpu);
    done
}

fn remove_snapshots(folder: &Path) {
    for entry in fs::read_dir(folder.join("checkpoints")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|ending| ending == "fold") {
            fs::remove_file(path).unwrap();
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let asked: Vec<u64> = std::env::args().skip(1).map(|text| text.parse()).collect::<Result<_, _>>()?;
    let asked = if asked.is_empty() { vec![10_000, 100_000, 1_000_000] } else { asked };
    for records in asked {
        let folder = tempfile::tempdir()?;
        let made = Store::open(folder.path())?;
        let database = made.layout().database();
        println!("{records} records");
        timed("made", || fill(&made, records))?;
        let key = *made.public_key();
        drop(made);
        println!("  {} MB", fs::metadata(&database)?.len() / 1_000_000);
        timed("start", || Store::open(folder.path()).map(drop))?;
        timed("shown without an engine", || Views::open_checked(&database).map(drop))?;
        let middle = records / 2;
        let proof = timed("proof of a record", || prove_record(&database, middle))?;
        println!("  which has {} bytes", proof.text()?.len());
        timed("proof checked", || proof.check(&key))?;
        timed("exported", || export_store(&database, Some(&key), &mut std::io::sink()))?;
        timed("backup", || backup(folder.path(), &folder.path().join("copy"), BackupParts::default()))?;
        remove_snapshots(folder.path());
        timed("start without a snapshot", || Store::open(folder.path()).map(drop))?;
        timed("verify", || verify(&database, Some(&key)))?;
        Connection::open(&database)?.execute_batch("UPDATE family SET reason = 'edited'")?;
        timed("rebuild", || rebuild(folder.path(), "{}", 0))?.ok_or("nothing was rebuilt")?;
        timed("start after it", || Store::open(folder.path()).map(drop))?;
    }
    Ok(())
}
