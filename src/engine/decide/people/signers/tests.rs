//! Which answers the socket accepts, whether the console, a command or another program sends them.

use std::fs;
use std::path::{Path, PathBuf};

use holdpoint_approvals::keyfile::KeyEncoding;
use holdpoint_approvals::{Approval, KdfCost, Nonce, Passphrase, PersonError, SignedPersonAct};
use holdpoint_governance::approval::Role;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::finding::Finding;
use holdpoint_governance::outcome::PolicyOutcome;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_protocol::approval_document::{
    AnswerVoidCause, ApprovalDocument, ApprovalFacts, QuestionRefusal, SignatureEffect,
};
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::command::Command;
use holdpoint_protocol::snapshot::ApprovalRequestView;
use holdpoint_text::hex::hex;
use holdpoint_wording::command_effect::{EngineEffect, engine_effect};

use super::*;
use crate::decide::people::persons::{enrolled, guarded};
use crate::decide::pipeline::Pipeline;
use crate::decide::stages::activation::tests::{package, request_activation};
use crate::decide::stages::rollback::tests::RollbackBench;
use crate::quick_folder::quick_folder;

/// An answer to the request about `align@1.1.0` that the engine does not count.
fn void(cause: AnswerVoidCause) -> QuestionRefusal {
    QuestionRefusal::AnswerVoid { version: "align@1.1.0".parse().unwrap(), cause }
}

fn not_enrolled(name: &str) -> QuestionRefusal {
    QuestionRefusal::NotEnrolled { name: name.to_owned(), administrator: "admin".to_owned() }
}

/// `ann` has approved it already.
fn approved_already() -> QuestionRefusal {
    let (name, version) = ("ann".to_owned(), "align@1.1.0".parse().unwrap());
    QuestionRefusal::AnsweredAlready { name, answer: ApprovalDecision::Approve, version }
}

/// A candidate waits for people under a profile, and the clock is a script's or the machine's.
fn waiting(profile: ProfileName, scripted: bool) -> (RollbackBench, PathBuf) {
    let mut bench = RollbackBench::resting(profile);
    request_activation(&mut bench.pipeline, package("align-improved", &[]));
    if !scripted {
        let now_ms = bench.pipeline.record().now_ms();
        bench.pipeline.live().record.set_clock(Clock::real(now_ms));
    }
    let folder = bench.pipeline.record().version_table().store().layout().identities();
    (bench, folder)
}

fn passphrase() -> Passphrase {
    Passphrase::new("under the oak".to_owned().into()).unwrap()
}

fn protected(bench: &mut RollbackBench, name: &str) -> Identity {
    enrolled(
        bench.pipeline.live().record,
        name,
        Role::Safety,
        KeyEncoding::Sealed(&passphrase(), KdfCost::LEAST),
    )
}

fn plain(bench: &mut RollbackBench, name: &str) -> Identity {
    enrolled(bench.pipeline.live().record, name, Role::Safety, KeyEncoding::Plain)
}

/// The store's first administrator.
fn administrator(bench: &RollbackBench, folder: &Path) -> Identity {
    bench
        .pipeline
        .record()
        .version_table()
        .store()
        .persons()
        .unwrap()
        .unprotected_administrator(folder)
        .unwrap()
}

fn act(bench: &mut RollbackBench, act: impl FnOnce(&PersonDirectory) -> SignedPersonAct) -> Reply {
    let signed = act(&bench.pipeline.record().version_table().store().persons().unwrap());
    bench.pipeline.command(Command::Person { signed: Box::new(signed) })
}

fn revoke(bench: &mut RollbackBench, folder: &Path, name: &str) -> Reply {
    let admin = administrator(bench, folder);
    act(bench, |persons| {
        persons.revocation(persons.named(name).unwrap(), &admin, "the key was copied").unwrap()
    })
}

fn done(reply: &Reply) {
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
}

