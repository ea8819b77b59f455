//! The lines of an approval request: their order, their failures, and what a signature does.

use holdpoint_governance::approval::{Author, Authorship, Requester, Role};
use holdpoint_governance::decision::Dimension;
use holdpoint_governance::evidence::StaleCause;
use holdpoint_governance::ids::{Digest, canonical_json};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::outcome::DimensionOutcome;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::risk::{RiskCause, RiskClass};
use holdpoint_governance::start_domain::{OutsideResponse, StartDomain};
use holdpoint_governance::submission::Risk;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::approval_document::{
    ApprovalFacts, ComponentFacts, CoverageFacts, DriftResponse, EarlierSignature, RequestedSigner,
    SignatureEffect, UntestedAspect,
};
use holdpoint_protocol::detail::{FieldDiff, VersionDiff};
use holdpoint_protocol::event::DimensionResult;
use holdpoint_protocol::snapshot::RequestKind;

use crate::approval::{LineMark, marked_lines, render};

fn dimension(dimension: Dimension, kappa: f64, outcome: DimensionOutcome) -> DimensionResult {
    DimensionResult { dimension, outcome, kappa: Some(kappa), interval: None, threshold: 0.8, measured: true }
}

/// A request about a version that passes everything, as the second of two signers gets it.
fn facts() -> ApprovalFacts {
    let digest = Digest::of_parts("test", &[b"request"]);
    ApprovalFacts {
        asked: Some(RequestedSigner { name: "ben".to_owned(), role: Role::Safety, void: None }),
        question: "request".to_owned(),
        purpose: RequestKind::Activation,
        version: "grasp@1.3.0".parse().unwrap(),
        replaces: Some("grasp@1.2.0".parse().unwrap()),
        robot: "arm7".to_owned(),
        candidate: digest,
        row_version: 7,
        evidence: digest,
        policy: digest,
        profile: ProfileName::Human,
        site: None,
        needed: 2,
        until: Some(WallTime::SCRIPT_EPOCH.plus_ms(1_200_000)),
        risk: Risk::Medium,
        assessed: Some(RiskClass { class: Risk::Medium, causes: [RiskCause::MoreSpeed].into() }),
        requester: Requester::Person { name: "tom".to_owned(), key: String::new() },
        author: Author { name: "ada".to_owned(), authorship: Authorship::Signed, key: String::new() },
        asked_by: None,
        about: String::new(),
        summary: "Approaches faster".to_owned(),
        component: None,
        state: State::Shadowed,
        deployment: None,
        stale: Vec::new(),
        dimensions: [Dimension::Interface, Dimension::Policy, Dimension::Behavior, Dimension::Recovery]
            .map(|of| dimension(of, 0.97, DimensionOutcome::Compatible))
            .to_vec(),
        pairs: None,
        counted: None,
        shadow: None,
        covers: Some(CoverageFacts {
            domain: StartDomain { bounds: Vec::new() },
            outside: OutsideResponse::Count,
        }),
        reasons: Vec::new(),
        failures: Vec::new(),
        why: vec!["behavior: nothing speaks against it".to_owned()],
        new_permissions: Vec::new(),
        changes: VersionDiff {
            fields: vec![FieldDiff {
                field: "params.speed".to_owned(),
                old: Some(1.0.into()),
                new: Some(2.0.into()),
            }],
            declared: Vec::new(),
        },
        conditions: Vec::new(),
        untested: vec![UntestedAspect::PhysicalArm],
        on_drift: Some(DriftResponse {
            back: None,
            coupled: true,
            restricted_to: 0.5,
            answer_within_s: 60.0,
            confirmed_after: 100,
            in_doubt: false,
            limits: None,
        }),
        signed_before: vec![EarlierSignature {
            name: "ana".to_owned(),
            role: Role::Engineer,
            at: WallTime::SCRIPT_EPOCH.plus_ms(920_000),
            reason: "read all".to_owned(),
        }],
        effect: Some(SignatureEffect::Completes),
    }
}

