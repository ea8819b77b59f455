//! A form says what is so now: it follows how things stand, or closes with a word; and who must be known is asked
//! for before anything is typed.

use super::*;
use holdpoint_governance::lifecycle::{Flags, State};
use holdpoint_protocol::command::Operation;
use holdpoint_protocol::event::{Event, EventKind};

fn stopped(by: &str, since_ms: u64) -> Snapshot {
    let mut now = snapshot(0, 'e');
    now.stopped = Some(StoppedView {
        by: by.to_owned(),
        caller: Caller::Script,
        reason: "a hand in the cell".to_owned(),
        since_ms,
        stood_after_ticks: None,
    });
    now
}

fn told(console: &mut TestConsole, now: Snapshot) {
    console.tell(MsgKind::Snapshot(Arc::new(now)));
}

fn form(console: &TestConsole) -> Option<&crate::form::Form> {
    match &console.model.entry.overlay {
        Some(Overlay::Form(form)) => Some(form),
        _ => None,
    }
}

fn notice(console: &TestConsole) -> String {
    console.model.notice.as_ref().map(|notice| notice.text.clone()).unwrap_or_default()
}

fn confirm(console: &mut TestConsole) -> Vec<Effect> {
    console.keys("a test");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    console.press(KeyCode::Enter)
}

fn command(effects: &[Effect]) -> Command {
    let [Effect::Operate { confirmed, .. }] = effects else { panic!("{effects:?}") };
    confirmed.as_ref().clone().into_command()
}

#[test]
fn letting_the_cell_work_is_about_the_stop_that_was_read() {
    let mut console = TestConsole::new(0);
    told(&mut console, stopped("bo", 1_000));
    console.keys("W");
    assert_eq!(form(&console).unwrap().intent.title(), "Let the stopped cell work again");
    // The same stop goes on: nothing changes, whatever else does.
    console.keys("clear");
    let mut again = stopped("bo", 1_000);
    again.at_ms += 5_000;
    told(&mut console, again);
    assert!(form(&console).is_some_and(|form| form.problem.is_none() && form.reason.text() == "clear"));
    // Somebody stopped it once more.
    told(&mut console, stopped("cy", 61_000));
    assert!(form(&console).is_none());
    assert!(notice(&console).contains("cy has stopped it anew"), "{}", notice(&console));
    // Also where the engine keeps the first stop as the one that counts.
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
    assert!(form(&console).is_some(), "that is the stop that was read");
    console.tell(MsgKind::Events(vec![stop(62_000)]));
    assert!(form(&console).is_none());
    assert!(notice(&console).contains("di has stopped it anew"), "{}", notice(&console));
    // Or let it work.
    console.keys("W");
    told(&mut console, snapshot(0, 'e'));
    assert!(form(&console).is_none());
    assert!(notice(&console).contains("let it work already"), "{}", notice(&console));
}

#[test]
fn what_needs_a_person_says_so_before_anything_is_typed() {
    for (before, key) in [("", "p"), ("", "F"), ("", "D"), ("5G", "R"), ("", "W"), ("", ":goal grasp\r")] {
        let mut console = TestConsole::new(0);
        console.model.seat.operator = None;
        told(&mut console, stopped("bo", 1_000));
        console.keys(before);
        for letter in key.chars() {
            console.press(if letter == '\r' { KeyCode::Enter } else { KeyCode::Char(letter) });
        }
        assert!(form(&console).is_none(), "{key}");
        assert!(notice(&console).contains(":as NAME"), "{key}: {}", notice(&console));
    }
    // Stopping and leaving need nobody.
    for key in ["x", "q"] {
        let mut console = TestConsole::new(0);
        console.model.seat.operator = None;
        console.keys(key);
        assert!(form(&console).is_some(), "{key}");
    }
}

#[test]
fn a_form_follows_its_version_and_asks_to_be_read_again() {
    let mut console = TestConsole::new(0);
    console.keys("F");
    assert!(form(&console).unwrap().consequences[0].contains("shadowed"));
    console.keys("no good");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    let mut now = snapshot(0, 'e');
    now.candidates[0].state = State::Demoted;
    now.candidates[0].flags = Flags::default();
    told(&mut console, now);
    let open = form(&console).unwrap();
    assert!(open.consequences[0].contains("demoted") && open.problem.is_some(), "{open:?}");
    // What fires is what was read: the button lost the keys.
    assert!(console.press(KeyCode::Enter).is_empty());
    assert!(form(&console).is_none(), "that was Cancel");
}

