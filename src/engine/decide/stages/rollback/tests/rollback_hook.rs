//! The rollback hook as the first rung: where it is called, and what follows if it does not stop the arm.

use holdpoint_governance::evidence::{DrillKind, DrillTallies, DrillTally};
use holdpoint_governance::outcome::{Assessment, Basis, RecoveryOutcome};
use holdpoint_governance::recovery::{DrillContrast, RecoveryAssessment};
use holdpoint_runtime::recovery::ROLLBACK_HOOK_TICKS;

use super::*;

use crate::quick_folder::quick_folder;

/// Drills without a failure that pass, by the shipped profiles.
const CLEAN_DRILLS: u32 = 114;

/// Gives a version the evidence of its rollback drills, of which it alone failed some.
fn rehearse(bench: &mut RollbackBench, id: &CapabilityId, failed_alone: u32) {
    let contrast = DrillContrast {
        kind: DrillKind::Rollback,
        paired: CLEAN_DRILLS,
        candidate_failed: failed_alone,
        active_failed: 0,
        alone: 0,
        alone_failed: 0,
    };
    let assessment = Assessment {
        outcome: RecoveryOutcome::Compatible,
        kappa: None,
        basis: Basis::Measured,
        reasons: Vec::new(),
        conditions: Vec::new(),
    };
    let rollback =
        DrillTally { passed: CLEAN_DRILLS - failed_alone, failed: failed_alone, ..DrillTally::default() };
    let own = DrillTallies { rollback, ..DrillTallies::default() };
    let live = bench.pipeline.live();
    let file = live.evidence_files.edit(id);
    file.drills = Some((own, DrillTallies::default()));
    file.recovery = Some(RecoveryAssessment {
        assessment,
        rho_candidate: None,
        rho_active: None,
        rates: Vec::new(),
        interval: None,
        kinds: Vec::new(),
        phases: Vec::new(),
        settled: vec![contrast],
        ended: None,
    });
}

fn hooks(record: &RollbackRecord) -> Vec<(Rung, Option<RungFailure>)> {
    let of_hook = |rung: &&RungRecord| matches!(rung.rung, Rung::RollbackHook | Rung::SafeAbort);
    record.rungs.iter().filter(of_hook).map(|rung| (rung.rung, rung.failure)).collect()
}

#[test]
fn a_rehearsed_rollback_hook_is_the_first_rung() {
    let (mut bench, id) = RollbackBench::resting_with_active("align-improved");
    rehearse(&mut bench, &id, 0);
    let record = bench.by_operator(&id);
    assert_eq!(hooks(&record), [(Rung::RollbackHook, None)]);
    assert_eq!(record.rungs[1].text, Notice::HookStopped.into());
    bench.assert_restored(&record);
}

#[test]
fn a_rollback_hook_that_failed_its_drills_is_not_called() {
    for failed_alone in [1, CLEAN_DRILLS] {
        let (mut bench, id) = RollbackBench::resting_with_active("align-improved");
        rehearse(&mut bench, &id, failed_alone);
        let record = bench.by_operator(&id);
        assert_eq!(hooks(&record), [(Rung::SafeAbort, None)], "{failed_alone}");
        bench.assert_restored(&record);
    }
}

#[test]
fn a_rollback_hook_that_never_ends_is_given_up_for_the_safe_abort_hook() {
    let folder = quick_folder();
    let shipped = Path::new(crate::MANIFESTS).join("candidates/align-improved");
    for entry in std::fs::read_dir(shipped).unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        let text = text.replace("rollback = \"handover\"", "rollback = \"none\"");
        std::fs::write(folder.path().join(path.file_name().unwrap()), text).unwrap();
    }
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = bench.activate_package(capability::read(folder.path()).unwrap(), &[]);
    rehearse(&mut bench, &id, 0);
    let record = bench.by_operator(&id);
    let expected = [(Rung::RollbackHook, Some(RungFailure::HookFailed)), (Rung::SafeAbort, None)];
    assert_eq!(hooks(&record), expected);
    assert_eq!(record.rungs[1].ticks, ROLLBACK_HOOK_TICKS);
    assert_eq!(record.rungs[1].text, Notice::RollbackHookDidNotStop.into());
    assert!(record.time_to_safe_ticks.unwrap() >= ROLLBACK_HOOK_TICKS);
    bench.assert_restored(&record);
}

#[test]
fn no_rollback_hook_after_a_safety_event() {
    let (mut bench, id) = RollbackBench::with_active("align-low-transit");
    rehearse(&mut bench, &id, 0);
    for _ in 0..40 {
        assert_eq!(bench.pipeline.advance(), SliceOutcome::Ran);
        if bench.pipeline.live().monitors.iter().next().is_none() {
            break;
        }
    }
    let record = bench.record();
    assert_eq!(record.trigger.kind, TriggerKind::SafetyEvent);
    assert!(hooks(&record).is_empty(), "{:?}", record.rungs);
}
