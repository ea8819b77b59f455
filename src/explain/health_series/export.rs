//! Exports a series as CSV and as SVG, for a report, a spreadsheet or a wall display.

use std::fmt::Write as _;

use holdpoint_governance::calendar;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_plot::{MARKS_LISTED_MAX, TrendLine, TrendMark, TrendPanel, TrendPlot, TrendPoint};
use holdpoint_protocol::clock::clock_time;
use holdpoint_protocol::health::{HealthClock, HealthPanel, HealthPoint, HealthSeries};
use holdpoint_text::Untrusted;
use holdpoint_wording::health::{axis_title, chart_title, mark_legend, panel_title};
use holdpoint_wording::program::health::{EMPTY_PANEL, unlisted_marks};

/// Columns of the file: a row per version and bucket, then a row per mark.
const COLUMNS: &str = "row,start_utc,start_virtual_s,end_utc,end_virtual_s,bucket_s,family,version,tasks,succeeded,success_percent,\
success_low_percent,success_high_percent,violated,near,time_median_s,time_p95_s,force_median_n,force_p95_n,mark,text";

/// The widest text of a mark, columns.
const TEXT_MAX: usize = 200;

/// The approximate number of labeled places on the axis.
const TICKS: u32 = 6;

/// The series as CSV in UTF-8, one line per row; times are RFC 3339 in UTC and virtual seconds. A bucket is named by the clock
/// of the series, and by the virtual time of its first and last task.
#[must_use]
pub fn csv(series: &HealthSeries) -> String {
    let mut text = format!("{COLUMNS}\n");
    let wall = |on_clock_ms: i64| match series.clock {
        HealthClock::Wall => calendar::rfc3339(on_clock_ms),
        HealthClock::Virtual => String::new(),
    };
    let width = i64::try_from(series.bucket_ms).unwrap_or(i64::MAX);
    for point in &series.points {
        let start = series.start_ms(point.bucket);
        let share = |part: f64| format!("{:.3}", 100.0 * part);
        let fields = [
            "tasks".to_owned(),
            wall(start),
            secs(point.at_ms[0]),
            wall(start.saturating_add(width)),
            secs(point.at_ms[1]),
            (series.bucket_ms / 1_000).to_string(),
            point.version.family.to_string(),
            point.version.to_string(),
            point.tasks.to_string(),
            point.succeeded.to_string(),
            share(point.succeeded as f64 / point.tasks.max(1) as f64),
            share(point.success[0]),
            share(point.success[1]),
            point.violated.to_string(),
            point.near.to_string(),
            number(point.time_s[0]),
            number(point.time_s[1]),
            number(point.force_n[0]),
            number(point.force_n[1]),
            String::new(),
            String::new(),
        ];
        let _ = writeln!(text, "{}", fields.join(","));
    }
    for mark in &series.marks {
        let family = mark.family.as_ref().map_or_else(String::new, ToString::to_string);
        let wall = mark.wall_ms.map_or_else(String::new, calendar::rfc3339);
        let mark_text = field(&mark.text);
        let _ = writeln!(
            text,
            "mark,{wall},{},,,,{family},{},{},{mark_text}",
            secs(mark.at_ms),
            ",".repeat(11),
            mark.kind
        );
    }
    text
}

/// A number with four digits; empty if it is not finite.
fn number(value: f64) -> String {
    if value.is_finite() { format!("{value:.4}") } else { String::new() }
}

fn secs(ms: u64) -> String {
    format!("{}.{:03}", ms / 1_000, ms % 1_000)
}

/// Foreign text as a field (RFC 4180), on one line and sanitized; a quote prevents evaluation by a spreadsheet.
fn field(text: &str) -> String {
    let safe = Untrusted::new(text).display(TEXT_MAX).into_string();
    let formula = safe.starts_with(['=', '+', '-', '@']);
    format!("\"{}{}\"", if formula { "'" } else { "" }, safe.replace('"', "\"\""))
}

/// A quantity of a panel: value and band of a point.
type PanelQuantity = fn(&HealthPoint) -> (f64, [f64; 2]);

