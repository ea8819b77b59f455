//! Stage 6: the live world under watch. Every activation has a monitor before its first tick.

use holdpoint_sim::io::TaskKind;

use crate::engine::event::{EventKind, TaskSummary};
use crate::governance::decision::Reason;
use crate::governance::evidence::{EpisodeValues, Signature};
use crate::governance::ids::{CapabilityId, Family};
use crate::governance::lifecycle::{Event, Leave};
use crate::governance::monitor::{Monitor, MonitorAction, MonitorDecision, SafetyEvent};
use crate::pipeline::ledger::Note;
use crate::pipeline::live::{Listener, Nobody, SequenceReport};
use crate::pipeline::manager::{Fault, UpgradeManager};
use crate::pipeline::seeds::{Purpose, episode_seed};
use crate::pipeline::shadow::Shadow;
use crate::registry::{AuditBody, Batch};
use crate::runtime::guard::PolicyHit;
use crate::runtime::task::TaskRecord;
use crate::runtime::watcher::WatcherSignal;
use crate::stats::wilson_upper;

/// Sequences whose success is kept for display.
const RECENT: usize = 50;

/// One-sided level of the bound on what is normal for a version in the live world.
const EXPECTED_ALPHA: f64 = 0.10;

/// The monitor of one activation.
pub struct Watch {
    pub(in crate::pipeline) id: CapabilityId,
    pub(in crate::pipeline) monitor: Monitor,
    pub(in crate::pipeline) episodes: u32,
    pub(in crate::pipeline) restricted: bool,
    pub(in crate::pipeline) confirmed: bool,
}

impl UpgradeManager {
    /// A monitor for a version about to be activated. What is normal is what its twins did in the
    /// live world, at the unfavourable end of what so few of them can tell.
    pub(in crate::pipeline) fn new_watch(&mut self, id: &CapabilityId) -> Result<Watch, Fault> {
        let expected = expected(&self.dossier(id).twins)
            .ok_or_else(|| Fault::Impossible(format!("{id} has no shadow evidence to monitor it against")))?;
        let monitor = Monitor::new(&self.profile, &expected, self.now_tick())
            .map_err(|error| Fault::Impossible(error.to_string()))?;
        Ok(Watch { id: id.clone(), monitor, episodes: 0, restricted: false, confirmed: false })
    }

    pub(in crate::pipeline) fn now_tick(&self) -> u64 {
        self.clock.now_ms().saturating_mul(u64::from(holdpoint_sim::io::RATE_HZ)) / 1000
    }

    /// One sequence of the live world; monitors learn from it.
    pub(in crate::pipeline) fn live_sequence(
        &mut self,
        shadow: Option<&mut Shadow<'_>>,
    ) -> Result<SequenceReport, Fault> {
        let index = self.live.sequences();
        let seed = episode_seed(self.seed, Purpose::Live, index);
        let mut nobody = Nobody;
        let listener = shadow.map_or(&mut nobody as &mut dyn Listener, |shadow| shadow);
        // The terms are made before the live world is borrowed.
        let terms: Vec<_> = TaskKind::SEQUENCE
            .into_iter()
            .filter_map(|task| self.active_of(&Family::from(task)))
            .map(|active| (active.id(), self.terms_of(&active)))
            .collect();
        let spare = self.terms_of_profile();
        let choose = |capability: &crate::runtime::capability::Capability| {
            let id = capability.id();
            terms
                .iter()
                .find(|(known, _)| *known == id)
                .map_or_else(|| spare.clone(), |(_, terms)| terms.clone())
        };
        let report = self.live.run_sequence(&self.ledger, &choose, seed, listener);
        self.clock.advance(report.duration_ms);
        let tasks: Vec<TaskSummary> = report.tasks.iter().map(summary).collect();
        self.recent.push_back(report.succeeded());
        if self.recent.len() > RECENT {
            self.recent.pop_front();
        }
        self.last_tasks.clone_from(&tasks);
        self.emit(EventKind::Sequence {
            index,
            success: report.succeeded(),
            tasks,
            refused: report.refused.as_ref().map(ToString::to_string),
        });
        for dispatched in &report.tasks {
            self.keep_telemetry(&dispatched.id, &dispatched.record, report.duration_ms)?;
            self.watch(&dispatched.id, &dispatched.record)?;
        }
        Ok(report)
    }

