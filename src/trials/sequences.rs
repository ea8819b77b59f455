//! Runs whole sequences, once with a candidate for its task and once with the active version.
//!
//! The dispatch is that of the live cell: a version that is not admitted is not started, and a task that is not done
//! ends the sequence. Judges nothing.

use holdpoint_body::TaskKind;
use holdpoint_cell::{CellError, EpisodeSetup};
use holdpoint_runtime::task::{Supervision, TaskRecord};

use super::trial_lab::TrialSubject;
use super::worker::Worker;
use crate::cell::{Cell, Conditions};

/// What whole sequences of an evaluation are sampled from.
const CONDITIONS: Conditions = Conditions::Sandbox;

/// The records of one sequence, with the candidate and with the active version for the candidate's task.
pub type SequenceRecords = (Vec<TaskRecord>, Vec<TaskRecord>);

/// The active versions of the families beside a candidate's, in the order of execution.
#[derive(Clone, Default)]
pub struct TrialTeam(Vec<TrialSubject>);

impl TrialTeam {
    /// Those of `subjects` that run another task of the cell's `sequence` than `candidate_task`, in the order of execution.
    #[must_use]
    pub fn excluding(
        sequence: &[TaskKind],
        candidate_task: TaskKind,
        subjects: impl IntoIterator<Item = TrialSubject>,
    ) -> Self {
        let task = |member: &TrialSubject| member.version.bundle.task();
        let mut members: Vec<TrialSubject> = subjects
            .into_iter()
            .filter(|subject| task(subject) != candidate_task && sequence.contains(&task(subject)))
            .collect();
        members.sort_by_key(|member| sequence.iter().position(|known| *known == task(member)));
        members.dedup_by_key(|member| member.version.bundle.task());
        Self(members)
    }

    /// The versions.
    #[must_use]
    pub fn members(&self) -> &[TrialSubject] {
        &self.0
    }

    /// The version for each task of the cell's `sequence` if `subject` runs its own task; `None` if a task has no version.
    #[must_use]
    pub fn lineup_with<'a>(
        &'a self,
        sequence: &[TaskKind],
        subject: &'a TrialSubject,
    ) -> Option<Vec<&'a TrialSubject>> {
        let version_for = |task: TaskKind| {
            let mut all = std::iter::once(subject).chain(&self.0);
            all.find(|member| member.version.bundle.task() == task)
        };
        sequence.iter().copied().map(version_for).collect()
    }

    /// The versions for the tasks of the cell's `sequence` before `task`, in order; `None` if one of them has no version.
    #[must_use]
    pub fn before(&self, sequence: &[TaskKind], task: TaskKind) -> Option<Vec<&TrialSubject>> {
        let version_for = |task: TaskKind| self.0.iter().find(|member| member.version.bundle.task() == task);
        sequence.iter().copied().take_while(|earlier| *earlier != task).map(version_for).collect()
    }
}

/// Runs one sequence of the sandbox's distribution; if the cell fails, the last record is invalid.
#[must_use]
pub fn run_sequence(
    worker: &mut Worker,
    cell: &Cell,
    lineup: &[&TrialSubject],
    seed: u64,
) -> Vec<TaskRecord> {
    let mut records = Vec::with_capacity(lineup.len());
    let set_up = worker.arm(cell, &setup(cell, CONDITIONS, seed)).map(|_| ());
    let outcome = set_up.and_then(|()| run_tasks(worker, cell, lineup, (CONDITIONS, seed), &mut records));
    records_with_failure(worker, outcome.map(|_| ()), (cell, lineup, seed), records)
}

