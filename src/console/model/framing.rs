//! The bounds of the robot pane: everything that has moved so far, so that the scale stays the same in every
//! sequence.

use holdpoint_protocol::video_frame::VideoFrame;

/// The step to which the bounds are rounded, m: a moving arm does not change them all the time.
const STEP_M: f32 = 0.2;

/// Nothing in a cell is further away, m: a larger number is an error.
const FAR_M: f32 = 10.0;

/// Lowest and highest x, y and z that were seen, m, on the grid; they only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Framing {
    bounds: [[f32; 2]; 3],
}

impl Framing {
    /// Of one moment alone.
    #[must_use]
    pub fn of(frame: &VideoFrame) -> Self {
        let mut framing = Self::default();
        framing.see(frame);
        framing
    }

    /// Takes in a moment.
    pub fn see(&mut self, frame: &VideoFrame) {
        let arms = std::iter::once(&frame.body).chain(frame.twin.as_ref().map(|twin| &twin.body));
        let joints = arms.flat_map(|body| body.links.iter().chain(std::iter::once(&body.object)));
        joints.for_each(|joint| self.reach(*joint));
    }

    /// Takes in a point.
    pub fn reach(&mut self, point: [f32; 3]) {
        for (bound, value) in self.bounds.iter_mut().zip(point) {
            let value = if value.is_finite() { value.clamp(-FAR_M, FAR_M) } else { 0.0 };
            *bound = [
                bound[0].min((value / STEP_M).floor() * STEP_M),
                bound[1].max((value / STEP_M).ceil() * STEP_M),
            ];
        }
    }

    /// Lowest and highest x, y and z, m.
    #[must_use]
    pub const fn bounds(&self) -> [[f32; 2]; 3] {
        self.bounds
    }
}
