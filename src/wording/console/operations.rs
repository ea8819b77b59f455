//! The sentences of operations on versions and alarms: consequences, refusals, and what ending the program does.

use std::fmt::Display;

use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::profile::ProfileName;

pub const NOTHING_TO_ABORT: &str = "nothing to abort is running; B rolls an active version back";
pub const REGISTERED_AND_EVALUATED: &str =
    "It is registered and evaluated beside the active version; it acts only after its gate";
pub const ALARM_NORMAL_AGAIN: &str = "the alarm is normal again";
pub const PAUSED_ACTIVE_KEEPS_THE_ARM: &str =
    "It keeps the arm, provisionally, and is monitored; it is not confirmed until it is resumed";
pub const PAUSED_STAGE_STOPS: &str = "Its stage stops; only reject, demote and resume go through";
pub const PAUSED_REQUEST_ENDS: &str =
    "Its request for approval ends; once it is resumed and its turn comes, approvers are asked again";
pub const ONLY_UNPAUSED_CAN_BE_PAUSED: &str =
    "only a candidate or a provisional version that is not paused can be paused";
pub const RESUMED_ACTIVE_IS_CONFIRMED: &str = "It is confirmed once its window is over without a trip";
pub const RESUMED_CONTINUES: &str = "It continues from its state when its turn comes; this approves nothing";
pub const ONLY_PAUSED_OR_HELD_CAN_BE_RESUMED: &str = "only what is paused or on hold can be resumed";
pub const NEVER_COMES_BACK: &str = "It never comes back under this version";
pub const ONLY_A_CANDIDATE_CAN_BE_REJECTED: &str = "only a candidate can be rejected";
pub const NO_VERSION_WOULD_TAKE_OVER: &str = "no version would take over; B deactivates the last version";
pub const EVALUATED_BEFORE_IT_MAY_ACT: &str = "It is evaluated again before it may act";
pub const ONLY_A_CANDIDATE_OR_ACTIVE_CAN_BE_RETURNED: &str =
    "only a candidate or an active version can be returned";
pub const FAMILY_MUST_BE_REACTIVATED: &str = "An operator has to reactivate the family";
pub const ONLY_AN_ACTIVE_VERSION_CAN_BE_ROLLED_BACK: &str = "only an active version can be rolled back";
pub const RESTRICTED_UNTIL_SETTLED: &str = "Its speed and force are tightened until it is settled";
pub const ONLY_AN_UNRESTRICTED_ACTIVE_VERSION_CAN_BE_RESTRICTED: &str =
    "only an active version that is not restricted can be restricted";
pub const SANDBOX_RUNS_AGAIN: &str = "Its sandbox is run again; gate pass and approvals are void";
pub const ONLY_A_VERSION_AT_REST_IS_EVALUATED_AGAIN: &str =
    "only a sandboxed, shadowed or demoted version at rest is evaluated again";
pub const FULL_ENVELOPE_AGAIN: &str = "It gets its full envelope; its window and its charts start over";
pub const ONLY_A_RESTRICTED_VERSION_CAN_BE_RELEASED: &str = "only a restricted version can be released";
pub const MONITOR_QUESTION_CLOSED: &str = "The monitor's question is closed; its charts start over";
pub const MONITOR_ASKS_NOTHING: &str = "its monitor asks nothing";
pub const ONLY_A_SUPERSEDED_VERSION_CAN_BE_REACTIVATED: &str =
    "only a superseded version of a stopped family can be reactivated";
pub const COMPARED_WITH_THE_ANCHOR: &str = "Candidates are compared with it, too, from their next sandbox on";
pub const ONLY_A_VERSION_IN_CONTROL_CAN_BE_THE_ANCHOR: &str =
    "only a version that is or was in control can be the anchor";
pub const CLOCK_IS_TRUSTED: &str = "the machine's clock is trusted";
pub const COMPARE_THE_CLOCK: &str =
    "Compare it with another clock; approvals, freezes and reviews then end by it";
pub const NOTE_GOES_ON_RECORD: &str =
    "It goes on record, into the log, and into Health as a mark; it changes nothing else";
pub const GOAL_LEAVES_FAMILIES_OUT: &str =
    "A candidate of a family that the goal leaves out meets no task in shadow";
pub const DEMOTED_UNDER_THIS_PROFILE: &str = "It is active under this profile, so it is demoted";
pub const NOTHING_KNOWN_YET: &str = "nothing is known yet";
pub const GO_TO_THE_ALARMS: &str = "go to the alarms first (5, or ! for the highest)";
pub const HISTORY_CHANGES_NOTHING: &str = "the history changes nothing; tab leads to the open alarms";
pub const NO_ALARM_HERE: &str = "there is no alarm under the cursor";
pub const CRITICAL_STAYS_IN_SIGHT: &str = "a critical alarm stays in sight: it cannot be shelved";
pub const SHELVED_COMES_BACK: &str = "It comes back by itself; shelved alarms are counted on every screen";
pub const CONDITION_STILL_PRESENT: &str =
    "its condition is still present: acknowledge it, and reset it when it is gone";
