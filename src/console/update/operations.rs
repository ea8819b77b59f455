//! Operations on versions and alarms: the form to open, or why it is refused.

use super::{cell_restart, engine_requests, identity_offer, overlays, refuse, selection, show_message, undo};
use crate::action::Action;
use crate::approval_screen::ApprovalScreen;
use crate::effect::{Effect, EngineQuery};
use crate::form::{Abort, ConfirmedOperation, Form, Intent};
use crate::formatters::state_label;
use crate::line::EditLine;
use crate::model::{ConsoleModel, EngineLink, EngineState, Overlay, RequestSubject};
use crate::rows::CandidateRank;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{State, VersionFlags};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::Command;
use holdpoint_protocol::snapshot::{AlarmView, CandidateView};
use holdpoint_text::Hint as _;
use holdpoint_wording::console::operations as wording;
use holdpoint_wording::console::shared;

/// Sends confirmed operations one by one: an item loses its mark when its operation is sent.
pub(super) fn carry_out(model: &mut ConsoleModel, confirmed: Vec<ConfirmedOperation>) -> Vec<Effect> {
    let descriptions: Vec<&str> = confirmed.iter().map(ConfirmedOperation::description).collect();
    show_message(model, format!("{}: asked", descriptions.join("; ")), false);
    let mut effects = Vec::new();
    for one in confirmed {
        // Too many requests wait: the other items keep their marks.
        let Some(id) =
            engine_requests::request(model, RequestSubject::Operation, one.description().to_owned())
        else {
            break;
        };
        let change = undo::change(model, one.command());
        engine_requests::note_undo(model, &id, change);
        let passphrase = overlays::leave_form(model, &id);
        if let Command::Reject(operation) | Command::Pause(operation) = one.command() {
            model.view_state.marked_versions.remove(&operation.version);
        }
        effects.push(Effect::Operate { id, confirmed: Box::new(one), passphrase });
    }
    effects
}

/// Opens a form, or reports a missing operator before a reason is typed.
pub(super) fn open(model: &mut ConsoleModel, intent: Intent, consequences: Vec<String>) -> Vec<Effect> {
    if let Some(absence) = model.absence().filter(|_| !intent.stops()) {
        return refuse(model, &absence.problem().sentence());
    }
    if let Some(unverified) = model.engine_data.unverified.filter(|_| !intent.allows_unverified_engine()) {
        return refuse(model, &wording::nothing_is_signed(unverified));
    }
    if intent.needs_person() && model.session.operator.is_none() {
        return refuse(model, &shared::who_first(&intent.title()));
    }
    let form = Form::new(intent, consequences).opened_at(model.now_ms);
    model.input.overlay = Some(Overlay::Form(Box::new(form)));
    model.input.typing = None;
    Vec::new()
}

/// Opens the form of an operation on the version under the cursor, or says why it is not possible.
pub(super) fn on_version(model: &mut ConsoleModel, action: Action) -> Vec<Effect> {
    if action == Action::Abort {
        return match abort(model) {
            Some((what, consequences)) => open(model, Intent::Abort(what), consequences),
            None => refuse(model, wording::NOTHING_TO_ABORT),
        };
    }
    if let Some(effects) = selection::on_versions(model, action) {
        return effects;
    }
    let Some(id) = model.version_here() else {
        return refuse(model, shared::NO_VERSION_HERE);
    };
    match intent(model, action, &id) {
        Ok((intent, consequences)) => open(model, intent, consequences),
        Err(why) => refuse(model, &why),
    }
}

/// Updates the open form to the current state. If its operation became impossible or different, the form becomes void
/// with a reason. It stays open, so that typed text does not become keys.
pub(super) fn follow(model: &mut ConsoleModel) {
    let Some(Overlay::Form(form)) = &model.input.overlay else { return };
    if form.void.is_some() || form.signing.as_ref().is_some_and(|signing| signing.request_id.is_some()) {
        // The operation was sent; the engine's answer closes the form.
        return;
    }
    match now(model, &form.intent) {
        Ok(consequences) => {
            if let Some(Overlay::Form(form)) = &mut model.input.overlay {
                form.follow(consequences);
            }
        }
        Err(why) => dismiss_form(model, why),
    }
}

