//! Whose answers count, at the door of the engine: whoever sends them, console, verb or another program.

use std::fs;
use std::path::PathBuf;

use holdpoint_approvals::keyfile::Keep;
use holdpoint_approvals::{Cost, Passphrase};
use holdpoint_governance::approval::Role;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::command::Command;

use super::*;
use crate::stages::activation::tests::{asked, package};
use crate::stages::rollback::tests::Bench;

/// A candidate waits for people under a profile, and the clock is a script's or the machine's.
fn waiting(profile: ProfileName, scripted: bool) -> (Bench, PathBuf) {
    let mut bench = Bench::under(Profile::builtin(profile).unwrap());
    asked(&mut bench.pipeline, package("align-improved", &[]));
    if !scripted {
        let now_ms = bench.pipeline.record().now_ms();
        bench.pipeline.live().record.set_clock(Clock::real(now_ms));
    }
    let folder = bench.pipeline.record().ledger().store().layout().identities();
    (bench, folder)
}

fn words() -> Passphrase {
    Passphrase::new("under the oak".to_owned().into()).unwrap()
}

fn protected(folder: &Path, name: &str) -> Identity {
    Identity::create_kept(folder, name, Role::Safety, Keep::Sealed(&words(), Cost::LEAST)).unwrap()
}

fn say(bench: &mut Bench, who: &Identity, answer: Answer, shown: Option<&str>) -> Reply {
    let prompt = bench.pipeline.snapshot().prompts.remove(0);
    let command = prompt.answer(who, answer, "evidence read", shown.map(ToOwned::to_owned)).unwrap();
    bench.pipeline.command(command)
}

fn approve(bench: &mut Bench, who: &Identity, shown: Option<&str>) -> Reply {
    say(bench, who, Answer::Approve, shown)
}

#[track_caller]
fn refused(reply: &Reply, said: &[&str]) {
    let Reply::Refused { text, hint, .. } = reply else { panic!("{reply:?}") };
    let all = format!("{text}; {}", hint.as_deref().unwrap_or_default());
    for part in said {
        assert!(all.contains(part), "{part:?} is not in {all:?}");
    }
}

/// An approval of a key that who can read a file has counted under `human` like any other.
#[test]
fn an_unprotected_key_approves_nothing_where_people_decide() {
    let (mut bench, folder) = waiting(ProfileName::Human, false);
    let ann = Identity::create(&folder, "ann", Role::Safety).unwrap();
    let reply = approve(&mut bench, &ann, Some("all of it"));
    refused(&reply, &["the key of ann has no passphrase", "`holdpoint identity passphrase ann` sets one"]);
    assert!(bench.pipeline.snapshot().prompts[0].approved_by.is_empty());
    // The same key under a passphrase, by the way that the refusal names.
    ann.keep(&folder, Keep::Sealed(&words(), Cost::LEAST)).unwrap();
    let reply = approve(&mut bench, &ann, Some("all of it"));
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
}

#[test]
fn a_key_file_that_others_can_read_or_that_is_none_approves_nothing() {
    use std::os::unix::fs::PermissionsExt;
    let (mut bench, folder) = waiting(ProfileName::Human, false);
    let ann = protected(&folder, "ann");
    let file = folder.join("ann.key");
    fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
    refused(&approve(&mut bench, &ann, Some("all of it")), &["mode 0640", "chmod 600"]);
    fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
    fs::write(&file, "holdpoint-key 1\n").unwrap();
    refused(&approve(&mut bench, &ann, Some("all of it")), &["ann.key", "kdf"]);
    // A key that is kept elsewhere is accepted: nothing is known of how.
    fs::remove_file(&file).unwrap();
    let reply = approve(&mut bench, &ann, Some("all of it"));
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
}

#[test]
fn an_approval_takes_what_was_shown_where_people_decide() {
    let (mut bench, folder) = waiting(ProfileName::Human, false);
    let ann = protected(&folder, "ann");
    for shown in [None, Some(""), Some(" \u{200b}\n")] {
        refused(&approve(&mut bench, &ann, shown), &["takes what was shown"]);
    }
    let reply = approve(&mut bench, &ann, Some("all of it"));
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
}

