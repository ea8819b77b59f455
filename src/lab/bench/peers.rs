//! Times the grasp-and-place episode on this cell and, beside it in the same rounds, on other physics engines.
//!
//! Owns the rounds and their report. The peers are separate programs (scripts for `PyBullet` and `MuJoCo`, and `MuJoCo`
//! in C): each prints one JSON line, of which this file uses the rates alone. A missing peer is named with the reason
//! and left out; an earlier figure never replaces it.

use std::borrow::Cow;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use holdpoint_sim::Fidelity;
use holdpoint_sim::bench_episode::PeerBench;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use serde::{Deserialize, Serialize};

use crate::wording::answers;
use holdpoint::bench::{BenchError, FigureClock, median};

/// The default number of rounds.
pub const ROUNDS: u32 = 5;

/// The most rounds.
pub const ROUNDS_MAX: u32 = 100;

/// The longest a peer may take for one round.
const PEER_MAX: Duration = Duration::from_mins(15);

/// How often a running peer is checked.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// The most of a peer's output that is read, bytes.
const OUTPUT_MAX: u64 = 1 << 20;

/// Lowest rate of episodes that must be lifted and placed: a fast engine that drops the cube is not compared.
const SUCCESS_MIN: f64 = 0.99;

/// Where the peers are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PeerSettings {
    /// The interpreter whose packages hold the peers.
    pub python: PathBuf,
    /// The folder of the scripts and their `models`.
    pub scripts: PathBuf,
    /// The program that runs the episode in `MuJoCo` from C; absent to leave it out.
    pub native: Option<PathBuf>,
    pub rounds: u32,
    /// Episodes of a round in this cell; each peer's own number fits its speed.
    pub episodes: u64,
}

/// The engine that runs the episode.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum PeerEngine {
    Holdpoint(CellMode),
    PyBullet,
    MujocoPython,
    /// With the accurate model.
    MujocoNative,
    /// With the model of `MuJoCo`'s cheapest contact settings.
    MujocoNativeFast,
}

/// This cell's modes in the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CellMode {
    Full,
    Adaptive,
    Reduced,
}

impl CellMode {
    const fn fidelity(self) -> Fidelity {
        match self {
            Self::Full => Fidelity::Full,
            Self::Adaptive => Fidelity::Adaptive,
            Self::Reduced => Fidelity::Reduced,
        }
    }
}

impl PeerEngine {
    /// The engines of a round, in turn.
    const ALL: [Self; 7] = [
        Self::Holdpoint(CellMode::Reduced),
        Self::MujocoNative,
        Self::PyBullet,
        Self::Holdpoint(CellMode::Adaptive),
        Self::Holdpoint(CellMode::Full),
        Self::MujocoNativeFast,
        Self::MujocoPython,
    ];

    /// The peer's program; absent for this cell, and for a native program that was not named.
    fn command(&self, settings: &PeerSettings) -> Option<Command> {
        let script = |name: &str, episodes: &str| {
            let mut command = Command::new(&settings.python);
            command.args([name, "--episodes", episodes]);
            command
        };
        let native = |model: &str| {
            let mut command = Command::new(settings.native.as_ref()?);
            // Episodes, threads, inverse kinematics in every tick.
            command.args([model, "160", "1", "1"]);
            Some(command)
        };
        match self {
            Self::Holdpoint(_) => None,
            Self::PyBullet => Some(script("pybullet_grasp.py", "16")),
            Self::MujocoPython => Some(script("mujoco_grasp.py", "40")),
            Self::MujocoNative => native("models/panda_prim.xml"),
            Self::MujocoNativeFast => native("models/panda_prim_fast.xml"),
        }
    }
}

/// The part of a peer's output that is used.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PeerRates {
    /// Episodes of the round.
    pub episodes: u64,
    /// Rate of episodes in which the cube was raised by 10 cm.
    pub lift_rate: f64,
    /// Rate of episodes in which it ended within 2 cm of the target.
    pub place_rate: f64,
    /// Episodes in a second of one thread's processor time.
    pub episodes_per_cpu_s: f64,
}

