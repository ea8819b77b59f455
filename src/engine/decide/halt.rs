//! A person's stop of the cell and its end: recorded, published, and restored after a restart.
//!
//! The [`StopSwitch`](crate::live::stop_switch::StopSwitch) stops the arm before any code here runs; a stop that cannot be
//! written is still a stop. Functions over record and live cell.

use holdpoint_governance::alarms::{AlarmEvent, AlarmKey, Priority};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::startup_stop::{
    LastEngineRun, StartStoppedReason, records_run_end, start_stopped_reason,
};
use holdpoint_protocol::command::{Caller, Refusal, Reply, StopPersistence};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::snapshot::{RepeatedStop, StoppedView};
use holdpoint_store::{AuditFilter, Layout, RecordViews, StopMarks, StoreError};
use holdpoint_text::{Hint, signing_options};
pub use holdpoint_wording::command_effect::StopFollowUp;
use holdpoint_wording::command_effect::{EngineEffect, early_stop_effect, engine_effect, stop_effect};
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};

use crate::decide::people::persons::unreadable;
use crate::decide::recorder::EngineRecorder;
use crate::live::account_stops::AccountStops;
use crate::live::stop_switch::StopRequest;
use crate::live::{LiveWorld, stop_mark};
use holdpoint_record::{REASON_BYTES_MAX, caller};
use holdpoint_wording::program::engine as sentences;

/// A stop or its end, in the audit chain.
#[derive(Serialize, Deserialize)]
struct StopRecord {
    by: String,
    caller: Caller,
    reason: String,
    /// Why the cell came up stopped; absent for a stop of a running cell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    code: Option<StartStoppedReason>,
}

/// The process of the engine's own requests; a script has none.
pub(crate) fn own_caller(record: &EngineRecorder) -> Caller {
    if record.clock().is_scripted() { Caller::Script } else { caller::own() }
}

/// Stops the cell and records it. The socket or the console has stopped the arm already.
pub(crate) fn stop(record: &mut EngineRecorder, world: &mut LiveWorld, request: StopRequest) -> Reply {
    let caller = request.caller.clone();
    world.switch().halt(request);
    let written = record_stops(record, world);
    // The name that another account states is no text for this one.
    let first =
        world.halted.as_ref().map(|halted| &halted.caller).filter(|first| user(first) != user(&caller));
    let problem = written.err().map(|error| error.sentence());
    // An earlier turn of the engine may have tried.
    let kept = world.unwritten.stop_storage();
    let text = stop_effect(first, kept, problem.as_deref(), world.account_stops.summed(&caller));
    Reply::Stopped { text, kept }
}

/// Stops a cell that does not answer any more, or stopped by itself. A person looks and starts it again.
pub(crate) fn stop_lost(record: &mut EngineRecorder, world: &mut LiveWorld, reason: &str) {
    let id = format!("cell-lost-{}", record.now_ms());
    let (by, caller) = ("the engine".to_owned(), own_caller(record));
    let request = StopRequest { id, by, reason: reason.to_owned(), caller };
    // The answer is for a person who asks.
    let _ = stop(record, world, request);
    let notice = Notice::CellLost { problem: reason.to_owned() };
    record.raise(AlarmKey::CellLost, Priority::High, true, notice);
}

/// The answer to a stop that the engine does not record in time: it is stored beside the record meanwhile.
#[must_use]
pub fn stopped_meanwhile(request: &StopRequest, marks: &StopMarks, follow_up: StopFollowUp) -> Reply {
    match marks.keep(&StopRecord::of(request).text()) {
        Ok(()) => {
            let kept = StopPersistence::InMark;
            Reply::Stopped { text: early_stop_effect(follow_up, kept, None), kept }
        }
        Err(error) => stopped_in_memory(follow_up, Some(&error.sentence())),
    }
}

/// The answer to a stop that is in no file.
#[must_use]
pub fn stopped_in_memory(follow_up: StopFollowUp, problem: Option<&str>) -> Reply {
    let kept = StopPersistence::InMemory;
    Reply::Stopped { text: early_stop_effect(follow_up, kept, problem), kept }
}

