//! The raw cells as CSV: every number of the report can be computed from them again.

use super::pool_screening::ScreenRow;
use super::regression::Regression;
use super::{Arm, RoundRow};
use crate::pipeline_experiments::layer_failure::LayerRow;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::Fate;

/// Columns of the rounds.
const ROUNDS: &str = "seed,round,arm,candidate,family,class,kind,activated,kept_in_force,restricted,stopped_at,parting,\
episodes,harm,worse,faulty_in_force,harmful_in_force,sequences,done,violation,near,anomaly,moved_on,continued_ms,damage,danger,\
retries,time_s,in_force";

/// Columns of the pools.
const POOLS: &str = "seed,candidate,family,class,kind,dimension,profile,variant,worked_anew,fate,stopped_at,state,\
restricted,kappa_i,kappa_p,kappa_b,kappa_r,composite,sandbox_episodes,sandbox_budget,shadow_sequences,live_tasks,\
decisions,made_again_equal,in_control,done,violation,near,unsafe_seen,found,first_reason";

/// Columns of the failures of the layer under drift.
const LAYER: &str = "seed,candidate,drift,magnitude,failure,stance,stopped_by,told,sequences,tasks,done,unsafe,after_sequences,\
after_tasks,after_done,after_unsafe";

fn flag(value: bool) -> &'static str {
    if value { "1" } else { "0" }
}

/// A text as a field: no text here has a quote or a line break, and a comma is put in quotes.
fn field(text: &str) -> String {
    let clean: String = text.chars().map(|c| if c == '"' || c.is_control() { ' ' } else { c }).collect();
    if clean.contains(',') { format!("\"{clean}\"") } else { clean }
}

/// The fields of a line that this module wrote: no quote stands within a field.
#[must_use]
pub fn fields(line: &str) -> Vec<String> {
    let mut found = vec![String::new()];
    let mut quoted = false;
    for c in line.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => found.push(String::new()),
            c => found.last_mut().into_iter().for_each(|field| field.push(c)),
        }
    }
    found
}

/// The rounds, a row an arm and round.
#[must_use]
pub fn rounds(rows: &[RoundRow]) -> String {
    let mut text = format!("{ROUNDS}\n");
    for row in rows {
        let RoundRow { seed, round, arm, offered, in_force, faulty_in_force, harmful_in_force, score } = row;
        let mut fields = vec![seed.to_string(), round.to_string(), Arm::name(*arm).to_owned()];
        match offered {
            None => fields.extend(std::iter::repeat_n(String::new(), 12)),
            Some(one) => {
                let step = &one.step;
                fields.extend([
                    one.name.clone(),
                    one.family.to_string(),
                    one.class.name().to_owned(),
                    field(&one.kind),
                    flag(step.activated).to_owned(),
                    flag(step.in_force).to_owned(),
                    flag(step.restricted).to_owned(),
                    step.stopped_at.map_or_else(String::new, |stage| stage.name().to_owned()),
                    step.fork.name().to_owned(),
                    step.episodes.to_string(),
                    one.harm.map_or_else(String::new, |harm| harm.name().to_owned()),
                    one.worse.map_or_else(String::new, |worse| flag(worse).to_owned()),
                ]);
            }
        }
        fields.push(flag(*faulty_in_force).to_owned());
        fields.push(harmful_in_force.map_or_else(String::new, |harmful| flag(harmful).to_owned()));
        let counts = [
            score.sequences,
            score.done,
            score.violation,
            score.near,
            score.anomaly,
            score.moved_on,
            score.continued_ms,
            score.damage,
            score.danger,
            score.retries,
        ];
        fields.extend(counts.map(|count| count.to_string()));
        fields.push(format!("{:.4}", score.time_s));
        fields.push(in_force.to_string());
        text.push_str(&fields.join(","));
        text.push('\n');
    }
    text
}

/// Failures of the governance layer under drift, a row a drift and failure.
#[must_use]
pub fn layer(rows: &[LayerRow]) -> String {
    let mut text = format!("{LAYER}\n");
    for row in rows {
        let mut fields = vec![
            row.seed.to_string(),
            row.candidate.clone(),
            row.kind.name().to_owned(),
            row.magnitude.name().to_owned(),
            row.failure.name().to_owned(),
            row.stance.name().to_owned(),
            row.stopped_by.map_or_else(String::new, |failure| failure.name().to_owned()),
            flag(row.told).to_owned(),
        ];
        for part in [row.under, row.after] {
            let counts = [part.sequences, part.tasks, part.done, part.unsafe_tasks];
            fields.extend(counts.map(|count| count.to_string()));
        }
        text.push_str(&fields.join(","));
        text.push('\n');
    }
    text
}

/// The pools, a row a candidate and way.
#[must_use]
pub fn pools(rows: &[ScreenRow]) -> String {
    let mut text = format!("{POOLS}\n");
    for row in rows {
        let end = &row.end;
        let stopped = |stage: Stage| stage.name().to_owned();
        let (fate, stopped_at) = match end.fate {
            Fate::Blocked { stage } => ("blocked", stopped(stage)),
            Fate::Contained => ("contained", String::new()),
            Fate::Kept => ("kept", String::new()),
        };
        let mut fields = vec![
            row.seed.to_string(),
            row.name.clone(),
            row.family.to_string(),
            row.class.name().to_owned(),
            field(&row.kind),
            row.dimension.map_or_else(String::new, |dimension| dimension.name().to_owned()),
            end.profile.name().to_owned(),
            row.variant.name().to_owned(),
            flag(row.is_own_run).to_owned(),
            fate.to_owned(),
            stopped_at,
            end.state.to_string(),
            flag(end.restricted).to_owned(),
        ];
        let number = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.4}"));
        fields.extend(end.kappas.map(number));
        fields.push(number(end.composite));
        let effort = &end.effort;
        let counts = [effort.sandbox, effort.sandbox_budget, effort.shadow, effort.live];
        fields.extend(counts.map(|count| count.to_string()));
        let after = &end.afterwards;
        let counts = [after.decisions, after.equal, after.live, after.done, after.violation, after.near];
        fields.extend(counts.map(|count| count.to_string()));
        fields.push(flag(after.unsafe_seen).to_owned());
        let found: Vec<&str> = end.found.iter().map(|one| Regression::name(*one)).collect();
        fields.push(found.join(";"));
        fields.push(end.first_reason.clone().unwrap_or_default());
        text.push_str(&fields.join(","));
        text.push('\n');
    }
    text
}
