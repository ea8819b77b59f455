//! The moving scene: arm, gripper, object, contacts, the tool's path, and the candidate's twin as a ghost.

use rerun::archetypes::{Arrows3D, Boxes3D, Capsules3D, Clear, LineStrips3D, Points3D};
use rerun::components::{Color, RotationQuat};
use rerun::datatypes::Quaternion;

use super::{Drawing, Trail, theme};
use crate::limits::{GRID_PER_M, PATH_POINTS_MAX, PATH_STEP_M};
use crate::rows::RowTime;
use holdpoint_protocol::video_frame::{
    ArmView, BlockRole, Contact, Orientation, SceneBlock, VideoFrame, WorldPoint,
};

/// Whether a body is the robot or the ghost of its twin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BodyRole {
    Live,
    Twin,
}

impl BodyRole {
    /// Its entity path.
    pub const fn root(self) -> &'static str {
        match self {
            Self::Live => "world",
            Self::Twin => "world/twin",
        }
    }

    /// Thickness of its links, m. The ghost is slightly thicker, so that equal surfaces do not flicker.
    pub const fn link_m(self) -> f32 {
        match self {
            Self::Live => 0.032,
            Self::Twin => 0.034,
        }
    }

    /// Factor of its boxes' size.
    const fn swell(self) -> f32 {
        match self {
            Self::Live => 1.0,
            Self::Twin => 1.04,
        }
    }
}

/// Half the size of a finger's pad, m: drawn, not simulated.
const PAD_HALF_M: [f32; 3] = [0.012, 0.005, 0.018];

/// Length of a contact's arrow, m for 1 N, and the longest.
const ARROW_M_PER_N: f32 = 0.008;
const ARROW_MAX_M: f32 = 0.25;

/// The force, in N, that is drawn in the strongest color.
const STRONG_N: f32 = 20.0;

/// A point on the grid.
pub fn on_grid(point: WorldPoint) -> WorldPoint {
    point.map(|value| (value * GRID_PER_M).round() / GRID_PER_M)
}

impl Drawing {
    pub(super) fn draw_world(&mut self, frame: &VideoFrame, time: &RowTime) {
        self.draw_body(&frame.body, BodyRole::Live, frame, time);
        self.draw_contacts(&frame.contacts, time);
        if self.blocks_sequence != Some(frame.sequence) {
            self.draw_blocks(&frame.blocks, time);
        }
        match &frame.twin {
            Some(twin) => {
                self.twin_shown = true;
                self.draw_body(&twin.body, BodyRole::Twin, frame, time);
            }
            None if self.twin_shown => {
                self.twin_shown = false;
                self.rows.at("world/twin", time, &Clear::new(true));
            }
            None => {}
        }
    }

    /// Tray and clutter, which keep their place for a sequence.
    fn draw_blocks(&mut self, blocks: &[SceneBlock], time: &RowTime) {
        let colors = blocks.iter().map(|block| {
            theme::solid(match block.role {
                BlockRole::Tray => [74, 124, 176],
                BlockRole::Clutter => [148, 112, 84],
            })
        });
        let boxes = Boxes3D::update_fields()
            .with_half_sizes(blocks.iter().map(|block| block.half_m))
            .with_centers(blocks.iter().map(|block| on_grid(block.at)))
            .with_quaternions(blocks.iter().map(|block| quaternion(block.turn)))
            .with_colors(colors);
        self.rows.at("world/standing", time, &boxes);
    }

    fn draw_body(&mut self, body: &ArmView, role: BodyRole, frame: &VideoFrame, time: &RowTime) {
        let root = role.root();
        let joints: Vec<WorldPoint> = body.links.iter().copied().map(on_grid).collect();
        self.rows.at(&format!("{root}/arm/links"), time, &links(&joints));
        self.rows.at(
            &format!("{root}/arm/joints"),
            time,
            &Points3D::update_fields().with_positions(joints.iter().copied()),
        );
        let pads = Boxes3D::update_fields()
            .with_half_sizes([PAD_HALF_M.map(|half| half * role.swell()); 2])
            .with_centers(body.pads.map(on_grid))
            .with_quaternions([quaternion(body.hand); 2]);
        self.rows.at(&format!("{root}/gripper"), time, &pads);
        let object = Boxes3D::update_fields()
            .with_half_sizes([[body.object_half_m * role.swell(); 3]])
            .with_centers([on_grid(body.object)])
            .with_quaternions([quaternion(body.object_turn)])
            .with_colors([object_color(role, body.held)]);
        self.rows.at(&format!("{root}/object"), time, &object);
        self.draw_path(body, role, frame, time);
    }

    fn draw_path(&mut self, body: &ArmView, role: BodyRole, frame: &VideoFrame, time: &RowTime) {
        let every_ms = self.path_every_ms;
        let [live, twin] = &mut self.trails;
        let trail = match role {
            BodyRole::Live => live,
            BodyRole::Twin => twin,
        };
        let Some(&tool) = body.links.last() else { return };
        if trail.follow(on_grid(tool), frame, every_ms) {
            let strip = LineStrips3D::update_fields().with_strips([trail.points.clone()]);
            self.rows.at(&format!("{}/path", role.root()), time, &strip);
        }
    }

