//! View 5: every alarm that is not normal, in the order of attention, and the one under the cursor in full.
//!
//! ```text
//! ▸ Alarms, 3 calls in 10 min (1 to 2 are normal) ──────────────────────
//!   priority  state            since     times  what
//! ▸ 1▲ CRIT   ⚠ unacknowledged 18:12:29  1      violation: grasp@1.0.0 violated a limit: force 71 N at the pads, limit 35 N
//!   3● LOW    ‖ shelved        18:06:40  7 ⚠    monitor: the camera is worse than when the cell was commissioned
//! ── violation:grasp@1.0.0 ───────────────────────────────────────────
//! grasp@1.0.0 violated a limit: force 71 N at the pads, limit 35 N, sequence 153 since its engine began
//! without action: the limit may be passed again
//! look at: gripper, tool and what they touch, then the film of the task
//! ```

use ratatui::layout::Rect;

use super::console_view::{ConsoleView, ViewDescription};
use super::small_window;
use super::status::priority_label;
use crate::action::{Action, Scope};
use crate::effect::{Effect, EngineQuery};
use crate::formatters::duration;
use crate::look::{Glyph, Look, ThemeRole};
use crate::model::{ConsoleModel, HISTORY_PANE, ItemKey, View};
use crate::rows::AlarmItem;
use crate::theme::StateMark;
use crate::update::{health, navigation, selection};
use crate::widgets::list::place;
use crate::widgets::pen::{Pen, below, cut};
use crate::widgets::row::{Row, wrap};
use holdpoint_governance::alarms::{AlarmKey, AlarmState, AlarmSummary, FLOOD_START};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::health::AlarmEpisode;
use holdpoint_protocol::snapshot::AlarmView;
use holdpoint_wording::console::alarms as wording;
use holdpoint_wording::console::shared;
use holdpoint_wording::{alarm as alarm_wording, notice};

/// Columns of the priority: number, sign, word, and the mark with a blank on both sides.
const PRIORITY: usize = 10;

/// Lines for the alarm under the cursor.
const DETAIL_ROWS: u16 = 9;

/// View 5.
pub struct AlarmsBehavior;

