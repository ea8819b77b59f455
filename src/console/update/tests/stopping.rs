//! Stopping: one key, from everywhere, without a question, and back to work only with a reason.

use super::*;

fn stops(effects: &[Effect]) -> bool {
    matches!(effects, [Effect::Ask { question: Question::Stop { .. }, .. }])
}

#[test]
fn one_key_stops_from_everywhere() {
    for opened in ["", "a", "?", ":", "/", "x", "5", "B"] {
        let mut console = TestConsole::new(2);
        console.keys(opened);
        assert!(stops(&console.press(KeyCode::F(9))), "after {opened:?}");
    }
    let mut console = TestConsole::new(2);
    assert!(stops(&console.keys("X")), "with nothing under evaluation as well");
    console.open_prompt();
    assert!(stops(&console.press(KeyCode::F(9))));
    // Who only looks on may stop, and so may who has not said a name.
    console.model.settings.read_only = true;
    console.model.seat.operator = None;
    let stopped = console.press(KeyCode::F(9));
    assert!(matches!(&stopped[..], [Effect::Ask { question: Question::Stop { by }, .. }] if by == "console"));
}

#[test]
fn no_number_of_requests_keeps_from_stopping() {
    let mut console = TestConsole::new(0);
    (0..64).for_each(|_| drop(console.keys("v")));
    assert!(console.keys("v").is_empty(), "too many wait");
    assert!(stops(&console.keys("X")));
}

#[test]
fn going_on_needs_a_name_and_a_reason() {
    let mut console = TestConsole::new(0);
    assert!(console.keys("W").is_empty());
    assert!(console.model.entry.overlay.is_none(), "there is nothing to let go");
    let mut now = snapshot(0, 'e');
    now.stopped = Some(StoppedView {
        by: "bo".to_owned(),
        caller: Caller::Script,
        reason: String::new(),
        since_ms: 1_000,
        stood_after_ticks: Some(20),
    });
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    console.keys("W");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    assert!(console.press(KeyCode::Enter).is_empty(), "without a reason");
    console.press(KeyCode::BackTab);
    console.press(KeyCode::BackTab);
    console.keys("the cell is empty");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    let effects = console.press(KeyCode::Enter);
    let [Effect::Operate { confirmed, .. }] = &effects[..] else { panic!("{effects:?}") };
    let asked = confirmed.as_ref().clone().into_command();
    assert_eq!(asked, Command::Go { by: "ana".to_owned(), reason: "the cell is empty".to_owned() });
}

/// What the agent works towards is asked for with a reason, as whatever a person answers for.
#[test]
fn a_goal_takes_a_reason() {
    let mut console = TestConsole::new(0);
    console.keys(":goal grasp");
    assert!(console.press(KeyCode::Enter).is_empty(), "a form opens");
    console.keys("the tray is being cleaned");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    let effects = console.press(KeyCode::Enter);
    let [Effect::Operate { confirmed, .. }] = &effects[..] else { panic!("{effects:?}") };
    let asked = Command::Goal {
        goal: "grasp".to_owned(),
        by: "ana".to_owned(),
        reason: "the tray is being cleaned".to_owned(),
    };
    assert_eq!(confirmed.as_ref().clone().into_command(), asked);
}
