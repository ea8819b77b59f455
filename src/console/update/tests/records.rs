//! The audit view in sentences and raw, the story's own filter, the smallest and the largest windows.

use super::agreeing::screen;
use super::*;
use crate::model::STORY_PANE;
use holdpoint_protocol::detail::AuditPage;
use holdpoint_protocol::event::{Event, EventKind};

fn logged() -> TestConsole {
    let mut console = TestConsole::new(0);
    let row = |seq: u64, kind: &str, body: serde_json::Value| {
        json!({ "seq": seq, "prev": digest('1'), "hash": digest('2'), "at_ms": seq * 1000, "kind": kind,
            "subject": CANDIDATE, "body": body.to_string(), "wall_ms": 0 })
    };
    let batch = |rows: u64| json!({ "change": { "batches": [{ "rows": rows }] } });
    let rows = json!([
        row(9, "telemetry-block-sealed", batch(20)),
        row(8, "telemetry-block-sealed", batch(20)),
        row(
            7,
            "state-set",
            json!({ "change": { "from": "registered", "to": "validated", "reason": "fine" } })
        ),
        row(6, "flags-set", json!({ "change": { "flags": { "running": "sandbox" } } })),
        row(5, "asked", json!({ "asked": "register", "caller": { "user": "root", "process": 12 } })),
    ]);
    let page = AuditPage { rows: serde_json::from_value(rows).unwrap(), head: 9 };
    console.keys("7");
    console.model.told.audit = Arc::new(page);
    console
}

#[test]
fn the_log_is_told_in_sentences_by_kind_and_enter_shows_a_record_raw() {
    let mut console = logged();
    let text = screen(&console, 120, 36);
    assert!(
        text.contains("registered -> validated: fine") && text.contains("root asked for register"),
        "{text}"
    );
    assert!(!text.contains("telemetry-block") && !text.contains('{'), "{text}");
    // The last pane has every record; the run of telemetry is one row.
    console.press(KeyCode::BackTab);
    let text = screen(&console, 120, 36);
    assert!(text.contains("2 records of sealed telemetry") && text.contains("in sandbox"), "{text}");
    assert_eq!(console.model.row_count(), 4);
    console.keys("j");
    console.press(KeyCode::Enter);
    let text = screen(&console, 120, 36);
    assert!(
        text.contains("Record 7 as it was written") && text.contains("\"from\": \"registered\""),
        "{text}"
    );
    assert!(text.contains(&digest('2')), "the whole hash: {text}");
    // What is looked for in it is gone to, and nothing is filtered by it.
    console.keys("/reason");
    console.press(KeyCode::Enter);
    assert!(console.model.place.opened.is_some_and(|opened| opened.scroll > 0));
    assert_eq!(console.model.row_count(), 4);
    console.press(KeyCode::Esc);
    assert!(console.model.place.opened.is_none() && console.model.place.view == View::Audit);
    // A sentence is found by its words, though its content has others.
    console.keys("/in sandbox");
    console.press(KeyCode::Enter);
    assert_eq!(console.model.row_count(), 1);
}

fn storied() -> TestConsole {
    let mut console = TestConsole::new(0);
    console.model.told.story.clear();
    let fault =
        |seq, text: &str| Event { seq, at_ms: seq * 1_000, kind: EventKind::Fault { text: text.to_owned() } };
    console.tell(MsgKind::Events(vec![fault(1, "a wheel came off"), fault(2, "the light went out")]));
    console
}

#[test]
fn the_story_has_a_filter_of_its_own() {
    let mut console = storied();
    console.model.place.panes[View::Overview as usize] = STORY_PANE;
    console.keys("/wheel");
    assert_eq!(console.model.row_count(), 1, "while it is typed");
    console.press(KeyCode::Enter);
    let text = screen(&console, 120, 36);
    assert!(text.contains("a wheel came off") && !text.contains("the light"), "{text}");
    assert!(text.contains("1 of 2 lines with \"wheel\""), "what is filtered says so: {text}");
    assert!(text.contains(CANDIDATE), "the pipeline keeps its candidates: {text}");
    console.press(KeyCode::Esc);
    assert_eq!(console.model.row_count(), 2);
    console.model.place.panes[View::Overview as usize] = 0;
    console.keys("/nothing of this name");
    console.press(KeyCode::Enter);
    assert!(
        screen(&console, 120, 36).contains("a wheel came off"),
        "the pipeline's filter is not the story's"
    );
}

#[test]
fn a_small_window_shows_the_view_below_what_calls() {
    let mut console = logged();
    for (key, said) in [
        ("1", CANDIDATE),
        ("2", "Registry: All"),
        ("3", "Candidate: Checks"),
        ("4", "no sequence has been shadowed"),
        ("5", "latched"),
        ("6", "approval grasp@1.3.0"),
        ("7", "registered -> v"),
    ] {
        console.keys(key);
        let text = screen(&console, 40, 12);
        assert!(text.contains(said), "{key}: {said}\n{text}");
        assert!(text.contains("HIGH") && text.contains("X stop"), "{key}\n{text}");
    }
    // With fewer lines alarms and what waits are all there is.
    console.keys("1");
    let text = screen(&console, 40, 6);
    assert!(text.contains("approval grasp@1.3.0") && !text.contains("Overview"), "{text}");
}

#[test]
fn a_large_window_says_why_beside_where() {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    now.candidates[0].reasons = serde_json::from_value(json!([
        { "code": "shadow-clean", "dimension": "shadow", "text": "no signal more", "evidence": null, "limit": null },
        { "code": "policy-compatible", "dimension": "policy", "text": "covered", "evidence": null, "limit": null },
    ]))
    .unwrap();
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    let text = screen(&console, 200, 60);
    assert!(text.contains("Checks of grasp@1.3.0") && text.contains("policy-compatible: covered"), "{text}");
    assert!(!screen(&console, 120, 36).contains("Checks of"));
}

#[test]
fn the_tour_takes_one_line() {
    let mut console = TestConsole::new(0);
    let without = screen(&console, 80, 24);
    console.model.settings.tour = Some(0);
    for (columns, rows) in [(80, 24), (60, 16), (120, 36)] {
        let text = screen(&console, columns, rows);
        assert!(text.lines().nth(2).is_some_and(|line| line.ends_with("(. ends the tour)")), "{text}");
    }
    let with = screen(&console, 80, 24);
    assert_eq!(with.lines().nth(3), without.lines().nth(2), "the view begins one line further down");
}
