//! A person's stop of the cell and its end: on record, told, and remembered over restarts.
//!
//! That the arm stands is the [`Switch`](crate::world::switch::Switch)'s, before anything here runs; a stop that
//! cannot be written is a stop all the same. Functions over record and live world.

use holdpoint_governance::alarms::{AlarmKey, Priority};
use holdpoint_governance::comes_up::{ComesUpStopped, LastEngine, comes_up_stopped, keeps_its_end};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Caller, Refusal, Reply, StopKept};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::snapshot::{StopAgain, StoppedView};
use holdpoint_registry::{AuditFilter, Layout, StopMarks, StoreError, Views};
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
    /// Why the cell came up stopped; absent where somebody stopped it at work.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    code: Option<ComesUpStopped>,
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
        Some(halted) if !halted.by.is_empty() => format!("the cell is stopped, by {}", halted.by),
        Some(_) | None => "the cell is stopped".to_owned(),
    };
    let why = written.err().map_or_else(String::new, |error| format!(": {}", error.sentence()));
    // It may have been tried on another turn of the engine.
    let kept = world.unwritten.kept();
    let text = match kept {
        StopKept::OnRecord => format!("{stopped}; `go` lets it work again"),
        StopKept::InMark => format!("{stopped}; it could not be put on record, and is kept beside it{why}"),
        StopKept::InMemory => format!("{stopped}; {KEPT_NOWHERE}{why}"),
    };
    Reply::Stopped { text, kept }
}

/// What is said of a stop that is in no file.
pub(crate) const KEPT_NOWHERE: &str =
    "it could be kept neither on record nor beside it: a sudden end of the engine forgets it";

