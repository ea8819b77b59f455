//! A person's stop of the cell and its end: on record, told, and remembered over restarts.
//!
//! That the arm stands is the [`Switch`](crate::world::switch::Switch)'s, before anything here runs; a stop that
//! cannot be written is a stop all the same. Functions over record and live world.

use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Caller, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::snapshot::{StopAgain, StoppedView};
use holdpoint_registry::{AuditFilter, Layout, StoreError, Views};
use holdpoint_text::{Hint, is_visible};
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};

use crate::caller;
use crate::operations::REASON_BYTES_MAX;
use crate::record::Record;
use crate::stop_mark;
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

/// How long it is waited until a stop that could not be put on record is tried again.
const AGAIN_AFTER: Duration = Duration::from_secs(10);

/// Stops that are in force and not on record, for the store could not be written.
#[derive(Default)]
pub(crate) struct UnwrittenStops {
    /// The bodies of their records.
    bodies: Vec<String>,
    tried: Option<Instant>,
}

/// Puts what could not be put on record there after all. Until then the first of it lies beside the database, where the
/// next engine finds it.
pub(crate) fn write_again(record: &mut Record, world: &mut LiveWorld) -> Result<(), StoreError> {
    while let Some(body) = world.unwritten.bodies.first().cloned() {
        world.unwritten.tried = Some(Instant::now());
        record.note(RecordKind::CellStopped, String::new(), body)?;
        world.unwritten.bodies.remove(0);
    }
    record.ledger().store().layout().unmark_stop();
    Ok(())
}

/// A cell that was stopped under an earlier engine stays so; a stop that could not be put on record then is asked for once
/// more.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn stay(record: &Record, world: &mut LiveWorld) -> Result<(), StoreError> {
    let store = record.ledger().store();
    if let Some(halted) = on_record(&store.views()?)? {
        world.stay_halted(halted);
    }
    if let Some(text) = store.layout().marked_stop() {
        let StopOnRecord { by, caller, reason } = StopOnRecord::read(&text);
        world.switch().halt(AskedStop { id: "unrecorded".to_owned(), by, reason, caller });
    }
    if let Some(found) = stop_mark::look(store.layout()) {
        world.switch().halt(found.asked);
    }
    Ok(())
}

/// Puts every stop on record that was asked for on any thread; the first one is who stopped the cell.
pub(crate) fn take_in(record: &mut Record, world: &mut LiveWorld) -> Result<(), StoreError> {
    let rests = |tried: Instant| tried.elapsed() < AGAIN_AFTER;
    let mut written = Ok(());
    if !world.unwritten.bodies.is_empty() && !world.unwritten.tried.is_some_and(rests) {
        written = write_again(record, world);
    }
    while let Some(asked) = world.switch().take_asked() {
        written = written.and(note(record, world, asked));
    }
    written
}

