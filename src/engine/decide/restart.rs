//! The clean-up after an interrupted engine: interrupted stages do not count, open requests are asked again, and an
//! interrupted rollback is finished. Publishes each step.

use crate::decide::operations::report_refused_form;
use crate::decide::people::approvals::{Approvals, void_requests};
use crate::decide::recorder::EngineRecorder;
use crate::decide::stages::live_harm::{self, LiveHarmWatch};
use crate::decide::stages::monitoring::LiveMonitoring;
use crate::decide::stages::rollback::{RequestedRollback, trigger};
use crate::fault::EngineFault;
use crate::live::monitors::ActivationMonitor;
use holdpoint_governance::alarms::{AlarmKey, Priority};
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Decision, Reason};
use holdpoint_governance::gate::GateOutcome;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{DeactivationKind, LifecycleEvent, Stage, State};
use holdpoint_governance::monitor::{MonitorOutcome, deciding_rates};
use holdpoint_governance::notice::{AdmissionRefusal, Notice};
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_governance::rollback::{Trigger, TriggerKind, deactivation_for};
use holdpoint_protocol::event::EventKind;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::not_admitted;
use holdpoint_record::evidence_file::{EvidenceFile, EvidenceFiles};
use holdpoint_record::rationale::lenient_bodies::{MonitorRecord, ReasonRecord};
use holdpoint_record::version_concern::VersionConcern;
use holdpoint_record::version_table::TransitionNote;
use holdpoint_runtime::capability::Capability;
use holdpoint_store::{
    AuditFilter, EvidenceEntry, EvidenceKind, InterruptedWork, QuarantinedFile, StartupTelemetry, StoreError,
};

/// Finishes or undoes the interrupted work of an earlier engine.
pub(crate) fn recover(live: &mut LiveMonitoring<'_>, approvals: &mut Approvals) -> Result<(), EngineFault> {
    live.is_starting = true;
    take_in_telemetry(live.record)?;
    let members = live.record.version_table().families().flat_map(|(_, entry)| &entry.members);
    let refused: Vec<Capability> = members
        .filter(|member| member.capability.bundle.refused_form())
        .map(|member| member.capability.clone())
        .collect();
    for version in refused {
        report_refused_form(live.record, &version);
    }
    reload_evidence_files(live.context, live.record, live.evidence_files)?;
    *live.live_harm = LiveHarmWatch::recall(live.context, live.record, live.evidence_files)?;
    let interrupted = live.record.version_table().store().opening().interrupted.clone();
    let mut restarted = std::collections::BTreeSet::new();
    for work in interrupted {
        match work {
            InterruptedWork::RollbackPending { version } => {
                if let Some(requested) = requested_rollback(live.record, &version)? {
                    continue_requested(live, &version, requested)?;
                } else {
                    let reasons = decided_rollback(live.record, &version)?;
                    continue_rollback(live, &version, reasons.as_deref())?;
                }
            }
            InterruptedWork::Stage { version, .. } => {
                if restarted.insert(version.family.clone()) {
                    let note = TransitionNote::because(Notice::StageVoidedByRestart);
                    live.record.transition(&version.family, LifecycleEvent::Restart, note)?;
                }
                let is_run_again = resume_demoted(live.record, &version)?;
                let notice = if is_run_again { Notice::StageRunAgain } else { Notice::RetryInterrupted };
                report_recovered(live.record, &version, notice);
            }
            InterruptedWork::Provisional { version } => resume_watch(live, &version)?,
        }
    }
    begin_decided_rollbacks(live)?;
    deactivate_unadmitted(live)?;
    resume_questions(live, approvals)
}

/// Rolls back the active versions whose rollback was decided and had not begun when the last engine ended.
fn begin_decided_rollbacks(live: &mut LiveMonitoring<'_>) -> Result<(), EngineFault> {
    let active = live.record.version_table().families().filter_map(|(_, entry)| entry.active());
    let active: Vec<CapabilityId> = active.map(|member| member.capability.id()).collect();
    for id in active {
        if let Some(reasons) = decided_rollback(live.record, &id)?
            && live.is_replaceable(&id)?
        {
            continue_rollback(live, &id, Some(&reasons))?;
        }
    }
    Ok(())
}

