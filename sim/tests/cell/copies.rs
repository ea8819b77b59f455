//! A world that goes on from a copy is the world it was copied from, bit for bit.

use holdpoint_body::{Command, TaskKind};
use holdpoint_cell::episode::tool_down;
use holdpoint_cell::{CellCopy, CellError, CellFactory, EpisodeSetup, RobotCell, StateImage, TrialCell};
use holdpoint_sim::{Fidelity, RobotModel, SimFactory, World, WorldConfig};

use crate::script::{arm, fingers, scene, world};

fn made_for(fidelity: Fidelity) -> World {
    let robot = RobotModel::builtin("arm7").expect("the robot parses");
    World::with_config(&robot, &scene(), WorldConfig { fidelity }).expect("it builds")
}

fn setup(seed: u64) -> EpisodeSetup {
    EpisodeSetup::sample(TaskKind::Grasp, &scene(), &holdpoint_sim::published::live().expect("live"), seed)
}

/// A grasp and a lift with latency, noise and contact; the hash after each tick.
fn work(world: &mut World, ticks: std::ops::Range<u64>) -> Vec<u64> {
    let object = world.setup().object.pose.isometry().translation;
    let hashed = |tick| {
        let command = match tick {
            0 => arm(&tool_down(object.x, object.y, 0.03, 0.0), 0.6),
            300 => fingers(0.0, 30.0),
            400 => arm(&tool_down(object.x, object.y, 0.2, 0.0), 0.3),
            _ => Command::Hold,
        };
        world.step(&command).expect("step");
        world.state_hash()
    };
    ticks.map(hashed).collect()
}

#[test]
fn world_continues_from_a_copy_bit_for_bit() {
    for fidelity in [Fidelity::Full, Fidelity::Adaptive, Fidelity::Reduced] {
        // 301 and 405: with a command under way.
        for at in [0, 1, 120, 299, 301, 352, 405, 470] {
            let mut whole = made_for(fidelity);
            whole.reset(&setup(9)).expect("reset");
            work(&mut whole, 0..at);
            let copy = whole.copy();
            assert_eq!(copy.tick(), at);
            let expected = work(&mut whole, at..560);
            // Into a world that was made for another effort and has worked another episode.
            let mut other = world("arm7");
            other.reset(&setup(4)).expect("reset");
            work(&mut other, 0..80);
            for time in ["first", "second"] {
                other.go_on_from(&copy).expect("the same robot");
                assert_eq!(work(&mut other, at..560), expected, "{fidelity:?} from {at}, the {time} time");
                assert_eq!(other.telemetry(), whole.telemetry());
                assert_eq!(other.observe(), whole.observe());
            }
        }
    }
}

#[test]
fn a_copy_of_another_robot_is_refused_and_changes_nothing() {
    let mut own = world("arm7");
    let before = own.state_hash();
    let foreign = world("arm6").copy();
    assert!(matches!(own.go_on_from(&foreign), Err(CellError::Snapshot(_))));
    assert_eq!(own.state_hash(), before);
}

fn hashes(cell: &mut dyn TrialCell, ticks: u64) -> Vec<u64> {
    let step = |_| {
        cell.step(&Command::Hold).expect("step");
        cell.as_any().downcast_ref::<World>().expect("a simulated cell").state_hash()
    };
    (0..ticks).map(step).collect()
}

#[test]
fn trial_cell_continues_from_memory_and_from_bytes_bit_for_bit() {
    let factory = SimFactory::new(RobotModel::builtin("arm7").expect("parses")).expect("the scene parses");
    let mut live = world("arm7");
    live.reset(&setup(9)).expect("reset");
    work(&mut live, 0..405);
    let in_memory = RobotCell::copy(&live).expect("it can");
    let sent = live.export().expect("it can");
    let received = StateImage::received(sent.bytes().to_vec(), sent.digest()).expect("unchanged");
    let expected = hashes(&mut live, 120);
    for copy in [in_memory, CellCopy::of_image(405, received)] {
        let mut twin = factory.trial().expect("it builds");
        twin.reset(&setup(4)).expect("reset");
        hashes(twin.as_mut(), 30);
        twin.go_on_from(&copy).expect("the same robot");
        assert_eq!((copy.tick(), twin.tick()), (405, 405));
        assert_eq!(hashes(twin.as_mut(), 120), expected);
    }
}

#[test]
fn foreign_state_is_refused_and_changes_nothing() {
    let mut own = world("arm7");
    let before = own.state_hash();
    let other_robot = RobotCell::copy(&world("arm6")).expect("it can");
    let no_state = CellCopy::of_image(0, StateImage::new(vec![1, 2, 3]).expect("short"));
    for copy in [other_robot, no_state, CellCopy::in_memory(0, "of another cell")] {
        assert!(matches!(TrialCell::go_on_from(&mut own, &copy), Err(CellError::Snapshot(_))));
        assert_eq!(own.state_hash(), before);
    }
}
