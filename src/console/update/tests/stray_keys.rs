//! Keys meant for something else: reflexes, words typed without an open field, and pasted text.

use super::*;

/// Keys that are hit by reflex or to move.
pub(super) const REFLEXES: [KeyCode; 16] = [
    KeyCode::Enter,
    KeyCode::Char(' '),
    KeyCode::Esc,
    KeyCode::Tab,
    KeyCode::BackTab,
    KeyCode::Up,
    KeyCode::Down,
    KeyCode::Left,
    KeyCode::Right,
    KeyCode::PageUp,
    KeyCode::PageDown,
    KeyCode::Home,
    KeyCode::End,
    KeyCode::Backspace,
    KeyCode::Delete,
    KeyCode::F(1),
];

impl TestConsole {
    /// Presses the confirming key, once it counts.
    pub(super) fn confirm(&mut self) -> Vec<Effect> {
        self.now_ms += GUARD_MS;
        self.keys("y")
    }

    /// Whether typed text goes into a field.
    fn has_field(&mut self) -> bool {
        self.model.input.typing.is_some()
            || match &mut self.model.input.overlay {
                Some(Overlay::Palette(_)) => true,
                Some(Overlay::Form(form)) => form.line_mut().is_some() || form.signing.is_some(),
                Some(Overlay::Approval(prompt)) => prompt.line_mut().is_some() || prompt.signing.is_some(),
                Some(Overlay::Replay(replay)) => replay.typing.is_some(),
                Some(Overlay::Why(_) | Overlay::Film(_) | Overlay::KeyLog(_) | Overlay::Event(_)) | None => {
                    false
                }
            }
    }
}

/// Whether no effect gives authority, takes it except by stopping the arm, or ends the program.
fn gives_nothing(effects: &[Effect]) -> bool {
    effects.iter().all(|effect| match effect {
        Effect::Decide { .. } | Effect::Operate { .. } | Effect::Register { .. } | Effect::End => false,
        Effect::Ask { question, .. } => !matches!(question, EngineQuery::Pace(_) | EngineQuery::Drift(_)),
        _ => true,
    })
}

/// A burst of typing without a field, a word or a line, confirms nothing: the confirming key does not count right
/// after the one that asks.
#[test]
fn a_burst_of_keys_confirms_nothing() {
    let keys: Vec<KeyCode> = (' '..='~')
        .map(KeyCode::Char)
        .chain([KeyCode::Enter, KeyCode::Tab, KeyCode::Backspace, KeyCode::F(9)])
        .collect();
    let mut forms = 0;
    for view in View::ALL {
        let mut base = TestConsole::new(0);
        base.model.view_state.view = view;
        for first in &keys {
            let mut one = base.clone();
            assert!(gives_nothing(&one.press(*first)), "{view:?}: {first:?}");
            if one.has_field() {
                continue;
            }
            forms += usize::from(one.model.input.overlay.is_some());
            for second in &keys {
                let mut two = one.clone();
                assert!(gives_nothing(&two.press(*second)), "{view:?}: {first:?} {second:?}");
                if !two.has_field() {
                    for last in [KeyCode::Char('y'), KeyCode::Enter] {
                        assert!(
                            gives_nothing(&two.clone().press(last)),
                            "{view:?}: {first:?} {second:?} {last:?}"
                        );
                    }
                }
            }
        }
    }
    assert!(forms > 0, "some key asks for a confirmation by one key");
}

/// The same key counts as soon as the operator can have read what it confirms.
#[test]
fn a_confirmation_needs_its_own_key() {
    let mut console = TestConsole::new(0);
    console.keys("xy");
    let Some(Overlay::Form(form)) = &console.model.input.overlay else { panic!("it stays open") };
    assert!(form.problem == Some(FormProblem::Guard), "{form:?}");
    assert!(console.model.notice.as_ref().is_some_and(|notice| notice.bad), "the last line says so, too");
    console.now_ms += GUARD_MS - 1;
    assert!(gives_nothing(&console.keys("y")));
    console.now_ms += 1;
    assert!(matches!(console.keys("y")[..], [Effect::Operate { .. }]));
    // Pasted text never acts, and the screen says so.
    for opened in ["", "x"] {
        let mut console = TestConsole::new(0);
        console.keys(opened);
        console.now_ms += GUARD_MS;
        assert!(console.tell(MsgKind::Paste("y\nxy\r".to_owned())).is_empty(), "after {opened:?}");
        assert!(console.model.notice.as_ref().is_some_and(|notice| notice.text.contains("ignored")));
    }
}

