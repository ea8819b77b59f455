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

/// Before roles were a closed set.
pub const OPEN_ROLES: &str = "store-4831bf5";

/// Before an authorization covered the rules of a profile, and not only its class.
const WORDS_OF_CLASSES: &str = "store-d43131bc";

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
pub fn copied(name: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    copy(&fixture(name).join("store"), &folder.path().join("store"));
    folder
}

/// Runs the program on the copy with the fixture's arguments.
pub fn holdpoint(folder: &TempDir, words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint"))
        .current_dir(folder.path())
        .args(["--data", "store"])
        .args(words)
        .output()
        .unwrap()
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Runs the program, which must succeed; returns its output.
fn printed(folder: &TempDir, words: &[&str]) -> String {
    let output = holdpoint(folder, words);
    assert_eq!(output.status.code(), Some(0), "{words:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// The result of a call: its code, its output, and its errors.
#[derive(Debug, PartialEq)]
struct Ended {
    code: i32,
    printed: String,
    said: String,
}

/// The present answer of `identity list`: with each person's state, the protection of the key and its enroller, and
/// with mara's unknown role; beside the table, or in the document.
fn with_a_problem(then: Ended) -> Ended {
    if then.printed.starts_with('[') {
        return Ended { code: 1, ..then };
    }
    let row = |row: &str| {
        let (person, key) = row.split_at(22);
        let [state, word, by, confirmed] = if person.starts_with("NAME") {
            ["STATE", "PROTECTION", "ENROLLED BY", "CONFIRMED BY"]
        } else {
            ["not-enrolled", "unprotected", "-", "-"]
        };
        format!("{person}{state:14}{word:13}{by:13}{confirmed:14}{key}\n")
    };
    Ended { code: 1, printed: then.printed.lines().map(row).collect(), said: NO_ROLE.to_owned() }
}

/// Intended differences of exit codes, by the start of the call: an unknown role decides nothing, and is named.
fn changed(call: &str, then: Ended) -> Ended {
    match call {
        _ if call.starts_with("identity list") => with_a_problem(then),
        _ if call.contains("--as mara") => Ended { code: 2, said: NO_ROLE.to_owned(), ..then },
        _ => then,
    }
}

/// The fixture omits the bodies of evidence, which are long.
fn without_bodies(printed: &str) -> String {
    let mut shown: Value = serde_json::from_str(printed).unwrap();
    for evidence in shown["evidence"].as_array_mut().unwrap() {
        evidence.as_object_mut().unwrap().retain(|field, _| field != "body");
    }
    shown.to_string()
}

/// Additions by a later version are no difference: it may add fields, but may not remove or change one.
fn without_new_fields(now: &mut Value, then: &Value) {
    match (now, then) {
        (Value::Object(now), Value::Object(then)) => {
            now.retain(|field, _| then.contains_key(field));
            for (field, value) in now {
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
fn as_far_as_it_said(then: &str, now: &str) -> (String, String) {
    let parsed = |line: &str| serde_json::from_str::<Value>(line).ok();
    let reworded = |line: &str| [" decide ", " ask "].iter().any(|word| line.contains(word));
    let same_number = then.lines().count() == now.lines().count();
    let pairs = then.lines().zip(now.lines()).map(|(then, now)| match (parsed(then), parsed(now)) {
        (Some(mut before), Some(mut shown)) => {
            // A deadline in engine time is not a time of day, and is no longer printed.
            if before["event"] == "approval-requested"
                && let Some(fields) = before.as_object_mut()
            {
                fields.retain(|name, _| name != "deadline_ms");
            }
            without_new_fields(&mut shown, &before);
            (before.to_string(), shown.to_string())
        }
        _ if reworded(then) && reworded(now) => (String::new(), String::new()),
        _ => (then.to_owned(), now.to_owned()),
    });
    if same_number { pairs.unzip() } else { (then.to_owned(), now.to_owned()) }
}

#[test]
fn every_verb_that_reads_answers_as_it_did() {
    let folder = copied(OPEN_ROLES);
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
        let then = Ended {
            code: code.parse().unwrap(),
            printed: read(Path::new(file)),
            said: read(&Path::new(file).with_extension("err")),
        };
        let mut then = changed(call, then);
        // A list now omits telemetry digests unless they are requested.
        let all = if call.starts_with("audit list") && !call.contains("--kind") { " --all" } else { "" };
        let line = format!("{call}{all}");
        let output = holdpoint(&folder, &line.split(' ').collect::<Vec<_>>());
        let mut now = Ended {
            code: output.status.code().unwrap(),
            printed: text(&output.stdout),
            said: text(&output.stderr),
        };
        // No administrator authorized this program's profile, which earlier programs did not require.
        let unauthorized = ["profile  NOT AUTHORIZED: ", "profile: gate-profile-unauthorized: "];
        let told = |line: &&str| !unauthorized.iter().any(|said| line.starts_with(said));
        now.printed = now.printed.split_inclusive('\n').filter(told).collect();
        if call.starts_with("registry show") && call.ends_with("--json") {
            then.printed = serde_json::from_str::<Value>(&then.printed).unwrap().to_string();
            now.printed = without_bodies(&now.printed);
        }
        // Errors, too, are now JSON on request.
        if call.contains("--json") && then.code != 0 && then.said.starts_with("error: ") {
            let document: Value = serde_json::from_str(&now.said).unwrap();
            let hint = document["hint"].as_str().map_or_else(String::new, |hint| format!("Hint: {hint}\n"));
            assert_eq!(document["code"], now.code, "{call}");
            now.said = format!("error: {}\n{hint}", document["error"].as_str().unwrap());
        }
        (then.printed, now.printed) = as_far_as_it_said(&then.printed, &now.printed);
        assert_eq!(now, then, "{call}");
    }
}

#[test]
fn an_engine_carries_it_on_and_every_old_record_stays() {
    let folder = copied(OPEN_ROLES);
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/scenarios/reject-policy.toml");
    let scripted = holdpoint(&folder, &["run", "--headless", "--script", script]);
    assert_eq!(scripted.status.code(), Some(3), "{}", text(&scripted.stderr));
    assert!(text(&scripted.stderr).contains("no script uses this store"), "{}", text(&scripted.stderr));
    let run = || holdpoint(&folder, &["run", "--plain", "--profile", "sim"]);
    // Last used under a profile with approvals: changing to simulation needs an administrator's authorization.
    let refused = run();
    let said = text(&refused.stderr);
    assert_eq!(refused.status.code(), Some(3), "{said}");
    assert!(said.contains("holdpoint profile allow sim --by ADMIN"), "{said}");
    let allow = ["profile", "allow", "sim", "--by", "admin", "--reason", "a try"];
    let unguarded = text(&holdpoint(&folder, &allow).stderr);
    assert!(unguarded.contains("holdpoint identity passphrase admin"), "{unguarded}");
    let words = folder.path().join("words");
    fs::write(&words, "under the oak\n").unwrap();
    fs::set_permissions(&words, fs::Permissions::from_mode(0o600)).unwrap();
    printed(&folder, &["identity", "passphrase", "admin", "--new-passphrase-file", "words"]);
    printed(&folder, &[&allow[..], &["--passphrase-file", "words"]].concat());
    let run = run();
    assert_eq!(run.status.code(), Some(3), "{}{}", text(&run.stdout), text(&run.stderr));
    let verified = printed(&folder, &["audit", "verify"]);
    let records =
        verified.strip_prefix("sound: ").and_then(|rest| rest.split(' ').next()?.parse::<u64>().ok());
    assert!(records.is_some_and(|records| records > 322), "{verified}");
    let records = printed(&folder, &["audit", "export"]);
    let old = fs::read_to_string(fixture(OPEN_ROLES).join("expected/audit-export.jsonl")).unwrap();
    assert!(records.starts_with(&old) && records.len() > old.len());
    let status = printed(&folder, &["status"]);
    for line in [
        "family   align: active align@1.0.0, rollback target none",
        "family   grasp: active grasp@1.1.0, rollback target grasp@1.0.0",
        "version  align@1.1.1: registered, paused",
    ] {
        assert!(status.lines().any(|told| told.starts_with(line)), "{line} is not in\n{status}");
    }
    assert!(printed(&folder, &["recordings", "verify"]).ends_with(", 0 not as recorded\n"));
}

/// Used with approvals, and this program has another profile than its last one.
#[test]
fn it_activates_nothing_until_an_administrator_signs_the_profile_as_this_program_has_it() {
    let folder = copied(OPEN_ROLES);
    let says = |output: &Output, code: i32, parts: &[&str]| {
        let said = text(&output.stdout) + &text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{said}");
        assert!(parts.iter().all(|part| said.contains(part)), "{said}");
    };
    let voided = || {
        let all = printed(&folder, &["audit", "list", "--kind", "family-voided", "--json"]);
        all.matches("the profile or its policies changed").count()
    };
    let before = voided();
    let missing = ["NOT AUTHORIZED", "not on record", "`holdpoint profile allow --by ADMIN --reason TEXT`"];
    says(&holdpoint(&folder, &["status"]), 0, &missing);
    says(&holdpoint(&folder, &["explain", "align@1.1.1"]), 0, &["gate-profile-unauthorized"]);
    // It starts, and acts that take authority away succeed.
    let rollback = ["rollback", "grasp", "--as", "omar", "--reason", "a try"];
    // The arm is at standstill, so no other version takes control either.
    says(&holdpoint(&folder, &rollback), 3, &["grasp@1.1.0 is rolled back", "no version of grasp is active"]);
    says(&holdpoint(&folder, &["status"]), 0, &["version  grasp@1.1.0: demoted", "NOT AUTHORIZED"]);
    says(&holdpoint(&folder, &["candidate", "compat", "align@1.1.1"]), 3, &["no administrator authorized"]);
    assert_eq!(voided(), before, "nothing is void by a profile that is not in force");
    let words = folder.path().join("words");
    fs::write(&words, "under the oak\n").unwrap();
    fs::set_permissions(&words, fs::Permissions::from_mode(0o600)).unwrap();
    let passphrase = ["--passphrase-file", "words"];
    let allow = ["profile", "allow", "--by", "admin", "--reason", "the new version was read"];
    says(&holdpoint(&folder, &allow), 3, &["identity passphrase admin"]);
    printed(&folder, &["identity", "passphrase", "admin", "--new-passphrase-file", "words"]);
    says(
        &holdpoint(&folder, &[&allow[..], &passphrase[..]].concat()),
        0,
        &["profile  not on record", "allows the profile"],
    );
    // After the next start it is like any other store.
    says(&holdpoint(&folder, &["run", "--plain"]), 4, &["align@1.1.1 held", "grasp@1.1.0 rolled back"]);
    let voided = printed(&folder, &["audit", "list", "--kind", "family-voided"]);
    assert!(["align", "grasp", "park", "place"].iter().all(|family| voided.contains(family)), "{voided}");
    assert!(!printed(&folder, &["status"]).contains("NOT AUTHORIZED"));
    says(&holdpoint(&folder, &["audit", "verify"]), 0, &["sound"]);
}

/// A site profile keeps its texts, and the old authorization stays valid.
#[test]
fn a_store_whose_profile_is_its_own_waits_for_an_authorization_and_verifies() {
    let folder = copied(WORDS_OF_CLASSES);
    let export = fixture(WORDS_OF_CLASSES).join("export.jsonl");
    let sound = "sound: 44 records, head 3f59f5ee43acc9960e904ed5152b641a9f0df27114367762d73695cd3f21592b\n";
    assert!(printed(&folder, &["audit", "verify", "--file", export.to_str().unwrap()]).starts_with(sound));
    assert!(printed(&folder, &["audit", "verify"]).starts_with(sound));
    let run = || {
        let run = holdpoint(&folder, &["run", "--plain"]);
        assert_eq!(run.status.code(), Some(5), "{}", text(&run.stderr));
        text(&run.stdout)
    };
    let held = run();
    assert!(held.contains("profile human (line-4)") && held.contains("profile-unauthorized"), "{held}");
    assert!(
        printed(&folder, &["status"])
            .contains("NOT AUTHORIZED: no administrator authorized the profile human (line-4)")
    );
    fs::write(folder.path().join("words"), "under the oak\n").unwrap();
    fs::set_permissions(folder.path().join("words"), fs::Permissions::from_mode(0o600)).unwrap();
    let allow = ["profile", "allow", "--by", "admin", "--reason", "read", "--passphrase-file", "words"];
    let allowed = printed(&folder, &allow);
    assert!(allowed.ends_with("admin allows the profile human (line-4) for the next start\n"), "{allowed}");
    let taken = run();
    assert!(taken.contains("void") && !taken.contains("profile-unauthorized [high, unack"), "{taken}");
    assert!(!printed(&folder, &["status"]).contains("NOT AUTHORIZED"));
    assert!(printed(&folder, &["audit", "verify"]).starts_with("sound: "));
    printed(&folder, &["store", "export", "new.jsonl"]);
    assert!(printed(&folder, &["audit", "verify", "--file", "new.jsonl"]).starts_with("sound: "));
}

#[test]
fn a_role_outside_the_set_is_refused_by_name_and_stops_nobody_else() {
    let folder = copied(OPEN_ROLES);
    let resume = |who| holdpoint(&folder, &["resume", "align", "--as", who, "--reason", "the tray is back"]);
    let refused = resume("mara");
    assert_eq!((refused.status.code(), text(&refused.stderr).as_str()), (Some(2), NO_ROLE));
    // Last used under a profile with approvals, and this key is not enrolled.
    let resumed = resume("omar");
    let said = text(&resumed.stderr);
    assert!(resumed.status.code() == Some(3) && said.contains("identity enrol omar --by admin"), "{said}");
    // The first administrator, the recorded removal of telemetry from now on, and the missing authorization of the
    // profile.
    let verified = printed(&folder, &["audit", "verify"]);
    assert!(verified.starts_with("sound: 325 records"), "{verified}");
    let made = holdpoint(&folder, &["identity", "new", "eve", "--role", "safety-officer"]);
    let said = text(&made.stderr);
    assert_eq!(made.status.code(), Some(2), "{said}");
    for word in ["'safety-officer'", "operator", "engineer", "safety"] {
        assert!(said.contains(word), "{word} is not in {said}");
    }
    printed(&folder, &["identity", "new", "eve", "--role", "safety", "--unprotected"]);
    let listed = holdpoint(&folder, &["identity", "list", "--json"]);
    assert_eq!((listed.status.code(), text(&listed.stderr).as_str()), (Some(1), ""));
    let people: Vec<Value> = serde_json::from_slice(&listed.stdout).unwrap();
    let names: Vec<_> = people.iter().map(|one| one["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["admin", "eve", "ines", "mara", "omar", "sana"]);
    let problems: Vec<_> = people.iter().filter_map(|one| one["problem"].as_str()).collect();
    assert!(
        matches!(problems[..], [one] if one.contains("\"safety-officer\" is not a role")),
        "{problems:?}"
    );
}
