//! Stopping: one key, from everywhere, without a question; starting needs a reason.

use super::*;
use crate::form::{Form, FormFocus};
use holdpoint_governance::wall_time::ClockMismatch;
use holdpoint_protocol::snapshot::{ClockMismatchView, RepeatedStop};

fn stops(effects: &[Effect]) -> bool {
    matches!(effects, [Effect::Ask { question: EngineQuery::Stop { .. }, .. }])
}

#[test]
fn stop_key_works_in_every_view() {
    for opened in ["", "a", "?", ":", "/", "x", "5", "B"] {
        let mut console = TestConsole::new(2);
        console.keys(opened);
        assert!(stops(&console.press(KeyCode::F(9))), "after {opened:?}");
    }
    let mut console = TestConsole::new(2);
    assert!(stops(&console.keys("X")), "with nothing under evaluation as well");
    console.open_prompt();
    assert!(stops(&console.press(KeyCode::F(9))));
    // A read-only console may stop, and so may an operator without a name.
    console.model.settings.read_only = true;
    console.model.session.operator = None;
    let stopped = console.press(KeyCode::F(9));
    assert!(
        matches!(&stopped[..], [Effect::Ask { question: EngineQuery::Stop { by }, .. }] if by.is_empty())
    );
}

#[test]
fn stop_is_sent_however_many_requests_wait() {
    let mut console = TestConsole::new(0);
    (0..64).for_each(|_| drop(console.keys("v")));
    assert!(console.keys("v").is_empty(), "too many wait");
    assert!(stops(&console.keys("X")));
}

#[test]
fn start_needs_a_name_and_a_reason() {
    let mut console = TestConsole::new(0);
    assert!(console.keys("W").is_empty());
    assert!(console.model.input.overlay.is_none(), "there is nothing to let go");
    let mut now = snapshot(0, 'e');
    now.stopped = Some(StoppedView::first("bo".to_owned(), Caller::Script, String::new(), 1_000));
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    console.now_ms += GUARD_MS;
    console.keys("W");
    console.now_ms += GUARD_MS;
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    assert!(console.press(KeyCode::Enter).is_empty(), "without a reason");
    console.press(KeyCode::BackTab);
    console.press(KeyCode::BackTab);
    console.keys("the cell is empty");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    console.now_ms += GUARD_MS;
    let effects = console.press(KeyCode::Enter);
    let [Effect::Operate { confirmed, .. }] = &effects[..] else { panic!("{effects:?}") };
    let command = confirmed.as_ref().clone().into_command();
    assert_eq!(
        command,
        Command::Go {
            by: "ana".to_owned(),
            reason: "the cell is empty".to_owned(),
            since_ms: 1_000,
            stops: 1
        }
    );
}

fn open_form(console: &mut TestConsole) -> &mut Form {
    let Some(Overlay::Form(form)) = &mut console.model.input.overlay else { panic!("a form is open") };
    form
}

/// In a small window the form named two of five operators who had stopped the cell, and started it for all of them.
#[test]
fn a_form_that_does_not_fit_is_read_to_its_end_first() {
    let mut console = TestConsole::new(0);
    let mut stopped = StoppedView::first("bo".to_owned(), Caller::Script, "r ".repeat(80), 1_000);
    for at_ms in [2_000, 3_000, 4_000] {
        let (by, reason) = ("cy".to_owned(), "he is at the far side and cannot be seen ".repeat(3));
        stopped.record_repeat(RepeatedStop { by, caller: Caller::Script, reason, at_ms, wall: None });
    }
    let (by, reason) = ("dora".to_owned(), "I AM INSIDE THE CELL".to_owned());
    stopped.record_repeat(RepeatedStop { by, caller: Caller::Script, reason, at_ms: 5_000, wall: None });
    let mut now = snapshot(0, 'e');
    now.stopped = Some(stopped);
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    let size = (60, 16);
    let shown = |console: &TestConsole| {
        let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Ascii);
        let model = ConsoleModel { size, ..console.model.clone() };
        crate::frame::text_of(&model, &look, size.0, size.1)
    };
    let confirms = |console: &mut TestConsole| {
        open_form(console).focus = FormFocus::Confirm;
        console.press(KeyCode::Enter)
    };
    console.keys("Wthe cell is empty");
    console.now_ms += GUARD_MS;
    console.draw(size);
    let screen = shown(&console);
    assert!(screen.contains("make sure") && screen.contains("more below"), "{screen}");
    assert!(!screen.contains("INSIDE"), "{screen}");
    assert!(confirms(&mut console).is_empty(), "it is not read yet");
    assert_eq!(open_form(&mut console).problem, Some(FormProblem::Unread));
    let mut read = String::new();
    for _ in 0..12 {
        console.press(KeyCode::PageDown);
        console.draw(size);
        read.push_str(&shown(&console));
    }
    assert!(read.contains("INSIDE") && !shown(&console).contains("more below"), "{read}");
    assert!(matches!(confirms(&mut console)[..], [Effect::Operate { .. }]));
    // Where the form cannot be drawn, nothing is confirmed.
    console.model.input.overlay = None;
    console.keys("Wthe cell is empty");
    console.draw((40, 4));
    assert!(confirms(&mut console).is_empty());
}

