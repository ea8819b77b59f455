//! The texts of the list of what waits for people.

use holdpoint_governance::ids::CapabilityId;

use crate::counted;

pub const HELP: &str = "Approvals that wait";
pub const TOUR: &str = "What waits for a person: enter opens it, and never approves";
pub const ORDER_OF_DEADLINES: &str = "what waits stands in the order of its deadlines";
pub const NOTHING_WAITS: &str = "nothing waits for people";
pub const CANDIDATE_GONE: &str = "the candidate is gone";
pub const WAITS_FOR_PEOPLE: &str = "Waits for people";
pub const NOTHING_WAITS_FOR_A_PERSON: &str = "Nothing waits for a person";

#[must_use]
pub fn opens_the_decision(key: &str) -> String {
    format!("{key} opens the whole decision; it approves nothing")
}

#[must_use]
pub fn more_lines(lines: usize) -> String {
    format!("{} in the prompt", counted(lines, "more line"))
}

#[must_use]
pub fn act_here_and_there(key: &str, action: &str) -> String {
    format!("; {key}: {action}, here and there")
}

#[must_use]
pub fn opens_its_card(key: &str, act: &str) -> String {
    format!("{key} opens its card{act}")
}

#[must_use]
pub fn monitor_asks(version: &CapabilityId) -> String {
    format!("The monitor of {version} cannot decide by itself and asks a person")
}

#[must_use]
pub fn no_answer_by(by: &str, left: &str) -> String {
    format!("No answer by {by}, in {left}: it is rolled back")
}

#[must_use]
pub fn monitor_keys(carry_on: &str, release: &str, roll_back: &str, tighten: &str) -> String {
    format!(
        "{carry_on} continues, {release} releases it if it is restricted, {roll_back} rolls it back, \
         {tighten} tightens its envelope; each asks for a reason"
    )
}