/// How long the engine waits before it tries to record a stop again.
const AGAIN_AFTER: Duration = Duration::from_secs(10);

/// Records stops that could not be written before. Until then the first of them is stored beside the database for the next
/// engine.
pub(crate) fn write_again(record: &mut EngineRecorder, world: &mut LiveWorld) -> Result<(), StoreError> {
    while let Some(body) = world.unwritten.bodies.first().cloned() {
        world.unwritten.tried = Some(Instant::now());
        record.note(RecordKind::CellStopped, String::new(), body)?;
        world.unwritten.bodies.remove(0);
    }
    record.version_table().store().layout().stop_marks().remove();
    Ok(())
}

/// Keeps a cell stopped that was stopped under an earlier engine. Stops the cell, with an alarm, if the last engine ended
/// suddenly or a stop is not on record.
///
/// # Errors
/// If the store cannot be read or written.
pub(crate) fn restore_stop(record: &mut EngineRecorder, world: &mut LiveWorld) -> Result<(), StoreError> {
    let store = record.version_table().store();
    let layout = store.layout().clone();
    let marks = layout.stop_marks();
    let (stopped, last) = {
        let views = store.views()?;
        (on_record(&*views)?, last_engine(&*views)?)
    };
    let is_known = |stop: &StopRecord| stopped.as_ref().is_some_and(|stopped| stop.is_among(stopped));
    // Without a socket, no watch does it.
    stop_mark::bring_forward(&layout);
    let request = stop_mark::look(&layout).map(|found| found.request);
    let is_settled = |request: &StopRequest| is_known(&StopRecord::of(request));
    if let Some(request) = request.as_ref().filter(|request| is_settled(request)) {
        stop_mark::settle(&layout, &request.id);
    }
    let request = request.filter(|request| !is_settled(request));
    if let Some(request) = &request {
        world.switch().halt(request.clone());
    }
    let mut unrecorded = request.is_some();
    let mut marked = marks.found().map(|text| StopRecord::read(&text));
    if marked.as_ref().is_some_and(is_known) {
        marks.remove();
        marked = None;
    }
    // This includes a stop made while the record was read.
    let waits = world.switch().first_stop();
    marked =
        marked.filter(|stop| !waits.as_ref().is_some_and(|request| stop.is_same(&StopRecord::of(request))));
    unrecorded |= marked.is_some();
    if let Some(stopped) = stopped {
        world.stay_halted(stopped);
    }
    let Some(why) = start_stopped_reason(last, unrecorded) else { return Ok(()) };
    let mut cause = why;
    world.switch().latch();
    if let Some(request) = request.filter(|request| world.switch().first_stop().as_ref() == Some(request)) {
        record_first_stop(record, world, &request, Some(StartStoppedReason::UnrecordedStop))?;
    }
    if let Some(stop) = marked {
        note(record, world, stop.because(StartStoppedReason::UnrecordedStop))?;
    }
    if last == LastEngineRun::Began {
        cause = StartStoppedReason::UncleanEnd;
        let last_record = record.version_table().store().opening().newest_record;
        let reason = holdpoint_wording::stop_after_unclean_end(last_record);
        let (by, caller) = ("the engine".to_owned(), own_caller(record));
        let stop = StopRecord { by, caller, reason, code: None };
        note(record, world, stop.because(StartStoppedReason::UncleanEnd))?;
        ended(record, false)?;
    }
    record.raise(AlarmKey::CameUpStopped, Priority::High, true, Notice::CameUpStopped { cause });
    Ok(())
}

fn last_engine(views: &dyn RecordViews) -> Result<LastEngineRun, StoreError> {
    let newest = |kind| -> Result<u64, StoreError> {
        Ok(views.audit(&AuditFilter::newest(kind))?.first().map_or(0, |record| record.seq))
    };
    let open = newest(RecordKind::EngineBegan)? > newest(RecordKind::EngineEnded)?;
    Ok(if open { LastEngineRun::Began } else { LastEngineRun::Ended })
}

