//! Where versions are tried out: episodes, pairs and drills on a pool of worlds, cached if they can be.
//!
//! What an active version did under a seed is kept, so that a second candidate does not pay for it again.
//! Runs what it is told and judges nothing.

use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;

use holdpoint_sim::pool::run_ordered;

use super::cache::EpisodeCache;
use super::drills::{Cast, DrillCase, DrillResult};
use super::episodes::{EpisodeJob, Worker, Workers, alone, batch, cache_key, pair};
use super::seeds::{Purpose, episode_seed};
use super::undisturbed::TrialCase;
use crate::cell::{COMPUTED_BY, Cell, Conditions};
use crate::fault::Fault;
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::ids::Digest;
use holdpoint_registry::{EpisodeKey, Store};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_runtime::terms::SkillTerms;

/// The cell, the workers and the cache that evaluations share.
pub struct Lab<'a> {
    /// Seed of the run.
    pub seed: u64,
    pub workers: &'a Workers,
    /// The most pairs or drills worked before whoever asked is heard again.
    pub part: usize,
    /// Set to interrupt between episodes.
    pub cancel: &'a AtomicBool,
    /// Robot, scene and distributions.
    pub cell: &'a Cell,
    /// Where episodes of the version compared with are kept.
    pub cache: &'a EpisodeCache,
    /// The store the cache may lie in.
    pub store: &'a Store,
}

/// A version that takes part, with what it runs under.
#[derive(Clone)]
pub struct Party {
    pub version: Capability,
    /// Guard, envelope and watcher limits.
    pub terms: SkillTerms,
    /// What its manifest binds as a fallback, if that is in the registry.
    pub fallback: Option<Capability>,
}

