//! The recipes of `recipes.toml`, each with its ranges and the reason for them.
//!
//! Owns the form of the table. Samples nothing and knows nothing of packages.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::kind::CandidateKind;
use holdpoint_governance::ids::Family;
use holdpoint_governance::text_error::{self, TextError};

const TEXT: &str = include_str!("recipes.toml");

/// Its name in errors.
const FILE: &str = "src/lab/candidate_pool/recipes.toml";

/// The kind that a recipe makes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RecipeKind {
    /// Harmless differences, which every candidate gets before what it is made for.
    Plain,
    /// See [`CandidateKind::Improved`].
    Improved,
    /// See [`CandidateKind::Lateral`].
    Lateral,
    /// See [`CandidateKind::MinorGain`].
    MinorGain,
    /// See [`CandidateKind::Efficiency`].
    Efficiency,
    /// See [`CandidateKind::Robust`].
    Robust,
    /// See [`CandidateKind::Stable`].
    Stable,
    /// See [`CandidateKind::Behavior`].
    Behavior,
    /// See [`CandidateKind::Recovery`].
    Recovery,
    /// See [`CandidateKind::MarginalBehavior`].
    MarginalBehavior,
    /// See [`CandidateKind::MarginalRecovery`].
    MarginalRecovery,
    /// See [`CandidateKind::Listed`]; the mechanism says which.
    Listed,
}

impl RecipeKind {
    /// The kinds that are made by parameters; interface and permission faults are in the manifest.
    #[must_use]
    pub const fn of(kind: CandidateKind) -> Self {
        match kind {
            CandidateKind::Improved => Self::Improved,
            CandidateKind::Lateral => Self::Lateral,
            CandidateKind::MinorGain => Self::MinorGain,
            CandidateKind::Efficiency => Self::Efficiency,
            CandidateKind::Robust => Self::Robust,
            CandidateKind::Stable => Self::Stable,
            CandidateKind::Interface(_) | CandidateKind::Permission(_) => Self::Plain,
            CandidateKind::Behavior(_) => Self::Behavior,
            CandidateKind::Recovery(_) => Self::Recovery,
            CandidateKind::MarginalBehavior => Self::MarginalBehavior,
            CandidateKind::MarginalRecovery => Self::MarginalRecovery,
            CandidateKind::Listed(_) => Self::Listed,
            // No recipe makes one.
            CandidateKind::Unchanged
            | CandidateKind::Negligible
            | CandidateKind::Mutant
            | CandidateKind::Component(_) => Self::Plain,
        }
    }
}

/// One way to make a candidate.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    pub family: Family,
    pub makes: RecipeKind,
    /// The mechanism, for the truth's `kind`; empty if the kind says it.
    #[serde(default)]
    pub mechanism: String,
    /// Always the first of its kind in a set.
    #[serde(default)]
    pub first: bool,
    /// Description, and the reason for these ranges.
    pub why: String,
    /// Parameters with a fixed value.
    #[serde(default)]
    pub set: BTreeMap<String, toml::Value>,
    /// Parameters sampled uniformly between two numbers.
    #[serde(default)]
    pub real: BTreeMap<String, [f64; 2]>,
    /// Parameters sampled uniformly among whole numbers, both ends included.
    #[serde(default)]
    pub whole: BTreeMap<String, [u32; 2]>,
    /// Declared stop time of the safe-abort hook, ms, sampled likewise.
    #[serde(default)]
    pub stop_time_ms: Option<[u32; 2]>,
    /// Declared largest tool speed, m/s.
    #[serde(default)]
    pub max_speed_m_s: Option<f64>,
    /// Declared largest force, N.
    #[serde(default)]
    pub max_force_n: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RecipeTable {
    recipe: Vec<Recipe>,
}

/// Every recipe, in the table's order.
///
/// # Errors
/// If the embedded table does not parse, or a range is empty.
pub fn recipes() -> Result<Vec<Recipe>, TextError> {
    let table: RecipeTable = text_error::parse_toml(FILE, TEXT)?;
    for recipe in &table.recipe {
        let empty = recipe.real.iter().find(|(_, [low, high])| !(low <= high)).map(|(name, _)| name);
        let none = recipe.whole.iter().find(|(_, [low, high])| low > high).map(|(name, _)| name);
        if let Some(name) = empty.or(none) {
            return Err(TextError::value(FILE, TEXT, name, "an empty range", "the lower number first"));
        }
    }
    Ok(table.recipe)
}
