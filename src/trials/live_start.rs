//! Single tasks from the starts of the live cell: its distribution, and the state in which the tasks before leave it.
//!
//! The first task of a live sequence begins at a reset of the world. Each later task begins where the one before ended,
//! and only if that was done. So the active versions of the earlier tasks run first. A seed whose sequence does not come
//! to the task is replaced. A version sees the same start as in the live cell. Judges nothing.

use holdpoint_body::TaskKind;
use holdpoint_cell::rng::Stream;
use holdpoint_cell::{CellError, EpisodeSetup};
use holdpoint_governance::ids::Digest;
use holdpoint_runtime::task::TaskRecord;

use super::episodes::{alone_here, pair_here};
use super::seeds::KEYED_FROM;
use super::sequences::{TrialTeam, run_tasks, setup};
use super::trial_subject::TrialSubject;
use super::worker::Worker;
use crate::cell::{Cell, Conditions};

/// What the live cell samples from.
const CONDITIONS: Conditions = Conditions::Live;

/// Seeds tried for one start. A cell that comes to the task in half of its sequences misses one start in 256.
const SEEDS_TRIED: usize = 8;

/// The episode of a version from the live start of a seed. Its record has the first seed tried that comes to the task; it
/// is invalid if none does.
#[must_use]
pub fn alone_from_live_start(
    worker: &mut Worker,
    cell: &Cell,
    team: &TrialTeam,
    subject: &TrialSubject,
    seed: u64,
) -> TaskRecord {
    let task = subject.version.bundle.task();
    match reach(worker, cell, team, task, seed) {
        Ok(Some(seed)) => alone_here(worker, &subject.trial(cell, CONDITIONS, seed)),
        Ok(None) => TaskRecord::invalid(task, seed),
        Err(error) => worker.failed(error, task, seed),
    }
}

/// As [`alone_from_live_start`], of two versions from one start. A cell that cannot export its state comes to it twice.
#[must_use]
pub fn pair_from_live_start(
    worker: &mut Worker,
    cell: &Cell,
    team: &TrialTeam,
    both: [&TrialSubject; 2],
    seed: u64,
) -> [TaskRecord; 2] {
    if !cell.spec.abilities.export_state {
        return both.map(|subject| alone_from_live_start(worker, cell, team, subject, seed));
    }
    let [first, _] = both;
    let task = first.version.bundle.task();
    match reach(worker, cell, team, task, seed) {
        Ok(Some(seed)) => pair_here(worker, both.map(|subject| subject.trial(cell, CONDITIONS, seed))),
        Ok(None) => both.map(|_| TaskRecord::invalid(task, seed)),
        Err(error) => both.map(|_| worker.failed(error.clone(), task, seed)),
    }
}

/// Everything that is drawn for a task from the live start of a seed that comes to it.
#[must_use]
pub fn setup_of(cell: &Cell, team: &TrialTeam, task: TaskKind, seed: u64) -> EpisodeSetup {
    if team.before(&cell.spec.tasks, task).is_some() {
        setup(cell, CONDITIONS, seed)
    } else {
        // No live sequence comes to a task behind an empty place, so it begins by itself.
        EpisodeSetup::sample(task, &cell.scene, cell.distribution(CONDITIONS), seed)
    }
}

/// What determines the episode of a version from the live start of a seed: the versions before it, too.
pub(super) fn key(cell: &Cell, team: &TrialTeam, subject: &TrialSubject, seed: u64) -> Digest {
    let before = team.before(&cell.spec.tasks, subject.version.bundle.task()).unwrap_or_default();
    let under = |one: &TrialSubject| one.key(cell, CONDITIONS, seed);
    let digests: Vec<Digest> = std::iter::once(subject).chain(before).map(under).collect();
    let parts: Vec<&[u8]> = digests.iter().map(|digest| digest.bytes().as_slice()).collect();
    Digest::of_parts("holdpoint.live-start.v1", &parts)
}

/// Brings the worker's arm to the live start of a seed, or of one that replaces it. Returns the seed of the start.
fn reach(
    worker: &mut Worker,
    cell: &Cell,
    team: &TrialTeam,
    task: TaskKind,
    seed: u64,
) -> Result<Option<u64>, CellError> {
    let before = team.before(&cell.spec.tasks, task);
    for seed in seeds_tried(seed) {
        worker.arm(cell, &setup_of(cell, team, task, seed))?;
        let Some(before) = &before else { return Ok(Some(seed)) };
        if run_tasks(worker, cell, before, (CONDITIONS, seed), &mut Vec::new())? {
            worker.built_arm()?.body_mut().begin_task(task);
            worker.restart_film();
            return Ok(Some(seed));
        }
    }
    Ok(None)
}

/// The seeds that are tried for the live start of a seed, that one first.
pub fn seeds_tried(seed: u64) -> impl Iterator<Item = u64> {
    std::iter::successors(Some(seed), |seed| Some(replacement(*seed))).take(SEEDS_TRIED)
}

