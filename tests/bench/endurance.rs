//! Whether a service stays small: `cargo run --release --example serve_endurance -- PROGRAM SEQUENCES`.
//!
//! Starts `PROGRAM serve` on a new store at the fastest pace, counts the reported sequences of its live cell, and
//! reads the process's resources from the system: memory, descriptors, threads, and the size of its store. Counts
//! alarms, too: nothing drifts, so each is false. Prints a row at each step, so a shortened run has results. At the
//! end the service must end cleanly; nothing else is judged.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a measurement reports by failing, and prints its results"
)]

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

/// Rows that are printed.
const ROWS: u64 = 40;

/// The share of first rows that the slopes leave out: caches fill, and the allocator settles.
const WARM_UP_SHARE: f64 = 0.1;

const SECONDS_OF_A_DAY: f64 = 86_400.0;

/// The resources of the process and its store at one moment.
#[derive(Clone, Copy)]
struct EnduranceSample {
    sequences: u64,
    resident_kib: u64,
    descriptors: u64,
    threads: u64,
    store_bytes: u64,
}

/// A number of `/proc/PID/status`.
fn status(process: u32, field: &str) -> u64 {
    let text = fs::read_to_string(format!("/proc/{process}/status")).expect("the service runs");
    let line = text.lines().find_map(|line| line.strip_prefix(field)).expect("the kernel reports it");
    line.trim_start_matches(':').split_whitespace().next().unwrap().parse().unwrap()
}

/// Bytes of all files beneath a folder.
fn bytes(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .map(|entry| match entry.metadata() {
            Ok(found) if found.is_dir() => bytes(&entry.path()),
            Ok(found) => found.len(),
            // A file of the database that came and went.
            Err(_) => 0,
        })
        .sum()
}

fn sample(process: u32, store: &Path, sequences: u64) -> EnduranceSample {
    EnduranceSample {
        sequences,
        resident_kib: status(process, "VmRSS"),
        descriptors: fs::read_dir(format!("/proc/{process}/fd")).unwrap().count() as u64,
        threads: status(process, "Threads"),
        store_bytes: bytes(store),
    }
}

/// Growth of a value per sequence: the slope of the least squares.
fn slope(samples: &[EnduranceSample], value: impl Fn(&EnduranceSample) -> u64) -> f64 {
    let n = samples.len() as f64;
    let mean_x = samples.iter().map(|sample| sample.sequences as f64).sum::<f64>() / n;
    let mean_y = samples.iter().map(|sample| value(sample) as f64).sum::<f64>() / n;
    let (mut covariance, mut variance) = (0.0, 0.0);
    for sample in samples {
        let x = sample.sequences as f64 - mean_x;
        covariance += x * (value(sample) as f64 - mean_y);
        variance += x * x;
    }
    covariance / variance
}

/// Simulated seconds of the tasks of a sequence.
fn task_secs(event: &Value) -> f64 {
    let tasks = event["tasks"].as_array().map(Vec::as_slice).unwrap_or_default();
    tasks.iter().filter_map(|task| task["time_secs"].as_f64()).sum()
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let usage = "the program and a number of sequences";
    let program = arguments.next().expect(usage);
    let sequences: u64 = arguments.next().and_then(|argument| argument.parse().ok()).expect(usage);
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("store");
    let mut service = Command::new(&program)
        .args(["serve", "--pace", "max", "--json", "--data"])
        .arg(&store)
        .stdout(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let process = service.id();
    let lines = BufReader::new(service.stdout.take().unwrap()).lines();
    let started = Instant::now();
    let sequences_per_row = (sequences / ROWS).max(1);
    let (mut samples, mut simulated) = (Vec::new(), 0.0);
    let (mut done, mut counted) = (0, 0);
    let mut alarms = BTreeMap::new();
    println!("sequences\tsecs\tresident KiB\tdescriptors\tthreads\tstore bytes");
    for line in lines {
        let event: Value = serde_json::from_str(&line.unwrap()).expect("a line is a document");
        if event["event"] == "alarm" {
            // Nothing drifts here: every alarm is false.
            let name = event["alarm"].as_str().expect("it has a name").to_owned();
            *alarms.entry(name).or_insert(0_u64) += 1;
        }
        if event["event"] != "sequence" {
            continue;
        }
        // Sequences that were not reported because of this slow reader are counted by their index.
        done = event["index"].as_u64().expect("it has an index") + 1;
        simulated += task_secs(&event);
        counted += 1;
        if done / sequences_per_row > samples.len() as u64 {
            let row = sample(process, &store, done);
            let secs = started.elapsed().as_secs();
            let EnduranceSample { resident_kib, descriptors, threads, store_bytes, .. } = row;
            println!("{done}\t{secs}\t{resident_kib}\t{descriptors}\t{threads}\t{store_bytes}");
            samples.push(row);
        }
        if done >= sequences {
            break;
        }
    }
    kill_process(Pid::from_raw(i32::try_from(process).unwrap()).unwrap(), Signal::TERM).unwrap();
    let status = service.wait().unwrap();
    assert!(status.success(), "the service ended with {status}");
    assert!(done >= sequences, "the service ended after {done} sequences");
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a length")]
    let warm_up_rows = (samples.len() as f64 * WARM_UP_SHARE) as usize;
    let steady = &samples[warm_up_rows..];
    let sequence_secs = simulated / f64::from(u32::try_from(counted).unwrap());
    let sequences_per_day = SECONDS_OF_A_DAY / sequence_secs;
    println!("states of alarms in {done} sequences without a drift: {alarms:?}");
    println!("from sequence {} on, growth per 1,000 sequences:", steady[0].sequences);
    println!("  resident memory {:.1} KiB", 1_000.0 * slope(steady, |row| row.resident_kib));
    println!(
        "  descriptors {:.3}, threads {:.3}",
        1_000.0 * slope(steady, |row| row.descriptors),
        1_000.0 * slope(steady, |row| row.threads)
    );
    let bytes_per_sequence = slope(steady, |row| row.store_bytes);
    println!("  store {:.0} bytes", 1_000.0 * bytes_per_sequence);
    println!(
        "a sequence takes {sequence_secs:.2} simulated s of tasks: at most {sequences_per_day:.0} a day at the pace of \
         the clock"
    );
    println!(
        "  store {:.1} KiB a day, {:.1} KiB after the last sequence",
        bytes_per_sequence * sequences_per_day / 1024.0,
        bytes(&store) as f64 / 1024.0
    );
}
