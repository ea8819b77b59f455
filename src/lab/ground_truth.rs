//! The ground truth of candidates, from the referee over many episodes, and how decisions compare with it.
//!
//! Owns the truth experiment: the scale of harm, the runs, when a question is settled, and the score. Recipes' labels
//! are no part of it. [`sensors`] compares the measures of harm with the truth. No decision sees any of it.

mod classify;
mod referee_runs;
mod roc;
mod scale;
mod score;
pub mod sensors;
mod true_harm;

use serde::{Deserialize, Serialize};

pub use self::classify::{
    ALPHA, ALPHA_EACH, ChannelTruth, ClassTruth, LOOKS, Settled, VersionHarm, WorseTruth,
};
pub use self::referee_runs::Channel;
pub(crate) use self::referee_runs::{ActiveTeam, JudgedVersion, observe_sequence};
pub use self::roc::{Roc, RocBy, RocPoint};
pub use self::scale::{HarmClass, HarmScale, HarmThreshold, RefereeObservation, TEXT, WorseBy};
pub use self::score::{ClassScore, ErrorTarget, ProfileScore};
pub use self::true_harm::{SqueezePeak, has_counterpart};
use crate::candidate_pool::Pool;
use crate::pipeline_experiments::candidate_run::{CandidateEnd, ThresholdScale};
use crate::pipeline_experiments::per_candidate::{self, CandidateJob, RunPlan};
use crate::pipeline_experiments::{
    ExperimentError, ProgressFn, baselines, cache_or_new, cached_result, scratch,
};
use crate::side_by_side::side_by_side;
use crate::wording::progress;
use holdpoint_engine::Experiment;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_record::context::Context;
use holdpoint_runtime::capability::Capability;
use holdpoint_sim::SimCells;
use holdpoint_store::ResultCache;
use holdpoint_text::Hint;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::worker::Worker;

/// Pairs of whole sequences, of stops and of rollbacks; each run once.
const PAIRS: u64 = 100;

/// Items that are cached together.
const BLOCK: u64 = 100;

/// The candidates to judge, and the most effort.
#[derive(Clone, Debug)]
pub struct TruthPlan {
    /// The pool and the decisions about it. The truth is measured under the least strict profile.
    pub run: RunPlan,
    /// The most pairs of episodes of a candidate; one of [`LOOKS`].
    pub most: u64,
    /// Every `of`-th candidate from the `shard`-th on.
    pub shard: (usize, usize),
}

/// The truth of one candidate, and its end under each profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CandidateTruth {
    pub name: String,
    pub truth: VersionHarm,
    pub ends: Vec<CandidateEnd>,
}

/// The result of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TruthReport {
    /// Digest of the scale's text.
    pub scale: Digest,
    pub candidates: Vec<CandidateTruth>,
    pub scores: Vec<ProfileScore>,
}

/// The data for the runs of one candidate.
pub(crate) struct TruthBench {
    most: u64,
    cell: Cell,
    cache: ResultCache,
    scale: HarmScale,
    context: Context,
    team: ActiveTeam,
}

/// Runs the plan. `tell` gets one line a candidate.
///
/// # Errors
/// If the pool cannot be read, a candidate cannot be loaded or does not come to an end, or a cached result cannot be
/// written.
pub fn run(plan: &TruthPlan, tell: &ProgressFn<'_>) -> Result<TruthReport, ExperimentError> {
    let pool = Pool::read(&plan.run.pool)?;
    let (shard, of) = plan.shard;
    let packages: Vec<_> = per_candidate::packages(&pool)?
        .into_iter()
        .enumerate()
        .filter(|(index, _)| index % of.max(1) == shard)
        .collect();
    let scratch = scratch()?;
    let bench = TruthBench::new(plan, scratch.path())?;
    let candidates = side_by_side(
        plan.run.jobs,
        packages.len(),
        |worker, at| {
            let (index, (name, package)) = &packages[at];
            let version = Capability::load(name, package.clone())
                .map_err(|error| ExperimentError::candidate(name, error.sentence()))?;
            let truth = bench.truth(worker, bench.judged_version(version))?;
            let seed = plan.run.seed + *index as u64 % plan.run.blocks.max(1);
            let decide = |&profile: &ProfileName| {
                let (experiment, thresholds) = (Experiment::default(), ThresholdScale::AsTheyAre);
                let job = CandidateJob { name, package, profile, seed, experiment, thresholds, workers: 1 };
                per_candidate::run_or_reuse(&bench.cell, &bench.cache, &job)
            };
            let ends = plan.run.profiles.iter().map(decide).collect::<Result<_, _>>()?;
            Ok(CandidateTruth { name: name.clone(), truth, ends })
        },
        |_, one| progress::truth(one),
        tell,
    )?;
    let score = |&profile: &ProfileName| ProfileScore::of(profile, &candidates);
    let scores = plan.run.profiles.iter().map(score).collect::<Result<_, _>>()?;
    Ok(TruthReport {
        scale: Digest::of_parts("holdpoint.harm-scale.v1", &[TEXT.as_bytes()]),
        candidates,
        scores,
    })
}

