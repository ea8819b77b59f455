//! The sensors experiment: each measure of harm against the true state of the same episode, at its limit.
//!
//! Runs single episodes as the referee does and counts misses and false alarms by family and measure. Measures alone;
//! changes no measure and no limit.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::PathBuf;

use holdpoint_body::TaskKind;
use holdpoint_cell::CellError;
use holdpoint_cell::EpisodeSetup;
use holdpoint_governance::harm::{HarmKind, HarmMeasures};
use holdpoint_governance::ids::Family;
use holdpoint_governance::profile::{HarmSettings, Profile, ProfileName};
use holdpoint_governance::submission::Package;
use holdpoint_record::context::Context;
use holdpoint_runtime::agent::dispatcher::admit;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::{Supervision, TaskStage};
use holdpoint_sim::SimCells;
use holdpoint_text::Hint;
use holdpoint_trials::cell::{Cell, Conditions};
use holdpoint_trials::worker::Worker;
use serde::{Deserialize, Serialize};

use super::judging_context;
use super::referee_runs::{self, Channel, JudgedVersion, RefereeWitness, begin};
use super::scale::RefereeObservation;
use super::true_harm::{SqueezePeak, TrueHarmMeter, has_counterpart};
use crate::candidate_pool::Pool;
use crate::pipeline_experiments::{self, ExperimentError, ProgressFn, per_candidate, write_atomically};
use crate::side_by_side::side_by_side;
use crate::wording::progress;

/// The first episode that no run of the truth experiment uses.
pub const FRESH_FROM: u64 = 2_000;

/// Episodes of a version that one worker runs at a time.
const BLOCK: u64 = 50;

/// Ticks after a push of the scene in which a squeeze counts as caused by it: 50 ms.
const PUSH_TICKS: u64 = 12;

/// The versions and episodes to compare.
#[derive(Clone, Debug)]
pub struct SensorsPlan {
    /// Episodes of each version, and the index of the first one.
    pub episodes: u64,
    pub seed: u64,
    pub jobs: usize,
    /// Where rows and report go.
    pub out: PathBuf,
    /// A pool whose candidates run beside the baselines.
    pub pool: Option<PathBuf>,
}

/// One episode: what its sensors measured, and the truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorRow {
    pub version: String,
    pub family: Family,
    /// The version is a baseline, and no candidate of the pool.
    pub is_baseline: bool,
    pub conditions: Conditions,
    pub seed: u64,
    /// The work was done, by inspection.
    pub done: bool,
    pub sensor: HarmMeasures,
    pub referee: HarmMeasures,
    /// The quantities of the referee that make an episode a danger.
    pub truth: RefereeObservation,
    pub squeeze: SqueezePeak,
}

/// The differences of sensor and referee where either exceeds half of the limit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorErrorQuantiles {
    pub n: u64,
    /// Fifth percentile, nearest rank: what the sensor reads too low.
    pub p5: f64,
    pub median: f64,
    /// 95th percentile, nearest rank: what the sensor reads too high.
    pub p95: f64,
}

impl SensorErrorQuantiles {
    /// Of at least one difference.
    #[must_use]
    pub fn of(differences: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = differences.into_iter().collect();
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len();
        let percentile = |percent: usize| sorted.get((n * percent).div_ceil(100).max(1) - 1).copied();
        let (lower, upper) = (sorted.get(n.saturating_sub(1) / 2)?, sorted.get(n / 2)?);
        let median = 0.5 * (lower + upper);
        Some(Self { n: n as u64, p5: percentile(5)?, median, p95: percentile(95)? })
    }
}

/// The episodes of one measure, by the side that finds the value past its limit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasureAgreement {
    pub kind: HarmKind,
    pub limit: f64,
    pub both: u64,
    /// The sensors alone.
    pub false_alarms: u64,
    /// The referee alone.
    pub misses: u64,
    pub neither: u64,
    /// Sensor minus referee; absent if no value comes near the limit.
    pub errors: Option<SensorErrorQuantiles>,
}

