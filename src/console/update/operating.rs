//! What an operator does to versions and alarms: which form opens, and why not.

use super::{asking, refuse, tell};
use crate::action::Action;
use crate::effect::{Effect, Question};
use crate::form::{Abort, Confirmed, Form, Intent};
use crate::model::{AskedFor, EngineState, Model, Overlay};
use crate::prompt::Prompt;
use crate::words::{seconds, standing};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Flags, State};
use holdpoint_governance::profile::ProfileName;

/// Hands a confirmed operation to the engine.
pub(super) fn carry_out(model: &mut Model, confirmed: Confirmed) -> Vec<Effect> {
    let said = confirmed.said().to_owned();
    tell(model, format!("{said}: asked"), false);
    asking::request(model, AskedFor::Operation, said)
        .map(|id| Effect::Operate { id, confirmed: Box::new(confirmed) })
        .into_iter()
        .collect()
}

fn open(model: &mut Model, intent: Intent, consequences: Vec<String>) -> Vec<Effect> {
    model.entry.overlay = Some(Overlay::Form(Box::new(Form::new(intent, consequences))));
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
    let Some(id) = model.version_here() else {
        return refuse(model, "there is no version under the cursor");
    };
    match intent(model, action, &id) {
        Ok((intent, consequences)) => open(model, intent, consequences),
        Err(why) => refuse(model, &why),
    }
}

/// Opens the form that lets a stopped cell work again.
pub(super) fn go(model: &mut Model) -> Vec<Effect> {
    let Some(stopped) = model.told.snapshot.as_ref().and_then(|snapshot| snapshot.stopped.clone()) else {
        return refuse(model, "the cell is not stopped");
    };
    let by = if stopped.by.is_empty() { "somebody".to_owned() } else { stopped.by };
    let why = if stopped.reason.is_empty() { String::new() } else { format!(": {}", stopped.reason) };
    let lines = vec![
        format!("Stopped by {by}, {}, since {}{why}", stopped.caller, seconds(stopped.since_ms)),
        "The arm moves again at once; make sure that nobody is in the cell".to_owned(),
    ];
    open(model, Intent::Go, lines)
}

/// Where a version stands, from whatever knows it.
fn stands(model: &Model, id: &CapabilityId) -> Option<(State, Flags)> {
    if let Some(candidate) = model.candidate(id) {
        return Some((candidate.state, candidate.flags));
    }
    let snapshot = model.told.snapshot.as_ref()?;
    let family = snapshot.families.iter().find(|family| family.family == id.family)?;
    if family.active.as_ref() == Some(id) {
        return Some((State::Active, family.flags.unwrap_or_default()));
    }
    let row = model.told.registry.page.rows.iter().find(|row| row.version == *id)?;
    Some((row.state, row.flags))
}

