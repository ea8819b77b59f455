//! Stores of earlier versions: each opens, answers as it did, and continues.
//!
//! A store in `tests/fixtures` is beside the output of its own program (`MADE.md` there tells how it was made).
//! Intended differences are listed here, each with its reason; everything else is unchanged.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, SystemTime};

use holdpoint::scenes::BUILT_IN;
use serde_json::Value;
use tempfile::TempDir;

use crate::quick_folder::quick_folder;
use crate::reported_error::assert_error;

/// Before roles were a closed set.
pub const OPEN_ROLES: &str = "store-4831bf5";

/// Before an authorization covered the rules of a profile, and not only its class.
const CLASS_AUTHORIZATIONS: &str = "store-d43131bc";

/// The verb that verifies a store, with a report for programs.
const VERIFY: [&str; 3] = ["audit", "verify", "--json"];

/// The text for a person with an unknown role.
const NO_ROLE: &str = "error: the identity \"mara\" cannot decide anything: \"safety-officer\" is not a role; \
    allowed: operator, engineer, safety, admin\nHint: make another identity with one of these\n";

/// The time of its only recording: 2026-11-22 07:36 UTC.
const WRITTEN_SECS: u64 = 1_795_332_990;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

/// Copies a folder. Restores the modes of keys and the times of recordings, which a checkout loses.
fn copy(from: &Path, to: &Path) {
    let written = SystemTime::UNIX_EPOCH + Duration::from_secs(WRITTEN_SECS);
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let (from, to) = (entry.as_ref().unwrap().path(), to.join(entry.unwrap().file_name()));
        if from.is_dir() {
            copy(&from, &to);
            continue;
        }
        fs::copy(&from, &to).unwrap();
        match to.extension().and_then(|extension| extension.to_str()) {
            Some("key") => fs::set_permissions(&to, fs::Permissions::from_mode(0o600)).unwrap(),
            Some("rrd") => fs::File::open(&to).unwrap().set_modified(written).unwrap(),
            _ => {}
        }
    }
}

/// A copy of a store, as `store` in a new folder.
pub fn copy_fixture(name: &str) -> TempDir {
    let folder = quick_folder();
    copy(&fixture(name).join("store"), &folder.path().join("store"));
    folder
}

