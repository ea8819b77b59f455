//! How far the arm is from the table plane and from itself, from geometry alone.
//!
//! Cheap enough for every tick of a runtime guard, and independent of the physics engine. Shapes
//! are covered by capsules: exact for capsules and balls, slightly larger for boxes and cylinders.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::chain::{Chain, Frames, Transform};
use crate::shape::Shape;

/// Distances in m; negative means inside.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Clearance {
    /// Lowest point of the moving arm (fingers open) above the table plane z = 0.
    pub table_m: f64,
    /// Closest two parts of the robot that may meet.
    pub self_m: f64,
}

/// A capsule on a piece of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
struct CoverCapsule {
    /// 0 is the base, `i` the link of joint `i - 1`.
    link: usize,
    a: Vector3<f64>,
    b: Vector3<f64>,
    radius: f64,
    /// Radius of the ball around it, m.
    around: f64,
}

/// The capsules that cover a robot, and the pairs of them that may meet.
#[derive(Clone, Debug, PartialEq)]
pub struct ClearanceModel {
    covers: Vec<CoverCapsule>,
    /// Pairs that may meet, as indices into `covers`.
    pairs: Vec<(usize, usize)>,
    /// Covers that can come near the table: those of the third link and beyond.
    low: Vec<usize>,
}

impl ClearanceModel {
    /// From the shapes on the robot: the piece each is on (0 is the base, `i` the link of joint `i - 1`), its pose in
    /// that piece's frame, and the shape. Pairs that are adjacent, or that already touch in the home pose, are left out.
    pub fn new(
        chain: &Chain,
        shapes: impl IntoIterator<Item = (usize, Transform, Shape)>,
        home: &[f64],
    ) -> Self {
        let covers: Vec<_> = shapes.into_iter().map(|(link, at, shape)| cover(link, &at, &shape)).collect();
        let frames = chain.frames(home);
        let placed: Vec<_> = covers.iter().map(|c| place(c, &frames)).collect();
        let mut pairs = Vec::new();
        for i in 0..covers.len() {
            for j in i + 1..covers.len() {
                let apart = covers[i].link.abs_diff(covers[j].link);
                if apart > 1 && distance(&placed[i], &placed[j], &covers[i], &covers[j]) > 0.0 {
                    pairs.push((i, j));
                }
            }
        }
        let low = (0..covers.len()).filter(|i| covers[*i].link >= 3).collect();
        Self { covers, pairs, low }
    }

    /// Distances for joint angles in rad, base first.
    #[must_use]
    pub fn measure(&self, chain: &Chain, q: &[f64]) -> Clearance {
        let frames = chain.frames(q);
        self.measure_frames(&frames)
    }

    /// Ends of the covers of every moving piece.
    pub fn points<'a>(&'a self, frames: &'a Frames) -> impl Iterator<Item = [f64; 3]> + 'a {
        self.covers.iter().filter(|cover| cover.link > 0).flat_map(move |cover| {
            let (a, b) = place(cover, frames);
            [a.into(), b.into()]
        })
    }

    /// Distances for frames already computed, m.
    #[must_use]
    pub fn measure_frames(&self, frames: &Frames) -> Clearance {
        const COVERS_MAX: usize = 48;
        let mut placed = [(Vector3::zeros(), Vector3::zeros()); COVERS_MAX];
        for (slot, cover) in placed.iter_mut().zip(&self.covers) {
            *slot = place(cover, frames);
        }
        let mut table_m = f64::INFINITY;
        for &i in &self.low {
            let (a, b) = placed[i];
            table_m = table_m.min(a.z.min(b.z) - self.covers[i].radius);
        }
        let mut self_m = f64::INFINITY;
        for &(i, j) in &self.pairs {
            let (a, b) = (&self.covers[i], &self.covers[j]);
            // Two balls around the capsules: where they are further apart than the closest pair so far, with room for
            // rounding, so are the capsules.
            let least = self_m + a.around + b.around + 1e-9;
            let apart = (placed[i].0 + placed[i].1) - (placed[j].0 + placed[j].1);
            if 0.25 * apart.norm_squared() > least * least {
                continue;
            }
            self_m = self_m.min(distance(&placed[i], &placed[j], a, b));
        }
        Clearance { table_m, self_m }
    }
}

/// The capsule around a shape: along its longest side, with the half diagonal of the other two as
/// radius, shortened so that the round ends stay within the corners' reach.
fn cover(link: usize, at: &Transform, shape: &Shape) -> CoverCapsule {
    let (axis, half, radius) = match *shape {
        Shape::Capsule { half_length_m, radius_m } => (2, half_length_m, radius_m),
        Shape::Cylinder { half_length_m, radius_m } => (2, half_length_m, radius_m),
        Shape::Ball { radius_m } => (2, 0.0, radius_m),
        Shape::Cuboid { half_m } => {
            let axis = (0..3).fold(0, |best, i| if half_m[i] > half_m[best] { i } else { best });
            let (u, v) = (half_m[(axis + 1) % 3], half_m[(axis + 2) % 3]);
            let radius = libm::sqrt(u * u + v * v);
            (axis, (half_m[axis] - 0.5 * radius).max(0.0), radius)
        }
    };
    let mut along = Vector3::zeros();
    along[axis] = half;
    CoverCapsule { link, a: at.point(&-along), b: at.point(&along), radius, around: along.norm() + radius }
}

fn place(cover: &CoverCapsule, frames: &Frames) -> (Vector3<f64>, Vector3<f64>) {
    match cover.link.checked_sub(1).and_then(|i| frames.links.get(i)) {
        None => (cover.a, cover.b),
        Some(frame) => (frame.point(&cover.a), frame.point(&cover.b)),
    }
}

type Segment = (Vector3<f64>, Vector3<f64>);

fn distance(p: &Segment, q: &Segment, a: &CoverCapsule, b: &CoverCapsule) -> f64 {
    libm::sqrt(segment_distance2(p, q)) - a.radius - b.radius
}

/// Squared distance of two segments (Ericson, Real-Time Collision Detection, 5.1.9).
fn segment_distance2(p: &Segment, q: &Segment) -> f64 {
    let (d1, d2, r) = (p.1 - p.0, q.1 - q.0, p.0 - q.0);
    let (a, e, f) = (d1.norm_squared(), d2.norm_squared(), d2.dot(&r));
    const TINY: f64 = 1e-12;
    let (s, t) = if a <= TINY && e <= TINY {
        (0.0, 0.0)
    } else if a <= TINY {
        (0.0, (f / e).clamp(0.0, 1.0))
    } else {
        let c = d1.dot(&r);
        if e <= TINY {
            ((-c / a).clamp(0.0, 1.0), 0.0)
        } else {
            let b = d1.dot(&d2);
            let denominator = a * e - b * b;
            let s = if denominator > TINY { ((b * f - c * e) / denominator).clamp(0.0, 1.0) } else { 0.0 };
            let t = (b * s + f) / e;
            if t < 0.0 {
                ((-c / a).clamp(0.0, 1.0), 0.0)
            } else if t > 1.0 {
                (((b - c) / a).clamp(0.0, 1.0), 1.0)
            } else {
                (s, t)
            }
        }
    };
    (r + d1 * s - d2 * t).norm_squared()
}
