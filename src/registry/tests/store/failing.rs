//! A failing disk: one system call that writes, allocates, syncs, renames or removes is refused, at every place in
//! turn. The error is reported, acknowledged data is kept, and the store stays usable.
//!
//! strace refuses the calls (`--inject`), outside the program, so that SQLite's own calls fail like ours. Without
//! strace, or where tracing is forbidden, the test skips itself with a message. `HOLDPOINT_IO_ERRORS` is the number of
//! cases (6). One call fails, or three in a row, or every later one; the lengths of the runs differ.

use std::path::Path;
use std::process::{Command, Stdio};

use holdpoint_registry::{Store, check_invariants, verify};
use holdpoint_store::Batch;

use crate::kill::one_step;
use crate::quick_folder::quick_folder;
use crate::support::*;

const CHILD: &str = "HOLDPOINT_FAILING_CHILD";
/// Further steps of the run.
const MORE: &str = "HOLDPOINT_FAILING_MORE";
const TEST: &str = "failing::disk_that_fails_at_any_call_loses_no_acknowledged_record";

/// The refused call and its error.
const CALLS: [&str; 6] = ["write", "pwrite64", "fsync", "fdatasync", "ftruncate", "rename"];
const ERRORS: [&str; 2] = ["EIO", "ENOSPC"];

/// How long a disk fails, from its `nth` call on.
#[derive(Clone, Copy, Debug)]
enum Spell {
    Once,
    Thrice,
    ForGood,
}

impl Spell {
    const ALL: [Self; 3] = [Self::Once, Self::Thrice, Self::ForGood];

    /// As strace takes it.
    fn when(self, nth: u64) -> String {
        match self {
            Self::Once => nth.to_string(),
            Self::Thrice => format!("{nth}..{}", nth + 2),
            Self::ForGood => format!("{nth}+"),
        }
    }
}

/// A short life of a store, from its creation to an activation and its rollback, with telemetry; prints `ACK <seq>`
/// after each commit and `FAILED` with the error at the first.
fn live(folder: &Path) -> Result<(), holdpoint_store::StoreError> {
    let store = Store::open(folder)?;
    let version = id("grasp@1.0.0");
    let acked = |command: &str, changes| {
        let receipt = commit(&store, command, changes)?;
        println!("ACK {}", receipt.last_seq);
        Ok::<_, holdpoint_store::StoreError>(())
    };
    acked("bootstrap", bootstrapping("grasp"))?;
    acked("shadowed", shadowing("grasp@1.1.0"))?;
    store.append_telemetry(&Batch {
        version,
        stream: "live".into(),
        from_ms: 1,
        to_ms: 2,
        rows: 1,
        body: vec![7; 900],
    })?;
    acked("seal", store.seal_telemetry()?)?;
    acked("activate", activation("grasp@1.1.0", ("grasp@1.0.0", 2), 0))?;
    acked("rollback", rollback(("grasp@1.1.0", 5), ("grasp@1.0.0", 3)))?;
    let more: u64 = std::env::var(MORE).map_or(0, |text| text.parse().unwrap());
    if more > 0 {
        let ada = person(&store, "ada");
        for step in 0..more {
            println!("ACK {}", one_step(&store, &ada, 0, step)?.last_seq);
        }
    }
    println!("DONE");
    Ok(())
}

