//! Episodes, ticks, drills and shadow sequences in the configured cell.
//!
//! Everything here is the product's own path from the pipeline, on one worker. It knows the cell by its ports alone.

use std::hint::black_box;

use holdpoint_body::TaskKind;
use holdpoint_cell::EpisodeSetup;

use super::BenchError;
use super::measure::{Figure, FigureClock, FigureEffort, FigureUnit, MeasuredFigure};
use super::subjects::{Subjects, seed};
use holdpoint_engine::live::shadow::Shadow;
use holdpoint_engine::live::station::LiveStation;
use holdpoint_governance::evidence::DrillKind;
use holdpoint_runtime::agent::ActiveView as _;
use holdpoint_runtime::harm::HarmMeter;
use holdpoint_runtime::task::{self, Supervision};
use holdpoint_trials::cell::Conditions;
use holdpoint_trials::drills::{DrillResult, DrillVersions, drill};
use holdpoint_trials::episodes::episode;
use holdpoint_trials::seeds::SeedPurpose;
use holdpoint_trials::worker::Worker;
use holdpoint_wording::program::bench as names;

pub(super) fn measure(subjects: &Subjects, effort: &FigureEffort) -> Result<Vec<MeasuredFigure>, BenchError> {
    let mut entries = Vec::new();
    for &task in &subjects.cell.spec.tasks {
        entries.push(sandbox_episode(subjects, effort, task)?);
    }
    entries.push(tick(subjects, effort)?);
    entries.extend(guarded_tick(subjects, effort)?);
    for kind in DrillKind::ALL {
        entries.push(one_drill(subjects, effort, kind)?);
    }
    entries.push(shadow_sequence(subjects, effort)?);
    Ok(entries)
}

/// One sandbox episode of the active version: reset, task, inspection.
fn sandbox_episode(
    subjects: &Subjects,
    effort: &FigureEffort,
    task: TaskKind,
) -> Result<MeasuredFigure, BenchError> {
    let version = subjects.active_for(task)?;
    let mut worker = Worker::new();
    let name = format!("sandbox episode, {}", version.id());
    Figure::new(name, FigureUnit::Millis, FigureClock::ThreadCpu, "episode").take(
        effort,
        effort.slow_secs,
        |call| {
            let seed = seed(SeedPurpose::Perturbation, call);
            let record =
                episode(&mut worker, &subjects.cell, &subjects.terms, version, Conditions::Sandbox, seed);
            Ok((!record.invalid).then_some(1))
        },
    )
}

/// The cost of one task of an active version.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskCost {
    /// How long it took in the world, s.
    pub simulated_secs: f64,
    /// CPU time of the thread, s; the world's reset is in it.
    pub cpu_secs: f64,
}

/// Runs tasks of every active version, `of_each` of each, on calibration seeds; a task whose world failed is left out.
///
/// # Errors
/// If the cell or a version that comes with the program does not load.
pub fn task_costs(of_each: u64) -> Result<Vec<TaskCost>, BenchError> {
    let subjects = Subjects::load()?;
    let mut worker = Worker::new();
    let mut found = Vec::new();
    for &task in &subjects.cell.spec.tasks {
        let version = subjects.active_for(task)?;
        for call in 0..of_each {
            let seed = seed(SeedPurpose::Perturbation, call);
            let began = FigureClock::ThreadCpu.secs();
            let record =
                episode(&mut worker, &subjects.cell, &subjects.terms, version, Conditions::Sandbox, seed);
            if !record.invalid {
                let cpu_secs = FigureClock::ThreadCpu.secs() - began;
                found.push(TaskCost { simulated_secs: record.time_secs, cpu_secs });
            }
        }
    }
    Ok(found)
}

/// One tick of the cell's first task: observation, skill, guard, servo, physics, sensors, watcher. Resets are not in it.
fn tick(subjects: &Subjects, effort: &FigureEffort) -> Result<MeasuredFigure, BenchError> {
    let task = subjects.cell.spec.first_task();
    let version = subjects.active_for(task)?;
    let (cell, terms) = (&subjects.cell, &subjects.terms);
    let mut worker = Worker::new();
    let mut samples = Vec::new();
    let figure =
        Figure::new("tick, whole", FigureUnit::Micros, FigureClock::ThreadCpu, names::MEAN_OVER_TICKS);
    let begin = FigureClock::Wall.secs();
    for call in 0..effort.samples_max as u64 {
        let seed = seed(SeedPurpose::Perturbation, call);
        let setup = EpisodeSetup::sample(task, &cell.scene, &cell.sandbox, seed);
        let arm = worker.arm(cell, &setup)?;
        let guard = terms.guard(&version.manifest.permissions);
        let skill = version.start(terms.bundle_seed(seed));
        let task_terms = terms.task(task, seed, version.abort_secs());
        let mut spent = Vec::new();
        let mut before = FigureClock::ThreadCpu.secs();
        task::run(&mut arm.handle(), skill, guard, &task_terms, &mut |_, _| {
            let now = FigureClock::ThreadCpu.secs();
            spent.push(now - before);
            before = now;
            Supervision::Continue
        })?;
        if !spent.is_empty() {
            samples.push(spent.iter().sum::<f64>() / spent.len() as f64);
        }
        if samples.len() >= effort.samples_min && FigureClock::Wall.secs() - begin >= effort.slow_secs {
            break;
        }
    }
    figure.of(samples, effort.samples_min)
}

