//! One chart over time, with its limit as it was then, the cursor and the moments at which it went wrong; and the time
//! axis of the charts.
//!
//! Many values share a dot column as their smallest and largest: a spike of one value survives any width. Moving
//! values are joined only if they follow each other closely; a gap stays a gap. Values that hold until the next
//! are drawn as steps.

use ratatui::layout::Rect;

use crate::look::{Glyph, ThemeRole};
use crate::replay::charts::LimitedSeries;
use crate::replay::model::ReplayModel;
use crate::widgets::dots::{ACROSS, DOWN, Dots, Ink};
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;

/// Columns left of a chart, for its numbers.
const SCALE: u16 = 6;

/// The visible span of a moving value, ms: before and after the cursor.
const WINDOW_MS: (u64, u64) = (15_000, 5_000);

/// Moving values further apart are not joined, ms.
const JOINED_MS: u64 = 1_000;

/// The areas and scales of a chart.
struct PlotArea {
    from_ms: u64,
    to_ms: u64,
    low: f64,
    high: f64,
    across: usize,
    down: usize,
}

impl PlotArea {
    /// The scales of a chart in its plot.
    fn new(chart: &LimitedSeries, model: &ReplayModel, plot: Rect) -> Self {
        let (from_ms, to_ms) = window_ms(chart, model);
        let (low, high) = range(chart);
        let (across, down) = (usize::from(plot.width) * ACROSS, usize::from(plot.height) * DOWN);
        Self { from_ms, to_ms, low, high, across, down }
    }

    /// The column of a time, from the plot's left end.
    fn column(&self, at_ms: u64) -> u16 {
        let column = usize::try_from(self.x(at_ms)).map_or(0, |dot| dot / ACROSS);
        let last = (self.across / ACROSS).saturating_sub(1);
        u16::try_from(column.min(last)).unwrap_or(0)
    }

    #[allow(clippy::cast_possible_truncation, reason = "a share of the dots across")]
    fn x(&self, at_ms: u64) -> i64 {
        let span_ms = (self.to_ms - self.from_ms).max(1) as f64;
        let share = at_ms.saturating_sub(self.from_ms) as f64 / span_ms;
        (share.clamp(0.0, 1.0) * self.across.saturating_sub(1) as f64).round() as i64
    }

    #[allow(clippy::cast_possible_truncation, reason = "a share of the dots down")]
    fn y(&self, value: f64) -> i64 {
        let bottom = self.down.saturating_sub(1) as f64;
        (bottom - (value - self.low) / (self.high - self.low) * bottom).round().clamp(0.0, bottom) as i64
    }
}

/// Draws it. In an area too small for a chart, nothing.
pub fn draw(chart: &LimitedSeries, model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let area = area.intersection(pen.buf.area);
    if area.width <= SCALE + 2 || area.height == 0 {
        return;
    }
    let plot = Rect { x: area.x + SCALE, width: area.width - SCALE, ..area };
    let frame = PlotArea::new(chart, model, plot);
    scale(&frame, pen, area);
    limit(chart, &frame, pen, plot);
    failures(model, &frame, pen, plot);
    cursor(model, &frame, pen, plot);
    let mut dots = Dots::new(plot);
    values(chart, &frame, model.cursor.at_ms, &mut dots);
    dots.draw(pen, plot);
}

/// The visible span: around the cursor for moving values, everything for the others.
fn window_ms(chart: &LimitedSeries, model: &ReplayModel) -> (u64, u64) {
    let (first_ms, last_ms) = model.timeline.span_ms();
    let (before_ms, after_ms) = WINDOW_MS;
    if !chart.moving || last_ms - first_ms <= before_ms + after_ms {
        return (first_ms, last_ms);
    }
    let to_ms = model.cursor.at_ms.saturating_add(after_ms).clamp(first_ms + before_ms + after_ms, last_ms);
    (to_ms - before_ms - after_ms, to_ms)
}

/// The smallest and largest number of the scale, over the whole recording so that it does not change.
fn range(chart: &LimitedSeries) -> (f64, f64) {
    let all =
        chart.values.iter().chain(&chart.limits).map(|(_, value)| *value).filter(|value| value.is_finite());
    let (low, high) =
        all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return (0.0, 1.0);
    }
    let low = if chart.at_least { low } else { low.min(0.0) };
    let room = if high > low { 0.1 * (high - low) } else { 0.1 * high.abs().max(1.0) };
    // Some room beyond, so that a limit never coincides with the frame.
    (if chart.at_least { low - room } else { low }, high + room)
}

