//! Keys inside the palette, an approval prompt and a form.

use ratatui::crossterm::event::{KeyCode, KeyEvent};

use super::{act, asking, operating, tell, typing};
use crate::action::Action;
use crate::effect::Effect;
use crate::form::{Confirmed, FormFocus, Intent};
use crate::model::{AskedFor, Model, Overlay, Told};
use crate::prompt::{Focus, Obstacle};
use crate::secret::{Signing, SigningKey};
use crate::words::taken_over;
use holdpoint_approvals::Passphrase;
use holdpoint_approvals::keyfile::Protection;
use holdpoint_governance::approval::Answer;
use holdpoint_text::is_visible;

pub(super) fn palette_key(model: &mut Model, key: KeyEvent) -> Vec<Effect> {
    let Some(Overlay::Palette(palette)) = &mut model.entry.overlay else { return Vec::new() };
    let last = palette.rows().len().saturating_sub(1);
    match key.code {
        KeyCode::Esc | KeyCode::F(1) => model.entry.overlay = None,
        KeyCode::Up => palette.cursor = palette.cursor.min(last).saturating_sub(1),
        KeyCode::Down => palette.cursor = palette.cursor.saturating_add(1).min(last),
        KeyCode::PageUp => palette.cursor = palette.cursor.saturating_sub(10),
        KeyCode::PageDown => palette.cursor = palette.cursor.saturating_add(10).min(last),
        KeyCode::Enter => {
            let chosen = palette.chosen();
            model.entry.overlay = None;
            return chosen.map_or_else(Vec::new, |action| act(model, action));
        }
        _ => {
            if typing::into_line(&mut palette.line, key) {
                palette.cursor = 0;
            }
        }
    }
    Vec::new()
}

