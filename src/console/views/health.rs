//! View 8: the results of live tasks over hours and days, family by family, with the events beside them.
//!
//! ```text
//! [Success] Violations  Time  Force      18 h, a column is 15 min, UTC
//! ▸ grasp ────────────────────────────── done 94.0 % of 810 [92, 95] ─
//! 100 % ⣀⣀⣀⡠⠤⠒⠒⠤╎⡠⠤⠒                 a line: the rate; dots above and below
//!  80 %         P   ⠒⠤⣀             it: the ends of the interval of 95 %
//! marks         P      !
//!       08:00       12:00       16:00
//! 12:00 to 12:15, engine 04:00:00: grasp@1.1.0 30 of 34 done, 1 with a violation
//! P 12:03 promotion: grasp@1.1.0 took over
//! success of grasp since Tue 17 Nov 12:00: 88.2 % of 340, before 94.0 %…
//! ```

use std::collections::BTreeMap;

use ratatui::layout::Rect;

use super::console_view::{ConsoleView, ORDER_OF_TIME, ViewDescription};
use super::health_quantity::{HealthQuantity, LABEL_WIDTH};
use super::tabs;
use crate::action::{Action, Scope};
use crate::effect::{Effect, EngineQuery};
use crate::formatters::seconds;
use crate::look::{Glyph, ThemeRole};
use crate::model::{ConsoleModel, ItemKey};
use crate::trend::SCALE;
use crate::update::{health, navigation};
use crate::widgets::dots::{ACROSS, DOWN, Dots, Ink};
use crate::widgets::pen::{Fit, Pen, above, below, cut};
use crate::widgets::row::{Row, wrap};
use holdpoint_governance::calendar;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_protocol::health::{
    HealthClock, HealthMark, HealthPoint, HealthSeries, MarkKind, Trend, together,
};
use holdpoint_wording::console::health as wording;
use holdpoint_wording::console::shared;
use holdpoint_wording::health::mark_kind;

/// Lines of one family at least: its heading and two of dots.
const FAMILY_ROWS: u16 = 3;

/// Lines of one family at most.
const FAMILY_ROWS_MAX: u16 = 20;

/// The most lines below the charts: values, marks, verdict, omissions.
const BELOW_ROWS_MAX: u16 = 14;

/// The fewest lines for the events of the column under the cursor, if there is room.
const MARKS_LEAST: usize = 4;

/// Lines below the charts from which numbers stand beside marks, and from which they stand in full.
const NUMBERS_FROM: usize = 5;
const WHOLE_FROM: usize = 8;

/// Columns between two times at the axis at least.
const TIME_APART: u32 = 14;

/// View 8.
pub struct HealthBehavior;

