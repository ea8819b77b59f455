//! Creating and rebuilding a store, killed at every durable system call: the result is no store, a whole one, or the
//! damaged one that can be rebuilt again.
//!
//! The kernel's tracer does it, where it is installed (`strace`, and the permission to trace); else the tests report
//! that they did nothing. `HOLDPOINT_KILL_EVERY` thins out the many writes (1 kills at each of them).

use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Stdio};

use holdpoint_registry::{Store, UnsignedRecords, check_invariants, rebuild, verify};
use holdpoint_store::StoreError;
use rusqlite::Connection;

use crate::edits::make_full_store;
use crate::quick_folder::quick_folder;
use crate::support::*;

const CHILD: &str = "HOLDPOINT_KILLED_CHILD";

/// Calls that change or flush a disk; a regular expression, because a call has several names.
const CALLS: [&str; 8] = [
    "/^mkdir(at)?$",
    "/^unlink(at)?$",
    "/^rename(at2?)?$",
    "/^link(at)?$",
    "/^f?truncate$",
    "/^f(data)?sync$",
    "/^p?write(64)?$",
    "/^open(at)?$",
];
/// Calls that there are hundreds of.
const MANY: [&str; 2] = ["/^p?write(64)?$", "/^open(at)?$"];

/// This test again as a child in `folder`, killed at the `nth` call of a kind. Returns whether it was killed.
fn killed(test: &str, folder: &Path, call: &str, nth: usize) -> bool {
    let status = Command::new("strace")
        .args(["-f", "-qq", "-o", "/dev/null", "-e"])
        .arg(format!("trace={call}"))
        .arg("-e")
        .arg(format!("inject={call}:signal=KILL:when={nth}"))
        .arg(std::env::current_exe().unwrap())
        .args([test, "--exact", "--nocapture", "--test-threads=1"])
        .env(CHILD, folder)
        .env("RUST_BACKTRACE", "0")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .unwrap();
    // The tracer ends like its child.
    let by_signal = status.signal() == Some(9);
    assert!(by_signal || status.success(), "{call} {nth}: {status}");
    by_signal
}

/// Whether processes can be traced here.
fn traces() -> bool {
    let tried =
        Command::new("strace").args(["-qq", "-o", "/dev/null", "true"]).stderr(Stdio::null()).status();
    let can = tried.is_ok_and(|status| status.success());
    if !can {
        println!("nothing was killed: strace is not installed, or must not trace");
    }
    can
}

/// Kills the child at call after call of every kind until one ends by itself.
fn at_every_call(test: &str, prepare: impl Fn(&Path), check: impl Fn(&Path, &str)) -> usize {
    let every: usize = std::env::var("HOLDPOINT_KILL_EVERY").map_or(9, |text| text.parse().unwrap());
    let mut kills = 0;
    for call in CALLS {
        let step = if MANY.contains(&call) { every } else { 1 };
        let before = kills;
        for nth in (1..2_000).step_by(step) {
            let folder = quick_folder();
            prepare(folder.path());
            if !killed(test, folder.path(), call, nth) {
                break;
            }
            kills += 1;
            check(folder.path(), &format!("{call} {nth}"));
        }
        println!("{call}: {} kills", kills - before);
    }
    kills
}

fn make(folder: &Path) {
    let store = open(folder);
    bootstrap(&store, "grasp");
}

#[test]
fn killed_creation_leaves_no_store_or_a_complete_one() {
    if let Ok(folder) = std::env::var(CHILD) {
        return make(Path::new(&folder));
    }
    if !traces() {
        return;
    }
    let test = "killed::killed_creation_leaves_no_store_or_a_complete_one";
    let check = |folder: &Path, when: &str| {
        let store = unless_in_use(|| Store::open(folder)).unwrap_or_else(|error| panic!("{when}: {error}"));
        if store.views().unwrap().head().unwrap().seq == 0 {
            bootstrap(&store, "grasp");
        }
        assert_eq!(check_invariants(store.views().unwrap().connection()).unwrap(), [], "{when}");
        let key = *store.public_key();
        drop(store);
        verify(&folder.join("holdpoint.db"), Some(&key)).unwrap_or_else(|error| panic!("{when}: {error}"));
    };
    assert!(at_every_call(test, |_| {}, check) > 40);
}

#[test]
fn killed_rebuild_leaves_the_damaged_or_the_rebuilt_store() {
    const DAMAGE: &str = "UPDATE family SET reason = 'edited' WHERE name = 'grasp'";
    if let Ok(folder) = std::env::var(CHILD) {
        drop(rebuild(Path::new(&folder), UnsignedRecords::Refuse, "{}", 0).unwrap());
        return;
    }
    if !traces() {
        return;
    }
    let whole = quick_folder();
    make_full_store(whole.path());
    Connection::open(whole.path().join("holdpoint.db")).unwrap().execute_batch(DAMAGE).unwrap();
    let prepare = |folder: &Path| copy(whole.path(), folder);
    let test = "killed::killed_rebuild_leaves_the_damaged_or_the_rebuilt_store";
    let check = |folder: &Path, when: &str| {
        match unless_in_use(|| Store::open(folder)).map(drop) {
            Ok(()) => {}
            Err(StoreError::Refused { .. }) => {
                let rebuilt = unless_in_use(|| rebuild(folder, UnsignedRecords::Refuse, "{}", 0));
                assert!(rebuilt.unwrap_or_else(|error| panic!("{when}: {error}")).is_some(), "{when}");
            }
            Err(error) => panic!("{when}: {error}"),
        }
        drop(open(folder));
        verify(&folder.join("holdpoint.db"), None).unwrap_or_else(|error| panic!("{when}: {error}"));
        let damaged_files = fs::read_dir(folder).unwrap().filter(|entry| {
            entry.as_ref().unwrap().file_name().to_string_lossy().starts_with("holdpoint-damaged-")
        });
        assert!(damaged_files.count() > 0, "{when}: the damaged file is gone");
    };
    assert!(at_every_call(test, prepare, check) > 20);
}

/// Copies a folder's files and folders into a folder, which is made if missing.
pub fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let (from, to) = (entry.as_ref().unwrap().path(), to.join(entry.unwrap().file_name()));
        if from.is_dir() {
            copy(&from, &to);
        } else {
            // Permissions come along.
            fs::copy(&from, &to).unwrap();
        }
    }
}
