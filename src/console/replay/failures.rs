//! The moments at which a version went wrong: its failures in re-run parts, its violations in the live cell, and the
//! decision against it.
//!
//! Reads events and marks; judges nothing itself.

use super::time_mark::TimeMark;
use crate::look::ThemeRole;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_recordings::recording::Recording;

/// See the module's head.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failures {
    /// Every such moment, virtual ms, in order.
    times_ms: Vec<u64>,
    /// The decision against the version for its own conduct; absent if the last decision favored it.
    decided_ms: Option<u64>,
    /// The decisions about the version: virtual ms, and whether each is against it.
    decisions: Vec<(u64, bool)>,
}

impl Failures {
    /// Of a recording in order of time, with the mark of each event.
    #[must_use]
    pub fn of(recording: &Recording, marks: &[Option<TimeMark>]) -> Self {
        let version = &recording.about.version;
        let turns: Vec<(&Event, bool)> = recording
            .events
            .iter()
            .zip(marks)
            .filter(|(event, _)| decides(&event.kind, version))
            .filter_map(|(event, mark)| {
                let mark = mark.filter(|mark| mark.is_turn)?;
                Some((event, mark.role == ThemeRole::Bad))
            })
            .collect();
        let last_good = turns.iter().rposition(|(_, is_bad)| !is_bad);
        let mut against = turns.iter().skip(last_good.map_or(0, |place| place + 1));
        let decided_ms = against.find(|(event, _)| blames(&event.kind)).map(|(event, _)| event.at_ms);
        let violations = recording.events.iter().filter(|event| violates(&event.kind, version));
        let failures = recording.films.iter().flat_map(|film| &film.failures);
        let mut times_ms: Vec<u64> = failures.map(|failure| failure.at_ms).chain(decided_ms).collect();
        times_ms.extend(violations.map(|event| event.at_ms));
        times_ms.sort_unstable();
        times_ms.dedup();
        let decisions = turns.iter().map(|(event, is_bad)| (event.at_ms, *is_bad)).collect();
        Self { times_ms, decided_ms, decisions }
    }

    /// Every moment, virtual ms, in order.
    #[must_use]
    pub fn times_ms(&self) -> &[u64] {
        &self.times_ms
    }

    /// The decision against the version, virtual ms.
    #[must_use]
    pub const fn decided_ms(&self) -> Option<u64> {
        self.decided_ms
    }

    /// The first moment after `at_ms`, or the first of all.
    #[must_use]
    pub fn next_ms(&self, at_ms: u64) -> Option<u64> {
        let next = self.times_ms.iter().find(|time_ms| **time_ms > at_ms);
        next.or_else(|| self.times_ms.first()).copied()
    }

    /// Whether the next decision is against the version, or the last one if none follows. Without a decision, a value
    /// past its limit counts as bad.
    #[must_use]
    pub fn ends_badly(&self, at_ms: u64) -> bool {
        let next = self.decisions.iter().find(|(time_ms, _)| *time_ms >= at_ms);
        next.or_else(|| self.decisions.last()).is_none_or(|(_, is_bad)| *is_bad)
    }
}

/// Whether an event decides about the version. A break-glass replaces a decision, and a review follows one.
fn decides(kind: &EventKind, version: &CapabilityId) -> bool {
    match kind {
        EventKind::RolledBack { version: of, .. }
        | EventKind::Monitor { version: of, .. }
        | EventKind::Decided { version: of, .. }
        | EventKind::StateChanged { version: of, .. }
        | EventKind::ApprovalReceived { version: of, .. }
        | EventKind::Activated { version: of, .. }
        | EventKind::Confirmed { version: of, .. }
        | EventKind::Continued { version: of, .. }
        | EventKind::Released { version: of, .. } => of == version,
        _ => false,
    }
}

/// Whether a decision against the version is about its conduct. A rollback by a person, or by an engine that came up, is
/// no failure of the version.
fn blames(kind: &EventKind) -> bool {
    let EventKind::RolledBack { record, .. } = kind else { return true };
    record.trigger.kind.is_by_monitor()
}

/// Whether a task of the version violated a limit in the live cell.
fn violates(kind: &EventKind, version: &CapabilityId) -> bool {
    let EventKind::Sequence { tasks, .. } = kind else { return false };
    tasks.iter().any(|task| task.version == *version && task.violation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_decision_tells_whether_a_value_was_tolerated() {
        let failures = Failures {
            times_ms: vec![10, 30],
            decided_ms: Some(30),
            decisions: vec![(20, false), (30, true), (31, true)],
        };
        for (at_ms, badly, next_ms) in
            [(0, false, 10), (10, false, 30), (20, false, 30), (21, true, 30), (99, true, 10)]
        {
            assert_eq!(
                (failures.ends_badly(at_ms), failures.next_ms(at_ms)),
                (badly, Some(next_ms)),
                "{at_ms}"
            );
        }
        let unknown = Failures { times_ms: Vec::new(), decided_ms: None, decisions: Vec::new() };
        assert_eq!((unknown.ends_badly(5), unknown.next_ms(5)), (true, None));
    }
}
