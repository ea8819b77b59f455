//! Tables and properties of the alarm states.

use proptest::prelude::*;

use super::*;

fn key(family: &str) -> AlarmKey {
    AlarmKey::NotRecovered(crate::ids::Family::new(family).unwrap())
}

fn grasp() -> AlarmKey {
    key("grasp")
}

fn raise_as(key: AlarmKey, priority: Priority, latching: bool) -> AlarmEvent {
    AlarmEvent::Raise { key, priority, latching, text: NoticeOrText::Text("slip".to_owned()) }
}

fn named(event: &str) -> AlarmEvent {
    let (key, by) = (grasp(), "mara".to_owned());
    match event {
        "raise" => raise_as(key, Priority::High, false),
        "raise-latching" => raise_as(key, Priority::High, true),
        "raise-critical" => raise_as(key, Priority::Critical, false),
        "clear" => AlarmEvent::Clear { key },
        "acknowledge" => AlarmEvent::Acknowledge { key, by },
        "reset" => AlarmEvent::Reset { key, by, reason: "looked at it".into() },
        "reset-silently" => AlarmEvent::Reset { key, by, reason: " ".into() },
        "shelve" => AlarmEvent::Shelve { key, by, until: wall(5_000), reason: "known sensor".into() },
        "shelve-silently" => AlarmEvent::Shelve { key, by, until: wall(5_000), reason: "".into() },
        "shelve-forever" => {
            AlarmEvent::Shelve { key, by, until: WallTime::from_ms(i64::MAX), reason: "tired".into() }
        }
        "unshelve" => AlarmEvent::Unshelve { key, by },
        "tick" => AlarmEvent::Tick,
        other => panic!("{other}"),
    }
}

/// The wall clock of a script.
fn wall(now_ms: u64) -> WallTime {
    WallTime::SCRIPT_EPOCH.plus_ms(now_ms)
}

fn step(book: &mut AlarmBook, event: &AlarmEvent, now_ms: u64) -> Result<Vec<AlarmChange>, AlarmError> {
    let changes = apply(book, event, now_ms, wall(now_ms))?;
    book.absorb(&changes);
    Ok(changes)
}

/// A version that violates a limit in every task writes no record for each of them.
#[test]
fn a_present_violation_changes_its_text_for_a_larger_value_alone() {
    use crate::notice::Notice;
    use crate::past_limit::{LimitedQuantity, MeasuredInTask, PastLimit};
    use crate::policy_hit::PolicyHit;
    let version: crate::ids::CapabilityId = "grasp@1.0.0".parse().unwrap();
    let raise = |sequence: u64, value: f64, hit: PolicyHit| {
        let past = PastLimit { quantity: LimitedQuantity::Force, value, limit: 35.0, place: None };
        let task = holdpoint_body::TaskKind::Grasp;
        let measured = Some(MeasuredInTask { sequence, task, past: Some(past) });
        let text = Notice::LimitViolated { version: version.clone(), hit: Some(hit), measured };
        let (key, priority) = (AlarmKey::Violation(version.clone()), Priority::High);
        AlarmEvent::Raise { key, priority, latching: true, text: text.into() }
    };
    let mut book = AlarmBook::new();
    let force = PolicyHit::ForceMeasured;
    for (sequence, value, hit, changes) in [
        (1, 50.0, force, 1),
        (2, 50.0, force, 0),
        (3, 49.0, force, 0),
        (4, 71.0, force, 1),
        (5, 40.0, PolicyHit::SpeedMeasured, 1),
    ] {
        let found = step(&mut book, &raise(sequence, value, hit), sequence).unwrap();
        assert_eq!(found.len(), changes, "{sequence}: {found:?}");
    }
    // A later episode has its own value.
    let key = AlarmKey::Violation(version.clone());
    step(&mut book, &AlarmEvent::Clear { key: key.clone() }, 6).unwrap();
    step(&mut book, &raise(7, 36.0, force), 7).unwrap();
    let AlarmEvent::Raise { text, .. } = raise(7, 36.0, force) else { panic!("it raises") };
    assert_eq!(book.get(&key).unwrap().text, text);
}

