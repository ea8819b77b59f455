//! A form follows the current state, or becomes void with a reason. Typed text goes nowhere else, and a missing operator
//! is reported before typing.

use super::*;
use holdpoint_approvals::Nonce;
use holdpoint_governance::lifecycle::{State, VersionFlags};
use holdpoint_protocol::command::Operation;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::snapshot::{RepeatedStop, SigningView};
use holdpoint_wording::console as wording;

fn stopped(by: &str, since_ms: u64) -> Snapshot {
    let mut now = snapshot(0, 'e');
    let reason = "a hand in the cell".to_owned();
    now.stopped = Some(StoppedView::first(by.to_owned(), Caller::Script, reason, since_ms));
    now
}

fn set_snapshot(console: &mut TestConsole, now: Snapshot) {
    console.tell(MsgKind::Snapshot(Arc::new(now)));
}

fn form(console: &TestConsole) -> Option<&crate::form::Form> {
    match &console.model.input.overlay {
        Some(Overlay::Form(form)) => Some(form),
        _ => None,
    }
}

/// Why the open form is void; the window is then closed.
fn void(console: &mut TestConsole) -> Option<String> {
    let why = form(console).and_then(|form| form.void.as_ref().map(|void| void.why.clone()));
    console.now_ms += GUARD_MS;
    console.press(KeyCode::Esc);
    why.filter(|_| form(console).is_none())
}

fn notice(console: &TestConsole) -> String {
    console.model.notice.as_ref().map(|notice| notice.text.clone()).unwrap_or_default()
}

fn confirm(console: &mut TestConsole) -> Vec<Effect> {
    console.keys("a test");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    console.now_ms += GUARD_MS;
    console.press(KeyCode::Enter)
}

fn command(effects: &[Effect]) -> Command {
    let [Effect::Operate { confirmed, .. }] = effects else { panic!("{effects:?}") };
    confirmed.as_ref().clone().into_command()
}

#[test]
fn a_start_covers_only_the_stop_that_was_read() {
    let mut console = TestConsole::new(0);
    set_snapshot(&mut console, stopped("bo", 1_000));
    console.keys("W");
    assert!(matches!(form(&console).unwrap().intent, Intent::Go { since_ms: 1_000, .. }));
    // The same stop continues: nothing changes, whatever else does.
    console.keys("clear");
    let mut again = stopped("bo", 1_000);
    again.at_ms += 5_000;
    set_snapshot(&mut console, again);
    assert!(form(&console).is_some_and(|form| form.problem.is_none() && form.reason.text() == "clear"));
    // Another stop.
    set_snapshot(&mut console, stopped("cy", 61_000));
    let stopped_again = |console: &TestConsole, by: &str, at_ms| {
        let author = holdpoint_wording::event::stop_author(by, &Caller::Script);
        wording::cell_restart::stopped_it_again(&author, &console.model.moment(at_ms))
    };
    let expected = stopped_again(&console, "cy", 61_000);
    assert!(notice(&console).contains(&expected), "{}", notice(&console));
    assert_eq!(void(&mut console), Some(expected));
    // Also if the engine's snapshot keeps the first stop.
    console.keys("W");
    let stop = |at_ms: u64| Event {
        seq: 9,
        at_ms,
        kind: EventKind::CellStopped {
            by: "di".to_owned(),
            caller: Caller::Script,
            reason: "a hand".to_owned(),
        },
    };
    console.tell(MsgKind::Events(vec![stop(61_000)]));
    console.tell(MsgKind::Events(vec![stop(60_000)]));
    assert!(form(&console).is_some_and(|form| form.void.is_none()), "that is the stop that was read");
    console.tell(MsgKind::Events(vec![stop(62_000)]));
    let expected = stopped_again(&console, "di", 62_000);
    assert_eq!(void(&mut console), Some(expected));
    // Or starts the cell.
    console.keys("W");
    set_snapshot(&mut console, snapshot(0, 'e'));
    assert_eq!(void(&mut console).as_deref(), Some(wording::cell_restart::ALREADY_STARTED));
}