/// Keys in an approval prompt. Enter and Esc never decide; a key that decides is refused while anything stands
/// against it, with the reason on the screen.
pub(super) fn prompt_key(model: &mut Model, key: KeyEvent, action: Option<Action>) -> Vec<Effect> {
    let now_ms = model.now_ms;
    let Some(Overlay::Prompt(prompt)) = &mut model.entry.overlay else { return Vec::new() };
    prompt.refused = None;
    if let Some(cut_off) = &mut prompt.cut_off {
        // Whatever was being typed goes nowhere; only a key of its own closes what is left to read.
        let may_close = cut_off.key(now_ms);
        match key.code {
            KeyCode::Esc | KeyCode::Enter if may_close => close_held(model),
            KeyCode::PageUp => prompt.scroll_by(false, true),
            KeyCode::PageDown => prompt.scroll_by(true, true),
            _ => prompt.refused = Some(Obstacle::Closed),
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
        // What is closed has no fields left to go to.
        KeyCode::Tab | KeyCode::BackTab if prompt.closed => prompt.refused = Some(Obstacle::Closed),
        KeyCode::Tab => step_focus(model, true),
        KeyCode::BackTab => step_focus(model, false),
        KeyCode::Esc if prompt.focus == Focus::Hold => close_held(model),
        KeyCode::Esc => prompt.focus = Focus::Hold,
        KeyCode::Enter if prompt.focus == Focus::Hold => close_held(model),
        KeyCode::Enter => step_focus(model, true),
        KeyCode::PageUp => prompt.scroll_by(false, true),
        KeyCode::PageDown => prompt.scroll_by(true, true),
        _ => {
            if let Some(line) = prompt.line_mut() {
                typing::into_line(line, key);
                return Vec::new();
            }
            return prompt_action(model, action);
        }
    }
    Vec::new()
}

fn prompt_action(model: &mut Model, action: Option<Action>) -> Vec<Effect> {
    let Some(Overlay::Prompt(prompt)) = &mut model.entry.overlay else { return Vec::new() };
    match action {
        Some(Action::Approve) => decide(model, Answer::Approve),
        Some(Action::Reject | Action::Reread) if prompt.closed => {
            prompt.refused = Some(Obstacle::Closed);
            Vec::new()
        }
        Some(Action::Reject) => {
            // The key that rejects leads to the reason first.
            if !is_visible(prompt.reason.text()) {
                prompt.refused = Some(Obstacle::Reason);
                prompt.focus = Focus::Reason;
                return Vec::new();
            }
            decide(model, Answer::Reject)
        }
        Some(Action::Reread) => {
            let (now_ms, snapshot) = (model.now_ms, model.told.snapshot.clone());
            let read = snapshot.is_some_and(|snapshot| prompt.reread(&snapshot, now_ms));
            if !read {
                tell(model, "the question is closed", true);
                model.entry.overlay = None;
            }
            Vec::new()
        }
        Some(action @ (Action::Abort | Action::Stop)) => act(model, action),
        Some(Action::Down) => {
            prompt.scroll_by(true, false);
            Vec::new()
        }
        Some(Action::Up) => {
            prompt.scroll_by(false, false);
            Vec::new()
        }
        // Nothing else reaches what lies below.
        Some(_) | None => Vec::new(),
    }
}

fn decide(model: &mut Model, answer: Answer) -> Vec<Effect> {
    let Some(Overlay::Prompt(prompt)) = &mut model.entry.overlay else { return Vec::new() };
    let made = prompt.decide(answer, model.seat.operator.as_ref(), model.settings.read_only, model.now_ms);
    let is_protected =
        model.seat.operator.as_ref().is_some_and(|who| who.protection == Protection::Passphrase);
    match made {
        // It is decided again when the passphrase is there, of how things stand then.
        Ok(_) if is_protected && prompt.signing.is_none() => {
            prompt.signing = Some(Signing::of(answer));
            Vec::new()
        }
        Ok(decision) => {
            let what = format!("{} {}", answer.name(), prompt.seen.version);
            let Some(id) = asking::request(model, AskedFor::Decision, what) else { return Vec::new() };
            let passphrase = signed_with(model, &id);
            if passphrase.is_none() {
                model.entry.overlay = None;
            }
            vec![Effect::Decide { id, decision: Box::new(decision), passphrase }]
        }
        Err(block) => {
            prompt.refused = Some(block);
            prompt.signing = None;
            Vec::new()
        }
    }
}

/// What was typed leaves the prompt, which stays until the engine has answered.
fn signed_with(model: &mut Model, id: &str) -> Option<Passphrase> {
    let Some(Overlay::Prompt(prompt)) = &mut model.entry.overlay else { return None };
    prompt.signing.as_mut()?.hand_over(id)
}

/// What stops works also while a passphrase is being checked.
fn stops_meanwhile<W>(signing: &Signing<W>, action: Option<Action>) -> Option<Action> {
    action.filter(|action| signing.is_checked() && matches!(action, Action::Abort | Action::Stop))
}

/// Keys while the passphrase of a decision is typed.
fn signing_key(model: &mut Model, key: KeyEvent) -> Vec<Effect> {
    let Some(Overlay::Prompt(prompt)) = &mut model.entry.overlay else { return Vec::new() };
    let Some(signing) = &mut prompt.signing else { return Vec::new() };
    match signing.key(key) {
        SigningKey::Typed => {}
        SigningKey::Back => prompt.signing = None,
        SigningKey::Away => model.entry.overlay = None,
        SigningKey::Sign => {
            let answer = signing.what;
            return decide(model, answer);
        }
    }
    Vec::new()
}

/// What was typed did not open the key: said where it was typed, and the question or form stays.
pub(super) fn unsigned(model: &mut Model, id: &str, text: String) {
    model.asking.pending.remove(id);
    match &mut model.entry.overlay {
        Some(Overlay::Prompt(prompt)) => {
            if let Some(signing) = prompt.signing.as_mut().filter(|signing| signing.waits_for(id)) {
                return signing.failed(text);
            }
        }
        Some(Overlay::Form(form)) => {
            if let Some(signing) = form.signing.as_mut().filter(|signing| signing.waits_for(id)) {
                return signing.failed(text);
            }
        }
        Some(Overlay::Palette(_) | Overlay::Why(_) | Overlay::Film(_)) | None => {}
    }
    tell(model, text, true);
}

/// What was handed over is answered by nobody any more: the question or form stays, and says so.
pub(super) fn unanswered(model: &mut Model, why: &str) {
    match &mut model.entry.overlay {
        Some(Overlay::Prompt(prompt)) => {
            if let Some(signing) = prompt.signing.as_mut().filter(|signing| signing.is_checked()) {
                signing.failed(why.to_owned());
            }
        }
        Some(Overlay::Form(form)) => {
            if let Some(signing) = form.signing.as_mut().filter(|signing| signing.is_checked()) {
                signing.failed(why.to_owned());
            }
        }
        Some(Overlay::Palette(_) | Overlay::Why(_) | Overlay::Film(_)) | None => {}
    }
}

/// The engine answered: a prompt or a form that waited for it is done with.
pub(super) fn answered(model: &mut Model, id: &str) {
    let waited = match &model.entry.overlay {
        Some(Overlay::Prompt(prompt)) => prompt.signing.as_ref().is_some_and(|signing| signing.waits_for(id)),
        Some(Overlay::Form(form)) => form.signing.as_ref().is_some_and(|signing| signing.waits_for(id)),
        Some(Overlay::Palette(_) | Overlay::Why(_) | Overlay::Film(_)) | None => false,
    };
    if waited {
        model.entry.overlay = None;
    }
}

fn step_focus(model: &mut Model, forward: bool) {
    let Some(Overlay::Prompt(prompt)) = &mut model.entry.overlay else { return };
    let focuses = prompt.focuses();
    let at = focuses.iter().position(|focus| *focus == prompt.focus).unwrap_or(0);
    let next = if forward { at + 1 } else { at + focuses.len() - 1 } % focuses.len().max(1);
    prompt.focus = focuses.get(next).copied().unwrap_or_default();
}

fn close_held(model: &mut Model) {
    let text = match &model.entry.overlay {
        Some(Overlay::Prompt(prompt)) if prompt.closed => None,
        Some(Overlay::Prompt(prompt)) if prompt.seen.granted => {
            Some(format!("{} is approved and {}", prompt.seen.version, taken_over(prompt.stopped)))
        }
        _ => Some("undecided: it goes on waiting and is held at its deadline".to_owned()),
    };
    model.entry.overlay = None;
    if let Some(text) = text {
        tell(model, text, false);
    }
}

pub(super) fn form_key(model: &mut Model, key: KeyEvent, action: Option<Action>) -> Vec<Effect> {
    let now_ms = model.now_ms;
    let Some(Overlay::Form(form)) = &mut model.entry.overlay else { return Vec::new() };
    let one_key = form.is_one_key();
    if let Some(void) = &mut form.void {
        let may_close = void.key(now_ms);
        match (key.code, action) {
            (KeyCode::Esc | KeyCode::Enter, _) if may_close => model.entry.overlay = None,
            // Nothing is typed into one that is confirmed by a key.
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
            SigningKey::Typed => {}
            SigningKey::Back => form.signing = None,
            SigningKey::Away => model.entry.overlay = None,
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
        _ => {
            if let Some(line) = form.line_mut() {
                typing::into_line(line, key);
                form.problem = None;
            } else if let Some(action @ (Action::Abort | Action::Stop)) = action {
                return act(model, action);
            }
        }
    }
    Vec::new()
}

/// A form is left as it was opened: whoever thought that they had confirmed it reads that they have not.
fn leave_undone(model: &mut Model) {
    let Some(Overlay::Form(form)) = &model.entry.overlay else { return };
    let text = format!("nothing was done: {}", form.intent.left());
    model.entry.overlay = None;
    tell(model, text, false);
}

fn confirm(model: &mut Model) -> Vec<Effect> {
    let Some(Overlay::Form(form)) = &mut model.entry.overlay else { return Vec::new() };
    if form.void.is_some() {
        return Vec::new();
    }
    // Keys that were typed for something else arrive in a burst.
    if form.is_one_key() && form.signing.is_none() && form.is_guarded(model.now_ms) {
        form.problem = Some("that key did nothing: wait a moment, then press it again".to_owned());
        return Vec::new();
    }
    if form.intent == Intent::Quit {
        model.entry.overlay = None;
        return vec![Effect::End];
    }
    if let Intent::Identity(name) = &form.intent {
        let name = name.clone();
        model.entry.overlay = None;
        tell(model, format!("making the identity {name}"), false);
        return vec![Effect::MakeIdentity(name)];
    }
    let confirmed = match form.confirm(model.seat.operator.as_ref()) {
        Ok(confirmed) => confirmed,
        Err(problem) => {
            form.problem = Some(problem);
            form.signing = None;
            return Vec::new();
        }
    };
    let gives = confirmed.is_empty() || confirmed.iter().any(Confirmed::gives_authority);
    let signs = gives && form.signing.is_none() && is_signed(&model.told);
    let is_protected =
        model.seat.operator.as_ref().is_some_and(|who| who.protection == Protection::Passphrase);
    if signs && is_protected {
        // It is confirmed again when the passphrase is there, as things stand then.
        form.signing = Some(Signing::of(()));
        return Vec::new();
    }
    match form.intent.clone() {
        Intent::Register(folder) => asking::submit(model, folder),
        _ => operating::carry_out(model, confirmed),
    }
}

/// Whether the engine asks for a signature under what gives authority.
pub(super) fn is_signed(told: &Told) -> bool {
    let signing = told.snapshot.as_ref().and_then(|snapshot| snapshot.signing.as_ref());
    signing.is_some_and(|signing| signing.required)
}

/// What was typed leaves the form, which stays until the engine has answered; a form that waits for nothing closes.
pub(super) fn leave_form(model: &mut Model, id: &str) -> Option<Passphrase> {
    let Some(Overlay::Form(form)) = &mut model.entry.overlay else { return None };
    let passphrase = form.signing.as_mut().and_then(|signing| signing.hand_over(id));
    if passphrase.is_none() {
        model.entry.overlay = None;
    }
    passphrase
}
