//! The state of a version and the people who decided it, in the words of scenarios and reports.

use holdpoint_governance::closed_set::ClosedSetError;
use holdpoint_governance::lifecycle::{Stage, State};
use serde::{Deserialize, Serialize};

/// The actual or expected state of a version: a lifecycle state, or a scenario's word for one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum ScenarioState {
    /// In this state.
    In(State),
    /// Active, and its provisional window is over.
    Confirmed,
    /// It waits for a person.
    Settled,
}

impl ScenarioState {
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

impl TryFrom<String> for ScenarioState {
    type Error = ClosedSetError;
    fn try_from(text: String) -> Result<Self, ClosedSetError> {
        let all = || State::ALL.map(Self::In).into_iter().chain([Self::Confirmed, Self::Settled]);
        let known = all().find(|stands| stands.name() == text);
        known.ok_or_else(|| ClosedSetError::new("state to wait for", &text, all().map(Self::name)))
    }
}

impl From<ScenarioState> for String {
    fn from(stands: ScenarioState) -> Self {
        stands.name().to_owned()
    }
}

impl std::fmt::Display for ScenarioState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

holdpoint_governance::closed_set! {
    /// The automatic decider about a version: a stage, or the monitor.
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
