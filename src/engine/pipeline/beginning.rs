//! How a pipeline begins: what it announces, and the versions a cell is commissioned with.

use holdpoint_governance::lifecycle::State;
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::ActiveCause;
use holdpoint_runtime::capability::Capability;

use super::Pipeline;
use crate::fault::Fault;
use crate::ledger::Note;
use crate::operations::registered_event;

impl Pipeline {
    /// Whether the agent that dispatches is the one the store is for.
    pub(super) fn is_same_agent(&self) -> bool {
        self.world.cell.agent_hash() == self.agent
    }

    pub(super) fn announce(&mut self) {
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
