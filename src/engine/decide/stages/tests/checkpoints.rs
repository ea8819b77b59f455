//! A checkpoint that cannot be written raises an alarm, and the store continues.

use std::fs;

use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::profile::ProfileName;

use crate::decide::stages::rollback::tests::RollbackBench;

#[test]
fn unwritable_checkpoint_raises_an_alarm_until_one_is_written() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let folder = bench.pipeline.record().version_table().store().layout().checkpoints();
    let aside = folder.with_extension("aside");
    let condition = |bench: &RollbackBench| {
        bench.pipeline.record().alarms().get(&AlarmKey::CheckpointFailed).map(|alarm| alarm.condition)
    };
    bench.pipeline.advance();
    assert_eq!(condition(&bench), None);
    fs::rename(&folder, &aside).unwrap();
    // Every activation makes a checkpoint.
    let first = bench.activate("align-improved");
    bench.pipeline.advance();
    assert_eq!(condition(&bench), Some(true));
    assert!(
        bench.pipeline.record().version_table().version(&first).is_ok()
            && bench.pipeline.record().holding().is_none()
    );
    fs::rename(&aside, &folder).unwrap();
    bench.activate("grasp-improved");
    bench.pipeline.advance();
    assert_ne!(condition(&bench), Some(true));
}
