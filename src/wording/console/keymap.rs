//! What is wrong with a file of keys, and a heading of their table.

/// The heading of the effects of the actions.
pub const EFFECT_COLUMN: &str = "what it does";

#[must_use]
pub fn not_bound(key: &str) -> String {
    format!("the key {key:?} is not bound")
}

#[must_use]
pub fn no_such_action(name: &str) -> String {
    format!("there is no action {name:?}; `holdpoint keys` lists them")
}

#[must_use]
pub fn no_key_left(action: &str) -> String {
    format!("{action:?} has no key left; it needs one")
}

#[must_use]
pub fn never_decides(key: &str, action: &str) -> String {
    format!("the key {key:?} cannot {action}: Enter, Space, Esc, Tab and keys that move never decide")
}

#[must_use]
pub fn stops_the_cell(key: &str) -> String {
    format!("the key {key:?} stops the cell, in whatever is open, and is given to nothing else")
}

#[must_use]
pub fn would_not_stop(key: &str, action: &str) -> String {
    format!("the key {key:?} means {action:?} in a question and would not stop the cell there")
}

#[must_use]
pub fn means_already(key: &str, action: &str) -> String {
    format!("the key {key:?} means {action:?} already; take it away first: unbind = [{key:?}]")
}

#[must_use]
pub fn no_key(text: &str) -> String {
    format!("{text:?} is no key; for instance q, Q, ctrl-s, pageup and f1 are")
}
