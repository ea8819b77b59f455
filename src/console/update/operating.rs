//! What an operator does to versions and alarms: which form opens, and why not.

use super::{asking, halted, marking, overlays, refuse, seating, tell};
use crate::action::Action;
use crate::effect::{Effect, Question};
use crate::form::{Abort, Confirmed, Form, Intent, NOBODY};
use crate::line::EditLine;
use crate::model::{AskedFor, EngineLink, EngineState, Model, Overlay};
use crate::prompt::Prompt;
use crate::words::standing;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Flags, State};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::snapshot::AlarmView;
use holdpoint_text::Hint as _;

/// Hands confirmed operations to the engine, each by itself: what was marked for one loses its mark as it is asked for.
pub(super) fn carry_out(model: &mut Model, confirmed: Vec<Confirmed>) -> Vec<Effect> {
    let said: Vec<&str> = confirmed.iter().map(Confirmed::said).collect();
    tell(model, format!("{}: asked", said.join("; ")), false);
    let mut effects = Vec::new();
    for one in confirmed {
        // So many wait already: the others keep their marks.
        let Some(id) = asking::request(model, AskedFor::Operation, one.said().to_owned()) else { break };
        let passphrase = overlays::leave_form(model, &id);
        if let Some(version) = one.version() {
            model.place.marked_versions.remove(version);
        }
        effects.push(Effect::Operate { id, confirmed: Box::new(one), passphrase });
    }
    effects
}

/// Opens a form, or says at once that somebody must say who they are: not after a reason was typed.
pub(super) fn open(model: &mut Model, intent: Intent, consequences: Vec<String>) -> Vec<Effect> {
    if let Some(absence) = model.absence().filter(|_| !intent.stops()) {
        return refuse(model, &absence.problem().sentence());
    }
    if let Some(doubt) = model.told.doubt.filter(|_| !intent.needs_no_known_engine()) {
        return refuse(model, &format!("{doubt}: nothing is signed for whoever that is"));
    }
    if intent.needs_person() && model.seat.operator.is_none() {
        return refuse(model, &format!("{NOBODY}: {}", intent.title()));
    }
    let form = Form::new(intent, consequences).opened_at(model.now_ms);
    model.entry.overlay = Some(Overlay::Form(Box::new(form)));
    model.entry.typing = None;
    Vec::new()
}

/// Opens the form of an operation on the version under the cursor, or says why it is not possible.
pub(super) fn on_version(model: &mut Model, action: Action) -> Vec<Effect> {
    if action == Action::Abort {
        return match abort(model) {
            Some((what, consequences)) => open(model, Intent::Abort(what), consequences),
            None => {
                refuse(model, "nothing is under way that could be aborted; B rolls an active version back")
            }
        };
    }
    if let Some(effects) = marking::on_versions(model, action) {
        return effects;
    }
    let Some(id) = model.version_here() else {
        return refuse(model, "there is no version under the cursor");
    };
    match intent(model, action, &id) {
        Ok((intent, consequences)) => open(model, intent, consequences),
        Err(why) => refuse(model, &why),
    }
}

/// Holds the open form against how things stand: what it says follows them. What is no more possible, or would now be
/// something else, makes it void with a word: it stays open, for what is being typed must not become keys.
pub(super) fn follow(model: &mut Model) {
    let Some(Overlay::Form(form)) = &model.entry.overlay else { return };
    if form.void.is_some() || form.signing.as_ref().is_some_and(|signing| signing.asked.is_some()) {
        // It was asked for as it stood; the engine's answer closes it.
        return;
    }
    match now(model, &form.intent) {
        Ok(consequences) => {
            if let Some(Overlay::Form(form)) = &mut model.entry.overlay {
                form.follow(consequences);
            }
        }
        Err(why) => make_void(model, why),
    }
}

/// Whatever form is open is for nothing any more; what was handed over already is answered, or said to be unanswered.
pub(super) fn void_all(model: &mut Model, why: &str) {
    let Some(Overlay::Form(form)) = &mut model.entry.overlay else { return };
    let is_asked = form.signing.as_ref().is_some_and(|signing| signing.asked.is_some());
    if form.void.is_none() && !is_asked {
        form.make_void(why.to_owned(), model.now_ms);
    }
}