fn failing(of: &[(Dimension, DimensionOutcome)]) -> ApprovalFacts {
    let mut failing = facts();
    for (dimension, outcome) in of {
        for one in failing.dimensions.iter_mut().filter(|one| one.dimension == *dimension) {
            (one.outcome, one.kappa) = (*outcome, Some(0.5));
        }
    }
    failing
}

fn verdict(facts: &ApprovalFacts) -> (String, LineMark) {
    let first = marked_lines(facts).remove(0);
    (first.text, first.mark)
}

#[test]
fn lines_stand_in_the_order_of_their_weight() {
    let lines = render(&facts());
    let heads = [
        "grasp@1.3.0 passes all 4 checks",
        "Promote grasp@1.3.0 (",
        "You are asked as ben, safety: ",
        "Replaces grasp@1.2.0",
        "Computed risk medium: it may move faster; takes 2 people",
        "Written by ada (signed), registered by tom",
        "Summary of the author: Approaches faster",
        "New permissions: none",
        "Change: parameter speed: 1.0 -> 2.0",
        "Evidence: interface 0.970",
        "Evidence: policy",
        "Evidence: behavior",
        "Evidence: recovery",
        "Why: behavior",
        "Not tested: It was not tried in the live cell",
        "Covered starts: no start",
        "Not covered: every other start; it runs the task, which counts as uncovered",
        "If it gets worse: ",
        "ana, engineer, signed Thu 1 Jan 00:15:20 UTC: read all",
        "Your signature is the last: it takes the arm after this sequence",
        "If no one decides by Thu 1 Jan 00:20 UTC, the version stays on hold",
    ];
    assert_eq!(lines.len(), heads.len(), "{lines:#?}");
    for (line, head) in lines.iter().zip(heads) {
        assert!(line.starts_with(head), "{head:?} begins another line than {line:?}");
    }
}

#[test]
fn a_signature_says_what_it_does() {
    let effect =
        |facts: &ApprovalFacts| render(facts).into_iter().find(|line| line.starts_with("Your signature"));
    let first =
        ApprovalFacts { signed_before: Vec::new(), effect: Some(SignatureEffect::MoreNeeded), ..facts() };
    assert_eq!(effect(&first).unwrap(), "Your signature is number 1 of 2 and takes no effect alone");
    assert!(!render(&first).iter().any(|line| line.contains(", signed ")));
    // Two engineers have read a version of high risk.
    let no_officer = ApprovalFacts { effect: Some(SignatureEffect::MoreNeeded), risk: Risk::High, ..facts() };
    assert_eq!(
        effect(&no_officer).unwrap(),
        "Your signature is number 2 of 2 and takes no effect alone; a safety officer has to sign, too"
    );
    let release = ApprovalFacts { purpose: RequestKind::Release, ..facts() };
    assert_eq!(effect(&release).unwrap(), "Your signature is the last: it lifts the restriction");
    let alone = ApprovalFacts { purpose: RequestKind::Emergency, signed_before: Vec::new(), ..facts() };
    assert_eq!(effect(&alone).unwrap(), "Your signature alone is enough: it takes the arm");
    let void = ApprovalFacts { effect: None, ..facts() };
    assert_eq!(effect(&void), None);
}

/// An approver who opened the request again read that an approval of theirs would count.
#[test]
fn signer_line_does_not_promise_a_second_approval() {
    let line = |facts: &ApprovalFacts| {
        render(facts).into_iter().find(|line| line.starts_with("You are asked as ben")).unwrap()
    };
    assert!(line(&facts()).contains("would count as one"));
    let mut again = facts();
    again.signed_before[0].name = "ben".to_owned();
    let line = line(&again);
    assert!(line.contains("is recorded") && !line.contains("would count"), "{line}");
}

