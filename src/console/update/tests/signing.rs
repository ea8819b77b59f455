//! A decision whose key has a passphrase.

use holdpoint_approvals::{Nonce, Passphrase};
use holdpoint_protocol::command::Reply;
use holdpoint_protocol::snapshot::SigningView;
use holdpoint_service::engine_handle::EngineEndError;
use holdpoint_wording::console as wording;

use super::*;
use crate::model::STALE_AFTER_MS;

const WORDS: &str = "Under the oak X";

fn passphrase() -> Passphrase {
    Passphrase::new(WORDS.to_owned().into()).unwrap()
}

impl TestConsole {
    /// Makes a person the operator whose key has this protection.
    pub(super) fn sit_with(&mut self, name: &str, protection: Protection) {
        self.tell(MsgKind::Operator(Operator { name: name.to_owned(), role: Role::Engineer, protection }));
    }
}

/// A console whose operator pressed the key that promotes, and is asked for a passphrase.
fn at_passphrase() -> TestConsole {
    let mut console = TestConsole::new(1);
    console.sit_with("ana", Protection::Passphrase);
    console.open_prompt();
    console.fill("aaaa", "");
    assert!(!decides(&console.keys("Y")), "nothing is signed without a passphrase");
    console
}

fn field(console: &TestConsole) -> Option<&crate::secret::Signing<ApprovalDecision>> {
    match &console.model.input.overlay {
        Some(Overlay::Approval(prompt)) => prompt.signing.as_ref(),
        _ => None,
    }
}

/// The screen's text, and the model's debug output.
fn visible_text(console: &TestConsole) -> String {
    let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Ascii);
    let debug = format!("{:?}{:?}", console.model.input.overlay, console.model.notice);
    crate::frame::text_of(&console.model, &look, 120, 80) + &debug
}

#[test]
fn a_protected_key_is_opened_to_sign_and_stays_hidden() {
    let mut console = at_passphrase();
    // Letters that would decide, stop or leave are text here.
    assert!(console.keys(WORDS).is_empty());
    console.keys("YqX");
    for _ in 0..3 {
        console.press(KeyCode::Backspace);
    }
    let text = visible_text(&console);
    assert!(text.contains(&format!("Passphrase of ana: {}", "*".repeat(WORDS.len()))), "{text}");
    assert!(!text.contains("Under") && !text.contains("oak"), "{text}");
    let effects = console.press(KeyCode::Enter);
    let Some(Effect::Decide { id, decision, passphrase: with }) = effects.first() else {
        panic!("{effects:?}")
    };
    assert_eq!(
        (decision.by(), decision.answer(), with.as_ref()),
        ("ana", ApprovalDecision::Approve, Some(&passphrase()))
    );
    assert!(!format!("{effects:?}").contains("oak"));
    assert!(field(&console).unwrap().secret.is_empty(), "what was handed over is kept nowhere");
    assert!(console.press(KeyCode::Enter).is_empty(), "it is signed once");
    let reply = serde_json::from_value(json!({ "reply": "accepted", "text": "approved", "version": null }));
    let answer = MsgKind::Answer { id: id.clone(), reply: Box::new(reply.unwrap()) };
    console.tell(answer);
    assert!(console.model.input.overlay.is_none());
    assert!(!visible_text(&console).contains("oak"));
}

/// `Y` was refused, and the passphrase typed next acted as keys of the request and of the view below it.
#[test]
fn a_passphrase_after_a_refused_key_goes_nowhere() {
    let mut console = TestConsole::new(1);
    console.sit_with("ana", Protection::Passphrase);
    console.open_prompt();
    console.keys("Y");
    assert_eq!(console.block(), Some(DecisionObstacle::ShortId));
    let before = (console.model.input.overlay.clone(), console.model.key_log.entries.clone());
    for key in "Nr:xqY oak".chars().map(KeyCode::Char).chain([KeyCode::Backspace, KeyCode::Enter]) {
        console.now_ms += GUARD_MS - 1;
        assert!(console.press(key).is_empty(), "{key:?}");
    }
    // The request still says why the key did nothing.
    assert_eq!((console.model.input.overlay.clone(), console.model.key_log.entries.clone()), before);
    // The field is reached at once, and a key after a pause is a key.
    console.fill("aaaa", "");
    assert_eq!(field(&console), None);
    console.now_ms += GUARD_MS;
    console.keys("Y");
    assert!(field(&console).is_some_and(|signing| signing.secret.is_empty()));
}

