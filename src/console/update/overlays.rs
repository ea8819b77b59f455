//! Keys inside the palette, an approval prompt and a form.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

use super::{act, engine_requests, operations, refuse, show_message, swallow_text, text_entry};
use crate::action::Action;
use crate::approval_screen::{ApprovalFocus, DecisionObstacle};
use crate::effect::Effect;
use crate::form::{ConfirmedOperation, FormFocus, FormProblem, Intent};
use crate::formatters::takeover_time;
use crate::model::{ConsoleModel, EngineData, Overlay, RequestSubject};
use crate::secret::{PassphraseEntry as _, Signing, SigningKey};
use holdpoint_approvals::Passphrase;
use holdpoint_approvals::keyfile::Protection;
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_text::is_visible;
use holdpoint_wording::console::engine_updates as engine_wording;
use holdpoint_wording::console::overlays as wording;
use holdpoint_wording::console::shared;

pub(super) fn palette_key(model: &mut ConsoleModel, key: KeyEvent) -> Vec<Effect> {
    let Some(Overlay::Palette(palette)) = &mut model.input.overlay else { return Vec::new() };
    let last = palette.rows().len().saturating_sub(1);
    match key.code {
        KeyCode::Esc | KeyCode::F(1) => model.input.overlay = None,
        KeyCode::Up => palette.cursor = palette.cursor.min(last).saturating_sub(1),
        KeyCode::Down => palette.cursor = palette.cursor.saturating_add(1).min(last),
        KeyCode::PageUp => palette.cursor = palette.cursor.saturating_sub(10),
        KeyCode::PageDown => palette.cursor = palette.cursor.saturating_add(10).min(last),
        KeyCode::Enter => {
            let chosen = palette.chosen();
            model.input.overlay = None;
            return chosen.map_or_else(Vec::new, |action| act(model, action));
        }
        _ => {
            if text_entry::into_line(&mut palette.line, key) {
                palette.cursor = 0;
            }
        }
    }
    Vec::new()
}

/// Keys in an approval prompt. Enter and Esc never decide; a deciding key is refused while there is an obstacle,
/// which is shown.
pub(super) fn approval_key(model: &mut ConsoleModel, key: KeyEvent, action: Option<Action>) -> Vec<Effect> {
    let now_ms = model.now_ms;
    let Some(Overlay::Approval(prompt)) = &mut model.input.overlay else { return Vec::new() };
    prompt.refused = None;
    if let Some(cut_off) = &mut prompt.dismissed {
        // Typed text goes nowhere; only a separate key closes the message.
        let may_close = cut_off.key(now_ms);
        match key.code {
            KeyCode::Esc | KeyCode::Enter if may_close => close_stale(model),
            KeyCode::PageUp => prompt.scroll_by(false, true),
            KeyCode::PageDown => prompt.scroll_by(true, true),
            _ => prompt.refused = Some(DecisionObstacle::Closed),
        }
        return Vec::new();
    }
    if let Some(signing) = &prompt.signing {
        if let Some(action) = stops_meanwhile(signing, action) {
            return act(model, action);
        }
        return signing_key(model, key);
    }
    match key.code {
        // A closed request has no fields.
        KeyCode::Tab | KeyCode::BackTab if prompt.closed => prompt.refused = Some(DecisionObstacle::Closed),
        KeyCode::Tab => step_focus(model, true),
        KeyCode::BackTab => step_focus(model, false),
        KeyCode::Esc if prompt.focus == ApprovalFocus::Later => close_stale(model),
        KeyCode::Esc => prompt.focus = ApprovalFocus::Later,
        KeyCode::Enter if prompt.focus == ApprovalFocus::Later => close_stale(model),
        KeyCode::Enter => step_focus(model, true),
        KeyCode::PageUp => prompt.scroll_by(false, true),
        KeyCode::PageDown => prompt.scroll_by(true, true),
        _ => {
            if let Some(line) = prompt.line_mut() {
                text_entry::into_line(line, key);
                return Vec::new();
            }
            return approval_action(model, action);
        }
    }
    Vec::new()
}

