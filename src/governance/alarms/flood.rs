//! Alarm floods: when many come at once, they are shown by group with the first one on top.

use super::{Alarm, AlarmBook, AlarmState, Priority};

/// A flood begins when more than this many alarms called for attention within [`FLOOD_WINDOW_MS`].
pub const FLOOD_START: usize = 10;

/// A flood ends when fewer than this many did.
pub const FLOOD_END: usize = 5;

/// The span over which flood rates are counted, ms: ten minutes (ISA-18.2).
pub const FLOOD_WINDOW_MS: u64 = 600_000;

/// One row of the alarm list.
#[derive(Clone, Debug, PartialEq)]
pub struct AlarmGroup<'a> {
    /// The first one: it is most often the cause.
    pub first: &'a Alarm,
    /// All of the row in the order they came, the first included.
    pub members: Vec<&'a Alarm>,
}

/// The open alarms as rows: each by itself, but in a flood those of one group together; critical and shelved
/// ones are never grouped.
#[must_use]
pub fn grouped(book: &AlarmBook) -> Vec<AlarmGroup<'_>> {
    let mut rows: Vec<AlarmGroup<'_>> = Vec::new();
    for alarm in book.open() {
        let groups = |a: &Alarm| a.priority != Priority::Critical && a.state() != AlarmState::Shelved;
        let same = |row: &&mut AlarmGroup<'_>| groups(row.first) && row.first.group == alarm.group;
        match rows.iter_mut().find(same) {
            Some(row) if book.is_flooded() && groups(alarm) => {
                row.members.push(alarm);
                if (alarm.first_ms, &alarm.key) < (row.first.first_ms, &row.first.key) {
                    row.first = alarm;
                }
            }
            Some(_) | None => rows.push(AlarmGroup { first: alarm, members: vec![alarm] }),
        }
    }
    for row in &mut rows {
        row.members.sort_by(|a, b| (a.first_ms, &a.key).cmp(&(b.first_ms, &b.key)));
    }
    rows
}

/// Remembers that an alarm called for attention; more than [`FLOOD_START`] + 1 times need not be known.
pub(super) fn note(annunciated_ms: &mut Vec<u64>, at_ms: u64) {
    if annunciated_ms.len() > FLOOD_START {
        annunciated_ms.remove(0);
    }
    annunciated_ms.push(at_ms);
}

/// How many alarms called for attention within [`FLOOD_WINDOW_MS`]; more than [`FLOOD_START`] + 1 are counted as so many.
pub(super) fn recent(annunciated_ms: &[u64], now_ms: u64) -> usize {
    annunciated_ms.iter().filter(|at| now_ms.saturating_sub(**at) < FLOOD_WINDOW_MS).count()
}

/// Whether there is a flood, given whether there was one.
pub(super) fn is_flood(annunciated_ms: &[u64], was: bool, now_ms: u64) -> bool {
    let recent = recent(annunciated_ms, now_ms);
    if was { recent >= FLOOD_END } else { recent > FLOOD_START }
}
