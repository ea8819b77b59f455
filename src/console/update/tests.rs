//! Tables of what can never happen at the keyboard, and of what must always be possible.

use std::sync::Arc;

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::layout::Rect;
use serde_json::json;

use self::delivered_request::with_lines;
use self::stray_keys::REFLEXES;
use super::update;
use crate::action::Action;
use crate::approval_screen::{DecisionObstacle, GUARD_MS};
use crate::effect::{Effect, EngineQuery};
use crate::form::{Abort, FormProblem, Intent};
use crate::frame::decision_on_screen;
use crate::keymap::Keymap;
use crate::look::{ColorDepth, Glyphs, Look, Theme};
use crate::model::{ConsoleModel, ConsoleSettings, EngineState, Overlay, Typing, View};
use crate::msg::{Msg, MsgKind};
use crate::operator::Operator;
use holdpoint_approvals::keyfile::Protection;
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_protocol::command::{Caller, Command};
use holdpoint_protocol::snapshot::{Snapshot, StoppedView};

mod approved_while_stopped;
mod attached_consoles;
mod consistency;
mod cursor_target;
mod delivered_request;
mod form_refresh;
mod health;
mod lists;
mod lost_engine;
mod marks;
mod no_engine;
mod offers;
mod reading;
mod recording;
mod records;
mod signing;
mod stopping;
mod stray_keys;
mod undo;
mod why;

const CANDIDATE: &str = "grasp@1.3.0";

fn digest(letter: char) -> String {
    letter.to_string().repeat(64)
}

fn flags(provisional: bool, awaiting: bool) -> serde_json::Value {
    json!({ "running": null, "paused": false, "awaiting_approval": awaiting, "provisional": provisional,
        "restricted": false, "rollback_pending": false })
}

fn alarm(name: &str, priority: &str, state: &str) -> serde_json::Value {
    let acknowledged = (state == "acknowledged").then_some("ana");
    json!({ "alarm": name, "subject": "monitor", "state": state, "priority": priority, "text": "something",
        "since_ms": 10, "state_below": state, "latching": state == "latched", "acknowledged_by": acknowledged,
        "shelf": null, "raises": 1, "chattering": false })
}

fn snapshot(tier: u8, evidence: char) -> Snapshot {
    let value = json!({
        "at_ms": 60_000, "profile": "human", "robot": "arm7", "seed": 1, "policy": digest('b'),
        "agent": digest('c'), "holding": null,
        "families": [{ "family": "grasp", "active": "grasp@1.2.0", "pinned": "grasp@1.1.0",
            "safe_stopped": false, "flags": flags(false, false), "provisional": null }],
        "candidates": [{ "version": CANDIDATE, "digest": digest('a'), "state": "shadowed",
            "flags": flags(false, true), "row_version": 7, "author": "cora", "provenance": "manual",
            "risk": "medium", "progress": null, "dimensions": [], "composite": null, "pairs": null,
            "drills": null, "shadow": null, "reasons": [], "conditions": [], "confirmed": false }],
        "prompts": [{ "id": "p1", "version": CANDIDATE, "replaces": "grasp@1.2.0", "candidate": digest('a'),
            "row_version": 7, "evidence": digest(evidence), "policy": digest('b'), "profile": "human",
            "needed": 2, "approved_by": [], "until": "2026-01-01T00:10:00Z", "valid_until": "2026-01-01T00:15:00Z",
            "store_id": "s", "asked": "2026-01-01T00:00:50Z", "tier": tier, "author": "cora", "new_permissions": [],
            "untested": [], "on_drift": "rolled back" }],
        "questions": [],
        "alarms": [alarm("low:1", "low", "unacknowledged"), alarm("high:1", "high", "unacknowledged"),
            alarm("seen:1", "high", "acknowledged"), alarm("latched:1", "critical", "latched")],
        "alarm_summary": { "highest_unacknowledged": "high", "unacknowledged": [0, 1, 1],
            "acknowledged": 1, "latched": 1, "shelved": 0, "flood": false },
        "live": { "sequences": 3, "recent_success": 1.0, "recent": 3, "last": [], "drift": null, "fault": null,
            "pace": 1.0, "outcomes": [true, true, true], "monitors": [] },
        "scenery": { "workspace": null, "keep_outs": [], "fixtures": [] },
        "thresholds": [0.95, 0.9, 0.85, 0.8],
    });
    serde_json::from_value(value).unwrap()
}

