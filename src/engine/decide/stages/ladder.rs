//! The record of a rollback: its rungs as events, the stored record, and its end.
//!
//! Writes and tells; moves nothing and decides nothing.

use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::rollback::{RollbackRecord, Rung, RungFailure, RungRecord};
use holdpoint_protocol::event::EventKind;
use holdpoint_store::{Change, EvidenceKind};

use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;

/// A rung that took no time.
pub(crate) fn rung(
    record: &mut EngineRecorder,
    rollback: &mut RollbackRecord,
    rung: Rung,
    failure: Option<RungFailure>,
    text: Notice,
) {
    push_rung(record, rollback, RungRecord::new(rung, failure, 0, text));
}

/// Tells a rung and adds it to the record.
pub(crate) fn push_rung(record: &mut EngineRecorder, rollback: &mut RollbackRecord, rung: RungRecord) {
    record.tell(EventKind::Rung {
        version: rollback.candidate.clone(),
        rung: rung.rung,
        ok: rung.failure.is_none(),
        failure: rung.failure,
        ms: rung.ms,
        text: rung.text.clone(),
    });
    rollback.rungs.push(rung);
}

/// Closes the record, now that the result is known. `alarmed`: the alarm about the rollback is already raised.
pub(crate) fn conclude(
    context: &Context,
    record: &mut EngineRecorder,
    rollback: RollbackRecord,
    alarmed: bool,
) -> Result<(), EngineFault> {
    let id = rollback.candidate.clone();
    record.write(vec![evidence(&rollback)?], Vec::new())?;
    if rollback.recovered == Some(false) {
        let priority = context.profile.alarms.safe_stopped;
        let notice = Notice::NotRecovered { family: id.family.clone() };
        record.raise(AlarmKey::NotRecovered(id.family.clone()), priority, true, notice);
    }
    if !alarmed {
        raise_rolled_back(context, record, &rollback);
    }
    let end = rollback.post_status.into();
    record.tell(event(rollback));
    record.close_audit(&id, end)
}

/// Raises the alarm that a version was rolled back.
pub(crate) fn raise_rolled_back(context: &Context, record: &mut EngineRecorder, rollback: &RollbackRecord) {
    let id = &rollback.candidate;
    let priority = context.profile.alarms.rolled_back;
    let trigger = Box::new(rollback.trigger.text.clone());
    let measured = rollback.trigger.measured;
    let notice = Notice::RolledBack { version: id.clone(), trigger, measured };
    record.raise(AlarmKey::RolledBack(id.clone()), priority, true, notice);
}

/// The record as the store keeps it.
pub(crate) fn evidence(rollback: &RollbackRecord) -> Result<Change, EngineFault> {
    let json = serde_json::to_string(rollback)?;
    let digest = Digest::of_json("holdpoint.rollback.v2", rollback)?;
    Ok(Change::PutEvidence {
        version: rollback.candidate.clone(),
        kind: EvidenceKind::Rollback,
        json,
        digest,
    })
}

/// The event with the record.
pub(crate) fn event(rollback: RollbackRecord) -> EventKind {
    EventKind::RolledBack {
        version: rollback.candidate.clone(),
        restored: rollback.predecessor.clone(),
        trigger: rollback.trigger.text.clone(),
        time_to_safe_ms: rollback.time_to_safe_ms,
        time_to_rollback_ms: rollback.time_to_restored_ms,
        recovered: rollback.recovered == Some(true),
        record: Box::new(rollback),
    }
}
