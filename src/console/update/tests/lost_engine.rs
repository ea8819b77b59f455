//! An engine that is silent, ends, or comes back: the messages, the pending stop, and the unchanged parts of the
//! view.

use super::*;
use crate::model::{EngineLink, ReconnectStatus, STOP_ANSWER_MS};
use holdpoint_protocol::command::{Refusal, Reply, StopPersistence};
use holdpoint_protocol::console_presence::{AttachedConsoleView, ConsolePresence};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_service::engine_handle::EngineEndError;
use holdpoint_wording::console as wording;

const SIZES: [(u16, u16); 5] = [(120, 36), (80, 24), (60, 16), (40, 12), (30, 3)];

fn refused(code: Refusal, text: &str) -> Reply {
    Reply::Refused { code, text: text.to_owned(), hint: None }
}

/// The request in this effect.
fn id(effects: &[Effect]) -> String {
    match effects {
        [Effect::Ask { id, .. } | Effect::Register { id, .. }] => id.clone(),
        other => panic!("{other:?}"),
    }
}

fn screen_text(console: &TestConsole, (columns, rows): (u16, u16)) -> String {
    console.screen(columns, rows).split_whitespace().collect::<Vec<_>>().join(" ")
}

fn later(console: &mut TestConsole, ms: u64) {
    console.now_ms += ms;
    console.tell(MsgKind::Tick);
}

/// The screen said that the arm was being stopped, and nothing more: the notice expired.
#[test]
fn an_unanswered_stop_is_shown_until_confirmed() {
    let mut console = TestConsole::new(0);
    let first = id(&console.keys("X"));
    assert!(
        !screen_text(&console, SIZES[0]).contains("NOT ANSWERED"),
        "a running engine has a moment to answer"
    );
    later(&mut console, STOP_ANSWER_MS);
    for minutes in 0..10 {
        for size in SIZES {
            let screen = screen_text(&console, size);
            assert!(screen.contains("NOT ANSWERED"), "{size:?} after {minutes} min: {screen}");
        }
        let screen = screen_text(&console, SIZES[1]);
        assert!(screen.contains("physical stop") && screen.contains("`holdpoint stop`"), "{screen}");
        later(&mut console, 60_000);
    }
    // A shell command without the store's path would stop another store's arm.
    let mut elsewhere = console.clone();
    elsewhere.model.data = Some("/srv/cell-2".to_owned());
    let screen = screen_text(&elsewhere, SIZES[0]);
    assert!(screen.contains("`holdpoint stop --data /srv/cell-2`"), "{screen}");
    // Whatever is open or typed, the warning stays in sight, and so does the typed text.
    console.keys(":pa");
    let screen = screen_text(&console, SIZES[1]);
    assert!(screen.contains("NOT ANSWERED") && screen.contains(":pa"), "{screen}");
    console.press(KeyCode::Esc);
    // A missing answer is not a confirmation.
    let why = "process 712 is silent";
    let reply = Box::new(refused(Refusal::NoAnswer, why));
    console.tell(MsgKind::Answer { id: first.clone(), reply });
    later(&mut console, 60_000);
    let screen = screen_text(&console, SIZES[0]);
    assert!(screen.contains("NOT CONFIRMED"), "{screen}");
    assert_eq!(screen.matches(why).count(), 1, "it appears in one place: {screen}");
    // Repeating the stop does not restart the count.
    let second = id(&console.keys("X"));
    assert_ne!(first, second);
    let screen = screen_text(&console, SIZES[0]);
    assert!(screen.contains("NOT ANSWERED") && screen.contains("for 66"), "{screen}");
    let accepted = Reply::Stopped { text: "the cell is stopped".to_owned(), kept: StopPersistence::OnRecord };
    let mut answered = console.clone();
    answered.tell(MsgKind::Answer { id: second, reply: Box::new(accepted) });
    assert!(!screen_text(&answered, SIZES[0]).contains("STOP NOT"));
    // A stopped cell is an answer, whatever its source.
    let mut now = snapshot(0, 'e');
    now.stopped = Some(StoppedView::first("bo".to_owned(), Caller::Script, String::new(), 61_000));
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    assert!(!screen_text(&console, SIZES[0]).contains("STOP NOT"));
}

