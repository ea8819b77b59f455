//! Stage 6: the live world under watch. Every activation has a monitor before its first tick.

use std::sync::Arc;

use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Reason, ReasonCode};
use holdpoint_governance::distribution_shift::{is_live_look_due, live_shifts, live_tasks_max};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{DeactivationKind, LifecycleEvent, State};
use holdpoint_governance::live_harm::TaskHarm;
use holdpoint_governance::monitor::{MonitorAction, MonitorDecision, deciding_rates, roll_back, safety_trip};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::record::{RecordKind, UpgradeEnd};
use holdpoint_governance::rollback::{Trigger, TriggerKind, deactivation_for, rollback_reasons};
use holdpoint_protocol::event::{EventKind, TaskSummary};
use holdpoint_runtime::task::TaskRecord;

use super::ladder::raise_rolled_back;
use super::live_harm::LiveHarmWatch;
use super::live_task_output::{keep_telemetry, summary};
use super::resume::{self, Resumption};
use super::rollback::{LiveScene, Rollback};
use crate::decide::health::CellHealth;
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use crate::live::LiveWorld;
use crate::live::listener::NoListener;
use crate::live::monitors::{self, MonitoredTask, Monitors};
use crate::live::painter::{Painter, SequencePainter};
use crate::live::sequence::{self, FinishedSequence, StartedSequence, StoppedTask};
use crate::live::shadow::Shadow;
use crate::live::station::{SequenceReport, TaskStart};
use crate::live::supervisor::Trip;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_file::EvidenceFiles;
use holdpoint_record::live_task_record::{LiveTaskMarks, LiveTaskRecord};
use holdpoint_record::version_concern::VersionConcern;
use holdpoint_record::version_table::TransitionNote;
use holdpoint_runtime::safety_event::safety_events;
use holdpoint_trials::past_limit::MeasuredTask;
use holdpoint_wording::program::engine::ARM_STOPPED;

/// The monitored live cell. It has neither approval requests nor evaluations.
pub struct LiveMonitoring<'a> {
    /// The terms of the decision.
    pub context: &'a Context,
    pub record: &'a mut EngineRecorder,
    pub evidence_files: &'a mut EvidenceFiles,
    pub monitors: &'a mut Monitors,
    /// Arm, agent and world.
    pub world: &'a mut LiveWorld,
    /// Predecessors that took over again; their first tasks are checked.
    pub resumptions: &'a mut Vec<Resumption>,
    /// What is normal for each family, for any active version.
    pub(crate) health: &'a mut CellHealth,
    /// The harm of every active version's live tasks.
    pub(crate) live_harm: &'a mut LiveHarmWatch,
    /// The engine comes up: no task runs before every version is watched and every rollback is finished.
    pub(crate) is_starting: bool,
}