    fn draw_contacts(&mut self, contacts: &[Contact], time: &RowTime) {
        let length = |contact: &Contact| contact.force_n.iter().map(|part| part * part).sum::<f32>().sqrt();
        let vectors = contacts.iter().map(|contact| {
            let newton = length(contact);
            let scale =
                if newton * ARROW_M_PER_N > ARROW_MAX_M { ARROW_MAX_M / newton } else { ARROW_M_PER_N };
            contact.force_n.map(|part| part * scale)
        });
        let colors = contacts.iter().map(|contact| {
            let strength = (length(contact) / STRONG_N).clamp(0.0, 1.0);
            heat(strength)
        });
        let arrows = Arrows3D::update_fields()
            .with_vectors(vectors)
            .with_origins(contacts.iter().map(|contact| on_grid(contact.at)))
            .with_colors(colors);
        self.rows.at("world/contacts", time, &arrows);
    }
}

impl Trail {
    /// Follows the tool; returns whether the path is due.
    fn follow(&mut self, tool: WorldPoint, frame: &VideoFrame, every_ms: u64) -> bool {
        if self.sequence != frame.sequence || self.drawn_ms.is_none() {
            *self = Self { sequence: frame.sequence, points: vec![tool], drawn_ms: Some(frame.at_ms) };
            return true;
        }
        let far = self.points.last().is_none_or(|last| {
            last.iter().zip(&tool).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt() >= PATH_STEP_M
        });
        if far {
            if self.points.len() >= PATH_POINTS_MAX {
                // From here on every other point is enough: the path keeps its shape and its bound.
                let mut index = 0_usize;
                self.points.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
            }
            self.points.push(tool);
        }
        let due = self.drawn_ms.is_none_or(|drawn| frame.at_ms >= drawn.saturating_add(every_ms));
        if due {
            self.drawn_ms = Some(frame.at_ms);
        }
        due
    }
}

/// A capsule from each joint to the next.
fn links(joints: &[WorldPoint]) -> Capsules3D {
    let pairs = || joints.iter().zip(joints.iter().skip(1));
    let along = |(from, to): (&WorldPoint, &WorldPoint)| [to[0] - from[0], to[1] - from[1], to[2] - from[2]];
    let norm = |vector: WorldPoint| vector.iter().map(|part| part * part).sum::<f32>().sqrt();
    Capsules3D::update_fields()
        // Links do not stretch: a rounded length is the same number in every row.
        .with_lengths(pairs().map(|pair| (norm(along(pair)) * 512.0).round() / 512.0))
        .with_translations(pairs().map(|(from, _)| *from))
        .with_quaternions(pairs().map(|pair| {
            let direction = along(pair);
            quaternion(turn_from_z(direction, norm(direction)))
        }))
}

/// The shortest rotation that turns z into a direction.
fn turn_from_z(direction: WorldPoint, length: f32) -> Orientation {
    if length <= f32::EPSILON {
        return holdpoint_protocol::video_frame::NO_TURN;
    }
    let [x, y, z] = direction.map(|part| part / length);
    let turn = [-y, x, 0.0, 1.0 + z];
    let norm = turn.iter().map(|part| part * part).sum::<f32>().sqrt();
    if norm < 1e-4 { [1.0, 0.0, 0.0, 0.0] } else { turn.map(|part| part / norm) }
}

fn quaternion(turn: Orientation) -> RotationQuat {
    RotationQuat::from(Quaternion::from_xyzw(turn.map(|part| (part * GRID_PER_M).round() / GRID_PER_M)))
}

fn object_color(role: BodyRole, held: bool) -> Color {
    match (role, held) {
        (BodyRole::Live, true) => theme::solid([88, 214, 120]),
        (BodyRole::Live, false) => theme::solid([226, 182, 74]),
        (BodyRole::Twin, true) => theme::ghost([150, 235, 170], 70),
        (BodyRole::Twin, false) => theme::ghost([255, 205, 120], 70),
    }
}

/// From a calm yellow to red.
fn heat(strength: f32) -> Color {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 0 and 200")]
    let green = (200.0 * (1.0 - strength)).round() as u8;
    theme::solid([255, green, 40])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn link_rotation_points_from_joint_to_joint() {
        for direction in [[0.0, 0.0, 1.0], [0.0, 0.0, -2.0], [0.3, -0.4, 0.1]] {
            let length = direction.iter().map(|part: &f32| part * part).sum::<f32>().sqrt();
            let [x, y, z, w] = turn_from_z(direction, length);
            // z turned by the quaternion.
            let turned = [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)];
            for (turned, wanted) in turned.iter().zip(direction) {
                assert!((turned - wanted / length).abs() < 1e-4, "{direction:?} gave {turned}");
            }
        }
    }

    #[test]
    fn positions_are_rounded_to_a_fine_grid() {
        let [x, y, z] = on_grid([0.123_456, -1.0, 0.000_02]);
        assert!((x - 0.123_456).abs() < 4e-5);
        assert_eq!([y, z], [-1.0, 0.0]);
    }
}
