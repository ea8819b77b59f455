//! Demonstrations over run seeds: in how many runs does a candidate keep its outcome?
//!
//! Each candidate goes through the stages on a new store, once for each run seed and profile. Approvers agree to everything.
//! Its outcome is the state that most of its runs end in. A finished run is cached; the episodes of active versions are
//! shared by the runs of one seed only, so that a long experiment leaves one file a run.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::candidate_run::{CandidateEnd, ThresholdScale};
use super::per_candidate::{CandidateJob, run_or_reuse_beside};
use super::{ExperimentError, ProgressFn, scratch, write_atomically};
use crate::side_by_side::side_by_side;
use crate::wording::progress;
use holdpoint_engine::Experiment;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::{Interval, clopper_pearson};
use holdpoint_governance::submission::Package;
use holdpoint_protocol::scenario_state::{Decider, ScenarioState};
use holdpoint_sim::SimCells;
use holdpoint_store::{CacheSecret, ResultCache};
use holdpoint_trials::cell::Cell;

/// The share of runs in which a demonstration has to keep its outcome.
pub const AIM: f64 = 0.999;

/// The level of the interval of that share.
const LEVEL: f64 = 0.95;

/// The plan of a run.
#[derive(Clone, Debug)]
pub struct DemonstrationsPlan {
    /// The candidates with their names.
    pub candidates: Vec<(String, Package)>,
    pub profiles: Vec<ProfileName>,
    /// The first run seed.
    pub seed: u64,
    /// The number of run seeds.
    pub runs: u64,
    pub jobs: usize,
    /// Where the report goes.
    pub out: PathBuf,
    /// Where finished runs are cached.
    pub cache: ResultCache,
}

/// The result of one run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DemonstrationRun {
    pub name: String,
    pub profile: ProfileName,
    pub seed: u64,
    /// `confirmed`, or the lifecycle state it stayed in.
    pub state: ScenarioState,
    /// The last decision about it: who decided, and the first reason.
    pub decider: Option<Decider>,
    pub reason: Option<ReasonCode>,
}

impl DemonstrationRun {
    fn of(end: CandidateEnd) -> Self {
        let last = end.stages.last();
        Self {
            decider: last.map(|last| last.stage),
            reason: last.and_then(|last| last.reasons.first()).map(|reason| reason.code),
            name: end.name,
            profile: end.profile,
            seed: end.seed,
            state: end.state,
        }
    }

    /// The state with the last decision.
    fn ending(&self) -> String {
        let decider = self.decider.map_or_else(String::new, |decider| format!(" {decider}"));
        let reason = self.reason.map_or_else(String::new, |reason| format!(" {reason}"));
        format!("{}{decider}{reason}", self.state)
    }
}

/// A candidate under one profile over all run seeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DemonstrationSummary {
    pub name: String,
    pub profile: ProfileName,
    /// The state that most runs ended in.
    pub outcome: ScenarioState,
    pub runs: u64,
    /// The runs that ended in it.
    pub kept: u64,
    /// Their share, with exact bounds (Clopper and Pearson, 95 %).
    pub share: Interval,
    /// The seeds of the other runs.
    pub other_seeds: Vec<u64>,
    /// Runs by state, decider and first reason.
    pub endings: BTreeMap<String, u64>,
}

impl DemonstrationSummary {
    fn of(runs: &[&DemonstrationRun]) -> Result<Self, ExperimentError> {
        let mut states: BTreeMap<&str, u64> = BTreeMap::new();
        let mut endings: BTreeMap<String, u64> = BTreeMap::new();
        for run in runs {
            *states.entry(run.state.name()).or_default() += 1;
            *endings.entry(run.ending()).or_default() += 1;
        }
        let commonest = runs.iter().max_by_key(|run| states.get(run.state.name()));
        let Some(commonest) = commonest else {
            return Err(ExperimentError::Unexpected("a demonstration has no run".to_owned()));
        };
        let outcome = commonest.state;
        let others = runs.iter().filter(|run| run.state != outcome);
        let other_seeds: Vec<u64> = others.map(|run| run.seed).collect();
        let all = runs.len() as u64;
        let kept = all - other_seeds.len() as u64;
        Ok(Self {
            name: commonest.name.clone(),
            profile: commonest.profile,
            outcome,
            runs: all,
            kept,
            share: clopper_pearson(kept, all, LEVEL)?,
            other_seeds,
            endings,
        })
    }

    /// Whether the measured share is at least [`AIM`]. Fewer than 1,000 runs without another outcome show little: see the
    /// bounds.
    #[must_use]
    pub fn reaches_aim(&self) -> bool {
        self.kept as f64 >= AIM * self.runs as f64
    }
}

/// The result of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DemonstrationsReport {
    /// The first run seed.
    pub seed: u64,
    /// By profile and candidate.
    pub summary: Vec<DemonstrationSummary>,
    /// By seed, profile and candidate.
    pub runs: Vec<DemonstrationRun>,
}

