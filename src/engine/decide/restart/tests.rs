//! What an engine makes of the work of one that ended in the middle of it: questions, rollbacks and watched versions.

use holdpoint_approvals::keyfile::KeyEncoding;
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Dimension, Reason};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage, State};
use holdpoint_governance::live_harm::{LiveHarm, TaskHarm};
use holdpoint_governance::monitor::{MonitorDecision, Rate, SafetyEvent, roll_back, safety_trip};
use holdpoint_governance::outcome::PolicyOutcome;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::event::EventKind;
use holdpoint_record::evidence_file::EvidenceFile;
use holdpoint_store::{Change, EvidenceKind};

use crate::decide::people::persons::enrolled;
use crate::decide::people::signers::tests::{question, signed};
use crate::decide::pipeline::Pipeline;
use crate::decide::stages::monitoring::tell_monitor;
use crate::decide::stages::rollback::tests::RollbackBench;
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

/// Puts on record that an active version is rolled back for these reasons, and ends the engine before it begins.
fn decided(
    mut bench: RollbackBench,
    id: &CapabilityId,
    decision: &MonitorDecision,
    by_harm: bool,
) -> RollbackBench {
    let live = bench.pipeline.live();
    if by_harm {
        let task = TaskHarm { danger: decision.reasons.clone(), ..TaskHarm::default() };
        let limits = Digest::of_parts("test", &[]);
        let body =
            serde_json::json!({ "limits": limits, "batch": 1, "task": task, "harm": LiveHarm::default() });
        live.record.note(RecordKind::LiveHarm, id.to_string(), body.to_string()).unwrap();
    } else {
        tell_monitor(live.record, id, decision.action, &decision.reasons).unwrap();
    }
    bench.restart()
}

/// Once the version went on as if nothing had been decided.
#[test]
fn decided_rollback_that_had_not_begun_is_carried_out_before_any_task() {
    let event = safety_trip(SafetyEvent::Danger, 0);
    let found = |finding| roll_back(vec![Reason::new(Dimension::Monitor, finding)], 0);
    let worse = |rate| found(Finding::RateWorse { rate });
    for (decision, by_harm, state) in [
        (&event, false, State::Demoted),
        (&event, true, State::Demoted),
        (&worse(Rate::Failure), false, State::Demoted),
        (&found(Finding::EscalationUnanswered), false, State::RolledBack),
        (&worse(Rate::Intervention), false, State::Demoted),
    ] {
        let (bench, id) = RollbackBench::with_active("align-improved");
        let bench = decided(bench, &id, decision, by_harm);
        assert_eq!(bench.pipeline.record().version_table().version(&id).unwrap().1.state, state, "{by_harm}");
        assert_eq!(bench.pipeline.sequences(), 0, "no task runs before every version is watched");
    }
    // What was decided about an earlier activation has had its effect.
    let mut bench = RollbackBench::new();
    let id = bench.pass("align-improved", &Stage::ALL);
    tell_monitor(bench.pipeline.live().record, &id, event.action, &event.reasons).unwrap();
    bench.enter(&id, |version| LifecycleEvent::Activate { version });
    let bench = bench.restart();
    assert_eq!(bench.pipeline.record().version_table().version(&id).unwrap().1.state, State::Active);
}

/// Its evidence is unreadable or gone, which says nothing against it.
#[test]
fn version_that_cannot_be_watched_after_a_restart_is_not_rolled_back_for_good() {
    let (mut bench, id) = RollbackBench::with_active("align-improved");
    let without_twins = EvidenceFile::default();
    let evidence = Change::PutEvidence {
        version: id.clone(),
        kind: EvidenceKind::Shadow,
        json: serde_json::to_string(&without_twins).unwrap(),
        digest: without_twins.digest().unwrap(),
    };
    bench.pipeline.live().record.write(vec![evidence], Vec::new()).unwrap();
    let bench = bench.restart();
    let version_table = bench.pipeline.record().version_table();
    assert_eq!(version_table.version(&id).unwrap().1.state, State::Demoted);
}
