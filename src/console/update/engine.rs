//! What the engine tells and answers.

use std::sync::Arc;

use super::{asking, operating, overlays, tell};
use crate::effect::{Effect, Question};
use crate::model::{AskedFor, EngineState, LOG_MAX, Model, Overlay, StoryLine, View};
use holdpoint_governance::alarms::Priority;
use holdpoint_governance::record::VersionGroup;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::event::{Event, EventKind};
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

pub(super) fn events(model: &mut Model, events: Vec<Event>) -> Vec<Effect> {
    for event in events {
        // Progress is in the snapshot, and there is much of it.
        if matches!(event.kind, EventKind::Progress { .. }) {
            continue;
        }
        if let EventKind::CellStopped { by, .. } = &event.kind {
            operating::stopped_again(model, by, event.at_ms);
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
        let text = words::sentence(&event, words::LINE_WIDTH_MAX).into_string();
        if let EventKind::CellReleased { by, .. } = &event.kind {
            released(model, by);
        }
        let sequences = u32::from(matches!(event.kind, EventKind::Sequence { .. }));
        let line = StoryLine { seq: event.seq, at_ms: event.at_ms, text, sequences };
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
        prompt.look(&snapshot);
    }
    model.told.snapshot_ms = model.now_ms;
    model.told.snapshot = Some(snapshot);
    operating::follow(model);
    if calls { vec![Effect::Bell] } else { Vec::new() }
}

pub(super) fn answer(model: &mut Model, id: &str, reply: Reply) -> Vec<Effect> {
    overlays::answered(model, id);
    let pending = model.asking.pending.remove(id);
    let about = pending.as_ref().map(|pending| pending.about);
    let asked = pending.map(|pending| pending.what).unwrap_or_default();
    match reply {
        Reply::Accepted { text, .. } => {
            tell(model, text, false);
            Vec::new()
        }
        // Others ask as well: what nobody asked for by a key is asked again without a word.
        Reply::Refused { code: Refusal::NotNow, .. }
            if matches!(about, Some(AskedFor::Health | AskedFor::AlarmHistory)) =>
        {
            about.map(|about| model.asking.asked.remove(&about));
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
        Reply::Registry { page } => {
            model.told.registry.page = Arc::new(page);
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