/// Runs what is missing and writes `demonstrations.json`. `tell` gets one line a run seed.
///
/// # Errors
/// If a file cannot be used, or a candidate does not come to an end.
pub fn run(
    plan: &DemonstrationsPlan,
    tell: &ProgressFn<'_>,
) -> Result<DemonstrationsReport, ExperimentError> {
    std::fs::create_dir_all(&plan.out).map_err(ExperimentError::file(&plan.out))?;
    let cell = Cell::of(&SimCells, None)?;
    let seeds = side_by_side(
        plan.jobs,
        usize::try_from(plan.runs).unwrap_or(usize::MAX),
        |_, at| run_seed(plan, &cell, plan.seed + at as u64),
        |_, runs| progress::demonstrations(runs),
        tell,
    )?;
    let runs: Vec<DemonstrationRun> = seeds.into_iter().flatten().collect();
    let report = DemonstrationsReport { seed: plan.seed, summary: summarize(plan, &runs)?, runs };
    write_atomically(&plan.out.join("demonstrations.json"), &serde_json::to_vec_pretty(&report)?)?;
    Ok(report)
}

/// All candidates under all profiles with one run seed.
fn run_seed(
    plan: &DemonstrationsPlan,
    cell: &Cell,
    seed: u64,
) -> Result<Vec<DemonstrationRun>, ExperimentError> {
    let folder = scratch()?;
    let episodes = ResultCache::in_folder(folder.path().to_owned(), CacheSecret::fresh()?);
    let mut runs = Vec::new();
    for profile in &plan.profiles {
        for (name, package) in &plan.candidates {
            let job = CandidateJob {
                name,
                package,
                profile: *profile,
                seed,
                experiment: Experiment::default(),
                thresholds: ThresholdScale::AsTheyAre,
                workers: 1,
            };
            runs.push(DemonstrationRun::of(run_or_reuse_beside(cell, (&plan.cache, &episodes), &job)?));
        }
    }
    Ok(runs)
}

fn summarize(
    plan: &DemonstrationsPlan,
    runs: &[DemonstrationRun],
) -> Result<Vec<DemonstrationSummary>, ExperimentError> {
    let mut summaries = Vec::new();
    for profile in &plan.profiles {
        for (name, _) in &plan.candidates {
            let own = runs.iter().filter(|run| run.name == *name && run.profile == *profile);
            summaries.push(DemonstrationSummary::of(&own.collect::<Vec<_>>())?);
        }
    }
    Ok(summaries)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline_experiments::embedded_package;
    use holdpoint_governance::lifecycle::State;

    fn ended(seed: u64, state: ScenarioState) -> DemonstrationRun {
        DemonstrationRun {
            name: "align-improved".to_owned(),
            profile: ProfileName::Sim,
            seed,
            state,
            decider: Some(Decider::Sandbox),
            reason: Some(ReasonCode::BehaviorEstablishedWorse),
        }
    }

    #[test]
    fn outcome_is_the_commonest_state_and_its_share_has_exact_bounds() {
        let mut runs: Vec<DemonstrationRun> =
            (0..1_000).map(|seed| ended(seed, ScenarioState::Confirmed)).collect();
        let summary =
            |runs: &[DemonstrationRun]| DemonstrationSummary::of(&runs.iter().collect::<Vec<_>>()).unwrap();
        let all = summary(&runs);
        assert_eq!((all.outcome, all.kept, all.runs), (ScenarioState::Confirmed, 1_000, 1_000));
        // .025^(1/1000)
        assert!((all.share.lower - 0.996_318).abs() < 1e-5, "{:?}", all.share);
        assert!(all.reaches_aim());
        runs[26].state = ScenarioState::In(State::Rejected);
        let one_other = summary(&runs);
        assert_eq!(one_other.kept, 999);
        assert_eq!(one_other.other_seeds, [26]);
        assert_eq!(one_other.endings.values().copied().collect::<Vec<_>>(), [999, 1]);
        assert!(one_other.reaches_aim());
        runs[27].state = ScenarioState::In(State::Rejected);
        assert!(!summary(&runs).reaches_aim());
    }

    /// A candidate that breaks its interface is rejected before its first episode. The second run reads the results.
    #[test]
    fn finished_runs_are_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let (kept, out) = (folder.path().join("runs"), folder.path().join("out"));
        let name = "grasp-tool-frame";
        let plan = DemonstrationsPlan {
            candidates: vec![(name.to_owned(), embedded_package(name).unwrap())],
            profiles: vec![ProfileName::Sim],
            seed: 10_000,
            runs: 2,
            jobs: 2,
            out: out.clone(),
            cache: ResultCache::in_folder(kept.clone(), CacheSecret::fresh().unwrap()),
        };
        let report = run(&plan, &|_| ()).unwrap();
        let summary = &report.summary[0];
        assert_eq!((summary.outcome, summary.kept), (ScenarioState::In(State::Rejected), 2));
        assert_eq!(report.runs[0].decider, Some(Decider::Validation));
        let files = || std::fs::read_dir(&kept).unwrap().count();
        let before = files();
        assert!(before > 0);
        assert_eq!(run(&plan, &|_| ()).unwrap(), report);
        assert_eq!(files(), before);
        let written = std::fs::read(out.join("demonstrations.json")).unwrap();
        assert_eq!(serde_json::from_slice::<DemonstrationsReport>(&written).unwrap(), report);
    }
}
