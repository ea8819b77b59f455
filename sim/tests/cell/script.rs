//! Scripted work from true poses: what a perfect skill would do, to exercise the world.

use holdpoint_body::{Command, Pose};
use holdpoint_sim::episode::{tool_down, upright, wrap_quarter_turn, yaw_of};
use holdpoint_sim::{Distribution, RobotModel, Scene, World};
use nalgebra::Isometry3;

pub fn scene() -> Scene {
    Scene::cell().expect("the scene parses")
}

pub fn world(robot: &str) -> World {
    World::new(&RobotModel::builtin(robot).expect("the robot parses"), &scene()).expect("the world builds")
}

pub fn canonical() -> Distribution {
    Distribution::canonical().expect("the distribution parses")
}

/// Gives a command once and lets it act for some ticks.
pub fn act(world: &mut World, command: &Command, ticks: u32) {
    world.step(command).expect("step");
    for _ in 1..ticks {
        world.step(&Command::Hold).expect("step");
    }
}

pub fn arm(pose: &Isometry3<f64>, max_speed_m_s: f64) -> Command {
    Command::ToolPose { pose: Pose::from(pose), max_speed_m_s }
}

pub fn fingers(width_m: f64, force_n: f64) -> Command {
    Command::Gripper { width_m, speed_m_s: 0.1, force_n }
}

/// Hover, descend, close, lift.
pub fn grasp(world: &mut World) {
    let (object, _) = world.object();
    let p = object.translation.vector;
    let yaw = wrap_quarter_turn(yaw_of(&object));
    act(world, &arm(&tool_down(p.x, p.y, 0.15, yaw), 0.5), 480);
    act(world, &arm(&tool_down(p.x, p.y, 0.028, yaw), 0.2), 300);
    act(world, &fingers(0.0, 30.0), 150);
    act(world, &arm(&tool_down(p.x, p.y, 0.18, yaw), 0.2), 360);
}

/// Brings the held object `height_m` above its seat, square to the tray.
pub fn bring_over_tray(world: &mut World, height_m: f64, speed_m_s: f64, ticks: u32) {
    let truth = world.truth();
    let (tool, object, target) = (truth.tool.isometry(), truth.object.isometry(), truth.target.isometry());
    let turn = wrap_quarter_turn(yaw_of(&target) - yaw_of(&object));
    let t = target.translation.vector;
    let height = t.z + world.scene().object.half_m + height_m;
    let goal = upright(t.x, t.y, height, yaw_of(&object) + turn);
    let command = arm(&(goal * (tool.inverse() * object).inverse()), speed_m_s);
    act(world, &command, ticks);
}

pub fn align(world: &mut World) {
    let hover = world.scene().tolerance.hover_m;
    bring_over_tray(world, hover, 0.3, 480);
    bring_over_tray(world, hover, 0.1, 120);
}

/// Lower, open, retreat.
pub fn place(world: &mut World) {
    bring_over_tray(world, 0.001, 0.1, 300);
    act(world, &fingers(0.07, 30.0), 120);
    let mut up = world.truth().tool.isometry();
    up.translation.z += 0.12;
    act(world, &arm(&up, 0.2), 240);
}
