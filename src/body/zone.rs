//! Zones of the workspace: named boxes, as manifests and policies use them.

use serde::{Deserialize, Serialize};

use crate::number::finite3;

/// A named axis-aligned box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Zone {
    /// Name, as manifests and policies use it.
    pub name: String,
    /// Lower corner, m.
    #[serde(deserialize_with = "finite3")]
    pub min_m: [f64; 3],
    /// Upper corner, m.
    #[serde(deserialize_with = "finite3")]
    pub max_m: [f64; 3],
    /// Whether the robot must stay out.
    pub keep_out: bool,
}

impl Zone {
    /// Whether a point lies in the box; never for a point that is not finite.
    #[must_use]
    pub fn contains(&self, point: &[f64; 3]) -> bool {
        (0..3).all(|i| point[i] >= self.min_m[i] && point[i] <= self.max_m[i])
    }
}

/// A zone by name.
#[must_use]
pub fn named<'a>(zones: &'a [Zone], name: &str) -> Option<&'a Zone> {
    zones.iter().find(|zone| zone.name == name)
}
