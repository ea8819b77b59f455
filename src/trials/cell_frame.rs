//! How the cell looks at one moment: arm, pads and object for a screen.
//!
//! The arm is drawn from measured joint positions by the robot's own kinematics. The object is drawn where the cell
//! shows it, in a simulation where it truly is: it is for display, and nothing that decides reads it.

use holdpoint_body::chain::Transform;
use holdpoint_body::{Telemetry, Zone};
use holdpoint_cell::scene::Clutter;
use holdpoint_cell::spec::RobotSpec;
use holdpoint_cell::{RobotCell, Scene};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::video_frame::{
    ArmView, BlockRole, CONTACTS_MAX, Contact, EnvelopeView, NO_TURN, Orientation, Region, SceneBlock,
    Scenery, WorldPoint,
};
use holdpoint_runtime::agent::dispatcher::is_holding;
use holdpoint_runtime::limits;

/// Name of the zone in which the tool may be anywhere on its way.
const WORKSPACE_ZONE: &str = "transit";

/// Name of the zone round the tray.
const TRAY_ZONE: &str = "tray";

/// What does not move.
#[must_use]
pub fn scenery(scene: &Scene) -> Scenery {
    let region = |zone: &Zone| Region {
        name: zone.name.clone(),
        min: zone.min_m.map(narrow),
        max: zone.max_m.map(narrow),
    };
    let named = |name: &str| scene.zones.iter().find(|zone| zone.name == name && !zone.keep_out).map(region);
    let (centre, half) = (scene.table.centre_m, scene.table.half_m);
    let corner = |sign: f64| std::array::from_fn(|i| narrow(sign.mul_add(half[i], centre[i])));
    let table = Region { name: Region::TABLE.to_owned(), min: corner(-1.0), max: corner(1.0) };
    Scenery {
        workspace: named(WORKSPACE_ZONE).map(|zone| Region { name: "workspace".to_owned(), ..zone }),
        keep_outs: scene.zones.iter().filter(|zone| zone.keep_out).map(region).collect(),
        fixtures: std::iter::once(table).chain(named(TRAY_ZONE)).collect(),
    }
}

/// The arm as its sensors tell, with the object as it truly is.
#[must_use]
pub fn body(world: &dyn RobotCell, seen: &Telemetry) -> ArmView {
    drawn(&world.spec().robot, seen, &world.shown_object(), world.spec().scene.object.half_m)
}

/// A robot as its sensors told, with the object (half its edge in m) where it was.
#[must_use]
pub fn drawn(robot: &RobotSpec, seen: &Telemetry, object: &Isometry3<f64>, object_half_m: f64) -> ArmView {
    let frames = robot.geometry.chain.frames(&seen.q);
    let origin = |frame: &Transform| point(&frame.point(&Vector3::zeros()));
    let tool = frames.tool.point(&Vector3::zeros());
    let mut links = vec![[0.0; 3]];
    links.extend(frames.links.iter().map(origin));
    links.push(point(&tool));
    let hand = frames.links.last();
    let half_width_m = seen.gripper_width_m / 2.0;
    // Fingers slide along their own z axis, each its half of the width, from where the pads meet: the tool.
    let pad = |index: usize| {
        let finger = robot.fingers.get(index);
        let along = hand.zip(finger).map(|(hand, finger)| hand.then(finger).z());
        point(&along.map_or(tool, |along| tool + along * half_width_m))
    };
    ArmView {
        links,
        pads: [pad(0), pad(1)],
        hand: hand.map_or(NO_TURN, |hand| turn(&hand.isometry().rotation)),
        object: point(&object.translation.vector),
        object_turn: turn(&object.rotation),
        object_half_m: narrow(object_half_m),
        held: is_holding(seen),
    }
}

/// The engine's virtual time of a moment of the live cell, ms. A script's clock does not run during a sequence and
/// then advances by its length.
#[must_use]
pub fn at_ms(clock: &Clock, world: &dyn RobotCell) -> u64 {
    if !clock.is_scripted() {
        return clock.now_ms();
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "seconds of one sequence")]
    let passed_ms = (world.secs() * 1000.0) as u64;
    clock.now_ms().saturating_add(passed_ms)
}

/// The envelope that a version is held to.
#[must_use]
pub const fn envelope(of: &limits::Envelope) -> EnvelopeView {
    EnvelopeView {
        speed_m_s: narrow(of.tool_speed_max_m_s),
        force_n: narrow(of.grip_force_max_n),
        contact_n: narrow(of.contact_force_max_n),
    }
}