impl TruthBench {
    fn new(plan: &TruthPlan, scratch: &std::path::Path) -> Result<Self, ExperimentError> {
        let cache = cache_or_new(plan.run.cache.as_ref(), scratch)?;
        let baselines = baselines()?;
        Self::with_team(Cell::of(&SimCells, None)?, cache, baselines, plan.most)
    }

    /// Where versions are judged beside `team`, the active ones, up to `most` pairs of episodes.
    pub(crate) fn with_team(
        cell: Cell,
        cache: ResultCache,
        team: Vec<Capability>,
        most: u64,
    ) -> Result<Self, ExperimentError> {
        let context = judging_context(cell.clone())?;
        let scale = HarmScale::builtin().map_err(ExperimentError::unexpected)?;
        let mut bench = Self { most, cell, cache, scale, context, team: Vec::new() };
        bench.team = team.into_iter().map(|version| bench.judged_version(version)).collect();
        Ok(bench)
    }

    /// A version with what it runs under.
    pub(crate) fn judged_version(&self, version: Capability) -> JudgedVersion {
        JudgedVersion::new(&self.context, version)
    }

    /// The referee's verdict on a candidate, beside the active version of its family.
    pub(crate) fn truth(
        &self,
        worker: &mut Worker,
        candidate: JudgedVersion,
    ) -> Result<VersionHarm, ExperimentError> {
        let family = candidate.version.id().family;
        let before =
            self.team.iter().find(|one| one.version.id().family == family).ok_or_else(|| {
                ExperimentError::Unexpected(format!("there is no active version of {family}"))
            })?;
        let sequences = self.channel(worker, &candidate, before, Channel::Sequences, PAIRS)?;
        let stops = self.channel(worker, &candidate, before, Channel::Stops, PAIRS)?;
        let rollbacks = self.channel(worker, &candidate, before, Channel::Rollbacks, PAIRS)?;
        let mut truth = VersionHarm::of(Vec::new());
        for look in LOOKS.into_iter().filter(|look| *look <= self.most) {
            let episodes = self.channel(worker, &candidate, before, Channel::Episodes, look)?;
            truth = VersionHarm::of(vec![episodes, sequences.clone(), stops.clone(), rollbacks.clone()]);
            if !truth.is_open() {
                break;
            }
        }
        Ok(truth)
    }

    fn channel(
        &self,
        worker: &mut Worker,
        candidate: &JudgedVersion,
        before: &JudgedVersion,
        channel: Channel,
        wanted: u64,
    ) -> Result<ChannelTruth, ExperimentError> {
        let (new, old) =
            (self.items(worker, candidate, channel, wanted)?, self.items(worker, before, channel, wanted)?);
        let pairs: Vec<(RefereeObservation, RefereeObservation)> =
            new.into_iter().zip(old).filter_map(|(new, old)| Some((new?, old?))).collect();
        Ok(ChannelTruth::of(channel, &self.scale, &pairs)?)
    }

    /// The first items of a channel, block by block, each run or read from the cache.
    fn items(
        &self,
        worker: &mut Worker,
        judged: &JudgedVersion,
        channel: Channel,
        wanted: u64,
    ) -> Result<Vec<Option<RefereeObservation>>, ExperimentError> {
        let mut items = Vec::new();
        for block in 0..wanted.div_ceil(BLOCK) {
            let key = self.key(judged, channel, block);
            let range = block * BLOCK..((block + 1) * BLOCK).min(wanted);
            let whole = cached_result::<Vec<Option<RefereeObservation>>>(&self.cache, &key);
            if let Some(known) = whole.filter(|known| known.len() as u64 == range.end - range.start) {
                items.extend(known);
                continue;
            }
            let observed: Vec<Option<RefereeObservation>> = range
                .map(|index| referee_runs::item(worker, &self.cell, judged, &self.team, channel, index))
                .collect();
            self.cache.put(&key, &serde_json::to_vec(&observed)?)?;
            items.extend(observed);
        }
        Ok(items)
    }

    fn key(&self, judged: &JudgedVersion, channel: Channel, block: u64) -> Digest {
        let team: Vec<String> = self.team.iter().map(|one| one.version.digest().to_string()).collect();
        let under = format!("{}|{channel}|{block}|{}", judged.terms.in_full(), team.join("|"));
        let parts = [
            self.cell.digest().bytes().as_slice(),
            self.cell.computed_by().as_bytes(),
            judged.version.digest().bytes().as_slice(),
            under.as_bytes(),
        ]
        .map(<[u8]>::to_vec);
        Digest::of_parts("holdpoint.truth.v5", &parts.iter().map(Vec::as_slice).collect::<Vec<_>>())
    }
}

/// The context in which versions are judged: the least strict profile.
pub(crate) fn judging_context(cell: Cell) -> Result<Context, ExperimentError> {
    let profile = Profile::builtin(ProfileName::Sim).map_err(ExperimentError::unexpected)?;
    let table = PolicyTable::builtin(&profile).map_err(ExperimentError::unexpected)?;
    Ok(Context::new(profile, table, None, cell)?)
}
