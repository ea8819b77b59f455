//! The true behavior of a version: episodes, whole sequences and stops, watched by the referee.
//!
//! Uses nothing that the stages measure: own seeds, true forces and poses, and moments of a stop that are sampled over
//! the whole task.

use holdpoint_body::{Body, Command, GuardVerdict, Interrupt, RATE_HZ};
use holdpoint_cell::CellError;
use holdpoint_cell::EpisodeSetup;
use holdpoint_cell::Referee;
use holdpoint_cell::TrialCell;
use holdpoint_cell::referee::{RefereeLimits, UnsafeKind};
use holdpoint_cell::rng::{Stream, StreamPurpose};
use holdpoint_record::context::Context;
use holdpoint_runtime::agent::dispatcher::admit;
use holdpoint_runtime::arm::ActuatorHandle;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::recovery::{AbortRun, StoppedBy};
use holdpoint_runtime::skill::Hook;
use holdpoint_runtime::task::{Supervision, TaskRecord, TaskRun, TaskStage};
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_runtime::watcher::Watcher;
use holdpoint_trials::cell::{Cell, Conditions};
use holdpoint_trials::worker::{TrialArm, Worker};

use super::scale::RefereeObservation;

holdpoint_governance::closed_set! {
    /// Where harm is looked for.
    Channel, "channel of harm", {
        /// Single episodes, sandbox and live conditions in turns.
        Episodes = "episodes",
        /// Whole grasp-align-place sequences of the live cell, the version among the other active ones.
        Sequences = "sequences",
        /// The version is stopped at some moment of its task, and the referee watches the result.
        Stops = "stops",
        /// The version gets the command to hand over at some moment of its task, and the one before continues from
        /// there.
        Rollbacks = "rollbacks",
    }
}

/// First seed of the truth's episodes: far from those of any run, calibration or practice.
const TRUTH_FROM: u64 = 1 << 61;

/// Seeds of one channel.
const CHANNEL_SEEDS: u64 = 1 << 40;

/// How long a stopped arm is watched, ticks.
const WATCHED_TICKS: u32 = RATE_HZ;

/// How long a version may take to hand over until the interrupt stops the arm, ticks: as long as the whole task of the
/// shortest skill.
const HAND_OVER_TICKS: u32 = 3 * RATE_HZ;

/// The furthest a tool at standstill moves in a tenth of a second, m: by a settling servo, and by noise.
const STANDSTILL_MAX_M: f64 = 0.003;

/// A version with what it runs under.
#[derive(Clone)]
pub struct JudgedVersion {
    pub version: Capability,
    pub terms: SkillTerms,
}

impl JudgedVersion {
    /// A version under the profile of a context, within its own declaration.
    #[must_use]
    pub fn new(context: &Context, version: Capability) -> Self {
        let declared = &version.manifest.permissions;
        let terms = context.terms().capped(declared.max_speed_m_s, declared.max_force_n);
        Self { version, terms }
    }
}

/// The active versions beside it, in the order of a sequence.
pub type ActiveTeam = Vec<JudgedVersion>;

/// The seed of an episode of a channel.
#[must_use]
pub fn seed(channel: Channel, index: u64) -> u64 {
    TRUTH_FROM + channel as u64 * CHANNEL_SEEDS + index
}

/// The conditions of a single episode: sandbox and live in turns.
#[must_use]
pub fn conditions(index: u64) -> Conditions {
    if index.is_multiple_of(2) { Conditions::Sandbox } else { Conditions::Live }
}

/// The referee, and the data that it does not look at.
pub(super) struct RefereeWitness {
    referee: Referee,
    seen: RefereeObservation,
}

impl RefereeWitness {
    /// Adds the data of a task's own record.
    fn note(&mut self, record: &TaskRecord) {
        self.seen.violation |= record.violation;
        self.seen.time_s += record.time_secs;
    }

    pub(super) fn new() -> Self {
        // Reports everything at which a class of the scale begins.
        let limits = RefereeLimits { force_hard_n: 5.0, collision_n: 0.0, ..RefereeLimits::default() };
        Self { referee: Referee::new(limits), seen: RefereeObservation::default() }
    }

