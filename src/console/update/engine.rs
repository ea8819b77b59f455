//! What the engine tells and answers.

use std::sync::Arc;

use super::{asking, halted, operating, overlays, tell, why};
use crate::effect::{Effect, Question};
use crate::model::{AskedFor, EngineLink, EngineState, Headway, LOG_MAX, Model, Overlay, StoryLine, View};
use holdpoint_engine::door::Doubt;
use holdpoint_engine::host::EndFault;
use holdpoint_governance::alarms::Priority;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::record::VersionGroup;
use holdpoint_protocol::command::{Refusal, Reply, StopKept};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::question::QuestionView;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::words;
use holdpoint_text::{Hint, Problem, Untrusted};

pub(super) fn started(model: &mut Model) -> Vec<Effect> {
    model.told.engine = EngineState::Running;
    let mut effects = vec![Effect::ReadIdentities];
    let everything = Question::Registry { group: VersionGroup::All, text: String::new() };
    effects.extend(asking::ask(model, String::new(), everything));
    effects
}

/// The engine is not there any more, or never came up.
pub(super) fn ended(model: &mut Model, how: Result<(), EndFault>) -> Vec<Effect> {
    if let Err(why) = &how {
        let came_up = model.told.engine == EngineState::Running;
        let what = match (came_up, why.orderly) {
            (true, true) => "the engine is gone",
            (true, false) => "the engine ended",
            (false, _) => "the engine did not come up",
        };
        tell(model, format!("{what}: {why}"), !why.orderly);
    }
    model.told.seat = None;
    model.told.engine = EngineState::Ended(how);
    operating::void_all(model, "the engine is gone");
    Vec::new()
}

/// The console sits down at an engine: where it is stays as it was, what was asked of another engine is not answered any
/// more, and its story goes on below what the other one told.
pub(super) fn seated(model: &mut Model, process: Option<i32>, doubt: Option<Doubt>) -> Vec<Effect> {
    let came_back = matches!(model.told.engine, EngineState::Ended(_));
    let is_same = process.is_some() && model.told.process == process;
    if let Some(last) = model.told.story.back().filter(|_| !is_same).cloned() {
        let text = "(the engine that told this is gone; another one tells what follows)".to_owned();
        model.told.story.push_back(StoryLine { seq: last.seq + 1, text, sequences: 0, ..last });
        model.told.story_base = last.seq + 2;
    }
    model.told.process = process;
    model.told.doubt = doubt;
    model.told.link = EngineLink::Attached;
    model.told.engine = EngineState::Starting;
    model.told.seeking = None;
    if came_back {
        // What the other engine would have done at its end says nothing of this one.
        model.told.begun = false;
        model.told.seated_ms = Some(model.now_ms);
        model.asking.pending.clear();
        model.asking.asked.clear();
        let (lost, now) = if is_same {
            let lost = "the connection to the engine was lost";
            (lost, "the engine was at work all along, and this console sits at it again")
        } else {
            let lost = "the engine that was asked is gone";
            (lost, "an engine is at work on this store again, and this console sits at it")
        };
        overlays::unanswered(model, &format!("{lost}; whether it was carried out is not known"));
        if let Some(asked) = &mut model.told.stop_asked {
            asked.why = Some(lost.to_owned());
        }
        tell(model, now, false);
    }
    Vec::new()
}

/// What an engine told before this console came.
pub(super) fn past(model: &mut Model, events: &[Event], earlier: u64) -> Vec<Effect> {
    let base = model.told.story_base;
    let known = model.told.story.back().map(|line| line.seq);
    if known.is_none_or(|known| known < base)
        && let Some(first) = events.first()
    {
        let text = if earlier == 0 {
            "(the engine began here)".to_owned()
        } else {
            format!("(the story begins here; {earlier} earlier events of this engine are on record alone)")
        };
        let seq = base.saturating_add(first.seq);
        model.told.story.push_back(StoryLine { seq, at_ms: first.at_ms, text, sequences: 0 });
    }
    for event in events.iter().filter(|event| known.is_none_or(|known| event.seq + base > known)) {
        tell_story(model, event);
    }
    Vec::new()
}

