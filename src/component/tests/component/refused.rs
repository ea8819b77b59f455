//! What is no component, or none of the contract's: refused with one error that says what is allowed.

use holdpoint_component::{COMPONENT_BYTES_MAX, ComponentError};
use holdpoint_text::Hint as _;

use crate::guest::{Guest, INTERFACE, all_is_well, load, wit};

#[test]
fn a_file_of_another_type_is_identified() {
    for (bytes, begins) in
        [(b"".as_slice(), "nothing"), (b"#!/bin/sh", "23 21 2f 62 69 6e 2f 73"), (b"\0as", "00 61 73")]
    {
        assert_eq!(load(bytes).unwrap_err(), ComponentError::NotWasm { begins: begins.to_owned() });
    }
    // A compiled form is not accepted as a component.
    assert!(matches!(load(b"\x7fELF\x02\x01\x01\0").unwrap_err(), ComponentError::NotWasm { .. }));
    let core = load(&Guest::default().core()).unwrap_err();
    assert_eq!(core, ComponentError::CoreModule);
    assert!(core.sentence().contains("skill build"));
    let mut bytes = Guest::default().bytes();
    let whole = bytes.len();
    bytes.resize(COMPONENT_BYTES_MAX + 1, 0);
    assert_eq!(load(&bytes).unwrap_err(), ComponentError::TooLarge { bytes: COMPONENT_BYTES_MAX + 1 });
    assert_eq!(load(&vec![0; 100 << 20]).unwrap_err(), ComponentError::TooLarge { bytes: 100 << 20 });
    bytes.truncate(whole - 7);
    assert!(matches!(load(&bytes).unwrap_err(), ComponentError::Invalid { .. }));
    all_is_well();
}

#[test]
fn no_damaged_component_harms_the_host() {
    let whole = Guest::default().bytes();
    let mut loaded = 0;
    for place in (0..whole.len()).step_by(61) {
        let mut bytes = whole.clone();
        bytes[place] ^= 1 << (place % 8);
        loaded += usize::from(load(&bytes).is_ok());
        let _ = load(&whole[..place]).unwrap_err();
    }
    assert!(loaded < whole.len() / 61, "something must have been refused");
    all_is_well();
}

#[test]
fn features_that_are_off_are_refused() {
    for (what, more) in [
        ("memory64", "(memory $more i64 1)"),
        ("two memories", "(memory $more 1)"),
        ("threads", "(memory $more 1 1 shared)"),
        (
            "relaxed SIMD",
            "(func (param v128 v128 v128) (result v128) (f64x2.relaxed_madd (local.get 0) (local.get 1) (local.get 2)))",
        ),
        ("GC", "(type (struct (field i32))) (func (result (ref null struct)) (ref.null struct))"),
        ("exceptions", "(tag $e) (func (throw $e))"),
    ] {
        let bytes = Guest { more: more.to_owned(), ..Guest::default() }.bytes();
        let error = load(&bytes).unwrap_err();
        assert!(matches!(error, ComponentError::Invalid { .. }), "{what}: {error}");
    }
    let simd = "(func (param v128 v128) (result v128) (f64x2.add (local.get 0) (local.get 1)))";
    Guest { more: simd.to_owned(), ..Guest::default() }.load().unwrap();
    all_is_well();
}

/// A guest of a contract that differs in one place.
fn other(from: &str, to: &str) -> ComponentError {
    let package = wit();
    assert!(package.contains(from), "{from}");
    Guest { package: package.replace(from, to), ..Guest::default() }.load().unwrap_err()
}

#[test]
fn missing_or_mistyped_export_is_named() {
    let none = Guest {
        package: wit().replace("export skill;", "export aside: interface { f: func(); }"),
        ..Guest::default()
    };
    let more = r#"(func (export "aside#f"))"#.to_owned();
    let error = Guest { more, ..none }.load().unwrap_err();
    assert_eq!(error, ComponentError::NoExport { name: "holdpoint:skill/skill@2.0.0".to_owned() });
    assert!(error.sentence().contains("skill.wit"));
    let named = |error: ComponentError| match error {
        ComponentError::ExportType { name, .. } => name,
        error => panic!("{error}"),
    };
    let name = "holdpoint:skill/skill@1.0.0";
    let speed = other("max-speed-m-s: f64", "max-speed-m-s: f32");
    assert_eq!(named(speed), format!("{name}#tick"));
    assert_eq!(named(other("rollback,", "rollback, more,")), format!("{name}#enter"));
    assert_eq!(named(other("flag(bool)", "flag(u8)")), format!("{name}#describe"));
    let package = wit().replace("package holdpoint:skill@1.0.0", "package holdpoint:skill@3.0.0");
    let later = Guest { package, version: "3.0.0", ..Guest::default() }.load().unwrap_err();
    assert!(matches!(later, ComponentError::NoExport { .. }), "{later}");
    all_is_well();
}

#[test]
fn an_import_outside_the_host_is_refused() {
    let import = |interface: &str, line: &str| {
        let package = wit().replace("export skill;", &format!("{line} export skill;"));
        let import = format!("(import \"{interface}\" \"move\" (func))");
        Guest { package, import, ..Guest::default() }.load().unwrap_err()
    };
    let robot = import("robot", "import robot: interface { move: func(); }");
    assert_eq!(robot, ComponentError::Import { name: "robot".to_owned() });
    assert!(robot.to_string().contains("wasi:*@0.2"), "{robot}");
    let bare = import("$root", "import move: func();");
    assert_eq!(bare, ComponentError::Import { name: "move".to_owned() });
    all_is_well();
}

#[test]
fn malformed_interface_is_refused() {
    for (interface, expected) in [
        ("", "EOF"),
        ("{}", "missing field"),
        ("[1, 2", "invalid type"),
        (&INTERFACE.replace("\"hooks\"", "\"surprise\":1,\"hooks\""), "surprise"),
        (&INTERFACE.replace("1.0.0", "one"), "version number"),
    ] {
        let error = Guest { interface: interface.to_owned(), ..Guest::default() }.load().unwrap_err();
        let ComponentError::Interface { reason } = &error else { panic!("{error}") };
        assert!(reason.contains(expected), "{reason}");
    }
    all_is_well();
}

#[test]
fn code_that_exhausts_the_compiler_is_refused_before_compilation() {
    let error = |more: String| {
        let began = std::time::Instant::now();
        let error = Guest { more, ..Guest::default() }.load().unwrap_err();
        assert!(began.elapsed().as_secs() < 10, "{error}: {:?}", began.elapsed());
        error
    };
    let long = error(format!("(func (param i32) {})", "(drop (local.get 0))".repeat(90_000)));
    assert!(matches!(long, ComponentError::TooMuch { max: 262_144, .. }), "{long}");
    let many = error("(func)".repeat(20_000));
    assert!(matches!(many, ComponentError::TooMuch { max: 10_000, .. }), "{many}");
    let locals = error(format!("(func (local {}))", "i64 ".repeat(2_001)));
    assert!(matches!(locals, ComponentError::TooMuch { count: 2_001, max: 2_000, .. }), "{locals}");
    all_is_well();
}

#[test]
fn component_with_own_resources_is_refused() {
    let text = "(component (type $r (resource (rep i32))) (core func $new (canon resource.new $r)))";
    assert_eq!(load(&wat::parse_str(text).unwrap()).unwrap_err(), ComponentError::Resource);
    let within = format!(
        "(component (component {}))",
        text.trim_start_matches("(component ").trim_end_matches(')').to_owned() + "))"
    );
    assert_eq!(load(&wat::parse_str(within).unwrap()).unwrap_err(), ComponentError::Resource);
}
