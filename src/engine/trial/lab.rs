//! Where versions are tried out: episodes, pairs and drills by a crew of workers, cached if they can be.
//!
//! What an active version did under a seed is kept, so that a second candidate does not pay for it again; whoever takes
//! it is told so ([`Reuse`]). Runs what it is told and judges nothing.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::crew::{Chore, Crew, Errand};
use super::drills::{Cast, DrillCase, DrillResult};
use super::episodes::{alone, cache_key, pair};
use super::outcome::ErrandOutcome;
pub use super::party::Party;
use super::reuse::{Reuse, Taken, value};
use super::seeds::{Purpose, episode_seed};
use super::sequences::{Team, WorkedSequences, sequence, sequences};
use super::undisturbed::{Shelf, Undisturbed};
use super::worker::Worker;
use crate::cell::{COMPUTED_BY, Cell, Conditions};
use crate::fault::Fault;
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::kept::KeptWork;
use holdpoint_governance::phase::WorkPhase;
use holdpoint_registry::{EpisodeKey, Found, KeptCells};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_sim::envelope::Point;

/// Where a drill begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DrillSpot {
    pub seed: u64,
    /// Anywhere in the work, if none is named.
    pub phase: Option<WorkPhase>,
}

/// What a lab may be asked for next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outlook {
    Pairs(Vec<u64>),
    Drills(DrillKind, Vec<DrillSpot>),
    Sequences(Vec<u64>),
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
    /// Where results of the version compared with are kept.
    pub cells: &'a KeptCells,
    /// Who works the tasks beside the candidate's in whole sequences.
    pub team: Team,
}

/// A kept result as it was read.
struct KeptResult<T> {
    result: T,
    own: bool,
}

/// Both parties and the cell, for work on another thread.
struct Matchup {
    cell: Cell,
    candidate: Party,
    active: Party,
    team: Team,
    undisturbed: Arc<Shelf>,
}

