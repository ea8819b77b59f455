//! Failures of the governance layer itself (the paper's appendix H): each is injected, and the effect is counted.
//!
//! The pools show a failure before an activation. A later failure needs a version that becomes worse in control: the
//! drifts that worsen one.

use std::collections::BTreeMap;

use holdpoint_governance::metrics::{Fate, Proportion};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::{PairedCounts, binary_pairs};

use super::{Section, counted, seeds_in};
use crate::paper_reproduction::figures::{is_faulty, variant_rows};
use crate::paper_reproduction::pool_screening::{ScreenRow, Variant};
use crate::paper_reproduction::report_table::ReportTable;
use crate::pipeline_experiments::ExperimentError;
use crate::pipeline_experiments::drift::Quantiles;
use crate::pipeline_experiments::layer_failure::{LayerFailure, LayerRow, Stance};

/// One-sided level at which more is established to get through.
const ALPHA: f64 = 0.05;

/// The class, how it is injected, and the way of the pools.
const BEFORE: [(&str, &str, Variant); 3] = [
    ("incomplete compatibility assessment", "interface and policy are never assessed", Variant::NoValidation),
    (
        "distribution gap",
        "nothing is seen of the live world's conditions before activation",
        Variant::NoShadow,
    ),
    ("misconfiguration", "thresholds are half of what they should be", Variant::Halved),
];

/// The class, how it is injected, and the failure of the drift experiment.
const AFTERWARDS: [(&str, &str, LayerFailure); 5] = [
    (BLIND_SPOT, "the monitor does not see whether tasks are done", LayerFailure::BlindToFailures),
    (BLIND_SPOT, "the monitor sees no rate, and safety events alone", LayerFailure::BlindToRates),
    (BLIND_SPOT, "no telemetry reaches the monitor", LayerFailure::Silent),
    (NO_ROLLBACK, "the rollback target was blocked under the profile", LayerFailure::PredecessorClosed),
    (NO_ROLLBACK, "the rollback target was changed in the store", LayerFailure::PredecessorChanged),
];

const BLIND_SPOT: &str = "monitor blind spot";
const NO_ROLLBACK: &str = "rollback unavailable";

/// The word for the effect of a failure: significantly more than without a failure, or not.
const fn verdict(more_at_least: f64) -> &'static str {
    if more_at_least > 0.0 { "fails open" } else { "restricts, as far as seen" }
}

/// The section; empty where nothing was injected.
///
/// # Errors
/// If no interval exists for a count.
pub fn meta_faults(
    rows: &[ScreenRow],
    layers: &[LayerRow],
    preset_seeds: u64,
) -> Result<Section, ExperimentError> {
    let (mut tables, mut lines) = (Vec::new(), Vec::new());
    if variant_rows(rows, ProfileName::Sim, Variant::NoValidation).next().is_some() {
        let (table, line) = before_activation(rows)?;
        tables.push(table);
        lines.push(line);
    }
    if !layers.is_empty() {
        let (mut table, line) = after_activation(layers)?;
        table.seeds = Some((seeds_in(layers, |row| row.seed), preset_seeds));
        tables.push(table);
        lines.push(line);
    }
    if tables.is_empty() {
        return Ok(Section::default());
    }
    let title = "Failures of the governance layer itself".to_owned();
    Ok(Section { title, text: Vec::new(), tables, plots: Vec::new(), lines })
}

/// Failures before an activation, by the pools.
fn before_activation(rows: &[ScreenRow]) -> Result<(ReportTable, String), ExperimentError> {
    let in_force = |variant: Variant| -> BTreeMap<(u64, &str), bool> {
        variant_rows(rows, ProfileName::Sim, variant)
            .filter(|row| is_faulty(row.class))
            .map(|row| ((row.seed, row.name.as_str()), row.end.fate == Fate::Kept))
            .collect()
    };
    let sound = in_force(Variant::Full);
    let mut table = ReportTable::new(
        "Faulty candidates in force in the end (profile sim)",
        &[
            "failure",
            "injected as",
            "in force",
            "with nothing failing",
            "more, at least",
            "the rest of the layer",
        ],
        "Fails open: it is established (exact, over the same candidates, one-sided 5 %) that more faulty candidates are in force \
         than with nothing failing. Restricts: at most as many as seen. Where a stage is blind the others still work.",
    );
    let (mut open, mut all) = (0, 0);
    for (name, how, variant) in BEFORE {
        let failing = in_force(variant);
        if failing.is_empty() {
            continue;
        }
        let pairs = PairedCounts::of(
            failing.iter().filter_map(|(candidate, found)| Some((*found, *sound.get(candidate)?))),
        );
        let bound = binary_pairs(pairs, ALPHA)?;
        all += 1;
        open += u32::from(bound.lower > 0.0);
        table.row([
            name.to_owned(),
            how.to_owned(),
            counted(&Proportion::of(failing.into_values())?),
            counted(&Proportion::of(sound.values().copied())?),
            format!("{:+.1} points", 100.0 * bound.lower),
            verdict(bound.lower).to_owned(),
        ]);
    }
    let line = format!(
        "Failures of the governance layer before an activation: {open} of {all} let more faulty candidates in"
    );
    Ok((table, line))
}