/// Records, once, that this engine begins to run the cell, so that a later one detects an unclean end.
pub(crate) fn begin_work(
    record: &mut EngineRecorder,
    world: &mut LiveWorld,
    profile: ProfileName,
) -> Result<(), StoreError> {
    let has_secret_seeds = record.seeds().of_run().is_none();
    let records = !record.clock().is_scripted() && records_run_end(profile, has_secret_seeds);
    if world.at_work || world.is_halted() || !records {
        return Ok(());
    }
    let clock = record.version_table().wall().reading();
    let body = serde_json::json!({ "clock": clock, "profile": profile }).to_string();
    record.note(RecordKind::EngineBegan, String::new(), body)?;
    world.at_work = true;
    Ok(())
}

/// Records a clean end of an engine that ran the cell. A halted engine does not: the effects of its fault are unknown.
pub(crate) fn end_work(record: &mut EngineRecorder, world: &mut LiveWorld) -> Result<(), StoreError> {
    if world.at_work && record.holding().is_none() {
        ended(record, true)?;
        world.at_work = false;
    }
    Ok(())
}

fn ended(record: &mut EngineRecorder, orderly: bool) -> Result<(), StoreError> {
    let clock = record.version_table().wall().reading();
    let body = serde_json::json!({ "clock": clock, "orderly": orderly }).to_string();
    record.note(RecordKind::EngineEnded, String::new(), body)
}

/// Records every stop requested on any thread; the first one counts as the stop of the cell.
pub(crate) fn record_stops(record: &mut EngineRecorder, world: &mut LiveWorld) -> Result<(), StoreError> {
    let rests = |tried: Instant| tried.elapsed() < AGAIN_AFTER;
    let mut written = Ok(());
    if !world.unwritten.bodies.is_empty() && !world.unwritten.tried.is_some_and(rests) {
        written = write_again(record, world);
    }
    // A stop stays requested while it is being written, so that the socket reports it.
    while let Some(request) = world.switch().first_stop() {
        written = written.and(record_first_stop(record, world, &request, None));
    }
    written
}

/// Records the first requested stop, and removes its mark once it is stored.
fn record_first_stop(
    record: &mut EngineRecorder,
    world: &mut LiveWorld,
    request: &StopRequest,
    code: Option<StartStoppedReason>,
) -> Result<(), StoreError> {
    let written = note(record, world, StopRecord { code, ..StopRecord::of(request) });
    world.switch().pop_stop();
    if world.unwritten.stop_storage() != StopPersistence::InMemory {
        stop_mark::settle(record.version_table().store().layout(), &request.id);
    }
    written
}

fn note(record: &mut EngineRecorder, world: &mut LiveWorld, stop: StopRecord) -> Result<(), StoreError> {
    if !world.account_stops.counts(&stop.caller, record.now_ms()) && world.halted.is_some() {
        return Ok(());
    }
    let body = stop.text();
    let StopRecord { by, caller, reason, code: _ } = stop;
    record.tell(EventKind::CellStopped { by: by.clone(), caller: caller.clone(), reason: reason.clone() });
    let (at_ms, wall) = (record.now_ms(), record.version_table().wall().machine_time());
    match &mut world.halted {
        Some(halted) => halted.record_repeat(RepeatedStop { by, caller, reason, at_ms, wall }),
        None => {
            world.halted = Some(StoppedView { wall, ..StoppedView::first(by, caller, reason, at_ms) });
        }
    }
    let written = if world.unwritten.bodies.is_empty() {
        record.note(RecordKind::CellStopped, String::new(), body.clone())
    } else {
        // Preserves their order.
        Err(StoreError::Unknown)
    };
    let marks = record.version_table().store().layout().stop_marks();
    match &written {
        Ok(()) => marks.remove(),
        Err(_) => {
            // If nothing can be written, the arm stays stopped as long as this engine runs.
            world.unwritten.is_marked = marks.keep(world.unwritten.bodies.first().unwrap_or(&body)).is_ok();
            world.unwritten.bodies.push(body);
            world.unwritten.tried = Some(Instant::now());
        }
    }
    written
}

/// Publishes, once, that the stopped arm is at standstill.
pub(crate) fn report_standstill(record: &mut EngineRecorder, world: &mut LiveWorld) {
    let at_work = world.is_running();
    let after = world.switch().ticks_to_standstill(at_work);
    let Some(halted) = world.halted.as_mut().filter(|halted| halted.stood_after_ticks.is_none()) else {
        return;
    };
    if let Some(ticks) = after {
        halted.stood_after_ticks = Some(ticks);
        record.tell(EventKind::ArmStands { ticks });
    }
}

