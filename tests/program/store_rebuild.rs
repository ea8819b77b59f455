//! A store with edited tables: no verb trusts it, no write hides the edit, and a rebuild repairs it.

use rusqlite::Connection;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::old_stores::{OPEN_ROLES, copy_fixture, holdpoint, text};
use crate::reported_error::assert_error;

/// A copy of an earlier version's store, edited with SQL past its triggers, which are then restored.
fn edited_store(sql: &str) -> TempDir {
    let folder = copy_fixture(OPEN_ROLES);
    let connection = Connection::open(folder.path().join("store/holdpoint.db")).unwrap();
    let mut select =
        connection.prepare("SELECT name, sql FROM sqlite_schema WHERE type = 'trigger'").unwrap();
    let triggers: Vec<(String, String)> =
        select.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap().map(Result::unwrap).collect();
    drop(select);
    for (name, _) in &triggers {
        connection.execute_batch(&format!("DROP TRIGGER {name}")).unwrap();
    }
    connection.execute_batch("PRAGMA foreign_keys = OFF; PRAGMA ignore_check_constraints = ON").unwrap();
    connection.execute_batch(sql).unwrap();
    for (_, sql) in &triggers {
        connection.execute_batch(sql).unwrap();
    }
    folder
}

/// The exit code of a call, and all its output.
fn run(folder: &TempDir, arguments: &[&str]) -> (i32, String) {
    let output = holdpoint(folder, arguments);
    (output.status.code().unwrap(), text(&output.stdout) + &text(&output.stderr))
}

/// The answer of a call that must succeed.
#[track_caller]
fn succeeds(folder: &TempDir, arguments: &[&str]) -> Value {
    let (code, text) = run(folder, arguments);
    assert_eq!(code, 0, "{text}");
    serde_json::from_str(&text).unwrap()
}

/// The error of a verb that refuses the store.
#[track_caller]
fn refusal(folder: &TempDir, arguments: &[&str], cause: &str) -> Value {
    let output = holdpoint(folder, &[arguments, &["--json"]].concat());
    let error = assert_error(&output, 2, &format!("store-refused/{cause}"));
    assert!(!text(&output.stdout).contains("active"), "{arguments:?}: {output:?}");
    error
}

/// A rejected version edited to active was once shown as active; the next write then made the edit sound.
#[test]
fn a_rejected_version_set_active_by_sql_is_nowhere_shown_active() {
    let folder = edited_store(
        "UPDATE version SET state = 'superseded' WHERE name = 'grasp@1.1.0';
         UPDATE version SET state = 'active' WHERE name = 'grasp@1.2.0';
         UPDATE family SET active = 'grasp@1.2.0' WHERE name = 'grasp'",
    );
    for arguments in [
        &["registry", "list"] as &[&str],
        &["registry", "show", "grasp@1.2.0"],
        &["registry", "history", "grasp"],
        &["status"],
        &["explain", "grasp@1.2.0"],
        &["alarms"],
        &["resume", "align", "--as", "omar", "--reason", "the tray is back"],
        &["rollback", "grasp", "--as", "omar", "--reason", "so"],
        &["serve"],
    ] {
        let error = refusal(&folder, arguments, "not-the-chain");
        assert!(error.to_string().contains("store rebuild"), "{arguments:?}: {error}");
    }
    assert_eq!(run(&folder, &["audit", "verify"]).0, 1, "no write made it good");
    let (code, text) = run(&folder, &["store", "rebuild"]);
    assert_eq!(code, 2, "without a source nothing is rebuilt: {text}");
    let rebuilt = succeeds(&folder, &["store", "rebuild", "--from-chain", "--json"])["rebuilt"].clone();
    assert_eq!((&rebuilt["from_seq"], &rebuilt["lost"]), (&322.into(), &json!([])), "{rebuilt}");
    assert_eq!(rebuilt["kept_as"], "holdpoint-damaged-322-1.db");
    let differed = rebuilt["differed"].as_array().unwrap();
    let is_edited = |row: &Value| row["table"] == "version" && row["key"] == "grasp@1.2.0";
    let edited = differed.iter().find(|row| is_edited(row)).unwrap_or_else(|| panic!("{rebuilt}"));
    assert_eq!(edited["columns"], json!(["state"]), "{rebuilt}");
    let status = succeeds(&folder, &["status", "--json"]);
    let grasp = status["families"].as_array().unwrap().iter().find(|one| one["family"] == "grasp").unwrap();
    assert_eq!(grasp["active"], "grasp@1.1.0");
    assert_eq!(succeeds(&folder, &["audit", "verify", "--json"])["report"]["records"], 323);
    let (_, text) = run(&folder, &["audit", "list", "--kind", "store-rebuilt", "--json"]);
    assert!(text.contains("\\\"uid\\\"") && text.contains("grasp@1.2.0"), "{text}");
    let (code, text) = run(&folder, &["rollback", "grasp", "--as", "omar", "--reason", "it is worse"]);
    // No administrator authorized this program's profile: the arm is at standstill, and the rollback target does
    // not act.
    assert!(code == 3 && text.contains("grasp@1.1.0") && text.contains("rolled back"), "{text}");
    let (_, text) = run(&folder, &["store", "rebuild", "--from-chain", "--json"]);
    assert_eq!(text.trim(), "{\"json_version\":1,\"rebuilt\":null}");
}

#[test]
fn an_edited_author_or_missing_state_is_refused_by_name() {
    for (sql, part) in [
        ("UPDATE version SET author = 'eve' WHERE name = 'grasp@1.1.0'", "\"grasp@1.1.0\""),
        ("UPDATE version SET permissions = '{}' WHERE name = 'grasp@1.1.0'", "(permissions)"),
        ("UPDATE family SET standing = NULL WHERE name = 'grasp'", "\"grasp\""),
    ] {
        let folder = edited_store(sql);
        let resume = ["resume", "align", "--as", "omar", "--reason", "the tray is back"];
        let error = refusal(&folder, &resume, "not-the-chain");
        assert!(error["error"].as_str().unwrap().contains(part), "{sql}: {error}");
        assert_eq!(run(&folder, &["audit", "verify"]).0, 1, "{sql}");
    }
    // Data without a record cannot be reconstructed.
    let folder = edited_store("UPDATE family SET standing = NULL WHERE name = 'grasp'");
    let error = refusal(&folder, &["store", "rebuild", "--from-chain"], "damaged");
    assert!(error["error"].as_str().unwrap().contains("family \"grasp\""), "{error}");
}

#[test]
fn another_trigger_is_refused_by_name() {
    let folder = edited_store("CREATE TRIGGER late AFTER INSERT ON audit BEGIN DELETE FROM alarm; END");
    let error = refusal(&folder, &["status"], "not-the-chain");
    assert!(error["error"].as_str().unwrap().contains("trigger \"late\""), "{error}");
    let (code, text) = run(&folder, &["audit", "verify"]);
    assert!(code == 1 && text.contains("late"), "{text}");
    assert_eq!(run(&folder, &["store", "rebuild", "--from-chain"]).0, 0);
    assert_eq!(run(&folder, &["status"]).0, 0);
}
