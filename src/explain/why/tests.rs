//! Explanations of a long record, and of a rebuilt one.

use holdpoint_governance::explanation::DecisionRemark;
use holdpoint_governance::record::RecordKind;
use holdpoint_registry::{Store, UnsignedRecords, rebuild};
use holdpoint_store::{AUDIT_MAX, AuditBody, Change, PAGE_ROWS_MAX};

use super::decisions;
use super::explained_decision::{DecisionReason, ExplainedDecision};

#[path = "../../registry/tests/store/support.rs"]
#[allow(dead_code, clippy::duplicate_mod, reason = "the tests of the store use the rest")]
mod support;

const ACTIVE: &str = "grasp@1.0.0";
const CANDIDATE: &str = "grasp@1.1.0";

fn decisions_on(store: &Store, version: &str) -> Vec<ExplainedDecision> {
    let (views, id) = (store.views().unwrap(), support::id(version));
    let detail = views.version(&id).unwrap().unwrap();
    decisions(&views, &id, &detail).unwrap()
}

#[test]
fn a_long_record_keeps_its_oldest_and_newest_decisions() {
    let folder = tempfile::tempdir().unwrap();
    let store = support::open(folder.path());
    support::bootstrap(&store, "grasp");
    let note = |command: String, kind, body: &str, count| {
        let body = AuditBody { kind, subject: ACTIVE.to_owned(), body: body.to_owned() };
        let mut noted = support::transaction(&command, 1, Vec::new());
        noted.audit = vec![body; count];
        store.commit(noted).unwrap().last_seq
    };
    let decision = |command: &str| note(command.to_owned(), RecordKind::Decision, r#"{"outcome":"hold"}"#, 1);
    let first = decision("first");
    for command in 0..=PAGE_ROWS_MAX / AUDIT_MAX {
        note(format!("anchor {command}"), RecordKind::AnchorSet, "{}", AUDIT_MAX);
        note(format!("harm {command}"), RecordKind::LiveHarm, "{}", AUDIT_MAX);
    }
    let last = decision("last");
    let explained = decisions_on(&store, ACTIVE);
    assert_eq!(explained.iter().map(|decision| decision.record).collect::<Vec<_>>(), [first, last]);
    let followed = explained.first().unwrap().consequences.len();
    assert!(followed > PAGE_ROWS_MAX, "{followed} acts followed the first decision");
    let detail = store.views().unwrap().version(&support::id(ACTIVE)).unwrap().unwrap();
    assert_eq!(detail.audit_links.last(), Some(&last));
}

#[test]
fn answers_stand_at_their_records_after_a_rebuild_lost_one() {
    let folder = tempfile::tempdir().unwrap();
    let store = support::open(folder.path());
    support::bootstrap(&store, "grasp");
    support::shadowed(&store, CANDIDATE);
    let answers = |store: &Store| -> Vec<(u64, String)> {
        let answer = |decision: ExplainedDecision| match decision.reasons.into_iter().next() {
            Some(DecisionReason::Remark(DecisionRemark::Answer { person, .. })) => {
                Some((decision.record, person))
            }
            _ => None,
        };
        decisions_on(store, CANDIDATE).into_iter().filter_map(answer).collect()
    };
    for (name, nonce) in [("ada", 1), ("ben", 2)] {
        let signed = support::approve(&store, &support::person(&store, name), CANDIDATE, nonce);
        support::commit(&store, name, vec![Change::PutApproval(Box::new(signed))]).unwrap();
    }
    let before = answers(&store);
    assert_eq!(before.iter().map(|(_, person)| person.as_str()).collect::<Vec<_>>(), ["ada", "ben"]);
    drop(store);
    let database = rusqlite::Connection::open(folder.path().join("holdpoint.db")).unwrap();
    database.execute("UPDATE approval SET signed = '{}' WHERE who = 'ada'", []).unwrap();
    drop(database);
    let by = r#"{"user":"ada"}"#;
    let rebuilt = support::unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Take, by, 7));
    assert_eq!(rebuilt.unwrap().unwrap().lost.len(), 1);
    assert_eq!(answers(&support::open(folder.path())), before);
}