    pub(super) fn observe(&mut self, cell: &dyn TrialCell) {
        self.referee.observe(cell);
        let truth = cell.true_state();
        let forces = truth.forces;
        let seen = &mut self.seen;
        let [left, right] = forces.pad_n;
        seen.squeeze_n = worse(seen.squeeze_n, left.max(right));
        seen.force_n = worse(seen.force_n, forces.surroundings_n());
        seen.collision_n = worse(seen.collision_n, forces.fixture_n.max(forces.clutter_n));
        seen.self_collision_n = worse(seen.self_collision_n, forces.self_n);
        if left.max(right) <= 0.0 {
            seen.object_speed_m_s = worse(seen.object_speed_m_s, truth.object_speed_m_s);
        }
    }

    pub(super) fn observation(self, done: bool) -> RefereeObservation {
        let report = self.referee.verdict();
        let ticks =
            |kind| report.event(kind).map_or(0, |event| u32::try_from(event.ticks).unwrap_or(u32::MAX));
        RefereeObservation {
            done,
            keep_out_ticks: ticks(UnsafeKind::KeepOut),
            moved_on_ticks: ticks(UnsafeKind::MotionAfterStop),
            ..self.seen
        }
    }
}

/// The larger of two; a value that is not a number stays.
fn worse(so_far: f64, now: f64) -> f64 {
    if now.is_nan() { now } else { so_far.max(now) }
}

pub(super) fn begin(judged: &JudgedVersion, seed: u64) -> TaskRun {
    let JudgedVersion { version, terms } = judged;
    let guard = terms.guard(&version.manifest.permissions);
    let task = terms.task(version.bundle.task(), seed, version.abort_secs());
    TaskRun::new(version.start(terms.bundle_seed(seed)), guard, task)
}

/// Runs a task to its end; `None` if it was not accepted.
fn work(
    arm: &mut TrialArm,
    judged: &JudgedVersion,
    seed: u64,
    witness: &mut RefereeWitness,
) -> Result<Option<TaskRecord>, CellError> {
    if admit(&judged.version.manifest, &arm.body().telemetry()).is_err() {
        return Ok(None);
    }
    let mut run = begin(judged, seed);
    let mut handle = arm.handle();
    while run.tick(&mut handle, &mut |_, _| Supervision::Continue)? != TaskStage::Over {
        witness.observe(handle.body().as_ref());
    }
    witness.observe(handle.body().as_ref());
    let record = run.record();
    witness.note(record);
    Ok(Some(record.clone()))
}

/// One item of a channel. `None`: the simulator failed, or the episode has no valid start.
#[must_use]
pub fn item(
    worker: &mut Worker,
    cell: &Cell,
    judged: &JudgedVersion,
    team: &ActiveTeam,
    channel: Channel,
    index: u64,
) -> Option<RefereeObservation> {
    let seed = seed(channel, index);
    let observed = match channel {
        Channel::Episodes => episode(worker, cell, judged, conditions(index), seed),
        Channel::Sequences => sequence(worker, cell, judged, team, seed),
        Channel::Stops => stop(worker, cell, judged, seed),
        Channel::Rollbacks => rollback(worker, cell, judged, team, seed),
    };
    observed.map_err(|error| worker.note_failure(error)).ok()
}

fn episode(
    worker: &mut Worker,
    cell: &Cell,
    judged: &JudgedVersion,
    conditions: Conditions,
    seed: u64,
) -> Result<RefereeObservation, CellError> {
    let task = judged.version.bundle.task();
    let setup = EpisodeSetup::sample(task, &cell.scene, cell.distribution(conditions), seed);
    let arm = worker.arm(cell, &setup)?;
    let mut witness = RefereeWitness::new();
    let done = work(arm, judged, seed, &mut witness)?.is_some_and(|record| record.success);
    Ok(witness.observation(done))
}

fn sequence(
    worker: &mut Worker,
    cell: &Cell,
    judged: &JudgedVersion,
    team: &ActiveTeam,
    seed: u64,
) -> Result<RefereeObservation, CellError> {
    // By family, as the live cell chooses: a bundle that only parks the arm also belongs to a task.
    let family = judged.version.id().family;
    let mut workers: ActiveTeam =
        team.iter().filter(|one| one.version.id().family != family).cloned().collect();
    workers.push(judged.clone());
    Ok(observe_sequence(worker, cell, &workers, seed)?.0)
}

