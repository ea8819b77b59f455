//! Prints how the ladder of a rollback goes in each of three orders, from the same moments of work of each commissioned
//! version: its rollback hook first, its safe-abort hook first, or the interrupt at once. Interrupt and retreat follow in
//! every order. `cargo run --release -p holdpoint-lab --example ladder -- DRILLS RUN_SEED`
#![allow(clippy::unwrap_used, clippy::panic, reason = "a measurement ends where something fails")]
#![allow(clippy::print_stdout, reason = "its output is its purpose")]

use std::sync::Arc;

use holdpoint_body::{
    Body, BodyError, Command, GuardVerdict, Interrupt, Observation, Standstill, TaskKind, Telemetry,
};
use holdpoint_cell::rng::{Stream, StreamPurpose};
use holdpoint_cell::{CellCopy, TrialCell};
use holdpoint_engine::live::ladder_motion::{hold, retract};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::rollback::ticks_to_ms;
use holdpoint_runtime::arm::{ActuatorHandle, Arm};
use holdpoint_runtime::guard::Guard;
use holdpoint_runtime::recovery::{self, ROLLBACK_HOOK_TICKS, StoppedBy};
use holdpoint_runtime::skill::{Hook, Skill, next_command};
use holdpoint_runtime::task::{TaskRun, TaskStage, Tick};
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_sim::SimCells;
use holdpoint_trials::cell::{Cell, Conditions};
use holdpoint_trials::drills::fate::{ObjectFate, ObjectWatch};
use holdpoint_trials::seeds::{SeedPurpose, episode_seed};
use holdpoint_trials::undisturbed_run::TrialCase;

/// What stops the arm first.
#[derive(Clone, Copy, Debug)]
enum FirstRung {
    RollbackHook,
    SafeAbortHook,
    Interrupt,
}

impl FirstRung {
    const ALL: [Self; 3] = [Self::RollbackHook, Self::SafeAbortHook, Self::Interrupt];
}

/// The cell, with the worst that is done to object and surroundings.
struct WatchedWorld {
    world: Box<dyn TrialCell>,
    object: ObjectWatch,
    standstill: Standstill,
    ticks: u64,
    /// The tick since which the arm is at rest.
    rest_since: Option<u64>,
    pad_n: f64,
    contact_n: f64,
}

impl WatchedWorld {
    fn new(world: Box<dyn TrialCell>, profile: &Profile) -> Self {
        let object = ObjectWatch::new(world.as_ref(), f64::INFINITY, profile);
        let standstill = Standstill::default();
        Self { world, object, standstill, ticks: 0, rest_since: None, pad_n: 0.0, contact_n: 0.0 }
    }

    /// Forgets what it has seen; `grip_max_n` is the limit per finger.
    fn watch(&mut self, grip_max_n: f64, profile: &Profile) {
        self.object = ObjectWatch::new(self.world.as_ref(), grip_max_n, profile);
        self.standstill = Standstill::default();
        (self.ticks, self.rest_since, self.pad_n, self.contact_n) = (0, None, 0.0, 0.0);
    }
}

impl Body for WatchedWorld {
    fn observe(&mut self, last: GuardVerdict) -> Observation {
        Body::observe(&mut self.world, last)
    }
    fn telemetry(&self) -> Telemetry {
        Body::telemetry(&self.world)
    }
    fn step(&mut self, command: &Command) -> Result<(), BodyError> {
        Body::step(&mut self.world, command)?;
        self.ticks += 1;
        self.object.observe(self.world.as_ref());
        if self.standstill.observe(&Body::telemetry(&self.world)) {
            self.rest_since.get_or_insert(self.ticks.saturating_sub(Standstill::TICKS as u64));
        } else {
            self.rest_since = None;
        }
        let forces = self.world.true_state().forces;
        let [left, right] = forces.pad_n;
        self.pad_n = self.pad_n.max(left).max(right);
        self.contact_n = self.contact_n.max(forces.surroundings_n());
        Ok(())
    }
    fn interrupt(&mut self, interrupt: Interrupt) {
        Body::interrupt(&mut self.world, interrupt);
    }
    fn inspect(&self) -> bool {
        Body::inspect(&self.world)
    }
}

/// What came of one ladder.
struct LadderEnd {
    /// The version's own hook did what it is for; true if none was called.
    hook_worked: bool,
    /// From the trigger to the standstill that lasted; absent without one.
    standstill_ticks: Option<u64>,
    /// From the trigger until the tool was clear of everything; absent if the retreat failed.
    clear_ticks: Option<u64>,
    fate: ObjectFate,
    pad_n: f64,
    contact_n: f64,
}

/// A moment drawn evenly from the undisturbed work; `None` if the episode has no valid start or is not accepted.
fn moment(arm: &mut Arm<WatchedWorld>, trial: &TrialCase<'_>) -> Option<(CellCopy, TaskRun)> {
    arm.body_mut().world.reset(&trial.setup()).ok()?;
    if !trial.is_admitted(arm) {
        return None;
    }
    let start = arm.body().world.copy().ok()?;
    let mut length = 0_u64;
    let mut to_the_end = |passed: &Tick<'_>| {
        length = passed.tick;
        false
    };
    trial.start().run_until(&mut arm.handle(), &mut to_the_end).ok()?;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a tick of one episode")]
    let at = (Stream::new(trial.seed, StreamPurpose::Drill).unit() * length as f64).ceil() as u64;
    arm.body_mut().world.go_on_from(&start).unwrap();
    let mut run = trial.start();
    let reached = run.run_until(&mut arm.handle(), &mut |passed| passed.tick >= at).ok()?;
    (reached && run.stage() == TaskStage::Working).then(|| (arm.body().world.copy().unwrap(), run))
}

