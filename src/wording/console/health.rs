//! The texts of the health view.

use holdpoint_protocol::health::HealthPoint;

use crate::counted;

pub const NARROWER_THAN_A_MINUTE: &str = "narrower than a minute";
pub const WIDER_THAN_A_DAY: &str = "wider than a day";
pub const NOTHING_READ_YET: &str = "nothing has been read yet";
pub const HELP: &str = "Health: success, violations, time and force over hours and days";
pub const TOUR: &str = "Better or worse, and since when: tab turns on, + and - zoom";
pub const NO_TASK: &str = "no task";
pub const SUCCESS: &str = "% done, band: 95 % interval";
pub const VIOLATIONS: &str = "% with a violation, band: with those close to a limit";
pub const TIME: &str = "s, median, band: to the 95th percentile";
pub const FORCE: &str = "N, median of the largest, band: to the 95th percentile";
pub const NO_LIVE_TASK: &str = "No live task of this span is on record. Tasks are kept of versions that came in \
     through the gate, from then on; those of a family's first version are not.";

/// The title of the last chart for which there is room, and the number of the others.
#[must_use]
pub fn and_hidden(title: &str, hidden: usize) -> String {
    format!("{title}; {hidden} hidden")
}

#[must_use]
pub fn column_is_no(end: &str) -> String {
    format!("a column is no {end}")
}

#[must_use]
pub fn span(all: &str, each: &str, clock: &str) -> String {
    format!("the last {all}, a column is {each}, {clock}")
}

#[must_use]
pub fn no_task_on_record(start: &str, end: &str, family: &str) -> String {
    format!("{start} to {end}: no task of {family} on record")
}

#[must_use]
pub fn marks_more(more: usize) -> String {
    format!("and {} in this column", counted(more, "more mark"))
}

#[must_use]
pub fn done_share(percent: f64, tasks: u64, low: f64, high: f64) -> String {
    format!("done {percent:.1} % of {tasks} [{low:.0}, {high:.0}]")
}

/// The results of one version in a bucket that begins at `start`; `engine_time`: the same on the engine's clock.
#[must_use]
pub fn results(point: &HealthPoint, start: &str, engine_time: Option<&str>) -> String {
    let HealthPoint { version, tasks, succeeded, success: [low, high], violated, near, .. } = point;
    let ([time, time_p95], [force, force_p95]) = (point.time_s, point.force_n);
    let engine = engine_time.map_or_else(String::new, |moment| format!(" (engine {moment})"));
    let share = 100.0 * *succeeded as f64 / (*tasks).max(1) as f64;
    let (low, high) = (100.0 * low, 100.0 * high);
    // On record, a task with a violation counts as near a limit, too.
    let close = near.saturating_sub(*violated);
    format!(
        "{start}{engine} {version}: {succeeded} of {tasks} done, {share:.1} % [{low:.0}, {high:.0}]; \
         {violated} with a violation, {close} close to a limit; {time:.1} s, p95 {time_p95:.1}; \
         {force:.1} N, p95 {force_p95:.1}"
    )
}
