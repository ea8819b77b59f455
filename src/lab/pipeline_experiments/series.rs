//! Series of inferior versions by one author, through the pipeline on one store each: in how many does any get in?
//!
//! Each series registers one tweak after another, under `sim` and with secret seeds, until one is activated or all are stopped.
//! The tweaks and what they lose: `series_tweaks.rs`. A finished series is cached, and written as a row; its seeds are secret, so
//! a series that is run again has other episodes.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::candidate_run::{CandidateDriver, EpisodeEffort, StageRecord};
use super::series_tweaks::{Calibration, Tweak, calibrate, commissioned, tweak};
use super::{ExperimentError, ProgressFn, cache_or_new, cached_result, scratch};
use crate::finished_rows::{self, RowFile};
use crate::side_by_side::side_by_side;
use crate::wording::progress;
use holdpoint::bench::FigureClock;
use holdpoint_engine::build_digest::decided_by;
use holdpoint_engine::{Config, Engine, Experiment};
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::metrics::Fate;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::stats::clopper_pearson_upper;
use holdpoint_governance::tries::CountedTry;
use holdpoint_protocol::scenario_state::{Decider, ScenarioState};
use holdpoint_sim::SimCells;
use holdpoint_store::ResultCache;
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::EpisodeSeeds;

/// One-sided level of the bound of the series in which a tweak gets in.
const BOUND_ALPHA: f64 = 0.05;

/// The plan of a run.
#[derive(Clone, Debug)]
pub struct SeriesPlan {
    pub series: u64,
    /// The most tweaks of a series.
    pub tweaks: u32,
    /// Every `of`-th series from the `shard`-th on.
    pub shard: (usize, usize),
    /// The first calibration seed, and the number of its episodes.
    pub calibration: (u64, u64),
    pub jobs: usize,
    /// Finished series and the calibration are cached here and not run again; only for this run if absent.
    pub cache: Option<ResultCache>,
    /// The file that gets a row for each finished series.
    pub rows: Option<PathBuf>,
}

/// The end of one tweak.
// Unknown fields are accepted: serde cannot tell them from flattened fields.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TryEnd {
    pub version: CapabilityId,
    /// The try that it was counted as; absent if it was stopped before its first pair.
    pub counted: Option<CountedTry>,
    /// Pairs that it ran.
    pub pairs: u64,
    /// Who decided last; absent without any decision.
    pub decider: Option<Decider>,
    /// Why, the deciding reason first.
    pub codes: Vec<ReasonCode>,
    /// `confirmed`, or the lifecycle state it stayed in.
    pub state: ScenarioState,
    /// Blocked, contained or kept.
    #[serde(flatten)]
    pub fate: Fate,
    /// Episodes that ran for it.
    pub effort: EpisodeEffort,
    /// CPU time of the thread that ran it, s.
    pub cpu_secs: f64,
}

impl TryEnd {
    /// Whether it was activated.
    const fn got_in(&self) -> bool {
        !matches!(self.fate, Fate::Blocked { .. })
    }
}

/// The end of one series: its tweaks in order. Only the last one can have got in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeriesEnd {
    /// Its number, from 0.
    pub series: u64,
    pub tries: Vec<TryEnd>,
}

impl SeriesEnd {
    /// The tweaks until one got in; `None` if none did.
    #[must_use]
    pub fn tries_until_in(&self) -> Option<usize> {
        self.tries.iter().position(TryEnd::got_in).map(|place| place + 1)
    }

    /// Pairs of all tweaks.
    #[must_use]
    pub fn pairs(&self) -> u64 {
        self.tries.iter().map(|one| one.pairs).sum()
    }

    /// CPU time of all tweaks, s.
    #[must_use]
    pub fn cpu_secs(&self) -> f64 {
        self.tries.iter().map(|one| one.cpu_secs).sum()
    }

    /// The tweaks that were stopped, by reason.
    #[must_use]
    pub fn stopped_by(&self) -> BTreeMap<String, u64> {
        let mut counts = BTreeMap::new();
        for one in self.tries.iter().filter(|one| !one.got_in()) {
            let reason = one.codes.first().map_or("none", |code| code.as_str());
            *counts.entry(reason.to_owned()).or_default() += 1;
        }
        counts
    }
}

