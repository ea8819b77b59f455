//! The recording and its outcome; below, the state at the cursor, the playing, and the time.
//!
//! ```text
//!  REPLAY   ◇ SIM  arm-1  place@1.1.0 against place@1.0.0  seed 42                    ended: ✖ rejected
//! ◌ running  sandboxed, in shadow                                  ‖ paused  1x  761.0 s  tick 182640
//! ```

use ratatui::layout::Rect;

use super::secs;
use crate::formatters;
use crate::look::{Glyph, ThemeRole};
use crate::replay::model::ReplayModel;
use crate::theme::StateMark;
use crate::theme::state_mark::of_end;
use crate::views::short;
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;
use holdpoint_protocol::clock::tick_of;

pub fn draw(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let width = usize::from(area.width);
    let top = justify(vec![badge(), subject(model)], asides(model, pen), outcome(model, pen), width);
    pen.row(area, 0, &top);
    let when = playing(model, pen).and(time(model, true));
    let status = version_status(model, pen);
    let when = if status.width() + when.width() < width {
        when
    } else {
        playing(model, pen).and(time(model, false))
    };
    pen.row(area, 1, &justify(vec![status], Vec::new(), when, width));
}

/// Joins what must appear at the left, what appears if there is room, and the right end.
fn justify(must: Vec<Row>, helps: Vec<Row>, right: Row, width: usize) -> Row {
    let mut row = must.into_iter().fold(Row::new(), Row::and);
    for piece in helps {
        if row.width() + piece.width() + right.width() + 2 <= width {
            row = row.and(piece);
        }
    }
    if row.width() + 1 + right.width() <= width {
        row = row.to_column(width - right.width()).and(right);
    }
    row
}

/// The word that distinguishes a replay from the live cell.
#[must_use]
pub fn badge() -> Row {
    Row::of(ThemeRole::ReadOnly, " REPLAY ").with(ThemeRole::Text, " ")
}

fn subject(model: &ReplayModel) -> Row {
    Row::of(ThemeRole::Title, &model.timeline.recording().about.version.to_string())
}

/// More about the recording, the most important first.
fn asides(model: &ReplayModel, pen: &Pen<'_>) -> Vec<Row> {
    let recording = model.timeline.recording();
    let about = &recording.about;
    let mut rows = Vec::new();
    if let Some(predecessor) = &about.predecessor {
        rows.push(Row::of(ThemeRole::Text, &format!(" against {predecessor}")));
    }
    let (frames, events) = recording.dropped;
    let lost = dropped_summary(frames, events);
    if !lost.is_empty() {
        rows.push(Row::of(ThemeRole::Warning, &format!("  {} {lost}", pen.look.glyph(Glyph::Warning))));
    }
    let profile = about.profile.known().map_or(StateMark::NO_PROFILE, |profile| StateMark::profile(*profile));
    rows.push(Row::of(ThemeRole::Text, "  ").with(profile.role, &pen.look.mark_label(profile)));
    rows.push(Row::of(ThemeRole::Text, &format!("  {}", short(&about.robot, 24))));
    rows.push(Row::of(ThemeRole::Muted, &format!("  {}", holdpoint_wording::seeds::named(about.seed))));
    rows
}

/// The number of dropped records; empty if there are none.
fn dropped_summary(frames: u64, events: u64) -> String {
    let counted = [(frames, "frames"), (events, "events")];
    let lost: Vec<String> = counted
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{count} {what}"))
        .collect();
    if lost.is_empty() { String::new() } else { format!("{} dropped", lost.join(" and ")) }
}

fn outcome(model: &ReplayModel, pen: &Pen<'_>) -> Row {
    match &model.timeline.recording().outcome {
        Some(outcome) => {
            let (glyph, role) =
                outcome.known().map_or((Glyph::Unknown, ThemeRole::Unknown), |end| of_end(*end));
            Row::of(ThemeRole::Muted, "ended: ")
                .with(role, &format!("{} {}", pen.look.glyph(glyph), short(&outcome.to_string(), 24)))
        }
        None => Row::of(ThemeRole::Unknown, &format!("{} not closed", pen.look.glyph(Glyph::Unknown))),
    }
}

/// The state of the version at the cursor: sign, word, and place in the pipeline.
fn version_status(model: &ReplayModel, pen: &Pen<'_>) -> Row {
    let status = model.timeline.version_status(model.cursor);
    let Some(state) = status.state else {
        return Row::of(
            ThemeRole::Unknown,
            &format!("{} state not recorded yet", pen.look.glyph(Glyph::Unknown)),
        );
    };
    let mark = StateMark::version(state, &status.flags);
    let row = Row::of(mark.role, &pen.look.mark_label(mark));
    let label = formatters::state_label(state, &status.flags);
    // If the state's label equals the mark's label, the header shows it once.
    if label.replace('-', " ") == mark.label { row } else { row.with(ThemeRole::Text, &format!("  {label}")) }
}

/// Whether it plays, and how fast.
#[must_use]
pub fn playing(model: &ReplayModel, pen: &Pen<'_>) -> Row {
    let (glyph, label, role) = if model.playing {
        (Glyph::Here, "playing", ThemeRole::Running)
    } else {
        (Glyph::Paused, "paused", ThemeRole::Held)
    };
    Row::of(role, &format!("{} {label}", pen.look.glyph(glyph)))
        .with(ThemeRole::Text, &format!(" {}", model.speed.label()))
}

fn time(model: &ReplayModel, with_tick: bool) -> Row {
    let row = Row::of(ThemeRole::Title, &format!("  {}", secs(model.cursor.at_ms)));
    if with_tick {
        row.with(ThemeRole::Muted, &format!("  tick {}", tick_of(model.cursor.at_ms)))
    } else {
        row
    }
}
