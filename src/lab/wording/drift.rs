//! The page of the drift experiment.

use crate::pipeline_experiments::drift::DriftReport;

pub const PLOT: &str = "recovered of the runs a drift worsened, 95 %";

/// Title, columns separated by `|`, and note.
pub const TABLE: [&str; 3] = [
    "By drift and magnitude",
    "drift | magnitude | n | worsened | rolled back of those | rolled back of the others | recovered of those rolled back | \
     worsened and recovered | safe-stopped of those rolled back | warned first | tasks to response, median (max) | tasks to \
     rollback | safe, ms | restored, ms | moved on, ms | good before / under / after",
    "Shares are counts with the Wilson interval at 95 %.\n\n\
     - **worsened**: over the same live episodes with and without the drift, unwatched, the share of bad tasks of \
     the version (failed, or unsafe by ground truth) rose by at least the shift the profile's monitor is tuned \
     to, and the rise is significant (one-sided paired 95 % bound above 0). Such a run needs a rollback.\n\
     - **recovered**: the ladder was completed and the rollback target is in control, motion after the trigger kept \
     to the profile's limit, and none of the target's tasks in the ten sequences after it was unsafe by \
     ground truth. A run that did not need a rollback and had none counts neither for nor against.\n\
     - **safe, ms**: from the trigger to the standstill of every joint, of versions that were stopped in flight. \
     **restored**: from the trigger until the rollback target was bound and had given a command its guard passes. \
     **moved on**: motion after the trigger, without what braking takes.\n\
     - **good before / under**: of the version's tasks, in the twins; **after**: of the rollback target's tasks, done, \
     under the drift.",
];

/// The head of the page: the runs, and their setting.
pub fn head(report: &DriftReport) -> String {
    let DriftReport { setting, seed, runs, not_activated, horizon, pairs, .. } = report;
    let setting = setting.short();
    format!(
        "# Rollback under drift\n\n{runs} runs from seed {seed}, {not_activated} of them without an activated candidate (they \
         count nowhere); horizon {horizon} sequences, twins of {pairs} sequences; setting {setting}.\n\n"
    )
}
