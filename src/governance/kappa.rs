//! A compatibility score.

use serde::{Deserialize, Serialize};

/// A compatibility value in [0, 1]; a number that is not finite cannot become one.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(try_from = "f64", into = "f64")]
pub struct Kappa(f64);

/// A number outside [0, 1], or not a number.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0} is not a compatibility value; 0 to 1 is allowed")]
pub struct KappaError(pub f64);

impl Kappa {
    /// Wraps a value in [0, 1]; `None` for anything else.
    #[must_use]
    pub fn new(value: f64) -> Option<Self> {
        (value.is_finite() && (0.0..=1.0).contains(&value)).then_some(Self(value))
    }

    /// Clamps a finite value into [0, 1]; `None` if it is not finite.
    #[must_use]
    pub fn clamped(value: f64) -> Option<Self> {
        value.is_finite().then(|| Self(value.clamp(0.0, 1.0)))
    }

    /// The value, finite and within [0, 1].
    #[must_use]
    pub const fn get(self) -> f64 {
        self.0
    }
}

impl TryFrom<f64> for Kappa {
    type Error = KappaError;
    fn try_from(value: f64) -> Result<Self, KappaError> {
        Self::new(value).ok_or(KappaError(value))
    }
}

impl From<Kappa> for f64 {
    fn from(kappa: Kappa) -> Self {
        kappa.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kappa_outside_0_to_1_is_refused() {
        for (value, ok) in
            [(0.0, true), (1.0, true), (0.5, true), (-0.1, false), (1.1, false), (f64::NAN, false)]
        {
            assert_eq!(Kappa::new(value).is_some(), ok, "{value}");
        }
        assert_eq!(Kappa::clamped(1.7), Kappa::new(1.0));
        assert_eq!(Kappa::clamped(f64::INFINITY), None);
    }
}