/// The open form is for nothing any more.
pub(super) fn make_void(model: &mut Model, why: String) {
    let now_ms = model.now_ms;
    let Some(Overlay::Form(form)) = &mut model.entry.overlay else { return };
    let text = format!("not asked: {}: {why}", form.intent.title());
    form.make_void(why, now_ms);
    tell(model, text, true);
}

/// What a form says now, or why it is not for what it was opened for any more.
pub(super) fn now(model: &Model, opened: &Intent) -> Result<Vec<String>, String> {
    let (action, id) = match opened {
        Intent::Pause(id) => (Action::Pause, id),
        Intent::Resume(id) => (Action::Resume, id),
        Intent::Reject(id) => (Action::Refuse, id),
        Intent::Demote(id) => (Action::Demote, id),
        Intent::Rollback(id) | Intent::Vacate(id) => (Action::Rollback, id),
        Intent::Restrict(id) => (Action::Restrict, id),
        Intent::Repeat(id) => (Action::Repeat, id),
        Intent::Release(id) => (Action::Release, id),
        Intent::Continue(id) => (Action::Continue, id),
        Intent::Rearm(id) => (Action::Rearm, id),
        Intent::Several(each) => return marking::lines(model, each),
        Intent::Abort(what) => return abort_lines(model, what),
        Intent::Go { since_ms, stops, .. } => return halted::still_stopped(model, (*since_ms, *stops)),
        Intent::Goal(_) => return Ok(goal_lines(model)),
        Intent::ConfirmTime(read) => return clock_lines(model, Some(*read)).map(|(_, lines)| lines),
        Intent::Note => return Ok(note_lines()),
        Intent::Profile(id, profile, close) => return Ok(profile_lines(model, id, *profile, *close)),
        Intent::Shelve(name) => return alarm_lines(alarm_now(model, name)?, Action::Shelve),
        Intent::ResetAlarm(name) => return alarm_lines(alarm_now(model, name)?, Action::ResetAlarm),
        Intent::Register(_) => return Ok(register_lines()),
        Intent::Identity(name) => return Ok(seating::lines(name)),
        Intent::Quit => return Ok(quit_lines(model)),
    };
    let (intent, lines) = intent(model, action, id)?;
    if intent == *opened {
        Ok(lines)
    } else {
        Err(format!("it would now be something else: {}", intent.title()))
    }
}

/// Opens the form that submits a candidate, where somebody signs for it.
pub(super) fn register(model: &mut Model, folder: Option<String>) -> Vec<Effect> {
    open(model, Intent::Register(folder), register_lines())
}

fn register_lines() -> Vec<String> {
    vec!["It is taken in and evaluated beside what is active; nothing of it acts before its gate".to_owned()]
}

fn alarm_now<'a>(model: &'a Model, name: &str) -> Result<&'a AlarmView, String> {
    let alarms = model.told.snapshot.as_ref().map_or(&[][..], |snapshot| &snapshot.alarms);
    alarms.iter().find(|alarm| alarm.alarm == name).ok_or_else(|| "the alarm is normal again".to_owned())
}

