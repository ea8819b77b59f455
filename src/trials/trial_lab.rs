//! Evaluates versions: episodes, pairs and drills, run by a worker pool and cached where possible.
//!
//! Results of an active version under a seed are cached, so that a second candidate does not pay for them again; the
//! caller learns of each use ([`Reuse`]). Runs its jobs and judges nothing.

mod pairing;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use pairing::TrialPairing;

use super::drills::DrillResult;
use super::episodes::{alone, cache_key};
use super::job_outcome::JobOutcome;
pub use super::pair_spot::PairSpot;
use super::reuse::{Reuse, ReusedResult, value};
use super::seeds::{SeedPurpose, SeedSource};
use super::sequences::{SequenceRecords, TrialTeam};
pub use super::trial_subject::TrialSubject;
use super::undisturbed_run::UndisturbedCache;
use super::worker::Worker;
use super::worker_pool::{PoolJob, WorkerPool};
use crate::cell::{Cell, Conditions};
use crate::fault::TrialFault;
use holdpoint_cell::envelope::EnvelopePoint;
use holdpoint_governance::cached_result::CachedWorkKind;
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::phase::WorkPhase;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_store::{CacheLookup, EpisodeKey, ResultCache};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DrillSpot {
    pub seed: u64,
    /// Absent: anywhere in the run.
    pub phase: Option<WorkPhase>,
}

/// A likely next request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Lookahead {
    Pairs(Vec<PairSpot>),
    Drills(DrillKind, Vec<DrillSpot>),
    Sequences(Vec<u64>),
}

/// The cell, the workers and the cache that evaluations share.
pub struct TrialLab<'a> {
    pub seeds: SeedSource,
    pub worker_pool: &'a WorkerPool<JobOutcome>,
    /// What several drills begin with.
    pub undisturbed: &'a Arc<UndisturbedCache>,
    /// The most pairs or drills run before the caller regains control.
    pub part: usize,
    /// Set to interrupt between episodes.
    pub cancel: &'a AtomicBool,
    pub cell: &'a Cell,
    /// Cache of results of the version compared with.
    pub cache: &'a ResultCache,
    /// The versions for the other tasks in whole sequences.
    pub team: TrialTeam,
    /// The family's anchor, if it is not the version compared with.
    pub anchor: Option<TrialSubject>,
}

struct CacheHit<T> {
    result: T,
    own: bool,
}