/// During another person's stop, typed text went to the view as keys: `F` opened a form, `q` another.
#[test]
fn text_typed_into_a_voided_form_acts_as_no_key() {
    let rest = "clear; Foreman quit, XBDqWx:demo";
    for at in 0..rest.len() {
        let mut console = TestConsole::new(0);
        set_snapshot(&mut console, stopped("bo", 1_000));
        console.keys("W");
        console.keys(&rest[..at]);
        set_snapshot(&mut console, stopped("cy", 61_000));
        let before = console.model.view_state.clone();
        let mut effects = console.keys(&rest[at..]);
        // The keys that would have confirmed it come with the rest.
        for key in [KeyCode::Enter, KeyCode::Tab, KeyCode::Tab, KeyCode::Enter, KeyCode::Esc] {
            console.now_ms += GUARD_MS - 1;
            effects.extend(console.press(key));
        }
        assert!(effects.is_empty(), "{at}: {effects:?}");
        assert!(form(&console).is_some_and(|form| form.void.is_some()), "{at}");
        assert_eq!(console.model.view_state, before, "{at}");
        // The key that stops the arm works, and is shown.
        assert!(matches!(
            &console.clone().press(KeyCode::F(9))[..],
            [Effect::Ask { question: EngineQuery::Stop { .. }, .. }]
        ));
        assert!(void(&mut console).is_some(), "{at}: a key of its own closes it");
    }
}

/// A passphrase is typed while the operation that it signs changes or disappears.
#[test]
fn a_passphrase_never_becomes_keys() {
    for gone in [false, true] {
        let mut console = TestConsole::new(0);
        console.sit_with("ana", Protection::Passphrase);
        let mut now = stopped("bo", 1_000);
        now.signing = Some(SigningView {
            required: true,
            store_id: "s".to_owned(),
            life: Nonce::from_bytes([7; 16]),
            until_ms: 300_000,
        });
        set_snapshot(&mut console, now.clone());
        console.keys("W");
        confirm(&mut console);
        console.keys("under th");
        if gone {
            now.stopped = None;
        } else if let Some(stopped) = &mut now.stopped {
            stopped.reason = "two hands".to_owned();
        }
        set_snapshot(&mut console, now);
        let effects = console.keys("e oak xXqF");
        assert!(effects.is_empty() && console.press(KeyCode::Enter).is_empty(), "{effects:?}");
        let open = form(&console).unwrap();
        assert_eq!((open.void.is_some(), open.signing.is_some()), (gone, !gone));
        if gone {
            assert!(void(&mut console).is_some());
        } else {
            console.press(KeyCode::Esc);
            let open = form(&console).unwrap();
            assert!(open.signing.is_none() && open.consequences[1].contains("two hands"), "{open:?}");
        }
    }
}

/// If another person answered a question during typing, the rest of the reason aborted and stopped, and Enter went to
/// the view below.
#[test]
fn text_typed_into_a_closing_request_acts_as_no_key() {
    let mut console = TestConsole::new(0);
    console.open_prompt();
    console.press(KeyCode::Tab);
    console.keys("no");
    let closed = Snapshot { prompts: Vec::new(), ..snapshot(0, 'e') };
    set_snapshot(&mut console, closed);
    let effects = console.keys(" good: xXYNr");
    assert!(effects.is_empty() && console.press(KeyCode::Enter).is_empty(), "{effects:?}");
    assert!(console.press(KeyCode::Esc).is_empty());
    assert!(matches!(&console.model.input.overlay, Some(Overlay::Approval(prompt)) if prompt.closed));
    console.now_ms += GUARD_MS;
    console.press(KeyCode::Esc);
    assert!(console.model.input.overlay.is_none());
}

