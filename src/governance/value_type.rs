//! Types of named fields: a capability's inputs, outputs and parameters.
//!
//! Owns field specifications and their rules (finite, ordered ranges, units and frames from a closed
//! list). Compares nothing; that is [`super::interface`]'s work.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The most names of an enum field.
pub const ENUM_VALUES_MAX: usize = 32;

/// The most elements a list field may allow.
pub const LIST_LENGTH_MAX: u32 = 64;

/// How far the squared length of a unit quaternion may be from 1: rounding of the numbers in a file.
const UNIT_WITHIN: f64 = 1e-6;

/// The largest magnitude a declared number may have.
pub const MAGNITUDE_MAX: f64 = 1.0e9;

/// The kind of value a field holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[schemars(rename = "Kind")]
pub enum ValueKind {
    /// `true` or `false`; neither unit nor range.
    Bool,
    /// A whole number of magnitude up to 1e9.
    Int,
    /// A finite number, with its unit.
    Real,
    /// Three finite numbers: a position, direction or velocity, in a frame.
    Vec3,
    /// A unit quaternion, x y z w.
    Quat,
    /// A position and a unit quaternion.
    Pose,
    /// One of the names in `values`.
    Enum,
    /// Up to `length_max` values of kind `element`.
    List,
}

/// A unit; a changed unit is a breaking change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
pub enum Unit {
    /// Length, m.
    #[serde(rename = "m")]
    Metre,
    /// Angle, rad.
    #[serde(rename = "rad")]
    Radian,
    /// Linear speed, m/s.
    #[serde(rename = "m/s")]
    MetrePerSecond,
    /// Angular speed, rad/s.
    #[serde(rename = "rad/s")]
    RadianPerSecond,
    /// Force, N.
    #[serde(rename = "N")]
    Newton,
    /// Torque, N m.
    #[serde(rename = "N m")]
    NewtonMetre,
    /// Time, s.
    #[serde(rename = "s")]
    Second,
    /// Time, ms.
    #[serde(rename = "ms")]
    Millisecond,
    /// Mass, kg.
    #[serde(rename = "kg")]
    Kilogram,
    /// A pure number: a share, a count or a factor.
    #[serde(rename = "1")]
    One,
}

/// The frame a position or pose is expressed in; a changed frame is a breaking change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CoordinateFrame {
    /// z up, the robot's base at the origin.
    World,
    /// Origin at the tool center point; moves with the gripper.
    Tool,
    /// Origin in the handled object; moves with it.
    Object,
    /// Origin in the place the object goes to, e.g. a slot of the tray.
    Target,
}

/// A value as a manifest or parameter file writes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Value {
    /// Written `true` or `false`.
    Bool(bool),
    /// A number written without a decimal point.
    Int(i64),
    /// A number written with a decimal point or an exponent; finite.
    Real(f64),
    /// One of the names of an enum field.
    Name(String),
    /// Numbers of a vector, quaternion, pose (position, then x y z w) or list.
    Numbers(Vec<f64>),
}

impl Value {
    /// The value as a number; `None` for a boolean, a name or a list.
    #[must_use]
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Int(value) => Some(*value as f64),
            Self::Real(value) => Some(*value),
            Self::Bool(_) | Self::Name(_) | Self::Numbers(_) => None,
        }
    }
}

const fn yes() -> bool {
    true
}

/// A named field's type, unit, frame, range and default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FieldSpec {
    /// Kind of value the field takes.
    #[serde(rename = "type")]
    pub kind: ValueKind,
    /// Unit of the numbers; required for reals, vectors and lists of them, `1` for pure numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<Unit>,
    /// Frame of a vector, quaternion or pose.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<CoordinateFrame>,
    /// Lowest and highest number allowed, both included.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
    /// The names an enum field may take.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub values: Vec<String>,
    /// Kind of a list's elements; never a list.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub element: Option<ValueKind>,
    /// Most elements of a list, up to [`LIST_LENGTH_MAX`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length_max: Option<u32>,
    /// Whether a caller must give it (inputs) or it is always there (outputs).
    #[serde(default = "yes")]
    pub required: bool,
    /// The default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub default: Option<Value>,
}

