//! What a monitor's record says: what it did, and why first.

use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::monitor::MonitorAction;
use holdpoint_governance::record::AuditRecord;
use holdpoint_governance::words::Word;
use serde::Deserialize;

/// The body of a monitor's record.
#[derive(Deserialize)]
struct Acted {
    action: Word<MonitorAction>,
    reasons: Vec<Coded>,
}

#[derive(Deserialize)]
struct Coded {
    code: Word<ReasonCode>,
}

/// The reason a monitor acted for first.
pub(super) fn cause(record: &AuditRecord) -> Option<ReasonCode> {
    let acted: Acted = serde_json::from_str(&record.body).ok()?;
    acted.reasons.first()?.code.known().copied()
}

/// Whether a record says that a monitor took this action.
pub(super) fn is_action(record: &AuditRecord, action: MonitorAction) -> bool {
    serde_json::from_str::<Acted>(&record.body).is_ok_and(|acted| acted.action == action)
}