/// Makes any open form void; a request already sent still gets its answer, or a notice that it got none.
pub(super) fn dismiss_all_forms(model: &mut ConsoleModel, why: &str) {
    let Some(Overlay::Form(form)) = &mut model.input.overlay else { return };
    let is_sent = form.signing.as_ref().is_some_and(|signing| signing.request_id.is_some());
    if form.void.is_none() && !is_sent {
        form.dismiss(why.to_owned(), model.now_ms);
    }
}

/// Makes the open form void.
pub(super) fn dismiss_form(model: &mut ConsoleModel, why: String) {
    let now_ms = model.now_ms;
    let Some(Overlay::Form(form)) = &mut model.input.overlay else { return };
    let text = wording::not_asked(&form.intent.title(), &why);
    form.dismiss(why, now_ms);
    show_message(model, text, true);
}

/// The current consequences of a form, or why it is void.
pub(super) fn now(model: &ConsoleModel, opened: &Intent) -> Result<Vec<String>, String> {
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
        Intent::Anchor(id) => (Action::Anchor, id),
        Intent::Several(each) => return selection::lines(model, each),
        Intent::Abort(what) => return abort_lines(model, what),
        Intent::Go { since_ms, stops, .. } => return cell_restart::still_stopped(model, (*since_ms, *stops)),
        Intent::Goal(_) => return Ok(goal_lines(model)),
        Intent::ConfirmTime(read) => return clock_lines(model, Some(*read)).map(|(_, lines)| lines),
        Intent::Note => return Ok(note_lines()),
        Intent::Profile(id, profile, close) => return Ok(profile_lines(model, id, *profile, *close)),
        Intent::Shelve(name) => return alarm_lines(alarm_now(model, name)?, Action::Shelve),
        Intent::ResetAlarm(name) => return alarm_lines(alarm_now(model, name)?, Action::ResetAlarm),
        Intent::Register(_) => return Ok(register_lines()),
        Intent::Identity(name) => return Ok(identity_offer::lines(name)),
        Intent::Quit => return Ok(quit_lines(model)),
    };
    let (intent, lines) = intent(model, action, id)?;
    if intent == *opened { Ok(lines) } else { Err(wording::would_be_something_else(&intent.title())) }
}

/// Opens the form that submits a candidate, where a signature is needed.
pub(super) fn register(model: &mut ConsoleModel, folder: Option<String>) -> Vec<Effect> {
    open(model, Intent::Register(folder), register_lines())
}

fn register_lines() -> Vec<String> {
    vec![wording::REGISTERED_AND_EVALUATED.to_owned()]
}

pub(super) fn alarm_now<'a>(model: &'a ConsoleModel, name: &str) -> Result<&'a AlarmView, String> {
    let alarms = model.engine_data.snapshot.as_ref().map_or(&[][..], |snapshot| &snapshot.alarms);
    alarms.iter().find(|alarm| alarm.alarm == name).ok_or_else(|| wording::ALARM_NORMAL_AGAIN.to_owned())
}

