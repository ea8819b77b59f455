//! Prints the cost of a long chain for a start, the verifier, a rebuild and appends. The stores have 10^4, 10^5 and
//! 10^6 records of about 1 KB, or the given numbers. Each step is a separate process: wall time, CPU time, and peak
//! memory. `cargo run --release --example long_chain -- 10000 100000 1000000`
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
use std::process::Command;
use std::time::{Duration, Instant};

use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::record::RecordKind;
use holdpoint_registry::{
    BackupParts, ExportScope, Store, UnsignedRecords, UnverifiedStore, Views, backup, export_store,
    prove_record, rebuild, verify,
};
use holdpoint_store::{AuditBody, Change, EvidenceKind, StoreError, Transaction};
use rusqlite::Connection;
use rustix::time::{ClockId, clock_gettime};
use store::{bootstrap, evidence, shadowed};

/// Records of a transaction that follow from its changes: one in four.
const CHANGE_RECORDS: u64 = 64;

/// Records of a transaction that its caller adds.
const CALLER_RECORDS: u64 = 192;

/// Fills a store up to this many records.
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
        let mut changes: Vec<Change> = (1..CHANGE_RECORDS).map(alarm).collect();
        changes.push(evidence("grasp@1.1.0", EvidenceKind::Monitor, &format!("{number} {text}")));
        let record = AuditBody {
            kind: RecordKind::Monitor,
            subject: "grasp@1.1.0".into(),
            body: format!("{{\"text\":\"{text}{}\"}}", &text[..100]),
        };
        let audit = (0..CALLER_RECORDS).map(|_| record.clone()).collect();
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

/// Timed appends, each a transaction that is on disk when it returns.
const APPENDS: u64 = 10_000;

/// The measured steps, each in its own process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ChainMeasure {
    View,
    Start,
    StartWhole,
    Shown,
    Verify,
    Append,
    Rebuild,
    StartAfter,
}

impl ChainMeasure {
    const ALL: [Self; 8] = [
        Self::View,
        Self::Start,
        Self::StartWhole,
        Self::Shown,
        Self::Verify,
        Self::Append,
        Self::Rebuild,
        Self::StartAfter,
    ];

    const fn name(self) -> &'static str {
        match self {
            Self::View => "view before the record is read",
            Self::Start => "start from a snapshot",
            Self::StartWhole => "start, the whole chain",
            Self::Shown => "shown without an engine",
            Self::Verify => "verify",
            Self::Append => "append",
            Self::Rebuild => "rebuild",
            Self::StartAfter => "start after it",
        }
    }

    fn prepare(self, folder: &Path) {
        match self {
            Self::StartWhole => remove_snapshots(folder),
            Self::Rebuild => {
                let database = Connection::open(folder.join("holdpoint.db")).unwrap();
                database.execute_batch("UPDATE family SET reason = 'edited'").unwrap();
            }
            Self::View | Self::Start | Self::Shown | Self::Verify | Self::Append | Self::StartAfter => {}
        }
    }

    fn run(self, folder: &Path) -> Result<(), Box<dyn std::error::Error>> {
        let database = folder.join("holdpoint.db");
        match self {
            Self::View => {
                let unverified = UnverifiedStore::take(folder)?;
                let views = unverified.views()?.ok_or("there is no store")?;
                views.families()?;
                views.alarms()?;
                views.head()?;
            }
            Self::Start | Self::StartWhole | Self::StartAfter => drop(Store::open(folder)?),
            Self::Shown => drop(Views::open_checked(&database)?),
            Self::Verify => {
                let (key, _) = holdpoint_approvals::keyfile::read_public(&folder.join("keys/store.pub"))?;
                verify(&database, Some(&key))?;
            }
            Self::Append => append(&Store::open(folder)?)?,
            Self::Rebuild => {
                drop(rebuild(folder, UnsignedRecords::Refuse, "{}", 0)?.ok_or("nothing was rebuilt")?);
            }
        }
        Ok(())
    }
}

/// Commits one record after the other.
fn append(store: &Store) -> Result<(), StoreError> {
    let begin = store.opening().head;
    let mut durations: Vec<Duration> = Vec::new();
    for number in 0..APPENDS {
        let record = AuditBody {
            kind: RecordKind::Monitor,
            subject: "grasp@1.1.0".into(),
            body: format!("{{\"text\":\"{}\"}}", "x".repeat(800)),
        };
        let transaction = Transaction {
            command_id: format!("append {} {number}", begin.seq),
            at_ms: begin.at_ms,
            wall_ms: 0,
            changes: Vec::new(),
            audit: vec![record],
        };
        let start = Instant::now();
        store.commit(transaction)?;
        durations.push(start.elapsed());
    }
    durations.sort();
    let quantile = |share: f64| {
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "a place in a list"
        )]
        let place = ((durations.len() - 1) as f64 * share) as usize;
        durations[place]
    };
    println!(
        "  append: p50 {:?}, p99 {:?}, max {:?}, n {APPENDS}",
        quantile(0.5),
        quantile(0.99),
        quantile(1.0)
    );
    Ok(())
}

/// CPU time of this process so far, s.
fn cpu_s() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as f64 + now.tv_nsec as f64 / 1e9
}

/// The most memory this process had, MB.
fn memory_mb() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    line.split_whitespace().next().unwrap().parse::<u64>().unwrap() / 1024
}

fn timed<T>(name: &str, step: impl FnOnce() -> T) -> T {
    let (wall, cpu) = (Instant::now(), cpu_s());
    let result = step();
    println!(
        "  {name}: {:.3} s, {:.3} s of CPU, {} MB",
        wall.elapsed().as_secs_f64(),
        cpu_s() - cpu,
        memory_mb()
    );
    result
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
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [flag, phase, folder] = arguments.as_slice()
        && flag == "--phase"
    {
        let phase =
            ChainMeasure::ALL.into_iter().find(|known| known.name() == phase).ok_or("no such phase")?;
        return timed(phase.name(), || phase.run(Path::new(folder)));
    }
    let requested: Vec<u64> = arguments.iter().map(|text| text.parse()).collect::<Result<_, _>>()?;
    let sizes = if requested.is_empty() { vec![10_000, 100_000, 1_000_000] } else { requested };
    for records in sizes {
        let folder = tempfile::tempdir()?;
        let store = Store::open(folder.path())?;
        let database = store.layout().database();
        println!("{records} records");
        timed("made", || fill(&store, records))?;
        let key = *store.public_key();
        drop(store);
        println!("  {} MB", fs::metadata(&database)?.len() / 1_000_000);
        let proof = timed("proof of a record", || prove_record(&database, records / 2))?;
        println!("  which has {} bytes", proof.text()?.len());
        timed("proof checked", || proof.check(&key))?;
        timed("exported", || export_store(&database, ExportScope::Signed, Some(&key), &mut std::io::sink()))?;
        let backup_folder = tempfile::tempdir()?;
        timed("backup", || {
            backup(folder.path(), &backup_folder.path().join("copy"), BackupParts::default())
        })?;
        for phase in ChainMeasure::ALL {
            phase.prepare(folder.path());
            let status = Command::new(std::env::current_exe()?)
                .args(["--phase", phase.name()])
                .arg(folder.path())
                .status()?;
            if !status.success() {
                return Err(format!("{} failed", phase.name()).into());
            }
        }
        if std::env::var_os("LONG_CHAIN_KEEP").is_some() {
            println!("  kept in {}", folder.keep().display());
        }
    }
    Ok(())
}
