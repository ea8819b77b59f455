//! The texts of the list of what waits for the operator.

#[must_use]
pub fn no_version_works(key: &str) -> String {
    format!("no version works until one is reactivated ({key})")
}

#[must_use]
pub fn or_rolled_back(left: &str, why: &str) -> String {
    format!("or it is rolled back in {left}: {why}")
}

#[must_use]
pub fn waits_for_you(count: usize) -> String {
    format!("Waits for you ({count})")
}

#[must_use]
pub fn for_others(count: usize) -> String {
    format!(", for others ({count})")
}

#[must_use]
pub fn others(count: usize, kinds: &str) -> String {
    format!("and {count} more: {kinds}")
}

#[must_use]
pub fn review_until(until: &str, overdue: bool) -> String {
    let then = if overdue { "" } else { ", then it is demoted" };
    format!("until {until}{then}; one person activated it")
}
