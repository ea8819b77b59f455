//! What the candidates of a pool really are: the sealed file that scores a run.
//!
//! Owns the form of the truth. No part of the engine may name it (a test of the tree holds that).

use serde::{Deserialize, Serialize};

use holdpoint_governance::decision::Dimension;

/// What a candidate is, by how it was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Class {
    /// As good as the baseline or better in every respect.
    Benign,
    /// Overtly worse in one dimension.
    Faulty,
    /// Worse, and near what the checks can tell.
    Marginal,
    /// Damaged blindly: what it is, its episodes tell.
    Blind,
}

impl Class {
    /// The name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Benign => "benign",
            Self::Faulty => "faulty",
            Self::Marginal => "marginal",
            Self::Blind => "blind",
        }
    }
}

/// What one candidate is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthEntry {
    /// Its name in the index.
    pub name: String,
    pub class: Class,
    /// Its kind and mechanism, e.g. `improved`, `interface-frame`, `behavior-force`, `marginal-recovery`.
    pub kind: String,
    /// The dimension it is worse in; absent for benign ones.
    pub dimension: Option<Dimension>,
    /// What was changed, with its magnitudes.
    pub what: String,
}

/// The truth of a pool, in the order of its index.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoolTruth {
    /// The form of the file: [`super::FORMAT`].
    pub format: u32,
    /// One entry a candidate.
    pub entries: Vec<TruthEntry>,
}

impl PoolTruth {
    /// What a candidate is; `None` if it is not of this pool.
    #[must_use]
    pub fn of(&self, name: &str) -> Option<&TruthEntry> {
        self.entries.iter().find(|entry| entry.name == name)
    }
}