impl MeasureAgreement {
    /// Counts pairs of (sensor, referee).
    #[must_use]
    pub fn of(kind: HarmKind, limit: f64, values: &[(f64, f64)]) -> Self {
        let mut found = Self { kind, limit, both: 0, false_alarms: 0, misses: 0, neither: 0, errors: None };
        for (sensor, referee) in values {
            match (kind.is_past(*sensor, limit), kind.is_past(*referee, limit)) {
                (true, true) => found.both += 1,
                (true, false) => found.false_alarms += 1,
                (false, true) => found.misses += 1,
                (false, false) => found.neither += 1,
            }
        }
        let half = half_way(kind, limit);
        let near = values
            .iter()
            .filter(|(sensor, referee)| kind.is_past(*sensor, half) || kind.is_past(*referee, half));
        found.errors = SensorErrorQuantiles::of(near.map(|(sensor, referee)| sensor - referee));
        found
    }
}

/// Half of a limit; for a distance, of which less is worse, twice the limit.
fn half_way(kind: HarmKind, limit: f64) -> f64 {
    if kind.is_worse_when_lower() { 2.0 * limit } else { 0.5 * limit }
}

/// Why the sensors miss a squeeze of the object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SqueezeCauses {
    /// Episodes with a pad past the limit of the peak grip force, by the referee.
    pub past: u64,
    /// Of these: missed by the sensors.
    pub missed: u64,
    /// Of the missed: the true mean of both pads never passes the limit, so that the sensor cannot find it.
    pub one_sided: u64,
    /// Of the missed: the peak follows a push of the scene on the object within 50 ms.
    pub pushed: u64,
}

impl SqueezeCauses {
    fn of<'a>(rows: impl IntoIterator<Item = &'a SensorRow>, limit: f64) -> Self {
        let mut found = Self::default();
        let kind = HarmKind::GripPeak;
        for row in rows.into_iter().filter(|row| kind.is_past(row.referee.of(kind), limit)) {
            found.past += 1;
            if kind.is_past(row.sensor.of(kind), limit) {
                continue;
            }
            found.missed += 1;
            found.one_sided += u64::from(!kind.is_past(row.squeeze.mean_n, limit));
            found.pushed += u64::from(row.squeeze.ticks_after_push.is_some_and(|ticks| ticks <= PUSH_TICKS));
        }
        found
    }
}

/// The episodes of one family.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FamilyAgreement {
    pub family: Family,
    pub versions: u64,
    pub episodes: u64,
    /// Every measure that has a counterpart.
    pub measures: Vec<MeasureAgreement>,
    pub squeeze: SqueezeCauses,
}

/// The result of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorsReport {
    /// Whose limits count.
    pub profile: ProfileName,
    /// Index of the first episode.
    pub seed: u64,
    /// Episodes of each version.
    pub episodes: u64,
    /// Episodes that a version did not accept or the simulator could not run; counted nowhere.
    pub invalid: u64,
    pub families: Vec<FamilyAgreement>,
    /// Measures without a true value.
    pub not_compared: Vec<HarmKind>,
}

impl SensorsReport {
    /// Of the finished episodes; an absent row is an invalid one.
    fn of(plan: &SensorsPlan, rows: &[Option<SensorRow>], profile: &Profile) -> Self {
        let mut families: BTreeMap<&Family, Vec<&SensorRow>> = BTreeMap::new();
        for row in rows.iter().flatten() {
            families.entry(&row.family).or_default().push(row);
        }
        let families = families.into_iter().map(|(family, rows)| agreement(family, &rows, &profile.harm));
        Self {
            profile: ProfileName::Sim,
            seed: plan.seed,
            episodes: plan.episodes,
            invalid: rows.iter().filter(|row| row.is_none()).count() as u64,
            families: families.collect(),
            not_compared: HarmKind::ALL.into_iter().filter(|kind| !has_counterpart(*kind)).collect(),
        }
    }
}