#[derive(Clone)]
struct TestConsole {
    model: ConsoleModel,
    now_ms: u64,
    answers: bool,
}

impl TestConsole {
    fn new(tier: u8) -> Self {
        let settings =
            ConsoleSettings { read_only: false, mouse: false, tour: None, theme: "calm-dark".to_owned() };
        let themes = vec!["calm-dark".to_owned(), "mono".to_owned()];
        let model = ConsoleModel::new(settings, Arc::new(Keymap::default()), themes);
        let mut console = Self { model, now_ms: 1_000, answers: true };
        console.tell(MsgKind::EngineStarted);
        console.tell(MsgKind::Snapshot(Arc::new(snapshot(tier, 'e'))));
        console.sit("ana");
        console
    }

    fn sit(&mut self, name: &str) {
        self.sit_with(name, Protection::None);
    }

    fn tell(&mut self, what: MsgKind) -> Vec<Effect> {
        let what = match what {
            MsgKind::Snapshot(now) => MsgKind::Snapshot(with_lines(now)),
            other => other,
        };
        let mut effects = update(&mut self.model, Msg { now_ms: self.now_ms, what });
        if self.answers {
            self.deliver(&mut effects);
        }
        effects
    }

    fn press(&mut self, code: KeyCode) -> Vec<Effect> {
        self.tell(MsgKind::Key(KeyEvent::new(code, KeyModifiers::NONE)))
    }

    fn control(&mut self, letter: char) -> Vec<Effect> {
        self.tell(MsgKind::Key(KeyEvent::new(KeyCode::Char(letter), KeyModifiers::CONTROL)))
    }

    fn keys(&mut self, text: &str) -> Vec<Effect> {
        text.chars().flat_map(|letter| self.press(KeyCode::Char(letter))).collect()
    }

    fn open_prompt(&mut self) {
        self.keys("a");
        self.press(KeyCode::Enter);
        assert!(matches!(self.model.input.overlay, Some(Overlay::Approval(_))), "{:?}", self.model.notice);
        self.draw((120, 80));
        self.now_ms += GUARD_MS;
    }

    fn draw(&mut self, (width, height): (u16, u16)) {
        let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Ascii);
        let visible = decision_on_screen(&self.model, &look, Rect::new(0, 0, width, height));
        if let Some(visible) = visible {
            self.tell(MsgKind::DecisionShown(visible));
        }
    }

    fn fill(&mut self, short_id: &str, reason: &str) {
        self.press(KeyCode::Tab);
        self.keys(short_id);
        self.press(KeyCode::Tab);
        self.keys(reason);
        self.press(KeyCode::Tab);
    }

    fn block(&self) -> Option<DecisionObstacle> {
        match &self.model.input.overlay {
            Some(Overlay::Approval(prompt)) => prompt.refused,
            _ => None,
        }
    }
}

fn decides(effects: &[Effect]) -> bool {
    effects.iter().any(|effect| matches!(effect, Effect::Decide { .. }))
}

fn harmless(effects: &[Effect]) -> bool {
    effects.iter().all(|effect| match effect {
        Effect::Decide { .. } | Effect::Operate { .. } | Effect::End | Effect::Register { .. } => false,
        Effect::Ask { question, .. } => {
            use EngineQuery as Q;
            let reads = matches!(question, Q::Detail(_) | Q::Registry { .. } | Q::Audit(_));
            reads || matches!(question, Q::Health(_) | Q::AlarmHistory(_))
        }
        _ => true,
    })
}

