//! A store with edited tables: no verb trusts it, no write hides the edit, and a rebuild repairs it.

use rusqlite::Connection;
use tempfile::TempDir;

use crate::old_stores::{OPEN_ROLES, copied, holdpoint, text};

/// A copy of an earlier version's store, edited with SQL past its triggers, which are then restored.
fn edited(sql: &str) -> TempDir {
    let folder = copied(OPEN_ROLES);
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
fn ended(folder: &TempDir, words: &[&str]) -> (i32, String) {
    let output = holdpoint(folder, words);
    (output.status.code().unwrap(), text(&output.stdout) + &text(&output.stderr))
}

/// A rejected version edited to active was once shown as active; the next write then made the edit sound.
#[test]
fn a_rejected_version_set_active_by_sql_is_nowhere_shown_active() {
    let folder = edited(
        "UPDATE version SET state = 'superseded' WHERE name = 'grasp@1.1.0';
         UPDATE version SET state = 'active' WHERE name = 'grasp@1.2.0';
         UPDATE family SET active = 'grasp@1.2.0' WHERE name = 'grasp'",
    );
    for words in [
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
        let (code, said) = ended(&folder, words);
        assert_eq!(code, 2, "{words:?}: {said}");
        assert!(
            said.contains("does not match the audit chain") && said.contains("store rebuild"),
            "{words:?}: {said}"
        );
        assert!(!said.contains("grasp@1.2.0: active"), "{words:?}: {said}");
    }
    assert_eq!(ended(&folder, &["audit", "verify"]).0, 1, "no write made it good");
    let (code, said) = ended(&folder, &["store", "rebuild"]);
    assert_eq!(code, 2, "without a source nothing is rebuilt: {said}");
    let (code, said) = ended(&folder, &["store", "rebuild", "--from-chain"]);
    assert_eq!(code, 0, "{said}");
    for told in
        ["rebuilt from 322 records", "version \"grasp@1.2.0\"", "(state)", "holdpoint-damaged-322-1.db"]
    {
        assert!(said.contains(told), "{told}: {said}");
    }
    let (code, said) = ended(&folder, &["status"]);
    assert!(code == 0 && said.contains("family   grasp: active grasp@1.1.0"), "{said}");
    let (code, said) = ended(&folder, &["audit", "verify"]);
    assert!(code == 0 && said.starts_with("sound: 323 records"), "{said}");
    let (_, said) = ended(&folder, &["audit", "list", "--kind", "store-rebuilt", "--json"]);
    assert!(said.contains("\\\"uid\\\"") && said.contains("grasp@1.2.0"), "{said}");
    let (code, said) = ended(&folder, &["rollback", "grasp", "--as", "omar", "--reason", "it is worse"]);
    // No administrator authorized this program's profile: the arm is at standstill, and the rollback target does
    // not act.
    assert!(code == 3 && said.contains("grasp@1.1.0 is rolled back"), "{said}");
    let (_, said) = ended(&folder, &["store", "rebuild", "--from-chain", "--json"]);
    assert_eq!(said.trim(), "{\"rebuilt\":null}");
}

#[test]
fn an_edited_author_or_a_standing_that_is_gone_is_refused_by_name() {
    for (sql, named) in [
        ("UPDATE version SET author = 'eve' WHERE name = 'grasp@1.1.0'", "\"grasp@1.1.0\""),
        ("UPDATE version SET permissions = '{}' WHERE name = 'grasp@1.1.0'", "(permissions)"),
        ("UPDATE family SET standing = NULL WHERE name = 'grasp'", "the family \"grasp\""),
    ] {
        let folder = edited(sql);
        let (code, said) =
            ended(&folder, &["resume", "align", "--as", "omar", "--reason", "the tray is back"]);
        assert!(code == 2 && said.contains(named), "{sql}: {code} {said}");
        assert_eq!(ended(&folder, &["audit", "verify"]).0, 1, "{sql}");
    }
    // Data without a record cannot be reconstructed.
    let folder = edited("UPDATE family SET standing = NULL WHERE name = 'grasp'");
    let (code, said) = ended(&folder, &["store", "rebuild", "--from-chain"]);
    assert!(code == 2 && said.contains("the family \"grasp\" cannot be rebuilt"), "{said}");
    assert!(said.contains("Nothing was changed"), "{said}");
}

#[test]
fn another_trigger_is_refused_by_name() {
    let folder = edited("CREATE TRIGGER late AFTER INSERT ON audit BEGIN DELETE FROM alarm; END");
    let (code, said) = ended(&folder, &["status"]);
    assert!(code == 2 && said.contains("the trigger \"late\" is not of this program"), "{said}");
    let (code, said) = ended(&folder, &["audit", "verify"]);
    assert!(code == 1 && said.contains("late"), "{said}");
    assert_eq!(ended(&folder, &["store", "rebuild", "--from-chain"]).0, 0);
    assert_eq!(ended(&folder, &["status"]).0, 0);
}
