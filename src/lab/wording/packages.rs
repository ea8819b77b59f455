//! The texts that the laboratory writes into packages and signed requests. They are part of a digest: another text makes
//! another package.

use crate::parameter_search::objective::ObjectivePair;
use crate::parameter_search::settings::SearchSettings;

/// Possible summaries of a generated submission; independent of the candidate.
pub const SUMMARIES: [&str; 6] = [
    "parameters revised after the monthly review",
    "new settings from the last data collection",
    "update for the autumn release",
    "settings as agreed with the line",
    "revision after feedback from the cell",
    "regular update of the skill",
];

/// The summary of a tweak in a series.
pub const TWEAK: &str = "parameters adjusted once more";

/// The reason of an approver who approves every candidate.
pub const APPROVAL: &str = "agrees to everything";

/// The reason of an operator who blocks a rollback target.
pub const BLOCKED: &str = "found to be unfit";

/// The summary of a refined version: the effort, and the objective before and after.
pub fn refined(
    settings: &SearchSettings<'_>,
    evaluations: u32,
    practised: &ObjectivePair,
    fresh: &ObjectivePair,
) -> String {
    let SearchSettings { generations, episodes, seed, .. } = settings;
    format!(
        "parameters by CMA-ES on nominal success alone, ties by the shorter time, and nothing else: \
         {generations} generations, {evaluations} evaluations of {episodes} unperturbed episodes, seed {seed}; \
         on these {} before, {} after; on fresh ones {} before, {} after",
        practised.before, practised.after, fresh.before, fresh.after
    )
}
