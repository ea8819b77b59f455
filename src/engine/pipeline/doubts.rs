//! Versions in doubt: confirmations, suspicious ones that are worked again in the live world's conditions, and what follows.

use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Leave;
use holdpoint_governance::rollback::TriggerKind;

use super::{Pipeline, Work};
use crate::fault::Fault;
use crate::stages::again::{self, AgainRun, AgainStep};
use crate::stages::confirmation::{self, ConfirmationRun};
use crate::stages::monitoring;
use crate::stages::rollback::trigger;
use crate::stages::shadow::ShadowRun;

impl Pipeline {
    /// Begins to work the first suspicious active version again, if there is one. Tells whether there was.
    pub(super) fn begin_again(&mut self) -> Result<bool, Fault> {
        let Some(id) = again::next(&self.monitors, &self.dossiers) else { return Ok(false) };
        let Self { context, record, dossiers, world, .. } = self;
        match again::begin(context, record, dossiers, &world.cell, &id, None)? {
            Some(run) => self.work = Some(Work::Again(run)),
            None => {
                self.demote(&id, "it is suspicious, and there is no predecessor to work it again beside")?;
            }
        }
        Ok(true)
    }

    /// Works a candidate again that shadow found suspicious.
    pub(super) fn begin_again_in_shadow(&mut self, shadow: Box<ShadowRun>) -> Result<(), Fault> {
        let id = shadow.id().clone();
        let Self { context, record, dossiers, world, .. } = self;
        self.work = again::begin(context, record, dossiers, &world.cell, &id, Some(shadow))?.map(Work::Again);
        Ok(())
    }

    pub(super) fn again_slice(&mut self, run: Box<AgainRun>) -> Result<(), Fault> {
        let Self { context, trials, record, dossiers, monitors, .. } = self;
        match again::slice(context, trials, record, dossiers, monitors, run)? {
            AgainStep::GoOn(run, episodes) => {
                self.live_due_for(episodes);
                self.work = Some(Work::Again(run));
                Ok(())
            }
            AgainStep::Gone | AgainStep::Decided => Ok(()),
            AgainStep::Cleared(id) => monitoring::maybe_confirm(record, dossiers, monitors, &id),
            AgainStep::NotCleared(id, why) => {
                self.demote(&id, &format!("it is not what its shadow showed; {why}"))
            }
        }
    }

    pub(super) fn begin_confirmation(&mut self, id: &CapabilityId) -> Result<(), Fault> {
        let Self { context, record, dossiers, .. } = self;
        match confirmation::begin(context, record, dossiers, id)? {
            Some(run) => {
                self.work = Some(Work::Confirmation(run));
                Ok(())
            }
            None => {
                self.demote(id, "its doubt cannot be settled: there is no predecessor to compare it with")
            }
        }
    }

    pub(super) fn confirmation_slice(&mut self, run: Box<ConfirmationRun>) -> Result<(), Fault> {
        let Self { context, trials, record, dossiers, monitors, .. } = self;
        match confirmation::slice(context, trials, record, dossiers, monitors, run)? {
            confirmation::ConfirmationStep::GoOn(run, episodes) => {
                self.live_due_for(episodes);
                self.work = Some(Work::Confirmation(run));
                Ok(())
            }
            confirmation::ConfirmationStep::Gone => Ok(()),
            confirmation::ConfirmationStep::Settled(id) => {
                monitoring::maybe_confirm(record, dossiers, monitors, &id)
            }
            confirmation::ConfirmationStep::DoubtRemains(id) => {
                self.demote(&id, "the doubt it was let in with remains on fresh evidence")
            }
        }
    }

    fn demote(&mut self, id: &CapabilityId, why: &str) -> Result<(), Fault> {
        let trigger = trigger(&self.record, TriggerKind::OpenDoubt, why);
        self.live().take_off(id, trigger, None, Leave::Demoted)
    }
}
