//! A safety event on which the rollback target was not compared: it counts as the version's own, and the record says why.

use std::sync::Arc;

use holdpoint_governance::monitor::SafetyEvent;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_trials::cell::Cell;

use super::*;
use crate::decide::pipeline::PipelineSettings;
use crate::live::fake_cell::StubFactory;
use crate::quick_folder::quick_folder;

/// What the rollback finds for a force of a grasp in these cells, with the state at the task's start, if one was kept.
fn compared(factory: StubFactory, start: Option<&CellCopy>) -> Result<Option<SharedEvent>, UncomparedReason> {
    let cell = Cell::new(Arc::new(factory)).unwrap();
    let folder = quick_folder();
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let settings = PipelineSettings { cell, ..settings(profile, EpisodeSeeds::OfRun(CALIBRATION_FROM_RUN)) };
    let mut pipeline = pipeline_of(folder.path(), settings, |_| WallClock::scripted(0, None));
    let target = pipeline.record().capability(&"grasp@1.0.0".parse().unwrap()).unwrap();
    let of_force = Trigger {
        event: Some(SafetyEvent::ForceLimit),
        ..trigger(pipeline.record(), TriggerKind::SafetyEvent, Notice::StageBegins)
    };
    let record = TaskRecord::refused(TaskKind::Grasp, 7);
    let task = MeasuredTask { sequence: 0, record: &record, envelope: None };
    let live = pipeline.live();
    let rollback = Rollback {
        context: live.context,
        record: live.record,
        evidence_files: live.evidence_files,
        monitors: live.monitors,
        world: live.world,
    };
    rollback.shared_event(start.map(|start| LiveScene { start, task }), &of_force, &target)
}

#[test]
fn a_cell_without_export_gives_no_comparison() {
    assert_eq!(compared(StubFactory::new(), None), Err(UncomparedReason::NoExport));
    // An observed state is no start of a fork, either: the twin would differ from the task.
    assert_eq!(compared(StubFactory::observing(0.0), None), Err(UncomparedReason::NoExport));
    assert_eq!(compared(StubFactory::exporting(), None), Err(UncomparedReason::NoStart));
}

#[test]
fn a_fork_compares_only_from_a_state_that_its_cell_takes() {
    let cell = Cell::new(Arc::new(StubFactory::exporting())).unwrap();
    let copy = cell.live_cell().unwrap().copy().unwrap();
    // The arm of the fork never moves, so the target has no force.
    assert_eq!(compared(StubFactory::exporting(), Some(&copy)), Ok(None));
    let of_another = CellCopy::in_memory(0, ());
    assert_eq!(compared(StubFactory::exporting(), Some(&of_another)), Err(UncomparedReason::NoFork));
}

#[test]
fn an_event_without_a_comparison_takes_the_version_off_for_good() {
    let (mut bench, id) = RollbackBench::with_active("align-improved");
    let cause = trigger(bench.pipeline.record(), TriggerKind::SafetyEvent, Notice::StageBegins);
    bench.pipeline.live().deactivate(&id, cause, None, DeactivationKind::RolledBack).unwrap();
    let record = bench.record();
    assert_eq!((record.post_status, record.shared), (PostStatus::RolledBack, None));
    assert_eq!(record.uncompared, Some(UncomparedReason::NoStart));
    assert_eq!(bench.pipeline.record().version_table().version(&id).unwrap().1.state, State::RolledBack);
    // Any other rollback makes no comparison, and records no reason.
    let mut other = RollbackBench::new();
    let id = other.activate("align-improved");
    assert_eq!(other.by_operator(&id).uncompared, None);
}
