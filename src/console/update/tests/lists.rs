//! Lists of versions: one filter by state in both, one search in all, and a state that no long name hides.

use super::consistency::screen;
use super::*;
use crate::model::EventLogLine;
use crate::state_filter::StateFilter;
use crate::theme::StateMark;
use holdpoint_governance::approval::Requester;
use holdpoint_governance::lifecycle::{Stage, State, VersionFlags};
use holdpoint_governance::record::VersionSummary;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::Reply;
use holdpoint_protocol::detail::RegistryPage;
use holdpoint_protocol::snapshot::ApprovalRequestView;
use holdpoint_wording::console as wording;

/// A version of 60 characters.
fn long_version() -> String {
    let version = format!("grasp@1.4.0-rc.{}", "7".repeat(45));
    assert_eq!(version.len(), 60);
    version
}

const PAUSED: VersionFlags = VersionFlags {
    running: None,
    paused: true,
    awaiting_approval: false,
    provisional: false,
    restricted: false,
    rollback_pending: false,
};

/// One version that runs, one queued, one that waits, two on hold and one rejected; `place@1.1.0` is the operator's own.
fn versions() -> Vec<(&'static str, State, VersionFlags, &'static str)> {
    let none = VersionFlags { paused: false, ..PAUSED };
    let running = VersionFlags { running: Some(Stage::Sandbox), ..none };
    let asked = VersionFlags { awaiting_approval: true, ..none };
    vec![
        ("align@1.1.0", State::Validated, running, "cora"),
        ("align@1.2.0", State::Registered, none, "cora"),
        (CANDIDATE, State::Shadowed, asked, "cora"),
        ("place@1.1.0", State::Sandboxed, PAUSED, "ana"),
        ("place@1.2.0", State::Demoted, none, "cora"),
        ("place@1.3.0", State::Rejected, none, "cora"),
    ]
}

fn console_with(versions: &[(&str, State, VersionFlags, &str)]) -> TestConsole {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    let first = now.candidates[0].clone();
    let candidate = |(version, state, flags, author): &(&str, State, VersionFlags, &str)| {
        let mut candidate = first.clone();
        (candidate.version, candidate.state) = (version.parse().unwrap(), *state);
        (candidate.flags, candidate.author) = (*flags, (*author).to_owned());
        candidate
    };
    now.candidates = versions.iter().map(candidate).collect();
    let row = |(version, state, flags, author): &(&str, State, VersionFlags, &str)| -> VersionSummary {
        serde_json::from_value(json!({ "version": version, "state": state, "row_version": 1, "flags": flags,
            "kappas": [null, null, null, null], "baseline": false, "author": author, "provenance": "manual",
            "risk": "low", "changed_ms": 0 }))
        .unwrap()
    };
    let rows: Vec<VersionSummary> = versions.iter().map(row).collect();
    let total = u64::try_from(rows.len()).unwrap();
    let page = RegistryPage { rows, total, thresholds: [0.95, 0.9, 0.85, 0.8], anchors: Vec::new() };
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    console.tell(MsgKind::Resize(120, 36));
    console.model.engine_data.registry.take(page);
    console
}

fn overview(console: &TestConsole) -> Vec<String> {
    let mut rows: Vec<String> =
        console.model.pipeline_rows().iter().map(|row| row.version.to_string()).collect();
    rows.sort();
    rows
}

#[test]
fn the_key_filters_overview_and_registry_by_state() {
    let mut console = console_with(&versions());
    assert_eq!(console.model.state_counts(), [6, 1, 1, 1, 2, 1, 2]);
    let text = screen(&console, 160, 36);
    assert!(text.contains("running 1  queued 1  waiting 1  held 2  rejected 1  mine 2"), "{text}");
    let own = ["grasp@1.3.0", "place@1.1.0"];
    for (filter, expected) in [
        (StateFilter::Running, &["align@1.1.0"][..]),
        (StateFilter::Queued, &["align@1.2.0"][..]),
        (StateFilter::Waiting, &[CANDIDATE][..]),
        (StateFilter::Held, &["place@1.1.0", "place@1.2.0"][..]),
        (StateFilter::Rejected, &["place@1.3.0"][..]),
        (StateFilter::Mine, &own[..]),
    ] {
        assert!(console.keys("i").is_empty());
        assert_eq!(console.model.view_state.state_filter, filter);
        assert_eq!(overview(&console), expected, "{filter:?}");
        let mut registry = console.clone();
        registry.keys("2");
        let listed = registry.model.registry_rows();
        let versions: Vec<String> = listed
            .iter()
            .filter_map(|item| match item {
                crate::rows::RegistryItem::Version(row) => Some(row.version.to_string()),
                crate::rows::RegistryItem::Family { .. } => None,
            })
            .collect();
        assert_eq!(versions, expected, "{filter:?}");
        for (columns, rows) in [(120, 36), (100, 30), (80, 24), (60, 16), (40, 12)] {
            for console in [&console, &registry] {
                let text = screen(console, columns, rows);
                assert!(text.contains(&format!("[{} {}]", filter.name(), expected.len())), "{text}");
            }
        }
    }
    console.keys("i");
    assert_eq!(overview(&console).len(), 6);
}

