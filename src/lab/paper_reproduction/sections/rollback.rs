//! E4: rollback under drift, from the drift experiment's cells.

use holdpoint_body::disturbance::DriftKind;
use holdpoint_governance::metrics::Proportion;

use super::{Section, counted};
use crate::paper_reproduction::published::PublishedNumbers;
use crate::paper_reproduction::report_table::ReportTable;
use crate::pipeline_experiments::ExperimentError;
use crate::pipeline_experiments::drift::{self, DriftCell, DriftReport};

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
    let [paper, deviation] = printed.t8.overall;
    let mut table = ReportTable::new(
        "Rollback under drift, three magnitudes together",
        &[
            "drift",
            "worsened the version",
            "rolled back",
            "recovered of those rolled back",
            "end to end",
            "success after",
            "paper: recovered",
        ],
        "End to end: recovered, of those that the drift worsened. The paper's rate has as its denominator the drifts that \
         were injected (readings X75).",
    );
    let kinds: Vec<DriftKind> = all.iter().map(|cell| cell.kind).fold(Vec::new(), |mut kinds, kind| {
        if !kinds.contains(&kind) {
            kinds.push(kind);
        }
        kinds
    });
    let mut row = |name: String, cells: &[&DriftCell], paper: Option<&[f64; 2]>| {
        let end_to_end = summed(cells, |cell| &cell.end_to_end)?;
        table.row([
            name,
            counted(&summed(cells, |cell| &cell.needed)?),
            counted(&summed(cells, |cell| &cell.trigger_recall)?),
            counted(&summed(cells, |cell| &cell.recovery_given_trigger)?),
            counted(&end_to_end),
            counted(&summed(cells, |cell| &cell.success_after)?),
            paper.map_or_else(String::new, |[mean, deviation]| format!("{mean:.1} ± {deviation:.1} %")),
        ]);
        Ok::<Proportion, ExperimentError>(end_to_end)
    };
    for kind in kinds {
        let of_kind: Vec<&DriftCell> = all.iter().copied().filter(|cell| cell.kind == kind).collect();
        let place = DriftKind::ALL.iter().position(|known| *known == kind);
        row(kind.to_string(), &of_kind, place.and_then(|place| printed.t8.by.get(place)))?;
    }
    let overall = row("all".to_owned(), &all, Some(&printed.t8.overall))?;
    let line =
        format!("E4: recovery end to end {} (paper: {paper:.1} ± {deviation:.1} %)", counted(&overall));
    Ok(Section {
        title: "E4: rollback under drift".to_owned(),
        text: vec![format!(
            "{} runs, each with the version that it activated, under four drifts at three magnitudes.",
            report.runs
        )],
        tables: vec![table],
        plots: Vec::new(),
        lines: vec![line],
    })
}
