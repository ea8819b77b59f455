//! The text of an open approval request, as the engine gives it to the operator, who signs exactly that text.

use super::*;
use holdpoint_approvals::Nonce;
use holdpoint_protocol::approval_document::ApprovalDocument;
use holdpoint_protocol::command::Reply;
use holdpoint_protocol::snapshot::ApprovalRequestView;
use holdpoint_wording::approval::LineMark;

/// The lines of a request, shorter than an engine's.
fn lines(open: &ApprovalRequestView) -> Vec<String> {
    let mut lines = vec![
        format!(
            "Promote {} ({}) to active on arm7, profile human?",
            open.version,
            &open.candidate.to_string()[..4]
        ),
        open.replaces.as_ref().map_or_else(|| "Replaces nothing".to_owned(), |id| format!("Replaces {id}")),
        format!("Evidence {}, policy {}", open.evidence, open.policy),
        "Without an answer it stays on hold, never approved".to_owned(),
    ];
    lines.extend(open.untested.iter().map(|what| format!("Not tested: {what}")));
    lines.extend(open.approved_by.iter().map(|by| format!("{by} signed")));
    lines
}

/// A snapshot whose requests have lines.
pub fn with_lines(mut now: Arc<Snapshot>) -> Arc<Snapshot> {
    let known = Arc::make_mut(&mut now);
    for open in known.prompts.iter_mut().chain(&mut known.emergencies) {
        open.lines = lines(open);
    }
    now
}

/// An approval request for one person, whose name it contains.
fn document(open: &ApprovalRequestView, who: &str) -> ApprovalDocument {
    let facts = json!({ "asked": { "name": who, "role": "safety" }, "question": open.id,
        "purpose": open.purpose, "version": open.version, "candidate": open.candidate,
        "row_version": open.row_version, "evidence": open.evidence, "policy": open.policy,
        "profile": open.profile, "needed": open.needed });
    let mut lines = lines(open);
    lines.insert(1, format!("You are asked as {who}"));
    ApprovalDocument {
        lines,
        facts: facts.to_string(),
        renderer: 1,
        request: Nonce::from_bytes([7; 16]),
        store_id: "s".to_owned(),
        store_key: "0".repeat(64),
        valid_until: open.valid_until,
    }
}

impl TestConsole {
    /// Answers like an engine, if the text was requested.
    pub fn deliver(&mut self, effects: &mut Vec<Effect>) {
        let is_query = |effect: &Effect| {
            matches!(effect, Effect::Ask { question: EngineQuery::ApprovalRequest { .. }, .. })
        };
        if let Some(at) = effects.iter().position(is_query) {
            let Effect::Ask { id, question: EngineQuery::ApprovalRequest { version, purpose, who } } =
                effects.remove(at)
            else {
                unreachable!("it was just looked at")
            };
            let open = self.model.engine_data.snapshot.as_ref().and_then(|now| {
                let all = now.prompts.iter().chain(&now.emergencies);
                all.clone().find(|open| open.version == version && open.purpose == purpose).cloned()
            });
            let Some(open) = open else { return };
            let reply = Box::new(Reply::Question { question: Box::new(document(&open, &who)) });
            effects.extend(update(
                &mut self.model,
                Msg { now_ms: self.now_ms, what: MsgKind::Answer { id, reply } },
            ));
        }
    }
}

/// An operator can approve only after the engine delivered the request, and only the one addressed to this operator.
#[test]
fn an_undelivered_request_is_not_approved() {
    let mut console = TestConsole::new(0);
    console.answers = false;
    console.keys("a");
    let effects = console.press(KeyCode::Enter);
    let query = |effects: &[Effect]| {
        effects.iter().find_map(|effect| match effect {
            Effect::Ask { id, question: EngineQuery::ApprovalRequest { who, .. } } => {
                Some((id.clone(), who.clone()))
            }
            _ => None,
        })
    };
    let (id, who) = query(&effects).unwrap();
    assert_eq!(who, "ana");
    console.draw((120, 80));
    console.now_ms += GUARD_MS;
    assert!(!decides(&console.keys("Y")));
    assert_eq!(console.block(), Some(DecisionObstacle::NotAsked));
    assert_eq!(query(&console.tell(MsgKind::Tick)), None, "it is asked once");
    // Another person's text is not accepted.
    let open = console.model.engine_data.snapshot.as_ref().unwrap().prompts[0].clone();
    let answer = |id: &str, who: &str| {
        let reply = Box::new(Reply::Question { question: Box::new(document(&open, who)) });
        MsgKind::Answer { id: id.to_owned(), reply }
    };
    console.tell(answer(&id, "bo"));
    console.draw((120, 80));
    assert!(!decides(&console.keys("Y")));
    assert_eq!(console.block(), Some(DecisionObstacle::NotAsked));
    // The key that reads again requests the text again; another operator gets another text.
    let (id, _) = query(&console.keys("r")).unwrap();
    console.tell(answer(&id, "ana"));
    console.draw((120, 80));
    console.now_ms += GUARD_MS;
    let mut other = console.clone();
    let seated = MsgKind::Operator(Operator {
        name: "bo".to_owned(),
        role: Role::Safety,
        protection: Protection::None,
    });
    assert_eq!(query(&other.tell(seated)).unwrap().1, "bo");
    assert!(!decides(&other.keys("Y")));
    assert!(decides(&console.keys("Y")));
}

/// The text names earlier signers, so the engine renders it again; the typed fields stay.
#[test]
fn another_approval_renders_the_request_again() {
    let mut console = TestConsole::new(2);
    console.open_prompt();
    console.fill("aaaa", "looks right");
    let mut now = snapshot(2, 'e');
    now.prompts[0].approved_by = vec!["bo".to_owned()];
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    assert!(!decides(&console.keys("Y")));
    assert_eq!(console.block(), Some(DecisionObstacle::Guard));
    console.now_ms += GUARD_MS;
    assert!(!decides(&console.keys("Y")));
    assert_eq!(console.block(), Some(DecisionObstacle::Unread), "the line about the first signer is unread");
    console.draw((120, 80));
    let effects = console.keys("Y");
    let Some(Effect::Decide { decision, .. }) = effects.first() else { panic!("{effects:?}") };
    assert_eq!(decision.reason(), "looks right");
    let signed = &decision.question().unwrap().lines;
    assert!(signed.contains(&"bo signed".to_owned()), "{signed:?}");
}

/// A line that a sender added to the facts' own lines has no color of theirs.
#[test]
fn lines_are_marked_by_the_facts_alone() {
    let mut console = TestConsole::new(0);
    console.open_prompt();
    let Some(Overlay::Approval(prompt)) = &console.model.input.overlay else { panic!("the prompt is open") };
    assert!(!prompt.text().is_empty());
    let marked = (0..prompt.text().len()).find(|line| prompt.mark(*line) != LineMark::Plain);
    assert_eq!(marked, None, "these facts are no engine's");
}
