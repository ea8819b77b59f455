//! The first line: profile, robot, operator, and how far the shown data can be trusted.
//!
//! ```text
//!  ◇ SIM   arm-1 · seed 42 · operator ada (operator)          READ-ONLY  ENGINE HALTED …  STALE 12 s
//! ```

use std::path::Path;

use ratatui::layout::Rect;

use super::tabs;
use crate::formatters::{duration, seconds, time_of_day};
use crate::look::{Glyph, ThemeRole};
use crate::model::{ConsoleModel, EngineLink, EngineState};
use crate::theme::StateMark;
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;
use holdpoint_governance::calendar;
use holdpoint_wording::console::banner as wording;

/// The width from which the views' line names the other consoles.
pub const OTHERS_NAMED_FROM: u16 = 100;

/// Draws it. Warnings stand first and are never cut before merely helpful parts.
pub fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let width = usize::from(area.width);
    let mut row = profile(model, pen).and(warnings(model, pen, width));
    // A clock that no engine was heard to keep is not shown.
    let clock = if model.last_seen().is_some() || model.absence().is_some() {
        Row::new()
    } else {
        // The store's own time adds up every engine of it: only the time of this one is a sign of life.
        let up_since_ms = model.engine_data.snapshot.as_ref().and_then(|now| now.up_since_ms);
        let up_ms = model.engine_ms().saturating_sub(up_since_ms.unwrap_or_default());
        // Beside a time of day, the time of the engine reads as another one.
        Row::of(ThemeRole::Muted, &format!(" engine {}", seconds(up_ms)))
    };
    let clocks = clocks(model);
    for piece in identity(model, width.saturating_sub(row.width() + clock.width())) {
        if row.width() + piece.width() + clock.width() <= width {
            row = row.and(piece);
        }
    }
    // The engine's own clock always; the machine's and the pace in as many words as fit.
    let room = width.saturating_sub(row.width() + clock.width());
    let more = clocks.into_iter().find(|more| more.width() <= room).unwrap_or_default();
    let clock = more.and(clock);
    if row.width() + clock.width() <= width {
        row = row.to_column(width - clock.width()).and(clock);
    }
    pen.row(area, 0, &row);
}

fn profile(model: &ConsoleModel, pen: &Pen<'_>) -> Row {
    let Some(snapshot) = &model.engine_data.snapshot else {
        return Row::of(ThemeRole::Title, " Holdpoint ");
    };
    let mark = StateMark::profile(snapshot.profile);
    let site = snapshot
        .site
        .as_ref()
        .map_or_else(String::new, |site| format!(" {}", super::short(site.as_str(), 24)));
    Row::of(mark.role, &format!(" {} ", pen.look.mark_label(mark)))
        .with(ThemeRole::Title, &site)
        .with(ThemeRole::Title, &format!(" {} ", super::short(&snapshot.robot, 24)))
}

