//! A filmed re-run: the candidate at the left, the compared version at the right, at the same moment of the same
//! episode; below, speed and force with the guard's limits.
//!
//! ```text
//! episode 17 of 120, seed 10016  it passes a limit, the active version does not      1x  3.2 of 7.0 s
//! ─ Candidate grasp@1.1.0 ──────────────── │ ─ Active grasp@1.0.0 ────────────────
//!  ▸ it passes a limit, does not do … 7.0 s │   does the task, 4.1 s
//!    (arm)                                  │   (arm)
//! speed, m/s                                │ speed, m/s
//! ──────────────✖──────│───────
//! ```

use ratatui::layout::Rect;

use super::robot;
use crate::look::{Glyph, ThemeRole};
use crate::model::FilmScreen;
use crate::player::Player;
use crate::widgets::dots::{ACROSS, DOWN, Dots, Ink};
use crate::widgets::pen::{Fit, Pen, above, below, cut};
use crate::widgets::row::{Row, wrap};
use holdpoint_body::TICK_SECS;
use holdpoint_protocol::film::{FilmFrame, FilmedRun};
use holdpoint_protocol::video_frame::VideoFrame;
use holdpoint_wording::console::film as wording;
use holdpoint_wording::film::title;

/// Lines from which the charts of speed and force have a place.
const CHARTS_HEIGHT_MIN: u16 = 16;

/// Draws it in place of the view.
pub fn draw(watched: &FilmScreen, pen: &mut Pen<'_>, area: Rect) {
    pen.clear(area);
    let player = &watched.player;
    let taken = head(player, pen, area);
    let area = below(area, taken);
    let (runs, foot) = cut(area, area.height.saturating_sub(1));
    timeline(player, pen, foot);
    let (left, right) = pen.split(runs, runs.width / 2);
    run(player, true, pen, left);
    run(player, false, pen, right);
}

/// The episode, the reason for its choice, and its differences from the judged run.
fn head(player: &Player, pen: &mut Pen<'_>, area: Rect) -> u16 {
    let film = &player.film;
    let secs = |tick: u64| tick as f64 * TICK_SECS;
    let state = if player.runs() { player.speed.label() } else { "stands".to_owned() };
    let place = format!("{state}  {:.1} of {:.1} s", secs(player.tick()), secs(film.end()));
    let place = Row::of(ThemeRole::Muted, &place);
    let width = usize::from(area.width);
    let mut row = Row::of(ThemeRole::Title, &super::short(&title(film), width));
    let room = width.saturating_sub(row.width() + place.width() + 4);
    if !film.why.is_empty() && room > 10 {
        row.push(ThemeRole::Text, &format!("  {}", super::short(&film.why, room)));
    }
    pen.row(area, 0, &row.to_column(width.saturating_sub(place.width())).and(place));
    let mut height = 1;
    let unlike = [&film.candidate, &film.active].into_iter().any(|run| run.as_recorded == Some(false));
    let unlike = unlike.then(|| wording::DIFFERS_FROM_THE_RECORD.to_owned());
    for warning in film.doubts.iter().chain(&unlike) {
        let text = format!("{} {warning}", pen.look.glyph(Glyph::Warning));
        height += pen.text(area, height, ThemeRole::Warning, &text);
    }
    height
}

