//! Several versions at once: an operation that takes authority away applies to all marked ones, after one question
//! that names each. One that gives authority applies to one version and ignores marks.

use super::consistency::screen;
use super::*;
use holdpoint_governance::lifecycle::State;
use holdpoint_wording::console as wording;

/// Three candidates in the pipeline, and a finished one.
fn candidates() -> Snapshot {
    let mut now = snapshot(0, 'e');
    let first = now.candidates[0].clone();
    now.candidates = ["align@1.1.0", "place@1.1.0", "grasp@1.4.0", CANDIDATE]
        .into_iter()
        .map(|version| {
            let mut candidate = first.clone();
            candidate.version = version.parse().unwrap();
            candidate.flags.awaiting_approval = version == CANDIDATE;
            candidate
        })
        .collect();
    now.candidates[2].state = State::Rejected;
    now
}

fn console_with_candidates() -> TestConsole {
    let mut console = TestConsole::new(0);
    console.tell(MsgKind::Snapshot(Arc::new(candidates())));
    console.tell(MsgKind::Resize(100, 30));
    console
}

/// Marks these versions, wherever they are in the list.
fn mark(console: &mut TestConsole, versions: &[&str]) {
    console.keys("1");
    for version in versions {
        let id = version.parse().unwrap();
        let row = console.model.row_of(&crate::model::ItemKey::Version(id)).unwrap();
        console.keys("g");
        console.keys(&"j".repeat(row));
        console.keys("m");
    }
}

fn form(console: &TestConsole) -> Option<&crate::form::Form> {
    match &console.model.input.overlay {
        Some(Overlay::Form(form)) => Some(form),
        _ => None,
    }
}

fn confirm(console: &mut TestConsole) -> Vec<Command> {
    console.keys("not for this part");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    let effects = console.press(KeyCode::Enter);
    effects
        .iter()
        .map(|effect| match effect {
            Effect::Operate { confirmed, .. } => confirmed.as_ref().clone().into_command(),
            other => panic!("{other:?}"),
        })
        .collect()
}

#[test]
fn one_form_names_and_sends_every_marked_version() {
    for key in ["F", "p"] {
        let mut console = console_with_candidates();
        mark(&mut console, &["place@1.1.0", "align@1.1.0"]);
        let notice = &console.model.notice.as_ref().unwrap().text;
        assert_eq!(*notice, wording::selection::marked(2, "F", "p", "y", "esc"));
        assert!(console.keys(key).is_empty());
        let open_form = form(&console).unwrap();
        assert!(matches!(&open_form.intent, Intent::Several(each) if each.len() == 2), "{open_form:?}");
        let shown = screen(&console, 100, 30);
        assert!(shown.contains("align@1.1.0 is") && shown.contains("place@1.1.0 is"), "{shown}");
        assert!(!open_form.consequences.iter().any(|line| line.contains(CANDIDATE)), "{open_form:?}");
        let commands = confirm(&mut console);
        let requests: Vec<(String, String)> = commands
            .into_iter()
            .map(|command| match command {
                Command::Reject(operation) if key == "F" => (operation.version.to_string(), operation.reason),
                Command::Pause(operation) if key == "p" => (operation.version.to_string(), operation.reason),
                other => panic!("{other:?}"),
            })
            .collect();
        let why = "not for this part".to_owned();
        assert_eq!(requests, [("align@1.1.0".to_owned(), why.clone()), ("place@1.1.0".to_owned(), why)]);
        assert!(console.model.view_state.marked_versions.is_empty() && form(&console).is_none());
    }
}