/// An open question as `who` gets it; else the refusal.
pub(crate) fn question(
    pipeline: &mut Pipeline,
    open: &ApprovalRequestView,
    who: &str,
) -> Result<ApprovalDocument, Reply> {
    let (version, purpose) = (open.version.clone(), open.purpose);
    match pipeline.command(Command::Question { version, purpose, who: who.to_owned() }) {
        Reply::Question { question } => Ok(*question),
        other => Err(other),
    }
}

/// The command by which a person answers an open request that they were shown; else the refusal.
pub(crate) fn signed(
    pipeline: &mut Pipeline,
    open: &ApprovalRequestView,
    who: &Identity,
    answer: ApprovalDecision,
) -> Result<Command, Reply> {
    let question = question(pipeline, open, &who.info().name)?;
    Ok(question.answer(who, answer, "evidence read").unwrap())
}

fn say(bench: &mut RollbackBench, who: &Identity, answer: ApprovalDecision) -> Reply {
    let open = bench.pipeline.snapshot().prompts.remove(0);
    match signed(&mut bench.pipeline, &open, who, answer) {
        Ok(command) => bench.pipeline.command(command),
        Err(refusal) => refusal,
    }
}

fn approve(bench: &mut RollbackBench, who: &Identity) -> Reply {
    say(bench, who, ApprovalDecision::Approve)
}

#[track_caller]
fn assert_refused(reply: &Reply, why: &QuestionRefusal) {
    assert_eq!(*reply, refused(why));
}

#[track_caller]
fn assert_act_refused(reply: &Reply, why: &PersonError) {
    assert_eq!(*reply, Reply::refused(Refusal::NotAllowed, why));
}

/// The refusal of the store or of a key file has these parts.
#[track_caller]
fn assert_names(reply: &Reply, parts: &[&str]) {
    let Reply::Refused { text, hint, .. } = reply else { panic!("{reply:?}") };
    let all = format!("{text}; {}", hint.as_deref().unwrap_or_default());
    for part in parts {
        assert!(all.contains(part), "{part:?} is not in {all:?}");
    }
}

/// Regression: under `human`, the approval of a key without a passphrase counted.
#[test]
fn an_unprotected_key_approves_nothing_where_people_decide() {
    let (mut bench, folder) = waiting(ProfileName::Human, false);
    let ann = plain(&mut bench, "ann");
    let reply = approve(&mut bench, &ann);
    let (name, profile) = ("ann".to_owned(), ProfileName::Human);
    assert_refused(&reply, &QuestionRefusal::KeyUnprotected { name, profile });
    assert!(bench.pipeline.snapshot().prompts[0].approved_by.is_empty());
    // The person sets a passphrase, as the refusal advises.
    ann.rewrite_key(&folder, KeyEncoding::Sealed(&passphrase(), KdfCost::LEAST)).unwrap();
    done(&approve(&mut bench, &ann));
}

#[test]
fn a_text_that_is_no_name_is_in_no_command() {
    let bench = RollbackBench::resting(ProfileName::Sim);
    let persons = bench.pipeline.record().version_table().store().persons().unwrap();
    for name in ["../../x", "x --by y; rm -rf .", ""] {
        let reply = person(&persons, name).unwrap_err();
        assert_refused(&reply, &QuestionRefusal::NoName { name: name.to_owned() });
    }
}

#[test]
fn readable_or_malformed_key_file_approves_nothing() {
    use std::os::unix::fs::PermissionsExt;
    let (mut bench, folder) = waiting(ProfileName::Human, false);
    let ann = protected(&mut bench, "ann");
    let file = folder.join("ann.key");
    fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
    assert_names(&approve(&mut bench, &ann), &["0640", "chmod 600"]);
    fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
    fs::write(&file, "holdpoint-key 1\n").unwrap();
    assert_names(&approve(&mut bench, &ann), &["ann.key", "kdf"]);
    // A key outside the store is accepted: its protection is unknown.
    fs::remove_file(&file).unwrap();
    done(&approve(&mut bench, &ann));
}

