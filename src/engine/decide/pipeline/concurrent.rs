//! The pipeline while the live cell runs on a thread of its own.
//!
//! What has to happen between two sequences waits for the end of the one that runs, what takes authority away stops
//! the arm first. Decides nothing about versions.

use std::sync::Arc;

use holdpoint_approvals::Approval;
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_protocol::command::Command;
use holdpoint_protocol::snapshot::RequestKind;

use super::{Pipeline, SliceOutcome, StageWork};
use crate::decide::halt;
use crate::decide::operations::is_last_version;
use crate::decide::stages::{confirmation, resume};
use crate::fault::EngineFault;
use crate::live::sequence::{FinishedSequence, ShadowResult};

/// When a command may be carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CommandTiming {
    Now,
    Between,
    /// Between two sequences, and the arm is stopped for it.
    Stop,
}

impl Pipeline {
    /// When a command may be carried out.
    pub(crate) fn timing(&self, command: &Command) -> CommandTiming {
        if !self.world.is_running() {
            return CommandTiming::Now;
        }
        let is_active = |id: &CapabilityId| {
            self.record
                .version_table()
                .version(id)
                .is_ok_and(|(_, lifecycle, _)| lifecycle.state == State::Active)
        };
        match command {
            // It only asks back; the arm works on.
            Command::Rollback(operation) | Command::Demote { operation, .. }
                if is_last_version(&self.context, &self.record, &operation.version) =>
            {
                CommandTiming::Now
            }
            command if command.stops_the_arm() => CommandTiming::Stop,
            Command::Demote { operation, .. } | Command::Reject(operation)
                if is_active(&operation.version) =>
            {
                CommandTiming::Stop
            }
            // The deadline of a question does not wait for the end of a sequence, so the answer does not either.
            Command::Continue(operation) if self.monitors.has_question(&operation.version) => {
                CommandTiming::Stop
            }
            Command::Release { operation, profiles } if profiles.is_empty() => {
                let has_question = self.monitors.has_question(&operation.version);
                if has_question { CommandTiming::Stop } else { CommandTiming::Between }
            }
            Command::Decide { signed } => self.decision_timing(signed.approval()),
            command if command.facts().waits_for_sequence => CommandTiming::Between,
            _ => CommandTiming::Now,
        }
    }

    /// Versions and envelopes change between two sequences; a reviewer's rejection stops the sequence that runs.
    fn decision_timing(&self, approval: &Approval) -> CommandTiming {
        match self.approvals.of(&approval.version).map(|pending| pending.kind) {
            _ if approval.break_glass => CommandTiming::Between,
            Some(RequestKind::Review) if approval.decision == ApprovalDecision::Reject => CommandTiming::Stop,
            Some(RequestKind::Release) => CommandTiming::Between,
            Some(RequestKind::Review | RequestKind::Activation | RequestKind::Emergency) | None => {
                CommandTiming::Now
            }
        }
    }

    /// Ends a finished sequence. Returns whether no sequence runs any more; `wait` waits for its end. A fault
    /// halts the engine.
    pub(crate) fn collect_sequence(&mut self, wait: bool) -> bool {
        let finished = self.world.thread.as_mut().and_then(|thread| thread.finished(wait));
        if let Some(finished) = finished
            && let Err(fault) = finished.and_then(|worked| self.finish_sequence(worked))
        {
            self.hold(&fault.halt_problem());
        }
        !self.world.is_running()
    }

    /// One slice of an engine whose live world has a thread of its own.
    pub(super) fn concurrent_slice(&mut self) -> Result<SliceOutcome, EngineFault> {
        if self.world.is_running() {
            let finished = self.world.thread.as_mut().and_then(|thread| thread.finished(false));
            if let Some(finished) = finished {
                self.finish_sequence(finished?)?;
                return Ok(SliceOutcome::Ran);
            }
            if self.live().look_at_questions()? || self.activation().look_at_deadlines()? {
                return Ok(SliceOutcome::Ran);
            }
        } else {
            if self.between_sequences()? {
                return Ok(SliceOutcome::Ran);
            }
            self.start_sequence()?;
        }
        self.evaluate_meanwhile()
    }