/// A queued version had `risk low`, the author's estimate, and `risk medium` once it was assessed.
#[test]
fn risk_before_the_assessment_is_an_estimate() {
    let registered = ("align@1.2.0", State::Registered, VersionFlags::default(), "cora");
    let mut console = console_with(&[registered]);
    let text = screen(&console, 200, 60);
    assert!(text.contains("manual, estimated risk medium"), "{text}");
    let mut now = console.model.engine_data.snapshot.as_deref().unwrap().clone();
    let dimensions = json!([{ "dimension": "policy", "outcome": "compatible", "kappa": 1.0, "interval": null,
        "threshold": 0.9, "measured": true }]);
    now.candidates[0].dimensions = serde_json::from_value(dimensions).unwrap();
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    let text = screen(&console, 200, 60);
    assert!(text.contains("manual, risk medium"), "{text}");
}

/// Two versions were "running", the count of one stood still with its time passing, and no line told why.
#[test]
fn a_resumed_stage_shows_that_it_waits_for_another_version() {
    let running = VersionFlags { running: Some(Stage::Sandbox), ..VersionFlags::default() };
    let both =
        [("align@1.3.0", State::Validated, running, "cora"), (CANDIDATE, State::Validated, running, "cora")];
    let mut console = console_with(&both);
    let mut now = console.model.engine_data.snapshot.as_deref().unwrap().clone();
    let progress = json!({ "stage": "sandbox", "what": "paired episodes", "done": 280, "budget": 300, "since_ms": 0,
        "early": "" });
    now.candidates[0].parked = true;
    now.candidates[0].progress = serde_json::from_value(progress).unwrap();
    now.prompts.clear();
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    let counts = console.model.state_counts();
    assert_eq!((counts[1], counts[2]), (1, 1), "one runs, and one waits");
    let text = screen(&console, 200, 60);
    let waits = "stands still at 280 of 300 paired episodes: waits for grasp@1.3.0, in sandbox";
    assert!(text.contains(StateMark::WAITS_ITS_TURN.label) && text.contains(waits), "{text}");
}

/// A version that was registered before a restart of the engine was younger than the time since then.
#[test]
fn age_of_a_version_counts_the_time_without_an_engine() {
    const WALL_MS: i64 = 1_795_501_000_000;
    let mut console = console_with(&[("align@1.2.0", State::Registered, VersionFlags::default(), "cora")]);
    let now = console.model.engine_data.snapshot.as_deref().unwrap().clone();
    console.tell(MsgKind::Snapshot(Arc::new(Snapshot { wall_ms: Some(WALL_MS), ..now })));
    let mut row = console.model.engine_data.registry.page.rows[0].clone();
    assert_eq!(console.model.age_ms(&row), 60_000, "without wall time");
    row.changed_at = Some(WallTime::from_ms(WALL_MS - 360_000));
    assert_eq!(console.model.age_ms(&row), 360_000);
}