impl LiveMonitoring<'_> {
    /// Gives arm, agent and monitors to one sequence.
    ///
    /// # Errors
    /// If another sequence has them.
    pub(crate) fn begin_sequence(&mut self) -> Result<StartedSequence, EngineFault> {
        let seeds = self.record.live_seeds()?;
        let (context, evidence_files, monitors) = (self.context, &*self.evidence_files, &*self.monitors);
        let version_table = self.record.version_table();
        let terms_of =
            |version: &_| monitors::terms_of(context, version_table, evidence_files, monitors, version);
        let paced = self.world.is_paced();
        let (known, by) = ((evidence_files, monitors), (version_table, self.record.clock()));
        sequence::begin(context, by, known, &mut self.world.cell, seeds, paced, &terms_of)
    }

    /// One sequence of the live world, in step with the engine; monitors learn from it.
    ///
    /// # Errors
    /// If the result cannot be written.
    pub fn sequence(&mut self, shadow: Option<&mut Shadow>) -> Result<SequenceReport, EngineFault> {
        let begun = self.begin_sequence()?;
        let mut worked = match (self.world.frame_sink.clone(), shadow) {
            (Some(sink), shadow) => {
                let clock = self.record.clock().clone();
                let painter = Painter::new(sink, clock, begun.index(), begun.workers());
                let mut listener = SequencePainter { painter, shadow };
                let worked = begun.run(&mut listener);
                listener.painter.rest(worked.running.world(), false);
                worked
            }
            (None, Some(shadow)) => begun.run(shadow),
            (None, None) => begun.run(&mut NoListener),
        };
        if self.world.is_halted() {
            worked.stopped = Some(StoppedTask::here(&worked.report, self.record.now_tick()));
        }
        self.end_sequence(worked)
    }

    /// Feeds a finished sequence to the monitors and acts on their decisions.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn end_sequence(&mut self, worked: FinishedSequence) -> Result<SequenceReport, EngineFault> {
        let FinishedSequence { index, mut running, report, supervisor, envelopes, .. } = worked;
        let (link_up, stopped) = (worked.link_up, worked.stopped);
        let starts = running.take_starts();
        self.world.cell.take_back(running);
        let (monitors, mut raised) = supervisor.stand_down();
        self.monitors.take_back(monitors);
        self.record.advance(report.duration_ms);
        let halted = stopped.as_ref().is_some_and(|stopped| stopped.halted);
        let stopped = stopped.is_some();
        let is_cut_short = |place: usize| stopped && place + 1 == report.tasks.len();
        let summaries = report.tasks.iter().enumerate();
        let tasks: Vec<TaskSummary> = summaries
            .map(|(place, dispatched)| {
                let past = MeasuredTask::new(index, dispatched, &envelopes).violation().past;
                TaskSummary { past, ..summary(dispatched, is_cut_short(place)) }
            })
            .collect();
        self.world.note((!stopped).then(|| report.succeeded()), &tasks);
        self.record.tell(EventKind::Sequence {
            index,
            success: report.succeeded(),
            tasks,
            refused: if stopped {
                Some(ARM_STOPPED.to_owned())
            } else {
                report.refused.as_ref().map(ToString::to_string)
            },
        });
        self.health.domain.observe(self.context, self.record, &report);
        for (place, dispatched) in report.tasks.iter().enumerate() {
            let id = &dispatched.id;
            let measured = MeasuredTask::new(index, dispatched, &envelopes);
            let cut_short = is_cut_short(place);
            // While the link is down, no telemetry of a task reaches the monitors. Of a task that a person cut short
            // a monitor learns only that; a danger before the cut is an event all the same. An operation that stops the arm
            // counts for the version it is about.
            let stepped_in = cut_short && halted && dispatched.record.intervention;
            let tightened = self.is_tightened(id);
            let mut harm = TaskHarm::default();
            if link_up {
                let marks = LiveTaskMarks { cut_short, stepped_in, tightened };
                let task_record = LiveTaskRecord { record: &dispatched.record, marks };
                let batch = keep_telemetry(self.record, self.monitors, id, &task_record, report.duration_ms)?;
                let judged = (self.context, &*self.evidence_files);
                harm = self.live_harm.observe(judged, self.record, (id, measured, batch), marks)?;
            }
            let (ours, others): (Vec<_>, Vec<_>) = raised.into_iter().partition(|raised| raised.id == *id);
            raised = others;
            let tripped = ours.iter().any(|raised| raised.decision.action == MonitorAction::Rollback);
            let of_task = |start: &&TaskStart| start.id == *id && start.task == dispatched.record.task;
            let start = starts.iter().find(of_task);
            let scene = start.map(|start| LiveScene { start: &start.world, task: measured });
            for raised in ours {
                self.act_on(id, &raised.decision, raised.trip.as_ref(), scene)?;
            }
            // The charts follow the active version; a task that another one ran in its place is none of its own.
            let in_place = report.outside.iter().any(|outside| outside.run_by.as_ref() == Some(id));
            if link_up && !cut_short && !in_place {
                self.health.observe(self.context, self.record, id, measured)?;
            }
            if tripped {
                continue;
            }
            let rolled_back = self.act_on_harm(id, (&harm, index), scene)?;
            if link_up && !rolled_back && (!cut_short || stepped_in) {
                self.watch(id, &dispatched.record, tightened, scene)?;
            }
        }
        // A task with a refused start is not in the report; what a monitor decided in it counts all the same.
        for raised in raised {
            self.act_on(&raised.id, &raised.decision, raised.trip.as_ref(), None)?;
        }
        Ok(report)
    }

    /// Whether a version works under a tighter envelope than it was measured under.
    fn is_tightened(&self, id: &CapabilityId) -> bool {
        self.record.is_restricted(id) || self.monitors.of(id).is_some_and(|watched| watched.restricted)
    }

    /// Rolls a version back for the harm of its live task. Returns whether it did: a version without monitor and rollback
    /// target is its family's commissioned one, a superseded one ran the task in place of the active one; both get an alarm.
    fn act_on_harm(
        &mut self,
        id: &CapabilityId,
        (harm, sequence): (&TaskHarm, u64),
        scene: Option<LiveScene<'_>>,
    ) -> Result<bool, EngineFault> {
        let reasons = harm.reasons();
        let state = self.record.version_table().version(id)?.1.state;
        if reasons.is_empty() || !matches!(state, State::Active | State::Superseded) {
            return Ok(false);
        }
        if state == State::Active && self.is_replaceable(id)? {
            let decision = roll_back(reasons, self.record.now_tick());
            return self.act_on(id, &decision, None, scene).map(|()| true);
        }
        if let Some(reason) = reasons.into_iter().next().filter(|_| !harm.past.is_empty()) {
            let notice = Notice::Harmful { version: id.clone(), reason: Box::new(reason), sequence };
            let priority = self.context.profile.alarms.violation;
            self.record.raise(AlarmKey::Harm(id.clone()), priority, true, notice);
        }
        Ok(false)
    }

    /// Whether a version is still active: an earlier task of the sequence, or a person, may have ended that.
    fn is_active(&self, id: &CapabilityId) -> Result<bool, EngineFault> {
        Ok(self.record.version_table().version(id)?.1.state == State::Active)
    }

    /// Whether a version is rolled back like a new one: it has a monitor or a rollback target.
    pub(crate) fn is_replaceable(&self, id: &CapabilityId) -> Result<bool, EngineFault> {
        let (_, lifecycle, _) = self.record.version_table().version(id)?;
        Ok(self.monitors.of(id).is_some() || lifecycle.predecessor.is_some())
    }

    /// Feeds one live task to the monitor of its version, and keeps it beside the monitor. A confirmed version that an
    /// engine found at its start has none: its safety events count all the same.
    fn watch(
        &mut self,
        id: &CapabilityId,
        record: &TaskRecord,
        tightened: bool,
        scene: Option<LiveScene<'_>>,
    ) -> Result<(), EngineFault> {
        let now_tick = self.record.now_tick();
        if let Some(values) = record.values().filter(|values| !values.intervention) {
            let start = scene.map(|scene| Arc::clone(scene.start));
            let task = MonitoredTask { start, task: record.task, seed: record.seed, values, tightened };
            self.monitors.keep_task(id, task, self.context.profile.monitor.paired_tasks_max());
        }
        let Some(watched) = self.monitors.of_mut(id) else {
            return match safety_events(record).first() {
                Some(event) if self.is_active(id)? && self.is_replaceable(id)? => {
                    let decision = safety_trip(*event, now_tick);
                    self.act_on(id, &decision, None, scene)
                }
                Some(_) | None => Ok(()),
            };
        };
        watched.monitor.set_tightened(tightened);
        let Some(values) = record.values() else { return Ok(()) };
        watched.monitor.telemetry(now_tick);
        watched.episodes = watched.episodes.saturating_add(u32::from(!values.intervention));
        let profile = &self.context.profile;
        let mut shift = Vec::new();
        if !values.intervention && !tightened && watched.lived.len() < live_tasks_max(profile) as usize {
            watched.lived.push(values);
            let tasks = u32::try_from(watched.lived.len()).unwrap_or(u32::MAX);
            if let Some(evidence_file) =
                self.evidence_files.of(id).filter(|_| is_live_look_due(tasks, profile))
            {
                shift = live_shifts(&evidence_file.twins, &watched.lived, profile);
            }
        }
        let mut decision = watched.monitor.observe(&values, now_tick);
        for event in safety_events(record) {
            decision = watched.monitor.safety(event, now_tick);
        }
        if !shift.is_empty() {
            raise_concern(self.context, self.record, self.evidence_files, id, shift)?;
        }
        self.act_on(id, &decision, None, scene)
    }

    /// A person restricted an active version: that is an intervention.
    ///
    /// # Errors
    /// If the result cannot be written.
    pub(crate) fn stepped_in(&mut self, id: &CapabilityId) -> Result<(), EngineFault> {
        let now_tick = self.record.now_tick();
        let Some(watched) = self.monitors.of_mut(id) else { return Ok(()) };
        let decision = watched.monitor.record_intervention(now_tick);
        self.act_on(id, &decision, None, None)
    }

    /// Acts on silence and unanswered escalations. Returns whether anything was done.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn look_at_monitors(&mut self) -> Result<bool, EngineFault> {
        let now_tick = self.record.now_tick();
        let link_up = self.world.cell.link_is_up();
        let mut due = Vec::new();
        for watched in self.monitors.iter_mut() {
            if link_up {
                // The arm at rest is read as well.
                watched.monitor.telemetry(now_tick);
            }
            let decision = watched.monitor.tick(now_tick);
            if decision.action > watched.announced {
                due.push((watched.id.clone(), decision));
            }
        }
        for (id, decision) in &due {
            self.act_on(id, decision, None, None)?;
        }
        Ok(!due.is_empty())
    }

    /// Reports the questions of monitors from their running sequence. Returns whether there were any.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn look_at_questions(&mut self) -> Result<bool, EngineFault> {
        let Some(thread) = &self.world.thread else { return Ok(false) };
        let questions = thread.take_questions();
        for (watched, decision) in &questions {
            if let Some(own) = self.monitors.of_mut(&watched.id) {
                // The engine's copy shows the question; the monitor itself continues in the sequence.
                own.monitor.clone_from(&watched.monitor);
                self.act_on(&watched.id, decision, None, None)?;
            }
        }
        Ok(!questions.is_empty())
    }

    /// Does what a monitor asks for. `trip` is the task it stopped, if it did; `scene` the task that it is about.
    fn act_on(
        &mut self,
        id: &CapabilityId,
        decision: &MonitorDecision,
        trip: Option<&Trip>,
        scene: Option<LiveScene<'_>>,
    ) -> Result<(), EngineFault> {
        let mut silent = false;
        let mut is_new_question = false;
        let mut question = Vec::new();
        if let Some(watched) = self.monitors.of_mut(id) {
            if watched.escalation_reason.is_none() && decision.action != MonitorAction::Continue {
                watched.escalation_reason = decision.reasons.first().map(|reason| reason.code);
            }
            watched.announced = watched.announced.max(decision.action);
            if watched.monitor.escalation().is_some() && watched.question.is_empty() {
                watched.question.clone_from(&decision.reasons);
                // The first restriction has its own alarm; later ones are only a question.
                is_new_question = watched.restricted;
            }
            silent = watched.escalation_reason == Some(ReasonCode::MonitorTelemetryMissing);
            question.clone_from(&watched.question);
        }
        match decision.action {
            MonitorAction::Continue => maybe_confirm(self.record, self.evidence_files, self.monitors, id),
            MonitorAction::Restrict if is_new_question => escalated(self.context, self.record, id, decision),
            MonitorAction::Restrict => {
                restrict(self.context, self.record, self.monitors, id, &decision.reasons)
            }
            MonitorAction::Escalate => escalated(self.context, self.record, id, decision),
            MonitorAction::Rollback => {
                let reasons = rollback_reasons(&decision.reasons, &question);
                tell_monitor(self.record, id, decision.action, &reasons)?;
                self.evidence_files.edit(id).reasons.clone_from(&reasons);
                let kind = TriggerKind::of(&reasons, silent);
                let event = trip.and_then(|trip| trip.event);
                let scene_of_event = scene.filter(|_| kind.needs_difference());
                let trigger = Trigger {
                    kind,
                    event,
                    rates: if kind.needs_difference() { Vec::new() } else { deciding_rates(&reasons) },
                    text: Notice::decided(reasons.first()).into(),
                    tick: decision.tick,
                    measured: scene_of_event.map(|scene| scene.task.safety_event(event)),
                };
                self.deactivate_after(id, trigger, trip, deactivation_for(&reasons), scene)
            }
        }
    }

    /// Deactivates an active version, and checks the first tasks of its predecessor: at once if the live cell runs in
    /// step with the engine, else as they end.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn deactivate(
        &mut self,
        id: &CapabilityId,
        trigger: Trigger,
        trip: Option<&Trip>,
        leave: DeactivationKind,
    ) -> Result<(), EngineFault> {
        self.deactivate_after(id, trigger, trip, leave, None)
    }

    /// The same after a safety event in a live task, or for rates. Once the arm is safe, the rollback target runs a fork
    /// of the task, or of the kept tasks. Without a difference the version is demoted and not rolled back for good.
    fn deactivate_after(
        &mut self,
        id: &CapabilityId,
        trigger: Trigger,
        trip: Option<&Trip>,
        leave: DeactivationKind,
        scene: Option<LiveScene<'_>>,
    ) -> Result<(), EngineFault> {
        let mut rollback = Rollback {
            context: self.context,
            record: self.record,
            evidence_files: self.evidence_files,
            monitors: self.monitors,
            world: self.world,
        };
        let Some(mut resumption) = rollback.run(id, trigger, trip, leave, scene)? else { return Ok(()) };
        // Neither a stopped cell nor an engine that comes up runs a task: the result is known later.
        if self.world.is_paced() || self.world.is_halted() || self.is_starting {
            raise_rolled_back(self.context, self.record, &resumption.record);
            self.resumptions.push(resumption.alarmed());
            return Ok(());
        }
        loop {
            if self.world.is_halted() {
                self.resumptions.push(resumption);
                return Ok(());
            }
            let report = self.sequence(None)?;
            if resume::takes_in(self.context, self.record, &mut resumption, &report) {
                return resume::close(self.context, self.record, resumption);
            }
        }
    }
}

