//! The lines of progress of experiments.

use std::time::Instant;

use super::range_to;
use crate::ground_truth::CandidateTruth;
use crate::paper_reproduction::ScreenRow;
use crate::pipeline_experiments::candidate_run::CandidateEnd;
use crate::pipeline_experiments::demonstrations::DemonstrationRun;
use crate::pipeline_experiments::drift_run::{CellResult, CellRun};
use crate::pipeline_experiments::layer_failure::LayerRow;
use crate::pipeline_experiments::series::SeriesEnd;
use crate::throwers::ThrowerRun;

/// A finished step, with the estimated remaining time.
pub fn step(what: &str, finished: usize, all: usize, began: Instant) -> String {
    let left = began.elapsed().as_secs_f64() / finished.max(1) as f64 * (all - finished) as f64;
    format!("[{finished}/{all}] {what}; about {:.0} min left", left / 60.0)
}

/// A block of items that run together.
pub fn block(of: u64, what: &str) -> String {
    format!("blocks of {of} {what}")
}

pub fn cost_of(candidate: &str) -> String {
    format!("cost of {candidate}")
}

pub fn rounds(seed: u64) -> String {
    format!("rounds of seed {seed}")
}

pub fn run(seed: u64) -> String {
    format!("run {seed}")
}

pub fn screened(row: &ScreenRow) -> String {
    format!("{} {} of seed {}: {}", row.end.profile, row.name, row.seed, row.end.state)
}

pub fn candidate(end: &CandidateEnd) -> String {
    format!("{} {}: {} after {} episodes", end.profile, end.name, end.state, end.effort.sandbox)
}

/// The runs of one run seed.
pub fn demonstrations(runs: &[DemonstrationRun]) -> String {
    let ends: Vec<String> =
        runs.iter().map(|run| format!("{} {}: {}", run.profile, run.name, run.state)).collect();
    let seed = runs.first().map_or_else(String::new, |run| format!("seed {}: ", run.seed));
    format!("{seed}{}", ends.join(", "))
}

pub fn truth(one: &CandidateTruth) -> String {
    let ends: Vec<String> = one.ends.iter().map(|end| format!("{} {}", end.profile, end.state)).collect();
    let open = one.truth.open.map_or_else(String::new, |class| format!(" ({class} is open)"));
    format!("{}: {}{open}; {}", one.name, one.truth.class, ends.join(", "))
}

pub fn thrower(run: &ThrowerRun) -> String {
    let ThrowerRun { profile, trigger, act, state, live_tasks, past_harm, .. } = run;
    format!("{profile} {trigger} {act}: {state} after {live_tasks} live tasks, {past_harm} past harm")
}

pub fn series(end: &SeriesEnd) -> String {
    let how = match end.tries_until_in() {
        Some(number) => format!("the tweak {number} got in"),
        None => format!("none of {} tweaks got in", end.tries.len()),
    };
    format!("series {}: {how}", end.series)
}

/// The calibration of the tweaks' defect: what a tweak loses, and from which episodes.
pub fn calibration([mean, lower, upper]: [f64; 3], episodes: u64, seed: u64) -> String {
    let loss = range_to(3, mean, lower, upper);
    format!("calibration: a tweak loses {loss} in {episodes} episodes from seed {seed}")
}

pub fn drift(run: &CellRun) -> String {
    let CellRun { seed, candidate, kind, magnitude, result, .. } = run;
    let how = result.as_ref().map_or_else(|| "not activated".to_owned(), drift_effect);
    format!("run {seed}: {candidate} {kind} {magnitude}: {how}")
}

fn drift_effect(cell: &CellResult) -> String {
    let effect = if cell.effect.needs_trigger { "worsened" } else { "not worsened" };
    let Some(record) = &cell.rollback else { return format!("{effect}, kept") };
    let (state, trigger, tasks) = (&record.post_status, record.trigger.kind.name(), cell.under.tasks);
    let recovered = if cell.recovered { "recovered" } else { "NOT recovered" };
    format!("{effect}, {state} for {trigger} after {tasks} tasks, {recovered}")
}

pub fn layer_failure(row: &LayerRow) -> String {
    let LayerRow { seed, candidate, kind, magnitude, failure, stance, under, .. } = row;
    let tasks = under.tasks;
    format!("run {seed}: {candidate} {kind} {magnitude}, {failure} fails: {stance} after {tasks} tasks")
}
