//! The cheaper solver modes come to the same outcomes as the reference.

use holdpoint_body::TaskKind;
use holdpoint_cell::EpisodeSetup;
use holdpoint_sim::bench_episode::{PeerBench, PeerOutcome};
use holdpoint_sim::{Fidelity, RobotModel, World, WorldConfig};

use crate::script::{align, canonical, grasp, place, scene};

/// What a scripted sequence came to.
struct SequenceOutcome {
    done: [bool; 3],
    grip_n: f64,
    slip_m: f64,
    object: [f64; 3],
}

fn sequence(world: &mut World, seed: u64) -> SequenceOutcome {
    world.reset(&EpisodeSetup::sample(TaskKind::Grasp, &scene(), &canonical(), seed)).expect("reset");
    grasp(world);
    let grasped = world.task_succeeded();
    let held = world.truth();
    world.begin_task(TaskKind::Align);
    align(world);
    let aligned = world.task_succeeded();
    world.begin_task(TaskKind::Place);
    place(world);
    SequenceOutcome {
        done: [grasped, aligned, world.task_succeeded()],
        grip_n: held.forces.grip_n(),
        slip_m: held.slip_m.unwrap_or(f64::NAN),
        object: world.truth().object.position,
    }
}

#[test]
fn cheaper_fidelities_have_the_outcomes_of_the_reference() {
    let world = |fidelity| {
        let robot = RobotModel::builtin("arm7").expect("the robot parses");
        World::with_config(&robot, &scene(), WorldConfig { fidelity }).expect("the world builds")
    };
    let mut reference = world(Fidelity::Reference);
    let mut cheaper = [Fidelity::Full, Fidelity::Adaptive, Fidelity::Single, Fidelity::Reduced]
        .map(|fidelity| (fidelity, world(fidelity)));
    for seed in 100..106 {
        let a = sequence(&mut reference, seed);
        for (fidelity, world) in &mut cheaper {
            let b = sequence(world, seed);
            assert_eq!(a.done, b.done, "{fidelity:?}, seed {seed}");
            assert!((a.grip_n - b.grip_n).abs() < 1.0, "{fidelity:?}, {seed}: {} {} N", a.grip_n, b.grip_n);
            assert!(b.slip_m < a.slip_m + 0.001, "{fidelity:?}, {seed}: {} {} m", a.slip_m, b.slip_m);
            for (at, other) in a.object.iter().zip(&b.object) {
                assert!((at - other).abs() < 0.003, "{fidelity:?}, {seed}: {:?} {:?}", a.object, b.object);
            }
        }
    }
}

#[test]
fn the_comparison_episode_is_solved_in_every_mode() {
    for fidelity in
        [Fidelity::Reference, Fidelity::Full, Fidelity::Adaptive, Fidelity::Single, Fidelity::Reduced]
    {
        let bench = PeerBench::new(fidelity).expect("the robot parses");
        for seed in 0..8 {
            let PeerOutcome { lifted, placed, place_error_m, .. } =
                bench.run(seed).expect("the episode runs");
            assert!(lifted && placed, "{fidelity:?}, seed {seed}: {place_error_m} m");
        }
    }
}

#[test]
fn contact_points_are_known_while_the_physics_engine_rests() {
    let held = [Fidelity::Adaptive, Fidelity::Reduced].map(|fidelity| {
        let robot = RobotModel::builtin("arm7").expect("the robot parses");
        let mut world =
            World::with_config(&robot, &scene(), WorldConfig { fidelity }).expect("the world builds");
        world.reset(&EpisodeSetup::sample(TaskKind::Grasp, &scene(), &canonical(), 3)).expect("reset");
        grasp(&mut world);
        assert_eq!(world.engine_rests(), fidelity == Fidelity::Reduced);
        (world.contact_points(), world.truth())
    });
    for (points, truth) in &held {
        assert_eq!(points.len(), 2, "{points:?}");
        for point in points {
            let force = point.force_n.iter().map(|part| part * part).sum::<f64>().sqrt();
            assert!((force - truth.forces.grip_n()).abs() < 1.0, "{force} of {:?}", truth.forces);
            for (at, centre) in point.at_m.iter().zip(truth.object.position) {
                assert!((at - centre).abs() < 0.03, "{points:?} {:?}", truth.object);
            }
        }
    }
    let lever = |(points, truth): &(Vec<_>, holdpoint_sim::WorldTruth), axis: usize| {
        let one: &holdpoint_cell::truth::ContactPoint = &points[0];
        one.force_n[axis].signum() * (one.at_m[axis] - truth.object.position[axis])
    };
    // The pads press the object away from themselves, so it presses each pad outward.
    for axis in 0..2 {
        assert!(held.iter().all(|of| lever(of, axis) > -1e-3), "{held:?}");
    }
}
