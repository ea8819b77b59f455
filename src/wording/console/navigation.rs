//! Answers to keys that move, sort and filter.

pub const ALL_LISTED: &str = "overview and registry list every version";
pub const OWN_LISTED: &str = "overview and registry list the versions that you wrote or that wait for you";
pub const NOT_FILTERED_BY_STATE: &str = "only the overview's pipeline and the registry are filtered by state";
pub const EVERY_ALARM_ACKNOWLEDGED: &str = "every alarm is acknowledged";
pub const TURNED_ROUND: &str = ", turned round";
pub const NONE_KNOWN_TO_BE_YOURS: &str = "no version is known to be yours";

#[must_use]
pub fn listed_alone(filter: &str) -> String {
    format!("overview and registry list {filter} versions alone")
}

#[must_use]
pub fn sorted_by(column: &str, order: &str) -> String {
    format!("sorted by {column}{order}")
}
