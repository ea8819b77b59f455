//! The engine on a cell that is no simulator.

use std::collections::{BTreeMap, BTreeSet};

use holdpoint_governance::cell_ability::CellAbility;
use holdpoint_governance::ids::Family;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_runtime::agent::ActiveView;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_trials::embedded;

use super::*;
use crate::live::listener::NoListener;
use crate::live::shadow::ShadowTrace;
use crate::live::station::{LiveStation, SequenceReport};
use crate::live::twin_start::{TwinStart, missing_abilities};

struct Baselines(BTreeMap<Family, Capability>);

impl ActiveView for Baselines {
    fn active(&self, family: &Family) -> Option<&Capability> {
        self.0.get(family)
    }
}

fn terms(cell: &Cell) -> SkillTerms {
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
    SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone())
}

fn run(factory: &StubFactory) -> SequenceReport {
    let cell = factory.clone().into_cell();
    let terms = terms(&cell);
    let baselines = embedded::baselines().unwrap().into_iter();
    let view = Baselines(baselines.map(|version| (version.id().family, version)).collect());
    let mut live = LiveStation::new(cell).unwrap();
    live.run_sequence(&view, &|_| terms.clone(), 7, &mut NoListener, None)
}

#[test]
fn evidence_is_bound_to_the_build_and_the_description_that_a_cell_states() {
    let first = StubFactory::new().into_cell();
    let again = StubFactory::new().into_cell();
    assert_eq!((first.digest(), first.computed_by()), (again.digest(), again.computed_by()));
    let rebuilt = StubFactory { build: "changed".to_owned(), ..StubFactory::new() }.into_cell();
    assert!(first.digest() != rebuilt.digest() && first.computed_by() != rebuilt.computed_by());
    let described = StubFactory::exporting().into_cell();
    assert!(first.digest() != described.digest() && first.computed_by() == described.computed_by());
}

#[test]
fn live_cell_is_asked_for_work_and_told_of_each_task() {
    let factory = StubFactory::new();
    assert!(!run(&factory).succeeded());
    let expected = [FakeCall::AwaitWork { seed: 7 }, FakeCall::BeginTask(TaskKind::Grasp), FakeCall::EndTask];
    assert_eq!(*factory.calls.lock().unwrap(), expected);
}

#[test]
fn sequence_without_work_has_failed() {
    let report = run(&StubFactory { is_starved: true, ..StubFactory::new() });
    assert!(report.failed && report.tasks.iter().all(|done| done.record.invalid), "{report:?}");
}

/// A cell that does not answer has another error than one that failed: a person has to look.
#[test]
fn sequence_of_a_lost_cell_says_so() {
    let report = run(&StubFactory { is_lost: true, ..StubFactory::new() });
    assert_eq!((report.failed, report.lost.as_deref()), (true, Some("gone")));
    let report = run(&StubFactory { is_starved: true, ..StubFactory::new() });
    assert_eq!((report.failed, report.lost), (true, None));
}

fn baseline(task: TaskKind) -> Capability {
    let mut baselines = embedded::baselines().unwrap().into_iter();
    baselines.find(|version| version.bundle.task() == task).unwrap()
}

/// What shadow records of a task of this kind in which the live cell stood still.
fn shadowed(factory: StubFactory, task: TaskKind) -> ShadowTrace {
    let cell = factory.into_cell();
    let mut shadow = Shadow::new(baseline(task), terms(&cell), cell.trial().unwrap());
    let record = stand_still(&mut shadow, &cell, 7);
    let (trace, fork) = shadow.conclude(Some(&record), 7);
    assert!(fork.is_some(), "the trial cell comes back");
    trace.unwrap()
}

#[test]
fn twin_continues_from_an_exported_state() {
    let trace = shadowed(StubFactory::exporting(), TaskKind::Grasp);
    let values = trace.values.unwrap();
    assert!(trace.twin.is_some() && trace.outputs.is_none());
    assert_eq!(values.twin_difference, None);
}

/// A twin that the live cell's thread works would delay the live cell.
#[test]
fn twin_beside_works_on_a_thread_of_its_own_with_the_same_result() {
    let cell = StubFactory::exporting().into_cell();
    let candidate = baseline(TaskKind::Grasp);
    let threads = Arc::new(Mutex::new(BTreeSet::new()));
    let mut traces = Vec::new();
    for is_beside in [false, true] {
        let mut shadow = Shadow::new(candidate.clone(), terms(&cell), cell.trial().unwrap());
        if is_beside {
            let threads = Arc::clone(&threads);
            let name = || std::thread::current().name().map(ToOwned::to_owned);
            shadow.run_twin_beside(Box::new(move |_, _| {
                threads.lock().unwrap().insert(name());
            }));
        }
        let record = stand_still(&mut shadow, &cell, 7);
        let (trace, _) = shadow.conclude(Some(&record), 7);
        traces.push(trace);
    }
    assert!(traces[0].is_some());
    assert_eq!(traces[0], traces[1]);
    assert_eq!(*threads.lock().unwrap(), BTreeSet::from([Some("twin".to_owned())]));
}

#[test]
fn twin_begins_at_the_observed_state_where_none_is_exported() {
    let trace = shadowed(StubFactory::observing(0.003), TaskKind::Grasp);
    assert!(trace.twin.is_some() && trace.outputs.is_none());
    let difference = trace.values.unwrap().twin_difference.unwrap();
    assert!((difference.joints_rad - 0.003).abs() < 1e-12, "{difference:?}");
    assert_eq!((difference.width_m, difference.object_m), (0.0, None));
}

#[test]
fn difference_that_is_no_number_is_no_twin() {
    let cell = StubFactory::observing(f64::NAN).into_cell();
    let mut trial = cell.trial().unwrap();
    assert!(TwinStart::at(cell.live_cell().unwrap().as_ref(), trial.as_mut()).is_none());
}

#[test]
fn outputs_alone_are_compared_where_a_cell_has_no_twin() {
    let alone = shadowed(StubFactory::new(), TaskKind::Grasp);
    assert!(alone.twin.is_none() && alone.values.is_none());
    let beside = shadowed(StubFactory::exporting(), TaskKind::Grasp);
    let outputs = alone.outputs.unwrap();
    assert_eq!(outputs.output_divergence, beside.values.unwrap().output_divergence);
    assert_eq!((outputs.seed, alone.proposed_commands), (7, beside.proposed_commands));
}

/// The dispatcher calls no align without an object in the hand.
#[test]
fn refused_candidate_commands_nothing_which_is_the_largest_divergence() {
    let trace = shadowed(StubFactory::new(), TaskKind::Align);
    assert_eq!(trace.outputs.unwrap().output_divergence, 1.0);
    assert!(trace.proposed_commands.is_empty());
}

#[test]
fn missing_abilities_are_those_that_a_twin_would_have_needed() {
    use CellAbility::{ExportState, SetObserved};
    for (factory, expected) in [
        (StubFactory::exporting(), vec![]),
        (StubFactory::observing(0.0), vec![ExportState]),
        (StubFactory::new(), vec![ExportState, SetObserved]),
    ] {
        assert_eq!(missing_abilities(factory.spec.abilities), expected);
    }
}
