//! The clean-up after an interrupted engine: what ran does not count, what was asked is asked anew, a rollback that was
//! under way is finished. It says all of it.

use crate::binding::{NotAdmitted, not_admitted};
use crate::context::Context;
use crate::dossier::{Dossier, Dossiers};
use crate::doubt::Suspicion;
use crate::fault::Fault;
use crate::ledger::Note;
use crate::monitors::Watched;
use crate::operations::say_refused_form;
use crate::people::approvals::{Approvals, void_requests};
use crate::record::Record;
use crate::stages::monitoring::Live;
use crate::stages::rollback::trigger;
use holdpoint_governance::alarms::{AlarmKey, Priority};
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::Decision;
use holdpoint_governance::gate::GateOutcome;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Leave, LifecycleEvent, Stage, State};
use holdpoint_governance::rollback::TriggerKind;
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::names::EvidenceKind;
use holdpoint_registry::{EvidenceEntry, FoundTelemetry, Interrupted, SetAside};
use holdpoint_runtime::capability::Capability;

/// Finishes or undoes what an interrupted engine left, and says so.
pub(crate) fn recover(live: &mut Live<'_>, approvals: &mut Approvals) -> Result<(), Fault> {
    take_in_telemetry(live.record)?;
    let members = live.record.ledger().families().flat_map(|(_, entry)| &entry.members);
    let refused: Vec<Capability> = members
        .filter(|member| member.capability.bundle.refused_form())
        .map(|member| member.capability.clone())
        .collect();
    for version in refused {
        say_refused_form(live.record, &version);
    }
    reload_dossiers(live.context, live.record, live.dossiers)?;
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
    leave_unadmitted(live)?;
    resume_questions(live, approvals)
}

/// What became of telemetry since the last engine is on record before anything else is: what nobody had sealed is sealed
/// as found, what is not there any more is told.
fn take_in_telemetry(record: &mut Record) -> Result<(), Fault> {
    let FoundTelemetry { changes, missing, aside, .. } = record.ledger().store().opening().telemetry.clone();
    if !changes.is_empty() {
        record.write(changes, Vec::new())?;
    }
    let text = match aside.last() {
        // The newest: the record names all.
        Some(SetAside { file, problem }) => {
            let lacks = match missing {
                0 => "every sealed batch".to_owned(),
                lost => format!("every sealed batch but {lost}, and what these held is in no metric"),
            };
            format!(
                "telemetry.db was put aside and is kept as {file}; the new one has {lacks}; why: {problem}"
            )
        }
        None if missing > 0 => format!(
            "{missing} sealed batches of telemetry are not in the store's telemetry.db any more, and no record says why: \
             somebody removed them or the file, or the disk lost it; what they held is in no metric; if there is a copy \
             of the store, `holdpoint metrics` and `audit verify` tell there what it was"
        ),
        None => return Ok(()),
    };
    record.raise(AlarmKey::TelemetryMissed, Priority::High, true, &text);
    Ok(())
}

