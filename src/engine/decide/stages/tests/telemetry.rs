//! Telemetry at the end of a session and at the start of the next, and who may take it from the monitors.

use holdpoint_body::disturbance::LiveFault;
use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::command::{Command, Refusal, Reply};
use holdpoint_registry::verify;
use holdpoint_store::Batch;

use crate::decide::stages::rollback::tests::RollbackBench;
use crate::quick_folder::quick_folder;
use crate::test_pipeline::resting_pipeline;

/// An orderly end writes the digest of the last telemetry; the next session reports telemetry removed meanwhile.
#[test]
fn telemetry_lost_between_engines_alarms() {
    let folder = quick_folder();
    let store = folder.path().join("store");
    let first = resting_pipeline(&store, ProfileName::Sim);
    let version = "grasp@1.0.0".parse().unwrap();
    let to_ms = first.record().now_ms();
    let body = b"what was measured".to_vec();
    let batch = Batch { version, stream: "live".into(), from_ms: to_ms, to_ms, rows: 1, body };
    first.record().version_table().store().append_telemetry(&batch).unwrap();
    drop(first);
    let database = store.join("holdpoint.db");
    assert_eq!(verify(&database, None).unwrap().batches, 1);

    std::fs::remove_file(store.join("telemetry.db")).unwrap();
    assert!(verify(&database, None).is_err());
    let second = resting_pipeline(&store, ProfileName::Sim);
    let alarm = second.record().alarms().get(&AlarmKey::TelemetryMissed).expect("an alarm is raised");
    assert_eq!(alarm.text, Notice::TelemetryMissing { batches: 1 }.into());
    drop(second);
    let report = verify(&database, None).unwrap();
    assert_eq!((report.batches, report.batches_missed), (0, 1));
    let third = resting_pipeline(&store, ProfileName::Sim);
    assert_eq!(third.record().version_table().store().opening().telemetry.missing, 0);
}

/// Whatever is in the place of telemetry, the engine starts, raises an alarm and records it.
#[test]
fn foreign_telemetry_is_quarantined_with_an_alarm() {
    let folder = quick_folder();
    let store = folder.path().join("store");
    drop(resting_pipeline(&store, ProfileName::Sim));
    let telemetry = rusqlite::Connection::open(store.join("telemetry.db")).unwrap();
    telemetry.execute_batch("CREATE TRIGGER x AFTER INSERT ON batch BEGIN DELETE FROM batch; END").unwrap();
    drop(telemetry);
    let second = resting_pipeline(&store, ProfileName::Sim);
    let alarm = second.record().alarms().get(&AlarmKey::TelemetryMissed).expect("an alarm is raised");
    let Some(Notice::TelemetryQuarantined { file, problem, .. }) = alarm.text.notice() else {
        panic!("{alarm:?}");
    };
    assert!(problem.contains("\"x\"") && file == "telemetry-aside-1.db", "{alarm:?}");
    drop(second);
    assert!(store.join("telemetry-aside-1.db").is_file());
    verify(&store.join("holdpoint.db"), None).unwrap();
    let third = resting_pipeline(&store, ProfileName::Sim);
    assert_eq!(third.record().version_table().store().opening().telemetry.aside, []);
}

/// One person could blind the monitors of a confirmed version for as long as the engine ran.
#[test]
fn no_exercise_takes_telemetry_from_the_monitors_of_a_cell_at_risk() {
    for (profile, is_refused) in
        [(ProfileName::Sim, false), (ProfileName::Real, true), (ProfileName::Human, true)]
    {
        let mut bench = RollbackBench::resting(profile);
        let now_ms = bench.pipeline.record().now_ms();
        bench.pipeline.live().record.set_clock(Clock::real(now_ms));
        let reply = bench.pipeline.command(Command::LiveFault { fault: Some(LiveFault::TelemetryLost) });
        let refused = matches!(reply, Reply::Refused { code: Refusal::NotAllowed, .. });
        assert_eq!(refused, is_refused, "{profile}: {reply:?}");
        assert_eq!(bench.pipeline.live().world.cell.link_is_up(), is_refused, "{profile}");
    }
}
