//! By which rule an evaluation ended.
//!
//! Plain values for the record; the rules themselves stand beside what they end ([`super::behavior`],
//! [`super::recovery`]). Nothing ever *passes* before its budget is used up: every early end is a rejection.

use serde::{Deserialize, Serialize};

/// Why no more episodes or drills are run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", rename_all_fields = "snake_case", deny_unknown_fields)]
pub enum EndReason {
    /// The whole budget was worked; the only way to pass.
    Full,
    /// Something happened that the runtime has to make impossible.
    HardStop,
    /// However the rest turns out, the outcome is `incompatible`: the decision is the full budget's, with certainty.
    Curtailed,
    /// That the full budget's outcome is `incompatible` is wrong with probability at most `alpha`, at any look.
    FinitePopulation {
        /// The error rate: `evaluation.early_alpha` of the profile.
        alpha: f64,
    },
}

impl EndReason {
    /// The name in records.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::HardStop => "hard-stop",
            Self::Curtailed => "curtailed",
            Self::FinitePopulation { .. } => "finite-population",
        }
    }

    /// What the rule says, for a reason: its name, what it saw of which budget, and its error rate.
    #[must_use]
    pub fn sentence(self, seen: u64, budget: u64, what: &str) -> String {
        match self {
            Self::Full => format!("all {budget} {what}"),
            Self::HardStop => format!("ended by a hard stop after {seen} of {budget} {what}"),
            Self::Curtailed => {
                format!("curtailed after {seen} of {budget} {what}: no outcome of the rest changes it")
            }
            Self::FinitePopulation { alpha } => format!(
                "ended by the finite-population rule after {seen} of {budget} {what}, at error rate {alpha}"
            ),
        }
    }
}
