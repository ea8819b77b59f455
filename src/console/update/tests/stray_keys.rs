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
                Some(Overlay::Why(_) | Overlay::Film(_)) | None => false,
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