/// Runs [`live`] in `folder` with refused calls; returns its output.
fn run(folder: &Path, more: u64, (call, error, when): (&str, &str, &str)) -> String {
    let program = std::env::current_exe().unwrap();
    let mut command = Command::new("strace");
    command.args(["-f", "-qq", "-o", "/dev/null", "-P"]).arg(folder);
    for file in ["holdpoint.db", "holdpoint.new", "telemetry.db", "telemetry.new"] {
        for ending in ["", "-wal", "-journal"] {
            command.arg("-P").arg(folder.join(format!("{file}{ending}")));
        }
    }
    for file in ["checkpoints", "keys", "keys/store.key.part", "keys/store.pub.part"] {
        command.arg("-P").arg(folder.join(file));
    }
    command.args(["-e", &format!("trace={call}"), "-e", &format!("inject={call}:error={error}:when={when}")]);
    command.arg(program);
    command
        .args([TEST, "--exact", "--nocapture", "--test-threads=1"])
        .env(CHILD, folder)
        .env(MORE, more.to_string());
    let output = command.stdout(Stdio::piped()).stderr(Stdio::piped()).output().unwrap();
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

fn can_trace() -> bool {
    let traced = Command::new("strace").args(["-o", "/dev/null", "true"]).stderr(Stdio::null()).status();
    traced.is_ok_and(|status| status.success())
}

/// After the failure: acknowledged data is there, the invariants hold, and the next engine runs on it.
fn check(folder: &Path, output: &str, when: &str) -> bool {
    let acked = output.lines().filter_map(|line| line.split("ACK ").nth(1)?.trim().parse::<u64>().ok());
    let acked = acked.max().unwrap_or(0);
    assert!(!output.contains("panicked"), "{when}: {output}");
    let failed = output.contains("FAILED");
    assert!(failed || output.contains("DONE"), "{when}: neither an error nor an end: {output}");
    let store = Store::open(folder).unwrap_or_else(|error| panic!("{when}: bricked: {error}"));
    let views = store.views().unwrap();
    assert!(views.head().unwrap().seq >= acked, "{when}: {acked} was acknowledged: {output}");
    assert_eq!(check_invariants(views.connection()).unwrap(), [], "{when}");
    if views.context().unwrap().is_none() {
        bootstrap(&store, "grasp");
    }
    commit(&store, "after", vec![new_version("grasp@9.0.0", false)]).unwrap();
    drop((views, store));
    verify(&folder.join("holdpoint.db"), None).unwrap_or_else(|error| panic!("{when}: {error}"));
    failed
}

#[test]
fn disk_that_fails_at_any_call_loses_no_acknowledged_record() {
    if let Ok(folder) = std::env::var(CHILD) {
        if let Err(error) = live(Path::new(&folder)) {
            println!("FAILED {error}");
        }
        return;
    }
    if !can_trace() {
        println!("left out: there is no strace that may trace");
        return;
    }
    let most: u64 = std::env::var("HOLDPOINT_IO_ERRORS").map_or(6, |text| text.parse().unwrap());
    let (mut done, mut reported) = (0, 0);
    'all: for more in 0.. {
        // At most every call of a run: after a call that is never made, the run ends normally.
        let all = CALLS.iter().flat_map(|call| ERRORS.iter().map(move |error| (*call, *error)));
        let mut open: Vec<(&str, &str, Spell)> =
            all.flat_map(|(call, error)| Spell::ALL.map(|spell| (call, error, spell))).collect();
        for nth in 1.. {
            let mut still_open = Vec::new();
            for (call, error, spell) in open {
                if done >= most {
                    break 'all;
                }
                let folder = quick_folder();
                let store = folder.path().join("store");
                std::fs::create_dir(&store).unwrap();
                let output = run(&store, more, (call, error, &spell.when(nth)));
                let failed = check(&store, &output, &format!("{call} {nth} {error} {spell:?}, {more} more"));
                done += 1;
                reported += u64::from(failed);
                if done % 500 == 0 {
                    println!("{done} failing calls so far, {reported} told by an error");
                }
                // The next sync repairs a failed one behind an acknowledgment, so a normal end tells nothing about
                // later calls; calls run out after some hundred.
                if failed || nth < 60 + 20 * more {
                    still_open.push((call, error, spell));
                }
            }
            open = still_open;
            if open.is_empty() {
                break;
            }
        }
    }
    assert!(reported > 0, "no failure reached the store");
    println!("{done} failing calls, {reported} told by an error, {} without effect", done - reported);
}