pub const WAITS_FOR_NO_RESET: &str = "it does not wait for a reset";
pub const RESET_RESUMES_NOTHING: &str = "It resumes nothing; say why it is safe";
pub const ENGINE_IS_IN_THIS_CONSOLE: &str =
    "this engine runs in this console and ends with it; start without `--in-process` to leave it";
pub const ENGINE_IS_BEING_STARTED: &str = "the engine is being started: wait a moment";
pub const ENGINE_SHUTS_DOWN: &str = "The engine shuts down cleanly; this approves and activates nothing";
pub const LAST_CONSOLE: &str = "This is the last console; `:detach` leaves the engine running";

#[must_use]
pub fn nothing_is_signed(unverified: impl Display) -> String {
    format!("{unverified}: nothing is signed for it")
}

#[must_use]
pub fn would_be_something_else(title: &str) -> String {
    format!("it would now be something else: {title}")
}

#[must_use]
pub fn nothing_known_about(version: &CapabilityId) -> String {
    format!("nothing is known about {version} yet")
}

#[must_use]
pub fn is_paused_already(key: &str) -> String {
    format!("it is paused already, {key} resumes it")
}

#[must_use]
pub fn family_acts_again(family: &Family) -> String {
    format!("{family} acts again, under this version")
}

#[must_use]
pub fn is_not_about_a_version(action: &str) -> String {
    format!("{action:?} is not about a version")
}

#[must_use]
pub fn no_break_glass_for(version: &CapabilityId) -> String {
    format!("break-glass does not apply to {version}")
}

#[must_use]
pub fn clock_when_opened(mismatch: &str, time: &str) -> String {
    format!("{mismatch}; it said {time} when this was opened")
}

#[must_use]
pub fn goal_applies_next(goal: &str) -> String {
    format!("The goal is now {goal}; this one applies from the next sequence on")
}

#[must_use]
pub fn not_activated_under(profile: ProfileName) -> String {
    format!("Under {profile} it is not activated; its state does not change")
}

#[must_use]
pub fn gate_looks_again_under(profile: ProfileName) -> String {
    format!("Under {profile} the gate looks at it again")
}

#[must_use]
pub fn arm_stops_and_other_takes_over(back: &CapabilityId, consequence: &str) -> String {
    format!("The arm stops; {back} takes over. {consequence}")
}

#[must_use]
pub fn arm_stops_and_family_is_safe_stopped(family: &Family) -> String {
    format!("The arm stops; {family} is safe-stopped: there is no rollback target")
}

#[must_use]
pub fn not_active_any_more(version: &CapabilityId) -> String {
    format!("{version} is not active any more")
}

#[must_use]
pub fn rollback_target_changed(version: &CapabilityId) -> String {
    format!("the version that takes over from {version} has changed: look again")
}

#[must_use]
pub fn has_another_status(version: &CapabilityId, status: &str) -> String {
    format!("{version} is {status} by now: look again")
}

#[must_use]
pub fn paused_in_its_state(version: &CapabilityId) -> String {
    format!("{version} is paused in its state; active versions continue")
}

#[must_use]
pub fn results_are_void(version: &CapabilityId, active: &CapabilityId) -> String {
    format!("{version} was compared with {active}: its results are void, its sandbox has to run again")
}

#[must_use]
pub fn nothing_to_be_compared_with(version: &CapabilityId, family: &Family) -> String {
    format!("{version} waits: no version of {family} is active that it can be compared with")
}

#[must_use]
pub fn sandbox_may_run_again(version: &CapabilityId, family: &Family) -> String {
    format!("{version}: its sandbox has to run again if it works beside {family}")
}

#[must_use]
pub fn others_lose_the_engine(others: usize) -> String {
    format!("{others} more at this engine {} it", if others == 1 { "loses" } else { "lose" })
}

#[must_use]
pub fn stage_runs_again(version: &CapabilityId, stage: &str, done: u64, budget: u64) -> String {
    format!("{version} is in {stage} ({done} of {budget}): that stage is run again at the next start")
}

#[must_use]
pub fn approvers_are_asked_again(version: &CapabilityId) -> String {
    format!("{version} waits for approval: approvers are asked again")
}

#[must_use]
pub fn window_starts_over(version: &CapabilityId) -> String {
    format!("{version} is provisional: its window starts over")
}

#[must_use]
pub fn not_asked(title: &str, why: &str) -> String {
    format!("not asked: {title}: {why}")
}

#[must_use]
pub fn not_touched(version: &CapabilityId) -> String {
    format!("Not touched: {version}")
}