fn escalated(
    context: &Context,
    record: &mut EngineRecorder,
    id: &CapabilityId,
    decision: &MonitorDecision,
) -> Result<(), EngineFault> {
    tell_monitor(record, id, decision.action, &decision.reasons)?;
    let alarms = &context.profile.alarms;
    let cause = decision.reasons.first().map(|reason| reason.code);
    let silent = cause == Some(ReasonCode::MonitorTelemetryMissing);
    let priority = if silent { alarms.telemetry_silent } else { alarms.escalated };
    let reason = decision.reasons.first().cloned().map(Box::new);
    let notice = Notice::Escalated { version: id.clone(), reason };
    record.raise(AlarmKey::Escalated(id.clone()), priority, true, notice);
    Ok(())
}

pub(crate) fn tell_monitor(
    record: &mut EngineRecorder,
    id: &CapabilityId,
    action: MonitorAction,
    reasons: &[Reason],
) -> Result<(), EngineFault> {
    let body = serde_json::json!({ "action": action.name(), "reasons": reasons }).to_string();
    record.note(RecordKind::Monitor, id.to_string(), body)?;
    record.tell(EventKind::Monitor {
        version: id.clone(),
        decision: action.into(),
        reasons: reasons.to_vec(),
    });
    Ok(())
}

