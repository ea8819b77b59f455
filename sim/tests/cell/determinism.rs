//! Same seed, same bits: across repeats, threads, and a snapshot in the middle.

use holdpoint_body::{Command, TaskKind};
use holdpoint_cell::episode::{tool_down, wrap_quarter_turn, yaw_of};
use holdpoint_cell::{CellError, EpisodeSetup};
use holdpoint_sim::{Fidelity, RobotModel, World, WorldConfig};

use crate::script::{arm, fingers, scene, world};

/// A lively episode: motion, contact, noise, latency, a push; so low at first that the fingers come onto the object.
fn run(world: &mut World, seed: u64, from: u64, to: u64) -> Vec<u64> {
    let mut hashes = Vec::new();
    for tick in from..to {
        let (object, _) = world.object();
        let at = world.setup().object.pose.isometry();
        let above = |z| tool_down(at.translation.x, at.translation.y, z, wrap_quarter_turn(yaw_of(&at)));
        let command = match tick {
            0 => arm(&above(0.012), 0.6),
            280 => arm(&above(0.03), 0.3),
            340 => fingers(0.0, 30.0),
            420 => arm(&above(0.2), 0.3),
            _ => Command::Hold,
        };
        assert!(object.translation.z.is_finite(), "seed {seed}");
        world.step(&command).expect("step");
        if tick % 50 == 49 {
            hashes.push(world.state_hash());
        }
    }
    hashes
}

fn setup(seed: u64) -> EpisodeSetup {
    EpisodeSetup::sample(TaskKind::Grasp, &scene(), &holdpoint_sim::published::live().expect("live"), seed)
}

#[test]
fn repeated_and_parallel_runs_are_equal() {
    let mut first = world("arm7");
    first.reset(&setup(5)).expect("reset");
    let reference = run(&mut first, 5, 0, 600);
    // Another episode in between must leave nothing behind.
    first.reset(&setup(6)).expect("reset");
    let other = run(&mut first, 6, 0, 600);
    assert_ne!(other, reference);
    first.reset(&setup(5)).expect("reset");
    assert_eq!(run(&mut first, 5, 0, 600), reference);
    let threads: Vec<_> = (0..3)
        .map(|_| {
            std::thread::spawn(|| {
                let mut world = world("arm7");
                world.reset(&setup(5)).expect("reset");
                run(&mut world, 5, 0, 600)
            })
        })
        .collect();
    for thread in threads {
        assert_eq!(thread.join().expect("no panic"), reference);
    }
}

#[test]
fn a_restored_world_continues_bit_for_bit() {
    for at in [0, 137, 350, 450] {
        let mut whole = world("arm7");
        whole.reset(&setup(9)).expect("reset");
        run(&mut whole, 9, 0, at);
        let bytes = whole.snapshot().expect("snapshot");
        let observation = whole.observe().clone();
        let expected = run(&mut whole, 9, at, 600);
        let mut resumed = world("arm7");
        resumed.restore(&bytes).expect("restore");
        assert_eq!(*resumed.observe(), observation);
        assert_eq!(resumed.snapshot().expect("snapshot"), bytes, "written again it is the same");
        assert_eq!(run(&mut resumed, 9, at, 600), expected, "from tick {at}");
        assert_eq!(resumed.telemetry(), whole.telemetry());
        assert_eq!(resumed.observe(), whole.observe());
    }
}

fn of(fidelity: Fidelity) -> World {
    let robot = RobotModel::builtin("arm7").expect("the robot parses");
    World::with_config(&robot, &scene(), WorldConfig { fidelity }).expect("it builds")
}

