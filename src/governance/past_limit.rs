//! Measured values past a limit: the quantity, the value, the limit, and the live task in which it was measured.
//!
//! Plain values for records, notices and events. Owns no sentence and measures nothing: the engine fills them in.

use holdpoint_body::TaskKind;
use serde::{Deserialize, Serialize};

crate::closed_set! {
    /// A quantity with a limit.
    LimitedQuantity, "quantity with a limit", {
        /// Force on wrist, pads or hand, N.
        Force = "force",
        /// Speed of the tool, m/s.
        Speed = "speed",
        /// Motion after a demanded stop, ms.
        Motion = "motion",
        /// New attempts in one task, a count.
        Retries = "retries",
    }
}

crate::closed_set! {
    /// The place where a force acts.
    ForcePlace, "place of a force", {
        /// Between the pads and the object.
        Pads = "pads",
        /// Between the robot, or the held object, and its surroundings.
        Surroundings = "surroundings",
    }
}

impl LimitedQuantity {
    /// The unit of its values; empty for a count.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Force => "N",
            Self::Speed => "m/s",
            Self::Motion => "ms",
            Self::Retries => "",
        }
    }
}

/// A measured value and the limit that it is past.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PastLimit {
    /// What was measured.
    pub quantity: LimitedQuantity,
    /// The largest value.
    pub value: f64,
    /// The limit.
    pub limit: f64,
    /// The place of a force, where one place alone had it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<ForcePlace>,
}

/// The live task in which a limit was violated, and the value with its limit where one was measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MeasuredInTask {
    /// Which sequence of the live world, counting from 0.
    pub sequence: u64,
    /// The task.
    pub task: TaskKind,
    /// The value and its limit; absent if the violation is about no measured value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub past: Option<PastLimit>,
}

impl MeasuredInTask {
    /// Whether its value is larger than that of another violation of the same limit.
    #[must_use]
    pub fn exceeds(&self, other: &Self) -> bool {
        match (self.past, other.past) {
            (Some(own), Some(other)) => own.value > other.value,
            (own, other) => own.is_some() && other.is_none(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn forced(sequence: u64, value: f64) -> MeasuredInTask {
        let past = PastLimit { quantity: LimitedQuantity::Force, value, limit: 35.0, place: None };
        MeasuredInTask { sequence, task: TaskKind::Grasp, past: Some(past) }
    }

    #[test]
    fn a_larger_value_exceeds_and_a_later_sequence_does_not() {
        assert!(forced(1, 72.0).exceeds(&forced(2, 71.0)));
        assert!(!forced(2, 71.0).exceeds(&forced(1, 71.0)));
        let unmeasured = MeasuredInTask { past: None, ..forced(3, 0.0) };
        assert!(forced(1, 36.0).exceeds(&unmeasured) && !unmeasured.exceeds(&forced(1, 36.0)));
    }

    /// Records of older builds name no place.
    #[test]
    fn a_value_without_a_place_reads_and_writes_as_before() {
        let older = r#"{"quantity":"force","value":144.25,"limit":60.0}"#;
        let past: PastLimit = serde_json::from_str(older).unwrap();
        assert_eq!((past.value, past.limit, past.place), (144.25, 60.0, None));
        assert_eq!(serde_json::to_string(&past).unwrap(), older);
    }
}