/// Records a concern about an active version that differs from its shadow, and raises an alarm; the version will be
/// re-evaluated. After it was cleared, only the alarm follows.
fn raise_concern(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    id: &CapabilityId,
    reasons: Vec<Reason>,
) -> Result<(), EngineFault> {
    let notice = Notice::Shifted { version: Some(id.clone()), reasons: reasons.clone() };
    record.raise(AlarmKey::Shifted(id.clone()), context.profile.alarms.degraded, true, notice);
    let evidence_file = evidence_files.edit(id);
    if evidence_file.suspicion.is_some() {
        return Ok(());
    }
    let suspicion = VersionConcern { reasons, again: None };
    record.write(vec![suspicion.evidence(id)?], Vec::new())?;
    evidence_file.suspicion = Some(suspicion);
    Ok(())
}

/// Tightens the envelope of an active version. A second demand changes nothing.
///
/// # Errors
/// If it cannot be written.
pub fn restrict(
    context: &Context,
    record: &mut EngineRecorder,
    monitors: &mut Monitors,
    id: &CapabilityId,
    reasons: &[Reason],
) -> Result<(), EngineFault> {
    let Some(watched) = monitors.of_mut(id).filter(|watched| !watched.restricted) else { return Ok(()) };
    if record.is_restricted(id) {
        // An operator was first.
        watched.restricted = true;
        return Ok(());
    }
    restrict_on_demand(context, record, monitors, id, reasons)
}

