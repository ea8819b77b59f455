//! A sensor that a component asks for by name: refused where the cell does not offer it, and else delivered as the manifest
//! declares.

use std::fmt::Write as _;
use std::path::Path;

use holdpoint_body::{Command as RobotCommand, GuardVerdict, TaskKind};
use holdpoint_cell::EpisodeSetup;
use holdpoint_governance::approval::Requester;
use holdpoint_governance::component::ComponentBytes;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_runtime::capability::{self, Capability};
use holdpoint_runtime::senses::Senses;
use holdpoint_text::Hint as _;
use holdpoint_trials::unoffered_sensor::UnofferedSensor;

use crate::decide::operations::registered_event;
use crate::decide::stages::rollback::tests::RollbackBench;

/// The engine's own controllers as a component of the first contract.
const CONTROLLERS: &[u8] = include_bytes!("../../../../sdk/prebuilt/controllers.wasm");

/// A grasp that asks for a sensor, and answers with a grip: its width is the number of vectors that arrived, its force the sum
/// of the first two numbers.
fn code(sensor: &str, length: u32) -> Vec<u8> {
    let grasp = Capability::load("test", read()).unwrap();
    let interface = serde_json::to_string(&grasp.bundle.interface()).unwrap();
    let escaped = interface.bytes().fold(String::new(), |mut text, byte| {
        write!(text, "\\{byte:02x}").unwrap();
        text
    });
    let (described, named) = (interface.len(), sensor.len());
    let name = "holdpoint:skill/skill@2.0.0";
    let first = "(i32.load offset=12 (i32.load offset=176 (local.get 0)))";
    let words = [(68, 1024), (72, 5), (76, 16384), (80, described), (92, 1088), (96, 1)];
    let stores = words.map(|(at, word)| format!("(i32.store (i32.const {at}) (i32.const {word}))")).concat();
    let text = format!(
        r#"(module
            (memory (export "memory") 1)
            (global $free (mut i32) (i32.const 32768))
            (data (i32.const 1024) "grasp")
            (data (i32.const 1056) "{sensor}")
            (data (i32.const 16384) "{escaped}")
            (func (export "cabi_realloc") (param i32 i32 i32 i32) (result i32)
                (global.set $free (i32.and (i32.add (global.get $free) (i32.const 7)) (i32.const -8)))
                (global.get $free)
                (global.set $free (i32.add (global.get $free) (local.get 3))))
            (func (export "{name}#describe") (param i32 i32) (result i32)
                (global.set $free (i32.const 32768))
                {stores}
                (i32.store (i32.const 1088) (i32.const 1056))
                (i32.store (i32.const 1092) (i32.const {named}))
                (i32.store (i32.const 1096) (i32.const {length}))
                (i32.const 64))
            (func (export "{name}#start") (param i64 i32 i32 i32 i32 i32 i32) (result i32)
                (global.set $free (i32.const 32768))
                (i32.const 128))
            (func (export "{name}#step") (param i32) (result i32)
                (global.set $free (i32.const 32768))
                (i32.store8 (i32.const 2048) (i32.const 3))
                (f64.store (i32.const 2056) (f64.convert_i32_u (i32.load offset=180 (local.get 0))))
                (if (i32.load offset=180 (local.get 0)) (then (f64.store (i32.const 2072)
                    (f64.add (f64.load {first}) (f64.load offset=8 {first})))))
                (i32.store (i32.const 160) (i32.const 2048))
                (i32.store (i32.const 164) (i32.const 1))
                (i32.const 160))
            (func (export "{name}#enter") (param i32)))"#
    );
    holdpoint_builder::encode(wat::parse_str(text).unwrap()).unwrap()
}

fn read() -> Package {
    capability::read(&Path::new(crate::MANIFESTS).join("candidates/grasp-improved")).unwrap()
}

/// A candidate with this code, whose manifest declares named sensors.
fn asking(sensor: &str, length: u32) -> Package {
    let mut package = read();
    for (from, to) in [("native:grasp", "skill.wasm"), ("sensors = [", "sensors = [\"named\", ")] {
        assert!(package.manifest.contains(from), "{from}");
        package.manifest = package.manifest.replace(from, to);
    }
    package.component = Some(ComponentBytes::new(code(sensor, length)).unwrap());
    package
}

fn register(bench: &mut RollbackBench, package: Package) -> Reply {
    bench.pipeline.command(Command::Register { package, name: "test".to_owned(), by: None })
}

#[test]
fn sensor_that_the_cell_does_not_offer_is_refused_with_those_that_it_offers() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    for (sensor, length) in [("touch", 2), ("pad-forces", 3)] {
        let reply = register(&mut bench, asking(sensor, length));
        assert!(matches!(reply, Reply::Refused { code: Refusal::BadInput, .. }), "{reply:?}");
        let candidate = Capability::load("test", asking(sensor, length)).unwrap();
        let spec = bench.pipeline.live().context.cell.spec.clone();
        let refused = UnofferedSensor::of(&candidate, &spec).unwrap();
        assert_eq!(refused.value, format!("{sensor} ({length} values)"));
        assert_eq!(
            (refused.file.as_str(), refused.allowed.as_str()),
            ("skill.wasm", "pad-forces (2 values)")
        );
        let place = refused.details().unwrap().place.unwrap();
        assert_eq!(place.field, Some("wanted".into()));
    }
    let reply = register(&mut bench, asking("pad-forces", 2));
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
}

#[test]
fn component_of_the_first_contract_is_registered_with_a_notice() {
    let notices = |package: Package| {
        let candidate = Capability::load("test", package).unwrap();
        let event = registered_event(&candidate, &Requester::Script);
        let EventKind::Registered { notices, .. } = event else { panic!("{event:?}") };
        notices
    };
    assert!(notices(read()).is_empty(), "it is compiled in");
    let mut first = asking("pad-forces", 2);
    assert!(notices(first.clone()).is_empty());
    first.component = Some(ComponentBytes::new(CONTROLLERS.to_vec()).unwrap());
    assert_eq!(notices(first), [Notice::ContractOld]);
}

#[test]
fn offered_sensor_reaches_the_component_if_the_manifest_declares_it() {
    let mut bench = RollbackBench::new();
    let cell = bench.pipeline.live().context.cell.clone();
    let mut trial = cell.trial().unwrap();
    trial.reset(&EpisodeSetup::sample(TaskKind::Align, &cell.scene, &cell.canonical, 5)).unwrap();
    let seen = trial.observe(GuardVerdict::Allowed);
    let asked = |package: Package| {
        let candidate = Capability::load("test", package).unwrap();
        let mut run = Senses::of(&candidate.manifest.permissions).confine(candidate.bundle.start(1));
        let command = run.tick(&seen);
        let RobotCommand::Gripper { width_m, force_n, .. } = command else { panic!("{command:?}") };
        (width_m, force_n)
    };
    let pads = &seen.sensors[0].values;
    assert!(pads.iter().all(|force| *force > 1.0), "the hand holds the object: {pads:?}");
    assert_eq!(asked(asking("pad-forces", 2)), (1.0, pads[0] + pads[1]));
    let mut undeclared = asking("pad-forces", 2);
    undeclared.manifest = undeclared.manifest.replace("\"named\", ", "");
    assert_eq!(asked(undeclared), (0.0, 0.0));
}
