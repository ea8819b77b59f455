//! The arm and the twin at the cursor: the last frame, and its age if it is old.
//!
//! ```text
//! ─ Robot ──────────────────── sequence 211, 3.4 s ─
//! ◷ frame of 1.5 s earlier
//!   side view           │ top view
//! ```

use ratatui::layout::Rect;

use super::secs;
use crate::look::{Glyph, ThemeRole};
use crate::replay::FRESH_MS;
use crate::replay::model::ReplayModel;
use crate::views::robot;
use crate::widgets::pen::{Pen, below};
use holdpoint_recordings::recording::FilmSpan;
use holdpoint_wording::console::replay as wording;
use holdpoint_wording::film::recorded_part;

pub fn draw(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let frame = model.cursor.frame.and_then(|frame| model.timeline.frame(frame));
    let place = frame
        .map(|frame| match film(model) {
            Some(_) => format!("re-run, {:.1} s", frame.at_secs),
            None => format!("sequence {}, {:.1} s", frame.sequence, frame.at_secs),
        })
        .unwrap_or_default();
    let inside = pen.pane(area, "Robot", false, &place);
    draw_inside(model, pen, inside);
}

/// Draws the pane's inside, which may have any size.
pub fn draw_inside(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let mut rows = 0;
    for (role, text) in warnings(model) {
        let glyph = if role == ThemeRole::Bad { Glyph::Bad } else { Glyph::Waiting };
        let text = format!("{} {text}", pen.look.glyph(glyph));
        rows += pen.text(area, rows, role, &text);
    }
    let Some(frame) = model.cursor.frame.and_then(|frame| model.timeline.frame(frame)) else {
        return;
    };
    let area = below(area, rows);
    if area.height == 0 {
        return;
    }
    robot::draw_frame(frame, &model.timeline.recording().scenery, Vec::new(), pen, area);
    // A scene long past is not drawn as if it were current.
    if model.timeline.gap_ms(model.cursor).is_some() {
        pen.lay(area, ThemeRole::Muted);
    }
}

/// The re-run that the shown frame belongs to; `None` for one of the live cell. The frame's own time decides: the
/// last one stays until another follows, and must not be taken for the live arm.
fn film(model: &ReplayModel) -> Option<&FilmSpan> {
    model.timeline.film_at(model.timeline.frame(model.cursor.frame?)?.at_ms)
}

/// What the user must know about the frame first.
fn warnings(model: &ReplayModel) -> Vec<(ThemeRole, String)> {
    let mut lines = Vec::new();
    // The header names the only part of a recording, and its failures have a pane.
    let only = model.timeline.recording().rerun();
    match (film(model), only) {
        (_, Some(film)) if !film.why.is_empty() => lines.push((ThemeRole::Unknown, film.why.clone())),
        (Some(film), None) => {
            lines.push((ThemeRole::Unknown, recorded_part(&film.title, &film.why)));
            let passed = film.failures.iter().rfind(|failure| failure.at_ms <= model.cursor.at_ms);
            lines.extend(passed.map(|failure| (ThemeRole::Bad, failure.text.clone())));
        }
        (_, Some(_)) | (None, None) => {}
    }
    if let Some((from_ms, to_ms)) = model.timeline.gap_ms(model.cursor) {
        let stretch = wording::stretch(&secs(from_ms), &secs(to_ms));
        lines.push((
            ThemeRole::Unknown,
            if model.timeline.version_status(model.cursor).is_offline() {
                wording::no_frames_evaluated_apart(&stretch)
            } else {
                wording::no_frames(&stretch)
            },
        ));
    }
    if let Some(age_ms) = model.frame_age_ms().filter(|age_ms| *age_ms > FRESH_MS) {
        lines.push((ThemeRole::Stale, wording::frame_is_earlier(&secs(age_ms))));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ages_are_shown_in_tenths() {
        assert_eq!((secs(1_549), secs(62_000)), ("1.5 s".to_owned(), "62.0 s".to_owned()));
    }
}