fn approval_action(model: &mut ConsoleModel, action: Option<Action>) -> Vec<Effect> {
    let Some(Overlay::Approval(prompt)) = &mut model.input.overlay else { return Vec::new() };
    match action {
        Some(Action::Approve) => decide(model, ApprovalDecision::Approve),
        Some(Action::Reject | Action::Reread) if prompt.closed => {
            prompt.refused = Some(DecisionObstacle::Closed);
            Vec::new()
        }
        Some(Action::Reject) => {
            // The key that rejects leads to the reason first.
            if !is_visible(prompt.reason.text()) {
                prompt.refused = Some(DecisionObstacle::Reason);
                prompt.focus = ApprovalFocus::Reason;
                return Vec::new();
            }
            decide(model, ApprovalDecision::Reject)
        }
        Some(Action::Reread) => {
            let (now_ms, snapshot) = (model.now_ms, model.engine_data.snapshot.clone());
            let read = snapshot.is_some_and(|snapshot| prompt.reread(&snapshot, now_ms));
            if !read {
                show_message(model, shared::QUESTION_CLOSED, true);
                model.input.overlay = None;
            }
            Vec::new()
        }
        Some(action @ (Action::Abort | Action::Stop)) => act(model, action),
        Some(Action::CommandLine) => refuse_command(model),
        Some(Action::Down) => {
            prompt.scroll_by(true, false);
            Vec::new()
        }
        Some(Action::Up) => {
            prompt.scroll_by(false, false);
            Vec::new()
        }
        // No other key reaches the view below.
        Some(_) | None => Vec::new(),
    }
}

/// Refuses a command over an open request or form, and the text of the command with it.
fn refuse_command(model: &mut ConsoleModel) -> Vec<Effect> {
    swallow_text(model);
    refuse(model, wording::CLOSE_THIS_FIRST)
}

/// Whether the operator's key has a passphrase.
fn is_protected(model: &ConsoleModel) -> bool {
    model.session.operator.as_ref().is_some_and(|who| who.protection == Protection::Passphrase)
}

fn decide(model: &mut ConsoleModel, answer: ApprovalDecision) -> Vec<Effect> {
    let is_protected = is_protected(model);
    let Some(Overlay::Approval(prompt)) = &mut model.input.overlay else { return Vec::new() };
    let made = prompt.decide(answer, model.session.operator.as_ref(), model.settings.read_only, model.now_ms);
    match made {
        // The decision is repeated when the passphrase is complete, from the state at that moment.
        Ok(_) if is_protected && prompt.signing.is_none() => {
            prompt.signing = Some(Signing::of(answer));
            Vec::new()
        }
        Ok(decision) => {
            let what = format!("{} {}", answer.name(), prompt.seen.version);
            let Some(id) = engine_requests::request(model, RequestSubject::Decision, what) else {
                return Vec::new();
            };
            let passphrase = signed_with(model, &id);
            if passphrase.is_none() {
                model.input.overlay = None;
            }
            vec![Effect::Decide { id, decision: Box::new(decision), passphrase }]
        }
        Err(block) => {
            prompt.refused = Some(block);
            prompt.signing = None;
            // Its passphrase may be typed already.
            if is_protected {
                swallow_text(model);
            }
            Vec::new()
        }
    }
}

/// Sends the typed passphrase with the prompt's decision; the prompt stays until the engine has answered.
fn signed_with(model: &mut ConsoleModel, id: &str) -> Option<Passphrase> {
    let Some(Overlay::Approval(prompt)) = &mut model.input.overlay else { return None };
    prompt.signing.as_mut()?.take_passphrase(id)
}

/// Keys that stop something work also while a passphrase is being checked.
fn stops_meanwhile<W>(signing: &Signing<W>, action: Option<Action>) -> Option<Action> {
    action.filter(|action| signing.is_checked() && matches!(action, Action::Abort | Action::Stop))
}

/// Keys while the passphrase of a decision is typed.
fn signing_key(model: &mut ConsoleModel, key: KeyEvent) -> Vec<Effect> {
    let Some(Overlay::Approval(prompt)) = &mut model.input.overlay else { return Vec::new() };
    let Some(signing) = &mut prompt.signing else { return Vec::new() };
    match signing.key(key) {
        // What is typed on after the answer goes nowhere, too.
        SigningKey::Typed if signing.is_checked() => swallow_text(model),
        SigningKey::Typed => {}
        SigningKey::Back => prompt.signing = None,
        SigningKey::Away => return take_back(model),
        SigningKey::Sign => {
            let answer = signing.what;
            return decide(model, answer);
        }
    }
    Vec::new()
}

