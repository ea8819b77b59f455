//! A chart of one series with its limit drawn in and labeled.
//!
//! Many values share a column as their smallest and largest, joined: a spike of one value survives any width.

use ratatui::layout::Rect;

use super::dots::{ACROSS, DOWN, Dots, Ink};
use super::pen::Pen;
use super::row::Row;
use crate::look::{Glyph, ThemeRole};

/// Columns left of a chart, for its numbers.
const SCALE: u16 = 6;

/// A series and its labels.
#[derive(Clone, Copy, Debug)]
pub struct Chart<'a> {
    /// The values, the newest last.
    pub values: &'a [f32],
    /// The upper limit.
    pub limit: Option<f64>,
}

/// The smallest and largest of each of at most `columns` equal parts, in order, without values that are no numbers.
#[must_use]
pub fn extremes(values: &[f32], columns: usize) -> Vec<(f32, f32)> {
    if columns == 0 {
        return Vec::new();
    }
    let parts = values.len().min(columns);
    (0..parts)
        .filter_map(|part| {
            let from = part * values.len() / parts;
            let to = (part + 1) * values.len() / parts;
            let part = values.get(from..to)?.iter().copied().filter(|value| value.is_finite());
            part.fold(None, |seen: Option<(f32, f32)>, value| {
                Some(seen.map_or((value, value), |(low, high)| (low.min(value), high.max(value))))
            })
        })
        .collect()
}

impl Chart<'_> {
    fn range(&self, columns: &[(f32, f32)]) -> (f64, f64) {
        let limit = self.limit.unwrap_or(0.0);
        let low = columns.iter().map(|(low, _)| f64::from(*low)).fold(limit.min(0.0), f64::min);
        let high = columns.iter().map(|(_, high)| f64::from(*high)).fold(limit, f64::max);
        // Head room, so that the limit never coincides with the frame.
        let high = if high > low { high + 0.1 * (high - low) } else { low + 1.0 };
        (low, high)
    }

    /// Draws it. In an area too small for a chart, nothing.
    #[allow(clippy::cast_possible_truncation, reason = "scaled to the area before")]
    pub fn draw(&self, pen: &mut Pen<'_>, area: Rect) {
        let area = area.intersection(pen.buf.area);
        if area.width <= SCALE + 2 || area.height == 0 {
            return;
        }
        let plot = Rect { x: area.x + SCALE, width: area.width - SCALE, ..area };
        let columns = extremes(self.values, usize::from(plot.width) * ACROSS);
        let (low, high) = self.range(&columns);
        let bottom = f64::from(plot.height) * DOWN as f64 - 1.0;
        let y =
            |value: f64| (bottom - (value - low) / (high - low) * bottom).round().clamp(0.0, bottom) as i64;
        self.scale(pen, area, plot, (low, high), &y);
        let mut dots = Dots::new(plot);
        // Few values stand apart, so that each can be counted.
        let across = usize::from(plot.width) * ACROSS;
        let step = (across / columns.len().max(1)).clamp(1, 4);
        let mut before: Option<(i64, i64)> = None;
        for (x, (least, most)) in (0i64..).step_by(step).zip(&columns) {
            let past = self.limit.is_some_and(|limit| f64::from(*most) > limit);
            let ink = Ink {
                role: if past { ThemeRole::Past } else { ThemeRole::Value },
                ascii: if past { "X" } else { "*" },
                dashed: false,
            };
            let (top, foot) = (y(f64::from(*most)), y(f64::from(*least)));
            let from = before.map_or((x, foot), |at| at);
            dots.line(from, (x, if (from.1 - top).abs() < (from.1 - foot).abs() { top } else { foot }), ink);
            dots.line((x, top), (x, foot), ink);
            before = Some((x, if top == foot { top } else { foot }));
        }
        dots.draw(pen, plot);
    }

    /// The numbers at the left and the line of the limit.
    fn scale(
        &self,
        pen: &mut Pen<'_>,
        area: Rect,
        plot: Rect,
        (low, high): (f64, f64),
        y: &dyn Fn(f64) -> i64,
    ) {
        let width = usize::from(SCALE - 1);
        let number =
            |value: f64| if value.abs() < 100.0 { format!("{value:.2}") } else { format!("{value:.0}") };
        pen.row(area, 0, &Row::new().cell_right(ThemeRole::Muted, &number(high), width));
        if area.height > 1 {
            pen.row(area, area.height - 1, &Row::new().cell_right(ThemeRole::Muted, &number(low), width));
        }
        let Some(limit) = self.limit.filter(|limit| limit.is_finite()) else { return };
        let at = usize::try_from(y(limit)).map_or(0, |dot| dot / DOWN);
        let at = u16::try_from(at).unwrap_or(0).min(area.height - 1);
        let line = if pen.look.ascii() { "-" } else { "╌" };
        for x in plot.left()..plot.right() {
            pen.cell(x, area.y + at, line, ThemeRole::Limit);
        }
        pen.row(area, at, &Row::new().cell_right(ThemeRole::Limit, &number(limit), width));
        let label = format!(" {} limit {} ", pen.look.glyph(Glyph::Limit), number(limit));
        let label_width = u16::try_from(label.chars().count()).unwrap_or(0);
        if plot.width > 2 * label_width {
            let x = plot.right() - label_width;
            pen.row(Rect { x, width: label_width, ..plot }, at, &Row::of(ThemeRole::Limit, &label));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chart_keeps_a_spike_and_omits_nan() {
        let mut values = vec![0.1f32; 100_000];
        *values.get_mut(54_321).unwrap() = 9.0;
        *values.get_mut(5).unwrap() = f32::NAN;
        let columns = extremes(&values, 60);
        assert_eq!(columns.len(), 60);
        assert_eq!(columns.iter().filter(|(_, high)| *high == 9.0).count(), 1);
        assert!(columns.iter().all(|(low, _)| *low == 0.1));
        assert!(extremes(&values, 0).is_empty() && extremes(&[], 9).is_empty());
    }
}