impl TrialLab<'_> {
    /// With this team beside the candidate in whole sequences.
    #[must_use]
    pub fn with_team(self, team: TrialTeam) -> Self {
        Self { team, ..self }
    }

    /// With this anchor to compare with as well.
    #[must_use]
    pub fn with_anchor(self, anchor: Option<TrialSubject>) -> Self {
        Self { anchor, ..self }
    }

    /// Episodes of one version, by their place among a purpose's seeds.
    ///
    /// # Errors
    /// If a worker failed or the run was interrupted; the results then permit no conclusion.
    pub fn episodes(
        &self,
        version: &Capability,
        terms: &SkillTerms,
        conditions: Conditions,
        purpose: SeedPurpose,
        range: std::ops::Range<u64>,
    ) -> Result<Vec<TaskRecord>, TrialFault> {
        let party = TrialSubject { version: version.clone(), terms: terms.clone(), fallback: None };
        let shared = Arc::new((self.cell.clone(), party));
        let job = |index| {
            let (seed, shared) = (self.seeds.seed(purpose, index), Arc::clone(&shared));
            PoolJob {
                key: job_key("episode", &[shared.1.key(&shared.0, conditions, seed)]),
                work: Box::new(move |worker: &mut Worker| {
                    let (cell, party) = &*shared;
                    JobOutcome::Alone(Box::new(alone(worker, party.trial(cell, conditions, seed))))
                }),
            }
        };
        let outcomes = self.worker_pool.run_jobs(range.map(job).collect(), self.cancel)?;
        outcomes.into_iter().map(|outcome| Ok(outcome.pair()?.0)).collect()
    }

    /// The episodes of the given spots with both versions: candidate first. Names the cached ones.
    ///
    /// # Errors
    /// As [`TrialLab::episodes`].
    pub fn pairs(
        &self,
        candidate: &TrialSubject,
        active: &TrialSubject,
        spots: &[PairSpot],
        reuse: &mut Reuse,
    ) -> Result<Vec<(TaskRecord, TaskRecord)>, TrialFault> {
        let cached = |spot: &PairSpot| self.cached(&self.episode_key(active, *spot), reuse);
        let known: Vec<Option<CacheHit<TaskRecord>>> = spots.iter().map(cached).collect();
        let table = self.table(candidate, active);
        let jobs = spots.iter().zip(&known).map(|(spot, known)| table.pair(*spot, known.is_some()));
        let outcomes = self.worker_pool.run_jobs(jobs.collect(), self.cancel)?;
        let mut pairs = Vec::with_capacity(spots.len());
        for ((outcome, known), spot) in outcomes.into_iter().zip(known).zip(spots) {
            let (new, fresh) = outcome.pair()?;
            if let Some(old) = &fresh {
                self.cache_episode(active, *spot, old)?;
            }
            if let Some(CacheHit { result, own }) = &known {
                let value = value(&serde_json::to_vec(result)?);
                reuse.note_use(ReusedResult::of_episode(CachedWorkKind::Episodes, *spot, value, *own));
            }
            let Some(old) = fresh.or(known.map(|hit| hit.result)) else { break };
            pairs.push((new, old));
        }
        complete(&pairs, spots.len())?;
        Ok(pairs)
    }

    /// The anchor's episodes of the given spots. Names the cached ones.
    ///
    /// # Errors
    /// As [`TrialLab::episodes`].
    pub fn anchor_episodes(
        &self,
        anchor: &TrialSubject,
        spots: &[PairSpot],
        reuse: &mut Reuse,
    ) -> Result<Vec<TaskRecord>, TrialFault> {
        let cached = |spot: &PairSpot| self.cached(&self.episode_key(anchor, *spot), reuse);
        let known: Vec<Option<CacheHit<TaskRecord>>> = spots.iter().map(cached).collect();
        let table = self.table(anchor, anchor);
        let jobs = spots.iter().zip(&known).filter(|(_, known)| known.is_none());
        let jobs = jobs.map(|(spot, _)| table.pair(*spot, true)).collect();
        let mut fresh = self.worker_pool.run_jobs(jobs, self.cancel)?.into_iter();
        let mut episodes = Vec::with_capacity(spots.len());
        for (known, spot) in known.into_iter().zip(spots) {
            if let Some(CacheHit { result, own }) = known {
                let value = value(&serde_json::to_vec(&result)?);
                let work = CachedWorkKind::AnchorEpisodes;
                reuse.note_use(ReusedResult::of_episode(work, *spot, value, own));
                episodes.push(result);
            } else {
                let Some(outcome) = fresh.next() else { break };
                let (record, _) = outcome.pair()?;
                self.cache_episode(anchor, *spot, &record)?;
                episodes.push(record);
            }
        }
        complete(&episodes, spots.len())?;
        Ok(episodes)
    }

    /// Uncached pairs (candidate, active) at given places of the sandbox's distribution, from a search's `first` on.
    ///
    /// # Errors
    /// As [`TrialLab::episodes`].
    pub fn places(
        &self,
        candidate: &TrialSubject,
        active: &TrialSubject,
        first: u64,
        points: &[EnvelopePoint],
    ) -> Result<Vec<(EnvelopePoint, TaskRecord, TaskRecord)>, TrialFault> {
        let job = |(index, point): (u64, &EnvelopePoint)| {
            let seed = self.seeds.seed(SeedPurpose::Search, first + index);
            let cell = self.cell.with_sandbox(self.cell.sandbox.at(point));
            self.table_in(cell, candidate, active).place(seed, point)
        };
        let jobs = (0..).zip(points).map(job).collect();
        let outcomes = self.worker_pool.run_jobs(jobs, self.cancel)?;
        let mut results = Vec::with_capacity(points.len());
        for (point, outcome) in points.iter().zip(outcomes) {
            let (new, old) = outcome.pair()?;
            let old = old.ok_or_else(|| TrialFault::Impossible("an episode has no partner".to_owned()))?;
            results.push((*point, new, old));
        }
        complete(&results, points.len())?;
        Ok(results)
    }

    /// The phases of a version's undisturbed runs, by seed.
    ///
    /// # Errors
    /// As [`TrialLab::episodes`].
    pub fn phases(&self, party: &TrialSubject, seeds: &[u64]) -> Result<Vec<Vec<WorkPhase>>, TrialFault> {
        let table = self.table(party, party);
        let outcomes =
            self.worker_pool.run_jobs(seeds.iter().map(|seed| table.phases(*seed)).collect(), self.cancel)?;
        let phases = outcomes.into_iter().map(JobOutcome::phases).collect::<Result<Vec<_>, TrialFault>>()?;
        complete(&phases, seeds.len())?;
        Ok(phases)
    }

    /// Drills of one kind at the given spots: the candidate's results, then the active version's. Unless `is_paired`, the
    /// active version is drilled only where the candidate failed; elsewhere its result is infeasible: it says nothing.
    /// Names the cached ones.
    ///
    /// # Errors
    /// As [`TrialLab::episodes`].
    pub fn drills(
        &self,
        candidate: &TrialSubject,
        active: &TrialSubject,
        (kind, is_paired): (DrillKind, bool),
        spots: &[DrillSpot],
        reuse: &mut Reuse,
    ) -> Result<(Vec<DrillResult>, Vec<DrillResult>), TrialFault> {
        if !is_paired {
            let of_candidate = self.fresh_drills(candidate, active, kind, spots, true)?;
            complete(&of_candidate, spots.len())?;
            let mut of_active = vec![DrillResult::Infeasible; spots.len()];
            for ((spot, new), old) in spots.iter().zip(&of_candidate).zip(&mut of_active) {
                if *new == DrillResult::Failed {
                    let (_, found) = self.drills(candidate, active, (kind, true), &[*spot], reuse)?;
                    *old = found.first().copied().unwrap_or(DrillResult::Infeasible);
                }
            }
            return Ok((of_candidate, of_active));
        }
        let known = self.cached_drills(active, kind, spots, reuse);
        let mut of_candidate = self.fresh_drills(candidate, active, kind, spots, known.is_some())?;
        let of_active = match known {
            Some(CacheHit { result: known, own }) => {
                for (DrillSpot { seed, phase }, result) in spots.iter().zip(&known) {
                    let value = value(&serde_json::to_vec(result)?);
                    let work = CachedWorkKind::Drills(kind);
                    let (phase, seed) = (*phase, *seed);
                    reuse.note_use(ReusedResult { work, phase, seed, live_like: false, value, own });
                }
                known
            }
            None => {
                let of_active = of_candidate.split_off(spots.len().min(of_candidate.len()));
                complete(&of_active, spots.len())?;
                let key = self.drill_key(active, kind, spots);
                self.cache.put(&key, &serde_json::to_vec(&of_active)?)?;
                of_active
            }
        };
        complete(&of_candidate, spots.len())?;
        Ok((of_candidate, of_active))
    }

    /// Drills of one kind without the cache: the candidate's results, then the active version's unless they are known.
    fn fresh_drills(
        &self,
        candidate: &TrialSubject,
        active: &TrialSubject,
        kind: DrillKind,
        spots: &[DrillSpot],
        is_known: bool,
    ) -> Result<Vec<DrillResult>, TrialFault> {
        let jobs = self.table(candidate, active).drills(kind, spots, is_known);
        self.worker_pool.run_jobs(jobs, self.cancel)?.into_iter().map(JobOutcome::drill).collect()
    }

    /// Whole sequences of the given seeds with both versions, candidate first. Names the cached ones.
    ///
    /// # Errors
    /// As [`TrialLab::episodes`], or if a place of the sequence is empty.
    pub fn sequences(
        &self,
        candidate: &TrialSubject,
        active: &TrialSubject,
        seeds: &[u64],
        reuse: &mut Reuse,
    ) -> Result<Vec<SequenceRecords>, TrialFault> {
        let cached = |seed: &u64| self.cached(&self.sequence_key(active, *seed), reuse);
        let known: Vec<Option<CacheHit<Vec<TaskRecord>>>> = seeds.iter().map(cached).collect();
        let table = self.table(candidate, active);
        let jobs = seeds.iter().zip(&known).map(|(seed, known)| table.sequences(*seed, known.is_some()));
        let outcomes = self.worker_pool.run_jobs(jobs.collect(), self.cancel)?;
        let mut pairs = Vec::with_capacity(seeds.len());
        for ((outcome, known), seed) in outcomes.into_iter().zip(known).zip(seeds) {
            let (new, fresh) = outcome.sequences()?;
            let old = match (fresh, known) {
                (Some(old), _) => {
                    self.cache.put(&self.sequence_key(active, *seed), &serde_json::to_vec(&old)?)?;
                    old
                }
                (None, Some(CacheHit { result, own })) => {
                    let value = value(&serde_json::to_vec(&result)?);
                    reuse.note_use(ReusedResult {
                        work: CachedWorkKind::Sequences,
                        phase: None,
                        seed: *seed,
                        live_like: false,
                        value,
                        own,
                    });
                    result
                }
                (None, None) => break,
            };
            pairs.push((new, old));
        }
        complete(&pairs, seeds.len())?;
        Ok(pairs)
    }

    /// Announces likely next requests: an idle worker begins with them. Changes no result.
    ///
    /// # Errors
    /// If no thread starts.
    pub fn expect(
        &self,
        candidate: &TrialSubject,
        active: &TrialSubject,
        next: &[Lookahead],
    ) -> Result<(), TrialFault> {
        if self.worker_pool.jobs() == 1 {
            return Ok(());
        }
        let table = self.table(candidate, active);
        let mut jobs = Vec::new();
        // Uses of cached results are reported when they are requested.
        let mut unreported = Reuse::default();
        for outlook in next {
            match outlook {
                Lookahead::Pairs(spots) => {
                    let mut known =
                        |spot| self.cached::<TaskRecord>(&self.episode_key(active, spot), &mut unreported);
                    let pair = |spot: &PairSpot| table.pair(*spot, known(*spot).is_some());
                    jobs.extend(spots.iter().map(pair));
                }
                Lookahead::Drills(kind, spots) => {
                    let known = self.cached_drills(active, *kind, spots, &mut unreported).is_some();
                    jobs.extend(table.drills(*kind, spots, known));
                }
                Lookahead::Sequences(seeds) => {
                    let mut known = |seed| {
                        self.cached::<Vec<TaskRecord>>(&self.sequence_key(active, seed), &mut unreported)
                    };
                    let both = |seed: &u64| table.sequences(*seed, known(*seed).is_some());
                    jobs.extend(seeds.iter().map(both));
                }
            }
        }
        self.worker_pool.expect(jobs)
    }

    fn table(&self, candidate: &TrialSubject, active: &TrialSubject) -> Arc<TrialPairing> {
        self.table_in(self.cell.clone(), candidate, active)
    }

    fn table_in(&self, cell: Cell, candidate: &TrialSubject, active: &TrialSubject) -> Arc<TrialPairing> {
        Arc::new(TrialPairing {
            cell,
            candidate: candidate.clone(),
            active: active.clone(),
            team: self.team.clone(),
            undisturbed: Arc::clone(self.undisturbed),
        })
    }

    /// Re-runs cached jobs of a version, in this order; returns the bytes that would be cached of each.
    ///
    /// # Errors
    /// As [`TrialLab::episodes`].
    pub fn rerun_episodes<'r>(
        &self,
        active: &TrialSubject,
        results: impl Iterator<Item = &'r ReusedResult>,
    ) -> Result<Vec<Vec<u8>>, TrialFault> {
        let table = self.table(active, active);
        let of_anchor = self.anchor.as_ref().map(|anchor| self.table(anchor, anchor));
        let job = |result: &ReusedResult| match (&of_anchor, result.work) {
            (Some(table), CachedWorkKind::AnchorEpisodes) => table.rerun(result),
            _ => table.rerun(result),
        };
        let outcomes = self.worker_pool.run_jobs(results.map(job).collect(), self.cancel)?;
        let mut bytes = Vec::with_capacity(outcomes.len());
        for outcome in outcomes {
            bytes.push(match outcome {
                JobOutcome::Drill(result) => serde_json::to_vec(&result)?,
                JobOutcome::Sequences(records, _) => serde_json::to_vec(&records)?,
                JobOutcome::Alone(_) | JobOutcome::Pair(_) | JobOutcome::Phases(_) => {
                    serde_json::to_vec(&without_path(&outcome.pair()?.0))?
                }
            });
        }
        Ok(bytes)
    }

    /// Notes the result of a re-run episode, which then counts as this process's own.
    pub fn confirm_episode(&self, active: &TrialSubject, spot: PairSpot, bytes: &[u8]) {
        self.cache.remember_own(&self.episode_key(active, spot), bytes);
    }

    fn episode_key(&self, party: &TrialSubject, spot: PairSpot) -> Digest {
        key(self.cell, &party.version, spot.scenario(self.cell, &self.team, party), spot.seed)
    }

    /// The result of a sequence depends on every version in it.
    fn sequence_key(&self, party: &TrialSubject, seed: u64) -> Digest {
        let under = |party: &TrialSubject| {
            cache_key(self.cell, &party.terms, &party.version, Conditions::Sandbox, seed)
        };
        let digests: Vec<Digest> = std::iter::once(party).chain(self.team.members()).map(under).collect();
        let parts: Vec<&[u8]> = digests.iter().map(|digest| digest.bytes().as_slice()).collect();
        key(self.cell, &party.version, Digest::of_parts("holdpoint.sequence.v1", &parts), seed)
    }

    fn drill_key(&self, party: &TrialSubject, kind: DrillKind, spots: &[DrillSpot]) -> Digest {
        let first = spots.first().map_or(0, |spot| spot.seed);
        let under = cache_key(self.cell, &party.terms, &party.version, Conditions::Canonical, first);
        let count = (spots.len() as u64).to_le_bytes();
        let phases: Vec<&str> =
            spots.iter().map(|spot| spot.phase.map_or("anywhere", WorkPhase::name)).collect();
        let phases = phases.join(",");
        // The fallback also determines a drill's result; an active version's predecessor is itself.
        let fallback = party.fallback.as_ref().map_or(under, Capability::digest);
        let parts =
            [under.bytes().as_slice(), kind.name().as_bytes(), &count, fallback.bytes(), phases.as_bytes()];
        key(self.cell, &party.version, Digest::of_parts("holdpoint.drill.v4", &parts), first)
    }

    /// A cached result; `None` if it is unreadable or invalid.
    fn cached<T: serde::de::DeserializeOwned>(&self, key: &Digest, reuse: &mut Reuse) -> Option<CacheHit<T>> {
        match self.cache.get(key) {
            CacheLookup::Nothing => None,
            CacheLookup::Refused => {
                reuse.note_refusal();
                None
            }
            CacheLookup::Found { body, own } => {
                let result = serde_json::from_slice(&body).ok()?;
                Some(CacheHit { result, own })
            }
        }
    }

    fn cached_drills(
        &self,
        party: &TrialSubject,
        kind: DrillKind,
        spots: &[DrillSpot],
        reuse: &mut Reuse,
    ) -> Option<CacheHit<Vec<DrillResult>>> {
        let known: CacheHit<Vec<DrillResult>> = self.cached(&self.drill_key(party, kind, spots), reuse)?;
        (known.result.len() == spots.len()).then_some(known)
    }

    fn cache_episode(
        &self,
        party: &TrialSubject,
        spot: PairSpot,
        record: &TaskRecord,
    ) -> Result<(), TrialFault> {
        let key = self.episode_key(party, spot);
        Ok(self.cache.put(&key, &serde_json::to_vec(&without_path(record))?)?)
    }
}

/// The path is for drawing and shadow; a cached comparison does not need it.
fn without_path(record: &TaskRecord) -> TaskRecord {
    TaskRecord { path: Vec::new(), ..record.clone() }
}

fn job_key(what: &str, parts: &[Digest]) -> Digest {
    let bytes: Vec<&[u8]> =
        std::iter::once(what.as_bytes()).chain(parts.iter().map(|part| part.bytes().as_slice())).collect();
    Digest::of_parts("holdpoint.errand.v1", &bytes)
}

fn key(cell: &Cell, version: &Capability, scenario: Digest, seed: u64) -> Digest {
    let bundle = version.bundle.digest();
    EpisodeKey { bundle, scenario, seed, engine_build: cell.computed_by().to_owned() }.digest()
}

/// A list shorter than the request was interrupted.
fn complete<T>(results: &[T], wanted: usize) -> Result<(), TrialFault> {
    if results.len() == wanted {
        Ok(())
    } else {
        Err(TrialFault::Impossible("the evaluation was interrupted".to_owned()))
    }
}