/// All series together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeriesSummary {
    pub series: u64,
    /// Series in which a tweak got in.
    pub got_in: u64,
    /// Upper bound of their rate (Clopper and Pearson, one-sided 95 %).
    pub at_most: f64,
    pub tries: u64,
    pub pairs: u64,
    pub cpu_secs: f64,
    /// The tweaks that were stopped, by reason.
    pub stopped_by: BTreeMap<String, u64>,
}

/// The result of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeriesReport {
    /// Digest of everything that decides.
    pub decided_by: String,
    pub calibration: Calibration,
    pub series: Vec<SeriesEnd>,
    pub summary: SeriesSummary,
}

impl SeriesReport {
    fn of(
        decided_by: String,
        calibration: Calibration,
        mut series: Vec<SeriesEnd>,
    ) -> Result<Self, ExperimentError> {
        series.sort_by_key(|end| end.series);
        let summary = summarize(&series)?;
        Ok(Self { decided_by, calibration, series, summary })
    }
}

/// The reports of finished series: one for each build and calibration.
///
/// # Errors
/// If a file cannot be read, or a line is no finished series.
pub fn reports_of(files: &[PathBuf]) -> Result<Vec<SeriesReport>, ExperimentError> {
    let groups = finished_rows::read::<Calibration, SeriesEnd>(files)?.into_iter();
    groups.map(|group| SeriesReport::of(group.decided_by, group.setting, group.results)).collect()
}

/// Runs the plan. `tell` gets one line a series.
///
/// # Errors
/// If the calibration finds no tweak that is inferior, the engine cannot start or halts, a tweak does not settle, or a file
/// cannot be used.
pub fn run(plan: &SeriesPlan, tell: &ProgressFn<'_>) -> Result<SeriesReport, ExperimentError> {
    let scratch = scratch()?;
    let cache = cache_or_new(plan.cache.as_ref(), scratch.path())?;
    let cell = Cell::of(&SimCells, None)?;
    let profile = Profile::builtin(ProfileName::Sim).map_err(ExperimentError::unexpected)?;
    let calibration = calibrate_or_reuse(plan, &cell, &cache, profile.tries.margin)?;
    let loss = &calibration.loss;
    let loss = [loss.mean, loss.lower, loss.upper];
    tell(&progress::calibration(loss, calibration.episodes, calibration.seed));
    let baseline = commissioned()?;
    let rows = plan.rows.clone().map(RowFile::open).transpose()?;
    let (shard, of) = plan.shard;
    let numbers: Vec<u64> = (0..plan.series).skip(shard).step_by(of.max(1)).collect();
    let series = side_by_side(
        plan.jobs,
        numbers.len(),
        |_, at| {
            let missing = || ExperimentError::Unexpected("a series is missing".to_owned());
            let number = *numbers.get(at).ok_or_else(missing)?;
            let tweaks = (1..=plan.tweaks)
                .map(|place| tweak(&baseline, number, place, calibration.share))
                .collect::<Result<Vec<_>, _>>()?;
            let end = run_or_reuse(&cell, &cache, &profile, number, &tweaks)?;
            if let Some(rows) = &rows {
                rows.add(&calibration, &end)?;
            }
            Ok(end)
        },
        |_, end| progress::series(end),
        tell,
    )?;
    SeriesReport::of(decided_by(holdpoint_sim::BUILD), calibration, series)
}

fn calibrate_or_reuse(
    plan: &SeriesPlan,
    cell: &Cell,
    cache: &ResultCache,
    margin: f64,
) -> Result<Calibration, ExperimentError> {
    let (seed, episodes) = plan.calibration;
    let environment = cell.digest();
    let decided_by = decided_by(holdpoint_sim::BUILD);
    let parts: [&[u8]; 5] = [
        environment.bytes(),
        decided_by.as_bytes(),
        &seed.to_le_bytes(),
        &episodes.to_le_bytes(),
        &margin.to_le_bytes(),
    ];
    let key = Digest::of_parts("holdpoint.series-calibration.v1", &parts);
    if let Some(known) = cached_result::<Calibration>(cache, &key) {
        return Ok(known);
    }
    let calibration = calibrate(cell, plan.calibration, plan.jobs, margin)?;
    cache.put(&key, &serde_json::to_vec(&calibration)?)?;
    Ok(calibration)
}

