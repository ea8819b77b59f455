//! The audit view in sentences and raw, the event log's own filter, the smallest and the largest windows.

use super::consistency::screen;
use super::*;
use crate::audit::AuditGroup;
use crate::model::EVENT_LOG_PANE;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::detail::AuditPage;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_wording::console as wording;

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
    console.model.engine_data.audit = Arc::new(page);
    console
}

#[test]
fn the_log_shows_sentences_and_enter_a_raw_record() {
    let mut console = logged();
    let text = screen(&console, 120, 36);
    assert!(text.contains("registered -> validated") && text.contains("root asked"), "{text}");
    assert!(!text.contains("telemetry-block") && !text.contains('{'), "{text}");
    // The last pane has every record; the run of telemetry is one row.
    console.press(KeyCode::BackTab);
    let text = screen(&console, 120, 36);
    assert!(text.contains("2 records") && text.contains("in sandbox"), "{text}");
    assert_eq!(console.model.row_count(), 4);
    console.keys("j");
    console.press(KeyCode::Enter);
    let text = screen(&console, 120, 36);
    assert!(text.contains("Record 7") && text.contains("\"from\": \"registered\""), "{text}");
    assert!(text.contains(&digest('2')), "the whole hash: {text}");
    // A search moves the cursor and filters nothing.
    console.keys("/reason");
    console.press(KeyCode::Enter);
    assert!(console.model.view_state.opened.is_some_and(|opened| opened.scroll > 0));
    assert_eq!(console.model.row_count(), 4);
    console.press(KeyCode::Esc);
    assert!(console.model.view_state.opened.is_none() && console.model.view_state.view == View::Audit);
    // The search finds words of a sentence, though its content has others.
    console.keys("/in sandbox");
    console.press(KeyCode::Enter);
    assert_eq!(console.model.row_count(), 1);
}

/// The filter took rows for words in their raw content, which the view does not show.
#[test]
fn the_filter_of_the_log_takes_what_is_shown_and_begins_empty() {
    let mut console = logged();
    assert_eq!(console.model.row_count(), 2);
    console.keys("/from");
    assert_eq!(console.model.row_count(), 0, "a field of the content");
    console.press(KeyCode::Esc);
    console.keys("/fine");
    console.press(KeyCode::Enter);
    assert_eq!(console.model.row_count(), 1);
    console.keys("/");
    assert_eq!((console.model.filter(), console.model.row_count()), ("", 2));
    console.press(KeyCode::Up);
    assert_eq!((console.model.filter(), console.model.row_count()), ("fine", 1));
}

/// Other views have the time of day; the log had the engine's own.
#[test]
fn the_log_has_the_time_of_day_beside_the_engines_own() {
    let mut console = logged();
    let mut page = (*console.model.engine_data.audit).clone();
    for row in &mut page.rows {
        // 08:12:41 on 2026-11-17.
        row.wall_ms = 1_794_903_161_000;
    }
    console.model.engine_data.audit = Arc::new(page);
    let text = screen(&console, 120, 36);
    assert!(text.contains("7      08:12:41  00:00:07"), "{text}");
    let mut moments = console.model.engine_data.audit.rows.iter().map(crate::formatters::record_moment);
    assert!(moments.any(|moment| text.contains(&moment)), "{text}");
    let narrow = screen(&console, 80, 24);
    assert!(narrow.contains("7      08:12:41  grasp"), "{narrow}");
}

fn console_with_events() -> TestConsole {
    let mut console = TestConsole::new(0);
    console.model.engine_data.events.clear();
    let fault =
        |seq, text: &str| Event { seq, at_ms: seq * 1_000, kind: EventKind::Fault { text: text.to_owned() } };
    console.tell(MsgKind::Events(vec![fault(1, "a wheel broke"), fault(2, "the light went out")]));
    console
}

#[test]
fn the_event_log_has_its_own_filter() {
    let mut console = console_with_events();
    console.model.view_state.panes[View::Overview as usize] = EVENT_LOG_PANE;
    console.keys("/wheel");
    assert_eq!(console.model.row_count(), 1, "while it is typed");
    console.press(KeyCode::Enter);
    let text = screen(&console, 120, 36);
    assert!(text.contains("a wheel broke") && !text.contains("the light"), "{text}");
    assert!(
        text.contains(&wording::overview::lines_filtered(1, 2, "wheel")),
        "what is filtered says so: {text}"
    );
    assert!(text.contains(CANDIDATE), "the pipeline keeps its candidates: {text}");
    console.press(KeyCode::Esc);
    assert_eq!(console.model.row_count(), 2);
    console.model.view_state.panes[View::Overview as usize] = 0;
    console.keys("/zebra");
    console.press(KeyCode::Enter);
    let text = screen(&console, 120, 36);
    assert!(text.contains("a wheel broke"), "the event log has its own filter");
    assert!(text.contains("none with") && text.contains("\"zebra\", 1 in"), "{text}");
    console.press(KeyCode::Esc);
    console.keys("/grasp");
    console.press(KeyCode::Enter);
    for (columns, rows) in [(120, 36), (80, 24), (60, 16), (40, 12)] {
        let text = screen(&console, columns, rows);
        assert!(text.contains("1 of 1") && text.contains("with \"grasp\""), "{columns}x{rows}: {text}");
    }
}

