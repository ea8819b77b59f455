//! An engine that is silent, ends, or comes back: what is said of it, what is done about a stop, and what stays where it was.

use super::*;
use crate::model::{EngineLink, STOP_ANSWER_MS, Seeking};
use holdpoint_engine::host::EndFault;
use holdpoint_protocol::command::{Refusal, Reply, StopKept};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::seat::{SeatView, Sitting};

const SIZES: [(u16, u16); 5] = [(120, 36), (80, 24), (60, 16), (40, 12), (30, 3)];

fn refused(code: Refusal, text: &str) -> Reply {
    Reply::Refused { code, text: text.to_owned(), hint: None }
}

/// What is asked with this effect.
fn id(effects: &[Effect]) -> String {
    match effects {
        [Effect::Ask { id, .. } | Effect::Register { id, .. }] => id.clone(),
        other => panic!("{other:?}"),
    }
}

fn words(console: &TestConsole, (columns, rows): (u16, u16)) -> String {
    console.screen(columns, rows).split_whitespace().collect::<Vec<_>>().join(" ")
}

fn later(console: &mut TestConsole, ms: u64) {
    console.now_ms += ms;
    console.tell(MsgKind::Tick);
}

/// It said that the arm was being stopped, and nothing more: the notice went by itself.
#[test]
fn a_stop_that_nobody_answers_is_said_until_something_confirms_it() {
    let mut console = TestConsole::new(0);
    let first = id(&console.keys("X"));
    assert!(!words(&console, SIZES[0]).contains("NOT ANSWERED"), "an engine at work has a moment to answer");
    later(&mut console, STOP_ANSWER_MS);
    for minutes in 0..10 {
        for size in SIZES {
            let screen = words(&console, size);
            assert!(screen.contains("STOP NOT ANSWERED for"), "{size:?} after {minutes} min: {screen}");
        }
        let screen = words(&console, SIZES[1]);
        assert!(screen.contains("physical stop") && screen.contains("`holdpoint stop`"), "{screen}");
        later(&mut console, 60_000);
    }
    // In a shell without a word it would be another store's arm.
    let mut elsewhere = console.clone();
    elsewhere.model.data = Some("/srv/cell-2".to_owned());
    let screen = words(&elsewhere, SIZES[0]);
    assert!(screen.contains("`holdpoint stop --data /srv/cell-2` does so in a shell"), "{screen}");
    // Whatever is open or typed, it stays in sight, and so does what is typed.
    console.keys(":pa");
    let screen = words(&console, SIZES[1]);
    assert!(screen.contains("STOP NOT ANSWERED for") && screen.contains(":pa"), "{screen}");
    console.press(KeyCode::Esc);
    // That nobody was there to answer is no answer.
    let reply = Box::new(refused(Refusal::NoAnswer, "process 712 does not answer: a signal stopped it"));
    console.tell(MsgKind::Answer { id: first.clone(), reply });
    later(&mut console, 60_000);
    let screen = words(&console, SIZES[0]);
    assert!(screen.contains("STOP NOT CONFIRMED") && screen.contains("a signal stopped it"), "{screen}");
    assert_eq!(screen.matches("a signal stopped it").count(), 1, "it is said in one place: {screen}");
    // Asking again begins no new count.
    let second = id(&console.keys("X"));
    assert_ne!(first, second);
    assert!(words(&console, SIZES[0]).contains("STOP NOT ANSWERED for 66"), "{}", words(&console, SIZES[0]));
    let accepted = Reply::Stopped { text: "the cell is stopped".to_owned(), kept: StopKept::OnRecord };
    let mut answered = console.clone();
    answered.tell(MsgKind::Answer { id: second, reply: Box::new(accepted) });
    assert!(!words(&answered, SIZES[0]).contains("STOP NOT"));
    // A cell that stands is an answer, whoever gives it.
    let mut now = snapshot(0, 'e');
    now.stopped = Some(StoppedView::first("bo".to_owned(), Caller::Script, String::new(), 61_000));
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    assert!(!words(&console, SIZES[0]).contains("STOP NOT"));
}

fn asks_for_a_stop(effects: &[Effect]) -> bool {
    matches!(effects, [Effect::Ask { question: Question::Stop { by }, .. }] if by == "ana")
}

