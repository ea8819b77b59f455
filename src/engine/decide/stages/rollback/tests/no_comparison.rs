//! A safety event on which the rollback target is not compared, and why.

use holdpoint_governance::monitor::SafetyEvent;
use holdpoint_runtime::task::TaskRecord;

use super::*;

const FORCE: Option<SafetyEvent> = Some(SafetyEvent::ForceLimit);

/// What the rollback finds for an event of a grasp in these cells, with the state at the task's start, if one was kept.
fn compared(
    factory: StubFactory,
    start: Option<&Arc<CellCopy>>,
    event: Option<SafetyEvent>,
) -> Result<Option<SharedEvent>, UncomparedReason> {
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let mut bench = RollbackBench::in_cell(factory.into_cell(), profile);
    let pipeline = &mut bench.pipeline;
    let target = pipeline.record().capability(&"grasp@1.0.0".parse().unwrap()).unwrap();
    let cause =
        Trigger { event, ..trigger(pipeline.record(), TriggerKind::SafetyEvent, Notice::StageBegins) };
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
    rollback.shared_event(start.map(|start| LiveScene { start, task }), &cause, &target)
}

#[test]
fn a_cell_without_export_gives_no_comparison() {
    assert_eq!(compared(StubFactory::new(), None, FORCE), Err(UncomparedReason::NoExport));
    // An observed state is no start of a fork, either: the twin would differ from the task.
    assert_eq!(compared(StubFactory::observing(0.0), None, FORCE), Err(UncomparedReason::NoExport));
    assert_eq!(compared(StubFactory::exporting(), None, FORCE), Err(UncomparedReason::NoStart));
}

#[test]
fn a_fork_compares_only_from_a_state_that_its_cell_takes() {
    let cell = StubFactory::exporting().into_cell();
    let copy = Arc::new(cell.live_cell().unwrap().copy().unwrap());
    // The arm of the fork never moves, so the target has no force.
    assert_eq!(compared(StubFactory::exporting(), Some(&copy), FORCE), Ok(None));
    // Neither the trigger nor the record of the task names an event to look for.
    assert_eq!(compared(StubFactory::exporting(), Some(&copy), None), Err(UncomparedReason::NoEvent));
    let of_another = Arc::new(CellCopy::in_memory(0, ()));
    assert_eq!(compared(StubFactory::exporting(), Some(&of_another), FORCE), Err(UncomparedReason::NoFork));
}

#[test]
fn a_rollback_by_a_person_makes_no_comparison() {
    let (mut bench, id) = RollbackBench::resting_with_active("align-improved");
    let record = bench.by_operator(&id);
    assert_eq!((record.post_status, record.uncompared), (PostStatus::RolledBack, None));
}