/// Runs a sequence with either of two versions for `candidate_task`; both share one run of the tasks before it, in a cell
/// that exports its state. The records equal those of two separate calls of [`run_sequence`].
#[must_use]
pub fn run_sequence_pair(
    worker: &mut Worker,
    cell: &Cell,
    lineups: [&[&TrialSubject]; 2],
    candidate_task: TaskKind,
    seed: u64,
) -> [Vec<TaskRecord>; 2] {
    if !cell.spec.abilities.export_state {
        return lineups.map(|lineup| run_sequence(worker, cell, lineup, seed));
    }
    let sequence = &cell.spec.tasks;
    let shared_tasks = sequence.iter().take_while(|task| **task != candidate_task).count();
    let [shared_lineup, _] = lineups.map(|lineup| lineup.get(..shared_tasks).unwrap_or_default());
    let mut shared_records = Vec::with_capacity(sequence.len());
    let set_up = worker.arm(cell, &setup(cell, CONDITIONS, seed)).map(|_| ());
    let world_after = set_up
        .and_then(|()| run_tasks(worker, cell, shared_lineup, (CONDITIONS, seed), &mut shared_records))
        .and_then(|is_done| Ok(if is_done { Some(worker.built_arm()?.body().copy()?) } else { None }));
    let world = match world_after {
        Ok(Some(world)) => world,
        Ok(None) => return [shared_records.clone(), shared_records],
        Err(error) => {
            let records =
                records_with_failure(worker, Err(error), (cell, shared_lineup, seed), shared_records);
            return [records.clone(), records];
        }
    };
    lineups.map(|lineup| {
        let (mut records, rest) = (shared_records.clone(), lineup.get(shared_tasks..).unwrap_or_default());
        let set_up = worker.arm_from(cell, &world).map(|_| ());
        let outcome = set_up.and_then(|()| run_tasks(worker, cell, rest, (CONDITIONS, seed), &mut records));
        records_with_failure(worker, outcome.map(|_| ()), (cell, lineup, seed), records)
    })
}

/// Everything that is drawn for a sequence.
pub(super) fn setup(cell: &Cell, conditions: Conditions, seed: u64) -> EpisodeSetup {
    EpisodeSetup::sample(cell.spec.first_task(), &cell.scene, cell.distribution(conditions), seed)
}

/// Runs tasks one after the other from the present state of the worker's arm. Returns whether all were done.
pub(super) fn run_tasks(
    worker: &mut Worker,
    cell: &Cell,
    subjects: &[&TrialSubject],
    (conditions, seed): (Conditions, u64),
    records: &mut Vec<TaskRecord>,
) -> Result<bool, CellError> {
    let arm = worker.built_arm()?;
    for subject in subjects {
        let trial = subject.trial(cell, conditions, seed);
        arm.body_mut().begin_task(subject.version.bundle.task());
        if !trial.is_admitted(arm) {
            records.push(trial.refused());
            return Ok(false);
        }
        let record = trial.start().finish(&mut arm.handle(), &mut |_, _| Supervision::Continue)?;
        let is_done = record.success;
        records.push(record);
        if !is_done {
            return Ok(false);
        }
    }
    Ok(true)
}