impl ConsoleView for AlarmsBehavior {
    fn description(&self) -> &'static ViewDescription {
        &ViewDescription {
            title: "Alarms",
            brief_title: "Alarms",
            action: "alarms",
            keys: &["5"],
            help: "Alarms",
            tour: wording::TOUR,
            panes: &["Open", "History"],
            scopes: &[Scope::Alarms],
            fixed_order: Some(wording::ORDER_OF_ATTENTION),
            queries_by_pane: true,
            is_about_version: false,
        }
    }

    fn row_count(&self, model: &ConsoleModel) -> usize {
        match model.view_state.pane() {
            HISTORY_PANE => model.alarm_spells().len(),
            _ => model.alarm_rows().len(),
        }
    }

    fn item_key(&self, model: &ConsoleModel, row: usize) -> Option<ItemKey> {
        match model.view_state.pane() {
            HISTORY_PANE => model.alarm_spells().get(row).map(|spell| ItemKey::Text(spell_name(spell))),
            _ => model.alarm_rows().get(row).map(|row| ItemKey::Alarm(row.alarm().alarm.clone())),
        }
    }

    fn row_of(&self, model: &ConsoleModel, key: &ItemKey) -> Option<usize> {
        match (model.view_state.pane(), key) {
            (HISTORY_PANE, ItemKey::Text(name)) => {
                model.alarm_spells().iter().position(|spell| spell_name(spell) == *name)
            }
            (_, ItemKey::Alarm(name)) => model.alarm_rows().iter().position(|row| row.alarm().alarm == *name),
            _ => None,
        }
    }

    fn version_here(&self, model: &ConsoleModel) -> Option<CapabilityId> {
        if model.view_state.pane() == HISTORY_PANE {
            let spells = model.alarm_spells();
            return spells.get(model.row())?.alarm.rsplit(':').next()?.parse().ok();
        }
        let rows = model.alarm_rows();
        rows.get(model.row())?.alarm().alarm.rsplit(':').next()?.parse().ok()
    }

    fn row_texts(&self, model: &ConsoleModel) -> Vec<String> {
        if model.view_state.pane() == HISTORY_PANE {
            let text = |spell: &AlarmEpisode| {
                format!("{} {}", spell.alarm, spell.text.as_ref().map(notice).unwrap_or_default())
            };
            return model.alarm_spells().into_iter().map(text).collect();
        }
        let rows = model.alarm_rows();
        let alarms = rows.iter().map(|row| row.alarm());
        alarms.map(|alarm| format!("{} {} {}", alarm.alarm, alarm.subject, notice(&alarm.text))).collect()
    }

    fn is_in_order_of_time(&self, pane: usize) -> bool {
        pane == HISTORY_PANE
    }

    fn can_mark(&self, item: &ItemKey) -> bool {
        matches!(item, ItemKey::Alarm(_))
    }

    fn hints(&self, model: &ConsoleModel) -> &'static [Action] {
        if model.view_state.pane() == HISTORY_PANE {
            return &[Action::NextPane, Action::Open, Action::Copy];
        }
        &[
            Action::Acknowledge,
            Action::Mark,
            Action::Shelve,
            Action::Unshelve,
            Action::ResetAlarm,
            Action::Open,
            Action::Abort,
        ]
    }

    fn hint_label(&self, model: &ConsoleModel, action: Action) -> Option<&'static str> {
        let other = if model.view_state.pane() == HISTORY_PANE { "open alarms" } else { "history" };
        (action == Action::NextPane).then_some(other)
    }

    fn can_open(&self, model: &ConsoleModel, _rows: usize, version: Option<&CapabilityId>) -> bool {
        version.is_some() || selection::group_here(model).is_some()
    }

    fn copied(&self, model: &ConsoleModel) -> Option<String> {
        if model.view_state.pane() == HISTORY_PANE {
            let spell = model.alarm_spells().get(model.row()).copied()?;
            let text = spell.text.as_ref().map(notice).unwrap_or_default();
            return Some(format!("{} {}: {text}", spell.alarm, spell.state));
        }
        let summary = |alarm: &AlarmView| {
            format!("{} {} {}: {}", alarm.priority, alarm.state, alarm.alarm, notice(&alarm.text))
        };
        let of_marked = model.engine_data.snapshot.iter().flat_map(|now| &now.alarms);
        let of_marked = of_marked.filter(|alarm| model.view_state.marked.contains(&alarm.alarm));
        let marked: Vec<String> = of_marked.map(summary).collect();
        if marked.is_empty() {
            return Some(summary(model.alarm_rows().get(model.row())?.alarm()));
        }
        Some(marked.join("\n"))
    }

    fn query(&self, model: &ConsoleModel) -> Option<EngineQuery> {
        (model.view_state.pane() == HISTORY_PANE).then_some(EngineQuery::AlarmHistory(health::HISTORY))
    }

    fn data(&self, model: &ConsoleModel) -> serde_json::Result<serde_json::Value> {
        if model.view_state.pane_of(View::Alarms) == HISTORY_PANE {
            let series = model.engine_data.alarm_history.as_ref();
            return serde_json::to_value(series.map(|series| &series.alarms));
        }
        serde_json::to_value(model.engine_data.snapshot.as_deref())
    }

    /// Opens the group under the cursor or closes it, or shows the version of the alarm.
    fn open(&self, model: &mut ConsoleModel) -> Vec<Effect> {
        let Some(subject) = selection::group_here(model) else { return navigation::choose(model) };
        let opened = &mut model.view_state.opened_groups;
        if !opened.remove(&subject) {
            opened.insert(subject);
        }
        Vec::new()
    }

    fn draw(&self, model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
        draw(model, pen, area);
    }

    fn small_rows(&self, model: &ConsoleModel, pen: &Pen<'_>, _width: usize) -> Vec<Row> {
        model.alarm_rows().iter().map(|item| small_window::alarm(*item, pen)).collect()
    }
}

/// Identifies one course of an alarm.
fn spell_name(spell: &AlarmEpisode) -> String {
    format!("{} {}", spell.alarm, spell.raised.at_ms)
}

fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    if model.view_state.pane() == HISTORY_PANE {
        super::alarm_history::draw(model, pen, area);
        return;
    }
    let items = model.alarm_rows();
    let summary = model.engine_data.snapshot.as_ref().map(|snapshot| &snapshot.alarm_summary);
    let title = title(summary);
    let inside = pen.pane(area, &title, true, &place(items.len(), model.row()));
    if items.is_empty() {
        pen.text(inside, 0, ThemeRole::Muted, wording::NO_ALARM_OPEN);
        return;
    }
    let look = pen.look;
    let since = items.iter().map(|item| model.moment(item.alarm().since_ms).len()).max();
    let since = since.unwrap_or_default() + 2;
    let header = Row::new()
        .to_column(2)
        .cell(ThemeRole::Muted, "priority", PRIORITY)
        .cell(ThemeRole::Muted, "state", 17)
        .cell(ThemeRole::Muted, "since", since)
        .cell(ThemeRole::Muted, "times", 7)
        .with(ThemeRole::Muted, "what");
    pen.row(inside, 0, &header);
    let detail_height = DETAIL_ROWS.min(inside.height / 2);
    let (list, detail) = cut(below(inside, 1), inside.height.saturating_sub(1 + detail_height));
    pen.list(list, items.len(), Some(model.row()), |index, _| {
        items.get(index).map_or_else(Row::new, |item| {
            let marked = model.view_state.marked.contains(&item.alarm().alarm);
            row(*item, marked, since, model, look)
        })
    });
    if let Some(item) = items.get(model.row()) {
        let inside = pen.pane(detail, &super::short(&item.alarm().alarm, 80), false, "");
        let rows = detail_rows(*item, model, look, usize::from(inside.width));
        pen.rows(inside, 0, &rows);
    }
}

