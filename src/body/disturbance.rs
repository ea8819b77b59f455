//! What a drill does to a cell, by name: drifts that set in, and parts that break.
//!
//! These types only name the disturbances; a simulator implements the effect of each.

use std::fmt;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A word that is not in its set.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{found:?} is not a {what}; allowed: {allowed}")]
pub struct UnknownName {
    /// What the word should have named, e.g. `kind of drift`.
    pub what: &'static str,
    /// The word that was found.
    pub found: String,
    /// The words of the set, separated by commas.
    pub allowed: String,
}

fn read<T: Copy>(
    what: &'static str,
    all: &[T],
    name: fn(T) -> &'static str,
    text: &str,
) -> Result<T, UnknownName> {
    all.iter().copied().find(|word| name(*word) == text).ok_or_else(|| UnknownName {
        what,
        found: text.to_owned(),
        allowed: all.iter().map(|word| name(*word)).collect::<Vec<_>>().join(", "),
    })
}

/// What changes in the cell after an activation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DriftKind {
    /// Noisier, biased, more often missing observations.
    #[serde(alias = "sensor-noise")]
    SensorNoise,
    /// Heavier, smoother goods that lie elsewhere.
    #[serde(alias = "distribution-shift")]
    DistributionShift,
    /// Commands reach the arm later.
    #[serde(alias = "actuator-delay")]
    ActuatorDelay,
    /// All three kinds at the same magnitude.
    Combined,
}

impl DriftKind {
    /// Every kind, the combination last.
    pub const ALL: [Self; 4] =
        [Self::SensorNoise, Self::DistributionShift, Self::ActuatorDelay, Self::Combined];

    /// The name in records, events and scenario files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::SensorNoise => "sensor_noise",
            Self::DistributionShift => "distribution_shift",
            Self::ActuatorDelay => "actuator_delay",
            Self::Combined => "combined",
        }
    }
}

impl FromStr for DriftKind {
    type Err = UnknownName;
    /// Reads a name; a person may write `-` for `_`.
    fn from_str(text: &str) -> Result<Self, UnknownName> {
        read("kind of drift", &Self::ALL, Self::name, &text.replace('-', "_"))
    }
}

impl fmt::Display for DriftKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// How much it changes; what a step is in numbers is the simulator's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Magnitude {
    /// The least of the three steps.
    Mild,
    /// Between the two.
    Middle,
    /// The most of the three steps.
    Strong,
}

impl Magnitude {
    /// Every magnitude, weakest first.
    pub const ALL: [Self; 3] = [Self::Mild, Self::Middle, Self::Strong];

    /// The name in records, events and scenario files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mild => "mild",
            Self::Middle => "middle",
            Self::Strong => "strong",
        }
    }
}

impl FromStr for Magnitude {
    type Err = UnknownName;
    fn from_str(text: &str) -> Result<Self, UnknownName> {
        read("magnitude of a drift", &Self::ALL, Self::name, text)
    }
}

impl fmt::Display for Magnitude {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A drift: what changes in the cell, and how much.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Drift {
    /// The part of the cell that changes.
    pub kind: DriftKind,
    /// How much it changes.
    pub magnitude: Magnitude,
}

impl fmt::Display for Drift {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.kind, self.magnitude)
    }
}

/// What can break in the live world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LiveFault {
    /// The link to the monitors is down: no telemetry of the arm reaches them. Guard and watcher run at the arm and
    /// still see it.
    TelemetryLost,
    /// Every camera frame is lost: skills get no new estimate of object and target.
    CameraLost,
}

impl LiveFault {
    /// Every fault, in the order of the variants.
    pub const ALL: [Self; 2] = [Self::TelemetryLost, Self::CameraLost];

    /// The name in commands, scenarios and records.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::TelemetryLost => "telemetry-lost",
            Self::CameraLost => "camera-lost",
        }
    }
}

impl FromStr for LiveFault {
    type Err = UnknownName;
    fn from_str(text: &str) -> Result<Self, UnknownName> {
        read("fault of the live world", &Self::ALL, Self::name, text)
    }
}

impl fmt::Display for LiveFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_known_is_refused_with_the_list() {
        assert_eq!("sensor-noise".parse(), Ok(DriftKind::SensorNoise));
        for kind in DriftKind::ALL {
            assert_eq!(kind.name().parse(), Ok(kind));
        }
        let unknown = "gone".parse::<DriftKind>().unwrap_err();
        assert_eq!(
            (unknown.found.as_str(), unknown.allowed),
            ("gone", DriftKind::ALL.map(DriftKind::name).join(", "))
        );
        let unknown = "much".parse::<Magnitude>().unwrap_err();
        assert_eq!(unknown.allowed, Magnitude::ALL.map(Magnitude::name).join(", "));
        let unknown = "gone".parse::<LiveFault>().unwrap_err();
        assert_eq!(unknown.allowed, LiveFault::ALL.map(LiveFault::name).join(", "));
    }
}