/// A signature of earlier versions does not cover the shown text: as an approval it is void, as a refusal it counts.
#[test]
fn approval_needs_the_shown_request_and_a_rejection_does_not() {
    for (profile, scripted) in [(ProfileName::Human, false), (ProfileName::Human, true)] {
        let (mut bench, _) = waiting(profile, scripted);
        let ann = protected(&mut bench, "ann");
        let open = bench.pipeline.snapshot().prompts.remove(0);
        let shown = question(&mut bench.pipeline, &open, "ann").unwrap();
        let Command::Decide { signed } = shown.answer(&ann, ApprovalDecision::Approve, "read").unwrap()
        else {
            panic!("a decision")
        };
        let approval = Approval { shown: None, ..signed.approval().clone() };
        let without = ann.sign(approval).unwrap();
        let reply = bench.pipeline.command(Command::Decide { signed: Box::new(without) });
        assert_refused(&reply, &void(AnswerVoidCause::NotDisplayed));
        done(&bench.pipeline.command(open.refuse(&ann, "not today").unwrap()));
    }
}

/// A decision over another text than the engine showed is void, for each part of the text.
#[test]
fn an_answer_over_another_request_is_refused() {
    type DocumentEdit = fn(&mut ApprovalDocument, &ApprovalDocument);
    let edits: [(&str, DocumentEdit, AnswerVoidCause); 9] = [
        ("a line is altered", |ours, _| ours.lines[3].push('!'), AnswerVoidCause::OtherLines),
        ("a line is missing", |ours, _| drop(ours.lines.remove(5)), AnswerVoidCause::OtherLines),
        ("a line is added", |ours, _| ours.lines.push("all is well".to_owned()), AnswerVoidCause::OtherLines),
        (
            "a fact is altered",
            |ours, _| ours.facts = ours.facts.replace("\"robot\":\"", "\"robot\":\"tuv-"),
            AnswerVoidCause::OtherFacts,
        ),
        ("blanks in the facts", |ours, _| ours.facts.insert(1, ' '), AnswerVoidCause::OtherFacts),
        ("the renderer", |ours, _| ours.renderer += 1, AnswerVoidCause::OtherRenderer),
        ("the store's key", |ours, _| ours.store_key = "0".repeat(64), AnswerVoidCause::OtherStoreKey),
        ("the request", |ours, _| ours.request = Nonce::from_bytes([7; 16]), AnswerVoidCause::RequestClosed),
        ("another's lines", |ours, other| ours.lines.clone_from(&other.lines), AnswerVoidCause::OtherLines),
    ];
    let (mut bench, _) = waiting(ProfileName::Human, false);
    let (ann, ben) = (protected(&mut bench, "ann"), protected(&mut bench, "ben"));
    let open = bench.pipeline.snapshot().prompts.remove(0);
    let of_ben = question(&mut bench.pipeline, &open, "ben").unwrap();
    let whole = question(&mut bench.pipeline, &open, "ann").unwrap();
    for (name, edit, cause) in edits {
        let mut altered = whole.clone();
        edit(&mut altered, &of_ben);
        assert_ne!(altered, whole, "{name}");
        let reply = bench.pipeline.command(altered.answer(&ann, ApprovalDecision::Approve, "read").unwrap());
        assert_refused(&reply, &void(cause));
    }
    // A request names its reader, so it takes no answer of another person.
    let reply = bench.pipeline.command(of_ben.answer(&ann, ApprovalDecision::Approve, "read").unwrap());
    assert_refused(&reply, &void(AnswerVoidCause::RequestClosed));
    assert!(bench.pipeline.snapshot().prompts[0].approved_by.is_empty());
    // An unaltered answer is accepted, once.
    let command = whole.answer(&ann, ApprovalDecision::Approve, "read").unwrap();
    done(&bench.pipeline.command(command.clone()));
    assert!(matches!(bench.pipeline.command(command), Reply::Refused { .. }));
    drop(ben);
}