/// One family of a series as SVG: one panel per quantity, with marks through all. Legible in black and white.
#[must_use]
pub fn svg(series: &HealthSeries, family: &Family, notes: &[String]) -> String {
    let points: Vec<&HealthPoint> =
        series.points.iter().filter(|point| point.version.family == *family).collect();
    let mut versions: Vec<&CapabilityId> = points.iter().map(|point| &point.version).collect();
    versions.sort();
    versions.dedup();
    let panel = |kind: HealthPanel, quantity: PanelQuantity, range: [f64; 2], digits| TrendPanel {
        title: panel_title(kind).to_owned(),
        range,
        digits,
        lines: versions
            .iter()
            .enumerate()
            .map(|(style, version)| TrendLine {
                name: version.to_string(),
                style,
                points: points
                    .iter()
                    .filter(|point| point.version == **version)
                    .map(|point| {
                        let (value, band) = quantity(point);
                        TrendPoint { at: middle(series, point.bucket), step: point.bucket, value, band }
                    })
                    .collect(),
            })
            .collect(),
    };
    let success: PanelQuantity = |point| {
        let share = 100.0 * point.succeeded as f64 / point.tasks.max(1) as f64;
        (share, point.success.map(|end| 100.0 * end))
    };
    let violations: PanelQuantity = |point| {
        let share = 100.0 * point.violated as f64 / point.tasks.max(1) as f64;
        (share, [share, 100.0 * point.near as f64 / point.tasks.max(1) as f64])
    };
    let time: PanelQuantity = |point| (point.time_s[0], point.time_s);
    let force: PanelQuantity = |point| (point.force_n[0], point.force_n);
    let least =
        |quantity: PanelQuantity| points.iter().map(|point| quantity(point).1[0]).fold(100.0, f64::min);
    let most = |quantity: PanelQuantity| points.iter().map(|point| quantity(point).1[1]).fold(0.0, f64::max);
    // Starts at a round number below the lowest band, so that small changes are visible.
    let low = (least(success) / 10.0).floor() * 10.0;
    let panels = vec![
        panel(HealthPanel::Success, success, [low.min(90.0), 100.0], 0),
        panel(HealthPanel::Violations, violations, [0.0, most(violations).max(1.0)], 1),
        panel(HealthPanel::Time, time, [0.0, most(time)], 1),
        panel(HealthPanel::Force, force, [0.0, most(force)], 1),
    ];
    let marks =
        series.marks.iter().filter(|mark| mark.family.is_none() || mark.family.as_ref() == Some(family));
    let marks: Vec<TrendMark> = marks
        .map(|mark| {
            let when = series.time_text(mark.on_clock_ms);
            let text = Untrusted::new(mark_legend(&when, mark)).display(TEXT_MAX).into_string();
            TrendMark {
                at: share(series, mark.on_clock_ms),
                letter: mark.kind.letter(),
                weight: mark.kind.weight(),
                text,
            }
        })
        .collect();
    let (from, until) = (series.time_text(series.from_ms), series.time_text(series.until_ms()));
    TrendPlot {
        title: chart_title(family, &from, &until),
        notes: notes
            .iter()
            .map(|note| Untrusted::new(note.as_str()).display(TEXT_MAX).into_string())
            .collect(),
        axis: axis_title(series.clock, series.bucket_ms),
        ticks: ticks(series),
        panels,
        empty: EMPTY_PANEL.to_owned(),
        unlisted: marks.len().checked_sub(MARKS_LISTED_MAX).filter(|more| *more > 0).map(unlisted_marks),
        marks,
    }
    .svg()
}

fn share(series: &HealthSeries, on_clock_ms: i64) -> f64 {
    let all = series.until_ms().saturating_sub(series.from_ms).max(1);
    on_clock_ms.saturating_sub(series.from_ms) as f64 / all as f64
}

fn middle(series: &HealthSeries, bucket: u32) -> f64 {
    (f64::from(bucket) + 0.5) / f64::from(series.buckets.max(1))
}

/// About this many beginnings of buckets, evenly spaced.
fn ticks(series: &HealthSeries) -> Vec<(f64, String)> {
    let step = series.buckets.div_ceil(TICKS).max(1);
    let places = (0..=series.buckets).step_by(usize::try_from(step).unwrap_or(1));
    places
        .map(|bucket| {
            let ms = series.start_ms(bucket);
            let label = match series.clock {
                HealthClock::Wall if series.bucket_ms >= 43_200_000 => calendar::date(ms),
                HealthClock::Wall => format!("{} {}", calendar::date(ms), calendar::time(ms)),
                HealthClock::Virtual => clock_time(u64::try_from(ms).unwrap_or(0)),
            };
            (share(series, ms), label)
        })
        .collect()
}
