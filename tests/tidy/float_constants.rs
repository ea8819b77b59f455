//! Limits are in profiles: the crates that decide have no float constant but those listed here, each with its kind.
//!
//! A new limit is a field of the profile. A new constant of another kind gets a line here and a reason in its comment.

use std::collections::BTreeSet;
use std::fs;

use regex::Regex;

use super::{is_test_file, program, report, sources};
use crate::data::root;

/// The crates whose constants are listed.
const CRATES: [&str; 5] = ["src/engine", "src/governance", "src/record", "src/runtime", "src/trials"];

/// What a constant is, where it is no limit of a profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ConstantKind {
    /// A constant of nature, or the number of units in another.
    Physical,
    /// Rounding: values that differ by less are equal.
    Tolerance,
    /// A parameter of an algorithm or of a statistical test, with which its guarantees are stated or measured.
    Method,
    /// What a measured value has to reach to say that something is so, in the terms of the sensors and the scene.
    Measured,
    /// The range of values that a file or a record may have.
    Format,
}

use ConstantKind::{Format, Measured, Method, Physical, Tolerance};

/// File, name and kind of every float constant.
const CONSTANTS: &[(&str, &str, ConstantKind)] = &[
    ("src/engine/live/ladder_motion.rs", "ARRIVED_M", Measured),
    ("src/engine/live/shadow.rs", "UNDECIDED_DIVERGENCE", Method),
    ("src/governance/behavior/harm.rs", "ASKING_ALPHA", Method),
    ("src/governance/behavior/sequences.rs", "NOT_DONE_PART", Method),
    ("src/governance/behavior/sequences.rs", "OTHER_PART", Method),
    ("src/governance/behavior/sequences.rs", "SHARING", Method),
    ("src/governance/distribution_shift.rs", "TRIFLE", Method),
    ("src/governance/harm.rs", "DISTANCE_MAX", Format),
    ("src/governance/live_harm.rs", "ANY_WEIGHT", Method),
    ("src/governance/live_harm.rs", "NORMAL_MAX", Method),
    ("src/governance/manifest.rs", "DECLARED_FORCE_MAX_N", Format),
    ("src/governance/manifest.rs", "DECLARED_SPEED_MAX_M_S", Format),
    ("src/governance/monitor.rs", "DEGRADED_MAX", Method),
    ("src/governance/monitor.rs", "SHIFT_MAX", Method),
    ("src/governance/phase.rs", "HELD_FROM_N", Measured),
    ("src/governance/phase.rs", "REACH_M", Measured),
    ("src/governance/phase.rs", "STILL_M_S", Measured),
    ("src/governance/profile/fields.rs", "SUM_WITHIN", Tolerance),
    ("src/governance/recovery/settle.rs", "BET", Method),
    ("src/governance/recovery/settle.rs", "UNSEEN_CHANCE", Method),
    ("src/governance/recovery/settle.rs", "WORSE_SHARE", Method),
    ("src/governance/stats.rs", "SHOWN_LEVEL", Method),
    ("src/governance/stats.rs", "STATISTIC_MAX", Tolerance),
    ("src/governance/stats/drift.rs", "ARL_MAX", Format),
    ("src/governance/stats/drift.rs", "BETS", Method),
    ("src/governance/stats/paired.rs", "SCORE_SHARE", Method),
    ("src/governance/stats/paired.rs", "SPREAD_MIN", Tolerance),
    ("src/governance/stats/population.rs", "LN_SLACK", Tolerance),
    ("src/governance/stats/rise.rs", "RISES", Method),
    ("src/governance/stats/special.rs", "CONVERGED", Tolerance),
    ("src/governance/stats/special.rs", "TINY", Tolerance),
    ("src/governance/stats/spot_check.rs", "ROUNDING_TOLERANCE", Tolerance),
    ("src/governance/stats/spot_check.rs", "SPOT_CHECK_POWER", Method),
    ("src/governance/text_error.rs", "EXPONENT_FROM", Format),
    ("src/governance/time_excess.rs", "MS_PER_MINUTE", Physical),
    ("src/governance/tries.rs", "FIRST_PART", Method),
    ("src/governance/value_type.rs", "MAGNITUDE_MAX", Format),
    ("src/governance/value_type.rs", "UNIT_WITHIN", Tolerance),
    ("src/runtime/agent/dispatcher.rs", "EQUAL_WITHIN", Tolerance),
    ("src/runtime/grant.rs", "DECLARED_MIN", Tolerance),
    ("src/runtime/guard.rs", "CLEARANCE_LOSS_M", Tolerance),
    ("src/runtime/guard.rs", "PARALLEL_M", Tolerance),
    ("src/runtime/harm.rs", "GRAVITY_M_S2", Physical),
    ("src/runtime/limits.rs", "SHARE_MIN", Format),
    ("src/runtime/recovery.rs", "HOOK_SECS_MAX", Format),
    ("src/runtime/senses.rs", "NONE", Format),
    ("src/runtime/task.rs", "CORRECTION_M", Measured),
    ("src/trials/cell/start_support.rs", "FRAME_ROUNDING_TICKS", Tolerance),
    ("src/trials/cell/start_support.rs", "GRAVITY_ROUNDED_M_S2", Physical),
    ("src/trials/cell/start_support.rs", "OUTSIDE_SHARE", Method),
    ("src/trials/cell/start_support.rs", "SENSOR_NOISE_SD", Measured),
    ("src/trials/drills/faults.rs", "NOISE_M_S", Measured),
    ("src/trials/drills/faults.rs", "OFF_SHARE", Method),
    ("src/trials/mode_metrics.rs", "WORST_SHARE", Method),
    ("src/trials/search.rs", "CROSSOVER_CHANCE", Method),
    ("src/trials/search.rs", "END_SHARE", Method),
    ("src/trials/search.rs", "MUTATION_CHANCE", Method),
    ("src/trials/search.rs", "MUTATION_STEP", Method),
    ("src/trials/search.rs", "RATIO_MAX", Method),
    ("src/trials/search.rs", "RESAMPLED_SHARE", Method),
];

