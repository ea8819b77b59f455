//! What the console says about requests to the engine.

pub const SUBMIT_THE_NEXT: &str = "submit the next demonstration candidate";
pub const STOP_REQUESTED: &str = "STOP: the stop is requested";
pub const STOP_ASKED_ELSEWHERE: &str = "STOP: the running engine is being asked";
pub const STOP_THE_CELL: &str = "stop the cell";
pub const STOP_SENT_AGAIN: &str = "STOP: the engine answers again; your stop failed and is sent again";
pub const CHECKING_THE_CHAIN: &str = "checking the audit chain";
pub const CHECK_THE_CHAIN: &str = "check the audit chain";

#[must_use]
pub fn too_many_wait(most: usize) -> String {
    format!("{most} requests wait for the engine already")
}
