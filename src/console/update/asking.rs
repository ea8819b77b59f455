//! What the console asks the engine for, and when: on entering a view, and again when something changed.

use super::{health, operating, overlays, tell};
use crate::audit::AuditGroup;
use crate::effect::{Effect, Question};
use crate::model::{AskedFor, EngineState, HISTORY_PANE, Model, Overlay, PendingRequest, StopAsked, View};
use holdpoint_governance::record::VersionGroup;
use holdpoint_text::Hint as _;

/// Requests without an answer at once; far below the engine's own limit.
const PENDING_MAX: usize = 32;

/// A stop that came to nothing is asked for again no sooner, ms.
const STOP_AGAIN_MS: u64 = 1_000;

/// What a demonstration is called that was asked for.
pub(super) const DEMO: &str = "submit the next demonstration candidate";

/// A new request's id; absent if too many wait already.
pub(super) fn request(model: &mut Model, about: AskedFor, what: String) -> Option<String> {
    // What a person has confirmed may be a stop: whoever hands it over knows where to.
    let confirmed = matches!(about, AskedFor::Operation | AskedFor::Decision);
    if let Some(absence) = model.absence().filter(|_| !confirmed) {
        tell(model, absence.problem().sentence(), true);
        return None;
    }
    if model.asking.pending.len() >= PENDING_MAX {
        tell(model, format!("{PENDING_MAX} requests wait for the engine already"), true);
        return None;
    }
    Some(noted(model, about, what))
}

fn noted(model: &mut Model, about: AskedFor, what: String) -> String {
    let id = format!("console-{}", model.asking.next_request);
    model.asking.next_request += 1;
    model.asking.pending.insert(id.clone(), PendingRequest { about, what });
    id
}

/// Stops the cell: asked however many requests wait, and with nothing in between.
pub(super) fn stop(model: &mut Model) -> Vec<Effect> {
    // Who has said no name is nobody: the record names user and process beside it.
    let by = model.seat.operator.as_ref().map_or_else(String::new, |who| who.name.clone());
    let text = match model.absence() {
        None => "STOP: the stop is asked for",
        Some(_) => "STOP: the engine that is at work is being asked",
    };
    tell(model, text, true);
    ask_stop(model, by)
}

fn ask_stop(model: &mut Model, by: String) -> Vec<Effect> {
    let question = Question::Stop { by: by.clone() };
    let id = noted(model, question.about(), "stop the cell".to_owned());
    let now_ms = model.now_ms;
    let since_ms = model.told.stop_asked.as_ref().map_or(now_ms, |asked| asked.since_ms);
    model.told.stop_asked = Some(StopAsked { id: id.clone(), by, asked_ms: now_ms, since_ms, why: None });
    vec![Effect::Ask { id, question }]
}

/// An engine is heard whose cell works: a stop that came to nothing, and that nobody has taken back, is asked for again.
pub(super) fn stop_again(model: &mut Model) -> Vec<Effect> {
    if model.told.engine != EngineState::Running {
        return Vec::new();
    }
    let now_ms = model.now_ms;
    // One that fails at once is not asked for with every picture.
    let is_due =
        |asked: &&StopAsked| asked.why.is_some() && now_ms.saturating_sub(asked.asked_ms) >= STOP_AGAIN_MS;
    let Some(by) = model.told.stop_asked.as_ref().filter(is_due).map(|asked| asked.by.clone()) else {
        return Vec::new();
    };
    tell(model, "STOP: the engine answers again; your stop came to nothing and is asked for again", true);
    ask_stop(model, by)
}

/// Asks for the question of an open prompt as who sits here gets it.
pub(super) fn question(model: &mut Model) -> Vec<Effect> {
    let Some(who) = model.seat.operator.as_ref().map(|who| who.name.clone()) else { return Vec::new() };
    let Some(Overlay::Prompt(prompt)) = &model.entry.overlay else { return Vec::new() };
    let waits = |id: &str| model.asking.pending.contains_key(id);
    if model.absence().is_some() || model.settings.read_only || !prompt.wants_question(&who, waits) {
        return Vec::new();
    }
    let (version, purpose) = (prompt.seen.version.clone(), prompt.seen.purpose);
    let question = Question::Asked { version, purpose, who: who.clone() };
    let Some(id) = request(model, question.about(), String::new()) else { return Vec::new() };
    if let Some(Overlay::Prompt(prompt)) = &mut model.entry.overlay {
        prompt.asked(who, id.clone());
    }
    vec![Effect::Ask { id, question }]
}

/// Asks something that decides nothing.
pub(super) fn ask(model: &mut Model, what: String, question: Question) -> Vec<Effect> {
    request(model, question.about(), what).map(|id| Effect::Ask { id, question }).into_iter().collect()
}

/// Asks for what the view shows, whether or not something changed.
pub(super) fn refresh_now(model: &mut Model) -> Vec<Effect> {
    if model.told.engine != EngineState::Running {
        return Vec::new();
    }
    let Some(question) = wanted(model) else { return Vec::new() };
    model.asking.asked.insert(question.about(), model.asking.changes);
    ask(model, String::new(), question)
}

/// Asks again if something changed since, one question of a kind at a time.
pub(super) fn refresh(model: &mut Model) -> Vec<Effect> {
    let Some(about) = wanted(model).as_ref().map(Question::about) else { return Vec::new() };
    let unchanged = model.asking.asked.get(&about) == Some(&model.asking.changes);
    let fresh = if about == AskedFor::Health { health::is_fresh(model, unchanged) } else { unchanged };
    let waits = model.asking.pending.values().any(|pending| pending.about == about);
    if fresh || waits { Vec::new() } else { refresh_now(model) }
}

fn wanted(model: &Model) -> Option<Question> {
    match model.place.view {
        View::Health => Some(Question::Health(health::asked(model))),
        View::Alarms if model.place.pane() == HISTORY_PANE => Some(Question::AlarmHistory(health::HISTORY)),
        View::Overview | View::Alarms | View::Approvals => None,
        View::Registry => Some(Question::Registry { group: group(model), text: String::new() }),
        View::Candidate | View::Shadow => Some(Question::Detail(model.subject()?)),
        View::Audit => Some(Question::Audit(AuditGroup::of_pane(model.place.pane_of(View::Audit)))),
    }
}

fn group(model: &Model) -> VersionGroup {
    match model.place.pane_of(View::Registry) {
        1 => VersionGroup::Active,
        2 => VersionGroup::Candidate,
        3 => VersionGroup::History,
        _ => VersionGroup::All,
    }
}

/// Asks for a check of the whole chain.
pub(super) fn verify(model: &mut Model) -> Vec<Effect> {
    tell(model, "checking the audit chain", false);
    ask(model, "check the audit chain".to_owned(), Question::Verify)
}

/// Submits a candidate: a folder, or the next demonstration candidate. Where somebody signs for it, it is confirmed
/// first.
pub(super) fn register(model: &mut Model, folder: Option<String>) -> Vec<Effect> {
    if overlays::is_signed(&model.told) {
        return operating::register(model, folder);
    }
    submit(model, folder)
}

/// Hands a candidate over, with what was typed to sign for it.
pub(super) fn submit(model: &mut Model, folder: Option<String>) -> Vec<Effect> {
    let what = folder.as_deref().map_or_else(|| DEMO.to_owned(), |folder| format!("submit {folder:?}"));
    let Some(id) = request(model, AskedFor::Registration, what) else { return Vec::new() };
    let passphrase = overlays::leave_form(model, &id);
    vec![Effect::Register { id, folder, passphrase }]
}
