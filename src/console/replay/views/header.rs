//! The recording and its outcome; below, the state at the cursor, the playing, and the time.
//!
//! ```text
//!  REPLAY   ◇ SIM  arm-1  place@1.1.0 against place@1.0.0  seed 42                    ended: ✖ rejected
//! ✖ rolled back  ✖ went wrong at 851.0 s                           ‖ paused  1x  761.0 s  tick 182640
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
use holdpoint_wording::console::replay as wording;

/// Columns that the note about the failure needs at least.
const NOTE_WIDTH_MIN: usize = 28;

/// The widest result of a re-run, columns.
const RESULT_WIDTH_MAX: usize = 36;

pub fn draw(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let width = usize::from(area.width);
    let top = justify(vec![badge(), subject(model)], asides(model, pen), outcome(model, pen), width);
    pen.row(area, 0, &top);
    let when = playing(model, pen).and(time(model, true));
    let status =
        if model.timeline.recording().rerun().is_some() { Row::new() } else { version_status(model, pen) };
    let when = if status.width() + when.width() < width {
        when
    } else {
        playing(model, pen).and(time(model, false))
    };
    let room = width.saturating_sub(status.width() + when.width() + 1);
    let failure = went_wrong(model, pen, room);
    pen.row(area, 1, &justify(vec![status, failure], Vec::new(), when, width));
}

/// Where it went wrong, in at most `room` columns; empty if it did not, or without room for the time.
fn went_wrong(model: &ReplayModel, pen: &Pen<'_>, room: usize) -> Row {
    let (lead, rerun) = match model.timeline.recording().rerun() {
        Some(film) => ("", Some(film)),
        None => ("  ", None),
    };
    let (role, glyph, text) = match (model.timeline.went_wrong(model.cursor.at_ms), rerun) {
        (Some((at_ms, "")), _) => (ThemeRole::Bad, Glyph::Bad, wording::went_wrong_at(&secs(at_ms))),
        (Some((at_ms, text)), _) => {
            (ThemeRole::Bad, Glyph::Bad, wording::went_wrong_with(&secs(at_ms), text))
        }
        (None, Some(film)) if !film.ended.is_empty() => {
            (ThemeRole::Good, Glyph::Good, wording::NOTHING_WRONG.to_owned())
        }
        (None, _) => return Row::new(),
    };
    let text = format!("{lead}{} {text}", pen.look.glyph(glyph));
    if room < NOTE_WIDTH_MIN { Row::new() } else { Row::of(role, &short(&text, room)) }
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
    if let Some(film) = recording.rerun() {
        rows.push(Row::of(ThemeRole::Text, &format!("  {}", short(&film.title, 60))));
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
    if let Some(film) = model.timeline.recording().rerun() {
        let (glyph, role, ended) = match (film.ended.as_str(), film.failures.as_slice()) {
            ("", _) => (Glyph::Unknown, ThemeRole::Unknown, "re-run"),
            (ended, []) => (Glyph::Good, ThemeRole::Good, ended),
            (ended, _) => (Glyph::Bad, ThemeRole::Bad, ended),
        };
        return Row::of(role, &format!("{} {}", pen.look.glyph(glyph), short(ended, RESULT_WIDTH_MAX)));
    }
    match &model.timeline.recording().outcome {
        Some(outcome) => {
            let (glyph, role) =
                outcome.known().map_or((Glyph::Unknown, ThemeRole::Unknown), |end| of_end(*end));
            Row::of(ThemeRole::Muted, "ended: ")
                .with(role, &format!("{} {}", pen.look.glyph(glyph), short(&outcome.to_string(), 24)))
        }
        None => Row::of(ThemeRole::Unknown, &wording::not_closed(pen.look.glyph(Glyph::Unknown))),
    }
}

/// The state of the version at the cursor: sign, word, and place in the pipeline.
fn version_status(model: &ReplayModel, pen: &Pen<'_>) -> Row {
    let status = model.timeline.version_status(model.cursor);
    let Some(state) = status.state else {
        return Row::of(ThemeRole::Unknown, &wording::state_not_recorded(pen.look.glyph(Glyph::Unknown)));
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
