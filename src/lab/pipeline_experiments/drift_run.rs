//! One run of the drift experiment: a version up to its activation, and the effect of each drift on it.
//!
//! The pipeline evaluates and activates the version once per run seed; every cell continues from a copy of that store.
//! A cell has three parts, all on live episodes that the run has not used. The version's twins run with and without the
//! drift and without a monitor (does the drift really worsen the version?). The watched run lasts until the monitor
//! rolls the version back or the horizon ends. The rollback target then runs its first sequences under the same drift.

use std::path::Path;

use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude};
use holdpoint_sim::SimCells;
use serde::{Deserialize, Serialize};

use super::layer_failure::LayerFailure;
use super::{DriftOptions, ExperimentError, baselines, embedded_package, workers_each};
use holdpoint_engine::StartError;
use holdpoint_engine::decide::pipeline::Pipeline;
use holdpoint_engine::decide::pipeline::PipelineSettings;
use holdpoint_engine::decide::pipeline::SliceOutcome;
use holdpoint_engine::decide::pipeline::experiment::ExperimentPipeline;
use holdpoint_engine::live::stop_switch::Controls;
use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::rollback::RollbackRecord;
use holdpoint_governance::stats::{PairedCounts, binary_pairs};
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::command::{Command, Reply};
use holdpoint_protocol::event::{EventKind, TaskSummary};
use holdpoint_record::version_table::VersionTable;
use holdpoint_record::wall_clock::WallClock;
use holdpoint_registry::Store;
use holdpoint_runtime::capability::Capability;
use holdpoint_store::ResultCache;
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::EpisodeSeeds;

/// Sequences of the rollback target that are counted.
pub const AFTER_SEQUENCES: u32 = 10;

/// One-sided level at which a drift counts as worsening a version.
const WORSE_ALPHA: f64 = 0.05;

/// Most slices until a candidate is active.
const SLICES_MAX: u32 = 100_000;

/// Benign versions that improve on their baseline; runs take them in turn.
const CANDIDATES: [&str; 3] = ["align-improved", "grasp-improved", "place-robust"];

/// The inputs that all runs share.
pub struct DriftSetting {
    pub(super) profile: Profile,
    cell: Cell,
    /// The cache of active versions' episodes, which runs share.
    pub(super) cache: ResultCache,
    /// Workers of a run's evaluation.
    pub(super) workers: usize,
    /// The most live sequences of a version that is not rolled back.
    pub(super) horizon: u32,
    /// Sequences of the twins.
    pub(super) pairs: u32,
}

impl DriftSetting {
    pub(super) fn new(options: &DriftOptions) -> Result<Self, ExperimentError> {
        let profile =
            Profile::builtin(ProfileName::Sim).map_err(|error| StartError::Profile(error.into()))?;
        let cell = Cell::of(&SimCells, None).map_err(StartError::from)?;
        let workers = workers_each(options.jobs, usize::try_from(options.runs).unwrap_or(usize::MAX));
        let (cache, horizon, pairs) = (options.cache.clone(), options.horizon, options.pairs);
        Ok(Self { profile, cell, cache, workers, horizon, pairs })
    }

    /// The inputs of a cached cell.
    pub(super) fn digest(&self) -> Result<Digest, ExperimentError> {
        let profile = self.profile.digest()?;
        let build = self.cell.computed_by().as_bytes();
        let sizes = [self.horizon.to_le_bytes(), self.pairs.to_le_bytes()].concat();
        let mut parts: Vec<Vec<u8>> =
            vec![profile.bytes().to_vec(), self.cell.digest().bytes().to_vec(), build.to_vec(), sizes];
        for name in CANDIDATES {
            parts.push(candidate(name)?.digest().bytes().to_vec());
        }
        let parts: Vec<&[u8]> = parts.iter().map(Vec::as_slice).collect();
        Ok(Digest::of_parts("holdpoint.experiment.drift.v1", &parts))
    }

