//! The cost of the console: `cargo build --release && cargo run --release --example console_cost`.
//!
//! Measures against the budget of the design: a frame at 200x60 with 10,000 versions, the first frame after the
//! start, key to repaint while the evaluation uses every core, and the processor time of an idle console. Each runs
//! alternately with the engine in a separate process and in the console's; then the cost of one more console for an
//! engine. Prints a table with budgets, verdicts and the load of the machine, which makes times longer. Does not
//! test correctness. `HOLDPOINT_COST_LINES=2` types fewer lines.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a measurement reports by failing, and prints its results"
)]

#[path = "../support/pty.rs"]
#[allow(dead_code, reason = "the tests use the rest")]
mod pty;

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Stdio};
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use holdpoint::console::frame;
use holdpoint::console::keymap::Keymap;
use holdpoint::console::look::{Look, LookOptions};
use holdpoint::console::model::{ConsoleModel, ConsoleSettings, View};
use holdpoint::governance::lifecycle::{State, VersionFlags};
use holdpoint::governance::record::VersionSummary;
use holdpoint::governance::submission::{Provenance, Risk};
use holdpoint::protocol::detail::RegistryPage;
use pty::{Console, Home};
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;

/// Versions in the registry.
const ROWS: u64 = 10_000;

/// Frames that are built.
const FRAMES: usize = 300;

/// Starts that are timed.
const STARTS: usize = 10;

/// Keys that are timed: lines, and letters in each.
const LINES: usize = 8;
const LETTERS: usize = 40;

/// Consoles that are attached beside the first one.
const MORE: usize = 4;

/// Programs that read the engine's stream beside one console.
const LISTENERS: usize = 64;

/// Budgets of the design: ms at p99, and per cent of a core.
const FRAME_MS: f64 = 2.0;
const FIRST_FRAME_MS: f64 = 150.0;
const KEY_MS: f64 = 20.0;
const IDLE_PERCENT: f64 = 3.0;

/// The idle time.
const IDLE: Duration = Duration::from_secs(20);

/// The kernel counts processor time in hundredths of a second.
const TICKS_PER_SEC: f64 = 100.0;

const SIZE: (u16, u16) = (200, 60);

/// The place of the engine, and the option for it.
const PLACES: [(&str, &[&str]); 2] = [("attached", &["--linger=5"]), ("in process", &["--in-process"])];

fn main() {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    println!("{cores} cores; load: processes that ran or waited to, mean of the last minute");
    line("what", ["median", "p99", "budget", "", "load"]);
    row("frame at 200x60, 10,000 versions", frames(), Some(FRAME_MS));
    // Alternating, so that other load affects both.
    let mut starts = PLACES.map(|_| (Vec::new(), Vec::new()));
    for _ in 0..STARTS {
        for ((_, more), (frames, shown)) in PLACES.iter().zip(&mut starts) {
            let (frame, show) = first_frame(more);
            frames.push(frame);
            shown.push(show);
        }
    }
    for ((place, _), (frames, shown)) in PLACES.iter().zip(starts) {
        row(&format!("first frame after the start, {place}"), frames, Some(FIRST_FRAME_MS));
        row(&format!("engine on the screen after the start, {place}"), shown, None);
    }
    for (place, more) in PLACES {
        row(&format!("key to repaint, every core busy, {place}"), keys(more), Some(KEY_MS));
    }
    for (place, more) in PLACES {
        idle(place, more);
    }
    attached();
    listened_to();
}

fn line(what: &str, [median, p99, budget, kept, load]: [&str; 5]) {
    println!("{what:<50} {median:>10} {p99:>10} {budget:>14} {kept:<6} {load:>6}");
}

/// Load of the machine: the mean of the last minute.
fn load() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap();
    text.split(' ').next().unwrap_or_default().to_owned()
}

const fn verdict(within: bool) -> &'static str {
    if within { "kept" } else { "OVER" }
}

/// A row of times; the budget applies to the 99th percentile.
fn row(what: &str, mut times: Vec<Duration>, budget_ms: Option<f64>) {
    times.sort();
    let at = |share: f64| {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
        let index = ((times.len() - 1) as f64 * share).round() as usize;
        times[index].as_secs_f64() * 1e3
    };
    let ms = |value: f64| format!("{value:.2} ms");
    let budget = budget_ms.map_or_else(String::new, |budget| format!("{budget:.0} ms at p99"));
    let result = budget_ms.map_or("", |budget| verdict(at(0.99) <= budget));
    line(&format!("{what} (n {})", times.len()), [&ms(at(0.5)), &ms(at(0.99)), &budget, result, &load()]);
}