pub(super) fn intent(
    model: &Model,
    action: Action,
    id: &CapabilityId,
) -> Result<(Intent, Vec<String>), String> {
    let Some((state, flags)) = model.stands(id) else {
        return Err(format!("nothing is known about {id} yet"));
    };
    let now = format!("{id} is {}", standing(state, &flags));
    let wrong = |what: &str| Err(format!("{now}; {what}"));
    let is_candidate = !state.is_terminal() && state != State::Active && state != State::Superseded;
    let of = id.clone();
    let (intent, consequence) = match action {
        Action::Pause if state.may_pause(&flags) => {
            let what = if state == State::Active {
                "It keeps the arm, provisionally, and is watched; it is not confirmed before it is let go on"
            } else {
                "Its stage stops; only reject, demote and resume go through"
            };
            (Intent::Pause(of), what.to_owned())
        }
        Action::Pause => return wrong("only what is on its way, or provisional, and not held can be held"),
        Action::Resume if state.may_resume(&flags, held(model, id)) => {
            let what = if state == State::Active {
                "It is confirmed once its window is over without a trip"
            } else {
                "It goes on where it stands; nothing is approved by it"
            };
            (Intent::Resume(of), what.to_owned())
        }
        Action::Resume => return wrong("only what is held can go on"),
        Action::Refuse if is_candidate => {
            (Intent::Reject(of), "It never comes back under this version".to_owned())
        }
        Action::Refuse => return wrong("only a candidate can be rejected"),
        Action::Demote if state == State::Active && pinned(model, id).is_none() => {
            return wrong("nobody would take over; B takes the last version off");
        }
        Action::Demote if is_candidate || state == State::Active => {
            (Intent::Demote(of), leaves(model, id, state, "It is evaluated again before it may act"))
        }
        Action::Demote => return wrong("only a candidate or an active version can be sent back"),
        Action::Rollback if state == State::Active && pinned(model, id).is_none() => {
            (Intent::Vacate(of), leaves(model, id, state, "Somebody has to re-arm the family"))
        }
        Action::Rollback if state == State::Active => {
            (Intent::Rollback(of), leaves(model, id, state, "It does not come back by itself"))
        }
        Action::Rollback => return wrong("only an active version can be rolled back"),
        Action::Restrict if state == State::Active && !flags.restricted => {
            (Intent::Restrict(of), "Its speed and force are tightened until it is settled".to_owned())
        }
        Action::Restrict => return wrong("only an active version that is not restricted can be restricted"),
        Action::Repeat if !flags.paused && flags.running.is_none() && repeats(state) => {
            (Intent::Repeat(of), "Its sandbox is worked anew; gate pass and approvals are void".to_owned())
        }
        Action::Repeat => {
            return wrong("only a sandboxed, shadowed or demoted version at rest is evaluated again");
        }
        Action::Release if state == State::Active && flags.restricted => {
            let what = "It works at its full envelope; its window and its charts begin anew";
            (Intent::Release(of), what.to_owned())
        }
        Action::Release => return wrong("only a restricted version can be released"),
        Action::Continue if asks(model, id) => {
            (Intent::Continue(of), "The monitor's question is closed; its charts start anew".to_owned())
        }
        Action::Continue => return wrong("its monitor asks nothing"),
        Action::Rearm if stopped(model, id) && matches!(state, State::Superseded | State::Demoted) => {
            (Intent::Rearm(of), format!("{} acts again, under this version", id.family))
        }
        Action::Rearm => {
            return wrong("only a superseded version of a stopped family can be made active again");
        }
        _ => return Err(format!("{:?} is not about a version", action.word())),
    };
    Ok((intent, vec![now, consequence]))
}

const fn repeats(state: State) -> bool {
    matches!(state, State::Sandboxed | State::Shadowed | State::Demoted)
}

fn held(model: &Model, id: &CapabilityId) -> bool {
    model.candidate(id).is_some_and(|candidate| candidate.held)
}

/// Opens the question whether one person lets the version under the cursor in alone.
pub(super) fn break_glass(model: &mut Model) -> Vec<Effect> {
    if let Some(effects) = marking::on_versions(model, Action::BreakGlass) {
        return effects;
    }
    let Some(id) = model.version_here() else {
        return refuse(model, "there is no version under the cursor");
    };
    let prompt = model.told.snapshot.as_ref().and_then(|snapshot| {
        let question = snapshot.emergencies.iter().find(|question| question.version == id)?;
        Some(Prompt::open(question, snapshot, model.now_ms))
    });
    match prompt {
        Some(prompt) => {
            model.entry.overlay = Some(Overlay::Prompt(Box::new(prompt)));
            model.entry.typing = None;
            Vec::new()
        }
        None => refuse(model, &format!("{id} is nothing that the emergency door is for")),
    }
}

/// Opens the form that gives the agent of the live cell a goal.
pub(super) fn goal(model: &mut Model, goal: String) -> Vec<Effect> {
    let lines = goal_lines(model);
    open(model, Intent::Goal(goal), lines)
}

/// Opens the form that confirms what the machine's clock says.
pub(super) fn confirm_time(model: &mut Model) -> Vec<Effect> {
    match clock_lines(model, None) {
        Ok((said, lines)) => open(model, Intent::ConfirmTime(said), lines),
        Err(why) => refuse(model, &why),
    }
}