pub(super) fn intent(
    model: &ConsoleModel,
    action: Action,
    id: &CapabilityId,
) -> Result<(Intent, Vec<String>), String> {
    let Some((state, flags)) = model.version_state(id) else {
        return Err(wording::nothing_known_about(id));
    };
    let now = format!("{id} is {}", state_label(state, &flags));
    let wrong = |what: &str| Err(format!("{now}; {what}"));
    let is_candidate = !state.is_terminal() && state != State::Active && state != State::Superseded;
    let of = id.clone();
    let (intent, consequence) = match action {
        Action::Pause if state.may_pause(&flags) => {
            let what = if state == State::Active {
                wording::PAUSED_ACTIVE_KEEPS_THE_ARM
            } else if flags.awaiting_approval {
                wording::PAUSED_REQUEST_ENDS
            } else {
                wording::PAUSED_STAGE_STOPS
            };
            (Intent::Pause(of), what.to_owned())
        }
        Action::Pause if flags.paused => {
            let key = model.keymap.key(Action::Resume);
            return wrong(&wording::is_paused_already(&key));
        }
        Action::Pause => {
            return wrong(wording::ONLY_UNPAUSED_CAN_BE_PAUSED);
        }
        Action::Resume if state.may_resume(&flags, is_held(model, id)) => {
            let what = if state == State::Active {
                wording::RESUMED_ACTIVE_IS_CONFIRMED
            } else {
                wording::RESUMED_CONTINUES
            };
            (Intent::Resume(of), what.to_owned())
        }
        Action::Resume => return wrong(wording::ONLY_PAUSED_OR_HELD_CAN_BE_RESUMED),
        Action::Refuse if is_candidate => (Intent::Reject(of), wording::NEVER_COMES_BACK.to_owned()),
        Action::Refuse => return wrong(wording::ONLY_A_CANDIDATE_CAN_BE_REJECTED),
        Action::Demote if state == State::Active && rollback_target(model, id).is_none() => {
            return wrong(wording::NO_VERSION_WOULD_TAKE_OVER);
        }
        Action::Demote if is_candidate || state == State::Active => {
            (Intent::Demote(of), leaves(model, id, state, wording::EVALUATED_BEFORE_IT_MAY_ACT))
        }
        Action::Demote => return wrong(wording::ONLY_A_CANDIDATE_OR_ACTIVE_CAN_BE_RETURNED),
        Action::Rollback if state == State::Active && rollback_target(model, id).is_none() => {
            (Intent::Vacate(of), leaves(model, id, state, wording::FAMILY_MUST_BE_REACTIVATED))
        }
        Action::Rollback if state == State::Active => {
            (Intent::Rollback(of), leaves(model, id, state, wording::NEVER_COMES_BACK))
        }
        Action::Rollback => return wrong(wording::ONLY_AN_ACTIVE_VERSION_CAN_BE_ROLLED_BACK),
        Action::Restrict if state == State::Active && !flags.restricted => {
            (Intent::Restrict(of), wording::RESTRICTED_UNTIL_SETTLED.to_owned())
        }
        Action::Restrict => return wrong(wording::ONLY_AN_UNRESTRICTED_ACTIVE_VERSION_CAN_BE_RESTRICTED),
        Action::Repeat if !flags.paused && flags.running.is_none() && repeats(state) => {
            (Intent::Repeat(of), wording::SANDBOX_RUNS_AGAIN.to_owned())
        }
        Action::Repeat => {
            return wrong(wording::ONLY_A_VERSION_AT_REST_IS_EVALUATED_AGAIN);
        }
        Action::Release if state == State::Active && flags.restricted => {
            let what = wording::FULL_ENVELOPE_AGAIN;
            (Intent::Release(of), what.to_owned())
        }
        Action::Release => return wrong(wording::ONLY_A_RESTRICTED_VERSION_CAN_BE_RELEASED),
        Action::Continue if has_open_request(model, id) => {
            (Intent::Continue(of), wording::MONITOR_QUESTION_CLOSED.to_owned())
        }
        Action::Continue => return wrong(wording::MONITOR_ASKS_NOTHING),
        Action::Rearm if stopped(model, id) && matches!(state, State::Superseded | State::Demoted) => {
            (Intent::Rearm(of), wording::family_acts_again(&id.family))
        }
        Action::Rearm => {
            return wrong(wording::ONLY_A_SUPERSEDED_VERSION_CAN_BE_REACTIVATED);
        }
        Action::Anchor if matches!(state, State::Active | State::Superseded) => {
            (Intent::Anchor(of), wording::COMPARED_WITH_THE_ANCHOR.to_owned())
        }
        Action::Anchor => return wrong(wording::ONLY_A_VERSION_IN_CONTROL_CAN_BE_THE_ANCHOR),
        _ => return Err(wording::is_not_about_a_version(action.name())),
    };
    Ok((intent, vec![now, consequence]))
}

