//! The two runs without a screen: a scenario to its end, and the demonstration as it happens.

use std::io::Write;
use std::path::Path;

use holdpoint_sim::robot::RobotModel;

use super::driver::{Driver, StepEnd};
use super::printer::Printer;
use super::script::Script;
use crate::error::{CliError, Exit};
use holdpoint_engine::cell::Cell;
use holdpoint_engine::door::Signals;
use holdpoint_engine::embedded;
use holdpoint_engine::pipeline::Progress;
use holdpoint_engine::pump::Pump;
use holdpoint_engine::trial::cache::EpisodeCache;
use holdpoint_engine::{Config, Engine};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::sink::MakeSink;
use holdpoint_protocol::snapshot::CandidateView;
use holdpoint_text::Hint;

pub struct RunScript<'a> {
    pub script: &'a Path,
    /// The store's folder; a fresh one that is removed afterwards if none is given.
    pub data: Option<&'a Path>,
    /// A folder of cached episodes that runs share.
    pub cache: Option<&'a Path>,
    /// The run's seed in place of the script's.
    pub seed: Option<u64>,
    pub jobs: usize,
    /// A robot's URDF file in place of the built-in arm.
    pub robot: Option<&'a Path>,
    /// Whether events are printed as JSON lines.
    pub json: bool,
    /// Who listens besides the printer: recordings, a live viewer.
    pub sinks: Vec<MakeSink>,
}

/// The demonstration, printed as it happens.
pub struct RunPlain<'a> {
    pub data: &'a Path,
    pub profile: ProfileName,
    pub seed: u64,
    pub jobs: usize,
    /// A robot's URDF file in place of the built-in arm.
    pub robot: Option<&'a Path>,
    /// Whether events are printed as JSON lines.
    pub json: bool,
    /// Simulated seconds of the live cell in a second; absent for as fast as it computes.
    pub pace: Option<f64>,
    /// Who listens besides the printer: recordings, a live viewer.
    pub sinks: Vec<MakeSink>,
}

/// One stage of one candidate by itself, printed as it happens.
pub struct RunStage<'a> {
    pub data: &'a Path,
    /// The profile the store was last used with.
    pub profile: ProfileName,
    pub seed: u64,
    pub jobs: usize,
    /// Whether events are printed as JSON lines.
    pub json: bool,
    pub version: &'a CapabilityId,
    pub stage: Stage,
}

/// The pause of the demonstration while it waits for people.
const IDLE_PAUSE: std::time::Duration = std::time::Duration::from_millis(200);

/// The pause while the live cell works at a pace of its own: what it did is taken in soon.
const PACED_PAUSE: std::time::Duration = std::time::Duration::from_millis(15);

/// The seed if neither script nor command line name one.
const DEFAULT_SEED: u64 = 1;

/// Runs a scenario to its end.
///
/// # Errors
/// [`CliError`] with exit code 2 for what is wrong with the input, 70 for what is wrong inside and
/// for an expectation that does not hold.
pub fn run_script(run: RunScript<'_>, out: &mut dyn Write) -> Result<Exit, CliError> {
    let shown = holdpoint_text::Untrusted::new(run.script.display().to_string()).line().into_string();
    let text = std::fs::read_to_string(run.script)
        .map_err(|error| CliError::usage(format!("cannot read {shown}: {error}")))?;
    let script = Script::parse(&shown, &text).map_err(CliError::usage)?;
    let fresh;
    let data = match run.data {
        Some(data) => data,
        None => {
            fresh = tempfile::tempdir()
                .map_err(|error| CliError::usage(format!("cannot make a temporary folder: {error}")))?;
            fresh.path()
        }
    };
    let engine = Engine::start(Config {
        data,
        profile: script.profile,
        seed: run.seed.or(script.seed).unwrap_or(DEFAULT_SEED),
        jobs: run.jobs,
        scripted: true,
        cell: cell(run.robot)?,
        cache: run.cache.map_or(EpisodeCache::InStore, |folder| EpisodeCache::Shared(folder.to_owned())),
    })
    .map_err(start_error)?;
    let mut pump = Pump::new(engine, run.sinks);
    if let Some(pictures) = pump.pictures() {
        pump.draw_live_world(pictures);
    }
    let mut driver = Driver::new(pump, Printer::new(out, run.json));
    driver.take_events()?;
    for (index, step) in script.steps.iter().enumerate() {
        if driver.step(step, index)? == StepEnd::TimedOut {
            driver.note(&format!("step {} timed out", index + 1))?;
            break;
        }
    }
    driver.finish()
}