#[test]
fn an_answer_without_a_reason_is_refused_whoever_sends_it() {
    for scripted in [true, false] {
        let (mut bench, folder) = waiting(ProfileName::Human, scripted);
        let ann = protected(&folder, "ann");
        for (answer, reason) in
            [(Answer::Approve, ""), (Answer::Approve, " \u{200b}"), (Answer::Reject, "\n")]
        {
            let prompt = bench.pipeline.snapshot().prompts.remove(0);
            let command = prompt.answer(&ann, answer, reason, Some("all of it".to_owned())).unwrap();
            refused(&bench.pipeline.command(command), &["needs a reason"]);
        }
    }
}

/// What a script says was settled when it was written, and stopping is never made harder.
#[test]
fn scripts_refusals_and_other_profiles_need_no_passphrase() {
    let (mut bench, folder) = waiting(ProfileName::Human, true);
    let ann = Identity::create(&folder, "ann", Role::Safety).unwrap();
    let reply = approve(&mut bench, &ann, None);
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    let (mut bench, folder) = waiting(ProfileName::Human, false);
    let ann = Identity::create(&folder, "ann", Role::Safety).unwrap();
    let reply = say(&mut bench, &ann, Answer::Reject, None);
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
}

/// An author's alias approved his own work.
#[test]
fn the_authors_key_under_another_name_approves_nothing() {
    for scripted in [true, false] {
        let (mut bench, folder) = waiting(ProfileName::Human, scripted);
        let author = bench.pipeline.snapshot().prompts[0].author.clone();
        protected(&folder, &author);
        for ending in ["key", "pub"] {
            fs::copy(folder.join(format!("{author}.{ending}")), folder.join(format!("alias.{ending}")))
                .unwrap();
        }
        let alias = Identity::open(&folder, "alias").unwrap().unlock(Some(&words())).unwrap();
        let reply = approve(&mut bench, &alias, Some("all of it"));
        refused(&reply, &["alias has the key of", &author, "cannot approve"]);
        assert!(bench.pipeline.snapshot().prompts[0].approved_by.is_empty());
        // Refusing it is anybody's right.
        let reply = say(&mut bench, &alias, Answer::Reject, None);
        assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    }
}

/// One key under two names satisfied a quorum of two.
#[test]
fn two_names_with_one_key_count_once() {
    let risky = [("estimated_risk = \"low\"", "estimated_risk = \"medium\"")];
    let mut bench = Bench::under(Profile::builtin(ProfileName::Human).unwrap());
    let mut submitted = package("align-improved", &[]);
    for (from, to) in risky {
        assert!(submitted.submission.contains(from), "{}", submitted.submission);
        submitted.submission = submitted.submission.replace(from, to);
    }
    asked(&mut bench.pipeline, submitted);
    let folder = bench.pipeline.record().ledger().store().layout().identities();
    let ann = protected(&folder, "ann");
    for ending in ["key", "pub"] {
        fs::copy(folder.join(format!("ann.{ending}")), folder.join(format!("zoe.{ending}"))).unwrap();
    }
    let zoe = Identity::open(&folder, "zoe").unwrap().unlock(Some(&words())).unwrap();
    assert_eq!(bench.pipeline.snapshot().prompts[0].needed, 2);
    for who in [&ann, &zoe] {
        let reply = approve(&mut bench, who, None);
        assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    }
    assert_eq!(bench.pipeline.snapshot().prompts.len(), 1, "it still waits for a second person");
    let ben = protected(&folder, "ben");
    let prompt = bench.pipeline.snapshot().prompts.remove(0);
    let command: Command = prompt.answer(&ben, Answer::Approve, "evidence read", None).unwrap();
    let _ = bench.pipeline.command(command);
    assert!(bench.pipeline.snapshot().prompts.is_empty(), "two people have approved");
}
