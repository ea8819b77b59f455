//! Several consoles at one engine: the presence that one reports, and the others that it shows.

use super::*;
use crate::approval_screen::ClosingAnswer;
use crate::model::{EngineLink, EventLogLine, SharedLine};
use holdpoint_protocol::account_role::AccountRole;
use holdpoint_protocol::console_presence::{AttachedConsoleView, ConsoleAccount, ConsolePresence};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_service::control_socket::AnswerOrigin;
use holdpoint_wording::console as wording;

fn event(seq: u64, kind: EventKind) -> Event {
    Event { seq, at_ms: 60_000 + seq, kind }
}

fn console_view(seat: u64, who: Option<&str>, reading: Option<&str>) -> AttachedConsoleView {
    let reading = reading.map(|version| version.parse().unwrap());
    let who = who.map(ToOwned::to_owned);
    AttachedConsoleView {
        seat,
        process: None,
        account: None,
        sitting: ConsolePresence { who, view: "Alarms".to_owned(), reading, read_only: false },
        not_reading: false,
    }
}

fn with_consoles(console: &mut TestConsole, seats: Vec<AttachedConsoleView>) {
    console.model.engine_data.console_number = Some(2);
    console.tell(MsgKind::Snapshot(Arc::new(Snapshot { seats, ..snapshot(0, 'e') })));
}

#[test]
fn a_console_reports_its_view_and_its_open_request() {
    let mut console = TestConsole::new(0);
    let attachment =
        |console: &TestConsole| (console.model.attachment().view, console.model.attachment().reading);
    assert_eq!(console.model.attachment().who.as_deref(), Some("ana"));
    assert_eq!(attachment(&console), ("Overview".to_owned(), None));
    console.keys("a");
    console.press(KeyCode::Enter);
    assert_eq!(attachment(&console), ("Approvals".to_owned(), Some(CANDIDATE.parse().unwrap())));
    // Once it is closed, no console reads it.
    console.tell(MsgKind::Snapshot(Arc::new(Snapshot { prompts: Vec::new(), ..snapshot(0, 'e') })));
    assert_eq!(attachment(&console).1, None);
}

#[test]
fn the_engine_accepts_the_title_of_every_view() {
    for view in View::ALL {
        let sitting = ConsolePresence { view: view.title().to_owned(), ..ConsolePresence::default() };
        assert_eq!(sitting.invalid_field(), None, "{view:?}");
    }
}

#[test]
fn other_consoles_exclude_this_console() {
    let mut console = TestConsole::new(0);
    with_consoles(
        &mut console,
        vec![
            console_view(1, Some("bert"), None),
            console_view(2, Some("ana"), None),
            console_view(7, None, None),
        ],
    );
    let others: Vec<u64> = console.model.engine_data.other_consoles().map(|one| one.seat).collect();
    assert_eq!(others, [1, 7]);
    console.model.engine_data.console_number = None;
    assert_eq!(
        console.model.engine_data.other_consoles().count(),
        0,
        "which seat is its own is not known yet"
    );
}

/// The text of a screen of this size.
fn screen(console: &TestConsole, columns: u16, rows: u16) -> String {
    let model = ConsoleModel { size: (columns, rows), ..console.model.clone() };
    let area = Rect::new(0, 0, columns, rows);
    let mut buffer = ratatui::buffer::Buffer::empty(area);
    let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Ascii);
    crate::frame::draw(&model, &look, area, &mut buffer);
    buffer.content.iter().map(ratatui::buffer::Cell::symbol).collect()
}

#[test]
fn every_screen_size_shows_other_consoles() {
    let mut console = TestConsole::new(0);
    with_consoles(
        &mut console,
        vec![console_view(1, Some("bert"), Some(CANDIDATE)), console_view(2, Some("ana"), None)],
    );
    assert!(screen(&console, 120, 36).contains(&format!("bert (reads {CANDIDATE})")));
    assert!(screen(&console, 100, 30).contains("with bert"));
    assert!(screen(&console, 80, 24).contains("with bert"));
    let mut looks_on = console_view(1, Some("bert"), None);
    looks_on.sitting.read_only = true;
    with_consoles(&mut console, vec![looks_on, console_view(2, Some("ana"), None)]);
    assert!(screen(&console, 120, 36).contains(&format!("bert, read-only ({})", View::Alarms.title())));
    let mut other = console_view(1, Some("bert"), None);
    other.sitting.view = "Administrator".to_owned();
    with_consoles(&mut console, vec![other, console_view(2, Some("ana"), None)]);
    let screen = screen(&console, 120, 36);
    assert!(screen.contains("with bert") && !screen.contains("Administrator"), "{screen}");
}

