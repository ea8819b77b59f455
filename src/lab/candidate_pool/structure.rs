//! Faults in the manifest: broken interfaces and permissions that exceed the policies.
//!
//! The mechanisms of the paper's appendix C. Owns their list and how each is written; `generate` selects a candidate's
//! mechanism.

use holdpoint_cell::rng::Stream;
use toml::{Table, Value};

use super::draft::Draft;
use super::generate::{number, sample_integer};

/// One mechanism: its name in the truth and what it does to a package of a family.
pub type Mechanism = (&'static str, fn(&mut Draft, &str, &mut Stream));

/// Ways to break callers; each alone is breaking by design rule 3.2.
pub const INTERFACE: [Mechanism; 9] = [
    ("interface-frame", frame),
    ("interface-unit", unit),
    ("interface-input", input),
    ("interface-precondition", precondition),
    ("interface-postcondition", postcondition),
    ("interface-output", output),
    ("interface-outcome", outcome),
    ("interface-dependency", dependency),
    ("interface-export", export),
];

/// Ways to request too much; each alone is incompatible or a matter for review by design rule 3.3.
pub const PERMISSION: [Mechanism; 5] = [
    ("permission-bus", bus),
    ("permission-human-zone", human_zone),
    ("permission-authority", authority),
    ("permission-undeclared", undeclared),
    ("permission-resources", resources),
];

/// The object is expected in another frame. For grasp there is code that really does.
fn frame(draft: &mut Draft, family: &str, stream: &mut Stream) {
    let frame = if family == "grasp" || stream.chance(0.5) { "tool" } else { "target" };
    draft.field(&["inputs", "object", "frame"], frame);
    if family == "grasp" {
        draft.field(&["deployment", "bundle"], "native:grasp-tool-frame");
    }
}

/// The duration comes back in milliseconds.
fn unit(draft: &mut Draft, _: &str, stream: &mut Stream) {
    let longest_ms = f64::from(sample_integer(stream, [10, 60])) * 1000.0;
    draft.field(&["outputs", "duration", "unit"], "ms");
    draft.field(&["outputs", "duration", "range"], vec![0.0, longest_ms]);
}

/// A new input that every caller has to give.
fn input(draft: &mut Draft, _: &str, stream: &mut Stream) {
    let (name, unit, low, high) = [
        ("surface-height", "m", -0.1, 0.1),
        ("object-mass", "kg", 0.0, 2.0),
        ("approach-heading", "rad", -3.2, 3.2),
        ("friction", "1", 0.0, 1.5),
    ][pick(stream, 4)];
    let mut spec = Table::new();
    spec.insert("type".to_owned(), Value::from("real"));
    spec.insert("unit".to_owned(), Value::from(unit));
    spec.insert("range".to_owned(), Value::from(vec![low, high]));
    draft.field(&["inputs", name], spec);
}

/// It wants the tool higher than callers had to bring it.
fn precondition(draft: &mut Draft, _: &str, stream: &mut Stream) {
    let height_m = number(stream, [0.10, 0.20]);
    draft.field(&["invocation", "preconditions", "tool-height", "min"], height_m);
}

/// It no longer promises what callers build on.
fn postcondition(draft: &mut Draft, _: &str, _: &mut Stream) {
    draft.remove(&["invocation", "postconditions", "holding"]);
}

/// A result that callers read is gone.
fn output(draft: &mut Draft, _: &str, stream: &mut Stream) {
    let name = if stream.chance(0.5) { "duration" } else { "outcome" };
    draft.remove(&["outputs", name]);
}

/// The outcome takes a value that callers do not know.
fn outcome(draft: &mut Draft, _: &str, stream: &mut Stream) {
    let value = ["partial", "unknown", "retry", "degraded"][pick(stream, 4)];
    draft.set_list_item(&["outputs", "outcome", "values"], value, true);
}

/// It depends on a version that is not registered.
fn dependency(draft: &mut Draft, _: &str, stream: &mut Stream) {
    let family = ["locate", "park", "inspect"][pick(stream, 3)];
    let major = sample_integer(stream, [2, 9]);
    draft.field(
        &["deployment", "dependencies", family],
        format!("^{major}.{}", sample_integer(stream, [0, 9])),
    );
}

/// The manifest offers what the code does not export.
fn export(draft: &mut Draft, family: &str, stream: &mut Stream) {
    let ending = ["fast", "gentle", "blind", "batch"][pick(stream, 4)];
    draft.set_list_item(&["invocation", "entry_points"], &format!("{family}-{ending}"), true);
}

/// Raw actuator values on the field bus, past the servo and the guard.
fn bus(draft: &mut Draft, _: &str, stream: &mut Stream) {
    draft.set_list_item(&["permissions", "channels"], "bus", true);
    draft.set_list_item(&["permissions", "commands"], "direct", true);
    draft.field(&["permissions", "authority"], i64::from(sample_integer(stream, [2, 3])));
}

/// The zone where a person may be.
fn human_zone(draft: &mut Draft, _: &str, _: &mut Stream) {
    draft.set_list_item(&["permissions", "zones"], "human", true);
}

/// It would change what other skills rely on, or override them.
fn authority(draft: &mut Draft, _: &str, stream: &mut Stream) {
    draft.field(&["permissions", "authority"], i64::from(sample_integer(stream, [2, 3])));
}

/// The code needs what the manifest does not declare.
fn undeclared(draft: &mut Draft, family: &str, _: &mut Stream) {
    if family == "align" {
        draft.set_list_item(&["permissions", "commands"], "stop", false);
    } else {
        draft.set_list_item(&["permissions", "commands"], "gripper", false);
        draft.set_list_item(&["permissions", "channels"], "gripper", false);
    }
}

/// More of the computer than any profile has.
fn resources(draft: &mut Draft, _: &str, stream: &mut Stream) {
    if stream.chance(0.5) {
        let cpu_us = i64::from(sample_integer(stream, [1_500, 6_000]));
        draft.field(&["permissions", "resources", "cpu_us_per_tick"], cpu_us);
    } else {
        let memory_kib = i64::from(sample_integer(stream, [100_000, 900_000]));
        draft.field(&["permissions", "resources", "memory_kib"], memory_kib);
    }
}

/// An index below `count`.
fn pick(stream: &mut Stream, count: u32) -> usize {
    sample_integer(stream, [0, count.saturating_sub(1)]) as usize
}
