//! A clock mismatch of the machine: recorded, published, and restored after a restart until a person confirms the time.
//! Meanwhile the gate activates nothing.
//!
//! The rules decide when there is a mismatch ([`holdpoint_governance::wall_time`]). Functions over the record.

use holdpoint_governance::alarms::{AlarmEvent, AlarmKey, Priority};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{FamilyState, State, Version};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::wall_time::{ClockMismatch, WallTime};
use holdpoint_protocol::command::{Caller, Refusal, Reply};
use holdpoint_protocol::snapshot::ClockMismatchView;
use holdpoint_record::clock_mismatch::{ClockMismatchRecord, read};
use holdpoint_store::{AuditFilter, RecordViews, StoreError};
use holdpoint_wording::command_effect::{EngineEffect, engine_effect};
use serde::Deserialize;

use crate::decide::people::persons::unreadable;
use crate::decide::recorder::EngineRecorder;
use holdpoint_record::version_origin;
use holdpoint_record::wall_clock::TrustedClockReading;

/// The largest difference between the time that a person confirms and the machine's clock when the engine takes the command,
/// ms: long enough to read the time, enter a reason and sign.
const CONFIRMED_WITHIN_MS: u64 = 300_000;

/// A record that contains a trusted reading.
#[derive(Deserialize)]
struct ClockReadingRecord {
    #[serde(default)]
    clock: Option<TrustedClockReading>,
}

/// Restores a mismatch that no person has confirmed since. Also finds a clock that was set while no engine ran: it differs
/// from the time since the machine's start, unless the machine restarted.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn recall(record: &mut EngineRecorder) -> Result<(), StoreError> {
    let views = record.version_table().store().views()?;
    let (mismatch, reading) = (recorded_mismatch(&*views)?, newest_reading(&*views)?);
    drop(views);
    if let Some(reading) = reading {
        record.wall_mut().compare_with_stored(&reading);
    }
    if let Some(mismatch) = mismatch {
        record.wall_mut().set_mismatch(mismatch);
    }
    Ok(())
}

/// The newest trusted reading.
fn newest_reading(views: &dyn RecordViews) -> Result<Option<TrustedClockReading>, StoreError> {
    let mut newest: (u64, Option<TrustedClockReading>) = (0, None);
    for kind in [RecordKind::EngineBegan, RecordKind::EngineEnded, RecordKind::ClockConfirmed] {
        let Some(found) = views.audit(&AuditFilter::newest(kind))?.into_iter().next() else { continue };
        let read = serde_json::from_str::<ClockReadingRecord>(&found.body).ok().and_then(|read| read.clock);
        if read.is_some() && found.seq > newest.0 {
            newest = (found.seq, read);
        }
    }
    Ok(newest.1)
}

/// The newest recorded mismatch, unless a person has confirmed the time after it.
///
/// # Errors
/// If the store cannot be read.
pub fn recorded_mismatch(views: &dyn RecordViews) -> Result<Option<ClockMismatch>, StoreError> {
    let newest = |kind| views.audit(&AuditFilter::newest(kind)).map(|found| found.into_iter().next());
    let confirmed_seq = newest(RecordKind::ClockConfirmed)?.map_or(0, |record| record.seq);
    let newest_record = newest(RecordKind::ClockDoubted)?.filter(|record| record.seq > confirmed_seq);
    Ok(newest_record.map(|record| read(&record.body)))
}

/// Records a mismatch as soon as there is one.
///
/// # Errors
/// If it cannot be written; the mismatch holds all the same.
pub(crate) fn check(record: &mut EngineRecorder) -> Result<(), StoreError> {
    if record.version_table().wall().is_mismatch_stored() {
        return Ok(());
    }
    let Some(doubt) = record.version_table().wall().clock_mismatch() else { return Ok(()) };
    let said = record.version_table().wall().machine_time();
    record.wall_mut().set_mismatch(doubt);
    let body = serde_json::json!(ClockMismatchRecord { doubt, said });
    let written = record.note(RecordKind::ClockDoubted, String::new(), body.to_string());
    record.raise(AlarmKey::ClockDoubted, Priority::High, false, Notice::ClockMismatched { mismatch: doubt });
    written
}

/// The view of a mismatch, if there is one.
pub(crate) fn view(record: &EngineRecorder) -> Option<ClockMismatchView> {
    let mismatch = record.version_table().wall().clock_mismatch()?;
    Some(ClockMismatchView {
        doubt: mismatch,
        text: holdpoint_wording::clock_mismatch(&mismatch),
        said: record.version_table().wall().machine_time()?,
    })
}

/// A person confirms the machine's clock; `time` is what the person read. `caller` is the requesting process.
///
/// # Errors
/// If it cannot be written; the mismatch then remains.
pub(crate) fn confirm(
    record: &mut EngineRecorder,
    (by, reason): (String, String),
    time: WallTime,
    caller: &Caller,
) -> Result<Reply, StoreError> {
    let refuse = |code, text: String| Ok(Reply::Refused { code, text, hint: None });
    let (Some(mismatch), Some(machine_time)) =
        (record.version_table().wall().clock_mismatch(), record.version_table().wall().machine_time())
    else {
        return refuse(
            Refusal::NotNow,
            "there is no clock mismatch, so there is no time to confirm".to_owned(),
        );
    };
    if let Some(refused) = unreadable(&by, &reason) {
        return Ok(refused);
    }
    if machine_time.ms_until(time).max(time.ms_until(machine_time)) > CONFIRMED_WITHIN_MS {
        let text =
            format!("the machine's clock says {machine_time}, and {time} is confirmed: read the time again");
        return refuse(Refusal::Stale, text);
    }
    if let Some(version) = undecided_version_of(record, &by)? {
        let text = format!(
            "{by} registered or wrote {version}, which is not decided: its deadlines run by this clock, so another \
             person must confirm the time"
        );
        return refuse(Refusal::NotAllowed, text);
    }
    record.wall_mut().believe();
    let clock = record.version_table().wall().reading();
    let body = serde_json::json!({
        "by": by, "caller": caller, "clock": clock, "reason": reason, "time": machine_time, "doubt": mismatch
    });
    if let Err(error) = record.note(RecordKind::ClockConfirmed, String::new(), body.to_string()) {
        record.wall_mut().set_mismatch(mismatch);
        return Err(error);
    }
    record.alarm_event(&AlarmEvent::Clear { key: AlarmKey::ClockDoubted });
    let effect = EngineEffect::TimeConfirmed { by: &by, time: machine_time };
    Ok(Reply::Accepted { text: engine_effect(&effect), version: None })
}

/// An undecided or unreviewed version of this person's.
fn undecided_version_of(record: &EngineRecorder, by: &str) -> Result<Option<CapabilityId>, StoreError> {
    let persons = record.version_table().store().persons()?;
    let is_open = |family: &FamilyState, number: usize, version: &Version| {
        let is_candidate =
            !version.state.is_terminal() && !matches!(version.state, State::Active | State::Superseded);
        let is_reviewed = family.review.is_some_and(|review| usize::from(review.version.0) == number);
        is_candidate || version.flags.awaiting_approval || is_reviewed
    };
    let mut all = record.version_table().families().flat_map(|(_, entry)| {
        entry
            .members
            .iter()
            .zip(&entry.state.versions)
            .enumerate()
            .map(move |(number, of)| (entry, number, of))
    });
    let found = all.find(|(entry, number, (member, version))| {
        is_open(&entry.state, *number, version) && version_origin::is_of(&persons, member, by)
    });
    Ok(found.map(|(_, _, (member, _))| member.capability.id()))
}

#[cfg(test)]
mod tests;
