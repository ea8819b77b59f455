//! The jobs of two versions in one cell, as the worker pool runs them.

use std::sync::Arc;

use super::{DrillSpot, PairSpot, job_key, without_path};
use crate::cell::{Cell, Conditions};
use crate::drills::{DrillCase, DrillVersions};
use crate::job_outcome::JobOutcome;
use crate::reuse::ReusedResult;
use crate::sequences::{TrialTeam, run_sequence, run_sequence_pair};
use crate::trial_subject::TrialSubject;
use crate::undisturbed_run::{UndisturbedCache, UndisturbedRun};
use crate::worker::Worker;
use crate::worker_pool::{JobFn, PoolJob};
use holdpoint_cell::envelope::EnvelopePoint;
use holdpoint_governance::cached_result::CachedWorkKind;
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::phase::WorkPhase;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;

pub(super) struct TrialPairing {
    pub(super) cell: Cell,
    pub(super) candidate: TrialSubject,
    pub(super) active: TrialSubject,
    pub(super) team: TrialTeam,
    pub(super) undisturbed: Arc<UndisturbedCache>,
}

impl TrialPairing {
    /// The episode of a spot: with both versions, or the candidate's alone if the other's is cached.
    pub(super) fn pair(self: &Arc<Self>, spot: PairSpot, known: bool) -> PoolJob<JobOutcome> {
        let table = Arc::clone(self);
        let scenario = |party: &TrialSubject| spot.scenario(&self.cell, &self.team, party);
        let (candidate, active) = (scenario(&self.candidate), scenario(&self.active));
        let (key, work): (_, JobFn<JobOutcome>) = if known {
            let work = move |worker: &mut Worker| {
                let TrialPairing { cell, candidate, team, .. } = &*table;
                JobOutcome::Alone(Box::new(spot.run(worker, cell, team, candidate)))
            };
            (job_key("episode", &[candidate]), Box::new(work))
        } else {
            let work = move |worker: &mut Worker| {
                let TrialPairing { cell, candidate, active, team, .. } = &*table;
                JobOutcome::Pair(Box::new(spot.run_both(worker, cell, team, [candidate, active])))
            };
            (job_key("pair", &[candidate, active]), Box::new(work))
        };
        PoolJob { key, work }
    }

    pub(super) fn place(self: &Arc<Self>, seed: u64, point: &EnvelopePoint) -> PoolJob<JobOutcome> {
        let PoolJob { key, work } = self.pair(PairSpot::in_sandbox(seed), false);
        let at: Vec<u8> = point.iter().flat_map(|share| share.to_bits().to_le_bytes()).collect();
        let key = job_key("place", &[key, Digest::of_parts("holdpoint.place.v1", &[&at])]);
        PoolJob { key, work }
    }

    /// Drills of one kind: the candidate's, then the active version's uncached ones.
    pub(super) fn drills(
        self: &Arc<Self>,
        kind: DrillKind,
        spots: &[DrillSpot],
        known: bool,
    ) -> Vec<PoolJob<JobOutcome>> {
        let of_candidate = spots.iter().map(|spot| self.drill_errand(true, kind, *spot));
        let of_active = spots.iter().filter(|_| !known).map(|spot| self.drill_errand(false, kind, *spot));
        of_candidate.chain(of_active).collect()
    }

    pub(super) fn drill_errand(
        self: &Arc<Self>,
        of_candidate: bool,
        kind: DrillKind,
        spot: DrillSpot,
    ) -> PoolJob<JobOutcome> {
        let table = Arc::clone(self);
        let party = if of_candidate { &self.candidate } else { &self.active };
        let work = party.key(&self.cell, Conditions::Canonical, spot.seed);
        // The predecessor and the fallback also determine a drill's result.
        let fallback = party.fallback.as_ref().map_or(work, Capability::digest);
        let parts = [work, self.active.version.digest(), fallback];
        let whose = if of_candidate { "candidate" } else { "active" };
        let what = format!("{kind} of {whose} in {}", spot.phase.map_or("anywhere", WorkPhase::name));
        PoolJob {
            key: job_key(&what, &parts),
            work: Box::new(move |worker: &mut Worker| table.drill(worker, of_candidate, kind, spot)),
        }
    }