impl Lab<'_> {
    /// With these beside the candidate in whole sequences.
    #[must_use]
    pub fn beside(self, team: Team) -> Self {
        Self { team, ..self }
    }

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

    /// The sandbox's episodes of the given seeds with both versions: candidate first. Says which were kept.
    ///
    /// # Errors
    /// As [`Lab::episodes`].
    pub fn pairs(
        &self,
        candidate: &Party,
        active: &Party,
        seeds: &[u64],
        reuse: &mut Reuse,
    ) -> Result<Vec<(TaskRecord, TaskRecord)>, Fault> {
        let mut known: Vec<Option<KeptResult<TaskRecord>>> = Vec::with_capacity(seeds.len());
        for seed in seeds {
            known.push(self.kept(&self.episode_key(active, *seed), reuse));
        }
        let table = self.table(candidate, active);
        let errands = seeds.iter().zip(&known).map(|(seed, known)| table.pair(*seed, known.is_some()));
        let outcomes = self.crew.work(errands.collect(), self.cancel)?;
        let mut pairs = Vec::with_capacity(seeds.len());
        for ((outcome, known), seed) in outcomes.into_iter().zip(known).zip(seeds) {
            let (new, fresh) = outcome.pair()?;
            if let Some(old) = &fresh {
                self.keep(active, old)?;
            }
            if let Some(KeptResult { result, own }) = &known {
                let value = value(&serde_json::to_vec(result)?);
                reuse.take(Taken { work: KeptWork::Episodes, phase: None, seed: *seed, value, own: *own });
            }
            let Some(old) = fresh.or(known.map(|kept| kept.result)) else { break };
            pairs.push((new, old));
        }
        complete(&pairs, seeds.len())?;
        Ok(pairs)
    }

    /// Episodes of both at chosen places of the sandbox's distribution, the first of them the `first`-th of a search:
    /// candidate's and active version's. Nothing of it is kept.
    ///
    /// # Errors
    /// As [`Lab::episodes`].
    pub fn places(
        &self,
        candidate: &Party,
        active: &Party,
        first: u64,
        points: &[Point],
    ) -> Result<Vec<(Point, TaskRecord, TaskRecord)>, Fault> {
        let errand = |(index, point): (u64, &Point)| {
            let seed = episode_seed(self.seed, Purpose::Search, first + index);
            self.table_at(candidate, active, point).place(seed, point)
        };
        let errands = (0..).zip(points).map(errand).collect();
        let outcomes = self.crew.work(errands, self.cancel)?;
        let mut worked = Vec::with_capacity(points.len());
        for (point, outcome) in points.iter().zip(outcomes) {
            let (new, old) = outcome.pair()?;
            let old = old.ok_or_else(|| Fault::Impossible("an episode has no partner".to_owned()))?;
            worked.push((*point, new, old));
        }
        complete(&worked, points.len())?;
        Ok(worked)
    }

    /// The phases that a version's undisturbed work shows, seed by seed.
    ///
    /// # Errors
    /// As [`Lab::episodes`].
    pub fn phases(&self, party: &Party, seeds: &[u64]) -> Result<Vec<Vec<WorkPhase>>, Fault> {
        let table = self.table(party, party);
        let outcomes = self.crew.work(seeds.iter().map(|seed| table.phases(*seed)).collect(), self.cancel)?;
        let phases = outcomes.into_iter().map(ErrandOutcome::phases).collect::<Result<Vec<_>, Fault>>()?;
        complete(&phases, seeds.len())?;
        Ok(phases)
    }

    /// Drills of one kind in the given phases on the given seeds, with both versions: the candidate's results, the active
    /// version's. Says which were kept.
    ///
    /// # Errors
    /// As [`Lab::episodes`].
    pub fn drills(
        &self,
        candidate: &Party,
        active: &Party,
        kind: DrillKind,
        spots: &[DrillSpot],
        reuse: &mut Reuse,
    ) -> Result<(Vec<DrillResult>, Vec<DrillResult>), Fault> {
        let known = self.kept_drills(active, kind, spots, reuse);
        let table = self.table(candidate, active);
        let outcomes = self.crew.work(table.drills(kind, spots, known.is_some()), self.cancel)?;
        let results = outcomes.into_iter().map(ErrandOutcome::drill).collect::<Result<Vec<_>, Fault>>()?;
        let mut of_candidate = results;
        let of_active = match known {
            Some(KeptResult { result: known, own }) => {
                for (DrillSpot { seed, phase }, result) in spots.iter().zip(&known) {
                    let value = value(&serde_json::to_vec(result)?);
                    let work = KeptWork::Drills(kind);
                    reuse.take(Taken { work, phase: *phase, seed: *seed, value, own });
                }
                known
            }
            None => {
                let of_active = of_candidate.split_off(spots.len().min(of_candidate.len()));
                complete(&of_active, spots.len())?;
                let key = self.drill_key(active, kind, spots);
                self.cells.put(&key, &serde_json::to_vec(&of_active)?)?;
                of_active
            }
        };
        complete(&of_candidate, spots.len())?;
        Ok((of_candidate, of_active))
    }

    /// Whole sequences of the given seeds with both versions in their place: the candidate's first. Says which were kept.
    ///
    /// # Errors
    /// As [`Lab::episodes`], or if a place of the sequence is empty.
    pub fn sequences(
        &self,
        candidate: &Party,
        active: &Party,
        seeds: &[u64],
        reuse: &mut Reuse,
    ) -> Result<Vec<WorkedSequences>, Fault> {
        let mut known: Vec<Option<KeptResult<Vec<TaskRecord>>>> = Vec::with_capacity(seeds.len());
        for seed in seeds {
            known.push(self.kept(&self.sequence_key(active, *seed), reuse));
        }
        let table = self.table(candidate, active);
        let errands = seeds.iter().zip(&known).map(|(seed, known)| table.sequences(*seed, known.is_some()));
        let outcomes = self.crew.work(errands.collect(), self.cancel)?;
        let mut pairs = Vec::with_capacity(seeds.len());
        for ((outcome, known), seed) in outcomes.into_iter().zip(known).zip(seeds) {
            let (new, fresh) = outcome.sequences()?;
            let old = match (fresh, known) {
                (Some(old), _) => {
                    self.cells.put(&self.sequence_key(active, *seed), &serde_json::to_vec(&old)?)?;
                    old
                }
                (None, Some(KeptResult { result, own })) => {
                    let value = value(&serde_json::to_vec(&result)?);
                    reuse.take(Taken { work: KeptWork::Sequences, phase: None, seed: *seed, value, own });
                    result
                }
                (None, None) => break,
            };
            pairs.push((new, old));
        }
        complete(&pairs, seeds.len())?;
        Ok(pairs)
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
        // What will be taken is said when it is.
        let mut unsaid = Reuse::default();
        for outlook in next {
            match outlook {
                Outlook::Pairs(seeds) => {
                    let mut known =
                        |seed| self.kept::<TaskRecord>(&self.episode_key(active, seed), &mut unsaid);
                    let pair = |seed: &u64| table.pair(*seed, known(*seed).is_some());
                    errands.extend(seeds.iter().map(pair));
                }
                Outlook::Drills(kind, spots) => {
                    let known = self.kept_drills(active, *kind, spots, &mut unsaid).is_some();
                    errands.extend(table.drills(*kind, spots, known));
                }
                Outlook::Sequences(seeds) => {
                    let mut known =
                        |seed| self.kept::<Vec<TaskRecord>>(&self.sequence_key(active, seed), &mut unsaid);
                    let both = |seed: &u64| table.sequences(*seed, known(*seed).is_some());
                    errands.extend(seeds.iter().map(both));
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
            team: self.team.clone(),
            undisturbed: Arc::clone(self.undisturbed),
        })
    }

    /// The table with the cell's sandbox reduced to one place.
    fn table_at(&self, candidate: &Party, active: &Party, point: &Point) -> Arc<Matchup> {
        Arc::new(Matchup {
            cell: self.cell.with_sandbox(self.cell.sandbox.at(point)),
            candidate: candidate.clone(),
            active: active.clone(),
            team: self.team.clone(),
            undisturbed: Arc::clone(self.undisturbed),
        })
    }

    /// Runs kept work of a version again, in this order: the bytes that would be kept of each.
    ///
    /// # Errors
    /// As [`Lab::episodes`].
    pub fn again(
        &self,
        active: &Party,
        kept: impl Iterator<Item = (KeptWork, DrillSpot)>,
    ) -> Result<Vec<Vec<u8>>, Fault> {
        let table = self.table(active, active);
        let outcomes =
            self.crew.work(kept.map(|(work, spot)| table.again(work, spot)).collect(), self.cancel)?;
        let mut bytes = Vec::with_capacity(outcomes.len());
        for outcome in outcomes {
            bytes.push(match outcome {
                ErrandOutcome::Drill(result) => serde_json::to_vec(&result)?,
                ErrandOutcome::Sequences(records, _) => serde_json::to_vec(&records)?,
                ErrandOutcome::Alone(_) | ErrandOutcome::Pair(_) | ErrandOutcome::Phases(_) => {
                    serde_json::to_vec(&without_path(&outcome.pair()?.0))?
                }
            });
        }
        Ok(bytes)
    }

    /// An episode was worked again and came to this: from now on it is this process's own.
    pub fn vouch(&self, active: &Party, seed: u64, bytes: &[u8]) {
        self.cells.vouch(&self.episode_key(active, seed), bytes);
    }

    fn episode_key(&self, party: &Party, seed: u64) -> Digest {
        let scenario = cache_key(self.cell, &party.terms, &party.version, Conditions::Sandbox, seed);
        key(&party.version, scenario, seed)
    }

    /// Everybody in the sequence decides what it comes to.
    fn sequence_key(&self, party: &Party, seed: u64) -> Digest {
        let under =
            |party: &Party| cache_key(self.cell, &party.terms, &party.version, Conditions::Sandbox, seed);
        let cast = std::iter::once(party).chain(self.team.members()).map(under);
        let digests: Vec<Digest> = cast.collect();
        let parts: Vec<&[u8]> = digests.iter().map(|digest| digest.bytes().as_slice()).collect();
        key(&party.version, Digest::of_parts("holdpoint.sequence.v1", &parts), seed)
    }

    fn drill_key(&self, party: &Party, kind: DrillKind, spots: &[DrillSpot]) -> Digest {
        let first = spots.first().map_or(0, |spot| spot.seed);
        let under = cache_key(self.cell, &party.terms, &party.version, Conditions::Canonical, first);
        let count = (spots.len() as u64).to_le_bytes();
        let phases: Vec<&str> =
            spots.iter().map(|spot| spot.phase.map_or("anywhere", WorkPhase::name)).collect();
        let phases = phases.join(",");
        // Who takes over decides what a drill comes to as well; an active version's predecessor is itself.
        let fallback = party.fallback.as_ref().map_or(under, Capability::digest);
        let parts =
            [under.bytes().as_slice(), kind.name().as_bytes(), &count, fallback.bytes(), phases.as_bytes()];
        key(&party.version, Digest::of_parts("holdpoint.drill.v4", &parts), first)
    }

    /// A kept result; what cannot be read or is not what was kept is none.
    fn kept<T: serde::de::DeserializeOwned>(&self, key: &Digest, reuse: &mut Reuse) -> Option<KeptResult<T>> {
        match self.cells.get(key) {
            Found::Nothing => None,
            Found::Refused => {
                reuse.refuse();
                None
            }
            Found::Cell { body, own } => {
                let result = serde_json::from_slice(&body).ok()?;
                Some(KeptResult { result, own })
            }
        }
    }

    /// Kept drills, in the order of their seeds.
    fn kept_drills(
        &self,
        party: &Party,
        kind: DrillKind,
        spots: &[DrillSpot],
        reuse: &mut Reuse,
    ) -> Option<KeptResult<Vec<DrillResult>>> {
        let known: KeptResult<Vec<DrillResult>> = self.kept(&self.drill_key(party, kind, spots), reuse)?;
        (known.result.len() == spots.len()).then_some(known)
    }

    fn keep(&self, party: &Party, record: &TaskRecord) -> Result<(), Fault> {
        let key = self.episode_key(party, record.seed);
        Ok(self.cells.put(&key, &serde_json::to_vec(&without_path(record))?)?)
    }
}

