//! Rollbacks for a single finding, also of a version without a drift monitor.

use super::{Finding, MonitorAction, MonitorDecision, Reason, SafetyEvent, reason};

/// Rolls a version back for these reasons, the deciding one first.
#[must_use]
pub const fn roll_back(reasons: Vec<Reason>, tick: u64) -> MonitorDecision {
    MonitorDecision { action: MonitorAction::Rollback, reasons, tick }
}

/// Rolls a version back for a safety event.
#[must_use]
pub fn safety_trip(event: SafetyEvent, tick: u64) -> MonitorDecision {
    roll_back(vec![reason(Finding::SafetyTrip { event })], tick)
}
