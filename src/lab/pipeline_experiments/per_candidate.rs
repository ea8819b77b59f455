//! Runs every candidate of a pool through the seven stages, and compares the results with the truth file.
//!
//! The engine first decides about all of them; then the experiment reads the truth. Each candidate gets its own store.
//! A few run seeds serve all candidates: those on one seed share the episodes of the active version. So a pool does not
//! run the baseline's episodes once per candidate.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::candidate_run::{CandidateEnd, CandidateSetting, ThresholdScale, run_candidate};
use super::claims::{CandidateVerdict, Claim, Summary};
use super::{ExperimentError, ProgressFn, cache_or_new, cached_result, scratch};
use crate::candidate_pool::{Pool, PoolCandidate, PoolTruth};
use crate::side_by_side::side_by_side;
use crate::wording::progress;
use holdpoint_engine::Experiment;
use holdpoint_engine::build_digest::decided_by;
use holdpoint_governance::component::ComponentBytes;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::submission::Package;
use holdpoint_runtime::capability;
use holdpoint_sim::SimCells;
use holdpoint_store::ResultCache;
use holdpoint_text::Hint;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::worker::Worker;

/// The plan of a run.
#[derive(Clone, Debug)]
pub struct RunPlan {
    pub pool: PathBuf,
    /// The profiles, from the least strict to the strictest.
    pub profiles: Vec<ProfileName>,
    /// The first run seed.
    pub seed: u64,
    /// The number of run seeds.
    pub blocks: u64,
    pub jobs: usize,
    /// Finished candidates and active versions' episodes are cached here and not run again; only for this run if
    /// absent.
    pub cache: Option<ResultCache>,
}

/// The result of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PerCandidateReport {
    /// Each candidate under each profile, in the pool's order.
    pub candidates: Vec<CandidateVerdict>,
    pub summaries: Vec<Summary>,
    /// The claims, and whether they were shown.
    pub claims: Vec<Claim>,
}

/// One candidate to run through the stages under one profile.
pub(crate) struct CandidateJob<'a> {
    pub(crate) name: &'a str,
    pub(crate) package: &'a Package,
    pub(crate) profile: ProfileName,
    pub(crate) seed: u64,
    /// The parts that are left out, and the first active versions.
    pub(crate) experiment: Experiment,
    pub(crate) thresholds: ThresholdScale,
    /// Workers for it.
    pub(crate) workers: usize,
}

/// Runs the plan. `tell` is given one line per finished candidate.
///
/// # Errors
/// If the pool cannot be read, a candidate does not come to an end, or the truth file does not match its digest.
pub fn run(plan: &RunPlan, tell: &ProgressFn<'_>) -> Result<PerCandidateReport, ExperimentError> {
    let pool = Pool::read(&plan.pool)?;
    let packages = packages(&pool)?;
    let scratch = scratch()?;
    let cache = cache_or_new(plan.cache.as_ref(), scratch.path())?;
    let cell = Cell::of(&SimCells, None)?;
    let mut jobs = Vec::new();
    for profile in &plan.profiles {
        for (index, (name, package)) in packages.iter().enumerate() {
            let seed = plan.seed + index as u64 % plan.blocks.max(1);
            jobs.push(CandidateJob {
                name,
                package,
                profile: *profile,
                seed,
                experiment: Experiment::default(),
                thresholds: ThresholdScale::AsTheyAre,
                workers: 1,
            });
        }
    }
    let run = |_: &mut Worker, at: usize| run_or_reuse(&cell, &cache, &jobs[at]);
    let ends = side_by_side(plan.jobs, jobs.len(), run, |_, end| progress::candidate(end), tell)?;
    // Everything is decided: the truth is read only now.
    let truth = pool.truth()?;
    report(&truth, ends, &plan.profiles)
}

/// The packages of a pool, in its order.
pub(crate) fn packages(pool: &Pool) -> Result<Vec<(String, Package)>, ExperimentError> {
    let read = |candidate: &PoolCandidate| {
        let package = capability::read(&pool.folder(candidate))
            .map_err(|error| ExperimentError::candidate(&candidate.name, error.sentence()))?;
        Ok((candidate.name.clone(), package))
    };
    pool.index.candidates.iter().map(read).collect()
}

/// Runs a job, or reads its cached result of an earlier run of the same build.
pub(crate) fn run_or_reuse(
    cell: &Cell,
    cache: &ResultCache,
    job: &CandidateJob<'_>,
) -> Result<CandidateEnd, ExperimentError> {
    run_or_reuse_beside(cell, (cache, cache), job)
}

/// As [`run_or_reuse`], with one cache for ends and another for the episodes of active versions.
pub(crate) fn run_or_reuse_beside(
    cell: &Cell,
    (ends, episodes): (&ResultCache, &ResultCache),
    job: &CandidateJob<'_>,
) -> Result<CandidateEnd, ExperimentError> {
    let (profile, _) = job
        .thresholds
        .of(job.profile)?
        .rules()
        .map_err(|error| ExperimentError::candidate(job.name, error.sentence()))?;
    let Experiment { omitted, first } = &job.experiment;
    let first: Vec<u8> = first.iter().flat_map(|version| *version.digest().bytes()).collect();
    let omitted = serde_json::to_vec(omitted)?;
    let parts = [
        job.package.manifest.as_bytes(),
        job.package.submission.as_bytes(),
        job.package.params.as_bytes(),
        job.package.component.as_ref().map_or(&[], ComponentBytes::bytes),
        &job.seed.to_le_bytes(),
        profile.digest()?.bytes().as_slice(),
        cell.digest().bytes().as_slice(),
        decided_by(holdpoint_sim::BUILD).as_bytes(),
        &omitted,
        &first,
    ]
    .map(<[u8]>::to_vec);
    let parts: Vec<&[u8]> = parts.iter().map(Vec::as_slice).collect();
    let key = Digest::of_parts("holdpoint.end.v5", &parts);
    if let Some(cached) = cached_result::<CandidateEnd>(ends, &key).filter(|cached| cached.name == job.name) {
        return Ok(cached);
    }
    let experiment = job.experiment.clone();
    let CandidateJob { profile, seed, thresholds, workers, .. } = *job;
    let setting = CandidateSetting { cell, profile, seed, cache: episodes, workers, experiment, thresholds };
    let end = run_candidate(&setting, job.name, job.package.clone())?;
    ends.put(&key, &serde_json::to_vec(&end)?)?;
    Ok(end)
}

fn report(
    truth: &PoolTruth,
    ends: Vec<CandidateEnd>,
    profiles: &[ProfileName],
) -> Result<PerCandidateReport, ExperimentError> {
    let candidates: Vec<CandidateVerdict> =
        ends.into_iter().map(|end| CandidateVerdict::of(end, truth)).collect::<Result<_, _>>()?;
    let summaries: Vec<Summary> =
        profiles.iter().map(|profile| Summary::of(*profile, &candidates)).collect::<Result<_, _>>()?;
    let claims = super::claims::claims(&summaries);
    Ok(PerCandidateReport { candidates, summaries, claims })
}
