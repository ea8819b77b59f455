//! The charts of one kind over one time axis, with their values and limits at the cursor. A chart without room becomes
//! a line.
//!
//! ```text
//! ─ Shadow ──────────────────────────── 2 of 3, by stage ─
//! output divergence                    0.112, at most 0.30
//!  0.46           ⡄   │
//!  0.30 ╌╌╌╌╌╌╌╌╌⡜⠸⡀╌╌│╌╌╌
//!     s  760       765↑     770
//! ```

use ratatui::layout::Rect;
use unicode_width::UnicodeWidthStr as _;

use super::plot;
use crate::look::{Glyph, ThemeRole};
use crate::replay::charts::LimitedSeries;
use crate::replay::model::ReplayModel;
use crate::widgets::pen::{Pen, above, below, cut};
use crate::widgets::row::Row;
use holdpoint_wording::console::replay as wording;

/// Lines that a chart needs with its heading.
const HEIGHT_MIN: u16 = 4;

/// Columns of a pane's first line that are neither heading nor place.
const ROOM_ROUND_HEADING: usize = 7;

/// The most lines that a chart gets.
const HEIGHT_MAX: u16 = 12;

pub fn draw(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let Some((place, group)) = model.shown_charts() else {
        let inside = pen.pane(area, "Charts", false, "");
        pen.text(inside, 0, ThemeRole::Muted, wording::NO_CHARTS_HERE);
        return;
    };
    let count = model.timeline.groups().len();
    let chosen = if model.charts.is_none() { ", by stage" } else { "" };
    let heading = group.about.heading();
    let right = format!("{} of {count}{chosen}", place + 1);
    let fits = heading.len() + right.len() + ROOM_ROUND_HEADING <= usize::from(area.width);
    let inside = pen.pane(area, heading, false, if fits { &right } else { "" });
    let drawn = visible_charts(inside.height, group.charts.len());
    let lines = u16::try_from(group.charts.len() - drawn).unwrap_or(u16::MAX).min(inside.height);
    let axis = u16::from(drawn > 0);
    let mut rest = above(inside, inside.height.saturating_sub(lines + axis));
    for (index, chart) in group.charts.iter().take(drawn).enumerate() {
        let left = u16::try_from(drawn - index).unwrap_or(1).max(1);
        let (part, below_it) = cut(rest, (rest.height / left).min(HEIGHT_MAX));
        rest = below_it;
        pen.row(part, 0, &value_line(chart, model, pen, part.width));
        plot::draw(chart, model, pen, below(part, 1));
    }
    // The charts of a group share one span of time, so one axis serves all.
    let foot = below(inside, inside.height.saturating_sub(rest.height + lines + axis));
    if let Some(chart) = group.charts.first().filter(|_| drawn > 0) {
        plot::axis(chart, model, pen, above(foot, axis));
    }
    let foot = below(foot, axis);
    for (chart, at) in group.charts.iter().skip(drawn).zip(0..lines) {
        pen.row(foot, at, &value_line(chart, model, pen, inside.width));
    }
}

/// How many charts are drawn; the others and the time axis get a line each.
fn visible_charts(height: u16, charts: usize) -> usize {
    let fits = |drawn: &usize| {
        let lines = charts - drawn + usize::from(*drawn > 0);
        usize::from(height) >= drawn * usize::from(HEIGHT_MIN) + lines
    };
    (0..=charts).rev().find(fits).unwrap_or(0)
}

/// A chart's name with its value and limit at the cursor; the limit's words are as many as fit.
fn value_line(chart: &LimitedSeries, model: &ReplayModel, pen: &Pen<'_>, width: u16) -> Row {
    let (value, limit) = chart.at(model.cursor.at_ms);
    let judged = if chart.limits_mean { chart.mean(model.cursor.at_ms) } else { value };
    let what = if chart.limits_mean { "mean " } else { "" };
    let is_past = judged.zip(limit).is_some_and(|(judged, limit)| chart.is_past(judged, limit));
    let counts = is_past && model.timeline.ends_badly(model.cursor.at_ms);
    let (role, text) = match judged {
        None => (ThemeRole::Unknown, wording::no_value_yet(pen.look.glyph(Glyph::Unknown))),
        Some(judged) if counts => {
            (ThemeRole::Past, format!("{} {what}{judged:.3}", pen.look.glyph(Glyph::Warning)))
        }
        Some(judged) => (ThemeRole::Value, format!("{what}{judged:.3}")),
    };
    // A value past its limit that was tolerated is no warning, and its line does not say "at most".
    let (long, short) = match (is_past && !counts, chart.at_least) {
        (true, true) => ("tolerated below", "below"),
        (true, false) => ("tolerated above", "above"),
        (false, true) => ("at least", "min"),
        (false, false) => ("at most", "max"),
    };
    let limited = |lead: &str| limit.map_or_else(String::new, |limit| format!(", {lead} {limit:.2}"));
    let width = usize::from(width);
    let wordings = [limited(long), limited(short), String::new()];
    let room = |limited: &str| width.saturating_sub(text.chars().count() + limited.len() + 1);
    let limited = wordings.iter().find(|limited| room(limited) >= chart.title.width());
    let limited = limited.map_or("", String::as_str);
    Row::new()
        .cell(ThemeRole::Text, &chart.title, room(limited))
        .with(ThemeRole::Text, " ")
        .with(role, &text)
        .with(role, limited)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_chart_has_a_line_at_least() {
        for (height, charts, expected) in
            [(13, 3, 3), (12, 3, 2), (10, 3, 2), (9, 3, 1), (4, 3, 0), (7, 4, 0), (8, 4, 1), (0, 4, 0)]
        {
            assert_eq!(visible_charts(height, charts), expected, "{height} {charts}");
        }
    }
}