    /// A whole sequence with both versions in their place, or the candidate's alone if the other's is cached.
    pub(super) fn sequences(self: &Arc<Self>, seed: u64, known: bool) -> PoolJob<JobOutcome> {
        let table = Arc::clone(self);
        let under = |party: &TrialSubject| party.key(&self.cell, Conditions::Sandbox, seed);
        let others = self.team.members().iter().map(under);
        let versions: Vec<Digest> =
            [under(&self.candidate), under(&self.active)].into_iter().chain(others).collect();
        PoolJob {
            key: job_key(if known { "sequence" } else { "sequences" }, &versions),
            work: Box::new(move |worker: &mut Worker| {
                let TrialPairing { cell, candidate, active, team, .. } = &*table;
                let task = candidate.version.bundle.task();
                let without_paths =
                    |records: Vec<TaskRecord>| records.iter().map(without_path).collect::<Vec<_>>();
                let lineup_with = |subject| team.lineup_with(&cell.spec.tasks, subject);
                match (lineup_with(candidate), lineup_with(active)) {
                    (Some(new), Some(old)) if !known => {
                        let [new, old] = run_sequence_pair(worker, cell, [&new, &old], task, seed);
                        JobOutcome::Sequences(without_paths(new), Some(without_paths(old)))
                    }
                    (Some(new), _) => {
                        JobOutcome::Sequences(without_paths(run_sequence(worker, cell, &new, seed)), None)
                    }
                    (None, _) => JobOutcome::Sequences(Vec::new(), None),
                }
            }),
        }
    }

    /// A cached result of the active version once more.
    pub(super) fn rerun(self: &Arc<Self>, result: &ReusedResult) -> PoolJob<JobOutcome> {
        let ReusedResult { seed, phase, .. } = *result;
        match result.work {
            CachedWorkKind::Episodes | CachedWorkKind::AnchorEpisodes => self.pair(result.pair_spot(), true),
            CachedWorkKind::Drills(kind) => self.drill_errand(false, kind, DrillSpot { seed, phase }),
            CachedWorkKind::Sequences => self.sequences(seed, true),
        }
    }

    /// The phases of the active version's undisturbed run; none without a valid start.
    pub(super) fn phases(self: &Arc<Self>, seed: u64) -> PoolJob<JobOutcome> {
        let table = Arc::clone(self);
        let work = self.active.key(&self.cell, Conditions::Canonical, seed);
        PoolJob {
            key: job_key("phases", &[work]),
            work: Box::new(move |worker: &mut Worker| {
                let trial = table.active.trial(&table.cell, Conditions::Canonical, seed);
                let trace = UndisturbedRun::begin(worker, &trial, None)
                    .and_then(|mut work| Ok(work.trace(worker, &trial)?.phases_present()));
                JobOutcome::Phases(trace.unwrap_or_else(|error| {
                    worker.note_failure(error);
                    Vec::new()
                }))
            }),
        }
    }

    /// One drill, continuing from the undisturbed run that all kinds of drill share.
    pub(super) fn drill(
        &self,
        worker: &mut Worker,
        of_candidate: bool,
        kind: DrillKind,
        spot: DrillSpot,
    ) -> JobOutcome {
        let DrillSpot { seed, phase } = spot;
        let party = if of_candidate { &self.candidate } else { &self.active };
        // A version without predecessor reloads itself by digest.
        let predecessor = &self.active.version;
        let cast = DrillVersions { version: &party.version, predecessor, fallback: party.fallback.as_ref() };
        let case = DrillCase { cell: &self.cell, terms: &party.terms, cast: &cast, kind, phase, seed };
        let under = party.key(&self.cell, Conditions::Canonical, seed);
        let begins = phase.map_or("anywhere", WorkPhase::name);
        let key = job_key(begins, &[under]);
        let mut shared = self.undisturbed.take(&key);
        let result = case.run(worker, &mut shared);
        if let Some(mut work) = shared
            && work.note_drilled(kind)
        {
            self.undisturbed.put(key, work);
        }
        JobOutcome::Drill(result)
    }
}
