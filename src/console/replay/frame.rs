//! The whole screen of a replay: its parts at each size, and their places.
//!
//! ```text
//! header     the recording and its outcome; state, playing, time
//! robot      │ charts
//! events
//! time bar   marks, frames, the cursor
//! hints      keys, answer, or typed text
//! ```

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;

use super::model::ReplayModel;
use super::views::{bar, charts, events, header, help, hints, robot, small_window};
use crate::look::Look;
use crate::widgets::pen::{Fit, Pen, above, below, cut};

/// Lines of the header.
const HEAD: u16 = 2;

/// Lines of the time bar and the hints.
const FOOT: u16 = 3;

/// Draws everything into `area`, which may have any size.
pub fn draw(model: &ReplayModel, look: &Look, area: Rect, buf: &mut Buffer) {
    let area = area.intersection(buf.area);
    if area.is_empty() {
        return;
    }
    let mut pen = Pen::new(look, buf, Fit::of(area.width, area.height));
    pen.clear(area);
    if pen.fit == Fit::Tiny {
        small_window::draw(model, &mut pen, area);
    } else {
        header::draw(model, &mut pen, above(area, HEAD));
        let (body, foot) = cut(below(area, HEAD), area.height - HEAD - FOOT);
        self::body(model, &mut pen, body);
        bar::draw(model, &mut pen, above(foot, FOOT - 1));
        hints::draw(model, &mut pen, below(foot, FOOT - 1));
    }
    if let Some(first) = model.help {
        // The line with the keys that leave stays in sight.
        help::draw(first, &mut pen, above(area, area.height - u16::from(area.height > 1)));
    }
}

/// Robot and charts beside each other over the events.
fn body(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let lower = match pen.fit {
        Fit::Tiny | Fit::One => 1,
        Fit::Two => area.height * 2 / 5,
        Fit::Full => (area.height / 3).max(8),
    };
    let (upper, lower) = cut(area, area.height.saturating_sub(lower));
    // Below 30 columns only the side view is drawn, and larger.
    let left = if pen.fit <= Fit::One { 29 } else { upper.width * 5 / 9 };
    let (left, right) = pen.split(upper, left);
    robot::draw(model, pen, left);
    charts::draw(model, pen, right);
    events::draw(model, pen, lower);
}
