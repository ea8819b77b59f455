//! Stage 7: the ladder. Every rung can fail and reports it; a failed rung ends in a safe-stopped family
//! with a latched alarm, never in a silent "rolled back".
//!
//! Owns the order of the rungs and their record. `live/ladder_motion.rs` moves the arm; the lifecycle decides which
//! version may take over. Source: paper section 5.2 stage 7; design rule 3.11.

use std::sync::Arc;

use holdpoint_body::TaskKind;
use holdpoint_cell::{CellCopy, CellError, TrialCell};
use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{DeactivationKind, LifecycleEvent, State, VersionRef};
use holdpoint_governance::monitor::{ForkedPair, Rate, RateComparison, RateTally};
use holdpoint_governance::notice::{Notice, NoticeOrText};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::rollback::{
    PostStatus, RollbackRecord, Rung, RungFailure, RungRecord, Trigger, TriggerKind, ticks_to_ms,
};
use holdpoint_governance::shared_event::{SceneKind, SharedEvent, StoppingEvent, UncomparedReason};
use holdpoint_runtime::agent::AbandonedGoal;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_store::{ActiveCause, AuditBody};
use holdpoint_text::Hint;
use serde::{Deserialize, Serialize};

use super::ladder::{event, evidence, push_rung, rung};
use super::resume::Resumption;
use super::shared_stops;
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use crate::live::LiveWorld;
use crate::live::forked_task::ForkedTask;
use crate::live::ladder_motion::LadderMotion;
use crate::live::monitors::{ActivationMonitor, EndedMonitor, Monitors, terms_of};
use crate::live::painter::LadderPainter;
use crate::live::station::Rig;
use crate::live::supervisor::Trip;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::{measured_terms_of, not_admitted};
use holdpoint_record::evidence_file::EvidenceFiles;
use holdpoint_record::version_table::{TransitionNote, VersionTableError};
use holdpoint_runtime::safety_event::stopping_events;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_trials::cell_frame;
use holdpoint_trials::past_limit::{MeasuredTask, past_limit};

/// The trigger of a rollback that begins now.
pub(crate) fn trigger(record: &EngineRecorder, kind: TriggerKind, text: Notice) -> Trigger {
    let (rates, text) = (Vec::new(), text.into());
    Trigger { kind, event: None, rates, text, tick: record.now_tick(), measured: None }
}

/// What a person decided about a rollback, recorded as it begins: the next engine carries out the same.
#[derive(Serialize, Deserialize)]
pub(crate) struct RequestedRollback {
    pub(crate) trigger: NoticeOrText,
    pub(crate) leave: DeactivationKind,
}

/// Takes the command authority of an active version away.
pub(crate) fn begin(
    record: &mut EngineRecorder,
    id: &CapabilityId,
    trigger: &Trigger,
    leave: DeactivationKind,
) -> Result<(), EngineFault> {
    let (version, _, _) = record.version_table().version(id)?;
    let text = trigger.text.clone();
    let mut note = TransitionNote::because(Notice::AuthorityRevoked { trigger: Box::new(text.clone()) });
    // The monitor has recorded its decision before; a person's is on record nowhere else.
    if trigger.kind == TriggerKind::Operator {
        let body = serde_json::to_string(&RequestedRollback { trigger: text, leave })?;
        note.audit.push(AuditBody { kind: RecordKind::RollbackRequested, subject: id.to_string(), body });
    }
    record.transition(&id.family, LifecycleEvent::BeginRollback { version }, note)
}

/// A live task and the world where it began.
#[derive(Clone, Copy)]
pub(crate) struct LiveScene<'a> {
    pub(crate) start: &'a Arc<CellCopy>,
    pub(crate) task: MeasuredTask<'a>,
}

/// What shows no difference between the version and its rollback target, and whether the target may do the same now.
fn shown_same(record: &RollbackRecord, target: &CapabilityId) -> Option<(Notice, bool)> {
    let (version, with) = (target.clone(), record.candidate.clone());
    if let Some(shared) = record.shared {
        return Some((Notice::SharedEvent { version, with, shared }, true));
    }
    let rates = record.rates.as_ref().filter(|rates| !rates.differs())?.tallies();
    let is_shared = rates.iter().any(RateTally::is_shared);
    Some((Notice::SharedRates { version, with, rates }, is_shared))
}

