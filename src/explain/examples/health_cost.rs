//! Prints the processor time of a query of health over time, for each span, on a store with thirty days of tasks. First makes
//! the store, with the given number of sequences of three tasks.
//! `cargo run --release -p holdpoint-explain --example health_cost -- 100000 1500`
#![allow(clippy::unwrap_used, clippy::panic, reason = "a measurement ends where it cannot go on")]
#![allow(clippy::print_stdout, reason = "its output is its purpose")]

#[path = "../../registry/tests/store/support.rs"]
#[allow(dead_code, reason = "the tests use the rest")]
mod store;

use std::time::Duration;

use holdpoint_explain::health_series::HealthReader;
use holdpoint_protocol::health::{HealthQuery, HealthSeries};
use holdpoint_registry::{Store, TelemetryLimits};
use holdpoint_store::{Batch, OpenStore, Transaction};
use rustix::time::{ClockId, clock_gettime};

const DAY_MS: u64 = 86_400_000;
const DAYS: u64 = 30;
const FAMILIES: [&str; 3] = ["grasp", "align", "place"];

fn cpu() -> Duration {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    Duration::new(u64::try_from(now.tv_sec).unwrap(), u32::try_from(now.tv_nsec).unwrap())
}

/// A stored task with a path of this many bytes.
fn body(success: bool, path_bytes: usize) -> Vec<u8> {
    let path = "0.553,".repeat(path_bytes / 6);
    format!(
        "{{\"task\":\"grasp\",\"seed\":1,\"success\":{success},\"violation\":false,\"anomaly\":false,\"recovery\":false,\
         \"retries\":0,\"time_secs\":4.2,\"timeout\":false,\"near\":false,\"clamps\":0,\"peak_force_n\":17.9,\
         \"peak_speed_m_s\":0.2,\"invalid\":false,\"path\":[{}]}}",
        path.trim_end_matches(',')
    )
    .into_bytes()
}

fn fill(store: &Store, sequences: u64, path_bytes: usize) {
    for family in FAMILIES {
        store::bootstrap(store, family);
    }
    let (good, bad) = (body(true, path_bytes), body(false, path_bytes));
    let wall = |at_ms: u64| 1_790_000_000_000 + i64::try_from(at_ms).unwrap();
    for sequence in 0..sequences {
        let at_ms = 10 + DAYS * DAY_MS * sequence / sequences;
        for family in FAMILIES {
            let body = if (sequence * 7) % 13 == 0 { bad.clone() } else { good.clone() };
            let version = format!("{family}@1.0.0").parse().unwrap();
            let batch = Batch { version, stream: "live".into(), from_ms: at_ms, to_ms: at_ms, rows: 1, body };
            store.append_telemetry(&batch).unwrap();
        }
        if store.telemetry_is_due(at_ms).unwrap() {
            store
                .commit_sealing(Transaction {
                    command_id: format!("seal {sequence}"),
                    at_ms,
                    wall_ms: wall(at_ms),
                    changes: Vec::new(),
                    audit: Vec::new(),
                })
                .unwrap();
        }
    }
}

fn main() {
    let mut numbers = std::env::args().skip(1).map(|text| text.parse::<u64>().unwrap());
    let sequences = numbers.next().unwrap_or(100_000);
    let path_bytes = usize::try_from(numbers.next().unwrap_or(1_500)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let limits = TelemetryLimits { batch_bytes_max: 8 << 30, ..TelemetryLimits::default() };
    let store = Store::open_with(folder.path(), limits).unwrap();
    fill(&store, sequences, path_bytes);
    println!("{} tasks, {} records", sequences * 3, store.views().unwrap().head().unwrap().seq);
    let measure = |what: &str, read: &dyn Fn(&HealthReader) -> HealthSeries| {
        let mut times: Vec<Duration> = (0..5)
            .map(|_| {
                let before = cpu();
                let reader = HealthReader::open(&*store.reader()).unwrap();
                let series = read(&reader);
                std::hint::black_box(&series);
                cpu().saturating_sub(before)
            })
            .collect();
        times.sort();
        let reader = HealthReader::open(&*store.reader()).unwrap();
        let coverage = read(&reader).coverage;
        println!(
            "{what}: median {:.0} ms, most {:.0} ms of processor time; {} tasks of {} of {} blocks",
            times[2].as_secs_f64() * 1e3,
            times[4].as_secs_f64() * 1e3,
            coverage.tasks,
            coverage.blocks_read,
            coverage.blocks
        );
    };
    for (what, bucket_ms, buckets) in [
        ("1 h by minute", 60_000, 60),
        ("18 h by 15 minutes", 900_000, 72),
        ("3 d by hour", 3_600_000, 72),
        ("30 d by 12 hours", 43_200_000, 60),
        ("72 d by day", 86_400_000, 72),
    ] {
        let query = HealthQuery { bucket_ms, buckets, ..HealthQuery::default() };
        measure(what, &|reader| reader.read(&query, None).unwrap());
    }
    let all = HealthQuery { bucket_ms: 86_400_000, buckets: 40, ..HealthQuery::default() };
    measure("30 d, every task", &|reader| reader.read_every_task(&all, None).unwrap());
}
