//! The quorum is complete and the cell is stopped: no text asks for approvals any more, and the start form names the
//! version that takes control.

use super::*;
use crate::formatters::takeover_time;
use holdpoint_wording::console as wording;

fn granted(stopped: bool) -> Snapshot {
    let mut now = snapshot(1, 'e');
    now.prompts[0].granted = true;
    now.prompts[0].approved_by = vec!["ana".to_owned(), "ben".to_owned()];
    now.prompts[0].until = holdpoint_governance::wall_time::WallTime::default();
    now.stopped = stopped.then(|| StoppedView::first("bo".to_owned(), Caller::Script, String::new(), 1_000));
    now
}

fn screen_text(console: &TestConsole) -> String {
    let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Ascii);
    let screen = crate::frame::text_of(&console.model, &look, 120, 80);
    screen.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn an_approved_request_names_its_takeover() {
    for stopped in [true, false] {
        let takeover = takeover_time(stopped);
        let mut console = TestConsole::new(1);
        console.open_prompt();
        console.tell(MsgKind::Snapshot(Arc::new(granted(stopped))));
        console.draw((120, 80));
        let screen = screen_text(&console);
        assert!(screen.contains("ana, ben") && screen.contains(takeover), "{screen}");
        for untrue in ["Time left", "is needed (", "decide later", "type the"] {
            assert!(!screen.contains(untrue), "{untrue}: {screen}");
        }
        assert!(!decides(&console.keys("Y")));
        assert_eq!(console.block(), Some(DecisionObstacle::Granted));
        console.press(KeyCode::Esc);
        let screen = screen_text(&console);
        let told = wording::overlays::approved_and(&CANDIDATE.parse().unwrap(), takeover);
        assert!(screen.contains(&told), "{screen}");
        assert!(screen.contains(&format!("2 of 2 {takeover}")), "{screen}");
        assert!(!screen.contains("2 of 2 until"), "{screen}");
    }
}

/// One of two approvals is not enough, from either approver.
#[test]
fn first_of_two_approvals_asks_for_another_approver() {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    now.prompts[0].approved_by = vec!["ana".to_owned()];
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    console.open_prompt();
    let screen = screen_text(&console);
    assert!(screen.contains("another approver") && screen.contains("never approved"), "{screen}");
}

#[test]
fn start_form_shows_the_versions_that_take_control() {
    let mut console = TestConsole::new(1);
    console.tell(MsgKind::Snapshot(Arc::new(granted(true))));
    console.keys("W");
    let names_version = |console: &TestConsole| match &console.model.input.overlay {
        Some(Overlay::Form(form)) => form.consequences.iter().any(|line| line.starts_with(CANDIDATE)),
        other => panic!("{other:?}"),
    };
    assert!(names_version(&console) && screen_text(&console).contains(&format!("{CANDIDATE} is approved")));
    // A version approved meanwhile must be read as well before the button works.
    let mut before = granted(true);
    before.prompts[0].granted = false;
    let mut console = TestConsole::new(1);
    console.tell(MsgKind::Snapshot(Arc::new(before)));
    console.keys("Wthe cell is empty");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    assert!(!names_version(&console));
    console.tell(MsgKind::Snapshot(Arc::new(granted(true))));
    assert!(names_version(&console));
    assert!(console.press(KeyCode::Enter).is_empty(), "what it does has just changed");
}
