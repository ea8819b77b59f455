//! A small registry to test the store with: families, candidates, gates, people.

use std::path::Path;
use std::time::{Duration, Instant};

use holdpoint_approvals::{
    Approval, DisplayBinding, Identity, IdentityInfo, Nonce, SignedApproval, SignedProfileAct, facts_digest,
    lines_digest,
};
use holdpoint_audit::profile_history::ContextRules;
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::approval::Role;
use holdpoint_governance::ids::{CapabilityId, Digest, Family, canonical_json};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::lifecycle::VersionFlags;
use holdpoint_governance::notice::NoticeOrText;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::profile_downgrade::{DowngradedField, ProfileSettings};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_registry::{Store, TelemetryViews, allow_profile};
use holdpoint_store::{
    ActiveCause, ApprovalRequest, AuditBody, Batch, Change, EvidenceKind, NewVersion, Receipt, RefusalCause,
    RequestState, StoreError, TelemetryReader as _, Transaction,
};

/// The digest of a robot.
pub const ROBOT: &str = "00000000000000a7";

/// The states a candidate passes before it can be active.
const STEPS: [(State, State); 3] = [
    (State::Registered, State::Validated),
    (State::Validated, State::Sandboxed),
    (State::Sandboxed, State::Shadowed),
];

/// Why a store is refused, and the problem, which names what is affected.
pub fn refusal(error: &StoreError) -> (RefusalCause, &str) {
    let StoreError::Refused { cause, problem, .. } = error else { panic!("{error}") };
    (*cause, problem)
}

/// A reason as an older build wrote it.
pub fn text(reason: &str) -> NoticeOrText {
    NoticeOrText::Text(reason.to_owned())
}

pub fn digest(text: &str) -> Digest {
    Digest::of_parts("test", &[text.as_bytes()])
}

pub fn id(text: &str) -> CapabilityId {
    text.parse().unwrap()
}

pub fn family(text: &str) -> Family {
    Family::new(text).unwrap()
}

