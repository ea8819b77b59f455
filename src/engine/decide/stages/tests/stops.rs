//! Stops by several accounts: what each is answered, and how many are counted.

use std::sync::Arc;
use std::time::{Duration, Instant};

use holdpoint_governance::lifecycle::State;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::command::{Caller, Command, Refusal, Reply, StopPersistence};
use holdpoint_protocol::event::EventKind;
use holdpoint_store::{AuditFilter, Layout};
use holdpoint_wording::command_effect::stop_effect;

use super::state_verb_table::done;

use crate::decide::stages::rollback::tests::RollbackBench;
use crate::live::stop_mark::OwnStopMark;
use crate::live::stop_switch::StopRequest;
use crate::quick_folder::quick_folder;
use crate::test_pipeline::resting_pipeline;

const fn process(uid: u32) -> Caller {
    Caller::Process { uid, user: None, process: Some(5) }
}

fn stop(bench: &mut RollbackBench, id: &str, uid: u32, by: &str) -> String {
    let (by, caller) = (by.to_owned(), process(uid));
    let request = StopRequest { id: id.to_owned(), by, reason: String::new(), caller };
    match bench.pipeline.halt(request) {
        Reply::Stopped { text, .. } => text,
        other => panic!("{other:?}"),
    }
}

/// The answer to a stop contained the name that another account had stated: `the cell is stopped, by …; start it now`.
#[test]
fn the_answer_to_a_stop_contains_no_text_of_another_account() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let first = stop(&mut bench, "1", 61_008, "ana; the fence is closed");
    let second = stop(&mut bench, "2", 61_009, "bert");
    assert_eq!(first, stop_effect(None, StopPersistence::OnRecord, None, 0));
    assert_eq!(second, stop_effect(Some(&process(61_008)), StopPersistence::OnRecord, None, 0));
}

/// An observer wrote 360 records in 8 s, and no person could follow the number of stops that `start` asks for.
#[test]
fn stops_of_one_account_without_end_are_recorded_as_a_sum() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    for nth in 0..100 {
        stop(&mut bench, &nth.to_string(), 61_008, "ana");
    }
    let last = stop(&mut bench, "last", 61_008, "ana");
    let stopped = bench.pipeline.snapshot().stopped.unwrap();
    assert_eq!(last, stop_effect(None, StopPersistence::OnRecord, None, 101 - stopped.stops));
    assert!(stopped.stops < 20, "{}", stopped.stops);
    let (by, reason) = ("ben".to_owned(), "empty".to_owned());
    done(&mut bench, Command::Go { by, reason, since_ms: stopped.since_ms, stops: stopped.stops });
    let records = |kind| {
        let filter = AuditFilter { kind: Some(kind), ..AuditFilter::default() };
        bench.pipeline.record().version_table().store().views().unwrap().audit(&filter).unwrap()
    };
    assert_eq!(records(RecordKind::CellStopped).len() as u64, stopped.stops);
    let released: serde_json::Value =
        serde_json::from_str(&records(RecordKind::CellReleased).pop().unwrap().body).unwrap();
    assert_eq!(released["summed_stops"]["61008"], 101 - stopped.stops, "{released}");
}

/// Regression: a sequence that had ended before a stop was recorded after it, as if the arm had worked on.
#[test]
fn a_sequence_that_ended_before_a_stop_is_recorded_before_it() {
    for through_engine in [true, false] {
        let mut bench = RollbackBench::new();
        let pipeline = &mut bench.pipeline;
        pipeline.live().record.set_clock(Clock::real(0));
        pipeline.pace_live_world(None, Arc::new(|_| {}));
        let until = Instant::now() + Duration::from_mins(1);
        while !pipeline.live().world.is_running() {
            assert!(Instant::now() < until, "no sequence begins");
            pipeline.advance();
        }
        while !pipeline.live().world.thread.as_ref().unwrap().has_ended() {
            assert!(Instant::now() < until, "the sequence does not end");
            std::thread::yield_now();
        }
        pipeline.drain_events();
        if through_engine {
            stop(&mut bench, "1", 61_008, "ana");
        } else {
            let (id, by, caller) = ("1".to_owned(), "ana".to_owned(), process(61_008));
            let switch = bench.pipeline.live().world.switch();
            switch.halt(StopRequest { id, by, reason: String::new(), caller });
            bench.pipeline.advance();
        }
        let events = bench.pipeline.drain_events();
        let place = |wanted: fn(&EventKind) -> bool| events.iter().position(wanted);
        let worked = place(|event| matches!(event, EventKind::Sequence { .. }));
        let stopped = place(|event| matches!(event, EventKind::CellStopped { .. }));
        assert!(worked.is_some() && worked < stopped, "{through_engine}: {events:?}");
        bench.pipeline.end();
    }
}

/// Without a socket no watch takes a stop that waits behind another one: it was not recorded, and no start was possible.
#[test]
fn a_waiting_stop_is_recorded_by_an_engine_without_a_socket() {
    let folder = quick_folder();
    drop(resting_pipeline(folder.path(), ProfileName::Sim));
    let _waits = OwnStopMark::put_behind(&Layout::new(folder.path()), "1", "ben", "").unwrap();
    let mut pipeline = resting_pipeline(folder.path(), ProfileName::Sim);
    let stopped = pipeline.snapshot().stopped.unwrap();
    assert_eq!((stopped.by.as_str(), stopped.stops), ("ben", 1));
    let (by, reason) = ("ben".to_owned(), "empty".to_owned());
    let reply = pipeline.command(Command::Go { by, reason, since_ms: stopped.since_ms, stops: 1 });
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
}

/// Each mark refused a start of its own.
#[test]
fn one_answer_counts_all_marks_and_one_start_releases_them() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    stop(&mut bench, "first", 61_008, "ana");
    let layout = Layout::new(bench.folder());
    let first = OwnStopMark::put(&layout, "1", "ben", "").unwrap();
    let behind = ["cy", "dora"].map(|by| OwnStopMark::put_behind(&layout, by, by, "").unwrap());
    let since_ms = bench.pipeline.snapshot().stopped.unwrap().since_ms;
    let go = |bench: &mut RollbackBench, stops| {
        let (by, reason) = ("ben".to_owned(), "empty".to_owned());
        bench.pipeline.command(Command::Go { by, reason, since_ms, stops })
    };
    assert!(matches!(go(&mut bench, 1), Reply::Refused { code: Refusal::NotNow, .. }));
    let stopped = bench.pipeline.snapshot().stopped.unwrap();
    let mut by: Vec<&str> = stopped.again.iter().map(|stop| stop.by.as_str()).collect();
    by.sort_unstable();
    assert_eq!((stopped.stops, by), (4, vec!["ben", "cy", "dora"]));
    assert!(first.is_removed() && behind.iter().all(OwnStopMark::is_removed), "they are on record");
    assert!(matches!(go(&mut bench, stopped.stops), Reply::Accepted { .. }));
}

/// Anyone may stop the cell, and some stops in a window ended an honest version for good.
#[test]
fn interventions_of_people_alone_demote_a_version() {
    let (mut bench, id) = RollbackBench::with_active("align-improved");
    for _ in 0..100 {
        bench.pipeline.live().stepped_in(&id).unwrap();
        let state = bench.pipeline.record().version_table().version(&id).unwrap().1.state;
        if state != State::Active {
            assert_eq!(state, State::Demoted);
            return;
        }
    }
    panic!("the rate of interventions rose, and {id} is active");
}