#[test]
fn a_form_closes_when_it_would_be_for_something_else() {
    type Change = fn(&mut Snapshot);
    let moved: [(&str, Change); 4] = [
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
        told(&mut console, now);
        assert!(form(&console).is_none(), "{key}");
        assert!(notice(&console).contains("not asked"), "{key}: {}", notice(&console));
    }
    // The way back goes away while somebody reads that it takes over.
    let mut console = TestConsole::new(0);
    console.keys("2");
    let mut now = snapshot(0, 'e');
    now.candidates.clear();
    now.families[0].flags = Some(Flags { provisional: true, ..Flags::default() });
    told(&mut console, now.clone());
    console.keys("1x");
    assert!(matches!(
        form(&console).map(|form| &form.intent),
        Some(Intent::Abort(crate::form::Abort::Active(_)))
    ));
    now.families[0].pinned = None;
    told(&mut console, now);
    assert!(form(&console).is_none(), "it would stop the family now");
}

#[test]
fn an_alarm_that_is_gone_closes_its_form() {
    let mut console = TestConsole::new(0);
    console.keys("5");
    console.press(KeyCode::Char('z'));
    assert!(form(&console).is_some(), "{}", notice(&console));
    let mut now = snapshot(0, 'e');
    now.alarms.remove(0);
    told(&mut console, now);
    assert!(form(&console).is_none());
    assert!(notice(&console).contains("normal again"), "{}", notice(&console));
}

/// The console's keys and the verbs `pause` and `resume` have one rule.
#[test]
fn holding_and_letting_go_have_the_verbs_rule() {
    for state in State::ALL {
        for bits in 0..8u8 {
            let flags = Flags { paused: bits & 1 > 0, provisional: bits & 2 > 0, ..Flags::default() };
            let held = bits & 4 > 0;
            for (key, allowed) in [("p", state.may_pause(&flags)), ("u", state.may_resume(&flags, held))] {
                let mut console = TestConsole::new(0);
                let mut now = snapshot(0, 'e');
                (now.candidates[0].state, now.candidates[0].flags) = (state, flags);
                now.candidates[0].held = held;
                told(&mut console, now);
                console.keys(key);
                assert_eq!(form(&console).is_some(), allowed, "{key} on {state} {flags:?} held {held}");
            }
        }
    }
}

#[test]
fn the_promotion_of_a_provisional_version_is_held_and_let_go_on_from_the_keyboard() {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    now.candidates[0].state = State::Active;
    now.candidates[0].flags = Flags { provisional: true, ..Flags::default() };
    told(&mut console, now.clone());
    console.keys("p");
    assert!(form(&console).unwrap().consequences[1].contains("keeps the arm"));
    let asked = command(&confirm(&mut console));
    let operation =
        Operation { version: CANDIDATE.parse().unwrap(), by: "ana".to_owned(), reason: "a test".to_owned() };
    assert_eq!(asked, Command::Pause(operation.clone()));
    now.candidates[0].flags.paused = true;
    told(&mut console, now);
    console.keys("u");
    assert!(form(&console).unwrap().consequences[0].contains("active, provisional, promotion paused"));
    assert_eq!(command(&confirm(&mut console)), Command::Resume(operation));
}

#[test]
fn what_is_frozen_is_story_and_charts_alone() {
    let mut console = TestConsole::new(0);
    console.keys("f");
    let mut now = stopped("bo", 60_500);
    now.families[0].active = Some("grasp@1.3.0".parse().unwrap());
    told(&mut console, now);
    let frozen = console.model.place.frozen.as_ref().unwrap();
    assert_eq!(frozen.at_ms, 60_000, "in the engine's time, as everything on the screen");
    assert!(console.model.told.snapshot.as_ref().unwrap().stopped.is_some());
    assert!(console.model.charted().unwrap().stopped.is_none());
    console.keys("f");
    assert!(console.model.place.frozen.is_none());
}