#[test]
fn a_change_voids_the_form_and_an_obstacle_is_named() {
    let mut console = console_with_candidates();
    mark(&mut console, &["place@1.1.0", "align@1.1.0"]);
    console.keys("F");
    console.keys("not for");
    let mut now = candidates();
    now.candidates[1].state = State::Active;
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    let void = form(&console).and_then(|form| form.void.as_ref()).unwrap();
    assert!(void.why.starts_with("place@1.1.0") && void.why.contains("active"), "{void:?}");
    assert!(console.press(KeyCode::Enter).is_empty());
    let mut console = console_with_candidates();
    mark(&mut console, &["align@1.1.0", "grasp@1.4.0"]);
    assert!(console.keys("F").is_empty() && form(&console).is_none());
    let notice = &console.model.notice.as_ref().unwrap().text;
    assert!(notice.starts_with("grasp@1.4.0 ") && notice.contains(State::Rejected.name()), "{notice}");
    // A screen that cannot name them all does not ask.
    let mut console = console_with_candidates();
    mark(&mut console, &["align@1.1.0", "place@1.1.0"]);
    console.tell(MsgKind::Resize(40, 10));
    assert!(console.keys("F").is_empty() && form(&console).is_none());
}

#[test]
fn only_reject_and_hold_take_marks() {
    for action in Action::ALL {
        let mut console = console_with_candidates();
        mark(&mut console, &["align@1.1.0", "place@1.1.0"]);
        console.model.notice = None;
        let effects = super::super::act(&mut console.model, *action);
        let several = form(&console).is_some_and(|form| matches!(form.intent, Intent::Several(_)));
        assert_eq!(several, matches!(action, Action::Refuse | Action::Pause), "{action:?}");
        let gives_authority = matches!(
            action,
            Action::Resume
                | Action::Repeat
                | Action::Release
                | Action::Continue
                | Action::Rearm
                | Action::Anchor
                | Action::BreakGlass
        );
        if gives_authority {
            let notice = console.model.notice.clone().unwrap();
            assert!(effects.is_empty() && form(&console).is_none(), "{action:?}");
            assert!(notice.bad && notice.text.contains("one alone"), "{action:?}: {notice:?}");
        }
    }
    // Stopping applies to the version under the cursor, whatever is marked.
    let mut console = console_with_candidates();
    mark(&mut console, &["align@1.1.0", "place@1.1.0"]);
    console.keys("x");
    assert!(matches!(form(&console).unwrap().intent, Intent::Abort(_)));
}

#[test]
fn marks_are_shown_copied_and_removed() {
    let mut console = console_with_candidates();
    assert!(!screen(&console, 100, 30).contains("M align@1.1.0"));
    mark(&mut console, &["place@1.1.0", "align@1.1.0"]);
    let shown = screen(&console, 100, 30);
    assert!(shown.contains("M align@1.1.0") && shown.contains("M place@1.1.0"), "{shown}");
    assert_eq!(console.keys("y"), [Effect::Copy("align@1.1.0\nplace@1.1.0".to_owned())]);
    // In a view of one version, marks have no effect.
    console.keys("3");
    assert_eq!(console.keys("y"), [Effect::Copy(console.model.subject().unwrap().to_string())]);
    console.keys("1");
    console.press(KeyCode::Esc);
    assert!(
        console.model.view_state.marked_versions.is_empty()
            && console.model.view_state.view == View::Overview
    );
    // The event log has nothing to mark.
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    console.keys("m");
    assert!(
        console.model.notice.as_ref().unwrap().bad && console.model.view_state.marked_versions.is_empty()
    );
}

/// The mark joined the word of the priority: `LOWM`.
#[test]
fn the_mark_of_an_alarm_stands_apart_from_its_priority() {
    let mut console = TestConsole::new(0);
    console.keys("5m");
    for (columns, rows) in [(120, 36), (80, 24)] {
        let shown = screen(&console, columns, rows);
        assert!(shown.contains("3o LOW M  ! unack"), "{shown}");
    }
    let mut critical = snapshot(0, 'e');
    critical.alarms[0].priority = holdpoint_governance::alarms::Priority::Critical;
    console.tell(MsgKind::Snapshot(Arc::new(critical)));
    assert!(screen(&console, 120, 36).contains("1^ CRIT M ! unack"));
}
