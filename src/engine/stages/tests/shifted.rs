//! An active version is held against its own twins as it works: what is otherwise than shadow showed is said, and the version
//! is worked again in the conditions of the live world.

use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::evidence::EpisodeValues;
use holdpoint_governance::harm::HarmMeasures;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::outcome::BehaviorOutcome;
use holdpoint_governance::shift::live_look;
use holdpoint_registry::Views;

use crate::doubt::Suspicion;
use crate::observed::{Since, observe};
use crate::pipeline::Progress;
use crate::stages::rollback::tests::{Bench, GOOD};

/// A bench with an active version whose twins in shadow were these, once it has worked as many live tasks as the first look
/// is taken at; and what the alarm says, if it is raised.
fn looked_at(twin: EpisodeValues) -> (Bench, Option<String>) {
    let mut bench = Bench::new();
    let id = bench.activate("align-improved");
    let live = bench.pipeline.live();
    live.dossiers.edit(&id).twins = vec![twin; 40];
    let tasks = (1..1_000).find(|tasks| live_look(*tasks, &live.context.profile)).unwrap();
    while bench.pipeline.live().monitors.of(&id).is_some_and(|watched| watched.episodes < tasks) {
        bench.pipeline.live().sequence(None).unwrap();
    }
    let (_, standing, _) = bench.pipeline.record().ledger().version(&id).unwrap();
    assert_eq!(standing.state, State::Active, "it decides nothing by itself");
    let alarm = bench
        .pipeline
        .record()
        .alarms()
        .get(&AlarmKey::Shifted(id))
        .map(|alarm| alarm.text.line().into_string());
    (bench, alarm)
}

#[test]
fn what_shadow_did_not_show_is_said_of_an_active_version() {
    // As if the twins had never touched anything.
    let (_bench, alarm) = looked_at(EpisodeValues { harm: Some(HarmMeasures::STILL), ..GOOD });
    let text = alarm.expect("the alarm is raised");
    assert!(text.contains("not what shadow showed") && text.contains("live tasks"), "{text}");
}

#[test]
fn what_shadow_showed_is_not_said_again() {
    let (_bench, alarm) = looked_at(GOOD);
    assert_eq!(alarm, None);
}

/// Works on until nothing is left to clear of this version.
fn worked_again(bench: &mut Bench, id: &CapabilityId) {
    for _ in 0..2_000 {
        if !bench.pipeline.live().dossiers.is_suspicious(id)
            || bench.pipeline.live().monitors.of(id).is_none()
        {
            return;
        }
        assert_eq!(bench.pipeline.advance(), Progress::Worked);
    }
    panic!("{id} is still suspicious");
}

#[test]
fn a_suspicious_version_is_worked_again_and_cleared_and_that_survives_the_engine() {
    let (bench, alarm) = looked_at(EpisodeValues { harm: Some(HarmMeasures::STILL), ..GOOD });
    assert!(alarm.unwrap().contains("suspicious: not what shadow showed"));
    // What it is suspected of is on record: an engine that comes up knows it.
    let mut bench = bench.restart();
    let id: CapabilityId = "align@1.1.0".parse().unwrap();
    let suspicious = bench.pipeline.live().dossiers.is_suspicious(&id);
    assert!(suspicious, "the engine that comes up goes on with it");
    worked_again(&mut bench, &id);
    let found_again = bench.pipeline.live().dossiers.of(&id).unwrap().suspicion.clone().unwrap();
    let again = found_again.again.as_ref().expect("it was worked again");
    assert_eq!(again.behavior.assessment.outcome, BehaviorOutcome::Compatible, "{:?}", again.behavior);
    let budget = bench.pipeline.live().context.profile.evaluation.sandbox_pairs;
    assert_eq!(again.pairs.pairs.len(), budget as usize, "the whole budget");
    let (_, standing, _) = bench.pipeline.record().ledger().version(&id).unwrap();
    assert_eq!(standing.state, State::Active);
    // What it came to is made again from the record, and comes out the same.
    let views = Views::open(&bench.folder().join("holdpoint.db")).unwrap();
    let environment = bench.pipeline.live().context.cell.digest();
    let found = observe(&views, None, Since::Record(1), environment).unwrap();
    assert_eq!((found.metrics.replays.differs, found.metrics.replays.equal), (0, 1), "{:?}", found.unequal);
    drop(views);
    // What an explanation tells of both, where a decision stands before them.
    let begun = Suspicion { again: None, ..found_again.clone() }.lines();
    assert!(begun[0].starts_with("suspicious: not what shadow showed"), "{begun:?}");
    let told = found_again.lines();
    let cleared = "suspicious, and worked again in the live world's conditions: compatible in";
    assert!(told.len() == 1 && told[0].starts_with(cleared), "{told:?}");
    // It is cleared for an engine that comes up later, too.
    let mut bench = bench.restart();
    assert!(!bench.pipeline.live().dossiers.is_suspicious(&id));
}

#[test]
fn a_suspicious_version_that_is_worse_there_is_taken_off() {
    let mut bench = Bench::new();
    let id = bench.activate("grasp-hard-grip");
    let reasons = Vec::new();
    bench.pipeline.live().dossiers.edit(&id).suspicion = Some(Suspicion { reasons, again: None });
    worked_again(&mut bench, &id);
    let (_, standing, _) = bench.pipeline.record().ledger().version(&id).unwrap();
    assert_eq!(standing.state, State::Demoted);
    let dossier = bench.pipeline.live().dossiers.of(&id).unwrap();
    let again = dossier.suspicion.as_ref().unwrap().again.as_ref().unwrap();
    assert_eq!(again.behavior.assessment.outcome, BehaviorOutcome::Incompatible);
    let first = &dossier.reasons[0];
    assert_eq!(first.code, ReasonCode::MonitorWorkedAgain);
    assert!(first.text.contains("worked again in the live world's conditions: incompatible"), "{first:?}");
}

#[test]
fn a_new_shadow_begins_without_what_was_suspected_before() {
    let mut bench = Bench::new();
    let id = bench.pass("align-improved", &[Stage::Validation, Stage::Sandbox]);
    let live = bench.pipeline.live();
    live.dossiers.edit(&id).suspicion = Some(Suspicion { reasons: Vec::new(), again: None });
    assert!(live.dossiers.is_suspicious(&id));
    crate::stages::shadow::begin(live.context, live.record, live.dossiers, &id).unwrap();
    assert!(!live.dossiers.is_suspicious(&id));
}