fn note(record: &mut Record, world: &mut LiveWorld, asked: AskedStop) -> Result<(), StoreError> {
    let AskedStop { mut by, mut reason, caller, id } = asked;
    // Nobody is sent back for a long name while an arm moves.
    for text in [&mut by, &mut reason] {
        text.truncate(text.floor_char_boundary(REASON_BYTES_MAX));
    }
    record.tell(EventKind::CellStopped { by: by.clone(), caller: caller.clone(), reason: reason.clone() });
    let body = serde_json::json!({ "by": by, "caller": caller, "reason": reason }).to_string();
    let at_ms = record.now_ms();
    match &mut world.halted {
        Some(halted) => halted.note_again(StopAgain { by, caller, reason, at_ms }),
        None => world.halted = Some(StoppedView::first(by, caller, reason, at_ms)),
    }
    let written = if world.unwritten.bodies.is_empty() {
        record.note(RecordKind::CellStopped, String::new(), body.clone())
    } else {
        // In their order.
        Err(StoreError::Unknown)
    };
    let layout = record.ledger().store().layout();
    let kept = match &written {
        Ok(()) => {
            layout.unmark_stop();
            true
        }
        Err(_) => {
            // Where nothing at all can be written, the arm is stopped as long as this engine lives.
            let marked = layout.mark_stop(world.unwritten.bodies.first().unwrap_or(&body)).is_ok();
            world.unwritten.bodies.push(body);
            world.unwritten.tried = Some(Instant::now());
            marked
        }
    };
    if kept {
        stop_mark::settle(layout, &id);
    }
    written
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
    (since_ms, known): (u64, u64),
    caller: Caller,
) -> Result<Reply, StoreError> {
    let refuse = |code, text: &str| Ok(Reply::Refused { code, text: text.to_owned(), hint: None });
    let Some(halted) = &world.halted else {
        return refuse(Refusal::NotNow, "the cell is not stopped");
    };
    if halted.since_ms != since_ms {
        let text = "it has worked since, and was stopped anew: read who did and why";
        return refuse(Refusal::NotNow, text);
    }
    if halted.stops != known {
        let text = match halted.stops {
            1 => format!("it was stopped once, and {known} stops are said to be known: read who stopped it"),
            stops => {
                format!("it was stopped {stops} times, and {known} of them are known: read who did and why")
            }
        };
        return refuse(Refusal::NotNow, &text);
    }
    if stop_mark::is_there(record.ledger().store().layout()) {
        let path = record.ledger().store().layout().stop_asked();
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("a stop is asked for: {path:?} lies in the store's folder"),
            hint: Some("try again in a moment; what stays there is taken away by hand".to_owned()),
        });
    }
    let fits = |text: &str| is_visible(text) && text.len() <= REASON_BYTES_MAX;
    if !fits(&by) || !fits(&reason) {
        let text =
            format!("a name and a reason that can be read are needed, of 1 to {REASON_BYTES_MAX} bytes each");
        return refuse(Refusal::BadInput, &text);
    }
    write_again(record, world)?;
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

/// The most stops of one standstill that are read again; who came later is on record, and not named.
const RECALLED_MAX: usize = 256;

/// A stop that nobody has ended: the first after the last go in the chain, or the one beside it that is on no record.
///
/// # Errors
/// If the store cannot be read.
pub fn recall(views: &Views) -> Result<Option<StoppedView>, StoreError> {
    if let Some(stopped) = on_record(views)? {
        return Ok(Some(stopped));
    }
    let layout = views.folder().map(Layout::new);
    let asked = || layout.as_ref().and_then(stop_mark::look).map(|found| found.asked.into());
    let marked = layout.as_ref().and_then(Layout::marked_stop);
    let marked = marked.map(|text| StopOnRecord::read(&text)).or_else(asked);
    // When it was asked for is on no record: after the last there is.
    let since_ms = views.head()?.at_ms;
    Ok(marked.map(|stop| stop.view(since_ms)))
}

/// A stop that nobody has ended, as the chain has it.
fn on_record(views: &Views) -> Result<Option<StoppedView>, StoreError> {
    let newest = AuditFilter {
        kind: Some(RecordKind::CellReleased),
        limit: 1,
        newest_first: true,
        ..AuditFilter::default()
    };
    let from_seq = views.audit(&newest)?.first().map_or(0, |record| record.seq);
    let since = AuditFilter {
        from_seq,
        kind: Some(RecordKind::CellStopped),
        limit: RECALLED_MAX,
        ..AuditFilter::default()
    };
    let mut found = views.audit(&since)?.into_iter();
    let Some(first) = found.next() else { return Ok(None) };
    let mut stopped = StopOnRecord::read(&first.body).view(first.at_ms);
    for record in found {
        let StopOnRecord { by, caller, reason } = StopOnRecord::read(&record.body);
        stopped.note_again(StopAgain { by, caller, reason, at_ms: record.at_ms });
    }
    Ok(Some(stopped))
}

impl From<AskedStop> for StopOnRecord {
    fn from(AskedStop { by, caller, reason, id: _ }: AskedStop) -> Self {
        Self { by, caller, reason }
    }
}

impl StopOnRecord {
    /// What cannot be read is a stop by somebody: uncertain means stopped.
    fn read(text: &str) -> Self {
        serde_json::from_str(text).unwrap_or(Self {
            by: "nobody known".to_owned(),
            caller: Caller::Script,
            reason: "a record of a stop that cannot be read".to_owned(),
        })
    }

    fn view(self, since_ms: u64) -> StoppedView {
        let Self { by, caller, reason } = self;
        StoppedView { stood_after_ticks: Some(0), ..StoppedView::first(by, caller, reason, since_ms) }
    }
}
