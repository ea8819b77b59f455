//! Primitive shapes.

use serde::{Deserialize, Serialize};

/// A primitive shape, in its own frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shape {
    /// A segment of half length along z, thickened by a radius (m).
    Capsule {
        /// Half the distance between the end points, m.
        half_length_m: f64,
        /// Radius of the thickening, m.
        radius_m: f64,
    },
    /// A cylinder along z.
    Cylinder {
        /// Half the height, m.
        half_length_m: f64,
        /// Radius of the round section, m.
        radius_m: f64,
    },
    /// A box of half extents (m).
    Cuboid {
        /// Half the edges along x, y and z, m.
        half_m: [f64; 3],
    },
    /// A ball about the origin.
    Ball {
        /// Radius of the ball, m.
        radius_m: f64,
    },
}