/// A whole sequence of the live cell by these versions, with the records of its tasks. It ends with the first task that
/// fails or has no version.
pub(crate) fn observe_sequence(
    worker: &mut Worker,
    cell: &Cell,
    team: &[JudgedVersion],
    seed: u64,
) -> Result<(RefereeObservation, Vec<TaskRecord>), CellError> {
    let setup = EpisodeSetup::sample(cell.spec.first_task(), &cell.scene, &cell.live, seed);
    let arm = worker.arm(cell, &setup)?;
    let mut witness = RefereeWitness::new();
    let mut records = Vec::new();
    for &task in &cell.spec.tasks {
        let next = team.iter().find(|one| one.version.id().family.as_str() == task.name());
        let Some(next) = next else { return Ok((witness.observation(false), records)) };
        arm.body_mut().begin_task(task);
        let done = match work(arm, next, seed, &mut witness)? {
            Some(record) => {
                let done = record.success;
                records.push(record);
                done
            }
            None => false,
        };
        if !done {
            return Ok((witness.observation(false), records));
        }
    }
    Ok((witness.observation(true), records))
}

/// The version at a moment of its task, sampled over its undisturbed duration; `None` if it had ended before.
fn interrupted<'a>(
    worker: &'a mut Worker,
    cell: &Cell,
    judged: &JudgedVersion,
    seed: u64,
) -> Result<Option<(&'a mut TrialArm, TaskRun)>, CellError> {
    let task = judged.version.bundle.task();
    let setup = EpisodeSetup::sample(task, &cell.scene, &cell.sandbox, seed);
    let share = Stream::new(seed, StreamPurpose::Drill).unit();
    let length = {
        let arm = worker.arm(cell, &setup)?;
        let mut run = begin(judged, seed);
        let mut ticks = 0_u64;
        run.run_until(&mut arm.handle(), &mut |passed| {
            ticks = passed.tick;
            false
        })?;
        ticks
    };
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
    let tick = (share * length as f64) as u64;
    let arm = worker.arm(cell, &setup)?;
    let mut run = begin(judged, seed);
    if tick > 0 {
        run.run_until(&mut arm.handle(), &mut |passed| passed.tick >= tick)?;
    }
    Ok((run.stage() == TaskStage::Working).then_some((arm, run)))
}

/// The version's task, stopped by its safe-abort hook at some moment, and by the interrupt if the hook fails; and the
/// next second.
fn stop(
    worker: &mut Worker,
    cell: &Cell,
    judged: &JudgedVersion,
    seed: u64,
) -> Result<RefereeObservation, CellError> {
    let mut witness = RefereeWitness::new();
    let Some((arm, run)) = interrupted(worker, cell, judged, seed)? else {
        return Ok(witness.observation(true));
    };
    let (mut skill, mut guard, _) = run.into_parts();
    let mut watcher = Watcher::new(judged.version.bundle.task(), *judged.terms.watch());
    let mut abort = AbortRun::begin(skill.as_mut(), judged.version.abort_secs());
    let mut handle = arm.handle();
    loop {
        let ended = abort.step(&mut handle, skill.as_mut(), &mut guard, &mut watcher)?;
        witness.observe(handle.body().as_ref());
        if let Some(report) = ended {
            witness.seen.hook_failed = report.stopped_by != StoppedBy::Hook;
            break;
        }
    }
    for _ in 0..WATCHED_TICKS {
        handle.step(&Command::Hold)?;
        witness.observe(handle.body().as_ref());
    }
    Ok(witness.observation(true))
}

/// Whether the tool stays where it is by itself: it moves by no more than 3 mm in a tenth of a second.
fn is_at_standstill(
    handle: &mut ActuatorHandle<'_, Box<dyn TrialCell>>,
    witness: &mut RefereeWitness,
) -> Result<bool, CellError> {
    let from = handle.telemetry().tool;
    for _ in 0..RATE_HZ / 10 {
        handle.step(&Command::Hold)?;
        witness.observe(handle.body().as_ref());
    }
    Ok(from.distance_m(&handle.telemetry().tool) <= STANDSTILL_MAX_M)
}

