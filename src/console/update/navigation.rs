//! Navigation: cursors, panes, branches, and the effect of Enter.

use super::{engine_requests, event_screen, refuse, selection, show, why};
use crate::action::Action;
use crate::approval_screen::ApprovalScreen;
use crate::audit;
use crate::effect::Effect;
use crate::form::NO_IDENTITY_TEXT;
use crate::model::{
    ConsoleModel, EVENT_LOG_PANE, HISTORY_PANE, ListCursor, OpenedRecord, Overlay, SortOrder, View,
};
use crate::rows::RegistryItem;
use crate::state_filter::StateFilter;
use crate::waiting_rows::WaitingRow;
use holdpoint_governance::ids::Family;
use holdpoint_protocol::snapshot::AlarmView;
use holdpoint_wording::notice;

/// How long keys for an item wait after another item moved under the cursor, ms: the user may have decided on the key
/// before.
const SLIP_MS: u64 = 700;

/// Rows kept in sight when a page is turned.
const PAGE_OVERLAP: usize = 12;

pub(super) fn go(model: &mut ConsoleModel, action: Action) -> Vec<Effect> {
    let page = usize::from(model.size.1).saturating_sub(PAGE_OVERLAP).max(1);
    if model.view_state.view == View::Audit && model.view_state.opened.is_some() {
        return in_record(model, action, page);
    }
    let last = model.row_count().saturating_sub(1);
    let row = model.row();
    match action {
        Action::Up => set_row(model, row.saturating_sub(1)),
        Action::Down => set_row(model, row.saturating_add(1).min(last)),
        Action::PageUp => set_row(model, row.saturating_sub(page)),
        Action::PageDown => set_row(model, row.saturating_add(page).min(last)),
        Action::Top => set_row(model, 0),
        Action::Bottom => set_row(model, last),
        Action::Left => return sideways(model, false),
        Action::Right => return sideways(model, true),
        Action::NextPane => return step_pane(model, true),
        Action::PreviousPane => return step_pane(model, false),
        _ => return open(model),
    }
    Vec::new()
}

/// Scrolls a raw record; Enter closes it.
fn in_record(model: &mut ConsoleModel, action: Action, page: usize) -> Vec<Effect> {
    let last = model.opened_record().map_or(0, |record| audit::raw(record).len().saturating_sub(1));
    let Some(opened) = &mut model.view_state.opened else { return Vec::new() };
    opened.scroll = match action {
        Action::Up => opened.scroll.saturating_sub(1),
        Action::Down => opened.scroll.saturating_add(1).min(last),
        Action::PageUp => opened.scroll.saturating_sub(page),
        Action::PageDown => opened.scroll.saturating_add(page).min(last),
        Action::Top => 0,
        Action::Bottom => last,
        _ => {
            model.view_state.opened = None;
            return Vec::new();
        }
    };
    Vec::new()
}

pub(super) fn wheel(model: &mut ConsoleModel, rows: i32) -> Vec<Effect> {
    let by = rows.unsigned_abs() as usize;
    let row = model.row();
    let last = model.row_count().saturating_sub(1);
    if model.input.overlay.is_none() && model.input.typing.is_none() {
        set_row(model, if rows < 0 { row.saturating_sub(by) } else { row.saturating_add(by).min(last) });
    }
    Vec::new()
}

pub(super) fn set_row(model: &mut ConsoleModel, row: usize) {
    let item = model.item_key(row);
    model.view_state.cursors.insert(model.view_state.list(), ListCursor { row, item });
}

/// Puts the cursor back on its item after the list may have changed. `by_itself`: no key changed it.
pub(super) fn follow(model: &mut ConsoleModel, by_itself: bool) {
    let row = model.row();
    let here = model.item_key(row);
    let cursor = model.view_state.cursors.get(&model.view_state.list());
    let item = cursor.and_then(|cursor| cursor.item.clone());
    if item.is_some() && item == here {
        return;
    }
    // A cursor at the newest end of a time-ordered list stays at the newest item.
    let tells_of_time = match (model.view_state.view, model.view_state.pane()) {
        (View::Overview, pane) => pane == EVENT_LOG_PANE,
        (View::Audit, _) => true,
        (View::Alarms, pane) => pane == HISTORY_PANE,
        (View::Registry | View::Candidate | View::Shadow | View::Approvals | View::Health, _) => false,
    };
    let at = item.as_ref().filter(|_| row > 0 || !tells_of_time).and_then(|item| model.row_of(item));
    if at.is_none() && item.is_some() && by_itself && !tells_of_time {
        model.view_state.slipped_ms = Some(model.now_ms);
    }
    set_row(model, at.unwrap_or(row));
}

/// Whether the item under the cursor disappeared so recently that a key may have been meant for it.
pub(super) fn has_slipped(model: &ConsoleModel) -> bool {
    model.view_state.slipped_ms.is_some_and(|at_ms| model.now_ms.saturating_sub(at_ms) < SLIP_MS)
}