/// The reasons for which the monitor, or the harm of a live task, ended the control of a version since it became active;
/// `None` if neither did. Such a decision ends the active state, so that one on record is still to be carried out.
fn decided_rollback(
    record: &EngineRecorder,
    version: &CapabilityId,
) -> Result<Option<Vec<Reason>>, EngineFault> {
    let action = newest_in_control(record, version, RecordKind::Monitor)?
        .and_then(|action| serde_json::from_str::<MonitorRecord>(&action.body).ok())
        .filter(|action| action.action == MonitorOutcome::Rollback);
    if let Some(action) = action {
        return Ok(Some(action.reasons.iter().filter_map(ReasonRecord::known).collect()));
    }
    let harm = newest_in_control(record, version, RecordKind::LiveHarm)?;
    let harm = harm.map(|task| live_harm::recorded_reasons(&task.body));
    Ok(harm.filter(|reasons| !reasons.is_empty()))
}

/// The rollback of a version that a person decided and that has begun since the version became active.
fn requested_rollback(
    record: &EngineRecorder,
    version: &CapabilityId,
) -> Result<Option<RequestedRollback>, EngineFault> {
    let found = newest_in_control(record, version, RecordKind::RollbackRequested)?;
    Ok(found.and_then(|found| serde_json::from_str(&found.body).ok()))
}

/// The newest record of a kind about a version since it became active.
fn newest_in_control(
    record: &EngineRecorder,
    version: &CapabilityId,
    kind: RecordKind,
) -> Result<Option<AuditRecord>, EngineFault> {
    let views = record.version_table().store().views()?;
    let newest = |kind| {
        let filter = AuditFilter { subject: Some(version.to_string()), ..AuditFilter::newest(kind) };
        Ok::<_, StoreError>(views.audit(&filter)?.into_iter().next())
    };
    let active_since = newest(RecordKind::StateSet)?.map_or(0, |record| record.seq);
    Ok(newest(kind)?.filter(|one| one.seq > active_since))
}

/// Finishes a rollback that a person decided.
fn continue_requested(
    live: &mut LiveMonitoring<'_>,
    version: &CapabilityId,
    requested: RequestedRollback,
) -> Result<(), EngineFault> {
    report_recovered(live.record, version, Notice::RollbackContinued);
    let RequestedRollback { trigger: text, leave } = requested;
    let trigger =
        Trigger { text, ..trigger(live.record, TriggerKind::Operator, Notice::RollbackInterrupted) };
    live.deactivate(version, trigger, None, leave)
}

/// Finishes a rollback that an earlier engine decided or began. Only a decision on record ends a version for good: what else
/// began the rollback is unknown. The tasks in which a rate is compared ended with that engine.
fn continue_rollback(
    live: &mut LiveMonitoring<'_>,
    version: &CapabilityId,
    decided: Option<&[Reason]>,
) -> Result<(), EngineFault> {
    report_recovered(live.record, version, Notice::RollbackContinued);
    let leave = decided.map_or(DeactivationKind::Demoted, deactivation_for);
    let event = decided.filter(|reasons| TriggerKind::of(reasons, false).needs_difference());
    let trigger = match event {
        Some(reasons) => {
            trigger(live.record, TriggerKind::of(reasons, false), Notice::decided(reasons.first()))
        }
        None => Trigger {
            rates: decided.map(deciding_rates).unwrap_or_default(),
            ..trigger(live.record, TriggerKind::Restart, Notice::RollbackInterrupted)
        },
    };
    live.deactivate(version, trigger, None, leave)
}