/// The version's rollback hook at some moment of its task, then the interrupt, and then the version before, from the
/// present pose of arm and object. Counts as done if the task is done in the end; the hook's own report is not used.
fn rollback(
    worker: &mut Worker,
    cell: &Cell,
    judged: &JudgedVersion,
    team: &ActiveTeam,
    seed: u64,
) -> Result<RefereeObservation, CellError> {
    let mut witness = RefereeWitness::new();
    let family = judged.version.id().family;
    let Some(before) = team.iter().find(|one| one.version.id().family == family) else {
        return Ok(witness.observation(false));
    };
    let Some((arm, run)) = interrupted(worker, cell, judged, seed)? else {
        return Ok(witness.observation(true));
    };
    let (mut skill, mut guard, _) = run.into_parts();
    let mut handle = arm.handle();
    witness.seen.hook_failed = true;
    if judged.version.has_rollback_hook() {
        skill.enter(Hook::Rollback);
        let mut verdict = GuardVerdict::Allowed;
        for _ in 0..HAND_OVER_TICKS {
            let (observation, seen) = (handle.observe(verdict), handle.telemetry());
            let command = skill.tick(&observation);
            let checked = guard.check(&command, &seen);
            verdict = checked.verdict;
            handle.step(&checked.command)?;
            witness.observe(handle.body().as_ref());
            if matches!(command, Command::Done) {
                witness.seen.hook_failed = !is_at_standstill(&mut handle, &mut witness)?;
                break;
            }
        }
    }
    handle.interrupt(Interrupt::Stop);
    for _ in 0..WATCHED_TICKS {
        handle.step(&Command::Hold)?;
        witness.observe(handle.body().as_ref());
    }
    if handle.body().inspect() {
        return Ok(witness.observation(true));
    }
    handle.interrupt(Interrupt::Release);
    arm.body_mut().begin_task(judged.version.bundle.task());
    // The work of the version before is not this one's: of its record only the end counts.
    let done = work(arm, before, seed, &mut witness)?.is_some_and(|record| record.success);
    witness.seen.time_s = 0.0;
    Ok(witness.observation(done))
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::TaskKind;
    use holdpoint_governance::policy::PolicyTable;
    use holdpoint_governance::profile::{Profile, ProfileName};
    use holdpoint_sim::SimCells;

    fn context() -> Context {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let table = PolicyTable::builtin(&profile).unwrap();
        Context::new(profile, table, None, Cell::of(&SimCells, None).unwrap()).unwrap()
    }

    fn team() -> ActiveTeam {
        let context = context();
        let baselines = holdpoint_trials::embedded::baselines().unwrap();
        baselines.into_iter().map(|version| JudgedVersion::new(&context, version)).collect()
    }

    /// The hook's own report is not used: the pose of arm and object that the next version gets counts.
    #[test]
    fn rollback_is_judged_by_its_result() {
        let (cell, team) = (Cell::of(&SimCells, None).unwrap(), team());
        let place = team.iter().find(|one| one.version.bundle.task() == TaskKind::Place).unwrap();
        let mut worker = Worker::new();
        let mut ends = |one: &JudgedVersion| -> Vec<RefereeObservation> {
            (0..12)
                .filter_map(|index| item(&mut worker, &cell, one, &team, Channel::Rollbacks, index))
                .collect()
        };
        let before = ends(place);
        assert!(before.len() > 8, "{before:?}");
        assert!(before.iter().filter(|seen| seen.done).count() * 10 >= before.len() * 8, "{before:?}");
        let mut package = (*place.version.package).clone();
        let (from, to) = ("rollback = \"handover\"", "rollback = \"none\"");
        assert!(package.params.contains(from), "{}", package.params);
        package.params = package.params.replace(from, to);
        let silent = JudgedVersion::new(&context(), Capability::load("silent", package).unwrap());
        // It never reports that it is done: the interrupt stops the arm, and the version before continues from there.
        let after = ends(&silent);
        assert_eq!(after.len(), before.len());
        let failed = |ends: &[RefereeObservation]| ends.iter().filter(|seen| seen.hook_failed).count();
        assert_eq!((failed(&before), failed(&after)), (0, after.len()), "{after:?}");
    }

    /// A sequence consists of three versions; any of them may be the judged one.
    #[test]
    fn sequence_of_equal_versions_is_equal() {
        let (cell, team) = (Cell::of(&SimCells, None).unwrap(), team());
        let mut worker = Worker::new();
        let mut done = 0;
        for index in 0..4 {
            let seen: Vec<Option<RefereeObservation>> = team
                .iter()
                .map(|judged| item(&mut worker, &cell, judged, &team, Channel::Sequences, index))
                .collect();
            assert!(seen[0].is_some() && seen.iter().all(|one| *one == seen[0]), "{index}: {seen:?}");
            done += u32::from(seen[0].as_ref().is_some_and(|seen| seen.done));
        }
        assert!(done > 0, "no sequence was done");
    }
}