/// The number of alarms that called in the last ten minutes, beside the number that a person can treat.
fn title(summary: Option<&AlarmSummary>) -> String {
    let Some(summary) = summary else { return "Alarms".to_owned() };
    let rate = summary.recent.map_or_else(String::new, |recent| {
        let recent = usize::try_from(recent).unwrap_or(usize::MAX);
        // The engine tells no more apart.
        let more = if recent > FLOOD_START { "more than " } else { "" };
        wording::rate(more, recent.min(FLOOD_START))
    });
    let flood = if summary.flood { wording::IN_A_FLOOD } else { "" };
    format!("Alarms{flood}{rate}")
}

fn row(item: AlarmItem<'_>, marked: bool, since: usize, model: &ConsoleModel, look: &Look) -> Row {
    let alarm = item.alarm();
    let priority = StateMark::priority(alarm.priority);
    let state = StateMark::alarm_state(alarm.state);
    // An acknowledged alarm calls no more: its priority appears in words alone.
    let quiet = match alarm.state {
        AlarmState::Acknowledged | AlarmState::Shelved => true,
        AlarmState::Normal
        | AlarmState::Unacknowledged
        | AlarmState::ReturnedUnacknowledged
        | AlarmState::Latched => false,
    };
    let role = if quiet { ThemeRole::Quiet } else { priority.role };
    let times = if alarm.chattering {
        format!("{} {}", alarm.raises, look.glyph(Glyph::Warning))
    } else {
        alarm.raises.to_string()
    };
    let mut text = format!("{}: {}", alarm.subject, notice(&alarm.text));
    if let AlarmItem::Group { count, .. } = item {
        let is_open = model.view_state.opened_groups.contains(&alarm.subject);
        let glyph = look.glyph(if is_open { Glyph::Open } else { Glyph::Closed });
        text = wording::group(glyph, count, &text);
    }
    // Beside the priority: all marked alarms are acknowledged together.
    let mark = if marked { format!(" {}", look.glyph(Glyph::Marked)) } else { String::new() };
    Row::new()
        .with(role, &priority_label(look, alarm.priority))
        .with(ThemeRole::Focus, &mark)
        .to_column(PRIORITY)
        .cell(state.role, &look.mark_label(state), 16)
        .with(ThemeRole::Text, " ")
        .cell(ThemeRole::Muted, &model.moment(alarm.since_ms), since)
        .cell(if alarm.chattering { ThemeRole::Warning } else { ThemeRole::Text }, &times, 7)
        .with(if quiet { ThemeRole::Quiet } else { ThemeRole::Text }, &text)
}

/// Everything about an alarm, in sentences.
fn detail_rows(item: AlarmItem<'_>, model: &ConsoleModel, look: &Look, width: usize) -> Vec<Row> {
    let alarm = item.alarm();
    let sentence = |text: &str| -> Vec<Row> {
        wrap(text, width, 2).iter().map(|line| Row::of(ThemeRole::Text, line)).collect()
    };
    let mut rows = sentence(&notice(&alarm.text));
    if let Ok(key) = alarm.alarm.parse::<AlarmKey>() {
        let (then, look_at) = (alarm_wording::consequence(key.kind()), alarm_wording::look_at(key.kind()));
        rows.extend(sentence(&shared::without_action(then)));
        rows.extend(sentence(&shared::look_at(look_at)));
    }
    let since = duration(model.engine_ms().saturating_sub(alarm.since_ms));
    let times = if alarm.raises == 1 { "once".to_owned() } else { format!("{} times", alarm.raises) };
    let chatter = if alarm.chattering { wording::CHATTERING } else { "" };
    rows.push(Row::of(ThemeRole::Muted, &wording::about(&alarm.subject, &since, &times, chatter)));
    rows.push(Row::of(ThemeRole::Text, &attention(alarm)));
    if let Some((by, why, until)) = &alarm.shelf {
        let back = until.as_deadline(model.time());
        let below = StateMark::alarm_state(alarm.state_below).label;
        rows.push(Row::of(ThemeRole::Text, &wording::shelved(by, &back, below, why)));
    }
    if alarm.latching {
        let latched = look.glyph(Glyph::Latched);
        rows.push(Row::of(ThemeRole::Muted, &wording::stays_until_reset(latched)));
    }
    if let AlarmItem::Group { count, .. } = item {
        let [open, acknowledge] = [Action::Open, Action::Acknowledge].map(|action| model.keymap.key(action));
        let more = wording::group_keys(count, &alarm.subject, &open, &acknowledge);
        rows.push(Row::of(ThemeRole::Warning, &more));
    }
    rows
}

fn attention(alarm: &AlarmView) -> String {
    match (&alarm.acknowledged_by, alarm.state) {
        (Some(by), _) => wording::acknowledged(by),
        (None, AlarmState::ReturnedUnacknowledged) => wording::CONDITION_GONE.to_owned(),
        (
            None,
            AlarmState::Normal
            | AlarmState::Unacknowledged
            | AlarmState::Acknowledged
            | AlarmState::Latched
            | AlarmState::Shelved,
        ) => wording::NOT_ACKNOWLEDGED.to_owned(),
    }
}
