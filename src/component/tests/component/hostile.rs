//! Code that does what it must not: one clear outcome each, and the host works on.

use std::time::Instant;

use holdpoint_body::{CodeFault, Command};
use holdpoint_component::{Component, ComponentCall, ComponentError, ComponentLimits};
use holdpoint_skill::{Hook, Skill as _};

use crate::guest::{Guest, LIMITS, all_is_well, seen, wit};

const FOREVER: &str = "(loop (br 0)) unreachable";

/// The fault of a run after its start and one tick, and that from then on it holds.
fn fault(component: &Component) -> Option<CodeFault> {
    let mut run = component.run(1);
    run.tick(&seen(0));
    let fault = run.confined().fault;
    if fault.is_some() {
        run.enter(Hook::SafeAbort);
        assert_eq!(run.tick(&seen(1)), Command::Hold);
        assert!(run.fork().is_none());
        assert_eq!(run.confined().fault, fault, "what failed stays failed in the same way");
    }
    fault
}

#[test]
fn failing_tick_is_a_fault_of_its_run() {
    let cases = [
        ("an infinite loop", FOREVER, CodeFault::Fuel),
        ("4 GiB of memory", "(drop (memory.grow (i32.const 65535))) unreachable", CodeFault::Memory),
        (
            "memory page by page",
            "(loop (drop (memory.grow (i32.const 1))) (br 0)) unreachable",
            CodeFault::Memory,
        ),
        (
            "more memory than there can be",
            "(drop (memory.grow (i32.const -1))) unreachable",
            CodeFault::Memory,
        ),
        (
            "a table",
            "(drop (table.grow $t (ref.null func) (i32.const 70000))) unreachable",
            CodeFault::Memory,
        ),
        (
            "a table, bit by bit",
            "(loop (drop (table.grow $t (ref.null func) (i32.const 10000))) (br 0)) unreachable",
            CodeFault::Memory,
        ),
        ("deep recursion", "(call $deep (i64.const 0))", CodeFault::Trap),
        ("unreachable", "unreachable", CodeFault::Trap),
        ("a division by zero", "(i32.div_s (i32.const 1) (i32.const 0))", CodeFault::Trap),
        ("a number that does not fit", "(i32.trunc_f64_s (f64.const 1e300))", CodeFault::Trap),
        ("an address beyond the memory", "(i32.load (i32.const 0x7ffffff0))", CodeFault::Trap),
        (
            "a call of nothing",
            "(call_indirect $t (type $nothing) (i32.const 0)) unreachable",
            CodeFault::Trap,
        ),
        ("an answer beyond the memory", "(i32.const 0x7ffffff0)", CodeFault::Answer),
        ("an answer that is not aligned", "(i32.const 257)", CodeFault::Answer),
        (
            "memory filled again and again",
            "(loop (memory.fill (i32.const 0) (i32.const 1) (i32.const 65536)) (br 0)) unreachable",
            CodeFault::Fuel,
        ),
        (
            "instructions that the runtime carries out, two thousand of them",
            "(local.set $word (i64.const 2000))
            (loop $again (drop (ref.func $deep)) (local.set $word (i64.sub (local.get $word) (i64.const 1)))
                (br_if $again (i64.ne (local.get $word) (i64.const 0))))
            (i32.const 256)",
            CodeFault::Fuel,
        ),
    ];
    for (what, tick, expected) in cases {
        let more = "(table $t 1 funcref) (type $nothing (func)) (elem declare func $deep)
            (func $deep (param i64) (result i32)
                (i32.add (call $deep (i64.add (local.get 0) (i64.const 1))) (i32.const 1)))";
        let guest = Guest { tick: tick.to_owned(), more: more.to_owned(), ..Guest::default() };
        let component = guest.load().unwrap_or_else(|error| panic!("{what}: {error}"));
        let began = Instant::now();
        assert_eq!(fault(&component), Some(expected), "{what}");
        assert_eq!(fault(&component), Some(expected), "{what}, again");
        assert!(began.elapsed().as_secs() < 5, "{what}: {:?}", began.elapsed());
        all_is_well();
    }
}