#[test]
fn the_filter_by_state_is_typed_removed_and_refused_where_no_version_is_listed() {
    let mut console = console_with(&versions());
    console.keys(":filter held");
    console.press(KeyCode::Enter);
    assert_eq!(overview(&console).len(), 2);
    console.keys("/1.2");
    console.press(KeyCode::Enter);
    assert_eq!(overview(&console), ["place@1.2.0"], "both filters apply");
    let text = screen(&console, 120, 36);
    assert!(text.contains(&wording::pipeline::place_in_filter_of_all("[held] 1 of 1", "1.2", 6)), "{text}");
    console.press(KeyCode::Esc);
    assert_eq!(overview(&console).len(), 2, "the typed filter goes first");
    console.press(KeyCode::Esc);
    assert_eq!(overview(&console).len(), 6);
    console.keys("5i");
    assert!(console.model.notice.as_ref().unwrap().bad);
    assert_eq!(console.model.view_state.state_filter, StateFilter::All);
    assert_eq!(console.model.alarm_rows().len(), 4);
    // Without a version that fits, the list says so.
    let mut console = console_with(&versions()[..1]);
    console.keys(":filter rejected");
    console.press(KeyCode::Enter);
    let text = screen(&console, 80, 24);
    assert!(
        text.contains(wording::pipeline::NO_CANDIDATE_FITS) && text.contains("[rejected 0]  none"),
        "{text}"
    );
}

#[test]
fn a_request_that_the_operator_may_not_answer_is_not_mine() {
    type Answered = fn(&mut ApprovalRequestView);
    let answered: [Answered; 2] = [
        |prompt| prompt.approved_by = vec!["ana".to_owned()],
        |prompt| prompt.requester = Requester::Person { name: "ana".to_owned(), key: String::new() },
    ];
    for answer in answered {
        let mut console = console_with(&versions());
        let mut now = (**console.model.engine_data.snapshot.as_ref().unwrap()).clone();
        answer(&mut now.prompts[0]);
        console.tell(MsgKind::Snapshot(Arc::new(now)));
        let heading = wording::waits::for_others(1);
        assert!(screen(&console, 120, 36).contains(&heading), "others answer it");
        console.model.view_state.state_filter = StateFilter::Mine;
        assert_eq!(overview(&console), ["place@1.1.0"]);
        console.model.session.operator = None;
        assert!(overview(&console).is_empty(), "no operator is named");
        assert!(!screen(&console, 120, 36).contains(&heading), "it waits for any user");
    }
}

#[test]
fn a_long_version_leaves_its_state_whole() {
    let name = long_version();
    let provisional = VersionFlags { provisional: true, paused: false, ..PAUSED };
    for (state, flags, label) in [
        (State::Sandboxed, PAUSED, "paused"),
        (State::Rejected, VersionFlags { paused: false, ..PAUSED }, "rejected"),
        (State::Active, provisional, "active, provisional"),
        (State::Shadowed, VersionFlags { awaiting_approval: true, ..provisional }, "awaiting approval"),
    ] {
        let mut console = console_with(&[(name.as_str(), state, flags, "cora")]);
        for key in ["1", "2"] {
            console.keys(key);
            for (columns, rows) in [(120, 36), (80, 24), (60, 16), (40, 16)] {
                let text = screen(&console, columns, rows);
                // The row of the version, above what a view says about it in full.
                let is_row =
                    |line: &&str| (line.contains("grasp@1") || line.contains("1.4")) && line.contains(label);
                assert!(
                    text.lines().any(|line| is_row(&line)),
                    "{label}, {columns}x{rows}, view {key}:\n{text}"
                );
            }
        }
    }
}

#[test]
fn one_search_text_is_found_in_every_list() {
    let mut console = console_with(&versions());
    console.keys("/place");
    console.press(KeyCode::Enter);
    assert_eq!(overview(&console).len(), 3);
    // The same text, in a list that hides nothing for it.
    console.press(KeyCode::Esc);
    console.keys("2g");
    console.keys("n");
    let here = |console: &TestConsole| console.model.item_key(console.model.row());
    let family = |name: &str| holdpoint_governance::ids::Family::new(name).unwrap();
    assert_eq!(here(&console), Some(crate::model::ItemKey::Family(family("place"))));
    console.keys("n");
    assert_eq!(console.model.version_here().unwrap().to_string(), "place@1.1.0");
    console.keys("5n");
    let notice = console.model.notice.as_ref().unwrap();
    assert!(notice.bad && notice.text == wording::shared::not_in_this_list("place"), "{notice:?}");
}

