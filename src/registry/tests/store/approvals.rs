//! Approvals: bound to the displayed text, used once.

use std::sync::Barrier;

use holdpoint_approvals::{Approval, ApprovalError, Identity, Nonce};
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::approval::Role;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_registry::verify;
use holdpoint_store::{
    ApprovalFault, ApprovalRequest, Change, EvidenceKind, Receipt, RequestState, StoreError,
};

use crate::quick_folder::quick_folder;
use crate::support::*;

const NEW: &str = "grasp@1.1.0";

/// Why a transaction about an approval is refused.
#[track_caller]
fn fault(result: Result<Receipt, StoreError>) -> ApprovalFault {
    match result {
        Err(StoreError::Approval { problem, .. }) => problem,
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_approval_that_four_threads_use_at_once_counts_once() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    shadowed(&store, NEW);
    let ada = person(&store, "ada");
    for round in 0..25u8 {
        let nonce = round + 1;
        let signed = Box::new(approve(&store, &ada, NEW, nonce));
        commit(&store, &format!("put {round}"), vec![Change::PutApproval(signed)]).unwrap();
        let start = Barrier::new(4);
        let wins: usize = std::thread::scope(|scope| {
            let use_approval = |thread: usize| {
                let (store, start) = (&store, &start);
                scope.spawn(move || {
                    start.wait();
                    usize::from(
                        commit(store, &format!("use {round} {thread}"), vec![consume(NEW, nonce)]).is_ok(),
                    )
                })
            };
            let threads: Vec<_> = (0..4).map(use_approval).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).sum()
        });
        assert_eq!(wins, 1, "round {round}");
    }
    assert_eq!(verify(&store.layout().database(), None).unwrap().approvals, 25);
}

#[test]
fn two_approvals_of_one_person_are_not_a_quorum_of_two() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    shadowed(&store, NEW);
    let (ada, bob) = (person(&store, "ada"), person(&store, "bob"));
    let put = [(&ada, 1), (&ada, 2), (&bob, 3)]
        .map(|(person, nonce)| Change::PutApproval(Box::new(approve(&store, person, NEW, nonce))));
    commit(&store, "put", put.to_vec()).unwrap();
    let activate_with = |nonces: [u8; 2]| {
        let mut changes: Vec<_> = nonces.into_iter().map(|nonce| consume(NEW, nonce)).collect();
        changes.extend(activation(NEW, ("grasp@1.0.0", 2), 2));
        changes
    };
    let error = commit(&store, "same", activate_with([1, 2])).unwrap_err().to_string();
    assert!(error.contains("2 people") && error.contains("1 gave"), "{error}");
    commit(&store, "both", activate_with([1, 3])).unwrap();
    let approvals = store.views().unwrap().approvals(&id(NEW)).unwrap();
    let used: Vec<_> = approvals.iter().map(|approval| approval.consumed_seq.is_some()).collect();
    assert_eq!(used, [true, false, true]);
}

#[test]
fn an_approval_bound_to_something_else_is_refused() {
    let other = digest("other");
    type StoredApprovalEdit = fn(&mut Approval, holdpoint_governance::ids::Digest);
    type IsDue = fn(&ApprovalFault) -> bool;
    let edits: [(&str, StoredApprovalEdit, IsDue); 8] = [
        (
            "refusal",
            |a, _| a.decision = ApprovalDecision::Reject,
            |fault| matches!(fault, ApprovalFault::Refusal),
        ),
        ("expired", |a, _| a.not_after_ms = 1, |fault| matches!(fault, ApprovalFault::Expired)),
        ("row version", |a, _| a.row_version = 3, |fault| matches!(fault, ApprovalFault::VersionChanged)),
        ("candidate", |a, d| a.candidate_digest = d, |fault| matches!(fault, ApprovalFault::OtherCandidate)),
        ("evidence", |a, d| a.evidence_digest = d, |fault| matches!(fault, ApprovalFault::EvidenceChanged)),
        ("policy", |a, d| a.policy_digest = d, |fault| matches!(fault, ApprovalFault::RulesChanged)),
        (
            "profile",
            |a, _| a.profile = ProfileName::Human,
            |fault| matches!(fault, ApprovalFault::RulesChanged),
        ),
        (
            "store",
            |a, _| a.store_id = "another".into(),
            |fault| matches!(fault, ApprovalFault::OtherStore(_)),
        ),
    ];
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    shadowed(&store, NEW);
    let ada = person(&store, "ada");
    for (nonce, (name, edit, is_due)) in (1..).zip(edits) {
        let mut approval = approval(&store, NEW, nonce);
        edit(&mut approval, other);
        let signed = ada.sign(over(approval, &ada)).unwrap();
        let put = commit(&store, &format!("put {name}"), vec![Change::PutApproval(Box::new(signed))]);
        let result = put.and_then(|_| commit(&store, &format!("use {name}"), vec![consume(NEW, nonce)]));
        assert!(is_due(&fault(result)), "{name}");
    }
}

