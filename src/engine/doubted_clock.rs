//! A machine's clock that is not believed: on record, told, remembered over restarts, and believed again once a person has
//! confirmed the time. Meanwhile the gate lets nothing pass.
//!
//! When it is not to be believed is the rules' ([`holdpoint_governance::wall_time`]). Functions over the record.

use holdpoint_governance::alarms::{AlarmEvent, AlarmKey, Priority};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::wall_time::{ClockDoubt, WallTime};
use holdpoint_protocol::command::{Caller, Refusal, Reply};
use holdpoint_protocol::snapshot::ClockDoubtView;
use holdpoint_registry::{AuditFilter, StoreError, Views};
use holdpoint_text::is_visible;
use serde::{Deserialize, Serialize};

use crate::operations::REASON_BYTES_MAX;
use crate::record::Record;

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

/// A clock that an earlier engine did not believe is not believed, unless a person has confirmed the time since.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn recall(record: &mut Record) -> Result<(), StoreError> {
    if let Some(doubt) = doubt_on_record(&record.ledger().store().views()?)? {
        record.wall_mut().keep_doubt(doubt);
    }
    Ok(())
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
    record.wall_mut().believe();
    let body =
        serde_json::json!({ "by": by, "caller": caller, "reason": reason, "time": said, "doubt": doubt });
    if let Err(error) = record.note(RecordKind::ClockConfirmed, String::new(), body.to_string()) {
        record.wall_mut().keep_doubt(doubt);
        return Err(error);
    }
    record.alarm_event(&AlarmEvent::Clear { key: AlarmKey::ClockDoubted });
    Ok(Reply::Accepted { text: format!("{by} confirmed the time, {said}"), version: None })
}

#[cfg(test)]
mod tests;