#[test]
fn the_log_of_keys_has_each_effect_refusal_and_answer() {
    let mut console = console_with(&versions());
    let entries = |console: &TestConsole| -> Vec<(String, String)> {
        console.model.key_log.entries.iter().map(|entry| (entry.key.clone(), entry.text.clone())).collect()
    };
    console.keys("jjgy");
    assert_eq!(entries(&console).len(), 1, "moves are left out: {:?}", entries(&console));
    console.keys("5i");
    let refused = console.model.key_log.entries.back().unwrap().clone();
    assert!(
        refused.refused && refused.key == "i" && refused.text == wording::navigation::NOT_FILTERED_BY_STATE,
        "{refused:?}"
    );
    console.keys("g");
    let effects = console.press(KeyCode::Char(' '));
    let Some(Effect::Ask { id, .. }) = effects.first() else { panic!("{effects:?}") };
    assert!(console.model.key_log.entries.back().unwrap().is_waiting());
    let reply = Reply::Accepted { text: "low:1 is acknowledged".to_owned(), version: None };
    console.tell(MsgKind::Answer { id: id.clone(), reply: Box::new(reply) });
    let answered = console.model.key_log.entries.back().unwrap().clone();
    assert_eq!((answered.key.as_str(), answered.answer.as_str()), ("space", "low:1 is acknowledged"));
    // What is typed into a field is in no entry; the line that ran is.
    console.keys(":theme nowhere");
    console.press(KeyCode::Enter);
    assert_eq!(entries(&console).last().unwrap().0, ":theme nowhere");
    let before = entries(&console).len();
    console.keys("L");
    assert_eq!(console.model.input.overlay, Some(Overlay::KeyLog(0)));
    for (columns, rows) in [(120, 36), (80, 24), (40, 16)] {
        let text = screen(&console, columns, rows);
        assert!(text.contains(&format!("1 of {before}")) && text.contains(":theme"), "{text}");
    }
    console.keys("j");
    assert_eq!(console.model.input.overlay, Some(Overlay::KeyLog(1)));
    assert!(screen(&console, 80, 24).contains(&wording::key_log::engine_answered("low:1 is acknowledged")));
    console.keys("G");
    assert_eq!(console.model.input.overlay, Some(Overlay::KeyLog(before - 1)));
    console.press(KeyCode::Esc);
    assert!(console.model.input.overlay.is_none() && entries(&console).len() == before);
}

/// A row of the event log is cut at the end of its pane.
#[test]
fn enter_shows_an_event_in_full() {
    let mut console = TestConsole::new(0);
    let text = (0..60).map(|number| format!("word{number:02}")).collect::<Vec<_>>().join(" ");
    let line = EventLogLine { seq: 1, at_ms: 60_000, text: text.clone(), shared: None };
    console.model.engine_data.events.push_back(line);
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    assert!(console.model.view_state.is_in_event_log());
    assert!(!screen(&console, 80, 24).contains("word59"), "the row is cut");
    console.press(KeyCode::Enter);
    for (columns, rows) in [(120, 36), (80, 24), (60, 18)] {
        let shown = screen(&console, columns, rows);
        assert!(shown.contains("word00") && shown.contains("word59"), "{columns}x{rows}:\n{shown}");
        assert!(shown.contains("X stop"), "{shown}");
    }
    // On a low screen the rest is below.
    console.model.size = (40, 14);
    assert!(!screen(&console, 40, 14).contains("word59"));
    console.keys("G");
    assert!(screen(&console, 40, 14).contains("word59"));
    assert!(matches!(&console.keys("y")[..], [Effect::Copy(copied)] if *copied == text));
    console.press(KeyCode::Esc);
    assert_eq!(console.model.input.overlay, None);
}

/// Without an active version of the family, the view was about the version that an earlier key had chosen.
#[test]
fn the_row_of_a_family_stands_for_its_active_version() {
    let mut console = console_with(&versions());
    console.keys("2g4");
    assert_eq!(console.model.view_state.view, View::Registry);
    let notice = console.model.notice.as_ref().map_or("", |notice| notice.text.as_str());
    let align = holdpoint_governance::ids::Family::new("align").unwrap();
    assert_eq!(notice, wording::update::no_active_version(&align));
    console.keys("jjj4");
    assert_eq!(console.model.view_state.view, View::Shadow);
    assert_eq!(console.model.subject().unwrap().to_string(), "grasp@1.2.0");
    let text = screen(&console, 120, 36);
    assert!(text.contains(wording::shadow::ACTIVE_HAS_NO_TWIN), "{text}");
}
