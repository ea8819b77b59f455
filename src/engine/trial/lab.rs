//! Where versions are tried out: episodes, pairs and drills on a pool of worlds, cached if they can be.
//!
//! What an active version did under a seed is kept, so that a second candidate does not pay for it again.
//! Runs what it is told and judges nothing.

use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;

use holdpoint_sim::pool::run_ordered;

use super::cache::EpisodeCache;
use super::drills::{Cast, DrillResult, drill};
use super::episodes::{EpisodeJob, Workers, batch, cache_key};
use super::seeds::{Purpose, episode_seed};
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
        let mut list: Vec<EpisodeJob> =
            seeds.iter().map(|seed| EpisodeJob { version: 0, seed: *seed }).collect();
        let missing = seeds.iter().zip(&known).filter(|(_, known)| known.is_none());
        list.extend(missing.map(|(seed, _)| EpisodeJob { version: 1, seed: *seed }));
        let versions = [(&candidate.version, &candidate.terms), (&active.version, &active.terms)];
        let mut new = batch(self.workers, self.cancel, self.cell, &versions, Conditions::Sandbox, &list)?;
        complete(&new, list.len())?;
        let mut fresh = new.split_off(seeds.len()).into_iter();
        let mut pairs = Vec::with_capacity(seeds.len());
        for (record, known) in new.into_iter().zip(known) {
            let old = match known {
                Some(known) => known,
                None => {
                    let Some(old) = fresh.next() else { break };
                    self.keep(active, &old)?;
                    old
                }
            };
            pairs.push((record, old));
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
                let (terms, cast) = (terms[*party], &casts[*party]);
                Some(worker.run(|worker| drill(worker, self.cell, terms, cast, kind, *seed)))
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
