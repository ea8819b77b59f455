//! View 1: active versions, the pipeline, everything that waits for a person, the robot, alarms and events.
//!
//! ```text
//! ── In control ─────────────────────── │ ▸ Robot ──────────────────
//! grasp ✔ active grasp@1.0.0            │  side view     │ top view
//! ▸ Pipeline ────────────────── 1 of 62  │
//! ▸ grasp@1.1.0 ◌ running               │  grasp 0.21 m/s 4.1 N held
//!   ████░░░░ 137 of 480                 │ ── Alarms (2) ─────────────
//!   QUEUE 60: next align@1.10.8         │ 1▲ CRIT 18:26:02 grasp …
//! ── Waits for you (1) ──────────────── │
//! sign  place@1.1.0  0 of 2           6 │
//! ── Events ──────────────────────────────────────────────────────
//! ```

use ratatui::layout::Rect;
use unicode_width::UnicodeWidthStr as _;

use super::console_view::{ConsoleView, ORDER_OF_TIME, ViewDescription};
use super::{event_log, families, pipeline, robot, status, tabs, waits};
use crate::action::{Action, Scope};
use crate::effect::Effect;
use crate::formatters::{approvals, duration, state_label};
use crate::look::{Glyph, ThemeRole};
use crate::model::{ConsoleModel, EVENT_LOG_PANE, EngineLink, ItemKey, View};
use crate::rows::{AlarmItem, CandidateItem};
use crate::state_filter::StateFilter;
use crate::theme::StateMark;
use crate::update::{event_screen, navigation, selection};
use crate::waiting_rows::{WaitingRow, standing};
use crate::widgets::list::place;
use crate::widgets::pen::{Fit, Hit, Pen, below, cut};
use crate::widgets::row::Row;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::snapshot::CandidateView;
use holdpoint_wording::console::overview as wording;

const PIPELINE_PANE: usize = 0;
const ROBOT_PANE: usize = 1;

/// The size from which the view has room for the checks of the candidate under the cursor, below the pipeline.
const WIDE_COLUMNS: u16 = 160;

const WIDE_ROWS: u16 = 30;

/// The width from which the pipeline names the seven stages.
const STRIP_WIDTH: u16 = 62;

/// The least columns for the name of a version that waits.
const NAME_MIN: usize = 12;

/// Lines that the pipeline keeps beside any number of families: its heading, two candidates, the queue.
const PIPELINE_ROWS_MIN: u16 = 6;

/// View 1.
pub struct OverviewBehavior;