/// A request that changed after an answer: the answer is void, and people are asked again.
#[test]
fn answers_given_before_the_request_changed_do_not_count() {
    let (mut bench, _) = waiting_for_two();
    let (ann, ben) = (protected(&mut bench, "ann"), protected(&mut bench, "ben"));
    done(&approve(&mut bench, &ann));
    let id = bench.pipeline.snapshot().prompts[0].version.clone();
    bench.pipeline.live().evidence_files.edit(&id).conditions.clear();
    let reply = approve(&mut bench, &ben);
    assert_refused(&reply, &QuestionRefusal::DisplayChanged { version: id });
    assert!(bench.pipeline.snapshot().prompts.iter().all(|open| open.approved_by.is_empty()));
}

/// The second signer reads who signed first and why. A text that was rendered before that signs nothing.
#[test]
fn the_second_signers_request_names_the_first() {
    let (mut bench, _) = waiting_for_two();
    let (ann, ben) = (protected(&mut bench, "ann"), protected(&mut bench, "ben"));
    let open = bench.pipeline.snapshot().prompts.remove(0);
    let facts = |shown: &ApprovalDocument| serde_json::from_str::<ApprovalFacts>(&shown.facts).unwrap();
    let of_ann = question(&mut bench.pipeline, &open, "ann").unwrap();
    assert_eq!(facts(&of_ann).effect, Some(SignatureEffect::MoreNeeded));
    assert_eq!(facts(&of_ann).signed_before, []);
    let early = question(&mut bench.pipeline, &open, "ben").unwrap();
    done(&bench.pipeline.command(of_ann.answer(&ann, ApprovalDecision::Approve, "drills read").unwrap()));
    let reply = bench.pipeline.command(early.answer(&ben, ApprovalDecision::Approve, "read").unwrap());
    assert_refused(&reply, &void(AnswerVoidCause::OtherFacts));
    let of_ben = question(&mut bench.pipeline, &open, "ben").unwrap();
    assert_eq!(facts(&of_ben).effect, Some(SignatureEffect::Completes));
    let before = facts(&of_ben).signed_before;
    let [first] = &before[..] else { panic!("{before:?}") };
    let said = (first.name.as_str(), first.role, first.reason.as_str());
    assert_eq!(said, ("ann", Role::Safety, "drills read"));
    // The own text of the first signer stays as it was signed.
    done(&bench.pipeline.command(of_ben.answer(&ben, ApprovalDecision::Approve, "read").unwrap()));
    assert!(bench.pipeline.snapshot().prompts.is_empty(), "two people have approved");
}

#[test]
fn an_answer_without_a_reason_is_refused() {
    for scripted in [true, false] {
        let (mut bench, _) = waiting(ProfileName::Human, scripted);
        let ann = protected(&mut bench, "ann");
        for (answer, reason) in [
            (ApprovalDecision::Approve, ""),
            (ApprovalDecision::Approve, " \u{200b}"),
            (ApprovalDecision::Reject, "\n"),
        ] {
            let open = bench.pipeline.snapshot().prompts.remove(0);
            let shown = question(&mut bench.pipeline, &open, "ann").unwrap();
            let command = shown.answer(&ann, answer, reason).unwrap();
            assert_refused(&bench.pipeline.command(command), &QuestionRefusal::NoReason);
        }
    }
}

/// Scripts need no passphrase, and neither does a refusal: it only takes authority away.
#[test]
fn scripts_refusals_and_other_profiles_need_no_passphrase() {
    let (mut bench, _) = waiting(ProfileName::Human, true);
    let ann = plain(&mut bench, "ann");
    done(&approve(&mut bench, &ann));
    let (mut bench, _) = waiting(ProfileName::Human, false);
    let ann = plain(&mut bench, "ann");
    done(&say(&mut bench, &ann, ApprovalDecision::Reject));
}

