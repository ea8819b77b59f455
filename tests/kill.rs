//! kill -9 at a random moment of `promote-benign`: the next start recovers and every invariant holds.
//!
//! Five kills by default; `HOLDPOINT_KILLS` sets another number.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test says so by failing")]

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use holdpoint::engine::cell::Cell;
use holdpoint::engine::pipeline::Progress;
use holdpoint::engine::trial::cache::EpisodeCache;
use holdpoint::engine::{Config, Engine};
use holdpoint::governance::profile::ProfileName;
use holdpoint::registry::{KeptCells, KeptSecret, check_invariants};

/// SplitMix64, so that a failing run can be repeated with its seed.
fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Starts the scenario and kills it after `after`; tells whether it was still running.
fn killed(data: &Path, cache: &Path, after: Duration) -> bool {
    let mut child = Command::new(env!("CARGO_BIN_EXE_holdpoint"))
        .args(["run", "--headless", "--script", "tests/scenarios/promote-benign.toml", "--seed", "5"])
        .arg("--cache")
        .arg(cache.join("cells"))
        .arg("--cache-key")
        .arg(cache.join("cells.key"))
        .arg("--data")
        .arg(data)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let start = Instant::now();
    while start.elapsed() < after {
        if child.try_wait().unwrap().is_some() {
            return false;
        }
        std::thread::yield_now();
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

#[test]
fn the_next_start_recovers_from_a_kill_at_any_moment() {
    let kills: u64 = std::env::var("HOLDPOINT_KILLS").map_or(5, |text| text.parse().unwrap());
    let seed = std::env::var("HOLDPOINT_KILL_SEED").map_or(20_261_121, |text| text.parse().unwrap());
    let mut state = seed;
    let cache = tempfile::tempdir().unwrap();
    let cells = cache.path().join("cells");
    let secret = KeptSecret::beside(&cache.path().join("cells.key"), &cells).unwrap();
    let mut landed = 0;
    for round in 0..kills {
        let data = tempfile::tempdir().unwrap();
        // Early moments are tried as often as late ones: the span is drawn first.
        let span_ms = [200, 1_000, 4_000, 12_000][usize::try_from(random(&mut state) % 4).unwrap()];
        let after = Duration::from_millis(20 + random(&mut state) % span_ms);
        landed += u64::from(killed(data.path(), cache.path(), after));
        if !data.path().join("holdpoint.db").exists() {
            continue;
        }
        let mut engine = Engine::start(Config {
            data: data.path(),
            profile: ProfileName::Sim.into(),
            seed: 5,
            jobs: 2,
            scripted: true,
            cell: Cell::builtin().unwrap(),
            cache: EpisodeCache::Shared(KeptCells::in_folder(cells.clone(), secret.clone())),
        })
        .unwrap_or_else(|error| panic!("round {round}, seed {seed}, after {after:?}: {error}"));
        for _ in 0..3 {
            if engine.advance() == (Progress::Idle { next_ms: None }) {
                break;
            }
        }
        assert_eq!(engine.holding(), None, "round {round}, seed {seed}, after {after:?}");
        let snapshot = engine.snapshot();
        for family in &snapshot.families {
            assert!(
                family.active.is_some() != family.safe_stopped,
                "round {round}, seed {seed}, after {after:?}: {family:?}"
            );
        }
        drop(engine);
        let found = violations(data.path());
        assert!(found.is_empty(), "round {round}, seed {seed}, after {after:?}: {found:?}");
        let verify = Command::new(env!("CARGO_BIN_EXE_holdpoint"))
            .args(["audit", "verify", "--data"])
            .arg(data.path())
            .output()
            .unwrap();
        assert!(
            verify.status.success(),
            "round {round}, seed {seed}: {}",
            String::from_utf8_lossy(&verify.stdout)
        );
    }
    assert!(landed * 2 >= kills, "only {landed} of {kills} kills hit a running engine");
}
