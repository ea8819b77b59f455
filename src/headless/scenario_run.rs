//! Runs a scenario to its end, without a screen, on a virtual clock.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use super::driver::{Driver, StepEnd};
use super::printer::Printer;
use super::script::{SCRIPT_BYTES_MAX, Script};
use crate::cells::CELLS;
use crate::error::{CliError, Exit, bootstrap_error, start_error};
use holdpoint_engine::{Config, Engine};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::site_profile::ChosenProfile;
use holdpoint_protocol::sink::MakeSink;
use holdpoint_runtime::capability::shown;
use holdpoint_service::control_socket::SignalHandling;
use holdpoint_service::pump::Pump;
use holdpoint_store::ResultCache;
use holdpoint_text::{ErrorDetails, ErrorReason, shell_word};
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::EpisodeSeeds;
use holdpoint_trials::site::LoadedSite;
use holdpoint_wording::program::run::timed_out;

pub struct RunScript<'a> {
    pub script: &'a Path,
    /// The store's folder; by default a temporary one.
    pub data: Option<&'a Path>,
    /// Cached episodes of active versions that runs share; by default the store's own.
    pub cache: Option<ResultCache>,
    /// The seed, instead of the script's.
    pub seed: Option<u32>,
    pub jobs: usize,
    /// A robot's URDF file, instead of the site's robot.
    pub robot: Option<&'a Path>,
    /// The site file; absent for the built-in site. The script names the profile.
    pub site: Option<Arc<LoadedSite>>,
    /// Whether events are printed as JSON lines.
    pub json: bool,
    /// Sinks besides the printer: recordings, a live viewer.
    pub sinks: Vec<MakeSink>,
}

/// One stage of one candidate, printed as it happens.
pub struct RunStage<'a> {
    pub data: &'a Path,
    /// The profile the store was last used with.
    pub profile: ChosenProfile,
    pub seeds: EpisodeSeeds,
    pub jobs: usize,
    /// The robot the store is for.
    pub cell: Cell,
    /// Whether events are printed as JSON lines.
    pub json: bool,
    pub version: &'a CapabilityId,
    pub stage: Stage,
}

/// The seed if neither script nor command line name one.
const DEFAULT_SEED: u32 = 1;

/// Runs a scenario to its end.
///
/// # Errors
/// [`CliError`] with exit code 2 for invalid input, 7 for an expectation that does not hold, 70 for a fault.
pub fn run_script(run: RunScript<'_>, out: &mut dyn Write) -> Result<Exit, CliError> {
    let shown = holdpoint_text::Untrusted::new(run.script.display().to_string()).line().into_string();
    let text = holdpoint_text::file::read_text(run.script, SCRIPT_BYTES_MAX as u64).map_err(|error| {
        CliError::usage(format!("cannot read {shown}: {error}")).with_bad_file(run.script)
    })?;
    let script = Script::parse(&shown, &text).map_err(CliError::usage)?;
    let fresh;
    let data = match run.data {
        Some(data) => data,
        None => {
            fresh = fresh_store()?;
            fresh.path()
        }
    };
    let engine = Engine::start(Config {
        data,
        profile: script.profile.into(),
        seeds: EpisodeSeeds::OfRun(u64::from(run.seed.or(script.seed).unwrap_or(DEFAULT_SEED))),
        jobs: run.jobs,
        scripted: true,
        cell: cell(run.robot, run.site.as_ref())?,
        cache: run.cache.map_or(EpisodeCache::InStore, EpisodeCache::Shared),
    })
    .map_err(start_error)?;
    let mut pump = Pump::new(engine, run.sinks);
    if let Some(sink) = pump.frame_sink() {
        pump.draw_live_world(sink);
    }
    let mut driver = Driver::new(pump, Printer::new(out, run.json));
    driver.take_events()?;
    driver.enrol(&script.steps)?;
    for (index, step) in script.steps.iter().enumerate() {
        if driver.step(step, index)? == StepEnd::TimedOut {
            driver.note(&timed_out(index + 1))?;
            break;
        }
    }
    driver.finish()
}

/// A folder for a temporary store, removed when this is dropped.
///
/// # Errors
/// If it cannot be created.
pub fn fresh_store() -> Result<tempfile::TempDir, CliError> {
    tempfile::tempdir().map_err(|error| {
        CliError::usage(format!("cannot create a temporary folder: {error}"))
            .with_unwritable(&std::env::temp_dir(), &error)
    })
}

/// Runs one stage of one candidate. The live cell works beside it, so other programs can stop it, and a signal ends the engine
/// cleanly.
///
/// # Errors
/// As [`run_script`], and with exit code 3 if the stage cannot begin now.
pub fn run_stage(run: RunStage<'_>, out: &mut dyn Write) -> Result<Exit, CliError> {
    let mut engine = Engine::start(Config {
        data: run.data,
        profile: run.profile,
        seeds: run.seeds,
        jobs: run.jobs,
        scripted: false,
        cell: run.cell,
        cache: EpisodeCache::InStore,
    })
    .map_err(start_error)?;
    engine.begin_on_call();
    let mut pump = Pump::new(engine, Vec::new());
    pump.open_socket(SignalHandling::Handled).map_err(|error| bootstrap_error(error.into()))?;
    let mut driver = Driver::new(pump, Printer::new(out, run.json));
    driver.take_events()?;
    driver.run_stage(run.version, run.stage)?;
    driver.finish_stage(run.stage)
}

/// The cell of an engine, with the robot of this file, else with the site's.
pub(crate) fn cell(robot: Option<&Path>, site: Option<&Arc<LoadedSite>>) -> Result<Cell, CliError> {
    Cell::at(&CELLS, robot, site).map_err(|error| {
        let error = CliError::usage(error.to_string());
        match (robot, site) {
            (Some(file), _) => error.with_bad_file(file),
            (None, Some(site)) => {
                let file = shown(&site.file);
                let check = format!("run `holdpoint site check {}`", shell_word(&file));
                let (hint, field) = match &site.site.live.endpoint {
                    Some(endpoint) => {
                        let listen = shell_word(endpoint);
                        (
                            format!("start the cell, e.g. `holdpoint cell serve --listen {listen}`; {check}"),
                            "live.endpoint",
                        )
                    }
                    None => (format!("correct it, then {check}"), "robot"),
                };
                error.with_hint(hint).with_details(ErrorDetails::of_field(file, field))
            }
            (None, None) => error.with_details(ErrorReason::Internal),
        }
    })
}
