//! What people were asked is open after a restart as it was, and shows what takes effect.

use holdpoint_approvals::keyfile::KeyEncoding;
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::condition::Condition;
use holdpoint_governance::outcome::PolicyOutcome;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::event::EventKind;

use crate::decide::people::persons::enrolled;
use crate::decide::people::signers::tests::{question, signed};
use crate::decide::pipeline::Pipeline;
use crate::quick_folder::quick_folder;
use crate::test_pipeline::resting_pipeline;
use crate::tests::{assert_accepted, at_the_gate, awaiting_approval};

#[test]
fn a_question_is_open_after_a_restart_with_the_answers_given() {
    let folder = quick_folder();
    let mut first = resting_pipeline(folder.path(), ProfileName::Human);
    // A review takes two people.
    awaiting_approval(&mut first, PolicyOutcome::Review, Vec::new());
    let mut before = first.snapshot().prompts;
    let ana = enrolled(first.live().record, "ana", Role::Engineer, KeyEncoding::Plain);
    let answer = signed(&mut first, &before[0], &ana, ApprovalDecision::Approve).unwrap();
    assert_accepted(&first.command(answer));
    before[0].approved_by = vec!["ana".to_owned()];
    assert!(before[0].needed > 1, "one answer is not enough");
    let answered = first.snapshot().prompts;
    assert_ne!(answered[0].lines, before[0].lines, "the next signer reads the first answer");
    before[0].lines.clone_from(&answered[0].lines);
    assert_eq!(answered, before);
    let ben = enrolled(first.live().record, "ben", Role::Engineer, KeyEncoding::Plain);
    let of_ben = question(&mut first, &before[0], &ben.info().name).unwrap();
    drop(first);

    let mut second = resting_pipeline(folder.path(), ProfileName::Human);
    let after = second.snapshot().prompts;
    // The deadline of a decision signed now is computed again.
    before[0].valid_until = after[0].valid_until;
    assert_eq!(after, before);
    assert_eq!(question(&mut second, &before[0], "ben").unwrap().lines, of_ben.lines);
    let events = second.drain_events();
    assert!(!events.iter().any(|event| matches!(event, EventKind::ApprovalRequested { .. })), "{events:?}");
    drop(second);
    // Under another profile it is another question.
    let third = resting_pipeline(folder.path(), ProfileName::Real);
    assert!(third.snapshot().prompts.is_empty());
}

/// What the gate adds to what the stages ask for is in no stage's evidence: who decides after a restart is shown it all
/// the same, and it is what takes effect.
#[test]
fn a_question_shows_the_conditions_that_take_effect_after_a_restart() {
    let folder = quick_folder();
    let mut first = resting_pipeline(folder.path(), ProfileName::Human);
    let id = at_the_gate(&mut first);
    for _ in 0..4 {
        first.advance();
    }
    let shown = |pipeline: &Pipeline| {
        let snapshot = pipeline.snapshot();
        let conditions =
            snapshot.candidates.iter().find(|one| one.version == id).map(|one| one.conditions.clone());
        let (prompt, answers) = (snapshot.prompts[0].clone(), conditions.unwrap());
        (prompt.on_drift, prompt.untested, answers)
    };
    let before = shown(&first);
    assert!(before.2.contains(&Condition::RollbackCoupled), "{before:?}");
    drop(first);
    assert_eq!(shown(&resting_pipeline(folder.path(), ProfileName::Human)), before);
}

#[test]
fn a_request_for_a_condition_is_open_after_a_restart() {
    for (profile, quorum) in [(ProfileName::Sim, 2), (ProfileName::Human, 3)] {
        let folder = quick_folder();
        let mut first = resting_pipeline(folder.path(), profile);
        awaiting_approval(
            &mut first,
            PolicyOutcome::Conditional,
            vec![Condition::ApprovalRequired { quorum }],
        );
        let mut before = first.snapshot().prompts;
        assert_eq!(before[0].needed, u32::from(quorum));
        drop(first);
        let after = resting_pipeline(folder.path(), profile).snapshot().prompts;
        before[0].valid_until = after.first().map_or(before[0].until, |prompt| prompt.valid_until);
        assert_eq!(after, before, "{profile:?}");
    }
}