impl ConsoleView for HealthBehavior {
    fn description(&self) -> &'static ViewDescription {
        &ViewDescription {
            title: "Health",
            brief_title: "Health",
            action: "health",
            keys: &["8"],
            help: wording::HELP,
            tour: wording::TOUR,
            panes: &["Success", "Violations", "Time", "Force"],
            scopes: &[Scope::Version, Scope::Charts],
            fixed_order: Some(ORDER_OF_TIME),
            queries_by_pane: false,
            is_about_version: false,
        }
    }

    fn row_count(&self, model: &ConsoleModel) -> usize {
        model.health_families().len()
    }

    fn item_key(&self, model: &ConsoleModel, row: usize) -> Option<ItemKey> {
        model.health_families().into_iter().nth(row).map(ItemKey::Family)
    }

    fn row_of(&self, model: &ConsoleModel, key: &ItemKey) -> Option<usize> {
        let ItemKey::Family(of) = key else { return None };
        model.health_families().iter().position(|family| family == of)
    }

    fn version_here(&self, model: &ConsoleModel) -> Option<CapabilityId> {
        model.health_version()
    }

    fn row_texts(&self, model: &ConsoleModel) -> Vec<String> {
        model.health_families().iter().map(ToString::to_string).collect()
    }

    fn hints(&self, _model: &ConsoleModel) -> &'static [Action] {
        &[
            Action::NextPane,
            Action::ZoomIn,
            Action::ZoomOut,
            Action::Left,
            Action::Right,
            Action::Export,
            Action::Freeze,
        ]
    }

    fn hint_label(&self, _model: &ConsoleModel, action: Action) -> Option<&'static str> {
        (action == Action::NextPane).then_some("next quantity")
    }

    fn can_open(&self, _model: &ConsoleModel, _rows: usize, _version: Option<&CapabilityId>) -> bool {
        false
    }

    fn copied(&self, model: &ConsoleModel) -> Option<String> {
        model.health_verdict().map(|verdict| holdpoint_wording::health::health_verdict(&verdict))
    }

    fn query(&self, model: &ConsoleModel) -> Option<EngineQuery> {
        Some(EngineQuery::Health(health::health_query(model)))
    }

    fn data(&self, model: &ConsoleModel) -> serde_json::Result<serde_json::Value> {
        serde_json::to_value(model.engine_data.health.as_ref().map(|(series, _)| &**series))
    }

    fn open(&self, model: &mut ConsoleModel) -> Vec<Effect> {
        navigation::choose(model)
    }

    /// The cursor goes one column to the left or to the right.
    fn sideways(&self, model: &mut ConsoleModel, right: bool) -> Vec<Effect> {
        health::step(model, right)
    }

    fn zoom(&self, model: &mut ConsoleModel, action: Action) -> Vec<Effect> {
        health::zoom(model, action)
    }

    fn draw(&self, model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
        draw(model, pen, area);
    }

    /// Without the tabs; the description gets a third of the room.
    fn draw_small(&self, model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
        let area = super::frozen(model, pen, area);
        let Some(series) = model.health() else {
            pen.row(area, 0, &Row::of(ThemeRole::Muted, shared::RECORD_IS_BEING_READ));
            return;
        };
        let quantity = HealthQuantity::of(model.view_state.pane());
        charts_pane(model, series, quantity, pen, area, area.height.div_ceil(3));
    }
}

fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let head = tabs::panes(model);
    let area = super::frozen(model, pen, area);
    let Some(series) = model.health() else {
        pen.row(area, 0, &head);
        pen.text(below(area, 1), 0, ThemeRole::Muted, shared::RECORD_IS_BEING_READ);
        return;
    };
    let quantity = HealthQuantity::of(model.view_state.pane());
    let room = usize::from(area.width).saturating_sub(head.width() + 2);
    let span = extent(series).into_iter().find(|text| text.chars().count() <= room).unwrap_or_default();
    let row = head.to_column(usize::from(area.width) - span.chars().count()).with(ThemeRole::Muted, &span);
    pen.row(area, 0, &row);
    let area = below(area, 1);
    charts_pane(model, series, quantity, pen, area, (area.height / 2).min(BELOW_ROWS_MAX));
}

/// Charts, marks and times, and below them a description of at most `foot` lines.
fn charts_pane(
    model: &ConsoleModel,
    series: &HealthSeries,
    quantity: HealthQuantity,
    pen: &mut Pen<'_>,
    area: Rect,
    foot_max: u16,
) {
    let below_it = under(model, series, usize::from(area.width), usize::from(foot_max));
    let families = model.health_families();
    let foot = u16::try_from(below_it.len()).unwrap_or(u16::MAX).min(foot_max);
    // Marks and times stand between charts and description. If hardly a chart fits beside them, the description comes
    // first.
    let between = area.height.saturating_sub(foot + 2).min(2);
    let (charts, rest) = cut(area, area.height.saturating_sub(foot + between));
    draw_families(model, series, quantity, &families, pen, charts);
    if between > 0 {
        marks_line(model, series, pen, above(rest, 1));
    }
    if between > 1 {
        axis(model, series, pen, above(below(rest, 1), 1));
    }
    pen.rows(below(rest, between), 0, &below_it);
}