impl ConsoleView for OverviewBehavior {
    fn description(&self) -> &'static ViewDescription {
        &ViewDescription {
            title: "Overview",
            brief_title: "Overview",
            action: "overview",
            keys: &["1"],
            help: wording::HELP,
            tour: wording::TOUR,
            panes: &["Pipeline", "Robot", "Events"],
            scopes: &[Scope::Version, Scope::Charts],
            fixed_order: Some(ORDER_OF_TIME),
            queries_by_pane: false,
            is_about_version: false,
        }
    }

    fn row_count(&self, model: &ConsoleModel) -> usize {
        match model.view_state.pane() {
            EVENT_LOG_PANE => model.event_log_rows().len(),
            _ => model.pipeline_rows().len(),
        }
    }

    fn item_key(&self, model: &ConsoleModel, row: usize) -> Option<ItemKey> {
        match model.view_state.pane() {
            EVENT_LOG_PANE => model.event_log_rows().get(row).map(|line| ItemKey::Event(line.seq)),
            _ => model.pipeline_rows().get(row).map(|row| ItemKey::Version(row.version.clone())),
        }
    }

    fn row_of(&self, model: &ConsoleModel, key: &ItemKey) -> Option<usize> {
        match (model.view_state.pane(), key) {
            (EVENT_LOG_PANE, ItemKey::Event(seq)) => {
                model.event_log_rows().iter().position(|line| line.seq == *seq)
            }
            (_, ItemKey::Version(id)) => model.pipeline_rows().iter().position(|row| row.version == *id),
            _ => None,
        }
    }

    fn version_here(&self, model: &ConsoleModel) -> Option<CapabilityId> {
        match model.view_state.pane() {
            EVENT_LOG_PANE => None,
            _ => model.pipeline_rows().get(model.row()).map(|row| row.version.clone()),
        }
    }

    fn row_texts(&self, model: &ConsoleModel) -> Vec<String> {
        if model.view_state.is_in_event_log() {
            return model.event_log_rows().iter().map(|line| line.text.clone()).collect();
        }
        let text = |row: &&CandidateView| {
            format!("{} {} {}", row.version, row.author, state_label(row.state, &row.flags))
        };
        model.pipeline_rows().iter().map(text).collect()
    }

    fn lists_versions(&self, pane: usize) -> bool {
        pane != EVENT_LOG_PANE
    }

    fn is_in_order_of_time(&self, pane: usize) -> bool {
        pane == EVENT_LOG_PANE
    }

    fn can_mark(&self, item: &ItemKey) -> bool {
        matches!(item, ItemKey::Version(_))
    }

    fn is_filtered(&self, _model: &ConsoleModel) -> bool {
        true
    }

    fn hints(&self, _model: &ConsoleModel) -> &'static [Action] {
        &[
            Action::Go,
            Action::Open,
            Action::Abort,
            Action::Pause,
            Action::Resume,
            Action::Show(View::Approvals),
            Action::NextPane,
            Action::Freeze,
            Action::Filter,
        ]
    }

    fn hint_label(&self, model: &ConsoleModel, action: Action) -> Option<&'static str> {
        match action {
            Action::Quit if !model.ends_engine() => Some(wording::LEAVE_IT_ON),
            Action::Quit if model.engine_data.link == EngineLink::Attached => Some(wording::END_ENGINE),
            Action::Quit => Some("quit"),
            _ => None,
        }
    }

    fn can_open(&self, model: &ConsoleModel, rows: usize, version: Option<&CapabilityId>) -> bool {
        if model.view_state.is_in_event_log() { rows > 0 } else { version.is_some() }
    }

    fn copied(&self, model: &ConsoleModel) -> Option<String> {
        if model.view_state.is_in_event_log() {
            return model.event_log_rows().get(model.row()).map(|line| line.text.clone());
        }
        selection::copied(model)
    }

    fn open(&self, model: &mut ConsoleModel) -> Vec<Effect> {
        if model.view_state.is_in_event_log() { event_screen::open(model) } else { navigation::choose(model) }
    }

    fn draw(&self, model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
        match pen.fit {
            Fit::Tiny | Fit::One => draw_one_pane(model, pen, area),
            Fit::Two => draw_two_panes(model, pen, area),
            Fit::Full => draw_all_panes(model, pen, area),
        }
    }

    fn small_title(&self, model: &ConsoleModel) -> String {
        let ViewDescription { title, panes, .. } = self.description();
        let pane = panes.get(model.view_state.pane()).copied().unwrap_or("");
        // The mark of a filter needs the space of the view's title.
        if !model.filter().is_empty() || model.view_state.state_filter != StateFilter::All {
            pane.to_owned()
        } else {
            format!("{title}: {pane}")
        }
    }

    fn small_place(&self, model: &ConsoleModel, title: &str, width: u16) -> String {
        match model.view_state.pane() {
            ROBOT_PANE | EVENT_LOG_PANE => place(model.row_count(), model.row()),
            _ => pipeline::extent(model, model.row(), title, width),
        }
    }

    fn draw_small(&self, model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
        match model.view_state.pane() {
            ROBOT_PANE => robot::draw(model, pen, area),
            EVENT_LOG_PANE => event_log::draw(model, pen, area, true),
            _ => {
                let active = families::rows(model, pen, usize::from(area.width));
                let height = u16::try_from(active.len()).unwrap_or(u16::MAX).min(area.height / 2);
                let (top, bottom) = cut(area, height);
                pen.rows(top, 0, &active);
                pipeline::draw(model, pen, bottom, true);
            }
        }
    }
}

fn draw_one_pane(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    tabs::draw_panes(model, Row::new(), pen, area);
    let area = below(area, 1);
    match model.view_state.pane() {
        ROBOT_PANE => robot::draw(model, pen, area),
        EVENT_LOG_PANE => {
            let area = super::frozen(model, pen, area);
            event_log::draw(model, pen, area, true);
        }
        _ => versions_and_pipeline(model, pen, area),
    }
}