    /// Whether the comparison under way is concluded by its next slice, which needs no sequence to run; absent if no stage is
    /// under way beside which the live world continues.
    fn is_concluding(&self) -> Option<bool> {
        match self.work.as_ref()? {
            StageWork::Sandbox(_) => Some(false),
            StageWork::Confirmation(run) => Some(run.is_over() || self.has_spent_time(&run.id)),
            StageWork::ReEvaluation(run) => Some(run.is_over() || self.has_spent_time(&run.id)),
            StageWork::Shadow(_) => None,
        }
    }

    /// Does one of the steps that need no sequence to run. Returns whether there was one.
    fn between_sequences(&mut self) -> Result<bool, EngineFault> {
        if self.look_at_deadlines()? || self.activation().take_granted()? {
            return Ok(true);
        }
        if self.is_concluding() == Some(true)
            && let Some(work) = self.work.take()
        {
            self.work_slice(work)?;
            return Ok(true);
        }
        if self.work.is_some() {
            return Ok(false);
        }
        if let Some(id) = confirmation::next(&self.monitors, &self.evidence_files) {
            self.begin_confirmation(&id)?;
            return Ok(true);
        }
        if self.begin_re_evaluation()? {
            return Ok(true);
        }
        if let Some((id, Stage::Activation)) = self.next_stage() {
            self.begin(&id, Stage::Activation)?;
            return Ok(true);
        }
        Ok(false)
    }

    /// Work that the live world does not wait for.
    fn evaluate_meanwhile(&mut self) -> Result<SliceOutcome, EngineFault> {
        if self.is_concluding() == Some(false)
            && let Some(work) = self.work.take()
        {
            self.work_slice(work)?;
            return Ok(SliceOutcome::Ran);
        }
        if self.work.is_none()
            && let Some((id, stage)) = self.next_stage()
            && stage != Stage::Activation
        {
            self.begin(&id, stage)?;
            return Ok(SliceOutcome::Ran);
        }
        Ok(SliceOutcome::Idle { next_ms: self.next_deadline_ms() })
    }

    /// Lets the live world work the next sequence, with the candidate in shadow if there is one.
    fn start_sequence(&mut self) -> Result<(), EngineFault> {
        if self.world.thread.as_ref().is_none_or(crate::live::thread::LiveThread::rests) {
            return Ok(());
        }
        let shadow = self.shadow_to_take()?;
        let at_work = self.record.version_table().families().filter_map(|(_, entry)| entry.active());
        let at_work = at_work.map(|member| {
            let id = member.capability.id();
            let last = is_last_version(&self.context, &self.record, &id);
            (id, last)
        });
        self.world.switch().work_under(at_work.collect());
        let begun = self.live().begin_sequence()?;
        self.world.stopped = None;
        let clock = self.record.clock().clone();
        let sink = self.world.frame_sink.clone().unwrap_or_else(|| Arc::new(|_| ()));
        let Some(thread) = &mut self.world.thread else { return Ok(()) };
        thread.start(begun, shadow, sink, clock)
    }

    /// Processes a finished sequence.
    pub(super) fn finish_sequence(&mut self, mut worked: FinishedSequence) -> Result<(), EngineFault> {
        let shadowed = worked.shadow.take();
        self.world.stopped.clone_from(&worked.stopped);
        if self.record.holding().is_some() {
            // Arm and agent are taken back without any conclusion.
            self.world.cell.take_back(worked.running);
            return Ok(());
        }
        let nothing = worked.report.tasks.iter().all(|done| done.record.refused || done.record.invalid);
        if let Some(thread) = &mut self.world.thread {
            thread.rest_if(nothing);
        }
        let mut live = self.live();
        live.look_at_questions()?;
        let report = live.end_sequence(worked)?;
        resume::look_at(&self.context, &mut self.record, &mut self.resumptions, &report)?;
        if let Some(reason) = &report.lost {
            halt::stop_lost(&mut self.record, &mut self.world, reason);
        }
        match shadowed {
            Some(ShadowResult { id, trace, fork }) => self.shadow_worked(&id, trace, fork),
            None => Ok(()),
        }
    }
}