/// Records the state of telemetry since the last engine before anything else: seals unsealed batches as found, and reports
/// missing ones.
fn take_in_telemetry(record: &mut EngineRecorder) -> Result<(), EngineFault> {
    let StartupTelemetry { changes, missing, aside, .. } =
        record.version_table().store().opening().telemetry.clone();
    if !changes.is_empty() {
        record.write(changes, Vec::new())?;
    }
    let notice = match aside.last() {
        // The newest one; the record names all.
        Some(QuarantinedFile { file, problem }) => {
            Notice::TelemetryQuarantined { file: file.clone(), missing, problem: problem.clone() }
        }
        None if missing > 0 => Notice::TelemetryMissing { batches: missing },
        None => return Ok(()),
    };
    record.raise(AlarmKey::TelemetryMissed, Priority::High, true, notice);
    Ok(())
}

/// Demotes versions that do not admit the store's profile, or are blocked under it: a version for simulation only controls
/// no other arm.
fn deactivate_unadmitted(live: &mut LiveMonitoring<'_>) -> Result<(), EngineFault> {
    let version_table = live.record.version_table();
    let active = version_table.families().filter_map(|(_, entry)| entry.active());
    let stray: Vec<(CapabilityId, AdmissionRefusal)> = active
        .filter_map(|member| {
            let why = not_admitted(live.context, version_table, &member.capability)?;
            // Under a profile that is not in force yet no version acts.
            let waits =
                live.context.unauthorized.is_some() && matches!(why, AdmissionRefusal::LessStrictGate(_));
            (!waits).then(|| (member.capability.id(), why))
        })
        .collect();
    for (id, refusal) in stray {
        let profile = live.context.profile.name;
        report_recovered(live.record, &id, Notice::RolledBackUnadmitted { profile, refusal });
        let notice = Notice::OpenedUnderProfile { profile, refusal };
        let trigger = trigger(live.record, TriggerKind::ProfileNotAdmitted, notice);
        live.deactivate(&id, trigger, None, DeactivationKind::Demoted)?;
    }
    Ok(())
}

/// Returns a version to its repeated stage after an interruption. Returns whether the stage is run again: that of a paused
/// version is not before a person retries it.
fn resume_demoted(record: &mut EngineRecorder, id: &CapabilityId) -> Result<bool, EngineFault> {
    let (version, lifecycle, _) = record.version_table().version(id)?;
    if lifecycle.state != State::Demoted {
        return Ok(true);
    }
    if lifecycle.flags.paused {
        return Ok(false);
    }
    let event = LifecycleEvent::Repeat { version, stage: Stage::Sandbox };
    record.transition(&id.family, event, TransitionNote::because(Notice::RetryInterrupted))?;
    Ok(true)
}

/// Monitors a provisional version before its next tick, from the start of its window.
fn resume_watch(live: &mut LiveMonitoring<'_>, id: &CapabilityId) -> Result<(), EngineFault> {
    let (_, lifecycle, _) = live.record.version_table().version(id)?;
    if lifecycle.state != State::Active {
        return Ok(());
    }
    let restricted = lifecycle.flags.restricted;
    let now_tick = live.record.now_tick();
    match ActivationMonitor::new(id, live.evidence_files.of(id), live.context, now_tick) {
        Ok(mut watched) => {
            watched.restricted = restricted;
            live.monitors.insert(watched);
            report_recovered(live.record, id, Notice::WindowRestarts);
            Ok(())
        }
        Err(fault) => {
            // A version that cannot be monitored does not act.
            let problem = fault.to_string();
            report_recovered(live.record, id, Notice::RolledBackUnmonitored { problem });
            let trigger = trigger(live.record, TriggerKind::Restart, Notice::NoMonitorAfterRestart);
            live.deactivate(id, trigger, None, DeactivationKind::Demoted)
        }
    }
}

