//! Undo sends the reverse of the last action, and refuses aloud what cannot be undone or has changed since.

use super::*;
use crate::effect::EngineQuery as Q;
use holdpoint_governance::lifecycle::VersionFlags;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::Reply;
use holdpoint_wording::console as wording;

impl TestConsole {
    /// The engine accepts the only request among these, and shows its result a moment later.
    fn accept(&mut self, effects: &[Effect], change: impl FnOnce(&mut Snapshot)) {
        let id = match effects {
            [Effect::Operate { id, .. } | Effect::Ask { id, .. }] => id.clone(),
            other => panic!("{other:?}"),
        };
        let reply = Reply::Accepted { text: "done".to_owned(), version: None };
        self.tell(MsgKind::Answer { id, reply: Box::new(reply) });
        self.show(change);
    }

    fn show(&mut self, change: impl FnOnce(&mut Snapshot)) {
        self.now_ms += GUARD_MS;
        let mut now = snapshot(0, 'e');
        now.live.goal = "place".to_owned();
        change(&mut now);
        self.tell(MsgKind::Snapshot(Arc::new(now)));
    }

    /// Types the reason into the open form and presses its button.
    fn fill_form(&mut self) -> Vec<Effect> {
        assert!(matches!(self.model.input.overlay, Some(Overlay::Form(_))), "{:?}", self.model.notice);
        self.keys("because");
        self.press(KeyCode::Tab);
        self.press(KeyCode::Tab);
        self.now_ms += GUARD_MS;
        self.press(KeyCode::Enter)
    }

    /// Presses the key of undo, which refuses: the reason.
    fn refused_undo(&mut self) -> String {
        self.now_ms += GUARD_MS;
        assert!(self.keys("U").is_empty() && self.model.input.overlay.is_none());
        let notice = self.model.notice.clone().unwrap();
        assert!(notice.bad, "{notice:?}");
        notice.text
    }

    fn intent(&self) -> Option<&Intent> {
        match &self.model.input.overlay {
            Some(Overlay::Form(form)) => Some(&form.intent),
            _ => None,
        }
    }
}

fn held(now: &mut Snapshot) {
    now.candidates[0].flags = VersionFlags { paused: true, ..VersionFlags::default() };
}

fn shelved_by(name: &str, now: &mut Snapshot) {
    now.alarms[0].shelf = Some((name.to_owned(), "because".to_owned(), WallTime::default()));
}

fn nothing_left(console: &mut TestConsole) {
    assert_eq!(console.refused_undo(), wording::undo::NOTHING);
}

/// Holds the candidate, up to the engine's answer.
fn hold(console: &mut TestConsole) -> Vec<Effect> {
    console.keys("1p");
    console.fill_form()
}

/// Shelves the first alarm, up to the engine's answer.
fn shelve(console: &mut TestConsole) -> Vec<Effect> {
    console.keys("5gz");
    console.press(KeyCode::Enter);
    console.fill_form()
}

#[test]
fn a_hold_is_undone_by_a_form_with_a_reason() {
    let mut console = TestConsole::new(0);
    nothing_left(&mut console);
    let effects = hold(&mut console);
    console.accept(&effects, held);
    assert!(console.keys("U").is_empty());
    assert_eq!(console.intent(), Some(&Intent::Resume(CANDIDATE.parse().unwrap())));
    // A form that is left keeps the action.
    console.press(KeyCode::Esc);
    console.keys("U");
    let effects = console.fill_form();
    let [Effect::Operate { confirmed, .. }] = &effects[..] else { panic!("{effects:?}") };
    assert!(matches!(confirmed.command(), Command::Resume(operation) if operation.reason == "because"));
    console.accept(&effects, |_| ());
    nothing_left(&mut console);
}

#[test]
fn a_changed_state_is_refused_and_the_action_before_it_is_next() {
    let mut console = TestConsole::new(0);
    console.show(|_| ());
    let effects = shelve(&mut console);
    console.accept(&effects, |now| shelved_by("ana", now));
    let effects = hold(&mut console);
    // Another person has resumed it meanwhile.
    console.accept(&effects, |now| shelved_by("ana", now));
    let why = console.refused_undo();
    assert!(why.contains(wording::operations::ONLY_PAUSED_OR_HELD_CAN_BE_RESUMED), "{why}");
    console.now_ms += GUARD_MS;
    let effects = console.keys("U");
    let [Effect::Ask { question: Q::Unshelve { alarm, by }, .. }] = &effects[..] else {
        panic!("{effects:?}")
    };
    assert_eq!((alarm.as_str(), by.as_str()), ("low:1", "ana"));
    console.accept(&effects, |_| ());
    nothing_left(&mut console);
}

