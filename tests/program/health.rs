//! `holdpoint health` on a store whose tasks SQL counts a second time, and the engine's clock over a sudden end.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use holdpoint::protocol::command::{Command as Ask, Reply};
use holdpoint::service::control_socket::Client;
use holdpoint::store::Layout;
use holdpoint_wording::program::alarms::no_change;
use rusqlite::Connection;
use serde_json::Value;

use crate::quick_folder::quick_folder;
use crate::reported_error::{assert_error, is_about};

/// A generous time limit.
const PATIENCE: Duration = Duration::from_mins(1);

fn holdpoint(arguments: &[&str], data: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint")).args(arguments).arg("--data").arg(data).output().unwrap()
}

fn output_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// A store of an earlier version with twenty live tasks of two versions; a script made it, so it has no machine
/// time.
fn store() -> tempfile::TempDir {
    let folder = quick_folder();
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/store-4831bf5/store");
    for file in ["holdpoint.db", "telemetry.db"] {
        fs::copy(from.join(file), folder.path().join(file)).unwrap();
    }
    folder
}

#[test]
fn health_shows_the_tasks_marks_and_verdicts_of_the_store() {
    let folder = store();
    let data = folder.path();
    let sql = Connection::open(data.join("telemetry.db")).unwrap();
    let count = |sql_text: &str| sql.query_row(sql_text, [], |row| row.get::<_, u64>(0)).unwrap();
    let tasks = count("SELECT count(*) FROM batch WHERE stream = 'live'");
    let done = count("SELECT count(*) FROM batch WHERE stream = 'live' AND body LIKE '%\"success\":true,%'");
    let output = holdpoint(&["health", "--json", "--since", "@1"], data);
    assert!(output.status.success(), "{}", output_text(&output));
    let health: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(health["clock"], "virtual");
    let points = health["points"].as_array().unwrap();
    let sum = |field: &str| points.iter().map(|point| point[field].as_u64().unwrap()).sum::<u64>();
    assert_eq!((sum("tasks"), sum("succeeded")), (tasks, done), "{health}");
    let kinds: Vec<&str> =
        health["marks"].as_array().unwrap().iter().map(|mark| mark["kind"].as_str().unwrap()).collect();
    assert!(kinds.contains(&"promotion") && kinds.contains(&"first-version"), "{kinds:?}");
    let (csv, svg) = (data.join("week.csv"), data.join("week.svg"));
    let paths = [csv.to_str().unwrap(), svg.to_str().unwrap()];
    let arguments = ["health", "--family", "align", "--csv", paths[0], "--svg", paths[1]];
    let text = output_text(&holdpoint(&arguments, data));
    assert!(text.contains("align since") && text.contains("P 00:"), "{text}");
    assert!(
        fs::read_to_string(&svg).unwrap().contains("<svg") && fs::read_to_string(&csv).unwrap().len() > 200
    );
    // No file is overwritten.
    let error = assert_error(&holdpoint(&[&arguments[..], &["--json"]].concat(), data), 2, "exists");
    assert!(is_about(&error, "week.csv"), "{error}");
    let courses = output_text(&holdpoint(&["alarms", "--history", "--courses"], data));
    assert!(courses.contains("raised by") && courses.contains("has stood"), "{courses}");
}