/// One line more.
fn tell_story(model: &mut Model, event: &Event) {
    let text = words::sentence(event, words::LINE_WIDTH_MAX).into_string();
    let sequences = u32::from(matches!(event.kind, EventKind::Sequence { .. }));
    let seq = event.seq.saturating_add(model.told.story_base);
    let line = StoryLine { seq, at_ms: event.at_ms, text, sequences };
    // One sequence after the other is one line: what else happens must not be drowned by them.
    match model.told.story.back_mut() {
        Some(last) if sequences > 0 && last.sequences > 0 => {
            *last = StoryLine { sequences: last.sequences.saturating_add(1), ..line };
        }
        _ => model.told.story.push_back(line),
    }
    if model.told.story.len() > LOG_MAX {
        model.told.story.pop_front();
    }
}

pub(super) fn events(model: &mut Model, events: Vec<Event>) -> Vec<Effect> {
    for event in events {
        // Progress is in the snapshot, and there is much of it.
        if matches!(event.kind, EventKind::Progress { .. }) {
            continue;
        }
        if let EventKind::CellStopped { by, .. } = &event.kind {
            halted::stopped_again(model, by, event.at_ms);
        }
        if let (
            EventKind::ApprovalReceived { version, by, decision, have, needed, .. },
            Some(Overlay::Prompt(prompt)),
        ) = (&event.kind, &mut model.entry.overlay)
        {
            prompt.note_answer(version, by, *decision, have >= needed);
        }
        if !matches!(event.kind, EventKind::Sequence { .. }) {
            model.asking.changes += 1;
        }
        if let EventKind::CellReleased { by, .. } = &event.kind {
            released(model, by);
        }
        tell_story(model, &event);
    }
    Vec::new()
}

/// The cell works again, whoever said so and from where: nothing may go on saying that it is stopped.
fn released(model: &mut Model, by: &str) {
    tell(model, format!("the cell works again: {} let it", Untrusted::new(by.to_owned()).line()), false);
    if let Some(picture) = &mut model.told.picture {
        // It is the last one of the stop, and the next one may be long in coming.
        Arc::make_mut(picture).stopped = false;
    }
}

/// The newest picture of how things stand. An open prompt is held against it at once.
pub(super) fn snapshot(model: &mut Model, snapshot: Arc<Snapshot>) -> Vec<Effect> {
    let critical =
        |snapshot: &Snapshot| snapshot.alarm_summary.highest_unacknowledged == Some(Priority::Critical);
    let calls = critical(&snapshot) && !model.told.snapshot.as_deref().is_some_and(critical);
    if let Some(Overlay::Prompt(prompt)) = &mut model.entry.overlay {
        prompt.look(&snapshot, model.now_ms);
    }
    if snapshot.stopped.is_some() {
        // That is the answer, whoever gives it.
        model.told.stop_asked = None;
    }
    headway(model, &snapshot);
    model.told.snapshot_ms = model.now_ms;
    model.told.snapshot = Some(snapshot);
    operating::follow(model);
    let mut effects = asking::stop_again(model);
    if calls {
        effects.push(Effect::Bell);
    }
    effects
}

/// Notes how far each stage is; of what rests or is over nothing is kept.
fn headway(model: &mut Model, now: &Snapshot) {
    let under_way = |id: &CapabilityId| {
        now.candidates.iter().any(|candidate| candidate.version == *id && candidate.progress.is_some())
    };
    model.told.headway.retain(|id, _| under_way(id));
    for candidate in &now.candidates {
        let Some(progress) = &candidate.progress else { continue };
        match model.told.headway.get_mut(&candidate.version) {
            Some(known) => known.see(progress, now.at_ms),
            None => {
                model.told.headway.insert(candidate.version.clone(), Headway::of(progress, now.at_ms));
            }
        }
    }
}

