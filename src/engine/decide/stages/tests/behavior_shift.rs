//! An active version is compared with its own twins as it runs: a difference from its shadow raises an alarm, and the
//! version is re-evaluated in the conditions of the live cell.

use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::distribution_shift::is_live_look_due;
use holdpoint_governance::evidence::EpisodeValues;
use holdpoint_governance::explanation::Consequence;
use holdpoint_governance::finding::Finding;
use holdpoint_governance::harm::HarmMeasures;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage, State};
use holdpoint_governance::notice::{Notice, NoticeOrText};
use holdpoint_governance::outcome::BehaviorOutcome;
use holdpoint_governance::profile::ProfileName;
use holdpoint_registry::Views;

use crate::decide::pipeline::SliceOutcome;
use crate::decide::stages::rollback::tests::{GOOD, RollbackBench};
use holdpoint_explain::store_metrics::{Since, observe};
use holdpoint_record::version_concern::VersionConcern;
use holdpoint_record::version_table::TransitionNote;

/// A bench with an active version whose twins in shadow were these, once it has worked as many live tasks as the first look
/// is taken at; and what the alarm says, if it is raised.
fn shift_alarm(twin: EpisodeValues) -> (RollbackBench, Option<NoticeOrText>) {
    let (mut bench, id) = RollbackBench::with_active("align-improved");
    let live = bench.pipeline.live();
    live.evidence_files.edit(&id).twins = vec![twin; 40];
    let tasks = (1..1_000).find(|tasks| is_live_look_due(*tasks, &live.context.profile)).unwrap();
    while bench.pipeline.live().monitors.of(&id).is_some_and(|watched| watched.episodes < tasks) {
        bench.pipeline.live().sequence(None).unwrap();
    }
    let (_, lifecycle, _) = bench.pipeline.record().version_table().version(&id).unwrap();
    assert_eq!(lifecycle.state, State::Active, "it decides nothing by itself");
    let alarm = bench.pipeline.record().alarms().get(&AlarmKey::Shifted(id)).map(|alarm| alarm.text.clone());
    (bench, alarm)
}

fn is_live_shift(text: &NoticeOrText) -> bool {
    let Some(Notice::Shifted { reasons, .. }) = text.notice() else { return false };
    reasons.iter().any(|reason| matches!(reason.finding, Some(Finding::ShiftedLive { .. })))
}

#[test]
fn a_shift_from_shadow_raises_an_alarm() {
    // As if the twins had never touched anything.
    let (_bench, alarm) = shift_alarm(EpisodeValues { harm: Some(HarmMeasures::STILL), ..GOOD });
    let text = alarm.expect("the alarm is raised");
    assert!(is_live_shift(&text), "{text:?}");
}

#[test]
fn the_same_behavior_raises_no_alarm() {
    let (_bench, alarm) = shift_alarm(GOOD);
    assert_eq!(alarm, None);
}

/// Runs until this version has no open concern.
fn re_evaluate(bench: &mut RollbackBench, id: &CapabilityId) {
    for _ in 0..2_000 {
        if !bench.pipeline.live().evidence_files.is_suspicious(id)
            || bench.pipeline.live().monitors.of(id).is_none()
        {
            return;
        }
        assert_eq!(bench.pipeline.advance(), SliceOutcome::Ran);
    }
    panic!("{id} still has a concern");
}