#[test]
fn failing_start_is_a_fault_of_its_run() {
    let cases = [
        ("an infinite loop", FOREVER.to_owned(), CodeFault::Fuel),
        ("a trap", "unreachable".to_owned(), CodeFault::Trap),
        // An error with a text of three bytes, of four gigabytes, and of what is no text.
        ("an error", error_at(3), CodeFault::Answer),
        ("a huge error", error_at(0x7fff_fff0), CodeFault::Answer),
        (
            "an error that is no text",
            error_at(16) + "(i32.store8 (i32.const 16384) (i32.const 255))",
            CodeFault::Answer,
        ),
    ];
    for (what, start, expected) in cases {
        let start = if start.contains("unreachable") { start } else { start + "(i32.const 128)" };
        let guest = Guest { start, ..Guest::default() };
        assert_eq!(fault(&guest.load().unwrap()), Some(expected), "{what}");
        all_is_well();
    }
}

/// Writes the result of `start`: an error with a text of `bytes` bytes.
fn error_at(bytes: u32) -> String {
    format!(
        "(i32.store (i32.const 128) (i32.const 1)) (i32.store (i32.const 132) (i32.const 16384))
        (i32.store (i32.const 136) (i32.const {bytes}))"
    )
}

#[test]
fn failing_hook_is_a_fault_of_its_run() {
    for (enter, expected) in [("unreachable", CodeFault::Trap), (FOREVER, CodeFault::Fuel)] {
        let guest = Guest { enter: enter.to_owned(), ..Guest::default() };
        let mut run = guest.load().unwrap().run(1);
        run.tick(&seen(0));
        assert_eq!(run.confined().fault, None);
        run.enter(Hook::SafeAbort);
        assert_eq!(run.confined().fault, Some(expected));
        assert_eq!(run.tick(&seen(1)), Command::Hold);
        all_is_well();
    }
}

#[test]
fn fuel_of_each_tick_is_counted_separately() {
    // Does nothing for 40 ticks, then loops: fuel that a tick leaves does not carry over.
    let tick = format!(
        "(local.set $word (i64.load (local.get 0)))
        (if (i64.eq (local.get $word) (i64.const 40)) (then (loop (br 0))))
        (i32.const {})",
        crate::guest::COMMAND
    );
    let mut run = Guest::ticking(&tick).run(1);
    for tick in 0..40 {
        run.tick(&seen(tick));
        assert_eq!(run.confined().fault, None, "tick {tick}");
    }
    run.tick(&seen(40));
    assert_eq!(run.confined().fault, Some(CodeFault::Fuel));
    assert_eq!(run.confined().fuel_tick_max, LIMITS.fuel_per_tick);
}

#[test]
fn failing_description_is_one_error() {
    let describe = |describe: &str| {
        let error = Guest { describe: describe.to_owned(), ..Guest::default() }.load().unwrap_err();
        all_is_well();
        error
    };
    assert!(matches!(describe(FOREVER), ComponentError::Fuel { call: ComponentCall::Describe, .. }));
    assert!(matches!(describe("unreachable"), ComponentError::Trapped { call: ComponentCall::Describe, .. }));
    assert!(matches!(
        describe("(drop (memory.grow (i32.const 1000))) unreachable"),
        ComponentError::Memory { call: ComponentCall::Describe, .. }
    ));
    // Its text's length.
    let text =
        |bytes: u32| describe(&format!("(i32.store (i32.const 76) (i32.const {bytes})) (i32.const 64)"));
    assert!(matches!(text(0x7fff_fff0), ComponentError::Answer { .. }));
    assert!(matches!(text(10), ComponentError::Interface { .. }));
    assert!(matches!(
        describe("(i32.store8 (i32.const 68) (i32.const 9)) (i32.const 64)"),
        ComponentError::Answer { .. }
    ));
    let refused = describe(
        "(i32.store8 (i32.const 64) (i32.const 1)) (i32.store (i32.const 68) (i32.const 16384))
        (i32.store (i32.const 72) (i32.const 13)) (i32.const 64)",
    );
    assert_eq!(refused, ComponentError::Refused { reason: "{\"controller\"".to_owned() });
    let long = Guest { memory: "3".to_owned(), interface: " ".repeat(64 << 10) + "{}", ..Guest::default() };
    assert_eq!(long.load().unwrap_err(), ComponentError::InterfaceSize { bytes: (64 << 10) + 2 });
    let escape = "(i32.store8 (i32.const 64) (i32.const 1)) (i32.store (i32.const 68) (i32.const 16384))
        (i32.store (i32.const 72) (i32.const 4000)) (i32.const 64)";
    let escape =
        Guest { describe: escape.to_owned(), interface: "\x1b[2J\n".repeat(1_000), ..Guest::default() };
    let message = escape.load().unwrap_err().to_string();
    assert!(!message.contains('\x1b') && !message.contains('\n') && message.len() < 2_000, "{message:?}");
    all_is_well();
}