/// The agent's goal needs a reason, like each operation that a person takes responsibility for.
#[test]
fn goal_needs_a_reason() {
    let mut console = TestConsole::new(0);
    console.keys(":goal grasp");
    assert!(console.press(KeyCode::Enter).is_empty(), "a form opens");
    console.keys("the tray is being cleaned");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    console.now_ms += GUARD_MS;
    let effects = console.press(KeyCode::Enter);
    let [Effect::Operate { confirmed, .. }] = &effects[..] else { panic!("{effects:?}") };
    let command = Command::Goal {
        goal: "grasp".to_owned(),
        by: "ana".to_owned(),
        reason: "the tray is being cleaned".to_owned(),
    };
    assert_eq!(confirmed.as_ref().clone().into_command(), command);
}

/// Enter twice, the second time on the button that cancels, gave no message.
#[test]
fn leaving_a_form_reports_that_nothing_was_done() {
    let is_told = |console: &TestConsole| {
        let notice = console.model.notice.as_ref();
        notice.is_some_and(|notice| !notice.bad && notice.text.ends_with("not paused"))
    };
    let mut console = TestConsole::new(0);
    console.keys("pit drops what it holds");
    console.press(KeyCode::Enter);
    console.press(KeyCode::Enter);
    assert!(console.model.input.overlay.is_none());
    assert!(is_told(&console), "{:?}", console.model.notice);
    for leave in [KeyCode::Esc, KeyCode::Char('n')] {
        let mut console = TestConsole::new(0);
        console.keys("x");
        console.press(leave);
        assert!(is_told(&console), "{leave:?}: {:?}", console.model.notice);
    }
}

/// A halted engine refuses it: the key was offered, and a reason typed without effect.
#[test]
fn a_key_does_not_start_a_halted_engine() {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    now.stopped = Some(StoppedView::first("bo".to_owned(), Caller::Script, String::new(), 1_000));
    console.tell(MsgKind::Snapshot(Arc::new(now.clone())));
    let offered = |console: &TestConsole| crate::views::hints::actions(&console.model).contains(&Action::Go);
    assert!(offered(&console));
    let why = "the disk is full. Hint: free some space";
    now.holding = Some(why.to_owned());
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    assert!(!offered(&console));
    console.keys("W");
    assert!(console.model.input.overlay.is_none());
    let notice = console.model.notice.as_ref().unwrap();
    assert!(notice.bad && notice.text.ends_with(why), "{notice:?}");
}

