//! The engine on a cell that is no simulator.

use std::collections::BTreeMap;

use holdpoint_governance::ids::Family;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_runtime::agent::ActiveView;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_runtime::terms::SkillTerms;

use super::*;
use crate::cell::Cell;
use crate::embedded;
use crate::world::listener::{Listener, NoListener};
use crate::world::live::{LiveStation, SequenceReport};
use crate::world::shadow::Shadow;

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

fn run(factory: &FakeFactory) -> SequenceReport {
    let cell = Cell::new(Arc::new(factory.clone())).unwrap();
    let terms = terms(&cell);
    let baselines = embedded::baselines().unwrap().into_iter();
    let view = Baselines(baselines.map(|version| (version.id().family, version)).collect());
    let mut live = LiveStation::new(cell).unwrap();
    live.run_sequence(&view, &|_| terms.clone(), 7, &mut NoListener, None)
}

#[test]
fn evidence_is_bound_to_the_build_and_the_description_that_a_cell_states() {
    let cell = |factory: FakeFactory| Cell::new(Arc::new(factory)).unwrap();
    let first = cell(FakeFactory::new());
    let again = cell(FakeFactory::new());
    assert_eq!((first.digest(), first.computed_by()), (again.digest(), again.computed_by()));
    let rebuilt = cell(FakeFactory { build: "changed".to_owned(), ..FakeFactory::new() });
    assert!(first.digest() != rebuilt.digest() && first.computed_by() != rebuilt.computed_by());
    let described = cell(FakeFactory::exporting());
    assert!(first.digest() != described.digest() && first.computed_by() == described.computed_by());
}

#[test]
fn live_cell_is_asked_for_work_and_told_of_each_task() {
    let factory = FakeFactory::new();
    assert!(!run(&factory).succeeded());
    let expected = [FakeCall::AwaitWork { seed: 7 }, FakeCall::BeginTask(TaskKind::Grasp), FakeCall::EndTask];
    assert_eq!(*factory.calls.lock().unwrap(), expected);
}

#[test]
fn sequence_without_work_has_failed() {
    let report = run(&FakeFactory { is_starved: true, ..FakeFactory::new() });
    assert!(report.failed && report.tasks.iter().all(|done| done.record.invalid), "{report:?}");
}

#[test]
fn twin_starts_from_an_exported_state_and_is_missing_without_one() {
    for (factory, has_twin) in [(FakeFactory::exporting(), true), (FakeFactory::new(), false)] {
        let cell = Cell::new(Arc::new(factory)).unwrap();
        let candidate = embedded::baselines().unwrap().remove(0);
        let task = candidate.bundle.task();
        let mut live = cell.live_cell().unwrap();
        live.begin_task(task);
        let mut shadow = Shadow::new(candidate, terms(&cell), cell.trial().unwrap());
        shadow.before_task(live.as_ref(), task, 7);
        let record = TaskRecord { success: true, invalid: false, ..TaskRecord::refused(task, 7) };
        let (trace, fork) = shadow.conclude(Some(&record), 7);
        assert_eq!(trace.is_some(), has_twin);
        assert!(fork.is_some());
    }
}