/// The visible span, and the width of a column, in ever shorter words.
fn extent(series: &HealthSeries) -> [String; 2] {
    let clock = match series.clock {
        HealthClock::Wall => "UTC",
        HealthClock::Virtual => "engine's time",
    };
    let all = series.bucket_ms.saturating_mul(u64::from(series.buckets));
    let (all, each) = (span(all), span(series.bucket_ms));
    [wording::span(&all, &each, clock), format!("{all}, {each} a column, {clock}")]
}

fn span(ms: u64) -> String {
    let minutes = ms / 60_000;
    match minutes {
        0..60 => format!("{minutes} min"),
        60..1_440 if minutes.is_multiple_of(60) => format!("{} h", minutes / 60),
        60..1_440 => format!("{} h {} min", minutes / 60, minutes % 60),
        _ if minutes % 1_440 < 60 => format!("{} d", minutes / 1_440),
        _ => format!("{} d {} h", minutes / 1_440, minutes / 60 % 24),
    }
}

fn draw_families(
    model: &ConsoleModel,
    series: &HealthSeries,
    quantity: HealthQuantity,
    families: &[Family],
    pen: &mut Pen<'_>,
    area: Rect,
) {
    if series.points.is_empty() {
        let lines = wrap(wording::NO_LIVE_TASK, usize::from(area.width), usize::from(area.height));
        let rows: Vec<Row> = lines.iter().map(|line| Row::of(ThemeRole::Muted, line)).collect();
        pen.rows(area, 0, &rows);
        return;
    }
    let fit = usize::from(area.height / FAMILY_ROWS).clamp(1, families.len().max(1));
    let here = model.row().min(families.len().saturating_sub(1));
    // The family under the cursor is always visible.
    let first = here.saturating_sub(fit - 1).min(families.len() - fit.min(families.len()));
    let mut rest = area;
    for (shown, (place, family)) in families.iter().enumerate().skip(first).take(fit).enumerate() {
        let to_come = u16::try_from(fit - shown).unwrap_or(1).max(1);
        let (part, left) = cut(rest, (rest.height / to_come).min(FAMILY_ROWS_MAX));
        rest = left;
        let all = series.points.iter().filter(|point| point.version.family == *family);
        let right = match together(all) {
            Some((tasks, done, [low, high])) => {
                let share = 100.0 * done as f64 / tasks as f64;
                // For every quantity, this is the success rate.
                wording::done_share(share, tasks, 100.0 * low, 100.0 * high)
            }
            None => wording::NO_TASK.to_owned(),
        };
        // In the smallest windows the view's own title names the quantity.
        let title = if pen.fit == Fit::Tiny {
            family.to_string()
        } else {
            format!("{family}, {}", quantity.legend())
        };
        // A family out of sight must not look like one that is not there.
        let hidden = if shown + 1 == fit { families.len().saturating_sub(fit) } else { 0 };
        let title = if hidden > 0 { wording::and_hidden(&title, hidden) } else { title };
        let inside = pen.pane(part, &title, place == here, &right);
        chart(model, series, (quantity, family), pen, inside);
    }
}

