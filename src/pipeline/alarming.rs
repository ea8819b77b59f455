//! Alarms as the pipeline raises them: into the book, into the store, told as events.

use super::manager::{UpgradeManager, word};
use crate::alarms::{AlarmEvent, Priority};
use crate::engine::event::EventKind;
use crate::governance::profile::AlarmPriority;
use crate::registry::Change;

impl UpgradeManager {
    /// Raises an alarm and says so.
    pub(super) fn raise(
        &mut self,
        key: &str,
        group: &str,
        priority: AlarmPriority,
        latching: bool,
        text: &str,
    ) {
        let priority = match priority {
            AlarmPriority::Low => Priority::Low,
            AlarmPriority::Medium => Priority::High,
            AlarmPriority::High => Priority::Critical,
        };
        let event = AlarmEvent::Raise {
            key: key.to_owned(),
            group: group.to_owned(),
            priority,
            latching,
            text: crate::text::Untrusted::new(text),
        };
        self.alarm_event(&event);
    }

    /// Applies an event to the alarm book, keeps it in the store and tells what changed. A book or a
    /// store that refuses makes the engine hold, without a further alarm.
    pub(super) fn alarm_event(&mut self, event: &AlarmEvent) {
        let now_ms = self.clock.now_ms();
        let changes = match crate::alarms::apply(&self.alarms, event, now_ms) {
            Ok(changes) => changes,
            Err(error) => {
                self.holding.get_or_insert_with(|| error.to_string());
                return;
            }
        };
        self.alarms.absorb(&changes);
        let mut stored = Vec::new();
        for change in &changes {
            if let crate::alarms::AlarmChange::Set { alarm, .. } = change {
                let state = word(&alarm.state());
                let priority = word(&alarm.priority);
                self.events.push(EventKind::Alarm {
                    alarm: alarm.key.clone(),
                    subject: alarm.group.clone(),
                    state: state.clone(),
                    priority: priority.clone(),
                    text: alarm.text.line().into_string(),
                });
                stored.push(Change::AlarmChange {
                    alarm: alarm.key.clone(),
                    subject: alarm.group.clone(),
                    state,
                    priority,
                    json: serde_json::to_string(alarm).unwrap_or_else(|_| "{}".to_owned()),
                });
            }
        }
        if !stored.is_empty()
            && let Err(error) = self.ledger.write(stored, Vec::new(), now_ms)
        {
            self.holding.get_or_insert_with(|| error.to_string());
        }
    }
}
