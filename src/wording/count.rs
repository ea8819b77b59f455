//! A count with its noun and its verb.

use std::fmt::Display;

/// A count with its noun, which is given in the singular.
#[must_use]
pub fn counted(count: impl Copy + Display + TryInto<u64>, noun: &str) -> String {
    let ending = match (is_one(count), noun.ends_with("ch")) {
        (true, _) => "",
        (false, true) => "es",
        (false, false) => "s",
    };
    format!("{count} {noun}{ending}")
}

/// The verb to a count.
pub(crate) fn is_or_are(count: impl TryInto<u64>) -> &'static str {
    if is_one(count) { "is" } else { "are" }
}

fn is_one(count: impl TryInto<u64>) -> bool {
    matches!(count.try_into(), Ok(1))
}
