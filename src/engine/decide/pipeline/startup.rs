//! How a pipeline begins: what it announces, the versions a cell is commissioned with, and each stage of a candidate.

use holdpoint_governance::ablation::AblationPart;
use holdpoint_governance::alarms::{AlarmEvent, AlarmKey, Priority};
use holdpoint_governance::approval::Requester;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::notice::Notice;
use holdpoint_protocol::event::EventKind;
use holdpoint_runtime::capability::Capability;
use holdpoint_store::ActiveCause;

use super::{Pipeline, StageWork};
use crate::decide::operations::registered_event;
use crate::decide::stages::{omitted_stage, sandbox, shadow, validation};
use crate::decide::store_identity::{StoreAgent, VoidedFamilies};
use crate::fault::EngineFault;
use holdpoint_record::version_table::{TransitionNote, VersionOrigin};

impl Pipeline {
    /// The agent the store is for, and the one that dispatches.
    pub(super) fn bound_agent(&self) -> StoreAgent {
        StoreAgent { recorded: self.agent, present: self.world.cell.agent_hash() }
    }

    /// Who starts under what, and what is void by it.
    pub(super) fn announce(&mut self, voided: Option<VoidedFamilies>) {
        let active = self
            .record
            .version_table()
            .families()
            .filter_map(|(_, entry)| entry.active().map(|member| member.capability.id()))
            .collect();
        self.record.tell(EventKind::EngineStarted {
            profile: self.context.profile.name,
            site: self.context.profile.site.clone(),
            robot: self.context.cell.spec.robot.name.clone(),
            seed: self.record.seeds().of_run(),
            policy: self.context.digest,
            agent: self.world.cell.agent_hash(),
            active,
        });
        let Some(VoidedFamilies { families, reason }) = voided else { return };
        for family in families {
            self.record.tell(EventKind::Voided { family, reason: reason.clone().into() });
        }
    }

    /// An alarm stands as long as no administrator authorized the profile.
    pub(super) fn look_at_authorization(&mut self) {
        let key = AlarmKey::ProfileUnauthorized;
        let is_raised = self.record.alarms().get(&key).is_some_and(|alarm| alarm.condition);
        match &self.context.unauthorized {
            Some(why) => self.record.raise(key, Priority::High, false, why.clone()),
            None if is_raised => self.record.alarm_event(&AlarmEvent::Clear { key }),
            None => {}
        }
    }

    pub(super) fn bootstrap(&mut self, baseline: Capability) -> Result<(), EngineFault> {
        let id = baseline.id();
        let event = registered_event(&baseline, &Requester::Program);
        let note = TransitionNote {
            cause: Some(ActiveCause::Bootstrap),
            ..TransitionNote::because(Notice::CommissionedWith)
        };
        self.record.register(
            (baseline, VersionOrigin::of(Requester::Program)),
            true,
            self.context.needs_approval(),
            note,
        )?;
        self.record.tell(event);
        self.record.tell(EventKind::StateChanged {
            version: id,
            from: State::Registered,
            to: State::Active,
            reason: Notice::CommissionedWith.into(),
        });
        Ok(())
    }

    /// Begins a stage of a candidate, or passes over one that an experiment leaves out.
    pub(super) fn begin(&mut self, id: &CapabilityId, stage: Stage) -> Result<(), EngineFault> {
        self.parked.retain(|work| work.id() != id);
        let Self { context, record, evidence_files, .. } = self;
        match stage {
            Stage::Sandbox if context.omitted.has(AblationPart::Sandbox) => {
                omitted_stage::pass_over(context, record, evidence_files, id, stage)?;
            }
            Stage::Shadow if context.omitted.has(AblationPart::Shadow) => {
                omitted_stage::pass_over(context, record, evidence_files, id, stage)?;
            }
            Stage::Validation => validation::run(context, record, evidence_files, id)?,
            Stage::Sandbox => {
                self.work = Some(StageWork::Sandbox(sandbox::begin(context, record, evidence_files, id)?));
            }
            Stage::Shadow => {
                self.work = Some(StageWork::Shadow(shadow::begin(context, record, evidence_files, id)?));
            }
            Stage::Activation => self.activation().run(id)?,
        }
        Ok(())
    }
}