/// Takes back a request whose passphrase is being checked. One that went to the engine is answered by it, unless the engine
/// is gone or silent: then the field closes, and what became of the request is unknown.
fn take_back(model: &mut ConsoleModel) -> Vec<Effect> {
    let lost = match (model.absence(), model.stale_ms()) {
        (Some(_), _) => Some(engine_wording::ENGINE_GONE),
        (None, Some(_)) => Some(wording::ENGINE_SILENT),
        (None, None) => None,
    };
    let signing = model.input.overlay.as_mut().and_then(Overlay::signing_mut);
    let Some(signing) = signing else { return Vec::new() };
    let found = model.requests.pending.iter().find(|(id, _)| signing.waits_for(id));
    match found.map(|(id, pending)| (id.clone(), pending.is_sent)) {
        Some((_, true)) => {
            let Some(lost) = lost else { return refuse(model, wording::TOO_LATE) };
            model.input.overlay = None;
            return refuse(model, &engine_wording::request_in_doubt(lost));
        }
        Some((id, false)) => {
            model.requests.pending.remove(&id);
            model.key_log.answered(&id, wording::TAKEN_BACK, true);
            signing.failed(wording::TAKEN_BACK.to_owned());
        }
        None => model.input.overlay = None,
    }
    Vec::new()
}

/// The passphrase did not open the key: the field shows it, and the prompt or form stays.
pub(super) fn unsigned(model: &mut ConsoleModel, id: &str, text: String) {
    model.requests.pending.remove(id);
    model.key_log.answered(id, &text, true);
    let signing = model.input.overlay.as_mut().and_then(Overlay::signing_mut);
    match signing.filter(|signing| signing.waits_for(id)) {
        Some(signing) => signing.failed(text),
        None => show_message(model, text, true),
    }
}

/// Reports that a request will get no answer: the question or form stays, with the reason.
pub(super) fn unanswered(model: &mut ConsoleModel, why: &str) {
    let signing = model.input.overlay.as_mut().and_then(Overlay::signing_mut);
    if let Some(signing) = signing.filter(|signing| signing.is_checked()) {
        signing.failed(why.to_owned());
    }
}

/// The engine answered: closes the prompt or form that waited for it.
pub(super) fn answered(model: &mut ConsoleModel, id: &str) {
    let signing = model.input.overlay.as_mut().and_then(Overlay::signing_mut);
    if signing.is_some_and(|signing| signing.waits_for(id)) {
        model.input.overlay = None;
    }
}

fn step_focus(model: &mut ConsoleModel, forward: bool) {
    let Some(Overlay::Approval(prompt)) = &mut model.input.overlay else { return };
    let focuses = prompt.focuses();
    let at = focuses.iter().position(|focus| *focus == prompt.focus).unwrap_or(0);
    let next = if forward { at + 1 } else { at + focuses.len() - 1 } % focuses.len().max(1);
    prompt.focus = focuses.get(next).copied().unwrap_or_default();
}

fn close_stale(model: &mut ConsoleModel) {
    let text = match &model.input.overlay {
        Some(Overlay::Approval(prompt)) if prompt.closed => None,
        Some(Overlay::Approval(prompt)) if prompt.seen.granted => {
            Some(wording::approved_and(&prompt.seen.version, takeover_time(prompt.stopped)))
        }
        _ => Some(wording::UNDECIDED.to_owned()),
    };
    model.input.overlay = None;
    if let Some(text) = text {
        show_message(model, text, false);
    }
}

pub(super) fn form_key(model: &mut ConsoleModel, key: KeyEvent, action: Option<Action>) -> Vec<Effect> {
    let now_ms = model.now_ms;
    let Some(Overlay::Form(form)) = &mut model.input.overlay else { return Vec::new() };
    let one_key = form.is_one_key();
    if let Some(void) = &mut form.void {
        let may_close = void.key(now_ms);
        match (key.code, action) {
            (KeyCode::Esc | KeyCode::Enter, _) if may_close => model.input.overlay = None,
            // A form confirmed by one key has no text fields.
            (_, Some(action @ (Action::Abort | Action::Stop))) if one_key => return act(model, action),
            _ => {}
        }
        return Vec::new();
    }
    if let Some(signing) = &mut form.signing {
        if let Some(action) = stops_meanwhile(signing, action) {
            return act(model, action);
        }
        match signing.key(key) {
            // What is typed on after the answer goes nowhere, too.
            SigningKey::Typed if signing.is_checked() => swallow_text(model),
            SigningKey::Typed => {}
            SigningKey::Back => form.signing = None,
            SigningKey::Away => return take_back(model),
            SigningKey::Sign => return confirm(model),
        }
        return Vec::new();
    }
    match key.code {
        KeyCode::Esc => leave_undone(model),
        KeyCode::PageDown => form.scroll_by(true),
        KeyCode::PageUp => form.scroll_by(false),
        KeyCode::Tab => form.step(true),
        KeyCode::BackTab => form.step(false),
        KeyCode::Enter => match form.focus {
            FormFocus::Minutes | FormFocus::Reason => form.step(true),
            FormFocus::Cancel => leave_undone(model),
            FormFocus::Confirm => return confirm(model),
        },
        KeyCode::Left | KeyCode::Up if form.line_mut().is_none() => form.step(false),
        KeyCode::Right | KeyCode::Down if form.line_mut().is_none() => form.step(true),
        KeyCode::Char('y') if one_key => return confirm(model),
        KeyCode::Char('n') if one_key => leave_undone(model),
        // A control key edits the field.
        KeyCode::Char(sign)
            if form.focus == FormFocus::Minutes
                && !sign.is_ascii_digit()
                && !key.modifiers.contains(KeyModifiers::CONTROL) => {}
        _ => {
            if let Some(line) = form.line_mut() {
                text_entry::into_line(line, key);
                form.problem = None;
            } else {
                match action {
                    Some(action @ (Action::Abort | Action::Stop)) => return act(model, action),
                    Some(Action::CommandLine) => return refuse_command(model),
                    Some(_) | None => {}
                }
            }
        }
    }
    Vec::new()
}