fn draw_two_panes(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let items = waits::items(model);
    // Over the whole width: half of it would cut the person and the deadline.
    let (upper, lower) = cut(area, area.height - waits::height(&items, area.height));
    let (left, right) = pen.split(upper, upper.width * 3 / 5);
    versions_and_pipeline(model, pen, left);
    if model.view_state.pane() == EVENT_LOG_PANE {
        event_log_pane(model, pen, right);
    } else {
        robot_pane(model, pen, right);
    }
    waits::draw(model, &items, pen, lower);
}

fn draw_all_panes(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let event_log_height = (area.height / 4).max(6);
    let (upper, lower) = cut(area, area.height - event_log_height);
    let (left, right) = pen.split(upper, (upper.width * 3 / 5).max(STRIP_WIDTH));
    let items = waits::items(model);
    let (left, waiting_area) = cut(left, left.height - waits::height(&items, left.height));
    if area.width >= WIDE_COLUMNS && left.height >= WIDE_ROWS {
        let (top, bottom) = cut(left, left.height / 2);
        versions_and_pipeline(model, pen, top);
        checks_under_cursor(model, pen, bottom);
    } else {
        versions_and_pipeline(model, pen, left);
    }
    waits::draw(model, &items, pen, waiting_area);
    let (robot_area, alarms_area) = cut(right, right.height - alarms_height(model, right.height));
    robot_pane(model, pen, robot_area);
    alarms_pane(model, pen, alarms_area);
    event_log_pane(model, pen, lower);
}

/// Active versions above the pipeline.
fn versions_and_pipeline(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let active = families::rows(model, pen, usize::from(area.width));
    let height = u16::try_from(active.len() + 1).unwrap_or(u16::MAX);
    let height = height.min(area.height.saturating_sub(PIPELINE_ROWS_MIN).max(area.height / 2));
    let (top, bottom) = cut(area, height);
    let inside = pen.pane(top, "In control", false, "");
    pen.rows(inside, 0, &active);
    let focused = model.view_state.pane() == PIPELINE_PANE;
    let cursor = if focused { model.row() } else { 0 };
    pen.hit(area, Hit::Pane(PIPELINE_PANE));
    let title = "Pipeline";
    let extent = pipeline::extent(model, cursor, title, bottom.width);
    let inside = pen.pane(bottom, title, focused, &extent);
    pipeline::draw(model, pen, inside, focused);
}

/// The candidate under the cursor in detail, if a large screen has room: its four checks and every reason of the last
/// decision.
fn checks_under_cursor(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let rows = model.pipeline_rows();
    let row = if model.view_state.is_in_event_log() { 0 } else { model.row() };
    let Some(candidate) = rows.get(row) else {
        pen.pane(area, "Checks", false, "");
        return;
    };
    let key = model.keymap.key(Action::Open);
    let title = wording::checks_of(&candidate.version);
    let inside = pen.pane(area, &title, false, &wording::opens_all(&key));
    let (look, width) = (pen.look, usize::from(inside.width));
    let dimensions = candidate.dimensions.iter().map(CandidateItem::Dimension);
    let reasons = candidate.reasons.iter().map(CandidateItem::Reason);
    let conditions = candidate.conditions.iter().map(CandidateItem::Condition);
    let rows: Vec<Row> = dimensions
        .chain(reasons)
        .chain(conditions)
        .flat_map(|row| super::candidate_rows::item(model, &row, look, width))
        .collect();
    if rows.is_empty() {
        pen.text(inside, 0, ThemeRole::Muted, wording::NOTHING_CHECKED);
        return;
    }
    pen.rows(inside, 0, &rows);
}

fn robot_pane(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let sequence = model
        .engine_data
        .frame
        .as_ref()
        .map(|frame| format!("sequence {}, {:.1} s", frame.sequence, frame.at_secs))
        .unwrap_or_default();
    pen.hit(area, Hit::Pane(ROBOT_PANE));
    let inside = pen.pane(area, "Robot", model.view_state.pane() == ROBOT_PANE, &sequence);
    robot::draw(model, pen, inside);
}

fn event_log_pane(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let focused = model.view_state.pane() == EVENT_LOG_PANE;
    // A filtered list must not look complete.
    let filter = model.event_log_filter();
    let right = if filter.is_empty() {
        wording::NEWEST_FIRST.to_owned()
    } else {
        let (shown, all) = (model.event_log_rows().len(), model.event_log().len());
        wording::lines_filtered(shown, all, &super::short(filter, 24))
    };
    pen.hit(area, Hit::Pane(EVENT_LOG_PANE));
    let inside = pen.pane(area, "Events", focused, &right);
    let inside = super::frozen(model, pen, inside);
    event_log::draw(model, pen, inside, focused);
}