/// Sorts the registry by the next column, or reverses the order. All other lists have a fixed order.
pub(super) fn sort(model: &mut ConsoleModel, action: Action) -> Vec<Effect> {
    if let Some(why) = unsorted(model) {
        return refuse(model, why);
    }
    let SortOrder { by, reversed } = model.engine_data.registry.sort;
    let sort = match action {
        Action::Sort => SortOrder { by: by.next(), reversed: false },
        _ => SortOrder { by, reversed: !reversed },
    };
    model.engine_data.registry.sort_by(sort);
    let order = if sort.reversed { ", turned round" } else { "" };
    super::show_message(model, format!("sorted by {}{order}", sort.by.label()), false);
    Vec::new()
}

/// Lists the versions of the next filter by state.
pub(super) fn next_state_filter(model: &mut ConsoleModel) -> Vec<Effect> {
    if let Some(why) = not_filtered_by_state(model) {
        return refuse(model, why);
    }
    filter_by_state(model, model.view_state.state_filter.next())
}

/// Lists the versions that a filter by state takes, in the overview and the registry.
pub(super) fn filter_by_state(model: &mut ConsoleModel, filter: StateFilter) -> Vec<Effect> {
    model.view_state.state_filter = filter;
    let text = match filter {
        StateFilter::All => "overview and registry list every version".to_owned(),
        StateFilter::Mine if model.session.operator.is_none() => {
            format!("{NO_IDENTITY_TEXT}: no version is known to be yours")
        }
        StateFilter::Mine => {
            "overview and registry list the versions that you submitted or that wait for you".to_owned()
        }
        _ => format!("overview and registry list {} versions alone", filter.name()),
    };
    super::show_message(model, text, false);
    Vec::new()
}

/// Why the list that has the keys is not filtered by state; absent if it is.
pub(super) fn not_filtered_by_state(model: &ConsoleModel) -> Option<&'static str> {
    let is_filtered = model.view_state.lists_versions();
    (!is_filtered).then_some("only the overview's pipeline and the registry are filtered by state")
}

/// Why the view's list cannot be sorted; absent if it can.
pub(super) const fn unsorted(model: &ConsoleModel) -> Option<&'static str> {
    match model.view_state.view {
        View::Registry => None,
        View::Alarms => Some("alarms stand in the order of attention"),
        View::Approvals => Some("what waits stands in the order of its deadlines"),
        View::Overview | View::Candidate | View::Shadow | View::Audit | View::Health => {
            Some("this list stands in the order in which things happened; the registry can be sorted")
        }
    }
}

/// In the registry the branch opens and closes; elsewhere the pane changes.
fn sideways(model: &mut ConsoleModel, right: bool) -> Vec<Effect> {
    if model.view_state.view == View::Health {
        return super::health::step(model, right);
    }
    if model.view_state.view != View::Registry || model.engine_data.registry.is_flat() {
        return step_pane(model, right);
    }
    let family = match model.registry_rows().get(model.row()) {
        Some(RegistryItem::Family { family, .. }) => (*family).clone(),
        Some(RegistryItem::Version(row)) => row.version.family.clone(),
        None => return Vec::new(),
    };
    set_branch(model, family, right);
    Vec::new()
}

/// The family under the registry's cursor, if the row is that of a family.
pub(super) fn family_here(model: &ConsoleModel) -> Option<Family> {
    if model.view_state.view != View::Registry {
        return None;
    }
    match model.registry_rows().get(model.row()) {
        Some(RegistryItem::Family { family, .. }) => Some((*family).clone()),
        Some(RegistryItem::Version(_)) | None => None,
    }
}

fn set_branch(model: &mut ConsoleModel, family: Family, open: bool) {
    if open {
        model.engine_data.registry.closed.remove(&family);
        return;
    }
    model.engine_data.registry.closed.insert(family.clone());
    // The cursor goes to the closed branch.
    let is_it =
        |item: &RegistryItem<'_>| matches!(item, RegistryItem::Family { family: of, .. } if **of == family);
    if let Some(row) = model.registry_rows().iter().position(is_it) {
        set_row(model, row);
    }
}

fn step_pane(model: &mut ConsoleModel, forward: bool) -> Vec<Effect> {
    let count = model.view_state.view.panes().len().max(1);
    let next =
        if forward { model.view_state.pane() + 1 } else { model.view_state.pane() + count - 1 } % count;
    to_pane(model, next)
}

/// Gives a pane of the view the keys.
pub(super) fn to_pane(model: &mut ConsoleModel, next: usize) -> Vec<Effect> {
    if let Some(pane) = model.view_state.panes.get_mut(model.view_state.view as usize) {
        *pane = next;
    }
    if matches!(model.view_state.view, View::Registry | View::Alarms | View::Audit) {
        engine_requests::refresh_now(model)
    } else {
        Vec::new()
    }
}