/// Failures while a version becomes worse in control, by the drifts that worsen one.
fn after_activation(layers: &[LayerRow]) -> Result<(ReportTable, String), ExperimentError> {
    let mut table = ReportTable::new(
        "Versions that a drift worsens in control (profile sim)",
        &[
            "failure",
            "injected as",
            "predecessor in control",
            "family stopped, arm held",
            "tighter envelope",
            "in control as before",
            "told of by another alarm",
            "its tasks under the drift, median (most)",
            "of all, unsafe by the referee",
            "family's tasks once stopped",
            "more in control, at least",
            "the rest of the layer",
        ],
        "Every failure under the same drifts, from the same activation, until the rollback or the horizon. Fails open: it \
         is established (exact, over the same drifts, one-sided 5 %) that more versions are in control as before than with \
         nothing failing. Another alarm: of health over the cell, of a shift, or of a violation.",
    );
    let rows_of = |failure: LayerFailure| layers.iter().filter(move |row| row.failure == failure);
    let drift_of = |row: &LayerRow| (row.seed, row.kind, row.magnitude);
    let is_in_control = |row: &LayerRow| row.stance == Stance::InControl;
    let sound: BTreeMap<_, bool> =
        rows_of(LayerFailure::Nothing).map(|row| (drift_of(row), is_in_control(row))).collect();
    let (mut open, mut all) = (0, 0);
    let nothing = [("none", "nothing fails", LayerFailure::Nothing)];
    for (name, how, failure) in nothing.into_iter().chain(AFTERWARDS) {
        let pairs =
            rows_of(failure).filter_map(|row| Some((is_in_control(row), *sound.get(&drift_of(row))?)));
        let bound = binary_pairs(PairedCounts::of(pairs), ALPHA)?;
        let count_of = |stance: Stance| -> Result<String, ExperimentError> {
            Ok(counted(&Proportion::of(rows_of(failure).map(|row| row.stance == stance))?))
        };
        let tasks = Quantiles::of(rows_of(failure).map(|row| f64::from(row.under.tasks)));
        let sum =
            |count: fn(&LayerRow) -> u32| rows_of(failure).map(|row| u64::from(count(row))).sum::<u64>();
        let stopped = rows_of(failure).filter(|row| row.stance == Stance::SafeStopped);
        let [more, label] = if failure == LayerFailure::Nothing {
            [String::new(), String::new()]
        } else {
            all += 1;
            open += u32::from(bound.lower > 0.0);
            [format!("{:+.1} points", 100.0 * bound.lower), verdict(bound.lower).to_owned()]
        };
        let stance_counts: Vec<String> = Stance::ALL.into_iter().map(count_of).collect::<Result<_, _>>()?;
        let mut cells = vec![name.to_owned(), how.to_owned()];
        cells.extend(stance_counts);
        cells.extend([
            counted(&Proportion::of(rows_of(failure).map(|row| row.told))?),
            tasks.map_or_else(|| "-".to_owned(), |tasks| format!("{:.0} ({:.0})", tasks.median, tasks.max)),
            format!("{}/{}", sum(|row| row.under.unsafe_tasks), sum(|row| row.under.tasks)),
            stopped.map(|row| u64::from(row.after.tasks)).sum::<u64>().to_string(),
            more,
            label,
        ]);
        table.row(cells);
    }
    let line = format!(
        "Failures of the governance layer while a version becomes worse in control: {open} of {all} leave more of them in control as \
         before ({} drifts that worsen one)",
        sound.len()
    );
    Ok((table, line))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline_experiments::drift_run::PartWork;
    use holdpoint_body::disturbance::{DriftKind, Magnitude};

    /// Eight drifts: a blind monitor leaves every version in control; without a rollback target every family is
    /// stopped.
    fn layers() -> Vec<LayerRow> {
        let row = |seed: u64, failure: LayerFailure| {
            let (stance, tasks) = match failure {
                LayerFailure::BlindToRates => (Stance::InControl, 200),
                LayerFailure::PredecessorClosed | LayerFailure::PredecessorChanged => {
                    (Stance::SafeStopped, 9)
                }
                LayerFailure::Nothing | LayerFailure::BlindToFailures | LayerFailure::Silent => {
                    (Stance::RolledBack, 9)
                }
            };
            LayerRow {
                seed,
                candidate: "grasp-improved".to_owned(),
                kind: DriftKind::Combined,
                magnitude: Magnitude::Strong,
                failure,
                stance,
                stopped_by: None,
                told: stance == Stance::InControl,
                under: PartWork { sequences: tasks, tasks, done: 1, unsafe_tasks: 1 },
                after: PartWork::default(),
            }
        };
        (40..48).flat_map(|seed| LayerFailure::ALL.map(|failure| row(seed, failure))).collect()
    }

    #[test]
    fn only_a_failure_that_leaves_versions_in_control_fails_open() {
        let section = meta_faults(&[], &layers(), 40).unwrap();
        let [table] = section.tables.as_slice() else { panic!("one table") };
        assert_eq!(table.seeds, Some((8, 40)));
        assert!(table.rows.iter().all(|row| row.len() == table.columns.len()));
        let verdicts: Vec<&str> = table.rows.iter().map(|row| row.last().unwrap().as_str()).collect();
        let restricts = "restricts, as far as seen";
        assert_eq!(verdicts, ["", restricts, "fails open", restricts, restricts, restricts]);
        assert!(table.rows[2].contains(&"200 (200)".to_owned()), "{:?}", table.rows[2]);
        assert!(section.lines[0].contains("1 of 5 "), "{:?}", section.lines);
    }

    #[test]
    fn section_without_injected_faults_is_empty() {
        assert_eq!(meta_faults(&[], &[], 40).unwrap(), Section::default());
    }
}