/// The rollback hook, until it reports done. Returns whether it did in time.
fn hand_over(
    handle: &mut ActuatorHandle<'_, WatchedWorld>,
    skill: &mut dyn Skill,
    guard: &mut Guard,
) -> Result<bool, BodyError> {
    skill.enter(Hook::Rollback);
    let mut verdict = GuardVerdict::Allowed;
    for _ in 0..ROLLBACK_HOOK_TICKS {
        let (observation, seen) = (handle.observe(verdict), handle.telemetry());
        let command = next_command(skill, &observation)?;
        let checked = guard.check(&command, &seen);
        verdict = checked.verdict;
        handle.step(&checked.command)?;
        if command == Command::Done {
            return Ok(true);
        }
    }
    Ok(false)
}

/// The rungs that move the arm, in one order.
fn climb(
    arm: &mut Arm<WatchedWorld>,
    trial: &TrialCase<'_>,
    (from, run): (&CellCopy, TaskRun),
    first: FirstRung,
) -> Result<LadderEnd, BodyError> {
    let (mut skill, mut guard, mut watcher) = run.into_parts();
    arm.body_mut().world.go_on_from(from).unwrap();
    arm.body_mut().watch(guard.envelope().grip_force_max_n, trial.terms.profile());
    let mut handle = arm.handle();
    let hook_worked = match first {
        FirstRung::RollbackHook => hand_over(&mut handle, skill.as_mut(), &mut guard)?,
        FirstRung::SafeAbortHook => {
            let secs = trial.version.abort_secs();
            let report = recovery::abort(&mut handle, skill.as_mut(), &mut guard, &mut watcher, secs)?;
            report.stopped_by == StoppedBy::Hook
        }
        FirstRung::Interrupt => true,
    };
    let stands = hold(&mut handle, guard.limits())?.0.failure.is_none();
    let standstill_ticks = handle.body().rest_since.filter(|_| stands);
    let mut clear_ticks = None;
    if stands {
        let mut own = trial.terms.own_guard(trial.version.manifest.permissions.authority);
        let retreat = retract(&mut handle, &mut own, trial.cell.scene.tallest_m(), &|_| false)?;
        clear_ticks = retreat.failure.is_none().then(|| handle.body().ticks);
    }
    let WatchedWorld { world, object, pad_n, contact_n, .. } = handle.body();
    let (fate, pad_n, contact_n) = (object.fate(world.as_ref()), *pad_n, *contact_n);
    Ok(LadderEnd { hook_worked, standstill_ticks, clear_ticks, fate, pad_n, contact_n })
}

/// Median, 95th percentile (nearest rank) and maximum, in ms.
fn times_ms(ticks: impl Iterator<Item = u64>) -> String {
    let mut sorted: Vec<u64> = ticks.map(ticks_to_ms).collect();
    sorted.sort_unstable();
    let percentile = |percent: usize| {
        let place = (sorted.len() * percent).div_ceil(100).max(1) - 1;
        sorted.get(place).map_or_else(|| "-".to_owned(), u64::to_string)
    };
    [50, 95, 100].map(percentile).join(" / ")
}

fn show(name: &str, first: FirstRung, ends: &[LadderEnd]) {
    let count = |holds: &dyn Fn(&LadderEnd) -> bool| ends.iter().filter(|end| holds(end)).count();
    let most = |value: &dyn Fn(&LadderEnd) -> f64| ends.iter().map(value).fold(0.0, f64::max);
    println!(
        "| {name} | {first:?} | {} | {} | {} | {} | {} | {} | {:.1} | {:.1} |",
        ends.len(),
        count(&|end| end.hook_worked),
        times_ms(ends.iter().filter_map(|end| end.standstill_ticks)),
        times_ms(ends.iter().filter_map(|end| end.clear_ticks)),
        count(&|end| end.clear_ticks.is_none()),
        count(&|end| !end.fate.is_safe()),
        most(&|end| end.contact_n),
        most(&|end| end.pad_n),
    );
}

fn main() {
    let numbers: Vec<u64> = std::env::args().skip(1).map(|text| text.parse().unwrap()).collect();
    let [drills, run_seed] = numbers[..] else { panic!("give DRILLS and RUN_SEED") };
    let cell = Cell::of(&SimCells, None).unwrap();
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
    let profile_terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
    println!(
        "| version | first | ladders | hook worked | standstill ms (50, 95, 100 %) | clear ms (50, 95, 100 %) | not clear | \
         object lost | contact N | pad N |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    for version in holdpoint_trials::embedded::baselines().unwrap() {
        let id = version.id();
        if TaskKind::named(id.family.as_str()).is_none() {
            continue;
        }
        let declared = &version.manifest.permissions;
        let terms = profile_terms.clone().capped(declared.max_speed_m_s, declared.max_force_n);
        let mut arm = Arm::new(WatchedWorld::new(cell.trial().unwrap(), &profile));
        let mut ends: [Vec<LadderEnd>; 3] = [Vec::new(), Vec::new(), Vec::new()];
        for place in 0..drills {
            let seed = episode_seed(run_seed, SeedPurpose::Drill, place);
            let conditions = Conditions::Sandbox;
            let trial = TrialCase { cell: &cell, terms: &terms, version: &version, conditions, seed };
            let Some((world, run)) = moment(&mut arm, &trial) else { continue };
            for (first, ends) in FirstRung::ALL.into_iter().zip(&mut ends) {
                let copy = run.fork().unwrap();
                ends.push(climb(&mut arm, &trial, (&world, copy), first).unwrap());
            }
        }
        for (first, ends) in FirstRung::ALL.into_iter().zip(&ends) {
            show(&id.to_string(), first, ends);
        }
    }
}
