//! Bars with their limit drawn in, progress, and small trends. Each reads the same without colors.

use super::row::Row;
use crate::look::{Glyph, Look, ThemeRole};

/// A share of 0 to 1 as a bar of `width` columns with a lower limit.
#[must_use]
pub fn against_limit(look: &Look, value: Option<f64>, limit: f64, width: usize) -> Row {
    let limit_at = columns(limit, width).min(width.saturating_sub(1));
    let filled = match value {
        None => 0,
        // A value short of its limit leaves a gap before it, however small; a value at its limit leaves none.
        Some(value) if !(value >= limit) => columns(value, width).min(limit_at.saturating_sub(1)),
        Some(value) => columns(value, width).max(limit_at),
    };
    let role = match value {
        None => ThemeRole::Unknown,
        Some(value) if value >= limit => ThemeRole::Value,
        Some(_) => ThemeRole::Past,
    };
    let piece = |from: usize, to: usize| {
        let full = filled.clamp(from, to) - from;
        let empty = (to - from) - full;
        Row::of(role, &look.glyph(Glyph::Full).repeat(full))
            .with(ThemeRole::Muted, &look.glyph(Glyph::Empty).repeat(empty))
    };
    if width == 0 {
        return Row::new();
    }
    piece(0, limit_at).with(ThemeRole::Limit, look.glyph(Glyph::Limit)).and(piece(limit_at + 1, width))
}

/// The progress of a job.
#[must_use]
pub fn progress(look: &Look, done: u64, budget: u64, width: usize) -> Row {
    let share = if budget == 0 { 0.0 } else { done as f64 / budget as f64 };
    let filled = columns(share, width);
    Row::of(ThemeRole::Running, &look.glyph(Glyph::Full).repeat(filled))
        .with(ThemeRole::Muted, &look.glyph(Glyph::Empty).repeat(width - filled))
}

/// Outcomes as signs, newest last; signs without room are dropped at the front.
#[must_use]
pub fn outcomes(look: &Look, outcomes: &[bool], width: usize) -> Row {
    let shown = outcomes.get(outcomes.len().saturating_sub(width)..).unwrap_or(&[]);
    let mut row = Row::new();
    for run in shown.chunk_by(|a, b| a == b) {
        let good = run.first().copied().unwrap_or(true);
        let (glyph, role) =
            if good { (Glyph::Neutral, ThemeRole::Text) } else { (Glyph::Bad, ThemeRole::Bad) };
        row.push(role, &look.glyph(glyph).repeat(run.len()));
    }
    row
}

/// Columns of a share of 0 to 1.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the width before")]
fn columns(share: f64, width: usize) -> usize {
    let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
    ((share * width as f64).round() as usize).min(width)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::look::{ColorDepth, Glyphs, Theme};

    fn text(row: &Row) -> String {
        row.parts().map(|(text, _)| text).collect()
    }

    #[test]
    fn bars_keep_their_width_and_mark_their_limit() {
        let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Ascii);
        let table = [
            (Some(0.5), 0.8, "#####...|."),
            (Some(0.95), 0.8, "########|#"),
            (Some(1.0), 1.0, "#########|"),
            (None, 0.8, "........|."),
            (Some(f64::NAN), 0.0, "|........."),
        ];
        for (value, limit, expected) in table {
            assert_eq!(text(&against_limit(&look, value, limit, 10)), expected);
        }
        assert_eq!(text(&progress(&look, 137, 480, 10)), "###.......");
        assert_eq!(text(&progress(&look, 9, 0, 4)), "....");
        assert_eq!(text(&outcomes(&look, &[true, false, true], 2)), "x-");
        assert_eq!(text(&against_limit(&look, Some(1.0), 0.5, 0)), "");
    }
}
