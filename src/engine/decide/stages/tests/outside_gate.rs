//! What makes a version active, or opens a profile to it, beside the gate: not while the cell is stopped, and not by whom it
//! concerns.

use holdpoint_approvals::keyfile::KeyEncoding;
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::{Caller, Command, Operation, Refusal, Reply};

use super::state_verb_table::{CANDIDATE, done, operation};
use crate::decide::people::persons::enrolled;
use crate::decide::people::signers::tests::signed;
use crate::decide::stages::activation::tests::{package, request_activation};
use crate::decide::stages::rollback::tests::RollbackBench;
use crate::live::stop_mark::OwnStopMark;
use crate::live::stop_switch::StopRequest;
use crate::quick_folder::quick_folder;
use crate::test_pipeline::resting_pipeline;
use crate::tests::at_the_gate;

/// Regression: a version became active during a person's stop, and the start of the cell did not report it.
#[test]
fn stopped_cell_activates_no_version_outside_the_gate() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = request_activation(&mut bench.pipeline, package(CANDIDATE, &[]));
    let dora = enrolled(bench.pipeline.live().record, "dora", Role::Safety, KeyEncoding::Plain);
    let family = "grasp@1.0.0".parse().unwrap();
    done(&mut bench, Command::Vacate(operation(&family)));
    let (by, reason) = ("ben".to_owned(), "a hand is in the cell".to_owned());
    let caller = Caller::Script;
    let stop = StopRequest { id: "1".to_owned(), by: by.clone(), reason: reason.clone(), caller };
    assert!(matches!(bench.pipeline.halt(stop), Reply::Stopped { .. }));
    let request =
        bench.pipeline.snapshot().emergencies.into_iter().find(|request| request.version == id).unwrap();
    let signed = signed(&mut bench.pipeline, &request, &dora, ApprovalDecision::Approve).unwrap();
    for command in [Command::Rearm(operation(&family)), signed] {
        let reply = bench.pipeline.command(command);
        assert!(matches!(reply, Reply::Refused { code: Refusal::NotNow, hint: Some(_), .. }), "{reply:?}");
    }
    // A repeated mark of the same stop does not prevent a start of the cell.
    let layout = bench.pipeline.record().version_table().store().layout().clone();
    let _mark = OwnStopMark::put(&layout, "1", &by, &reason).unwrap();
    let since_ms = bench.pipeline.snapshot().stopped.unwrap().since_ms;
    let go = |by: &str| Command::Go { by: by.to_owned(), reason: "empty".to_owned(), since_ms, stops: 1 };
    let other = OwnStopMark::put(&layout, "2", "cy", "");
    assert!(other.is_err(), "one mark lies there at a time");
    done(&mut bench, go("ben"));
    done(&mut bench, Command::Rearm(operation(&family)));
}

/// Its requester opened the profile again that a safety officer had closed.
#[test]
fn a_requester_unblocks_no_profile() {
    let folder = quick_folder();
    let mut pipeline = resting_pipeline(folder.path(), ProfileName::Sim);
    let id = at_the_gate(&mut pipeline);
    let of = |by: &str| Operation { by: by.to_owned(), ..operation(&id) };
    let human = vec![ProfileName::Human];
    let closed = pipeline.command(Command::Demote { operation: of("sam"), profiles: human.clone() });
    assert!(matches!(closed, Reply::Accepted { .. }), "{closed:?}");
    let own = pipeline.command(Command::Release { operation: of("rita"), profiles: human.clone() });
    assert!(matches!(&own, Reply::Refused { code: Refusal::NotAllowed, .. }), "{own:?}");
    let opened = pipeline.command(Command::Release { operation: of("sam"), profiles: human });
    assert!(matches!(opened, Reply::Accepted { .. }), "{opened:?}");
}
