//! A distribution as a box: the perturbations that a search may choose instead of drawing them.

use crate::distribution::Distribution;
use crate::number::Range;

/// The axes of the box, in order; in the words of a distribution's file.
pub const AXES: [&str; 13] = [
    "object.x_m",
    "object.y_m",
    "object.yaw_rad",
    "object.mass_kg",
    "object.friction",
    "target.x_m",
    "target.y_m",
    "target.yaw_rad",
    "held.depth_m",
    "camera.delay_ms",
    "camera.sigma_m",
    "camera.drop_probability",
    "action.latency_ms",
];

/// A place in the box: a share of each axis' range, 0 to 1.
pub type EnvelopePoint = [f64; AXES.len()];

impl Distribution {
    /// The ranges of the axes, in their order.
    fn axes(&mut self) -> [&mut Range; AXES.len()] {
        let Self { object, target, held, camera, action, .. } = self;
        [
            &mut object.x_m,
            &mut object.y_m,
            &mut object.yaw_rad,
            &mut object.mass_kg,
            &mut object.friction,
            &mut target.x_m,
            &mut target.y_m,
            &mut target.yaw_rad,
            &mut held.depth_m,
            &mut camera.delay_ms,
            &mut camera.sigma_m,
            &mut camera.drop_probability,
            &mut action.latency_ms,
        ]
    }

    /// The same, with the axes' values fixed; what is drawn besides stays drawn. Shares outside 0 to 1 are taken for the
    /// nearer end: nothing outside of what the distribution declares is ever tried.
    #[must_use]
    pub fn at(&self, point: &EnvelopePoint) -> Self {
        let mut fixed = self.clone();
        for (range, share) in fixed.axes().into_iter().zip(point) {
            let share = if share.is_nan() { 0.5 } else { share.clamp(0.0, 1.0) };
            *range = Range::exactly(range.min + share * (range.max - range.min));
        }
        fixed
    }

    /// The values of a place, by axis.
    #[must_use]
    pub fn values(&self, point: &EnvelopePoint) -> [f64; AXES.len()] {
        self.at(point).axes().map(|range| range.min)
    }
}