fn scale(frame: &PlotArea, pen: &mut Pen<'_>, area: Rect) {
    let width = usize::from(SCALE - 1);
    let number = |value: f64| if value.abs() < 100.0 { format!("{value:.2}") } else { format!("{value:.0}") };
    pen.row(area, 0, &Row::new().cell_right(ThemeRole::Muted, &number(frame.high), width));
    if area.height > 1 {
        pen.row(area, area.height - 1, &Row::new().cell_right(ThemeRole::Muted, &number(frame.low), width));
    }
}

/// The limit in force in each column.
fn limit(chart: &LimitedSeries, frame: &PlotArea, pen: &mut Pen<'_>, plot: Rect) {
    let line = if pen.look.ascii() { "-" } else { "╌" };
    let span_ms = u128::from(frame.to_ms - frame.from_ms);
    for column in 0..plot.width {
        let passed_ms = span_ms * u128::from(column) / u128::from(plot.width);
        let at_ms = frame.from_ms.saturating_add(u64::try_from(passed_ms).unwrap_or(u64::MAX));
        let Some(limit) = chart.at(at_ms).1.filter(|limit| limit.is_finite()) else { continue };
        let row = usize::try_from(frame.y(limit)).map_or(0, |dot| dot / DOWN);
        let row = u16::try_from(row).unwrap_or(0).min(plot.height - 1);
        pen.cell(plot.x + column, plot.y + row, line, ThemeRole::Limit);
    }
}

/// A line at each visible moment at which it went wrong.
fn failures(model: &ReplayModel, frame: &PlotArea, pen: &mut Pen<'_>, plot: Rect) {
    let sign = if pen.look.ascii() { ":" } else { "╎" };
    for at_ms in visible_failures(model, frame) {
        for y in plot.top()..plot.bottom() {
            pen.cell(plot.x + frame.column(at_ms), y, sign, ThemeRole::Bad);
        }
    }
}

fn visible_failures(model: &ReplayModel, frame: &PlotArea) -> impl Iterator<Item = u64> {
    let times_ms = model.timeline.failures().times_ms().iter().copied();
    let (from_ms, to_ms) = (frame.from_ms, frame.to_ms);
    times_ms.filter(move |at_ms| (from_ms..=to_ms).contains(at_ms))
}

/// Draws the times below a chart, in the first line of the area: seconds, the cursor and the moments at which it went
/// wrong.
pub fn axis(chart: &LimitedSeries, model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let area = area.intersection(pen.buf.area);
    if area.width <= SCALE + 2 || area.height == 0 {
        return;
    }
    let plot = Rect { x: area.x + SCALE, width: area.width - SCALE, ..area };
    let frame = PlotArea::new(chart, model, plot);
    pen.row(area, 0, &Row::new().cell_right(ThemeRole::Muted, "s", usize::from(SCALE - 1)));
    let mut row = Row::new();
    for (at_ms, label) in labels(frame.from_ms, frame.to_ms, plot.width) {
        let column = usize::from(frame.column(at_ms));
        let is_free = row.width() == 0 || column > row.width();
        if is_free && column + label.len() <= usize::from(plot.width) {
            row = row.to_column(column).with(ThemeRole::Muted, &label);
        }
    }
    pen.row(plot, 0, &row);
    for at_ms in visible_failures(model, &frame) {
        pen.cell(plot.x + frame.column(at_ms), plot.y, pen.look.glyph(Glyph::Bad), ThemeRole::Bad);
    }
    // Not every screen has a color for the cursor.
    let here = plot.x + frame.column(model.cursor.at_ms);
    pen.cell(here, plot.y, pen.look.glyph(Glyph::Up), ThemeRole::Focus);
}

/// Steps of the time axis, ms.
const STEPS_MS: [u64; 15] = [
    100, 200, 500, 1_000, 2_000, 5_000, 10_000, 20_000, 60_000, 120_000, 300_000, 600_000, 1_800_000,
    3_600_000, 14_400_000,
];

/// Columns between two times of the axis at least.
const BETWEEN: usize = 3;

/// The times of an axis, ms, and their labels in seconds: at round steps that leave room between them.
fn labels(from_ms: u64, to_ms: u64, width: u16) -> impl Iterator<Item = (u64, String)> {
    let label = |at_ms: u64, step_ms: u64| {
        let tenths = if step_ms < 1_000 { format!(".{}", at_ms / 100 % 10) } else { String::new() };
        format!("{}{tenths}", at_ms / 1_000)
    };
    let span_ms = to_ms.saturating_sub(from_ms).max(1);
    let fits = |step_ms: &u64| {
        let each = label(to_ms, *step_ms).len() + BETWEEN;
        u128::from(*step_ms) * u128::from(width) >= u128::from(span_ms) * each as u128
    };
    let step_ms = STEPS_MS.into_iter().find(fits).unwrap_or(span_ms);
    let first_ms = from_ms.div_ceil(step_ms).checked_mul(step_ms);
    std::iter::successors(first_ms, move |at_ms| at_ms.checked_add(step_ms))
        .take_while(move |at_ms| *at_ms <= to_ms)
        .map(move |at_ms| (at_ms, label(at_ms, step_ms)))
}

