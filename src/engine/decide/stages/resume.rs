//! The last rung: watches the first tasks under the predecessor until it is known whether the family recovered.
//!
//! An engine in step runs them at once; a paced one waits for the live cell to run them, and closes the record then.
//! Moves nothing itself.

use holdpoint_governance::evidence::HardStop;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::monitor::SafetyEvent;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::rollback::{RollbackRecord, Rung, RungFailure, RungRecord};
use holdpoint_protocol::clock::tick_of;
use holdpoint_runtime::task::TaskRecord;

use super::ladder::{conclude, push_rung};
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use crate::live::station::SequenceReport;
use holdpoint_record::context::Context;
use holdpoint_runtime::safety_event::stopping_events;

/// Tasks of the predecessor after which the recovery of the family is judged.
const RESUME_TASKS: u32 = 3;

/// Most sequences for them: the live cell may not reach the family's task.
const RESUME_SEQUENCES_MAX: u32 = 9;

/// A predecessor whose first tasks are watched.
pub struct Resumption {
    predecessor: CapabilityId,
    pub(crate) record: RollbackRecord,
    events: Vec<SafetyEvent>,
    sequences: u32,
    from_ms: u64,
    /// The alarm about the rollback is already raised.
    alarmed: bool,
}

impl Resumption {
    /// Nothing is in flight: the agent plans again; the first tasks under the predecessor remain to be watched.
    #[must_use]
    pub(crate) const fn new(predecessor: CapabilityId, record: RollbackRecord, now_ms: u64) -> Self {
        Self { predecessor, record, events: Vec::new(), sequences: 0, from_ms: now_ms, alarmed: false }
    }

    /// The same, with the alarm about the rollback already raised.
    #[must_use]
    pub(crate) fn alarmed(self) -> Self {
        Self { alarmed: true, ..self }
    }
}

/// A paced live cell ran a sequence.
pub(crate) fn look_at(
    context: &Context,
    record: &mut EngineRecorder,
    resumptions: &mut Vec<Resumption>,
    report: &SequenceReport,
) -> Result<(), EngineFault> {
    for mut resumption in std::mem::take(resumptions) {
        if takes_in(context, record, &mut resumption, report) {
            close(context, record, resumption)?;
        } else {
            resumptions.push(resumption);
        }
    }
    Ok(())
}

/// The engine ends: open results stay unknown, and the records are closed.
pub(crate) fn end(
    context: &Context,
    record: &mut EngineRecorder,
    resumptions: &mut Vec<Resumption>,
) -> Result<(), EngineFault> {
    for resumption in std::mem::take(resumptions) {
        let Resumption { record: mut rollback, from_ms, alarmed, .. } = resumption;
        let (failure, ticks) = (Some(RungFailure::NotRecovered), ticks_since(record, from_ms));
        let rung = RungRecord::new(Rung::Resume, failure, ticks, Notice::RecoveryUnknown);
        push_rung(record, &mut rollback, rung);
        conclude(context, record, rollback, alarmed)?;
    }
    Ok(())
}

/// Takes a sequence in. Returns whether the result is known.
pub(crate) fn takes_in(
    context: &Context,
    record: &EngineRecorder,
    resumption: &mut Resumption,
    report: &SequenceReport,
) -> bool {
    let Resumption { predecessor, record: rollback, events, sequences, .. } = resumption;
    *sequences += 1;
    // What was refused, or lost by the cell, shows nothing of how it works.
    let worked = report.tasks.iter().filter(|done| !done.record.refused && !done.record.invalid);
    for done in worked.filter(|done| done.id == *predecessor) {
        rollback.resumed_tasks += 1;
        events.extend(stopping_events(&done.record, &context.profile));
        events.extend(moved_on(&done.record, context.profile.runtime.unsafe_continuation_max_ms));
    }
    let replaced = record.active_of(&predecessor.family).is_none_or(|now| now.id() != *predecessor);
    rollback.resumed_tasks >= RESUME_TASKS
        || !events.is_empty()
        || replaced
        || *sequences >= RESUME_SEQUENCES_MAX
}

/// Closes the record with the result.
pub(crate) fn close(
    context: &Context,
    record: &mut EngineRecorder,
    resumption: Resumption,
) -> Result<(), EngineFault> {
    let Resumption { record: mut rollback, events, sequences, from_ms, alarmed, .. } = resumption;
    let recovered = rollback.resumed_tasks > 0 && events.is_empty();
    rollback.recovered = Some(recovered);
    let notice = match (events.first(), rollback.resumed_tasks) {
        (Some(event), tasks) => Notice::UnsafeAfterRollback { event: *event, task: tasks.into() },
        (None, 0) => Notice::TargetTaskNotReached { sequences: sequences.into() },
        (None, tasks) => Notice::SafeAfterRollback { tasks: tasks.into() },
    };
    let ticks = ticks_since(record, from_ms);
    let failure = (!recovered).then_some(RungFailure::NotRecovered);
    push_rung(record, &mut rollback, RungRecord::new(Rung::Resume, failure, ticks, notice));
    conclude(context, record, rollback, alarmed)
}

/// How long the predecessor was watched, ticks.
fn ticks_since(record: &EngineRecorder, from_ms: u64) -> u64 {
    tick_of(record.now_ms().saturating_sub(from_ms))
}

/// Motion after a stop, as the monitor counts it.
fn moved_on(record: &TaskRecord, limit_ms: f64) -> Option<SafetyEvent> {
    let moved = record.unsafe_continuation_ms as f64 > limit_ms
        || record.hard_stop == Some(HardStop::MotionAfterStop);
    moved.then_some(SafetyEvent::UnsafeContinuation)
}
