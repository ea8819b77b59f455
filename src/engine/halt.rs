//! A person's stop of the cell and its end: on record, told, and remembered over restarts.
//!
//! That the arm stands is the [`Switch`](crate::world::switch::Switch)'s, before anything here runs; a stop that
//! cannot be written is a stop all the same. Functions over record and live world.

use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Caller, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::snapshot::StoppedView;
use holdpoint_registry::{AuditFilter, StoreError, Views};
use holdpoint_text::{Hint, is_visible};
use serde::{Deserialize, Serialize};

use crate::caller;
use crate::operations::REASON_BYTES_MAX;
use crate::record::Record;
use crate::world::LiveWorld;
use crate::world::switch::AskedStop;

/// A stop or its end, as the chain keeps it.
#[derive(Serialize, Deserialize)]
struct StopOnRecord {
    by: String,
    caller: Caller,
    reason: String,
}

/// Whose process the engine's own requests come from: a script is nobody's.
pub(crate) fn own_caller(record: &Record) -> Caller {
    if record.clock().is_scripted() { Caller::Script } else { caller::own() }
}

/// Stops the cell and puts it on record. Who asked through the door or at the console has stopped the arm already.
pub(crate) fn stop(record: &mut Record, world: &mut LiveWorld, asked: AskedStop) -> Reply {
    world.switch().halt(asked);
    let written = take_in(record, world);
    let stopped = match &world.halted {
        Some(halted) if halted.by.is_empty() => "the cell is stopped".to_owned(),
        Some(halted) => format!("the cell is stopped, by {}", halted.by),
        None => "the cell is stopped".to_owned(),
    };
    match written {
        Ok(()) => Reply::Accepted { text: format!("{stopped}; `go` lets it work again"), version: None },
        Err(error) => Reply::Refused {
            code: Refusal::Store,
            text: format!("{stopped}, but it could not be put on record: {}", error.sentence()),
            hint: error.hint().map(std::borrow::Cow::into_owned),
        },
    }
}

/// Puts every stop on record that was asked for on any thread; the first one is who stopped the cell.
pub(crate) fn take_in(record: &mut Record, world: &mut LiveWorld) -> Result<(), StoreError> {
    let mut written = Ok(());
    while let Some(asked) = world.switch().take_asked() {
        written = written.and(note(record, world, asked));
    }
    written
}

fn note(record: &mut Record, world: &mut LiveWorld, asked: AskedStop) -> Result<(), StoreError> {
    let AskedStop { mut by, mut reason, caller, id: _ } = asked;
    // Nobody is sent back for a long name while an arm moves.
    for text in [&mut by, &mut reason] {
        text.truncate(text.floor_char_boundary(REASON_BYTES_MAX));
    }
    record.tell(EventKind::CellStopped { by: by.clone(), caller: caller.clone(), reason: reason.clone() });
    let body = serde_json::json!({ "by": by, "caller": caller, "reason": reason }).to_string();
    world.halted.get_or_insert(StoppedView {
        by,
        caller,
        reason,
        since_ms: record.now_ms(),
        stood_after_ticks: None,
    });
    record.note(RecordKind::CellStopped, String::new(), body)
}

/// Tells, once, that the stopped arm stands.
pub(crate) fn look(record: &mut Record, world: &mut LiveWorld) {
    let at_work = world.is_running();
    let after = world.switch().stood_after(at_work);
    let Some(halted) = world.halted.as_mut().filter(|halted| halted.stood_after_ticks.is_none()) else {
        return;
    };
    if let Some(ticks) = after {
        halted.stood_after_ticks = Some(ticks);
        record.tell(EventKind::ArmStands { ticks });
    }
}

/// A person lets the stopped cell work again; `caller` is whose process asks.
pub(crate) fn go(
    record: &mut Record,
    world: &mut LiveWorld,
    by: String,
    reason: String,
    caller: Caller,
) -> Result<Reply, StoreError> {
    let refuse = |code, text: &str| Ok(Reply::Refused { code, text: text.to_owned(), hint: None });
    if world.halted.is_none() {
        return refuse(Refusal::NotNow, "the cell is not stopped");
    }
    let fits = |text: &str| is_visible(text) && text.len() <= REASON_BYTES_MAX;
    if !fits(&by) || !fits(&reason) {
        let text =
            format!("a name and a reason that can be read are needed, of 1 to {REASON_BYTES_MAX} bytes each");
        return refuse(Refusal::BadInput, &text);
    }
    let body = serde_json::json!({ "by": by, "caller": caller, "reason": reason }).to_string();
    record.note(RecordKind::CellReleased, String::new(), body)?;
    if !world.switch().release() {
        // Somebody stopped it meanwhile; that stop goes on record next, and counts.
        return refuse(Refusal::NotNow, "the cell was stopped again meanwhile");
    }
    world.halted = None;
    record.tell(EventKind::CellReleased { by, caller, reason });
    Ok(Reply::Accepted { text: "the cell works again".to_owned(), version: None })
}

/// A stop that nobody has ended, from the chain: the first after the last go.
///
/// # Errors
/// If the store cannot be read.
pub fn recall(views: &Views) -> Result<Option<StoppedView>, StoreError> {
    let newest = AuditFilter {
        kind: Some(RecordKind::CellReleased),
        limit: 1,
        newest_first: true,
        ..AuditFilter::default()
    };
    let from_seq = views.audit(&newest)?.first().map_or(0, |record| record.seq);
    let first =
        AuditFilter { from_seq, kind: Some(RecordKind::CellStopped), limit: 1, ..AuditFilter::default() };
    let Some(found) = views.audit(&first)?.into_iter().next() else { return Ok(None) };
    // What cannot be read is a stop by somebody: uncertain means stopped.
    let kept = serde_json::from_str(&found.body).unwrap_or(StopOnRecord {
        by: String::new(),
        caller: Caller::Script,
        reason: String::new(),
    });
    Ok(Some(StoppedView {
        by: kept.by,
        caller: kept.caller,
        reason: kept.reason,
        since_ms: found.at_ms,
        stood_after_ticks: Some(0),
    }))
}
