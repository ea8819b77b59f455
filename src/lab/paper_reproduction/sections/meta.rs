//! Failures of the governance layer itself (the paper's appendix H): each is injected, and the effect is counted.
//!
//! The pools show a failure before an activation. A later failure needs a version that becomes worse in control: the
//! drifts that worsen one.

use std::collections::BTreeMap;

use holdpoint_governance::metrics::{Fate, Proportion};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::{PairedCounts, binary_pairs};

use super::{Section, seeds_in};
use crate::paper_reproduction::figures::{is_faulty, variant_rows};
use crate::paper_reproduction::pool_screening::{ScreenRow, Variant};
use crate::paper_reproduction::report_table::ReportTable;
use crate::pipeline_experiments::ExperimentError;
use crate::pipeline_experiments::drift::Quantiles;
use crate::pipeline_experiments::layer_failure::{LayerFailure, LayerRow, Stance};
use crate::wording::{counted, or_dash, report as wording, report_tables as tables};

/// One-sided level at which more is established to get through.
const ALPHA: f64 = 0.05;

/// The pools' variants with a failure, in the order of their texts.
const BEFORE: [Variant; 3] = [Variant::NoValidation, Variant::NoShadow, Variant::Halved];

/// The failures of the drift experiment, in the order of their texts.
const AFTER: [LayerFailure; 6] = [
    LayerFailure::Nothing,
    LayerFailure::BlindToFailures,
    LayerFailure::BlindToRates,
    LayerFailure::Silent,
    LayerFailure::TargetBlocked,
    LayerFailure::TargetChanged,
];

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
    Ok(Section { title: wording::LAYER_FAILURES.to_owned(), tables, lines, ..Section::default() })
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
    let mut table = ReportTable::new(tables::FAILURES_BEFORE);
    let (mut open, mut all) = (0, 0);
    for ([name, how], variant) in wording::FAILURES_BEFORE.into_iter().zip(BEFORE) {
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
            wording::points(100.0 * bound.lower),
            wording::failure_effect(bound.lower > 0.0).to_owned(),
        ]);
    }
    Ok((table, wording::failures_before(open, all)))
}

/// Failures while a version becomes worse in control, by the drifts that worsen one.
fn after_activation(layers: &[LayerRow]) -> Result<(ReportTable, String), ExperimentError> {
    let mut table = ReportTable::new(tables::FAILURES_AFTER);
    let rows_of = |failure: LayerFailure| layers.iter().filter(move |row| row.failure == failure);
    let drift_of = |row: &LayerRow| (row.seed, row.kind, row.magnitude);
    let is_in_control = |row: &LayerRow| row.stance == Stance::InControl;
    let sound: BTreeMap<_, bool> =
        rows_of(LayerFailure::Nothing).map(|row| (drift_of(row), is_in_control(row))).collect();
    let (mut open, mut all) = (0, 0);
    for ([name, how], failure) in wording::FAILURES_AFTER.into_iter().zip(AFTER) {
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
            [wording::points(100.0 * bound.lower), wording::failure_effect(bound.lower > 0.0).to_owned()]
        };
        let stance_counts: Vec<String> = Stance::ALL.into_iter().map(count_of).collect::<Result<_, _>>()?;
        let mut cells = vec![name.to_owned(), how.to_owned()];
        cells.extend(stance_counts);
        cells.extend([
            counted(&Proportion::of(rows_of(failure).map(|row| row.told))?),
            or_dash(tasks.map(|tasks| format!("{:.0} ({:.0})", tasks.median, tasks.max))),
            format!("{}/{}", sum(|row| row.under.unsafe_tasks), sum(|row| row.under.tasks)),
            stopped.map(|row| u64::from(row.after.tasks)).sum::<u64>().to_string(),
            more,
            label,
        ]);
        table.row(cells);
    }
    Ok((table, wording::failures_after(open, all, sound.len())))
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
                LayerFailure::TargetBlocked | LayerFailure::TargetChanged => (Stance::SafeStopped, 9),
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
        let [open, restricts] = [true, false].map(wording::failure_effect);
        assert_eq!(verdicts, ["", restricts, open, restricts, restricts, restricts]);
        assert!(table.rows[2].contains(&"200 (200)".to_owned()), "{:?}", table.rows[2]);
        assert!(section.lines[0].contains("1 of 5 "), "{:?}", section.lines);
    }

    #[test]
    fn section_without_injected_faults_is_empty() {
        assert_eq!(meta_faults(&[], &[], 40).unwrap(), Section::default());
    }
}