/// The records, with an invalid one at the end if the cell failed.
fn records_with_failure(
    worker: &mut Worker,
    outcome: Result<(), CellError>,
    (cell, lineup, seed): (&Cell, &[&TrialSubject], u64),
    mut records: Vec<TaskRecord>,
) -> Vec<TaskRecord> {
    if let Err(error) = outcome {
        let next = lineup.get(records.len()).map(|subject| subject.version.bundle.task());
        let task = next.unwrap_or_else(|| cell.spec.last_task());
        records.push(worker.failed(error, task, seed));
    }
    records
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::embedded;
    use crate::seeds::{CALIBRATION_FROM_RUN, SeedPurpose, episode_seed};
    use holdpoint_governance::policy::PolicyTable;
    use holdpoint_governance::profile::{Profile, ProfileName};
    use holdpoint_runtime::terms::SkillTerms;
    use holdpoint_sim::SimCells;
    use std::sync::Arc;

    /// Team and lineup have the tasks of the cell's sequence, in its order, whatever other versions there are.
    #[test]
    fn a_lineup_follows_the_sequence_of_the_cell() {
        let (cell, profile) =
            (Cell::of(&SimCells, None).unwrap(), Profile::builtin(ProfileName::Sim).unwrap());
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
        let baselines = embedded::baselines().unwrap().into_iter();
        let in_sequence = baselines.filter(|version| version.id().family.as_str() != "park");
        let all: Vec<TrialSubject> = in_sequence
            .map(|version| TrialSubject { version, terms: terms.clone(), fallback: None })
            .collect();
        let tasks = |subjects: &[&TrialSubject]| -> Vec<TaskKind> {
            subjects.iter().map(|subject| subject.version.bundle.task()).collect()
        };
        let [grasp, align, place] = [TaskKind::Grasp, TaskKind::Align, TaskKind::Place];
        let own = all.iter().find(|subject| subject.version.bundle.task() == place).unwrap();
        for (sequence, before) in
            [(vec![grasp, align, place], vec![grasp, align]), (vec![grasp, place], vec![grasp])]
        {
            let team = TrialTeam::excluding(&sequence, place, all.iter().rev().cloned());
            assert_eq!(tasks(&team.members().iter().collect::<Vec<_>>()), before);
            assert_eq!(tasks(&team.before(&sequence, place).unwrap()), before);
            assert_eq!(tasks(&team.lineup_with(&sequence, own).unwrap()), sequence);
        }
        let backwards = [place, align, grasp];
        let team = TrialTeam::excluding(&backwards, place, all.iter().cloned());
        assert_eq!(tasks(&team.members().iter().collect::<Vec<_>>()), [align, grasp]);
        assert!(team.before(&backwards, place).unwrap().is_empty());
    }

    /// The pair shares the tasks before the candidate's, whichever task that is.
    #[test]
    fn a_sequence_pair_has_the_records_of_two_separate_sequences() {
        let (cell, profile) =
            (Cell::of(&SimCells, None).unwrap(), Profile::builtin(ProfileName::Sim).unwrap());
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
        let subject = |version| TrialSubject { version, terms: terms.clone(), fallback: None };
        let all: Vec<TrialSubject> = embedded::baselines().unwrap().into_iter().map(subject).collect();
        let mut worker = Worker::new();
        let mut unforked = cell.clone();
        Arc::make_mut(&mut unforked.spec).abilities.export_state = false;
        let mut lengths = std::collections::BTreeSet::new();
        for task in TaskKind::SEQUENCE {
            let runs_task = |subject: &&TrialSubject| subject.version.id().family.to_string() == task.name();
            let active = all.iter().find(runs_task).unwrap();
            let mut slower = active.clone();
            slower.terms = slower.terms.tightened(0.6);
            let beside = all.iter().filter(|subject| subject.version.id().family.to_string() != "park");
            let sequence = &cell.spec.tasks;
            let team = TrialTeam::excluding(sequence, task, beside.cloned());
            let both = [&slower, active].map(|subject| team.lineup_with(sequence, subject).unwrap());
            let lineups = both.each_ref().map(Vec::as_slice);
            for index in 0..4 {
                let seed = episode_seed(CALIBRATION_FROM_RUN + 9, SeedPurpose::Sequence, index);
                let pair = run_sequence_pair(&mut worker, &cell, lineups, task, seed);
                let separate = lineups.map(|lineup| run_sequence(&mut worker, &cell, lineup, seed));
                assert_eq!(pair, separate, "{task} {seed}");
                if index == 0 {
                    let pair = run_sequence_pair(&mut worker, &unforked, lineups, task, seed);
                    assert_eq!(pair, separate, "{task} {seed} without forks");
                }
                lengths.extend(pair.iter().map(Vec::len));
            }
        }
        assert!(lengths.contains(&3), "some sequences come to their end: {lengths:?}");
    }
}
