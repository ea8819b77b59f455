//! Kills `promote-benign` with SIGKILL at random moments: the next start recovers and every invariant holds. Also
//! cuts the power at any moment, simulated from one record of the run's disk writes.
//!
//! `HOLDPOINT_KILLS` is the number of kills (5), `HOLDPOINT_POWER_CUTS` of power cuts (8),
//! `HOLDPOINT_REPLAYED_KILLS` of ends of the recorded run without loss (4); `HOLDPOINT_KILL_SEED` is the seed.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test says so by failing")]
#![allow(clippy::print_stdout, reason = "a campaign prints its progress")]

#[path = "support/disk.rs"]
mod disk;
#[allow(dead_code, reason = "its random numbers are used here, not its mutants")]
#[path = "fuzz/mutate.rs"]
mod mutate;
#[path = "support/quick_folder.rs"]
mod quick_folder;

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use holdpoint::engine::decide::pipeline::SliceOutcome;
use holdpoint::engine::{Config, Engine};
use holdpoint::governance::profile::ProfileName;
use holdpoint::registry::check_invariants;
use holdpoint::store::{CacheSecret, ResultCache};
use holdpoint::trials::cache::EpisodeCache;
use holdpoint::trials::cell::Cell;
use holdpoint_sim::SimCells;
use tempfile::TempDir;

use disk::{Loss, Trace};
use mutate::Random;
use quick_folder::quick_folder;

fn number(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).map_or(otherwise, |text| text.parse().unwrap())
}

/// The scenario with JSON output.
fn scenario(data: &Path, cache: &Path) -> Command {
    let mut program = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    program
        .args(["run", "--headless", "--json", "--seed", "5"])
        .args(["--script", "tests/scenarios/promote-benign.toml"])
        .arg("--cache")
        .arg(cache.join("cells"))
        .arg("--cache-key")
        .arg(cache.join("cells.key"))
        .arg("--data")
        .arg(data);
    program
}

/// Starts the scenario and kills it after `after`; tells whether it was still running.
fn killed(data: &Path, cache: &Path, after: Duration) -> bool {
    let mut child = scenario(data, cache).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let start = Instant::now();
    while start.elapsed() < after {
        if child.try_wait().unwrap().is_some() {
            return false;
        }
        std::thread::park_timeout(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    true
}

fn violations(data: &Path) -> Vec<String> {
    let connection = rusqlite::Connection::open(data.join("holdpoint.db")).unwrap();
    check_invariants(&connection).unwrap().iter().map(ToString::to_string).collect()
}

/// The cached results that all runs share.
struct Cache {
    folder: TempDir,
    secret: CacheSecret,
}

impl Cache {
    fn new() -> Self {
        let folder = quick_folder();
        let secret =
            CacheSecret::of_file_outside(&folder.path().join("cells.key"), &folder.path().join("cells"))
                .unwrap();
        Self { folder, secret }
    }

    fn cells(&self) -> ResultCache {
        ResultCache::in_folder(self.folder.path().join("cells"), self.secret.clone())
    }
}

/// The next engine runs on the remaining store, no change is half done, and the record is sound.
fn recovers(data: &Path, cache: &Cache, when: &str) {
    let mut engine = Engine::start(Config {
        data,
        profile: ProfileName::Sim.into(),
        seeds: holdpoint_trials::seeds::EpisodeSeeds::OfRun(5),
        jobs: 2,
        scripted: true,
        cell: Cell::of(&SimCells, None).unwrap(),
        cache: EpisodeCache::Shared(cache.cells()),
    })
    .unwrap_or_else(|error| panic!("{when}: {error}"));
    for _ in 0..3 {
        if engine.advance() == (SliceOutcome::Idle { next_ms: None }) {
            break;
        }
    }
    assert_eq!(engine.holding(), None, "{when}");
    for family in &engine.snapshot().families {
        assert!(family.active.is_some() != family.safe_stopped, "{when}: {family:?}");
    }
    drop(engine);
    let found = violations(data);
    assert!(found.is_empty(), "{when}: {found:?}");
    let verify = Command::new(env!("CARGO_BIN_EXE_holdpoint"))
        .args(["audit", "verify", "--data"])
        .arg(data)
        .output()
        .unwrap();
    assert!(verify.status.success(), "{when}: {}", String::from_utf8_lossy(&verify.stdout));
}

#[test]
fn the_next_start_recovers_from_a_kill_at_any_time() {
    let kills = number("HOLDPOINT_KILLS", 5);
    let seed = number("HOLDPOINT_KILL_SEED", 20_261_121);
    let cache = Cache::new();
    let mut landed = 0;
    for round in 0..kills {
        let mut random = Random::of_run(seed, round);
        let data = quick_folder();
        // The span is sampled first, so early moments are tried as often as late ones.
        let span_ms: usize = *random.of(&[200, 1_000, 4_000, 12_000]);
        let after = Duration::from_millis(20 + random.below(span_ms) as u64);
        landed += u64::from(killed(data.path(), cache.folder.path(), after));
        if data.path().join("holdpoint.db").exists() {
            recovers(data.path(), &cache, &format!("round {round}, seed {seed}, after {after:?}"));
        }
    }
    println!("kills of the program: seed {seed}, {kills} kills, {landed} of them while it ran");
    assert!(landed * 2 >= kills, "only {landed} of {kills} kills hit a running engine");
}

/// The number of state changes in the store.
fn changes_of_state(data: &Path) -> u64 {
    let connection = rusqlite::Connection::open(data.join("holdpoint.db")).unwrap();
    let sql = "SELECT count(*) FROM audit WHERE kind = 'state-set'";
    connection.query_row(sql, [], |row| row.get(0)).unwrap()
}

#[test]
fn the_next_start_recovers_from_a_power_cut_at_any_time() {
    let seed = number("HOLDPOINT_KILL_SEED", 20_261_121);
    let cache = Cache::new();
    let data = quick_folder();
    // A change is printed only after it is stored.
    let mut changes = 0;
    let acknowledge = |text: &str| {
        let lines = text.matches("\"event\":\"state-changed\"").count() as u64;
        changes += lines;
        (lines > 0).then_some(changes)
    };
    let Some(trace) =
        Trace::record(data.path(), &mut scenario(data.path(), cache.folder.path()), acknowledge)
    else {
        return;
    };
    for (loss, cases) in [
        (Loss::Unforced, number("HOLDPOINT_POWER_CUTS", 8)),
        (Loss::Nothing, number("HOLDPOINT_REPLAYED_KILLS", 4)),
    ] {
        for case in 0..cases {
            let mut random = Random::of_run(seed, case);
            let cut = random.below(trace.cut_count());
            let data = quick_folder();
            trace.play(cut, loss, &mut random, data.path());
            let when = format!("{loss:?} lost, seed {seed}, case {case}, moment {cut}");
            recovers(data.path(), &cache, &when);
            let (acknowledged, stored) = (trace.acknowledged(cut), changes_of_state(data.path()));
            assert!(
                stored >= acknowledged,
                "{when}: {acknowledged} changes of state were printed, {stored} are kept"
            );
        }
        println!(
            "power cuts of the program: seed {seed}, {cases} of {} moments, {loss:?} lost",
            trace.cut_count()
        );
    }
}
