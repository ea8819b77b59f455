//! Times one tick of a whole world (servo, physics, sensors, telemetry) by phase of a grasp.
//!
//! Usage: `tick_cost [EPISODES] [full|adaptive|single|reduced]`; thread CPU time, one JSON line.
#![expect(clippy::print_stdout, reason = "its output is its purpose")]

use holdpoint_body::{Command, Pose, TaskKind};
use holdpoint_cell::EpisodeSetup;
use holdpoint_cell::episode::{tool_down, wrap_quarter_turn, yaw_of};
use holdpoint_sim::{Fidelity, RobotModel, World, WorldConfig};
use rustix::time::{ClockId, clock_gettime};

fn cpu_secs() -> f64 {
    let t = clock_gettime(ClockId::ThreadCPUTime);
    t.tv_sec as f64 + 1e-9 * t.tv_nsec as f64
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let episodes: u64 = args.next().map_or(Ok(20), |text| text.parse())?;
    let fidelity = match args.next().as_deref() {
        None | Some("full") => Fidelity::Full,
        Some("adaptive") => Fidelity::Adaptive,
        Some("single") => Fidelity::Single,
        Some("reduced") => Fidelity::Reduced,
        Some(other) => return Err(format!("mode \"{other}\"; full, adaptive, single or reduced").into()),
    };
    let (scene, distribution) = (holdpoint_sim::published::scene()?, holdpoint_sim::published::sandbox()?);
    let mut world = World::with_config(&RobotModel::builtin("arm7")?, &scene, WorldConfig { fidelity })?;
    let names = ["reset", "approach", "descend", "close", "lift"];
    let mut spent = [0.0; 5];
    let mut ticks = [0_u32; 5];
    let mut lifted = 0;
    for seed in 0..episodes {
        let setup = EpisodeSetup::sample(TaskKind::Grasp, &scene, &distribution, seed);
        let before = cpu_secs();
        world.reset(&setup)?;
        spent[0] += cpu_secs() - before;
        ticks[0] += 1;
        for (phase, count) in [(1, 480), (2, 300), (3, 120), (4, 300)] {
            let object = world.object().0;
            let (p, yaw) = (object.translation, wrap_quarter_turn(yaw_of(&object)));
            let arm = |z, speed| Command::ToolPose {
                pose: Pose::from(&tool_down(p.x, p.y, z, yaw)),
                max_speed_m_s: speed,
            };
            let command = match phase {
                1 => arm(0.15, 0.5),
                2 => arm(0.028, 0.2),
                3 => Command::Gripper { width_m: 0.0, speed_m_s: 0.1, force_n: 30.0 },
                _ => arm(0.18, 0.2),
            };
            let before = cpu_secs();
            for tick in 0..count {
                world.step(if tick == 0 { &command } else { &Command::Hold })?;
                std::hint::black_box(world.telemetry());
            }
            spent[phase] += cpu_secs() - before;
            ticks[phase] += count;
        }
        lifted += u32::from(world.task_succeeded());
    }
    let per_tick: Vec<String> = (0..5)
        .map(|i| format!("\"{}_us\": {:.1}", names[i], 1e6 * spent[i] / f64::from(ticks[i].max(1))))
        .collect();
    let all: f64 = spent.iter().skip(1).sum();
    let count: u32 = ticks.iter().skip(1).sum();
    println!(
        "{{\"mode\": \"{fidelity:?}\", \"episodes\": {episodes}, \"lifted\": {lifted}, {}, \"mean_tick_us\": {:.1}, \"snapshot_bytes\": {}}}",
        per_tick.join(", "),
        1e6 * all / f64::from(count.max(1)),
        world.snapshot()?.len(),
    );
    Ok(())
}