#[test]
fn failures_are_counted_and_stand_first() {
    use DimensionOutcome::{Conditional, Incompatible, Inconclusive, Review};
    let mut one = failing(&[(Dimension::Recovery, Incompatible)]);
    one.failures = vec!["recovery: fails 60 of 60 fallback drills, the active version 2 of 60".to_owned()];
    one.stale = vec![StaleCause::Profile];
    let lines = marked_lines(&one);
    let texts: Vec<&str> = lines.iter().map(|line| line.text.as_str()).collect();
    assert_eq!(
        texts[..4],
        [
            "grasp@1.3.0 FAILS 1 of 4 checks; the signatures waive it",
            "STALE, measured under another profile",
            "FAILS recovery 0.500 (at least 0.80) incompatible",
            "FAILS because: recovery: fails 60 of 60 fallback drills, the active version 2 of 60",
        ]
    );
    assert!(lines[..4].iter().all(|line| line.mark == LineMark::Failure), "{lines:#?}");
    assert!(lines[4..].iter().all(|line| line.mark != LineMark::Failure), "{lines:#?}");
    assert_eq!(lines[4].mark, LineMark::Question);
    assert!(!texts.iter().any(|text| text.starts_with("Evidence: recovery")), "{texts:#?}");
    assert_eq!(texts, render(&one));

    for (of, purpose, text, mark) in [
        (Vec::new(), RequestKind::Activation, "passes all 4 checks", LineMark::Good),
        (
            vec![(Dimension::Behavior, Incompatible), (Dimension::Recovery, Incompatible)],
            RequestKind::Activation,
            "FAILS 2 of 4 checks; the signatures waive them",
            LineMark::Failure,
        ),
        (
            vec![(Dimension::Policy, Conditional), (Dimension::Recovery, Incompatible)],
            RequestKind::Emergency,
            "FAILS 1 of 4 checks; 1 under a restriction; break-glass activates it all the same",
            LineMark::Failure,
        ),
        (
            vec![(Dimension::Recovery, Incompatible)],
            RequestKind::Release,
            "FAILS 1 of 4 checks; it is active all the same",
            LineMark::Failure,
        ),
        (
            vec![(Dimension::Policy, Review)],
            RequestKind::Activation,
            "passes all 4 checks; 1 left to people",
            LineMark::Caution,
        ),
        (
            vec![(Dimension::Behavior, Inconclusive)],
            RequestKind::Emergency,
            "fails none of 4 checks; 1 undecided",
            LineMark::Caution,
        ),
    ] {
        let of = ApprovalFacts { purpose, ..failing(&of) };
        assert_eq!(verdict(&of), (format!("grasp@1.3.0 {text}"), mark));
    }
    let nothing = ApprovalFacts { dimensions: Vec::new(), ..facts() };
    assert_eq!(verdict(&nothing), ("grasp@1.3.0 was not assessed".to_owned(), LineMark::Caution));
}

#[test]
fn the_first_line_names_a_component() {
    let component = |replaces: Option<&str>| {
        let file = "c-grasp.wasm".to_owned();
        let component = ComponentFacts { file, replaces: replaces.map(str::to_owned) };
        verdict(&ApprovalFacts { component: Some(component), ..facts() }).0
    };
    assert_eq!(
        component(Some("native:grasp")),
        "grasp@1.3.0, a WebAssembly component (c-grasp.wasm in place of native:grasp), passes all 4 checks"
    );
    assert_eq!(component(None), "grasp@1.3.0, a WebAssembly component (c-grasp.wasm), passes all 4 checks");
}

/// Requests of older builds are read and written as they were signed.
#[test]
fn facts_of_older_builds_keep_their_text() {
    let old = ApprovalFacts { summary: String::new(), signed_before: Vec::new(), effect: None, ..facts() };
    let text = canonical_json(&old).unwrap();
    for new in ["\"summary\"", "\"component\"", "\"failures\"", "\"signed_before\"", "\"effect\""] {
        assert!(!text.contains(new), "{new}: {text}");
    }
    let read: ApprovalFacts = serde_json::from_str(&text).unwrap();
    assert_eq!(canonical_json(&read).unwrap(), text);
}
