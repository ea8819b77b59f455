//! The clean-up after an interrupted engine: what ran does not count, what was asked is asked anew, a rollback that was
//! under way is finished. It says all of it.

use crate::dossier::Dossiers;
use crate::fault::Fault;
use crate::ledger::Note;
use crate::monitors::Watched;
use crate::people::approvals::void_requests;
use crate::record::Record;
use crate::stages::monitoring::Live;
use crate::stages::rollback::trigger;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Leave, LifecycleEvent, Stage, State};
use holdpoint_governance::rollback::TriggerKind;
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::Interrupted;

/// Finishes or undoes what an interrupted engine left, and says so.
pub(crate) fn recover(live: &mut Live<'_>) -> Result<(), Fault> {
    reload_dossiers(live.record, live.dossiers)?;
    let interrupted = live.record.ledger().store().opening().interrupted.clone();
    let mut restarted = std::collections::BTreeSet::new();
    for left in interrupted {
        match left {
            Interrupted::RollbackPending { version } => {
                say_recovered(live.record, &version, "a rollback was under way and is finished now");
                let trigger = trigger(live.record, TriggerKind::Restart, "a rollback was interrupted");
                live.take_off(&version, trigger, None, Leave::RolledBack)?;
            }
            Interrupted::Stage { version, .. } => {
                if restarted.insert(version.family.clone()) {
                    let note = Note::because("the engine came up again: what ran is not done");
                    live.record.transition(&version.family, LifecycleEvent::Restart, note)?;
                }
                resume_demoted(live.record, &version)?;
                say_recovered(
                    live.record,
                    &version,
                    "a stage was running; it does not count and is run again",
                );
            }
            Interrupted::Provisional { version } => resume_watch(live, &version)?,
        }
    }
    resume_questions(live.record)
}

/// A version whose repeated stage was interrupted goes back to that stage.
fn resume_demoted(record: &mut Record, id: &CapabilityId) -> Result<(), Fault> {
    let (version, standing, _) = record.ledger().version(id)?;
    if standing.state == State::Demoted {
        let event = LifecycleEvent::Repeat { version, stage: Stage::Sandbox };
        record.transition(&id.family, event, Note::because("the repeated stage was interrupted"))?;
    }
    Ok(())
}

/// A provisional version is watched again before its next tick, from the start of its window.
fn resume_watch(live: &mut Live<'_>, id: &CapabilityId) -> Result<(), Fault> {
    let (_, standing, _) = live.record.ledger().version(id)?;
    if standing.state != State::Active {
        return Ok(());
    }
    let restricted = standing.flags.restricted;
    let now_tick = live.record.now_tick();
    match Watched::new(id, live.dossiers.of(id), live.context, now_tick) {
        Ok(mut watched) => {
            watched.restricted = restricted;
            live.monitors.insert(watched);
            say_recovered(live.record, id, "it is provisional; its window begins anew under a new monitor");
            Ok(())
        }
        Err(fault) => {
            // What cannot be watched does not act.
            say_recovered(live.record, id, &format!("it cannot be monitored ({fault}) and is rolled back"));
            let text = "no monitor could be set up after a restart";
            let trigger = trigger(live.record, TriggerKind::Restart, text);
            live.take_off(id, trigger, None, Leave::RolledBack)
        }
    }
}

/// Questions that were open are asked anew, over the evidence as it was stored.
fn resume_questions(record: &mut Record) -> Result<(), Fault> {
    let mut open = Vec::new();
    for (family, entry) in record.ledger().families() {
        for (index, version) in entry.state.versions.iter().enumerate() {
            if version.flags.awaiting_approval && matches!(version.state, State::Shadowed | State::Active) {
                open.push((family.clone(), index));
            }
        }
    }
    for (family, index) in open {
        let Ok(number) = u16::try_from(index) else { continue };
        let version = holdpoint_governance::lifecycle::VersionRef(number);
        let Some(id) = record.ledger().family(&family)?.members.get(index).map(|m| m.capability.id()) else {
            continue;
        };
        let note = Note {
            before: void_requests(record.ledger(), &id)?,
            ..Note::because("the engine came up again: people are asked anew")
        };
        let restricted = record.ledger().version(&id)?.1.state == State::Active;
        record.transition(&family, LifecycleEvent::ApprovalExpired { version }, note)?;
        let what = if restricted {
            "people had been asked to release it; it stays restricted until they are asked anew"
        } else {
            "people had been asked; they are asked anew"
        };
        say_recovered(record, &id, what);
    }
    Ok(())
}

fn say_recovered(record: &mut Record, version: &CapabilityId, text: &str) {
    record.tell(EventKind::Recovered { version: version.clone(), text: text.to_owned() });
}

/// Reads the newest evidence of every version that is not history.
fn reload_dossiers(record: &Record, dossiers: &mut Dossiers) -> Result<(), Fault> {
    let views = record.ledger().store().views()?;
    let mut loaded = Vec::new();
    for (_, entry) in record.ledger().families() {
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
    dossiers.extend(loaded);
    Ok(())
}
