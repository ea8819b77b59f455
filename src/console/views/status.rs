//! The status line in every view, under every filter and at every size: the first alarm, the number of alarms, and
//! the waiting requests.
//!
//! ```text
//! 1▲ CRIT arm-1: the monitor lost its samples · 1 crit 2 high 0 low · 3 ack · 1 latched · shelved 2    ◷ 2 wait
//! ```

use ratatui::layout::Rect;

use crate::look::{Glyph, Look, ThemeRole};
use crate::model::ConsoleModel;
use crate::theme::StateMark;
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;
use holdpoint_governance::alarms::{AlarmState, AlarmSummary, Priority};
use holdpoint_governance::lifecycle::{State, VersionFlags};
use holdpoint_protocol::command::Caller;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_wording::console::shared;
use holdpoint_wording::console::status as wording;

/// Columns reserved for the text of an alarm, before counts are dropped.
const TEXT_MIN: usize = 26;

/// Columns from which a version is named here.
const WIDE: usize = 110;

pub fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let width = usize::from(area.width);
    let snapshot = model.engine_data.snapshot.as_deref();
    let paused = snapshot.map(|snapshot| paused_promotions(snapshot, pen.look, width));
    let waits = paused.unwrap_or_default().and(waiting(model, pen.look));
    let Some(snapshot) = &model.engine_data.snapshot else {
        let absent = model.absence().is_some();
        let text = if absent { shared::NO_ENGINE_HERE_TITLE } else { wording::NO_DATA_YET };
        pen.row(
            area,
            0,
            &Row::of(ThemeRole::Muted, text).to_column(width.saturating_sub(waits.width())).and(waits),
        );
        return;
    };
    let head = head(model, snapshot, pen.look);
    let room = width.saturating_sub(waits.width() + 1);
    // Words are dropped before the alarm's own text.
    let head_text = head_text(model, snapshot);
    let is_quiet = snapshot.foremost_alarm().is_none();
    let text_min = if is_quiet { head_text.len() } else { head_text.len().min(TEXT_MIN) };
    let fits = |row: &Row| head.width() + text_min + row.width() <= room;
    let styles = [CountStyle::Full, CountStyle::Short, CountStyle::Signs];
    let count_row = |style| counts(&snapshot.alarm_summary, pen.look, style);
    let counts = styles.map(count_row).into_iter().find(fits).unwrap_or_else(|| count_row(CountStyle::Signs));
    let left = room.saturating_sub(head.width() + counts.width());
    let text = super::short(&head_text, left);
    let role = if is_quiet { ThemeRole::Muted } else { ThemeRole::Text };
    let row = head.with(role, &text).and(counts).to_column(room + 1).and(waits);
    pen.row(area, 0, &row);
}

/// A priority as number, sign and word, `1▲ CRIT`.
#[must_use]
pub fn priority_label(look: &Look, priority: Priority) -> String {
    let number = match priority {
        Priority::Critical => 1,
        Priority::High => 2,
        Priority::Low => 3,
    };
    let mark = StateMark::priority(priority);
    format!("{number}{} {}", look.glyph(mark.glyph), mark.label)
}

/// The operators who stopped the cell, first and last, and the times; absent while it runs.
#[must_use]
pub fn stopped(model: &ConsoleModel) -> Option<String> {
    stop_text(model, true)
}

/// As [`stopped`] without the times, which have their days if they are not of this engine.
#[must_use]
pub fn stopped_untimed(model: &ConsoleModel) -> Option<String> {
    stop_text(model, false)
}

