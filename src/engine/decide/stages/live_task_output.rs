//! What leaves the engine of a finished live task: its telemetry, and its summary in the event of its sequence.

use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::event::TaskSummary;
use holdpoint_runtime::agent::dispatcher::DispatchedTask;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_store::Batch;

use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use crate::live::monitors::Monitors;
use holdpoint_record::live_task_record::{LIVE, LiveTaskRecord, UNWATCHED};

/// Stores the task of a version in the telemetry file, with its path if the version is monitored. The digest enters the
/// chain with a later record. Returns the number of its batch.
pub(super) fn keep_telemetry(
    record: &mut EngineRecorder,
    monitors: &Monitors,
    id: &CapabilityId,
    task_record: &LiveTaskRecord<'_>,
    duration_ms: u64,
) -> Result<u64, EngineFault> {
    let (stream, rows, body) = if monitors.of(id).is_some() {
        (LIVE, task_record.record.path.len().max(1), serde_json::to_vec(task_record)?)
    } else {
        let record = TaskRecord { path: Vec::new(), ..task_record.record.clone() };
        (UNWATCHED, 1, serde_json::to_vec(&LiveTaskRecord { record: &record, marks: task_record.marks })?)
    };
    let to_ms = record.now_ms();
    let batch = Batch {
        version: id.clone(),
        stream: stream.to_owned(),
        from_ms: to_ms.saturating_sub(duration_ms),
        to_ms,
        rows: rows as u64,
        body,
    };
    let store = record.version_table().store();
    let number = store.append_telemetry(&batch)?.batch;
    if store.telemetry_is_due(to_ms)? {
        record.write(Vec::new(), Vec::new())?;
    }
    Ok(number)
}

/// A task that was cut short has no cause of its own.
pub(super) fn summary(dispatched: &DispatchedTask, cut_short: bool) -> TaskSummary {
    let record = &dispatched.record;
    TaskSummary {
        version: dispatched.id.clone(),
        success: record.success,
        violation: record.violation,
        past: None,
        anomaly: record.anomaly,
        recovery: record.recovery,
        retries: record.retries,
        time_secs: record.time_secs,
        uncovered: record.starts_outside(),
        failure: record.failure_cause().filter(|_| !cut_short),
    }
}
