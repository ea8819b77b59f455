//! `holdpoint lab bench` measures everything it names, with its number of samples; its study refutes no stated rate.

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
    assert_eq!(
        (&report["quick"], &report["physics"]),
        (&Value::from(true), &Value::from("f64, in the engine f32"))
    );
    let entries = report["entries"].as_array().unwrap();
    for entry in entries {
        positive(entry, entry["name"].as_str().unwrap());
    }
    for name in MEASURED {
        let found = entries.iter().any(|entry| entry["name"].as_str().unwrap().starts_with(name));
        assert!(found, "{name} was not measured");
    }
    let modes = report["peer"].as_array().unwrap();
    assert_eq!(modes.len(), 2, "{modes:?}");
    for peer in modes {
        positive(peer, "peer episode");
        assert!(peer["place_rate"].as_f64().unwrap() >= 0.99, "{peer}");
    }
}

/// The rules with stated error rates, by their names in the study.
const STUDIED: [&str; 6] = [
    "exact curtailment",
    "finite population, pass rule",
    "finite population, pairs",
    "kappa_B",
    "shadow",
    "monitor",
];

#[test]
fn a_short_study_refutes_no_stated_rate() {
    // A refuted rate ends with another code than 0, and `unwrap` then fails.
    let run = Command::new(env!("CARGO_BIN_EXE_holdpoint"))
        .args(["bench", "stats", "--runs", "100", "--json"])
        .unwrap();
    let report: Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!((report["runs"].as_u64(), report["tables"].as_array().map(Vec::len)), (Some(100), Some(9)));
    let findings = report["findings"].as_array().unwrap();
    for rule in STUDIED {
        let of = findings.iter().filter(|finding| finding["rule"] == rule);
        let stated = of.clone().filter(|finding| !finding["stated"].is_null()).count();
        assert!(stated > 0 && stated < of.count(), "{rule} has stated and other figures");
    }
    let value = |what: &str, under: &str| {
        let found =
            findings.iter().find(|f| f["what"] == what && f["under"].as_str().unwrap().starts_with(under));
        found.unwrap_or_else(|| panic!("{what}, {under}"))["value"].as_f64().unwrap()
    };
    // The findings of the study, with margins of more than four standard errors at a hundred runs.
    assert!(value("equally good: compatible", "align-improved, 300 pairs") > 0.9);
    assert!(value("equally good: compatible", "align-improved, 120 pairs") < 0.97);
    assert!(value("+.13 anomalies: incompatible", "place-robust, 300 pairs") > 0.95);
    assert!(value("median delay to rollback", "sim, 20 twins, failures 0.05 and +0.4") < 60.0);
}
