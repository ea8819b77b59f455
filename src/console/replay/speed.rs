//! How fast a replay plays.

/// One of the allowed speeds, in quarters of the recorded time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Speed(u16);

/// The fastest speed, in quarters.
const MAX: u16 = 256;

impl Default for Speed {
    fn default() -> Self {
        Self(4)
    }
}

impl Speed {
    /// The speed by its factor; `None` if there is no such speed. The factors are 0.25, 0.5, 1, 2 and so on to 64.
    #[must_use]
    pub fn of(times: f64) -> Option<Self> {
        std::iter::successors(Some(Self(1)), |speed| Self(speed.0 * 2).within())
            .find(|speed| f64::from(speed.0) / 4.0 == times)
    }

    const fn within(self) -> Option<Self> {
        if self.0 >= 1 && self.0 <= MAX { Some(self) } else { None }
    }

    /// The next faster one; the fastest stays.
    #[must_use]
    pub fn faster(self) -> Self {
        Self(self.0 * 2).within().unwrap_or(self)
    }

    /// The next slower one; the slowest stays.
    #[must_use]
    pub fn slower(self) -> Self {
        Self(self.0 / 2).within().unwrap_or(self)
    }

    /// Recorded time that passes in a real time, in quarters of a ms.
    #[must_use]
    pub const fn quarters(self, real_ms: u64) -> u64 {
        real_ms.saturating_mul(self.0 as u64)
    }

    /// Real time for a recorded time, ms, rounded up.
    #[must_use]
    pub const fn real_ms(self, recorded_ms: u64) -> u64 {
        recorded_ms.saturating_mul(4).div_ceil(self.0 as u64)
    }

    /// In words: `1/4x`, `8x`.
    #[must_use]
    pub fn label(self) -> String {
        match self.0 {
            1 => "1/4x".to_owned(),
            2 => "1/2x".to_owned(),
            quarters => format!("{}x", quarters / 4),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speed_ranges_from_a_quarter_to_sixty_four() {
        let mut speed = Speed::of(0.25).unwrap();
        let mut labels = vec![speed.label()];
        while speed.faster() != speed {
            speed = speed.faster();
            labels.push(speed.label());
        }
        assert_eq!(labels, ["1/4x", "1/2x", "1x", "2x", "4x", "8x", "16x", "32x", "64x"]);
        assert_eq!(Speed::of(64.0), Some(speed));
        while speed.slower() != speed {
            speed = speed.slower();
        }
        assert_eq!(speed.label(), "1/4x");
        for times in [0.0, 0.1, 3.0, 128.0, -1.0, f64::NAN] {
            assert_eq!(Speed::of(times), None, "{times}");
        }
        assert_eq!((speed.quarters(10), speed.real_ms(10)), (10, 40));
    }
}
