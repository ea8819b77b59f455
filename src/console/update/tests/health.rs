//! The health view: its queries and their frequency, the cursor, and the alarm history, which changes nothing.

use super::*;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::health::{HealthClock, HealthQuery, HealthSeries};

/// Tue 17 Nov 2026, 08:00 UTC.
const TUESDAY_MS: i64 = 1_794_902_400_000;

fn sent_query(effects: &[Effect]) -> Option<(String, HealthQuery)> {
    effects.iter().find_map(|effect| match effect {
        Effect::Ask { id, question: EngineQuery::Health(query) | EngineQuery::AlarmHistory(query) } => {
            Some((id.clone(), *query))
        }
        _ => None,
    })
}

fn series(query: HealthQuery, until_ms: i64) -> Reply {
    let width = i64::try_from(query.bucket_ms).unwrap();
    let alarm = json!({ "alarm": "degraded:grasp@1.3.0", "priority": "high", "text": "worse",
        "raised": { "at_ms": 5, "wall_ms": null, "by": null, "reason": null }, "began_before": false,
        "acknowledged": null, "shelved": null, "over": null, "reset": null, "ended": null,
        "state": "unacknowledged", "changes": 1 });
    let series = json!({ "clock": HealthClock::Wall, "from_ms": until_ms - width * i64::from(query.buckets),
        "bucket_ms": query.bucket_ms, "buckets": query.buckets, "last_at_ms": 0, "last_wall_ms": null, "points": [],
        "marks": [], "alarms": [alarm], "coverage": { "tasks": 0, "blocks": 0, "blocks_read": 0, "not_judged": 0,
        "removed": 0, "late": 0, "damaged": 0, "without_wall": 0, "marks_left_off": 0, "alarms_left_off": 0 } });
    Reply::Health { series: Box::new(serde_json::from_value::<HealthSeries>(series).unwrap()) }
}

/// In the health view, after its query was answered.
fn opened() -> TestConsole {
    let mut console = TestConsole::new(0);
    let effects = console.keys("8");
    assert_eq!(console.model.view_state.view, View::Health);
    answer(&mut console, &effects, TUESDAY_MS);
    console
}

fn answer(console: &mut TestConsole, effects: &[Effect], until_ms: i64) -> HealthQuery {
    let (id, query) = sent_query(effects).expect("the record is asked");
    console.tell(MsgKind::Answer { id, reply: Box::new(series(query, until_ms)) });
    query
}

#[test]
fn zoom_queries_new_buckets_within_its_ends() {
    let mut console = opened();
    console.tell(MsgKind::Resize(120, 36));
    let effects = console.tell(MsgKind::Tick);
    let first = answer(&mut console, &effects, TUESDAY_MS);
    assert_eq!((first.bucket_ms, first.buckets, first.until_ms), (900_000, 113, None));
    let effects = console.keys("-");
    assert_eq!(answer(&mut console, &effects, TUESDAY_MS).bucket_ms, 1_800_000);
    let mut narrowest = 0;
    for _ in 0..12 {
        let effects = console.keys("+");
        match sent_query(&effects) {
            Some(_) => narrowest = answer(&mut console, &effects, TUESDAY_MS).bucket_ms,
            None => assert!(console.model.notice.as_ref().unwrap().text.contains("narrower")),
        }
    }
    assert_eq!(narrowest, 60_000);
    let effects = console.keys("0");
    assert_eq!(answer(&mut console, &effects, TUESDAY_MS).bucket_ms, 900_000);
}

#[test]
fn the_cursor_stays_at_its_time_while_time_passes() {
    let mut console = opened();
    assert_eq!(console.model.health_bucket(), Some(72), "the newest");
    console.keys("hh");
    let (series, _) = console.model.engine_data.health.clone().unwrap();
    let at_ms = series.start_ms(70);
    assert_eq!(console.model.view_state.health.cursor_ms, Some(at_ms));
    console.now_ms += 20_000;
    let effects = console.tell(MsgKind::Tick);
    answer(&mut console, &effects, TUESDAY_MS + 900_000);
    assert_eq!(console.model.health_bucket(), Some(69), "the same moment, one column further left");
    console.keys("lll");
    assert_eq!(console.model.view_state.health.cursor_ms, None);
    let effects = console.keys("-");
    answer(&mut console, &effects, TUESDAY_MS + 900_000);
    assert_eq!(console.model.health_bucket(), Some(72), "it goes on with the newest");
}

