//! A live distribution that leaves the domain of the evidence: reported at its first task outside, and answered as the
//! profile demands.

use holdpoint_body::TaskKind;
use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude};
use holdpoint_governance::alarms::{Alarm, AlarmKey, Priority};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::start_domain::{
    DomainMiss, OutsideResponse, StartBound, StartDomain, StartQuantity,
};
use holdpoint_runtime::agent::dispatcher::DispatchRefusal;

use crate::decide::stages::rollback::tests::RollbackBench;
use crate::live::station::SequenceReport;
use holdpoint_record::evidence_binding::{binding, start_domain};

/// The first sequence of the bench has its object at x = .589 m after this drift; the next seven have theirs inside.
const SHIFT: Drift = Drift { kind: DriftKind::DistributionShift, magnitude: Magnitude::Strong };

fn baseline() -> CapabilityId {
    "grasp@1.0.0".parse().unwrap()
}

/// The simulation's profile with another response.
fn responding(outside: OutsideResponse) -> Profile {
    let mut profile = Profile::builtin(ProfileName::Sim).unwrap();
    profile.domain.outside = outside;
    profile
}

fn alarm<'a>(bench: &'a RollbackBench, id: &CapabilityId) -> Option<&'a Alarm> {
    bench.pipeline.record().alarms().get(&AlarmKey::OutsideDomain(id.clone()))
}

/// A domain that covers no start of the cell.
fn nowhere() -> StartDomain {
    StartDomain { bounds: vec![StartBound { quantity: StartQuantity::ObjectX, low: 0.0, high: 0.1 }] }
}

fn run(bench: &mut RollbackBench) -> SequenceReport {
    bench.pipeline.live().sequence(None).unwrap()
}

fn is_outside(report: &SequenceReport) -> bool {
    matches!(report.refused, Some(DispatchRefusal::OutsideDomain { .. }))
}

#[test]
fn unchanged_cell_raises_no_alarm_and_a_shift_raises_it_at_its_first_task() {
    let mut bench = RollbackBench::new();
    let report = run(&mut bench);
    assert!(report.tasks.iter().all(|done| done.record.uncovered.is_none()), "{:?}", report.tasks);
    assert!(alarm(&bench, &baseline()).is_none());
    let mut bench = RollbackBench::new();
    bench.pipeline.live().world.cell.set_drift(Some(SHIFT)).unwrap();
    let report = run(&mut bench);
    let grasp = report.task(TaskKind::Grasp).unwrap();
    assert!(grasp.record.starts_outside() && grasp.record.time_secs > 1.0, "it runs all the same");
    assert_eq!(bench.pipeline.live().world.uncovered, 1);
    let alarm = alarm(&bench, &baseline()).unwrap();
    assert!(alarm.condition && alarm.priority == Priority::Low, "{alarm:?}");
    let Some(Notice::OutsideDomain { missed, run_by, .. }) = alarm.text.notice() else { panic!("{alarm:?}") };
    assert_eq!(*run_by, Some(baseline()));
    let DomainMiss::Outside { quantity, value: Some(value), high, .. } = missed[0] else {
        panic!("{missed:?}")
    };
    assert_eq!(quantity, StartQuantity::ObjectX);
    assert!(value > 0.58 && high < 0.568, "{value} {high}");
}