/// Runs the demonstration in real time: the first embedded candidate that is not registered yet, to
/// its end. Other programs can talk to the engine meanwhile.
///
/// # Errors
/// As [`run_script`].
pub fn run_plain(run: RunPlain<'_>, out: &mut dyn Write) -> Result<Exit, CliError> {
    let engine = Engine::start(Config {
        data: run.data,
        profile: run.profile,
        seed: run.seed,
        jobs: run.jobs,
        scripted: false,
        cell: cell(run.robot)?,
        cache: EpisodeCache::InStore,
    })
    .map_err(start_error)?;
    let mut pump = Pump::new(engine, run.sinks);
    match (run.pace, pump.pictures()) {
        // Nobody looks at the pictures.
        (Some(pace), None) => pump.pace_live_world(Some(pace), std::sync::Arc::new(|_| ())),
        (Some(pace), Some(pictures)) => pump.pace_live_world(Some(pace), pictures),
        (None, Some(pictures)) => pump.draw_live_world(pictures),
        (None, None) => {}
    }
    pump.open_door(Signals::Taken).map_err(CliError::usage)?;
    let mut driver = Driver::new(pump, Printer::new(out, run.json));
    driver.take_events()?;
    let known: Vec<CapabilityId> =
        driver.pump.engine().snapshot().candidates.into_iter().map(|candidate| candidate.version).collect();
    let Some(name) = embedded::names_beside(&known).next() else {
        driver
            .note("every demonstration candidate is registered; see `holdpoint candidate register <dir>`")?;
        return driver.finish();
    };
    driver.note(&format!("submitting the demonstration candidate {name}"))?;
    driver.register(name)?;
    loop {
        let (progress, events) = driver.pump.turn();
        driver.tell(&events)?;
        let idle = matches!(progress, Progress::Idle { .. });
        // With a pace an idle engine may wait for the live cell in the middle of a stage.
        let works = |view: &CandidateView| run.pace.is_some() && view.flags.running.is_some();
        let settled = driver.view().is_some_and(|view| driver.is_settled(&view, idle) && !works(&view));
        if settled || driver.is_over() {
            return driver.finish();
        }
        if idle {
            driver.pump.wait(if run.pace.is_some() { PACED_PAUSE } else { IDLE_PAUSE });
        }
    }
}

/// Runs one stage of one candidate and nothing else.
///
/// # Errors
/// As [`run_script`], and with exit code 3 if the stage cannot be begun now.
pub fn run_stage(run: &RunStage<'_>, out: &mut dyn Write) -> Result<Exit, CliError> {
    let mut engine = Engine::start(Config {
        data: run.data,
        profile: run.profile,
        seed: run.seed,
        jobs: run.jobs,
        scripted: false,
        cell: cell(None)?,
        cache: EpisodeCache::InStore,
    })
    .map_err(start_error)?;
    engine.begin_on_call();
    let mut driver = Driver::new(Pump::new(engine, Vec::new()), Printer::new(out, run.json));
    driver.take_events()?;
    driver.run_stage(run.version, run.stage)?;
    driver.finish_stage(run.stage)
}

fn cell(robot: Option<&Path>) -> Result<Cell, CliError> {
    let model = match robot {
        None => RobotModel::builtin("arm7"),
        Some(path) => RobotModel::load(path),
    };
    model.and_then(Cell::new).map_err(|error| CliError::usage(error.to_string()))
}

/// What cannot be opened or read is the caller's to mend; a fault of the engine is not.
fn start_error(error: holdpoint_engine::StartError) -> CliError {
    match &error {
        holdpoint_engine::StartError::Fault(_) => CliError::internal(error.sentence()),
        _ => CliError::usage(error),
    }
}
