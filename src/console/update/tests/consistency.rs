//! Two places of the screen must not contradict each other.

use super::*;
use crate::rows::CandidateItem;
use holdpoint_governance::deployability::Deployability;
use holdpoint_governance::lifecycle::State;
use holdpoint_protocol::detail::Detail;
use holdpoint_wording::console as wording;

/// The screen as lines, at a size.
pub(super) fn screen(console: &TestConsole, columns: u16, rows: u16) -> String {
    let model = ConsoleModel { size: (columns, rows), ..console.model.clone() };
    let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Ascii);
    crate::frame::text_of(&model, &look, columns, rows)
}

fn detail(state: &serde_json::Value) -> Detail {
    let mut value = json!({
        "version": CANDIDATE, "against": null, "parent": "grasp@1.2.0", "digest": digest('a'), "summary": "",
        "author": "cora", "provenance": "manual", "risk": "low", "registered_ms": 0, "dimensions": [],
        "composite": null, "reasons": [], "conditions": [], "differences": [], "behavior": [], "modes": [],
        "drills": [], "decisions": [], "audit": [], "evidence": null, "untested": [] });
    let (Some(into), Some(more)) = (value.as_object_mut(), state.as_object()) else { panic!("objects") };
    into.extend(more.clone());
    serde_json::from_value(value).unwrap()
}

fn open_detail(console: &mut TestConsole, detail: Detail) {
    console.keys("3");
    console.model.engine_data.detail = Some(Arc::new(detail));
}

#[test]
fn better_names_the_average_and_its_interval() {
    let reason = json!({ "code": "behavior-improved", "dimension": "behavior",
        "finding": { "finding": "component-better", "component": "retry" },
        "evidence": 0.02, "limit": 0.0 });
    let behavior = |high: f64| {
        json!({ "reasons": [reason], "behavior": [{ "name": "retry", "candidate": 0.02, "active": 0.04,
            "interval": [-0.05, high], "limit": 0.15, "n": 120 }] })
    };
    let mut console = TestConsole::new(0);
    for (high, change, is_established) in [
        (0.01, wording::candidate::better_to_worse(0.05, 0.01), false),
        (-0.01, wording::candidate::better_by(0.01, 0.05), true),
    ] {
        open_detail(&mut console, detail(&behavior(high)));
        let is_caveat = |row: &CandidateItem<'_>| matches!(row, CandidateItem::Unproven(..));
        assert_eq!(console.model.candidate_rows(0).iter().any(is_caveat), !is_established, "{high}");
        let text = screen(&console, 100, 30);
        assert!(text.contains("on average") && text.contains(&change), "{text}");
        assert_eq!(text.contains("not established"), !is_established, "{text}");
    }
}

#[test]
fn an_empty_pane_explains_itself_by_state() {
    use wording::candidate as c;
    let grasp = holdpoint_governance::ids::Family::new("grasp").unwrap();
    let cases = [
        ("rolled-back", None, 1, c::TOOK_OVER_FROM_NONE.to_owned()),
        ("rolled-back", Some("grasp@1.1.0"), 1, c::no_field_differs(&"grasp@1.1.0".parse().unwrap())),
        ("registered", None, 1, c::nothing_to_compare_with(&grasp)),
        ("registered", None, 2, c::nothing_ran_yet(c::NO_SANDBOX_EPISODE)),
        ("rejected", None, 2, c::nothing_on_record(c::NO_SANDBOX_EPISODE, "rejected")),
        ("rejected", None, 3, c::nothing_on_record(c::NO_RECOVERY_DRILL, "rejected")),
        ("registered", None, 4, c::NO_DECISION_YET.to_owned()),
    ];
    for (state, against, pane, expected) in cases {
        let mut console = TestConsole::new(0);
        let mut now = snapshot(0, 'e');
        now.candidates[0].state = serde_json::from_value(json!(state)).unwrap();
        console.tell(MsgKind::Snapshot(Arc::new(now)));
        open_detail(&mut console, detail(&json!({ "against": against })));
        console.model.view_state.panes[View::Candidate as usize] = pane;
        let text = screen(&console, 100, 30);
        assert!(text.contains(&expected), "{state} {pane}:\n{text}");
    }
}

