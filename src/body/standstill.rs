//! Whether an arm is at standstill, by its measured joint speeds alone. Decides nothing.

use std::collections::VecDeque;

use crate::messages::{JointVec, Telemetry};

/// A joint is at standstill if its mean speed is below this, rad/s: above the noise of the sensors.
const SPEED_MAX_RAD_S: f64 = 0.02;

/// Tells a standstill from joint speeds, through the sensors' noise: the mean speed of every joint over the last 50 ms is
/// low. An arm that leans on something may tremble at standstill; an arm with a missing speed is not at standstill.
#[derive(Clone, Debug, Default)]
pub struct Standstill {
    /// Speeds of the last ticks; empty for a tick without the speed of every joint.
    window: VecDeque<JointVec>,
}

impl Standstill {
    /// Ticks over which the mean is taken.
    pub const TICKS: usize = 12;

    /// Takes one tick; returns whether the arm is at standstill.
    pub fn observe(&mut self, seen: &Telemetry) -> bool {
        let is_whole = seen.dq.len() == seen.q.len();
        self.window.push_back(if is_whole { seen.dq.clone() } else { JointVec::new() });
        if self.window.len() > Self::TICKS {
            self.window.pop_front();
        }
        self.is_reached()
    }

    /// Whether the arm is at standstill.
    #[must_use]
    pub fn is_reached(&self) -> bool {
        self.window.len() == Self::TICKS && self.is_slow()
    }

    /// Whether the mean speeds of the ticks so far are those of a standstill, though there may be fewer than it takes.
    #[must_use]
    pub fn is_slow(&self) -> bool {
        let joints = self.window.iter().map(JointVec::len).max().unwrap_or(0);
        let ticks = self.window.len() as f64;
        let mean = |joint: usize| {
            let speeds = self.window.iter().map(|dq| dq.get(joint).copied().unwrap_or(f64::NAN));
            speeds.sum::<f64>().abs() / ticks
        };
        // A speed that is missing or no number makes its mean no number, which is not below the limit.
        joints > 0 && (0..joints).all(|joint| mean(joint) < SPEED_MAX_RAD_S)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{Contacts, Pose};

    /// Telemetry of an arm with three joints and these speeds.
    fn seen(dq: &[f64]) -> Telemetry {
        Telemetry {
            tick: 0,
            q: JointVec::from_iter([0.0; 3]),
            dq: dq.iter().copied().collect(),
            tracking_error_rad: 0.0,
            tool: Pose::IDENTITY,
            tool_speed_m_s: 0.0,
            gripper_width_m: 0.0,
            gripper_force_n: 0.0,
            contact_force_n: 0.0,
            contacts: Contacts::default(),
            slip_m: None,
            picture_age_ticks: None,
            tool_available: true,
        }
    }

    /// Whether an arm whose middle joint has this speed in each tick is at standstill in the end.
    fn stands(speed: impl Fn(usize) -> f64) -> bool {
        let mut standstill = Standstill::default();
        (0..60).fold(false, |_, tick| standstill.observe(&seen(&[0.0, speed(tick), 0.0])))
    }

    #[test]
    fn noise_of_the_sensors_is_a_standstill_and_motion_is_none() {
        let alternating = |speed: f64| move |tick: usize| if tick.is_multiple_of(2) { speed } else { -speed };
        assert!(stands(|_| 0.0));
        assert!(stands(alternating(0.06)), "it trembles in its place");
        assert!(!stands(|_| -0.05));
        assert!(!stands(|_| 0.05));
        assert!(!stands(|tick| if tick == 55 { f64::NAN } else { 0.0 }));
    }

    #[test]
    fn an_arm_with_a_missing_speed_is_not_at_standstill() {
        for missing in [&[][..], &[0.0, 0.0]] {
            let mut standstill = Standstill::default();
            assert!(!(0..60).any(|_| standstill.observe(&seen(missing))), "{missing:?}");
            assert!(!standstill.is_slow());
            let whole = seen(&[0.0; 3]);
            let ticks = (1..60).find(|_| standstill.observe(&whole));
            assert_eq!(ticks, Some(Standstill::TICKS), "every tick of the window has its speeds");
            assert!(!standstill.observe(&seen(missing)), "one tick is enough");
        }
    }
}
