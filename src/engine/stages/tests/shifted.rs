//! An active version is held against its own twins as it works: what is otherwise than shadow showed is said, and decides
//! nothing.

use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::evidence::EpisodeValues;
use holdpoint_governance::harm::HarmMeasures;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::shift::live_look;

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
    assert_eq!(standing.state, State::Active, "it decides nothing");
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