impl Lab<'_> {
    /// Episodes of one version, by their place among a purpose's seeds.
    ///
    /// # Errors
    /// If a worker failed or the run was interrupted; nothing is concluded from it then.
    pub fn episodes(
        &self,
        version: &Capability,
        terms: &SkillTerms,
        conditions: Conditions,
        purpose: Purpose,
        range: std::ops::Range<u64>,
    ) -> Result<Vec<TaskRecord>, Fault> {
        let list: Vec<EpisodeJob> = range
            .map(|index| EpisodeJob { version: 0, seed: episode_seed(self.seed, purpose, index) })
            .collect();
        let records = batch(self.workers, self.cancel, self.cell, &[(version, terms)], conditions, &list)?;
        complete(&records, list.len())?;
        Ok(records)
    }

    /// The sandbox's episodes of the given seeds with both versions: candidate first.
    ///
    /// # Errors
    /// As [`Lab::episodes`].
    pub fn pairs(
        &self,
        candidate: &Party,
        active: &Party,
        seeds: &[u64],
    ) -> Result<Vec<(TaskRecord, TaskRecord)>, Fault> {
        let known: Vec<Option<TaskRecord>> = seeds.iter().map(|seed| self.cached(active, *seed)).collect();
        let mut worked = Vec::with_capacity(seeds.len());
        run_ordered(
            self.workers.jobs(),
            seeds.len() as u64,
            self.cancel,
            || Ok(self.workers.hire()),
            |worker, index| {
                // The pool hands out indices below the list's length.
                let index = usize::try_from(index).ok()?;
                let (seed, known) = (*seeds.get(index)?, known.get(index)?);
                Some(worker.run(|worker| match known {
                    Some(_) => (alone(worker, self.trial(candidate, seed)), None),
                    None => {
                        let both = [candidate, active].map(|party| self.trial(party, seed));
                        let [new, old] = pair(worker, both);
                        (new, Some(old))
                    }
                }))
            },
            |_, records| {
                worked.extend(records);
                ControlFlow::Continue(())
            },
        )?;
        complete(&worked, seeds.len())?;
        let mut pairs = Vec::with_capacity(seeds.len());
        for ((new, fresh), known) in worked.into_iter().zip(known) {
            if let Some(old) = &fresh {
                self.keep(active, old)?;
            }
            let Some(old) = fresh.or(known) else { break };
            pairs.push((new, old));
        }
        Ok(pairs)
    }

    /// Drills of one kind on the given seeds, with both versions: the candidate's results, the active version's.
    ///
    /// # Errors
    /// As [`Lab::episodes`].
    pub fn drills(
        &self,
        candidate: &Party,
        active: &Party,
        kind: DrillKind,
        seeds: &[u64],
    ) -> Result<(Vec<DrillResult>, Vec<DrillResult>), Fault> {
        let key = self.drill_key(active, kind, seeds);
        let known: Option<Vec<DrillResult>> =
            self.cache.get(self.store, &key).and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let known = known.filter(|results| results.len() == seeds.len());
        let casts = [
            Cast {
                version: &candidate.version,
                predecessor: &active.version,
                fallback: candidate.fallback.as_ref(),
            },
            // A version without predecessor reloads itself by digest.
            Cast {
                version: &active.version,
                predecessor: &active.version,
                fallback: active.fallback.as_ref(),
            },
        ];
        let parties = if known.is_some() { 1 } else { 2 };
        let list: Vec<(usize, u64)> =
            (0..parties).flat_map(|party| seeds.iter().map(move |seed| (party, *seed))).collect();
        let terms = [&candidate.terms, &active.terms];
        let mut of_candidate = Vec::with_capacity(list.len());
        run_ordered(
            self.workers.jobs(),
            list.len() as u64,
            self.cancel,
            || Ok(self.workers.hire()),
            |worker, index| {
                // The pool hands out indices below the list's length.
                let (party, seed) = usize::try_from(index).ok().and_then(|index| list.get(index))?;
                let case = DrillCase {
                    cell: self.cell,
                    terms: terms[*party],
                    cast: &casts[*party],
                    kind,
                    seed: *seed,
                };
                Some(worker.run(|worker| self.drill(worker, &case)))
            },
            |_, result| {
                of_candidate.extend(result);
                ControlFlow::Continue(())
            },
        )?;
        complete(&of_candidate, list.len())?;
        let of_active = match known {
            Some(known) => known,
            None => {
                let of_active = of_candidate.split_off(seeds.len());
                self.cache.put(self.store, &key, &serde_json::to_vec(&of_active)?)?;
                of_active
            }
        };
        Ok((of_candidate, of_active))
    }

    /// A party's episode of the sandbox.
    fn trial<'b>(&'b self, party: &'b Party, seed: u64) -> TrialCase<'b> {
        let (terms, version, conditions) = (&party.terms, &party.version, Conditions::Sandbox);
        TrialCase { cell: self.cell, terms, version, conditions, seed }
    }

    /// One drill, beginning with what other kinds of drill have worked of the same.
    fn drill(&self, worker: &mut Worker, case: &DrillCase<'_>) -> DrillResult {
        let DrillCase { cell, terms, cast, kind, seed } = *case;
        let key = cache_key(cell, terms, cast.version, Conditions::Canonical, seed);
        let mut shared = self.workers.undisturbed.take(&key);
        let result = case.run(worker, &mut shared, &DrillKind::ALL);
        if let Some(mut work) = shared
            && work.note_drilled(kind)
        {
            self.workers.undisturbed.put(key, work);
        }
        result
    }

    fn episode_key(&self, party: &Party, seed: u64) -> EpisodeKey {
        let scenario = cache_key(self.cell, &party.terms, &party.version, Conditions::Sandbox, seed);
        key(&party.version, scenario, seed)
    }

    fn drill_key(&self, party: &Party, kind: DrillKind, seeds: &[u64]) -> EpisodeKey {
        let first = seeds.first().copied().unwrap_or(0);
        let under = cache_key(self.cell, &party.terms, &party.version, Conditions::Canonical, first);
        let count = (seeds.len() as u64).to_le_bytes();
        let parts = [under.bytes().as_slice(), kind.name().as_bytes(), &count];
        key(&party.version, Digest::of_parts("holdpoint.drill.v2", &parts), first)
    }

    /// A cached episode; a damaged entry is no entry.
    fn cached(&self, party: &Party, seed: u64) -> Option<TaskRecord> {
        let bytes = self.cache.get(self.store, &self.episode_key(party, seed))?;
        serde_json::from_slice(&bytes).ok()
    }

    fn keep(&self, party: &Party, record: &TaskRecord) -> Result<(), Fault> {
        // The path is for drawing and shadow; a cached comparison does not need it.
        let record = TaskRecord { path: Vec::new(), ..record.clone() };
        let key = self.episode_key(party, record.seed);
        Ok(self.cache.put(self.store, &key, &serde_json::to_vec(&record)?)?)
    }
}

fn key(version: &Capability, scenario: Digest, seed: u64) -> EpisodeKey {
    EpisodeKey { bundle: version.bundle.digest(), scenario, seed, engine_build: COMPUTED_BY.to_owned() }
}

/// A list that is shorter than what was asked for was interrupted.
fn complete<T>(results: &[T], wanted: usize) -> Result<(), Fault> {
    if results.len() == wanted {
        Ok(())
    } else {
        Err(Fault::Impossible("the evaluation was interrupted".to_owned()))
    }
}