/// Has a version run a task in this fork, from its start. Returns the world for the next fork.
fn run_fork(
    mut fork: Box<dyn TrialCell>,
    start: &CellCopy,
    (target, terms): (&Capability, &SkillTerms),
    (task, seed): (TaskKind, u64),
) -> Result<(Box<dyn TrialCell>, TaskRecord), UncomparedReason> {
    fork.go_on_from(start).map_err(|_| UncomparedReason::NoFork)?;
    let worked = ForkedTask::new(fork, target, terms, task, seed).run(&mut |_, _| {});
    worked.filter(|(_, worked)| !worked.invalid).ok_or(UncomparedReason::InvalidFork)
}

/// Rolls versions back: moves the arm, activates the rollback target and ends the drift monitor.
pub struct Rollback<'a> {
    /// The terms of the decision.
    pub context: &'a Context,
    pub record: &'a mut EngineRecorder,
    pub evidence_files: &'a EvidenceFiles,
    pub monitors: &'a mut Monitors,
    /// Arm, agent and world.
    pub world: &'a mut LiveWorld,
}

impl Rollback<'_> {
    /// Rolls back an active version: first its command authority, then the arm to a safe pose, then
    /// the binding, then the record. `trip` is the task stopped for it, if any. Returns the first tasks under the
    /// predecessor to watch; `None` if there was nothing to do, or the family is safe-stopped.
    pub(crate) fn run(
        &mut self,
        id: &CapabilityId,
        trigger: Trigger,
        trip: Option<&Trip>,
        leave: DeactivationKind,
        scene: Option<LiveScene<'_>>,
    ) -> Result<Option<Resumption>, EngineFault> {
        let (version, lifecycle, _) = self.record.version_table().version(id)?;
        if lifecycle.state != State::Active {
            return Ok(None);
        }
        let (target, is_continued) = (lifecycle.predecessor, lifecycle.flags.rollback_pending);
        if !is_continued {
            begin(self.record, id, &trigger, leave)?;
        }
        let mut record =
            RollbackRecord { in_flight: trip.is_some(), ..RollbackRecord::triggered(id.clone(), trigger) };
        rung(self.record, &mut record, Rung::RevokeAuthority, None, Notice::NoMoreCommands);
        // At a restart the state of the arm is unknown, whatever began the rollback.
        let cause = if is_continued { TriggerKind::Restart } else { record.trigger.kind };
        let motion = self.bring_to_rest(id, trip, cause, &mut record)?;
        let ended = self.monitors.remove(&id.family).filter(|ended| ended.watched.id == *id);
        if !motion.continues() {
            return self.safe_stop(id, version, record).map(|()| None);
        }
        let Some(predecessor) = self.load_predecessor(id, target, &mut record) else {
            return self.safe_stop(id, version, record).map(|()| None);
        };
        let failure = self.policy_failure();
        rung(self.record, &mut record, Rung::VerifyPolicy, failure, Notice::PoliciesCompared);
        if failure.is_some() {
            return self.safe_stop(id, version, record).map(|()| None);
        }
        let ready_rung = self.check_target_ready(&predecessor);
        let restored_ticks = motion.ticks_since_trigger + ready_rung.ticks;
        self.record.advance(ready_rung.ms);
        let is_ready = ready_rung.continues();
        push_rung(self.record, &mut record, ready_rung);
        if !is_ready {
            return self.safe_stop(id, version, record).map(|()| None);
        }
        // Without a live monitor no tick runs under a provisional version.
        let evidence_file = self.evidence_files.of(&predecessor.id());
        let now = (self.record.version_table(), self.record.now_tick());
        let Ok(watched) = ActivationMonitor::reactivated(&predecessor.id(), now, evidence_file, self.context)
        else {
            let notice = Notice::TargetUnmonitored { version: predecessor.id() };
            let failed = Some(RungFailure::PredecessorFailed);
            rung(self.record, &mut record, Rung::ReadyPredecessor, failed, notice);
            return self.safe_stop(id, version, record).map(|()| None);
        };
        // The scene of the event, or the tasks of the rates, ended with the engine that decided.
        let is_interrupted = is_continued || record.trigger.kind == TriggerKind::Restart;
        let compared = if record.trigger.kind.needs_difference() {
            if is_continued {
                Err(UncomparedReason::Interrupted)
            } else {
                self.shared_event(scene, &record.trigger, &predecessor).map(|shared| record.shared = shared)
            }
        } else if record.trigger.rates.is_empty() {
            Ok(())
        } else if is_interrupted {
            Err(UncomparedReason::Interrupted)
        } else {
            self.rate_comparison(ended.as_ref(), &record.trigger.rates, &predecessor)
                .map(|rates| record.rates = Some(rates))
        };
        record.uncompared = compared.err();
        let leave = if record.is_unproven() { DeactivationKind::Demoted } else { leave };
        record.post_status = leave.into();
        record.predecessor = Some(predecessor.id());
        record.time_to_restored_ticks = Some(restored_ticks);
        record.time_to_restored_ms = Some(ticks_to_ms(restored_ticks));
        let same = shown_same(&record, &predecessor.id());
        let because = same
            .as_ref()
            .map_or_else(|| record.trigger.text.clone(), |(notice, _)| NoticeOrText::from(notice.clone()));
        let note = TransitionNote {
            cause: Some(ActiveCause::Restore),
            before: vec![evidence(&record)?],
            ..TransitionNote::because(because)
        };
        match self.record.transition(&id.family, LifecycleEvent::FinishRollback { version, leave }, note) {
            Ok(()) => {
                if let Some(watched) = watched {
                    self.monitors.insert(watched);
                }
                let notice = self.abandon_goal(record.in_flight);
                rung(self.record, &mut record, Rung::SwapBinding, None, notice);
            }
            Err(EngineFault::VersionTable(VersionTableError::Store(error))) => {
                let notice = Notice::SwapFailed { problem: error.sentence() };
                rung(self.record, &mut record, Rung::SwapBinding, Some(RungFailure::StoreFailed), notice);
                return self.safe_stop(id, version, record).map(|()| None);
            }
            Err(fault) => return Err(fault),
        }
        if let Some((notice, true)) = same {
            shared_stops::alarm(self.context, self.record, &predecessor.id(), notice);
        }
        Ok(Some(Resumption::new(predecessor.id(), record, self.record.now_ms())))
    }

    /// Has the rollback target run a fork of the task, and returns the safety event of the version if the target has it
    /// too, and every other one of the task.
    ///
    /// # Errors
    /// If the target could not run it: then no difference is shown.
    fn shared_event(
        &self,
        scene: Option<LiveScene<'_>>,
        trigger: &Trigger,
        target: &Capability,
    ) -> Result<Option<SharedEvent>, UncomparedReason> {
        let scene = scene.ok_or_else(|| self.no_start())?;
        let events = stopping_events(scene.task.record, &self.context.profile);
        let event = trigger.event.or_else(|| events.first().copied()).ok_or(UncomparedReason::NoEvent)?;
        let (task, seed) = (scene.task.record.task, scene.task.record.seed);
        let by = (target, &self.terms(target));
        let (_, worked) = run_fork(self.new_fork()?, scene.start, by, (task, seed))?;
        let of_target = stopping_events(&worked, &self.context.profile);
        if !events.iter().chain([&event]).all(|event| of_target.contains(event)) {
            return Ok(None);
        }
        let event = StoppingEvent::Safety(event);
        let past = past_limit(event, &worked, &self.context.profile);
        Ok(Some(SharedEvent { scene: SceneKind::Live, seed, event, past }))
    }

    /// Has the rollback target run forks of the tasks that the version's monitor was fed, each under an envelope as
    /// tight as the version's, and compares both in the rates that decided.
    ///
    /// # Errors
    /// If no task has a start, or the target could not run one of them: then no difference is shown.
    fn rate_comparison(
        &self,
        ended: Option<&EndedMonitor>,
        rates: &[Rate],
        target: &Capability,
    ) -> Result<RateComparison, UncomparedReason> {
        let ended = ended.ok_or_else(|| self.no_start())?;
        let settings = &self.context.profile.monitor;
        let measured = measured_terms_of(self.context, self.evidence_files, target);
        let tight = measured.clone().tightened(settings.restrict_factor);
        let mut fork = self.new_fork()?;
        let mut pairs = Vec::new();
        for kept in &ended.tasks {
            let Some(start) = &kept.start else { continue };
            let by = (target, if kept.tightened { &tight } else { &measured });
            let (world, worked) = run_fork(fork, start, by, (kept.task, kept.seed))?;
            fork = world;
            let of_target = worked.values().ok_or(UncomparedReason::InvalidFork)?;
            pairs.push(ForkedPair {
                seed: kept.seed,
                version: kept.values,
                target: of_target,
                tightened: kept.tightened,
            });
        }
        if pairs.is_empty() {
            return Err(self.no_start());
        }
        Ok(ended.watched.monitor.rate_comparison(rates, &pairs, settings.paired_alpha))
    }

    /// Why no state at the start of a live task was kept.
    fn no_start(&self) -> UncomparedReason {
        if self.context.cell.spec.abilities.export_state {
            UncomparedReason::NoStart
        } else {
            UncomparedReason::NoExport
        }
    }

    fn new_fork(&self) -> Result<Box<dyn TrialCell>, UncomparedReason> {
        self.context.cell.trial().map_err(|_| UncomparedReason::NoFork)
    }

    /// Runs the rungs that move the arm. A failed body is not at standstill.
    fn bring_to_rest(
        &mut self,
        id: &CapabilityId,
        trip: Option<&Trip>,
        cause: TriggerKind,
        record: &mut RollbackRecord,
    ) -> Result<LadderMotion, EngineFault> {
        let leaving = self.record.capability(id)?;
        let terms = self.terms(&leaving);
        let settings = &self.context.profile.recovery;
        let is_rehearsed =
            self.evidence_files.of(id).is_some_and(|file| file.has_passed_rollback_drills(settings));
        let cause = (cause, is_rehearsed);
        let outcome =
            self.run_drawn(&leaving, &terms, |rig| rig.run_motion_rungs(&leaving, &terms, trip, cause));
        let motion = outcome.unwrap_or_else(|notice| LadderMotion {
            rungs: vec![RungRecord::new(Rung::Hold, Some(RungFailure::NoStandstill), 0, notice)],
            ticks_to_safe: None,
            ticks_since_trigger: 0,
            rung_ticks: 0,
            motion_ticks: 0,
        });
        self.record.advance(ticks_to_ms(motion.rung_ticks));
        record.time_to_safe_ticks = motion.ticks_to_safe;
        record.time_to_safe_ms = motion.ticks_to_safe.map(ticks_to_ms);
        record.unsafe_continuation_ms = ticks_to_ms(motion.motion_ticks);
        for rung in &motion.rungs {
            push_rung(self.record, record, rung.clone());
        }
        Ok(motion)
    }

    /// The predecessor, read from the store again.
    fn load_predecessor(
        &mut self,
        id: &CapabilityId,
        target: Option<VersionRef>,
        record: &mut RollbackRecord,
    ) -> Option<Capability> {
        let known = target.and_then(|target| {
            let entry = self.record.version_table().family(&id.family).ok()?;
            let restorable = entry.state.state(target) == Some(State::Superseded);
            let member = entry.members.get(usize::from(target.0)).filter(|_| restorable)?;
            Some(member.capability.id())
        });
        let profile = self.context.profile.name;
        let admission_problem = known.as_ref().and_then(|known| {
            let version_table = self.record.version_table();
            let refusal =
                not_admitted(self.context, version_table, &version_table.version(known).ok()?.2.capability)?;
            Some(Notice::TargetNotAdmitted { version: known.clone(), profile, refusal })
        });
        let loaded = match (&known, admission_problem) {
            (Some(_), Some(notice)) => Err((RungFailure::PredecessorMissing, notice)),
            (None, _) => Err((RungFailure::PredecessorMissing, Notice::NoTarget)),
            (Some(known), None) => self.record.version_table().reload(known).map_err(|error| {
                let failure = match error {
                    VersionTableError::Store(_) => RungFailure::StoreFailed,
                    VersionTableError::UnknownFamily(_) | VersionTableError::UnknownVersion(_) => {
                        RungFailure::PredecessorMissing
                    }
                    VersionTableError::Exists(_)
                    | VersionTableError::Refused(_)
                    | VersionTableError::Load { .. }
                    | VersionTableError::Record { .. }
                    | VersionTableError::DigestDiffers { .. } => RungFailure::DigestMismatch,
                };
                (failure, Notice::TargetUnreadable { problem: error.to_string() })
            }),
        };
        match loaded {
            Ok(predecessor) => {
                let notice = Notice::TargetVerified { version: predecessor.id() };
                rung(self.record, record, Rung::LoadPredecessor, None, notice);
                Some(predecessor)
            }
            Err((failure, notice)) => {
                rung(self.record, record, Rung::LoadPredecessor, Some(failure), notice);
                None
            }
        }
    }

    /// Compiles the profile's policies again and compares them with those in force, and with the store's context.
    fn policy_failure(&self) -> Option<RungFailure> {
        let compiles_to_same =
            self.context.recompiled().is_ok_and(|table| table.digest == self.context.table.digest);
        let Ok(context) = self.record.version_table().store().views().and_then(|views| views.context())
        else {
            return Some(RungFailure::StoreFailed);
        };
        let is_on_record = context.is_some_and(|(_, digest, _)| digest == self.context.digest);
        (!(compiles_to_same && is_on_record)).then_some(RungFailure::PolicyMismatch)
    }

    /// Ends the current task with its sequence; the version that takes over runs the goal from its first primitive.
    fn abandon_goal(&mut self, in_flight: bool) -> Notice {
        // A task that failed and ended is no longer in flight.
        let abandoned = self.world.cell.rig_mut().map(Rig::give_up).filter(|_| in_flight);
        match abandoned {
            Some(AbandonedGoal { in_flight, planned }) => {
                Notice::TargetBound { task: in_flight, planned: planned as u64 }
            }
            None => Notice::TargetBound { task: None, planned: 0 },
        }
    }

    fn check_target_ready(&mut self, predecessor: &Capability) -> RungRecord {
        let terms = self.terms(predecessor);
        let outcome = self.run_drawn(predecessor, &terms, |rig| rig.check_target_ready(predecessor, &terms));
        outcome.unwrap_or_else(|notice| {
            RungRecord::new(Rung::ReadyPredecessor, Some(RungFailure::PredecessorFailed), 0, notice)
        })
    }

    /// The terms that a version runs under now.
    fn terms(&self, version: &Capability) -> SkillTerms {
        terms_of(self.context, self.record.version_table(), self.evidence_files, self.monitors, version)
    }

    /// Has the arm run a rung of a version, and draws it if video frames are wanted.
    fn run_drawn<T>(
        &mut self,
        of: &Capability,
        terms: &SkillTerms,
        run: impl FnOnce(&mut Rig) -> Result<T, CellError>,
    ) -> Result<T, Notice> {
        let sketch = self.world.frame_sink.clone().map(|sink| {
            let envelope = cell_frame::envelope(terms.envelope());
            let sequence = self.world.cell.sequences().saturating_sub(1);
            LadderPainter::new(sink, self.record.clock().clone(), sequence, of.id(), envelope)
        });
        let Some(rig) = self.world.cell.rig_mut() else { return Err(Notice::ArmOutOfReach) };
        rig.arm_mut().body_mut().draw(sketch);
        let result = run(rig);
        rig.arm_mut().body_mut().draw(None);
        result.map_err(|error| Notice::BodyFailed { problem: error.to_string() })
    }

    /// Leaves the family safe-stopped: a rung failed, or there is no rollback target.
    fn safe_stop(
        &mut self,
        id: &CapabilityId,
        version: VersionRef,
        mut record: RollbackRecord,
    ) -> Result<(), EngineFault> {
        record.post_status = PostStatus::SafeStopped;
        record.predecessor = None;
        record.time_to_restored_ticks = None;
        record.time_to_restored_ms = None;
        record.recovered = Some(false);
        let failure = record.stopped_by();
        let trigger = Box::new(record.trigger.text.clone());
        let note = TransitionNote {
            cause: Some(ActiveCause::Vacate),
            before: vec![evidence(&record)?],
            ..TransitionNote::because(Notice::RollbackFailed { failure, trigger })
        };
        self.record.transition(&id.family, LifecycleEvent::FailRollback { version }, note)?;
        let priority = self.context.profile.alarms.safe_stopped;
        let notice = Notice::SafeStopped { family: id.family.clone(), failure };
        self.record.raise(AlarmKey::SafeStopped(id.family.clone()), priority, true, notice);
        self.record.tell(event(record));
        self.record.close_audit(id, PostStatus::SafeStopped.into())
    }
}

#[cfg(test)]
pub(crate) mod tests;
