//! The files of the drift experiment: JSON with everything, CSV and Markdown for reading, an SVG of the curves.
//!
//! Writes the summary; computes nothing but text and coordinates.

use std::path::Path;

use holdpoint_body::disturbance::{DriftKind, Magnitude};
use plotters::prelude::{
    BLACK, BLUE, ChartBuilder, Color, GREEN, IntoDrawingArea, LineSeries, MAGENTA, PathElement, RED,
    RGBColor, SVGBackend, WHITE,
};

use super::drift::{DriftCell, DriftReport, Quantiles};
use super::{ExperimentError, write_atomically};
use crate::paper_reproduction::report_table::ReportTable;
use crate::wording::{drift as wording, number, or_dash};
use holdpoint_governance::metrics::Proportion;

/// Size of the plot, pixels.
const PLOT: (u32, u32) = (760, 420);

/// Writes `drift.json`, `drift.csv`, `drift.md` and `drift.svg`.
pub(super) fn write(report: &DriftReport, out: &Path) -> Result<(), ExperimentError> {
    write_atomically(&out.join("drift.json"), &serde_json::to_vec_pretty(report)?)?;
    write_atomically(&out.join("drift.csv"), csv(report).as_bytes())?;
    write_atomically(&out.join("drift.md"), markdown(report).as_bytes())?;
    write_atomically(&out.join("drift.svg"), svg(report)?.as_bytes())
}

/// The rates of a cell with their names.
fn rates(cell: &DriftCell) -> [(&'static str, &Proportion); 11] {
    [
        ("needed", &cell.needed),
        ("trigger_recall", &cell.trigger_recall),
        ("triggered_unneeded", &cell.triggered_unneeded),
        ("recovery_given_trigger", &cell.recovery_given_trigger),
        ("end_to_end", &cell.end_to_end),
        ("safe_stopped", &cell.safe_stopped),
        ("warned_first", &cell.warned_first),
        ("good_before", &cell.good_before),
        ("good_under", &cell.good_under),
        ("success_after", &cell.success_after),
        ("unsafe_after", &cell.unsafe_after),
    ]
}

/// The quantiles of a cell with their names.
fn quantiles(cell: &DriftCell) -> [(&'static str, Option<Quantiles>); 5] {
    [
        ("episodes_to_response", cell.episodes_to_response),
        ("episodes_to_rollback", cell.episodes_to_rollback),
        ("time_to_safe_ms", cell.time_to_safe_ms),
        ("time_to_restored_ms", cell.time_to_restored_ms),
        ("unsafe_continuation_ms", cell.unsafe_continuation_ms),
    ]
}

/// One line for each figure: its name, count and total with the interval, or n, median, p90 and largest.
pub(super) fn csv(report: &DriftReport) -> String {
    let mut text =
        "kind,magnitude,figure,count_or_n,total,share_or_median,lower_or_p90,upper_or_max\n".to_owned();
    for cell in &report.cells {
        let head = format!("{},{}", cell.kind, cell.magnitude);
        for (what, rate) in rates(cell) {
            let ends = rate.interval.map_or([None, None], |ends| [Some(ends.lower), Some(ends.upper)]);
            let [value, lower, upper] =
                [rate.rate(), ends[0], ends[1]].map(|v| v.map_or_else(String::new, |v| format!("{v:.4}")));
            text.push_str(&format!("{head},{what},{},{},{value},{lower},{upper}\n", rate.count, rate.total));
        }
        for (what, found) in quantiles(cell) {
            let Some(quantiles) = found else { continue };
            text.push_str(&format!(
                "{head},{what},{},,{},{},{}\n",
                quantiles.n, quantiles.median, quantiles.p90, quantiles.max
            ));
        }
    }
    text
}

fn count_and_interval(rate: &Proportion) -> String {
    match rate.interval {
        None => "none".to_owned(),
        Some(ends) => format!("{}/{} [{:.2}, {:.2}]", rate.count, rate.total, ends.lower, ends.upper),
    }
}

fn median(found: Option<Quantiles>) -> String {
    or_dash(found.map(|found| format!("{:.0} ({:.0})", found.median, found.max)))
}

/// The table for readers, with the meaning of its columns.
pub(super) fn markdown(report: &DriftReport) -> String {
    let mut table = ReportTable::new(wording::TABLE);
    for cell in &report.cells {
        let mut cells = vec![cell.kind.to_string(), cell.magnitude.to_string(), cell.runs.to_string()];
        let rates = [
            &cell.needed,
            &cell.trigger_recall,
            &cell.triggered_unneeded,
            &cell.recovery_given_trigger,
            &cell.end_to_end,
            &cell.safe_stopped,
            &cell.warned_first,
        ];
        cells.extend(rates.map(count_and_interval));
        cells.extend(quantiles(cell).map(|(_, found)| median(found)));
        let good = [&cell.good_before, &cell.good_under, &cell.success_after];
        cells.push(good.map(|rate| number(rate.rate(), 2)).join(" / "));
        table.row(cells);
    }
    wording::head(report) + &table.markdown()
}

/// Recovery end to end against the magnitude, one curve for each drift; a cell has no point if no run needed a rollback.
pub(super) fn svg(report: &DriftReport) -> Result<String, ExperimentError> {
    draw(report).map_err(|error| ExperimentError::Plot(error.to_string()))
}

fn draw(report: &DriftReport) -> Result<String, Box<dyn std::error::Error>> {
    const COLORS: [RGBColor; 4] = [BLUE, RED, GREEN, MAGENTA];
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, PLOT).into_drawing_area();
        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&area)
            .caption(wording::PLOT, ("sans-serif", 18))
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(44)
            .build_cartesian_2d(0.6..3.4_f64, 0.0..1.0_f64)?;
        chart
            .configure_mesh()
            .x_labels(3)
            .x_label_formatter(&|x| label(*x).to_owned())
            .y_desc("share")
            .x_desc("magnitude")
            .draw()?;
        for (index, (kind, color)) in DriftKind::ALL.into_iter().zip(COLORS).enumerate() {
            // The curves are shifted, so that their bars do not overlap.
            let shift = 0.05 * (index as f64 - 1.5);
            let mut points = Vec::new();
            for (step, magnitude) in Magnitude::ALL.into_iter().enumerate() {
                let found = report.cells.iter().find(|cell| cell.kind == kind && cell.magnitude == magnitude);
                let Some(cell) = found else { continue };
                let (Some(share), Some(ends)) = (cell.end_to_end.rate(), cell.end_to_end.interval) else {
                    continue;
                };
                let x = step as f64 + 1.0 + shift;
                points.push((x, share));
                let bar = vec![(x, ends.lower), (x, ends.upper)];
                chart.draw_series(LineSeries::new(bar, color.stroke_width(1)))?;
            }
            chart
                .draw_series(LineSeries::new(points, color.stroke_width(2)))?
                .label(kind.name())
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], color));
        }
        chart.configure_series_labels().border_style(BLACK).background_style(WHITE.mix(0.8)).draw()?;
        area.present()?;
    }
    Ok(text)
}

