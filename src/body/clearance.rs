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
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "UncheckedModel")]
pub struct ClearanceModel {
    covers: Vec<CoverCapsule>,
    /// Pairs that may meet, as indices into `covers`.
    pairs: Vec<(usize, usize)>,
    /// Covers that can come near the table: those of the third link and beyond.
    low: Vec<usize>,
}

/// The most capsules that are measured.
const COVERS_MAX: usize = 48;

/// A [`ClearanceModel`] from outside, whose indices may point nowhere.
#[derive(Deserialize)]
struct UncheckedModel {
    covers: Vec<CoverCapsule>,
    pairs: Vec<(usize, usize)>,
    low: Vec<usize>,
}

impl TryFrom<UncheckedModel> for ClearanceModel {
    type Error = String;
    fn try_from(model: UncheckedModel) -> Result<Self, String> {
        let UncheckedModel { covers, pairs, low } = model;
        if covers.len() > COVERS_MAX {
            return Err(format!(
                "{} capsules cover the robot; at most {COVERS_MAX} are measured",
                covers.len()
            ));
        }
        let named = pairs.iter().flat_map(|(i, j)| [*i, *j]).chain(low.iter().copied());
        match named.max() {
            Some(index) if index >= covers.len() => {
                Err(format!("capsule {index} is named; there are {}", covers.len()))
            }
            Some(_) | None => Ok(Self { covers, pairs, low }),
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn model_from_outside_names_only_capsules_that_it_has() {
        let cover =
            CoverCapsule { link: 1, a: Vector3::zeros(), b: Vector3::zeros(), radius: 0.1, around: 0.1 };
        let of = |pairs: Vec<(usize, usize)>, low| {
            ClearanceModel::try_from(UncheckedModel { covers: vec![cover; 3], pairs, low })
        };
        assert!(of(vec![(0, 2)], vec![1]).is_ok());
        assert!(of(vec![(0, 3)], vec![1]).unwrap_err().contains("capsule 3"));
        assert!(of(vec![], vec![7]).unwrap_err().contains("capsule 7"));
        let many = UncheckedModel { covers: vec![cover; COVERS_MAX + 1], pairs: vec![], low: vec![] };
        assert!(ClearanceModel::try_from(many).is_err());
    }
}