#[test]
fn reflex_keys_paste_and_letters_never_approve() {
    for tier in 0..=2 {
        for key in REFLEXES {
            let mut console = TestConsole::new(tier);
            console.open_prompt();
            assert!(!decides(&console.press(key)), "tier {tier}: {key:?}");
            assert!(!decides(&console.press(key)), "tier {tier}: {key:?} twice");
        }
        let mut console = TestConsole::new(tier);
        console.open_prompt();
        for text in ["Y", "Y\n", "aaaa\tY\r\n", "N"] {
            assert!(!decides(&console.tell(MsgKind::Paste(text.to_owned()))), "tier {tier}: paste {text:?}");
        }
        for letter in ('!'..='~').filter(|letter| *letter != 'Y') {
            let mut console = TestConsole::new(tier);
            console.open_prompt();
            assert!(!decides(&console.press(KeyCode::Char(letter))), "tier {tier}: {letter:?}");
        }
    }
}

#[test]
fn no_letter_decides_without_an_open_request() {
    for view in View::ALL {
        for letter in ' '..='~' {
            let mut console = TestConsole::new(0);
            console.model.view_state.view = view;
            assert!(!decides(&console.press(KeyCode::Char(letter))), "{view:?}: {letter:?}");
        }
    }
}

#[test]
fn keys_inside_the_guard_time_never_approve() {
    for (wait_ms, counts) in [(0, false), (1, false), (GUARD_MS - 1, false), (GUARD_MS, true)] {
        let mut console = TestConsole::new(0);
        console.keys("a");
        console.press(KeyCode::Enter);
        console.draw((120, 80));
        console.now_ms += wait_ms;
        assert_eq!(decides(&console.keys("Y")), counts, "{wait_ms} ms");
        if !counts {
            assert_eq!(console.block(), Some(DecisionObstacle::Guard));
        }
    }
}

#[test]
fn higher_tiers_need_more_input() {
    // Short id typed, reason typed; the obstacle to Y in tiers 0, 1 and 2.
    let table = [
        ("", "", [None, Some(DecisionObstacle::ShortId), Some(DecisionObstacle::ShortId)]),
        ("aaab", "", [None, Some(DecisionObstacle::ShortId), Some(DecisionObstacle::ShortId)]),
        ("aaaa", "", [None, None, Some(DecisionObstacle::Reason)]),
        ("aaaa", "looks right", [None, None, None]),
    ];
    for (short_id, reason, blocks) in table {
        for (tier, block) in (0..=2).zip(blocks) {
            let mut console = TestConsole::new(tier);
            console.open_prompt();
            if tier == 0 {
                console.press(KeyCode::Tab);
                console.keys(reason);
                console.press(KeyCode::Tab);
            } else {
                console.fill(short_id, reason);
            }
            let effects = console.keys("Y");
            assert_eq!(decides(&effects), block.is_none(), "tier {tier}, {short_id:?}, {reason:?}");
            assert_eq!(console.block(), block);
            let Some(Effect::Decide { decision, .. }) = effects.first() else { continue };
            assert_eq!((decision.by(), decision.answer()), ("ana", ApprovalDecision::Approve));
            assert_eq!(decision.over().evidence.to_string(), digest('e'));
            let shown = &decision.question().unwrap().lines;
            assert!(shown.contains(&"Replaces grasp@1.2.0".to_owned()), "{shown:?}");
            assert!(console.model.input.overlay.is_none());
        }
    }
}

#[test]
fn a_letter_typed_into_a_field_is_text() {
    let mut console = TestConsole::new(1);
    console.open_prompt();
    console.press(KeyCode::Tab);
    assert!(!decides(&console.keys("aaaaY")));
    let Some(Overlay::Approval(prompt)) = &console.model.input.overlay else { panic!("the prompt is open") };
    assert_eq!(prompt.short_id.text(), "aaaaY");
}

