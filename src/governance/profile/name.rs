//! The three settings there are profiles for.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The setting a profile is for (paper: `Gamma_sim`, `Gamma_real`, `Gamma_human`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ProfileName {
    /// Simulation only: nothing can be damaged, nobody is asked (paper appendix D).
    Sim,
    /// A real cell with nobody inside while it works.
    Real,
    /// People work beside the robot: the tightest limits, and activation needs signatures.
    Human,
}

impl ProfileName {
    /// Every profile, the loosest first.
    pub const ALL: [Self; 3] = [Self::Sim, Self::Real, Self::Human];
    /// The name in files, policies and records.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sim => "sim",
            Self::Real => "real",
            Self::Human => "human",
        }
    }
}

impl std::str::FromStr for ProfileName {
    type Err = ProfileNameError;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::ALL
            .into_iter()
            .find(|name| name.name() == text)
            .ok_or_else(|| ProfileNameError(text.to_owned()))
    }
}

impl std::fmt::Display for ProfileName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A text that names no profile; `sim`, `real` and `human` are.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the profile {0:?} does not exist; sim, real and human do")]
pub struct ProfileNameError(pub String);