/// One engine over all rounds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PeerRow {
    pub engine: PeerEngine,
    /// Episodes of each round.
    pub episodes: u64,
    /// Rates of the rounds, in their order, episodes per CPU-s.
    pub rates: Vec<f64>,
    pub median: f64,
    /// Rate of all rounds' episodes in which the cube was raised by 10 cm.
    pub lift_rate: f64,
    /// Rate of all rounds' episodes in which the cube was placed.
    pub place_rate: f64,
    /// Median of the rounds' ratios to `PyBullet`; absent without it.
    pub to_pybullet: Option<f64>,
    /// Median of the rounds' ratios to `MuJoCo` in C with its accurate model; absent without it.
    pub to_mujoco_native: Option<f64>,
}

/// The result of one comparison.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PeerReport {
    pub rounds: u32,
    /// This cell's number format; the peers compute in f64.
    pub physics: &'static str,
    pub rows: Vec<PeerRow>,
    /// Engines that could not take part, and why.
    pub absent: Vec<(PeerEngine, String)>,
}

/// Why there is no comparison.
#[derive(Debug, thiserror::Error)]
pub enum PeerError {
    /// This cell's own episodes could not run.
    #[error(transparent)]
    Own(#[from] BenchError),
    /// A given folder or program does not exist.
    #[error("{0:?} does not exist")]
    Missing(PathBuf),
    /// No peer could be run.
    #[error("none of the peers could be run: {0}")]
    Alone(String),
    /// An engine lost the cube too often for its speed to mean anything.
    #[error(
        "{} lifted {lift_rate:.3} and placed {place_rate:.3} of its episodes; at least {SUCCESS_MIN} are needed",
        answers::peer_engine(engine)
    )]
    Lost { engine: PeerEngine, lift_rate: f64, place_rate: f64 },
}

impl Hint for PeerError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Own(error) => error.details(),
            Self::Missing(path) => Some(ErrorDetails::of_path(ErrorReason::NotFound, path)),
            Self::Alone(_) | Self::Lost { .. } => Some(ErrorReason::Environment.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Own(error) => error.hint(),
            Self::Missing(_) | Self::Lost { .. } => None,
            Self::Alone(_) => {
                Some("pip install mujoco pybullet numpy, and name that interpreter with --python".into())
            }
        }
    }
}

/// Runs the rounds, every engine once in each, and passes the present round and engine to `progress`.
///
/// # Errors
/// [`PeerError`]; no partial report is given, because only whole rounds compare.
pub fn run(
    settings: &PeerSettings,
    progress: &mut dyn FnMut(u32, &PeerEngine),
) -> Result<PeerReport, PeerError> {
    let mut paths = std::iter::once(&settings.scripts).chain(&settings.native);
    if let Some(missing) = paths.find(|path| !path.exists()) {
        return Err(PeerError::Missing(missing.clone()));
    }
    let mut results: Vec<(PeerEngine, Vec<PeerRates>)> =
        PeerEngine::ALL.map(|engine| (engine, Vec::new())).into();
    let mut absent: Vec<(PeerEngine, String)> = Vec::new();
    for round in 0..settings.rounds {
        for (engine, rates) in &mut results {
            if absent.iter().any(|(gone, _)| gone == engine) {
                continue;
            }
            progress(round, engine);
            match one_round(engine, settings)? {
                Ok(one) => rates.push(one),
                Err(why) => absent.push((engine.clone(), why)),
            }
        }
    }
    results.retain(|(engine, _)| absent.iter().all(|(gone, _)| gone != engine));
    if results.iter().all(|(engine, _)| matches!(engine, PeerEngine::Holdpoint(_))) {
        let why: Vec<String> =
            absent.iter().map(|(gone, why)| format!("{}: {why}", answers::peer_engine(gone))).collect();
        return Err(PeerError::Alone(why.join("; ")));
    }
    let rows = rows(&results)?;
    Ok(PeerReport { rounds: settings.rounds, physics: answers::PHYSICS_NUMBERS, rows, absent })
}

