//! Versions with a concern: confirmation, re-evaluation in the live cell's conditions, and the consequences.

use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::DeactivationKind;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::rollback::TriggerKind;

use super::{Pipeline, StageWork};
use crate::decide::stages::confirmation::{self, ConfirmationRun, ConfirmationStep};
use crate::decide::stages::monitoring;
use crate::decide::stages::re_evaluation::{self, ReEvaluationRun, ReEvaluationStep};
use crate::decide::stages::rollback::trigger;
use crate::decide::stages::shadow::ShadowRun;
use crate::fault::EngineFault;

impl Pipeline {
    /// Begins to re-evaluate the first active version with an open concern. Returns whether there is one.
    pub(super) fn begin_re_evaluation(&mut self) -> Result<bool, EngineFault> {
        let next = re_evaluation::next(self.record.version_table(), &self.evidence_files);
        let Some(id) = next else { return Ok(false) };
        let Self { context, record, evidence_files, world, .. } = self;
        match re_evaluation::begin(context, record, evidence_files, &world.cell, &id, None)? {
            Some(run) => self.work = Some(StageWork::ReEvaluation(run)),
            None => self.demote(&id, Notice::ShiftWithoutTarget)?,
        }
        Ok(true)
    }

    /// Re-evaluates a candidate whose behavior shifted in shadow.
    pub(super) fn begin_again_in_shadow(&mut self, shadow: Box<ShadowRun>) -> Result<(), EngineFault> {
        let id = shadow.id.clone();
        let Self { context, record, evidence_files, world, .. } = self;
        self.work = re_evaluation::begin(context, record, evidence_files, &world.cell, &id, Some(shadow))?
            .map(StageWork::ReEvaluation);
        Ok(())
    }

    pub(super) fn re_evaluation_slice(&mut self, run: Box<ReEvaluationRun>) -> Result<(), EngineFault> {
        let (id, begun_ms) = (run.id.clone(), self.record.now_ms());
        let Self { context, trials, record, evidence_files, .. } = self;
        let step = re_evaluation::slice(context, trials, record, evidence_files, run)?;
        self.note_slice_time(&id, begun_ms);
        let Self { record, evidence_files, monitors, .. } = self;
        match step {
            ReEvaluationStep::GoOn(run, episodes) => {
                self.live_due_for(episodes);
                self.work = Some(StageWork::ReEvaluation(run));
                Ok(())
            }
            ReEvaluationStep::Gone | ReEvaluationStep::Decided => Ok(()),
            ReEvaluationStep::Cleared(id) => monitoring::maybe_confirm(record, evidence_files, monitors, &id),
            ReEvaluationStep::NotCleared(id, reason) => {
                self.demote(&id, Notice::DiffersFromShadow { reason })
            }
            ReEvaluationStep::TimeSpent(id, reason) => self.demote(&id, Notice::Decided { reason }),
        }
    }

    pub(super) fn begin_confirmation(&mut self, id: &CapabilityId) -> Result<(), EngineFault> {
        let Self { context, record, evidence_files, .. } = self;
        match confirmation::begin(context, record, evidence_files, id)? {
            Some(run) => {
                self.work = Some(StageWork::Confirmation(run));
                Ok(())
            }
            None => self.demote(id, Notice::ConcernWithoutTarget),
        }
    }

    pub(super) fn confirmation_slice(&mut self, run: Box<ConfirmationRun>) -> Result<(), EngineFault> {
        let (id, begun_ms) = (run.id.clone(), self.record.now_ms());
        let Self { context, trials, record, evidence_files, monitors, .. } = self;
        let step = confirmation::slice(context, trials, record, evidence_files, monitors, run)?;
        self.note_slice_time(&id, begun_ms);
        let Self { record, evidence_files, monitors, .. } = self;
        match step {
            ConfirmationStep::GoOn(run, episodes) => {
                self.live_due_for(episodes);
                self.work = Some(StageWork::Confirmation(run));
                Ok(())
            }
            ConfirmationStep::Gone => Ok(()),
            ConfirmationStep::Settled(id) => monitoring::maybe_confirm(record, evidence_files, monitors, &id),
            ConfirmationStep::ConcernRemains(id) => self.demote(&id, Notice::ConcernRemains),
            ConfirmationStep::TimeSpent(id, reason) => self.demote(&id, Notice::Decided { reason }),
        }
    }

    fn demote(&mut self, id: &CapabilityId, why: Notice) -> Result<(), EngineFault> {
        let trigger = trigger(&self.record, TriggerKind::OpenDoubt, why);
        self.live().deactivate(id, trigger, None, DeactivationKind::Demoted)
    }
}