/// A copy of a person's key files under another name, which earlier versions took for another person.
fn copied(folder: &Path, from: &str, to: &str) -> Identity {
    for ending in ["key", "pub"] {
        fs::copy(folder.join(format!("{from}.{ending}")), folder.join(format!("{to}.{ending}"))).unwrap();
    }
    Identity::open(folder, to).unwrap().unlock(Some(&passphrase())).unwrap()
}

/// Regression: an author's alias approved the author's own version.
#[test]
fn the_authors_key_under_another_name_approves_nothing() {
    for scripted in [true, false] {
        let (mut bench, folder) = waiting(ProfileName::Human, scripted);
        let author_label = bench.pipeline.snapshot().prompts[0].author.clone();
        let author = author_label.split(' ').next().unwrap().to_owned();
        let themselves = protected(&mut bench, &author);
        let alias = copied(&folder, &author, "alias");
        assert_refused(&approve(&mut bench, &alias), &not_enrolled("alias"));
        // Nor does an administrator make two persons of one key.
        let admin = administrator(&bench, &folder);
        if !scripted {
            admin.rewrite_key(&folder, KeyEncoding::Sealed(&passphrase(), KdfCost::LEAST)).unwrap();
        }
        let reply =
            act(&mut bench, |persons| persons.enrolment(alias.info(), false, &admin, "a test").unwrap());
        let (name, state) = ("alias".to_owned(), PersonState::Enrolled);
        assert_act_refused(&reply, &PersonError::KeyTaken { name, other: author, state });
        // Under the own name it is put down, and does not count.
        done(&approve(&mut bench, &themselves));
        assert_eq!(bench.pipeline.snapshot().prompts.len(), 1, "it waits for another person");
    }
}

/// Medium risk: two people have to approve.
fn waiting_for_two() -> (RollbackBench, PathBuf) {
    let mut bench = RollbackBench::resting(ProfileName::Human);
    let mut submitted = package("align-improved", &[]);
    let (from, to) = ("estimated_risk = \"low\"", "estimated_risk = \"medium\"");
    assert!(submitted.submission.contains(from), "{}", submitted.submission);
    submitted.submission = submitted.submission.replace(from, to);
    request_activation(&mut bench.pipeline, submitted);
    let folder = bench.pipeline.record().version_table().store().layout().identities();
    assert_eq!(bench.pipeline.snapshot().prompts[0].needed, 2);
    (bench, folder)
}

/// One key under two names satisfied a quorum of two.
#[test]
fn two_names_with_one_key_count_once() {
    let (mut bench, folder) = waiting_for_two();
    let ann = protected(&mut bench, "ann");
    let zoe = copied(&folder, "ann", "zoe");
    done(&approve(&mut bench, &ann));
    assert_refused(&approve(&mut bench, &zoe), &not_enrolled("zoe"));
    assert_refused(&approve(&mut bench, &ann), &approved_already());
    assert_eq!(bench.pipeline.snapshot().prompts.len(), 1, "it still waits for a second person");
    let ben = protected(&mut bench, "ben");
    done(&approve(&mut bench, &ben));
    assert!(bench.pipeline.snapshot().prompts.is_empty(), "two people have approved");
}

/// One person's answer was taken, and put on record, as often as it was given.
#[test]
fn repeated_answer_is_refused_and_a_different_one_is_accepted() {
    let (mut bench, _) = waiting_for_two();
    let ann = protected(&mut bench, "ann");
    let request = bench.pipeline.snapshot().prompts.remove(0);
    let mut answer = |answer: ApprovalDecision| {
        // Each is signed for itself: only what it says is the same.
        let command = signed(&mut bench.pipeline, &request, &ann, answer).unwrap();
        let reply = bench.pipeline.command(command);
        let records = bench.pipeline.record().version_table().store().views().unwrap().head().unwrap().seq;
        (reply, records, bench.pipeline.snapshot().prompts)
    };
    let (first, records, _) = answer(ApprovalDecision::Approve);
    done(&first);
    let (second, after, prompts) = answer(ApprovalDecision::Approve);
    assert_refused(&second, &approved_already());
    assert_eq!(after, records, "nothing more is put on record");
    assert_eq!(prompts[0].approved_by, ["ann"]);
    // Who thinks better of it is heard.
    let (other, after, prompts) = answer(ApprovalDecision::Reject);
    done(&other);
    assert!(after > records && prompts.is_empty());
}