/// The seed that replaces one: among the keyed seeds if that is one, and else below them. So every reader of JSON has all of
/// its digits.
fn replacement(seed: u64) -> u64 {
    let bits = Stream::from_state(seed ^ 0x11fe_57a2_7000_0001).bits() % KEYED_FROM;
    if (KEYED_FROM..2 * KEYED_FROM).contains(&seed) { KEYED_FROM + bits } else { bits }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::embedded;
    use crate::episodes::alone;
    use crate::seeds::{CALIBRATION_FROM_RUN, SeedPurpose, episode_seed};
    use crate::undisturbed_run::TrialCase;
    use holdpoint_governance::ids::Family;
    use holdpoint_governance::policy::PolicyTable;
    use holdpoint_governance::profile::{Profile, ProfileName};
    use holdpoint_runtime::capability::Capability;
    use holdpoint_runtime::terms::SkillTerms;
    use holdpoint_sim::SimCells;
    use std::collections::BTreeMap;
    use std::sync::Arc;

    struct Bench {
        cell: Cell,
        terms: SkillTerms,
        active: BTreeMap<Family, Capability>,
    }

    impl Bench {
        fn new() -> Self {
            let (cell, profile) =
                (Cell::of(&SimCells, None).unwrap(), Profile::builtin(ProfileName::Sim).unwrap());
            let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
            let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
            let baselines = embedded::baselines().unwrap().into_iter();
            let in_sequence = baselines.filter(|version| version.id().family.as_str() != "park");
            let active = in_sequence.map(|version| (version.id().family, version)).collect();
            Self { cell, terms, active }
        }

        fn subject(&self, task: TaskKind) -> TrialSubject {
            let version = self.active[&Family::from(task)].clone();
            TrialSubject { version, terms: self.terms.clone(), fallback: None }
        }

        fn team(&self, task: TaskKind) -> TrialTeam {
            let sequence = &self.cell.spec.tasks;
            TrialTeam::excluding(sequence, task, sequence.iter().map(|task| self.subject(*task)))
        }
    }

    fn seed(index: u64) -> u64 {
        episode_seed(CALIBRATION_FROM_RUN + 11, SeedPurpose::Live, index)
    }

    #[test]
    fn seed_that_does_not_come_to_the_task_is_replaced() {
        let bench = Bench::new();
        let task = TaskKind::Place;
        let (subject, mut team) = (bench.subject(task), bench.team(task));
        let mut worker = Worker::new();
        let mut run =
            |team: &TrialTeam, seed| alone_from_live_start(&mut worker, &bench.cell, team, &subject, seed);
        let replaced: Vec<u64> = (0..40).map(seed).filter(|seed| run(&team, *seed).seed != *seed).collect();
        assert!(!replaced.is_empty() && replaced.len() < 40, "{replaced:?}");
        for seed in replaced {
            let record = run(&team, seed);
            assert!(!record.invalid && record.seed < 1 << 53, "{record:?}");
            assert_eq!(run(&team, record.seed), record, "the seed of a start comes to the task itself");
        }
        // At a twentieth of its speed and force no grasp is done in time.
        let slow = |subject: TrialSubject| TrialSubject { terms: subject.terms.tightened(0.05), ..subject };
        let slow_members = team.members().iter().cloned().map(slow);
        team = TrialTeam::excluding(&bench.cell.spec.tasks, task, slow_members);
        assert!(run(&team, seed(0)).invalid);
    }

    #[test]
    fn keyed_seeds_are_replaced_by_keyed_seeds_and_others_by_others() {
        for seed in [seed(0), KEYED_FROM - 1, 3 << 60] {
            assert!(seeds_tried(seed).skip(1).all(|tried| tried < KEYED_FROM), "{seed}");
        }
        for seed in [KEYED_FROM, 2 * KEYED_FROM - 1] {
            let tried: Vec<u64> = seeds_tried(seed).collect();
            assert_eq!((tried.len(), tried.first()), (SEEDS_TRIED, Some(&seed)));
            assert!(tried.iter().all(|tried| (KEYED_FROM..2 * KEYED_FROM).contains(tried)), "{tried:?}");
        }
    }

    #[test]
    fn task_behind_an_empty_place_begins_by_itself() {
        let bench = Bench::new();
        let subject = bench.subject(TaskKind::Align);
        let no_team = TrialTeam::default();
        let (cell, seed) = (&bench.cell, seed(3));
        let found = alone_from_live_start(&mut Worker::new(), cell, &no_team, &subject, seed);
        let (terms, version) = (&subject.terms, &subject.version);
        let case = TrialCase { cell, terms, version, conditions: Conditions::Live, seed };
        assert_eq!(found, alone(&mut Worker::new(), case));
        assert_eq!(setup_of(cell, &no_team, TaskKind::Align, seed), case.setup());
        let of_sequence = setup_of(cell, &bench.team(TaskKind::Align), TaskKind::Align, seed);
        assert_eq!((of_sequence.task, of_sequence.distribution.as_str()), (TaskKind::Grasp, "live"));
    }
}