impl FieldSpec {
    /// A required field of this kind without unit, frame or range.
    #[must_use]
    pub const fn plain(kind: ValueKind) -> Self {
        Self {
            kind,
            unit: None,
            frame: None,
            range: None,
            values: Vec::new(),
            element: None,
            length_max: None,
            required: true,
            default: None,
        }
    }

    /// A required real with a unit and a range.
    #[must_use]
    pub const fn real(unit: Unit, lowest: f64, highest: f64) -> Self {
        let mut spec = Self::plain(ValueKind::Real);
        spec.unit = Some(unit);
        spec.range = Some([lowest, highest]);
        spec
    }

    /// A required pose in a frame, meters.
    #[must_use]
    pub const fn pose(frame: CoordinateFrame) -> Self {
        let mut spec = Self::plain(ValueKind::Pose);
        spec.unit = Some(Unit::Metre);
        spec.frame = Some(frame);
        spec
    }

    /// The same field with a default (and so not required).
    #[must_use]
    pub fn or(mut self, default: Value) -> Self {
        self.default = Some(default);
        self.required = false;
        self
    }

    /// The problem of this specification: the key, the value and what is allowed; `None` if it is valid.
    #[must_use]
    pub fn problem(&self) -> Option<(&'static str, String, String)> {
        let bad = |key, value: String, allowed: &str| Some((key, value, allowed.to_owned()));
        let numeric = matches!(self.kind, ValueKind::Int | ValueKind::Real | ValueKind::Vec3)
            || (self.kind == ValueKind::List
                && matches!(self.element, Some(ValueKind::Int | ValueKind::Real)));
        let spatial = matches!(self.kind, ValueKind::Vec3 | ValueKind::Quat | ValueKind::Pose);
        if let Some([lowest, highest]) = self.range {
            let finite = [lowest, highest].iter().all(|v| v.is_finite() && v.abs() <= MAGNITUDE_MAX);
            if !finite || lowest > highest {
                return bad("range", format!("{lowest}, {highest}"), "two finite numbers, the lower first");
            }
            if !numeric {
                return bad(
                    "range",
                    format!("{lowest}, {highest}"),
                    "a range only for int, real, vec3 and lists of them",
                );
            }
        }
        if matches!(self.kind, ValueKind::Real | ValueKind::Vec3 | ValueKind::Pose) && self.unit.is_none() {
            return bad("unit", "(missing)".into(), "a unit, \"1\" for a pure number");
        }
        if self.frame.is_some() && !spatial {
            return bad("frame", format!("{:?}", self.frame), "a frame only for vec3, quat and pose");
        }
        if matches!(self.kind, ValueKind::Quat | ValueKind::Pose) && self.frame.is_none() {
            return bad("frame", "(missing)".into(), "world, tool, object or target");
        }
        let names_ok = !self.values.is_empty()
            && self.values.len() <= ENUM_VALUES_MAX
            && self.values.iter().all(|name| super::ids::is_name(name));
        if (self.kind == ValueKind::Enum) == self.values.is_empty()
            || (self.kind == ValueKind::Enum && !names_ok)
        {
            return bad("values", format!("{:?}", self.values), "1 to 32 names, for an enum only");
        }
        let scalar = matches!(
            self.element,
            Some(ValueKind::Bool | ValueKind::Int | ValueKind::Real | ValueKind::Vec3)
        );
        if (self.kind == ValueKind::List) != self.element.is_some()
            || (self.kind == ValueKind::List && !scalar)
        {
            return bad("element", format!("{:?}", self.element), "bool, int, real or vec3, for a list only");
        }
        let length_ok = self.length_max.is_some_and(|n| (1..=LIST_LENGTH_MAX).contains(&n));
        if (self.kind == ValueKind::List) != self.length_max.is_some()
            || (self.kind == ValueKind::List && !length_ok)
        {
            return bad("length_max", format!("{:?}", self.length_max), "1 to 64, for a list only");
        }
        if let Some(default) = &self.default
            && !self.admits(default)
        {
            return bad("default", format!("{default:?}"), "a value of the field's own type and range");
        }
        None
    }

