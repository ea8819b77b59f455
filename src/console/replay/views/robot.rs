//! The arm and the twin at the cursor: the last picture that was kept, its age if it is old.
//!
//! ```text
//! ─ Robot ──────────────────── sequence 211, 3.4 s ─
//! ◷ picture of 1.5 s earlier
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

pub fn draw(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let picture = model.cursor.picture.and_then(|picture| model.timeline.picture(picture));
    let place = picture
        .map(|picture| match film(model) {
            Some(_) => format!("worked again, {:.1} s", picture.at_secs),
            None => format!("sequence {}, {:.1} s", picture.sequence, picture.at_secs),
        })
        .unwrap_or_default();
    let inside = pen.pane(area, "Robot", false, &place);
    draw_inside(model, pen, inside);
}

/// Draws the pane's inside, which may have any size.
pub fn draw_inside(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let doubts = doubts(model);
    let mut taken = 0;
    for (role, text) in &doubts {
        let text = format!("{} {text}", pen.look.glyph(Glyph::Waiting));
        taken += pen.text(area, taken, *role, &text);
    }
    let Some(picture) = model.cursor.picture.and_then(|picture| model.timeline.picture(picture)) else {
        return;
    };
    let area = below(area, taken);
    if area.height == 0 {
        return;
    }
    robot::draw_picture(picture, &model.timeline.recording().scenery, Vec::new(), pen, area);
    // What is long past is not drawn as if it were now.
    if model.timeline.gap_ms(model.cursor).is_some() {
        pen.lay(area, ThemeRole::Muted);
    }
}

/// The piece of an evaluation that the picture shown is of; `None` for one of the live cell. It is the picture's time that
/// says so: the last one stands there until another follows, and nobody may take it for what the live arm did.
fn film(model: &ReplayModel) -> Option<&FilmSpan> {
    let at_ms = model.timeline.picture(model.cursor.picture?)?.at_ms;
    let films = &model.timeline.recording().films;
    films.iter().find(|film| (film.from_ms..=film.until_ms).contains(&at_ms))
}

/// What must be known about the picture before it is looked at.
fn doubts(model: &ReplayModel) -> Vec<(ThemeRole, String)> {
    let mut said = Vec::new();
    if let Some(film) = film(model) {
        said.push((ThemeRole::Unknown, film.sentence()));
    }
    if let Some((from_ms, to_ms)) = model.timeline.gap_ms(model.cursor) {
        let stretch = format!("from {} to {}", secs(from_ms), secs(to_ms));
        said.push((
            ThemeRole::Unknown,
            if model.timeline.standing(model.cursor).is_apart() {
                format!("no pictures {stretch}: the candidate is evaluated apart from the live cell")
            } else {
                format!("no pictures {stretch}")
            },
        ));
    }
    if let Some(age_ms) = model.picture_age_ms().filter(|age_ms| *age_ms > FRESH_MS) {
        said.push((ThemeRole::Stale, format!("picture of {} earlier", secs(age_ms))));
    }
    said
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ages_are_said_in_tenths() {
        assert_eq!((secs(1_549), secs(62_000)), ("1.5 s".to_owned(), "62.0 s".to_owned()));
    }
}