/// A row of a fraction of one core.
fn share_row(what: &str, percent: f64, budget_percent: Option<f64>) {
    let budget = budget_percent.map_or_else(String::new, |budget| format!("{budget:.0} %"));
    let result = budget_percent.map_or("", |budget| verdict(percent <= budget));
    line(what, [&format!("{percent:.2} %"), "", &budget, result, &load()]);
}

fn frames() -> Vec<Duration> {
    let settings =
        ConsoleSettings { read_only: false, mouse: false, tour: None, theme: "calm-dark".to_owned() };
    let mut model = ConsoleModel::new(settings, Arc::new(Keymap::default()), Vec::new());
    let version = |number: u64| VersionSummary {
        version: format!("family{}@1.0.{number}", number % 50).parse().unwrap(),
        state: State::Superseded,
        row_version: 1,
        flags: VersionFlags::default(),
        kappas: [Some(0.97), Some(0.95), Some(0.9), None],
        baseline: false,
        author: "refinery".to_owned(),
        provenance: Provenance::Optimiser,
        risk: Risk::Low,
        changed_ms: number,
        changed_at: None,
        unreviewed: false,
    };
    let mut rows: Vec<VersionSummary> = (0..ROWS).map(version).collect();
    rows.sort_by(|a, b| a.version.cmp(&b.version));
    let thresholds = [0.95, 0.9, 0.85, 0.8];
    let page = RegistryPage { rows, total: ROWS, thresholds, anchors: Vec::new() };
    model.engine_data.registry.take(page);
    model.view_state.view = View::Registry;
    model.size = SIZE;
    let options = LookOptions {
        term: Some("xterm-256color".to_owned()),
        colorterm: Some("truecolor".to_owned()),
        ..LookOptions::default()
    };
    let look = Look::detect(&options).unwrap();
    let area = Rect::new(0, 0, SIZE.0, SIZE.1);
    let frame = |_| {
        let mut buffer = Buffer::empty(area);
        let begun = Instant::now();
        frame::draw(&model, &look, area, &mut buffer);
        begun.elapsed()
    };
    (0..FRAMES).map(frame).collect()
}

/// The time until the first frame, and until the engine is on it.
fn first_frame(more: &[&str]) -> (Duration, Duration) {
    let home = Home::new();
    let begun = Instant::now();
    let mut console = home.console(&[&["run", "--no-tour"], more].concat(), SIZE);
    let ends = |raw: &[u8]| raw.windows(8).any(|bytes| bytes == b"\x1b[?2026l");
    console.wait_for_bytes("the first frame", ends);
    let frame = begun.elapsed();
    console.wait_for_text("SIM");
    let shown = begun.elapsed();
    end(&mut console);
    (frame, shown)
}

/// Ends console and engine.
fn end(console: &mut Console) {
    console.keys("1q");
    console.wait_for_text(" y does it");
    // The key counts once the screen shows it.
    console.keys("y");
    console.end();
}

/// A console whose engine evaluates a candidate.
fn at_work(home: &Home, more: &[&str]) -> Console {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let jobs = format!("--jobs={cores}");
    let mut console = home.console(&[&["run", "--no-tour", &jobs], more].concat(), SIZE);
    console.wait_for_text("SIM");
    console.keys(":demo\r");
    console.wait_for_text("sandbox");
    console
}

fn keys(more: &[&str]) -> Vec<Duration> {
    let home = Home::new();
    let mut console = at_work(&home, more);
    let requested = std::env::var("HOLDPOINT_COST_LINES").ok().and_then(|text| text.parse().ok());
    let lines = requested.unwrap_or(LINES);
    let mut times = Vec::with_capacity(lines * LETTERS);
    for _ in 0..lines {
        console.keys(":");
        for count in 1..=LETTERS {
            let typed = "w".repeat(count);
            let begun = Instant::now();
            console.keys("w");
            console.wait_for_text(&typed);
            times.push(begun.elapsed());
        }
        console.keys("\x1b");
        console.wait_for("the line is closed", |screen| !screen.contents().contains("www"));
    }
    end(&mut console);
    times
}

