//! The record of a monitor's action, and its first reason.

use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::monitor::MonitorAction;
use holdpoint_governance::record::AuditRecord;
use serde::Deserialize;

/// The body of a monitor's record.
#[derive(Deserialize)]
struct MonitorActionBody {
    action: Lenient<MonitorAction>,
    reasons: Vec<CodedReason>,
}

#[derive(Deserialize)]
struct CodedReason {
    code: Lenient<ReasonCode>,
}

/// The first reason of a monitor's action.
pub(super) fn cause(record: &AuditRecord) -> Option<ReasonCode> {
    let acted: MonitorActionBody = serde_json::from_str(&record.body).ok()?;
    acted.reasons.first()?.code.known().copied()
}

/// Whether a record contains this action of a monitor.
pub(super) fn is_action(record: &AuditRecord, action: MonitorAction) -> bool {
    serde_json::from_str::<MonitorActionBody>(&record.body).is_ok_and(|acted| acted.action == action)
}
