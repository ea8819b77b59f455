//! Keys act on the item that the cursor shows, while lists change under it; typed text is never a key.

use super::*;
use holdpoint_protocol::snapshot::AlarmView;
use holdpoint_wording::console as wording;

fn alarm_view(name: &str, priority: &str) -> AlarmView {
    serde_json::from_value(alarm(name, priority, "unacknowledged")).unwrap()
}

fn acknowledged(effects: &[Effect]) -> Option<&str> {
    match effects.first()? {
        Effect::Ask { question: EngineQuery::Acknowledge { alarm, .. }, .. } => Some(alarm),
        _ => None,
    }
}

fn under_cursor(console: &TestConsole) -> String {
    console.model.alarm_rows()[console.model.row()].alarm().alarm.clone()
}

#[test]
fn the_cursor_stays_on_its_alarm_when_a_weightier_one_comes_above_it() {
    let mut console = TestConsole::new(0);
    console.keys("!");
    assert_eq!(under_cursor(&console), "high:1");
    let mut now = snapshot(0, 'e');
    now.alarms.insert(0, alarm_view("critical:1", "critical"));
    now.alarms.insert(0, alarm_view("critical:2", "critical"));
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    assert_eq!(under_cursor(&console), "high:1");
    assert_eq!(acknowledged(&console.press(KeyCode::Char(' '))), Some("high:1"));
}

#[test]
fn a_cursor_that_was_never_moved_stays_on_its_item_too() {
    let mut console = TestConsole::new(0);
    console.model.view_state.view = View::Alarms;
    console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e'))));
    assert_eq!(under_cursor(&console), "low:1");
    let mut now = snapshot(0, 'e');
    now.alarms.insert(0, alarm_view("critical:1", "critical"));
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    assert_eq!(acknowledged(&console.press(KeyCode::Char(' '))), Some("low:1"));
}

#[test]
fn key_for_a_vanished_item_does_not_act_on_its_successor() {
    let mut console = TestConsole::new(0);
    console.model.view_state.view = View::Alarms;
    console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e'))));
    let mut now = snapshot(0, 'e');
    now.alarms.remove(0);
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    assert_eq!(under_cursor(&console), "high:1");
    console.now_ms += 100;
    assert_eq!(console.press(KeyCode::Char(' ')), []);
    assert!(console.model.view_state.slipped_ms.is_some() && console.model.notice.as_ref().unwrap().bad);
    console.now_ms += 1_000;
    assert_eq!(acknowledged(&console.press(KeyCode::Char(' '))), Some("high:1"));
}

/// A group did not open, and its key acknowledged one alarm of it.
#[test]
fn a_group_of_alarms_opens_and_is_acknowledged_as_one() {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    now.alarm_summary.flood = true;
    now.alarms = ["low:1", "low:2", "low:3"].map(|name| alarm_view(name, "low")).into();
    now.alarms.push(alarm_view("critical:1", "critical"));
    console.keys("5");
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    console.keys("g");
    let names = |console: &TestConsole| {
        let rows = console.model.alarm_rows();
        rows.iter().map(|row| row.alarm().alarm.clone()).collect::<Vec<String>>()
    };
    assert_eq!(names(&console), ["low:1", "critical:1"]);
    console.press(KeyCode::Enter);
    assert_eq!(names(&console), ["low:1", "low:2", "low:3", "critical:1"]);
    assert_eq!(console.model.view_state.view, View::Alarms, "it opens here");
    console.press(KeyCode::Enter);
    assert_eq!(names(&console), ["low:1", "critical:1"]);
    let effects = console.press(KeyCode::Char(' '));
    let names: Vec<&str> = effects.chunks(1).filter_map(acknowledged).collect();
    assert_eq!(names, ["low:1", "low:2", "low:3"]);
}

