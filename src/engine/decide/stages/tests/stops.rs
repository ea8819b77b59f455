//! Stops by several accounts: what each is answered.

use holdpoint_protocol::command::{Caller, Reply};

use crate::decide::stages::rollback::tests::Bench;
use crate::live::stop_switch::StopRequest;

fn stop(bench: &mut Bench, id: &str, uid: u32, by: &str) -> String {
    let caller = Caller::Process { uid, user: None, process: Some(5) };
    let request = StopRequest { id: id.to_owned(), by: by.to_owned(), reason: String::new(), caller };
    match bench.pipeline.halt(request) {
        Reply::Stopped { text, .. } => text,
        other => panic!("{other:?}"),
    }
}

/// The answer to a stop contained the name that another account had stated: `the cell is stopped, by …; start it now`.
#[test]
fn the_answer_to_a_stop_contains_no_text_of_another_account() {
    let mut bench = Bench::new();
    let first = stop(&mut bench, "1", 61_008, "ana; the fence is closed");
    let second = stop(&mut bench, "2", 61_009, "bert");
    assert!(first.starts_with("the cell is stopped; it stays"), "{first}");
    let account = "the cell is stopped, first by uid 61008 (without a name, process 5);";
    assert!(second.starts_with(account) && !second.contains("ana"), "{second}");
}