/// What stands in the cell in this sequence.
#[must_use]
pub fn blocks(world: &dyn RobotCell) -> Vec<SceneBlock> {
    let scene = &world.spec().scene;
    let block = |(pose, half_m): (Isometry3<f64>, [f64; 3])| SceneBlock {
        role: block_role(scene, &pose, half_m),
        at: point(&pose.translation.vector),
        half_m: half_m.map(narrow),
        turn: turn(&pose.rotation),
    };
    world.fixtures().into_iter().map(block).collect()
}

/// Clutter, if the scene has a piece of this size there; any other box is a part of the tray.
fn block_role(scene: &Scene, pose: &Isometry3<f64>, half_m: [f64; 3]) -> BlockRole {
    let at = pose.translation.vector;
    let is_piece = |piece: &Clutter| {
        let [x, y] = piece.centre_xy_m;
        piece.half_m == half_m && (at.x - x).abs() <= half_m[0] && (at.y - y).abs() <= half_m[1]
    };
    if scene.clutter.iter().any(is_piece) { BlockRole::Clutter } else { BlockRole::Tray }
}

/// What touches what, as it truly is: for display alone.
#[must_use]
pub fn contacts(world: &dyn RobotCell) -> Vec<Contact> {
    let points = world.contact_points().into_iter().take(CONTACTS_MAX);
    points.map(|point| Contact { at: point.at_m.map(narrow), force_n: point.force_n.map(narrow) }).collect()
}

fn turn(rotation: &UnitQuaternion<f64>) -> Orientation {
    [rotation.i, rotation.j, rotation.k, rotation.w].map(narrow)
}

fn point(at: &Vector3<f64>) -> WorldPoint {
    [narrow(at.x), narrow(at.y), narrow(at.z)]
}

/// A tenth of a millimeter is far below a screen's resolution; f32 holds far more.
#[allow(clippy::cast_possible_truncation, reason = "drawn only")]
#[must_use]
pub const fn narrow(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::Cell;
    use holdpoint_body::TaskKind;
    use holdpoint_cell::EpisodeSetup;
    use holdpoint_sim::SimCells;

    #[test]
    fn the_arm_is_drawn_from_base_to_tool() {
        let cell = Cell::of(&SimCells, None).unwrap();
        let world = cell.trial().unwrap();
        let seen = world.telemetry();
        let body = body(world.as_ref(), &seen);
        assert_eq!(body.links.len(), cell.spec.robot.geometry.joint_count() + 2);
        let tool = body.links.last().unwrap();
        for (i, at) in tool.iter().enumerate() {
            assert!((f64::from(*at) - seen.tool.position[i]).abs() < 1e-3, "{tool:?} {:?}", seen.tool);
        }
        let span: f32 = (0..3).map(|i| (body.pads[0][i] - body.pads[1][i]).powi(2)).sum();
        assert!((f64::from(span.sqrt()) - seen.gripper_width_m).abs() < 1e-3, "{:?}", body.pads);
        assert!(!body.held);
    }

    #[test]
    fn blocks_have_the_role_that_the_scene_gives_them() {
        let cell = Cell::of(&SimCells, None).unwrap();
        let mut setup = EpisodeSetup::sample(TaskKind::Grasp, &cell.scene, &cell.sandbox, 100);
        let pieces = u8::try_from(cell.scene.clutter.len()).unwrap();
        setup.clutter = (0..pieces).collect();
        let mut world = cell.trial().unwrap();
        world.reset(&setup).unwrap();
        let clutter: Vec<SceneBlock> =
            blocks(world.as_ref()).into_iter().filter(|block| block.role == BlockRole::Clutter).collect();
        assert!(pieces > 0 && clutter.len() == usize::from(pieces), "{clutter:?}");
        for (block, piece) in clutter.iter().zip(&cell.scene.clutter) {
            assert_eq!(block.half_m, piece.half_m.map(narrow));
        }
        // A cell names its boxes in any order, and has as many parts of a tray as it likes.
        let piece = &cell.scene.clutter[0];
        let [x, y] = piece.centre_xy_m;
        let there = Isometry3::translation(x, y, piece.half_m[2]);
        assert_eq!(block_role(&cell.scene, &there, piece.half_m), BlockRole::Clutter);
        assert_eq!(block_role(&cell.scene, &there, [0.2, 0.2, 0.01]), BlockRole::Tray);
    }

    #[test]
    fn scenery_has_workspace_fixtures_and_keep_out_zones() {
        let scenery = scenery(&Cell::of(&SimCells, None).unwrap().scene);
        assert_eq!(scenery.workspace.unwrap().name, "workspace");
        let names: Vec<&str> = scenery.fixtures.iter().map(|region| region.name.as_str()).collect();
        assert_eq!(names, ["table", "tray"]);
        assert_eq!(scenery.keep_outs.len(), 1);
        assert!(scenery.keep_outs.iter().all(|region| (0..3).all(|i| region.min[i] < region.max[i])));
    }
}
