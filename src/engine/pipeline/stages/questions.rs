//! A monitor's question to people: shown while it waits, answered with "go on", told again when it comes again.
//!
//! Owns the answer and its record. What a question is raised for, and what becomes of one that nobody answers, is
//! the monitor's. An answer lifts no restriction and confirms nothing.

use crate::pipeline::manager::{Fault, UpgradeManager};
use crate::pipeline::stages::monitoring::ms_of;
use holdpoint_governance::alarms::AlarmEvent;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::monitor::{MonitorAction, normal_rates};
use holdpoint_protocol::command::{Operation, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::snapshot::{MonitorView, QuestionView};
use holdpoint_registry::AuditBody;
use holdpoint_text::Untrusted;

impl UpgradeManager {
    /// Somebody answers a monitor's question: the version goes on, its charts begin anew.
    pub(in crate::pipeline) fn go_on(&mut self, operation: &Operation) -> Result<Reply, Fault> {
        let id = self.checked(operation)?;
        let now_tick = self.now_tick();
        let asks = |watch: &&mut super::monitoring::Watch| {
            watch.id == id && watch.monitor.escalation().is_some_and(|asked| asked.deadline_tick > now_tick)
        };
        let expected = self.dossiers.get(&id).and_then(|dossier| normal_rates(&dossier.twins));
        let (Some(expected), Some(watch)) = (expected, self.watches.get_mut(&id.family).filter(asks)) else {
            return Ok(Reply::Refused {
                code: Refusal::NotNow,
                text: format!("no monitor asks about {id}"),
                hint: Some("open questions are in `holdpoint status`".to_owned()),
            });
        };
        watch
            .monitor
            .answered(&self.profile, &expected, now_tick)
            .map_err(|error| Fault::Impossible(error.to_string()))?;
        // The next question is a new one.
        watch.told = MonitorAction::Continue;
        watch.asked = None;
        watch.question.clear();
        let body = serde_json::json!({ "answer": "go-on", "by": operation.by, "reason": operation.reason });
        let record = AuditBody {
            kind: holdpoint_governance::record::RecordKind::MonitorAnswer,
            subject: id.to_string(),
            body: body.to_string(),
        };
        let at_ms = self.clock.now_ms();
        self.ledger.write(Vec::new(), vec![record], at_ms)?;
        self.emit(EventKind::Continued {
            version: id.clone(),
            by: Untrusted::new(operation.by.clone()).line().into_string(),
            reason: Untrusted::new(operation.reason.clone()).line().into_string(),
        });
        self.alarm_event(&AlarmEvent::Clear { key: format!("escalated:{id}") });
        Ok(Reply::Accepted { text: format!("{id} goes on"), version: Some(id) })
    }

    /// Whether a monitor asks about a version.
    pub(in crate::pipeline) fn has_question(&self, id: &CapabilityId) -> bool {
        let watch = self.watches.get(&id.family).filter(|watch| watch.id == *id);
        watch.is_some_and(|watch| watch.monitor.escalation().is_some())
    }

    /// Questions that wait for an answer.
    #[must_use]
    pub fn questions(&self) -> Vec<QuestionView> {
        let open = self.watches.values().filter_map(|watch| {
            let asked = watch.monitor.escalation()?;
            Some(QuestionView {
                version: watch.id.clone(),
                reasons: watch.question.clone(),
                deadline_ms: ms_of(asked.deadline_tick),
            })
        });
        open.collect()
    }

    /// Every monitor's charts against their limits.
    #[must_use]
    pub fn monitor_views(&self) -> Vec<MonitorView> {
        let needed = self.profile.activation.provisional_episodes;
        let view = |watch: &super::monitoring::Watch| MonitorView {
            version: watch.id.clone(),
            episodes: watch.episodes,
            needed,
            restricted: watch.restricted,
            charts: watch
                .monitor
                .charts()
                .map(|(rate, chart, stands, limit)| (format!("{} {chart}", rate.name()), stands, limit))
                .collect(),
        };
        self.watches.values().map(view).collect()
    }
}

#[cfg(test)]
mod tests;
