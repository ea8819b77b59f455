//! Further objects: named, free, pushed by the arm, and at rest where nothing touches them.

use std::collections::BTreeMap;

use holdpoint_body::{Command, FurtherObject, FurtherShape, TaskKind};
use holdpoint_cell::episode::tool_down;
use holdpoint_cell::spec::ObjectKind;
use holdpoint_cell::{CellCopy, CellError, CellFactory, EpisodeSetup, RobotCell, StateImage, TrialCell};
use holdpoint_sim::{Fidelity, RobotModel, SimFactory, World, WorldConfig};

use crate::script::{act, arm, canonical, fingers, scene};

/// Clear of workpiece, tray and clutter, wherever these are.
const LID: FurtherObject = FurtherObject {
    shape: FurtherShape::Box { half_m: [0.03, 0.02, 0.03] },
    mass_kg: 0.15,
    friction: 0.5,
    x_m: [0.48, 0.48],
    y_m: [-0.06, -0.06],
    yaw_rad: [0.0, 0.0],
    above_table_m: 0.0,
};

fn declared(list: &[(&str, FurtherObject)]) -> BTreeMap<String, FurtherObject> {
    list.iter().map(|(name, object)| ((*name).to_owned(), *object)).collect()
}

fn world(fidelity: Fidelity, list: &[(&str, FurtherObject)]) -> World {
    let robot = RobotModel::builtin("arm7").expect("the robot parses");
    let mut world = World::with_objects(&robot, &scene(), &declared(list), WorldConfig { fidelity })
        .expect("the world builds");
    world.reset(&EpisodeSetup::sample(TaskKind::Grasp, &scene(), &canonical(), 5)).expect("it starts");
    world
}

fn hold(world: &mut World, ticks: u32) {
    act(world, &Command::Hold, ticks);
}

#[test]
fn an_object_is_seen_under_its_name_and_falls_to_rest() {
    let cylinder = FurtherObject {
        shape: FurtherShape::Cylinder { half_height_m: 0.025, radius_m: 0.02 },
        x_m: [0.62, 0.62],
        ..LID
    };
    for fidelity in [Fidelity::Full, Fidelity::Reduced] {
        let list = [("can", cylinder), ("lid", FurtherObject { above_table_m: 0.05, ..LID })];
        let mut world = world(fidelity, &list);
        assert!((world.further_objects()["lid"].translation.z - 0.08).abs() < 1e-6);
        hold(&mut world, 240);
        let truth: BTreeMap<String, _> =
            world.further_objects().into_iter().map(|(name, pose)| (name.to_owned(), pose)).collect();
        for (name, height) in [("lid", 0.03), ("can", 0.025)] {
            let rest = truth[name];
            assert!((rest.translation.z - height).abs() < 0.002, "{fidelity:?} {name}: {rest:?}");
            let seen = world.observe().named(name).expect("it is in sight").pose;
            assert!((rest.translation.vector - seen.isometry().translation.vector).norm() < 1e-3, "{name}");
        }
        let observed = world.observe();
        assert!(observed.object().is_some() && observed.target().is_some());
        assert_eq!(observed.objects.len(), 4);
        // At rest it is no reason for the engine to work.
        assert_eq!(world.engine_rests(), fidelity == Fidelity::Reduced);
        let contacts = world.telemetry().contacts;
        assert!(!contacts.object_clutter && !contacts.robot_clutter && contacts.object_fixture);
    }
}

/// A lost frame tells of no object, as of the others.
#[test]
fn a_lost_camera_sees_no_object() {
    let mut world = world(Fidelity::Reduced, &[("lid", LID)]);
    hold(&mut world, 30);
    assert!(world.observe().named("lid").is_some());
    world.inject(holdpoint_cell::InjectedFault::CameraLost);
    hold(&mut world, 30);
    assert!(world.observe().objects.is_empty());
}

