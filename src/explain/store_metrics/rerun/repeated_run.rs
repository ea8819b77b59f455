//! Runs an evaluation once more as the engine ran it, without cached results, and names the first difference.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde::Serialize;

use holdpoint_governance::behavior::{add_search_concern, add_stress_concern, add_uncompared_concern};
use holdpoint_governance::early_stop::EarlyStopReason;
use holdpoint_governance::evidence::{Pair, SandboxMode};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::outcome::BehaviorOutcome;
use holdpoint_governance::shared_event::SceneKind;
use holdpoint_record::evidence_file::{EvidenceFile, MODE_EPISODES};
use holdpoint_record::version_concern::{Confirmation, ReEvaluationEvidence};
use holdpoint_runtime::task::TaskRecord;
use holdpoint_store::{CacheSecret, ResultCache, ResultRows, StoreError};
use holdpoint_trials::cell::Cell;
use holdpoint_trials::evaluation::{Evaluation, EvaluationPlan};
use holdpoint_trials::fault::TrialFault;
use holdpoint_trials::job_outcome::JobOutcome;
use holdpoint_trials::mode_metrics::{ComparedVersion, ModeMetrics};
use holdpoint_trials::scene_stops::SceneStops;
use holdpoint_trials::search::{Search, SearchStyle};
use holdpoint_trials::seeds::SeedSource;
use holdpoint_trials::solo_mode::SoloMode;
use holdpoint_trials::trial_lab::TrialLab;
use holdpoint_trials::undisturbed_run::UndisturbedCache;
use holdpoint_trials::worker_pool::WorkerPool;

use super::cast::Cast;
use super::recorded_evaluation::RecordedEvaluation;
use super::{Obstacle, StoreUnderRerun};
use crate::store_metrics::replay::differing;

/// An evaluation that was run once more.
pub(super) struct RepeatedRun {
    /// Episodes, drills and sequences that were run.
    pub(super) runs: u64,
    /// The first difference from the record; `None` if there is none.
    pub(super) difference: Option<String>,
}

/// Workers that use no cached result.
pub(super) struct RerunWorkers {
    worker_pool: WorkerPool<JobOutcome>,
    undisturbed: Arc<UndisturbedCache>,
    cache: ResultCache,
    cancel: AtomicBool,
}

/// A cache without results.
#[derive(Debug)]
struct NoRows;

impl ResultRows for NoRows {
    fn row(&self, _key: &Digest) -> Result<Option<(String, Vec<u8>)>, StoreError> {
        Ok(None)
    }

    fn put_row(&self, _key: &Digest, _mac: &str, _body: &[u8]) -> Result<(), StoreError> {
        Ok(())
    }

    fn delete_rows(&self) -> Result<(), StoreError> {
        Ok(())
    }
}

impl RerunWorkers {
    pub(super) fn new(jobs: usize) -> Result<Self, StoreError> {
        Ok(Self {
            worker_pool: WorkerPool::new(jobs),
            undisturbed: Arc::new(UndisturbedCache::new()),
            cache: ResultCache::in_table(Arc::new(NoRows), CacheSecret::fresh()?),
            cancel: AtomicBool::new(false),
        })
    }

    fn lab<'a>(&'a self, cell: &'a Cell, seeds: SeedSource, cast: &Cast) -> TrialLab<'a> {
        TrialLab {
            seeds,
            worker_pool: &self.worker_pool,
            undisturbed: &self.undisturbed,
            part: usize::MAX,
            cancel: &self.cancel,
            cell,
            cache: &self.cache,
            team: cast.team.clone(),
            anchor: cast.anchor.clone(),
        }
    }
}

/// The records of a comparison: the candidate's and those of the version compared with.
#[derive(Default)]
struct ComparedRecords {
    candidate: Vec<TaskRecord>,
    active: Vec<TaskRecord>,
    runs: u64,
}

