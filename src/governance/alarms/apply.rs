//! The transition function.

use super::{
    ALARMS_MAX, Alarm, AlarmBook, AlarmChange, AlarmError, AlarmEvent, AlarmKey, AlarmState, CHATTER_RAISES,
    Priority, RESERVED_PLACES, SHELF_MS_MAX, Shelving, flood,
};
use crate::ids::is_name;
use crate::notice::NoticeOrText;
use crate::wall_time::WallTime;
use holdpoint_text::Untrusted;

/// The longest key, in bytes.
const KEY_BYTES_MAX: usize = 200;

/// Returns the changes of an event. It does not touch the book; apply them with [`AlarmBook::absorb`].
///
/// `now_ms` is the engine's time, which alarms are counted in; `wall` is the time that shelves end by.
///
/// Clearing an alarm that is not there, or acknowledging one twice, changes nothing and is no error.
///
/// # Errors
/// [`AlarmError`]: the key names no alarm, `by` is no identity, a reset or shelf is not allowed in the alarm's state or
/// lacks its reason, or the book is full.
pub fn apply(
    book: &AlarmBook,
    event: &AlarmEvent,
    now_ms: u64,
    wall: WallTime,
) -> Result<Vec<AlarmChange>, AlarmError> {
    let mut changes = match event {
        AlarmEvent::Raise { key, priority, latching, text } => {
            raise(book, key, (*priority, *latching), text, now_ms)?
        }
        AlarmEvent::Clear { key } => match book.get(key) {
            Some(alarm) if alarm.condition => set(alarm, now_ms, |alarm| alarm.condition = false),
            Some(_) | None => Vec::new(),
        },
        AlarmEvent::Acknowledge { key, by } => {
            let (alarm, by) = (find(book, key)?, identity(by)?);
            if alarm.acknowledged_by.is_some() {
                Vec::new()
            } else {
                set(alarm, now_ms, |alarm| alarm.acknowledged_by = Some(by))
            }
        }
        AlarmEvent::Reset { key, by, reason } => reset(find(book, key)?, identity(by)?, reason, now_ms)?,
        AlarmEvent::Shelve { key, by, until, reason } => shelve(
            find(book, key)?,
            Shelving { until: *until, by: identity(by)?, reason: reason.clone() },
            (now_ms, wall),
        )?,
        AlarmEvent::Unshelve { key, by } => {
            let alarm = find(book, key)?;
            identity(by)?;
            if alarm.shelf.is_none() {
                return Err(AlarmError::NotShelved(quoted(key)));
            }
            unshelve(alarm, now_ms)
        }
        AlarmEvent::Tick => tick(book, now_ms, wall),
    };
    changes.extend(flood_change(book, &changes, now_ms));
    Ok(changes)
}

fn raise(
    book: &AlarmBook,
    key: &AlarmKey,
    (priority, latching): (Priority, bool),
    text: &NoticeOrText,
    now_ms: u64,
) -> Result<Vec<AlarmChange>, AlarmError> {
    if key.to_string().len() > KEY_BYTES_MAX {
        return Err(AlarmError::Key(quoted(key)));
    }
    let mut changes = Vec::new();
    let mut alarm = match book.get(key) {
        Some(alarm) => alarm.clone(),
        None => {
            let places = if priority == Priority::Low { ALARMS_MAX - RESERVED_PLACES } else { ALARMS_MAX };
            if book.alarms.len() >= places {
                changes
                    .extend(make_room(book, priority, now_ms).ok_or_else(|| AlarmError::Full(quoted(key)))?);
            }
            normal(key, now_ms)
        }
    };
    let from = book.get(key).map_or(AlarmState::Normal, Alarm::state);
    // While it is there it may become more urgent, never less; the operator is then called again.
    let urgent = alarm.condition && priority < alarm.priority;
    let appears = !alarm.condition;
    if !appears && !urgent && alarm.text.covers(text) && (alarm.latching || !latching) {
        return Ok(Vec::new());
    }
    if appears {
        let over = alarm.state_below() == AlarmState::Normal;
        // Neither does an episode that still waits for the operator become less urgent by coming again.
        alarm.priority = if over { priority } else { alarm.priority.min(priority) };
        alarm.latching = latching || (alarm.latching && !over);
        if over {
            alarm.first_ms = now_ms;
        }
        alarm.raises = alarm.raises.saturating_add(1);
        if alarm.raises_ms.len() >= CHATTER_RAISES {
            alarm.raises_ms.remove(0);
        }
        alarm.raises_ms.push(now_ms);
    } else {
        alarm.priority = alarm.priority.min(priority);
        alarm.latching |= latching;
    }
    let called = appears || urgent;
    if called {
        alarm.acknowledged_by = None;
    }
    alarm.condition = true;
    alarm.reset_pending = alarm.latching;
    alarm.text = text.clone();
    // A critical alarm does not stay shelved.
    if alarm.priority == Priority::Critical {
        alarm.shelf = None;
    }
    let annunciated = called && alarm.shelf.is_none();
    changes.push(AlarmChange::Set { alarm, from, annunciated, at_ms: now_ms });
    Ok(changes)
}