    fn pipeline(&self, seed: u64, folder: &Path) -> Result<Pipeline, ExperimentError> {
        let store = Store::open(folder).map_err(StartError::from)?;
        let clock = Clock::scripted(store.opening().head.at_ms);
        let version_table =
            VersionTable::open(Box::new(store), WallClock::scripted(0, None)).map_err(StartError::from)?;
        let table = PolicyTable::builtin(&self.profile).map_err(|error| StartError::Profile(error.into()))?;
        let settings = PipelineSettings {
            seeds: EpisodeSeeds::OfRun(seed),
            jobs: self.workers,
            profile: self.profile.clone(),
            table,
            own: None,
            cell: self.cell.clone(),
            cache: EpisodeCache::Shared(self.cache.clone()),
            controls: Controls::default(),
            omitted: holdpoint_governance::ablation::AblatedParts::default(),
        };
        let baselines = baselines()?;
        Ok(Pipeline::new(settings, version_table, clock, baselines)?)
    }
}

fn candidate(name: &str) -> Result<Capability, ExperimentError> {
    let package = embedded_package(name)?;
    Ok(Capability::load(name, package).map_err(StartError::from)?)
}

/// The candidate of a run.
pub(super) fn candidate_of(seed: u64) -> &'static str {
    // The modulus is below three.
    CANDIDATES[usize::try_from(seed % CANDIDATES.len() as u64).unwrap_or(0)]
}

/// A run with an active version, ready to be copied.
pub struct ActivatedRun {
    pub(super) seed: u64,
    folder: tempfile::TempDir,
    pub(super) id: CapabilityId,
    next_sequence: u64,
    calm: Vec<Option<bool>>,
}

/// Takes the run's candidate to its activation. `None` if the pipeline did not activate it.
pub(super) fn activate(setting: &DriftSetting, seed: u64) -> Result<Option<ActivatedRun>, ExperimentError> {
    let folder = super::scratch()?;
    let name = candidate_of(seed);
    let id = candidate(name)?.id();
    let mut pipeline = setting.pipeline(seed, folder.path())?;
    let package = embedded_package(name)?;
    let reply = pipeline.command(Command::Register { package, name: name.to_owned(), by: None });
    if !matches!(reply, Reply::Accepted { .. }) {
        return Err(ExperimentError::Unexpected(format!("{name} was not taken in: {reply:?}")));
    }
    let mut state = State::Registered;
    for _ in 0..SLICES_MAX {
        let progress = pipeline.advance();
        for event in pipeline.drain_events() {
            match event {
                EventKind::StateChanged { version, to, .. } if version == id => state = to,
                EventKind::Fault { text } => return Err(ExperimentError::Unexpected(text)),
                _ => {}
            }
        }
        if state == State::Active || state.is_terminal() || state == State::Demoted {
            break;
        }
        if progress != SliceOutcome::Ran {
            break;
        }
    }
    if state != State::Active {
        return Ok(None);
    }
    let next_sequence = pipeline.sequences();
    drop(pipeline);
    let mut run = ActivatedRun { seed, folder, id, next_sequence, calm: Vec::new() };
    run.calm = run.twins(setting, None)?;
    Ok(Some(run))
}

/// Whether the drift worsens the version, by its twins: same live episodes, with the drift and without.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriftEffect {
    /// Sequences in which both twins reached the version's task.
    pub pairs: u64,
    /// Of those, bad without the drift: the task failed, or the referee saw something unsafe in it.
    pub bad_calm: u64,
    /// Of those, bad under the drift.
    pub bad_under: u64,
    /// Lower bound of the difference of the two rates, one-sided 95 %.
    pub worse_at_least: f64,
    /// The drift raises the rate of bad tasks by at least the shift that the monitor is tuned to, and the rise is
    /// significant: a rollback is needed.
    pub needs_trigger: bool,
}

/// The first request of a monitor.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FirstResponse {
    /// The request.
    pub decision: MonitorOutcome,
    /// Tasks of the version under the drift until then.
    pub episodes: u32,
}

/// Work of one part of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartWork {
    pub sequences: u32,
    /// Tasks of the family that was upgraded.
    pub tasks: u32,
    /// Of those, the ones that were done.
    pub done: u32,
    /// Of those, with something unsafe by ground truth.
    pub unsafe_tasks: u32,
}

/// One cell: one run under one drift.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellRun {
    /// Digest of everything the result depends on beside the fields below.
    pub setting: Digest,
    pub seed: u64,
    pub candidate: String,
    pub kind: DriftKind,
    pub magnitude: Magnitude,
    /// Absent if the pipeline did not activate the candidate on this seed: the cell then counts nowhere.
    pub result: Option<CellResult>,
}

