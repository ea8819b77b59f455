//! The hidden ground truth of a pool's candidates: the sealed file that scores a run.
//!
//! Owns the form of the truth. No part of the engine may name it (a test of the tree holds that).

use serde::{Deserialize, Serialize};

use holdpoint_governance::decision::Dimension;

/// The class of a candidate, by its construction.
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

/// The truth about one candidate.
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
    /// The changes, with their magnitudes.
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
    /// The truth about a candidate; `None` if it is not of this pool.
    #[must_use]
    pub fn of(&self, name: &str) -> Option<&TruthEntry> {
        self.entries.iter().find(|entry| entry.name == name)
    }
}
