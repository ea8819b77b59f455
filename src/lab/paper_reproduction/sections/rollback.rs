//! E4: rollback under drift, from the drift experiment's cells.

use holdpoint_body::disturbance::DriftKind;
use holdpoint_governance::metrics::Proportion;

use super::Section;
use crate::paper_reproduction::published::PublishedNumbers;
use crate::paper_reproduction::report_table::ReportTable;
use crate::pipeline_experiments::ExperimentError;
use crate::pipeline_experiments::drift::{self, DriftCell, DriftReport};
use crate::wording::{counted, plus_minus, report as wording, report_tables as tables};

/// The sum of a proportion over several cells of the drift experiment.
fn summed(
    cells: &[&DriftCell],
    measure: fn(&DriftCell) -> &Proportion,
) -> Result<Proportion, ExperimentError> {
    let (count, total) = cells
        .iter()
        .map(|cell| measure(cell))
        .fold((0, 0), |(count, total), part| (count + part.count, total + part.total));
    Ok(drift::counted(count, total)?)
}

/// The section; empty without a cell.
///
/// # Errors
/// If no interval exists for a count.
pub fn rollback(report: &DriftReport, printed: &PublishedNumbers) -> Result<Section, ExperimentError> {
    let all: Vec<&DriftCell> = report.cells.iter().collect();
    if all.iter().all(|cell| cell.runs == 0) {
        return Ok(Section::default());
    }
    let mut table = ReportTable::new(tables::ROLLBACK);
    let mut row = |name: &str, cells: &[&DriftCell], paper: [f64; 2]| {
        let end_to_end = summed(cells, |cell| &cell.end_to_end)?;
        table.row([
            name.to_owned(),
            counted(&summed(cells, |cell| &cell.needed)?),
            counted(&summed(cells, |cell| &cell.trigger_recall)?),
            counted(&summed(cells, |cell| &cell.recovery_given_trigger)?),
            counted(&end_to_end),
            counted(&summed(cells, |cell| &cell.success_after)?),
            format!("{} %", plus_minus(paper)),
        ]);
        Ok::<Proportion, ExperimentError>(end_to_end)
    };
    for (kind, paper) in DriftKind::ALL.into_iter().zip(printed.t8.by) {
        let of_kind: Vec<&DriftCell> = all.iter().copied().filter(|cell| cell.kind == kind).collect();
        if !of_kind.is_empty() {
            row(kind.name(), &of_kind, paper)?;
        }
    }
    let overall = row("all", &all, printed.t8.overall)?;
    Ok(Section {
        title: wording::ROLLBACK.to_owned(),
        text: vec![wording::drift_runs(report.runs)],
        tables: vec![table],
        lines: vec![wording::rollback(&overall, printed.t8.overall)],
        ..Section::default()
    })
}