fn run(player: &Player, own: bool, pen: &mut Pen<'_>, area: Rect) {
    let film = &player.film;
    let (run, name) = if own { (&film.candidate, "Candidate") } else { (&film.active, "Active") };
    let checked = match run.as_recorded {
        Some(true) => "as recorded",
        Some(false) => wording::NOT_AS_RECORDED,
        None => "",
    };
    let inside = pen.pane(area, &format!("{name} {}", run.version), own, checked);
    let Some(frame) = run.frame_at(player.tick()) else {
        pen.text(inside, 0, ThemeRole::Unknown, &wording::no_frame(&run.ended));
        return;
    };
    let taken = draw_summary(player, run, pen, inside);
    let inside = below(inside, taken);
    let charts = if inside.height >= CHARTS_HEIGHT_MIN { inside.height / 3 } else { 0 };
    let (scene, charts) = cut(inside, inside.height - charts);
    // The arm of the cell has no part in it.
    let stopped = frame.stopped.then(|| Row::of(ThemeRole::Warning, wording::STOPPED_IN_IT));
    robot::draw_frame(&video_frame(run, frame), &film.scenery, stopped.into_iter().collect(), pen, scene);
    if charts.height == 0 {
        return;
    }
    let (speed, force) = cut(charts, charts.height / 2);
    let limits = run.envelope;
    FilmChart { name: "speed, m/s", limit: limits.speed_m_s, of: |frame| frame.speed_m_s }
        .draw(player, run, pen, speed);
    FilmChart { name: "grip, N", limit: limits.force_n, of: |frame| frame.grip_n }
        .draw(player, run, pen, force);
}

/// The outcome, and the last event.
fn draw_summary(player: &Player, run: &FilmedRun, pen: &mut Pen<'_>, area: Rect) -> u16 {
    let lines_max = if pen.fit >= Fit::Two { 2 } else { 1 };
    let (glyph, role) = sign(run);
    let width = usize::from(area.width);
    let lines = |glyph: Glyph, run: &FilmedRun| {
        wrap(&format!("{} {}", pen.look.glyph(glyph), run.ended), width, lines_max)
    };
    let own = lines(glyph, run);
    // Both frames begin on one line, so that they can be compared.
    let film = &player.film;
    let most = [&film.candidate, &film.active].map(|run| lines(glyph, run).len()).into_iter().max();
    let mut rows: Vec<Row> = own.iter().map(|line| Row::of(role, line)).collect();
    rows.resize(most.unwrap_or(rows.len()).max(rows.len()), Row::new());
    let last = run.marks.iter().rfind(|mark| mark.tick <= player.tick());
    rows.push(last.map_or_else(Row::new, |mark| {
        let at = mark.tick as f64 * TICK_SECS;
        let role = if mark.bad { ThemeRole::Warning } else { ThemeRole::Muted };
        Row::of(role, &super::short(&format!("{at:.1} s: {}", mark.text), usize::from(area.width)))
    }));
    pen.rows(area, 0, &rows)
}

/// The sign of a result. What speaks against a version without a failure is a warning.
fn sign(run: &FilmedRun) -> (Glyph, ThemeRole) {
    match (run.failed, run.failed_at()) {
        (true, _) => (Glyph::Bad, ThemeRole::Bad),
        (false, Some(_)) => (Glyph::Warning, ThemeRole::Warning),
        (false, None) => (Glyph::Good, ThemeRole::Good),
    }
}

fn video_frame(run: &FilmedRun, frame: &FilmFrame) -> VideoFrame {
    VideoFrame {
        sequence: 0,
        at_ms: 0,
        at_secs: frame.tick as f64 * TICK_SECS,
        task: None,
        version: Some(run.version.clone()),
        body: frame.body.clone(),
        speed_m_s: frame.speed_m_s,
        force_n: frame.grip_n,
        contact_n: frame.contact_n,
        envelope: Some(run.envelope),
        contacts: Vec::new(),
        blocks: run.blocks.clone(),
        unexpected_contact: frame.touched,
        stopped: false,
        twin: None,
    }
}

/// A measured quantity over the whole film, with the guard's limit and the cursor.
struct FilmChart {
    name: &'static str,
    limit: f32,
    of: fn(&FilmFrame) -> f32,
}

