//! Zones of the workspace: named boxes, as manifests and policies use them.

use serde::{Deserialize, Serialize};

use crate::number::finite3;

/// A named box of the workspace, its edges along the world's axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Zone {
    /// Name, as manifests and policies use it.
    pub name: String,
    /// Corner with the smallest coordinates, world frame, m.
    #[serde(deserialize_with = "finite3")]
    pub min_m: [f64; 3],
    /// Corner with the largest coordinates, world frame, m.
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

/// The first zone of this name; `None` if there is none.
#[must_use]
pub fn named<'a>(zones: &'a [Zone], name: &str) -> Option<&'a Zone> {
    zones.iter().find(|zone| zone.name == name)
}