#[test]
fn a_shelf_of_another_person_stays() {
    let of_another = wording::undo::shelved_by_another("low:1", "bo");
    let of_none = format!("low:1: {}", wording::selection::NOT_SHELVED);
    for (by, expected) in [(Some("bo"), of_another), (None, of_none)] {
        let mut console = TestConsole::new(0);
        let effects = shelve(&mut console);
        console.accept(&effects, |now| by.into_iter().for_each(|name| shelved_by(name, now)));
        assert_eq!(console.refused_undo(), wording::undo::not_undone(&expected));
        nothing_left(&mut console);
    }
}

#[test]
fn the_goal_before_is_set_again_with_a_reason() {
    let set = |console: &mut TestConsole, after: &str| {
        console.show(|_| ());
        console.keys(":goal grasp");
        console.press(KeyCode::Enter);
        let effects = console.fill_form();
        console.accept(&effects, |now| after.clone_into(&mut now.live.goal));
    };
    let mut console = TestConsole::new(0);
    set(&mut console, "grasp");
    console.keys("U");
    assert_eq!(console.intent(), Some(&Intent::Goal("place".to_owned())));
    let effects = console.fill_form();
    console.accept(&effects, |_| ());
    nothing_left(&mut console);
    let mut console = TestConsole::new(0);
    set(&mut console, "align");
    let changed = wording::undo::goal_has_changed("align", "grasp", "place");
    assert_eq!(console.refused_undo(), wording::undo::not_undone(&changed));
    nothing_left(&mut console);
}

#[test]
fn marks_are_undone_one_by_one() {
    let mut console = TestConsole::new(0);
    console.keys("5gmm");
    assert_eq!(console.model.view_state.marked.len(), 2);
    assert!(console.keys("U").is_empty());
    assert_eq!(console.model.view_state.marked.len(), 1);
    // Marks that are gone in another way need no undo.
    console.press(KeyCode::Esc);
    nothing_left(&mut console);
}

#[test]
fn an_acknowledgment_is_never_undone() {
    let mut console = TestConsole::new(0);
    console.keys("!");
    let effects = console.press(KeyCode::Char(' '));
    console.accept(&effects, |_| ());
    let why = console.refused_undo();
    assert_eq!(why, wording::undo::not_undone(&wording::undo::acknowledgment_has_no_reverse("high:1")));
    assert_eq!(console.model.key_log.entries.back().map(|entry| entry.text.clone()), Some(why));
    nothing_left(&mut console);
}

#[test]
fn nothing_is_undone_before_the_answer_and_its_result() {
    let mut console = TestConsole::new(0);
    let effects = hold(&mut console);
    let asked = Intent::Pause(CANDIDATE.parse().unwrap()).title();
    assert_eq!(console.refused_undo(), wording::undo::not_answered_yet(&asked));
    let [Effect::Operate { id, .. }] = &effects[..] else { panic!("{effects:?}") };
    let reply = Reply::Accepted { text: "held".to_owned(), version: None };
    console.tell(MsgKind::Answer { id: id.clone(), reply: Box::new(reply) });
    assert_eq!(console.refused_undo(), wording::undo::not_undone(wording::undo::RESULT_NOT_SHOWN));
    console.show(held);
    console.now_ms += GUARD_MS;
    console.keys("U");
    assert!(matches!(console.intent(), Some(Intent::Resume(_))), "{:?}", console.model.notice);
    // A refused request leaves nothing to undo.
    let mut console = TestConsole::new(0);
    let effects = hold(&mut console);
    let [Effect::Operate { id, .. }] = &effects[..] else { panic!("{effects:?}") };
    let refused = json!({ "reply": "refused", "code": "not-now", "text": "no", "hint": null });
    let reply = Box::new(serde_json::from_value(refused).unwrap());
    console.tell(MsgKind::Answer { id: id.clone(), reply });
    nothing_left(&mut console);
}
