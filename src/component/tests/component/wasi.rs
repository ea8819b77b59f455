//! What a component built by an ordinary toolchain finds of WASI.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use holdpoint_body::{CodeFault, Command};
use holdpoint_component::{Component, ComponentError, ComponentLimits};
use holdpoint_skill::{Hook, Skill as _};

use crate::guest::{all_is_well, seen};

const EVERYTHING: &[u8] = include_bytes!("../guests/everything.wasm");
const PACKAGES: [&str; 5] = ["wasi:cli", "wasi:clocks", "wasi:filesystem", "wasi:io", "wasi:random"];
const LIMITS: ComponentLimits = ComponentLimits { fuel_per_tick: 200_000, memory_bytes: 1 << 20 };

fn load(parameters: &Value, packages: &[&str]) -> Result<Component, ComponentError> {
    let packages: BTreeSet<String> = packages.iter().map(ToString::to_string).collect();
    Component::load(EVERYTHING, parameters, LIMITS, &packages)
}

/// The numbers that the guest answers a tick with.
fn numbers(command: Command) -> (Vec<f64>, f64) {
    let Command::Joints { q, max_speed_rad_s } = command else { panic!("{command:?}") };
    (q.to_vec(), max_speed_rad_s)
}

#[test]
fn an_ordinary_library_works_without_access_to_the_machine() {
    let component = load(&json!({"speed": 0.25}), &PACKAGES).unwrap();
    assert_eq!(component.interface().controller, "everything");
    assert!(component.imports().iter().all(|name| name.starts_with("wasi:")), "{:?}", component.imports());
    let mut run = component.run(7);
    for tick in [0, 1, 240, 2_400] {
        let began = std::time::Instant::now();
        let (q, speed) = numbers(run.tick(&seen(tick)));
        assert!(began.elapsed().as_secs_f64() < 1.0, "it asked to sleep for a second, and nothing sleeps");
        let [drawn, monotonic, slept, wall, last] = q[..] else { panic!("{q:?}") };
        assert!((0.0..1.0).contains(&drawn));
        assert!((monotonic - tick as f64 / 240.0).abs() < 1e-6, "{monotonic} at tick {tick}");
        assert_eq!((slept, wall, speed), (0.0, 946_684_800.0, 0.25));
        assert!((last - (0.2 + 99.0)).abs() < 1e-9, "{last}");
    }
    run.enter(Hook::SafeAbort);
    let log = run.log();
    assert!(log.raw().contains("seed 7, speed 0.250,"), "{:?}", log.raw());
    assert!(log.raw().ends_with("entered 0\n"), "{:?}", log.raw());
    assert_eq!(run.confined().fault, None);
    run.enter(Hook::Rollback);
    assert_eq!(run.confined().fault, Some(CodeFault::Trap), "it called exit");
    assert_eq!(run.tick(&seen(0)), Command::Hold);
    assert!(run.log().raw().contains("entered 1"), "the log outlives the fault");
    all_is_well();
}

#[test]
fn equal_seeds_draw_equal_numbers_on_any_thread() {
    let component = load(&Value::Null, &PACKAGES).unwrap();
    let run_of = |seed: u64| {
        let mut run = component.run(seed);
        let commands: Vec<_> = (0..50).map(|tick| numbers(run.tick(&seen(tick)))).collect();
        (commands, run.log().raw().to_owned(), run.confined())
    };
    let one = run_of(3);
    let threads: Vec<_> = std::thread::scope(|scope| {
        let all: Vec<_> = (0..4).map(|_| scope.spawn(|| run_of(3))).collect();
        all.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    for other in threads {
        assert_eq!(other, one);
    }
    assert_ne!(run_of(4).0, one.0);
    assert_ne!(one.0[0].0[0], one.0[1].0[0], "a stream, and not one number");
}

#[test]
fn undeclared_import_is_refused_with_the_declaration_to_add() {
    let error = load(&Value::Null, &PACKAGES[..4]).unwrap_err();
    let ComponentError::Undeclared { name, package } = &error else { panic!("{error}") };
    assert!(name.starts_with("wasi:random/") && package == "wasi:random", "{error}");
    let hint = holdpoint_text::Hint::hint(&error).unwrap();
    assert!(hint.contains("wasi:random") && hint.contains("deployment.imports"), "{hint}");
}
