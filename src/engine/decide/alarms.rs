//! Alarms as the engine raises them: into the alarm book, into the store, and published as events.

use crate::decide::recorder::EngineRecorder;
use crate::live::monitors::Monitors;
use holdpoint_governance::alarms::{
    ALARMS_MAX, Alarm, AlarmBook, AlarmChange, AlarmError, AlarmEvent, AlarmKey, AlarmState, Priority,
};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::notice::Notice;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_store::{AuditBody, Change, StoreError};

/// The raised alarms, and when the engine next checks their conditions.
#[derive(Default)]
pub(crate) struct RaisedAlarms {
    book: AlarmBook,
    /// Virtual ms.
    due_ms: u64,
}

impl RaisedAlarms {
    pub(crate) const fn book(&self) -> &AlarmBook {
        &self.book
    }

    /// Whether a check of the conditions is due; if so, the next one is a period later.
    fn take_due(&mut self, now_ms: u64) -> bool {
        let due = now_ms >= self.due_ms;
        if due {
            self.due_ms = now_ms.saturating_add(ALARMS_EVERY_MS);
        }
        due
    }
}

impl EngineRecorder {
    /// Restores the alarms from the store: an alarm that was open before a restart is open again, even if acknowledged.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub(crate) fn recall_alarms(&mut self) -> Result<(), StoreError> {
        let mut rows = self.version_table().store().views()?.alarms()?;
        rows.retain(|entry| entry.state != AlarmState::Normal);
        rows.truncate(ALARMS_MAX);
        let now_ms = self.now_ms();
        for entry in rows {
            // An alarm of another build may be unreadable. It must not be lost: it is raised as a fault.
            let Ok(alarm) = serde_json::from_str::<Alarm>(&entry.json) else {
                let notice = Notice::AlarmUnreadable { alarm: entry.alarm };
                self.raise(AlarmKey::EngineFault, entry.priority, true, notice);
                continue;
            };
            let from = alarm.state();
            let change = AlarmChange::Set { alarm, from, annunciated: false, at_ms: now_ms };
            self.alarms.book.absorb(&[change]);
        }
        self.alarms.book.recount();
        Ok(())
    }

    /// Raises an alarm and publishes it.
    pub(crate) fn raise(&mut self, key: AlarmKey, priority: Priority, latching: bool, notice: Notice) {
        let text = notice.into();
        self.alarm_event(&AlarmEvent::Raise { key, priority, latching, text });
    }

    /// Applies an event to the alarm book, stores the changes and publishes them. If the event is not valid or the store
    /// refuses, the engine halts, without a further alarm. An alarm that finds no place is left out: the book is full of
    /// alarms that are as urgent, and the record has the cause.
    pub(crate) fn alarm_event(&mut self, event: &AlarmEvent) {
        match holdpoint_governance::alarms::apply(self.alarms(), event, self.now_ms(), self.wall_now()) {
            Ok(changes) => {
                if let Err(error) = self.apply_changes(&changes, Vec::new()) {
                    self.hold_silently(&error);
                }
            }
            Err(AlarmError::Full(_)) => {}
            Err(error) => {
                self.hold_silently(&error);
            }
        }
    }

    /// Advances shelves and floods, and clears alarms whose conditions are over. Does nothing in a script, whose clock jumps.
    pub(crate) fn look_at_alarms(&mut self, monitors: &Monitors, works: bool) {
        let now_ms = self.now_ms();
        self.look_at_checkpoints();
        if self.clock().is_scripted() || !self.alarms.take_due(now_ms) {
            return;
        }
        let over: Vec<AlarmKey> = self
            .alarms()
            .iter()
            .filter(|alarm| alarm.condition && self.is_over(&alarm.key, monitors, works))
            .map(|alarm| alarm.key.clone())
            .collect();
        for key in over {
            self.alarm_event(&AlarmEvent::Clear { key });
        }
        self.alarm_event(&AlarmEvent::Tick);
    }

    /// A person's event. A forbidden one is refused and changes nothing.
    pub(crate) fn alarm_command(
        &mut self,
        event: &AlarmEvent,
        done: String,
        monitors: &Monitors,
        works: bool,
    ) -> Reply {
        if let AlarmEvent::Reset { key, .. } = event
            && self.alarms().get(key).is_some_and(|alarm| alarm.condition)
            && self.is_over(key, monitors, works)
        {
            self.alarm_event(&AlarmEvent::Clear { key: key.clone() });
        }
        let changes =
            match holdpoint_governance::alarms::apply(self.alarms(), event, self.now_ms(), self.wall_now()) {
                Ok(changes) => changes,
                Err(error) => return refused(&error),
            };
        match self.apply_changes(&changes, reason_of(event)) {
            Ok(()) => Reply::Accepted { text: done, version: None },
            Err(error) => Reply::refused(Refusal::Store, &error),
        }
    }

    /// Whether the condition of an alarm is over. For a single occurrence it is over at once; the alarm then stays until an
    /// operator resets it. `works`: the last live sequence completed.
    fn is_over(&self, key: &AlarmKey, monitors: &Monitors, works: bool) -> bool {
        match key {
            AlarmKey::RolledBack(_)
            | AlarmKey::Shifted(_)
            | AlarmKey::SharedEvent(_)
            | AlarmKey::Harm(_)
            | AlarmKey::KeptFalse
            | AlarmKey::NameTaken
            | AlarmKey::TelemetryMissed
            | AlarmKey::CameUpStopped => true,
            AlarmKey::Escalated(version) => {
                monitors.of(version).is_none_or(|watched| watched.monitor.escalation().is_none())
            }
            AlarmKey::Restricted(version) => !self.is_restricted(version),
            // The live tasks of the version measure it (`health.rs`); an inactive version runs none.
            AlarmKey::Violation(version) | AlarmKey::Degraded(version) | AlarmKey::OutsideDomain(version) => {
                !self.is_active(version)
            }
            // No live task measures it: it is there again where the rollback target takes over.
            AlarmKey::WeakRecovery(version) => !self.may_act(version),
            // The camera check ends it.
            AlarmKey::CellDegraded => false,
            // A person's start of the cell ends it.
            AlarmKey::CellLost => false,
            AlarmKey::SafeStopped(family) => self.is_in_control(family),
            AlarmKey::NotRecovered(family) => self.is_in_control(family) && works,
            AlarmKey::Unreviewed(version) => !self.is_unreviewed(version),
            // The end of the request or rejection clears it, as does an authorized start.
            AlarmKey::Approval(_) | AlarmKey::Rejected(_) | AlarmKey::ProfileUnauthorized => false,
            AlarmKey::CheckpointFailed => self.version_table().store().checkpoint_problem().is_none(),
            // A person confirms the time.
            AlarmKey::ClockDoubted => self.version_table().wall().clock_mismatch().is_none(),
            // A halted engine stays halted until it restarts.
            AlarmKey::EngineFault => self.holding().is_none(),
        }
    }

    /// Checks that the newest checkpoint was written, and sent to the store's witnesses. The engine continues without.
    fn look_at_checkpoints(&mut self) {
        let key = AlarmKey::CheckpointFailed;
        let raised = self.alarms().get(&key).is_some_and(|alarm| alarm.condition);
        match self.version_table().store().checkpoint_problem() {
            Some(problem) if !raised => {
                self.raise(key, Priority::High, false, Notice::CheckpointFailed { problem });
                self.version_table().store().mark_problems_reported();
            }
            None if raised => self.alarm_event(&AlarmEvent::Clear { key }),
            Some(_) => self.version_table().store().mark_problems_reported(),
            None => {}
        }
    }

    pub(crate) fn is_restricted(&self, version: &CapabilityId) -> bool {
        self.version_table().version(version).is_ok_and(|(_, state, _)| state.flags.restricted)
    }

    /// Whether a version is active, or takes over if the active one leaves.
    fn may_act(&self, version: &CapabilityId) -> bool {
        self.version_table().family(&version.family).is_ok_and(|entry| {
            let Some(active) = entry.state.active() else { return false };
            let target = entry.state.restorable_predecessor(active);
            entry.find(version).is_some_and(|(number, _, _)| number == active || Some(number) == target)
        })
    }

    fn is_active(&self, version: &CapabilityId) -> bool {
        self.version_table().version(version).is_ok_and(|(_, state, _)| state.state == State::Active)
    }

    /// Whether approvers still have to review a version's activation.
    pub(crate) fn is_unreviewed(&self, version: &CapabilityId) -> bool {
        self.version_table().family(&version.family).is_ok_and(|entry| {
            entry.find(version).is_some_and(|(number, _, _)| entry.state.is_unreviewed(number))
        })
    }

    /// Whether a family has an active version that may run.
    fn is_in_control(&self, family: &Family) -> bool {
        self.version_table()
            .family(family)
            .is_ok_and(|entry| !entry.state.safe_stopped && entry.active().is_some())
    }

    /// Adds changes to the store, then to the book, then publishes them. A change that the store refuses has no effect.
    fn apply_changes(&mut self, changes: &[AlarmChange], records: Vec<AuditBody>) -> Result<(), StoreError> {
        let mut stored = Vec::new();
        let mut events = Vec::new();
        for change in changes {
            if let AlarmChange::Set { alarm, .. } = change {
                let state = alarm.state();
                let priority = alarm.priority;
                events.push(EventKind::Alarm {
                    alarm: alarm.key.to_string(),
                    subject: alarm.group.to_string(),
                    state,
                    priority,
                    text: alarm.text.clone(),
                });
                stored.push(Change::AlarmChange {
                    alarm: alarm.key.to_string(),
                    subject: alarm.group.to_string(),
                    state,
                    priority,
                    json: serde_json::to_string(alarm).unwrap_or_else(|_| "{}".to_owned()),
                });
            }
        }
        let written = if stored.is_empty() { Ok(()) } else { self.write(stored, records) };
        // An alarm that cannot be written is shown all the same.
        let raised =
            changes.iter().any(|change| matches!(change, AlarmChange::Set { annunciated: true, .. }));
        if written.is_ok() || raised {
            self.alarms.book.absorb(changes);
            for event in events {
                self.tell(event);
            }
        }
        written
    }
}

