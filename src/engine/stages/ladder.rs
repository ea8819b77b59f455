//! The record of a rollback: its rungs as they are told, what is kept of it, and how it is closed.
//!
//! Writes and tells; moves nothing and decides nothing.

use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::rollback::{RollbackRecord, Rung, RungFailure, RungRecord};
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::Change;
use holdpoint_registry::names::EvidenceKind;

use crate::context::Context;
use crate::fault::Fault;
use crate::record::Record;

/// A rung that took no time.
pub(crate) fn rung(
    record: &mut Record,
    rollback: &mut RollbackRecord,
    rung: Rung,
    failure: Option<RungFailure>,
    text: &str,
) {
    push_rung(record, rollback, RungRecord::new(rung, failure, 0, text));
}

/// Tells a rung and adds it to the record.
pub(crate) fn push_rung(record: &mut Record, rollback: &mut RollbackRecord, rung: RungRecord) {
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

/// The terminal record: what came of it is known now. `alarmed`: the alarm that the version was taken off is raised
/// already.
pub(crate) fn conclude(
    context: &Context,
    record: &mut Record,
    rollback: RollbackRecord,
    alarmed: bool,
) -> Result<(), Fault> {
    let id = rollback.candidate.clone();
    record.write(vec![evidence(&rollback)?], Vec::new())?;
    if rollback.recovered == Some(false) {
        let priority = context.profile.alarms.safe_stopped;
        let text = format!("{} is back to its predecessor and does not work safely", id.family);
        record.raise(AlarmKey::NotRecovered(id.family.clone()), priority, true, &text);
    }
    if !alarmed {
        raise_rolled_back(context, record, &rollback);
    }
    let end = rollback.post_status.into();
    record.tell(event(rollback));
    record.close_audit(&id, end)
}

/// The alarm that a version was taken off.
pub(crate) fn raise_rolled_back(context: &Context, record: &mut Record, rollback: &RollbackRecord) {
    let id = &rollback.candidate;
    let priority = context.profile.alarms.rolled_back;
    let text = format!("{id} was taken off: {}", rollback.trigger.text);
    record.raise(AlarmKey::RolledBack(id.clone()), priority, true, &text);
}

/// The record as the store keeps it.
pub(crate) fn evidence(rollback: &RollbackRecord) -> Result<Change, Fault> {
    let json = serde_json::to_string(rollback)?;
    let digest = Digest::of_json("holdpoint.rollback.v2", rollback)?;
    Ok(Change::PutEvidence {
        version: rollback.candidate.clone(),
        kind: EvidenceKind::Rollback,
        json,
        digest,
    })
}

/// The record as it is told.
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