/// One engine's share of a round; the inner error says why a peer cannot take part.
fn one_round(engine: &PeerEngine, settings: &PeerSettings) -> Result<Result<PeerRates, String>, PeerError> {
    if let PeerEngine::Holdpoint(mode) = engine {
        return Ok(Ok(own_rates(mode.fidelity(), settings.episodes)?));
    }
    let Some(command) = engine.command(settings) else {
        return Ok(Err("no native program was named (--native)".to_owned()));
    };
    Ok(printed(command, &settings.scripts).and_then(|text| rates_in(&text)))
}

/// Times episodes of this cell, on seeds from 0: 960 ticks of approach, grasp, lift, transfer, place and retreat with
/// inverse kinematics in every tick. The cell is rebuilt for each.
fn own_rates(mode: Fidelity, episodes: u64) -> Result<PeerRates, BenchError> {
    if episodes == 0 {
        return Err(BenchError::TooFew { name: "peer episode".to_owned(), found: 0, needed: 1 });
    }
    let bench = PeerBench::new(mode)?;
    bench.run(episodes)?; // not counted, as with the peers
    let (mut lifted, mut placed, mut cpu_secs) = (0_u64, 0_u64, 0.0);
    for seed in 0..episodes {
        let before = FigureClock::ThreadCpu.secs();
        let outcome = bench.run(seed)?;
        cpu_secs += FigureClock::ThreadCpu.secs() - before;
        lifted += u64::from(outcome.lifted);
        placed += u64::from(outcome.placed);
    }
    let count = episodes as f64;
    Ok(PeerRates {
        episodes,
        lift_rate: lifted as f64 / count,
        place_rate: placed as f64 / count,
        episodes_per_cpu_s: count / cpu_secs,
    })
}

/// The output of a peer, within a time limit.
fn printed(mut command: Command, scripts: &Path) -> Result<String, String> {
    let cannot = |error: io::Error| format!("cannot be run: {error}");
    // A file, because no thread reads while the peer runs, and a full pipe would stop it.
    let output = tempfile::NamedTempFile::new().map_err(cannot)?;
    let mut child = command
        .current_dir(scripts)
        .env("OMP_NUM_THREADS", "1")
        .env("OPENBLAS_NUM_THREADS", "1")
        .stdin(Stdio::null())
        .stdout(output.reopen().map_err(cannot)?)
        .stderr(Stdio::null())
        .spawn()
        .map_err(cannot)?;
    let until = Instant::now() + PEER_MAX;
    let status = loop {
        if let Some(status) = child.try_wait().map_err(cannot)? {
            break status;
        }
        if Instant::now() > until {
            // The peer is killed because its time is over; its output does not count.
            let _ = child.kill();
            let _ = child.wait();
            return Err(format!("did not end within {} s", PEER_MAX.as_secs()));
        }
        std::thread::sleep(LOOK_EVERY);
    };
    if !status.success() {
        return Err(format!("ended with {status}"));
    }
    let mut text = String::new();
    let file = File::open(output.path()).map_err(cannot)?;
    io::Read::read_to_string(&mut io::Read::take(file, OUTPUT_MAX), &mut text).map_err(cannot)?;
    Ok(text)
}

/// The rates in the last JSON line of a peer's output.
fn rates_in(text: &str) -> Result<PeerRates, String> {
    let line = text.lines().rev().find(|line| line.starts_with('{')).ok_or("printed no figures")?;
    let rates: PeerRates =
        serde_json::from_str(line).map_err(|error| format!("printed no figures: {error}"))?;
    let share = 0.0..=1.0;
    let usable = rates.episodes > 0
        && rates.episodes_per_cpu_s.is_finite()
        && rates.episodes_per_cpu_s > 0.0
        && share.contains(&rates.lift_rate)
        && share.contains(&rates.place_rate);
    if usable { Ok(rates) } else { Err(format!("printed figures that cannot be: {line}")) }
}