/// An approval that has run out can be given again: the old one no longer counts.
#[test]
fn expired_answer_can_be_given_again() {
    let (mut bench, _) = waiting_for_two();
    let ann = protected(&mut bench, "ann");
    let request = bench.pipeline.snapshot().prompts.remove(0);
    let shown = question(&mut bench.pipeline, &request, "ann").unwrap();
    let soon = ApprovalDocument { valid_until: request.asked.plus_ms(2_000), ..shown };
    done(&bench.pipeline.command(soon.answer(&ann, ApprovalDecision::Approve, "read").unwrap()));
    let later_ms = bench.pipeline.record().engine_ms_at(request.asked.plus_ms(3_000));
    bench.pipeline.jump_to(later_ms);
    done(&approve(&mut bench, &ann));
    assert_refused(&approve(&mut bench, &ann), &approved_already());
}

/// An approval that is given and not used yet counts no more when its key is revoked, and a later one is refused.
#[test]
fn approvals_of_a_revoked_key_do_not_count() {
    let (mut bench, folder) = waiting_for_two();
    let (ann, ben, cleo) =
        (protected(&mut bench, "ann"), protected(&mut bench, "ben"), protected(&mut bench, "cleo"));
    let open = bench.pipeline.snapshot().prompts.remove(0);
    let early = signed(&mut bench.pipeline, &open, &ann, ApprovalDecision::Approve).unwrap();
    done(&approve(&mut bench, &ann));
    let reply = revoke(&mut bench, &folder, "ann");
    let revoked = engine_effect(&EngineEffect::Revoked { name: "ann", by: "admin", discarded: 1 });
    assert!(matches!(&reply, Reply::Accepted { text, .. } if *text == revoked), "{reply:?}");
    assert!(bench.pipeline.snapshot().prompts[0].approved_by.is_empty());
    let why = QuestionRefusal::KeyRevoked { name: "ann".to_owned(), by: "admin".to_owned() };
    assert_refused(&approve(&mut bench, &ann), &why);
    // Also what was signed before and is handed in now.
    assert_refused(&bench.pipeline.command(early), &why);
    done(&approve(&mut bench, &ben));
    assert_eq!(bench.pipeline.snapshot().prompts.len(), 1, "one of two");
    done(&approve(&mut bench, &cleo));
    assert!(bench.pipeline.snapshot().prompts.is_empty(), "two people have approved");
    assert!(bench.pipeline.record().holding().is_none());
}

/// A question that is taken up after a restart has the answers of those who are enrolled still.
#[test]
fn an_answer_by_a_revoked_key_is_not_restored() {
    let mut bench = RollbackBench::resting(ProfileName::Human);
    // A review takes two people.
    crate::tests::awaiting_approval(&mut bench.pipeline, PolicyOutcome::Review, Vec::new());
    let folder = bench.pipeline.record().version_table().store().layout().identities();
    let ann = protected(&mut bench, "ann");
    done(&approve(&mut bench, &ann));
    let bench = bench.reopened(Profile::builtin(ProfileName::Human).unwrap());
    assert_eq!(bench.pipeline.snapshot().prompts[0].approved_by, ["ann"]);
    // Revoked while no engine runs: the store takes the act itself.
    let store = bench.pipeline.record().version_table().store();
    let persons = store.persons().unwrap();
    let admin = persons.unprotected_administrator(&folder).unwrap();
    let signed = persons.revocation(persons.named("ann").unwrap(), &admin, "a test").unwrap();
    let at_ms = store.views().unwrap().head().unwrap().at_ms;
    let changes = vec![holdpoint_store::Change::RevokePerson(Box::new(signed))];
    let (command_id, audit) = ("revoke ann".to_owned(), Vec::new());
    store.commit(holdpoint_store::Transaction { command_id, at_ms, wall_ms: 0, changes, audit }).unwrap();
    let bench = bench.reopened(Profile::builtin(ProfileName::Human).unwrap());
    assert!(bench.pipeline.snapshot().prompts[0].approved_by.is_empty());
}