/// Lets the open form or request accept nothing for a moment: its keys come in a burst, or its text was pasted. A
/// passphrase may be pasted: its form was confirmed before.
pub(super) fn guard_again(model: &mut ConsoleModel) {
    let now_ms = model.now_ms;
    match &mut model.input.overlay {
        Some(Overlay::Approval(prompt)) if prompt.signing.is_none() => prompt.opened_ms = now_ms,
        Some(Overlay::Form(form)) if form.signing.is_none() => form.opened_ms = now_ms,
        Some(_) | None => {}
    }
}

/// Closes a form without effect, and says so to an operator who may believe that it was confirmed.
fn leave_undone(model: &mut ConsoleModel) {
    let Some(Overlay::Form(form)) = &model.input.overlay else { return };
    let text = wording::nothing_was_done(form.intent.cancelled_text());
    model.input.overlay = None;
    show_message(model, text, false);
}

fn confirm(model: &mut ConsoleModel) -> Vec<Effect> {
    let is_protected = is_protected(model);
    let Some(Overlay::Form(form)) = &mut model.input.overlay else { return Vec::new() };
    if form.void.is_some() {
        return Vec::new();
    }
    // Keys typed for something else arrive in a burst.
    if form.signing.is_none() && form.is_guarded(model.now_ms) {
        return not_confirmed(model, FormProblem::Guard);
    }
    if form.intent == Intent::Quit {
        model.input.overlay = None;
        return vec![Effect::End];
    }
    if let Intent::Identity(name) = &form.intent {
        let name = name.clone();
        model.input.overlay = None;
        show_message(model, wording::making_identity(&name), false);
        return vec![Effect::MakeIdentity(name)];
    }
    let confirmed = match form.confirm(model.session.operator.as_ref()) {
        Ok(confirmed) => confirmed,
        Err(problem) => return not_confirmed(model, problem),
    };
    let gives = confirmed.is_empty() || confirmed.iter().any(ConfirmedOperation::gives_authority);
    let signs = gives && form.signing.is_none() && is_signed(&model.engine_data);
    if signs && is_protected {
        // The form is confirmed again once the passphrase is complete, from the state at that moment.
        form.signing = Some(Signing::of(()));
        return Vec::new();
    }
    match form.intent.clone() {
        Intent::Register(folder) => engine_requests::submit(model, folder),
        _ => operations::carry_out(model, confirmed),
    }
}

/// Says in the form and in the last line why the key confirmed nothing.
fn not_confirmed(model: &mut ConsoleModel, problem: FormProblem) -> Vec<Effect> {
    let may_sign = is_protected(model) && is_signed(&model.engine_data);
    let Some(Overlay::Form(form)) = &mut model.input.overlay else { return Vec::new() };
    let text = problem.to_string();
    form.problem = Some(problem);
    form.signing = None;
    // Its passphrase may be typed already.
    if may_sign && !form.intent.allows_unverified_engine() {
        swallow_text(model);
    }
    refuse(model, &text)
}

/// Whether the engine asks for a signature under what gives authority.
pub(super) fn is_signed(data: &EngineData) -> bool {
    let signing = data.snapshot.as_ref().and_then(|snapshot| snapshot.signing.as_ref());
    signing.is_some_and(|signing| signing.required)
}

/// Sends the typed passphrase with the form, which stays open until the engine has answered its request.
pub(super) fn leave_form(model: &mut ConsoleModel, id: &str) -> Option<Passphrase> {
    let Some(Overlay::Form(form)) = &mut model.input.overlay else { return None };
    let passphrase = form.signing.as_mut().and_then(|signing| signing.take_passphrase(id));
    if passphrase.is_none() {
        model.input.overlay = None;
    }
    passphrase
}