fn cursor(model: &ReplayModel, frame: &PlotArea, pen: &mut Pen<'_>, plot: Rect) {
    let column = frame.column(model.cursor.at_ms);
    pen.divider(Rect { x: plot.x + column, width: 1, ..plot });
    pen.lay(Rect { x: plot.x + column, width: 1, ..plot }, ThemeRole::Focus);
}

/// The values; those after the cursor are muted.
fn values(chart: &LimitedSeries, frame: &PlotArea, here_ms: u64, dots: &mut Dots) {
    let first = chart.values.partition_point(|(at_ms, _)| *at_ms < frame.from_ms);
    let end = chart.values.partition_point(|(at_ms, _)| *at_ms <= frame.to_ms);
    let within = chart.values.get(first..end).unwrap_or_default();
    let mut before: Option<PlotPoint> = None;
    if !chart.moving
        && let (Some(value), _) = chart.at(frame.from_ms)
        && value.is_finite()
    {
        before = Some(PlotPoint::of(chart, frame, (frame.from_ms, value)));
    }
    for value in within.iter().filter(|(_, value)| value.is_finite()) {
        let point = PlotPoint::of(chart, frame, *value);
        match before {
            Some(before) if chart.moving && point.at_ms - before.at_ms <= JOINED_MS => {
                dots.line((before.x, before.y), (point.x, point.y), point.ink(here_ms));
            }
            Some(before) if !chart.moving => {
                before.hold(dots, point.x, (here_ms, frame.x(here_ms)));
                dots.line((point.x, before.y), (point.x, point.y), point.ink(here_ms));
            }
            Some(_) | None => dots.dot(point.x, point.y, point.ink(here_ms)),
        }
        before = Some(point);
    }
    if let Some(before) = before.filter(|_| !chart.moving) {
        before.hold(dots, frame.x(frame.to_ms), (here_ms, frame.x(here_ms)));
    }
}

/// A value on the dots.
#[derive(Clone, Copy)]
struct PlotPoint {
    at_ms: u64,
    x: i64,
    y: i64,
    is_past: bool,
}

impl PlotPoint {
    fn of(chart: &LimitedSeries, frame: &PlotArea, (at_ms, value): (u64, f64)) -> Self {
        let is_past = chart.at(at_ms).1.is_some_and(|limit| chart.is_past(value, limit));
        Self { at_ms, x: frame.x(at_ms), y: frame.y(value), is_past }
    }

    const fn ink(self, here_ms: u64) -> Ink {
        let role = match (self.at_ms <= here_ms, self.is_past) {
            (false, _) => ThemeRole::Muted,
            (true, true) => ThemeRole::Past,
            (true, false) => ThemeRole::Value,
        };
        Ink { role, ascii: if self.is_past { "X" } else { "*" }, dashed: false }
    }

    /// Draws the value up to a column, muted from the cursor's column on.
    fn hold(self, dots: &mut Dots, until_x: i64, (here_ms, here_x): (u64, i64)) {
        let turns_x = if self.at_ms <= here_ms { here_x.clamp(self.x, until_x.max(self.x)) } else { self.x };
        dots.line((turns_x, self.y), (until_x, self.y), Ink { role: ThemeRole::Muted, ..self.ink(here_ms) });
        if self.at_ms <= here_ms {
            dots.line((self.x, self.y), (turns_x, self.y), self.ink(here_ms));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_the_axis_are_round_and_apart() {
        let shown =
            |from_ms, to_ms, width| labels(from_ms, to_ms, width).map(|(_, label)| label).collect::<Vec<_>>();
        assert_eq!(shown(836_300, 856_300, 40), ["840", "845", "850", "855"]);
        assert_eq!(shown(0, 2_000, 40), ["0.0", "0.5", "1.0", "1.5", "2.0"]);
        assert_eq!(shown(0, 7_033, 20), ["0", "2", "4", "6"]);
        assert_eq!(shown(700_000, 880_000, 29), ["720", "780", "840"]);
        assert_eq!(shown(5, 5, 20), Vec::<String>::new());
        // A broken file has senseless times: the axis stays short.
        for (from_ms, to_ms) in [(0, u64::MAX), (u64::MAX - 1, u64::MAX), (u64::MAX, 0)] {
            assert!(shown(from_ms, to_ms, 60).len() <= 20, "{from_ms} {to_ms}");
        }
    }
}