/// Drops one alarm for a new one of this priority: the oldest normal one, else the least urgent returned one, else one that
/// is less urgent. Of equally urgent ones the oldest goes. An alarm that waits for its reset stays. `None` if none can go.
fn make_room(book: &AlarmBook, priority: Priority, now_ms: u64) -> Option<Vec<AlarmChange>> {
    let place = |alarm: &Alarm| {
        let state = alarm.state();
        if state == AlarmState::Normal {
            return Some(0);
        }
        let returned = state == AlarmState::ReturnedUnacknowledged && !alarm.reset_pending;
        if returned && alarm.priority >= priority {
            return Some(1);
        }
        (alarm.priority > priority && !alarm.reset_pending).then_some(2)
    };
    let leaves = book
        .iter()
        .filter_map(|alarm| Some((place(alarm)?, std::cmp::Reverse(alarm.priority), alarm)))
        .min_by_key(|(place, urgency, alarm)| (*place, *urgency, alarm.raises_ms.last().copied()));
    let (_, _, alarm) = leaves?;
    let mut changes = Vec::new();
    // The store keeps the row of a dropped alarm: without this change a returned one would be open after a restart.
    if alarm.state() == AlarmState::ReturnedUnacknowledged {
        changes.extend(set(alarm, now_ms, |alarm| alarm.acknowledged_by = Some(String::new())));
    }
    changes.push(AlarmChange::Dropped { key: alarm.key.clone() });
    Some(changes)
}

fn reset(alarm: &Alarm, by: String, reason: &Untrusted, now_ms: u64) -> Result<Vec<AlarmChange>, AlarmError> {
    let key = || quoted(&alarm.key);
    if !alarm.reset_pending {
        return Err(AlarmError::NotLatched(key()));
    }
    if alarm.condition {
        return Err(AlarmError::StillPresent(key()));
    }
    if reason.is_blank() {
        return Err(AlarmError::NoReason(key()));
    }
    Ok(set(alarm, now_ms, |alarm| {
        alarm.reset_pending = false;
        alarm.acknowledged_by.get_or_insert(by);
    }))
}

fn shelve(
    alarm: &Alarm,
    shelf: Shelving,
    (now_ms, wall): (u64, WallTime),
) -> Result<Vec<AlarmChange>, AlarmError> {
    let key = || quoted(&alarm.key);
    if alarm.priority == Priority::Critical {
        return Err(AlarmError::ShelveCritical(key()));
    }
    if shelf.reason.is_blank() {
        return Err(AlarmError::NoReason(key()));
    }
    let requested_ms = shelf.until.ms().saturating_sub(wall.ms());
    if requested_ms <= 0 || requested_ms.unsigned_abs() > SHELF_MS_MAX {
        return Err(AlarmError::ShelfTime { requested_ms, max_ms: SHELF_MS_MAX });
    }
    Ok(set(alarm, now_ms, |alarm| alarm.shelf = Some(shelf)))
}

/// An alarm that is still unacknowledged below its shelf calls again when the shelf ends.
fn unshelve(alarm: &Alarm, now_ms: u64) -> Vec<AlarmChange> {
    let from = alarm.state();
    let alarm = Alarm { shelf: None, ..alarm.clone() };
    let annunciated = alarm.state() == AlarmState::Unacknowledged;
    vec![AlarmChange::Set { alarm, from, annunciated, at_ms: now_ms }]
}

fn tick(book: &AlarmBook, now_ms: u64, wall: WallTime) -> Vec<AlarmChange> {
    let mut changes = Vec::new();
    for alarm in book.iter() {
        if alarm.shelf.as_ref().is_some_and(|shelf| shelf.until <= wall) {
            changes.extend(unshelve(alarm, now_ms));
        } else if alarm.state() == AlarmState::Normal
            && alarm
                .raises_ms
                .last()
                .is_none_or(|last| now_ms.saturating_sub(*last) >= flood::FLOOD_WINDOW_MS)
        {
            changes.push(AlarmChange::Dropped { key: alarm.key.clone() });
        }
    }
    changes
}

fn flood_change(book: &AlarmBook, changes: &[AlarmChange], now_ms: u64) -> Option<AlarmChange> {
    let mut annunciated_ms = book.annunciated_ms.clone();
    for change in changes {
        if let AlarmChange::Set { annunciated: true, at_ms, .. } = change {
            flood::note(&mut annunciated_ms, *at_ms);
        }
    }
    let on = flood::is_flood(&annunciated_ms, book.flood, now_ms);
    (on != book.flood).then_some(AlarmChange::Flood { on })
}

/// A change that calls for no attention.
fn set(alarm: &Alarm, now_ms: u64, change: impl FnOnce(&mut Alarm)) -> Vec<AlarmChange> {
    let from = alarm.state();
    let mut alarm = alarm.clone();
    change(&mut alarm);
    vec![AlarmChange::Set { alarm, from, annunciated: false, at_ms: now_ms }]
}

/// An alarm that was never raised: acknowledged by no one in particular, so that its state is normal.
fn normal(key: &AlarmKey, now_ms: u64) -> Alarm {
    Alarm {
        key: key.clone(),
        group: key.kind().topic(),
        priority: Priority::Low,
        latching: false,
        text: NoticeOrText::default(),
        condition: false,
        acknowledged_by: Some(String::new()),
        reset_pending: false,
        shelf: None,
        first_ms: now_ms,
        raises_ms: Vec::new(),
        raises: 0,
    }
}

fn find<'a>(book: &'a AlarmBook, key: &AlarmKey) -> Result<&'a Alarm, AlarmError> {
    book.get(key).ok_or_else(|| AlarmError::Unknown(quoted(key)))
}

fn quoted(key: &AlarmKey) -> Untrusted {
    Untrusted::new(key.to_string())
}

fn identity(by: &str) -> Result<String, AlarmError> {
    if is_name(by) { Ok(by.to_owned()) } else { Err(AlarmError::Identity(by.into())) }
}