    fn terms_of_profile(&self) -> crate::runtime::terms::Terms {
        crate::runtime::terms::Terms::new(
            &self.profile,
            self.table.clone(),
            self.cell.model.clone(),
            self.cell.scene.clone(),
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
        self.act_on(id, &decision)
    }

    /// Silence and unanswered escalations. Tells whether anything was done.
    pub(in crate::pipeline) fn look_at_monitors(&mut self) -> Result<bool, Fault> {
        let now_tick = self.now_tick();
        let due: Vec<CapabilityId> = self
            .watches
            .values()
            .filter(|watch| {
                watch.monitor.escalation().is_some_and(|waiting| now_tick >= waiting.deadline_tick)
            })
            .map(|watch| watch.id.clone())
            .collect();
        for id in &due {
            let Some(watch) = self.watches.get_mut(&id.family) else { continue };
            let decision = watch.monitor.tick(now_tick);
            self.act_on(id, &decision)?;
        }
        Ok(!due.is_empty())
    }

    pub(in crate::pipeline) fn next_escalation_ms(&self) -> Option<u64> {
        let deadlines = self.watches.values().filter_map(|watch| watch.monitor.escalation());
        let rate = u64::from(holdpoint_sim::io::RATE_HZ);
        deadlines.map(|waiting| waiting.deadline_tick.saturating_mul(1000).div_ceil(rate)).min()
    }

    fn act_on(&mut self, id: &CapabilityId, decision: &MonitorDecision) -> Result<(), Fault> {
        match decision.action {
            MonitorAction::Continue => self.maybe_confirm(id),
            MonitorAction::Restrict => self.restrict(id, &decision.reasons),
            MonitorAction::Escalate => {
                self.tell_monitor(id, decision.action, &decision.reasons)?;
                let priority = self.profile.alarms.escalated;
                self.raise(
                    &format!("escalated:{id}"),
                    "monitor",
                    priority,
                    true,
                    &format!("{id}: people are needed"),
                );
                Ok(())
            }
            MonitorAction::Rollback => {
                self.tell_monitor(id, decision.action, &decision.reasons)?;
                let trigger = decision.reasons.first().map_or_else(
                    || "monitor".to_owned(),
                    |reason| format!("{}: {}", reason.code, reason.text),
                );
                self.dossier(id).reasons.clone_from(&decision.reasons);
                self.roll_back(id, &trigger, Leave::RolledBack)
            }
        }
    }

    fn tell_monitor(
        &mut self,
        id: &CapabilityId,
        action: MonitorAction,
        reasons: &[Reason],
    ) -> Result<(), Fault> {
        let body = serde_json::json!({ "action": action.name(), "reasons": reasons }).to_string();
        let record = AuditBody { kind: "monitor".to_owned(), subject: id.to_string(), body };
        let at_ms = self.clock.now_ms();
        self.ledger.write(Vec::new(), vec![record], at_ms)?;
        self.emit(EventKind::Monitor {
            version: id.clone(),
            decision: action.name().to_owned(),
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
        self.close_audit(id, "confirmed")
    }
}

fn summary(dispatched: &crate::runtime::agent::dispatcher::Dispatched) -> TaskSummary {
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

/// The events of a live task that trip at once.
fn safety_events(record: &TaskRecord) -> Vec<SafetyEvent> {
    let of_hit = |hit: &PolicyHit| match hit {
        PolicyHit::ForceMeasured => Some(SafetyEvent::ForceLimit),
        PolicyHit::SpeedMeasured => Some(SafetyEvent::SpeedLimit),
        PolicyHit::KeepOut => Some(SafetyEvent::KeepOut),
        PolicyHit::PredictedCollision => Some(SafetyEvent::Collision),
        PolicyHit::NotFinite => Some(SafetyEvent::NotANumber),
        PolicyHit::ModeUncovered | PolicyHit::ModeForbidden | PolicyHit::ModeUnreviewed => {
            Some(SafetyEvent::PermissionBreach)
        }
        PolicyHit::OutsideWorkspace
        | PolicyHit::RetriesExceeded
        | PolicyHit::SpeedClamped
        | PolicyHit::ForceClamped => None,
    };
    let hits = record.hits.iter().filter_map(|(_, hit)| of_hit(hit));
    let collided = record.signals.iter().any(|raised| raised.signal == WatcherSignal::UnexpectedContact);
    hits.chain(collided.then_some(SafetyEvent::Collision)).collect()
}

/// What is normal: for each rate the upper bound that the twins leave open.
fn expected(twins: &[EpisodeValues]) -> Option<Signature> {
    let n = u64::try_from(twins.len()).ok().filter(|n| *n > 0)?;
    let mean = crate::governance::behavior::signature(twins.iter())?;
    let bound = |flag: &dyn Fn(&EpisodeValues) -> bool| {
        let count = twins.iter().filter(|values| flag(values)).count() as u64;
        wilson_upper(count, n, EXPECTED_ALPHA).ok()
    };
    Some(Signature {
        success: 1.0 - bound(&|v| !v.success)?,
        violation: bound(&|v| v.violation)?,
        anomaly: bound(&|v| v.anomaly)?,
        recovery: bound(&|v| v.recovery)?,
        retry: bound(&|v| v.retries > 0)?,
        intervention: bound(&|v| v.intervention)?,
        timeout: bound(&|v| v.timeout)?,
        ..mean
    })
}
