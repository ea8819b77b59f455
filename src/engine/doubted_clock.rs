//! A machine's clock that is not believed: on record, told, remembered over restarts, and believed again once a person has
//! confirmed the time. Meanwhile the gate lets nothing pass.
//!
//! When it is not to be believed is the rules' ([`holdpoint_governance::wall_time`]). Functions over the record.

use holdpoint_governance::alarms::{AlarmEvent, AlarmKey, Priority};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{FamilyState, State, Version};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::wall_time::{ClockDoubt, WallTime};
use holdpoint_protocol::command::{Caller, Refusal, Reply};
use holdpoint_protocol::snapshot::ClockDoubtView;
use holdpoint_registry::{AuditFilter, StoreError, Views};
use holdpoint_text::is_visible;
use serde::{Deserialize, Serialize};

use crate::operations::REASON_BYTES_MAX;
use crate::origin;
use crate::record::Record;
use crate::wall_clock::KeptReading;

/// How far the time that a person confirms may be from what the machine's clock says when the engine takes the command, ms:
/// long enough to read the time, enter a reason and sign.
const CONFIRMED_WITHIN_MS: u64 = 300_000;

/// A doubt, as the chain keeps it.
#[derive(Serialize, Deserialize)]
struct DoubtOnRecord {
    doubt: ClockDoubt,
    /// What the machine's clock said.
    said: Option<WallTime>,
}

/// Of a record that keeps what was believed.
#[derive(Deserialize)]
struct ReadingOnRecord {
    #[serde(default)]
    clock: Option<KeptReading>,
}

/// A clock that an earlier engine did not believe is not believed, unless a person has confirmed the time since. One that was
/// set while no engine ran has gone another way than the time since the machine's start, as long as that was not started anew.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn recall(record: &mut Record) -> Result<(), StoreError> {
    let views = record.ledger().store().views()?;
    let (doubt, kept) = (doubt_on_record(&views)?, newest_reading(&views)?);
    drop(views);
    if let Some(kept) = kept {
        record.wall_mut().hold_against(&kept);
    }
    if let Some(doubt) = doubt {
        record.wall_mut().keep_doubt(doubt);
    }
    Ok(())
}

/// What was believed last.
fn newest_reading(views: &Views) -> Result<Option<KeptReading>, StoreError> {
    let mut newest: (u64, Option<KeptReading>) = (0, None);
    for kind in [RecordKind::EngineBegan, RecordKind::EngineEnded, RecordKind::ClockConfirmed] {
        let filter = AuditFilter { kind: Some(kind), limit: 1, newest_first: true, ..AuditFilter::default() };
        let Some(found) = views.audit(&filter)?.into_iter().next() else { continue };
        let read = serde_json::from_str::<ReadingOnRecord>(&found.body).ok().and_then(|read| read.clock);
        if read.is_some() && found.seq > newest.0 {
            newest = (found.seq, read);
        }
    }
    Ok(newest.1)
}

/// The last doubt on record that nobody has confirmed the time after.
///
/// # Errors
/// If the store cannot be read.
pub fn doubt_on_record(views: &Views) -> Result<Option<ClockDoubt>, StoreError> {
    let newest = |kind| {
        let filter = AuditFilter { kind: Some(kind), limit: 1, newest_first: true, ..AuditFilter::default() };
        views.audit(&filter).map(|found| found.into_iter().next())
    };
    let confirmed_seq = newest(RecordKind::ClockConfirmed)?.map_or(0, |record| record.seq);
    let doubted = newest(RecordKind::ClockDoubted)?.filter(|record| record.seq > confirmed_seq);
    Ok(doubted.map(|record| read(&record.body)))
}

/// The doubt in a record's body. What cannot be read is a doubt all the same.
pub(crate) fn read(body: &str) -> ClockDoubt {
    let unread = ClockDoubt::Jumped { by_ms: 0 };
    serde_json::from_str::<DoubtOnRecord>(body).map_or(unread, |on_record| on_record.doubt)
}