/// The same in a form: `y` came too early, and an `n` of the passphrase closed the form.
#[test]
fn a_passphrase_after_a_refused_form_goes_nowhere() {
    let mut console = TestConsole::new(1);
    console.sit_with("ana", Protection::Passphrase);
    console.signs();
    console.keys(":demo");
    console.press(KeyCode::Enter);
    console.keys("y");
    assert_eq!(console.form().map(|form| form.problem.clone()), Some(Some(FormProblem::Guard)));
    for key in "nYy oak".chars().map(KeyCode::Char).chain([KeyCode::Enter]) {
        console.now_ms += GUARD_MS - 1;
        assert!(console.press(key).is_empty(), "{key:?}");
        assert!(console.form().is_some_and(|form| form.signing.is_none()), "{key:?}");
    }
    assert!(console.confirm().is_empty());
    assert!(console.form().is_some_and(|form| form.signing.is_some()));
}

/// From Enter until the engine's answer no key is text, and the keys that stop still work.
#[test]
fn stops_work_while_a_passphrase_is_checked() {
    for key in [KeyCode::Char('X'), KeyCode::F(9)] {
        let mut console = at_passphrase();
        console.keys(WORDS);
        assert!(decides(&console.press(KeyCode::Enter)));
        let effects = console.press(key);
        assert!(!effects.is_empty(), "{key:?} stopped nothing");
        assert!(!decides(&effects), "{effects:?}");
    }
}

/// Esc closed the field, and the arm started all the same.
#[test]
fn esc_takes_back_what_is_not_sent_yet_and_is_refused_later() {
    let signed = |console: &mut TestConsole| {
        console.keys(WORDS);
        match console.press(KeyCode::Enter).first() {
            Some(Effect::Decide { id, .. }) => id.clone(),
            other => panic!("{other:?}"),
        }
    };
    let mut console = at_passphrase();
    let id = signed(&mut console);
    console.press(KeyCode::Esc);
    let shown = field(&console).and_then(|signing| signing.problem.as_deref());
    assert_eq!(shown, Some(wording::overlays::TAKEN_BACK));
    assert!(!console.model.requests.hand_over(&id), "it does not go to the engine");
    // It can be signed again.
    let id = signed(&mut console);
    assert!(console.model.requests.hand_over(&id));
    console.press(KeyCode::Esc);
    assert!(field(&console).is_some_and(|signing| signing.request_id.as_ref() == Some(&id)));
    assert!(console.model.notice.as_ref().is_some_and(|notice| notice.text == wording::overlays::TOO_LATE));
    assert!(!visible_text(&console).contains(wording::approval_screen::BACK_TO_THE_QUESTION));
}

/// Esc was refused for an answer that could not come any more, and no key led out of the field.
#[test]
fn esc_leaves_a_sent_request_whose_engine_is_gone_or_silent() {
    let mut gone = at_passphrase();
    gone.keys(WORDS);
    let effects = gone.press(KeyCode::Enter);
    let Some(Effect::Decide { id, .. }) = effects.first() else { panic!("{effects:?}") };
    assert!(gone.model.requests.hand_over(id));
    let mut silent = gone.clone();
    silent.now_ms += STALE_AFTER_MS;
    gone.tell(MsgKind::EngineEnded(Err(EngineEndError::of("it has ended"))));
    for mut console in [gone, silent] {
        console.press(KeyCode::Esc);
        assert!(console.model.input.overlay.is_none());
        assert!(console.model.notice.as_ref().is_some_and(|notice| notice.bad), "it is in doubt");
    }
}