/// Interval between checks of the alarms, ms.
const ALARMS_EVERY_MS: u64 = 1_000;

/// The reason a person gave for clearing an alarm; the alarm itself does not contain it.
fn reason_of(event: &AlarmEvent) -> Vec<AuditBody> {
    let AlarmEvent::Reset { key, by, reason } = event else { return Vec::new() };
    let body = serde_json::json!({ "alarm": key, "by": by, "reason": reason.raw() }).to_string();
    vec![AuditBody {
        kind: holdpoint_governance::record::RecordKind::AlarmReset,
        subject: key.to_string(),
        body,
    }]
}

pub(crate) fn refused(error: &AlarmError) -> Reply {
    let code = match error {
        AlarmError::Unknown(_) => Refusal::NotFound,
        AlarmError::Key(_)
        | AlarmError::Identity(_)
        | AlarmError::NoReason(_)
        | AlarmError::ShelfTime { .. } => Refusal::BadInput,
        AlarmError::StillPresent(_) | AlarmError::NotLatched(_) | AlarmError::NotShelved(_) => {
            Refusal::NotNow
        }
        AlarmError::ShelveCritical(_) => Refusal::NotAllowed,
        AlarmError::Full(_) => Refusal::Holding,
    };
    Reply::refused(code, error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decide::stages::rollback::tests::RollbackBench;
    use holdpoint_protocol::command::Command;

    /// A weakness of the rollback target was over as soon as another version was active, though no drill had passed.
    #[test]
    fn a_weakness_stays_while_its_version_may_take_over() {
        let (mut bench, next) = RollbackBench::resting_with_active("align-improved");
        let family = bench.pipeline.record().version_table().family(&next.family).unwrap();
        let weak = family.members[0].capability.id();
        let key = AlarmKey::WeakRecovery(weak.clone());
        let notice = Notice::WeakRecovery { version: Some(weak), reasons: Vec::new() };
        bench.pipeline.live().record.raise(key.clone(), Priority::High, true, notice);
        let reset = |bench: &mut RollbackBench| {
            let (alarm, by, reason) = (key.to_string(), "ana".to_owned(), "inspected".to_owned());
            bench.pipeline.command(Command::ResetAlarm { alarm, by, reason })
        };
        let refused = reset(&mut bench);
        assert!(matches!(refused, Reply::Refused { code: Refusal::NotNow, .. }), "{refused:?}");
        bench.activate("align-low-transit");
        let closed = reset(&mut bench);
        assert!(matches!(closed, Reply::Accepted { .. }), "{closed:?}");
    }
}