#[test]
fn a_small_window_shows_the_view_below_alarms() {
    let mut console = logged();
    for (key, expected) in [
        ("1", CANDIDATE),
        ("2", "Registry: All"),
        ("3", "Candidate: Checks"),
        ("4", "Its shadow is over"),
        ("5", "latched"),
        ("6", "approval grasp@1.3.0"),
        ("7", "registered -> v"),
    ] {
        console.keys(key);
        let text = screen(&console, 40, 12);
        assert!(text.contains(expected), "{key}: {expected}\n{text}");
        assert!(text.contains("HIGH") && text.contains("X stop"), "{key}\n{text}");
    }
    // With fewer lines only alarms and waiting requests remain.
    console.keys("1");
    let text = screen(&console, 40, 6);
    assert!(text.contains("approval grasp@1.3.0") && !text.contains("Overview"), "{text}");
}

#[test]
fn a_large_window_shows_the_checks() {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    now.candidates[0].reasons = serde_json::from_value(json!([
        { "code": "shadow-clean", "dimension": "shadow", "text": "no signal more", "evidence": null, "limit": null },
        { "code": "policy-compatible", "dimension": "policy", "text": "covered", "evidence": null, "limit": null },
    ]))
    .unwrap();
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    let text = screen(&console, 200, 60);
    assert!(text.contains(&format!("Checks of {CANDIDATE}")) && text.contains("policy-compatible"), "{text}");
    assert!(!screen(&console, 120, 36).contains("Checks of"));
}

#[test]
fn tour_occupies_one_line() {
    let mut console = TestConsole::new(0);
    let without = screen(&console, 80, 24);
    console.model.settings.tour = Some(0);
    for (columns, rows) in [(80, 24), (60, 16), (120, 36)] {
        let text = screen(&console, columns, rows);
        assert!(
            text.lines().nth(3).is_some_and(|line| line.contains("(. ends") && line.ends_with(')')),
            "{text}"
        );
    }
    let with = screen(&console, 80, 24);
    assert_eq!(with.lines().nth(4), without.lines().nth(3), "the view begins one line further down");
}

fn listed(console: &mut TestConsole) {
    let row = |version: &str, state: &str, behavior: Option<f64>, changed_ms: u64| {
        json!({ "version": version, "state": state, "row_version": 1, "flags": flags(false, false),
            "kappas": [1.0, 1.0, behavior, null], "baseline": false, "author": "cora", "provenance": "manual",
            "risk": "low", "changed_ms": changed_ms })
    };
    let page = json!({ "reply": "registry", "page": { "total": 4, "thresholds": [0.9, 0.9, 0.9, 0.9], "rows": [
        row("align@1.0.0", "active", None, 10), row("grasp@1.0.0", "superseded", Some(0.7), 20),
        row("grasp@1.2.0", "active", Some(0.95), 30), row("grasp@1.10.0", "rejected", Some(0.2), 40)] } });
    let reply = Box::new(serde_json::from_value(page).unwrap());
    console.tell(MsgKind::Answer { id: "x".to_owned(), reply });
}

/// The versions of the registry's rows, in their order.
fn versions(console: &TestConsole) -> Vec<String> {
    let rows = console.model.registry_rows();
    let version = |row: &crate::rows::RegistryItem<'_>| match row {
        crate::rows::RegistryItem::Version(row) => Some(row.version.to_string()),
        crate::rows::RegistryItem::Family { .. } => None,
    };
    rows.iter().filter_map(version).collect()
}