/// Letters typed on after the answer acted as keys of the view.
#[test]
fn text_typed_while_a_passphrase_is_checked_goes_nowhere_after_the_answer() {
    let mut console = at_passphrase();
    console.keys(WORDS);
    let effects = console.press(KeyCode::Enter);
    let Some(Effect::Decide { id, .. }) = effects.first() else { panic!("{effects:?}") };
    console.keys(":p");
    let reply = Reply::Accepted { text: "approved".to_owned(), version: None };
    console.tell(MsgKind::Answer { id: id.clone(), reply: Box::new(reply) });
    assert!(console.model.input.overlay.is_none());
    let before = console.model.view_state.clone();
    for letter in "ace 3".chars() {
        console.now_ms += GUARD_MS - 1;
        assert!(console.press(KeyCode::Char(letter)).is_empty(), "{letter:?}");
        assert_eq!(console.model.view_state, before, "{letter:?}");
    }
    console.now_ms += GUARD_MS;
    console.keys("3");
    assert_eq!(console.model.view_state.view, View::Candidate, "a key after a pause is a key");
}

#[test]
fn a_wrong_passphrase_is_reported_and_the_request_stays() {
    let mut console = at_passphrase();
    console.keys("wrong words");
    let effects = console.press(KeyCode::Enter);
    let Some(Effect::Decide { id, .. }) = effects.first() else { panic!("{effects:?}") };
    let text = "wrong passphrase, nothing was signed".to_owned();
    console.tell(MsgKind::Unsigned { id: id.clone(), text: text.clone() });
    assert_eq!(field(&console).unwrap().problem.as_deref(), Some(text.as_str()));
    assert!(visible_text(&console).contains(&text));
    assert!(!console.model.requests.pending.contains_key(id));
    console.keys(WORDS);
    let effects = console.press(KeyCode::Enter);
    assert!(
        matches!(effects.first(), Some(Effect::Decide { passphrase: Some(with), .. }) if *with == passphrase())
    );
}

#[test]
fn a_change_while_typing_prevents_signing() {
    let mut console = at_passphrase();
    console.keys(WORDS);
    console.tell(MsgKind::Snapshot(Arc::new(snapshot(1, 'f'))));
    assert!(!decides(&console.press(KeyCode::Enter)));
    assert_eq!(console.block(), Some(DecisionObstacle::Stale));
    assert_eq!(field(&console), None);
}

#[test]
fn esc_leads_back_to_the_question_and_an_empty_field_signs_nothing() {
    let mut console = at_passphrase();
    assert!(!decides(&console.press(KeyCode::Enter)));
    assert!(field(&console).unwrap().problem.is_some());
    console.tell(MsgKind::Paste(format!("{WORDS}\n")));
    assert_eq!(field(&console).unwrap().secret.len(), WORDS.len());
    console.press(KeyCode::Esc);
    assert_eq!(field(&console), None);
    assert!(matches!(console.model.input.overlay, Some(Overlay::Approval(_))));
    console.keys("Y");
    assert!(field(&console).unwrap().secret.is_empty(), "what was typed before is gone");
    // Stopping works with the field open.
    let effects = console.press(KeyCode::F(9));
    assert!(matches!(&effects[..], [Effect::Ask { question: EngineQuery::Stop { .. }, .. }]), "{effects:?}");
}

impl TestConsole {
    /// The cell is stopped, and the engine asks for a signature under what gives authority.
    fn signs(&mut self) {
        let mut now = snapshot(1, 'a');
        now.signing = Some(SigningView {
            required: true,
            store_id: "s".to_owned(),
            life: Nonce::from_bytes([7; 16]),
            until_ms: 300_000,
        });
        now.stopped = Some(StoppedView::first("bo".to_owned(), Caller::Script, String::new(), 1));
        self.tell(MsgKind::Snapshot(Arc::new(now)));
    }

