//! A recording that no viewer can show is replayed over the view.

use super::*;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::notice::Notice;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::video_frame::Scenery;
use holdpoint_recordings::recording::{Recording, RecordingSubject};
use holdpoint_wording::console as wording;

fn recording(events: &[u64]) -> MsgKind {
    let version: holdpoint_governance::ids::CapabilityId = CANDIDATE.parse().unwrap();
    let event = |seq: u64, at_ms: u64| Event {
        seq,
        at_ms,
        kind: EventKind::StateChanged {
            version: version.clone(),
            from: State::Registered,
            to: State::Validated,
            reason: Notice::StageBegins.into(),
        },
    };
    MsgKind::RecordingRead {
        recording: Box::new(Recording {
            about: RecordingSubject {
                version: version.clone(),
                digest: holdpoint_governance::ids::Digest::from_bytes([1; 32]),
                predecessor: None,
                profile: holdpoint_governance::profile::ProfileName::Human.into(),
                robot: "arm7".to_owned(),
                seed: None,
                engine_build: "test".to_owned(),
            },
            outcome: None,
            scenery: Scenery::default(),
            pictures: Vec::new(),
            events: (1..).zip(events).map(|(seq, at_ms)| event(seq, *at_ms)).collect(),
            series: Vec::new(),
            films: Vec::new(),
            dropped: (0, 0),
        }),
        why: "there is no scene viewer".to_owned(),
    }
}

/// The cursor of the open replay, ms; absent if none is open.
fn cursor_ms(console: &TestConsole) -> Option<u64> {
    match &console.model.input.overlay {
        Some(Overlay::Replay(replay)) => Some(replay.cursor.at_ms),
        _ => None,
    }
}

fn notice(console: &TestConsole) -> &str {
    console.model.notice.as_ref().map_or("", |notice| notice.text.as_str())
}

#[test]
fn a_recording_is_replayed_over_the_view_with_its_own_keys() {
    let mut console = TestConsole::new(0);
    console.keys("3");
    let effects = console.keys("o");
    assert!(effects.iter().any(|effect| matches!(effect, Effect::OpenRecording(_))), "{effects:?}");
    console.tell(recording(&[10_000, 13_000, 50_000]));
    assert_eq!(cursor_ms(&console), Some(10_000));
    assert_eq!(notice(&console), wording::recording::replayed_here("there is no scene viewer"));
    console.model.notice = None;
    for (columns, rows) in [(120, 36), (80, 24), (60, 16), (40, 12)] {
        let screen = super::consistency::screen(&console, columns, rows);
        assert!(screen.contains("REPLAY") && screen.contains("X stop"), "{columns}x{rows}:\n{screen}");
    }
    console.keys("n");
    assert_eq!(cursor_ms(&console), Some(13_000));
    // A digit begins a jump here and opens no other view.
    console.keys("50");
    console.press(KeyCode::Enter);
    assert_eq!((cursor_ms(&console), console.model.view_state.view), (Some(50_000), View::Candidate));
    console.keys("q");
    assert_eq!((cursor_ms(&console), &console.model.input.overlay), (None, &None));
}

#[test]
fn a_replay_plays_with_the_consoles_clock() {
    let mut console = TestConsole::new(0);
    console.tell(recording(&[10_000, 10_500, 11_000]));
    assert!(!console.model.plays());
    console.keys(" ");
    assert!(console.model.plays());
    console.now_ms += 200;
    console.tell(MsgKind::Tick);
    assert_eq!(cursor_ms(&console), Some(10_200));
}

#[test]
fn the_arm_is_stopped_from_a_replay() {
    // Over the replay, over its help, and while a jump target is typed: there a letter is text.
    for (opens, key, shown) in [
        ("", KeyCode::Char('X'), "X stop"),
        ("?", KeyCode::Char('X'), "X stop"),
        (":1", KeyCode::F(9), "f9 stop"),
    ] {
        let mut console = TestConsole::new(0);
        console.tell(recording(&[10_000]));
        console.keys(opens);
        console.model.notice = None;
        let screen = super::consistency::screen(&console, 80, 24);
        assert!(screen.to_lowercase().contains(&shown.to_lowercase()), "{opens:?}:\n{screen}");
        let effects = console.press(key);
        let stops =
            |effect: &Effect| matches!(effect, Effect::Ask { question: EngineQuery::Stop { .. }, .. });
        assert!(effects.iter().any(stops), "{opens:?}: {effects:?}");
        assert_eq!(cursor_ms(&console), Some(10_000), "{opens:?}");
    }
}

#[test]
fn a_recording_covers_nothing_that_is_open_and_must_have_content() {
    let mut console = TestConsole::new(0);
    console.keys("?");
    console.tell(recording(&[10_000]));
    assert!(matches!(console.model.input.overlay, Some(Overlay::Palette(_))));
    assert_eq!(notice(&console), wording::recording::read_while_busy(CANDIDATE));
    console.press(KeyCode::Esc);
    console.tell(recording(&[]));
    assert_eq!(cursor_ms(&console), None);
    assert!(console.model.notice.as_ref().is_some_and(|notice| notice.bad));
}
