//! The author and the registrar of a version cannot approve it, by any route or after any restart; and an author's
//! estimate lowers no requirement.

use holdpoint_approvals::SignedAuthorship;
use holdpoint_governance::approval::Requester;
use holdpoint_governance::finding::{Finding, VoteFlaw};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::outcome::PolicyOutcome;
use holdpoint_governance::risk::RiskCause;
use holdpoint_governance::submission::{Package, Risk};
use holdpoint_governance::tries::CountedTry;
use holdpoint_protocol::event::EventKind;

use super::tests::{question, signed};
use super::*;
use crate::decide::people::persons::enrolled;
use crate::decide::pipeline::Pipeline;
use crate::decide::stages::activation::tests::{package, request_activation_by};
use crate::quick_folder::quick_folder;
use crate::test_pipeline::resting_pipeline;
use crate::tests::awaiting_approval;
use holdpoint_approvals::keyfile::KeyEncoding;
use holdpoint_governance::approval::Role;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::command::{Command, Operation, Refusal};

fn person(pipeline: &mut Pipeline, name: &str, role: Role) -> Identity {
    enrolled(pipeline.live().record, name, role, KeyEncoding::Plain)
}

fn approve(pipeline: &mut Pipeline, who: &Identity) -> Reply {
    let open = pipeline.snapshot().prompts.remove(0);
    match signed(pipeline, &open, who, ApprovalDecision::Approve) {
        Ok(command) => pipeline.command(command),
        Err(refusal) => refusal,
    }
}

fn reply_text(reply: &Reply) -> &str {
    match reply {
        Reply::Accepted { text, .. } | Reply::Refused { text, .. } => text,
        other => panic!("{other:?}"),
    }
}

/// Whether a reply says that the answer of this person does not count, for this flaw.
fn is_void(reply: &Reply, person: &str, flaw: VoteFlaw) -> bool {
    let void = Finding::AnswerVoid { person: person.to_owned(), flaw };
    reply_text(reply).contains(&holdpoint_wording::finding(&void))
}

fn submitted(author: &str) -> Package {
    let mut submitted = package("align-improved", &[]);
    let (from, to) = ("author = \"skill-lab\"", format!("author = \"{author}\""));
    assert!(submitted.submission.contains(from), "{}", submitted.submission);
    submitted.submission = submitted.submission.replace(from, &to);
    submitted
}

/// One engineer registered a version and approved it alone: the requester was the constant "engine".
#[test]
fn requester_cannot_approve_a_version_even_after_a_restart() {
    let folder = quick_folder();
    let mut first = resting_pipeline(folder.path(), ProfileName::Human);
    let [rita, ben, sam] = ["rita", "ben", "sam"].map(|name| person(&mut first, name, Role::Safety));
    // It is registered on behalf of rita.
    let id = awaiting_approval(&mut first, PolicyOutcome::Review, Vec::new());
    assert_eq!(first.snapshot().prompts[0].requester.name(), "rita");
    assert!(is_void(&approve(&mut first, &rita), "rita", VoteFlaw::Requester), "it does not count");
    assert!(
        first.snapshot().prompts[0].approved_by.is_empty(),
        "what does not count is not shown as counted"
    );
    drop(first);
    let mut second = resting_pipeline(folder.path(), ProfileName::Human);
    let open = second.snapshot().prompts.remove(0);
    assert_eq!(open.requester.name(), "rita");
    let shown = question(&mut second, &open, "ben").unwrap();
    assert!(shown.lines.iter().any(|line| line.contains(" rita")), "{:?}", shown.lines);
    approve(&mut second, &ben);
    assert_eq!(second.record().version_table().version(&id).unwrap().1.state, State::Shadowed, "one of two");
    assert!(matches!(approve(&mut second, &sam), Reply::Accepted { .. }));
    assert!(second.snapshot().prompts.is_empty(), "two others are enough");
}