/// The reason of the gate, which decides before it asks, stood there after the first answer, too.
#[test]
fn reason_of_a_waiting_version_counts_the_approvals() {
    let mut bench = RollbackBench::resting(ProfileName::Human);
    // A review takes two people.
    let id = crate::tests::awaiting_approval(&mut bench.pipeline, PolicyOutcome::Review, Vec::new());
    let lead = |bench: &RollbackBench| {
        let snapshot = bench.pipeline.snapshot();
        let candidate = snapshot.candidates.into_iter().find(|candidate| candidate.version == id).unwrap();
        let pending = candidate.reasons.iter().find(|reason| reason.code == ReasonCode::ApprovalPending);
        pending.unwrap().finding.clone().unwrap()
    };
    assert_eq!(lead(&bench), Finding::ApprovalsSoFar { given: 0, needed: 2 });
    let ann = protected(&mut bench, "ann");
    done(&approve(&mut bench, &ann));
    assert_eq!(lead(&bench), Finding::ApprovalsSoFar { given: 1, needed: 2 });
}

/// Public parts lie in the folder for convenience alone.
#[test]
fn public_key_files_decide_nothing() {
    let (mut bench, folder) = waiting(ProfileName::Human, true);
    let ann = protected(&mut bench, "ann");
    let eve = Identity::create(quick_folder().path(), "ann", Role::Safety).unwrap();
    let public = |who: &Identity| format!("{} safety\n", hex(who.info().public_key.as_bytes()));
    // Swapped: another key claims the name.
    fs::write(folder.join("ann.pub"), public(&eve)).unwrap();
    let another_key = holdpoint_approvals::ApprovalError::Key("ann".to_owned()).to_string();
    assert_names(&approve(&mut bench, &eve), &[&another_key]);
    // Removed: the person decides as before.
    fs::remove_file(folder.join("ann.pub")).unwrap();
    done(&approve(&mut bench, &ann));
    assert!(bench.pipeline.snapshot().prompts.iter().all(|open| open.approved_by == ["ann"]));
}

/// The first administrator's key has no passphrase at first: under `human` it adds no person until it has one.
#[test]
fn first_administrator_with_an_unencrypted_key_enrolls_no_one_where_people_decide() {
    let (mut bench, folder) = waiting(ProfileName::Human, false);
    let admin = administrator(&bench, &folder);
    let ben = Identity::create(&folder, "ben", Role::Safety).unwrap();
    let enrol = |persons: &PersonDirectory| persons.enrolment(ben.info(), true, &admin, "a test").unwrap();
    let reply = act(&mut bench, enrol);
    let (name, profile) = ("admin".to_owned(), Some(ProfileName::Human));
    assert_refused(&reply, &QuestionRefusal::AdministratorUnprotected { name, profile });
    admin.rewrite_key(&folder, KeyEncoding::Sealed(&passphrase(), KdfCost::LEAST)).unwrap();
    done(&act(&mut bench, enrol));
}

/// `admin` enrolls `who`.
fn by<'a>(who: &'a Identity, admin: &'a Identity) -> impl FnOnce(&PersonDirectory) -> SignedPersonAct + 'a {
    move |persons| persons.enrolment(who.info(), true, admin, "a test").unwrap()
}