fn label(x: f64) -> &'static str {
    [(1.0, "mild"), (2.0, "middle"), (3.0, "strong")]
        .into_iter()
        .find(|(at, _)| (x - at).abs() < 0.01)
        .map_or("", |(_, label)| label)
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::ids::Digest;

    fn report() -> DriftReport {
        let share = |count: u64, total: u64| Proportion::of((0..total).map(|i| i < count)).unwrap();
        let cell = |kind, magnitude| DriftCell {
            kind,
            magnitude,
            runs: 4,
            needed: share(3, 4),
            trigger_recall: share(3, 3),
            triggered_unneeded: share(0, 1),
            recovery_given_trigger: share(2, 3),
            end_to_end: share(2, 3),
            safe_stopped: share(1, 3),
            warned_first: share(1, 3),
            episodes_to_response: Quantiles::of([2.0, 5.0]),
            episodes_to_rollback: Quantiles::of([7.0]),
            time_to_safe_ms: None,
            time_to_restored_ms: Quantiles::of([900.0]),
            unsafe_continuation_ms: Quantiles::of([0.0]),
            good_before: share(9, 10),
            good_under: share(5, 10),
            success_after: share(0, 0),
            unsafe_after: share(0, 0),
        };
        let cells = DriftKind::ALL
            .into_iter()
            .flat_map(|kind| Magnitude::ALL.into_iter().map(move |magnitude| cell(kind, magnitude)))
            .collect();
        let setting = Digest::of_parts("test", &[b"setting"]);
        DriftReport { setting, seed: 100, runs: 5, not_activated: 1, horizon: 200, pairs: 60, cells }
    }

    #[test]
    fn the_table_has_exactly_the_measured_figures() {
        let csv = csv(&report());
        let lines: Vec<&str> = csv.lines().collect();
        // Eleven rates and the four quantiles that have values, twelve times.
        assert_eq!(lines.len(), 1 + 12 * (11 + 4));
        assert!(lines.contains(&"sensor_noise,mild,end_to_end,2,3,0.6667,0.2077,0.9385"), "{csv}");
        assert!(lines.contains(&"combined,strong,success_after,0,0,,,"));
        assert!(!csv.contains("time_to_safe_ms"));
        let text = markdown(&report());
        assert_eq!(text.lines().filter(|line| line.starts_with("| ")).count(), 2 + 12);
        assert!(text.contains("| 4 (5) | 7 (7) | - | 900 (900) | 0 (0) | 0.90 / 0.50 / - |"), "{text}");
    }

    #[test]
    fn the_plot_has_every_drift() {
        let svg = svg(&report()).unwrap();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
        for kind in DriftKind::ALL {
            assert!(svg.contains(kind.name()), "{kind:?}");
        }
    }
}