const fn repeats(state: State) -> bool {
    matches!(state, State::Sandboxed | State::Shadowed | State::Demoted)
}

fn is_held(model: &ConsoleModel, id: &CapabilityId) -> bool {
    model.candidate(id).is_some_and(|candidate| candidate.held)
}

/// Opens the request for a break-glass activation of the version under the cursor.
pub(super) fn break_glass(model: &mut ConsoleModel) -> Vec<Effect> {
    if let Some(effects) = selection::on_versions(model, Action::BreakGlass) {
        return effects;
    }
    let Some(id) = model.version_here() else {
        return refuse(model, shared::NO_VERSION_HERE);
    };
    let prompt = model.engine_data.snapshot.as_ref().and_then(|snapshot| {
        let question = snapshot.emergencies.iter().find(|question| question.version == id)?;
        Some(ApprovalScreen::open(question, snapshot, model.now_ms))
    });
    match prompt {
        Some(prompt) => {
            model.input.overlay = Some(Overlay::Approval(Box::new(prompt)));
            model.input.typing = None;
            Vec::new()
        }
        None => refuse(model, &wording::no_break_glass_for(&id)),
    }
}

/// Opens the form that gives the agent of the live cell a goal.
pub(super) fn goal(model: &mut ConsoleModel, goal: String) -> Vec<Effect> {
    let lines = goal_lines(model);
    open(model, Intent::Goal(goal), lines)
}

/// Opens the form that confirms what the machine's clock says.
pub(super) fn confirm_time(model: &mut ConsoleModel) -> Vec<Effect> {
    match clock_lines(model, None) {
        Ok((time, lines)) => open(model, Intent::ConfirmTime(time), lines),
        Err(why) => refuse(model, &why),
    }
}

/// The time of the machine's clock, now or as it was read, and why it is not trusted; an error if it is.
fn clock_lines(model: &ConsoleModel, read: Option<WallTime>) -> Result<(WallTime, Vec<String>), String> {
    let mismatch = model.engine_data.snapshot.as_ref().and_then(|snapshot| snapshot.clock_doubt.as_ref());
    let mismatch = mismatch.ok_or_else(|| wording::CLOCK_IS_TRUSTED.to_owned())?;
    let time = read.unwrap_or(mismatch.said);
    let lines = vec![
        wording::clock_when_opened(&mismatch.text, &time.label()),
        wording::COMPARE_THE_CLOCK.to_owned(),
    ];
    Ok((time, lines))
}

/// Opens the form for a note, with the text typed so far.
pub(super) fn note(model: &mut ConsoleModel, text: &str) -> Vec<Effect> {
    let effects = open(model, Intent::Note, note_lines());
    match &mut model.input.overlay {
        Some(Overlay::Form(form)) if form.intent == Intent::Note => form.reason = EditLine::new(text),
        _ => {}
    }
    effects
}

fn note_lines() -> Vec<String> {
    vec![wording::NOTE_GOES_ON_RECORD.to_owned()]
}

fn goal_lines(model: &ConsoleModel) -> Vec<String> {
    let now = model.engine_data.snapshot.as_ref().map_or("", |snapshot| snapshot.live.goal.as_str());
    vec![wording::goal_applies_next(now), wording::GOAL_LEAVES_FAMILIES_OUT.to_owned()]
}

/// Opens the form that blocks the version under the cursor for a profile, or unblocks it.
pub(super) fn on_profile(model: &mut ConsoleModel, profile: ProfileName, close: bool) -> Vec<Effect> {
    let Some(id) = model.version_here() else {
        return refuse(model, shared::NO_VERSION_HERE);
    };
    let lines = profile_lines(model, &id, profile, close);
    open(model, Intent::Profile(id, profile, close), lines)
}

