//! Components of `holdpoint:skill@2.0.0`: what is handed over, chunks of commands, and sensors.

use std::path::Path;

use wit_component::{ComponentEncoder, StringEncoding, embed_component_metadata};
use wit_parser::Resolve;

use holdpoint_body::{CodeFault, Command, GuardVerdict, NamedReading, ObjectName, Observation, TaskKind};
use holdpoint_component::{
    CHUNK_COMMANDS_MAX, Component, ComponentError, ComponentRun, ImageSpec, PixelFormat, SkillContract,
};
use holdpoint_governance::mode::Sensor;
use holdpoint_skill::{Hook, Skill as _};

use crate::guest::{Guest, INTERFACE, all_is_well, data, load, seen};

/// Addresses in a guest's memory: results of `describe` and `start`, the answer of a step, a counter, and the commands.
const DESCRIBED: u32 = 64;
const STARTED: u32 = 128;
const ANSWER: u32 = 160;
const COUNT: u32 = 176;
const COMMANDS: u32 = 1_024;
/// Bytes of a command.
const STRIDE: u32 = 72;
/// An image that is asked for, its name, the name of the task, and the interface.
const WANTED: u32 = 24_000;
const NAME: u32 = 24_064;
const TASK: u32 = 24_128;
/// A vector that is asked for, and its name.
const VECTOR: u32 = 24_192;
const VECTOR_NAME: u32 = 24_256;
const TEXT: u32 = 24_576;
/// Address at which the host writes the arguments of each call.
const HANDED: u32 = 32_768;