/// The lines of the alarms with their heading: at most a quarter of the column; 0 without any.
fn alarms_height(model: &ConsoleModel, of: u16) -> u16 {
    let rows = model.alarm_rows().len();
    if rows == 0 { 0 } else { u16::try_from(rows + 1).unwrap_or(u16::MAX).min((of / 4).max(2)).min(of) }
}

/// The most urgent alarms; the status line has the first of them in full.
fn alarms_pane(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let items = model.alarm_rows();
    if items.is_empty() {
        return;
    }
    let key = model.keymap.key(Action::Show(View::Alarms));
    let inside = pen.pane(area, &format!("Alarms ({})", items.len()), false, &format!("{key} opens"));
    let rows: Vec<Row> = items.iter().map(|item| alarm_row(model, *item, pen)).collect();
    pen.rows(inside, 0, &rows);
}

fn alarm_row(model: &ConsoleModel, item: AlarmItem<'_>, pen: &Pen<'_>) -> Row {
    let alarm = item.alarm();
    let (priority, state) = (StateMark::priority(alarm.priority), StateMark::alarm_state(alarm.state));
    let role = if alarm.state.calls() { priority.role } else { ThemeRole::Quiet };
    let count = match item {
        AlarmItem::Alarm(_) => String::new(),
        AlarmItem::Group { count, .. } => format!(", {count} alarms"),
    };
    let notice = holdpoint_wording::notice(&alarm.text);
    Row::of(role, &status::priority_label(pen.look, alarm.priority))
        .with(state.role, &format!(" {} ", pen.look.glyph(state.glyph)))
        .with(ThemeRole::Muted, &model.moment(alarm.since_ms))
        .with(ThemeRole::Text, &format!(" {}{count}: {notice}", alarm.subject))
}

/// A version or request that waits for a person, as one line.
#[must_use]
pub fn waiting_row(model: &ConsoleModel, item: &WaitingRow<'_>, pen: &Pen<'_>, width: usize) -> Row {
    let now_ms = model.engine_ms();
    let glyph = pen.look.glyph(Glyph::Waiting);
    match item {
        WaitingRow::MonitorQuestion(question) => {
            let head = Row::of(ThemeRole::Waiting, &format!("{glyph} question "));
            let left = wording::rolled_back_in(&time_left(question.deadline_ms, now_ms));
            let room = name_room(width, &head, &left);
            let name = super::cut_middle(&question.version.to_string(), room);
            head.with(ThemeRole::Text, &name).with(ThemeRole::Muted, &left)
        }
        WaitingRow::Approval(prompt) => {
            let (count, next) = approvals(prompt, model.is_stopped(), model.time());
            let role = if prompt.granted { ThemeRole::Text } else { ThemeRole::Muted };
            let head = Row::of(ThemeRole::Waiting, &format!("{glyph} approval "));
            let (count, next) = (format!("  {count}"), format!("  {next}"));
            let room = name_room(width, &head, &count);
            let name = super::cut_middle(&prompt.version.to_string(), room);
            head.with(ThemeRole::Text, &format!("{name}{count}")).with(role, &next)
        }
        WaitingRow::Standing(candidate) => {
            let status = model.engine_data.snapshot.as_ref().map(|now| now.status(candidate));
            let stands = status.as_ref().and_then(|status| standing(status.condition));
            let label = stands.map_or("", |(label, _)| label);
            let why = status.as_ref().and_then(holdpoint_wording::status_cause).unwrap_or_default();
            let head = Row::of(ThemeRole::Waiting, &format!("{} {label} ", pen.look.glyph(Glyph::Paused)));
            let name = super::cut_middle(&candidate.version.to_string(), name_room(width, &head, ""));
            head.with(ThemeRole::Text, &name).with(ThemeRole::Muted, &format!("  {why}"))
        }
    }
}

/// Columns for the name of a version between the head of its row and the text that must not be cut.
fn name_room(width: usize, head: &Row, behind: &str) -> usize {
    width.saturating_sub(head.width() + behind.width()).max(NAME_MIN)
}

/// The time until a deadline.
#[must_use]
pub fn time_left(deadline_ms: u64, now_ms: u64) -> String {
    duration(deadline_ms.saturating_sub(now_ms))
}
