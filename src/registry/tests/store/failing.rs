//! A disk that fails: one call of the system that writes, makes room, syncs, renames or removes is refused, at every
//! place in turn. The error is said, nothing acknowledged is lost, no store is bricked.
//!
//! The calls are refused by strace (`--inject`), outside the program: SQLite's own calls are met like ours. Where there
//! is no strace, or the system forbids tracing, this is left out and said. `HOLDPOINT_IO_ERRORS` is how many (6).

use std::path::Path;
use std::process::{Command, Stdio};

use holdpoint_registry::{Batch, Store, check_invariants, verify};

use crate::support::*;

const CHILD: &str = "HOLDPOINT_FAILING_CHILD";
const TEST: &str = "failing::a_disk_that_fails_at_any_call_loses_nothing";

/// What is refused, and with which error.
const CALLS: [&str; 6] = ["write", "pwrite64", "fsync", "fdatasync", "ftruncate", "rename"];
const ERRORS: [&str; 2] = ["EIO", "ENOSPC"];

/// A short life of a store, from its making to an activation and its rollback, with telemetry; says `ACK <seq>` after
/// each commit and `FAILED` with the error at the first.
fn live(folder: &Path) -> Result<(), holdpoint_registry::StoreError> {
    let store = Store::open(folder)?;
    let version = id("grasp@1.0.0");
    let acked = |command: &str, changes| {
        let receipt = commit(&store, command, changes)?;
        println!("ACK {}", receipt.last_seq);
        Ok::<_, holdpoint_registry::StoreError>(())
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
    println!("DONE");
    Ok(())
}

/// Runs [`live`] in `folder`, with the `nth` of these calls refused if one is given; what it printed.
fn run(folder: &Path, refused: Option<(&str, &str, u64)>) -> String {
    let program = std::env::current_exe().unwrap();
    let mut command = match refused {
        None => Command::new(program),
        Some((call, error, nth)) => {
            let mut strace = Command::new("strace");
            strace.args(["-f", "-qq", "-o", "/dev/null", "-P"]).arg(folder);
            for file in ["holdpoint.db", "holdpoint.new", "telemetry.db", "telemetry.new"] {
                for ending in ["", "-wal", "-journal"] {
                    strace.arg("-P").arg(folder.join(format!("{file}{ending}")));
                }
            }
            for file in ["checkpoints", "keys/store.key", "keys/store.pub", "keys/cells.key"] {
                strace.arg("-P").arg(folder.join(file));
            }
            strace.args([
                "-e",
                &format!("trace={call}"),
                "-e",
                &format!("inject={call}:error={error}:when={nth}"),
            ]);
            strace.arg(program);
            strace
        }
    };
    command.args([TEST, "--exact", "--nocapture", "--test-threads=1"]).env(CHILD, folder);
    let output = command.stdout(Stdio::piped()).stderr(Stdio::piped()).output().unwrap();
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

fn can_trace() -> bool {
    let traced = Command::new("strace").args(["-o", "/dev/null", "true"]).stderr(Stdio::null()).status();
    traced.is_ok_and(|status| status.success())
}

/// After the failure: what was acknowledged is there, everything holds, and the next engine works in it.
fn check(folder: &Path, said: &str, when: &str) -> bool {
    let acked = said.lines().filter_map(|line| line.split("ACK ").nth(1)?.trim().parse::<u64>().ok());
    let acked = acked.max().unwrap_or(0);
    assert!(!said.contains("panicked"), "{when}: {said}");
    let failed = said.contains("FAILED");
    assert!(failed || said.contains("DONE"), "{when}: neither an error nor an end: {said}");
    let store = Store::open(folder).unwrap_or_else(|error| panic!("{when}: bricked: {error}"));
    let views = store.views().unwrap();
    assert!(views.head().unwrap().seq >= acked, "{when}: {acked} was acknowledged: {said}");
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
fn a_disk_that_fails_at_any_call_loses_nothing() {
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
    let (mut done, mut told) = (0, 0);
    // Every call of one life at most: a call that is never made lets it end in peace.
    let mut open: Vec<(&str, &str)> =
        CALLS.iter().flat_map(|call| ERRORS.iter().map(move |error| (*call, *error))).collect();
    let mut nth = 0;
    while done < most && !open.is_empty() {
        nth += 1;
        open.retain(|(call, error)| {
            if done >= most {
                return false;
            }
            let folder = tempfile::tempdir().unwrap();
            let store = folder.path().join("store");
            std::fs::create_dir(&store).unwrap();
            let said = run(&store, Some((call, error, nth)));
            let failed = check(&store, &said, &format!("{call} {nth} {error}"));
            done += 1;
            told += u64::from(failed);
            // A sync or write that fails behind an acknowledgement is put right by the next one, so an end in peace
            // says nothing of what comes later; calls run out after some hundred.
            failed || nth < 60
        });
    }
    assert!(told > 0, "no failure reached the store");
    println!("{done} failing calls, {told} told by an error, {} without effect", done - told);
}
