//! Where versions are tried out: episodes, pairs and drills by a crew of workers, cached if they can be.
//!
//! What an active version did under a seed is kept, so that a second candidate does not pay for it again.
//! Runs what it is told and judges nothing.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::cache::EpisodeCache;
use super::crew::{Chore, Crew, Errand};
use super::drills::{Cast, DrillCase, DrillResult};
use super::episodes::{alone, cache_key, pair};
use super::seeds::{Purpose, episode_seed};
use super::undisturbed::{Shelf, TrialCase};
use super::worker::Worker;
use crate::cell::{COMPUTED_BY, Cell, Conditions};
use crate::fault::Fault;
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::ids::Digest;
use holdpoint_registry::{EpisodeKey, Store};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_runtime::terms::SkillTerms;

/// What an errand of a lab comes to.
pub enum ErrandOutcome {
    /// An episode of one version.
    Alone(Box<TaskRecord>),
    /// The same episode of both: the candidate's, the active version's.
    Pair(Box<[TaskRecord; 2]>),
    Drill(DrillResult),
}

/// What a lab may be asked for next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outlook {
    Pairs(Vec<u64>),
    Drills(DrillKind, Vec<u64>),
}

/// The cell, the workers and the cache that evaluations share.
pub struct Lab<'a> {
    /// Seed of the run.
    pub seed: u64,
    pub crew: &'a Crew<ErrandOutcome>,
    /// What several drills begin with.
    pub undisturbed: &'a Arc<Shelf>,
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

/// Both parties and the cell, for work on another thread.
struct Matchup {
    cell: Cell,
    candidate: Party,
    active: Party,
    undisturbed: Arc<Shelf>,
}

impl Party {
    fn trial<'a>(&'a self, cell: &'a Cell, conditions: Conditions, seed: u64) -> TrialCase<'a> {
        TrialCase { cell, terms: &self.terms, version: &self.version, conditions, seed }
    }

    /// What determines its episode.
    fn key(&self, cell: &Cell, conditions: Conditions, seed: u64) -> Digest {
        cache_key(cell, &self.terms, &self.version, conditions, seed)
    }
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
        let party = Party { version: version.clone(), terms: terms.clone(), fallback: None };
        let shared = Arc::new((self.cell.clone(), party));
        let errand = |index| {
            let (seed, shared) = (episode_seed(self.seed, purpose, index), Arc::clone(&shared));
            Errand {
                key: errand_key("episode", &[shared.1.key(&shared.0, conditions, seed)]),
                work: Box::new(move |worker: &mut Worker| {
                    let (cell, party) = &*shared;
                    ErrandOutcome::Alone(Box::new(alone(worker, party.trial(cell, conditions, seed))))
                }),
            }
        };
        let outcomes = self.crew.work(range.map(errand).collect(), self.cancel)?;
        outcomes.into_iter().map(|outcome| Ok(outcome.pair()?.0)).collect()
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
        let table = self.table(candidate, active);
        let errands = seeds.iter().zip(&known).map(|(seed, known)| table.pair(*seed, known.is_some()));
        let outcomes = self.crew.work(errands.collect(), self.cancel)?;
        let mut pairs = Vec::with_capacity(seeds.len());
        for (outcome, known) in outcomes.into_iter().zip(known) {
            let (new, fresh) = outcome.pair()?;
            if let Some(old) = &fresh {
                self.keep(active, old)?;
            }
            let Some(old) = fresh.or(known) else { break };
            pairs.push((new, old));
        }
        complete(&pairs, seeds.len())?;
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
        let known = self.cached_drills(active, kind, seeds);
        let table = self.table(candidate, active);
        let outcomes = self.crew.work(table.drills(kind, seeds, known.is_some()), self.cancel)?;
        let results = outcomes.into_iter().map(ErrandOutcome::drill).collect::<Result<Vec<_>, Fault>>()?;
        let mut of_candidate = results;
        let of_active = match known {
            Some(known) => known,
            None => {
                let of_active = of_candidate.split_off(seeds.len().min(of_candidate.len()));
                complete(&of_active, seeds.len())?;
                let key = self.drill_key(active, kind, seeds);
                self.cache.put(self.store, &key, &serde_json::to_vec(&of_active)?)?;
                of_active
            }
        };
        complete(&of_candidate, seeds.len())?;
        Ok((of_candidate, of_active))
    }

    /// Says what will probably be asked for next: whoever has nothing else to do begins with it. Changes no result.
    ///
    /// # Errors
    /// If no thread starts.
    pub fn expect(&self, candidate: &Party, active: &Party, next: &[Outlook]) -> Result<(), Fault> {
        if self.crew.jobs() == 1 {
            return Ok(());
        }
        let table = self.table(candidate, active);
        let mut errands = Vec::new();
        for outlook in next {
            match outlook {
                Outlook::Pairs(seeds) => {
                    let pair = |seed: &u64| table.pair(*seed, self.cached(active, *seed).is_some());
                    errands.extend(seeds.iter().map(pair));
                }
                Outlook::Drills(kind, seeds) => {
                    let known = self.cached_drills(active, *kind, seeds).is_some();
                    errands.extend(table.drills(*kind, seeds, known));
                }
            }
        }
        self.crew.expect(errands)
    }

    fn table(&self, candidate: &Party, active: &Party) -> Arc<Matchup> {
        Arc::new(Matchup {
            cell: self.cell.clone(),
            candidate: candidate.clone(),
            active: active.clone(),
            undisturbed: Arc::clone(self.undisturbed),
        })
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

    /// Cached drills, in the order of their seeds.
    fn cached_drills(&self, party: &Party, kind: DrillKind, seeds: &[u64]) -> Option<Vec<DrillResult>> {
        let bytes = self.cache.get(self.store, &self.drill_key(party, kind, seeds))?;
        let known: Vec<DrillResult> = serde_json::from_slice(&bytes).ok()?;
        (known.len() == seeds.len()).then_some(known)
    }

    fn keep(&self, party: &Party, record: &TaskRecord) -> Result<(), Fault> {
        // The path is for drawing and shadow; a cached comparison does not need it.
        let record = TaskRecord { path: Vec::new(), ..record.clone() };
        let key = self.episode_key(party, record.seed);
        Ok(self.cache.put(self.store, &key, &serde_json::to_vec(&record)?)?)
    }
}

