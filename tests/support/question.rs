//! A handmade approval request: the read-only view, and the text for one person.

use holdpoint_governance::approval::{Author, Authorship, Requester, Role};
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::ids::canonical_json;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::risk::{RiskCause, RiskClass};
use holdpoint_governance::submission::Risk;
use holdpoint_protocol::approval_document::{
    ApprovalDocument, ApprovalFacts, DriftResponse, EarlierSignature, PairsFacts, RequestedSigner,
    SignatureEffect, UntestedAspect,
};
use holdpoint_protocol::detail::{FieldDiff, VersionDiff};
use holdpoint_protocol::snapshot::{ApprovalRequestView, RequestKind};
use holdpoint_wording::approval::{RENDERER_VERSION, render};
use holdpoint_wording::request::{drift_response, untested};
use serde_json::Value;

use super::{TIME, candidates, digest, id};

fn changed(field: &str, old: Option<Value>, new: Option<Value>) -> FieldDiff {
    FieldDiff { field: field.to_owned(), old, new }
}

/// The difference between `align@2.0.0` and the version before it.
fn differences() -> VersionDiff {
    VersionDiff {
        fields: vec![
            changed("manifest.permissions.max_force_n", Some(15.0.into()), Some(20.0.into())),
            changed("manifest.permissions.zones", None, Some("tray".into())),
            changed("params.transit_speed_m_s", Some(0.2.into()), Some(0.25.into())),
        ],
        declared: Vec::new(),
    }
}

/// The facts of a request about `align@2.0.0`, for the operator at the console or for the read-only view.
pub fn facts(tier: u8, who: Option<&str>) -> ApprovalFacts {
    let candidate = candidates().into_iter().find(|one| one.version == id("align@2.0.0"));
    let signer = who.map(|name| RequestedSigner { name: name.to_owned(), role: Role::Safety, void: None });
    ApprovalFacts {
        asked: signer,
        question: "approval:align@2.0.0".to_owned(),
        purpose: RequestKind::Activation,
        version: id("align@2.0.0"),
        replaces: Some(id("align@1.0.0")),
        robot: "arm7".to_owned(),
        candidate: digest("align@2.0.0"),
        row_version: 7,
        evidence: digest("evidence"),
        policy: digest("policy"),
        profile: ProfileName::Human,
        site: None,
        needed: if tier == 2 { 2 } else { 1 },
        until: Some(TIME.plus_ms(1_742_000)),
        risk: Risk::High,
        assessed: Some(RiskClass {
            class: Risk::High,
            causes: [RiskCause::MoreZones, RiskCause::MoreForce, RiskCause::FirstOfAuthor].into(),
        }),
        requester: Requester::Person { name: "tom".to_owned(), key: String::new() },
        author: Author { name: "ada".to_owned(), authorship: Authorship::Unverified, key: String::new() },
        asked_by: None,
        about: String::new(),
        summary: "Moves to the part faster, and presses harder on the tray".to_owned(),
        component: None,
        state: State::Shadowed,
        deployment: None,
        stale: candidate.as_ref().map_or_else(Vec::new, |one| one.stale.clone()),
        dimensions: candidate.as_ref().map_or_else(Vec::new, |one| one.dimensions.clone()),
        pairs: candidate.as_ref().and_then(|one| one.pairs.as_ref()).map(|pairs| PairsFacts {
            n: pairs.n,
            candidate: pairs.candidate.success,
            candidate_interval: pairs.candidate_success,
            active: pairs.active.success,
            active_interval: pairs.active_success,
        }),
        counted: None,
        shadow: None,
        covers: None,
        reasons: Vec::new(),
        failures: Vec::new(),
        why: vec!["recovery: fails 9 of 50 fallback drills, the active version 2 of 50".to_owned()],
        new_permissions: vec!["zone tray".to_owned(), "force 20 N (was 15 N)".to_owned()],
        changes: differences(),
        conditions: Vec::new(),
        untested: vec![UntestedAspect::PhysicalArm, UntestedAspect::Drill(DrillKind::Rollback)],
        on_drift: Some(DriftResponse {
            back: Some(id("align@1.0.0")),
            coupled: true,
            restricted_to: 0.5,
            answer_within_s: 120.0,
            confirmed_after: 100,
            in_doubt: false,
            limits: None,
        }),
        signed_before: if tier == 2 { vec![signed_by_grace()] } else { Vec::new() },
        effect: who.map(|_| SignatureEffect::Completes),
    }
}

/// The first of two approvals.
fn signed_by_grace() -> EarlierSignature {
    EarlierSignature {
        name: "grace".to_owned(),
        role: Role::Engineer,
        at: TIME.minus_secs(20.0),
        reason: "drills and shadow read".to_owned(),
    }
}

/// The request as one person gets it.
pub fn document(tier: u8, who: &str) -> Box<ApprovalDocument> {
    document_of(&facts(tier, Some(who)))
}

/// The request with these facts.
pub fn document_of(facts: &ApprovalFacts) -> Box<ApprovalDocument> {
    Box::new(ApprovalDocument {
        lines: render(facts),
        facts: canonical_json(facts).unwrap(),
        renderer: RENDERER_VERSION,
        request: serde_json::from_value(Value::String("07".repeat(16))).unwrap(),
        store_id: "store".to_owned(),
        store_key: "0".repeat(64),
        valid_until: TIME.plus_ms(600_000),
    })
}

/// A request about `align@2.0.0` at a tier.
pub fn question(tier: u8) -> ApprovalRequestView {
    let facts = facts(tier, None);
    ApprovalRequestView {
        id: facts.question.clone(),
        version: facts.version.clone(),
        replaces: facts.replaces.clone(),
        candidate: facts.candidate,
        row_version: facts.row_version,
        evidence: facts.evidence,
        policy: facts.policy,
        profile: facts.profile,
        site: None,
        granted: false,
        needed: facts.needed,
        approved_by: if tier == 2 { vec!["grace".to_owned()] } else { Vec::new() },
        officer_missing: false,
        until: TIME.plus_ms(1_742_000),
        valid_until: TIME.plus_ms(600_000),
        store_id: "store".to_owned(),
        asked: TIME.minus_secs(58.0),
        tier,
        author: facts.author.label(),
        requester: facts.requester.clone(),
        risk: facts.assessed.clone(),
        new_permissions: facts.new_permissions.clone(),
        changes: facts.changes.clone(),
        conditions: Vec::new(),
        why: facts.why.clone(),
        untested: facts.untested.iter().copied().map(untested).collect(),
        on_drift: facts.on_drift.as_ref().map_or_else(String::new, drift_response),
        purpose: facts.purpose,
        about: String::new(),
        lines: render(&facts),
    }
}
