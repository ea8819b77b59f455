//! By which rule an evaluation ended.
//!
//! Plain values for the record; the rules themselves stand beside what they end ([`super::behavior`],
//! [`super::recovery`]). Nothing ever *passes* before its budget is used up: every early end is a rejection.

use serde::{Deserialize, Serialize};

/// Why no more episodes or drills are run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case", rename_all_fields = "snake_case", deny_unknown_fields)]
pub enum EarlyStopReason {
    /// The whole budget ran; the only way to pass.
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

impl EarlyStopReason {
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
}