#[test]
fn tasks_are_read_at_intervals_and_frozen_data_stays() {
    let mut console = opened();
    console.now_ms += 14_000;
    assert_eq!(sent_query(&console.tell(MsgKind::Tick)), None, "nothing happened but work");
    console.now_ms += 2_000;
    let effects = console.tell(MsgKind::Tick);
    assert!(sent_query(&effects).is_some());
    assert_eq!(sent_query(&console.tell(MsgKind::Tick)), None, "one question at a time");
    answer(&mut console, &effects, TUESDAY_MS);
    console.keys("f");
    console.now_ms += 60_000;
    assert_eq!(sent_query(&console.tell(MsgKind::Tick)), None, "frozen");
}

#[test]
fn a_refused_reading_is_retried_silently() {
    let mut console = TestConsole::new(0);
    let effects = console.keys("8");
    let (id, _) = sent_query(&effects).unwrap();
    assert_eq!(sent_query(&console.tell(MsgKind::Tick)), None, "one question at a time");
    let refused = Reply::Refused {
        code: Refusal::NotNow,
        text: "others read".to_owned(),
        hint: Some("wait".to_owned()),
    };
    console.model.notice = None;
    console.tell(MsgKind::Answer { id, reply: Box::new(refused) });
    assert_eq!(console.model.notice, None);
    let effects = console.tell(MsgKind::Tick);
    answer(&mut console, &effects, TUESDAY_MS);
    assert!(console.model.health().is_some());
}

#[test]
fn alarm_history_sends_no_changing_request() {
    let mut console = TestConsole::new(0);
    console.keys("5");
    let effects = console.press(KeyCode::Tab);
    let query = answer(&mut console, &effects, TUESDAY_MS);
    assert!(query.only_alarms && console.model.engine_data.health.is_none());
    assert_eq!(console.model.alarm_spells().len(), 1);
    for key in [" ", "z", "Z", "R"] {
        let effects = console.keys(key);
        assert!(effects.is_empty() && console.model.input.overlay.is_none(), "{key}: {effects:?}");
        assert!(console.model.notice.as_ref().unwrap().text.contains("changes nothing"));
    }
    // Letters typed at once after a refused key may be a reason, and go nowhere.
    console.now_ms += GUARD_MS;
    console.press(KeyCode::Enter);
    assert_eq!(console.model.view_state.view, View::Candidate, "it opens what the alarm is about");
    console.keys("!");
    assert_eq!(console.model.view_state.view, View::Alarms);
    assert_eq!(console.model.view_state.pane(), 0, "the alarm to attend to is among the open ones");
    assert!(!console.press(KeyCode::Char(' ')).is_empty());
}

/// In the health view, with tasks and `notes` notes in the newest column, one minute apart.
fn opened_with_notes(notes: usize) -> TestConsole {
    let mut console = TestConsole::new(0);
    let effects = console.keys("8");
    let (id, query) = sent_query(&effects).unwrap();
    let Reply::Health { mut series } = self::series(query, TUESDAY_MS) else { panic!("no series") };
    let last = u32::from(query.buckets) - 1;
    series.points = (0..12)
        .map(|back| {
            let point = json!({ "version": "grasp@1.2.0", "bucket": last - back, "tasks": 40, "succeeded": 38 - back,
                "success": [0.8, 0.99], "violated": 1, "near": 2, "time_s": [4.0, 5.0], "force_n": [20.0, 25.0],
                "at_ms": [0, 1] });
            serde_json::from_value(point).unwrap()
        })
        .collect();
    let begins_ms = series.start_ms(last);
    series.marks = (0..notes)
        .map(|number| {
            let at_ms = u64::try_from(number).unwrap() * 60_000;
            let mark = json!({ "kind": "note", "on_clock_ms": begins_ms + i64::try_from(at_ms).unwrap(),
                "at_ms": at_ms, "wall_ms": null, "family": null, "text": format!("ana: note {number}."), "record": 9 });
            serde_json::from_value(mark).unwrap()
        })
        .collect();
    console.tell(MsgKind::Answer { id, reply: Box::new(Reply::Health { series }) });
    console
}