#[test]
fn changed_evidence_cannot_be_approved_until_it_was_read_again() {
    type PromptChange = fn(&mut Snapshot);
    let changes: [(&str, PromptChange); 7] = [
        ("the evidence changed", |now| now.prompts[0].evidence = digest('f').parse().unwrap()),
        ("the candidate changed", |now| now.prompts[0].candidate = digest('f').parse().unwrap()),
        ("the policy changed", |now| now.prompts[0].policy = digest('f').parse().unwrap()),
        ("the request was renewed", |now| now.prompts[0].row_version += 1),
        ("the active version changed", |now| now.prompts[0].replaces = None),
        ("its text changed", |now| now.prompts[0].untested = vec!["a new gripper".to_owned()]),
        ("the question is closed", |now| now.prompts.clear()),
    ];
    for (what, change) in changes {
        let mut console = TestConsole::new(1);
        console.open_prompt();
        console.fill("aaaa", "");
        let mut changed = snapshot(1, 'e');
        change(&mut changed);
        console.tell(MsgKind::Snapshot(Arc::new(changed.clone())));
        assert!(!decides(&console.keys("Y")), "{what}");
        let closed = changed.prompts.is_empty();
        assert_eq!(
            console.block(),
            Some(if closed { DecisionObstacle::Closed } else { DecisionObstacle::Stale }),
            "{what}"
        );
        console.tell(MsgKind::Snapshot(Arc::new(snapshot(1, 'e'))));
        assert!(!decides(&console.keys("Y")), "{what}, and back");
        console.tell(MsgKind::Snapshot(Arc::new(changed.clone())));
        console.keys("r");
        let Some(Overlay::Approval(prompt)) = &console.model.input.overlay else { panic!("{what}") };
        assert_eq!(closed, prompt.refused == Some(DecisionObstacle::Closed), "{what}");
        if closed {
            continue;
        }
        assert!(prompt.stale.is_none() && prompt.short_id.text().is_empty(), "{what}");
        assert!(!decides(&console.keys("Y")), "{what}: the guard time starts over");
    }
}

#[test]
fn a_refused_approver_sees_the_reason() {
    let table = [
        (Some("ana"), None, None),
        (Some("cora"), None, Some(DecisionObstacle::OwnWork)),
        (Some("ana"), Some("ana"), Some(DecisionObstacle::Approved)),
        (Some("bo"), Some("ana"), None),
        (None, None, Some(DecisionObstacle::NoIdentity)),
    ];
    for (who, approved, block) in table {
        let mut console = TestConsole::new(0);
        let mut now = snapshot(0, 'e');
        now.prompts[0].approved_by = approved.into_iter().map(ToOwned::to_owned).collect();
        console.tell(MsgKind::Snapshot(Arc::new(now)));
        match who {
            Some(name) => console.sit(name),
            None => console.model.session.operator = None,
        }
        console.open_prompt();
        assert_eq!(decides(&console.keys("Y")), block.is_none(), "{who:?} after {approved:?}");
        assert_eq!(console.block(), block, "{who:?} after {approved:?}");
    }
}

#[test]
fn rejecting_needs_a_reason_and_its_key_again() {
    let mut console = TestConsole::new(2);
    console.open_prompt();
    assert!(!decides(&console.keys("N")));
    assert_eq!(console.block(), Some(DecisionObstacle::Reason));
    assert!(!decides(&console.keys("too hard a grip")), "this goes into the field");
    console.press(KeyCode::Esc);
    let effects = console.keys("N");
    let Some(Effect::Decide { decision, .. }) = effects.first() else { panic!("{effects:?}") };
    assert_eq!((decision.answer(), decision.reason()), (ApprovalDecision::Reject, "too hard a grip"));
}

#[test]
fn read_only_refuses_everything_that_changes_something() {
    for action in Action::ALL {
        let mut console = TestConsole::new(0);
        console.model.settings.read_only = true;
        console.model.view_state.view = View::Alarms;
        let effects = super::act(&mut console.model, *action);
        assert!(
            harmless(&effects) || matches!(action, Action::Verify | Action::Stop),
            "{action:?}: {effects:?}"
        );
        if action.changes_something() && *action != Action::Stop {
            assert!(effects.is_empty() && console.model.input.overlay.is_none(), "{action:?}");
        }
    }
    let mut console = TestConsole::new(0);
    console.model.settings.read_only = true;
    console.open_prompt();
    assert!(!decides(&console.keys("Y")));
    assert_eq!(console.block(), Some(DecisionObstacle::ReadOnly));
    for line in ["demo", "register x", "pace 5", "drift off", "goal grasp"] {
        console.model.input.overlay = None;
        console.keys(":");
        console.keys(line);
        assert!(console.press(KeyCode::Enter).is_empty(), "{line}");
    }
}