/// One family's chart: a column a bucket.
#[allow(clippy::cast_possible_truncation, reason = "scaled to the area before")]
fn chart(
    model: &ConsoleModel,
    series: &HealthSeries,
    (quantity, family): (HealthQuantity, &Family),
    pen: &mut Pen<'_>,
    area: Rect,
) {
    if area.width <= SCALE || area.height == 0 {
        return;
    }
    let plot = Rect { x: area.x + SCALE, width: area.width - SCALE, ..area };
    let mut buckets: BTreeMap<u32, Vec<&HealthPoint>> = BTreeMap::new();
    for point in series.points.iter().filter(|point| point.version.family == *family) {
        buckets.entry(point.bucket).or_default().push(point);
    }
    let values: Vec<(u32, f64, [f64; 2])> = buckets
        .iter()
        .filter_map(|(bucket, points)| {
            let (value, band) = quantity.of_points(points)?;
            Some((column(series, *bucket, plot.width)?, value, band))
        })
        .collect();
    let (low, high) = range(quantity, &values);
    let bottom = f64::from(plot.height) * DOWN as f64 - 1.0;
    let y = |value: f64| (bottom - (value - low) / (high - low) * bottom).round().clamp(0.0, bottom) as i64;
    let mut dots = Dots::new(plot);
    let across = i64::try_from(ACROSS).unwrap_or(2);
    let band = Ink { role: ThemeRole::Muted, ascii: ".", dashed: false };
    let ink = Ink { role: ThemeRole::Value, ascii: "*", dashed: false };
    for (x, _, [lower, upper]) in &values {
        let x = i64::from(*x) * across + 1;
        dots.dot(x, y(*upper), band);
        dots.dot(x, y(*lower), band);
    }
    let mut before: Option<(u32, i64)> = None;
    for (x, value, _) in &values {
        let (column, at) = (i64::from(*x) * across, y(*value));
        // Joined only with its neighbor bucket: a gap in the record is a gap here.
        if let Some((last, from)) = before.filter(|(last, _)| last + 1 == *x) {
            dots.line((i64::from(last) * across + 1, from), (column, at), ink);
        }
        dots.dot(column, at, ink);
        dots.dot(column + 1, at, ink);
        before = Some((*x, at));
    }
    let takeovers = takeovers(series, family, plot);
    let line = if pen.look.ascii() { ":" } else { "╎" };
    for (x, mark) in &takeovers {
        for y in plot.top()..plot.bottom() {
            pen.cell(*x, y, line, role(mark.kind));
        }
    }
    dots.draw(pen, plot);
    for (x, mark) in &takeovers {
        letter(mark.kind, pen, (*x, plot.bottom() - 1));
    }
    let label = |value| Row::new().cell_right(ThemeRole::Muted, &quantity.label(value), LABEL_WIDTH);
    pen.row(area, 0, &label(high));
    if area.height > 1 {
        pen.row(area, area.height - 1, &label(low));
    }
    if let Some(x) = model.health_bucket().and_then(|bucket| column(series, bucket, plot.width)) {
        let x = plot.x + u16::try_from(x).unwrap_or(0);
        pen.lay(Rect { x, width: 1, ..plot }, ThemeRole::Selected);
    }
}

/// The marks at which another version of a family took over, with their columns, the most important of a column last.
fn takeovers<'a>(series: &'a HealthSeries, family: &Family, plot: Rect) -> Vec<(u16, &'a HealthMark)> {
    let takes_over = |kind| {
        matches!(
            kind,
            MarkKind::Promotion
                | MarkKind::Rollback
                | MarkKind::Demotion
                | MarkKind::Restored
                | MarkKind::Vacated
                | MarkKind::BreakGlass
        )
    };
    let own =
        series.marks.iter().filter(|mark| mark.family.as_ref() == Some(family) && takes_over(mark.kind));
    let mut placed: Vec<(u16, &HealthMark)> = own
        .filter_map(|mark| {
            let column = column(series, series.bucket_of(mark.on_clock_ms)?, plot.width)?;
            Some((plot.x + u16::try_from(column).ok()?, mark))
        })
        .collect();
    placed.sort_by_key(|(_, mark)| std::cmp::Reverse(mark.kind.weight()));
    placed
}

/// Draws a mark's letter.
fn letter(kind: MarkKind, pen: &mut Pen<'_>, (x, y): (u16, u16)) {
    let mut bytes = [0; 4];
    pen.cell(x, y, kind.letter().encode_utf8(&mut bytes), role(kind));
}

/// The column of a bucket: the newest at the right end; a narrower screen loses the oldest.
fn column(series: &HealthSeries, bucket: u32, width: u16) -> Option<u32> {
    let back = series.buckets.checked_sub(bucket + 1)?;
    u32::from(width).checked_sub(back + 1)
}

