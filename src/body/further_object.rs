//! Further objects: named objects of a cell beside those that its tasks work on.
//!
//! Owns what a declaration states and which values it may have. Where an object starts in an episode, and how it moves,
//! belongs to the cell.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::messages::MAX_OBJECTS;
use crate::shape::Shape;

/// The most further objects of a cell: the workpiece and its place have a name, too.
pub const FURTHER_OBJECTS_MAX: usize = MAX_OBJECTS - 2;

/// What the height, the width and the depth of a further object may be: half of it, m.
const HALF_M: [f64; 2] = [0.005, 0.25];
/// As the mass and the friction of a workpiece may be: kg, and the Coulomb coefficient.
const MASS_KG: [f64; 2] = [0.001, 5.0];
const FRICTION: [f64; 2] = [0.001, 2.0];
/// Where it may start, m and rad.
const PLACE_M: [f64; 2] = [-2.0, 2.0];
const YAW_RAD: [f64; 2] = [-core::f64::consts::PI, core::f64::consts::PI];
const ABOVE_TABLE_M: [f64; 2] = [0.0, 0.2];

/// The shape of a further object, as it starts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum FurtherShape {
    /// A box.
    Box {
        /// Half of its edges, m.
        half_m: [f64; 3],
    },
    /// An upright cylinder.
    Cylinder {
        /// Half of its height, m.
        half_height_m: f64,
        /// Its radius, m.
        radius_m: f64,
    },
}

impl FurtherShape {
    /// The same shape as a robot has them.
    #[must_use]
    pub const fn primitive(self) -> Shape {
        match self {
            Self::Box { half_m } => Shape::Cuboid { half_m },
            Self::Cylinder { half_height_m, radius_m } => {
                Shape::Cylinder { half_length_m: half_height_m, radius_m }
            }
        }
    }

    /// Half extents of the box around it, m.
    #[must_use]
    pub const fn half_m(self) -> [f64; 3] {
        match self {
            Self::Box { half_m } => half_m,
            Self::Cylinder { half_height_m, radius_m } => [radius_m, radius_m, half_height_m],
        }
    }

    /// Radius of its outline from above, m.
    #[must_use]
    pub fn outline_m(self) -> f64 {
        match self {
            Self::Box { half_m: [x, y, _] } => libm::hypot(x, y),
            Self::Cylinder { radius_m, .. } => radius_m,
        }
    }
}

/// A free rigid body in a cell. Observations name it, and no task works on it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FurtherObject {
    /// Its shape.
    pub shape: FurtherShape,
    /// Its mass, kg, spread evenly.
    pub mass_kg: f64,
    /// Coulomb coefficient. At a contact the smaller coefficient of the two bodies counts.
    pub friction: f64,
    /// Its middle at the start, m: from and to. Each seed draws one value; two equal ones fix it.
    pub x_m: [f64; 2],
    /// As `x_m`.
    pub y_m: [f64; 2],
    /// How it is turned about the vertical at the start, rad; as `x_m`.
    pub yaw_rad: [f64; 2],
    /// Height of its underside over the table at the start, m.
    #[serde(default)]
    pub above_table_m: f64,
}

/// The first value of a declaration that is not allowed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FurtherProblem {
    /// The field.
    pub field: &'static str,
    /// Its value.
    pub value: String,
    /// What is allowed.
    pub allowed: String,
}

impl FurtherObject {
    /// The first value that is not allowed.
    #[must_use]
    pub fn problem(&self) -> Option<FurtherProblem> {
        let half_m = self.shape.half_m();
        let rows: [(&'static str, &[f64], [f64; 2]); 7] = [
            ("shape", &half_m, HALF_M),
            ("mass_kg", &[self.mass_kg], MASS_KG),
            ("friction", &[self.friction], FRICTION),
            ("x_m", &self.x_m, PLACE_M),
            ("y_m", &self.y_m, PLACE_M),
            ("yaw_rad", &self.yaw_rad, YAW_RAD),
            ("above_table_m", &[self.above_table_m], ABOVE_TABLE_M),
        ];
        // A value that is no number lies in no range.
        let out_of_range = rows
            .into_iter()
            .find(|(_, values, [low, high])| !values.iter().all(|value| (*low..=*high).contains(value)));
        if let Some((field, values, [low, high])) = out_of_range {
            let value = match values {
                [value] => format!("{value:?}"),
                values => format!("{values:?}"),
            };
            let of = if field == "shape" { "half extents of " } else { "" };
            return Some(FurtherProblem { field, value, allowed: format!("{of}{low} to {high}") });
        }
        let ranges = [("x_m", self.x_m), ("y_m", self.y_m), ("yaw_rad", self.yaw_rad)];
        let reversed = ranges.into_iter().find(|(_, [from, to])| from > to);
        reversed.map(|(field, range)| FurtherProblem {
            field,
            value: format!("{range:?}"),
            allowed: "the smaller end first".to_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_value_has_a_range() {
        let good = FurtherObject {
            shape: FurtherShape::Box { half_m: [0.03, 0.02, 0.01] },
            mass_kg: 0.2,
            friction: 0.6,
            x_m: [0.4, 0.5],
            y_m: [-0.02, -0.02],
            yaw_rad: [-0.7, 0.7],
            above_table_m: 0.0,
        };
        assert_eq!(good.problem(), None);
        type Change = fn(&mut FurtherObject);
        let cases: [(Change, &str); 9] = [
            (|object| object.shape = FurtherShape::Box { half_m: [0.03, 0.002, 0.01] }, "shape"),
            (|object| object.shape = FurtherShape::Cylinder { half_height_m: 0.3, radius_m: 0.02 }, "shape"),
            (|object| object.mass_kg = f64::NAN, "mass_kg"),
            (|object| object.mass_kg = 0.0, "mass_kg"),
            (|object| object.friction = -0.1, "friction"),
            (|object| object.x_m = [0.5, f64::INFINITY], "x_m"),
            (|object| object.y_m = [0.1, -0.1], "y_m"),
            (|object| object.yaw_rad[0] = -4.0, "yaw_rad"),
            (|object| object.above_table_m = -0.01, "above_table_m"),
        ];
        for (change, field) in cases {
            let mut changed = good;
            change(&mut changed);
            let problem = changed.problem().unwrap();
            assert_eq!(problem.field, field, "{problem:?}");
            assert!(!problem.value.is_empty() && !problem.allowed.is_empty(), "{problem:?}");
        }
    }

    #[test]
    fn a_cylinder_stands_upright() {
        let shape = FurtherShape::Cylinder { half_height_m: 0.04, radius_m: 0.02 };
        assert_eq!((shape.half_m(), shape.outline_m()), ([0.02, 0.02, 0.04], 0.02));
        let diagonal = FurtherShape::Box { half_m: [0.03, 0.04, 0.01] }.outline_m();
        assert!((diagonal - 0.05).abs() < 1e-12, "{diagonal}");
        assert_eq!(shape.primitive(), Shape::Cylinder { half_length_m: 0.04, radius_m: 0.02 });
    }
}