#[test]
fn failing_instantiation_is_one_error() {
    let more = |more: &str| {
        let error = Guest { more: more.to_owned(), ..Guest::default() }.load().unwrap_err();
        all_is_well();
        error
    };
    let start = "(func $begin (loop (br 0))) (start $begin)";
    assert!(matches!(more(start), ComponentError::Fuel { call: ComponentCall::Instantiate, .. }));
    let start = "(func $begin unreachable) (start $begin)";
    assert!(matches!(more(start), ComponentError::Trapped { call: ComponentCall::Instantiate, .. }));
    let table = "(table 1000000 funcref)";
    assert!(matches!(more(table), ComponentError::Memory { call: ComponentCall::Instantiate, .. }));
    let large = Guest { memory: "65536".to_owned(), ..Guest::default() }.load().unwrap_err();
    assert!(matches!(large, ComponentError::Memory { call: ComponentCall::Instantiate, .. }), "{large}");
    assert!(holdpoint_text::Hint::sentence(&large).contains("memory_kib"));
    all_is_well();
}

/// A guest that imports a little of WASI, as its own WIT says it.
fn reaching(tick: &str) -> Guest {
    let nested = "
        package wasi:io@0.2.3 {
            interface poll {
                resource pollable { block: func(); }
                poll: func(all: list<borrow<pollable>>) -> list<u32>;
            }
            interface error { resource error; }
            interface streams {
                use error.{error};
                variant stream-error { last-operation-failed(error), closed }
                resource output-stream { write: func(bytes: list<u8>) -> result<_, stream-error>; }
            }
        }
        package wasi:clocks@0.2.3 {
            interface monotonic-clock {
                use wasi:io/poll@0.2.3.{pollable};
                now: func() -> u64;
                subscribe-duration: func(nanos: u64) -> pollable;
            }
        }
        package wasi:random@0.2.3 { interface random { get-random-bytes: func(wanted: u64) -> list<u8>; } }
        package wasi:cli@0.2.3 {
            interface stdout {
                use wasi:io/streams@0.2.3.{output-stream};
                get-stdout: func() -> output-stream;
            }
        }
        package wasi:sockets@0.2.3 {
            interface instance-network { resource network; instance-network: func() -> network; }
        }";
    let world = "export skill;
        import wasi:clocks/monotonic-clock@0.2.3; import wasi:io/poll@0.2.3; import wasi:random/random@0.2.3;
        import wasi:cli/stdout@0.2.3; import wasi:io/streams@0.2.3;
        import wasi:sockets/instance-network@0.2.3;";
    let import = r#"
        (import "wasi:clocks/monotonic-clock@0.2.3" "now" (func $now (result i64)))
        (import "wasi:clocks/monotonic-clock@0.2.3" "subscribe-duration" (func $sleep (param i64) (result i32)))
        (import "wasi:io/poll@0.2.3" "poll" (func $poll (param i32 i32 i32)))
        (import "wasi:io/poll@0.2.3" "[method]pollable.block" (func $block (param i32)))
        (import "wasi:io/poll@0.2.3" "[resource-drop]pollable" (func $wake (param i32)))
        (import "wasi:random/random@0.2.3" "get-random-bytes" (func $random (param i64 i32)))
        (import "wasi:cli/stdout@0.2.3" "get-stdout" (func $stdout (result i32)))
        (import "wasi:io/streams@0.2.3" "[method]output-stream.write" (func $write (param i32 i32 i32 i32)))
        (import "wasi:sockets/instance-network@0.2.3" "instance-network" (func $network (result i32)))"#;
    let package =
        wit().replacen("world component {\n    export skill;", &format!("world component {{ {world}"), 1)
            + nested;
    Guest { package, import: import.to_owned(), tick: tick.to_owned(), ..Guest::default() }
}

const REACHED: [&str; 5] = ["wasi:cli", "wasi:clocks", "wasi:io", "wasi:random", "wasi:sockets"];

