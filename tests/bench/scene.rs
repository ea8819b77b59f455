//! The cost of scenes: `cargo run --release --example scene_cost`.
//!
//! The live cell runs sequences as fast as it computes; all processor time of the process counts, including the
//! sink's thread and the server's. The variants alternate, so that other load affects all. Prints a table; does not
//! test correctness.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a measurement reports by failing, and prints its results"
)]

use std::net::{SocketAddr, TcpListener};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use holdpoint::engine::{Config, Engine};
use holdpoint::governance::ids::{CapabilityId, Digest};
use holdpoint::governance::lifecycle::Stage;
use holdpoint::governance::profile::ProfileName;
use holdpoint::protocol::event::{Event, EventKind};
use holdpoint::protocol::video_frame::VideoFrame;
use holdpoint::scene::{SceneConfig, SceneSink};
use holdpoint::trials::cache::EpisodeCache;
use holdpoint::trials::cell::Cell;
use holdpoint_sim::SimCells;
use rustix::time::{ClockId, clock_gettime};

/// Turns of each variant.
const ROUNDS: usize = 5;

/// Sequences of one turn: about two minutes of the cell's time.
const SEQUENCES: u64 = 8;

/// A run seed of the calibration pool.
const SEED: u64 = 150;

const TICKS_PER_MS: f64 = 0.24;

#[derive(Clone, Copy, Debug)]
enum SceneOutput {
    Off,
    File,
    Live,
    Both,
}

const SCENE_OUTPUTS: [(SceneOutput, &str); 4] = [
    (SceneOutput::Off, "off"),
    (SceneOutput::File, "file"),
    (SceneOutput::Live, "live server, no viewer"),
    (SceneOutput::Both, "file and live server"),
];

/// The results of one turn.
#[derive(Clone, Copy, Debug, Default)]
struct Turn {
    /// Processor time of the process for each tick, us.
    tick_us: f64,
    /// The longest handover of a camera frame, us.
    longest_us: f64,
    /// Bytes on the disk for a minute of the cell's time.
    bytes_a_minute: f64,
    dropped: u64,
}

fn main() {
    println!("load average: {}", std::fs::read_to_string("/proc/loadavg").unwrap().trim());
    let mut turns: [Vec<Turn>; 4] = std::array::from_fn(|_| Vec::new());
    for _ in 0..ROUNDS {
        for (turns, (output, _)) in turns.iter_mut().zip(SCENE_OUTPUTS) {
            turns.push(turn(output));
        }
    }
    let median = |turns: &[Turn], of: fn(&Turn) -> f64| {
        let mut values: Vec<f64> = turns.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let off = median(&turns[0], |turn| turn.tick_us);
    println!(
        "{:<28} {:>12} {:>9} {:>16} {:>14} {:>8}",
        "sink", "CPU a tick", "to off", "longest hand-over", "MiB a minute", "dropped"
    );
    for (turns, (_, name)) in turns.iter().zip(SCENE_OUTPUTS) {
        let tick_us = median(turns, |turn| turn.tick_us);
        println!(
            "{name:<28} {:>9.2} us {:>8.3}x {:>13.0} us {:>14.2} {:>8}",
            tick_us,
            tick_us / off,
            median(turns, |turn| turn.longest_us),
            median(turns, |turn| turn.bytes_a_minute) / f64::from(1 << 20),
            turns.iter().map(|turn| turn.dropped).sum::<u64>(),
        );
    }
}

fn cpu() -> Duration {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    Duration::new(u64::try_from(now.tv_sec).unwrap(), u32::try_from(now.tv_nsec).unwrap())
}

fn turn(output: SceneOutput) -> Turn {
    let data = tempfile::tempdir().unwrap();
    let mut engine = Engine::start(Config {
        data: data.path(),
        profile: ProfileName::Sim.into(),
        seeds: holdpoint_trials::seeds::EpisodeSeeds::OfRun(SEED),
        jobs: 1,
        scripted: true,
        cell: Cell::of(&SimCells, None).unwrap(),
        cache: EpisodeCache::InStore,
    })
    .unwrap();
    let started = engine.drain_events();
    let folder = data.path().join("recordings");
    let to_file = matches!(output, SceneOutput::File | SceneOutput::Both);
    let view = matches!(output, SceneOutput::Live | SceneOutput::Both).then(free);
    let config = SceneConfig { recordings: to_file.then(|| folder.clone()), view, ..SceneConfig::default() };
    let scenes = (to_file || view.is_some()).then(|| SceneSink::start(config).unwrap());
    if let Some(scenes) = &scenes {
        scenes.feed().events(&started, || engine.snapshot());
        // All drawing belongs to an upgrade in shadow.
        scenes.feed().events(&in_shadow(engine.now_ms()), || engine.snapshot());
    }
    let longest = Arc::new(AtomicU64::new(0));
    let feed = Mutex::new(scenes.as_ref().map(SceneSink::feed));
    let seen = Arc::clone(&longest);
    let on_frame = move |frame: VideoFrame| {
        let begun = Instant::now();
        if let Some(feed) = &*feed.lock().unwrap() {
            feed.video_frame(frame);
        }
        seen.fetch_max(u64::try_from(begun.elapsed().as_nanos()).unwrap(), Ordering::Relaxed);
    };
    engine.pace_live_world(None, Arc::new(on_frame));
    let (from, from_ms) = (cpu(), engine.now_ms());
    let mut sequences = 0;
    let (_nobody, rest) = sync_channel::<()>(0);
    while sequences < SEQUENCES {
        engine.advance();
        let events = engine.drain_events();
        sequences +=
            events.iter().filter(|event| matches!(event.kind, EventKind::Sequence { .. })).count() as u64;
        match &scenes {
            Some(scenes) if !events.is_empty() => scenes.feed().events(&events, || engine.snapshot()),
            // The measured thread is the one that runs the cell, not this one.
            _ => drop(rest.recv_timeout(Duration::from_millis(1))),
        }
    }
    let dropped = scenes.as_ref().map_or(0, |scenes| scenes.feed().dropped().0);
    if let Some(scenes) = scenes {
        drop(scenes.finish(Duration::from_secs(30)));
    }
    let ms = (engine.now_ms() - from_ms) as f64;
    let spent = cpu().saturating_sub(from);
    let bytes: u64 = std::fs::read_dir(&folder)
        .into_iter()
        .flatten()
        .map(|entry| entry.unwrap().metadata().unwrap().len())
        .sum();
    Turn {
        tick_us: spent.as_secs_f64() * 1e6 / (ms * TICKS_PER_MS),
        longest_us: longest.load(Ordering::Relaxed) as f64 / 1e3,
        bytes_a_minute: bytes as f64 / (ms / 60_000.0),
        dropped,
    }
}

fn in_shadow(at_ms: u64) -> Vec<Event> {
    let version: CapabilityId = "grasp@1.1.0".parse().unwrap();
    let registered = EventKind::Registered {
        version: version.clone(),
        digest: Digest::of_parts("measurement", &[b"grasp"]),
        author: "measurement".to_owned(),
        requester: holdpoint_governance::approval::Requester::Script,
        provenance: holdpoint::governance::submission::Provenance::Manual,
        risk: holdpoint::governance::submission::Risk::Low,
        parent: Some("grasp@1.0.0".to_owned()),
        interface_changes: Vec::new(),
        notices: Vec::new(),
    };
    let begins = EventKind::StageStarted { version, stage: Stage::Shadow, budget: SEQUENCES };
    [registered, begins].into_iter().zip(1_000..).map(|(kind, seq)| Event { seq, at_ms, kind }).collect()
}

fn free() -> SocketAddr {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}
