//! Windows below 60 x 16: recording, time, last event and the keys that leave; the arm if there is room.
//!
//! ```text
//! REPLAY place@1.1.0
//! ‖ paused 1x  761.0 s
//! ✖ 761.0 decide place@1.1.0 …
//! q leaves  space plays
//! ```

use ratatui::layout::Rect;

use super::{bar, events, header, hints, robot, secs};
use crate::look::ThemeRole;
use crate::replay::model::ReplayModel;
use crate::widgets::pen::{Pen, above, below, cut};
use crate::widgets::row::Row;

/// Lines from which the arm is drawn.
const ROBOT_HEIGHT_MIN: u16 = 9;

pub fn draw(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let version = model.timeline.recording().about.version.to_string();
    let time = Row::of(ThemeRole::Title, &format!(" {}", secs(model.cursor.at_ms)));
    let head = header::badge().with(ThemeRole::Title, &version);
    let state = header::playing(model, pen).and(time.clone());
    let event = events::here(model, pen.look);
    match area.height {
        0 => {}
        1 => pen.row(area, 0, &header::badge().and(time)),
        2 => {
            pen.row(area, 0, &header::badge().and(time));
            foot(model, pen, below(area, 1));
        }
        3..ROBOT_HEIGHT_MIN => {
            pen.rows(area, 0, &[head, state, event]);
            foot(model, pen, below(area, area.height - 1));
        }
        _ => {
            pen.rows(area, 0, &[head, state]);
            let (body, rest) = cut(below(area, 2), area.height - 6);
            robot::draw_inside(model, pen, body);
            pen.row(rest, 0, &event);
            bar::draw(model, pen, above(below(rest, 1), 2));
            foot(model, pen, below(rest, 3));
        }
    }
}

fn foot(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    if model.typing.is_some() || model.notice.is_some() {
        hints::draw(model, pen, area);
        return;
    }
    let plays = if model.playing { " pauses" } else { " plays" };
    let row = Row::of(ThemeRole::Key, "q")
        .with(ThemeRole::Text, " leaves  ")
        .with(ThemeRole::Key, "space")
        .with(ThemeRole::Text, plays)
        .with(ThemeRole::Key, "  ?")
        .with(ThemeRole::Text, " keys");
    pen.row(area, 0, &row);
}