fn intent(model: &Model, action: Action, id: &CapabilityId) -> Result<(Intent, Vec<String>), String> {
    let Some((state, flags)) = stands(model, id) else {
        return Err(format!("nothing is known about {id} yet"));
    };
    let now = format!("{id} is {}", standing(state, &flags));
    let wrong = |what: &str| Err(format!("{now}; {what}"));
    let is_candidate = !state.is_terminal() && state != State::Active && state != State::Superseded;
    let of = id.clone();
    let (intent, consequence) = match action {
        Action::Pause if is_candidate && !flags.paused => {
            (Intent::Pause(of), "Its stage stops; only reject, demote and resume go through".to_owned())
        }
        Action::Pause => return wrong("only a candidate that is not held can be held"),
        Action::Resume if is_candidate && (flags.paused || held(model, id)) => {
            (Intent::Resume(of), "It goes on where it stands; nothing is approved by it".to_owned())
        }
        Action::Resume => return wrong("only a candidate that is held can go on"),
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
    let Some(id) = model.version_here() else {
        return refuse(model, "there is no version under the cursor");
    };
    let prompt = model.told.snapshot.as_ref().and_then(|snapshot| {
        let question = snapshot.emergencies.iter().find(|question| question.version == id)?;
        Prompt::open(question, snapshot, model.now_ms)
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
    let now = model.told.snapshot.as_ref().map_or("", |snapshot| snapshot.live.goal.as_str());
    let lines = vec![
        format!("Now it works towards {now}; from the next sequence on, towards this"),
        "A candidate of a family that the goal leaves out meets no task in shadow".to_owned(),
    ];
    open(model, Intent::Goal(goal), lines)
}

/// Opens the form that closes a profile to the version under the cursor, or opens it again.
pub(super) fn on_profile(model: &mut Model, profile: ProfileName, close: bool) -> Vec<Effect> {
    let Some(id) = model.version_here() else {
        return refuse(model, "there is no version under the cursor");
    };
    let now = model.told.snapshot.as_ref().map(|snapshot| snapshot.profile);
    let acts = stands(model, &id).is_some_and(|(state, _)| state == State::Active);
    let consequence = match (close, acts && now == Some(profile)) {
        (true, true) => leaves(model, &id, State::Active, "It acts under this profile, so it is taken off"),
        (true, false) => format!("Under {} the gate holds it; how it stands is not touched", profile.name()),
        (false, _) => format!("Under {} the gate looks at it again", profile.name()),
    };
    open(model, Intent::Profile(id, profile, close), vec![consequence])
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
fn abort(model: &Model) -> Option<(Abort, Vec<String>)> {
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
    let under_way = |id: &&CapabilityId| {
        let candidate = model.candidate(id);
        candidate.is_some_and(|c| !c.state.is_terminal() && c.state != State::Active && !c.flags.paused)
    };
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
    let mut lines = match &what {
        Abort::Active(id) | Abort::Last(id) => {
            vec![leaves(model, id, State::Active, "It does not come back by itself")]
        }
        Abort::Candidate(id) => vec![format!("{id} is held where it stands; what is active goes on")],
    };
    let rest = candidates().filter(|id| !matches!(&what, Abort::Candidate(of) if of == *id));
    lines.extend(rest.map(|id| format!("Not touched: {id}")).take(3));
    Some((what, lines))
}

/// Acknowledging and unshelving are undone as easily and act at once; the others open a form.
pub(super) fn on_alarm(model: &mut Model, action: Action) -> Vec<Effect> {
    use crate::model::View;
    if model.place.view != View::Alarms {
        return refuse(model, "go to the alarms first (5, or ! for the highest)");
    }
    let rows = model.alarm_rows();
    let Some(alarm) = rows.get(model.row()).map(|item| item.alarm().clone()) else {
        return refuse(model, "there is no alarm under the cursor");
    };
    let by = model.seat.operator.as_ref().map_or_else(|| "console".to_owned(), |who| who.name.clone());
    match action {
        Action::Acknowledge => {
            if alarm.acknowledged_by.is_some() {
                return refuse(model, "somebody has acknowledged it already");
            }
            let what = format!("acknowledge {}", alarm.alarm);
            asking::ask(model, what, Question::Acknowledge { alarm: alarm.alarm, by })
        }
        Action::Unshelve => {
            if alarm.shelf.is_none() {
                return refuse(model, "it is not shelved");
            }
            let what = format!("unshelve {}", alarm.alarm);
            asking::ask(model, what, Question::Unshelve { alarm: alarm.alarm, by })
        }
        Action::Shelve => {
            if !alarm.priority.can_be_shelved() {
                return refuse(model, "a critical alarm stays in sight: it cannot be shelved");
            }
            let lines = vec![
                alarm.text.clone(),
                "It comes back by itself; shelved alarms are counted on every screen".to_owned(),
            ];
            open(model, Intent::Shelve(alarm.alarm), lines)
        }
        _ => {
            if alarm.state_below.is_present() {
                return refuse(
                    model,
                    "its condition is still present: acknowledge it, and reset it when it is gone",
                );
            }
            if !alarm.latching {
                return refuse(model, "it does not wait for a reset");
            }
            let lines = vec![alarm.text.clone(), "It resumes nothing; say why it is safe".to_owned()];
            open(model, Intent::ResetAlarm(alarm.alarm), lines)
        }
    }
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
    let mut lines = vec!["The engine ends in good order; nothing is approved or activated by it".to_owned()];
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
    open(model, Intent::Quit, lines)
}