#[test]
fn the_registry_is_sorted_by_its_columns_and_back_to_the_tree() {
    let mut console = TestConsole::new(0);
    console.keys("2");
    listed(&mut console);
    let tree = ["align@1.0.0", "grasp@1.0.0", "grasp@1.2.0", "grasp@1.10.0"];
    assert_eq!(versions(&console), tree);
    assert_eq!(console.model.row_count(), 6, "families are rows of the tree");
    // The cursor stays on its version, wherever that moves.
    console.keys("G");
    console.keys("ssss");
    assert_eq!(versions(&console), ["grasp@1.10.0", "grasp@1.0.0", "grasp@1.2.0", "align@1.0.0"], "behavior");
    assert_eq!(console.model.version_here().unwrap().to_string(), "grasp@1.10.0");
    let text = screen(&console, 120, 36);
    assert!(text.contains("behavior^") && text.contains("grasp@1.10.0"), "{text}");
    console.keys("S");
    assert_eq!(
        versions(&console),
        ["grasp@1.2.0", "grasp@1.0.0", "grasp@1.10.0", "align@1.0.0"],
        "turned round; what is not measured stays last"
    );
    // A reloaded page keeps the order.
    listed(&mut console);
    assert_eq!(versions(&console)[0], "grasp@1.2.0");
    console.keys("ss");
    assert_eq!(versions(&console)[0], "grasp@1.10.0", "the newest change first");
    console.keys("ss");
    assert_eq!(versions(&console), tree);
    console.keys("S");
    assert_eq!(versions(&console), ["align@1.0.0", "grasp@1.10.0", "grasp@1.2.0", "grasp@1.0.0"]);
    console.keys("5s");
    assert!(console.model.notice.as_ref().is_some_and(|notice| notice.text.contains("of attention")));
}

#[test]
fn details_are_searched_and_n_finds_the_next_hit() {
    let mut console = TestConsole::new(0);
    console.keys("3");
    let value = json!({
        "version": CANDIDATE, "against": "grasp@1.2.0", "parent": null, "digest": digest('a'), "summary": "",
        "author": "cora", "provenance": "manual", "risk": "low", "registered_ms": 0, "dimensions": [],
        "composite": null, "reasons": [], "conditions": [], "behavior": [], "modes": [],
        "differences": [
            { "field": "params.speed", "old": 1, "new": 2 }, { "field": "params.grip", "old": "soft", "new": "hard" },
            { "field": "params.lift", "old": null, "new": 3 }, { "field": "params.drop", "old": "hard", "new": null }],
        "drills": [], "decisions": [], "audit": [], "evidence": null, "untested": [] });
    console.model.engine_data.detail = Some(Arc::new(serde_json::from_value(value).unwrap()));
    console.press(KeyCode::Tab);
    // By a value, and not only by the field's name.
    console.keys("/HARD");
    console.press(KeyCode::Enter);
    assert_eq!(console.model.row(), 1);
    console.keys("n");
    assert_eq!(console.model.row(), 3);
    console.keys("n");
    assert_eq!(console.model.row(), 1, "from the top again");
    let mut other = TestConsole::new(0);
    other.keys("n");
    assert!(
        other.model.notice.as_ref().is_some_and(|notice| notice.bad && notice.text.contains("was searched"))
    );
}

/// The place of a text on the screen of the model's size.
fn place(console: &TestConsole, wanted: &str) -> (u16, u16) {
    let (columns, rows) = console.model.size;
    let text = screen(console, columns, rows);
    let found = text.lines().enumerate().find_map(|(row, line)| Some((line.find(wanted)?, row)));
    let (column, row) = found.unwrap_or_else(|| panic!("{wanted:?} is not there:\n{text}"));
    (u16::try_from(column).unwrap(), u16::try_from(row).unwrap())
}

#[test]
fn click_opens_its_target_and_decides_nothing() {
    let mut console = TestConsole::new(0);
    console.model.size = (120, 36);
    console.model.settings.mouse = true;
    let click = |console: &mut TestConsole, wanted: &str| {
        let (column, row) = place(console, wanted);
        console.tell(MsgKind::Click(column, row))
    };
    click(&mut console, "5 Alarms");
    assert_eq!(console.model.view_state.view, View::Alarms);
    click(&mut console, "3o LOW");
    click(&mut console, "1^ CRIT   # latched");
    assert_eq!(console.model.row(), 3, "the alarm that was pointed at");
    click(&mut console, "2 Registry");
    listed(&mut console);
    click(&mut console, "Candidates");
    assert_eq!(console.model.view_state.pane(), 2);
    click(&mut console, "All");
    click(&mut console, "1.10.0");
    assert_eq!(console.model.version_here().unwrap().to_string(), "grasp@1.10.0");
    console.now_ms += 1_000;
    click(&mut console, "1.10.0");
    assert_eq!(console.model.view_state.view, View::Candidate, "what is under the cursor opens");
    click(&mut console, "1 Overview");
    click(&mut console, "Events");
    assert_eq!(console.model.view_state.pane(), EVENT_LOG_PANE);
    click(&mut console, CANDIDATE);
    assert_eq!(console.model.view_state.pane(), 0);
    // A dialog over the view takes no click, and has no buttons to click.
    for open in ["x", "a"] {
        console.keys("1");
        console.keys(open);
        console.press(KeyCode::Enter);
        if open == "x" {
            console.keys("x");
        }
        let before = console.model.clone();
        assert!(before.input.overlay.is_some(), "{open}");
        for row in 0..36 {
            for column in (0..120).step_by(3) {
                assert!(console.tell(MsgKind::Click(column, row)).is_empty());
            }
        }
        assert_eq!(console.model.input, before.input, "{open}");
        console.press(KeyCode::Esc);
    }
    console.model.settings.mouse = false;
    console.keys("1");
    click(&mut console, "5 Alarms");
    assert_eq!(console.model.view_state.view, View::Overview, "the mouse was given back");
}