/// Runs the program on the copy with the fixture's arguments.
pub fn holdpoint(folder: &TempDir, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint"))
        .current_dir(folder.path())
        .args(["--data", "store"])
        .args(arguments)
        .output()
        .unwrap()
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Runs the program, which must succeed; returns its output.
fn output_of(folder: &TempDir, arguments: &[&str]) -> String {
    let output = holdpoint(folder, arguments);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// The result of a call: its code, its output, and its errors.
#[derive(Debug, PartialEq)]
struct CallResult {
    code: i32,
    stdout: String,
    stderr: String,
}

/// The present answer of `identity list`: with each person's state, the protection of the key and its enroller, and
/// with mara's unknown role; beside the table, or in the document.
fn with_a_problem(then: CallResult) -> CallResult {
    if then.stdout.starts_with('[') {
        return CallResult { code: 1, ..then };
    }
    let row = |row: &str| {
        let (person, key) = row.split_at(22);
        let [state, protection, by, confirmed_by] = if person.starts_with("NAME") {
            ["STATE", "PROTECTION", "ENROLLED BY", "CONFIRMED BY"]
        } else {
            ["not-enrolled", "unprotected", "-", "-"]
        };
        format!("{person}{state:14}{protection:13}{by:13}{confirmed_by:14}{key}\n")
    };
    CallResult { code: 1, stdout: then.stdout.lines().map(row).collect(), stderr: NO_ROLE.to_owned() }
}

/// Intended differences of exit codes, by the start of the call: an unknown role decides nothing, and is named.
fn changed(call: &str, then: CallResult) -> CallResult {
    match call {
        _ if call.starts_with("identity list") => with_a_problem(then),
        _ if call.contains("--as mara") => CallResult { code: 2, stderr: NO_ROLE.to_owned(), ..then },
        _ => then,
    }
}

/// The fixture omits the bodies of evidence, which are long.
fn without_bodies(json_text: &str) -> String {
    let mut document: Value = serde_json::from_str(json_text).unwrap();
    for evidence in document["evidence"].as_array_mut().unwrap() {
        evidence.as_object_mut().unwrap().retain(|field, _| field != "body");
    }
    document.to_string()
}

/// An explanation without the sentences about measurements: they now say in words what is worse, and no longer name limits
/// that are met.
fn without_measurements(json_text: &str) -> String {
    let mut document: Value = serde_json::from_str(json_text).unwrap();
    for decision in document["decisions"].as_array_mut().unwrap() {
        decision.as_object_mut().unwrap().retain(|field, _| field != "change");
        for reason in decision["reasons"].as_array_mut().unwrap() {
            reason.as_object_mut().unwrap().retain(|field, _| field != "measured");
            // The same time of motion, which includes the braking, was called the time beyond it.
            let text = reason["text"].as_str().unwrap();
            let text =
                text.replace("; it moved ", "; the arm moved for ").replace(" ms beyond braking", " ms");
            reason["text"] = text.into();
        }
    }
    document.to_string()
}

/// Additions by a later version are no difference: it may add fields, but may not remove or change one.
fn without_new_fields(now: &mut Value, then: &Value) {
    match (now, then) {
        (Value::Object(now), Value::Object(then)) => {
            now.retain(|field, _| then.contains_key(field));
            for (field, value) in now {
                // The status of a version now has its reason in every state.
                if field == "reason" && then[field].is_null() {
                    *value = Value::Null;
                }
                without_new_fields(value, &then[field]);
            }
        }
        (Value::Array(now), Value::Array(then)) => {
            for (now, then) in now.iter_mut().zip(then) {
                without_new_fields(now, then);
            }
        }
        _ => {}
    }
}

/// Both answers, line by line, as far as the older one has them: without newer fields, and without the texts of
/// decisions and requests, whose conditions changed from data to sentences.
fn comparable_lines(then: &str, now: &str) -> (String, String) {
    let parsed = |line: &str| serde_json::from_str::<Value>(line).ok();
    let reworded = |line: &str| [" decide ", " ask "].iter().any(|part| line.contains(part));
    let same_number = then.lines().count() == now.lines().count();
    let pairs = then.lines().zip(now.lines()).map(|(then, now)| match (parsed(then), parsed(now)) {
        (Some(mut before), Some(mut after)) => {
            // A deadline in engine time is not a time of day, and is no longer printed.
            if before["event"] == "approval-requested"
                && let Some(fields) = before.as_object_mut()
            {
                fields.retain(|name, _| name != "deadline_ms");
            }
            without_new_fields(&mut after, &before);
            (before.to_string(), after.to_string())
        }
        _ if reworded(then) && reworded(now) => (String::new(), String::new()),
        _ => (then.to_owned(), now.to_owned()),
    });
    if same_number { pairs.unzip() } else { (then.to_owned(), now.to_owned()) }
}

/// A line of `audit list` without its time, which ends with `s` or `UTC`.
fn without_time(line: &str) -> String {
    let words: Vec<&str> = line.split_whitespace().collect();
    let end = words.iter().position(|word| ["s", "UTC"].contains(word));
    let rest = end.map_or(&words[..], |end| &words[end + 1..]);
    [words.first().copied().unwrap_or_default(), &rest.join(" ")].join(" ")
}

#[test]
fn reading_verbs_answer_as_before() {
    let folder = copy_fixture(OPEN_ROLES);
    let expected = fixture(OPEN_ROLES).join("expected");
    let calls = fs::read_to_string(expected.join("exit-codes.txt")).unwrap();
    assert_eq!(calls.lines().count(), 66);
    for line in calls.lines() {
        let (code, rest) = line.split_once(' ').unwrap();
        let (file, call) = rest.split_once(": holdpoint ").unwrap();
        // A build without scenes replays nothing.
        if call.starts_with("replay") && !BUILT_IN {
            continue;
        }
        let read = |file: &Path| fs::read_to_string(expected.join(file)).unwrap_or_default();
        let then = CallResult {
            code: code.parse().unwrap(),
            stdout: read(Path::new(file)),
            stderr: read(&Path::new(file).with_extension("err")),
        };
        let mut then = changed(call, then);
        // A list now omits telemetry digests unless they are requested.
        let all = if call.starts_with("audit list") && !call.contains("--kind") { " --all" } else { "" };
        let line = format!("{call}{all}");
        let output = holdpoint(&folder, &line.split(' ').collect::<Vec<_>>());
        let mut now = CallResult {
            code: output.status.code().unwrap(),
            stdout: text(&output.stdout),
            stderr: text(&output.stderr),
        };
        // No administrator authorized this program's profile, which earlier programs did not require.
        let unauthorized = ["profile  NOT AUTHORIZED: ", "profile: gate-profile-unauthorized: "];
        let is_comparable = |line: &&str| !unauthorized.iter().any(|start| line.starts_with(start));
        now.stdout = now.stdout.split_inclusive('\n').filter(is_comparable).collect();
        // The status of a version, and who shelved an alarm, now follow in brackets.
        if call.starts_with("status") && !call.contains("--json") {
            let before_bracket =
                |line: &str| line.split_once("  [").map_or(line, |(start, _)| start).to_owned();
            for answer in [&mut then.stdout, &mut now.stdout] {
                let lines: Vec<String> = answer.lines().map(before_bracket).collect();
                *answer = lines.join("\n");
            }
        }
        if call.starts_with("registry show") && call.ends_with("--json") {
            then.stdout = serde_json::from_str::<Value>(&then.stdout).unwrap().to_string();
            now.stdout = without_bodies(&now.stdout);
        }
        // Errors, too, are now JSON on request.
        if call.contains("--json") && then.code != 0 && then.stderr.starts_with("error: ") {
            let document: Value = serde_json::from_str(&now.stderr).unwrap();
            let hint = document["hint"].as_str().map_or_else(String::new, |hint| format!("Hint: {hint}\n"));
            assert_eq!(document["code"], now.code, "{call}");
            now.stderr = format!("error: {}\n{hint}", document["error"].as_str().unwrap());
        }
        // A hint now repeats the store that the command line named.
        now.stderr = now.stderr.replace(" --data store`", "`");
        // The text is now the short form; JSON has what was printed before, with reworded measurements.
        if call.starts_with("explain") {
            for answer in [&mut then.stdout, &mut now.stdout] {
                *answer = if call.ends_with("--json") { without_measurements(answer) } else { String::new() };
            }
        }
        then.stdout = then.stdout.replace("no: voided since", "no: it was voided later");
        // The columns of times have times of day where the record has them.
        if call.starts_with("registry list") && !call.contains("--json") {
            for answer in [&mut then.stdout, &mut now.stdout] {
                let last = answer.find("CHANGED").map_or(0, |at| answer[..at].chars().count());
                let lines: Vec<String> =
                    answer.lines().map(|line| line.chars().take(last).collect()).collect();
                *answer = lines.join("\n");
            }
        }
        if call.starts_with("audit list") && !call.contains("--json") {
            for answer in [&mut then.stdout, &mut now.stdout] {
                let lines: Vec<String> = answer.lines().map(without_time).collect();
                *answer = lines.join("\n");
            }
        }
        (then.stdout, now.stdout) = comparable_lines(&then.stdout, &now.stdout);
        assert_eq!(now, then, "{call}");
    }
}

#[test]
fn engine_continues_an_old_store_and_keeps_every_record() {
    let folder = copy_fixture(OPEN_ROLES);
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/scenarios/reject-policy.toml");
    let script_output = holdpoint(&folder, &["run", "--headless", "--script", script, "--json"]);
    assert_error(&script_output, 3, "script-after-live");
    // Last used under a profile with approvals: changing to simulation needs an administrator's authorization.
    let run = ["run", "--plain", "--profile", "sim"];
    let output = holdpoint(&folder, &[&run[..], &["--json"]].concat());
    assert_error(&output, 3, "profile-not-authorized");
    let allow = ["profile", "allow", "sim", "--by", "admin", "--reason", "a try"];
    let unguarded = holdpoint(&folder, &[&allow[..], &["--json"]].concat());
    assert_error(&unguarded, 3, "not-allowed/no-passphrase");
    let passphrase_file = folder.path().join("words");
    fs::write(&passphrase_file, "under the oak\n").unwrap();
    fs::set_permissions(&passphrase_file, fs::Permissions::from_mode(0o600)).unwrap();
    output_of(&folder, &["identity", "passphrase", "admin", "--new-passphrase-file", "words"]);
    output_of(&folder, &[&allow[..], &["--passphrase-file", "words"]].concat());
    let run = holdpoint(&folder, &run);
    assert_eq!(run.status.code(), Some(3), "{}{}", text(&run.stdout), text(&run.stderr));
    let verified: Value = serde_json::from_str(&output_of(&folder, &VERIFY)).unwrap();
    assert!(verified["report"]["records"].as_u64() > Some(322), "{verified}");
    let records = output_of(&folder, &["audit", "export"]);
    let old = fs::read_to_string(fixture(OPEN_ROLES).join("expected/audit-export.jsonl")).unwrap();
    assert!(records.starts_with(&old) && records.len() > old.len());
    let status: Value = serde_json::from_str(&output_of(&folder, &["status", "--json"])).unwrap();
    let row = |list: &str, key: &str, name: &str| {
        let rows = status[list].as_array().unwrap();
        rows.iter().find(|one| one[key] == name).unwrap_or_else(|| panic!("{name}: {status}")).clone()
    };
    for (family, active, target) in
        [("align", "align@1.0.0", None), ("grasp", "grasp@1.1.0", Some("grasp@1.0.0"))]
    {
        let row = row("families", "family", family);
        assert_eq!(
            (row["active"].as_str(), row["rollback_target"].as_str()),
            (Some(active), target),
            "{row}"
        );
    }
    let paused = row("versions", "version", "align@1.1.1");
    assert!(paused["state"] == "registered" && paused["paused"] == true, "{paused}");
    let recordings = output_of(&folder, &["recordings", "verify", "--json"]);
    let summary: Value = serde_json::from_str(recordings.lines().last().unwrap()).unwrap();
    assert_eq!(summary["bad"], 0);
}

/// Used with approvals, and this program has another profile than its last one.
#[test]
fn no_version_activates_until_an_administrator_signs_the_changed_profile() {
    let folder = copy_fixture(OPEN_ROLES);
    let check = |output: &Output, code: i32, parts: &[&str]| {
        let message = text(&output.stdout) + &text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{message}");
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    };
    let void_count = || {
        let all = output_of(&folder, &["audit", "list", "--kind", "family-voided", "--json"]);
        all.matches("\"subject\":\"align\"").count()
    };
    let before = void_count();
    let missing = ["NOT AUTHORIZED", "`holdpoint profile allow --by admin --reason TEXT`"];
    check(&holdpoint(&folder, &["status"]), 0, &missing);
    check(&holdpoint(&folder, &["explain", "align@1.1.1"]), 0, &["gate-profile-unauthorized"]);
    // It starts, and acts that take authority away succeed.
    let rollback = ["rollback", "grasp", "--as", "omar", "--reason", "a try", "--json"];
    // The arm is at standstill, so no other version takes control either.
    assert_error(&holdpoint(&folder, &rollback), 3, "safe-stopped");
    check(&holdpoint(&folder, &["status"]), 0, &["version  grasp@1.1.0: demoted", "NOT AUTHORIZED"]);
    check(&holdpoint(&folder, &["candidate", "compat", "align@1.1.1"]), 3, &["administrator authorized"]);
    assert_eq!(void_count(), before, "nothing is void by a profile that is not in force");
    let passphrase_file = folder.path().join("words");
    fs::write(&passphrase_file, "under the oak\n").unwrap();
    fs::set_permissions(&passphrase_file, fs::Permissions::from_mode(0o600)).unwrap();
    let passphrase = ["--passphrase-file", "words"];
    let allow = ["profile", "allow", "--by", "admin", "--reason", "the new version was read"];
    let unguarded = holdpoint(&folder, &[&allow[..], &["--json"]].concat());
    assert_error(&unguarded, 3, "not-allowed/no-passphrase");
    output_of(&folder, &["identity", "passphrase", "admin", "--new-passphrase-file", "words"]);
    let allowed = output_of(&folder, &[&allow[..], &passphrase[..], &["--json"]].concat());
    let allowed: Value = serde_json::from_str(&allowed).unwrap();
    assert_eq!(allowed["by"], "admin", "{allowed}");
    assert_eq!(allowed["loosened"][0]["field"], "profile", "nothing is on record before it: {allowed}");
    // After the next start it is like any other store.
    check(&holdpoint(&folder, &["run", "--plain"]), 4, &["align@1.1.1 held", "grasp@1.1.0 rolled back"]);
    let void_records = output_of(&folder, &["audit", "list", "--kind", "family-voided"]);
    assert!(
        ["align", "grasp", "park", "place"].iter().all(|family| void_records.contains(family)),
        "{void_records}"
    );
    assert!(!output_of(&folder, &["status"]).contains("NOT AUTHORIZED"));
    check(&holdpoint(&folder, &["audit", "verify"]), 0, &["sound"]);
}

/// A site profile keeps its texts, and the old authorization stays valid.
#[test]
fn old_store_with_a_site_profile_waits_for_an_authorization() {
    let folder = copy_fixture(CLASS_AUTHORIZATIONS);
    let export = fixture(CLASS_AUTHORIZATIONS).join("export.jsonl");
    for arguments in [&["audit", "verify", "--file", export.to_str().unwrap(), "--json"][..], &VERIFY] {
        let verified: Value = serde_json::from_str(&output_of(&folder, arguments)).unwrap();
        assert_eq!(verified["report"]["records"], 44, "{verified}");
        let head = "3f59f5ee43acc9960e904ed5152b641a9f0df27114367762d73695cd3f21592b";
        assert_eq!(verified["report"]["head"], head, "{verified}");
    }
    let run = || {
        let run = holdpoint(&folder, &["run", "--plain"]);
        assert_eq!(run.status.code(), Some(5), "{}", text(&run.stderr));
        text(&run.stdout)
    };
    let first_run = run();
    assert!(
        first_run.contains("human (line-4)") && first_run.contains("profile-unauthorized"),
        "{first_run}"
    );
    let status: Value = serde_json::from_str(&output_of(&folder, &["status", "--json"])).unwrap();
    assert!(status["unauthorized"].as_str().unwrap().contains("human (line-4)"), "{status}");
    fs::write(folder.path().join("words"), "under the oak\n").unwrap();
    fs::set_permissions(folder.path().join("words"), fs::Permissions::from_mode(0o600)).unwrap();
    let allow = ["profile", "allow", "--by", "admin", "--reason", "read", "--passphrase-file", "words"];
    assert!(output_of(&folder, &allow).contains("human (line-4)"));
    let second_run = run();
    assert!(
        second_run.contains("void") && !second_run.contains("profile-unauthorized [high, unack"),
        "{second_run}"
    );
    let status: Value = serde_json::from_str(&output_of(&folder, &["status", "--json"])).unwrap();
    assert_eq!(status.get("unauthorized"), None, "{status}");
    output_of(&folder, &VERIFY);
    output_of(&folder, &["store", "export", "new.jsonl"]);
    output_of(&folder, &["audit", "verify", "--file", "new.jsonl"]);
}

#[test]
fn unknown_role_is_refused_by_name_and_affects_no_other_person() {
    let folder = copy_fixture(OPEN_ROLES);
    let resume =
        |who| holdpoint(&folder, &["resume", "align", "--as", who, "--reason", "the tray is back", "--json"]);
    assert_error(&resume("mara"), 2, "not-allowed/unknown-role");
    // Last used under a profile with approvals, and this key is not enrolled.
    let error = assert_error(&resume("omar"), 3, "not-allowed");
    assert!(error["hint"].as_str().unwrap().contains("identity enroll omar --by admin"), "{error}");
    // The first administrator, the recorded removal of telemetry from now on, and the missing authorization of the
    // profile.
    let verified: Value = serde_json::from_str(&output_of(&folder, &VERIFY)).unwrap();
    assert_eq!(verified["report"]["records"], 325, "{verified}");
    let output = holdpoint(&folder, &["identity", "new", "eve", "--role", "safety-officer"]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    for part in ["'safety-officer'", "operator", "engineer", "safety"] {
        assert!(message.contains(part), "{part} is not in {message}");
    }
    output_of(&folder, &["identity", "new", "eve", "--role", "safety", "--unprotected"]);
    let list = holdpoint(&folder, &["identity", "list", "--json"]);
    assert_eq!((list.status.code(), text(&list.stderr).as_str()), (Some(1), ""));
    let people: Vec<Value> = serde_json::from_slice(&list.stdout).unwrap();
    let names: Vec<_> = people.iter().map(|one| one["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["admin", "eve", "ines", "mara", "omar", "sana"]);
    let problems: Vec<_> = people.iter().filter_map(|one| one["problem"].as_str()).collect();
    assert!(matches!(problems[..], [one] if one.contains("\"safety-officer\"")), "{problems:?}");
}