fn profile_lines(model: &ConsoleModel, id: &CapabilityId, profile: ProfileName, close: bool) -> Vec<String> {
    let now = model.engine_data.snapshot.as_ref().map(|snapshot| snapshot.profile);
    let acts = model.version_state(id).is_some_and(|(state, _)| state == State::Active);
    let consequence = match (close, acts && now == Some(profile)) {
        (true, true) => leaves(model, id, State::Active, wording::DEMOTED_UNDER_THIS_PROFILE),
        (true, false) => wording::not_activated_under(profile),
        (false, _) => wording::gate_looks_again_under(profile),
    };
    vec![consequence]
}

fn has_open_request(model: &ConsoleModel, id: &CapabilityId) -> bool {
    model
        .engine_data
        .snapshot
        .as_ref()
        .is_some_and(|now| now.questions.iter().any(|question| question.version == *id))
}

fn stopped(model: &ConsoleModel, id: &CapabilityId) -> bool {
    let families = model.engine_data.snapshot.as_ref().map_or(&[][..], |snapshot| &snapshot.families);
    families.iter().any(|family| family.family == id.family && family.safe_stopped)
}

/// The consequences for the robot when an active version loses control.
fn leaves(model: &ConsoleModel, id: &CapabilityId, state: State, otherwise: &str) -> String {
    if state != State::Active {
        return otherwise.to_owned();
    }
    match rollback_target(model, id) {
        Some(back) => wording::arm_stops_and_other_takes_over(back, otherwise),
        None => wording::arm_stops_and_family_is_safe_stopped(&id.family),
    }
}

fn rollback_target<'a>(model: &'a ConsoleModel, id: &CapabilityId) -> Option<&'a CapabilityId> {
    let snapshot = model.engine_data.snapshot.as_ref()?;
    snapshot.families.iter().find(|family| family.active.as_ref() == Some(id))?.pinned.as_ref()
}

/// The most urgent target of an abort, with its consequences: an active version in question, an unsettled one, the
/// candidate under the cursor that is not queued, a running candidate, a waiting one.
pub(super) fn abort(model: &ConsoleModel) -> Option<(Abort, Vec<String>)> {
    let snapshot = model.engine_data.snapshot.as_ref()?;
    let actives: Vec<(&CapabilityId, VersionFlags)> = snapshot
        .families
        .iter()
        .filter_map(|family| Some((family.active.as_ref()?, family.flags.unwrap_or_default())))
        .collect();
    let here = model.version_here();
    let escalation = snapshot.questions.first().map(|question| &question.version);
    let open = || actives.iter().filter(|(_, flags)| is_unsettled(*flags)).map(|(id, _)| *id);
    let active = escalation
        .or_else(|| open().find(|id| Some(*id) == here.as_ref()))
        .or_else(|| open().next())
        .or_else(|| actives.iter().map(|(id, _)| *id).find(|id| Some(*id) == here.as_ref()))
        .cloned();
    let under_way = |id: &&CapabilityId| is_under_way(model, id);
    let candidates = || snapshot.candidates.iter().map(|candidate| &candidate.version).filter(under_way);
    let settled_active = active.as_ref().is_some_and(|id| !open().any(|o| o == id) && escalation != Some(id));
    let is_queued = |id: &CapabilityId| {
        model.candidate(id).is_some_and(|c| CandidateRank::of(c) == CandidateRank::Queued)
    };
    // On a queued candidate, too, it means the one that runs: a pause is for the queue.
    let candidate = here
        .as_ref()
        .filter(|id| under_way(id) && !is_queued(id))
        .or_else(|| candidates().find(|id| model.candidate(id).is_some_and(|c| c.progress.is_some())))
        .or_else(|| candidates().find(|id| !is_queued(id)))
        .or_else(|| here.as_ref().filter(under_way))
        .or_else(|| candidates().next());
    let what = match (active, candidate) {
        (Some(id), None) => Abort::Active(id),
        (Some(id), Some(_)) if !settled_active => Abort::Active(id),
        (_, Some(id)) => Abort::Candidate(id.clone()),
        (None, None) => return None,
    };
    let what = match what {
        Abort::Active(id) if rollback_target(model, &id).is_none() => Abort::Last(id),
        Abort::Active(_) | Abort::Last(_) | Abort::Candidate(_) => what,
    };
    let lines = abort_lines(model, &what).ok()?;
    Some((what, lines))
}

