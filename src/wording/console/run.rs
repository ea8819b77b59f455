//! The last line of a console, and why it could not run.

use std::fmt::Display;

pub const DID_NOT_END_IN_TIME: &str = "the engine did not end in time; the next start recovers its work";
pub const CONSOLE_FAILED: &str = "the console failed; the engine was left halted";
pub const PLAIN_NEEDS_NONE: &str = "`holdpoint run --plain` needs none";
pub const THREAD_GONE: &str = "its thread is gone";
pub const NO_ENGINE_ON_THIS_STORE: &str = "no engine runs on this store";

#[must_use]
pub fn did_not_come_up(why: impl Display) -> String {
    format!("the engine did not come up: {why}")
}

#[must_use]
pub fn ended_with_a_fault(why: impl Display) -> String {
    format!("the engine ended with a fault: {why}")
}

#[must_use]
pub fn left_running(attach: &str, stop: &str) -> String {
    format!("left the engine running; {attach} attaches to it again, {stop} stops its arm")
}

#[must_use]
pub fn ends_alone_after(secs: u64) -> String {
    format!("; without a console, it ends after {secs} s")
}

#[must_use]
pub fn request_failed(why: &str) -> String {
    format!("; the request to keep it running FAILED: {why}")
}

#[must_use]
pub fn still_shutting_down(status: &str) -> String {
    format!("the engine is still shutting down; {status} shows when the store is free")
}

#[must_use]
pub fn engine_is_gone(why: impl Display) -> String {
    format!("the engine that this console was at is gone: {why}")
}

#[must_use]
pub fn stage_runs_again(candidates: &str, stage: &str) -> String {
    format!("{candidates} in {stage}: that stage is run again at the next start")
}

#[must_use]
pub fn held_for_approval(candidates: &str) -> String {
    format!("{candidates} held for approval; approvers are asked again")
}

#[must_use]
pub fn provisional(candidates: &str) -> String {
    format!("{candidates} provisional, monitored again from the next start")
}

#[must_use]
pub fn no_thread(error: impl Display) -> String {
    format!("cannot start a thread: {error}")
}

#[must_use]
pub fn log_begins(process: u32, unix_secs: u64) -> String {
    format!("console begins, process {process}, Unix time {unix_secs}")
}