/// Its last records are of 2522.101 s; before these, alarms changed at 2467.284 s and 1818.931 s.
#[test]
fn alarms_and_records_since_a_moment_are_listed() {
    let folder = store();
    let count = |arguments: &[&str]| {
        let output = holdpoint(&[arguments, &["--json"]].concat(), folder.path());
        assert!(output.status.success(), "{arguments:?}: {}", output_text(&output));
        String::from_utf8(output.stdout).unwrap().lines().count()
    };
    let (history, courses) =
        (["alarms", "--history", "--since"], ["alarms", "--history", "--courses", "--since"]);
    for (verb, since, expected) in [
        (&["audit", "list", "--since"][..], "30s", 3),
        (&["audit", "list", "--since"], "@2500", 3),
        (&["audit", "list", "--since"], "#320", 3),
        (&["audit", "list", "--since"], "@9999", 0),
        (&["audit", "list", "--kind", "alarm-changed", "--since"], "@2467.284", 2),
        (&["alarms", "--since"], "30s", 1),
        (&["alarms", "--since"], "@1800", 3),
        (&["alarms", "--since"], "@9999", 0),
        (&history[..], "30s", 1),
        (&history, "@2467", 2),
        (&history, "@9999", 0),
        // Five are still open.
        (&courses[..], "30s", 5),
        (&courses, "@2462", 6),
    ] {
        assert_eq!(count(&[verb, &[since]].concat()), expected, "{verb:?} {since}");
    }
    for verb in [&["audit", "list", "--json"][..], &["alarms", "--json"], &["alarms", "--history", "--json"]]
    {
        for (since, part) in [("soon", "\"soon\""), ("tuesday", "machine time")] {
            let output = holdpoint(&[verb, &["--since", since]].concat(), folder.path());
            let error = assert_error(&output, 2, "usage");
            assert!(error["error"].as_str().unwrap().contains(part), "{verb:?} {since}: {error}");
        }
    }
    let output = holdpoint(&["alarms", "--since", "@9999"], folder.path());
    assert_eq!(output_text(&output), format!("{}\n", no_change(true, false)));
}

#[test]
fn an_invalid_option_is_one_sentence() {
    let folder = store();
    for (arguments, part) in [
        (vec!["--since", "soon"], "\"soon\""),
        (vec!["--since", "tuesday"], "machine time"),
        (vec!["--since", "@9999999"], "is empty"),
        (vec!["--since", "@10", "--until", "@5"], "is empty"),
        (vec!["--since", "@1", "--until", "2026-11-17"], "two clocks"),
        (vec!["--bucket", "1s"], "\"1s\""),
        (vec!["--bucket", "2d"], "\"2d\""),
        (vec!["--family", "No Family"], "No Family"),
    ] {
        let output = holdpoint(&[&["health", "--json"], arguments.as_slice()].concat(), folder.path());
        let error = assert_error(&output, 2, "usage");
        // The code is the same for all: the sentence tells what is wrong with the option.
        assert!(error["error"].as_str().unwrap().contains(part), "{arguments:?}: {error}");
    }
    let nothing = quick_folder();
    assert_error(&holdpoint(&["health", "--json"], nothing.path()), 2, "no-store");
}

/// A running engine; it does not outlive the test.
struct Service(Child);

impl Service {
    fn start(data: &Path) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
        command.args(["serve", "--jobs", "1", "--quiet", "--data"]).arg(data);
        Self(command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

/// The engine's time once it is at least this.
fn time_from(data: &Path, at_least_ms: u64) -> u64 {
    let until = Instant::now() + PATIENCE;
    let layout = Layout::new(data);
    loop {
        assert!(Instant::now() < until, "the engine says no time from {at_least_ms} ms on");
        let Ok(Some(mut client)) = Client::connect(&layout) else { continue };
        let Ok(Reply::Snapshot { snapshot }) = client.send(Ask::Snapshot) else { continue };
        if snapshot.reading.is_none() && snapshot.at_ms >= at_least_ms {
            assert!(snapshot.wall_ms.unwrap() > 1_700_000_000_000);
            return snapshot.at_ms;
        }
    }
}

#[test]
fn clock_continues_from_its_stored_time_and_not_from_the_last_record() {
    let folder = quick_folder();
    let data = folder.path().join("store");
    let first = Service::start(&data);
    // Long after the last record: the first versions are bound within the first second.
    let stood_ms = time_from(&data, 4_000);
    drop(first);
    let sql = Connection::open(data.join("holdpoint.db")).unwrap();
    let last_ms: u64 = sql.query_row("SELECT max(at_ms) FROM audit", [], |row| row.get(0)).unwrap();
    assert!(last_ms + 2_000 < stood_ms, "the record ends at {last_ms} and the clock stood at {stood_ms}");
    drop(sql);
    let _second = Service::start(&data);
    let resumed_ms = time_from(&data, 1);
    // A sudden end takes back a second at most.
    assert!(resumed_ms + 1_100 >= stood_ms, "from {stood_ms} to {resumed_ms}");
}