#[test]
fn a_later_change_voids_an_approval() {
    type VoidingChanges = fn() -> Vec<Change>;
    let events: [(&str, VoidingChanges); 4] = [
        ("profile", || {
            let mut other = context(ProfileName::Sim);
            if let Change::SetContext { policy_digest, .. } = &mut other {
                *policy_digest = digest("other policies");
            }
            vec![other, context(ProfileName::Sim)]
        }),
        ("family", || vec![Change::VoidFamily { family: family("grasp"), reason: text("other active") }]),
        ("state", || vec![set_state(NEW, 4, State::Shadowed, State::Demoted)]),
        ("use", || vec![consume(NEW, 1)]),
    ];
    for (name, event) in events {
        let folder = quick_folder();
        let store = open(folder.path());
        bootstrap(&store, "grasp");
        shadowed(&store, NEW);
        let ada = person(&store, "ada");
        let signed = approve(&store, &ada, NEW, 1);
        commit(&store, "put", vec![Change::PutApproval(Box::new(signed.clone()))]).unwrap();
        commit(&store, "event", event()).unwrap();
        assert!(commit(&store, "use", vec![consume(NEW, 1)]).is_err(), "{name}");
        let again = commit(&store, "again", vec![Change::PutApproval(Box::new(signed))]);
        assert!(matches!(fault(again), ApprovalFault::Repeated), "{name}");
    }
}

#[test]
fn forged_and_unknown_approvals_are_refused() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    shadowed(&store, NEW);
    let signed = approve(&store, &person(&store, "ada"), NEW, 1);
    let mut json = serde_json::to_value(&signed).unwrap();
    json["approval"]["reason"] = "edited".into();
    let forged = serde_json::from_value(json).unwrap();
    let other_keys = quick_folder();
    for (name, role) in [("ada", Role::Operator), ("eve", Role::Operator), ("ada", Role::Safety)] {
        let folder = other_keys.path().join(format!("{name} {role}"));
        std::fs::create_dir(&folder).unwrap();
        let stranger = Identity::create(&folder, name, role).unwrap();
        let signed = Box::new(approve(&store, &stranger, NEW, 2));
        match fault(commit(&store, &format!("{name} {role}"), vec![Change::PutApproval(signed)])) {
            ApprovalFault::NotEnrolled(who) => assert_eq!(who, "eve"),
            ApprovalFault::Signature(ApprovalError::Key(who)) => assert_eq!(who, "ada"),
            other => panic!("{name} {role}: {other}"),
        }
    }
    assert!(commit(&store, "forged", vec![Change::PutApproval(Box::new(forged))]).is_err());
    let unknown = commit(&store, "unknown", vec![consume(NEW, 9)]);
    assert!(matches!(unknown, Err(StoreError::NotFound { .. })));
    assert_ne!(Nonce::random().unwrap(), Nonce::random().unwrap());
}

#[test]
fn approval_requests_queue_until_they_are_answered() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    shadowed(&store, NEW);
    let request = |name: &str, deadline_ms, state| ApprovalRequest {
        id: name.into(),
        version: id(NEW),
        row_version: 4,
        evidence_digest: digest("gate"),
        policy_digest: digest("sim"),
        profile: ProfileName::Sim,
        needed: 1,
        until: WallTime::from_ms(deadline_ms),
        state,
        json: "{}".into(),
    };
    let put = |name: &str, deadline_ms, state| {
        Change::PutApprovalRequest(Box::new(request(name, deadline_ms, state)))
    };
    commit(&store, "ask", vec![put("late", 900, RequestState::Open), put("soon", 100, RequestState::Open)])
        .unwrap();
    let queue = || store.views().unwrap().open_requests().unwrap();
    assert_eq!(queue(), [request("soon", 100, RequestState::Open), request("late", 900, RequestState::Open)]);
    commit(&store, "answer", vec![put("soon", 100, RequestState::Expired)]).unwrap();
    assert_eq!(queue(), [request("late", 900, RequestState::Open)]);
    // A request cannot be turned into another one.
    assert!(commit(&store, "other", vec![put("late", 901, RequestState::Granted)]).is_err());
    commit(&store, "more", vec![evidence(NEW, EvidenceKind::Monitor, "x")]).unwrap();
    verify(&store.layout().database(), None).unwrap();
}