/// The names of the float constants in a program, those of lists included.
fn float_constants(code: &str) -> Vec<String> {
    let constant = Regex::new(r"\bconst ([A-Z][A-Z0-9_]*): *&?\[?f(?:32|64)\b").unwrap();
    constant.captures_iter(code).map(|found| found[1].to_owned()).collect()
}

/// Whether a line before that of the constant is its comment, which gives its reason; attributes may stand between.
fn has_comment(text: &str, name: &str) -> bool {
    let lines: Vec<&str> = text.lines().map(str::trim_start).collect();
    let is_it = |line: &&str| line.contains(&format!("const {name}:"));
    let at = lines.iter().position(is_it).unwrap_or_default();
    let before = lines[..at].iter().rev().find(|line| !line.starts_with("#["));
    before.is_some_and(|line| line.starts_with("//"))
}

/// The numbers that a program compares with, but 0, one half and 1, which are the middle and the ends of a share.
/// A quantity with a unit is no share.
fn compared_literals(code: &str) -> Vec<String> {
    let number = r"\d[\d_]*\.\d[\d_]*(?:e-?\d+)?|\d[\d_]*e-?\d+";
    let compared =
        Regex::new(&format!(r"(?:^|[^=<>-])[<>]=? *-?({number})|\b({number})(?:_f64|_f32)? *[<>]")).unwrap();
    let quantity = Regex::new(&format!(r"_(?:m|n|s|ms|rad|m_s|rad_s)\b\)* *[<>]=? *-?({number})")).unwrap();
    let value = |text: &str| text.replace('_', "").parse::<f64>().unwrap();
    let compared = compared.captures_iter(code).filter_map(|found| found.get(1).or(found.get(2)));
    let compared = compared.filter(|literal| ![0.0, 0.5, 1.0].contains(&value(literal.as_str())));
    let quantities = quantity.captures_iter(code).filter_map(|found| found.get(1));
    let quantities = quantities.filter(|literal| [0.5, 1.0].contains(&value(literal.as_str())));
    compared.chain(quantities).map(|literal| literal.as_str().to_owned()).collect()
}

#[test]
fn float_constants_of_crates_that_decide_are_listed_with_their_kind() {
    let mut problems = Vec::new();
    let mut found = BTreeSet::new();
    for path in CRATES.into_iter().flat_map(sources).filter(|path| !is_test_file(path)) {
        let code = program(&path);
        let file = path.strip_prefix(root()).unwrap().to_str().unwrap().to_owned();
        for literal in compared_literals(&code) {
            problems.push(format!("{file} compares with {literal}: a limit is a field of the profile"));
        }
        let text = fs::read_to_string(&path).unwrap();
        for name in float_constants(&code) {
            if !has_comment(&text, &name) {
                problems.push(format!("{file}: {name} has no comment with its reason"));
            }
            found.insert((file.clone(), name));
        }
    }
    let listed: BTreeSet<(String, String)> =
        CONSTANTS.iter().map(|(file, name, _)| ((*file).to_owned(), (*name).to_owned())).collect();
    assert_eq!(listed.len(), CONSTANTS.len(), "a constant is listed once");
    for (file, name) in found.difference(&listed) {
        problems.push(format!(
            "{file} has {name}: a limit is a field of the profile, another constant is listed"
        ));
    }
    for (file, name) in listed.difference(&found) {
        problems.push(format!("{file} has no {name}"));
    }
    report(&problems);
}

/// The physical constants have units in their names.
#[test]
fn physical_constants_name_their_unit() {
    for (file, name, _) in CONSTANTS.iter().filter(|(_, _, kind)| *kind == Physical) {
        assert!(name.ends_with("_M_S2") || name.contains("_PER_"), "{file}: {name}");
    }
}

#[test]
fn float_detectors_find_constants_and_comparisons() {
    for (code, names) in [
        ("pub const LIMIT_M: f64 = 0.2;", ["LIMIT_M"].as_slice()),
        ("const BETS: [f64; 3] = [0.1, 0.2, 0.3];", &["BETS"]),
        ("const A: &[f32] = &[]; const TICKS: u32 = 3;", &["A"]),
        ("const fn of(value: f64) -> f64 { value }", &[]),
    ] {
        assert_eq!(float_constants(code), names, "{code}");
    }
    for (code, literals) in [
        ("if speed > 0.03 {", ["0.03"].as_slice()),
        ("if !(error <= 1e-9) {", &["1e-9"]),
        ("if 0.25 < share {", &["0.25"]),
        ("if share >= 0.5 && rate < 1.0 && rate > 0.0 {", &[]),
        ("if seen.gripper_force_n > 1.0 && slip_m > 0.0 {", &["1.0"]),
        ("Self::Adaptable => 0.7,", &[]),
        ("fn low() -> Vec<f64> { 0.1 }", &[]),
        ("if count > 3 {", &[]),
    ] {
        assert_eq!(compared_literals(code), literals, "{code}");
    }
    for (text, is_explained) in [
        ("/// Its reason.\npub const A: f64 = 0.2;", true),
        ("// Its reason.\n#[allow(dead_code)]\n    const A: f64 = 0.2;", true),
        ("/// Of another.\nconst B: f64 = 0.1;\nconst A: f64 = 0.2;", false),
    ] {
        assert_eq!(has_comment(text, "A"), is_explained, "{text}");
    }
}
