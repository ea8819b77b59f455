//! Code that does what it must not: one clear outcome each, and the host works on.

use std::time::Instant;

use holdpoint_body::{CodeFault, Command};
use holdpoint_component::{Call, Component, ComponentError};
use holdpoint_skill::{Hook, Skill as _};

use crate::guest::{Guest, LIMITS, all_is_well, seen};

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
fn a_tick_that_goes_wrong_is_a_fault_of_its_run() {
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
    ];
    for (what, tick, expected) in cases {
        let more = "(table $t 1 funcref) (type $nothing (func))
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
fn a_start_that_goes_wrong_is_a_fault_of_its_run() {
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

/// Writes the result of `start`: an error with a text of so many bytes.
fn error_at(bytes: u32) -> String {
    format!(
        "(i32.store (i32.const 128) (i32.const 1)) (i32.store (i32.const 132) (i32.const 16384))
        (i32.store (i32.const 136) (i32.const {bytes}))"
    )
}

#[test]
fn a_hook_that_goes_wrong_is_a_fault_of_its_run() {
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
fn a_tick_in_between_is_counted_by_itself() {
    // Works for so many ticks, then never again: what a tick left over is not the next one's.
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
fn a_description_that_goes_wrong_is_one_error() {
    let describe = |describe: &str| {
        let error = Guest { describe: describe.to_owned(), ..Guest::default() }.load().unwrap_err();
        all_is_well();
        error
    };
    assert!(matches!(describe(FOREVER), ComponentError::Fuel { call: Call::Describe, .. }));
    assert!(matches!(describe("unreachable"), ComponentError::Trapped { call: Call::Describe, .. }));
    assert!(matches!(
        describe("(drop (memory.grow (i32.const 1000))) unreachable"),
        ComponentError::Memory { call: Call::Describe, .. }
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
    let said = escape.load().unwrap_err().to_string();
    assert!(!said.contains('\x1b') && !said.contains('\n') && said.len() < 2_000, "{said:?}");
    all_is_well();
}

#[test]
fn an_instance_that_goes_wrong_is_one_error() {
    let more = |more: &str| {
        let error = Guest { more: more.to_owned(), ..Guest::default() }.load().unwrap_err();
        all_is_well();
        error
    };
    let start = "(func $begin (loop (br 0))) (start $begin)";
    assert!(matches!(more(start), ComponentError::Fuel { call: Call::Instantiate, .. }));
    let start = "(func $begin unreachable) (start $begin)";
    assert!(matches!(more(start), ComponentError::Trapped { call: Call::Instantiate, .. }));
    let table = "(table 1000000 funcref)";
    assert!(matches!(more(table), ComponentError::Memory { call: Call::Instantiate, .. }));
    let large = Guest { memory: "65536".to_owned(), ..Guest::default() }.load().unwrap_err();
    assert!(matches!(large, ComponentError::Memory { call: Call::Instantiate, .. }), "{large}");
    assert!(holdpoint_text::Hint::sentence(&large).contains("memory_kib"));
    all_is_well();
}