/// Two or three marks were shown, the newest was not, and the screen did not say so.
#[test]
fn marks_are_shown_or_counted_newest_first() {
    for (notes, columns, rows) in [(2, 80, 24), (6, 80, 24), (9, 120, 36), (9, 80, 24), (14, 60, 16)] {
        let console = opened_with_notes(notes);
        let screen = super::consistency::screen(&console, columns, rows);
        let visible: Vec<bool> =
            (0..notes).map(|number| screen.contains(&format!("ana: note {number}."))).collect();
        let shown = visible.iter().filter(|is_visible| **is_visible).count();
        assert!(
            shown > 0 && visible[notes - shown..].iter().all(|is_visible| *is_visible),
            "{visible:?}\n{screen}"
        );
        let expected = match notes - shown {
            0 => String::new(),
            1 => "1 more mark".to_owned(),
            more => format!("{more} more marks"),
        };
        assert!(screen.contains(&expected), "{expected:?}\n{screen}");
        assert!(shown == notes || !expected.is_empty());
    }
    assert_eq!(
        (0..6)
            .filter(|number| super::consistency::screen(&opened_with_notes(6), 120, 36)
                .contains(&format!("ana: note {number}.")))
            .count(),
        6,
        "with enough room all are shown"
    );
}

#[test]
fn the_smallest_window_shows_a_chart_its_marks_and_the_verdict() {
    let screen = super::consistency::screen(&opened_with_notes(1), 40, 12);
    for label in ["Health: Success", "grasp", "% of 480", "marks", "N", "100", "success of grasp"] {
        assert!(screen.contains(label), "{label:?} is not in\n{screen}");
    }
    assert!(screen.contains('*'), "no chart in\n{screen}");
}

/// "near 137" of 137 tasks told nothing, the axis had no unit, and a promotion stood in no chart.
#[test]
fn health_names_units_tolerated_tasks_and_promotions() {
    let mut console = opened_with_notes(0);
    let (series, came_ms) = console.model.engine_data.health.clone().unwrap();
    let mut series = HealthSeries::clone(&series);
    let mark = json!({ "kind": "promotion", "on_clock_ms": series.start_ms(series.buckets - 5), "at_ms": 5,
        "wall_ms": null, "family": "grasp", "text": "grasp@1.2.0 took over", "record": 9 });
    series.marks = vec![serde_json::from_value(mark).unwrap()];
    console.model.engine_data.health = Some((Arc::new(series), came_ms));
    for (columns, rows) in [(120, 36), (80, 24)] {
        let screen = super::consistency::screen(&console, columns, rows);
        let flat = screen.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(
            flat.contains("100 % ") && flat.contains("1 with a violation, 1 close to a limit"),
            "{screen}"
        );
        let line = |label: &str| screen.lines().find(|line| line.trim_start().starts_with(label)).unwrap();
        let column = line("marks").rfind('P').unwrap();
        assert_eq!(line("50 %").as_bytes().get(column), Some(&b'P'), "{screen}");
    }
    for (tabs, unit) in [(2, "0.0 s"), (1, "0.0 N")] {
        (0..tabs).for_each(|_| drop(console.press(KeyCode::Tab)));
        let screen = super::consistency::screen(&console, 80, 24);
        assert!(screen.lines().any(|line| line.trim_start().starts_with(unit)), "{unit}: {screen}");
    }
}
