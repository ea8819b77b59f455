//! The three settings there are profiles for, and the names of profiles that do not come with the program.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ids::is_name;

/// The setting a profile is for (paper: `Gamma_sim`, `Gamma_real`, `Gamma_human`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ProfileName {
    /// Simulation only: nothing can be damaged, no approval is required (paper appendix D).
    Sim,
    /// A real cell with no person inside while it runs.
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

/// The name of a profile that does not come with the program, e.g. `line-4`: as every name here, and none of the
/// three settings.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub struct SiteName(String);

/// A profile's class, with its own name if it has one: `human`, or `human (line-4)`.
#[must_use]
pub fn titled(class: ProfileName, site: Option<&SiteName>) -> String {
    site.map_or_else(|| class.name().to_owned(), |site| format!("{class} ({site})"))
}

/// A text that is no valid name of a site's profile.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the name {0:?} is not allowed: 1 to 64 characters of a-z, 0-9, '.', '_' and '-', starting with a letter or \
     digit, and none of sim, real and human"
)]
pub struct SiteNameError(pub String);

impl SiteName {
    /// The name, `[a-z0-9._-]`, at most 64 characters.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TryFrom<String> for SiteName {
    type Error = SiteNameError;
    fn try_from(name: String) -> Result<Self, SiteNameError> {
        let taken = name.parse::<ProfileName>().is_ok();
        if is_name(&name) && !taken { Ok(Self(name)) } else { Err(SiteNameError(name)) }
    }
}

impl From<SiteName> for String {
    fn from(name: SiteName) -> Self {
        name.0
    }
}

impl std::fmt::Display for SiteName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}