/// The events of a cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellResult {
    /// Whether a rollback was needed.
    #[serde(rename = "need")]
    pub effect: DriftEffect,
    /// The first request of the monitor.
    pub first: Option<FirstResponse>,
    /// Tasks of the version under the drift until the rollback, or until the horizon.
    pub under: PartWork,
    /// The rollback, if there was one.
    pub rollback: Option<RollbackRecord>,
    /// The rollback target's first sequences under the drift.
    pub after: PartWork,
    /// The value of [`CellResult::is_recovered`].
    pub recovered: bool,
}

impl CellResult {
    /// The ladder was completed, the rollback target is in control, motion after the trigger kept to the profile's
    /// limit, and the target's first ten sequences under the drift had nothing unsafe by ground truth in its tasks.
    fn is_recovered(&self, limit_ms: f64) -> bool {
        self.rollback.as_ref().is_some_and(|record| {
            record.predecessor.is_some()
                && record.unsafe_continuation_ms as f64 <= limit_ms
                && self.after.sequences >= AFTER_SEQUENCES
                && self.after.unsafe_tasks == 0
        })
    }
}

impl ActivatedRun {
    pub(super) fn cell(&self, setting: &DriftSetting, drift: Drift) -> Result<CellResult, ExperimentError> {
        let effect = self.effect(setting, drift)?;
        let WatchedRun { first, under, after, record, .. } =
            self.run_monitored(setting, drift, LayerFailure::Nothing)?;
        let mut result = CellResult { effect, first, under, rollback: record, after, recovered: false };
        result.recovered = result.is_recovered(setting.profile.runtime.unsafe_continuation_max_ms);
        Ok(result)
    }

    /// The version under the drift and its monitor, and its successor, while a part of the layer fails.
    pub(super) fn run_monitored(
        &self,
        setting: &DriftSetting,
        drift: Drift,
        failure: LayerFailure,
    ) -> Result<WatchedRun, ExperimentError> {
        let copy = self.copy()?;
        let mut pipeline = setting.pipeline(self.seed, copy.path())?;
        failure.sets_in(&mut pipeline, &self.id, copy.path())?;
        pipeline.drain_events();
        let mut rehearsal = pipeline.rehearse(self.next_sequence);
        rehearsal.blind(failure.unseen());
        rehearsal.set_drift(Some(drift)).map_err(StartError::from)?;
        let mut watched = WatchedRun { id: Some(self.id.clone()), ..WatchedRun::default() };
        for _ in 0..setting.horizon + AFTER_SEQUENCES {
            let over = if watched.record.is_some() {
                watched.after.sequences >= AFTER_SEQUENCES
            } else {
                watched.under.sequences >= setting.horizon
            };
            if over {
                break;
            }
            rehearsal.run_monitored()?;
            watched.take(&mut rehearsal)?;
        }
        Ok(watched)
    }

    fn effect(&self, setting: &DriftSetting, drift: Drift) -> Result<DriftEffect, ExperimentError> {
        let under = self.twins(setting, Some(drift))?;
        let both: Vec<(bool, bool)> =
            under.iter().zip(&self.calm).filter_map(|(under, calm)| Some(((*under)?, (*calm)?))).collect();
        let pairs = both.len() as u64;
        let bad_under = both.iter().filter(|(under, _)| *under).count() as u64;
        let bad_calm = both.iter().filter(|(_, calm)| *calm).count() as u64;
        if pairs == 0 {
            // The family's task is not reached any more: there is no data about the version.
            return Ok(DriftEffect {
                pairs,
                bad_calm,
                bad_under,
                worse_at_least: -1.0,
                needs_trigger: false,
            });
        }
        let bound = binary_pairs(PairedCounts::of(both), WORSE_ALPHA)?;
        let needs_trigger = bound.lower > 0.0 && bound.mean >= setting.profile.monitor.shift;
        Ok(DriftEffect { pairs, bad_calm, bad_under, worse_at_least: bound.lower, needs_trigger })
    }

    /// The version unwatched: for each sequence whether its task went badly; `None` if it was not reached.
    fn twins(
        &self,
        setting: &DriftSetting,
        drift: Option<Drift>,
    ) -> Result<Vec<Option<bool>>, ExperimentError> {
        let copy = self.copy()?;
        let mut rehearsal = setting.pipeline(self.seed, copy.path())?.rehearse(self.next_sequence);
        rehearsal.set_drift(drift).map_err(StartError::from)?;
        let mut bad = Vec::new();
        for _ in 0..setting.pairs {
            let report = rehearsal.run_unmonitored();
            let verdicts = rehearsal.take_verdicts();
            bad.push(report.tasks.iter().find(|done| done.id == self.id).map(|done| {
                let seen = verdicts.iter().any(|(_, id, verdict)| *id == self.id && verdict.is_unsafe());
                seen || !done.record.success
            }));
        }
        Ok(bad)
    }

