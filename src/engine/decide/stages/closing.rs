//! How a stage ends: the decision told, the evidence written with the change of state, a rejection closed.

use holdpoint_governance::decision::{Decision, Kappa, Reason, lead_reason};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage, State, VersionFlags};
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::outcome::StageOutcome;
use holdpoint_governance::record::{RecordKind, UpgradeEnd};
use holdpoint_governance::time_excess::TimeExcess;
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::snapshot::ProgressView;
use holdpoint_protocol::work_unit::{PartCount, WorkUnit};
use holdpoint_store::{AuditBody, Change, EvidenceKind, RequestState};
use holdpoint_wording::stage::early_end;

use crate::decide::people::approvals::{Approvals, clear_alarm, closing_note};
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_file::{EvidenceFile, EvidenceFiles};
use holdpoint_record::recorded_decision;
use holdpoint_record::version_table::TransitionNote;

/// Keeps and tells how far a stage is: the unit that runs, with its own count where that is a part, and the whole.
pub(crate) fn progress(
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    id: &CapabilityId,
    stage: Stage,
    (what, part): (WorkUnit, Option<PartCount>),
    (done, budget): (u64, u64),
) {
    let now_ms = record.now_ms();
    let evidence_file = evidence_files.edit(id);
    let before = evidence_file.progress.as_ref();
    let since_ms = before.filter(|view| view.stage == stage).map_or(now_ms, |view| view.since_ms);
    let early = early_end(stage).to_owned();
    let view = ProgressView { stage, what: what.into(), done, budget, part, since_ms, early };
    evidence_file.progress = Some(view);
    record.tell(EventKind::Progress { version: id.clone(), stage, what: what.into(), done, budget, part });
}

pub(crate) fn report_decision<O: Copy + Into<StageOutcome>>(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_file: &mut EvidenceFile,
    id: &CapabilityId,
    stage: Stage,
    decision: &Decision<O>,
) {
    evidence_file.progress = None;
    evidence_file.deployment = decision.answers().deployment;
    let found = ((*decision.outcome()).into(), decision.reasons());
    tell_decided(context, record, evidence_file, (id, stage), found);
}

/// Publishes the outcome of a stage with its reasons.
pub(crate) fn tell_decided(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_file: &EvidenceFile,
    (id, stage): (&CapabilityId, Stage),
    (outcome, reasons): (StageOutcome, &[Reason]),
) {
    record.tell(EventKind::Decided {
        version: id.clone(),
        stage,
        outcome,
        dimensions: evidence_file.dimensions(&context.profile),
        composite: evidence_file.composite(&context.profile),
        reasons: reasons.to_vec(),
        conditions: evidence_file.conditions.clone(),
        deployment: evidence_file.deployment,
    });
}

/// The note of a stage's end: the evidence so far and the decision, written with the state change.
pub(crate) fn stage_note<O: serde::Serialize>(
    evidence_file: &EvidenceFile,
    id: &CapabilityId,
    kind: EvidenceKind,
    reason: Notice,
    decision: &Decision<O>,
) -> Result<TransitionNote, EngineFault> {
    let json = serde_json::to_string(evidence_file)?;
    let digest = evidence_file.digest()?;
    let evidence = Change::PutEvidence { version: id.clone(), kind, json, digest };
    let body = recorded_decision::body(decision, evidence_file)?;
    let record = AuditBody { kind: RecordKind::Decision, subject: id.to_string(), body };
    Ok(TransitionNote {
        reason: reason.into(),
        cause: None,
        before: vec![evidence, scores(evidence_file, id)],
        after: Vec::new(),
        audit: vec![record],
    })
}

fn scores(evidence_file: &EvidenceFile, id: &CapabilityId) -> Change {
    let signature = evidence_file.behavior.as_ref().and_then(|behavior| behavior.candidate);
    let kappas = evidence_file.kappas.as_ref().map_or([None; 4], |kappas| {
        [kappas.interface.kappa, kappas.policy.kappa, kappas.behavior.kappa, kappas.recovery.kappa]
            .map(|kappa| kappa.map(Kappa::get))
    });
    Change::SetScores {
        version: id.clone(),
        kappas,
        signature: signature.and_then(|signature| serde_json::to_string(&signature).ok()),
    }
}