/// Refuses an activation without the gate while the cell is stopped: the person who starts the cell does not see it.
pub(crate) fn activation_refusal(id: &CapabilityId) -> Reply {
    Reply::Refused {
        code: Refusal::NotNow,
        text: format!("the cell is stopped, and {id} does not become active before the cell runs again"),
        hint: Some("`holdpoint status` shows who stopped it and how to start it".to_owned()),
    }
}

/// The most marks that one start takes in; the answer names the others.
const MARKS_MAX: usize = 64;

/// Records the stops that marks request, one after the other: one answer then counts all of them. A mark that cannot be
/// removed stays, with those behind it.
fn take_in_marks(record: &mut EngineRecorder, world: &mut LiveWorld) -> Result<(), StoreError> {
    let layout = record.version_table().store().layout().clone();
    for _ in 0..MARKS_MAX {
        stop_mark::bring_forward(&layout);
        let Some(found) = stop_mark::look(&layout) else { break };
        // A stop that is known does not count again: its maker has created the mark again.
        world.switch().halt(found.request.clone());
        record_stops(record, world)?;
        if world.unwritten.stop_storage() != StopPersistence::InMemory {
            stop_mark::settle(&layout, &found.request.id);
        }
        if stop_mark::is_there(&layout) {
            break;
        }
    }
    Ok(())
}

/// A person starts the stopped cell; `caller` is the requesting process.
pub(crate) fn go(
    record: &mut EngineRecorder,
    world: &mut LiveWorld,
    by: String,
    reason: String,
    (since_ms, known): (u64, u64),
    caller: Caller,
) -> Result<Reply, StoreError> {
    let refuse = |code, text: &str| Ok(Reply::Refused { code, text: text.to_owned(), hint: None });
    if world.halted.is_some() {
        take_in_marks(record, world)?;
    }
    let Some(halted) = &world.halted else {
        return refuse(Refusal::NotNow, "the cell is not stopped");
    };
    if halted.since_ms != since_ms {
        let text = "the cell has run since, and was stopped again: read who stopped it and why";
        return refuse(Refusal::NotNow, text);
    }
    if halted.stops != known {
        let text = match halted.stops {
            1 => format!("it was stopped once, and the request names {known} stops: read who stopped it"),
            stops => {
                format!("it was stopped {stops} times, and {known} of them are known: read who did and why")
            }
        };
        let signature = signing_options(&by, &reason);
        let hint = format!(
            "`holdpoint status` shows who stopped it; `holdpoint start --stops {} {signature}` then starts it",
            halted.stops
        );
        return Ok(Reply::Refused { code: Refusal::NotNow, text, hint: Some(hint) });
    }
    let marks = stop_mark::requested_at(record.version_table().store().layout());
    if !marks.is_empty() {
        let named: Vec<String> = marks.iter().map(|path| format!("{path:?}")).collect();
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("these files request a stop, and stay in the store's folder: {}", named.join(", ")),
            hint: Some("try again in a moment; remove by hand those that stay there".to_owned()),
        });
    }
    if let Some(refused) = unreadable(&by, &reason) {
        return Ok(refused);
    }
    write_again(record, world)?;
    let mut body = serde_json::json!({ "by": by, "caller": caller, "reason": reason });
    let sums = world.account_stops.take_sums();
    if !sums.is_empty() {
        body["summed_stops"] = serde_json::json!(sums);
    }
    record.note(RecordKind::CellReleased, String::new(), body.to_string())?;
    if !world.switch().release() {
        // The cell was stopped meanwhile; that stop is recorded next, and counts.
        return refuse(Refusal::NotNow, "the cell was stopped again meanwhile");
    }
    world.halted = None;
    world.account_stops = AccountStops::default();
    record.tell(EventKind::CellReleased { by, caller, reason });
    record.alarm_event(&AlarmEvent::Clear { key: AlarmKey::CellLost });
    Ok(Reply::Accepted { text: engine_effect(&EngineEffect::CellStarted), version: None })
}

