//! Stage 6: the live world under watch. Every activation has a monitor before its first tick.

use holdpoint_governance::decision::{Reason, ReasonCode};
use holdpoint_protocol::clock::tick_of;
use holdpoint_protocol::event::{EventKind, TaskSummary};

use crate::pipeline::ledger::Note;
use crate::pipeline::live::{Nobody, SequenceReport};
use crate::pipeline::manager::{Fault, UpgradeManager};
use crate::pipeline::painter::{Drawn, Painter};
use crate::pipeline::sentry::{Trip, safety_events};
use crate::pipeline::sequence::Worked;
use crate::pipeline::shadow::Shadow;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Event, Leave};
use holdpoint_governance::monitor::{Monitor, MonitorAction, MonitorDecision, normal_rates};
use holdpoint_governance::rollback::{Trigger, TriggerKind};
use holdpoint_registry::{AuditBody, Batch};
use holdpoint_runtime::task::TaskRecord;

/// Sequences whose success is kept for display.
const RECENT: usize = 50;

/// The monitor of one activation.
#[derive(Clone)]
pub struct Watch {
    pub(in crate::pipeline) id: CapabilityId,
    pub(in crate::pipeline) monitor: Monitor,
    pub(in crate::pipeline) episodes: u32,
    pub(in crate::pipeline) restricted: bool,
    pub(in crate::pipeline) confirmed: bool,
    /// The gravest thing it has asked for.
    pub(in crate::pipeline) told: MonitorAction,
    /// What its first question was raised for.
    pub(in crate::pipeline) asked: Option<ReasonCode>,
    /// Why it asks people now; empty where it does not.
    pub(in crate::pipeline) question: Vec<Reason>,
}

impl UpgradeManager {
    /// A monitor for a version about to be activated. What is normal is what its twins did in the
    /// live world, at the unfavourable end of what so few of them can tell.
    pub(in crate::pipeline) fn new_watch(&mut self, id: &CapabilityId) -> Result<Watch, Fault> {
        let expected = normal_rates(&self.dossier(id).twins)
            .ok_or_else(|| Fault::Impossible(format!("{id} has no shadow evidence to monitor it against")))?;
        let monitor = Monitor::new(&self.profile, &expected, self.now_tick())
            .map_err(|error| Fault::Impossible(error.to_string()))?;
        Ok(Watch {
            id: id.clone(),
            monitor,
            episodes: 0,
            restricted: false,
            confirmed: false,
            told: MonitorAction::Continue,
            asked: None,
            question: Vec::new(),
        })
    }

    pub(in crate::pipeline) fn now_tick(&self) -> u64 {
        tick_of(self.clock.now_ms())
    }

    /// One sequence of the live world; monitors learn from it.
    pub(in crate::pipeline) fn live_sequence(
        &mut self,
        shadow: Option<&mut Shadow>,
    ) -> Result<SequenceReport, Fault> {
        let begun = self.begin_sequence()?;
        let worked = match (self.pictures.clone(), shadow) {
            (Some(pictures), shadow) => {
                let painter = Painter::new(pictures, self.clock.clone(), begun.index(), begun.workers());
                let mut drawn = Drawn { painter, shadow };
                let worked = begun.work(&mut drawn);
                drawn.painter.rest(worked.outing.world(), false);
                worked
            }
            (None, Some(shadow)) => begun.work(shadow),
            (None, None) => begun.work(&mut Nobody),
        };
        self.end_sequence(worked)
    }

    /// What a worked sequence comes to: the monitors take it in, and what they ask for is done.
    pub(in crate::pipeline) fn end_sequence(&mut self, worked: Worked) -> Result<SequenceReport, Fault> {
        let Worked { index, outing, report, sentry, link_up, stopped, shadow: _ } = worked;
        self.live.take_back(outing);
        let (watches, mut raised) = sentry.stand_down();
        for (family, watch) in watches {
            // A version that was taken off or replaced meanwhile has no monitor any more.
            if let Some(own) = self.watches.get_mut(&family).filter(|own| own.id == watch.id) {
                // A question that was told meanwhile is still the same question.
                let (asked, question) = (own.asked, std::mem::take(&mut own.question));
                *own = watch;
                own.asked = own.asked.or(asked);
                if own.question.is_empty() {
                    own.question = question;
                }
            }
        }
        self.clock.advance(report.duration_ms);
        let tasks: Vec<TaskSummary> = report.tasks.iter().map(summary).collect();
        let stopped = stopped.is_some();
        // Work that a person stopped is neither done nor failed.
        if !stopped {
            self.recent.push_back(report.succeeded());
        }
        if self.recent.len() > RECENT {
            self.recent.pop_front();
        }
        self.last_tasks.clone_from(&tasks);
        self.emit(EventKind::Sequence {
            index,
            success: report.succeeded(),
            tasks,
            refused: if stopped {
                Some("the arm was stopped".to_owned())
            } else {
                report.refused.as_ref().map(ToString::to_string)
            },
        });
        for (place, dispatched) in report.tasks.iter().enumerate() {
            let id = &dispatched.id;
            // Nothing of a task reaches the monitors while the link is down.
            if link_up {
                self.keep_telemetry(id, &dispatched.record, report.duration_ms)?;
            }
            let (ours, others): (Vec<_>, Vec<_>) = raised.into_iter().partition(|raised| raised.id == *id);
            raised = others;
            let tripped = ours.iter().any(|raised| raised.decision.action == MonitorAction::Rollback);
            for raised in ours {
                self.act_on(id, &raised.decision, raised.trip.as_ref())?;
            }
            let cut_short = stopped && place + 1 == report.tasks.len();
            if link_up && !tripped && !cut_short {
                self.watch(id, &dispatched.record)?;
            }
        }
        Ok(report)
    }