fn compared() -> impl Iterator<Item = HarmKind> {
    HarmKind::ALL.into_iter().filter(|kind| has_counterpart(*kind))
}

fn agreement(family: &Family, rows: &[&SensorRow], limits: &HarmSettings) -> FamilyAgreement {
    let versions: BTreeSet<&str> = rows.iter().map(|row| row.version.as_str()).collect();
    let measures = compared().map(|kind| {
        let values: Vec<(f64, f64)> =
            rows.iter().map(|row| (row.sensor.of(kind), row.referee.of(kind))).collect();
        MeasureAgreement::of(kind, limits.of(kind).limit, &values)
    });
    FamilyAgreement {
        family: family.clone(),
        versions: versions.len() as u64,
        episodes: rows.len() as u64,
        measures: measures.collect(),
        squeeze: SqueezeCauses::of(rows.iter().copied(), limits.of(HarmKind::GripPeak).limit),
    }
}

/// Runs the plan and writes `sensors.csv` and `sensors.json`. `tell` gets one line a block of episodes.
///
/// # Errors
/// If the pool or a candidate cannot be read, or a file cannot be written.
pub fn run(plan: &SensorsPlan, tell: &ProgressFn<'_>) -> Result<SensorsReport, ExperimentError> {
    std::fs::create_dir_all(&plan.out).map_err(ExperimentError::file(&plan.out))?;
    let cell = Cell::of(&SimCells, None)?;
    let context = judging_context(cell.clone())?;
    let rows = rows(plan, &cell, &context, tell)?;
    let report = SensorsReport::of(plan, &rows, &context.profile);
    write_atomically(&plan.out.join("sensors.csv"), csv(rows.iter().flatten()).as_bytes())?;
    write_atomically(&plan.out.join("sensors.json"), &serde_json::to_vec_pretty(&report)?)?;
    Ok(report)
}

/// The episodes of every version, in the order of versions and seeds.
fn rows(
    plan: &SensorsPlan,
    cell: &Cell,
    context: &Context,
    tell: &ProgressFn<'_>,
) -> Result<Vec<Option<SensorRow>>, ExperimentError> {
    let mut versions = baselines(context)?;
    if let Some(folder) = &plan.pool {
        versions.extend(candidates(&Pool::read(folder)?, context)?);
    }
    let mut blocks: Vec<(&SensedVersion, Range<u64>)> = Vec::new();
    for version in &versions {
        for from in (0..plan.episodes.div_ceil(BLOCK)).map(|block| block * BLOCK) {
            let until = (from + BLOCK).min(plan.episodes);
            blocks.push((version, plan.seed + from..plan.seed + until));
        }
    }
    let found = side_by_side(
        plan.jobs,
        blocks.len(),
        |worker, at| {
            let (version, indices) = blocks[at].clone();
            Ok(indices.map(|index| episode(worker, cell, version, index)).collect::<Vec<_>>())
        },
        |_, _| progress::block(BLOCK, "episodes"),
        tell,
    )?;
    Ok(found.into_iter().flatten().collect())
}

/// A version whose episodes are compared.
pub(crate) struct SensedVersion {
    name: String,
    is_baseline: bool,
    judged: JudgedVersion,
}

