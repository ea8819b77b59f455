//! The table of built-in controllers: what it names, what digests cover, and the frame of the object's pose.

use std::collections::BTreeSet;
use std::path::Path;

use holdpoint_body::{Estimate, GuardVerdict, JointVec, ReadingVec, Twist};

use super::*;

/// A bundle of the parameters that a shipped baseline has.
fn bundle(controller: &str, family: &str) -> NativeBundle {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../manifests").join(family).join("1.0.0");
    let text = std::fs::read_to_string(folder.join("params.toml")).unwrap();
    NativeBundle::new(Controller::parse(controller, "params.toml", &text).unwrap()).unwrap()
}

#[test]
fn each_name_stands_for_one_controller_that_says_so() {
    let names = Controller::names();
    assert_eq!(names.iter().collect::<BTreeSet<_>>().len(), names.len());
    for name in names {
        let family = name.strip_suffix("-tool-frame").unwrap_or(name);
        let bundle = bundle(name, family);
        assert_eq!(bundle.interface().controller, name);
        assert_eq!(bundle.interface().entry_points, BTreeSet::from([family.to_owned()]));
    }
    let unknown = Controller::parse("park2", "params.toml", "");
    assert!(matches!(unknown, Err(NativeError::UnknownController(name)) if name == "park2"));
}

#[test]
fn a_digest_covers_name_semantics_and_parameters() {
    let params = r#"{"controller":"park","params":{"rise_height_m":0.2,"speed_m_s":0.2,"timeout_secs":8.0}}"#;
    let parts = ["park", "1.1.0", params].map(str::as_bytes);
    assert_eq!(bundle("park", "park").digest(), Digest::of_parts("holdpoint.bundle.native.v1", &parts));
    assert_ne!(bundle("grasp", "grasp").digest(), bundle("grasp-tool-frame", "grasp").digest());
}

/// A run that sends the tool to where it sees the object.
struct Echo;

impl Skill for Echo {
    fn tick(&mut self, seen: &Observation) -> Command {
        let pose = seen.object().map_or(Pose::IDENTITY, |object| object.pose);
        Command::ToolPose { pose, max_speed_m_s: 0.1 }
    }

    fn enter(&mut self, _: Hook) {}

    fn fork(&self) -> Option<Box<dyn Skill>> {
        Some(Box::new(Self))
    }
}

#[test]
fn a_pose_in_the_frame_of_the_tool_reaches_the_code_in_the_world() {
    // The hand points down: ahead of it is below it, and its y axis is turned too.
    let object =
        Estimate { pose: Pose { position: [0.02, 0.03, 0.4], ..Pose::IDENTITY }, age_ticks: 3, sequence: 1 };
    let seen = Observation {
        tick: 0,
        q: JointVec::new(),
        dq: JointVec::new(),
        tau: JointVec::new(),
        tool: Pose { position: [0.4, 0.1, 0.5], rotation: [1.0, 0.0, 0.0, 0.0] },
        tool_twist: Twist::default(),
        gripper_width_m: 0.08,
        gripper_force_n: 0.0,
        wrist_force_n: 0.0,
        objects: TaskKind::Grasp.seen_objects(Some(object), None),
        sensors: ReadingVec::new(),
        tool_available: true,
        goal: TaskKind::Grasp,
        guard: GuardVerdict::Allowed,
    };
    let object = |name: &str| bundle(name, "grasp").interface().inputs.get("object").unwrap().frame;
    assert_eq!(object("grasp"), Some(CoordinateFrame::World));
    assert_eq!(object("grasp-tool-frame"), Some(CoordinateFrame::Tool));

    let mut run = ToolFrame(Box::new(Echo));
    let mut copy = run.fork().unwrap();
    for command in [run.tick(&seen), copy.tick(&seen)] {
        let Command::ToolPose { pose, .. } = command else { panic!("{command:?}") };
        let world = Pose { position: [0.42, 0.07, 0.1], ..Pose::IDENTITY };
        assert!(pose.distance_m(&world) < 1e-12, "{pose:?}");
    }
}