/// Tightens the envelope of an active version on demand.
///
/// # Errors
/// If the lifecycle refuses, or it cannot be written; nothing has changed then.
pub fn restrict_on_demand(
    context: &Context,
    record: &mut EngineRecorder,
    monitors: &mut Monitors,
    id: &CapabilityId,
    reasons: &[Reason],
) -> Result<(), EngineFault> {
    let (version, _, _) = record.version_table().version(id)?;
    let reason = Notice::decided(reasons.first());
    record.transition(&id.family, LifecycleEvent::Restrict { version }, TransitionNote::because(reason))?;
    if let Some(watched) = monitors.of_mut(id) {
        watched.restricted = true;
    }
    tell_monitor(record, id, MonitorAction::Restrict, reasons)?;
    let priority = context.profile.alarms.restricted;
    let reason = reasons.first().cloned().map(Box::new);
    let notice = Notice::Restricted { version: id.clone(), reason };
    record.raise(AlarmKey::Restricted(id.clone()), priority, true, notice);
    Ok(())
}

/// Confirms a version whose window passed without a trip and without an open concern. A paused version keeps running
/// and is confirmed when it is resumed.
///
/// # Errors
/// If it cannot be written.
pub fn maybe_confirm(
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    monitors: &mut Monitors,
    id: &CapabilityId,
) -> Result<(), EngineFault> {
    let Some(watched) = monitors.of_mut(id) else { return Ok(()) };
    if !watched.monitor.is_confirmed() || watched.confirmed || watched.restricted {
        return Ok(());
    }
    let (version, lifecycle, _) = record.version_table().version(id)?;
    let (provisional, paused) = (lifecycle.flags.provisional, lifecycle.flags.paused);
    if paused || evidence_files.has_open_concern(id) || record.is_unreviewed(id) {
        return Ok(());
    }
    watched.confirmed = true;
    watched.monitor.confirmed().map_err(|error| EngineFault::Impossible(error.to_string()))?;
    evidence_files.edit(id).conditions.retain(Condition::outlives_confirmation);
    let episodes = watched.episodes;
    if !provisional {
        return Ok(());
    }
    let note = TransitionNote::because(Notice::WindowPassed);
    record.transition(&id.family, LifecycleEvent::Confirm { version }, note)?;
    record.tell(EventKind::Confirmed { version: id.clone(), episodes });
    record.close_audit(id, UpgradeEnd::Confirmed)
}
