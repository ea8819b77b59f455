//! `holdpoint bench` measures everything it names, with its number of samples.

use assert_cmd::Command;
use serde_json::Value;

/// The required figures, by the start of their names.
const MEASURED: [&str; 15] = [
    "sandbox episode, grasp",
    "sandbox episode, align",
    "sandbox episode, place",
    "tick, whole",
    "tick, guard and harm",
    "tick, harm",
    "drill, rollback",
    "drill, detect",
    "shadow sequence",
    "static check, policies compiled",
    "behavior assessment, 120 pairs",
    "gate",
    "monitor, one episode",
    "audit commit, on disk",
    "audit verification of 10,000 records",
];

fn positive(figure: &Value, name: &str) {
    let count = figure["n"].as_u64().unwrap();
    let (median, p90) = (figure["median"].as_f64().unwrap(), figure["p90"].as_f64().unwrap());
    assert!(count >= 1 && median > 0.0 && p90 >= median, "{name}: {figure}");
}

#[test]
fn quick_bench_has_a_figure_of_everything() {
    let run = Command::new(env!("CARGO_BIN_EXE_holdpoint")).args(["bench", "--quick", "--json"]).unwrap();
    let report: Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!((&report["quick"], &report["robot"]), (&Value::from(true), &Value::from("arm7")));
    let entries = report["entries"].as_array().unwrap();
    for entry in entries {
        positive(entry, entry["name"].as_str().unwrap());
    }
    for name in MEASURED {
        let found = entries.iter().any(|entry| entry["name"].as_str().unwrap().starts_with(name));
        assert!(found, "{name} was not measured");
    }
}
