//! The texts of forms: buttons, titles, answers to a cancelation, and why nothing is confirmed yet.

use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::profile::ProfileName;

pub const ABORT_ROLL_BACK: &str = "Abort: roll back";
pub const ABORT_STOP_THE_FAMILY: &str = "Abort: stop the family";
pub const DEACTIVATE_THE_LAST_VERSION: &str = "Deactivate the last version";
pub const BLOCK_UNDER_A_PROFILE: &str = "Block under a profile";
pub const UNBLOCK_UNDER_A_PROFILE: &str = "Unblock under a profile";
pub const RETURN_TO_EVALUATION: &str = "Return to evaluation";
pub const START_THE_CELL: &str = "Start the cell";
pub const START_THE_STOPPED_CELL: &str = "Start the stopped cell";
pub const LEAVE_A_NOTE: &str = "Leave a note for the next shift";
pub const SUBMIT_THE_NEXT: &str = "Submit the next demonstration candidate";
pub const NOT_ROLLED_BACK: &str = "not rolled back";
pub const NOT_EVALUATED_AGAIN: &str = "not evaluated again";
pub const MONITOR_NOT_ANSWERED: &str = "its monitor is not answered";
pub const ANCHOR_NOT_SET: &str = "anchor not set";
pub const CELL_STAYS_STOPPED: &str = "the cell stays stopped";
pub const GOAL_AS_IT_WAS: &str = "the goal is as it was";
pub const TIME_NOT_CONFIRMED: &str = "the time is not confirmed";
pub const NO_NOTE_LEFT: &str = "no note is left";
pub const NO_IDENTITY_MADE: &str = "no identity is made";
pub const ENGINE_KEEPS_RUNNING: &str = "the engine keeps running";
pub const READ_TO_THE_END: &str = "read the text above to its end first (pagedown)";
pub const TEXT_HAS_CHANGED: &str = "the text above has just changed: read it again";
pub const KEY_DID_NOTHING: &str = "that key did nothing: wait a moment, then press it again";
pub const REASON_NEEDED: &str = "a reason is needed, of characters that can be seen";
pub const OPERATION_HAS_CHANGED: &str = "the operation has just changed: Esc leads back, read it again";
pub const ABORTED_AT_THE_CONSOLE: &str = "aborted at the console";
pub const ABORT_PAUSE: &str = "Abort: pause";
pub const ROLL_BACK: &str = "Roll back";
pub const EVALUATE_AGAIN: &str = "Evaluate again";
pub const SET_ANCHOR: &str = "Set anchor";
pub const SET_GOAL: &str = "Set goal";
pub const CONFIRM_IT: &str = "Confirm it";
pub const LEAVE_IT: &str = "Leave it";
pub const MAKE_IT: &str = "Make it";
pub const END_HOLDPOINT: &str = "End Holdpoint";
pub const NOT_DEACTIVATED: &str = "not deactivated";
pub const NOT_PAUSED: &str = "not paused";
pub const NOT_RELEASED: &str = "not released";
pub const NOT_BLOCKED: &str = "not blocked";
pub const NOT_UNBLOCKED: &str = "not unblocked";
pub const NOT_RESUMED: &str = "not resumed";
pub const NOT_REJECTED: &str = "not rejected";
pub const NOT_RETURNED: &str = "not returned";
pub const NOT_RESTRICTED: &str = "not restricted";
pub const NOT_REACTIVATED: &str = "not reactivated";
pub const NOT_SHELVED: &str = "not shelved";
pub const NOT_RESET: &str = "not reset";
pub const NOT_SUBMITTED: &str = "not submitted";
pub const ONLY_THIS_KEY_CLOSES: &str =
    " closes this, a moment after the last key; other keys do nothing here";
pub const BACK_TO_THE_FORM: &str = " back to the form";
pub const DOES_IT_IN_A_MOMENT: &str = " does it in a moment";
pub const LEAVES_AS_IT_IS: &str = " leaves everything as it is";
pub const TYPE_THE_PASSPHRASE: &str = "type the passphrase first, or Esc";

#[must_use]
pub fn abort_active(version: &CapabilityId) -> String {
    format!("Abort {version}: roll it back")
}

#[must_use]
pub fn abort_last(version: &CapabilityId, family: &Family) -> String {
    format!("Abort {version}: stop the family {family}")
}

#[must_use]
pub fn abort_candidate(version: &CapabilityId) -> String {
    format!("Abort {version}: pause it")
}

#[must_use]
pub fn roll_back(version: &CapabilityId) -> String {
    format!("Roll {version} back")
}

#[must_use]
pub fn deactivate(version: &CapabilityId) -> String {
    format!("Deactivate {version}: no version follows")
}

#[must_use]
pub fn evaluate_again(version: &CapabilityId) -> String {
    format!("Evaluate {version} again")
}

#[must_use]
pub fn lift_restriction(version: &CapabilityId) -> String {
    format!("Lift the restriction of {version}")
}

#[must_use]
pub fn block(version: &CapabilityId, profile: ProfileName) -> String {
    format!("Block {version} under the profile {profile}")
}

#[must_use]
pub fn unblock(version: &CapabilityId, profile: ProfileName) -> String {
    format!("Unblock {version} under the profile {profile}")
}

#[must_use]
pub fn reject_finally(version: &CapabilityId) -> String {
    format!("Reject {version} finally")
}

#[must_use]
pub fn return_to_evaluation(version: &CapabilityId) -> String {
    format!("Return {version} to evaluation")
}

#[must_use]
pub fn continue_with(version: &CapabilityId) -> String {
    format!("Continue with {version}: answer its monitor")
}

#[must_use]
pub fn make_anchor(version: &CapabilityId, family: &Family) -> String {
    format!("Make {version} the anchor of {family}")
}

#[must_use]
pub fn set_goal(goal: &str) -> String {
    format!("Set the goal {goal}")
}

#[must_use]
pub fn confirm_time(time: &str) -> String {
    format!("Confirm the time: {time}")
}

#[must_use]
pub fn make_identity(name: &str) -> String {
    format!("Make the identity {name}")
}

#[must_use]
pub fn not_asked_any_more(glyph: &str, why: &str) -> String {
    format!("{glyph} NOT ASKED, and no longer possible: {why}")
}

#[must_use]
pub fn in_a_moment(glyph: &str, button: &str) -> String {
    format!("{glyph}({button}, in a moment)")
}

#[must_use]
pub fn minutes_not_allowed(typed: &str, most: u64) -> String {
    format!("{typed:?} is not allowed; 1 to {most} minutes are")
}