fn stop_text(model: &ConsoleModel, is_timed: bool) -> Option<String> {
    let stopped = model.engine_data.snapshot.as_ref()?.stopped.as_ref()?;
    let own = model.engine_data.own_account();
    let by = |by: &str, caller: &Caller| {
        // A stop from another account names the account, which alone stated the person's name.
        let account = match caller {
            Caller::Process { uid, user, .. }
                if by.is_empty() || own.is_some_and(|account| account.uid != *uid) =>
            {
                let account = user.clone().unwrap_or_else(|| uid.to_string());
                Some(format!("account {}", super::short(&account, 16)))
            }
            Caller::Process { .. } | Caller::Script => None,
        };
        match (by, account) {
            ("", account) => account.unwrap_or_else(|| "somebody".to_owned()),
            (by, None) => super::short(by, 16),
            (by, Some(account)) => format!("{account} as {:?}", super::short(by, 16)),
        }
    };
    let first_by = by(&stopped.by, &stopped.caller);
    let first = model.recorded_moment(stopped.since_ms, stopped.wall);
    Some(match stopped.again.last() {
        None if is_timed => wording::stopped_by(&first_by, &first),
        None => wording::stopped_untimed(&first_by, None, ""),
        Some(last) => {
            let between = stopped.unnamed.saturating_add(stopped.again.len() as u64).saturating_sub(1);
            let more = if between > 0 { format!(" and {between} more") } else { String::new() };
            let last_by = by(&last.by, &last.caller);
            if is_timed {
                let again = model.recorded_moment(last.at_ms, last.wall);
                wording::stopped_again(&first_by, &first, &last_by, &again, &more)
            } else {
                wording::stopped_untimed(&first_by, Some(&last_by), &more)
            }
        }
    })
}

/// The stop of the cell before the alarms; absent while it runs.
#[must_use]
pub fn stop_row(model: &ConsoleModel) -> Option<Row> {
    stopped(model).map(|text| Row::of(ThemeRole::Problem, &text).with(ThemeRole::Text, " "))
}

fn head(model: &ConsoleModel, snapshot: &Snapshot, look: &Look) -> Row {
    // Where the screen has the line of state, that line names the stop.
    let stop = stop_row(model).filter(|_| !super::state_line::says_stopped(model));
    let mut row = stop.unwrap_or_default();
    if let Some(alarm) = snapshot.foremost_alarm() {
        row.push(StateMark::priority(alarm.priority).role, &priority_label(look, alarm.priority));
        row.push(ThemeRole::Text, " ");
    } else {
        // Without an engine, no state is known to be good.
        let (role, glyph) = match (model.last_seen(), snapshot.alarm_summary.shelved) {
            (None, 0) => (ThemeRole::Good, Glyph::Good),
            (None, _) => (ThemeRole::Quiet, Glyph::Neutral),
            (Some(_), _) => (ThemeRole::Unknown, Glyph::Unknown),
        };
        row.push(role, look.glyph(glyph));
        row.push(ThemeRole::Text, " ");
    }
    row
}

/// That no alarm is open, or none but shelved ones, as of when if the data is old.
#[must_use]
pub fn no_alarm(model: &ConsoleModel) -> String {
    let has_shelved =
        model.engine_data.snapshot.as_ref().is_some_and(|snapshot| snapshot.alarm_summary.shelved > 0);
    let none = if has_shelved { wording::ONLY_SHELVED_ALARMS } else { wording::NO_ALARM };
    model.last_seen().map_or_else(|| none.to_owned(), |seen| wording::none_last_seen(&seen, none))
}

fn head_text(model: &ConsoleModel, snapshot: &Snapshot) -> String {
    snapshot.foremost_alarm().map_or_else(
        || no_alarm(model),
        |alarm| {
            // An ended one stays until it is acknowledged; an acknowledged one until its condition ends.
            let state_note = match alarm.state {
                AlarmState::ReturnedUnacknowledged => " (ended)",
                AlarmState::Acknowledged => " (acknowledged)",
                AlarmState::Latched => " (latched)",
                AlarmState::Normal | AlarmState::Unacknowledged | AlarmState::Shelved => "",
            };
            format!("{}{state_note}: {}", alarm.subject, holdpoint_wording::notice(&alarm.text))
        },
    )
}

/// How many words accompany a count.
#[derive(Clone, Copy, PartialEq, Eq)]
enum CountStyle {
    Full,
    Short,
    Signs,
}