/// The path is for drawing and shadow; a kept comparison does not need it.
fn without_path(record: &TaskRecord) -> TaskRecord {
    TaskRecord { path: Vec::new(), ..record.clone() }
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

    /// The episode of a seed with both versions at a place, which is all that the table's sandbox has.
    fn place(self: &Arc<Self>, seed: u64, point: &Point) -> Errand<ErrandOutcome> {
        let Errand { key, work } = self.pair(seed, false);
        let at: Vec<u8> = point.iter().flat_map(|share| share.to_bits().to_le_bytes()).collect();
        let key = errand_key("place", &[key, Digest::of_parts("holdpoint.place.v1", &[&at])]);
        Errand { key, work }
    }

    /// Drills of one kind: the candidate's, then the active version's where they are not known.
    fn drills(
        self: &Arc<Self>,
        kind: DrillKind,
        spots: &[DrillSpot],
        known: bool,
    ) -> Vec<Errand<ErrandOutcome>> {
        let of_candidate = spots.iter().map(|spot| self.drill_errand(true, kind, *spot));
        let of_active = spots.iter().filter(|_| !known).map(|spot| self.drill_errand(false, kind, *spot));
        of_candidate.chain(of_active).collect()
    }

    fn drill_errand(
        self: &Arc<Self>,
        of_candidate: bool,
        kind: DrillKind,
        spot: DrillSpot,
    ) -> Errand<ErrandOutcome> {
        let table = Arc::clone(self);
        let party = if of_candidate { &self.candidate } else { &self.active };
        let work = party.key(&self.cell, Conditions::Canonical, spot.seed);
        // A version that is handed over to, and one that takes over, decide what a drill comes to as well.
        let fallback = party.fallback.as_ref().map_or(work, Capability::digest);
        let parts = [work, self.active.version.digest(), fallback];
        // A version may be compared with itself: both are worked.
        let whose = if of_candidate { "candidate" } else { "active" };
        let what = format!("{kind} of {whose} in {}", spot.phase.map_or("anywhere", WorkPhase::name));
        Errand {
            key: errand_key(&what, &parts),
            work: Box::new(move |worker: &mut Worker| table.drill(worker, of_candidate, kind, spot)),
        }
    }

    /// A whole sequence with both versions in their place, or the candidate's alone where the other's is known.
    fn sequences(self: &Arc<Self>, seed: u64, known: bool) -> Errand<ErrandOutcome> {
        let table = Arc::clone(self);
        let under = |party: &Party| party.key(&self.cell, Conditions::Sandbox, seed);
        let others = self.team.members().iter().map(under);
        let cast: Vec<Digest> =
            [under(&self.candidate), under(&self.active)].into_iter().chain(others).collect();
        Errand {
            key: errand_key(if known { "sequence" } else { "sequences" }, &cast),
            work: Box::new(move |worker: &mut Worker| {
                let Matchup { cell, candidate, active, team, .. } = &*table;
                let place = candidate.version.bundle.task();
                let kept = |records: Vec<TaskRecord>| records.iter().map(without_path).collect::<Vec<_>>();
                match (team.cast(candidate), team.cast(active)) {
                    (Some(new), Some(old)) if !known => {
                        let [new, old] = sequences(worker, cell, [new, old], place, seed);
                        ErrandOutcome::Sequences(kept(new), Some(kept(old)))
                    }
                    (Some(new), _) => ErrandOutcome::Sequences(kept(sequence(worker, cell, new, seed)), None),
                    (None, _) => ErrandOutcome::Sequences(Vec::new(), None),
                }
            }),
        }
    }

    /// What was kept of the active version, once more.
    fn again(self: &Arc<Self>, work: KeptWork, spot: DrillSpot) -> Errand<ErrandOutcome> {
        match work {
            KeptWork::Episodes => self.pair(spot.seed, true),
            KeptWork::Drills(kind) => self.drill_errand(false, kind, spot),
            KeptWork::Sequences => self.sequences(spot.seed, true),
        }
    }

    /// The phases that the active version's undisturbed work shows; none if it has no valid start.
    fn phases(self: &Arc<Self>, seed: u64) -> Errand<ErrandOutcome> {
        let table = Arc::clone(self);
        let work = self.active.key(&self.cell, Conditions::Canonical, seed);
        Errand {
            key: errand_key("phases", &[work]),
            work: Box::new(move |worker: &mut Worker| {
                let trial = table.active.trial(&table.cell, Conditions::Canonical, seed);
                let trace = Undisturbed::begin(worker, &trial, None)
                    .and_then(|mut work| Ok(work.trace(worker, &trial)?.shown()));
                ErrandOutcome::Phases(trace.unwrap_or_default())
            }),
        }
    }

    /// One drill, beginning with what other kinds of drill have worked of the same.
    fn drill(
        &self,
        worker: &mut Worker,
        of_candidate: bool,
        kind: DrillKind,
        spot: DrillSpot,
    ) -> ErrandOutcome {
        let DrillSpot { seed, phase } = spot;
        let party = if of_candidate { &self.candidate } else { &self.active };
        // A version without predecessor reloads itself by digest.
        let predecessor = &self.active.version;
        let cast = Cast { version: &party.version, predecessor, fallback: party.fallback.as_ref() };
        let case = DrillCase { cell: &self.cell, terms: &party.terms, cast: &cast, kind, phase, seed };
        let under = party.key(&self.cell, Conditions::Canonical, seed);
        let begins = phase.map_or("anywhere", WorkPhase::name);
        let key = errand_key(begins, &[under]);
        let mut shared = self.undisturbed.take(&key);
        let result = case.run(worker, &mut shared);
        if let Some(mut work) = shared
            && work.note_drilled(kind)
        {
            self.undisturbed.put(key, work);
        }
        ErrandOutcome::Drill(result)
    }
}

/// What an errand is known by.
fn errand_key(what: &str, parts: &[Digest]) -> Digest {
    let bytes: Vec<&[u8]> =
        std::iter::once(what.as_bytes()).chain(parts.iter().map(|part| part.bytes().as_slice())).collect();
    Digest::of_parts("holdpoint.errand.v1", &bytes)
}

fn key(version: &Capability, scenario: Digest, seed: u64) -> Digest {
    let bundle = version.bundle.digest();
    EpisodeKey { bundle, scenario, seed, engine_build: COMPUTED_BY.to_owned() }.digest()
}

/// A list that is shorter than what was asked for was interrupted.
fn complete<T>(results: &[T], wanted: usize) -> Result<(), Fault> {
    if results.len() == wanted {
        Ok(())
    } else {
        Err(Fault::Impossible("the evaluation was interrupted".to_owned()))
    }
}