/// The parts of a guest that differ between tests.
struct Guest2 {
    task: &'static str,
    /// The name and the width of an image that it asks for.
    image: Option<(&'static str, u32)>,
    /// The name and the length of a vector that it asks for; its `start` traps if it is granted another number of them.
    vector: Option<(&'static str, u32)>,
    /// Instructions that write commands; local 0 is the observation's address.
    step: String,
    /// How many commands it answers.
    count: usize,
}

impl Default for Guest2 {
    fn default() -> Self {
        Self { task: "align", image: None, vector: None, step: String::new(), count: 1 }
    }
}

impl Guest2 {
    fn bytes(&self) -> Vec<u8> {
        let length = |text: &str| u32::try_from(text.len()).unwrap();
        let Self { task, image, vector, step, count } = self;
        let (name, width) = image.unwrap_or_default();
        let (vector_name, vector_length) = vector.unwrap_or_default();
        let (images, vectors) = (u32::from(image.is_some()), u32::from(vector.is_some()));
        let words = |words: &[u32]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
        let described =
            words(&[0, TASK, length(task), TEXT, length(INTERFACE), WANTED, images, VECTOR, vectors]);
        let wanted = words(&[NAME, length(name), width, 48, 1]);
        let wanted_vector = words(&[VECTOR_NAME, length(vector_name), vector_length]);
        let texts: Vec<String> = [
            (DESCRIBED, described.as_slice()),
            (WANTED, wanted.as_slice()),
            (NAME, name.as_bytes()),
            (VECTOR, wanted_vector.as_slice()),
            (VECTOR_NAME, vector_name.as_bytes()),
            (TASK, task.as_bytes()),
            (TEXT, INTERFACE.as_bytes()),
        ]
        .iter()
        .map(|(at, bytes)| format!("(data (i32.const {at}) \"{}\")", data(bytes)))
        .collect();
        let texts = texts.concat();
        let interface = SkillContract::Two.skill();
        let text = format!(
            r#"(module
                (memory (export "memory") 2)
                (global $at (mut i32) (i32.const {HANDED}))
                {texts}
                (func (export "cabi_realloc") (param i32 i32 i32 i32) (result i32)
                    (global.set $at (i32.and (i32.add (global.get $at) (i32.const 7)) (i32.const -8)))
                    (global.get $at)
                    (global.set $at (i32.add (global.get $at) (local.get 3))))
                (func (export "{interface}#describe") (param i32 i32) (result i32)
                    (global.set $at (i32.const {HANDED})) (i32.const {DESCRIBED}))
                (func (export "{interface}#start") (param i64 i32 i32 i32 i32 i32 i32) (result i32)
                    (global.set $at (i32.const {HANDED}))
                    (if (i32.or (local.get 4) (i32.ne (local.get 6) (i32.const {vectors}))) (then (unreachable)))
                    (i32.const {STARTED}))
                (func (export "{interface}#step") (param i32) (result i32)
                    (local $word i64) (local $place i32) (local $base i32)
                    (global.set $at (i32.const {HANDED}))
                    (i32.store (i32.const {COUNT}) (i32.add (i32.load (i32.const {COUNT})) (i32.const 1)))
                    {step}
                    (i32.store (i32.const {ANSWER}) (i32.const {COMMANDS}))
                    (i32.store (i32.const {}) (i32.const {count}))
                    (i32.const {ANSWER}))
                (func (export "{interface}#enter") (param i32)
                    (global.set $at (i32.const {HANDED}))))"#,
            ANSWER + 4
        );
        let wit = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sdk/wit/2/skill.wit");
        let mut resolve = Resolve::default();
        let package = resolve.push_str("skill.wit", &std::fs::read_to_string(wit).unwrap()).unwrap();
        let world = resolve.select_world(&[package], Some("component")).unwrap();
        let mut core = wat::parse_str(text).unwrap();
        embed_component_metadata(&mut core, &resolve, world, StringEncoding::UTF8).unwrap();
        ComponentEncoder::default().module(&core).unwrap().encode().unwrap()
    }

    fn load(&self) -> Result<Component, ComponentError> {
        load(&self.bytes())
    }

    fn run(&self) -> ComponentRun {
        self.load().unwrap().run(1)
    }
}

/// Answers grips of the widths 0.5, 1.5 and 2.5, whose force counts the answers.
fn gripping() -> Guest2 {
    let grip = |index: u32| {
        let at = COMMANDS + STRIDE * index;
        format!(
            "(i32.store8 (i32.const {at}) (i32.const 3))
            (f64.store (i32.const {}) (f64.const {index}.5))
            (f64.store (i32.const {}) (f64.convert_i32_u (i32.load (i32.const {COUNT}))))",
            at + 8,
            at + 24
        )
    };
    Guest2 { step: (0..3).map(grip).collect(), count: 3, ..Guest2::default() }
}

/// The width and the force of the grip that is asked for.
fn grip(run: &mut ComponentRun, seen: &Observation) -> (f64, f64) {
    let command = run.tick(seen);
    let Command::Gripper { width_m, force_n, .. } = command else { panic!("{command:?}") };
    (width_m, force_n)
}

#[test]
fn chunk_is_played_one_command_a_tick_and_the_code_is_then_asked_again() {
    let mut run = gripping().run();
    let played: Vec<(f64, f64)> = (0..5).map(|tick| grip(&mut run, &seen(tick))).collect();
    assert_eq!(played, [(0.5, 1.0), (1.5, 1.0), (2.5, 1.0), (0.5, 2.0), (1.5, 2.0)]);
    assert_eq!(run.confined().fault, None);
}

#[test]
fn denied_command_hook_and_interrupt_drop_the_rest_of_a_chunk() {
    let begun = || {
        let mut run = gripping().run();
        assert_eq!(grip(&mut run, &seen(0)), (0.5, 1.0));
        run
    };
    let denied = Observation { guard: GuardVerdict::Denied, ..seen(1) };
    assert_eq!(grip(&mut begun(), &denied), (0.5, 2.0));
    let mut hooked = begun();
    hooked.enter(Hook::SafeAbort);
    assert_eq!(grip(&mut hooked, &seen(1)), (0.5, 2.0));
    assert_eq!(grip(&mut begun(), &seen(9)), (0.5, 2.0), "eight ticks were left out");
    assert_eq!(grip(&mut begun(), &seen(1)), (1.5, 1.0));
}

/// Answers with the 8 bytes at a place that the tick names, as the width of a grip: in the observation, or in the list whose
/// address is at `tick / 65536` in it.
fn reader() -> Guest2 {
    let step = format!(
        "(local.set $word (i64.load (local.get 0)))
        (local.set $place (i32.wrap_i64 (i64.shr_u (local.get $word) (i64.const 16))))
        (local.set $base (local.get 0))
        (if (local.get $place) (then
            (local.set $base (i32.load (i32.add (local.get 0) (local.get $place))))))
        (i32.store8 (i32.const {COMMANDS}) (i32.const 3))
        (i64.store (i32.const {}) (i64.load (i32.add (local.get $base)
            (i32.and (i32.wrap_i64 (local.get $word)) (i32.const 65535)))))",
        COMMANDS + 8
    );
    Guest2 { step, ..Guest2::default() }
}

#[test]
fn every_field_of_an_observation_arrives() {
    let mut run = reader().run();
    let mut read = |list: u64, place: u64| grip(&mut run, &seen((list << 16) | place)).0;
    let all = seen(0);
    for (list, joints) in [(8, &all.q), (16, &all.dq), (24, &all.tau)] {
        for (place, value) in (0..).zip(joints) {
            assert_eq!(read(list, 8 * place), *value, "joint {place} of the list at {list}");
        }
    }
    let forces = [all.gripper_width_m, all.gripper_force_n, all.wrist_force_n];
    let numbers = [
        (32, &all.tool.position[..]),
        (56, &all.tool.rotation[..]),
        (88, &all.tool_twist.linear[..]),
        (112, &all.tool_twist.angular[..]),
        (136, &forces[..]),
    ];
    for (from, values) in numbers {
        for (place, value) in (0..).zip(values) {
            assert_eq!(read(0, from + 8 * place), *value, "the number at {from} and {place}");
        }
    }
    assert_eq!(read(160, 56), 1.0, "the scalar part of the target's rotation");
    let mut bits = |list: u64, place: u64, mask: u64| read(list, place).to_bits() & mask;
    let word = u64::from(u32::MAX);
    assert_eq!([12, 20, 28].map(|place| bits(0, place, word)), [7; 3], "joints");
    assert_eq!(bits(0, 164, word), 1, "the object was not seen, the target was");
    assert_eq!(bits(160, 4, word), 4, "length of its name");
    assert_eq!(bits(160, 64, u64::MAX), (9 << 32) | 3, "age and sequence");
    assert_eq!([172, 180].map(|place| bits(0, place, word)), [0; 2], "images and vectors");
    let text = |text: &str| text.bytes().rev().fold(0, |sum, byte| (sum << 8) | u64::from(byte));
    assert_eq!(bits(188, 0, 0xff_ffff_ffff), text("align"), "task of the goal");
    assert_eq!(bits(196, 0, 0xffff_ffff_ffff), text("object"), "object of the goal");
    assert_eq!(bits(204, 0, word), text("tray"), "target of the goal");
    assert_eq!((bits(0, 184, 0xff), bits(0, 212, 0xff)), (1, 1), "tool there, guard clamped");
}

#[test]
fn arm_of_sixteen_joints_is_seen_and_moved() {
    let step = format!(
        "(i32.store8 (i32.const {COMMANDS}) (i32.const 2))
        (i32.store (i32.const {}) (i32.load offset=8 (local.get 0)))
        (i32.store (i32.const {}) (i32.load offset=12 (local.get 0)))
        (f64.store (i32.const {}) (f64.const 0.25))",
        COMMANDS + 8,
        COMMANDS + 12,
        COMMANDS + 16
    );
    let mut run = Guest2 { step, ..Guest2::default() }.run();
    let q = (0..16).map(f64::from).collect();
    let long = Observation { q, ..seen(0) };
    let moved = Command::Joints { q: long.q.clone(), max_speed_rad_s: 0.25 };
    assert_eq!(run.tick(&long), moved);
    assert_eq!(run.confined().fault, None);
}

#[test]
fn what_is_no_answer_is_a_fault() {
    let faulty = |step: String, count: usize| {
        let mut run = Guest2 { step, count, ..Guest2::default() }.run();
        assert_eq!(run.tick(&seen(0)), Command::Hold);
        run.confined().fault
    };
    let answer = Some(CodeFault::Answer);
    assert_eq!(faulty(String::new(), CHUNK_COMMANDS_MAX), None);
    assert_eq!(faulty(String::new(), CHUNK_COMMANDS_MAX + 1), answer, "too many");
    assert_eq!(faulty(String::new(), 0), answer, "none");
    let second = COMMANDS + STRIDE;
    let joints = format!(
        "(i32.store8 (i32.const {second}) (i32.const 2))
        (i32.store (i32.const {}) (i32.const {HANDED}))
        (i32.store (i32.const {}) (i32.const 17))",
        second + 8,
        second + 12
    );
    assert_eq!(faulty(joints.clone(), 1), None);
    assert_eq!(faulty(joints, 2), answer, "seventeen joints in the second command");
    assert_eq!(faulty(format!("(i32.store8 (i32.const {COMMANDS}) (i32.const 7))"), 1), answer);
    all_is_well();
}

#[test]
fn image_is_asked_for_and_none_is_granted() {
    let component = Guest2 { image: Some(("wrist", 64)), ..Guest2::default() }.load().unwrap();
    let wrist =
        ImageSpec { name: "wrist".to_owned(), width_px: 64, height_px: 48, format: PixelFormat::Rgb8 };
    assert_eq!(component.wanted_sensors().images, [wrist]);
    assert!(component.wanted_sensors().vectors.is_empty());
    // Its `start` traps if it is granted a sensor.
    assert_eq!(component.run(1).confined().fault, None);
    let wide = Guest2 { image: Some(("wrist", 1_025)), ..Guest2::default() }.load().unwrap_err();
    assert_eq!(wide, ComponentError::Sensor { name: "wrist".to_owned() });
}

#[test]
fn granted_vector_arrives_in_the_form_that_was_asked_for() {
    let vectors = |field: u32| format!("(i32.load offset={field} (i32.load offset=176 (local.get 0)))");
    // The sum of its numbers, and how many vectors there are.
    let step = format!(
        "(i32.store8 (i32.const {COMMANDS}) (i32.const 3))
        (f64.store (i32.const {}) (f64.convert_i32_u (i32.load offset=180 (local.get 0))))
        (if (i32.load offset=180 (local.get 0)) (then (f64.store (i32.const {})
            (f64.add (f64.load {values}) (f64.load offset=8 {values})))))",
        COMMANDS + 8,
        COMMANDS + 24,
        values = vectors(12)
    );
    let component = Guest2 { vector: Some(("pad-forces", 2)), step, ..Guest2::default() }.load().unwrap();
    assert!(component.interface().sensors.contains(&Sensor::Named), "whatever its interface says");
    let told = |name: &str, values: &[f64]| {
        let name = ObjectName::from(name).unwrap();
        let read = NamedReading { name, age_ticks: 3, values: values.iter().copied().collect() };
        let mut run = component.run(1);
        let grip = grip(&mut run, &Observation { sensors: [read].into_iter().collect(), ..seen(0) });
        assert_eq!(run.confined().fault, None);
        grip
    };
    assert_eq!(told("pad-forces", &[1.5, 2.0]), (1.0, 3.5));
    assert_eq!(told("pad-forces", &[1.5]), (0.0, 0.0), "another length");
    assert_eq!(told("encoders", &[1.5, 2.0]), (0.0, 0.0), "it did not ask for it");
}

#[test]
fn component_names_contract_and_task() {
    let second = Guest2::default().load().unwrap();
    assert_eq!((second.contract(), second.task()), (SkillContract::Two, TaskKind::Align));
    assert_eq!(Guest::default().load().unwrap().contract(), SkillContract::One);
    let unknown = Guest2 { task: "juggle", ..Guest2::default() }.load().unwrap_err();
    assert_eq!(unknown, ComponentError::Task { name: "juggle".to_owned() });
}