    pub(in crate::pipeline) fn terms_of_profile(&self) -> holdpoint_runtime::terms::Terms {
        holdpoint_runtime::terms::Terms::new(
            &self.profile,
            self.table.clone(),
            self.cell.geometry.clone(),
            self.cell.zones.clone(),
        )
    }

    /// Keeps what a watched version did, record and path, in the telemetry file; its digest enters the chain.
    fn keep_telemetry(
        &mut self,
        id: &CapabilityId,
        record: &TaskRecord,
        duration_ms: u64,
    ) -> Result<(), Fault> {
        if self.watches.get(&id.family).is_none_or(|watch| watch.id != *id) {
            return Ok(());
        }
        let to_ms = self.clock.now_ms();
        let batch = Batch {
            version: id.clone(),
            stream: "live".to_owned(),
            from_ms: to_ms.saturating_sub(duration_ms),
            to_ms,
            rows: record.path.len().max(1) as u64,
            body: serde_json::to_vec(record)?,
        };
        self.ledger.store().append_telemetry(&batch)?;
        let seals = self.ledger.store().seal_telemetry()?;
        if !seals.is_empty() {
            self.ledger.write(seals, Vec::new(), to_ms)?;
        }
        Ok(())
    }

    /// Feeds one live task to the monitor of its version.
    fn watch(&mut self, id: &CapabilityId, record: &TaskRecord) -> Result<(), Fault> {
        let now_tick = self.now_tick();
        let Some(watch) = self.watches.get_mut(&id.family).filter(|watch| watch.id == *id) else {
            return Ok(());
        };
        let Some(values) = record.values() else { return Ok(()) };
        watch.monitor.telemetry(now_tick);
        watch.episodes = watch.episodes.saturating_add(1);
        let mut decision = watch.monitor.observe(&values, now_tick);
        for event in safety_events(record) {
            decision = watch.monitor.safety(event, now_tick);
        }
        self.act_on(id, &decision, None)
    }

    /// Silence and unanswered escalations. Tells whether anything was done.
    pub(in crate::pipeline) fn look_at_monitors(&mut self) -> Result<bool, Fault> {
        let now_tick = self.now_tick();
        let link_up = self.live.link_is_up();
        let mut due = Vec::new();
        for watch in self.watches.values_mut() {
            if link_up {
                // The arm at rest is read as well.
                watch.monitor.telemetry(now_tick);
            }
            let decision = watch.monitor.tick(now_tick);
            if decision.action > watch.told {
                due.push((watch.id.clone(), decision));
            }
        }
        for (id, decision) in &due {
            self.act_on(id, decision, None)?;
        }
        Ok(!due.is_empty())
    }

    /// When a monitor has to be looked at again, virtual ms.
    pub(in crate::pipeline) fn next_escalation_ms(&self) -> Option<u64> {
        let link_up = self.live.link_is_up();
        let due = self.watches.values().flat_map(|watch| {
            let deadline = watch.monitor.escalation().map(|waiting| waiting.deadline_tick);
            let silence = if link_up { None } else { watch.monitor.silence_due_tick() };
            [deadline, silence]
        });
        due.flatten().map(ms_of).min()
    }