/// The most stops of one standstill that are read again; later ones are on record, but not named.
const RECALLED_MAX: usize = 256;

/// A stop without an end: the first after the last start in the chain, or the one stored beside the record.
///
/// # Errors
/// If the store cannot be read.
pub fn recall(views: &dyn RecordViews) -> Result<Option<StoppedView>, StoreError> {
    if let Some(stopped) = on_record(views)? {
        return Ok(Some(stopped));
    }
    let layout = views.folder().map(Layout::new);
    let marked = layout.as_ref().and_then(|layout| layout.stop_marks().found());
    let marked = marked.map(|text| StopRecord::read(&text));
    let requested = || layout.as_ref().and_then(stop_mark::look).map(|found| StopRecord::of(&found.request));
    // The time of the request is not on record: it is after the last record.
    let since_ms = views.head()?.at_ms;
    Ok(marked.or_else(requested).map(|stop| stop.view(since_ms)))
}

/// A stop in the chain without an end.
fn on_record(views: &dyn RecordViews) -> Result<Option<StoppedView>, StoreError> {
    let from_seq =
        views.audit(&AuditFilter::newest(RecordKind::CellReleased))?.first().map_or(0, |record| record.seq);
    let filter = AuditFilter {
        from_seq,
        kind: Some(RecordKind::CellStopped),
        limit: RECALLED_MAX,
        ..AuditFilter::default()
    };
    let mut found = views.audit(&filter)?.into_iter();
    let Some(first) = found.next() else { return Ok(None) };
    let mut stopped = StopRecord::read(&first.body).view(first.at_ms);
    stopped.wall = first.wall();
    for record in found {
        let StopRecord { by, caller, reason, code: _ } = StopRecord::read(&record.body);
        let at_ms = record.at_ms;
        stopped.record_repeat(RepeatedStop { by, caller, reason, at_ms, wall: record.wall() });
    }
    Ok(Some(stopped))
}

const fn user(caller: &Caller) -> Option<u32> {
    match caller {
        Caller::Process { uid, .. } => Some(*uid),
        Caller::Script => None,
    }
}

impl StopRecord {
    fn of(request: &StopRequest) -> Self {
        // A long name must not delay a stop: it is cut.
        let cut = |text: &str| text[..text.floor_char_boundary(REASON_BYTES_MAX)].to_owned();
        Self {
            by: cut(&request.by),
            caller: request.caller.clone(),
            reason: cut(&request.reason),
            code: None,
        }
    }

    fn because(self, code: StartStoppedReason) -> Self {
        Self { code: Some(code), ..self }
    }

    fn text(&self) -> String {
        let mut body = serde_json::json!({ "by": self.by, "caller": self.caller, "reason": self.reason });
        if let Some(code) = self.code {
            body["code"] = code.name().into();
        }
        body.to_string()
    }

    /// Whether it is one of the stops that keep the cell stopped.
    fn is_among(&self, stopped: &StoppedView) -> bool {
        let named = stopped.again.iter().map(|one| (&one.by, &one.caller, &one.reason));
        let mut all = named.chain([(&stopped.by, &stopped.caller, &stopped.reason)]);
        all.any(|(by, caller, reason)| {
            self.by == *by && self.reason == *reason && user(caller) == user(&self.caller)
        })
    }

    /// Whether both are the same stop; only one of them names the process.
    fn is_same(&self, other: &Self) -> bool {
        self.by == other.by && self.reason == other.reason && user(&self.caller) == user(&other.caller)
    }

    /// An unreadable text counts as a stop by an unknown person.
    fn read(text: &str) -> Self {
        serde_json::from_str(text).unwrap_or(Self {
            by: sentences::UNKNOWN_PERSON.to_owned(),
            caller: Caller::Script,
            reason: sentences::UNREADABLE_STOP.to_owned(),
            code: None,
        })
    }

    fn view(self, since_ms: u64) -> StoppedView {
        let Self { by, caller, reason, code: _ } = self;
        StoppedView { stood_after_ticks: Some(0), ..StoppedView::first(by, caller, reason, since_ms) }
    }
}