#[test]
fn abort_needs_two_keys_in_every_view() {
    let abort = |effects: &[Effect]| match effects {
        [Effect::Operate { confirmed, .. }] => {
            matches!(confirmed.clone().into_command(), Command::Pause(operation) if operation.version.to_string() == CANDIDATE)
        }
        _ => false,
    };
    for view in View::ALL {
        for key in [
            KeyEvent::new(KeyCode::Char('x'), KeyModifiers::NONE),
            KeyEvent::new(KeyCode::Char('x'), KeyModifiers::CONTROL),
        ] {
            let mut console = TestConsole::new(1);
            console.model.view_state.view = view;
            console.tell(MsgKind::Key(key));
            let effects = console.confirm();
            assert!(abort(&effects), "{view:?} {key:?}: {effects:?}");
        }
    }
    let openers: [fn(&mut TestConsole); 6] = [
        |console| console.open_prompt(),
        |console| {
            console.open_prompt();
            console.press(KeyCode::Tab);
        },
        |console| drop(console.keys(":pa")),
        |console| drop(console.keys("2/gr")),
        |console| drop(console.keys("?")),
        |console| {
            console.keys("3");
            console.keys("F");
        },
    ];
    for (number, open) in openers.into_iter().enumerate() {
        let mut console = TestConsole::new(1);
        open(&mut console);
        console.control('x');
        let effects = console.confirm();
        assert!(abort(&effects), "{number}: {effects:?}");
    }
}

#[test]
fn enter_and_cursor_keys_send_no_request_in_any_view() {
    for view in View::ALL {
        for key in REFLEXES.iter().filter(|key| **key != KeyCode::Char(' ')) {
            let mut console = TestConsole::new(0);
            console.model.view_state.view = view;
            let effects = console.press(*key);
            assert!(harmless(&effects), "{view:?} {key:?}: {effects:?}");
        }
    }
}

#[test]
fn filter_hides_no_alarm_and_no_waiting_request() {
    let mut console = TestConsole::new(0);
    console.model.view_state.filters =
        View::ALL.into_iter().map(|view| (view, "nothing has this name".to_owned())).collect();
    for view in View::ALL {
        console.model.view_state.view = view;
        assert_eq!(console.model.alarm_rows().len(), 4, "{view:?}");
        assert_eq!(console.model.waiting_rows().len(), 1, "{view:?}");
    }
    console.model.view_state.view = View::Overview;
    assert!(console.model.pipeline_rows().is_empty());
    console.press(KeyCode::Esc);
    assert_eq!(console.model.pipeline_rows().len(), 1, "Esc takes the filter away");
}

#[test]
fn alarms_are_reached_acknowledged_shelved_and_reset() {
    let mut console = TestConsole::new(0);
    console.keys("3!");
    assert_eq!(console.model.view_state.view, View::Alarms);
    let effects = console.press(KeyCode::Char(' '));
    let Some(Effect::Ask { question: EngineQuery::Acknowledge { alarm, by }, .. }) = effects.first() else {
        panic!("{effects:?}")
    };
    assert_eq!((alarm.as_str(), by.as_str()), ("high:1", "ana"));
    console.keys("j");
    assert!(console.press(KeyCode::Char(' ')).is_empty(), "seen already");
    console.keys("j");
    assert!(
        console.keys("z").is_empty() && console.model.input.overlay.is_none(),
        "critical ones are not shelved"
    );
    console.now_ms += GUARD_MS;
    console.keys("R");
    assert!(matches!(console.model.input.overlay, Some(Overlay::Form(_))));
    console.press(KeyCode::Esc);
    console.keys("gz");
    // The field already contains 30 minutes.
    console.press(KeyCode::Enter);
    console.keys("a sensor is being replaced");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    console.now_ms += GUARD_MS;
    let effects = console.press(KeyCode::Enter);
    let Some(Effect::Operate { confirmed, .. }) = effects.first() else { panic!("{effects:?}") };
    assert!(matches!(confirmed.as_ref().clone().into_command(),
        Command::ShelveAlarm { for_ms: 1_800_000, alarm, .. } if alarm == "low:1"));
}