/// Rejects a candidate, and closes its record.
pub(crate) fn reject(
    record: &mut EngineRecorder,
    id: &CapabilityId,
    note: TransitionNote,
) -> Result<(), EngineFault> {
    let (version, _, _) = record.version_table().version(id)?;
    record.transition(&id.family, LifecycleEvent::Reject { version }, note)?;
    close_rejected(record, id)
}

/// Closes the record after a rejection. Its events are the decision and the change of state; it asks nothing of an operator,
/// so it raises no alarm.
pub(crate) fn close_rejected(record: &mut EngineRecorder, id: &CapabilityId) -> Result<(), EngineFault> {
    record.close_audit(id, UpgradeEnd::Rejected)
}

/// Demotes a candidate whose evidence does not decide. One that repeated the stage is demoted already and stays so.
pub(crate) fn put_on_hold(
    record: &mut EngineRecorder,
    id: &CapabilityId,
    note: TransitionNote,
) -> Result<(), EngineFault> {
    let (version, lifecycle, _) = record.version_table().version(id)?;
    let event = if lifecycle.state == State::Demoted {
        LifecycleEvent::Abort { version }
    } else {
        LifecycleEvent::Demote { version }
    };
    record.transition(&id.family, event, note)
}

/// The comparison of an active version took too long: its concern stays open. Publishes and returns the reason.
pub(crate) fn note_spent_time(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    id: &CapabilityId,
    excess: &TimeExcess,
) -> Reason {
    let reason = excess.reason(&context.profile);
    let evidence_file = evidence_files.edit(id);
    evidence_file.progress = None;
    evidence_file.reasons = vec![reason.clone()];
    let (decision, reasons) = (MonitorOutcome::DoubtRemains, vec![reason.clone()]);
    record.tell(EventKind::Monitor { version: id.clone(), decision, reasons });
    reason
}

/// A stage ends without a result; it can be begun again.
pub(crate) fn abort_stage(
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    id: &CapabilityId,
    why: Notice,
) -> Result<(), EngineFault> {
    let (version, _, _) = record.version_table().version(id)?;
    evidence_files.edit(id).progress = None;
    record.transition(&id.family, LifecycleEvent::Abort { version }, TransitionNote::because(why))
}

/// Voids an approval request about a version that has changed since, in the record and as an event; people are asked
/// again when the version may advance.
pub(crate) fn cancel_request(
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    approvals: &mut Approvals,
    id: &CapabilityId,
    why: Notice,
) -> Result<(), EngineFault> {
    let Some(flags) = end_request(record, approvals, id, RequestState::Void, why.clone())? else {
        return Ok(());
    };
    record.tell(EventKind::Voided { family: id.family.clone(), reason: why.clone().into() });
    if flags.running == Some(Stage::Activation) {
        abort_stage(record, evidence_files, id, why)?;
    }
    Ok(())
}

/// Ends a version's request that was not granted. Returns the flags that the version had; `None` without a request.
pub(crate) fn end_request(
    record: &mut EngineRecorder,
    approvals: &mut Approvals,
    id: &CapabilityId,
    state: RequestState,
    why: Notice,
) -> Result<Option<VersionFlags>, EngineFault> {
    let Some(pending) = approvals.of(id) else { return Ok(None) };
    let note = closing_note(pending, state, why);
    let (version, lifecycle, _) = record.version_table().version(id)?;
    let flags = lifecycle.flags;
    if flags.awaiting_approval {
        record.transition(&id.family, LifecycleEvent::ApprovalExpired { version }, note)?;
    } else {
        // The version left its place meanwhile, and the question with it.
        record.write(note.before, Vec::new())?;
    }
    approvals.close(id);
    clear_alarm(record, id, None);
    Ok(Some(flags))
}

pub(crate) fn first_reason<O>(decision: &Decision<O>) -> Notice {
    Notice::decided(lead_reason(decision.reasons()))
}