#[test]
fn alarm_states_follow_the_events() {
    use AlarmState::{Acknowledged, Latched, Normal, ReturnedUnacknowledged, Shelved, Unacknowledged};
    for (events, expected) in [
        ("raise", Some(Unacknowledged)),
        ("raise acknowledge", Some(Acknowledged)),
        ("raise acknowledge acknowledge", Some(Acknowledged)),
        ("raise acknowledge raise", Some(Acknowledged)),
        ("raise acknowledge raise-critical", Some(Unacknowledged)),
        ("raise clear", Some(ReturnedUnacknowledged)),
        ("raise clear acknowledge", Some(Normal)),
        ("raise acknowledge clear", Some(Normal)),
        ("raise acknowledge clear raise", Some(Unacknowledged)),
        ("raise clear raise", Some(Unacknowledged)),
        ("raise-latching acknowledge clear", Some(Latched)),
        ("raise-latching acknowledge clear acknowledge clear", Some(Latched)),
        ("raise-latching clear acknowledge reset", Some(Normal)),
        ("raise-latching clear reset", Some(Normal)),
        ("raise-latching clear acknowledge raise", Some(Unacknowledged)),
        ("raise-latching clear acknowledge raise clear acknowledge", Some(Latched)),
        ("raise shelve", Some(Shelved)),
        ("raise shelve clear acknowledge", Some(Shelved)),
        ("raise shelve clear acknowledge unshelve", Some(Normal)),
        ("raise shelve unshelve", Some(Unacknowledged)),
        ("raise shelve raise-critical", Some(Unacknowledged)),
        // Refused:
        ("acknowledge", None),
        ("reset", None),
        ("raise reset", None),
        ("raise-latching reset", None),
        ("raise-latching acknowledge reset", None),
        ("raise-latching clear reset-silently", None),
        ("raise shelve-silently", None),
        ("raise shelve-forever", None),
        ("raise unshelve", None),
        ("raise-critical shelve", None),
    ] {
        let mut book = AlarmBook::new();
        let mut last = Ok(Vec::new());
        for (at, event) in events.split(' ').enumerate() {
            assert!(last.is_ok(), "{events}: refused before its last event: {last:?}");
            last = step(&mut book, &named(event), 10 * at as u64);
        }
        match expected {
            Some(state) => assert_eq!(book.get(&grasp()).map(Alarm::state), Some(state), "{events}"),
            None => assert!(last.is_err(), "{events}"),
        }
    }
}

#[test]
fn shelved_alarm_returns_after_its_time() {
    let mut book = AlarmBook::new();
    step(&mut book, &named("raise"), 0).unwrap();
    step(&mut book, &named("shelve"), 10).unwrap();
    assert_eq!(book.summary(10).shelved, 1);
    assert!(step(&mut book, &AlarmEvent::Tick, 4_999).unwrap().is_empty());
    let changes = step(&mut book, &AlarmEvent::Tick, 5_000).unwrap();
    assert!(matches!(changes[..], [AlarmChange::Set { annunciated: true, from: AlarmState::Shelved, .. }]));
    assert_eq!(book.summary(5_000).highest_unacknowledged, Some(Priority::High));
}

/// A shelf of minutes lasted for as long as no engine ran: it ended by the engine's time.
#[test]
fn a_shelf_ends_by_wall_time_alone() {
    let mut book = AlarmBook::new();
    step(&mut book, &named("raise"), 0).unwrap();
    step(&mut book, &named("shelve"), 10).unwrap();
    let tick = |now_ms, wall_ms| apply(&book, &AlarmEvent::Tick, now_ms, wall(wall_ms)).unwrap();
    assert!(tick(600_000, 4_999).is_empty(), "the engine's time ends no shelf");
    assert_eq!(tick(11, 5_000).len(), 1);
    // A shelf of an earlier version ends in milliseconds of its engine: that moment has passed.
    let mut old = serde_json::to_value(book.get(&grasp()).unwrap()).unwrap();
    old["shelf"]["until_ms"] = 9_000_000.into();
    let old: Alarm = serde_json::from_value(old).unwrap();
    book.alarms.insert(grasp(), old);
    assert_eq!(apply(&book, &AlarmEvent::Tick, 11, wall(11)).unwrap().len(), 1);
}

