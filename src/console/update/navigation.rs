//! Navigation: cursors, panes, the order and the filter by state.

use super::{engine_requests, refuse, show};
use crate::action::Action;
use crate::audit;
use crate::effect::Effect;
use crate::model::{ConsoleModel, ListCursor, SortOrder, View};
use crate::rows::RegistryItem;
use crate::state_filter::StateFilter;
use holdpoint_governance::ids::Family;
use holdpoint_wording::console::navigation as wording;
use holdpoint_wording::console::shared;

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
        Action::Left => return model.view_state.view.behavior().sideways(model, false),
        Action::Right => return model.view_state.view.behavior().sideways(model, true),
        Action::NextPane => return step_pane(model, true),
        Action::PreviousPane => return step_pane(model, false),
        _ => return model.view_state.view.behavior().open(model),
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

pub(crate) fn set_row(model: &mut ConsoleModel, row: usize) {
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
    let tells_of_time = model.view_state.view.behavior().is_in_order_of_time(model.view_state.pane());
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
    let order = if sort.reversed { wording::TURNED_ROUND } else { "" };
    super::show_message(model, wording::sorted_by(sort.by.label(), order), false);
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
        StateFilter::All => wording::ALL_LISTED.to_owned(),
        StateFilter::Mine if model.session.operator.is_none() => {
            shared::who_first(wording::NONE_KNOWN_TO_BE_YOURS)
        }
        StateFilter::Mine => wording::OWN_LISTED.to_owned(),
        _ => wording::listed_alone(filter.name()),
    };
    super::show_message(model, text, false);
    Vec::new()
}

/// Why the list that has the keys is not filtered by state; absent if it is.
pub(super) fn not_filtered_by_state(model: &ConsoleModel) -> Option<&'static str> {
    let is_filtered = model.view_state.lists_versions();
    (!is_filtered).then_some(wording::NOT_FILTERED_BY_STATE)
}

/// Why the view's list cannot be sorted; absent if it can.
pub(super) fn unsorted(model: &ConsoleModel) -> Option<&'static str> {
    model.view_state.view.description().fixed_order
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

/// Gives the next pane of the view the keys, or the one before.
pub(crate) fn step_pane(model: &mut ConsoleModel, forward: bool) -> Vec<Effect> {
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
    if model.view_state.view.description().queries_by_pane {
        engine_requests::refresh_now(model)
    } else {
        Vec::new()
    }
}

/// Shows the version under the cursor.
pub(crate) fn choose(model: &mut ConsoleModel) -> Vec<Effect> {
    match model.version_here() {
        Some(version) => {
            model.view_state.chosen = Some(version);
            show(model, View::Candidate)
        }
        None => Vec::new(),
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
        None => super::show_message(model, wording::EVERY_ALARM_ACKNOWLEDGED, false),
    }
    effects
}
