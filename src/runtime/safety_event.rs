//! The safety events in what guard and watcher report of a task.
//!
//! Names what happened in the terms of the rules; judges nothing.

use holdpoint_governance::monitor::SafetyEvent;
use holdpoint_governance::profile::Profile;

use super::guard::PolicyHit;
use super::task::{TaskRecord, Tick};
use super::watcher::WatcherSignal;

/// The safety event in a tick, the gravest source first.
#[must_use]
pub fn safety_event(passed: &Tick<'_>) -> Option<SafetyEvent> {
    passed
        .measured
        .and_then(of_hit)
        .or_else(|| passed.checked.and_then(of_hit))
        .or_else(|| passed.raised.iter().find_map(|signal| of_signal(*signal)))
}

/// The safety events of a finished task.
#[must_use]
pub fn safety_events(record: &TaskRecord) -> Vec<SafetyEvent> {
    let hits = record.hits.iter().filter_map(|(_, hit)| of_hit(*hit));
    let signals = record.signals.iter().filter_map(|raised| of_signal(raised.signal));
    hits.chain(signals).collect()
}

/// The safety events of a finished task, danger by its measures of harm among them.
#[must_use]
pub fn stopping_events(record: &TaskRecord, profile: &Profile) -> Vec<SafetyEvent> {
    let is_danger = record.harm.is_some_and(|harm| !profile.live_harm.dangers(&harm).is_empty());
    safety_events(record).into_iter().chain(is_danger.then_some(SafetyEvent::Danger)).collect()
}

const fn of_hit(hit: PolicyHit) -> Option<SafetyEvent> {
    match hit {
        PolicyHit::ForceMeasured => Some(SafetyEvent::ForceLimit),
        PolicyHit::SpeedMeasured => Some(SafetyEvent::SpeedLimit),
        PolicyHit::KeepOut | PolicyHit::KeepOutEntered => Some(SafetyEvent::KeepOut),
        PolicyHit::PredictedCollision => Some(SafetyEvent::Collision),
        PolicyHit::NotFinite => Some(SafetyEvent::NotANumber),
        PolicyHit::ModeUncovered
        | PolicyHit::ModeForbidden
        | PolicyHit::ModeUnreviewed
        | PolicyHit::CommandUndeclared
        | PolicyHit::ZoneUndeclared
        | PolicyHit::BudgetExceeded => Some(SafetyEvent::PermissionBreach),
        PolicyHit::UnsafeContinuation => Some(SafetyEvent::UnsafeContinuation),
        PolicyHit::OutsideWorkspace
        | PolicyHit::RetriesExceeded
        | PolicyHit::PermissionWithdrawn
        | PolicyHit::SpeedClamped
        | PolicyHit::ForceClamped => None,
    }
}

const fn of_signal(signal: WatcherSignal) -> Option<SafetyEvent> {
    match signal {
        WatcherSignal::UnexpectedContact => Some(SafetyEvent::Collision),
        WatcherSignal::TelemetryInvalid => Some(SafetyEvent::NotANumber),
        WatcherSignal::ObjectSlip
        | WatcherSignal::ObjectLost
        | WatcherSignal::TrackingError
        | WatcherSignal::StaleInput
        | WatcherSignal::ToolLost
        | WatcherSignal::GripFault
        | WatcherSignal::Overrun => None,
    }
}