#[test]
fn an_answer_from_another_console_is_named() {
    let mut console = TestConsole::new(0);
    console.keys("a");
    console.press(KeyCode::Enter);
    let answer = |version: &str| EventKind::ApprovalReceived {
        version: version.parse().unwrap(),
        by: "bert\u{1b}[2J".to_owned(),
        decision: ApprovalDecision::Reject,
        reason: "no".to_owned(),
        have: 0,
        needed: 2,
    };
    let yes = |have| EventKind::ApprovalReceived {
        version: CANDIDATE.parse().unwrap(),
        by: "carl".to_owned(),
        decision: ApprovalDecision::Approve,
        reason: "read".to_owned(),
        have,
        needed: 2,
    };
    let answered = |console: &TestConsole| match &console.model.input.overlay {
        Some(Overlay::Approval(prompt)) => prompt.answered.clone(),
        other => panic!("{other:?}"),
    };
    console.tell(MsgKind::Events(vec![event(1, answer("place@1.0.1"))]));
    assert_eq!(answered(&console), None, "that was about another one");
    console.tell(MsgKind::Events(vec![event(2, answer(CANDIDATE))]));
    let answer = answered(&console).unwrap();
    assert!(answer.by.starts_with("bert") && !answer.by.contains('\u{1b}'), "{answer:?}");
    assert_eq!(answer.decision, ApprovalDecision::Reject);
    console.tell(MsgKind::Events(vec![event(3, yes(1))]));
    assert_eq!(answered(&console), None, "one of two closes nothing");
    console.tell(MsgKind::Events(vec![event(4, yes(2))]));
    let carl = ClosingAnswer { by: "carl".to_owned(), decision: ApprovalDecision::Approve };
    assert_eq!(answered(&console), Some(carl));
}

#[test]
fn leaving_ends_only_an_own_engine() {
    let (leaves, keeps) = (Some(Effect::Leave), Some(Effect::Detach));
    for (link, ends_alone_s, others, quits, detaches) in [
        (EngineLink::Own, None, 0, None, None),
        (EngineLink::Attached, None, 0, leaves.clone(), keeps.clone()),
        // An engine started by a console ends with the last console, unless it was asked to keep running.
        (EngineLink::Attached, Some(60), 0, None, keeps.clone()),
        (EngineLink::Attached, Some(60), 1, leaves, keeps),
    ] {
        let mut console = TestConsole::new(0);
        console.model.engine_data.link = link;
        console.model.engine_data.console_number = Some(9);
        let seats = (0..others).map(|number| console_view(number, None, None)).collect();
        let now = Snapshot { seats, ends_alone_s, ..snapshot(0, 'e') };
        console.tell(MsgKind::Snapshot(Arc::new(now)));
        console.model.notice = None;
        let hint = match (link, &quits) {
            (EngineLink::Own, _) => "q quit",
            (EngineLink::Attached, None) => "q end",
            (EngineLink::Attached, Some(_)) => "q leave",
        };
        assert!(screen(&console, 120, 36).contains(hint), "{hint}: {}", screen(&console, 120, 36));
        console.keys(":detach");
        assert_eq!(console.press(KeyCode::Enter).pop(), detaches, "{link:?}");
        if detaches.is_none() {
            let notice = console.model.notice.as_ref().unwrap();
            assert!(notice.bad && notice.text.contains("--in-process"), "{notice:?}");
        }
        assert_eq!(console.keys("q").pop(), quits, "{link:?}");
        // If it would end the engine, it asks first.
        assert_eq!(console.model.input.overlay.is_some(), quits.is_none(), "{link:?}");
    }
}