/// The hand closes beside the object and moves along x, low over the table; the state after each tick.
fn sweep(world: &mut World, ticks: std::ops::Range<u64>) -> Vec<u64> {
    let stepped = |tick| {
        let command = match tick {
            0 => fingers(0.0, 10.0),
            60 => arm(&tool_down(0.38, -0.06, 0.15, 0.0), 0.5),
            420 => arm(&tool_down(0.38, -0.06, 0.035, 0.0), 0.2),
            660 => arm(&tool_down(0.52, -0.06, 0.035, 0.0), 0.1),
            _ => Command::Hold,
        };
        world.step(&command).expect("step");
        world.state_hash()
    };
    ticks.map(stepped).collect()
}

#[test]
fn the_arm_pushes_an_object() {
    for fidelity in [Fidelity::Full, Fidelity::Adaptive, Fidelity::Reduced] {
        let mut world = world(fidelity, &[("lid", LID)]);
        sweep(&mut world, 0..660);
        let before = world.further_objects()["lid"].translation;
        assert!((before.x - 0.48).abs() < 1e-3, "nothing has touched it: {before:?}");
        let mut touched = false;
        for tick in 660..1060 {
            sweep(&mut world, tick..tick + 1);
            touched |= world.telemetry().contacts.robot_clutter;
        }
        let after = world.further_objects()["lid"].translation;
        assert!(touched && after.x - before.x > 0.03, "{fidelity:?}: {after:?}");
    }
}

/// An object of the workpiece's size.
#[test]
fn a_world_with_objects_continues_from_a_copy_bit_for_bit() {
    let cube = FurtherObject {
        shape: FurtherShape::Box { half_m: [scene().object.half_m; 3] },
        x_m: [0.46, 0.50],
        yaw_rad: [-0.2, 0.2],
        above_table_m: 0.02,
        ..LID
    };
    let list = [("cube", cube)];
    for fidelity in [Fidelity::Full, Fidelity::Reduced] {
        // In the air twice, at rest, and pushed.
        for at in [0, 12, 300, 800] {
            let mut whole = world(fidelity, &list);
            sweep(&mut whole, 0..at);
            let in_memory = RobotCell::copy(&whole).expect("it can");
            let sent = whole.export().expect("it can");
            let received = StateImage::received(sent.bytes().to_vec(), sent.digest()).expect("unchanged");
            let (seen, bytes) = (whole.observe().clone(), whole.snapshot().expect("it can"));
            let expected = sweep(&mut whole, at..900);
            for copy in [in_memory, CellCopy::of_image(at, received)] {
                let mut other = world(fidelity, &list);
                sweep(&mut other, 0..33);
                TrialCell::go_on_from(&mut other, &copy).expect("the same objects");
                assert_eq!(*other.observe(), seen);
                assert_eq!(other.snapshot().expect("it can"), bytes);
                assert_eq!(sweep(&mut other, at..900), expected, "{fidelity:?} from {at}");
                assert_eq!(other.telemetry(), whole.telemetry());
                assert_eq!(other.observe(), whole.observe());
            }
        }
    }
}

#[test]
fn state_of_a_cell_with_other_objects_is_refused() {
    let (mut without, mut with) = (world(Fidelity::Reduced, &[]), world(Fidelity::Reduced, &[("lid", LID)]));
    let before = [without.state_hash(), with.state_hash()];
    let (copy_without, copy_with) = (without.copy(), with.copy());
    let images = [&without, &with].map(|world| world.export().expect("it can"));
    assert!(matches!(without.go_on_from(&copy_with), Err(CellError::Snapshot(_))));
    assert!(matches!(with.go_on_from(&copy_without), Err(CellError::Snapshot(_))));
    assert!(matches!(TrialCell::import(&mut without, &images[1]), Err(CellError::Snapshot(_))));
    assert!(matches!(TrialCell::import(&mut with, &images[0]), Err(CellError::Snapshot(_))));
    assert_eq!([without.state_hash(), with.state_hash()], before);
}