    /// A separate store, as it was at the activation.
    fn copy(&self) -> Result<tempfile::TempDir, ExperimentError> {
        let copy = super::scratch()?;
        copy_folder(self.folder.path(), copy.path())?;
        Ok(copy)
    }
}

fn copy_folder(from: &Path, to: &Path) -> Result<(), ExperimentError> {
    for entry in std::fs::read_dir(from).map_err(ExperimentError::file(from))? {
        let path = entry.map_err(ExperimentError::file(from))?.path();
        let Some(name) = path.file_name() else { continue };
        let target = to.join(name);
        if path.is_dir() {
            std::fs::create_dir_all(&target).map_err(ExperimentError::file(&target))?;
            copy_folder(&path, &target)?;
        } else if path.is_file() {
            std::fs::copy(&path, &target).map_err(ExperimentError::file(&path))?;
        }
    }
    Ok(())
}

/// The data of a watched run so far.
#[derive(Default)]
pub(super) struct WatchedRun {
    id: Option<CapabilityId>,
    first: Option<FirstResponse>,
    pub(super) under: PartWork,
    pub(super) after: PartWork,
    left: bool,
    pub(super) record: Option<RollbackRecord>,
    /// The monitor restricted its envelope.
    pub(super) restricted: bool,
    /// While it was in control, an alarm named it that is not the monitor's.
    pub(super) has_alarm: bool,
}

impl WatchedRun {
    /// Takes the events and the ground truth of the last run.
    fn take(&mut self, rehearsal: &mut ExperimentPipeline) -> Result<(), ExperimentError> {
        let verdicts = rehearsal.take_verdicts();
        let Some(ours) = self.id.clone() else { return Ok(()) };
        for event in rehearsal.drain_events() {
            match event {
                EventKind::Sequence { index, tasks, .. } => {
                    let is_unsafe = |task: &TaskSummary| {
                        verdicts.iter().any(|(sequence, id, verdict)| {
                            *sequence == index && *id == task.version && verdict.is_unsafe()
                        })
                    };
                    let work = if self.left { &mut self.after } else { &mut self.under };
                    if self.left && work.sequences >= AFTER_SEQUENCES {
                        continue;
                    }
                    work.sequences += 1;
                    for task in tasks.iter().filter(|task| task.version.family == ours.family) {
                        work.tasks += 1;
                        work.done += u32::from(task.success);
                        work.unsafe_tasks += u32::from(is_unsafe(task));
                    }
                }
                EventKind::Monitor { version, decision, .. } if version == ours => {
                    let episodes = self.under.tasks;
                    self.first.get_or_insert(FirstResponse { decision, episodes });
                    self.restricted |= decision == MonitorOutcome::Restrict;
                }
                EventKind::Alarm { alarm, state, .. } if state.is_present() && !self.left => {
                    self.has_alarm |= reports_degradation(&alarm, &ours);
                }
                EventKind::Rung { version, .. } if version == ours => self.left = true,
                EventKind::RolledBack { record, .. } if record.candidate == ours => {
                    self.left = true;
                    self.record = Some(*record);
                }
                EventKind::Fault { text } => return Err(ExperimentError::Unexpected(text)),
                _ => {}
            }
        }
        Ok(())
    }
}

/// Whether an alarm reports a worse version, independently of its monitor.
fn reports_degradation(alarm: &str, version: &CapabilityId) -> bool {
    match alarm.parse() {
        Ok(AlarmKey::Degraded(of) | AlarmKey::Shifted(of) | AlarmKey::Violation(of)) => of == *version,
        Ok(AlarmKey::CellDegraded) => true,
        _ => false,
    }
}

/// Every drift in every magnitude.
pub(super) fn drifts() -> impl Iterator<Item = Drift> {
    DriftKind::ALL
        .into_iter()
        .flat_map(|kind| Magnitude::ALL.into_iter().map(move |magnitude| Drift { kind, magnitude }))
}
