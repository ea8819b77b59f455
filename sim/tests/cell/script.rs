//! Scripted work from true poses: what a perfect skill would do, to exercise the world.

use holdpoint_body::{Command, Pose};
use holdpoint_cell::episode::{tool_down, upright, wrap_quarter_turn, yaw_of};
use holdpoint_cell::{Distribution, Scene};
use holdpoint_sim::{RobotModel, World};
use nalgebra::Isometry3;

pub fn scene() -> Scene {
    holdpoint_sim::published::scene().expect("the scene parses")
}

pub fn world(robot: &str) -> World {
    World::new(&RobotModel::builtin(robot).expect("the robot parses"), &scene()).expect("the world builds")
}

pub fn canonical() -> Distribution {
    holdpoint_sim::published::canonical().expect("the distribution parses")
}

/// What scripted work is done on: a world, or a world that is looked at after every tick.
pub trait ScriptedWorld {
    fn tick(&mut self, command: &Command);
    fn world(&mut self) -> &mut World;
}

impl ScriptedWorld for World {
    fn tick(&mut self, command: &Command) {
        self.step(command).expect("step");
    }

    fn world(&mut self) -> &mut World {
        self
    }
}

/// Gives a command once and lets it act for some ticks.
pub fn act(cell: &mut impl ScriptedWorld, command: &Command, ticks: u32) {
    cell.tick(command);
    for _ in 1..ticks {
        cell.tick(&Command::Hold);
    }
}

pub fn arm(pose: &Isometry3<f64>, max_speed_m_s: f64) -> Command {
    Command::ToolPose { pose: Pose::from(pose), max_speed_m_s }
}

pub fn fingers(width_m: f64, force_n: f64) -> Command {
    Command::Gripper { width_m, speed_m_s: 0.1, force_n }
}

/// Hover, descend, close, lift.
pub fn grasp(cell: &mut impl ScriptedWorld) {
    let (object, _) = cell.world().object();
    let p = object.translation.vector;
    let yaw = wrap_quarter_turn(yaw_of(&object));
    act(cell, &arm(&tool_down(p.x, p.y, 0.15, yaw), 0.5), 480);
    act(cell, &arm(&tool_down(p.x, p.y, 0.028, yaw), 0.2), 300);
    act(cell, &fingers(0.0, 30.0), 150);
    act(cell, &arm(&tool_down(p.x, p.y, 0.18, yaw), 0.2), 360);
}

/// Brings the held object `height_m` above its seat, square to the tray.
pub fn bring_over_tray(cell: &mut impl ScriptedWorld, height_m: f64, speed_m_s: f64, ticks: u32) {
    let world = cell.world();
    let truth = world.truth();
    let (tool, object, target) = (truth.tool.isometry(), truth.object.isometry(), truth.target.isometry());
    let turn = wrap_quarter_turn(yaw_of(&target) - yaw_of(&object));
    let t = target.translation.vector;
    let height = t.z + world.scene().object.half_m + height_m;
    let goal = upright(t.x, t.y, height, yaw_of(&object) + turn);
    let command = arm(&(goal * (tool.inverse() * object).inverse()), speed_m_s);
    act(cell, &command, ticks);
}

pub fn align(cell: &mut impl ScriptedWorld) {
    let hover = cell.world().scene().tolerance.hover_m;
    bring_over_tray(cell, hover, 0.3, 480);
    bring_over_tray(cell, hover, 0.1, 120);
}

/// Lower, open, retreat.
pub fn place(cell: &mut impl ScriptedWorld) {
    bring_over_tray(cell, 0.001, 0.1, 300);
    act(cell, &fingers(0.07, 30.0), 120);
    let mut up = cell.world().truth().tool.isometry();
    up.translation.z += 0.12;
    act(cell, &arm(&up, 0.2), 240);
}