fn range(quantity: HealthQuantity, values: &[(u32, f64, [f64; 2])]) -> (f64, f64) {
    let least = values.iter().map(|(_, _, [lower, _])| *lower).fold(f64::INFINITY, f64::min);
    let most = values.iter().map(|(_, _, [_, upper])| *upper).fold(0.0, f64::max);
    match quantity {
        // From a round number below the lowest band, so that small differences are visible.
        HealthQuantity::Success => {
            (if least.is_finite() { (least / 10.0).floor() * 10.0 } else { 0.0 }.min(90.0), 100.0)
        }
        HealthQuantity::Violations => (0.0, most.max(5.0)),
        HealthQuantity::Time | HealthQuantity::Force => (0.0, if most > 0.0 { most } else { 1.0 }),
    }
}

/// The marks of the family under the cursor and of the cell, each over its column; of several the most important.
fn marks_line(model: &ConsoleModel, series: &HealthSeries, pen: &mut Pen<'_>, area: Rect) {
    let plot = Rect { x: area.x + SCALE, width: area.width.saturating_sub(SCALE), ..area };
    pen.row(area, 0, &Row::new().cell_right(ThemeRole::Muted, "marks", usize::from(SCALE - 2)));
    let family = model.health_family();
    let mut weightiest: BTreeMap<u32, &HealthMark> = BTreeMap::new();
    for mark in family_marks(series, family.as_ref()) {
        let Some(x) =
            series.bucket_of(mark.on_clock_ms).and_then(|bucket| column(series, bucket, plot.width))
        else {
            continue;
        };
        let known = weightiest.entry(x).or_insert(mark);
        if mark.kind.weight() < known.kind.weight() {
            *known = mark;
        }
    }
    for (x, mark) in weightiest {
        letter(mark.kind, pen, (plot.x + u16::try_from(x).unwrap_or(0), area.y));
    }
}

fn family_marks<'a>(
    series: &'a HealthSeries,
    family: Option<&'a Family>,
) -> impl Iterator<Item = &'a HealthMark> {
    series.marks.iter().filter(move |mark| mark.family.is_none() || mark.family.as_ref() == family)
}

const fn role(kind: MarkKind) -> ThemeRole {
    match kind {
        MarkKind::Rollback | MarkKind::Vacated | MarkKind::Stopped | MarkKind::BreakGlass => ThemeRole::Bad,
        MarkKind::Demotion | MarkKind::Restriction | MarkKind::DriftAlarm | MarkKind::AlarmRaised => {
            ThemeRole::Warning
        }
        MarkKind::Promotion | MarkKind::Confirmed => ThemeRole::Good,
        MarkKind::Restored
        | MarkKind::FirstVersion
        | MarkKind::AlarmReset
        | MarkKind::Drift
        | MarkKind::LiveFault
        | MarkKind::Released
        | MarkKind::Goal
        | MarkKind::Note
        | MarkKind::Context
        | MarkKind::Commissioned
        | MarkKind::EngineOff => ThemeRole::Text,
    }
}

/// Times below the columns at which they begin.
fn axis(model: &ConsoleModel, series: &HealthSeries, pen: &mut Pen<'_>, area: Rect) {
    let plot = Rect { x: area.x + SCALE, width: area.width.saturating_sub(SCALE), ..area };
    let mut row = Row::new();
    let mut bucket = 0;
    while bucket < series.buckets {
        if let Some(x) = column(series, bucket, plot.width) {
            let label = tick(series, bucket);
            let x = usize::try_from(x).unwrap_or(0);
            if x >= row.width() && x + label.chars().count() < usize::from(plot.width) {
                row = row.to_column(x).with(ThemeRole::Muted, &label);
            }
        }
        bucket += TIME_APART;
    }
    pen.row(plot, 0, &row);
    // The cursor's column also has a sign, because not every screen has a color for it.
    if let Some(x) = model.health_bucket().and_then(|bucket| column(series, bucket, plot.width)) {
        let sign = pen.look.glyph(Glyph::Up);
        pen.cell(plot.x + u16::try_from(x).unwrap_or(0), plot.y, sign, ThemeRole::Focus);
    }
}