/// Keeps open requests and their answers. Asks again only where something changed that the request binds.
fn resume_questions(live: &mut LiveMonitoring<'_>, approvals: &mut Approvals) -> Result<(), EngineFault> {
    let record = &mut *live.record;
    let mut open = Vec::new();
    for (family, entry) in record.version_table().families() {
        for (index, version) in entry.state.versions.iter().enumerate() {
            if version.flags.awaiting_approval && matches!(version.state, State::Shadowed | State::Active) {
                open.push((family.clone(), index));
            }
        }
    }
    for (family, index) in open {
        let Ok(number) = u16::try_from(index) else { continue };
        let version = holdpoint_governance::lifecycle::VersionRef(number);
        let Some(id) = record.version_table().family(&family)?.members.get(index).map(|m| m.capability.id())
        else {
            continue;
        };
        if let Some(answers) = approvals.restore(live.context, record, live.evidence_files, &id)? {
            let priority = live.context.profile.alarms.approval_waiting;
            let notice = Notice::WaitsForApproval { version: id.clone() };
            record.raise(AlarmKey::Approval(id.clone()), priority, false, notice);
            report_recovered(record, &id, Notice::RequestStaysOpen { answers: answers as u64 });
            continue;
        }
        let note = TransitionNote {
            before: void_requests(record.version_table(), &id)?,
            ..TransitionNote::because(Notice::RequestVoidedByRestart)
        };
        let restricted = record.version_table().version(&id)?.1.state == State::Active;
        record.transition(&family, LifecycleEvent::ApprovalExpired { version }, note)?;
        let notice = if restricted { Notice::ReleaseToAskAgain } else { Notice::ActivationAskedAgain };
        report_recovered(record, &id, notice);
    }
    Ok(())
}

fn report_recovered(record: &mut EngineRecorder, version: &CapabilityId, notice: Notice) {
    record.tell(EventKind::Recovered { version: version.clone(), text: notice.into() });
}

/// The display of a version that is history; its measurements stay in the store.
fn terminal_summary(evidence_file: EvidenceFile) -> EvidenceFile {
    let EvidenceFile { kappas, conditions, reasons, risk, counted, bindings, .. } = evidence_file;
    EvidenceFile { kappas, counted, bindings, conditions, reasons, risk, ..EvidenceFile::default() }
}

/// Reads the newest evidence of every version.
fn reload_evidence_files(
    context: &Context,
    record: &EngineRecorder,
    evidence_files: &mut EvidenceFiles,
) -> Result<(), EngineFault> {
    let views = record.version_table().store().views()?;
    let mut loaded = Vec::new();
    for (member, version) in record.version_table().versions() {
        let id = member.capability.id();
        let evidence = views.evidence(&id, None)?;
        let is_over = version.state.is_terminal();
        let mut entries = evidence.iter().rev().filter(|entry| match entry.kind {
            EvidenceKind::Compat | EvidenceKind::Sandbox | EvidenceKind::Shadow => true,
            // From a rejection at the gate; the evidence of a pass is no evidence file.
            EvidenceKind::Gate => is_over,
            EvidenceKind::Activation
            | EvidenceKind::Monitor
            | EvidenceKind::Rollback
            | EvidenceKind::Drill => false,
        });
        let newest = entries.find_map(|entry| serde_json::from_str::<EvidenceFile>(&entry.json).ok());
        let Some(mut evidence_file) = newest else { continue };
        if is_over {
            evidence_file = terminal_summary(evidence_file);
        } else if version.state == State::Active {
            evidence_file.conditions = conditions_in_force(context, &evidence, &evidence_file.conditions);
            if !version.flags.provisional {
                evidence_file.conditions.retain(Condition::outlives_confirmation);
            }
            evidence_file.suspicion = recorded_concern(&evidence);
        }
        loaded.push((id, evidence_file));
    }
    drop(views);
    evidence_files.extend(loaded);
    Ok(())
}

/// The concern about an active version since its shadow, and its re-evaluation.
fn recorded_concern(evidence: &[EvidenceEntry]) -> Option<VersionConcern> {
    let since = evidence.iter().rev().take_while(|entry| entry.kind != EvidenceKind::Shadow);
    let mut found = since.filter(|entry| entry.kind == EvidenceKind::Monitor);
    found.find_map(|entry| serde_json::from_str(&entry.json).ok())
}

/// The conditions of an active version, from its gate pass. An approval under another profile or other policies does not
/// count.
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
