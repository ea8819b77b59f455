//! What a component costs: a tick, compiling, loading what was kept, an instance, memory.
//!
//!     cargo run --release -p holdpoint-component --example component_cost -- COMPONENT.wasm [PARAMETERS.json]
//!
//! Without a path, the component of the tests that was built with an ordinary C library.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a measurement ends where it cannot go on")]

use std::collections::BTreeSet;
use std::hint::black_box;
use std::time::Instant;

use holdpoint_body::{Command, GuardVerdict, Observation, Pose, ReadingVec, TaskKind, Twist};
use holdpoint_component::{Component, ComponentLimits, keep_compiled_in};
use holdpoint_skill::Skill;

/// Ticks that are measured one by one.
const TICKS: u64 = 200_000;

/// Runs that are alive at a time for the memory of one.
const RUNS: usize = 200;

fn seen(tick: u64) -> Observation {
    let value = (tick % 997) as f64 / 997.0;
    let pose = Pose { position: [value, 0.1, 0.2], rotation: [0.0, 0.0, 0.0, 1.0] };
    let estimate = holdpoint_body::Estimate { pose, age_ticks: 4, sequence: 1 };
    Observation {
        tick,
        q: (0..7).map(|_| value).collect(),
        dq: (0..7).map(|_| value).collect(),
        tau: (0..7).map(|_| value).collect(),
        tool: pose,
        tool_twist: Twist::default(),
        gripper_width_m: 0.08,
        gripper_force_n: 0.0,
        wrist_force_n: 0.0,
        objects: TaskKind::Grasp.seen_objects(Some(estimate), Some(estimate)),
        sensors: ReadingVec::new(),
        tool_available: true,
        goal: TaskKind::Grasp,
        guard: GuardVerdict::Allowed,
    }
}

/// The middle one and the one that one in a hundred is above, us.
fn quantiles(mut nanos: Vec<u128>) -> (f64, f64) {
    nanos.sort_unstable();
    let at = |share: usize| nanos[(nanos.len() - 1) * share / 100] as f64 / 1e3;
    (at(50), at(99))
}

fn timed<T>(times: usize, mut work: impl FnMut() -> T) -> (f64, f64) {
    quantiles(
        (0..times)
            .map(|_| {
                let began = Instant::now();
                black_box(work());
                began.elapsed().as_nanos()
            })
            .collect(),
    )
}

/// Memory of this process that is in use, KiB; 0 where the system does not say.
fn resident_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap_or_default();
    line.split_whitespace().next().and_then(|number| number.parse().ok()).unwrap_or(0)
}

fn main() {
    let mut names = std::env::args().skip(1);
    let shipped = include_bytes!("../tests/guests/everything.wasm");
    let bytes = names.next().map_or(shipped.to_vec(), |name| std::fs::read(name).unwrap());
    let parameters = names.next().map_or(serde_json::Value::Null, |name| {
        serde_json::from_str(&std::fs::read_to_string(name).unwrap()).unwrap()
    });
    let imports: BTreeSet<String> = ["cli", "clocks", "filesystem", "io", "random", "sockets", "http"]
        .map(|package| format!("wasi:{package}"))
        .into();
    let limits = ComponentLimits { fuel_per_tick: 4_000_000, memory_bytes: 64 << 20 };
    let load = || Component::load(&bytes, &parameters, limits, &imports).unwrap();

    let (p50, p99) = timed(5, load);
    println!("{} bytes", bytes.len());
    println!("compile and describe     p50 {:9.3} ms   p99 {:9.3} ms", p50 / 1e3, p99 / 1e3);
    let folder = tempfile::tempdir().unwrap();
    keep_compiled_in(folder.path().to_owned(), [7; 32]);
    drop(load());
    let cached: u64 =
        folder.path().read_dir().unwrap().map(|file| file.unwrap().metadata().unwrap().len()).sum();
    let (p50, p99) = timed(50, load);
    println!(
        "load kept and describe   p50 {:9.3} ms   p99 {:9.3} ms   {cached} bytes kept",
        p50 / 1e3,
        p99 / 1e3
    );
    let component = load();
    println!("origin {:?}, imports {:?}", component.origin(), component.imports());
    let (p50, p99) = timed(500, load);
    println!("load again and describe  p50 {p50:9.3} us   p99 {p99:9.3} us");
    let (p50, p99) = timed(2_000, || component.start(1));
    println!("instantiate and start    p50 {p50:9.3} us   p99 {p99:9.3} us");

    let mut run = component.run(1);
    let mut nanos = Vec::new();
    let mut moved = 0_u64;
    for tick in 0..TICKS {
        let seen = seen(tick);
        let began = Instant::now();
        let command = black_box(run.tick(black_box(&seen)));
        nanos.push(began.elapsed().as_nanos());
        moved += u64::from(command != Command::Hold);
    }
    let (p50, p99) = quantiles(nanos);
    println!("tick                     p50 {p50:9.3} us   p99 {p99:9.3} us   {moved} of {TICKS} not holding");
    println!("{:?}", run.confined());
    let began = Instant::now();
    for tick in 0..TICKS {
        black_box(run.tick(&seen(tick)));
    }
    println!("tick in a row            mean {:8.3} us", began.elapsed().as_secs_f64() * 1e6 / TICKS as f64);

    let before = resident_kib();
    let mut runs: Vec<Box<dyn Skill>> = (0..RUNS as u64).map(|seed| component.start(seed)).collect();
    for run in &mut runs {
        run.tick(&seen(0));
    }
    println!(
        "memory of a live run     {:.1} KiB",
        resident_kib().saturating_sub(before) as f64 / RUNS as f64
    );
}
