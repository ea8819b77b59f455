//! The settings there are profiles for, each declared once, and the names of profiles that do not come with the program.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ids::is_name;

/// What can be damaged or injured in the cell of a class of profiles, the least first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ClassRisk {
    /// Nothing: the cell is simulated.
    Nothing,
    /// The robot and its cell.
    Machine,
    /// People beside the robot.
    People,
}

/// What a class of profiles is, beside the numbers of its shipped profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClassDeclaration {
    /// What can be damaged or injured in its cell.
    pub risk: ClassRisk,
    /// Its name on the console.
    pub label: &'static str,
    /// What it is for, in the help of the command line.
    pub help: &'static str,
    /// File and text of its shipped profile.
    pub profile: (&'static str, &'static str),
    /// File and text of its shipped policies.
    pub policy: (&'static str, &'static str),
}

/// Declares the classes: the variant, the name in files, and what the class is.
macro_rules! classes {
    ($($(#[$doc:meta])* $class:ident = $name:literal, $label:literal: $risk:ident, $help:literal;)+) => {
        /// The setting a profile is for (paper: `Gamma_sim`, `Gamma_real`, `Gamma_human`).
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
        pub enum ProfileName { $($(#[$doc])* #[serde(rename = $name)] $class),+ }

        impl ProfileName {
            /// Every profile, the loosest first.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$class),+];

            /// Every name, in the same order.
            pub const NAMES: [&'static str; Self::ALL.len()] = [$($name),+];

            /// The name in files, policies and records.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$class => $name),+ }
            }

            /// What the class is.
            #[must_use]
            pub const fn declaration(self) -> &'static ClassDeclaration {
                match self {
                    $(Self::$class => const {
                        &ClassDeclaration {
                            risk: ClassRisk::$risk,
                            label: $label,
                            help: $help,
                            profile: (
                                concat!("profiles/", $name, ".toml"),
                                include_str!(concat!("../../../profiles/", $name, ".toml")),
                            ),
                            policy: (
                                concat!("profiles/", $name, ".cedar"),
                                include_str!(concat!("../../../profiles/", $name, ".cedar")),
                            ),
                        }
                    }),+
                }
            }
        }
    };
}

classes! {
    /// Simulation only: nothing can be damaged, no approval is required (paper appendix D).
    Sim = "sim", "SIM": Nothing, "Simulation only: no approvals";
    /// A real cell with no person inside while it runs.
    Real = "real", "REAL": Machine, "A real cell, no people inside";
    /// People work beside the robot: the tightest limits, and activation needs signatures.
    Human = "human", "HUMAN": People, "People work beside the robot: the tightest limits";
}

impl ProfileName {
    /// Every name in one text, with `word` instead of the last comma: `sim, real and human`.
    #[must_use]
    pub fn listed(word: &str) -> String {
        let [names @ .., last] = Self::NAMES;
        format!("{} {word} {last}", names.join(", "))
    }

    /// Whether it is for a cell in which damage or injury is possible.
    #[must_use]
    pub const fn is_at_risk(self) -> bool {
        !matches!(self.declaration().risk, ClassRisk::Nothing)
    }

    /// Whether people work beside the robot.
    #[must_use]
    pub const fn is_beside_people(self) -> bool {
        matches!(self.declaration().risk, ClassRisk::People)
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

/// A text that names no profile.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the profile {0:?} does not exist; {known} do", known = ProfileName::listed("and"))]
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
     digit, and none of {taken}",
    taken = ProfileName::listed("and")
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

#[cfg(test)]
mod tests {
    use super::*;

    /// No class has less at risk than the one before it; records and files have these names.
    #[test]
    fn classes_are_declared_in_the_order_of_their_risk() {
        let risks = ProfileName::ALL.map(|class| class.declaration().risk);
        assert!(risks.is_sorted(), "{risks:?}");
        let named = ["sim", "real", "human"].map(|name| name.parse::<ProfileName>().unwrap());
        assert_eq!(named, [ProfileName::Sim, ProfileName::Real, ProfileName::Human]);
        assert_eq!(ProfileName::listed("or"), "sim, real or human");
        for class in ProfileName::ALL {
            assert_eq!(serde_json::to_value(class).unwrap(), class.name());
            assert_eq!(class.declaration().label, class.name().to_uppercase());
            let texts = [class.declaration().profile, class.declaration().policy];
            assert_eq!(
                texts.map(|(file, _)| file),
                ["toml", "cedar"].map(|end| format!("profiles/{class}.{end}"))
            );
        }
    }
}