fn rows(results: &[(PeerEngine, Vec<PeerRates>)]) -> Result<Vec<PeerRow>, PeerError> {
    let of = |engine: &PeerEngine| {
        results.iter().find(|(known, _)| known == engine).map(|(_, rates)| rates.as_slice())
    };
    let ratio = |rates: &[PeerRates], other: Option<&[PeerRates]>| {
        let ratios = rates.iter().zip(other?).map(|(a, b)| a.episodes_per_cpu_s / b.episodes_per_cpu_s);
        middle(ratios.collect())
    };
    let mut rows = Vec::with_capacity(results.len());
    for (engine, rates) in results {
        let mean = |of: fn(&PeerRates) -> f64| rates.iter().map(of).sum::<f64>() / rates.len() as f64;
        let (lift_rate, place_rate) = (mean(|one| one.lift_rate), mean(|one| one.place_rate));
        if !(lift_rate >= SUCCESS_MIN && place_rate >= SUCCESS_MIN) {
            return Err(PeerError::Lost { engine: engine.clone(), lift_rate, place_rate });
        }
        let all: Vec<f64> = rates.iter().map(|one| one.episodes_per_cpu_s).collect();
        rows.push(PeerRow {
            engine: engine.clone(),
            episodes: rates.first().map_or(0, |one| one.episodes),
            median: middle(all.clone()).unwrap_or(f64::NAN),
            rates: all,
            lift_rate,
            place_rate,
            to_pybullet: ratio(rates, of(&PeerEngine::PyBullet)),
            to_mujoco_native: ratio(rates, of(&PeerEngine::MujocoNative)),
        });
    }
    rows.sort_by(|a, b| b.median.total_cmp(&a.median));
    Ok(rows)
}

fn middle(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    median(&values)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    /// A peer that prints the given text for any arguments.
    fn peer_that_prints(folder: &Path, line: &str) -> PathBuf {
        let path = folder.join("python");
        fs::write(&path, format!("#!/bin/sh\necho warming up\nprintf '%s\\n' '{line}'\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o700)).unwrap();
        path
    }

    fn compared(folder: &Path, line: &str) -> Result<PeerReport, PeerError> {
        let settings = PeerSettings {
            python: peer_that_prints(folder, line),
            scripts: folder.to_owned(),
            native: None,
            rounds: 2,
            episodes: 1,
        };
        run(&settings, &mut |_, _| {})
    }

    #[test]
    fn output_of_a_peer_is_compared_with_own_measurements() {
        let folder = tempfile::tempdir().unwrap();
        let line = r#"{"peer": "x", "episodes": 16, "lift_rate": 1.0, "place_rate": 1.0, "episodes_per_cpu_s": 0.5}"#;
        let report = compared(folder.path(), line).unwrap();
        let row = |engine| report.rows.iter().find(|row| row.engine == engine).unwrap();
        assert_eq!((row(PeerEngine::PyBullet).median, row(PeerEngine::PyBullet).rates.len()), (0.5, 2));
        let own = row(PeerEngine::Holdpoint(CellMode::Adaptive));
        let expected: Vec<f64> = own.rates.iter().map(|rate| rate / 0.5).collect();
        assert_eq!(own.to_pybullet, middle(expected));
        assert_eq!(own.to_mujoco_native, None);
        assert_eq!(report.absent.len(), 2, "both native models: {:?}", report.absent);
    }

    #[test]
    fn a_peer_without_a_usable_result_is_named() {
        let folder = tempfile::tempdir().unwrap();
        for line in [
            "",
            "{}",
            r#"{"episodes": 0, "lift_rate": 1, "place_rate": 1, "episodes_per_cpu_s": 5}"#,
            r#"{"episodes": 4, "lift_rate": 1, "place_rate": 2, "episodes_per_cpu_s": 5}"#,
            r#"{"episodes": 4, "lift_rate": 1, "place_rate": 1, "episodes_per_cpu_s": -1}"#,
        ] {
            let error = compared(folder.path(), line).unwrap_err();
            assert!(matches!(&error, PeerError::Alone(why) if why.contains("PyBullet: printed")), "{error}");
        }
    }

    #[test]
    fn an_engine_that_loses_the_cube_is_not_compared() {
        let folder = tempfile::tempdir().unwrap();
        let line = r#"{"episodes": 16, "lift_rate": 1.0, "place_rate": 0.9, "episodes_per_cpu_s": 500}"#;
        let error = compared(folder.path(), line).unwrap_err();
        assert!(matches!(error, PeerError::Lost { .. }), "{error}");
    }
}