/// Starting the cell answers for all stops, not for the first alone.
#[test]
fn every_operator_who_stopped_is_named() {
    let mut now = stopped("ana", 62_000);
    let again = |by: &str, at_ms| RepeatedStop {
        by: by.to_owned(),
        caller: Caller::Script,
        reason: format!("{by} saw something"),
        at_ms,
        wall: None,
    };
    let screens = |now: &Snapshot| {
        let mut console = TestConsole::new(0);
        set_snapshot(&mut console, now.clone());
        let screen = console.screen(120, 36);
        console.keys("W");
        (screen, form(&console).unwrap().consequences.join("\n"), console.screen(80, 24))
    };
    now.stopped.as_mut().unwrap().record_repeat(again("bert", 69_000));
    let (screen, form, _) = screens(&now);
    let twice = wording::status::stopped_again("ana", "00:01:02", "bert", "00:01:09", "");
    assert!(screen.contains(&twice), "{screen}");
    assert!(form.contains("as \"ana\"") && form.contains("00:01:02: \"a hand"), "{form}");
    assert!(form.contains("as \"bert\"") && form.contains("00:01:09: \"bert saw"), "{form}");
    // However many stops there are, the first and the last ones are named, and the others counted.
    for (by, at_ms) in
        [("carl", 70_000), ("dora", 71_000), ("emil", 72_000), ("fritz", 73_000), ("bert", 74_000)]
    {
        now.stopped.as_mut().unwrap().record_repeat(again(by, at_ms));
    }
    let stopped = now.stopped.as_ref().unwrap();
    let named: Vec<&str> = stopped.again.iter().map(|stop| stop.by.as_str()).collect();
    assert_eq!((named, stopped.unnamed), (vec!["dora", "emil", "fritz", "bert"], 2));
    let (screen, form, open) = screens(&now);
    let often = wording::status::stopped_again("ana", "00:01:02", "bert", "00:01:14", " and 5 more");
    assert!(screen.contains(&often), "{screen}");
    assert!(form.contains(&wording::cell_restart::stopped_again_unnamed(2)), "{form}");
    assert!(form.contains("fritz") && !form.contains("carl"), "{form}");
    for wanted in ["Stopped by", "2 more times", "\"bert\"", "is empty", "Reason"] {
        assert!(open.contains(wanted), "{wanted}: {open}");
    }
}

#[test]
fn a_missing_operator_is_reported_before_typing() {
    for (before, key) in [("", "p"), ("", "F"), ("", "D"), ("5G", "R"), ("", "W"), ("", ":goal grasp\r")] {
        let mut console = TestConsole::new(0);
        console.model.session.operator = None;
        set_snapshot(&mut console, stopped("bo", 1_000));
        console.keys(before);
        for letter in key.chars() {
            console.press(if letter == '\r' { KeyCode::Enter } else { KeyCode::Char(letter) });
        }
        assert!(form(&console).is_none(), "{key}");
        assert!(notice(&console).contains(":as NAME"), "{key}: {}", notice(&console));
    }
    // Stopping and leaving need no operator.
    for key in ["x", "q"] {
        let mut console = TestConsole::new(0);
        console.model.session.operator = None;
        console.keys(key);
        assert!(form(&console).is_some(), "{key}");
    }
}

#[test]
fn a_form_follows_its_version_and_is_read_again() {
    let mut console = TestConsole::new(0);
    console.keys("F");
    assert!(form(&console).unwrap().consequences[0].contains("shadowed"));
    console.keys("no good");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    let mut now = snapshot(0, 'e');
    now.candidates[0].state = State::Demoted;
    now.candidates[0].flags = VersionFlags::default();
    set_snapshot(&mut console, now);
    let open = form(&console).unwrap();
    assert!(open.consequences[0].contains("demoted") && open.problem.is_some(), "{open:?}");
    // Only a read text is confirmed: the button lost the keys.
    assert!(console.press(KeyCode::Enter).is_empty());
    assert!(form(&console).is_none(), "that was Cancel");
}

