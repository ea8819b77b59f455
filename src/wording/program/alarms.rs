//! What `alarms` and `status` print of alarms: a shelving, the advice of an open alarm, a list without alarms.

use holdpoint_governance::alarms::Shelving;
use holdpoint_text::Untrusted;

/// Its author, its end and its reason.
#[must_use]
pub fn shelving(shelf: &Shelving) -> String {
    let by = Untrusted::new(shelf.by.as_str());
    format!("shelved by {} until {}: {}", by.line(), shelf.until.label(), shelf.reason.line())
}

/// The shelving of an open alarm, what follows without an action, and what to look at first.
#[must_use]
pub fn open_alarm(shelf: Option<&Shelving>, consequence: &str, look_at: &str) -> String {
    let shelf = shelf.map_or_else(String::new, |shelf| format!("{}; ", shelving(shelf)));
    format!("{shelf}without action: {consequence}; look at: {look_at}")
}

/// A list of changes without an entry: since a moment or ever, of the whole history or of open alarms.
#[must_use]
pub const fn no_change(since: bool, history: bool) -> &'static str {
    match (since, history) {
        (true, true) => "no alarm changed since then",
        (true, false) => "no open alarm changed since then",
        (false, true) => NEVER_RAISED,
        (false, false) => "no alarm is open",
    }
}

/// A list of courses without an entry.
#[must_use]
pub const fn no_course(since: bool) -> &'static str {
    if since { "no alarm was open since then" } else { NEVER_RAISED }
}

const NEVER_RAISED: &str = "no alarm was ever raised";