#[test]
fn a_world_restored_around_an_owner_change_continues_bit_for_bit() {
    // Where the physics engine is left, where it takes over, and the ticks before and after.
    let mut world = of(Fidelity::Reduced);
    world.reset(&setup(9)).expect("reset");
    let mut changes = Vec::new();
    for tick in 0..600 {
        let before = world.engine_rests();
        run(&mut world, 9, tick, tick + 1);
        if world.engine_rests() != before {
            changes.push(tick + 1);
        }
    }
    assert!(changes.len() >= 3, "{changes:?}");
    let mut again = of(Fidelity::Reduced);
    again.reset(&setup(9)).expect("reset");
    run(&mut again, 9, 0, 600);
    assert_eq!(again.state_hash(), world.state_hash(), "the same bits twice");
    for change in changes.iter().take(8) {
        for at in change - 1..=change + 1 {
            let mut whole = of(Fidelity::Reduced);
            whole.reset(&setup(9)).expect("reset");
            run(&mut whole, 9, 0, at);
            let bytes = whole.snapshot().expect("snapshot");
            // Restored into a world that was made for another effort.
            let mut resumed = of(Fidelity::Single);
            resumed.restore(&bytes).unwrap_or_else(|error| panic!("tick {at}: {error}"));
            assert_eq!(resumed.snapshot().expect("snapshot"), bytes, "written again it is the same");
            run(&mut resumed, 9, at, 600);
            assert_eq!(resumed.state_hash(), world.state_hash(), "from tick {at}");
            run(&mut whole, 9, at, 600);
            assert_eq!(resumed.observe(), whole.observe());
        }
    }
}

#[test]
fn every_command_in_flight_survives_a_snapshot() {
    let home = crate::script::world("arm7").robot().home.clone();
    let commands = [
        arm(&holdpoint_cell::episode::tool_down(0.5, 0.0, 0.2, 0.0), 0.3),
        Command::Joints { q: home, max_speed_rad_s: 0.5 },
        fingers(0.03, 20.0),
        Command::Stop,
        Command::Done,
        Command::Fail { signal: holdpoint_body::FailureSignal::GraspMissed },
    ];
    for command in commands {
        let mut setup = setup(9);
        (setup.action.latency_ticks, setup.action.jitter_ticks) = (6.0, 0.0);
        let mut whole = world("arm7");
        whole.reset(&setup).expect("reset");
        whole.step(&command).expect("step");
        let bytes = whole.snapshot().expect("snapshot");
        let mut resumed = world("arm7");
        resumed.restore(&bytes).unwrap_or_else(|error| panic!("{command:?}: {error}"));
        for _ in 0..60 {
            whole.step(&Command::Hold).expect("step");
            resumed.step(&Command::Hold).expect("step");
        }
        assert_eq!(resumed.state_hash(), whole.state_hash(), "{command:?}");
    }
}

#[test]
fn a_foreign_snapshot_is_refused_and_changes_nothing() {
    let mut world = world("arm7");
    let before = world.state_hash();
    let foreign = crate::script::world("arm6").snapshot().expect("snapshot");
    let whole = world.snapshot().expect("snapshot");
    for bytes in [&foreign[..], &whole[..whole.len() / 2], b"", b"not a snapshot"] {
        assert!(matches!(world.restore(bytes), Err(CellError::Snapshot(_))));
        assert_eq!(world.state_hash(), before);
    }
}

#[test]
fn disturbances_do_not_depend_on_the_commands() {
    let mut observations = Vec::new();
    for command in [Command::Hold, arm(&holdpoint_cell::episode::tool_down(0.4, 0.1, 0.4, 0.3), 0.5)] {
        let mut world = world("arm7");
        let mut setup = setup(12);
        setup.pushes.clear();
        world.reset(&setup).expect("reset");
        let mut seen = Vec::new();
        for _ in 0..200 {
            world.step(&command).expect("step");
            let o = world.observe();
            // The tray does not move, so its measurement is bias and noise alone.
            seen.push((o.target().copied(), world.telemetry().picture_age_ticks));
        }
        observations.push(seen);
    }
    assert_eq!(observations[0], observations[1]);
}