/// What the machine's clock says, or said when it was read, and why it is not believed; an error if it is.
fn clock_lines(model: &Model, read: Option<WallTime>) -> Result<(WallTime, Vec<String>), String> {
    let doubt = model.told.snapshot.as_ref().and_then(|snapshot| snapshot.clock_doubt.as_ref());
    let doubt = doubt.ok_or_else(|| "the machine's clock is believed".to_owned())?;
    let said = read.unwrap_or(doubt.said);
    let lines = vec![
        format!("{}; it said {} when this was opened", doubt.text, said.spoken()),
        "Hold it against another clock; approvals, freezes and reviews end by it from then on".to_owned(),
    ];
    Ok((said, lines))
}

/// Opens the form that takes a note, with what was typed of it.
pub(super) fn note(model: &mut Model, text: &str) -> Vec<Effect> {
    let effects = open(model, Intent::Note, note_lines());
    match &mut model.entry.overlay {
        Some(Overlay::Form(form)) if form.intent == Intent::Note => form.reason = EditLine::new(text),
        _ => {}
    }
    effects
}

fn note_lines() -> Vec<String> {
    vec!["It stays on record, stands in the log and is a mark in Health; it changes nothing else".to_owned()]
}

fn goal_lines(model: &Model) -> Vec<String> {
    let now = model.told.snapshot.as_ref().map_or("", |snapshot| snapshot.live.goal.as_str());
    vec![
        format!("Now it works towards {now}; from the next sequence on, towards this"),
        "A candidate of a family that the goal leaves out meets no task in shadow".to_owned(),
    ]
}

/// Opens the form that closes a profile to the version under the cursor, or opens it again.
pub(super) fn on_profile(model: &mut Model, profile: ProfileName, close: bool) -> Vec<Effect> {
    let Some(id) = model.version_here() else {
        return refuse(model, "there is no version under the cursor");
    };
    let lines = profile_lines(model, &id, profile, close);
    open(model, Intent::Profile(id, profile, close), lines)
}

fn profile_lines(model: &Model, id: &CapabilityId, profile: ProfileName, close: bool) -> Vec<String> {
    let now = model.told.snapshot.as_ref().map(|snapshot| snapshot.profile);
    let acts = model.stands(id).is_some_and(|(state, _)| state == State::Active);
    let consequence = match (close, acts && now == Some(profile)) {
        (true, true) => leaves(model, id, State::Active, "It acts under this profile, so it is taken off"),
        (true, false) => format!("Under {} the gate holds it; how it stands is not touched", profile.name()),
        (false, _) => format!("Under {} the gate looks at it again", profile.name()),
    };
    vec![consequence]
}

fn asks(model: &Model, id: &CapabilityId) -> bool {
    model
        .told
        .snapshot
        .as_ref()
        .is_some_and(|now| now.questions.iter().any(|question| question.version == *id))
}

fn stopped(model: &Model, id: &CapabilityId) -> bool {
    let families = model.told.snapshot.as_ref().map_or(&[][..], |snapshot| &snapshot.families);
    families.iter().any(|family| family.family == id.family && family.safe_stopped)
}

/// What leaving an active version means for the robot.
fn leaves(model: &Model, id: &CapabilityId, state: State, otherwise: &str) -> String {
    if state != State::Active {
        return otherwise.to_owned();
    }
    match pinned(model, id) {
        Some(back) => format!("The arm stops; {back} takes over. {otherwise}"),
        None => format!("The arm stops; {} is safe-stopped: there is no way back", id.family),
    }
}

fn pinned<'a>(model: &'a Model, id: &CapabilityId) -> Option<&'a CapabilityId> {
    let snapshot = model.told.snapshot.as_ref()?;
    snapshot.families.iter().find(|family| family.active.as_ref() == Some(id))?.pinned.as_ref()
}