/// The consequences of an abort in the current state.
fn abort_lines(model: &ConsoleModel, what: &Abort) -> Result<Vec<String>, String> {
    let snapshot = model.engine_data.snapshot.as_ref().ok_or(wording::NOTHING_KNOWN_YET)?;
    let acts = |id: &CapabilityId| snapshot.families.iter().any(|family| family.active.as_ref() == Some(id));
    let mut lines = match what {
        Abort::Active(id) | Abort::Last(id) if !acts(id) => {
            return Err(wording::not_active_any_more(id));
        }
        Abort::Active(id) | Abort::Last(id) => {
            if matches!(what, Abort::Last(_)) == rollback_target(model, id).is_some() {
                return Err(wording::rollback_target_changed(id));
            }
            vec![leaves(model, id, State::Active, wording::NEVER_COMES_BACK)]
        }
        Abort::Candidate(id) if !is_under_way(model, id) => {
            let status = model.version_state(id);
            let status =
                status.map_or_else(|| "gone".to_owned(), |(state, flags)| state_label(state, &flags));
            return Err(wording::has_another_status(id, &status));
        }
        Abort::Candidate(id) => vec![wording::paused_in_its_state(id)],
    };
    let versions = snapshot.candidates.iter().map(|candidate| &candidate.version);
    let rest = versions.filter(|id| is_under_way(model, id));
    let rest = rest.filter(|id| !matches!(what, Abort::Candidate(of) if of == *id));
    lines.extend(rest.map(|id| effect_of_abort(what, id)).take(3));
    Ok(lines)
}

/// What an abort does to another candidate. Evidence counts for the active version that it was compared with, and for the
/// versions beside which it was gathered.
fn effect_of_abort(what: &Abort, id: &CapabilityId) -> String {
    match what {
        Abort::Candidate(_) => wording::not_touched(id),
        Abort::Active(active) if active.family == id.family => wording::results_are_void(id, active),
        Abort::Last(active) if active.family == id.family => {
            wording::nothing_to_be_compared_with(id, &id.family)
        }
        Abort::Active(active) | Abort::Last(active) => wording::sandbox_may_run_again(id, &active.family),
    }
}

/// Whether anything is under way that an abort stops. Of a confirmed version it is a rollback, which has a key of its own.
pub(super) fn is_anything_under_way(model: &ConsoleModel) -> bool {
    model.engine_data.snapshot.as_ref().is_some_and(|now| {
        let mut flags = now.families.iter().filter_map(|family| family.flags);
        !now.questions.is_empty() || flags.any(is_unsettled) || now.candidates.iter().any(continues)
    })
}

const fn is_unsettled(flags: VersionFlags) -> bool {
    flags.provisional || flags.restricted
}

/// Whether a candidate continues without an operator.
fn is_under_way(model: &ConsoleModel, id: &CapabilityId) -> bool {
    model.candidate(id).is_some_and(continues)
}

fn continues(candidate: &CandidateView) -> bool {
    !candidate.state.is_terminal() && candidate.state != State::Active && !candidate.flags.paused
}