/// The number of alarms in each state; zero is left out, but unacknowledged ones never.
fn counts(summary: &AlarmSummary, look: &Look, style: CountStyle) -> Row {
    let [critical, high, low] = summary.unacknowledged;
    let mut row = Row::new();
    let separator = match (style, look.ascii()) {
        (CountStyle::Full, false) => " · ",
        (CountStyle::Full, true) => " | ",
        (CountStyle::Short | CountStyle::Signs, _) => " ",
    };
    let mut push_count = |count: u32, role: ThemeRole, text: String| {
        if count > 0 {
            row.push(ThemeRole::Muted, separator);
            row.push(role, &text);
        }
    };
    if summary.flood {
        push_count(1, ThemeRole::High, format!("{} FLOOD", look.glyph(Glyph::Warning)));
    }
    if style == CountStyle::Full {
        push_count(critical, ThemeRole::Critical, format!("{critical} crit"));
        push_count(high, ThemeRole::High, format!("{high} high"));
        push_count(low, ThemeRole::Low, format!("{low} low"));
    } else {
        let glyph = |priority| look.glyph(StateMark::priority(priority).glyph);
        push_count(critical, ThemeRole::Critical, format!("{}{critical}", glyph(Priority::Critical)));
        push_count(high, ThemeRole::High, format!("{}{high}", glyph(Priority::High)));
        push_count(low, ThemeRole::Low, format!("{}{low}", glyph(Priority::Low)));
    }
    let [acknowledged, latched, shelved] = match style {
        CountStyle::Full => ["acknowledged ", "latched ", "shelved "],
        CountStyle::Short => ["ack ", "latched ", "shelved "],
        CountStyle::Signs => ["a", "l", "s"],
    };
    push_count(summary.acknowledged, ThemeRole::Quiet, format!("{acknowledged}{}", summary.acknowledged));
    push_count(summary.latched, ThemeRole::Warning, format!("{latched}{}", summary.latched));
    push_count(summary.shelved, ThemeRole::Quiet, format!("{shelved}{}", summary.shelved));
    row
}

/// Provisional versions whose promotion is paused: in words, or in signs and a count.
fn paused_promotions(snapshot: &Snapshot, look: &Look, width: usize) -> Row {
    let paused = snapshot.families.iter().filter(|family| {
        family.active.is_some() && family.flags.is_some_and(|flags| flags.provisional && flags.paused)
    });
    let names: Vec<String> =
        paused.filter_map(|family| family.active.as_ref()).map(ToString::to_string).collect();
    let flags = VersionFlags { provisional: true, paused: true, ..VersionFlags::default() };
    let state_mark = StateMark::version(State::Active, &flags);
    let (Some(first), Some(paused_mark)) = (names.first(), StateMark::secondary(State::Active, &flags))
    else {
        return Row::new();
    };
    let (state_glyph, paused_glyph) = (look.glyph(state_mark.glyph), look.glyph(paused_mark.glyph));
    let more = if names.len() > 1 { format!(" +{}", names.len() - 1) } else { String::new() };
    if width >= WIDE {
        Row::of(state_mark.role, &format!("{state_glyph} {}{more} provisional ", super::short(first, 24)))
            .with(paused_mark.role, &format!("{paused_glyph} {} ", paused_mark.label))
    } else {
        Row::of(state_mark.role, &format!("{state_glyph} provisional{more} "))
            .with(paused_mark.role, &format!("{paused_glyph} paused "))
    }
}

/// The waiting requests, and the missed events.
#[must_use]
pub fn waiting(model: &ConsoleModel, look: &Look) -> Row {
    let mut row = Row::new();
    if model.engine_data.missed > 0 {
        row.push(
            ThemeRole::Warning,
            &format!("{} missed {} ", look.glyph(Glyph::Warning), model.engine_data.missed),
        );
    }
    if !model.requests.pending.is_empty() {
        row.push(
            ThemeRole::Running,
            &format!("{} {} asked ", look.glyph(Glyph::Running), model.requests.pending.len()),
        );
    }
    let waiting = model
        .engine_data
        .snapshot
        .as_ref()
        .map_or(0, |snapshot| snapshot.prompts.len() + snapshot.questions.len());
    if waiting > 0 {
        row.push(ThemeRole::Waiting, &format!("{} {waiting} wait", look.glyph(Glyph::Waiting)));
    }
    row
}