/// Once the cell runs again, from whatever source, no line of this screen says that it is stopped.
#[test]
fn a_start_elsewhere_leaves_no_stale_line() {
    let mut console = TestConsole::new(0);
    let body = json!({ "links": [[0, 0, 0], [0, 0, 1]], "pads": [[0, 0, 1], [0, 0, 1]], "hand": [0, 0, 0, 1],
        "object": [0, 0, 0], "object_turn": [0, 0, 0, 1], "object_half_m": 0.02, "held": false });
    let frame = json!({ "sequence": 1, "at_ms": 59_000, "at_secs": 1.0, "task": null, "version": null, "body": body,
        "speed_m_s": 0, "force_n": 0, "contact_n": 0, "envelope": null, "contacts": [], "blocks": [],
        "unexpected_contact": false, "stopped": true, "twin": null });
    console.tell(MsgKind::VideoFrame(Arc::new(serde_json::from_value(frame).unwrap())));
    let effects = console.keys("X");
    let [Effect::Ask { id, .. }] = &effects[..] else { panic!("{effects:?}") };
    let reply =
        json!({ "reply": "accepted", "text": "the cell is stopped; `go` starts it", "version": null });
    let reply = Box::new(serde_json::from_value(reply).unwrap());
    console.tell(MsgKind::Answer { id: id.clone(), reply });
    let mut now = snapshot(0, 'e');
    now.stopped = Some(StoppedView {
        stood_after_ticks: Some(20),
        ..StoppedView::first("ana".to_owned(), Caller::Script, String::new(), 60_000)
    });
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Unicode);
    let screen = |console: &TestConsole| crate::frame::text_of(&console.model, &look, 120, 36).to_lowercase();
    assert!(screen(&console).contains("stopped"));

    let go = json!({ "seq": 9, "at_ms": 61_000, "event": "cell-released", "by": "omar",
        "caller": { "kind": "script" }, "reason": "the cell is empty" });
    console.tell(MsgKind::Events(vec![serde_json::from_value(go).unwrap()]));
    console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e'))));
    let after = screen(&console);
    assert!(!after.contains("stopped"), "{after}");
    assert!(after.contains("runs again") && after.contains("by omar"), "{after}");
}

/// The form contained the clock's second: it changed each second, and no passphrase was typed fast enough.
#[test]
fn the_form_that_confirms_the_time_stays_as_it_was_read() {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    let at = |now: &mut Snapshot, secs: u64| {
        let (mismatch, time) = (ClockMismatch::Jumped { by_ms: 60_000 }, now.time.plus_ms(secs * 1_000));
        let text = holdpoint_wording::clock_mismatch(&mismatch);
        now.clock_doubt = Some(ClockMismatchView { doubt: mismatch, text, said: time });
    };
    at(&mut now, 0);
    console.tell(MsgKind::Snapshot(Arc::new(now.clone())));
    console.keys(":confirm-time");
    console.press(KeyCode::Enter);
    let form = |console: &TestConsole| match &console.model.input.overlay {
        Some(Overlay::Form(form)) => (form.consequences.clone(), form.problem.clone(), form.void.is_some()),
        other => panic!("{other:?}"),
    };
    let opened = form(&console);
    for secs in 1..4 {
        at(&mut now, secs);
        console.tell(MsgKind::Snapshot(Arc::new(now.clone())));
        assert_eq!(form(&console), opened);
    }
    now.clock_doubt = None;
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    assert!(form(&console).2, "nothing waits to be confirmed any more");
}

/// A minute at standstill counted as the slowest episode, and hours were forecast.
#[test]
fn a_stop_leaves_no_rate_for_a_forecast() {
    let mut console = TestConsole::new(0);
    let show = |console: &mut TestConsole, done: u64, at_ms: u64, is_stopped: bool| {
        let mut now = snapshot(0, 'e');
        now.at_ms = at_ms;
        let progress = json!({ "stage": "sandbox", "what": "paired episodes", "done": done, "budget": 100,
            "since_ms": 0, "early": "" });
        now.candidates[0].progress = Some(serde_json::from_value(progress).unwrap());
        now.stopped =
            is_stopped.then(|| StoppedView::first("bo".to_owned(), Caller::Script, String::new(), at_ms));
        console.tell(MsgKind::Snapshot(Arc::new(now.clone())));
        let candidate = &now.candidates[0];
        let known = console.model.engine_data.stage_progress.get(&candidate.version).unwrap();
        known.remaining_ms(candidate.progress.as_ref().unwrap(), at_ms)
    };
    for (done, at_ms) in [(0, 0), (1, 1_000), (2, 2_000)] {
        assert_eq!(show(&mut console, done, at_ms, false), None);
    }
    assert_eq!(show(&mut console, 3, 3_000, false), Some((97_000, 97_000)));
    assert_eq!(show(&mut console, 3, 63_000, true), None);
    for (done, at_ms) in [(4, 64_000), (5, 65_000)] {
        assert_eq!(show(&mut console, done, at_ms, false), None);
    }
    assert_eq!(show(&mut console, 6, 66_000, false), Some((94_000, 94_000)));
}