    fn form(&self) -> Option<&crate::form::Form> {
        match &self.model.input.overlay {
            Some(Overlay::Form(form)) => Some(form),
            _ => None,
        }
    }
}

#[test]
fn authority_is_signed_in_its_form() {
    let mut console = TestConsole::new(1);
    console.sit_with("ana", Protection::Passphrase);
    console.signs();
    console.keys("W");
    console.keys("the cell is empty");
    for _ in 0..2 {
        console.press(KeyCode::Tab);
    }
    console.now_ms += GUARD_MS;
    assert!(console.press(KeyCode::Enter).is_empty(), "nothing is asked for without a passphrase");
    console.keys("wrong words");
    assert!(!visible_text(&console).contains("wrong words"));
    let effects = console.press(KeyCode::Enter);
    let Some(Effect::Operate { id, passphrase: Some(_), .. }) = effects.first() else {
        panic!("{effects:?}")
    };
    let text = "wrong passphrase, nothing was signed".to_owned();
    console.tell(MsgKind::Unsigned { id: id.clone(), text: text.clone() });
    assert!(visible_text(&console).contains(&text));
    // Esc leads back to the form, and the typed text is gone.
    console.press(KeyCode::Esc);
    assert!(console.form().is_some_and(|form| form.signing.is_none()));
    console.press(KeyCode::Enter);
    console.tell(MsgKind::Paste(format!("{WORDS}\n")));
    let effects = console.press(KeyCode::Enter);
    let Some(Effect::Operate { id, confirmed, passphrase: with }) = effects.first() else {
        panic!("{effects:?}")
    };
    assert_eq!(with.as_ref(), Some(&passphrase()));
    assert!(matches!(confirmed.clone().into_command(), Command::Go { by, .. } if by == "ana"));
    assert!(console.press(KeyCode::Enter).is_empty(), "it is signed once");
    let reply = serde_json::from_value(json!({ "reply": "accepted", "text": "done", "version": null }));
    console.tell(MsgKind::Answer { id: id.clone(), reply: Box::new(reply.unwrap()) });
    assert!(console.form().is_none());
}

#[test]
fn submitting_needs_an_operator_and_stopping_does_not() {
    let mut console = TestConsole::new(1);
    console.signs();
    console.model.session.operator = None;
    console.keys(":demo");
    assert!(console.press(KeyCode::Enter).is_empty(), "there is no operator");
    assert!(console.model.notice.as_ref().unwrap().text.contains(":as NAME"));
    console.sit_with("ana", Protection::Passphrase);
    console.keys(":demo");
    assert!(console.press(KeyCode::Enter).is_empty(), "it is confirmed first");
    assert_eq!(console.form().map(|form| &form.intent), Some(&Intent::Register(None)));
    assert!(console.confirm().is_empty());
    console.keys(WORDS);
    let effects = console.press(KeyCode::F(9));
    assert!(matches!(&effects[..], [Effect::Ask { question: EngineQuery::Stop { .. }, .. }]), "{effects:?}");
    let effects = console.press(KeyCode::Enter);
    assert!(
        matches!(&effects[..], [Effect::Register { folder: None, passphrase: Some(with), .. }] if *with == passphrase())
    );
    // Taken back, and left. A key without a passphrase signs at once.
    for _ in 0..3 {
        console.press(KeyCode::Esc);
    }
    assert!(console.form().is_none());
    console.sit_with("bo", Protection::None);
    console.keys(":register somewhere");
    console.press(KeyCode::Enter);
    let effects = console.confirm();
    assert!(
        matches!(&effects[..], [Effect::Register { folder: Some(_), passphrase: None, .. }]),
        "{effects:?}"
    );
    assert!(console.form().is_none());
}