fn is_stop(effects: &[Effect]) -> bool {
    matches!(effects, [Effect::Ask { question: EngineQuery::Stop { by }, .. }] if by == "ana")
}

/// The screen kept saying that nothing moves the arm while the engine answered, and the stop was never carried out.
#[test]
fn a_failed_stop_is_sent_again_once_the_engine_answers() {
    let mut console = TestConsole::new(0);
    let stop_id = id(&console.keys("X"));
    // An operator who comes meanwhile has asked for nothing.
    console.sit("bo");
    later(&mut console, 5_000);
    let why = "process 712 does not answer: a signal stopped it; nothing moves the arm meanwhile";
    let no_answer = || Box::new(refused(Refusal::NoAnswer, why));
    console.tell(MsgKind::Answer { id: stop_id.clone(), reply: no_answer() });
    console.press(KeyCode::Esc);
    assert!(screen_text(&console, SIZES[0]).contains("NOT CONFIRMED"), "nothing was heard since");
    let effects = console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e'))));
    assert!(is_stop(&effects), "{effects:?}");
    let again = id(&effects);
    assert_ne!(again, stop_id);
    let screen = screen_text(&console, SIZES[0]);
    assert!(screen.contains(wording::model::stop_not_answered(5, "").trim_end()), "{screen}");
    assert!(screen.contains(wording::engine_requests::STOP_SENT_AGAIN), "{screen}");
    assert!(!screen.contains("nothing moves"), "{screen}");
    // A stop under way is not sent twice, and a failed one not again with each camera frame.
    assert!(console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e')))).is_empty());
    console.tell(MsgKind::Answer { id: again, reply: no_answer() });
    assert!(console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e')))).is_empty());
    // Once the engine answers, the operator who asked for the stop may withdraw it.
    let mut taken_back = console.clone();
    taken_back.press(KeyCode::Esc);
    assert!(!screen_text(&taken_back, SIZES[0]).contains("STOP NOT"));
    later(&mut taken_back, 60_000);
    assert!(taken_back.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e')))).is_empty());
    later(&mut console, 1_000);
    assert!(is_stop(&console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e'))))));
}

fn attached() -> TestConsole {
    let mut console = TestConsole::new(0);
    console.tell(MsgKind::Attached(Some(811), None));
    console.tell(MsgKind::EngineStarted);
    let sitting = ConsolePresence {
        who: Some("bert".to_owned()),
        view: "Alarms".to_owned(),
        ..ConsolePresence::default()
    };
    let seat = |seat, sitting| AttachedConsoleView {
        seat,
        process: None,
        account: None,
        sitting,
        not_reading: false,
    };
    let seats = vec![seat(1, sitting), seat(2, ConsolePresence::default())];
    console.model.engine_data.console_number = Some(2);
    console.model.size = (120, 36);
    console.tell(MsgKind::Snapshot(Arc::new(Snapshot { seats, ..snapshot(0, 'e') })));
    assert!(screen_text(&console, SIZES[0]).contains("bert (Alarms)"));
    console
}

/// The names of the engine's other operators stayed on the screen after its death.
#[test]
fn a_lost_engine_has_no_consoles_and_is_searched_for() {
    for (why, expected) in [
        (
            EngineEndError::of("the engine at \"/data/engine.sock\" has ended"),
            ["ENGINE GONE", "last seen 00:01:00"],
        ),
        (EngineEndError::orderly("it shut down cleanly: bert ended it"), ["ENGINE ENDED", "cleanly: bert"]),
        (
            EngineEndError::reported("audit record 5 is bad: its content does not match its hash"),
            ["ENGINE GONE", "record 5"],
        ),
    ] {
        let mut console = attached();
        console.keys("7");
        console.tell(MsgKind::EngineEnded(Err(why)));
        console.tell(MsgKind::ReconnectFailed(ReconnectStatus {
            tries: 3,
            tries_max: 64,
            result: "no engine runs".to_owned(),
        }));
        later(&mut console, 60_000);
        let screen = screen_text(&console, SIZES[0]);
        assert!(expected.iter().all(|part| screen.contains(part)), "{screen}");
        for size in &SIZES[..2] {
            assert!(screen_text(&console, *size).contains("again 3/64"), "{}", screen_text(&console, *size));
        }
        assert!(
            !screen.contains("with bert") && console.model.engine_data.other_consoles().count() == 0,
            "{screen}"
        );
        assert!(screen.contains("STALE 1 min 0 s"), "the age of what is shown: {screen}");
        // The hints offer nothing of that engine, not even ending it.
        console.keys("1");
        let screen = screen_text(&console, SIZES[0]);
        for gone in ["x abort", "p pause", "leave it", "end engine", "00:02:00"] {
            assert!(!screen.contains(gone), "{gone}: {screen}");
        }
        assert!(screen.contains("q quit"), "{screen}");
        console.keys("7");
        // The command is kept for the next engine.
        console.tell(MsgKind::Attached(Some(902), None));
        console.tell(MsgKind::EngineStarted);
        console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e'))));
        let data = &console.model.engine_data;
        assert_eq!((console.model.view_state.view, data.link), (View::Audit, EngineLink::Attached));
        assert_eq!((&data.engine, &data.reconnect, data.process), (&EngineState::Running, &None, Some(902)));
        let screen = screen_text(&console, SIZES[0]);
        assert!(!screen.contains("ENGINE") && screen.contains("attached to"), "{screen}");
        // The view's data is requested again.
        assert!(matches!(
            &console.tell(MsgKind::Tick)[..],
            [Effect::Ask { question: EngineQuery::Audit(_), .. }]
        ));
    }
}

/// Text typed into a form goes nowhere without an engine.
#[test]
fn a_form_is_void_once_the_engine_is_lost() {
    let mut console = attached();
    console.keys(":goal grasp");
    console.press(KeyCode::Enter);
    console.keys("the tray");
    console.tell(MsgKind::EngineEnded(Err(EngineEndError::of("it has ended"))));
    let screen = screen_text(&console, SIZES[0]);
    assert!(screen.contains("NOT ASKED") && screen.contains("is gone"), "{screen}");
    assert!(screen.contains("the tray"), "what was typed can be read: {screen}");
    console.keys(" is empty");
    assert!(console.press(KeyCode::Enter).is_empty());
}

/// Requests to the lost engine get no answer: the window must not wait for ever.
#[test]
fn requests_to_a_lost_engine_are_not_waited_for() {
    let mut console = attached();
    let stop_id = id(&console.keys("X"));
    console.tell(MsgKind::EngineEnded(Err(EngineEndError::of("it has ended"))));
    console.tell(MsgKind::Attached(Some(902), None));
    assert!(!console.model.requests.pending.contains_key(&stop_id));
    assert!(screen_text(&console, SIZES[0]).contains("NOT CONFIRMED"), "its effect is unknown");
    // The operator wanted the arm to stop: the new engine gets the stop as well.
    later(&mut console, 5_000);
    console.tell(MsgKind::EngineStarted);
    let effects = console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e'))));
    assert!(is_stop(&effects), "{effects:?}");
}

/// A request without a passphrase leaves no field that could say it: only the log of keys did.
#[test]
fn a_request_to_a_lost_engine_is_named_on_the_screen() {
    let mut console = attached();
    console.keys(":pace 5");
    assert!(!console.press(KeyCode::Enter).is_empty());
    let mut asked = console.model.requests.pending.values().map(|pending| pending.what.clone());
    let what = asked.find(|what| !what.is_empty()).expect("the pace was asked for");
    console.tell(MsgKind::EngineEnded(Err(EngineEndError::of("it has ended"))));
    console.tell(MsgKind::Attached(Some(902), None));
    let notice = console.model.notice.as_ref().unwrap();
    assert!(notice.bad && notice.text.starts_with(&format!("{what}: ")), "{notice:?}");
}

fn event(seq: u64) -> Event {
    Event {
        seq,
        at_ms: seq.saturating_mul(1_000),
        kind: EventKind::Fault { text: format!("fault number {seq}") },
    }
}

fn event_texts(console: &TestConsole) -> Vec<&str> {
    console.model.engine_data.events.iter().map(|line| line.text.as_str()).collect()
}

/// A newly attached console showed "Nothing has happened yet" despite earlier events.
#[test]
fn earlier_events_are_shown_with_their_beginning() {
    let mut console = TestConsole::new(0);
    console.model.engine_data.events.clear();
    console.tell(MsgKind::Attached(Some(811), None));
    console.tell(MsgKind::Past { events: (10..13).map(event).collect(), earlier: 7 });
    console.tell(MsgKind::Events(vec![event(13)]));
    let lines = event_texts(&console);
    assert_eq!(lines.len(), 5, "{lines:?}");
    assert_eq!(lines[0], wording::engine_updates::log_begins_here(7));
    assert!(lines[1].contains("fault number 10") && lines[4].contains("fault number 13"), "{lines:?}");
    // The same engine repeats no event; another one counts from the start, and its log continues below.
    console.tell(MsgKind::EngineEnded(Err(EngineEndError::of("it has ended"))));
    console.tell(MsgKind::Attached(Some(811), None));
    console.tell(MsgKind::Past { events: (11..15).map(event).collect(), earlier: 8 });
    assert_eq!(event_texts(&console).len(), 6, "{:?}", event_texts(&console));
    let notice = &console.model.notice.as_ref().unwrap().text;
    assert_eq!(notice, wording::engine_updates::ATTACHED_AGAIN, "it was this console that stood still");
    console.tell(MsgKind::EngineEnded(Err(EngineEndError::of("it has ended"))));
    console.tell(MsgKind::Attached(Some(902), None));
    console.tell(MsgKind::Past { events: (0..2).map(event).collect(), earlier: 0 });
    console.tell(MsgKind::Events(vec![event(2)]));
    let lines = event_texts(&console);
    assert_eq!(lines[6], wording::engine_updates::ANOTHER_ENGINE_FOLLOWS);
    assert_eq!(lines[7], wording::engine_updates::ENGINE_BEGAN_HERE);
    assert!(lines[8].contains("fault number 0"), "{lines:?}");
    assert!(lines[10].contains("fault number 2"), "{lines:?}");
    let numbers: Vec<u64> = console.model.engine_data.events.iter().map(|line| line.seq).collect();
    assert!(numbers.is_sorted(), "{numbers:?}");
}

/// Another process numbers the events.
#[test]
fn the_largest_number_of_an_event_does_not_end_the_console() {
    let mut console = attached();
    console.tell(MsgKind::Events(vec![event(u64::MAX)]));
    console.tell(MsgKind::EngineEnded(Err(EngineEndError::of("it has ended"))));
    console.tell(MsgKind::Attached(Some(902), None));
    console.tell(MsgKind::Past { events: vec![event(u64::MAX)], earlier: 0 });
    assert_eq!(event_texts(&console).last(), Some(&wording::engine_updates::ANOTHER_ENGINE_FOLLOWS));
}

/// Old events open, close and report nothing.
#[test]
fn earlier_events_trigger_nothing() {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    now.stopped = Some(StoppedView::first("bo".to_owned(), Caller::Script, String::new(), 1_000));
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    console.keys("W");
    let by = || "cy".to_owned();
    let kinds = [
        EventKind::CellStopped { by: by(), caller: Caller::Script, reason: String::new() },
        EventKind::CellReleased { by: by(), caller: Caller::Script, reason: "checked".to_owned() },
    ];
    let events = kinds.into_iter().zip(2_000..).map(|(kind, at_ms)| Event { seq: at_ms, at_ms, kind });
    console.tell(MsgKind::Past { events: events.collect(), earlier: 0 });
    assert!(matches!(&console.model.input.overlay, Some(Overlay::Form(form)) if form.void.is_none()));
    assert!(console.model.notice.is_none() || !console.model.notice.as_ref().unwrap().text.contains("cy"));
}

/// `:demo` at two consoles at once: the second one named a version that was already registered.
#[test]
fn demonstration_candidate_used_elsewhere_is_followed_by_the_next() {
    let mut console = TestConsole::new(0);
    console.keys(":demo");
    let request_id = id(&console.press(KeyCode::Enter));
    let reply = Box::new(refused(Refusal::Exists, "align@1.1.0 is registered already"));
    let effects = console.tell(MsgKind::Answer { id: request_id.clone(), reply });
    assert!(matches!(&effects[..], [Effect::Register { folder: None, .. }]), "{effects:?}");
    assert_ne!(id(&effects), request_id);
    let notice = console.model.notice.as_ref().unwrap();
    let followed = wording::engine_updates::next_is_submitted("align@1.1.0 is registered already");
    assert!(notice.text == followed && !notice.bad, "{notice:?}");
    // A folder that the operator named is not replaced by another one.
    console.keys(":register /tmp/x");
    let request_id = id(&console.press(KeyCode::Enter));
    let reply = Box::new(refused(Refusal::Exists, "align@1.1.0 is registered already"));
    assert!(console.tell(MsgKind::Answer { id: request_id, reply }).is_empty());
}

/// The last console of an engine asked whether to end it, also where it may change nothing.
#[test]
fn a_read_only_console_leaves_its_engine() {
    for read_only in [false, true] {
        let mut console = TestConsole::new(0);
        console.model.settings.read_only = read_only;
        let effects = console.keys("q");
        assert_eq!(effects == [Effect::Leave], read_only, "{effects:?}");
        assert_eq!(console.model.input.overlay.is_none(), read_only);
    }
}

/// While no key arrives, no line offers one, at any size.
#[test]
fn a_terminal_in_line_mode_is_named_and_no_key_is_offered() {
    for size in [(120, 36), (80, 24), (60, 16), (40, 12)] {
        let mut console = TestConsole::new(0);
        console.model.data = Some("/srv/cell-2".to_owned());
        assert!(screen_text(&console, size).contains("X stop"), "{size:?}");
        console.tell(MsgKind::LineMode(true));
        let screen = screen_text(&console, size);
        assert!(screen.contains("`holdpoint stop --data /srv/cell-2`"), "{size:?}: {screen}");
        for offer in ["X stop", "q quit", "? keys", "? help"] {
            assert!(!screen.contains(offer), "{size:?}: {offer}: {screen}");
        }
        console.tell(MsgKind::LineMode(false));
        assert!(screen_text(&console, size).contains("X stop"), "{size:?}");
    }
}

/// The screen said that the engine is gone, and nothing of what brings one back.
#[test]
fn a_lost_engine_names_what_starts_the_next_one() {
    let look = |tries| ReconnectStatus { tries, tries_max: 64, result: "no engine runs".to_owned() };
    let shell = "`holdpoint --data /srv/cell`";
    let no_engine = wording::model::no_engine_runs("", "");
    for (why, is_sudden) in
        [(EngineEndError::of("it has ended"), true), (EngineEndError::orderly("bert ended it"), false)]
    {
        let mut console = attached();
        console.model.data = Some("/srv/cell".to_owned());
        assert!(!screen_text(&console, SIZES[0]).contains(no_engine.trim_end()));
        console.tell(MsgKind::EngineEnded(Err(why)));
        for (tries, expected) in
            [(3, wording::model::starts_in_a_shell(shell)), (64, wording::model::ends_and_starts("q", shell))]
        {
            console.tell(MsgKind::ReconnectFailed(look(tries)));
            // However long it takes to read.
            later(&mut console, 600_000);
            for size in &SIZES[..3] {
                let screen = screen_text(&console, *size);
                assert!(screen.contains(no_engine.trim_end()), "{size:?}: {screen}");
                assert!(screen.contains(&expected), "{size:?}: {screen}");
                assert_eq!(
                    screen.contains(&wording::model::then_start("W")),
                    is_sudden,
                    "{size:?}: {screen}"
                );
                assert!(screen.contains("X stop"), "{size:?}: {screen}");
            }
        }
    }
}

/// "no alarm" stood beside a dead engine as if it were a live value.
#[test]
fn no_alarm_of_a_lost_engine_has_its_time() {
    for ends in [true, false] {
        let mut console = TestConsole::new(0);
        let mut now = snapshot(0, 'e');
        (now.alarms, now.wall_ms) = (Vec::new(), Some(((18 * 60 + 31) * 60 + 56) * 1_000));
        now.alarm_summary = serde_json::from_value(json!({ "highest_unacknowledged": null,
            "unacknowledged": [0, 0, 0], "acknowledged": 0, "latched": 0, "shelved": 0, "flood": false }))
        .unwrap();
        console.tell(MsgKind::Snapshot(Arc::new(now)));
        for size in &SIZES[..4] {
            let screen = screen_text(&console, *size);
            assert!(screen.contains("no alarm") && !screen.contains("last seen"), "{size:?}: {screen}");
        }
        if ends {
            console.tell(MsgKind::EngineEnded(Err(EngineEndError::of("it has ended"))));
        } else {
            later(&mut console, 1_000);
        }
        for size in &SIZES[..4] {
            let screen = screen_text(&console, *size);
            let none = wording::status::none_last_seen("18:31:56", wording::status::NO_ALARM);
            assert!(screen.contains(&none), "{size:?}: {screen}");
        }
    }
}

/// A shelved alarm stood behind "no alarm".
#[test]
fn shelved_alarms_are_not_told_as_none() {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    now.alarms = vec![serde_json::from_value(alarm("high:1", "high", "shelved")).unwrap()];
    now.alarm_summary = serde_json::from_value(json!({ "highest_unacknowledged": null,
        "unacknowledged": [0, 0, 0], "acknowledged": 0, "latched": 0, "shelved": 1, "flood": false }))
    .unwrap();
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    for size in &SIZES[..4] {
        let screen = screen_text(&console, *size);
        let only = wording::status::ONLY_SHELVED_ALARMS;
        assert!(screen.contains(only) && !screen.contains("no alarm"), "{size:?}: {screen}");
    }
}

/// The last speed of a silent engine stood on the screen as if it were the present one.
#[test]
fn values_of_a_silent_engine_are_dated_and_dimmed_in_every_view() {
    let body = json!({ "links": [[0, 0, 0], [0, 0, 1]], "pads": [[0, 0, 1], [0, 0, 1]], "hand": [0, 0, 0, 1],
        "object": [0, 0, 0], "object_turn": [0, 0, 0, 1], "object_half_m": 0.02, "held": false });
    let frame = json!({ "sequence": 1, "at_ms": 59_000, "at_secs": 1.0, "task": null, "version": null, "body": body,
        "speed_m_s": 0.25, "force_n": 0, "contact_n": 0, "envelope": null, "contacts": [], "blocks": [],
        "unexpected_contact": false, "stopped": false, "twin": null });
    let dims = |console: &TestConsole| {
        let area = Rect::new(0, 0, 120, 36);
        let mut buffer = ratatui::buffer::Buffer::empty(area);
        let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Ascii);
        crate::frame::draw(&console.model, &look, area, &mut buffer);
        buffer.cell((4, 12)).unwrap().modifier.contains(ratatui::style::Modifier::DIM)
    };
    for view in View::ALL {
        let mut console = TestConsole::new(0);
        let mut now = snapshot(0, 'e');
        now.wall_ms = Some(((18 * 60 + 31) * 60 + 56) * 1_000);
        console.tell(MsgKind::Snapshot(Arc::new(now.clone())));
        console.tell(MsgKind::VideoFrame(Arc::new(serde_json::from_value(frame.clone()).unwrap())));
        console.model.view_state.view = view;
        later(&mut console, 999);
        assert!(!screen_text(&console, SIZES[0]).contains("last seen"), "{view:?}");
        later(&mut console, 1);
        for size in &SIZES[..2] {
            let screen = screen_text(&console, *size);
            assert!(screen.contains(&wording::banner::last_seen("18:31:56")), "{view:?}: {screen}");
        }
        assert!(dims(&console), "{view:?}");
        if view == View::Overview {
            let screen = screen_text(&console, SIZES[0]);
            let dated = format!("{}at rest 0.25 m/s", wording::robot::last_seen("18:31:56"));
            assert!(screen.contains(&dated), "{screen}");
        }
        // The engine answers again.
        console.tell(MsgKind::Snapshot(Arc::new(now)));
        assert!(!screen_text(&console, SIZES[0]).contains("last seen"), "{view:?}");
    }
}
