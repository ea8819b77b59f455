//! The clean-up after an interrupted engine: what ran does not count, what was asked is asked anew, a rollback that was
//! under way is finished. It says all of it.

use crate::fault::Fault;
use crate::ledger::Note;
use crate::monitors::Watched;
use crate::people::approvals::void_requests;
use crate::pipeline::Pipeline;
use crate::stages::rollback::trigger;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Leave, LifecycleEvent, Stage, State};
use holdpoint_governance::rollback::TriggerKind;
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::Interrupted;

impl Pipeline {
    /// Finishes or undoes what an interrupted engine left, and says so.
    pub(crate) fn recover(&mut self) -> Result<(), Fault> {
        self.reload_dossiers()?;
        let interrupted = self.record.ledger().store().opening().interrupted.clone();
        let mut restarted = std::collections::BTreeSet::new();
        for left in interrupted {
            match left {
                Interrupted::RollbackPending { version } => {
                    self.say_recovered(&version, "a rollback was under way and is finished now");
                    let trigger = trigger(&self.record, TriggerKind::Restart, "a rollback was interrupted");
                    self.live().take_off(&version, trigger, None, Leave::RolledBack)?;
                }
                Interrupted::Stage { version, .. } => {
                    if restarted.insert(version.family.clone()) {
                        let note = Note::because("the engine came up again: what ran is not done");
                        self.record.transition(&version.family, LifecycleEvent::Restart, note)?;
                    }
                    self.resume_demoted(&version)?;
                    self.say_recovered(&version, "a stage was running; it does not count and is run again");
                }
                Interrupted::Provisional { version } => self.resume_watch(&version)?,
            }
        }
        self.resume_questions()
    }

    /// A version whose repeated stage was interrupted goes back to that stage.
    fn resume_demoted(&mut self, id: &CapabilityId) -> Result<(), Fault> {
        let (version, standing, _) = self.record.ledger().version(id)?;
        if standing.state == State::Demoted {
            let event = LifecycleEvent::Repeat { version, stage: Stage::Sandbox };
            self.record.transition(&id.family, event, Note::because("the repeated stage was interrupted"))?;
        }
        Ok(())
    }

    /// A provisional version is watched again before its next tick, from the start of its window.
    fn resume_watch(&mut self, id: &CapabilityId) -> Result<(), Fault> {
        let (_, standing, _) = self.record.ledger().version(id)?;
        if standing.state != State::Active {
            return Ok(());
        }
        let restricted = standing.flags.restricted;
        let now_tick = self.record.now_tick();
        match Watched::new(id, self.dossiers.of(id), &self.context, now_tick) {
            Ok(mut watched) => {
                watched.restricted = restricted;
                self.monitors.insert(watched);
                self.say_recovered(id, "it is provisional; its window begins anew under a new monitor");
                Ok(())
            }
            Err(fault) => {
                // What cannot be watched does not act.
                self.say_recovered(id, &format!("it cannot be monitored ({fault}) and is rolled back"));
                let text = "no monitor could be set up after a restart";
                let trigger = trigger(&self.record, TriggerKind::Restart, text);
                self.live().take_off(id, trigger, None, Leave::RolledBack)
            }
        }
    }

    /// Questions that were open are asked anew, over the evidence as it was stored.
    fn resume_questions(&mut self) -> Result<(), Fault> {
        let mut open = Vec::new();
        for (family, entry) in self.record.ledger().families() {
            for (index, version) in entry.state.versions.iter().enumerate() {
                if version.flags.awaiting_approval && version.state == State::Shadowed {
                    open.push((family.clone(), index));
                }
            }
        }
        for (family, index) in open {
            let Ok(number) = u16::try_from(index) else { continue };
            let version = holdpoint_governance::lifecycle::VersionRef(number);
            let Some(id) =
                self.record.ledger().family(&family)?.members.get(index).map(|m| m.capability.id())
            else {
                continue;
            };
            let note = Note {
                before: void_requests(self.record.ledger(), &id)?,
                ..Note::because("the engine came up again: people are asked anew")
            };
            self.record.transition(&family, LifecycleEvent::ApprovalExpired { version }, note)?;
            self.say_recovered(&id, "people had been asked; they are asked anew");
        }
        Ok(())
    }

    fn say_recovered(&mut self, version: &CapabilityId, text: &str) {
        self.record.tell(EventKind::Recovered { version: version.clone(), text: text.to_owned() });
    }

    /// Reads the newest evidence of every version that is not history.
    fn reload_dossiers(&mut self) -> Result<(), Fault> {
        let views = self.record.ledger().store().views()?;
        let mut loaded = Vec::new();
        for (_, entry) in self.record.ledger().families() {
            for (member, version) in entry.members.iter().zip(&entry.state.versions) {
                if version.state.is_terminal() {
                    continue;
                }
                let id = member.capability.id();
                let evidence = views.evidence(&id, None)?;
                let newest = evidence.iter().rev().find(|entry| {
                    use holdpoint_registry::names::EvidenceKind;
                    matches!(entry.kind, EvidenceKind::Compat | EvidenceKind::Sandbox | EvidenceKind::Shadow)
                });
                if let Some(dossier) = newest.and_then(|entry| serde_json::from_str(&entry.json).ok()) {
                    loaded.push((id, dossier));
                }
            }
        }
        drop(views);
        self.dossiers.extend(loaded);
        Ok(())
    }
}
