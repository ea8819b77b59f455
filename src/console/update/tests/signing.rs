//! A decision whose key is under a passphrase.

use holdpoint_approvals::Passphrase;

use super::*;

const WORDS: &str = "Under the oak X";

fn passphrase() -> Passphrase {
    Passphrase::new(WORDS.to_owned().into()).unwrap()
}

impl TestConsole {
    /// Somebody sits down whose key is kept so.
    pub(super) fn sit_with(&mut self, name: &str, protection: Protection) {
        self.tell(MsgKind::Operator(Operator { name: name.to_owned(), role: Role::Engineer, protection }));
    }
}

/// A console whose operator was asked for a passphrase by the key that promotes.
fn asked() -> TestConsole {
    let mut console = TestConsole::new(1);
    console.sit_with("ana", Protection::Passphrase);
    console.open_prompt();
    console.fill("aaaa", "");
    assert!(!decides(&console.keys("Y")), "nothing is signed without a passphrase");
    console
}

fn field(console: &TestConsole) -> Option<&crate::prompt::Signing> {
    match &console.model.entry.overlay {
        Some(Overlay::Prompt(prompt)) => prompt.signing.as_ref(),
        _ => None,
    }
}

/// What a person sees, and what the model would tell if it were printed.
fn seen(console: &TestConsole) -> String {
    let look = Look::new(Theme::builtin("mono").unwrap(), Depth::Mono, Glyphs::Ascii);
    let told = format!("{:?}{:?}", console.model.entry.overlay, console.model.notice);
    crate::frame::text_of(&console.model, &look, 120, 80) + &told
}

#[test]
fn a_protected_key_is_opened_at_the_moment_of_signing_and_nothing_shows_it() {
    let mut console = asked();
    // Letters that would decide, stop or leave are text here.
    assert!(console.keys(WORDS).is_empty());
    console.keys("YqX");
    for _ in 0..3 {
        console.press(KeyCode::Backspace);
    }
    let text = seen(&console);
    assert!(text.contains(&format!("Passphrase of ana: {}", "*".repeat(WORDS.len()))), "{text}");
    assert!(!text.contains("Under") && !text.contains("oak"), "{text}");
    let effects = console.press(KeyCode::Enter);
    let Some(Effect::Decide { id, decision, passphrase: with }) = effects.first() else {
        panic!("{effects:?}")
    };
    assert_eq!(
        (decision.by(), decision.answer(), with.as_ref()),
        ("ana", Answer::Approve, Some(&passphrase()))
    );
    assert!(!format!("{effects:?}").contains("oak"));
    assert!(field(&console).unwrap().secret.is_empty(), "what was handed over is kept nowhere");
    assert!(console.press(KeyCode::Enter).is_empty(), "it is signed once");
    let reply = serde_json::from_value(json!({ "reply": "accepted", "text": "approved", "version": null }));
    let answer = MsgKind::Answer { id: id.clone(), reply: Box::new(reply.unwrap()) };
    console.tell(answer);
    assert!(console.model.entry.overlay.is_none());
    assert!(!seen(&console).contains("oak"));
}

#[test]
fn a_wrong_passphrase_is_said_in_place_and_the_question_stays() {
    let mut console = asked();
    console.keys("wrong words");
    let effects = console.press(KeyCode::Enter);
    let Some(Effect::Decide { id, .. }) = effects.first() else { panic!("{effects:?}") };
    let text = "wrong passphrase, nothing was signed".to_owned();
    console.tell(MsgKind::Unsigned { id: id.clone(), text: text.clone() });
    assert_eq!(field(&console).unwrap().problem.as_deref(), Some(text.as_str()));
    assert!(seen(&console).contains(&text));
    assert!(!console.model.asking.pending.contains_key(id));
    console.keys(WORDS);
    let effects = console.press(KeyCode::Enter);
    assert!(
        matches!(effects.first(), Some(Effect::Decide { passphrase: Some(with), .. }) if *with == passphrase())
    );
}

#[test]
fn what_changes_while_a_passphrase_is_typed_is_not_signed() {
    let mut console = asked();
    console.keys(WORDS);
    console.tell(MsgKind::Snapshot(Arc::new(snapshot(1, 'f'))));
    assert!(!decides(&console.press(KeyCode::Enter)));
    assert_eq!(console.block(), Some(Obstacle::Stale));
    assert_eq!(field(&console), None);
}

#[test]
fn esc_leads_back_to_the_question_and_an_empty_field_signs_nothing() {
    let mut console = asked();
    assert!(!decides(&console.press(KeyCode::Enter)));
    assert!(field(&console).unwrap().problem.is_some());
    console.tell(MsgKind::Paste(format!("{WORDS}\n")));
    assert_eq!(field(&console).unwrap().secret.len(), WORDS.len());
    console.press(KeyCode::Esc);
    assert_eq!(field(&console), None);
    assert!(matches!(console.model.entry.overlay, Some(Overlay::Prompt(_))));
    console.keys("Y");
    assert!(field(&console).unwrap().secret.is_empty(), "what was typed before is gone");
    // Stopping works with the field open.
    let effects = console.press(KeyCode::F(9));
    assert!(matches!(&effects[..], [Effect::Ask { question: Question::Stop { .. }, .. }]), "{effects:?}");
}