/// What does not admit the profile that the store was opened under, or has it closed, is taken off: a version for
/// simulation alone gets no other arm.
fn leave_unadmitted(live: &mut Live<'_>) -> Result<(), Fault> {
    let ledger = live.record.ledger();
    let active = ledger.families().filter_map(|(_, entry)| entry.active());
    let stray: Vec<(CapabilityId, NotAdmitted)> = active
        .filter_map(|member| {
            let why = not_admitted(live.context, ledger, &member.capability)?;
            // Under a profile that is not in force yet nothing acts.
            let waits = live.context.unauthorized.is_some() && matches!(why, NotAdmitted::LetInByLess(_));
            (!waits).then(|| (member.capability.id(), why))
        })
        .collect();
    for (id, why) in stray {
        let profile = live.context.profile.name;
        let why = why.text(profile);
        say_recovered(live.record, &id, &format!("it {why} and is taken off"));
        let text = format!("the store was opened under the profile {profile}: the version {why}");
        let trigger = trigger(live.record, TriggerKind::ProfileNotAdmitted, &text);
        live.take_off(&id, trigger, None, Leave::Demoted)?;
    }
    Ok(())
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

/// Questions that were open are open as they were, with the answers that were given. People are asked anew only where
/// something has changed that they were asked about.
fn resume_questions(live: &mut Live<'_>, approvals: &mut Approvals) -> Result<(), Fault> {
    let record = &mut *live.record;
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
        if let Some(answers) = approvals.take_up(live.context, record, live.dossiers, &id)? {
            let priority = live.context.profile.alarms.approval_waiting;
            record.raise(
                AlarmKey::Approval(id.clone()),
                priority,
                false,
                &format!("{id} waits for approval"),
            );
            let text =
                format!("people had been asked; the question is open as it was, with {answers} answers");
            say_recovered(record, &id, &text);
            continue;
        }
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

/// What is still said of a version that is history; what was measured of it stays in the store.
fn what_is_said_of(dossier: Dossier) -> Dossier {
    let Dossier { kappas, conditions, reasons, .. } = dossier;
    Dossier { kappas, conditions, reasons, ..Dossier::default() }
}

/// Reads the newest evidence of every version.
fn reload_dossiers(context: &Context, record: &Record, dossiers: &mut Dossiers) -> Result<(), Fault> {
    let views = record.ledger().store().views()?;
    let mut loaded = Vec::new();
    for (_, entry) in record.ledger().families() {
        for (member, version) in entry.members.iter().zip(&entry.state.versions) {
            let id = member.capability.id();
            let evidence = views.evidence(&id, None)?;
            let is_over = version.state.is_terminal();
            let mut kept = evidence.iter().rev().filter(|entry| match entry.kind {
                EvidenceKind::Compat | EvidenceKind::Sandbox | EvidenceKind::Shadow => true,
                // Of a refusal at the gate; of a pass it is no dossier.
                EvidenceKind::Gate => is_over,
                EvidenceKind::Activation
                | EvidenceKind::Monitor
                | EvidenceKind::Rollback
                | EvidenceKind::Drill => false,
            });
            let newest = kept.find_map(|entry| serde_json::from_str::<Dossier>(&entry.json).ok());
            let Some(mut dossier) = newest else { continue };
            if is_over {
                dossier = what_is_said_of(dossier);
            } else if version.state == State::Active {
                dossier.conditions = conditions_in_force(context, &evidence, &dossier.conditions);
                if !version.flags.provisional {
                    dossier.conditions.retain(Condition::outlives_confirmation);
                }
                dossier.suspicion = suspicion_on_record(&evidence);
            }
            loaded.push((id, dossier));
        }
    }
    drop(views);
    dossiers.extend(loaded);
    Ok(())
}

/// What an active version is suspected of since its shadow, and what working it again came to.
fn suspicion_on_record(evidence: &[EvidenceEntry]) -> Option<Suspicion> {
    let since = evidence.iter().rev().take_while(|entry| entry.kind != EvidenceKind::Shadow);
    let mut found = since.filter(|entry| entry.kind == EvidenceKind::Monitor);
    found.find_map(|entry| serde_json::from_str(&entry.json).ok())
}

/// The conditions of an active version: those its gate was passed under. What people approved under another profile or
/// other policies is no approval under these.
fn conditions_in_force(
    context: &Context,
    evidence: &[EvidenceEntry],
    measured: &[Condition],
) -> Vec<Condition> {
    let gate = evidence.iter().rev().find(|entry| entry.kind == EvidenceKind::Gate);
    let passed = gate.and_then(|entry| serde_json::from_str::<Decision<GateOutcome>>(&entry.json).ok());
    let under_these = passed.as_ref().is_some_and(|decision| {
        let under = decision.made_under();
        under.profile == context.profile_digest && under.policy == context.table.digest
    });
    let mut conditions =
        passed.map_or_else(|| measured.to_vec(), |passed| passed.answers().conditions.clone());
    if !under_these {
        conditions.retain(|condition| !matches!(condition, Condition::ApprovalRequired { .. }));
    }
    conditions
}

#[cfg(test)]
mod tests;