#[test]
fn three_raises_in_a_minute_chatter() {
    let mut book = AlarmBook::new();
    for at in [0, 20_000, 40_000] {
        assert!(!book.get(&grasp()).is_some_and(|alarm| alarm.is_chattering(at)));
        step(&mut book, &named("raise"), at).unwrap();
        step(&mut book, &named("clear"), at + 1).unwrap();
    }
    let alarm = book.get(&grasp()).unwrap();
    assert!(alarm.is_chattering(60_000) && !alarm.is_chattering(60_001));
    assert_eq!((alarm.raises, book.open().len()), (3, 1));
}

#[test]
fn floods_group_by_cause_and_keep_criticals_apart() {
    let mut book = AlarmBook::new();
    for at in 0..=FLOOD_START as u64 {
        assert!(!book.is_flooded(), "{at}");
        step(&mut book, &raise_as(key(&format!("low-{at:02}")), Priority::Low, false), at).unwrap();
    }
    assert!(book.is_flooded());
    step(&mut book, &raise_as(key("trip"), Priority::Critical, true), 50).unwrap();
    assert_eq!(book.summary(50).recent, Some(11), "twelve, counted as more than ten");
    let rows = grouped(&book);
    assert_eq!(
        rows.iter().map(|row| (row.first.key.clone(), row.members.len())).collect::<Vec<_>>(),
        [(key("trip"), 1), (key("low-00"), 11)]
    );
    // It ends when the window contains fewer than five.
    let changes = step(&mut book, &AlarmEvent::Tick, FLOOD_WINDOW_MS + 4).unwrap();
    assert!(changes.is_empty() && book.is_flooded());
    step(&mut book, &AlarmEvent::Tick, FLOOD_WINDOW_MS + 10).unwrap();
    assert!(!book.is_flooded());
    assert_eq!(book.summary(FLOOD_WINDOW_MS + 10).recent, Some(1));
    assert_eq!(grouped(&book).len(), 12);
}

#[test]
fn full_alarm_book_makes_room_for_what_is_as_urgent() {
    let mut book = AlarmBook::new();
    let places = ALARMS_MAX - RESERVED_PLACES;
    for at in 0..places {
        step(&mut book, &raise_as(key(&format!("a{at}")), Priority::Low, false), at as u64).unwrap();
    }
    let low = |name: &str| raise_as(key(name), Priority::Low, false);
    assert!(matches!(apply(&book, &low("more"), 1_000, wall(1_000)), Err(AlarmError::Full(_))));
    // A normal one goes first, then one whose condition is gone, although no person acknowledged it.
    for name in ["a5", "a7"] {
        step(&mut book, &AlarmEvent::Clear { key: key(name) }, 1_000).unwrap();
    }
    step(&mut book, &AlarmEvent::Acknowledge { key: key("a7"), by: "mara".into() }, 1_000).unwrap();
    step(&mut book, &low("more-1"), 1_000).unwrap();
    assert!(book.get(&key("a7")).is_none() && book.get(&key("a5")).is_some());
    let changes = apply(&book, &low("more-2"), 1_000, wall(1_000)).unwrap();
    let closed = |change: &AlarmChange| matches!(change, AlarmChange::Set { alarm, .. } if alarm.key == key("a5") && alarm.state() == AlarmState::Normal);
    assert!(changes.iter().any(closed), "{changes:?}");
    book.absorb(&changes);
    assert!(book.get(&key("a5")).is_none() && book.get(&key("more-2")).is_some());
    assert_eq!(book.iter().count(), places);
    // The reserved places are for high ones, and then a high one takes the place of the oldest low one.
    for at in 0..RESERVED_PLACES {
        let high = raise_as(key(&format!("h{at}")), Priority::High, true);
        step(&mut book, &high, 2_000).unwrap();
    }
    assert_eq!(book.iter().count(), ALARMS_MAX);
    step(&mut book, &raise_as(key("h-more"), Priority::High, true), 2_000).unwrap();
    assert!(book.get(&key("a0")).is_none() && book.get(&key("h-more")).is_some());
    assert!(matches!(apply(&book, &low("more-3"), 2_000, wall(2_000)), Err(AlarmError::Full(_))));
    step(&mut book, &raise_as(key("critical"), Priority::Critical, true), 2_000).unwrap();
    assert_eq!(book.iter().count(), ALARMS_MAX);
}

