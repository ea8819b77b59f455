//! Components written for a test: a core module in text, made a component of the contract's own WIT.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;

use serde_json::Value;
use wit_component::{ComponentEncoder, StringEncoding, embed_component_metadata};
use wit_parser::Resolve;

use holdpoint_body::{Command, GuardVerdict, JointVec, Observation, Pose, ReadingVec, TaskKind, Twist};
use holdpoint_component::{Component, ComponentError, ComponentLimits};

pub const LIMITS: ComponentLimits = ComponentLimits { fuel_per_tick: 100_000, memory_bytes: 1 << 20 };

/// The interface that a valid guest describes.
pub const INTERFACE: &str = r#"{"controller":"test","semantics_version":"1.0.0","entry_points":[],"inputs":{},"outputs":{},"parameters":{},"hooks":[],"failure_signals":[],"needs":[]}"#;

/// Addresses in a guest's memory: the command of a tick, the results of `describe` and `start`, and the interface.
pub const COMMAND: u32 = 256;
const DESCRIBED: u32 = 64;
const STARTED: u32 = 128;
const TEXT: u32 = 16_384;
/// Address at which the host writes the arguments of each call.
const HANDED: u32 = 1_024;

/// The parts of a guest; each function's body is a text of instructions.
#[derive(Clone)]
pub struct Guest {
    pub package: String,
    pub version: &'static str,
    /// What the module imports.
    pub import: String,
    pub memory: String,
    /// The interface that `describe` returns, JSON.
    pub interface: String,
    /// Leaves the address of the result of `describe`.
    pub describe: String,
    pub start: String,
    /// Gets the observation's address as local 0 and may use `$word` and `$place`; leaves the command's address.
    pub tick: String,
    pub enter: String,
    /// Any further parts of the module.
    pub more: String,
}

impl Default for Guest {
    /// A valid guest that holds in every tick.
    fn default() -> Self {
        Self {
            package: wit(),
            version: "1.0.0",
            import: String::new(),
            memory: "1".to_owned(),
            interface: INTERFACE.to_owned(),
            describe: format!("(i32.const {DESCRIBED})"),
            start: format!("(i32.const {STARTED})"),
            tick: format!("(i32.const {COMMAND})"),
            enter: String::new(),
            more: String::new(),
        }
    }
}

/// The contract's own text.
pub fn wit() -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../sdk/wit/skill.wit")).unwrap()
}

/// Bytes as they stand in a string of the text format.
pub fn data(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "\\{byte:02x}").unwrap();
        text
    })
}

impl Guest {
    pub fn core(&self) -> Vec<u8> {
        let mut described = vec![0; 8];
        described.extend(TEXT.to_le_bytes());
        described.extend(u32::try_from(self.interface.len()).unwrap().to_le_bytes());
        let Self { version, import, memory, describe, start, tick, enter, more, .. } = self;
        let (described, interface) = (data(&described), data(self.interface.as_bytes()));
        let name = format!("holdpoint:skill/skill@{version}");
        let text = format!(
            r#"(module
                {import}
                (memory (export "memory") {memory})
                (global $at (mut i32) (i32.const {HANDED}))
                (data (i32.const {DESCRIBED}) "{described}")
                (data (i32.const {TEXT}) "{interface}")
                (func (export "cabi_realloc") (param i32 i32 i32 i32) (result i32)
                    (global.set $at (i32.and (i32.add (global.get $at) (i32.const 7)) (i32.const -8)))
                    (global.get $at)
                    (global.set $at (i32.add (global.get $at) (local.get 3))))
                (func (export "{name}#describe") (param i32 i32) (result i32)
                    (global.set $at (i32.const {HANDED})) {describe})
                (func (export "{name}#start") (param i64 i32 i32) (result i32)
                    (global.set $at (i32.const {HANDED})) {start})
                (func (export "{name}#tick") (param i32) (result i32) (local $word i64) (local $place i32)
                    (global.set $at (i32.const {HANDED})) {tick})
                (func (export "{name}#enter") (param i32)
                    (global.set $at (i32.const {HANDED})) {enter})
                {more})"#
        );
        wat::parse_str(text).unwrap()
    }

    pub fn bytes(&self) -> Vec<u8> {
        let mut resolve = Resolve::default();
        let package = resolve.push_str("skill.wit", &self.package).unwrap();
        let world = resolve.select_world(&[package], Some("component")).unwrap();
        let mut core = self.core();
        embed_component_metadata(&mut core, &resolve, world, StringEncoding::UTF8).unwrap();
        ComponentEncoder::default().module(&core).unwrap().encode().unwrap()
    }

    pub fn load(&self) -> Result<Component, ComponentError> {
        load(&self.bytes())
    }

    /// Loads it with packages that it may import.
    pub fn load_with(&self, packages: &[&str]) -> Result<Component, ComponentError> {
        let packages = packages.iter().map(ToString::to_string).collect();
        Component::load(&self.bytes(), &Value::Null, LIMITS, &packages)
    }

    /// A guest that is valid except for its `tick`.
    pub fn ticking(tick: &str) -> Component {
        Self { tick: tick.to_owned(), ..Self::default() }.load().unwrap()
    }
}

pub fn load(bytes: &[u8]) -> Result<Component, ComponentError> {
    Component::load(bytes, &Value::Null, LIMITS, &BTreeSet::new())
}

/// What a run sees in a tick.
pub fn seen(tick: u64) -> Observation {
    let value = |scale: f64| (0..7).map(|joint| scale * (f64::from(joint) + 1.0)).collect::<JointVec>();
    Observation {
        tick,
        q: value(0.1),
        dq: value(0.01),
        tau: value(-1.0),
        tool: Pose { position: [0.1, 0.2, 0.3], rotation: [0.0, 0.6, 0.0, 0.8] },
        tool_twist: Twist { linear: [1.0, 2.0, 3.0], angular: [4.0, 5.0, 6.0] },
        gripper_width_m: 0.07,
        gripper_force_n: 1.5,
        wrist_force_n: 2.5,
        objects: TaskKind::Align.seen_objects(
            None,
            Some(holdpoint_body::Estimate { pose: Pose::IDENTITY, age_ticks: 3, sequence: 9 }),
        ),
        sensors: ReadingVec::new(),
        tool_available: true,
        goal: TaskKind::Align,
        guard: GuardVerdict::Clamped,
    }
}

/// Checks that a valid guest still runs in this process after another guest failed.
pub fn all_is_well() {
    let mut run = Guest::default().load().unwrap().run(1);
    use holdpoint_skill::Skill as _;
    for tick in 0..3 {
        assert_eq!(run.tick(&seen(tick)), Command::Hold);
    }
    run.enter(holdpoint_skill::Hook::SafeAbort);
    assert_eq!(run.confined().fault, None);
}