/// The answer to a stop that the engine has not put on record in time: it is kept beside the record meanwhile.
pub(crate) fn stopped_meanwhile(asked: &AskedStop, marks: &StopMarks, next: &str) -> Reply {
    match marks.keep(&StopOnRecord::of(asked).text()) {
        Ok(()) => Reply::Stopped {
            text: format!("the cell is stopped, which is kept beside the record; {next}"),
            kept: StopKept::InMark,
        },
        Err(error) => Reply::Stopped {
            text: format!("the cell is stopped; {next}; until then {KEPT_NOWHERE}: {}", error.sentence()),
            kept: StopKept::InMemory,
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
    /// Whether the first of them is kept beside the record.
    is_marked: bool,
}

impl UnwrittenStops {
    /// Where the stop of the cell is kept.
    pub(crate) const fn kept(&self) -> StopKept {
        match (self.bodies.is_empty(), self.is_marked) {
            (true, _) => StopKept::OnRecord,
            (false, true) => StopKept::InMark,
            (false, false) => StopKept::InMemory,
        }
    }
}

/// Puts what could not be put on record there after all. Until then the first of it lies beside the database, where the
/// next engine finds it.
pub(crate) fn write_again(record: &mut Record, world: &mut LiveWorld) -> Result<(), StoreError> {
    while let Some(body) = world.unwritten.bodies.first().cloned() {
        world.unwritten.tried = Some(Instant::now());
        record.note(RecordKind::CellStopped, String::new(), body)?;
        world.unwritten.bodies.remove(0);
    }
    record.ledger().store().layout().stop_marks().remove();
    Ok(())
}

/// A cell that was stopped under an earlier engine stays so. One whose last engine ended suddenly, or that was stopped
/// without a record, is stopped now, with an alarm.
///
/// # Errors
/// If the store cannot be read or written.
pub(crate) fn come_up(record: &mut Record, world: &mut LiveWorld) -> Result<(), StoreError> {
    let store = record.ledger().store();
    let layout = store.layout().clone();
    let marks = layout.stop_marks();
    let (stopped, last) = {
        let views = store.views()?;
        (on_record(&views)?, last_engine(&views)?)
    };
    let is_known = |stop: &StopOnRecord| stopped.as_ref().is_some_and(|stopped| stop.is_among(stopped));
    let asked = stop_mark::look(&layout).map(|found| found.asked);
    let is_settled = |asked: &AskedStop| is_known(&StopOnRecord::of(asked));
    if let Some(asked) = asked.as_ref().filter(|asked| is_settled(asked)) {
        stop_mark::settle(&layout, &asked.id);
    }
    let asked = asked.filter(|asked| !is_settled(asked));
    if let Some(asked) = &asked {
        world.switch().halt(asked.clone());
    }
    let mut unrecorded = asked.is_some();
    let mut marked = marks.found().map(|text| StopOnRecord::read(&text));
    if marked.as_ref().is_some_and(is_known) {
        marks.remove();
        marked = None;
    }
    // So is who stopped the cell while the record was read.
    let waits = world.switch().first_asked();
    marked =
        marked.filter(|stop| !waits.as_ref().is_some_and(|asked| stop.is_same(&StopOnRecord::of(asked))));
    unrecorded |= marked.is_some();
    if let Some(stopped) = stopped {
        world.stay_halted(stopped);
    }
    let Some(why) = comes_up_stopped(last, unrecorded) else { return Ok(()) };
    let mut text = match why {
        ComesUpStopped::UnrecordedStop => "somebody had stopped the cell, and that was not on record",
        ComesUpStopped::UncleanEnd => UNCLEAN_END,
    };
    world.switch().latch();
    if let Some(asked) = asked.filter(|asked| world.switch().first_asked().as_ref() == Some(asked)) {
        take_first(record, world, &asked, Some(ComesUpStopped::UnrecordedStop))?;
    }
    if let Some(stop) = marked {
        note(record, world, stop.because(ComesUpStopped::UnrecordedStop))?;
    }
    if last == LastEngine::Began {
        text = UNCLEAN_END;
        let (by, caller, reason) = ("the engine".to_owned(), own_caller(record), UNCLEAN_END.to_owned());
        let stop = StopOnRecord { by, caller, reason, code: None };
        note(record, world, stop.because(ComesUpStopped::UncleanEnd))?;
        ended(record, false)?;
    }
    record.raise(AlarmKey::CameUpStopped, Priority::High, true, text);
    Ok(())
}

/// Why the engine itself stops a cell.
const UNCLEAN_END: &str = "the last engine ended suddenly while it worked the cell: look at the cell first";

fn last_engine(views: &Views) -> Result<LastEngine, StoreError> {
    let newest = |kind| -> Result<u64, StoreError> {
        let one = AuditFilter { kind: Some(kind), limit: 1, newest_first: true, ..AuditFilter::default() };
        Ok(views.audit(&one)?.first().map_or(0, |record| record.seq))
    };
    let open = newest(RecordKind::EngineBegan)? > newest(RecordKind::EngineEnded)?;
    Ok(if open { LastEngine::Began } else { LastEngine::Ended })
}

/// Puts on record, once, that this engine begins to work the cell: a later one sees that it did not end in good order.
pub(crate) fn begin_work(
    record: &mut Record,
    world: &mut LiveWorld,
    profile: ProfileName,
) -> Result<(), StoreError> {
    if world.at_work || world.is_halted() || record.clock().is_scripted() || !keeps_its_end(profile) {
        return Ok(());
    }
    let clock = record.ledger().wall().reading();
    let body = serde_json::json!({ "clock": clock, "profile": profile }).to_string();
    record.note(RecordKind::EngineBegan, String::new(), body)?;
    world.at_work = true;
    Ok(())
}

/// Puts on record that the engine ends in good order, if it worked the cell. One that holds does not: nobody knows what
/// its fault left.
pub(crate) fn end_work(record: &mut Record, world: &mut LiveWorld) -> Result<(), StoreError> {
    if world.at_work && record.holding().is_none() {
        ended(record, true)?;
        world.at_work = false;
    }
    Ok(())
}

fn ended(record: &mut Record, orderly: bool) -> Result<(), StoreError> {
    let clock = record.ledger().wall().reading();
    let body = serde_json::json!({ "clock": clock, "orderly": orderly }).to_string();
    record.note(RecordKind::EngineEnded, String::new(), body)
}

/// Puts every stop on record that was asked for on any thread; the first one is who stopped the cell.
pub(crate) fn take_in(record: &mut Record, world: &mut LiveWorld) -> Result<(), StoreError> {
    let rests = |tried: Instant| tried.elapsed() < AGAIN_AFTER;
    let mut written = Ok(());
    if !world.unwritten.bodies.is_empty() && !world.unwritten.tried.is_some_and(rests) {
        written = write_again(record, world);
    }
    // One that is being written is still asked for: until then the door says so.
    while let Some(asked) = world.switch().first_asked() {
        written = written.and(take_first(record, world, &asked, None));
    }
    written
}

/// Puts the first stop that is asked for on record, and takes its mark away once it is kept.
fn take_first(
    record: &mut Record,
    world: &mut LiveWorld,
    asked: &AskedStop,
    code: Option<ComesUpStopped>,
) -> Result<(), StoreError> {
    let written = note(record, world, StopOnRecord { code, ..StopOnRecord::of(asked) });
    world.switch().took_asked();
    if world.unwritten.kept() != StopKept::InMemory {
        stop_mark::settle(record.ledger().store().layout(), &asked.id);
    }
    written
}

fn note(record: &mut Record, world: &mut LiveWorld, stop: StopOnRecord) -> Result<(), StoreError> {
    let body = stop.text();
    let StopOnRecord { by, caller, reason, code: _ } = stop;
    record.tell(EventKind::CellStopped { by: by.clone(), caller: caller.clone(), reason: reason.clone() });
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
    let marks = record.ledger().store().layout().stop_marks();
    match &written {
        Ok(()) => marks.remove(),
        Err(_) => {
            // Where nothing at all can be written, the arm is stopped as long as this engine lives.
            world.unwritten.is_marked = marks.keep(world.unwritten.bodies.first().unwrap_or(&body)).is_ok();
            world.unwritten.bodies.push(body);
            world.unwritten.tried = Some(Instant::now());
        }
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

/// The refusal of whatever would make a version active beside the gate while the cell is stopped: the person who lets the
/// cell go is not told of that version.
pub(crate) fn lets_nothing_in(id: &CapabilityId) -> Reply {
    Reply::Refused {
        code: Refusal::NotNow,
        text: format!("the cell is stopped, and {id} does not become active before it works again"),
        hint: Some("a person lets it work first: `holdpoint go`".to_owned()),
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
    let layout = record.ledger().store().layout();
    if let Some(found) = stop_mark::look(layout)
        && world.switch().knows(&found.asked.id)
        && world.switch().first_asked().is_none()
    {
        // One of the stops that are let go, whose maker has put it there again.
        stop_mark::settle(layout, &found.asked.id);
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
    let marked = layout.as_ref().and_then(|layout| layout.stop_marks().found());
    let marked = marked.map(|text| StopOnRecord::read(&text));
    let asked = || layout.as_ref().and_then(stop_mark::look).map(|found| StopOnRecord::of(&found.asked));
    // When it was asked for is on no record: after the last there is.
    let since_ms = views.head()?.at_ms;
    Ok(marked.or_else(asked).map(|stop| stop.view(since_ms)))
}

/// A stop that the chain holds and that nobody has ended.
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
        let StopOnRecord { by, caller, reason, code: _ } = StopOnRecord::read(&record.body);
        stopped.note_again(StopAgain { by, caller, reason, at_ms: record.at_ms });
    }
    Ok(Some(stopped))
}

const fn user(caller: &Caller) -> Option<u32> {
    match caller {
        Caller::Process { uid, .. } => Some(*uid),
        Caller::Script => None,
    }
}

impl StopOnRecord {
    fn of(asked: &AskedStop) -> Self {
        // Nobody is sent back for a long name while an arm moves.
        let cut = |text: &str| text[..text.floor_char_boundary(REASON_BYTES_MAX)].to_owned();
        Self { by: cut(&asked.by), caller: asked.caller.clone(), reason: cut(&asked.reason), code: None }
    }

    fn because(self, code: ComesUpStopped) -> Self {
        Self { code: Some(code), ..self }
    }

    fn text(&self) -> String {
        let mut body = serde_json::json!({ "by": self.by, "caller": self.caller, "reason": self.reason });
        if let Some(code) = self.code {
            body["code"] = code.name().into();
        }
        body.to_string()
    }

    /// Whether it is one of those that keep the cell stopped.
    fn is_among(&self, stopped: &StoppedView) -> bool {
        let named = stopped.again.iter().map(|one| (&one.by, &one.caller, &one.reason));
        let mut all = named.chain([(&stopped.by, &stopped.caller, &stopped.reason)]);
        all.any(|(by, caller, reason)| {
            self.by == *by && self.reason == *reason && user(caller) == user(&self.caller)
        })
    }

    /// Whether both tell of one stop; whose process it was is told by one of them alone.
    fn is_same(&self, other: &Self) -> bool {
        self.by == other.by && self.reason == other.reason && user(&self.caller) == user(&other.caller)
    }

    /// What cannot be read is a stop by somebody: uncertain means stopped.
    fn read(text: &str) -> Self {
        serde_json::from_str(text).unwrap_or(Self {
            by: "nobody known".to_owned(),
            caller: Caller::Script,
            reason: "a record of a stop that cannot be read".to_owned(),
            code: None,
        })
    }

    fn view(self, since_ms: u64) -> StoppedView {
        let Self { by, caller, reason, code: _ } = self;
        StoppedView { stood_after_ticks: Some(0), ..StoppedView::first(by, caller, reason, since_ms) }
    }
}