/// A version to register.
pub fn new_version(name: &str, baseline: bool) -> Change {
    Change::RegisterVersion(Box::new(NewVersion {
        id: id(name),
        parent: None,
        candidate_digest: digest(&format!("candidate {name}")),
        manifest_digest: digest(&format!("manifest {name}")),
        bundle_digest: digest(&format!("bundle {name}")),
        manifest: format!(r#"{{"name":"{name}"}}"#),
        submission: r#"{"author":"bob"}"#.into(),
        author: "bob".into(),
        provenance: holdpoint_governance::submission::Provenance::Manual,
        risk: holdpoint_governance::submission::Risk::Low,
        permissions: "[]".into(),
        environments: r#"["sim"]"#.into(),
        baseline,
    }))
}

/// A change of state.
pub fn set_state(name: &str, expected_row_version: u64, from: State, to: State) -> Change {
    Change::SetState { version: id(name), expected_row_version, from, to, reason: text("test") }
}

/// A piece of evidence.
pub fn evidence(name: &str, kind: EvidenceKind, text: &str) -> Change {
    Change::PutEvidence {
        version: id(name),
        kind,
        json: format!("{{\"is\":\"{text}\"}}"),
        digest: digest(text),
    }
}

/// The profile and policy.
pub fn context(profile: ProfileName) -> Change {
    context_of(profile, profile.name(), &[])
}

/// The profile with rules of this name, in which these fields are less strict.
pub fn context_of(profile: ProfileName, rules: &str, looser: &[&str]) -> Change {
    let loosened = looser.iter().map(|field| DowngradedField {
        before: "1".into(),
        field: (*field).into(),
        now: "3".into(),
        shipped: "2".into(),
    });
    Change::SetContext {
        profile,
        policy_digest: digest(profile.name()),
        json: "{}".into(),
        rules: Some(Box::new(ContextRules {
            digest: digest(rules),
            loosened: loosened.collect(),
            scripted: false,
            settings: ProfileSettings::from([("name".into(), profile.name().into())]),
        })),
    }
}

/// A person signs, over the present end of the chain, that a profile may come into force.
pub fn sign_profile(store: &Store, who: &Identity, next: &Change) -> (ProfileName, SignedProfileAct) {
    let Change::SetContext { profile, rules: Some(rules), .. } = next else { panic!("{next:?}") };
    let views = store.views().unwrap();
    let end = (store.store_id(), views.head().unwrap().hash);
    let change = views.profiles().unwrap().change_to(rules);
    (*profile, SignedProfileAct::by(who, (*profile, change), end, "a test").unwrap())
}

/// As [`sign_profile`], on record.
pub fn authorize(store: &Store, who: &Identity, next: &Change) -> Result<(), StoreError> {
    let (profile, act) = sign_profile(store, who, next);
    allow_profile(store, profile, ("{\"user\":\"ada\"}".to_owned(), act), 7)
}

/// Wall time of every transaction, ms since 1970.
pub const WALL_MS: i64 = 1_700_000_000_000;

/// A transaction with a command id of its own.
pub fn transaction(command_id: &str, at_ms: u64, changes: Vec<Change>) -> Transaction {
    let (mut before, mut audit) = with_shown(&changes);
    before.extend(changes);
    let changes = before;
    audit.push(AuditBody {
        kind: holdpoint_governance::record::RecordKind::Decision,
        subject: String::new(),
        body: "{}".into(),
    });
    Transaction { command_id: command_id.into(), at_ms, wall_ms: WALL_MS, changes, audit }
}

/// Commits changes under a command id at virtual time 1.
pub fn commit(store: &Store, command_id: &str, changes: Vec<Change>) -> Result<Receipt, StoreError> {
    store.commit(transaction(command_id, 1, changes))
}

/// The changes that make the family's baseline `<family>@1.0.0` active under profile `sim`.
pub fn bootstrapping(name: &str) -> Vec<Change> {
    let baseline = format!("{name}@1.0.0");
    vec![
        context(ProfileName::Sim),
        new_version(&baseline, true),
        set_state(&baseline, 1, State::Registered, State::Active),
        Change::SetActive {
            family: family(name),
            active: Some(id(&baseline)),
            pinned: None,
            cause: ActiveCause::Bootstrap,
            robot: Some(ROBOT.into()),
        },
    ]
}

/// A store with the family's baseline active.
pub fn bootstrap(store: &Store, name: &str) {
    commit(store, &format!("bootstrap {name}"), bootstrapping(name)).unwrap();
}

/// The changes that register a candidate and take it to `shadowed` (row version 4) with a gate record `gate <name>`.
pub fn shadowing(name: &str) -> Vec<Change> {
    let mut changes = vec![new_version(name, false)];
    for (row_version, (from, to)) in (1..).zip(STEPS) {
        changes.push(set_state(name, row_version, from, to));
    }
    changes.push(evidence(name, EvidenceKind::Gate, &format!("gate {name}")));
    changes
}

/// A batch of telemetry; `None` if there is none of this number.
pub fn stored_batch(store: &Store, number: u64) -> Option<Batch> {
    let telemetry = TelemetryViews::open(&store.layout().telemetry()).unwrap();
    let mut found = None;
    telemetry
        .each_batch(number, &mut |stored| {
            if stored.number == number {
                found = stored.batch;
            }
        })
        .unwrap();
    found
}

/// A candidate at `shadowed`.
pub fn shadowed(store: &Store, name: &str) {
    commit(store, &format!("shadowed {name}"), shadowing(name)).unwrap();
}

/// The changes that make `name` active in place of `old`, whose row version is given.
pub fn activation(name: &str, old: (&str, u64), approvals_needed: u32) -> Vec<Change> {
    vec![
        set_state(old.0, old.1, State::Active, State::Superseded),
        set_state(name, 4, State::Shadowed, State::Active),
        Change::SetActive {
            family: id(name).family,
            active: Some(id(name)),
            pinned: Some(id(old.0)),
            cause: ActiveCause::Gate { evidence: digest(&format!("gate {name}")), approvals_needed },
            robot: Some(ROBOT.into()),
        },
        Change::SetFlags {
            version: id(name),
            flags: VersionFlags { provisional: true, ..VersionFlags::default() },
        },
    ]
}

/// The changes that take the active `name` out and restore `old`, with their row versions.
pub fn rollback(name: (&str, u64), old: (&str, u64)) -> Vec<Change> {
    vec![
        set_state(name.0, name.1, State::Active, State::RolledBack),
        set_state(old.0, old.1, State::Superseded, State::Active),
        Change::SetActive {
            family: id(name.0).family,
            active: Some(id(old.0)),
            pinned: None,
            cause: ActiveCause::Restore,
            robot: Some(ROBOT.into()),
        },
        evidence(name.0, EvidenceKind::Rollback, "rollback"),
    ]
}

/// A person who may decide; an existing one is used unchanged.
pub fn person(store: &Store, name: &str) -> Identity {
    let folder = store.layout().identities();
    let who = Identity::load(&folder, name)
        .unwrap_or_else(|_| Identity::create(&folder, name, Role::Operator).unwrap());
    enrol(store, &who);
    who
}

/// The store's first administrator enrolls a person, unless enrolled.
pub fn enrol(store: &Store, who: &Identity) {
    store.first_administrator(0).unwrap();
    let persons = store.persons().unwrap();
    if persons.named(&who.info().name).is_none() {
        let admin = administrator(store);
        let act = persons.enrolment(who.info(), true, &admin, "a test").unwrap();
        let command = format!("enrol {}", act.act().nonce);
        let at_ms = store.views().unwrap().head().unwrap().at_ms;
        store.commit(transaction(&command, at_ms, vec![Change::EnrolPerson(Box::new(act))])).unwrap();
    }
}

/// The store's first administrator revokes a person.
pub fn revoke(store: &Store, name: &str) {
    let persons = store.persons().unwrap();
    let act = persons.revocation(persons.named(name).unwrap(), &administrator(store), "a test").unwrap();
    let command = format!("revoke {}", act.act().nonce);
    let at_ms = store.views().unwrap().head().unwrap().at_ms;
    store.commit(transaction(&command, at_ms, vec![Change::RevokePerson(Box::new(act))])).unwrap();
}

/// The store's first administrator, with the key.
pub fn administrator(store: &Store) -> Identity {
    store.persons().unwrap().unprotected_administrator(&store.layout().identities()).unwrap()
}

/// An approval of the shadowed `name` on its gate record, valid for 1000 ms from [`WALL_MS`] on.
pub fn approve(store: &Store, who: &Identity, name: &str, nonce: u8) -> SignedApproval {
    who.sign(over(approval(store, name, nonce), who)).unwrap()
}

/// An approval over the lines and facts of [`shown`].
pub fn over(approval: Approval, who: &Identity) -> Approval {
    let IdentityInfo { name, role, .. } = who.info().clone();
    let answer = Approval { who: name, role, ..approval };
    let (lines, facts) = shown(&answer);
    let shown = answer.shown.clone().map(|shown| DisplayBinding {
        lines: lines_digest(&lines),
        facts: facts_digest(&facts),
        ..shown
    });
    Approval { shown, ..answer }
}

/// The lines and facts of the request that an approval answers.
pub fn shown(approval: &Approval) -> (Vec<String>, String) {
    let facts = serde_json::json!({
        "asked": { "name": approval.who, "role": approval.role },
        "question": format!("question-{}", approval.nonce),
        "purpose": if approval.break_glass { "emergency" } else { "activation" },
        "version": approval.version,
        "candidate": approval.candidate_digest,
        "row_version": approval.row_version,
        "evidence": approval.evidence_digest,
        "policy": approval.policy_digest,
        "profile": approval.profile,
        "needed": 1,
    });
    (vec![format!("Promote {}?", approval.version)], canonical_json(&facts).unwrap())
}

/// The records before and beside an approval: the request, and its displayed text.
fn with_shown(changes: &[Change]) -> (Vec<Change>, Vec<AuditBody>) {
    let (mut requests, mut records) = (Vec::new(), Vec::new());
    for change in changes {
        let Change::PutApproval(signed) = change else { continue };
        let approval = signed.approval();
        if approval.shown.is_none() {
            continue;
        }
        let (lines, facts) = shown(approval);
        requests.push(Change::PutApprovalRequest(Box::new(ApprovalRequest {
            id: format!("question-{}", approval.nonce),
            version: approval.version.clone(),
            row_version: approval.row_version,
            evidence_digest: approval.evidence_digest,
            policy_digest: approval.policy_digest,
            profile: approval.profile,
            needed: 1,
            until: approval.not_after(),
            state: RequestState::Void,
            json: "{}".to_owned(),
        })));
        let body = serde_json::json!({ "by": approval.who, "nonce": approval.nonce, "lines": lines, "facts": facts });
        records.push(AuditBody {
            kind: holdpoint_governance::record::RecordKind::Shown,
            subject: approval.version.to_string(),
            body: canonical_json(&body).unwrap(),
        });
    }
    (requests, records)
}

/// As [`approve`], not yet signed.
pub fn approval(store: &Store, name: &str, nonce: u8) -> Approval {
    Approval {
        who: String::new(),
        role: Role::Operator,
        decision: ApprovalDecision::Approve,
        reason: "seen".into(),
        version: id(name),
        candidate_digest: digest(&format!("candidate {name}")),
        row_version: 4,
        evidence_digest: digest(&format!("gate {name}")),
        policy_digest: digest("sim"),
        profile: ProfileName::Sim,
        store_id: store.store_id().into(),
        nonce: Nonce::from_bytes([nonce; 16]),
        not_after_ms: WALL_MS.unsigned_abs() + 1000,
        break_glass: false,
        shown: Some(DisplayBinding {
            renderer: 1,
            lines: digest("lines"),
            facts: digest("facts"),
            store_key: holdpoint_text::hex::hex(store.public_key().as_bytes()),
            request: Nonce::from_bytes([nonce; 16]),
        }),
    }
}

/// Uses an approval of `name`.
pub fn consume(name: &str, nonce: u8) -> Change {
    Change::ConsumeApproval {
        nonce: Nonce::from_bytes([nonce; 16]).to_string(),
        evidence_digest: digest(&format!("gate {name}")),
        at: Some(WallTime::from_ms(WALL_MS)),
    }
}

/// Opens a free store. A parallel test may be starting a child, which inherits this process's descriptors and a
/// released lock until it runs its program; this function waits for that.
pub fn open(folder: &Path) -> Store {
    unless_in_use(|| Store::open(folder)).unwrap()
}

/// Runs work that needs a free store, waiting as [`open`] does.
pub fn unless_in_use<T>(mut work: impl FnMut() -> Result<T, StoreError>) -> Result<T, StoreError> {
    let until = Instant::now() + Duration::from_mins(1);
    loop {
        match work() {
            Err(StoreError::InUse { .. }) if Instant::now() < until => {
                std::thread::park_timeout(Duration::from_millis(1));
            }
            done => return done,
        }
    }
}

/// The store's first administrator with the same key, as it signs with a passphrase.
pub fn guarded_administrator(store: &Store) -> Identity {
    use holdpoint_approvals::keyfile::KeyEncoding;
    let (folder, plain) = (store.layout().identities(), administrator(store));
    let passphrase = holdpoint_approvals::Passphrase::new("under the oak".to_owned().into()).unwrap();
    plain
        .rewrite_key(&folder, KeyEncoding::Sealed(&passphrase, holdpoint_approvals::KdfCost::LEAST))
        .unwrap();
    let guarded = Identity::open(&folder, &plain.info().name).unwrap().unlock(Some(&passphrase)).unwrap();
    plain.rewrite_key(&folder, KeyEncoding::Plain).unwrap();
    guarded
}

/// The store's first administrator verifies a person.
pub fn confirm(store: &Store, name: &str) {
    let persons = store.persons().unwrap();
    let by = guarded_administrator(store);
    let act = persons.confirmation(persons.named(name).unwrap(), &by, "a test").unwrap();
    let command = format!("confirm {}", act.act().nonce);
    let at_ms = store.views().unwrap().head().unwrap().at_ms;
    store.commit(transaction(&command, at_ms, vec![Change::about_person(act)])).unwrap();
}
