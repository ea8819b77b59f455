//! How a pipeline begins: what it announces, and the versions a cell is commissioned with.

use holdpoint_governance::lifecycle::State;
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::ActiveCause;
use holdpoint_runtime::capability::Capability;

use super::Pipeline;
use crate::bound::{BoundAgent, VoidedNow};
use crate::fault::Fault;
use crate::ledger::Note;
use crate::operations::registered_event;

impl Pipeline {
    /// The agent the store is for, and the one that dispatches.
    pub(super) fn bound_agent(&self) -> BoundAgent {
        BoundAgent { recorded: self.agent, present: self.world.cell.agent_hash() }
    }

    /// Who starts under what, and what is void by it.
    pub(super) fn announce(&mut self, voided: Option<VoidedNow>) {
        let active = self
            .record
            .ledger()
            .families()
            .filter_map(|(_, entry)| entry.active().map(|member| member.capability.id()))
            .collect();
        self.record.tell(EventKind::EngineStarted {
            profile: self.context.profile.name,
            site: self.context.profile.site.clone(),
            robot: self.context.cell.model.name.clone(),
            seed: self.trials.seed(),
            policy: self.context.digest,
            agent: self.world.cell.agent_hash(),
            active,
        });
        let Some(VoidedNow { families, reason }) = voided else { return };
        for family in families {
            self.record.tell(EventKind::Voided { family, reason: reason.clone() });
        }
    }

    pub(super) fn bootstrap(&mut self, baseline: Capability) -> Result<(), Fault> {
        const WHY: &str = "the version the cell was commissioned with";
        let id = baseline.id();
        let event = registered_event(&baseline);
        let note = Note { cause: Some(ActiveCause::Bootstrap), ..Note::because(WHY) };
        self.record.register(baseline, true, self.context.needs_approval(), note)?;
        self.record.tell(event);
        self.record.tell(EventKind::StateChanged {
            version: id,
            from: State::Registered,
            to: State::Active,
            reason: WHY.to_owned(),
        });
        Ok(())
    }
}