#[test]
fn long_normal_alarms_are_dropped() {
    let mut book = AlarmBook::new();
    step(&mut book, &raise_as(key("a8"), Priority::Low, false), 8).unwrap();
    step(&mut book, &AlarmEvent::Clear { key: key("a8") }, 1_000).unwrap();
    step(&mut book, &AlarmEvent::Acknowledge { key: key("a8"), by: "mara".into() }, 1_000).unwrap();
    step(&mut book, &AlarmEvent::Tick, FLOOD_WINDOW_MS + 8).unwrap();
    assert!(book.get(&key("a8")).is_none());
}

#[test]
fn invalid_names_and_keys_are_refused() {
    let mut book = AlarmBook::new();
    step(&mut book, &named("raise"), 0).unwrap();
    let forged = AlarmEvent::Acknowledge { key: grasp(), by: "mara\u{202e}".into() };
    assert!(matches!(apply(&book, &forged, 0, wall(0)), Err(AlarmError::Identity(_))));
    let long = format!("grasp@1.0.0-{}", "k".repeat(200)).parse().unwrap();
    let long = raise_as(AlarmKey::Rejected(long), Priority::Low, false);
    assert!(matches!(apply(&book, &long, 0, wall(0)), Err(AlarmError::Key(_))));
}

const NAMES: [&str; 10] = [
    "raise",
    "raise-latching",
    "raise-critical",
    "clear",
    "acknowledge",
    "reset",
    "shelve",
    "unshelve",
    "tick",
    "shelve-silently",
];

proptest! {
    #[test]
    fn alarm_book_keeps_its_invariants_in_any_history(history in proptest::collection::vec((0..NAMES.len(), 0u64..4_000), 1..60)) {
        let (mut book, mut replayed, mut now_ms) = (AlarmBook::new(), AlarmBook::new(), 0);
        for (index, later_ms) in history {
            now_ms += later_ms;
            let before = book.clone();
            match apply(&book, &named(NAMES[index]), now_ms, wall(now_ms)) {
                Ok(changes) => {
                    book.absorb(&changes);
                    let stored = serde_json::to_string(&changes).unwrap();
                    replayed.absorb(&serde_json::from_str::<Vec<AlarmChange>>(&stored).unwrap());
                }
                Err(_) => prop_assert_eq!(&book, &before),
            }
            prop_assert_eq!(&book, &replayed);
            let Some(alarm) = book.get(&grasp()) else { continue };
            // A present condition is never shown as normal, and a critical one never lies on a shelf.
            prop_assert!(!alarm.condition || alarm.state() != AlarmState::Normal);
            prop_assert!(alarm.priority != Priority::Critical || alarm.shelf.is_none());
            prop_assert!(alarm.raises_ms.len() <= CHATTER_RAISES);
            // Only an operator ends the call for attention: it is over only after an acknowledgement or reset.
            let was_open = before.get(&grasp()).is_some_and(|old| old.acknowledged_by.is_none());
            if was_open && alarm.acknowledged_by.is_some() {
                prop_assert!(matches!(NAMES[index], "acknowledge" | "reset"));
            }
        }
    }
}