#[test]
fn forms_refuse_missing_fields() {
    let mut console = TestConsole::new(0);
    console.keys("3F");
    for _ in 0..2 {
        console.press(KeyCode::Tab);
    }
    assert!(console.press(KeyCode::Enter).is_empty());
    let Some(Overlay::Form(form)) = &console.model.input.overlay else { panic!("it stays open") };
    assert_eq!(form.problem, Some(FormProblem::NoReason));
    console.model.session.operator = None;
    console.press(KeyCode::BackTab);
    console.press(KeyCode::BackTab);
    console.keys("because");
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    assert!(console.press(KeyCode::Enter).is_empty());
    let Some(Overlay::Form(form)) = &console.model.input.overlay else { panic!("it stays open") };
    assert_eq!(form.problem, Some(FormProblem::NoIdentity));
}

#[test]
fn quitting_asks_and_names_the_consequences() {
    let mut console = TestConsole::new(0);
    console.keys("4");
    assert!(console.keys("q").is_empty());
    assert_eq!(console.model.view_state.view, View::Overview);
    assert!(console.keys("q").is_empty());
    let Some(Overlay::Form(form)) = &console.model.input.overlay else { panic!("a form opens") };
    assert_eq!(form.intent, Intent::Quit);
    assert!(form.consequences.iter().any(|line| line.starts_with(CANDIDATE) && line.contains("approval")));
    assert_eq!(console.confirm(), [Effect::End]);
    assert_eq!(console.control('z'), []);
    assert!(
        console
            .model
            .notice
            .as_ref()
            .is_some_and(|notice| notice.text == holdpoint_wording::console::update::NO_SUSPENDING)
    );
    console.model.engine_data.engine = EngineState::Ended(Ok(()));
    assert_eq!(console.keys("q"), [Effect::End], "nothing is left to ask about");
}

#[test]
fn answers_reach_the_status_line_and_open_no_prompt() {
    let mut console = TestConsole::new(0);
    console.keys(":pace 5");
    let effects = console.press(KeyCode::Enter);
    let [Effect::Ask { id, question: EngineQuery::Pace(Some(times)) }] = effects.as_slice() else {
        panic!("{effects:?}")
    };
    assert_eq!(*times, 5.0);
    assert!(console.model.requests.pending.contains_key(id));
    let refused = json!({ "reply": "refused", "code": "not-now", "text": "no", "hint": "later" });
    let reply = Box::new(serde_json::from_value(refused).unwrap());
    console.tell(MsgKind::Answer { id: id.clone(), reply });
    let notice = console.model.notice.clone().unwrap();
    assert!(notice.bad && notice.text.contains("pace: no"), "{notice:?}");
    assert!(notice.text.ends_with("Hint: later"), "{notice:?}");
    assert!(!console.model.requests.pending.contains_key(id));
    console.tell(MsgKind::Snapshot(Arc::new(snapshot(2, 'f'))));
    assert!(console.model.input.overlay.is_none(), "prompts never steal the focus");
}

#[test]
fn frozen_charts_do_not_move_while_the_status_updates() {
    let mut console = TestConsole::new(0);
    console.keys("4f");
    let mut now = snapshot(0, 'e');
    now.at_ms = 99_000;
    now.alarm_summary.shelved = 3;
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    assert_eq!(console.model.charted().unwrap().at_ms, 60_000);
    assert_eq!(console.model.engine_data.snapshot.as_ref().unwrap().alarm_summary.shelved, 3);
    console.keys("f");
    assert_eq!(console.model.charted().unwrap().at_ms, 99_000);
}

#[test]
fn an_old_snapshot_is_stale() {
    let mut console = TestConsole::new(0);
    console.now_ms += 12_000;
    console.tell(MsgKind::Tick);
    assert_eq!(console.model.stale_ms(), Some(12_000));
}

#[test]
fn every_loss_of_the_terminal_ends_without_a_decision() {
    let mut console = TestConsole::new(0);
    console.open_prompt();
    assert_eq!(console.tell(MsgKind::EndRequested), [Effect::End]);
}
