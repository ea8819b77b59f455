//! Runs whole sequences, once with a candidate for its task and once with the active version.
//!
//! The dispatch is that of the live cell: a version that is not admitted is not started, and a task that is not done
//! ends the sequence. Judges nothing.

use holdpoint_body::TaskKind;
use holdpoint_runtime::task::{Supervision, TaskRecord};
use holdpoint_sim::SimError;
use holdpoint_sim::episode::EpisodeSetup;

use super::trial_lab::TrialSubject;
use super::undisturbed_run::TrialCase;
use super::worker::Worker;
use crate::cell::{Cell, Conditions};

/// The records of one sequence, with the candidate and with the active version for the candidate's task.
pub type SequenceRecords = (Vec<TaskRecord>, Vec<TaskRecord>);

/// The active versions of the families beside a candidate's, in the order of execution.
#[derive(Clone, Default)]
pub struct TrialTeam(Vec<TrialSubject>);

impl TrialTeam {
    /// Those of `parties` that run a task of a sequence other than `place`, in the order of execution.
    #[must_use]
    pub fn excluding(place: TaskKind, parties: impl IntoIterator<Item = TrialSubject>) -> Self {
        let mut beside: Vec<TrialSubject> =
            parties.into_iter().filter(|party| party.version.bundle.task() != place).collect();
        beside.sort_by_key(|party| party.version.bundle.task());
        beside.dedup_by_key(|party| party.version.bundle.task());
        Self(beside)
    }

    /// The versions.
    #[must_use]
    pub fn members(&self) -> &[TrialSubject] {
        &self.0
    }

    /// The version for each task if `own` is in its place; `None` if one is missing.
    #[must_use]
    pub fn cast<'a>(&'a self, own: &'a TrialSubject) -> Option<[&'a TrialSubject; 3]> {
        let of = |task| {
            let mut all = std::iter::once(own).chain(&self.0);
            all.find(|party| party.version.bundle.task() == task)
        };
        let [first, second, third] = TaskKind::SEQUENCE;
        Some([of(first)?, of(second)?, of(third)?])
    }
}

/// Runs one sequence of the sandbox's distribution; if the simulator fails, the last record is invalid.
#[must_use]
pub fn sequence(worker: &mut Worker, cell: &Cell, cast: [&TrialSubject; 3], seed: u64) -> Vec<TaskRecord> {
    let mut records = Vec::with_capacity(cast.len());
    let begun = worker.arm(cell, &setup(cell, seed)).map(|_| ());
    let ended = begun.and_then(|()| work(worker, cell, &cast, seed, &mut records));
    close(worker, ended.map(|_| ()), &cast, seed, records)
}

/// Runs a sequence with either of two versions for the task `place`; both share one run of the tasks before it. The
/// records equal those of two separate calls of [`sequence`].
#[must_use]
pub fn sequences(
    worker: &mut Worker,
    cell: &Cell,
    casts: [[&TrialSubject; 3]; 2],
    place: TaskKind,
    seed: u64,
) -> [Vec<TaskRecord>; 2] {
    let before = TaskKind::SEQUENCE.iter().take_while(|task| **task < place).count();
    let [ahead, _] = casts.map(|cast| cast.into_iter().take(before).collect::<Vec<_>>());
    let mut first = Vec::with_capacity(TaskKind::SEQUENCE.len());
    let begun = worker.arm(cell, &setup(cell, seed)).map(|_| ());
    let handed = begun
        .and_then(|()| work(worker, cell, &ahead, seed, &mut first))
        .and_then(|is_done| Ok(if is_done { Some(worker.built_arm()?.body().copy()) } else { None }));
    let copy = match handed {
        Ok(Some(copy)) => copy,
        Ok(None) => return [first.clone(), first],
        Err(error) => {
            let records = close(worker, Err(error), &ahead, seed, first);
            return [records.clone(), records];
        }
    };
    casts.map(|cast| {
        let (mut records, rest) = (first.clone(), cast.get(before..).unwrap_or_default());
        let begun = worker.arm_from(cell, &copy).map(|_| ());
        let ended = begun.and_then(|()| work(worker, cell, rest, seed, &mut records));
        close(worker, ended.map(|_| ()), &cast, seed, records)
    })
}

fn setup(cell: &Cell, seed: u64) -> EpisodeSetup {
    EpisodeSetup::sample(TaskKind::Grasp, &cell.scene, cell.distribution(Conditions::Sandbox), seed)
}

/// Runs tasks one after the other from the present state of the worker's arm. Returns whether all were done.
fn work(
    worker: &mut Worker,
    cell: &Cell,
    cast: &[&TrialSubject],
    seed: u64,
    records: &mut Vec<TaskRecord>,
) -> Result<bool, SimError> {
    let arm = worker.built_arm()?;
    for party in cast {
        let version = &party.version;
        let trial = TrialCase { cell, terms: &party.terms, version, conditions: Conditions::Sandbox, seed };
        arm.body_mut().begin_task(version.bundle.task());
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

/// The records, with an invalid one at the end if the world failed.
fn close(
    worker: &mut Worker,
    ended: Result<(), SimError>,
    cast: &[&TrialSubject],
    seed: u64,
    mut records: Vec<TaskRecord>,
) -> Vec<TaskRecord> {
    if ended.is_err() {
        let task = cast.get(records.len()).map_or(TaskKind::Place, |party| party.version.bundle.task());
        records.push(worker.failed(task, seed));
    }
    records
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::embedded;
    use crate::trial::seeds::{CALIBRATION_FROM_RUN, SeedPurpose, episode_seed};
    use holdpoint_governance::policy::PolicyTable;
    use holdpoint_governance::profile::{Profile, ProfileName};
    use holdpoint_runtime::terms::SkillTerms;
    use std::sync::Arc;

    /// A result run once for both equals the result that each would have alone, wherever the candidate's place is.
    #[test]
    fn what_comes_before_the_place_is_worked_once_and_comes_to_the_same() {
        let (cell, profile) = (Cell::builtin().unwrap(), Profile::builtin(ProfileName::Sim).unwrap());
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
        let party = |version| TrialSubject { version, terms: terms.clone(), fallback: None };
        let all: Vec<TrialSubject> = embedded::baselines().unwrap().into_iter().map(party).collect();
        let mut worker = Worker::new();
        let mut lengths = std::collections::BTreeSet::new();
        for place in TaskKind::SEQUENCE {
            let works = |party: &&TrialSubject| party.version.id().family.to_string() == place.name();
            let own = all.iter().find(works).unwrap();
            let mut slower = own.clone();
            slower.terms = slower.terms.tightened(0.6);
            let beside = all.iter().filter(|party| party.version.id().family.to_string() != "park");
            let team = TrialTeam::excluding(place, beside.cloned());
            let casts = [team.cast(&slower).unwrap(), team.cast(own).unwrap()];
            for index in 0..4 {
                let seed = episode_seed(CALIBRATION_FROM_RUN + 9, SeedPurpose::Sequence, index);
                let both = sequences(&mut worker, &cell, casts, place, seed);
                assert_eq!(
                    both,
                    casts.map(|cast| sequence(&mut worker, &cell, cast, seed)),
                    "{place} {seed}"
                );
                lengths.extend(both.iter().map(Vec::len));
            }
        }
        assert!(lengths.contains(&3), "some sequences come to their end: {lengths:?}");
    }
}