#[test]
fn every_marked_alarm_is_acknowledged_by_one_key() {
    let mut console = TestConsole::new(0);
    console.keys("5g");
    console.keys("mmm");
    assert_eq!(console.model.view_state.marked.len(), 3);
    assert!(screen(&console, 100, 30).contains("LOW M"), "{}", screen(&console, 100, 30));
    let effects = console.keys(" ");
    let named: Vec<&str> = effects
        .iter()
        .filter_map(|effect| match effect {
            Effect::Ask { question: EngineQuery::Acknowledge { alarm, by }, .. } if by == "ana" => {
                Some(alarm.as_str())
            }
            _ => None,
        })
        .collect();
    // The third is already acknowledged.
    assert_eq!(named, ["low:1", "high:1"]);
    let ids = effects.iter().filter_map(|effect| match effect {
        Effect::Ask { id, question: EngineQuery::Acknowledge { .. } } => Some(id.clone()),
        _ => None,
    });
    let ids: Vec<String> = ids.collect();
    let accepted = || Box::new(Reply::Accepted { text: "it is acknowledged".to_owned(), version: None });
    let mut refused = console.clone();
    refused.tell(MsgKind::Answer { id: ids[0].clone(), reply: accepted() });
    assert_eq!(refused.model.requests.alarms_changed, 1);
    let reply = Reply::Refused { code: Refusal::NotNow, text: "it is normal again".to_owned(), hint: None };
    refused.tell(MsgKind::Answer { id: ids[1].clone(), reply: Box::new(reply) });
    assert_eq!(refused.model.requests.alarms_changed, 0, "it counts for no later alarm");
    for id in ids {
        console.tell(MsgKind::Answer { id, reply: accepted() });
    }
    let told = console.model.notice.as_ref().map(|notice| notice.text.clone());
    assert_eq!(told, Some(wording::engine_updates::alarm_changed("it is acknowledged", 1)));
    console.keys(" ");
    assert!(console.model.view_state.marked.is_empty());
    assert!(console.keys("gm").is_empty() && console.model.view_state.marked.len() == 1);
    console.keys("gm");
    assert!(console.model.view_state.marked.is_empty(), "the same key takes the mark away");
}

#[test]
fn changed_files_of_keys_and_themes_are_reloaded() {
    let mut console = TestConsole::new(0);
    console.now_ms += 5_000;
    assert!(console.tell(MsgKind::Tick).contains(&Effect::CheckOperatorFiles));
    assert!(!console.tell(MsgKind::Tick).contains(&Effect::CheckOperatorFiles), "not at every tick");
    let keymap = Keymap::with_file("keys.toml", "[keys]\nalarms = [\"f5\"]\n").unwrap();
    let themes = vec!["calm-dark".to_owned(), "dusk".to_owned()];
    console.tell(MsgKind::OperatorFiles { keymap: Arc::new(keymap), themes });
    console.press(KeyCode::F(5));
    assert_eq!(console.model.view_state.view, View::Alarms);
    assert_eq!(console.keys("T"), [Effect::UseTheme("dusk".to_owned())]);
}

/// After a long shift the newest thousand records were telemetry digests, and notes and stops could not be reached.
#[test]
fn each_pane_of_the_log_is_read_separately() {
    let mut console = TestConsole::new(0);
    let group_of = |effects: &[Effect]| match effects {
        [Effect::Ask { question: EngineQuery::Audit(group), .. }] => *group,
        other => panic!("{other:?}"),
    };
    let first_group = group_of(&console.keys("7"));
    assert_eq!(first_group, AuditGroup::Events);
    for kind in RecordKind::SEALS {
        let leave_out = AuditGroup::ALL.map(|group| group.leaves_out().contains(&kind));
        assert_eq!(leave_out, [true, true, true, true, false]);
    }
    for kind in [RecordKind::ShiftNote, RecordKind::EngineBegan, RecordKind::EngineEnded] {
        assert!(!first_group.leaves_out().contains(&kind), "{kind}");
    }
    assert_eq!(group_of(&console.press(KeyCode::Tab)), AuditGroup::People);
}