#[test]
fn form_is_void_once_its_version_changes_state() {
    type CandidateChange = fn(&mut Snapshot);
    let moved: [(&str, CandidateChange); 4] = [
        ("F", |now| now.candidates[0].state = State::Active),
        ("p", |now| now.candidates[0].flags.paused = true),
        ("D", |now| now.candidates[0].state = State::Rejected),
        ("x", |now| now.candidates[0].state = State::Active),
    ];
    for (key, change) in moved {
        let mut console = TestConsole::new(0);
        console.keys(key);
        assert!(form(&console).is_some(), "{key}");
        let mut now = snapshot(0, 'e');
        change(&mut now);
        set_snapshot(&mut console, now);
        assert!(notice(&console).contains("not asked"), "{key}: {}", notice(&console));
        assert!(void(&mut console).is_some(), "{key}");
    }
    // The rollback target disappears while the operator reads that it takes over.
    let mut console = TestConsole::new(0);
    console.keys("2");
    let mut now = snapshot(0, 'e');
    now.candidates.clear();
    now.families[0].flags = Some(VersionFlags { provisional: true, ..VersionFlags::default() });
    set_snapshot(&mut console, now.clone());
    console.keys("1x");
    assert!(matches!(
        form(&console).map(|form| &form.intent),
        Some(Intent::Abort(crate::form::Abort::Active(_)))
    ));
    now.families[0].pinned = None;
    set_snapshot(&mut console, now);
    // The key that aborts asks again, from the current state.
    assert!(form(&console).is_some_and(|form| form.void.is_some()), "it would stop the family now");
    console.keys("x");
    assert!(matches!(
        form(&console).map(|form| (&form.intent, &form.void)),
        Some((Intent::Abort(crate::form::Abort::Last(_)), None))
    ));
}

#[test]
fn vanished_alarm_voids_its_form() {
    let mut console = TestConsole::new(0);
    console.keys("5");
    console.press(KeyCode::Char('z'));
    assert!(form(&console).is_some(), "{}", notice(&console));
    let mut now = snapshot(0, 'e');
    now.alarms.remove(0);
    set_snapshot(&mut console, now);
    assert!(void(&mut console).unwrap().contains("normal again"));
}

/// The console's keys and the verbs `pause` and `resume` have one rule.
#[test]
fn pause_and_resume_keys_follow_the_rule_of_the_verbs() {
    for state in State::ALL {
        for bits in 0..8u8 {
            let flags =
                VersionFlags { paused: bits & 1 > 0, provisional: bits & 2 > 0, ..VersionFlags::default() };
            let held = bits & 4 > 0;
            for (key, allowed) in [("p", state.may_pause(&flags)), ("u", state.may_resume(&flags, held))] {
                let mut console = TestConsole::new(0);
                let mut now = snapshot(0, 'e');
                (now.candidates[0].state, now.candidates[0].flags) = (state, flags);
                now.candidates[0].held = held;
                set_snapshot(&mut console, now);
                console.keys(key);
                assert_eq!(form(&console).is_some(), allowed, "{key} on {state} {flags:?} held {held}");
            }
        }
    }
}

#[test]
fn a_provisional_version_is_paused_and_resumed_by_keys() {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    now.candidates[0].state = State::Active;
    now.candidates[0].flags = VersionFlags { provisional: true, ..VersionFlags::default() };
    set_snapshot(&mut console, now.clone());
    console.keys("p");
    assert!(form(&console).unwrap().consequences[1].contains("keeps"));
    let pause = command(&confirm(&mut console));
    let operation =
        Operation { version: CANDIDATE.parse().unwrap(), by: "ana".to_owned(), reason: "a test".to_owned() };
    assert_eq!(pause, Command::Pause(operation.clone()));
    now.candidates[0].flags.paused = true;
    let label = crate::formatters::state_label(State::Active, &now.candidates[0].flags);
    set_snapshot(&mut console, now);
    console.keys("u");
    assert!(form(&console).unwrap().consequences[0].ends_with(&label));
    assert_eq!(command(&confirm(&mut console)), Command::Resume(operation));
}

#[test]
fn only_the_event_log_and_charts_are_frozen() {
    let mut console = TestConsole::new(0);
    console.keys("f");
    let mut now = stopped("bo", 60_500);
    now.families[0].active = Some("grasp@1.3.0".parse().unwrap());
    set_snapshot(&mut console, now);
    let frozen = console.model.view_state.frozen.as_ref().unwrap();
    assert_eq!(frozen.at_ms, 60_000, "in the engine's time, as everything on the screen");
    assert!(console.model.engine_data.snapshot.as_ref().unwrap().stopped.is_some());
    assert!(console.model.charted().unwrap().stopped.is_none());
    console.keys("f");
    assert!(console.model.view_state.frozen.is_none());
}
