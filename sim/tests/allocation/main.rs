//! Ticks in which the physics engine rests take nothing from the allocator.
#![allow(clippy::expect_used, clippy::print_stdout, reason = "a test says what it expects by failing")]

use allocation_counter::measure;
use holdpoint_body::{Command, Pose, TaskKind};
use holdpoint_cell::EpisodeSetup;
use holdpoint_cell::episode::{tool_down, wrap_quarter_turn, yaw_of};
use holdpoint_sim::{Fidelity, RobotModel, World, WorldConfig};

/// Ticks and allocations of a scripted grasp: without the engine, with it.
fn grasp(fidelity: Fidelity) -> [(u64, u64); 2] {
    let (robot, scene) =
        (RobotModel::builtin("arm7").expect("parses"), holdpoint_sim::published::scene().expect("parses"));
    let mut world = World::with_config(&robot, &scene, WorldConfig { fidelity }).expect("it builds");
    let distribution = holdpoint_sim::published::canonical().expect("parses");
    let setup = EpisodeSetup::sample(TaskKind::Grasp, &scene, &distribution, 7);
    world.reset(&setup).expect("a valid start");
    let at = world.object().0;
    let yaw = wrap_quarter_turn(yaw_of(&at));
    let arm = |z, speed| Command::ToolPose {
        pose: Pose::from(&tool_down(at.translation.x, at.translation.y, z, yaw)),
        max_speed_m_s: speed,
    };
    let close = Command::Gripper { width_m: 0.0, speed_m_s: 0.1, force_n: 30.0 };
    let work = [(arm(0.15, 0.5), 480), (arm(0.028, 0.2), 300), (close, 150), (arm(0.18, 0.2), 360)];
    let mut seen = [(0, 0); 2];
    for (command, ticks) in work {
        for tick in 0..ticks {
            let command = if tick == 0 { &command } else { &Command::Hold };
            let rested = world.engine_rests();
            let taken = measure(|| {
                world.step(command).expect("step");
                std::hint::black_box(world.telemetry());
            });
            // Where the state changed hands, the tick was the engine's.
            let engine = !(rested && world.engine_rests());
            let row = &mut seen[usize::from(engine)];
            (row.0, row.1) = (row.0 + 1, row.1 + taken.count_total);
        }
    }
    assert!(world.task_succeeded());
    seen
}

#[test]
fn ticks_without_the_physics_engine_allocate_nothing() {
    let [(ticks, allocations), with_engine] = grasp(Fidelity::Reduced);
    println!(
        "without the engine: {allocations} in {ticks} ticks; with it (ticks, allocations): {with_engine:?}"
    );
    assert!(ticks > 900, "{ticks} ticks");
    assert_eq!(allocations, 0);
    for fidelity in [Fidelity::Full, Fidelity::Adaptive, Fidelity::Single] {
        println!("{fidelity:?} (ticks, allocations): {:?}", grasp(fidelity)[1]);
    }
}