#[test]
fn frequent_events_do_not_fill_the_event_log() {
    let sequence = |index| EventKind::Sequence { index, success: true, tasks: Vec::new(), refused: None };
    let past = |version: &str, danger| EventKind::HarmPastLimit {
        version: version.parse().unwrap(),
        task: 1,
        sequence: None,
        past: Vec::new(),
        danger,
        tasks_past: 1,
    };
    let lines = |kinds: Vec<EventKind>| {
        let mut console = TestConsole::new(0);
        console.model.engine_data.events.clear();
        console.tell(MsgKind::Events((0..).zip(kinds).map(|(seq, kind)| event(seq, kind)).collect()));
        let count = |line: &EventLogLine| match line.shared {
            Some(SharedLine::Sequences { count, .. } | SharedLine::TasksPastLimit { count, .. }) => count,
            None => 0,
        };
        let events = &console.model.engine_data.events;
        events.iter().map(|line| (line.seq, count(line))).collect::<Vec<_>>()
    };
    let fault = || EventKind::Fault { text: "something else".to_owned() };
    let mut kinds: Vec<EventKind> = (0..40).map(sequence).collect();
    kinds.extend([fault(), sequence(41)]);
    assert_eq!(
        lines(kinds),
        [(39, 40), (40, 0), (41, 1)],
        "the newest of each run, and how many events share its line"
    );
    // Each sequence with a task of two versions past a limit: three lines, in the order of their newest events.
    let rounds =
        (0..10).flat_map(|index| [past("grasp@1.0.0", false), past("place@1.0.0", false), sequence(index)]);
    let mut kinds: Vec<EventKind> = rounds.collect();
    kinds.extend([past("grasp@1.0.0", true), past("grasp@1.0.0", false)]);
    assert_eq!(lines(kinds), [(27, 10), (28, 10), (29, 10), (30, 0), (31, 1)], "a danger has its own line");
}

#[test]
fn versions_are_found_by_state() {
    let mut console = TestConsole::new(0);
    for (filter, found) in [("awaiting", 1), ("shadowed", 1), ("rejected", 0), ("grasp", 1)] {
        console.model.view_state.filters.insert(View::Overview, filter.to_owned());
        assert_eq!(console.model.pipeline_rows().len(), found, "{filter}");
    }
}

#[test]
fn a_console_not_reading_is_marked() {
    let mut console = TestConsole::new(0);
    let asleep = AttachedConsoleView { not_reading: true, ..console_view(1, Some("bert"), None) };
    with_consoles(&mut console, vec![asleep, console_view(2, Some("ana"), None)]);
    assert!(screen(&console, 140, 36).contains(&format!("bert, NOT READING ({})", View::Alarms.title())));
    for size in [(120, 36), (100, 30), (80, 24)] {
        let screen = screen(&console, size.0, size.1);
        assert!(screen.contains("NOT READING"), "{size:?}: {screen}");
    }
    // These names do not fit.
    let others = ["bartholomew", "bernadette", "constantine"].into_iter().zip(3..);
    let mut all: Vec<AttachedConsoleView> =
        others.map(|(name, seat)| console_view(seat, Some(name), None)).collect();
    all[1].not_reading = true;
    all.push(console_view(2, Some("ana"), None));
    with_consoles(&mut console, all);
    let expected = wording::banner::others(3, 1);
    assert!(screen(&console, 80, 24).contains(&expected), "{}", screen(&console, 80, 24));
}

#[test]
fn the_account_of_another_console_is_named_if_it_differs() {
    let mut console = TestConsole::new(0);
    let of = |uid, role| {
        let with = |uid, role, view| AttachedConsoleView {
            account: Some(ConsoleAccount { uid, user: None, role }),
            ..view
        };
        vec![
            with(uid, role, console_view(1, Some("bert"), None)),
            with(7, AccountRole::Administrator, console_view(2, Some("ana"), None)),
        ]
    };
    with_consoles(&mut console, of(7, AccountRole::Administrator));
    assert!(screen(&console, 120, 36).contains(&format!("with bert ({})", View::Alarms.title())));
    with_consoles(&mut console, of(8, AccountRole::Observer));
    let named = format!("with bert of account 8, observer ({})", View::Alarms.title());
    assert!(screen(&console, 140, 36).contains(&named), "{}", screen(&console, 140, 36));
}

#[test]
fn an_unverified_engine_is_named_in_the_first_line() {
    let mut console = TestConsole::new(0);
    let unverified = AnswerOrigin::Untold.unverified();
    let warning = unverified.unwrap().short();
    let warns = |console: &TestConsole| screen(console, 100, 30).contains(warning);
    console.tell(MsgKind::Attached(Some(7), unverified));
    assert!(warns(&console));
    console.tell(MsgKind::Attached(Some(8), None));
    assert!(!warns(&console));
}