/// Puts a doubt on record as soon as there is one.
///
/// # Errors
/// If it cannot be written; the clock is not believed all the same.
pub(crate) fn look(record: &mut Record) -> Result<(), StoreError> {
    if record.ledger().wall().is_doubt_kept() {
        return Ok(());
    }
    let Some(doubt) = record.ledger().wall().doubt() else { return Ok(()) };
    let said = record.ledger().wall().said();
    record.wall_mut().keep_doubt(doubt);
    let body = serde_json::json!(DoubtOnRecord { doubt, said });
    let text = format!("{doubt}; nothing is activated until a person confirms the time");
    let written = record.note(RecordKind::ClockDoubted, String::new(), body.to_string());
    record.raise(AlarmKey::ClockDoubted, Priority::High, false, &text);
    written
}

/// How it stands, where the clock is not believed.
pub(crate) fn view(record: &Record) -> Option<ClockDoubtView> {
    let doubt = record.ledger().wall().doubt()?;
    Some(ClockDoubtView { doubt, text: doubt.to_string(), said: record.ledger().wall().said()? })
}

/// A person confirms what the machine's clock says; `time` is what the person read. `caller` is whose process asks.
///
/// # Errors
/// If it cannot be written; the clock is then not believed, as before.
pub(crate) fn confirm(
    record: &mut Record,
    (by, reason): (String, String),
    time: WallTime,
    caller: &Caller,
) -> Result<Reply, StoreError> {
    let refuse = |code, text: String| Ok(Reply::Refused { code, text, hint: None });
    let (Some(doubt), Some(said)) = (record.ledger().wall().doubt(), record.ledger().wall().said()) else {
        return refuse(
            Refusal::NotNow,
            "the machine's clock is believed; nothing waits to be confirmed".to_owned(),
        );
    };
    let fits = |text: &str| is_visible(text) && text.len() <= REASON_BYTES_MAX;
    if !fits(&by) || !fits(&reason) {
        let text =
            format!("a name and a reason that can be read are needed, of 1 to {REASON_BYTES_MAX} bytes each");
        return refuse(Refusal::BadInput, text);
    }
    if said.ms_until(time).max(time.ms_until(said)) > CONFIRMED_WITHIN_MS {
        let text = format!("the machine's clock says {said}, and {time} is confirmed: read the time again");
        return refuse(Refusal::Stale, text);
    }
    if let Some(version) = own_that_waits(record, &by)? {
        let text = format!(
            "{by} registered or wrote {version}, which is not decided: its deadlines run by this clock, so somebody else confirms \
             the time"
        );
        return refuse(Refusal::NotAllowed, text);
    }
    record.wall_mut().believe();
    let clock = record.ledger().wall().reading();
    let body = serde_json::json!({
        "by": by, "caller": caller, "clock": clock, "reason": reason, "time": said, "doubt": doubt
    });
    if let Err(error) = record.note(RecordKind::ClockConfirmed, String::new(), body.to_string()) {
        record.wall_mut().keep_doubt(doubt);
        return Err(error);
    }
    record.alarm_event(&AlarmEvent::Clear { key: AlarmKey::ClockDoubted });
    Ok(Reply::Accepted { text: format!("{by} confirmed the time, {said}"), version: None })
}

/// A version of this person's that people may still decide on, or have to review.
fn own_that_waits(record: &Record, by: &str) -> Result<Option<CapabilityId>, StoreError> {
    let persons = record.ledger().store().persons()?;
    let waits = |family: &FamilyState, number: usize, version: &Version| {
        let is_candidate =
            !version.state.is_terminal() && !matches!(version.state, State::Active | State::Superseded);
        let is_reviewed = family.review.is_some_and(|review| usize::from(review.version.0) == number);
        is_candidate || version.flags.awaiting_approval || is_reviewed
    };
    let mut all = record.ledger().families().flat_map(|(_, entry)| {
        entry
            .members
            .iter()
            .zip(&entry.state.versions)
            .enumerate()
            .map(move |(number, of)| (entry, number, of))
    });
    let found = all.find(|(entry, number, (member, version))| {
        waits(&entry.state, *number, version) && origin::is_of(&persons, member, by)
    });
    Ok(found.map(|(_, _, (member, _))| member.capability.id()))
}

#[cfg(test)]
mod tests;