    /// Does what a monitor asks for. `trip` is the task it stopped, where it did.
    pub(in crate::pipeline) fn act_on(
        &mut self,
        id: &CapabilityId,
        decision: &MonitorDecision,
        trip: Option<&Trip>,
    ) -> Result<(), Fault> {
        let mut silent = false;
        let mut asks_anew = false;
        if let Some(watch) = self.watches.get_mut(&id.family).filter(|watch| watch.id == *id) {
            if watch.asked.is_none() && decision.action != MonitorAction::Continue {
                watch.asked = decision.reasons.first().map(|reason| reason.code);
            }
            watch.told = watch.told.max(decision.action);
            if watch.monitor.escalation().is_some() && watch.question.is_empty() {
                watch.question.clone_from(&decision.reasons);
                // A restriction is told with its own alarm the first time; later ones are a question alone.
                asks_anew = watch.restricted;
            }
            silent = watch.asked == Some(ReasonCode::MonitorTelemetryMissing);
        }
        match decision.action {
            MonitorAction::Continue => self.maybe_confirm(id),
            MonitorAction::Restrict if asks_anew => self.escalated(id, decision),
            MonitorAction::Restrict => self.restrict(id, &decision.reasons),
            MonitorAction::Escalate => self.escalated(id, decision),
            MonitorAction::Rollback => {
                self.tell_monitor(id, decision.action, &decision.reasons)?;
                let trigger = decision.reasons.first().map_or_else(
                    || "monitor".to_owned(),
                    |reason| format!("{}: {}", reason.code, reason.text),
                );
                self.dossier(id).reasons.clone_from(&decision.reasons);
                let trigger = Trigger {
                    kind: TriggerKind::of(&decision.reasons, silent),
                    event: trip.and_then(|trip| trip.event),
                    text: trigger,
                    tick: decision.tick,
                };
                self.roll_back(id, trigger, trip, Leave::RolledBack)
            }
        }
    }

    fn escalated(&mut self, id: &CapabilityId, decision: &MonitorDecision) -> Result<(), Fault> {
        self.tell_monitor(id, decision.action, &decision.reasons)?;
        let priority = self.profile.alarms.escalated;
        let text = format!("{id}: people are needed");
        self.raise(&format!("escalated:{id}"), "monitor", priority, true, &text);
        Ok(())
    }

    fn tell_monitor(
        &mut self,
        id: &CapabilityId,
        action: MonitorAction,
        reasons: &[Reason],
    ) -> Result<(), Fault> {
        let body = serde_json::json!({ "action": action.name(), "reasons": reasons }).to_string();
        let record = AuditBody {
            kind: holdpoint_governance::record::RecordKind::Monitor,
            subject: id.to_string(),
            body,
        };
        let at_ms = self.clock.now_ms();
        self.ledger.write(Vec::new(), vec![record], at_ms)?;
        self.emit(EventKind::Monitor {
            version: id.clone(),
            decision: action.into(),
            reasons: reasons.to_vec(),
        });
        Ok(())
    }

    /// Tightens the envelope of an active version. A second demand changes nothing.
    pub(in crate::pipeline) fn restrict(
        &mut self,
        id: &CapabilityId,
        reasons: &[Reason],
    ) -> Result<(), Fault> {
        let Some(watch) = self.watches.get_mut(&id.family).filter(|watch| watch.id == *id) else {
            return Ok(());
        };
        if watch.restricted {
            return Ok(());
        }
        watch.restricted = true;
        self.tell_monitor(id, MonitorAction::Restrict, reasons)?;
        let (version, _, _) = self.ledger.version(id)?;
        let reason =
            reasons.first().map_or_else(String::new, |reason| format!("{}: {}", reason.code, reason.text));
        self.transition(&id.family, Event::Restrict { version }, Note::because(reason))?;
        let priority = self.profile.alarms.restricted;
        self.raise(&format!("restricted:{id}"), "monitor", priority, true, &format!("{id} is restricted"));
        Ok(())
    }

    /// Confirms a version whose window passed without a trip and which is in no doubt.
    pub(in crate::pipeline) fn maybe_confirm(&mut self, id: &CapabilityId) -> Result<(), Fault> {
        let Some(watch) = self.watches.get(&id.family).filter(|watch| watch.id == *id) else {
            return Ok(());
        };
        if !watch.monitor.is_confirmed() || watch.confirmed || watch.restricted {
            return Ok(());
        }
        if self.has_open_doubt(id) {
            return Ok(());
        }
        let Some(watch) = self.watches.get_mut(&id.family) else { return Ok(()) };
        watch.confirmed = true;
        let episodes = watch.episodes;
        let (version, standing, _) = self.ledger.version(id)?;
        if !standing.flags.provisional {
            return Ok(());
        }
        let note = Note::because("the provisional window passed without a trip");
        self.transition(&id.family, Event::Confirm { version }, note)?;
        self.emit(EventKind::Confirmed { version: id.clone(), episodes });
        self.close_audit(id, holdpoint_governance::record::UpgradeEnd::Confirmed)
    }
}

fn summary(dispatched: &holdpoint_runtime::agent::dispatcher::Dispatched) -> TaskSummary {
    let record = &dispatched.record;
    TaskSummary {
        version: dispatched.id.clone(),
        success: record.success,
        violation: record.violation,
        anomaly: record.anomaly,
        recovery: record.recovery,
        retries: record.retries,
        time_secs: record.time_secs,
    }
}

/// The first virtual time at which a tick has come.
pub(in crate::pipeline) const fn ms_of(tick: u64) -> u64 {
    tick.saturating_mul(1000).div_ceil(holdpoint_body::RATE_HZ as u64)
}