#[test]
fn a_re_evaluation_that_clears_a_version_survives_a_restart() {
    let (bench, alarm) = shift_alarm(EpisodeValues { harm: Some(HarmMeasures::STILL), ..GOOD });
    assert!(is_live_shift(&alarm.unwrap()));
    // The concern is recorded: a restarted engine knows it.
    let mut bench = bench.restart();
    let id: CapabilityId = "align@1.1.0".parse().unwrap();
    let suspicious = bench.pipeline.live().evidence_files.is_suspicious(&id);
    assert!(suspicious, "the restarted engine continues it");
    re_evaluate(&mut bench, &id);
    let found_again = bench.pipeline.live().evidence_files.of(&id).unwrap().suspicion.clone().unwrap();
    let again = found_again.again.as_ref().expect("it was re-evaluated");
    assert_eq!(again.behavior.assessment.outcome, BehaviorOutcome::Compatible, "{:?}", again.behavior);
    let budget = bench.pipeline.live().context.profile.evaluation.sandbox_pairs;
    assert_eq!(again.pairs.pairs.len(), budget as usize, "the whole budget");
    let (_, lifecycle, _) = bench.pipeline.record().version_table().version(&id).unwrap();
    assert_eq!(lifecycle.state, State::Active);
    // Its result is recomputed from the record, and equals the stored one.
    let views = Views::open(&bench.folder().join("holdpoint.db")).unwrap();
    let environment = bench.pipeline.live().context.cell.digest();
    let found = observe(&views, None, Since::Record(1), environment).unwrap();
    assert_eq!((found.metrics.replays.differs, found.metrics.replays.equal), (0, 1), "{:?}", found.unequal);
    drop(views);
    // What an explanation states of both, before their decisions.
    let begun = VersionConcern { again: None, ..found_again.clone() }.consequence();
    let Consequence::ConcernFound(reasons) = &begun else { panic!("{begun:?}") };
    assert!(matches!(reasons[0].finding, Some(Finding::ShiftedLive { .. })), "{reasons:?}");
    let Consequence::ReEvaluated { drift: None, reasons } = found_again.consequence() else {
        panic!("{found_again:?}")
    };
    let [result] = &reasons[..] else { panic!("{reasons:?}") };
    let outcome = BehaviorOutcome::Compatible;
    assert!(
        matches!(result.finding, Some(Finding::ReEvaluatedLive { outcome: of, .. }) if of == outcome),
        "{result:?}"
    );
    // It is cleared for a later engine, too.
    let mut bench = bench.restart();
    assert!(!bench.pipeline.live().evidence_files.is_suspicious(&id));
}

#[test]
fn a_version_that_re_evaluates_as_worse_is_demoted() {
    let (mut bench, id) = RollbackBench::with_active("align-low-transit");
    let reasons = Vec::new();
    bench.pipeline.live().evidence_files.edit(&id).suspicion = Some(VersionConcern { reasons, again: None });
    re_evaluate(&mut bench, &id);
    let (_, lifecycle, _) = bench.pipeline.record().version_table().version(&id).unwrap();
    assert_eq!(lifecycle.state, State::Demoted);
    let evidence_file = bench.pipeline.live().evidence_files.of(&id).unwrap();
    let again = evidence_file.suspicion.as_ref().unwrap().again.as_ref().unwrap();
    assert_eq!(again.behavior.assessment.outcome, BehaviorOutcome::Incompatible);
    let first = &evidence_file.reasons[0];
    assert_eq!(first.code, ReasonCode::MonitorWorkedAgain);
    let outcome = BehaviorOutcome::Incompatible;
    let found = first.finding.as_ref();
    assert!(
        matches!(found, Some(Finding::ReEvaluatedLive { outcome: of, .. }) if *of == outcome),
        "{first:?}"
    );
}

/// No monitor watches a confirmed version after a restart, and its concern once stayed open without a re-evaluation.
#[test]
fn a_concern_about_a_confirmed_version_is_re_evaluated_after_a_restart() {
    let (mut bench, id) = RollbackBench::with_active("align-improved");
    let version = bench.pipeline.record().version_table().version(&id).unwrap().0;
    let live = bench.pipeline.live();
    let note = TransitionNote::because(Notice::StageBegins);
    live.record.transition(&id.family, LifecycleEvent::Confirm { version }, note).unwrap();
    let concern = VersionConcern { reasons: Vec::new(), again: None };
    live.record.write(vec![concern.evidence(&id).unwrap()], Vec::new()).unwrap();
    let mut bench = bench.restart();
    assert!(bench.pipeline.live().monitors.of(&id).is_none());
    for slice in ["it begins", "it goes on"] {
        assert_eq!(bench.pipeline.advance(), SliceOutcome::Ran, "{slice}");
        let progress = bench.pipeline.live().evidence_files.of(&id).unwrap().progress.clone();
        assert_eq!(progress.map(|view| view.stage), Some(Stage::Shadow), "{slice}");
    }
}

#[test]
fn new_shadow_evaluation_clears_an_earlier_concern() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = bench.pass("align-improved", &[Stage::Validation, Stage::Sandbox]);
    let live = bench.pipeline.live();
    live.evidence_files.edit(&id).suspicion = Some(VersionConcern { reasons: Vec::new(), again: None });
    assert!(live.evidence_files.is_suspicious(&id));
    crate::decide::stages::shadow::begin(live.context, live.record, live.evidence_files, &id).unwrap();
    assert!(!live.evidence_files.is_suspicious(&id));
}
