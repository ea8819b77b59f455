//! Moving about: cursors, panes, branches, and what Enter opens.

use super::{asking, marking, refuse, show, why};
use crate::action::Action;
use crate::audit;
use crate::effect::Effect;
use crate::model::{HISTORY_PANE, ListCursor, Model, OpenedRecord, Overlay, STORY_PANE, SortOrder, View};
use crate::prompt::Prompt;
use crate::rows::{RegistryItem, WaitingItem};
use holdpoint_governance::ids::Family;
use holdpoint_protocol::snapshot::AlarmView;

/// How long keys that aim at an item wait after another one came under the cursor by itself, ms: the time in which
/// a key that is pressed was decided on before.
const SLIP_MS: u64 = 700;

/// Rows kept in sight when a page is turned.
const PAGE_OVERLAP: usize = 12;

pub(super) fn go(model: &mut Model, action: Action) -> Vec<Effect> {
    let page = usize::from(model.size.1).saturating_sub(PAGE_OVERLAP).max(1);
    if model.place.view == View::Audit && model.place.opened.is_some() {
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

/// Moves over the lines of a raw record; Enter closes it as it opened it.
fn in_record(model: &mut Model, action: Action, page: usize) -> Vec<Effect> {
    let last = model.opened_record().map_or(0, |record| audit::raw(record).len().saturating_sub(1));
    let Some(opened) = &mut model.place.opened else { return Vec::new() };
    opened.scroll = match action {
        Action::Up => opened.scroll.saturating_sub(1),
        Action::Down => opened.scroll.saturating_add(1).min(last),
        Action::PageUp => opened.scroll.saturating_sub(page),
        Action::PageDown => opened.scroll.saturating_add(page).min(last),
        Action::Top => 0,
        Action::Bottom => last,
        _ => {
            model.place.opened = None;
            return Vec::new();
        }
    };
    Vec::new()
}

pub(super) fn wheel(model: &mut Model, rows: i32) -> Vec<Effect> {
    let by = rows.unsigned_abs() as usize;
    let row = model.row();
    let last = model.row_count().saturating_sub(1);
    if model.entry.overlay.is_none() && model.entry.typing.is_none() {
        set_row(model, if rows < 0 { row.saturating_sub(by) } else { row.saturating_add(by).min(last) });
    }
    Vec::new()
}

pub(super) fn set_row(model: &mut Model, row: usize) {
    let item = model.item_key(row);
    model.place.cursors.insert(model.place.list(), ListCursor { row, item });
}

/// Puts the cursor back on its item after the list may have changed. `by_itself`: no key changed it.
pub(super) fn follow(model: &mut Model, by_itself: bool) {
    let row = model.row();
    let here = model.item_key(row);
    let cursor = model.place.cursors.get(&model.place.list());
    let item = cursor.and_then(|cursor| cursor.item.clone());
    if item.is_some() && item == here {
        return;
    }
    // What tells of time goes on under a cursor at its end: the newest is what is looked at there.
    let tells_of_time = match (model.place.view, model.place.pane()) {
        (View::Overview, pane) => pane == STORY_PANE,
        (View::Audit, _) => true,
        (View::Alarms, pane) => pane == HISTORY_PANE,
        (View::Registry | View::Candidate | View::Shadow | View::Approvals | View::Health, _) => false,
    };
    let at = item.as_ref().filter(|_| row > 0 || !tells_of_time).and_then(|item| model.row_of(item));
    if at.is_none() && item.is_some() && by_itself && !tells_of_time {
        model.place.slipped_ms = Some(model.now_ms);
    }
    set_row(model, at.unwrap_or(row));
}

/// Whether what was under the cursor went away so recently that a key may have been meant for it.
pub(super) fn has_slipped(model: &Model) -> bool {
    model.place.slipped_ms.is_some_and(|at_ms| model.now_ms.saturating_sub(at_ms) < SLIP_MS)
}

/// The next column of the registry's rows, or the other way round. Every other list has its order for a reason.
pub(super) fn sort(model: &mut Model, action: Action) -> Vec<Effect> {
    if let Some(why) = unsorted(model) {
        return refuse(model, why);
    }
    let SortOrder { by, reversed } = model.told.registry.sort;
    let sort = match action {
        Action::Sort => SortOrder { by: by.next(), reversed: false },
        _ => SortOrder { by, reversed: !reversed },
    };
    model.told.registry.sort_by(sort);
    let way = if sort.reversed { ", turned round" } else { "" };
    super::tell(model, format!("sorted by {}{way}", sort.by.words()), false);
    Vec::new()
}

/// Why the list of the view is in no other order; absent if it can be.
pub(super) const fn unsorted(model: &Model) -> Option<&'static str> {
    match model.place.view {
        View::Registry => None,
        View::Alarms => Some("alarms stand in the order of attention"),
        View::Approvals => Some("what waits stands in the order of its deadlines"),
        View::Overview | View::Candidate | View::Shadow | View::Audit | View::Health => {
            Some("this list stands in the order in which things happened; the registry can be sorted")
        }
    }
}

/// In the registry the branch opens and closes; elsewhere the pane changes.
fn sideways(model: &mut Model, right: bool) -> Vec<Effect> {
    if model.place.view == View::Health {
        return super::health::step(model, right);
    }
    if model.place.view != View::Registry || model.told.registry.is_flat() {
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

fn set_branch(model: &mut Model, family: Family, open: bool) {
    if open {
        model.told.registry.closed.remove(&family);
        return;
    }
    model.told.registry.closed.insert(family.clone());
    // The cursor goes to what was closed.
    let is_it =
        |item: &RegistryItem<'_>| matches!(item, RegistryItem::Family { family: of, .. } if **of == family);
    if let Some(row) = model.registry_rows().iter().position(is_it) {
        set_row(model, row);
    }
}

fn step_pane(model: &mut Model, forward: bool) -> Vec<Effect> {
    let count = model.place.view.panes().len().max(1);
    let next = if forward { model.place.pane() + 1 } else { model.place.pane() + count - 1 } % count;
    to_pane(model, next)
}

/// Gives a pane of the view the keys.
pub(super) fn to_pane(model: &mut Model, next: usize) -> Vec<Effect> {
    if let Some(pane) = model.place.panes.get_mut(model.place.view as usize) {
        *pane = next;
    }
    if matches!(model.place.view, View::Registry | View::Alarms | View::Audit) {
        asking::refresh_now(model)
    } else {
        Vec::new()
    }
}

/// Enter: opens what is under the cursor. It changes nothing outside this console.
fn open(model: &mut Model) -> Vec<Effect> {
    match model.place.view {
        View::Registry => {
            if let Some(RegistryItem::Family { family, open, .. }) = model.registry_rows().get(model.row()) {
                let (family, open) = ((*family).clone(), *open);
                set_branch(model, family, !open);
                return Vec::new();
            }
            choose(model)
        }
        View::Overview => choose(model),
        View::Audit => {
            let seq = model.audit_rows().get(model.row()).map(|row| row.record.seq);
            model.place.opened = seq.map(|seq| OpenedRecord { seq, scroll: 0 });
            Vec::new()
        }
        View::Shadow => show(model, View::Candidate),
        View::Candidate => {
            if why::open(model) {
                return Vec::new();
            }
            step_pane(model, true)
        }
        View::Alarms => match model.version_here() {
            Some(version) => {
                model.place.chosen = Some(version);
                show(model, View::Candidate)
            }
            None => Vec::new(),
        },
        View::Health => choose(model),
        View::Approvals => open_waiting(model),
    }
}

fn choose(model: &mut Model) -> Vec<Effect> {
    match model.version_here() {
        Some(version) => {
            model.place.chosen = Some(version);
            show(model, View::Candidate)
        }
        None => Vec::new(),
    }
}

/// A waiting approval opens its prompt; a monitor's question opens the version, its answers are keys of their own.
fn open_waiting(model: &mut Model) -> Vec<Effect> {
    let prompt = match model.waiting_rows().get(model.row()) {
        Some(WaitingItem::Prompt(question)) => {
            model.told.snapshot.as_ref().map(|snapshot| Prompt::open(question, snapshot, model.now_ms))
        }
        Some(WaitingItem::Question(question)) => {
            model.place.chosen = Some(question.version.clone());
            return show(model, View::Candidate);
        }
        None => return refuse(model, "nothing waits for people"),
    };
    match prompt {
        Some(prompt) => {
            model.entry.overlay = Some(Overlay::Prompt(Box::new(prompt)));
            Vec::new()
        }
        None => refuse(model, "the candidate is gone"),
    }
}

/// The highest alarm nobody has acknowledged, whatever the view.
pub(super) fn jump_to_alarm(model: &mut Model) -> Vec<Effect> {
    if let Some(pane) = model.place.panes.get_mut(View::Alarms as usize) {
        *pane = 0;
    }
    let rows = model.alarm_rows();
    let highest = rows
        .iter()
        .enumerate()
        .filter(|(_, item)| item.alarm().state.calls())
        .min_by_key(|(_, item)| item.alarm().attention())
        .map(|(row, _)| row);
    let effects = show(model, View::Alarms);
    match highest {
        Some(row) => set_row(model, row),
        None => super::tell(model, "every alarm is acknowledged", false),
    }
    effects
}

/// What Copy takes: the value a person would want to paste elsewhere.
pub(super) fn copied(model: &Model) -> Option<String> {
    match model.place.view {
        View::Health => model.health_verdict().map(|verdict| verdict.sentence()),
        View::Alarms if model.place.pane() == HISTORY_PANE => {
            let spell = model.alarm_spells().get(model.row()).copied()?;
            Some(format!("{} {}: {}", spell.alarm, spell.state, spell.text.as_deref().unwrap_or("")))
        }
        View::Alarms => {
            let rows = model.alarm_rows();
            let said = |alarm: &AlarmView| {
                format!("{} {} {}: {}", alarm.priority, alarm.state, alarm.alarm, alarm.text)
            };
            let of_marked = model.told.snapshot.iter().flat_map(|now| &now.alarms);
            let of_marked = of_marked.filter(|alarm| model.place.marked.contains(&alarm.alarm));
            let marked: Vec<String> = of_marked.map(said).collect();
            if marked.is_empty() {
                Some(said(rows.get(model.row())?.alarm()))
            } else {
                Some(marked.join("\n"))
            }
        }
        View::Audit => {
            let rows = model.audit_rows();
            let row = model.opened_record().or_else(|| rows.get(model.row()).map(|row| row.record))?;
            Some(format!("{} {} {} {} {}", row.seq, row.kind, row.subject, row.hash, row.body))
        }
        View::Overview if model.place.pane() == STORY_PANE => {
            model.story_rows().get(model.row()).map(|told| told.text.clone())
        }
        View::Overview | View::Registry | View::Candidate | View::Shadow | View::Approvals => {
            let marked: Vec<String> = marking::versions(model).iter().map(ToString::to_string).collect();
            if marked.is_empty() {
                return model.version_here().map(|version| version.to_string());
            }
            Some(marked.join("\n"))
        }
    }
}
