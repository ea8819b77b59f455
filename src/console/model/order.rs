//! The order of the registry's rows: as a tree, or by one column.
//!
//! The rows are many and are drawn often: they are sorted when they or the column change, not for each frame.

use std::cmp::Ordering;

use holdpoint_governance::record::VersionSummary;
use holdpoint_wording::console::registry as wording;

/// The column that sorts the registry's rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SortBy {
    /// Families, and their versions in them.
    #[default]
    Tree,
    State,
    /// One of the four kappas, in the order I, P, B, R.
    Kappa(usize),
    /// The last change, the newest first.
    Age,
    /// The author.
    Author,
}

impl SortBy {
    /// In the order of the columns, which a key steps through.
    pub const ALL: [Self; 8] = [
        Self::Tree,
        Self::State,
        Self::Kappa(0),
        Self::Kappa(1),
        Self::Kappa(2),
        Self::Kappa(3),
        Self::Age,
        Self::Author,
    ];

    /// The next one.
    #[must_use]
    pub fn next(self) -> Self {
        let at = Self::ALL.iter().position(|by| *by == self).unwrap_or(0);
        Self::ALL.get((at + 1) % Self::ALL.len()).copied().unwrap_or_default()
    }

    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            Self::Tree => wording::FAMILY_AND_VERSION,
            Self::State => "state",
            Self::Kappa(0) => "interface",
            Self::Kappa(1) => "policy",
            Self::Kappa(2) => "behavior",
            Self::Kappa(_) => "recovery",
            Self::Age => "age",
            Self::Author => "author",
        }
    }
}

/// A column and its direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SortOrder {
    pub by: SortBy,
    pub reversed: bool,
}

impl SortOrder {
    /// The places of the rows in this order; empty for the tree.
    #[must_use]
    pub fn places(self, rows: &[VersionSummary]) -> Vec<usize> {
        if self == Self::default() {
            return Vec::new();
        }
        let mut places: Vec<usize> = (0..rows.len()).collect();
        places.sort_by(|a, b| match (rows.get(*a), rows.get(*b)) {
            (Some(one), Some(other)) => self.compare(one, other),
            _ => Ordering::Equal,
        });
        places
    }

    /// Unmeasured values come last in either direction.
    fn compare(self, one: &VersionSummary, other: &VersionSummary) -> Ordering {
        let turned = |order: Ordering| if self.reversed { order.reverse() } else { order };
        match self.by {
            // Families keep their order; the versions in them are reversed.
            SortBy::Tree => one
                .version
                .family
                .cmp(&other.version.family)
                .then_with(|| turned(one.version.version.cmp(&other.version.version))),
            SortBy::State => turned(one.state.name().cmp(other.state.name())),
            SortBy::Kappa(which) => {
                let of = |row: &VersionSummary| row.kappas.get(which).copied().flatten();
                match (of(one), of(other)) {
                    (Some(one), Some(other)) => turned(one.total_cmp(&other)),
                    (Some(_), None) => Ordering::Less,
                    (None, Some(_)) => Ordering::Greater,
                    (None, None) => Ordering::Equal,
                }
            }
            SortBy::Age => turned(other.changed_ms.cmp(&one.changed_ms)),
            SortBy::Author => turned(one.author.cmp(&other.author)),
        }
    }
}
