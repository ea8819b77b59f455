//! Primitive shapes.

/// A primitive shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A segment of half length along z, thickened by a radius (m).
    Capsule {
        /// Half the distance between the end points, m.
        half_length_m: f64,
        /// Radius, m.
        radius_m: f64,
    },
    /// A cylinder along z.
    Cylinder {
        /// Half the height, m.
        half_length_m: f64,
        /// Radius, m.
        radius_m: f64,
    },
    /// A box of half extents (m).
    Cuboid {
        /// Half extents, m.
        half_m: [f64; 3],
    },
    /// A ball.
    Ball {
        /// Radius, m.
        radius_m: f64,
    },
}