#[test]
fn candidates_that_resort_keep_the_cursor_on_theirs() {
    let mut console = TestConsole::new(0);
    let mut more = snapshot(0, 'e');
    let mut other = more.candidates[0].clone();
    other.version = "place@2.0.0".parse().unwrap();
    more.candidates.push(other);
    let mut settled = more.clone();
    console.tell(MsgKind::Snapshot(Arc::new(more)));
    console.keys("g");
    let first = console.model.version_here().unwrap();
    assert_eq!(first.to_string(), "place@2.0.0");
    settled.candidates[1].state = holdpoint_governance::lifecycle::State::Rejected;
    console.tell(MsgKind::Snapshot(Arc::new(settled)));
    assert_eq!(console.model.row(), 1);
    assert_eq!(console.model.version_here(), Some(first));
}

#[test]
fn text_after_a_slash_never_acts() {
    for view in View::ALL {
        let mut console = TestConsole::new(0);
        console.model.view_state.view = view;
        // Without the line `x` would open the form that aborts, and `y` confirm it.
        assert_eq!(console.keys("/xy"), [], "{view:?}");
        assert!(console.model.input.overlay.is_none() && console.model.input.typing.is_some(), "{view:?}");
        console.press(KeyCode::Enter);
        assert!(console.model.input.overlay.is_none() && console.model.input.typing.is_none(), "{view:?}");
    }
}

#[test]
fn in_an_unfiltered_list_the_cursor_finds_the_text() {
    let mut console = TestConsole::new(0);
    console.keys("!/latched");
    assert_eq!(under_cursor(&console), "latched:1");
    assert_eq!(console.model.alarm_rows().len(), 4, "nothing is hidden");
    console.press(KeyCode::Enter);
    assert_eq!(under_cursor(&console), "latched:1");
    console.keys("/zebra");
    console.press(KeyCode::Enter);
    let notice = console.model.notice.clone().unwrap();
    assert!(notice.bad && notice.text.contains("\"zebra\""), "{notice:?}");
    assert_eq!(under_cursor(&console), "latched:1");
}

#[test]
fn keys_3_and_4_open_the_item_under_the_cursor() {
    for (key, view) in [("3", View::Candidate), ("4", View::Shadow)] {
        for from in [View::Overview, View::Approvals] {
            let mut console = TestConsole::new(0);
            console.model.view_state.chosen = Some("place@9.9.9".parse().unwrap());
            console.model.view_state.view = from;
            console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e'))));
            console.keys(key);
            assert_eq!(console.model.view_state.view, view);
            assert_eq!(console.model.subject().unwrap().to_string(), CANDIDATE, "{key} from {from:?}");
        }
    }
}

#[test]
fn the_event_log_has_no_version_under_its_cursor() {
    let mut console = TestConsole::new(0);
    console.model.view_state.panes[View::Overview as usize] = crate::model::EVENT_LOG_PANE;
    assert_eq!(console.model.version_here(), None);
    assert_eq!(console.keys("D"), []);
    assert!(console.model.input.overlay.is_none(), "a line of the event log is not a version");
}

#[test]
fn typed_lines_complete_recall_and_cancel() {
    let mut console = TestConsole::new(0);
    console.keys(":them");
    console.press(KeyCode::Tab);
    let Some(Typing::Command(line)) = &console.model.input.typing else { panic!("it is typed") };
    assert_eq!(line.text(), "theme");
    console.keys(" mono");
    assert_eq!(console.press(KeyCode::Enter), [Effect::UseTheme("mono".to_owned())]);
    console.keys(":");
    console.press(KeyCode::Up);
    let Some(Typing::Command(line)) = &console.model.input.typing else { panic!("it is recalled") };
    assert_eq!(line.text(), "theme mono");
    console.press(KeyCode::Esc);
    assert!(console.model.input.typing.is_none());
    console.keys(":nonsense");
    console.press(KeyCode::Enter);
    assert!(console.model.notice.as_ref().is_some_and(|notice| notice.bad));
}