/// A stopped console, and the row of a spreadsheet that was pasted where the terminal does not mark a paste: `W` opened
/// the form, two tabs reached its button, and the line's end confirmed it.
#[test]
fn a_pasted_row_starts_no_stopped_cell() {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    now.stopped = Some(StoppedView::first("bo".to_owned(), Caller::Script, String::new(), 1_000));
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    let type_row = |console: &mut TestConsole, row: &str| -> Vec<Effect> {
        let code = |sign| match sign {
            '\t' => KeyCode::Tab,
            '\n' => KeyCode::Enter,
            sign => KeyCode::Char(sign),
        };
        row.chars().flat_map(|sign| console.press(code(sign))).collect()
    };
    let mut at_once = console.clone();
    assert!(gives_nothing(&type_row(&mut at_once, "Washer M8\t\t200 pcs\n")));
    // The same into a form that has been open for a while: its keys come in a burst.
    console.keys("W");
    console.now_ms += 10 * GUARD_MS;
    for sign in "asher M8\t\t200 pcs\n".chars() {
        console.tell(MsgKind::Burst);
        assert!(gives_nothing(&type_row(&mut console, &sign.to_string())));
    }
    let Some(Overlay::Form(form)) = &console.model.input.overlay else { panic!("it stays open") };
    assert_eq!(form.problem, Some(FormProblem::Guard));
    // A key of its own confirms it, unless a paste came just before.
    console.tell(MsgKind::Paste(" and more".to_owned()));
    console.now_ms += GUARD_MS - 1;
    assert!(gives_nothing(&console.press(KeyCode::Enter)));
    console.now_ms += 1;
    assert!(matches!(console.press(KeyCode::Enter)[..], [Effect::Operate { .. }]));
}

/// Taking authority away from a version needs no pause: its form has a reason to type.
#[test]
fn a_form_that_takes_authority_away_confirms_at_once() {
    for (key, is_guarded) in [("F", false), ("p", false), ("e", true)] {
        let mut console = TestConsole::new(0);
        let mut now = snapshot(0, 'e');
        now.candidates[0].flags = serde_json::from_value(flags(false, false)).unwrap();
        console.tell(MsgKind::Snapshot(Arc::new(now)));
        console.keys(key);
        console.keys("a reason");
        console.press(KeyCode::Tab);
        console.press(KeyCode::Tab);
        assert_eq!(console.press(KeyCode::Enter).is_empty(), is_guarded, "{key}");
    }
}

/// `u` on a version that is not paused opened no form, and the reason that followed acted as keys; so did the passphrase
/// after a `Y` without an open request.
#[test]
fn text_typed_for_a_refused_form_acts_as_no_key() {
    for refused in ["u", "Y", "N"] {
        let mut console = TestConsole::new(0);
        console.keys(refused);
        assert!(console.model.notice.as_ref().is_some_and(|notice| notice.bad), "{refused}");
        let before = (console.model.view_state.clone(), console.model.key_log.entries.clone());
        let text = "pump is new, Fixed by ana; exit".chars().map(KeyCode::Char);
        for key in text.chain([KeyCode::Enter, KeyCode::Tab, KeyCode::Char('q')]) {
            console.now_ms += GUARD_MS - 1;
            assert!(console.press(key).is_empty(), "{refused}, {key:?}");
            let input = &console.model.input;
            assert!(input.overlay.is_none() && input.typing.is_none(), "{refused}, {key:?}");
        }
        assert_eq!((console.model.view_state.clone(), console.model.key_log.entries.clone()), before);
        // The arm is stopped at once, and a key after a pause is a key.
        assert!(matches!(
            &console.clone().keys("X")[..],
            [Effect::Ask { question: EngineQuery::Stop { .. }, .. }]
        ));
        console.now_ms += GUARD_MS;
        console.keys("F");
        assert!(matches!(&console.model.input.overlay, Some(Overlay::Form(_))), "{refused}");
    }
}

/// `:as cora` over an open request or form changed nothing and said nothing, and its letters acted as keys.
#[test]
fn a_command_over_an_open_request_or_form_is_refused_aloud() {
    for opened in ["", "x"] {
        let mut console = TestConsole::new(0);
        if opened.is_empty() {
            console.open_prompt();
        } else {
            console.keys(opened);
        }
        let before = console.model.input.overlay.clone();
        console.keys(":as n cora");
        assert!(console.press(KeyCode::Enter).is_empty());
        assert!(console.model.notice.as_ref().is_some_and(|notice| notice.bad), "over {opened:?}");
        assert_eq!(console.model.input.overlay, before, "over {opened:?}");
        console.press(KeyCode::Esc);
        assert!(console.model.input.overlay.is_none(), "over {opened:?}");
    }
}

/// A letter in the field of minutes showed only at the end that the form refuses it.
#[test]
fn a_field_of_minutes_takes_digits_alone() {
    let mut console = TestConsole::new(0);
    let form = crate::form::Form::new(Intent::Shelve("low:1".to_owned()), Vec::new());
    console.model.input.overlay = Some(Overlay::Form(Box::new(form)));
    console.keys("x4y");
    let Some(Overlay::Form(form)) = &console.model.input.overlay else { panic!("the form is closed") };
    assert_eq!(form.minutes.text(), "4", "the offered 30 are replaced");
}

/// The next theme came without its name.
#[test]
fn a_new_theme_is_named() {
    let mut console = TestConsole::new(0);
    console.tell(MsgKind::Theme("mono".to_owned()));
    assert!(console.model.notice.as_ref().is_some_and(|notice| notice.text == "theme mono"));
}