impl StoreUnderRerun<'_> {
    /// Runs an evaluation once more, and compares.
    pub(super) fn run(
        &self,
        cast: &Cast,
        seeds: SeedSource,
        evaluation: &RecordedEvaluation,
    ) -> Result<RepeatedRun, Obstacle> {
        match evaluation {
            RecordedEvaluation::Sandbox(recorded) => self.sandbox(cast, seeds, recorded),
            RecordedEvaluation::Confirmation(recorded) => self.confirmation(cast, seeds, recorded),
            RecordedEvaluation::ReEvaluation(recorded, _) => self.re_evaluation(cast, seeds, recorded),
        }
    }

    fn sandbox(
        &self,
        cast: &Cast,
        seeds: SeedSource,
        recorded: &EvidenceFile,
    ) -> Result<RepeatedRun, Obstacle> {
        let Some(binding) = recorded.bindings.first().copied() else {
            return Ok(RepeatedRun { runs: 0, difference: None });
        };
        let profile = &cast.context.profile;
        let lab = self.workers.lab(&self.cell, seeds, cast);
        let subjects = (&cast.candidate, &cast.active);
        let mut again = recorded.clone();
        again.clear_sandbox();
        let (mut stops, mut runs) = (SceneStops::default(), 0);
        for solo in [SoloMode::Canonical, SoloMode::Adversarial] {
            // A hard stop ends the sandbox.
            if !stops.own.is_empty() {
                break;
            }
            let (records, unsafe_alone) = solo.run(&lab, subjects, 0..MODE_EPISODES, profile, &mut stops)?;
            again.unsafe_under_stress += unsafe_alone;
            again.alone.extend(solo.episodes(&records));
            again.note_use(&cast.candidate.version, &records);
            again.modes.extend(ModeMetrics::of(solo.mode(), ComparedVersion::Candidate, &records));
            runs += records.len() as u64;
        }
        let plan = EvaluationPlan::sandbox(profile).with_anchor(binding.anchor.is_some());
        let plan = recorded.counted.as_ref().map_or(plan, |counted| plan.with_pairs(counted.pairs));
        let mut evaluation = Evaluation::new(plan, binding, stops);
        evaluation.counted.clone_from(&recorded.counted);
        let records = self.compare(cast, &lab, &mut evaluation)?;
        runs += records.runs;
        if evaluation.assess(profile).0.assessment.outcome == BehaviorOutcome::Compatible {
            let search = Self::search(cast, &lab, &mut evaluation, recorded)?;
            again.searched = search.finding(&self.cell.sandbox);
            runs += search.pairs_run();
        }
        let (mut behavior, recovery) = evaluation.assess(profile);
        add_uncompared_concern(&mut behavior, &evaluation.stops().uncompared, profile);
        add_stress_concern(&mut behavior, again.unsafe_under_stress, MODE_EPISODES, profile);
        add_search_concern(&mut behavior, again.searched.as_ref(), profile);
        again.note_use(&cast.candidate.version, &records.candidate);
        for (version, records) in
            [(ComparedVersion::Candidate, &records.candidate), (ComparedVersion::Active, &records.active)]
        {
            again.modes.extend(ModeMetrics::of(SandboxMode::Perturbation, version, records));
        }
        again.take_comparison(&evaluation);
        again.hard_stops.clone_from(&evaluation.stops().own);
        again.shared_events.clone_from(&evaluation.stops().shared);
        again.uncompared_stops.clone_from(&evaluation.stops().uncompared);
        // What was measured comes before what the rules conclude from it.
        let mut difference = first_difference((&recorded.pairs, recorded), (&again.pairs, &again))?;
        if difference.is_none() {
            (again.behavior, again.recovery) = (Some(behavior), Some(recovery));
            difference = first_difference((&recorded.pairs, recorded), (&again.pairs, &again))?;
        }
        Ok(RepeatedRun { runs, difference })
    }

    fn confirmation(
        &self,
        cast: &Cast,
        seeds: SeedSource,
        recorded: &Confirmation,
    ) -> Result<RepeatedRun, Obstacle> {
        let (profile, binding) = (&cast.context.profile, recorded.pairs.binding);
        let plan = EvaluationPlan::confirmation(profile).with_anchor(binding.anchor.is_some());
        let mut evaluation = Evaluation::new(plan, binding, SceneStops::default());
        let lab = self.workers.lab(&self.cell, seeds, cast);
        let runs = self.compare(cast, &lab, &mut evaluation)?.runs;
        let (behavior, recovery) = evaluation.assess(profile);
        let again = Confirmation {
            pairs: evaluation.paired(),
            drills: evaluation.rehearsed(),
            anchor: evaluation.anchor().cloned(),
            handovers: evaluation.sequences().cloned(),
            behavior,
            recovery,
            kept: recorded.kept.clone(),
        };
        let difference = first_difference((&recorded.pairs.pairs, recorded), (&again.pairs.pairs, &again))?;
        Ok(RepeatedRun { runs, difference })
    }

    fn re_evaluation(
        &self,
        cast: &Cast,
        seeds: SeedSource,
        recorded: &ReEvaluationEvidence,
    ) -> Result<RepeatedRun, Obstacle> {
        let (profile, binding) = (&cast.context.profile, recorded.pairs.binding);
        let live = match &recorded.drift {
            None => Arc::clone(&self.cell.live),
            Some(drift) => Arc::new(self.cell.with_drift(&self.cell.live, drift)?),
        };
        let cell = self.cell.with_live_sandbox(&live);
        let plan = EvaluationPlan::re_evaluation(profile);
        let mut evaluation = Evaluation::new(plan, binding, SceneStops::default());
        let lab = self.workers.lab(&cell, seeds, cast);
        let runs = self.compare(cast, &lab, &mut evaluation)?.runs;
        let again = ReEvaluationEvidence {
            drift: recorded.drift,
            pairs: evaluation.paired(),
            handovers: evaluation.sequences().cloned(),
            behavior: evaluation.assess(profile).0,
            kept: recorded.kept.clone(),
        };
        let difference = first_difference((&recorded.pairs.pairs, recorded), (&again.pairs.pairs, &again))?;
        Ok(RepeatedRun { runs, difference })
    }

    /// Runs a comparison to its end.
    fn compare(
        &self,
        cast: &Cast,
        lab: &TrialLab<'_>,
        evaluation: &mut Evaluation,
    ) -> Result<ComparedRecords, TrialFault> {
        let id = cast.candidate.version.id();
        let mut found = ComparedRecords::default();
        while !evaluation.is_over() {
            let step = evaluation.step(lab, &cast.candidate, &cast.active, &cast.context.profile)?;
            let Some(slice) = step else { continue };
            found.runs += slice.worked;
            for pair in slice.pairs {
                found.candidate.push(pair.candidate);
                found.active.push(pair.active);
            }
            (self.tell)(&id, slice.done, evaluation.plan().budget());
        }
        Ok(found)
    }

    /// Searches for the worst episode. After a hard stop the recorded search ended with the pairs that ran at once, and so
    /// does this one.
    fn search(
        cast: &Cast,
        lab: &TrialLab<'_>,
        evaluation: &mut Evaluation,
        recorded: &EvidenceFile,
    ) -> Result<Search, TrialFault> {
        let profile = &cast.context.profile;
        let mut search = Search::new(lab.seeds.search_state(), SearchStyle::Evolution, profile.harm);
        let recorded_pairs = recorded
            .searched
            .as_ref()
            .map_or(0, |found| u64::from(found.tried).saturating_add(found.repeats.pairs));
        loop {
            let left = recorded_pairs.saturating_sub(search.pairs_run());
            let is_stopped = evaluation.ended() == Some(EarlyStopReason::HardStop);
            if search.is_over() || (is_stopped && left == 0) {
                return Ok(search);
            }
            let most = if left == 0 { usize::MAX } else { usize::try_from(left).unwrap_or(usize::MAX) };
            let (first, points) = search.next_points(most);
            let results = lab.places(&cast.candidate, &cast.active, first, &points)?;
            search.add_results(&results);
            for (_, new, old) in &results {
                evaluation.note_scene(SceneKind::Search, new, old, profile);
            }
        }
    }
}