/// `:demo` and Tab became `:demote`, and Enter then opened its form.
#[test]
fn a_complete_command_survives_completion() {
    let mut console = TestConsole::new(0);
    console.keys(":demo");
    let typed = |console: &TestConsole| match &console.model.input.typing {
        Some(Typing::Command(line)) => line.text().to_owned(),
        other => panic!("{other:?}"),
    };
    for expected in ["demo", "demote", "demo"] {
        console.press(KeyCode::Tab);
        assert_eq!(typed(&console), expected);
    }
}

/// The text after `:note` was lost.
#[test]
fn typed_note_is_shown_in_its_form() {
    let mut console = TestConsole::new(0);
    console.keys(":note the tray is new");
    assert!(console.press(KeyCode::Enter).is_empty());
    let Some(Overlay::Form(form)) = &console.model.input.overlay else { panic!("a form opens") };
    assert_eq!((&form.intent, form.reason.text()), (&Intent::Note, "the tray is new"));
}

#[test]
fn the_palette_runs_its_item_and_no_decision() {
    let mut console = TestConsole::new(0);
    console.keys("?");
    let Some(Overlay::Palette(palette)) = &console.model.input.overlay else { panic!("it opens") };
    assert!(!palette.actions.iter().any(|action| action.decides()));
    console.keys("audit log");
    console.press(KeyCode::Enter);
    assert_eq!(console.model.view_state.view, View::Audit);
}

#[test]
fn abort_stops_the_most_urgent_thing() {
    let mut console = TestConsole::new(1);
    let mut now = snapshot(1, 'e');
    now.families[0].flags = serde_json::from_value(flags(true, false)).unwrap();
    now.candidates.push(now.candidates[0].clone());
    now.candidates[1].version = "place@2.0.0".parse().unwrap();
    let [compared, other] = [0, 1].map(|place| now.candidates[place].version.clone());
    let (active, family) = (now.families[0].active.clone().unwrap(), now.families[0].family.clone());
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    console.keys("x");
    let Some(Overlay::Form(form)) = &console.model.input.overlay else { panic!("a form opens") };
    assert_eq!(form.intent, Intent::Abort(Abort::Active("grasp@1.2.0".parse().unwrap())));
    assert!(form.consequences.iter().any(|line| line.contains("grasp@1.1.0 takes")), "{form:?}");
    for line in [
        wording::operations::results_are_void(&compared, &active),
        wording::operations::sandbox_may_run_again(&other, &family),
    ] {
        assert!(form.consequences.contains(&line), "{line}: {form:?}");
    }
    let effects = console.confirm();
    let Some(Effect::Operate { confirmed, .. }) = effects.first() else { panic!("{effects:?}") };
    assert!(matches!(confirmed.as_ref().clone().into_command(), Command::Rollback(operation)
        if operation.version.to_string() == "grasp@1.2.0"));
    console.keys("x");
    assert!(console.press(KeyCode::Enter).is_empty());
    assert!(console.model.input.overlay.is_none());
}

/// On a queued row the key paused that one, and the one that ran went on.
#[test]
fn an_abort_on_a_queued_row_means_the_candidate_that_runs() {
    use holdpoint_governance::lifecycle::{Stage, VersionFlags};
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    now.prompts.clear();
    now.candidates[0].flags = VersionFlags::default();
    let mut running = now.candidates[0].clone();
    running.version = "place@2.0.0".parse().unwrap();
    running.flags.running = Some(Stage::Sandbox);
    now.candidates.push(running);
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    console.keys("g");
    console.press(KeyCode::Down);
    assert_eq!(console.model.version_here().unwrap().to_string(), CANDIDATE);
    console.keys("x");
    let Some(Overlay::Form(form)) = &console.model.input.overlay else { panic!("no form") };
    assert_eq!(form.intent, Intent::Abort(Abort::Candidate("place@2.0.0".parse().unwrap())));
}
