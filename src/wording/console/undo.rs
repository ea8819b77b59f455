//! What the undo key says.

pub const NOTHING: &str = "no shelving, hold, mark or goal of this console is left to undo";
pub const RESULT_NOT_SHOWN: &str = "the engine has not shown its result yet: wait a moment";

#[must_use]
pub fn not_answered_yet(what: &str) -> String {
    format!("{what}: the engine has not answered yet, so nothing is undone")
}

#[must_use]
pub fn acknowledgment_has_no_reverse(alarm: &str) -> String {
    format!("{alarm}: an acknowledgment records that you saw the alarm, and has no reverse")
}

#[must_use]
pub fn not_marked_any_more(name: &str) -> String {
    format!("undone: {name} is not marked any more")
}

#[must_use]
pub fn shelved_by_another(alarm: &str, by: &str) -> String {
    format!("{alarm} is shelved by {by} now")
}

#[must_use]
pub fn unshelve_asked(alarm: &str) -> String {
    format!("undo: unshelve {alarm}: asked")
}

#[must_use]
pub fn goal_has_changed(now: &str, set: &str, before: &str) -> String {
    format!("the goal is {now} now, and no longer {set}; `:goal {before}` sets the one before it")
}

#[must_use]
pub fn not_undone(why: &str) -> String {
    format!("not undone: {why}")
}
