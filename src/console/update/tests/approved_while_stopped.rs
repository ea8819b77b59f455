//! The quorum is complete and the cell is stopped: no text asks for approvals any more, and the start form names the
//! version that takes control.

use super::*;

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
    for (stopped, when) in
        [(true, "as soon as the cell starts"), (false, "when the sequence that runs is over")]
    {
        let mut console = TestConsole::new(1);
        console.open_prompt();
        console.tell(MsgKind::Snapshot(Arc::new(granted(stopped))));
        console.draw((120, 80));
        let screen = screen_text(&console);
        assert!(screen.contains(&format!("Approved by ana, ben: it takes over {when}")), "{screen}");
        for untrue in ["Time left", "is needed (", "decide later", "type the short id"] {
            assert!(!screen.contains(untrue), "{untrue}: {screen}");
        }
        assert!(!decides(&console.keys("Y")));
        assert_eq!(console.block(), Some(DecisionObstacle::Granted));
        console.press(KeyCode::Esc);
        let screen = screen_text(&console);
        assert!(screen.contains(&format!("{CANDIDATE} is approved and takes over {when}")), "{screen}");
        assert!(screen.contains(&format!("2 of 2 takes over {when}")), "{screen}");
        assert!(!screen.contains("held in") && !screen.contains("on hold from its deadline"), "{screen}");
    }
}

/// One of two approvals is not enough, from either approver.
#[test]
fn one_of_two_needs_another_approver() {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    now.prompts[0].approved_by = vec!["ana".to_owned()];
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    console.open_prompt();
    let screen = screen_text(&console);
    assert!(screen.contains("another approver is needed") && screen.contains("never approved"), "{screen}");
}

#[test]
fn starting_the_cell_shows_what_takes_control() {
    let mut console = TestConsole::new(1);
    console.tell(MsgKind::Snapshot(Arc::new(granted(true))));
    console.keys("W");
    let line = format!("{CANDIDATE} is approved and takes control at once");
    assert!(screen_text(&console).contains(&line), "{}", screen_text(&console));
    // A version approved meanwhile must be read as well before the button works.
    let mut before = granted(true);
    before.prompts[0].granted = false;
    let mut console = TestConsole::new(1);
    console.tell(MsgKind::Snapshot(Arc::new(before)));
    console.keys("Wthe cell is empty");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    assert!(!screen_text(&console).contains("takes control at once"));
    console.tell(MsgKind::Snapshot(Arc::new(granted(true))));
    assert!(screen_text(&console).contains(&line), "{}", screen_text(&console));
    assert!(console.press(KeyCode::Enter).is_empty(), "what it does has just changed");
}