#[test]
fn beside_people_the_task_is_refused_and_a_covered_one_runs() {
    let mut bench = RollbackBench::under(Profile::builtin(ProfileName::Human).unwrap());
    bench.pipeline.live().world.cell.set_drift(Some(SHIFT)).unwrap();
    let report = run(&mut bench);
    assert!(is_outside(&report) && report.tasks.is_empty(), "{report:?}");
    // The first camera frame comes within 200 ms; then the arm is brought to a standstill, where it was.
    assert!(report.duration_ms < 500, "{}", report.duration_ms);
    let live = bench.pipeline.live();
    let home = live.context.cell.spec.robot.home.clone();
    let rig = live.world.cell.rig_mut().unwrap();
    let moved = rig.world().truth().unwrap().joints.q.iter().zip(&home).map(|(q, home)| (q - home).abs());
    assert!(moved.fold(0.0, f64::max) < 0.06);
    let raised = alarm(&bench, &baseline()).unwrap();
    assert_eq!(raised.priority, Priority::Critical);
    let Some(Notice::OutsideDomain { run_by: None, .. }) = raised.text.notice() else { panic!("{raised:?}") };
    let active = bench.pipeline.record().active_of(&baseline().family).unwrap();
    assert_eq!(active.id(), baseline(), "it speaks against no version");
    let next = run(&mut bench);
    assert!(!is_outside(&next) && next.tasks[0].id == baseline(), "{:?}", next.refused);
}

#[test]
fn the_newest_earlier_version_that_covers_the_start_runs_the_task() {
    let mut bench = RollbackBench::under(responding(OutsideResponse::LastCovering));
    let id = bench.activate("grasp-improved");
    bench.pipeline.live().evidence_files.edit(&id).domain = Some(nowhere());
    let report = run(&mut bench);
    assert_eq!(report.tasks[0].id, baseline(), "{report:?}");
    assert_eq!(report.outside.len(), 1);
    assert_eq!((&report.outside[0].id, &report.outside[0].run_by), (&id, &Some(baseline())));
    assert!(report.tasks[0].record.uncovered.is_none(), "its evidence covers the start");
    assert!(alarm(&bench, &id).is_some() && alarm(&bench, &baseline()).is_none());
    let episodes = bench.pipeline.live().monitors.of(&id).unwrap().episodes;
    assert_eq!(episodes, 0, "the task of another version is none of its own");
    // Where no version covers the start, the task is refused.
    bench.pipeline.live().evidence_files.edit(&baseline()).domain = Some(nowhere());
    let report = run(&mut bench);
    assert!(is_outside(&report) && report.tasks.is_empty(), "{report:?}");
    assert_eq!(report.outside[0].run_by, None);
}

/// Every task is near enough to a person's zone to be a danger. An alarm names the version that works in place of the active one.
#[test]
fn harm_by_a_version_in_place_of_the_active_one_raises_an_alarm() {
    let mut profile = responding(OutsideResponse::LastCovering);
    profile.harm.zone_clearance_m.limit = 2.0;
    profile.live_harm.danger_zone_clearance_m = 2.0;
    let mut bench = RollbackBench::under(profile);
    let id = bench.activate("grasp-improved");
    bench.pipeline.live().evidence_files.edit(&id).domain = Some(nowhere());
    let report = run(&mut bench);
    assert_eq!(report.tasks[0].id, baseline(), "{report:?}");
    let record = bench.pipeline.record();
    assert!(record.alarms().get(&AlarmKey::Harm(baseline())).is_some(), "{:?}", record.alarms());
    assert_eq!(record.active_of(&id.family).map(|active| active.id()), Some(id.clone()), "it did not run");
}

#[test]
fn evidence_of_another_cell_that_declares_no_domain_covers_no_start() {
    let mut bench = RollbackBench::resting_under(responding(OutsideResponse::Refuse));
    let id = bench.activate("grasp-improved");
    let live = bench.pipeline.live();
    let version = live.record.active_of(&id.family).unwrap();
    let own = binding(live.context, live.record.version_table(), &version);
    live.evidence_files.edit(&id).bindings = vec![own];
    let cell = live.context.cell.start_domain(TaskKind::Grasp).clone();
    assert_eq!(start_domain(live.context, live.evidence_files, &version), cell);
    let environment = Digest::of_parts("test", &[b"another cell"]);
    live.evidence_files.edit(&id).bindings[0].environment = environment;
    assert_eq!(*start_domain(live.context, live.evidence_files, &version), StartDomain::default());
    let report = run(&mut bench);
    assert!(is_outside(&report), "{report:?}");
    assert_eq!(report.outside[0].missed, [DomainMiss::Undeclared]);
}
