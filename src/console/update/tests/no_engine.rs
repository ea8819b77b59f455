//! A console without an engine: another one holds the store, or it has ended. Only stops go out.

use super::*;
use crate::action::Scope;
use crate::frame;
use crate::model::EngineAbsence;
use holdpoint_service::engine_handle::EngineEndError;

const IN_USE: &str = "the store \"/data\" is in use by process 712";

/// A console whose engine never came up, because another one holds the store.
fn second() -> TestConsole {
    let mut console = TestConsole::new(2);
    console.model.engine_data = crate::model::EngineData::default();
    console.model.requests = crate::model::EngineRequests::default();
    console.ended(EngineEndError::in_use(IN_USE));
    console
}

/// A key as written in the table of actions.
pub(super) fn key_event(text: &str) -> KeyEvent {
    let mut letters = text.chars();
    if let (Some(letter), None) = (letters.next(), letters.next()) {
        return KeyEvent::new(KeyCode::Char(letter), KeyModifiers::NONE);
    }
    text.parse::<crokey::KeyCombination>().unwrap().into()
}

impl TestConsole {
    fn ended(&mut self, why: EngineEndError) {
        self.tell(MsgKind::EngineEnded(Err(why)));
    }

    fn notice_text(&self) -> &str {
        self.model.notice.as_ref().map_or("", |notice| notice.text.as_str())
    }

    pub(super) fn screen(&self, columns: u16, rows: u16) -> String {
        let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Unicode);
        frame::text_of(&self.model, &look, columns, rows)
    }
}

#[test]
fn only_stops_go_out_if_another_engine_holds_the_store() {
    let plain = EngineAbsence::HeldElsewhere.problem();
    for action in Action::ALL {
        let mut console = second();
        let Some(key) = action.default_keys().first().filter(|_| action.scope() != Scope::Prompt) else {
            continue;
        };
        let effects = console.tell(MsgKind::Key(key_event(key)));
        match action {
            Action::Stop => {
                let [Effect::Ask { question: EngineQuery::Stop { by }, .. }] = &effects[..] else {
                    panic!("{effects:?}")
                };
                assert_eq!(by, "ana");
            }
            Action::Quit => assert_eq!(effects, [Effect::End]),
            _ => assert!(
                !effects.iter().any(|effect| matches!(
                    effect,
                    Effect::Ask { .. }
                        | Effect::Operate { .. }
                        | Effect::Decide { .. }
                        | Effect::Register { .. }
                )),
                "{action:?}: {effects:?}"
            ),
        }
        if action.changes_something() {
            assert!(
                console.notice_text().starts_with(&plain.to_string()),
                "{action:?}: {}",
                console.notice_text()
            );
        }
    }
    let mut console = second();
    console.keys(":pace 5");
    assert!(console.press(KeyCode::Enter).is_empty());
    assert!(console.notice_text().starts_with(&plain.to_string()), "{}", console.notice_text());
}

#[test]
fn the_screen_names_the_store_owner_and_usable_keys() {
    for (columns, rows) in [(120, 36), (80, 24), (50, 12)] {
        let mut console = second();
        console.now_ms += 60_000;
        console.tell(MsgKind::Tick);
        let screen = console.screen(columns, rows);
        let text = screen.split_whitespace().collect::<Vec<_>>().join(" ");
        for wanted in ["NO ENGINE", "process 712", "X or f9: stops", "q or ctrl-c: ends", "exit code 2"] {
            assert!(text.contains(wanted), "{wanted}: {screen}");
        }
        for absent in ["approvals", "abort", "Registry", "starting"] {
            assert!(!screen.contains(absent), "{absent}: {screen}");
        }
        console.keys("?");
        let Some(Overlay::Palette(palette)) = &console.model.input.overlay else { panic!("help opens") };
        let offered = palette.rows();
        assert!(offered.contains(&Action::Stop) && !offered.contains(&Action::Demo), "{offered:?}");
    }
}

/// After the end of an attached engine its last data stays on the screen; a command that takes authority away goes to
/// any running engine.
#[test]
fn stops_still_go_out_after_the_engine_ended() {
    let mut console = TestConsole::new(0);
    console.ended(EngineEndError::of("the disk is full"));
    assert!(
        console.keys("1W").is_empty() && console.model.input.overlay.is_none(),
        "{:?}",
        console.model.input
    );
    let plain = EngineAbsence::Ended.problem().to_string();
    assert!(console.notice_text().starts_with(&plain), "{}", console.notice_text());
    console.now_ms += GUARD_MS;
    console.keys("x");
    assert!(matches!(&console.model.input.overlay, Some(Overlay::Form(_))), "{}", console.notice_text());
    assert!(matches!(&console.confirm()[..], [Effect::Operate { .. }]));
    assert!(matches!(&console.keys("X")[..], [Effect::Ask { question: EngineQuery::Stop { .. }, .. }]));
}

/// A refusal must be readable to its end.
#[test]
fn a_long_answer_is_shown_whole() {
    let long = "the record is being verified; nothing is carried out before that, and all requests are refused \
                (7 of 120000 records). Hint: try again in a moment; `holdpoint stop` works now, from every shell of this machine";
    for (columns, rows) in [(120, 36), (100, 30), (80, 24), (60, 16), (50, 12)] {
        for opened in ["", "a\r", "5", "B"] {
            let mut console = TestConsole::new(2);
            opened.chars().for_each(|key| {
                console.press(if key == '\r' { KeyCode::Enter } else { KeyCode::Char(key) });
            });
            console.tell(MsgKind::Done { text: long.to_owned(), bad: true });
            let screen = console.screen(columns, rows);
            let foot: Vec<&str> =
                screen.lines().rev().take(usize::from(rows / if rows < 16 { 2 } else { 3 })).collect();
            let foot: Vec<&str> = foot.into_iter().rev().flat_map(str::split_whitespace).collect();
            let foot = foot.join(" ");
            let text = long.split_whitespace().collect::<Vec<_>>().join(" ");
            let (start, end) = text.split_at(text.len() - 20);
            assert!(foot.contains(start), "{columns}x{rows} after {opened:?}: {screen}");
            assert!(foot.contains(end.trim()), "{columns}x{rows} after {opened:?}: {screen}");
            assert!(foot.contains("stop"), "how the arm is stopped stays in sight: {screen}");
            // It stays long enough to be read, and disappears by itself.
            console.now_ms += 9_000;
            console.tell(MsgKind::Tick);
            assert!(console.model.notice.is_some());
            console.now_ms += 60_000;
            console.tell(MsgKind::Tick);
            assert!(console.model.notice.is_none());
        }
    }
}

/// The operator named at the start is the author of a stop, also before the engine is up; without a name, no one is.
#[test]
fn an_early_stop_names_the_operator() {
    for (sits, by) in [(true, "ana"), (false, "")] {
        let mut console = TestConsole::new(0);
        console.model.engine_data = crate::model::EngineData::default();
        if !sits {
            console.model.session.operator = None;
        }
        let effects = console.keys("X");
        let [Effect::Ask { question: EngineQuery::Stop { by: named }, .. }] = &effects[..] else {
            panic!("{effects:?}")
        };
        assert_eq!(named, by);
    }
}