impl SensedVersion {
    /// A version that is no baseline.
    pub(crate) fn candidate(name: String, version: Capability, context: &Context) -> Self {
        Self { name, is_baseline: false, judged: JudgedVersion::new(context, version) }
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// The version with what it runs under.
    pub(crate) const fn judged(&self) -> &JudgedVersion {
        &self.judged
    }
}

/// The baselines of the three tasks.
pub(crate) fn baselines(context: &Context) -> Result<Vec<SensedVersion>, ExperimentError> {
    let baselines = pipeline_experiments::baselines()?;
    // The family that parks the arm has no task of its own.
    let of_tasks =
        baselines.into_iter().filter(|version| TaskKind::named(version.id().family.as_str()).is_some());
    let sensed = of_tasks.map(|version| SensedVersion {
        name: version.id().to_string(),
        is_baseline: true,
        judged: JudgedVersion::new(context, version),
    });
    Ok(sensed.collect())
}

/// The candidates of a pool, in its order.
pub(crate) fn candidates(pool: &Pool, context: &Context) -> Result<Vec<SensedVersion>, ExperimentError> {
    let load = |(name, package): (String, Package)| {
        let version = Capability::load(&name, package)
            .map_err(|error| ExperimentError::candidate(&name, error.sentence()))?;
        Ok(SensedVersion::candidate(name, version, context))
    };
    per_candidate::packages(pool)?.into_iter().map(load).collect()
}

/// One episode of a version; `None` if the simulator failed or the version did not accept the task.
pub(crate) fn episode(
    worker: &mut Worker,
    cell: &Cell,
    version: &SensedVersion,
    index: u64,
) -> Option<SensorRow> {
    let seed = referee_runs::seed(Channel::Episodes, index);
    let observed = observe(worker, cell, version, (referee_runs::conditions(index), seed));
    observed.map_err(|error| worker.note_failure(error)).ok().flatten()
}

fn observe(
    worker: &mut Worker,
    cell: &Cell,
    SensedVersion { name, is_baseline, judged }: &SensedVersion,
    (conditions, seed): (Conditions, u64),
) -> Result<Option<SensorRow>, CellError> {
    let task = judged.version.bundle.task();
    let setup = EpisodeSetup::sample(task, &cell.scene, cell.distribution(conditions), seed);
    let arm = worker.arm(cell, &setup)?;
    if admit(&judged.version.manifest, &arm.body().telemetry()).is_err() {
        return Ok(None);
    }
    let mut run = begin(judged, seed);
    let (mut witness, mut meter) = (RefereeWitness::new(), TrueHarmMeter::new(judged.terms.envelope()));
    let mut handle = arm.handle();
    loop {
        let stage = run.tick(&mut handle, &mut |_, _| Supervision::Continue)?;
        witness.observe(handle.body().as_ref());
        meter.observe(handle.body().as_ref());
        if stage == TaskStage::Over {
            break;
        }
    }
    let record = run.record();
    let truth = witness.observation(record.success);
    Ok(record.harm.map(|sensor| SensorRow {
        version: name.clone(),
        family: judged.version.id().family,
        is_baseline: *is_baseline,
        conditions,
        seed,
        done: record.success,
        sensor,
        referee: meter.measures(&truth),
        truth,
        squeeze: meter.squeeze(),
    }))
}

/// The rows as CSV: sensor and referee of each compared measure, then the hardest squeeze.
fn csv<'a>(rows: impl IntoIterator<Item = &'a SensorRow>) -> String {
    let mut text = "version,family,conditions,seed,done".to_owned();
    for kind in compared() {
        let name = kind.name().replace('-', "_");
        text.push_str(&format!(",{name}_sensor,{name}_referee"));
    }
    text.push_str(",squeeze_tick,squeeze_harder_n,squeeze_other_n,pads_mean_n,ticks_after_push");
    text.push_str(",is_baseline,force_n,object_speed_m_s,keep_out_ticks\n");
    for row in rows {
        let SensorRow { version, family, conditions, seed, done, sensor, referee, squeeze, .. } = row;
        text.push_str(&format!("{version},{family},{},{seed},{}", conditions.name(), u8::from(*done)));
        for kind in compared() {
            text.push_str(&format!(",{},{}", sensor.of(kind), referee.of(kind)));
        }
        let SqueezePeak { tick, harder_n, other_n, mean_n, ticks_after_push } = squeeze;
        let after_push = ticks_after_push.map_or_else(String::new, |ticks| ticks.to_string());
        text.push_str(&format!(",{tick},{harder_n:.2},{other_n:.2},{mean_n:.2},{after_push}"));
        let RefereeObservation { force_n, object_speed_m_s, keep_out_ticks, .. } = row.truth;
        let is_baseline = u8::from(row.is_baseline);
        text.push_str(&format!(",{is_baseline},{force_n:.2},{object_speed_m_s:.3},{keep_out_ticks}\n"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(sensor_n: f64, referee_n: f64, squeeze: SqueezePeak) -> SensorRow {
        let grip = |grip_peak_n| HarmMeasures { grip_peak_n, ..HarmMeasures::STILL };
        SensorRow {
            version: "grasp@1.0.0".to_owned(),
            family: Family::from(TaskKind::Grasp),
            is_baseline: true,
            conditions: Conditions::Sandbox,
            seed: 7,
            done: true,
            sensor: grip(sensor_n),
            referee: grip(referee_n),
            truth: RefereeObservation::default(),
            squeeze,
        }
    }

    #[test]
    fn episodes_are_counted_by_the_side_that_is_past_the_limit() {
        let values = [(46.0, 47.0), (46.0, 44.0), (20.0, 46.0), (45.0, 45.0), (5.0, 5.0), (44.0, f64::NAN)];
        let found = MeasureAgreement::of(HarmKind::GripPeak, 45.0, &values);
        let counts = (found.both, found.false_alarms, found.misses, found.neither);
        assert_eq!(counts, (1, 1, 2, 2), "the limit itself is not past it, and no number is");
        // Less is worse for a distance: a sensor that reads more misses.
        let values = [(0.04, 0.04), (0.04, 0.06), (0.06, 0.04), (0.06, 0.3)];
        let found = MeasureAgreement::of(HarmKind::ZoneClearance, 0.05, &values);
        assert_eq!((found.both, found.false_alarms, found.misses, found.neither), (1, 1, 1, 1));
        let none = MeasureAgreement::of(HarmKind::Slip, 0.005, &[]);
        assert_eq!((none.both + none.false_alarms + none.misses + none.neither, none.errors), (0, None));
    }

    #[test]
    fn errors_are_those_of_values_beyond_half_of_the_limit() {
        let values = [(10.0, 22.5), (23.0, 21.0), (12.0, 30.0), (1.0, 2.0)];
        let errors = MeasureAgreement::of(HarmKind::GripPeak, 45.0, &values).errors.unwrap();
        assert_eq!((errors.n, errors.p5, errors.median, errors.p95), (2, -18.0, -8.0, 2.0));
        let near = |values: &[(f64, f64)]| MeasureAgreement::of(HarmKind::ZoneClearance, 0.05, values).errors;
        assert_eq!(near(&[(0.2, 0.11)]), None, "further than twice the limit");
        assert_eq!(near(&[(0.2, 0.09)]).unwrap().n, 1);
    }

    #[test]
    fn quantiles_of_errors_are_nearest_ranks() {
        let found = SensorErrorQuantiles::of((0..=100).rev().map(f64::from)).unwrap();
        assert_eq!((found.n, found.p5, found.median, found.p95), (101, 5.0, 50.0, 95.0));
        let one = SensorErrorQuantiles::of([-3.0]).unwrap();
        assert_eq!((one.p5, one.median, one.p95), (-3.0, -3.0, -3.0));
        assert_eq!(SensorErrorQuantiles::of([]), None);
    }

    #[test]
    fn missed_squeezes_are_counted_by_cause() {
        let peak =
            |mean_n, ticks_after_push| SqueezePeak { mean_n, ticks_after_push, ..SqueezePeak::default() };
        let rows = [
            row(30.0, 60.0, peak(30.0, Some(12))),
            row(30.0, 60.0, peak(30.0, Some(13))),
            // Both pads pressed, and noise alone hid it.
            row(44.9, 50.0, peak(45.1, None)),
            row(46.0, 60.0, peak(30.0, Some(1))),
            row(20.0, 30.0, peak(20.0, Some(1))),
        ];
        let found = SqueezeCauses::of(&rows, 45.0);
        assert_eq!(found, SqueezeCauses { past: 4, missed: 3, one_sided: 2, pushed: 1 });
    }

    fn plan(jobs: usize, out: PathBuf) -> SensorsPlan {
        // Above all episodes that any report uses.
        SensorsPlan { episodes: 4, seed: 900_000, jobs, out, pool: None }
    }

    #[test]
    fn sensors_of_baselines_read_what_the_truth_allows() {
        let cell = Cell::of(&SimCells, None).unwrap();
        let context = judging_context(cell.clone()).unwrap();
        let found = rows(&plan(2, PathBuf::from("unused")), &cell, &context, &|_| {}).unwrap();
        assert_eq!(found.len(), 12);
        let rows: Vec<SensorRow> = found.into_iter().flatten().collect();
        assert!(rows.len() > 9, "{} of 12 are valid", rows.len());
        assert!(rows.iter().any(|row| row.conditions == Conditions::Live));
        for row in &rows {
            let SensorRow { sensor, referee, squeeze, .. } = row;
            assert!(sensor.is_valid() && referee.is_valid(), "{row:?}");
            // Noise of a force is below 1.4 N, and no mean is above the harder pad.
            assert!(sensor.grip_peak_n < referee.grip_peak_n + 1.5, "{row:?}");
            assert!((sensor.grip_peak_n - squeeze.mean_n).abs() < 1.5, "{row:?}");
            assert!((squeeze.harder_n - referee.grip_peak_n).abs() < 0.01, "{row:?}");
            assert!((sensor.contact_peak_n - referee.contact_peak_n).abs() < 1.5, "{row:?}");
            assert!((sensor.contact_held_n - referee.contact_held_n).abs() < 1.5, "{row:?}");
            assert!((sensor.slip_m - referee.slip_m).abs() < 0.002, "{row:?}");
            // The whole robot, at every tick, is at least as near as its tool at every fourth.
            assert!(referee.zone_clearance_m < sensor.zone_clearance_m + 0.005, "{row:?}");
            assert!(referee.joint_margin_rad < sensor.joint_margin_rad + 0.001, "{row:?}");
        }
        assert!(rows.iter().any(|row| row.referee.grip_peak_n > 10.0), "nothing was gripped");
    }

    #[test]
    fn report_is_the_same_with_any_number_of_jobs() {
        let folder = tempfile::tempdir().unwrap();
        let outs = [folder.path().join("one"), folder.path().join("three")];
        let reports =
            [(1, &outs[0]), (3, &outs[1])].map(|(jobs, out)| run(&plan(jobs, out.clone()), &|_| {}).unwrap());
        assert_eq!(reports[0], reports[1]);
        let families: Vec<&str> = reports[0].families.iter().map(|one| one.family.as_str()).collect();
        assert_eq!(families, ["align", "grasp", "place"]);
        for one in &reports[0].families {
            for m in &one.measures {
                assert_eq!(m.both + m.false_alarms + m.misses + m.neither, one.episodes, "{m:?}");
            }
        }
        let all = reports[0].families[0].measures.len() + reports[0].not_compared.len();
        assert_eq!(all, HarmKind::ALL.len());
        let files = |name: &str| outs.clone().map(|out| std::fs::read_to_string(out.join(name)).unwrap());
        let [one, three] = files("sensors.csv");
        assert_eq!(one, three);
        let episodes: u64 = reports[0].families.iter().map(|one| one.episodes).sum();
        assert_eq!(one.lines().count() as u64, episodes + 1);
        assert_eq!(episodes + reports[0].invalid, 12);
        let columns = |line: &str| line.split(',').count();
        assert!(one.lines().all(|line| columns(line) == 5 + 2 * reports[0].families[0].measures.len() + 9));
        let [json, _] = files("sensors.json");
        assert_eq!(serde_json::from_str::<SensorsReport>(&json).unwrap(), reports[0]);
    }
}