fn tick(series: &HealthSeries, bucket: u32) -> String {
    let at_ms = series.start_ms(bucket);
    match series.clock {
        HealthClock::Virtual => seconds(u64::try_from(at_ms).unwrap_or(0)),
        HealthClock::Wall if series.bucket_ms >= 43_200_000 => calendar::date(at_ms),
        HealthClock::Wall if series.bucket_ms >= 3_600_000 => {
            format!("{} {}", calendar::date(at_ms), calendar::time(at_ms))
        }
        HealthClock::Wall => calendar::time(at_ms),
    }
}

/// The description below the charts, of at most `height` lines: the verdict, the bucket under the cursor, its events,
/// omissions.
fn under(model: &ConsoleModel, series: &HealthSeries, width: usize, height: usize) -> Vec<Row> {
    let mut rows = Vec::new();
    let lines = |role: ThemeRole, text: &str, most: usize| -> Vec<Row> {
        wrap(text, width, most).iter().map(|line| Row::of(role, line)).collect()
    };
    let mut say = |role: ThemeRole, text: &str, most: usize| rows.extend(lines(role, text, most));
    let (Some(bucket), Some(family)) = (model.health_bucket(), model.health_family()) else { return rows };
    if let Some(verdict) = model.health_verdict().filter(|_| !series.points.is_empty()) {
        let role = match verdict.trend() {
            Trend::Worse => ThemeRole::Warning,
            Trend::Better => ThemeRole::Good,
            Trend::NotShown | Trend::TooFew | Trend::NoData => ThemeRole::Text,
        };
        say(role, &holdpoint_wording::health::health_verdict(&verdict), 2);
        if let Some(text) = holdpoint_wording::health::confounding_versions(&verdict) {
            say(ThemeRole::Text, &text, 2);
        }
    }
    let mut marks: Vec<&HealthMark> = series.marks_in(Some(&family), bucket).collect();
    // Of equal importance the newest first: the others are counted.
    marks.sort_by_key(|mark| (mark.kind.weight(), std::cmp::Reverse(mark.at_ms)));
    // If hardly a line is left, the events come before the numbers, which the chart shows.
    if height >= NUMBERS_FROM || marks.is_empty() {
        let (start, end) =
            (series.time_text(series.start_ms(bucket)), series.time_text(series.start_ms(bucket + 1)));
        let points: Vec<&HealthPoint> = series.at(&family, bucket).collect();
        if points.is_empty() {
            say(ThemeRole::Muted, &wording::no_task_on_record(&start, &end, &family.to_string()), 1);
        }
        let each = if height < WHOLE_FROM && !marks.is_empty() { 1 } else { 2 };
        for point in &points {
            say(ThemeRole::Text, &values(series, point, &start), each);
        }
    }
    let left_out: Vec<Row> = holdpoint_wording::health::omissions(&series.coverage)
        .iter()
        .flat_map(|text| lines(ThemeRole::Muted, text, 2))
        .collect();
    // The events come before the omissions, if both are too much; events without a line are counted.
    let room = height.saturating_sub(rows.len());
    let room = room.saturating_sub(left_out.len()).max(MARKS_LEAST).min(room);
    let shown = if marks.len() > room { room.saturating_sub(1) } else { marks.len() };
    let mut say = |role: ThemeRole, text: &str| rows.extend(lines(role, text, 1));
    for mark in marks.iter().take(shown) {
        let when = match (series.clock, mark.wall_ms) {
            (HealthClock::Wall, Some(wall_ms)) => calendar::time(wall_ms - wall_ms.rem_euclid(1_000)),
            _ => seconds(mark.at_ms),
        };
        let (letter, what) = (mark.kind.letter(), mark_kind(mark.kind));
        say(role(mark.kind), &format!("{letter} {when} {what}: {}", mark.text));
    }
    match marks.len() - shown {
        0 => {}
        more => say(ThemeRole::Muted, &wording::marks_more(more)),
    }
    rows.extend(left_out);
    rows
}

/// The results of one version in a bucket, with both clocks.
fn values(series: &HealthSeries, point: &HealthPoint, start: &str) -> String {
    let engine = match series.clock {
        HealthClock::Wall => Some(seconds(point.at_ms[0])),
        HealthClock::Virtual => None,
    };
    wording::results(point, start, engine.as_deref())
}