/// Each seed draws a place in the region; the same seed draws the same, and nothing else of the episode changes.
#[test]
fn a_region_is_drawn_by_the_seed() {
    let region = FurtherObject { x_m: [0.40, 0.60], y_m: [-0.25, 0.25], yaw_rad: [-1.0, 1.0], ..LID };
    let (mut plain, mut world) =
        (world(Fidelity::Reduced, &[]), world(Fidelity::Reduced, &[("lid", region)]));
    let mut starts = Vec::new();
    for seed in [1, 2, 3, 4, 5, 6, 1] {
        let setup = EpisodeSetup::sample(
            TaskKind::Grasp,
            &scene(),
            &holdpoint_sim::published::live().expect("live"),
            seed,
        );
        plain.reset(&setup).expect("it starts");
        world.reset(&setup).expect("it starts");
        let at = world.further_objects()["lid"].translation.vector;
        let apart = at - setup.object.pose.isometry().translation.vector;
        assert!(apart.xy().norm() > 0.07, "clear of the workpiece: {at:?}");
        starts.push([at.x, at.y]);
        for _ in 0..20 {
            for world in [&mut plain, &mut world] {
                world.step(&Command::Hold).expect("step");
            }
        }
        // Noise and delays of what the camera sees of the workpiece are as without the object.
        let sequence =
            |world: &mut World| world.observe().object().map(|seen| (seen.sequence, seen.age_ticks));
        assert_eq!(sequence(&mut plain), sequence(&mut world));
        assert_eq!(plain.observe().target(), world.observe().target());
    }
    assert_eq!(starts[0], starts[6]);
    assert!(starts[1..6].iter().all(|start| *start != starts[0]));
}

#[test]
fn an_object_that_the_cell_cannot_have_is_refused_by_its_name() {
    let factory = SimFactory::new(RobotModel::builtin("arm7").expect("parses")).expect("the scene parses");
    let plain = factory.spec().digest();
    let own = factory.with_objects("site.toml", &declared(&[("lid", LID)])).expect("it can");
    assert_eq!(own.spec().object("lid").expect("named").kind, ObjectKind::Further(LID));
    own.spec().check("site.toml").expect("it describes a cell");
    assert_ne!(own.spec().digest(), plain);
    // Without any, a cell has the description and the digest of before there were any.
    let none = factory.with_objects("site.toml", &BTreeMap::new()).expect("it can");
    assert_eq!((none.spec().digest(), none.spec().objects.len()), (plain, 2));
    assert!(!format!("{:?}", none.spec()).contains("Further"));
    let many: Vec<(String, FurtherObject)> = (0..7).map(|number| (format!("box-{number}"), LID)).collect();
    let many: Vec<(&str, FurtherObject)> = many.iter().map(|(name, lid)| (name.as_str(), *lid)).collect();
    let cases: [(&[(&str, FurtherObject)], &str); 7] = [
        (many.as_slice(), "objects"),
        (&[("tray", LID)], "objects.tray"),
        (&[("", LID)], "objects."),
        (&[("a-name-of-17-byte", LID)], "objects.a-name-of-17-byte"),
        (&[("lid", FurtherObject { mass_kg: f64::NAN, ..LID })], "objects.lid"),
        (&[("lid", FurtherObject { x_m: [0.2, 0.5], ..LID })], "objects.lid"),
        // Where workpieces lie.
        (&[("lid", FurtherObject { y_m: [-0.2, -0.2], ..LID })], "objects"),
    ];
    for (list, expected) in cases {
        let error = factory.with_objects("site.toml", &declared(list)).err().expect(expected);
        let CellError::File { file, element, problem } = error else { panic!("{error}") };
        assert_eq!((file.as_str(), element.as_str()), ("site.toml", expected), "{problem}");
    }
}

#[test]
fn an_object_does_not_start_where_the_workpiece_lies() {
    let mut world = world(Fidelity::Reduced, &[("lid", LID)]);
    let mut setup = world.setup().clone();
    setup.object.pose.position = [0.48, -0.06, 0.025];
    assert!(matches!(World::reset(&mut world, &setup), Err(CellError::InvalidStart { .. })));
}