/// Acknowledging and unshelving act at once, because they are easily undone; the others open a form.
pub(super) fn on_alarm(model: &mut ConsoleModel, action: Action) -> Vec<Effect> {
    use crate::model::{HISTORY_PANE, View};
    if model.view_state.view != View::Alarms {
        return refuse(model, wording::GO_TO_THE_ALARMS);
    }
    if model.view_state.pane() == HISTORY_PANE {
        return refuse(model, wording::HISTORY_CHANGES_NOTHING);
    }
    let rows = model.alarm_rows();
    let Some(alarm) = rows.get(model.row()).map(|item| item.alarm().clone()) else {
        return refuse(model, wording::NO_ALARM_HERE);
    };
    let by = model.session.operator.as_ref().map_or_else(|| "console".to_owned(), |who| who.name.clone());
    match action {
        Action::Acknowledge if !model.view_state.marked.is_empty() || selection::mark_group(model) => {
            selection::acknowledge(model, &by)
        }
        Action::Acknowledge => {
            if let Err(why) = selection::takes(&alarm, action) {
                return refuse(model, &why);
            }
            let what = format!("acknowledge {}", alarm.alarm);
            engine_requests::send_query(model, what, EngineQuery::Acknowledge { alarm: alarm.alarm, by })
        }
        Action::Unshelve => {
            if let Err(why) = selection::takes(&alarm, action) {
                return refuse(model, &why);
            }
            let what = format!("unshelve {}", alarm.alarm);
            engine_requests::send_query(model, what, EngineQuery::Unshelve { alarm: alarm.alarm, by })
        }
        _ => match alarm_lines(&alarm, action) {
            Ok(lines) if action == Action::Shelve => open(model, Intent::Shelve(alarm.alarm), lines),
            Ok(lines) => open(model, Intent::ResetAlarm(alarm.alarm), lines),
            Err(why) => refuse(model, &why),
        },
    }
}

/// The consequences of shelving or resetting an alarm, or why it is not possible.
pub(super) fn alarm_lines(alarm: &AlarmView, action: Action) -> Result<Vec<String>, String> {
    if action == Action::Shelve {
        if !alarm.priority.can_be_shelved() {
            return Err(wording::CRITICAL_STAYS_IN_SIGHT.to_owned());
        }
        let what = wording::SHELVED_COMES_BACK.to_owned();
        return Ok(vec![holdpoint_wording::notice(&alarm.text), what]);
    }
    if alarm.state_below.is_present() {
        return Err(wording::CONDITION_STILL_PRESENT.to_owned());
    }
    if !alarm.latching {
        return Err(wording::WAITS_FOR_NO_RESET.to_owned());
    }
    Ok(vec![holdpoint_wording::notice(&alarm.text), wording::RESET_RESUMES_NOTHING.to_owned()])
}

/// Leaves the view, or opens the form that ends the program.
pub(super) fn quit(model: &mut ConsoleModel) -> Vec<Effect> {
    use crate::model::View;
    if matches!(model.engine_data.engine, EngineState::Ended(_)) {
        return vec![Effect::End];
    }
    if model.view_state.view != View::Overview {
        model.view_state.back.clear();
        model.view_state.view = View::Overview;
        return Vec::new();
    }
    if !model.ends_engine() {
        return vec![Effect::Leave];
    }
    let lines = quit_lines(model);
    open(model, Intent::Quit, lines)
}

/// Ends only the console, if the engine can run without it.
pub(super) fn detach(model: &mut ConsoleModel) -> Vec<Effect> {
    if model.engine_data.link == EngineLink::Own {
        let text = wording::ENGINE_IS_IN_THIS_CONSOLE;
        show_message(model, text.to_owned(), true);
        return Vec::new();
    }
    if model.engine_data.engine == EngineState::Starting {
        return refuse(model, wording::ENGINE_IS_BEING_STARTED);
    }
    vec![Effect::Detach]
}

/// The consequences for the engine when the program ends.
fn quit_lines(model: &ConsoleModel) -> Vec<String> {
    let mut lines = vec![wording::ENGINE_SHUTS_DOWN.to_owned()];
    let others = model.engine_data.other_consoles().count();
    if others > 0 {
        lines.push(wording::others_lose_the_engine(others));
    }
    if model.engine_data.link == EngineLink::Attached {
        lines.push(wording::LAST_CONSOLE.to_owned());
    }
    for candidate in model.engine_data.snapshot.iter().flat_map(|snapshot| &snapshot.candidates) {
        if let Some(progress) = &candidate.progress {
            lines.push(wording::stage_runs_again(
                &candidate.version,
                progress.stage.name(),
                progress.done,
                progress.budget,
            ));
        } else if candidate.flags.awaiting_approval {
            lines.push(wording::approvers_are_asked_again(&candidate.version));
        } else if candidate.flags.provisional {
            lines.push(wording::window_starts_over(&candidate.version));
        }
    }
    lines
}
