//! What a rule asks for reaches what it is about: a condition the guard's envelope, a person's act the charts.

use holdpoint_governance::condition::Condition;
use holdpoint_governance::monitor::Rate;
use holdpoint_protocol::command::{Caller, Command, Reply};
use holdpoint_text::Hint;

use super::state_verb_table::{CANDIDATE, operation};
use crate::decide::stages::rollback::tests::RollbackBench;
use crate::live::monitors::terms_of;
use holdpoint_record::evidence_binding::measured_terms_of;

/// A tighter envelope binds where the version is measured and where it has the arm.
#[test]
fn a_tighter_envelope_binds_in_the_sandbox_and_on_the_arm() {
    let (mut bench, id) = RollbackBench::resting_with_active(CANDIDATE);
    let limits = |bench: &mut RollbackBench| {
        let live = bench.pipeline.live();
        let version = live.record.capability(&id).unwrap();
        let measured = measured_terms_of(live.context, live.evidence_files, &version);
        let acting =
            terms_of(live.context, live.record.version_table(), live.evidence_files, live.monitors, &version);
        [measured, acting].map(|terms| {
            let envelope = terms.envelope();
            (envelope.tool_speed_max_m_s, envelope.grip_force_max_n)
        })
    };
    let wide = limits(&mut bench);
    let (speed, force) = (0.5 * wide[0].0, 0.5 * wide[0].1);
    bench.pipeline.live().evidence_files.edit(&id).conditions =
        vec![Condition::TighterEnvelope { speed_max_m_s: speed, force_max_n: force }];
    for (tight, wide) in limits(&mut bench).into_iter().zip(wide) {
        assert!(tight.0 <= speed && tight.1 <= force, "{tight:?} of {wide:?}");
    }
}

/// A manual restriction of an active version counts as an intervention, and its monitor knows.
#[test]
fn a_restriction_by_a_person_reaches_the_chart_of_interventions() {
    let (mut bench, id) = RollbackBench::resting_with_active(CANDIDATE);
    let charted = |bench: &mut RollbackBench| {
        let live = bench.pipeline.live();
        let monitor = &live.monitors.of(&id).unwrap().monitor;
        monitor.charts().filter(|(rate, ..)| *rate == Rate::Intervention).map(|(_, _, at, _)| at).sum::<f64>()
    };
    let before = charted(&mut bench);
    let reply = bench.pipeline.command(Command::Restrict(operation(&id)));
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    let after = charted(&mut bench);
    assert!(after > before, "{before} to {after}");
}

/// What was done is never told to be refused, whatever comes after it.
#[test]
fn unrecordable_caller_halts_the_engine() {
    let (mut bench, id) = RollbackBench::resting_with_active(CANDIDATE);
    let caller = Caller::Process { uid: 7, user: None, process: Some(7) };
    let database = bench.pipeline.record().version_table().store().layout().database();
    let reply = bench.pipeline.command_of(Command::Restrict(operation(&id)), &caller, None);
    assert!(
        matches!(reply, Reply::Accepted { .. }) && bench.pipeline.record().holding().is_none(),
        "{reply:?}"
    );
    let index = "CREATE UNIQUE INDEX refuse ON audit (kind) WHERE kind = 'asked'";
    rusqlite::Connection::open(database).and_then(|other| other.execute_batch(index)).unwrap();
    let release = Command::Release { operation: operation(&id), profiles: Vec::new() };
    let released = bench.pipeline.command_of(release, &caller, None);
    assert!(matches!(released, Reply::Accepted { .. }), "{released:?}");
    let problem = bench.pipeline.record().holding().map(Hint::sentence).unwrap_or_default();
    assert!(problem.contains("release"), "the command is named: {problem}");
}