/// The most urgent thing to stop: an active version in question, one that is not settled, the candidate under the
/// cursor, a candidate at work, one that waits; each with what stopping it does.
pub(super) fn abort(model: &Model) -> Option<(Abort, Vec<String>)> {
    let snapshot = model.told.snapshot.as_ref()?;
    let unsettled = |flags: &Flags| flags.provisional || flags.restricted;
    let actives: Vec<(&CapabilityId, Flags)> = snapshot
        .families
        .iter()
        .filter_map(|family| Some((family.active.as_ref()?, family.flags.unwrap_or_default())))
        .collect();
    let here = model.version_here();
    let asked = snapshot.questions.first().map(|question| &question.version);
    let open = || actives.iter().filter(|(_, flags)| unsettled(flags)).map(|(id, _)| *id);
    let active = asked
        .or_else(|| open().find(|id| Some(*id) == here.as_ref()))
        .or_else(|| open().next())
        .or_else(|| actives.iter().map(|(id, _)| *id).find(|id| Some(*id) == here.as_ref()))
        .cloned();
    let under_way = |id: &&CapabilityId| is_under_way(model, id);
    let candidates = || snapshot.candidates.iter().map(|candidate| &candidate.version).filter(under_way);
    let settled_active = active.as_ref().is_some_and(|id| !open().any(|o| o == id) && asked != Some(id));
    let candidate = here
        .as_ref()
        .filter(under_way)
        .or_else(|| candidates().find(|id| model.candidate(id).is_some_and(|c| c.progress.is_some())))
        .or_else(|| candidates().next());
    let what = match (active, candidate) {
        (Some(id), None) => Abort::Active(id),
        (Some(id), Some(_)) if !settled_active => Abort::Active(id),
        (_, Some(id)) => Abort::Candidate(id.clone()),
        (None, None) => return None,
    };
    let what = match what {
        Abort::Active(id) if pinned(model, &id).is_none() => Abort::Last(id),
        Abort::Active(_) | Abort::Last(_) | Abort::Candidate(_) => what,
    };
    let lines = abort_lines(model, &what).ok()?;
    Some((what, lines))
}

/// What an abort does as things stand now.
fn abort_lines(model: &Model, what: &Abort) -> Result<Vec<String>, String> {
    let snapshot = model.told.snapshot.as_ref().ok_or("nothing is known yet")?;
    let acts = |id: &CapabilityId| snapshot.families.iter().any(|family| family.active.as_ref() == Some(id));
    let mut lines = match what {
        Abort::Active(id) | Abort::Last(id) if !acts(id) => {
            return Err(format!("{id} is not active any more"));
        }
        Abort::Active(id) | Abort::Last(id) => {
            if matches!(what, Abort::Last(_)) == pinned(model, id).is_some() {
                return Err(format!("who takes over from {id} has changed: look again"));
            }
            vec![leaves(model, id, State::Active, "It does not come back by itself")]
        }
        Abort::Candidate(id) if !is_under_way(model, id) => {
            let stands = model.stands(id);
            let stands = stands.map_or_else(|| "gone".to_owned(), |(state, flags)| standing(state, &flags));
            return Err(format!("{id} is {stands} by now: look again"));
        }
        Abort::Candidate(id) => vec![format!("{id} is held where it stands; what is active goes on")],
    };
    let under_way = snapshot.candidates.iter().map(|candidate| &candidate.version);
    let rest = under_way.filter(|id| is_under_way(model, id));
    let rest = rest.filter(|id| !matches!(what, Abort::Candidate(of) if of == *id));
    lines.extend(rest.map(|id| format!("Not touched: {id}")).take(3));
    Ok(lines)
}

/// Whether a candidate goes on by itself.
fn is_under_way(model: &Model, id: &CapabilityId) -> bool {
    let candidate = model.candidate(id);
    candidate.is_some_and(|c| !c.state.is_terminal() && c.state != State::Active && !c.flags.paused)
}

