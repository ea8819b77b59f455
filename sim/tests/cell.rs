//! A scripted pick through the public boundary, on both arms.

use holdpoint_sim::episode::{tool_down, wrap_quarter_turn, yaw_of};
use holdpoint_sim::io::{Command, Pose, TaskKind};
use holdpoint_sim::{Distribution, EpisodeSetup, RobotModel, Scene, World};

/// Drives a grasp by true object pose: hover, descend, close, lift.
fn scripted_grasp(world: &mut World) -> bool {
    let truth = world.truth();
    let object = truth.object.isometry();
    let yaw = wrap_quarter_turn(yaw_of(&object));
    let p = object.translation.vector;
    let pose = |z: f64| Pose::from(&tool_down(p.x, p.y, z, yaw));
    let arm = |z: f64, speed: f64| Command::ToolPose { pose: pose(z), max_speed_m_s: speed };
    let script = [
        (480, arm(0.15, 0.5)),
        (300, arm(0.028, 0.2)),
        (200, Command::Gripper { width_m: 0.0, speed_m_s: 0.1, force_n: 30.0 }),
        (400, arm(0.18, 0.2)),
    ];
    for (ticks, command) in script {
        for tick in 0..ticks {
            let command = if tick == 0 { command.clone() } else { Command::Hold };
            world.step(&command).expect("step");
        }
    }
    world.task_succeeded()
}

#[test]
fn both_arms_lift_the_cube() {
    let scene = Scene::cell().expect("scene");
    let distribution = Distribution::canonical().expect("distribution");
    for name in ["arm7", "arm6"] {
        let robot = RobotModel::builtin(name).expect("robot");
        let mut world = World::new(&robot, &scene).expect("world");
        for seed in 0..3 {
            let setup = EpisodeSetup::sample(TaskKind::Grasp, &scene, &distribution, seed);
            world.reset(&setup).expect("reset");
            assert!(scripted_grasp(&mut world), "{name}, seed {seed}");
        }
    }
}

#[test]
fn held_starts_hold() {
    let scene = Scene::cell().expect("scene");
    let distribution = Distribution::sandbox().expect("distribution");
    let robot = RobotModel::builtin("arm7").expect("robot");
    let mut world = World::new(&robot, &scene).expect("world");
    for task in [TaskKind::Align, TaskKind::Place] {
        for seed in 0..20 {
            let setup = EpisodeSetup::sample(task, &scene, &distribution, seed);
            world.reset(&setup).expect("a valid start");
            for _ in 0..240 {
                world.step(&Command::Hold).expect("step");
            }
            let slip = world.truth().slip_m.expect("held");
            assert!(slip < 0.003, "{task:?} seed {seed}: slip {slip}");
        }
    }
}