#[test]
fn abuse_of_host_functions_ends_in_a_code_fault() {
    let cases = [
        (
            "a busy wait",
            "(loop (br_if 0 (i64.lt_u (call $now) (i64.const 1000000000000)))) unreachable",
            CodeFault::Fuel,
        ),
        (
            "a busy poll",
            "(i32.store (i32.const 9000) (call $sleep (i64.const 1000000000)))
            (loop (call $poll (i32.const 9000) (i32.const 1) (i32.const 9008)) (br 0)) unreachable",
            CodeFault::Fuel,
        ),
        (
            "sleeping for ever",
            "(loop (local.set $place (call $sleep (i64.const -1))) (call $block (local.get $place))
                (call $wake (local.get $place)) (br 0)) unreachable",
            CodeFault::Fuel,
        ),
        (
            "a poll of nothing",
            "(call $poll (i32.const 0) (i32.const 0) (i32.const 9008)) unreachable",
            CodeFault::Trap,
        ),
        (
            "a petabyte of random numbers",
            "(call $random (i64.const 0x4000000000000) (i32.const 9008)) unreachable",
            CodeFault::Trap,
        ),
        (
            "a write of half the memory",
            "(call $write (call $stdout) (i32.const 0) (i32.const 32768) (i32.const 9008)) unreachable",
            CodeFault::Trap,
        ),
        ("a network", "(call $network)", CodeFault::Trap),
    ];
    for (what, tick, expected) in cases {
        let component = reaching(tick).load_with(&REACHED).unwrap_or_else(|error| panic!("{what}: {error}"));
        let began = Instant::now();
        assert_eq!(fault(&component), Some(expected), "{what}");
        assert!(began.elapsed().as_secs() < 5, "{what}: {:?}", began.elapsed());
        all_is_well();
    }
}

#[test]
fn handles_and_the_log_are_bounded() {
    let answer = format!("(i32.const {})", crate::guest::COMMAND);
    // A handle a tick that is never given back.
    let mut run =
        reaching(&format!("(drop (call $sleep (i64.const 1))) {answer}")).load_with(&REACHED).unwrap().run(1);
    for tick in 0..1_024 {
        run.tick(&seen(tick));
        assert_eq!(run.confined().fault, None, "tick {tick}");
    }
    run.tick(&seen(1_024));
    assert_eq!(run.confined().fault, Some(CodeFault::Trap));
    // 4 KiB of output a tick.
    let write =
        format!("(call $write (call $stdout) (i32.const 16384) (i32.const 4096) (i32.const 9008)) {answer}");
    let mut run = reaching(&write).load_with(&REACHED).unwrap().run(1);
    for tick in 0..10 {
        run.tick(&seen(tick));
    }
    assert_eq!(run.confined().fault, None);
    assert_eq!(run.log().raw().len(), holdpoint_component::LOG_BYTES_MAX);
    assert!(run.log().raw().starts_with("{\"controller\""));
    all_is_well();
}

#[test]
fn undeclared_import_is_refused_whatever_it_calls() {
    let error = reaching("(i32.const 256)").load_with(&REACHED[..4]).unwrap_err();
    assert_eq!(
        error,
        ComponentError::Undeclared {
            name: "wasi:sockets/instance-network@0.2.3".to_owned(),
            package: "wasi:sockets".to_owned(),
        }
    );
    assert_eq!(fault(&reaching("(i32.const 256)").load_with(&REACHED).unwrap()), None);
}

/// Describing an unchecked component is bounded by the host's own limits.
#[test]
fn excessive_declared_limits_are_refused_before_the_code_runs() {
    let bytes = Guest { describe: FOREVER.to_owned(), ..Guest::default() }.bytes();
    let load = |limits| {
        Component::load(&bytes, &serde_json::Value::Null, limits, &std::collections::BTreeSet::new())
    };
    for (limits, name, declared) in [
        (ComponentLimits { fuel_per_tick: 4_167_000, ..LIMITS }, "cpu_us_per_tick", 4_167),
        (
            ComponentLimits { memory_bytes: u64::from(u32::MAX) << 10, ..LIMITS },
            "memory_kib",
            u64::from(u32::MAX),
        ),
    ] {
        let error = load(limits).unwrap_err();
        let ComponentError::Limit { field, value, max } = error else { panic!("{error}") };
        assert!(field == name && value == declared && max < value, "{field}: {value}, {max}");
    }
    let began = Instant::now();
    let error = load(ComponentLimits { fuel_per_tick: 4_166_000, ..LIMITS }).unwrap_err();
    assert!(matches!(error, ComponentError::Fuel { call: ComponentCall::Describe, .. }), "{error}");
    assert!(began.elapsed().as_secs() < 5, "{:?}", began.elapsed());
}