/// Enter: opens what is under the cursor. It changes nothing outside this console.
fn open(model: &mut ConsoleModel) -> Vec<Effect> {
    match model.view_state.view {
        View::Registry => {
            if let Some(RegistryItem::Family { family, open, .. }) = model.registry_rows().get(model.row()) {
                let (family, open) = ((*family).clone(), *open);
                set_branch(model, family, !open);
                return Vec::new();
            }
            choose(model)
        }
        View::Overview if model.view_state.is_in_event_log() => event_screen::open(model),
        View::Overview => choose(model),
        View::Audit => {
            let seq = model.audit_rows().get(model.row()).map(|row| row.record.seq);
            model.view_state.opened = seq.map(|seq| OpenedRecord { seq, scroll: 0 });
            Vec::new()
        }
        View::Shadow => show(model, View::Candidate),
        View::Candidate => {
            if why::open(model) {
                return Vec::new();
            }
            step_pane(model, true)
        }
        View::Alarms => {
            if let Some(subject) = selection::group_here(model) {
                let opened = &mut model.view_state.opened_groups;
                if !opened.remove(&subject) {
                    opened.insert(subject);
                }
                return Vec::new();
            }
            choose(model)
        }
        View::Health => choose(model),
        View::Approvals => open_waiting(model),
    }
}

fn choose(model: &mut ConsoleModel) -> Vec<Effect> {
    match model.version_here() {
        Some(version) => {
            model.view_state.chosen = Some(version);
            show(model, View::Candidate)
        }
        None => Vec::new(),
    }
}

/// Opens the prompt of a waiting approval, or the card of a version with keys of its own: a monitor asks about it, or it
/// stands until a person acts.
fn open_waiting(model: &mut ConsoleModel) -> Vec<Effect> {
    let prompt = match model.waiting_rows().get(model.row()) {
        Some(WaitingRow::Approval(question)) => model
            .engine_data
            .snapshot
            .as_ref()
            .map(|snapshot| ApprovalScreen::open(question, snapshot, model.now_ms)),
        Some(row @ (WaitingRow::MonitorQuestion(_) | WaitingRow::Standing(_))) => {
            model.view_state.chosen = Some(row.version().clone());
            return show(model, View::Candidate);
        }
        None => return refuse(model, "nothing waits for people"),
    };
    match prompt {
        Some(prompt) => {
            model.input.overlay = Some(Overlay::Approval(Box::new(prompt)));
            Vec::new()
        }
        None => refuse(model, "the candidate is gone"),
    }
}

/// Selects the highest unacknowledged alarm, whatever the view.
pub(super) fn jump_to_alarm(model: &mut ConsoleModel) -> Vec<Effect> {
    if let Some(pane) = model.view_state.panes.get_mut(View::Alarms as usize) {
        *pane = 0;
    }
    let rows = model.alarm_rows();
    let highest = rows
        .iter()
        .enumerate()
        .filter(|(_, item)| item.alarm().state.calls())
        .min_by_key(|(_, item)| item.alarm().attention_rank())
        .map(|(row, _)| row);
    let effects = show(model, View::Alarms);
    match highest {
        Some(row) => set_row(model, row),
        None => super::show_message(model, "every alarm is acknowledged", false),
    }
    effects
}

/// The value for Copy: the one that a person would paste elsewhere.
pub(super) fn copied(model: &ConsoleModel) -> Option<String> {
    match model.view_state.view {
        View::Health => {
            model.health_verdict().map(|verdict| holdpoint_wording::health::health_verdict(&verdict))
        }
        View::Alarms if model.view_state.pane() == HISTORY_PANE => {
            let spell = model.alarm_spells().get(model.row()).copied()?;
            Some(format!(
                "{} {}: {}",
                spell.alarm,
                spell.state,
                spell.text.as_ref().map(notice).unwrap_or_default()
            ))
        }
        View::Alarms => {
            let rows = model.alarm_rows();
            let summary = |alarm: &AlarmView| {
                format!("{} {} {}: {}", alarm.priority, alarm.state, alarm.alarm, notice(&alarm.text))
            };
            let of_marked = model.engine_data.snapshot.iter().flat_map(|now| &now.alarms);
            let of_marked = of_marked.filter(|alarm| model.view_state.marked.contains(&alarm.alarm));
            let marked: Vec<String> = of_marked.map(summary).collect();
            if marked.is_empty() {
                Some(summary(rows.get(model.row())?.alarm()))
            } else {
                Some(marked.join("\n"))
            }
        }
        View::Audit => {
            let rows = model.audit_rows();
            let row = model.opened_record().or_else(|| rows.get(model.row()).map(|row| row.record))?;
            Some(format!("{} {} {} {} {}", row.seq, row.kind, row.subject, row.hash, row.body))
        }
        View::Overview if model.view_state.pane() == EVENT_LOG_PANE => {
            model.event_log_rows().get(model.row()).map(|line| line.text.clone())
        }
        View::Overview | View::Registry | View::Candidate | View::Shadow | View::Approvals => {
            let marked: Vec<String> = selection::versions(model).iter().map(ToString::to_string).collect();
            if marked.is_empty() {
                return model.version_here().map(|version| version.to_string());
            }
            Some(marked.join("\n"))
        }
    }
}