    /// Whether `value` is of this field's type and inside its range.
    #[must_use]
    pub fn admits(&self, value: &Value) -> bool {
        let inside = |v: f64| {
            v.is_finite()
                && v.abs() <= MAGNITUDE_MAX
                && self.range.is_none_or(|[low, high]| low <= v && v <= high)
        };
        match (self.kind, value) {
            (ValueKind::Bool, Value::Bool(_)) => true,
            (ValueKind::Int, Value::Int(_)) | (ValueKind::Real, Value::Int(_) | Value::Real(_)) => {
                value.number().is_some_and(inside)
            }
            (ValueKind::Vec3, Value::Numbers(v)) => v.len() == 3 && v.iter().copied().all(inside),
            (ValueKind::Quat, Value::Numbers(v)) => v.len() == 4 && unit_length(v),
            (ValueKind::Pose, Value::Numbers(v)) => {
                v.len() == 7 && v[..3].iter().copied().all(inside) && unit_length(&v[3..])
            }
            (ValueKind::Enum, Value::Name(name)) => self.values.contains(name),
            (ValueKind::List, Value::Numbers(v)) => {
                let numbers = matches!(self.element, Some(ValueKind::Int | ValueKind::Real));
                let whole = self.element != Some(ValueKind::Int) || v.iter().all(|v| v.fract() == 0.0);
                numbers
                    && whole
                    && self.length_max.is_some_and(|max| v.len() <= max as usize)
                    && v.iter().copied().all(inside)
            }
            (
                ValueKind::Bool
                | ValueKind::Int
                | ValueKind::Real
                | ValueKind::Vec3
                | ValueKind::Quat
                | ValueKind::Pose
                | ValueKind::Enum
                | ValueKind::List,
                Value::Bool(_) | Value::Int(_) | Value::Real(_) | Value::Name(_) | Value::Numbers(_),
            ) => false,
        }
    }
}

fn unit_length(v: &[f64]) -> bool {
    (v.iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < UNIT_WITHIN
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn field_admits_only_values_of_its_kind_and_range() {
        let speed = FieldSpec::real(Unit::MetrePerSecond, 0.0, 1.0);
        let pose = FieldSpec::pose(CoordinateFrame::World);
        for (spec, value, ok) in [
            (&speed, Value::Real(0.5), true),
            (&speed, Value::Int(1), true),
            (&speed, Value::Real(1.1), false),
            (&speed, Value::Real(f64::NAN), false),
            (&speed, Value::Bool(true), false),
            (&pose, Value::Numbers(vec![0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), true),
            (&pose, Value::Numbers(vec![0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0]), false),
            (&pose, Value::Numbers(vec![0.0]), false),
        ] {
            assert_eq!(spec.admits(&value), ok, "{value:?}");
        }
    }

    #[test]
    fn bad_specifications_are_named() {
        let real = FieldSpec::real(Unit::One, 0.0, 1.0);
        let list = FieldSpec {
            element: Some(ValueKind::Real),
            length_max: Some(4),
            ..FieldSpec::plain(ValueKind::List)
        };
        for (spec, key) in [
            (real.clone(), None),
            (list.clone(), None),
            (FieldSpec { range: Some([1.0, 0.0]), ..real.clone() }, Some("range")),
            (FieldSpec { range: Some([f64::NAN, 0.0]), ..real.clone() }, Some("range")),
            (FieldSpec { range: Some([0.0, f64::INFINITY]), ..real.clone() }, Some("range")),
            (FieldSpec { unit: None, ..real.clone() }, Some("unit")),
            (FieldSpec { frame: Some(CoordinateFrame::Tool), ..real.clone() }, Some("frame")),
            (FieldSpec { frame: None, ..FieldSpec::pose(CoordinateFrame::World) }, Some("frame")),
            (FieldSpec::plain(ValueKind::Enum), Some("values")),
            (FieldSpec { element: Some(ValueKind::List), ..list.clone() }, Some("element")),
            (FieldSpec { length_max: Some(65), ..list.clone() }, Some("length_max")),
            (real.clone().or(Value::Real(2.0)), Some("default")),
        ] {
            assert_eq!(spec.problem().map(|(key, ..)| key), key, "{spec:?}");
        }
    }
}