/// A rejected version still had the deployment outcome of an earlier decision.
#[test]
fn a_rejected_version_shows_no_deployment_outcome() {
    for (state, is_shown) in [(State::Shadowed, true), (State::Rejected, false)] {
        let mut console = TestConsole::new(0);
        let mut now = snapshot(0, 'e');
        (now.candidates[0].state, now.candidates[0].deployment) = (state, Some(Deployability::Conditionally));
        console.tell(MsgKind::Snapshot(Arc::new(now)));
        open_detail(&mut console, detail(&json!({})));
        let text = screen(&console, 120, 36);
        let outcome = format!("deployment {}", Deployability::Conditionally);
        assert_eq!(text.contains(&outcome), is_shown, "{state}: {text}");
    }
}

fn shadowed(state: &str, n: u64, reasons: &serde_json::Value) -> TestConsole {
    let mut console = TestConsole::new(0);
    let mut now = snapshot(0, 'e');
    now.candidates[0].state = serde_json::from_value(json!(state)).unwrap();
    now.candidates[0].reasons = serde_json::from_value(reasons.clone()).unwrap();
    now.candidates[0].shadow = (n > 0).then(|| {
        serde_json::from_value(json!({ "n": n, "output": 0.1, "governance": 0.2, "envelope": 0.1,
            "limits": [0.3, null, 0.4], "series": vec![[0.1, 0.2, 0.1]; usize::try_from(n).unwrap()], "disagreements": [] }))
        .unwrap()
    });
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    console.keys("4");
    console
}

#[test]
fn a_shadow_rejection_is_shown_as_decisive() {
    let reasons = json!([{ "code": "shadow-governance-divergence", "dimension": "shadow",
        "text": "policy hits are established as more frequent than under the active version",
        "evidence": 0.05, "limit": 0.0 }]);
    for (columns, rows) in [(120, 36), (80, 24)] {
        let text = screen(&shadowed("rejected", 9, &reasons), columns, rows);
        assert!(text.contains("shadow-governance-divergence"), "{text}");
        assert!(text.contains("in pairs") && !text.contains("decides nothing"), "{text}");
    }
}

#[test]
fn only_shadowed_sequences_are_described_as_alike() {
    let none = json!([]);
    for (n, expected) in [
        (0, wording::shadow::NO_SEQUENCE_YET.to_owned()),
        (1, wording::shadow::ONE_SEQUENCE_ALIKE.to_owned()),
        (7, wording::shadow::all_sequences_alike(7)),
    ] {
        let text = screen(&shadowed("sandboxed", n, &none), 100, 30);
        assert!(text.contains(&expected), "{n}:\n{text}");
        assert_eq!(text.contains("ended alike"), n > 0, "{n}:\n{text}");
    }
}

#[test]
fn the_first_line_names_the_site_file() {
    let first =
        |console: &TestConsole| screen(console, 120, 36).lines().next().unwrap_or_default().to_owned();
    let mut console = TestConsole::new(0);
    assert!(!first(&console).contains("  site "), "the built-in site has no file: {}", first(&console));
    let site_file = Some("/etc/cells/line-4.toml".to_owned());
    console.tell(MsgKind::Snapshot(Arc::new(Snapshot { site_file, ..snapshot(0, 'e') })));
    assert!(first(&console).contains("  site line-4.toml"), "{}", first(&console));
}

/// At 80 columns the first line ended with a bare "00:01:00", which read as a time of day.
#[test]
fn the_first_line_names_the_clock_of_the_engine() {
    for wall_ms in [None, Some(((18 * 60 + 31) * 60 + 56) * 1_000)] {
        let mut console = TestConsole::new(0);
        console.tell(MsgKind::Snapshot(Arc::new(Snapshot { wall_ms, ..snapshot(0, 'e') })));
        for (columns, rows) in [(120, 36), (80, 24), (60, 16), (40, 12)] {
            let screen = screen(&console, columns, rows);
            let first = screen.lines().next().unwrap_or_default();
            let is_named = first.contains("engine 00:01:00") || !first.contains("00:01:00");
            assert!(is_named, "{columns}: {first}");
        }
        assert!(screen(&console, 80, 24).lines().next().unwrap().contains("engine 00:01:00"));
    }
}