impl Matchup {
    /// The sandbox's episode of a seed: with both versions, or the candidate's alone where the other's is known.
    fn pair(self: &Arc<Self>, seed: u64, known: bool) -> Errand<ErrandOutcome> {
        const CONDITIONS: Conditions = Conditions::Sandbox;
        let table = Arc::clone(self);
        let (candidate, active) =
            (self.candidate.key(&self.cell, CONDITIONS, seed), self.active.key(&self.cell, CONDITIONS, seed));
        let (key, work): (_, Chore<ErrandOutcome>) = if known {
            let work = move |worker: &mut Worker| {
                let trial = table.candidate.trial(&table.cell, CONDITIONS, seed);
                ErrandOutcome::Alone(Box::new(alone(worker, trial)))
            };
            (errand_key("episode", &[candidate]), Box::new(work))
        } else {
            let work = move |worker: &mut Worker| {
                let both = [&table.candidate, &table.active];
                let both = both.map(|party| party.trial(&table.cell, CONDITIONS, seed));
                ErrandOutcome::Pair(Box::new(pair(worker, both)))
            };
            (errand_key("pair", &[candidate, active]), Box::new(work))
        };
        Errand { key, work }
    }

    /// Drills of one kind: the candidate's, then the active version's where they are not known.
    fn drills(self: &Arc<Self>, kind: DrillKind, seeds: &[u64], known: bool) -> Vec<Errand<ErrandOutcome>> {
        let drill = |of_candidate: bool, seed: u64| {
            let table = Arc::clone(self);
            let party = if of_candidate { &self.candidate } else { &self.active };
            let work = party.key(&self.cell, Conditions::Canonical, seed);
            // A version that is handed over to, and one that takes over, decide what a drill comes to as well.
            let fallback = party.fallback.as_ref().map_or(work, Capability::digest);
            let parts = [work, self.active.version.digest(), fallback];
            // A version may be compared with itself: both are worked.
            let what = format!("{} of {}", kind.name(), if of_candidate { "candidate" } else { "active" });
            Errand {
                key: errand_key(&what, &parts),
                work: Box::new(move |worker: &mut Worker| table.drill(worker, of_candidate, kind, seed)),
            }
        };
        let of_candidate = seeds.iter().map(|seed| drill(true, *seed));
        let of_active = seeds.iter().filter(|_| !known).map(|seed| drill(false, *seed));
        of_candidate.chain(of_active).collect()
    }

    /// One drill, beginning with what other kinds of drill have worked of the same.
    fn drill(&self, worker: &mut Worker, of_candidate: bool, kind: DrillKind, seed: u64) -> ErrandOutcome {
        let party = if of_candidate { &self.candidate } else { &self.active };
        // A version without predecessor reloads itself by digest.
        let predecessor = &self.active.version;
        let cast = Cast { version: &party.version, predecessor, fallback: party.fallback.as_ref() };
        let case = DrillCase { cell: &self.cell, terms: &party.terms, cast: &cast, kind, seed };
        let key = party.key(&self.cell, Conditions::Canonical, seed);
        let mut shared = self.undisturbed.take(&key);
        let result = case.run(worker, &mut shared, &DrillKind::ALL);
        if let Some(mut work) = shared
            && work.note_drilled(kind)
        {
            self.undisturbed.put(key, work);
        }
        ErrandOutcome::Drill(result)
    }
}

impl ErrandOutcome {
    /// An episode, and the other version's if it was worked too.
    fn pair(self) -> Result<(TaskRecord, Option<TaskRecord>), Fault> {
        match self {
            Self::Alone(record) => Ok((*record, None)),
            Self::Pair(records) => {
                let [new, old] = *records;
                Ok((new, Some(old)))
            }
            Self::Drill(_) => Err(Fault::Impossible("a drill was handed over for an episode".to_owned())),
        }
    }

    fn drill(self) -> Result<DrillResult, Fault> {
        match self {
            Self::Drill(result) => Ok(result),
            Self::Alone(_) | Self::Pair(_) => {
                Err(Fault::Impossible("an episode was handed over for a drill".to_owned()))
            }
        }
    }
}

/// What an errand is known by.
fn errand_key(what: &str, parts: &[Digest]) -> Digest {
    let bytes: Vec<&[u8]> =
        std::iter::once(what.as_bytes()).chain(parts.iter().map(|part| part.bytes().as_slice())).collect();
    Digest::of_parts("holdpoint.errand.v1", &bytes)
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