/// Acknowledging and unshelving are undone as easily and act at once; the others open a form.
pub(super) fn on_alarm(model: &mut Model, action: Action) -> Vec<Effect> {
    use crate::model::{HISTORY_PANE, View};
    if model.place.view != View::Alarms {
        return refuse(model, "go to the alarms first (5, or ! for the highest)");
    }
    if model.place.pane() == HISTORY_PANE {
        return refuse(model, "the history changes nothing; tab leads to the open alarms");
    }
    let rows = model.alarm_rows();
    let Some(alarm) = rows.get(model.row()).map(|item| item.alarm().clone()) else {
        return refuse(model, "there is no alarm under the cursor");
    };
    let by = model.seat.operator.as_ref().map_or_else(|| "console".to_owned(), |who| who.name.clone());
    match action {
        Action::Acknowledge if !model.place.marked.is_empty() => marking::acknowledge(model, &by),
        Action::Acknowledge => {
            if let Err(why) = marking::takes(&alarm, action) {
                return refuse(model, &why);
            }
            let what = format!("acknowledge {}", alarm.alarm);
            asking::ask(model, what, Question::Acknowledge { alarm: alarm.alarm, by })
        }
        Action::Unshelve => {
            if let Err(why) = marking::takes(&alarm, action) {
                return refuse(model, &why);
            }
            let what = format!("unshelve {}", alarm.alarm);
            asking::ask(model, what, Question::Unshelve { alarm: alarm.alarm, by })
        }
        _ => match alarm_lines(&alarm, action) {
            Ok(lines) if action == Action::Shelve => open(model, Intent::Shelve(alarm.alarm), lines),
            Ok(lines) => open(model, Intent::ResetAlarm(alarm.alarm), lines),
            Err(why) => refuse(model, &why),
        },
    }
}

/// What shelving or resetting an alarm does, or why it is not possible.
pub(super) fn alarm_lines(alarm: &AlarmView, action: Action) -> Result<Vec<String>, String> {
    if action == Action::Shelve {
        if !alarm.priority.can_be_shelved() {
            return Err("a critical alarm stays in sight: it cannot be shelved".to_owned());
        }
        let what = "It comes back by itself; shelved alarms are counted on every screen".to_owned();
        return Ok(vec![alarm.text.clone(), what]);
    }
    if alarm.state_below.is_present() {
        return Err("its condition is still present: acknowledge it, and reset it when it is gone".to_owned());
    }
    if !alarm.latching {
        return Err("it does not wait for a reset".to_owned());
    }
    Ok(vec![alarm.text.clone(), "It resumes nothing; say why it is safe".to_owned()])
}

/// Leaves the view, or asks about ending the program and says what the engine will do.
pub(super) fn quit(model: &mut Model) -> Vec<Effect> {
    use crate::model::View;
    if matches!(model.told.engine, EngineState::Ended(_)) {
        return vec![Effect::End];
    }
    if model.place.view != View::Overview {
        model.place.back.clear();
        model.place.view = View::Overview;
        return Vec::new();
    }
    if !model.told.ends_with_this() {
        return vec![Effect::Leave];
    }
    let lines = quit_lines(model);
    open(model, Intent::Quit, lines)
}

/// Ends the console alone, where the engine can do without it.
pub(super) fn detach(model: &mut Model) -> Vec<Effect> {
    if model.told.link == EngineLink::Own {
        let text =
            "this engine lives in this console and ends with it; without `--in-process` it can be left";
        tell(model, text.to_owned(), true);
        return Vec::new();
    }
    if model.told.engine == EngineState::Starting {
        return refuse(model, "the engine is being started: wait a moment");
    }
    vec![Effect::Detach]
}

/// What the engine does when the program ends.
fn quit_lines(model: &Model) -> Vec<String> {
    let mut lines = vec!["The engine ends in good order; nothing is approved or activated by it".to_owned()];
    let others = model.told.others().count();
    if others > 0 {
        lines.push(format!("{others} more at this engine lose it"));
    }
    if model.told.link == EngineLink::Attached {
        lines.push("You are the last one here; `:detach` leaves it at work with nobody".to_owned());
    }
    for candidate in model.told.snapshot.iter().flat_map(|snapshot| &snapshot.candidates) {
        if let Some(progress) = &candidate.progress {
            lines.push(format!(
                "{} is in {} ({} of {}): that stage is run again at the next start",
                candidate.version,
                progress.stage.name(),
                progress.done,
                progress.budget
            ));
        } else if candidate.flags.awaiting_approval {
            lines.push(format!("{} waits for approval: people are asked anew", candidate.version));
        } else if candidate.flags.provisional {
            lines.push(format!("{} is provisional: its window begins anew", candidate.version));
        }
    }
    lines
}