/// One person demoted a version, stopped its family and armed it again with that version: unwatched, and not restricted any more.
#[test]
fn reactivation_and_release_need_a_second_person() {
    let folder = quick_folder();
    let mut pipeline = resting_pipeline(folder.path(), ProfileName::Human);
    let [ben, sam] = ["ben", "sam"].map(|name| person(&mut pipeline, name, Role::Safety));
    let id = awaiting_approval(&mut pipeline, PolicyOutcome::Review, Vec::new());
    approve(&mut pipeline, &ben);
    approve(&mut pipeline, &sam);
    let state_of = |pipeline: &Pipeline, id: &CapabilityId| {
        let (_, lifecycle, _) = pipeline.record().version_table().version(id).unwrap();
        (lifecycle.state, lifecycle.flags.restricted)
    };
    while state_of(&pipeline, &id).0 != State::Active && pipeline.record().holding().is_none() {
        pipeline.advance();
    }
    assert_eq!(state_of(&pipeline, &id), (State::Active, false));
    let of = |version: &CapabilityId| Operation {
        version: version.clone(),
        by: "rita".to_owned(),
        reason: "a test".to_owned(),
    };
    let first: CapabilityId = "align@1.0.0".parse().unwrap();
    let mut run = |command| reply_text(&pipeline.command(command)).to_owned();
    run(Command::Demote { operation: of(&id), profiles: Vec::new() });
    run(Command::Restrict(of(&first)));
    run(Command::Vacate(of(&first)));
    let refusal = pipeline.command(Command::Rearm(of(&id)));
    assert!(matches!(refusal, Reply::Refused { .. }), "{refusal:?}");
    let acceptance = pipeline.command(Command::Rearm(of(&first)));
    assert!(matches!(acceptance, Reply::Accepted { .. }), "{acceptance:?}");
    assert_eq!(state_of(&pipeline, &id), (State::Demoted, false));
    assert_eq!(state_of(&pipeline, &first), (State::Active, true), "it is as restricted as it was");
}

/// `estimated_risk = "low"` made one approval enough, for whatever was submitted.
#[test]
fn estimated_risk_and_a_script_lower_no_quorum() {
    let folder = quick_folder();
    let mut pipeline = resting_pipeline(folder.path(), ProfileName::Human);
    let submitted = package("align-shared", &[]);
    assert!(submitted.submission.contains("estimated_risk = \"low\""), "{}", submitted.submission);
    request_activation_by(&mut pipeline, submitted, None);
    let open = pipeline.snapshot().prompts.remove(0);
    assert_eq!(open.requester, Requester::Script);
    let risk = open.risk.unwrap();
    assert_eq!((risk.class, risk.causes.contains(&RiskCause::MoreAuthority)), (Risk::High, true), "{risk:?}");
    // Two engineers are two people, and none of them answers for people's safety.
    let [ben, eve] = ["ben", "eve"].map(|name| person(&mut pipeline, name, Role::Engineer));
    approve(&mut pipeline, &ben);
    approve(&mut pipeline, &eve);
    let open = pipeline.snapshot().prompts.remove(0);
    assert_eq!(
        (open.approved_by.len(), open.officer_missing),
        (2, true),
        "a safety officer is still to answer"
    );
    let sam = person(&mut pipeline, "sam", Role::Safety);
    approve(&mut pipeline, &sam);
    assert!(pipeline.snapshot().prompts.is_empty());
}

#[test]
fn author_is_recognized_and_excluded_by_key() {
    let folder = quick_folder();
    let mut pipeline = resting_pipeline(folder.path(), ProfileName::Human);
    let acme = person(&mut pipeline, "acme", Role::Safety);
    let mut submitted = submitted("acme");
    let loaded = holdpoint_runtime::capability::Capability::load("test", submitted.clone()).unwrap();
    let signature = SignedAuthorship::by(&acme, &loaded.digest(), &submitted.submission).unwrap();
    let register = |pipeline: &mut Pipeline, package: Package| {
        pipeline.command(Command::Register { package, name: "test".to_owned(), by: None })
    };
    // A signature that does not cover these files, or by an unknown key, is refused, not treated as free text.
    for (wrong, what) in [
        (SignedAuthorship { public_key: "00".repeat(32), ..signature.clone() }, "not over these files"),
        (SignedAuthorship { author: "ben".to_owned(), ..signature.clone() }, "names the author \"acme\""),
    ] {
        submitted.author_signature = Some(serde_json::to_string(&wrong).unwrap());
        assert!(reply_text(&register(&mut pipeline, submitted.clone())).contains(what), "{what}");
    }
    submitted.author_signature = Some(serde_json::to_string(&signature).unwrap());
    request_activation_by(&mut pipeline, submitted, Some("ana"));
    let open = pipeline.snapshot().prompts.remove(0);
    assert_eq!(open.author, "acme (signed)");
    // An organization's key does not approve what it wrote, in whichever role.
    assert!(is_void(&approve(&mut pipeline, &acme), "acme", VoteFlaw::Author));
}