/// The cost of guard and harm in a tick, and of harm alone: recorded ticks of the cell's first task, checked and
/// measured again with nothing else.
fn guarded_tick(subjects: &Subjects, effort: &FigureEffort) -> Result<[MeasuredFigure; 2], BenchError> {
    let task = subjects.cell.spec.first_task();
    let version = subjects.active_for(task)?;
    let (cell, terms) = (&subjects.cell, &subjects.terms);
    let mut worker = Worker::new();
    let seed = seed(SeedPurpose::Perturbation, 0);
    let setup = EpisodeSetup::sample(task, &cell.scene, &cell.sandbox, seed);
    let arm = worker.arm(cell, &setup)?;
    let mut before = arm.handle().telemetry();
    let mut ticks = Vec::new();
    let guard = terms.guard(&version.manifest.permissions);
    let task_terms = terms.task(task, seed, version.abort_secs());
    let skill = version.start(terms.bundle_seed(seed));
    let mut judging = guard.clone();
    task::run(&mut arm.handle(), skill, guard.clone(), &task_terms, &mut |_, passed| {
        let then = std::mem::replace(&mut before, passed.seen.clone());
        let checked = judging.check(passed.command, &then);
        let near = judging.is_near(passed.seen);
        ticks.push((
            then,
            passed.observation.clone(),
            passed.command.clone(),
            passed.seen.clone(),
            checked,
            near,
        ));
        Supervision::Continue
    })?;
    let figure = |name| Figure::new(name, FigureUnit::Micros, FigureClock::ThreadCpu, "tick");
    let both = figure(names::TICK_GUARD_AND_HARM).take(effort, effort.fast_secs, |_| {
        let (mut guard, mut harm) = (guard.clone(), HarmMeter::default());
        for (at, (before, observation, asked, after, ..)) in ticks.iter().enumerate() {
            if at.is_multiple_of(4) {
                black_box(guard.predicts_collision(before));
            }
            let checked = guard.check(asked, before);
            harm.note_command(asked, &checked, &guard, (&observation.tau, &observation.dq));
            black_box(guard.measure(after));
            let near = guard.is_near(after);
            harm.note(after, &guard, near);
        }
        black_box(harm.measures());
        Ok(Some(ticks.len() as u64))
    })?;
    let harm = figure("tick, harm").take(effort, effort.fast_secs, |_| {
        let mut harm = HarmMeter::default();
        for (_, observation, asked, after, checked, near) in &ticks {
            harm.note_command(asked, checked, &guard, (&observation.tau, &observation.dq));
            harm.note(after, &guard, *near);
        }
        black_box(harm.measures());
        Ok(Some(ticks.len() as u64))
    })?;
    Ok([both, harm])
}

/// One drill with the candidate, its start included.
fn one_drill(
    subjects: &Subjects,
    effort: &FigureEffort,
    kind: DrillKind,
) -> Result<MeasuredFigure, BenchError> {
    let candidate = &subjects.candidate;
    let fallback = candidate.manifest.recovery.fallback.as_ref();
    let cast = DrillVersions {
        version: candidate,
        predecessor: subjects.rollback_target()?,
        fallback: fallback.and_then(|binding| subjects.active.active(&binding.family)),
    };
    let mut worker = Worker::new();
    let name = format!("drill, {}", kind.name());
    Figure::new(name, FigureUnit::Millis, FigureClock::ThreadCpu, "drill").take(
        effort,
        effort.slow_secs,
        |call| {
            let seed = seed(SeedPurpose::Drill, call);
            let result = drill(&mut worker, &subjects.cell, &subjects.terms, &cast, kind, seed);
            Ok((result != DrillResult::Infeasible).then_some(1))
        },
    )
}

/// One live sequence with the candidate in shadow, the twin included.
fn shadow_sequence(subjects: &Subjects, effort: &FigureEffort) -> Result<MeasuredFigure, BenchError> {
    let (candidate, terms) = (&subjects.candidate, &subjects.terms);
    let mut live = LiveStation::new(subjects.cell.clone())?;
    let mut spare = Some(subjects.cell.trial()?);
    let figure =
        Figure::new("shadow sequence", FigureUnit::Millis, FigureClock::ThreadCpu, names::SEQUENCE_WITH_TWIN);
    figure.take(effort, effort.slow_secs, |call| {
        let fork = match spare.take() {
            Some(fork) => fork,
            None => subjects.cell.trial()?,
        };
        let mut shadow = Shadow::new(candidate.clone(), terms.clone(), fork);
        let seed = seed(SeedPurpose::Live, call);
        let report = live.run_sequence(&subjects.active, &|_| terms.clone(), seed, &mut shadow, None);
        let worked = report.task(candidate.bundle.task()).map(|done| &done.record);
        let (trace, fork) = shadow.conclude(worked, report.seed);
        spare = fork;
        // A sequence that ends before the candidate's task has no twin and says nothing about its cost.
        Ok(trace.map(|_| 1))
    })
}
