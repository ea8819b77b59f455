//! Where a version stands and who decided about it, in the words of scenarios and of reports.

use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::words::WordError;
use serde::{Deserialize, Serialize};

/// Where a version stands or is to stand: a state of its lifecycle, or what a scenario calls one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Stands {
    /// In this state.
    In(State),
    /// Active, and its provisional window is over.
    Confirmed,
    /// Nothing more happens to it by itself.
    Settled,
}

impl Stands {
    /// The name in scenarios and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::In(state) => state.name(),
            Self::Confirmed => "confirmed",
            Self::Settled => "settled",
        }
    }
}

impl TryFrom<String> for Stands {
    type Error = WordError;
    fn try_from(text: String) -> Result<Self, WordError> {
        let all = || State::ALL.map(Self::In).into_iter().chain([Self::Confirmed, Self::Settled]);
        let known = all().find(|stands| stands.name() == text);
        known.ok_or_else(|| WordError::new("state to wait for", &text, all().map(Self::name)))
    }
}

impl From<Stands> for String {
    fn from(stands: Stands) -> Self {
        stands.name().to_owned()
    }
}

impl std::fmt::Display for Stands {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

holdpoint_governance::words! {
    /// Who decides about a version by itself: a stage, or the monitor.
    Decider, "stage", {
        /// The static checks.
        Validation = "validation",
        /// Sandbox evaluation with drills.
        Sandbox = "sandbox",
        /// Shadow deployment.
        Shadow = "shadow",
        /// The gate.
        Activation = "activation",
        /// The monitor of an active version.
        Monitor = "monitor",
    }
}

impl From<Stage> for Decider {
    fn from(stage: Stage) -> Self {
        match stage {
            Stage::Validation => Self::Validation,
            Stage::Sandbox => Self::Sandbox,
            Stage::Shadow => Self::Shadow,
            Stage::Activation => Self::Activation,
        }
    }
}