/// The first difference of recorded evidence and the same made again: its pairs first, each with its place and seed.
fn first_difference<T: Serialize>(
    (recorded_pairs, recorded): (&[Pair], &T),
    (pairs, again): (&[Pair], &T),
) -> Result<Option<String>, serde_json::Error> {
    for (index, (before, now)) in recorded_pairs.iter().zip(pairs).enumerate() {
        let at = format!("pair {} (seed {})", index + 1, before.seed);
        let difference = differing(&at, &serde_json::to_value(before)?, &serde_json::to_value(now)?);
        if difference.is_some() {
            return Ok(difference);
        }
    }
    Ok(differing("evidence", &serde_json::to_value(recorded)?, &serde_json::to_value(again)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::evidence::EpisodeValues;

    #[test]
    fn the_first_difference_is_that_of_the_first_pair_that_differs() {
        let pair = |seed| {
            let (active, candidate) = (EpisodeValues::CLEAN, EpisodeValues::CLEAN);
            Pair { seed, active, candidate, live_like: false }
        };
        let recorded: Vec<Pair> = [3, 5, 9].map(pair).to_vec();
        let compare = |again: &Vec<Pair>| first_difference((&recorded, &recorded), (again, again)).unwrap();
        assert_eq!(compare(&recorded), None);
        let mut again = recorded.clone();
        again[1].candidate.success = !again[1].candidate.success;
        again[2].active.violation = !again[2].active.violation;
        let (on_record, now) = (recorded[1].candidate.success, again[1].candidate.success);
        let expected =
            format!("pair 2 (seed 5).candidate.success is {on_record} on record and {now} when replayed");
        assert_eq!(compare(&again), Some(expected));
        // A pair that is missing is found in the whole.
        assert!(compare(&recorded[..2].to_vec()).unwrap().starts_with("evidence is ["));
    }
}