/// The second engine of a store showed the time of both, seconds after its start.
#[test]
fn the_clock_of_the_engine_begins_with_it() {
    let mut console = TestConsole::new(0);
    let up_since_ms = Some(57_000);
    console.tell(MsgKind::Snapshot(Arc::new(Snapshot { up_since_ms, ..snapshot(0, 'e') })));
    let screen = screen(&console, 80, 24);
    assert!(screen.lines().next().unwrap().contains("engine 00:00:03"), "{screen}");
}

fn approval_record(seq: u64, kind: &str, change: &serde_json::Value) -> serde_json::Value {
    json!({ "seq": seq, "prev": digest('a'), "hash": digest('b'), "at_ms": seq, "kind": kind,
        "subject": CANDIDATE, "body": json!({ "change": change, "rows": [] }).to_string(), "wall_ms": 0 })
}

/// The card named a limit that the version was admitted below, and not the people who waived it.
#[test]
fn the_card_names_who_waived_a_limit() {
    let put = |seq, who: &str, nonce: &str, evidence: char| {
        let change = json!({ "change": "put-approval", "decision": "approve", "who": who, "nonce": nonce,
            "evidence_digest": digest(evidence) });
        approval_record(seq, "approval-put", &change)
    };
    let used = |seq, nonce: &str| {
        let change = json!({ "change": "consume-approval", "nonce": nonce, "evidence_digest": digest('e') });
        approval_record(seq, "approval-consumed", &change)
    };
    let audit = json!([
        used(9, "3"),
        used(8, "2"),
        put(7, "linus", "3", 'e'),
        put(6, "grace", "2", 'e'),
        put(5, "mara", "1", 'e'),
        used(4, "0"),
        put(3, "bert", "0", 'd')
    ]);
    let recovery = |kappa: f64| {
        json!([{ "dimension": "recovery", "outcome": "suspicious", "kappa": kappa, "interval": null,
            "threshold": 0.8, "measured": true }])
    };
    let card = |state: &str, dimensions: serde_json::Value| {
        let mut console = TestConsole::new(0);
        let mut now = snapshot(0, 'e');
        now.prompts.clear();
        now.candidates[0].state = serde_json::from_value(json!(state)).unwrap();
        now.candidates[0].flags = serde_json::from_value(flags(true, false)).unwrap();
        console.tell(MsgKind::Snapshot(Arc::new(now)));
        open_detail(&mut console, detail(&json!({ "dimensions": dimensions, "audit": audit })));
        screen(&console, 120, 36)
    };
    let waived = wording::candidate::admitted_and_waived("recovery 0.50 of 0.80", "linus, grace");
    let text = card("active", recovery(0.5));
    // Not mara, whose approval was not used, and not bert, who approved other evidence.
    assert!(text.lines().any(|line| line.trim_end() == waived), "{text}");
    assert!(!card("active", recovery(0.9)).contains("waived"), "within its limit");
    assert!(!card("shadowed", recovery(0.5)).contains("waived"), "not admitted");
}

/// The pane said that nothing had been read where the log has no such record.
#[test]
fn a_kind_without_records_is_not_called_unread() {
    let mut console = TestConsole::new(0);
    console.keys("7");
    assert!(screen(&console, 120, 36).contains(wording::audit::NO_RECORD_READ));
    let page = holdpoint_protocol::detail::AuditPage { rows: Vec::new(), head: 9 };
    console.model.engine_data.audit = Arc::new(page);
    assert!(screen(&console, 120, 36).contains(wording::audit::NO_RECORD_OF_THIS_KIND));
}

#[test]
fn the_item_of_a_row_leads_back_to_the_row_in_every_view() {
    let mut console = TestConsole::new(0);
    let mut rows = 0;
    for view in View::ALL {
        console.model.view_state.view = view;
        for pane in 0..view.panes().len() {
            console.model.view_state.panes[view as usize] = pane;
            for row in 0..console.model.row_count() {
                let item = console.model.item_key(row).unwrap();
                assert_eq!(console.model.row_of(&item), Some(row), "{view:?} {pane}: {item:?}");
                rows += 1;
            }
            let expected = (console.model.row_count(), console.model.version_here());
            assert_eq!(console.model.rows_and_version(), expected, "{view:?} {pane}");
        }
    }
    // One candidate in two panes, four alarms, one request.
    assert!(rows > 2 + 4, "{rows}");
}