/// It went on saying that nothing moves the arm while the engine answered, and the stop was never carried out.
#[test]
fn a_stop_that_came_to_nothing_is_asked_for_again_once_the_engine_is_heard() {
    let mut console = TestConsole::new(0);
    let asked = id(&console.keys("X"));
    // Whoever sits down meanwhile has asked for nothing.
    console.sit("bo");
    later(&mut console, 5_000);
    let why = "process 712 does not answer: a signal stopped it; nothing moves the arm meanwhile";
    let no_answer = || Box::new(refused(Refusal::NoAnswer, why));
    console.tell(MsgKind::Answer { id: asked.clone(), reply: no_answer() });
    console.press(KeyCode::Esc);
    assert!(words(&console, SIZES[0]).contains("STOP NOT CONFIRMED"), "nothing was heard since");
    let effects = console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e'))));
    assert!(asks_for_a_stop(&effects), "{effects:?}");
    let again = id(&effects);
    assert_ne!(again, asked);
    let screen = words(&console, SIZES[0]);
    assert!(screen.contains("STOP NOT ANSWERED for 5 s") && screen.contains("asked for again"), "{screen}");
    assert!(!screen.contains("nothing moves the arm"), "{screen}");
    // It is under way: nothing is asked for twice, and where it fails at once, not with every picture.
    assert!(console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e')))).is_empty());
    console.tell(MsgKind::Answer { id: again, reply: no_answer() });
    assert!(console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e')))).is_empty());
    // Whoever asked for it may take it back, now that the engine is heard.
    let mut taken_back = console.clone();
    taken_back.press(KeyCode::Esc);
    assert!(!words(&taken_back, SIZES[0]).contains("STOP NOT"));
    later(&mut taken_back, 60_000);
    assert!(taken_back.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e')))).is_empty());
    later(&mut console, 1_000);
    assert!(asks_for_a_stop(&console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e'))))));
}

fn attached() -> TestConsole {
    let mut console = TestConsole::new(0);
    console.tell(MsgKind::Seated(Some(811), None));
    console.tell(MsgKind::EngineStarted);
    let sitting = Sitting { who: Some("bert".to_owned()), view: "Alarms".to_owned(), ..Sitting::default() };
    let seat = |seat, sitting| SeatView { seat, process: None, sitting, not_reading: false };
    let seats = vec![seat(1, sitting), seat(2, Sitting::default())];
    console.model.told.seat = Some(2);
    console.model.size = (120, 36);
    console.tell(MsgKind::Snapshot(Arc::new(Snapshot { seats, ..snapshot(0, 'e') })));
    assert!(words(&console, SIZES[0]).contains("with bert (Alarms)"));
    console
}

/// The names of those who sat at it stayed on the screen after the engine's death.
#[test]
fn an_engine_that_is_gone_has_no_seats_and_is_looked_for() {
    for (why, said) in [
        (
            EndFault::of("the engine at \"/data/engine.sock\" has ended"),
            "ENGINE GONE (looks again 3/64), last heard 00:01:00",
        ),
        (
            EndFault::orderly("it ended in good order: bert ended it"),
            "ENGINE ENDED (looks again 3/64): it ended in good order: bert",
        ),
        (
            EndFault::told("audit record 5 is bad: its content does not match its hash"),
            "ENGINE GONE (looks again 3/64): audit record 5 is bad: its content",
        ),
    ] {
        let mut console = attached();
        console.keys("7");
        console.tell(MsgKind::EngineEnded(Err(why)));
        console.tell(MsgKind::Sought(Seeking {
            tries: 3,
            tries_max: 64,
            said: "none is at work".to_owned(),
        }));
        later(&mut console, 60_000);
        let screen = words(&console, SIZES[0]);
        assert!(screen.contains(said), "{screen}");
        assert!(words(&console, SIZES[1]).contains("(looks again 3/64)"), "{}", words(&console, SIZES[1]));
        assert!(!screen.contains("with bert") && console.model.told.others().count() == 0, "{screen}");
        assert!(screen.contains("STALE 1 min 0 s"), "the age of what is shown: {screen}");
        // Neither what that engine would do is offered, nor the way out of it.
        console.keys("1");
        let screen = words(&console, SIZES[0]);
        for gone in ["x abort", "p hold", "leave it on", "end engine", "00:02:00"] {
            assert!(!screen.contains(gone), "{gone}: {screen}");
        }
        assert!(screen.contains("q quit"), "{screen}");
        console.keys("7");
        // The place is kept for when there is one.
        console.tell(MsgKind::Seated(Some(902), None));
        console.tell(MsgKind::EngineStarted);
        console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e'))));
        let told = &console.model.told;
        assert_eq!((console.model.place.view, told.link), (View::Audit, EngineLink::Attached));
        assert_eq!((&told.engine, &told.seeking, told.process), (&EngineState::Running, &None, Some(902)));
        let screen = words(&console, SIZES[0]);
        assert!(!screen.contains("ENGINE") && screen.contains("sits at it"), "{screen}");
        // What the view shows is asked for anew.
        assert!(matches!(
            &console.tell(MsgKind::Tick)[..],
            [Effect::Ask { question: Question::Audit(_), .. }]
        ));
    }
}

/// What is typed into a form goes nowhere once nobody is there to ask.
#[test]
fn a_form_that_is_open_when_the_engine_goes_is_for_nothing() {
    let mut console = attached();
    console.keys(":goal grasp");
    console.press(KeyCode::Enter);
    console.keys("the tray");
    console.tell(MsgKind::EngineEnded(Err(EndFault::of("it has ended"))));
    let screen = words(&console, SIZES[0]);
    assert!(screen.contains("NOT ASKED, and no longer possible: the engine is gone"), "{screen}");
    assert!(screen.contains("the tray"), "what was typed can be read: {screen}");
    console.keys(" is empty");
    assert!(console.press(KeyCode::Enter).is_empty());
}

/// What was handed to the engine that is gone is answered by nobody: the window must not wait for ever.
#[test]
fn what_was_asked_of_an_engine_that_is_gone_is_not_waited_for() {
    let mut console = attached();
    let asked = id(&console.keys("X"));
    console.tell(MsgKind::EngineEnded(Err(EndFault::of("it has ended"))));
    console.tell(MsgKind::Seated(Some(902), None));
    assert!(!console.model.asking.pending.contains_key(&asked));
    assert!(words(&console, SIZES[0]).contains("STOP NOT CONFIRMED"), "nobody knows what became of it");
    // Whoever asked for it wanted the arm to stand: the engine that is at work now is asked as well.
    later(&mut console, 5_000);
    console.tell(MsgKind::EngineStarted);
    let effects = console.tell(MsgKind::Snapshot(Arc::new(snapshot(0, 'e'))));
    assert!(asks_for_a_stop(&effects), "{effects:?}");
}

fn event(seq: u64) -> Event {
    Event { seq, at_ms: seq * 1_000, kind: EventKind::Fault { text: format!("fault number {seq}") } }
}

fn story(console: &TestConsole) -> Vec<&str> {
    console.model.told.story.iter().map(|line| line.text.as_str()).collect()
}

/// Whoever attached saw "Nothing has happened yet", whatever had happened.
#[test]
fn what_happened_before_is_told_and_says_where_it_begins() {
    let mut console = TestConsole::new(0);
    console.model.told.story.clear();
    console.tell(MsgKind::Seated(Some(811), None));
    console.tell(MsgKind::Past { events: (10..13).map(event).collect(), earlier: 7 });
    console.tell(MsgKind::Events(vec![event(13)]));
    let told = story(&console);
    assert_eq!(told.len(), 5, "{told:?}");
    assert!(told[0].contains("begins here; 7 earlier events"), "{told:?}");
    assert!(told[1].contains("fault number 10") && told[4].contains("fault number 13"), "{told:?}");
    // The same engine tells nothing twice; another one counts from the start, and its story goes on below.
    console.tell(MsgKind::EngineEnded(Err(EndFault::of("it has ended"))));
    console.tell(MsgKind::Seated(Some(811), None));
    console.tell(MsgKind::Past { events: (11..15).map(event).collect(), earlier: 8 });
    assert_eq!(story(&console).len(), 6, "{:?}", story(&console));
    let said = &console.model.notice.as_ref().unwrap().text;
    assert!(
        said.contains("the engine was at work all along"),
        "it was this console that stood still: {said}"
    );
    console.tell(MsgKind::EngineEnded(Err(EndFault::of("it has ended"))));
    console.tell(MsgKind::Seated(Some(902), None));
    console.tell(MsgKind::Past { events: (0..2).map(event).collect(), earlier: 0 });
    console.tell(MsgKind::Events(vec![event(2)]));
    let told = story(&console);
    assert!(told[6].contains("another one tells what follows"), "{told:?}");
    assert!(told[7].contains("began here") && told[8].contains("fault number 0"), "{told:?}");
    assert!(told[10].contains("fault number 2"), "{told:?}");
    let numbers: Vec<u64> = console.model.told.story.iter().map(|line| line.seq).collect();
    assert!(numbers.is_sorted(), "{numbers:?}");
}

/// Old events are no news: nothing of them opens, closes or says anything.
#[test]
fn what_happened_before_is_no_news() {
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
    assert!(matches!(&console.model.entry.overlay, Some(Overlay::Form(form)) if form.void.is_none()));
    assert!(console.model.notice.is_none() || !console.model.notice.as_ref().unwrap().text.contains("cy"));
}

/// `:demo` at two seats at once: the second one was told that a version it had never named is registered already.
#[test]
fn a_demonstration_that_somebody_else_was_quicker_with_is_followed_by_the_next() {
    let mut console = TestConsole::new(0);
    console.keys(":demo");
    let asked = id(&console.press(KeyCode::Enter));
    let reply = Box::new(refused(Refusal::Exists, "align@1.1.0 is registered already"));
    let effects = console.tell(MsgKind::Answer { id: asked.clone(), reply });
    assert!(matches!(&effects[..], [Effect::Register { folder: None, .. }]), "{effects:?}");
    assert_ne!(id(&effects), asked);
    let said = console.model.notice.as_ref().unwrap();
    assert!(
        said.text.contains("somebody else") && said.text.contains("the next one") && !said.bad,
        "{said:?}"
    );
    // A folder that somebody named is that folder and no other.
    console.keys(":register /tmp/x");
    let asked = id(&console.press(KeyCode::Enter));
    let reply = Box::new(refused(Refusal::Exists, "align@1.1.0 is registered already"));
    assert!(console.tell(MsgKind::Answer { id: asked, reply }).is_empty());
}