/// The requester is on record, and told.
#[test]
fn a_registration_names_its_requester() {
    let folder = quick_folder();
    let mut pipeline = resting_pipeline(folder.path(), ProfileName::Sim);
    person(&mut pipeline, "ana", Role::Engineer);
    request_activation_by(&mut pipeline, submitted("ana"), Some("ana"));
    let events = pipeline.live().record.take_events();
    let requester = events.iter().find_map(|event| match event {
        EventKind::Registered { requester, author, .. } if author == "ana" => {
            Some(requester.name().to_owned())
        }
        _ => None,
    });
    assert_eq!(requester.as_deref(), Some("ana"));
    // Who registers what they wrote has signed it by that.
    assert_eq!(pipeline.snapshot().prompts[0].author, "ana (signed)");
}

/// Regression: an unsigned version became active near people by `rearm`, without an approval.
#[test]
fn version_without_a_known_requester_is_not_reactivated_where_people_decide() {
    let folder = quick_folder();
    let mut pipeline = resting_pipeline(folder.path(), ProfileName::Human);
    let now_ms = pipeline.record().now_ms();
    pipeline.live().record.set_clock(Clock::real(now_ms));
    let package = submitted("skill-lab");
    pipeline.command(Command::Register { package, name: "test".to_owned(), by: None });
    let mut rearm = |version: &str| {
        let (by, reason) = ("ana".to_owned(), "a test".to_owned());
        let reply =
            pipeline.command(Command::Rearm(Operation { version: version.parse().unwrap(), by, reason }));
        reply_text(&reply).to_owned()
    };
    let unknown = "no enrolled person is on record as having registered";
    assert!(rearm("align@1.1.0").contains(unknown));
    // The version that the cell was commissioned with comes from the program.
    assert!(!rearm("align@1.0.0").contains(unknown));
}

/// A version by skill-lab that rita registers; ben is the other person with her role.
fn registered_by_rita(pipeline: &mut Pipeline) -> CapabilityId {
    for name in ["rita", "ben"] {
        person(pipeline, name, Role::Safety);
    }
    let package = submitted("skill-lab");
    let id = holdpoint_runtime::capability::Capability::load("test", package.clone()).unwrap().id();
    let by = Some("rita".to_owned());
    pipeline.command(Command::Register { package, name: "test".to_owned(), by });
    id
}

/// Where people approve, the tries of a family are reviewed by a person who wrote and registered none of them.
#[test]
fn authors_and_registrars_do_not_review_their_own_tries() {
    let folder = quick_folder();
    let mut pipeline = resting_pipeline(folder.path(), ProfileName::Human);
    let id = registered_by_rita(&mut pipeline);
    let author = pipeline.record().version_table().try_author(&id).unwrap();
    assert_eq!(author.name, "rita", "no author signed it");
    let counted = CountedTry {
        subject: Digest::of_parts("test", &[]),
        drawn: None,
        author,
        by_author: 1,
        in_family: 1,
        level: 0.01,
        pairs: 300,
        left: 11,
    };
    pipeline.live().record.note_try(&id, counted);
    let now_ms = pipeline.record().now_ms();
    pipeline.live().record.set_clock(Clock::real(now_ms));
    let mut review = |by: &str| {
        let version = "align@1.0.0".parse().unwrap();
        let (by, reason) = (by.to_owned(), "a test".to_owned());
        pipeline.command(Command::ReviewTries(Operation { version, by, reason }))
    };
    for own in ["rita", "skill-lab"] {
        let reply = review(own);
        assert!(matches!(reply, Reply::Refused { code: Refusal::NotAllowed, .. }), "{own}: {reply:?}");
    }
    let reply = review("ben");
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
}

/// A low risk may need no approval: with anchors of their own, one author could let the tolerances add up.
#[test]
fn authors_and_registrars_do_not_make_their_own_version_the_anchor() {
    let folder = quick_folder();
    let mut pipeline = resting_pipeline(folder.path(), ProfileName::Human);
    let id = registered_by_rita(&mut pipeline);
    let now_ms = pipeline.record().now_ms();
    pipeline.live().record.set_clock(Clock::real(now_ms));
    let mut choose = |by: &str| {
        let (version, by, reason) = (id.clone(), by.to_owned(), "a test".to_owned());
        pipeline.command(Command::Anchor(Operation { version, by, reason }))
    };
    for own in ["rita", "skill-lab"] {
        let reply = choose(own);
        assert!(matches!(reply, Reply::Refused { code: Refusal::NotAllowed, .. }), "{own}: {reply:?}");
    }
    let reply = choose("ben");
    assert!(matches!(reply, Reply::Refused { code: Refusal::NotNow, .. }), "it is not confirmed: {reply:?}");
}