pub(super) fn answer(model: &mut Model, id: &str, reply: Reply) -> Vec<Effect> {
    overlays::answered(model, id);
    let stays_in_sight = stop_answered(model, id, &reply);
    let pending = model.asking.pending.remove(id);
    let about = pending.as_ref().map(|pending| pending.about);
    let asked = pending.map(|pending| pending.what).unwrap_or_default();
    match reply {
        _ if stays_in_sight => Vec::new(),
        Reply::Accepted { text, .. } | Reply::Stopped { text, kept: StopKept::OnRecord } => {
            tell(model, text, false);
            Vec::new()
        }
        // It is in force, and whoever asked has to know what a sudden end would make of it.
        Reply::Stopped { text, kept: StopKept::InMark | StopKept::InMemory } => {
            tell(model, text, true);
            Vec::new()
        }
        // Two consoles have the same list before them: the next one of it is as good.
        Reply::Refused { code: Refusal::Exists, text, .. }
            if asked == asking::DEMO && !overlays::is_signed(&model.told) =>
        {
            let effects = asking::submit(model, None);
            tell(model, format!("{text}, by somebody else meanwhile: the next one is submitted"), false);
            effects
        }
        Reply::Refused { code: Refusal::Exists, text, .. } if asked == asking::DEMO => {
            tell(
                model,
                format!("{text}, by somebody else meanwhile: `:demo` again takes the next one"),
                true,
            );
            Vec::new()
        }
        // Others ask as well: what nobody asked for by a key is asked again without a word.
        Reply::Refused { code: Refusal::NotNow, .. }
            if matches!(about, Some(AskedFor::Health | AskedFor::AlarmHistory)) =>
        {
            about.map(|about| model.asking.asked.remove(&about));
            Vec::new()
        }
        Reply::Refused { text, hint, .. } if about == Some(AskedFor::Question) => {
            take_question(model, id, Err(Problem::from((text, hint)).sentence()));
            Vec::new()
        }
        Reply::Question { question } => {
            take_question(model, id, Ok(question));
            Vec::new()
        }
        Reply::Refused { text, hint, .. } => {
            let asked = if asked.is_empty() { asked } else { format!("{asked}: ") };
            tell(model, format!("{asked}{}", Problem::from((text, hint)).sentence()), true);
            Vec::new()
        }
        // The engine publishes snapshots by itself; one that is asked for is as good.
        Reply::Snapshot { snapshot: told } => snapshot(model, Arc::from(told)),
        Reply::Detail { detail } => {
            model.told.detail = Some(Arc::from(detail));
            Vec::new()
        }
        Reply::Film { film } => {
            why::film(model, film);
            Vec::new()
        }
        Reply::Registry { page } => {
            model.told.registry.take(page);
            Vec::new()
        }
        Reply::Audit { page } => {
            model.told.audit = Arc::new(page);
            Vec::new()
        }
        Reply::Health { series } => {
            if about == Some(AskedFor::AlarmHistory) {
                model.told.alarm_history = Some(Arc::from(series));
            } else {
                model.told.health = Some((Arc::from(series), model.now_ms));
            }
            Vec::new()
        }
        Reply::Verified { verified } => {
            tell(model, verified.text.clone(), !verified.holds);
            model.told.verified = Some(verified);
            if model.place.view == View::Audit { asking::refresh_now(model) } else { Vec::new() }
        }
    }
}

/// The question of an open prompt, or why there is none; what was asked for another one is let go.
fn take_question(model: &mut Model, id: &str, answer: Result<Box<QuestionView>, String>) {
    if let Some(Overlay::Prompt(prompt)) = &mut model.entry.overlay {
        prompt.take(id, answer);
    }
}

/// What a stop came to. One that no engine has answered is asked for until something confirms it: tells whether that stays
/// in sight, so that nothing else has to be said.
fn stop_answered(model: &mut Model, id: &str, reply: &Reply) -> bool {
    let Some(asked) = model.told.stop_asked.as_mut().filter(|asked| asked.id == id) else { return false };
    if let Reply::Refused { code: Refusal::NoAnswer, text, hint } = reply {
        asked.why = Some(Problem::from((text.clone(), hint.clone())).sentence());
        model.notice = None;
        return true;
    }
    model.told.stop_asked = None;
    false
}
