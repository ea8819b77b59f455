//! Scenarios with the cells of another process: the same log, line by line, as with the cells of the engine's process.
//!
//! `HOLDPOINT_WIRE_SCENARIOS="NAME NAME"` names the scenarios; `.ci/run --interop` names all of them. The test prints how
//! long each took on both ways, and how much processor time: the price of trials over the wire.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use crate::cell_process::{CellProcess, site_at};
use crate::quick_folder::quick_folder;

/// The scenarios of a plain test: one that ends in validation, and one that ends in the sandbox.
const SHORT: &str = "reject-interface reject-low-flight";

/// What may differ between the two logs, and nothing else: a field of an event. The digest of the policies and the one that
/// approvers sign cover the site file with the cell's endpoint; the keys of a script's people are new in each run.
const MAY_DIFFER: [(&str, &str); 3] =
    [("engine-started", "/policy"), ("registered", "/requester/key"), ("approval-requested", "/evidence")];

/// One run of a scenario.
struct Run {
    code: Option<i32>,
    log: Vec<Value>,
    wall_secs: f64,
    /// Processor time of the engine.
    cpu_secs: f64,
}

/// Runs a scenario, at a site or at the built-in one.
fn run(scenario: &str, data: &Path, site: Option<&str>) -> Run {
    let script = format!("tests/scenarios/{scenario}.toml");
    let mut timed = Command::new("bash");
    timed.env("LC_ALL", "C").args(["-c", "TIMEFORMAT='%R %U %S'; time \"$0\" \"$@\""]);
    timed.arg(env!("CARGO_BIN_EXE_holdpoint"));
    timed.args(["run", "--headless", "--json", "--seed", "1", "--no-recording", "--script", &script]);
    timed.arg("--data").arg(data);
    if let Some(site) = site {
        timed.args(["--site", site]);
    }
    let Output { status, stdout, stderr } = timed.output().unwrap();
    let told = String::from_utf8(stderr).unwrap();
    let times: Vec<f64> =
        told.lines().last().unwrap().split(' ').filter_map(|secs| secs.parse().ok()).collect();
    let [wall_secs, user_secs, system_secs] = times[..] else { panic!("{scenario}: {told}") };
    let log = String::from_utf8(stdout).unwrap();
    let log = log.lines().map(|line| serde_json::from_str(line).unwrap()).map(without_what_may_differ);
    Run { code: status.code(), log: log.collect(), wall_secs, cpu_secs: user_secs + system_secs }
}

fn without_what_may_differ(mut line: Value) -> Value {
    for (event, field) in MAY_DIFFER {
        if line["event"] == event
            && let Some(value) = line.pointer_mut(field)
        {
            *value = Value::Null;
        }
    }
    line
}

#[test]
fn scenarios_over_the_wire_have_the_log_of_scenarios_in_process() {
    let named = std::env::var("HOLDPOINT_WIRE_SCENARIOS").unwrap_or_else(|_| SHORT.to_owned());
    println!(
        "scenario, lines, in process: wall s, CPU s, over the wire: wall s, CPU s of the engine, CPU s of the cell"
    );
    let mut sums = [0.0; 5];
    for scenario in named.split_whitespace() {
        let root = quick_folder();
        let near = run(scenario, &root.path().join("near"), None);
        let served = CellProcess::in_folder(root.path());
        let (site, data) = (site_at(root.path(), &served.endpoint), root.path().join("far"));
        let far = run(scenario, &data, Some(&site));
        let differs = near.log.iter().zip(&far.log).position(|(near, far)| near != far);
        let lines = differs.map(|place| (&near.log[place], &far.log[place]));
        assert_eq!(lines, None, "{scenario}: line {differs:?}");
        assert_eq!((near.code, near.log.len()), (far.code, far.log.len()), "{scenario}");
        assert!(near.log.len() > 5, "{scenario}: the log is too short to compare");
        let verified = Command::new(env!("CARGO_BIN_EXE_holdpoint"))
            .args(["audit", "verify", "--data"])
            .arg(&data)
            .output()
            .unwrap();
        assert!(verified.status.success(), "{scenario}: {}", String::from_utf8_lossy(&verified.stdout));
        let secs = [near.wall_secs, near.cpu_secs, far.wall_secs, far.cpu_secs, served.cpu_secs()];
        println!("{scenario}, {}, {}", near.log.len(), shown(secs));
        for (sum, secs) in sums.iter_mut().zip(secs) {
            *sum += secs;
        }
    }
    println!("sum, -, {}", shown(sums));
}

fn shown(secs: [f64; 5]) -> String {
    secs.map(|secs| format!("{secs:.1}")).join(", ")
}