impl FilmChart {
    fn draw(&self, player: &Player, run: &FilmedRun, pen: &mut Pen<'_>, area: Rect) {
        let (end, of) = (player.film.end().max(1), self.of);
        let now = run.frame_at(player.tick()).map_or(0.0, of);
        let past = now > self.limit;
        let role = if past { ThemeRole::Past } else { ThemeRole::Value };
        let row = Row::of(ThemeRole::Muted, self.name)
            .with(role, &format!("  {now:.2}"))
            .with(ThemeRole::Limit, &format!(", at most {:.2}", self.limit));
        pen.row(area, 0, &row);
        let plot = below(area, 1).intersection(pen.buf.area);
        if plot.is_empty() {
            return;
        }
        let top =
            run.frames.iter().map(of).filter(|value| value.is_finite()).fold(self.limit, f32::max) * 1.1;
        let (across, down) = (usize::from(plot.width) * ACROSS, usize::from(plot.height) * DOWN);
        let x = |tick: u64| scaled_dots(tick as f64 / end as f64, across);
        let y = |value: f32| scaled_dots(1.0 - f64::from(value / top.max(f32::MIN_POSITIVE)), down);
        let limit = u16::try_from(y(self.limit)).unwrap_or(0) / 4;
        for column in plot.left()..plot.right() {
            let line = if pen.look.ascii() { "-" } else { "╌" };
            pen.cell(column, plot.y + limit.min(plot.height - 1), line, ThemeRole::Limit);
        }
        let mut dots = Dots::new(plot);
        let mut before: Option<(i64, i64)> = None;
        for frame in run.frames.iter().filter(|frame| of(frame).is_finite()) {
            let value = of(frame);
            let role = match (value > self.limit, frame.tick <= player.tick()) {
                (true, _) => ThemeRole::Past,
                (false, true) => ThemeRole::Value,
                (false, false) => ThemeRole::Muted,
            };
            let ascii = if value > self.limit { "X" } else { "*" };
            let at = (x(frame.tick), y(value));
            dots.line(before.unwrap_or(at), at, Ink { role, ascii, dashed: false });
            before = Some(at);
        }
        dots.draw(pen, plot);
        let column = u16::try_from(x(player.tick())).unwrap_or(0) / 2;
        let column = plot.x + column.min(plot.width - 1);
        pen.lay(Rect { x: column, width: 1, ..plot }, ThemeRole::Focus);
    }
}

#[allow(clippy::cast_possible_truncation, reason = "a share of the dots of a screen")]
fn scaled_dots(of: f64, dots: usize) -> i64 {
    (of.clamp(0.0, 1.0) * dots.saturating_sub(1) as f64).round() as i64
}

/// The whole film in one line: the position, and what happened to the candidate.
fn timeline(player: &Player, pen: &mut Pen<'_>, area: Rect) {
    let area = above(area, 1);
    if area.is_empty() {
        return;
    }
    let end = player.film.end().max(1) as f64;
    let place = |tick: u64| {
        let column = scaled_dots(tick as f64 / end, usize::from(area.width));
        area.x + u16::try_from(column).unwrap_or(0).min(area.width - 1)
    };
    let line = pen.look.glyph(Glyph::Horizontal);
    let full = pen.look.glyph(Glyph::Full);
    let here = place(player.tick());
    for column in area.left()..area.right() {
        let role = if column <= here { ThemeRole::Value } else { ThemeRole::Rule };
        pen.cell(column, area.y, line, role);
    }
    let mut marks: Vec<(bool, u64)> =
        player.film.candidate.marks.iter().map(|mark| (mark.bad, mark.tick)).collect();
    // The most serious of those that share a column is drawn last.
    marks.sort_unstable();
    for (bad, tick) in marks {
        let (glyph, role) =
            if bad { (Glyph::Bad, ThemeRole::Bad) } else { (Glyph::Neutral, ThemeRole::Muted) };
        let glyph = pen.look.glyph(glyph);
        pen.cell(place(tick), area.y, glyph, role);
    }
    pen.cell(here, area.y, full, ThemeRole::Focus);
}