/// The warnings: everything that makes the screen less reliable.
fn warnings(model: &ConsoleModel, pen: &Pen<'_>, width: usize) -> Row {
    let mut row = Row::new();
    let mut say = |role: ThemeRole, text: &str| {
        row.push(ThemeRole::Text, " ");
        row.push(role, text);
    };
    if let Some(unverified) =
        model.engine_data.unverified.filter(|_| !matches!(model.engine_data.engine, EngineState::Ended(_)))
    {
        say(ThemeRole::Problem, unverified.short());
    }
    if model.settings.read_only {
        say(ThemeRole::ReadOnly, " READ-ONLY ");
    }
    match &model.engine_data.engine {
        EngineState::Starting => {
            say(ThemeRole::Running, &format!("{} starting", pen.look.glyph(Glyph::Running)));
        }
        EngineState::Running => {}
        EngineState::Ended(Ok(())) => say(ThemeRole::Problem, wording::ENGINE_ENDED),
        EngineState::Ended(Err(why)) if why.in_use => {
            say(ThemeRole::Problem, &wording::held_elsewhere(&seeking(model)));
        }
        EngineState::Ended(Err(why)) if why.orderly && model.engine_data.snapshot.is_none() => {
            say(ThemeRole::Stale, &wording::no_engine(&seeking(model), why));
        }
        EngineState::Ended(Err(why)) if why.orderly => {
            say(ThemeRole::Stale, &wording::engine_ended(&seeking(model), why));
        }
        EngineState::Ended(Err(why)) => {
            // An engine in another process that gave no reason: the age of its last data, which stands behind it, is enough.
            let unsaid =
                model.engine_data.link == EngineLink::Attached && model.engine_data.snapshot.is_some();
            let rest = if why.from_engine {
                format!(": {}", super::short(&why.to_string(), width / 3))
            } else if unsaid {
                String::new()
            } else {
                format!(": {why}")
            };
            say(ThemeRole::Problem, &wording::engine_gone(&seeking(model), &rest));
        }
    }
    if let Some(reading) = model.engine_data.snapshot.as_ref().and_then(|snapshot| snapshot.reading) {
        say(ThemeRole::Stale, &wording::not_verified_yet(reading.read, reading.of));
    }
    if let Some(age_ms) = model.stale_ms() {
        say(ThemeRole::Stale, &format!("{} STALE {}", pen.look.glyph(Glyph::Waiting), duration(age_ms)));
    }
    if let Some(seen) = model.last_seen() {
        say(ThemeRole::Stale, &wording::last_seen(&seen));
    }
    if let Some(why) = model.engine_data.snapshot.as_ref().and_then(|snapshot| snapshot.holding.as_deref()) {
        let why = super::short(why, width / 4);
        say(ThemeRole::Held, &wording::engine_halted(pen.look.glyph(Glyph::Paused), &why));
    }
    if model.engine_data.snapshot.as_ref().is_some_and(|snapshot| snapshot.unauthorized.is_some()) {
        say(ThemeRole::Held, &wording::not_authorized(pen.look.glyph(Glyph::Paused)));
    }
    if model.engine_data.snapshot.as_ref().is_some_and(|snapshot| snapshot.clock_doubt.is_some()) {
        say(ThemeRole::Held, &wording::time_not_confirmed(pen.look.glyph(Glyph::Paused)));
    }
    // An unreviewed break-glass activation is shown on every screen, even if its alarm is acknowledged.
    for family in model.engine_data.snapshot.iter().flat_map(|snapshot| &snapshot.families) {
        if let Some(review) = &family.review {
            let what = if review.overdue { "OVERDUE" } else { "UNREVIEWED" };
            say(ThemeRole::Problem, &format!("{what} {}", super::short(&review.version.to_string(), 24)));
        }
    }
    if let Some(frozen) = &model.view_state.frozen {
        let glyph = pen.look.glyph(Glyph::Paused);
        say(ThemeRole::Stale, &wording::frozen_since(glyph, &model.moment(frozen.at_ms)));
    }
    row
}

/// The machine's time and the pace of the live cell, in ever shorter words; empty if the engine reports no time.
fn clocks(model: &ConsoleModel) -> Vec<Row> {
    let (Some(wall_ms), Some(snapshot)) = (model.wall_ms(), &model.engine_data.snapshot) else {
        return Vec::new();
    };
    if model.last_seen().is_some() {
        return Vec::new();
    }
    let pace = snapshot.live.pace.map_or_else(|| "max".to_owned(), |times| format!("{times}x"));
    let time = time_of_day(wall_ms);
    let day = calendar::day(wall_ms);
    let shorter = format!("  {time} UTC  pace {pace} ");
    [format!("  {day} {time} UTC  pace {pace} "), shorter, format!("  {time} UTC ")]
        .map(|text| Row::of(ThemeRole::Muted, &text))
        .into()
}

/// The search for an engine, if there is one; it stands before the reason for it.
fn seeking(model: &ConsoleModel) -> String {
    match &model.engine_data.reconnect {
        Some(seeking) if seeking.tries < seeking.tries_max => {
            wording::looks_again(seeking.tries, seeking.tries_max)
        }
        Some(_) => wording::NO_MORE_LOOKS.to_owned(),
        None => String::new(),
    }
}

/// Operator, other consoles, seed and site file, the most important first. The other consoles get the longest words that fit
/// into `room` columns.
fn identity(model: &ConsoleModel, room: usize) -> Vec<Row> {
    let who = match &model.session.operator {
        Some(who) => Row::of(ThemeRole::Text, &format!("  {} ({})", super::short(&who.name, 24), who.role)),
        None => Row::of(ThemeRole::Warning, wording::NO_NAME),
    };
    let room = room.saturating_sub(who.width());
    let mut pieces = vec![who];
    // The line of the views has no room for them.
    if model.size.0 < OTHERS_NAMED_FROM {
        let others = tabs::other_consoles(model).into_iter();
        let mut others = others.map(|text| Row::of(ThemeRole::Text, &format!("  {text}")));
        pieces.extend(others.find(|others| others.width() <= room));
    }
    if let Some(snapshot) = &model.engine_data.snapshot {
        pieces.push(Row::of(
            ThemeRole::Muted,
            &format!("  {}", holdpoint_wording::seeds::named(snapshot.seed)),
        ));
        let file = snapshot.site_file.as_deref().map(Path::new).and_then(Path::file_name);
        pieces.extend(file.map(|file| {
            Row::of(ThemeRole::Muted, &format!("  site {}", super::short(&file.to_string_lossy(), 24)))
        }));
    }
    pieces
}
