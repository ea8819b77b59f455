//! What is wrong with a theme.

use std::fmt::Display;

pub const THEME_LIST: &str = "`holdpoint theme list`";
pub const NEEDS_FOREGROUND: &str = "bg: a background needs a foreground with it; add fg";

#[must_use]
pub fn no_builtin(name: &str, allowed: &str) -> String {
    format!("inherits: there is no built-in theme {name:?}; allowed are {allowed}")
}

#[must_use]
pub fn no_such_role(name: &str, allowed: &str) -> String {
    format!("there is no role {name:?}; allowed are {allowed}")
}

#[must_use]
pub fn no_color(key: &str, shown: &str, names: &str) -> String {
    format!("{key}: {shown} is no color; allowed are default, 0 to 255, \"#rrggbb\" and {names}")
}

#[must_use]
pub fn no_such_theme(name: &str, allowed: &str) -> String {
    format!("there is no theme {name:?}; allowed are {allowed}")
}

#[must_use]
pub fn one_too_many(name: &str, allowed: impl Display) -> String {
    format!("the theme {name:?} is one too many; at most {allowed} files are allowed")
}
