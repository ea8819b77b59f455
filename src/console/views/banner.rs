//! The first line: on which profile and robot is this, who sits here, and how far what is shown can be trusted.
//!
//! ```text
//!  ◇ SIM   arm-1 · seed 42 · operator ada (operator)          READ-ONLY  HOLDING paused  STALE 12 s  00:12:41
//! ```

use ratatui::layout::Rect;

use crate::look::{Glyph, ThemeRole};
use crate::model::{EngineLink, EngineState, Model};
use crate::theme::Mark;
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;
use crate::words::{duration, seconds};
use holdpoint_governance::calendar;

/// From so many columns on the views' line says who else is here.
pub const OTHERS_NAMED_FROM: u16 = 100;

/// Draws it. What was not known to be well stands first and is never cut off before what merely helps.
pub fn draw(model: &Model, pen: &mut Pen<'_>, area: Rect) {
    let width = usize::from(area.width);
    let mut row = profile(model, pen).and(doubts(model, pen, width));
    let identity = identity(model);
    // Without an engine there is no time of its own.
    let clock = match model.absence() {
        Some(_) => Row::new(),
        None => Row::of(ThemeRole::Muted, &format!(" {}", seconds(model.engine_ms()))),
    };
    let clocks = clocks(model);
    for piece in identity {
        if row.width() + piece.width() + clock.width() <= width {
            row = row.and(piece);
        }
    }
    // The engine's own clock always; the machine's and the pace in as many words as there is room for.
    let room = width.saturating_sub(row.width() + clock.width());
    let more = clocks.into_iter().find(|more| more.width() <= room).unwrap_or_default();
    let clock = more.and(clock);
    if row.width() + clock.width() <= width {
        row = row.to_column(width - clock.width()).and(clock);
    }
    pen.row(area, 0, &row);
}

fn profile(model: &Model, pen: &Pen<'_>) -> Row {
    let Some(snapshot) = &model.told.snapshot else {
        return Row::of(ThemeRole::Title, " Holdpoint ");
    };
    let mark = Mark::profile(snapshot.profile);
    let site = snapshot
        .site
        .as_ref()
        .map_or_else(String::new, |site| format!(" {}", super::short(site.as_str(), 24)));
    Row::of(mark.role, &format!(" {} ", pen.look.words(mark)))
        .with(ThemeRole::Title, &site)
        .with(ThemeRole::Title, &format!(" {} ", super::short(&snapshot.robot, 24)))
}