fn idle(place: &str, more: &[&str]) {
    let home = Home::new();
    let mut console = home.console(&[&["run", "--no-tour"], more].concat(), SIZE);
    console.wait_for_text("SIM");
    let id = console.id();
    let engine = engine_of(&home);
    let mut files = vec![format!("/proc/{id}/task/{id}/stat"), format!("/proc/{id}/stat")];
    if engine != id {
        files.push(format!("/proc/{engine}/stat"));
    }
    for (key, what) in [("1", "the arm moves on the screen"), ("5", "alarms, nothing moves")] {
        console.keys(key);
        let shares = shares(&files);
        println!("{what}, {place}, cell at 1x:");
        share_row("  console's thread", shares[0], None);
        // In its own process the engine is not part of the console.
        let budget = (shares.len() > 2).then_some(IDLE_PERCENT);
        share_row("  console's process", shares[1], budget);
        if let Some(engine) = shares.get(2) {
            share_row("  engine's process", *engine, None);
            share_row("  both processes", shares[1] + engine, None);
        }
    }
    end(&mut console);
}

/// The fractions of one core that processes or threads use while idle, per cent.
fn shares(files: &[String]) -> Vec<f64> {
    // No input: the time passes.
    let (_kept, never) = sync_channel::<()>(1);
    never.recv_timeout(Duration::from_secs(3)).ok();
    let before: Vec<u64> = files.iter().map(|file| ticks(file)).collect();
    never.recv_timeout(IDLE).ok();
    let share = |(file, before): (&String, u64)| {
        (ticks(file) - before) as f64 / TICKS_PER_SEC / IDLE.as_secs_f64() * 100.0
    };
    files.iter().zip(before).map(share).collect()
}

/// The process that holds the store.
fn engine_of(home: &Home) -> u32 {
    let owner = std::fs::read_to_string(home.data().join("engine.lock")).unwrap();
    owner.split(' ').nth(1).unwrap().parse().unwrap()
}

/// The cost of consoles that show the arm, for their engine: this number of them, compared with one.
fn attached() {
    let home = Home::new();
    let mut first = home.console(&["run", "--no-tour", "--linger=5"], SIZE);
    first.wait_for_text("SIM");
    let engine = [format!("/proc/{}/stat", engine_of(&home))];
    let alone = shares(&engine)[0];
    let others: Vec<Console> = (0..MORE)
        .map(|_| {
            let console = home.console(&["run", "--no-tour", "--read-only"], SIZE);
            console.wait_for_text("SIM");
            console
        })
        .collect();
    let together = shares(&engine)[0];
    println!("consoles at one engine, the arm moves on each, cell at 1x:");
    share_row("  engine's process, one console", alone, None);
    share_row(&format!("  engine's process, {} consoles", MORE + 1), together, None);
    share_row("  engine's process, each console more", (together - alone) / MORE as f64, None);
    for mut console in others {
        console.keys("q");
        console.end();
    }
    // While it shows another console it leaves the engine running, and asks for nothing.
    first.wait_for("no other console", |screen| {
        screen.rows(0, SIZE.0).nth(1).is_some_and(|line| !line.contains("with ") && !line.contains(" more"))
    });
    end(&mut first);
}

/// The cost of programs that read the engine's stream, for their engine.
fn listened_to() {
    let home = Home::new();
    let mut console = home.console(&["run", "--no-tour", "--linger=5"], SIZE);
    console.wait_for_text("SIM");
    let engine = [format!("/proc/{}/stat", engine_of(&home))];
    let alone = shares(&engine)[0];
    let listeners: Vec<Listener> = (0..LISTENERS).map(|_| Listener::new(&home)).collect();
    let together = shares(&engine)[0];
    println!("programs that read the engine's stream (`status --watch --json`), cell at 1x:");
    share_row("  engine's process, no such program", alone, None);
    share_row(&format!("  engine's process, {LISTENERS} of them"), together, None);
    drop(listeners);
    end(&mut console);
}

/// A program that reads the stream, from its first line on.
struct Listener(Child);

impl Listener {
    fn new(home: &Home) -> Self {
        let mut child = home
            .command(&["status", "--watch", "--json"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap());
        lines.read_line(&mut String::new()).unwrap();
        std::thread::spawn(move || std::io::copy(&mut lines, &mut std::io::sink()));
        Self(child)
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

/// User and system time of a process or thread.
fn ticks(file: &str) -> u64 {
    let text = std::fs::read_to_string(file).unwrap();
    let (_, fields) = text.rsplit_once(')').unwrap();
    fields.split_whitespace().skip(11).take(2).map(|field| field.parse::<u64>().unwrap()).sum()
}