/// Enrolled by who is no administrator, or none any more.
#[test]
fn only_administrators_enroll() {
    let (mut bench, folder) = waiting(ProfileName::Human, true);
    let ann = protected(&mut bench, "ann");
    let ben = Identity::create(&folder, "ben", Role::Safety).unwrap();
    let why = PersonError::NoAdministrator { name: "ann".to_owned(), role: Role::Safety };
    assert_act_refused(&act(&mut bench, by(&ben, &ann)), &why);
    let admin = administrator(&bench, &folder);
    let why = PersonError::LastAdministrator("admin".to_owned());
    assert_act_refused(&revoke(&mut bench, &folder, "admin"), &why);
    let second = enrolled(bench.pipeline.live().record, "second", Role::Admin, KeyEncoding::Plain);
    done(&act(&mut bench, |persons| {
        persons.revocation(persons.named("admin").unwrap(), &second, "a test").unwrap()
    }));
    let why = PersonError::SignerUnknown("admin".to_owned());
    assert_act_refused(&act(&mut bench, by(&ben, &admin)), &why);
    done(&act(&mut bench, by(&ben, &second)));
}

/// Regression: a person enrolled by an unencrypted key without people near the arm decided where people are near.
#[test]
fn a_person_enrolled_by_an_unencrypted_key_approves_nothing() {
    let (mut bench, folder) = waiting(ProfileName::Human, true);
    let admin = administrator(&bench, &folder);
    let ann = Identity::create_encoded(
        &folder,
        "ann",
        Role::Safety,
        KeyEncoding::Sealed(&passphrase(), KdfCost::LEAST),
    )
    .unwrap();
    done(&act(&mut bench, by(&ann, &admin)));
    let now_ms = bench.pipeline.record().now_ms();
    bench.pipeline.live().record.set_clock(Clock::real(now_ms));
    let (name, profile, by_admin) = ("ann".to_owned(), ProfileName::Human, Some("admin".to_owned()));
    let (enrolled_by, confirmer) = (by_admin.clone(), by_admin);
    let why = QuestionRefusal::NotConfirmed { name, profile, enrolled_by, confirmer };
    assert_refused(&approve(&mut bench, &ann), &why);
    // An act that claims a passphrase-protected key is checked against the key file, under every profile.
    let admin = guarded(&folder, &admin);
    let confirm = |persons: &PersonDirectory| {
        persons.confirmation(persons.named("ann").unwrap(), &admin, "a test").unwrap()
    };
    let (name, profile) = ("admin".to_owned(), None);
    assert_refused(&act(&mut bench, confirm), &QuestionRefusal::AdministratorUnprotected { name, profile });
    admin.rewrite_key(&folder, KeyEncoding::Sealed(&passphrase(), KdfCost::LEAST)).unwrap();
    let reply = act(&mut bench, confirm);
    let confirmed = engine_effect(&EngineEffect::PersonConfirmed { name: "ann", by: "admin" });
    assert!(matches!(&reply, Reply::Accepted { text, .. } if *text == confirmed), "{reply:?}");
    done(&approve(&mut bench, &ann));
}

/// What such a person answers to stop something is taken, and where no person is asked it counts.
#[test]
fn person_enrolled_by_an_unencrypted_key_can_reject_and_decide_in_scripts() {
    for (scripted, answer) in [(true, ApprovalDecision::Approve), (false, ApprovalDecision::Reject)] {
        let (mut bench, folder) = waiting(ProfileName::Human, true);
        let admin = administrator(&bench, &folder);
        let ann = Identity::create(&folder, "ann", Role::Safety).unwrap();
        done(&act(&mut bench, by(&ann, &admin)));
        if !scripted {
            let now_ms = bench.pipeline.record().now_ms();
            bench.pipeline.live().record.set_clock(Clock::real(now_ms));
        }
        done(&say(&mut bench, &ann, answer));
    }
}