/// Runs a series, or reads its cached result of an earlier run of the same build.
fn run_or_reuse(
    cell: &Cell,
    cache: &ResultCache,
    profile: &Profile,
    series: u64,
    tweaks: &[Tweak],
) -> Result<SeriesEnd, ExperimentError> {
    let mut parts = vec![
        profile.digest()?.bytes().to_vec(),
        cell.digest().bytes().to_vec(),
        decided_by(holdpoint_sim::BUILD).as_bytes().to_vec(),
        series.to_le_bytes().to_vec(),
    ];
    for Tweak { package, .. } in tweaks {
        for text in [&package.manifest, &package.submission, &package.params] {
            parts.push(text.as_bytes().to_vec());
        }
    }
    let parts: Vec<&[u8]> = parts.iter().map(Vec::as_slice).collect();
    let key = Digest::of_parts("holdpoint.series.v2", &parts);
    if let Some(known) = cached_result::<SeriesEnd>(cache, &key).filter(|known| known.series == series) {
        return Ok(known);
    }
    let end = SeriesEnd { series, tries: run_series(cell, tweaks)? };
    cache.put(&key, &serde_json::to_vec(&end)?)?;
    Ok(end)
}

/// Registers the tweaks one after another on one store, until one is activated.
fn run_series(cell: &Cell, tweaks: &[Tweak]) -> Result<Vec<TryEnd>, ExperimentError> {
    let Some(first) = tweaks.first() else { return Ok(Vec::new()) };
    let store = scratch()?;
    let config = Config {
        data: store.path(),
        profile: ProfileName::Sim.into(),
        seeds: EpisodeSeeds::Secret,
        // The thread that drives the engine runs the episodes as well, so its CPU time is that of the series.
        jobs: 1,
        scripted: true,
        cell: cell.clone(),
        cache: EpisodeCache::InStore,
    };
    let engine = Engine::start_experiment(config, Experiment::default())?;
    let mut drive = CandidateDriver::new(engine, &first.name, first.version.clone());
    let mut ends = Vec::new();
    for tweak in tweaks {
        let began = FigureClock::ThreadCpu.secs();
        drive.turn_to(&tweak.name, tweak.version.clone());
        drive.register(tweak.package.clone())?;
        drive.run_until_settled()?;
        let (view, seen) = drive.take_outcome()?;
        let last = seen.stages.last();
        let end = TryEnd {
            version: tweak.version.clone(),
            pairs: view.pairs.as_ref().map_or(0, |pairs| pairs.n),
            decider: last.map(|last| last.stage),
            codes: last.map(StageRecord::codes).unwrap_or_default(),
            state: seen.state(view.state),
            fate: seen.fate(),
            counted: view.counted,
            effort: seen.effort,
            cpu_secs: FigureClock::ThreadCpu.secs() - began,
        };
        let got_in = end.got_in();
        ends.push(end);
        if got_in {
            break;
        }
    }
    Ok(ends)
}