/// Whatever makes the screen less than it seems.
fn doubts(model: &Model, pen: &Pen<'_>, width: usize) -> Row {
    let mut row = Row::new();
    let mut say = |role: ThemeRole, text: &str| {
        row.push(ThemeRole::Text, " ");
        row.push(role, text);
    };
    if let Some(doubt) = model.told.doubt.filter(|_| !matches!(model.told.engine, EngineState::Ended(_))) {
        say(ThemeRole::Problem, doubt.short());
    }
    if model.settings.read_only {
        say(ThemeRole::ReadOnly, " READ-ONLY ");
    }
    match &model.told.engine {
        EngineState::Starting => {
            say(ThemeRole::Running, &format!("{} starting", pen.look.glyph(Glyph::Running)));
        }
        EngineState::Running => {}
        EngineState::Ended(Ok(())) => say(ThemeRole::Problem, "ENGINE ENDED"),
        EngineState::Ended(Err(why)) if why.in_use => {
            say(
                ThemeRole::Problem,
                &format!("NO ENGINE HERE: another one holds the store{}", seeking(model)),
            );
        }
        EngineState::Ended(Err(why)) if why.orderly => {
            say(ThemeRole::Stale, &format!("ENGINE ENDED{}: {why}", seeking(model)));
        }
        EngineState::Ended(Err(why)) => {
            // Of one in another process that did not say why there is no more to say: when it was heard last says how old all of
            // this is.
            let unsaid = model.told.link == EngineLink::Attached && !why.told;
            let last = model.told.snapshot.as_ref().filter(|_| unsaid);
            let rest = match last {
                Some(last) => format!(", last heard {}", seconds(last.at_ms)),
                // How old all of this is stands behind it.
                None if why.told => format!(": {}", super::short(&why.to_string(), width / 3)),
                None => format!(": {why}"),
            };
            say(ThemeRole::Problem, &format!("ENGINE GONE{}{rest}", seeking(model)));
        }
    }
    if let Some(reading) = model.told.snapshot.as_ref().and_then(|snapshot| snapshot.reading) {
        say(ThemeRole::Stale, &format!("NOT VERIFIED YET {} of {} records", reading.read, reading.of));
    }
    if let Some(age_ms) = model.stale_ms() {
        say(ThemeRole::Stale, &format!("{} STALE {}", pen.look.glyph(Glyph::Waiting), duration(age_ms)));
    }
    if let Some(why) = model.told.snapshot.as_ref().and_then(|snapshot| snapshot.holding.as_deref()) {
        let why = super::short(why, width / 4);
        say(ThemeRole::Held, &format!("{} HOLDING {why}", pen.look.glyph(Glyph::Paused)));
    }
    if model.told.snapshot.as_ref().is_some_and(|snapshot| snapshot.unauthorized.is_some()) {
        say(ThemeRole::Held, &format!("{} PROFILE NOT AUTHORIZED", pen.look.glyph(Glyph::Paused)));
    }
    if model.told.snapshot.as_ref().is_some_and(|snapshot| snapshot.clock_doubt.is_some()) {
        say(ThemeRole::Held, &format!("{} TIME NOT CONFIRMED", pen.look.glyph(Glyph::Paused)));
    }
    // Until it is reviewed it is said on every screen, also where its alarm was acknowledged.
    for family in model.told.snapshot.iter().flat_map(|snapshot| &snapshot.families) {
        if let Some(review) = &family.review {
            let what = if review.overdue { "OVERDUE" } else { "UNREVIEWED" };
            say(ThemeRole::Problem, &format!("{what} {}", super::short(&review.version.to_string(), 24)));
        }
    }
    if let Some(frozen) = &model.place.frozen {
        let glyph = pen.look.glyph(Glyph::Paused);
        say(ThemeRole::Stale, &format!("{glyph} frozen since {}", seconds(frozen.at_ms)));
    }
    row
}

/// The machine's time and the pace of the live cell, in words that get shorter; nothing where the engine says no time.
fn clocks(model: &Model) -> Vec<Row> {
    let (Some(wall_ms), Some(snapshot)) = (model.wall_ms(), &model.told.snapshot) else { return Vec::new() };
    if model.absence().is_some() {
        return Vec::new();
    }
    let pace = snapshot.live.pace.map_or_else(|| "max".to_owned(), |times| format!("{times}x"));
    let secs = wall_ms.div_euclid(1_000);
    let time = format!("{:02}:{:02}:{:02}", secs / 3_600 % 24, secs / 60 % 60, secs % 60);
    let day = calendar::day(wall_ms);
    [format!("  {day} {time} UTC  pace {pace}  engine"), format!("  {time} UTC  pace {pace} ")]
        .map(|text| Row::of(ThemeRole::Muted, &text))
        .into()
}

/// How the search for an engine goes, where there is one; it stands before why it is needed.
fn seeking(model: &Model) -> String {
    match &model.told.seeking {
        Some(seeking) if seeking.tries < seeking.tries_max => {
            format!(" (looks again {}/{})", seeking.tries, seeking.tries_max)
        }
        Some(_) => " (no more looks: start `holdpoint` anew)".to_owned(),
        None => String::new(),
    }
}

/// Operator and seed, the weightiest first.
fn identity(model: &Model) -> Vec<Row> {
    let who = match &model.seat.operator {
        Some(who) => Row::of(ThemeRole::Text, &format!("  {} ({})", super::short(&who.name, 24), who.role)),
        None => Row::of(ThemeRole::Warning, "  nobody: `:as NAME`"),
    };
    let mut pieces = vec![who];
    // Where the views' line has no room for them, others are counted here.
    let others = model.told.others().count();
    if others > 0 && model.size.0 < OTHERS_NAMED_FROM {
        pieces.push(Row::of(ThemeRole::Text, &format!("  and {others} more")));
    }
    if let Some(snapshot) = &model.told.snapshot {
        pieces.push(Row::of(ThemeRole::Muted, &format!("  seed {}", snapshot.seed)));
    }
    pieces
}