fn summarize(series: &[SeriesEnd]) -> Result<SeriesSummary, ExperimentError> {
    let all = series.len() as u64;
    let got_in = series.iter().filter(|end| end.tries_until_in().is_some()).count() as u64;
    let mut stopped_by: BTreeMap<String, u64> = BTreeMap::new();
    for (reason, count) in series.iter().flat_map(SeriesEnd::stopped_by) {
        *stopped_by.entry(reason).or_default() += count;
    }
    Ok(SeriesSummary {
        series: all,
        got_in,
        at_most: clopper_pearson_upper(got_in, all, BOUND_ALPHA)?,
        tries: series.iter().map(|end| end.tries.len() as u64).sum(),
        pairs: series.iter().map(SeriesEnd::pairs).sum(),
        cpu_secs: series.iter().map(SeriesEnd::cpu_secs).sum(),
        stopped_by,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::lifecycle::{Stage, State};
    use holdpoint_governance::stats::{PairedCounts, binary_pairs};
    use holdpoint_store::CacheSecret;

    /// Two tweaks that fail in half of their runs: each is another try and is stopped. The second run reads the result.
    #[test]
    fn a_series_of_hopeless_tweaks_is_stopped_try_by_try() {
        let cell = Cell::of(&SimCells, None).unwrap();
        let baseline = commissioned().unwrap();
        let tweaks: Vec<Tweak> = (1..=2).map(|number| tweak(&baseline, 7, number, 0.5).unwrap()).collect();
        let folder = tempfile::tempdir().unwrap();
        let cache = ResultCache::in_folder(folder.path().to_owned(), CacheSecret::fresh().unwrap());
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let run = || run_or_reuse(&cell, &cache, &profile, 7, &tweaks).unwrap();
        let end = run();
        assert_eq!((end.tries.len(), end.tries_until_in()), (2, None));
        for (one, number) in end.tries.iter().zip(1..) {
            assert_eq!(one.fate, Fate::Blocked { stage: Stage::Sandbox }, "{one:?}");
            let counted = one.counted.as_ref().unwrap();
            assert_eq!((counted.by_author, counted.in_family), (number, number));
            assert_eq!(one.decider, Some(Decider::Sandbox));
            assert!(!one.codes.is_empty() && one.pairs > 0 && one.cpu_secs > 0.0, "{one:?}");
        }
        assert_eq!(end.stopped_by().values().sum::<u64>(), 2);
        // CPU times are never equal twice.
        assert_eq!(run(), end);
    }

    fn end(fate: Fate, reason: ReasonCode) -> TryEnd {
        TryEnd {
            version: "grasp@1.1.1".parse().unwrap(),
            counted: None,
            pairs: 100,
            decider: None,
            codes: vec![reason],
            state: ScenarioState::In(State::Rejected),
            fate,
            effort: EpisodeEffort::default(),
            cpu_secs: 0.5,
        }
    }

    #[test]
    fn series_with_a_tweak_that_got_in_are_counted_with_a_bound() {
        let blocked = || end(Fate::Blocked { stage: Stage::Sandbox }, ReasonCode::BehaviorTryOpen);
        let mut series: Vec<SeriesEnd> =
            (0..40).map(|series| SeriesEnd { series, tries: vec![blocked(), blocked()] }).collect();
        let summary = summarize(&series).unwrap();
        assert_eq!((summary.series, summary.got_in, summary.tries, summary.pairs), (40, 0, 80, 8_000));
        // 1 - .05^(1/40)
        assert!((summary.at_most - 0.072_158).abs() < 1e-5, "{}", summary.at_most);
        assert_eq!(summary.stopped_by, BTreeMap::from([("behavior-try-open".to_owned(), 80)]));
        // A version that was activated counts also where it was rolled back later.
        series[3].tries.push(end(Fate::Contained, ReasonCode::BehaviorCompatible));
        assert_eq!(series[3].tries_until_in(), Some(3));
        let summary = summarize(&series).unwrap();
        assert_eq!((summary.got_in, summary.stopped_by["behavior-try-open"]), (1, 80));
        let text = serde_json::to_string(&series[3]).unwrap();
        assert_eq!(serde_json::from_str::<SeriesEnd>(&text).unwrap(), series[3]);
    }

    #[test]
    fn rows_of_two_shards_make_one_report() {
        let loss = binary_pairs(PairedCounts::of((0..50).map(|at| (at < 9, false))), 0.05).unwrap();
        let (episodes, commissioned, tweak) = (50, 50, 41);
        let calibration =
            Calibration { seed: 100, episodes, commissioned, defective: 0, share: 0.18, tweak, loss };
        let folder = tempfile::tempdir().unwrap();
        let files = [0, 1].map(|shard| {
            let file = folder.path().join(format!("{shard}.jsonl"));
            let rows = RowFile::open(file.clone()).unwrap();
            for series in [shard + 2, shard] {
                let blocked = end(Fate::Blocked { stage: Stage::Sandbox }, ReasonCode::BehaviorTryOpen);
                rows.add(&calibration, &SeriesEnd { series, tries: vec![blocked] }).unwrap();
            }
            file
        });
        let reports = reports_of(&files).unwrap();
        let [report] = &reports[..] else { panic!("{reports:?}") };
        assert_eq!(report.calibration, calibration);
        let numbers: Vec<u64> = report.series.iter().map(|end| end.series).collect();
        assert_eq!(numbers, [0, 1, 2, 3]);
        assert_eq!((report.summary.series, report.summary.tries), (4, 4));
    }
}
