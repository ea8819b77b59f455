//! Rows edited with SQL, in every column of every table: a start finds each, and no later write hides it.
//!
//! `HOLDPOINT_EDITS` is the number of edits (400), `HOLDPOINT_EDITS_SEED` the seed.

use std::fs;
use std::path::Path;

use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::lifecycle::VersionFlags;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_registry::{Store, Views, verify};
use holdpoint_store::{ApprovalRequest, Change, EvidenceKind, RefusalCause, RequestState, StoreError};
use holdpoint_text::Hint as _;
use rusqlite::types::Value;
use rusqlite::{Connection, params};

use crate::quick_folder::quick_folder;
use crate::support::*;

/// Edits of the database of a running engine.
const EDITS_RUNNING: usize = 40;
/// The seed, unless the environment names another.
const SEED: u64 = 0x005E_ED01;

/// Columns that are only displayed or refuse a retry, and decide nothing; the registry's module `compare` has the
/// reasons.
const NOT_VOUCHED: [(&str, &str); 2] = [("audit", "wall_ms"), ("command", "digest")];

/// A closed store with every kind of row.
pub fn make_full_store(folder: &Path) {
    let store = open(folder);
    bootstrap(&store, "grasp");
    bootstrap(&store, "place");
    shadowed(&store, "grasp@1.1.0");
    shadowed(&store, "place@1.1.0");
    let signed = approve(&store, &person(&store, "ada"), "grasp@1.1.0", 1);
    person(&store, "ben");
    revoke(&store, "ben");
    let alarm = |state, json: &str| Change::AlarmChange {
        alarm: "a1".into(),
        subject: "grasp@1.1.0".into(),
        state,
        priority: Priority::High,
        json: json.into(),
    };
    let request = |state| {
        Change::PutApprovalRequest(Box::new(ApprovalRequest {
            id: "r1".into(),
            version: id("grasp@1.1.0"),
            row_version: 4,
            evidence_digest: digest("gate grasp@1.1.0"),
            policy_digest: digest("sim"),
            profile: ProfileName::Sim,
            needed: 1,
            until: WallTime::from_ms(900),
            state,
            json: "{\"shown\":\"all of it\"}".into(),
        }))
    };
    let family_state = |json: &str| Change::SetStanding { family: family("grasp"), json: json.into() };
    let first = vec![
        request(RequestState::Open),
        Change::PutApproval(Box::new(signed)),
        alarm(AlarmState::Unacknowledged, "{}"),
        family_state("{\"versions\":[]}"),
        Change::SetScores {
            version: id("grasp@1.1.0"),
            kappas: [Some(0.5), Some(0.25), None, Some(1.0)],
            signature: Some("{\"mean\":1}".into()),
        },
    ];
    commit(&store, "put", first).unwrap();
    let mut changes = vec![consume("grasp@1.1.0", 1)];
    changes.extend(activation("grasp@1.1.0", ("grasp@1.0.0", 2), 1));
    changes.push(evidence("grasp@1.1.0", EvidenceKind::Activation, "activation"));
    changes.push(request(RequestState::Granted));
    changes.push(alarm(AlarmState::Acknowledged, "{\"by\":\"ada\"}"));
    changes.push(family_state("{\"versions\":[1]}"));
    changes.push(Change::VoidFamily { family: family("place"), reason: text("a drill") });
    changes.push(Change::SetFlags {
        version: id("place@1.1.0"),
        flags: VersionFlags { paused: true, ..VersionFlags::default() },
    });
    commit(&store, "activate", changes).unwrap();
}

/// Numbers that look random, from a seed.
pub struct Dice(pub u64);

impl Dice {
    pub fn roll(&mut self, sides: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        usize::try_from((bits ^ (bits >> 31)) % (sides as u64)).unwrap()
    }
}

/// Every column of every table.
pub fn columns(connection: &Connection) -> Vec<(String, String)> {
    let sql =
        "SELECT t.name, c.name FROM sqlite_schema t JOIN pragma_table_xinfo(t.name) c WHERE t.type = 'table'
        ORDER BY t.name, c.cid";
    let mut select = connection.prepare(sql).unwrap();
    select.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap().map(Result::unwrap).collect()
}

/// A different value: by a typing error or on purpose.
fn other(dice: &mut Dice, value: &Value, same_column: &[Value]) -> Value {
    if dice.roll(4) == 0 {
        return same_column[dice.roll(same_column.len())].clone();
    }
    match value {
        Value::Null => [Value::Integer(1), Value::Text("{}".into()), Value::Real(0.5)][dice.roll(3)].clone(),
        Value::Integer(number) => match dice.roll(4) {
            0 => Value::Null,
            1 => Value::Integer(number + 1),
            2 => Value::Integer(number - 1),
            _ => Value::Integer(1 - number),
        },
        Value::Real(number) => {
            if dice.roll(3) == 0 {
                Value::Null
            } else {
                Value::Real(1.0 - number / 3.0)
            }
        }
        Value::Text(text) => match dice.roll(4) {
            0 => Value::Null,
            1 => Value::Text(format!("{text} ")),
            2 => Value::Text(text.replace(['a', '1'], "b")),
            _ => {
                let mut bytes = text.clone().into_bytes();
                let at = dice.roll(bytes.len().max(1));
                if let Some(byte) = bytes.get_mut(at) {
                    *byte = if *byte == b'7' { b'8' } else { b'7' };
                }
                Value::Text(String::from_utf8(bytes).unwrap())
            }
        },
        Value::Blob(bytes) => {
            let mut bytes = bytes.clone();
            let at = dice.roll(bytes.len());
            bytes[at] ^= 1 << dice.roll(8);
            Value::Blob(bytes)
        }
    }
}

/// Edits one value of a column, past every trigger and check. Returns a description, `None` if SQLite rejected it.
pub fn edit(database: &Path, dice: &mut Dice, table: &str, column: &str) -> Option<String> {
    let connection = Connection::open(database).unwrap();
    let mut select =
        connection.prepare("SELECT name, sql FROM sqlite_schema WHERE type = 'trigger'").unwrap();
    let triggers: Vec<(String, String)> =
        select.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap().map(Result::unwrap).collect();
    drop(select);
    for (name, _) in &triggers {
        connection.execute_batch(&format!("DROP TRIGGER {name}")).unwrap();
    }
    let mut select = connection.prepare(&format!("SELECT {column} FROM {table}")).unwrap();
    let values: Vec<Value> = select.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect();
    drop(select);
    let (place, value) = {
        let place = dice.roll(values.len());
        (place, other(dice, &values[place], &values))
    };
    let sql = format!(
        "UPDATE {table} SET {column} = ?1 WHERE ({0}) IN (SELECT {0} FROM {table} LIMIT 1 OFFSET ?2)",
        key(table)
    );
    // In the order of the values read above: a table's own.
    let done = value != values[place] && connection.execute(&sql, params![value, place]).is_ok();
    let now: Vec<Value> = {
        let mut select = connection.prepare(&format!("SELECT {column} FROM {table}")).unwrap();
        select.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect()
    };
    for (_, sql) in &triggers {
        connection.execute_batch(sql).unwrap();
    }
    (done && now != values).then(|| format!("{table}.{column}: {:?} became {value:?}", values[place]))
}

/// The columns that name a row of a table.
fn key(table: &str) -> &'static str {
    match table {
        "meta" => "key",
        "context" | "version" | "approval_request" | "alarm" | "command" | "audit_head" => "id",
        "family" | "person" => "name",
        "activation" | "evidence" | "audit" => "seq",
        "approval" => "nonce",
        other => panic!("{other} has no key here"),
    }
}

pub fn seed() -> u64 {
    let seed = std::env::var("HOLDPOINT_EDITS_SEED").ok().map_or(SEED, |text| text.parse().unwrap());
    println!("seed {seed}");
    seed
}

#[test]
fn every_edit_of_every_column_is_found_at_the_start() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let database = folder.path().join("holdpoint.db");
    let whole = fs::read(&database).unwrap();
    let all = columns(&Connection::open(&database).unwrap());
    assert!(all.len() > 100, "{} columns", all.len());
    let wanted: usize = std::env::var("HOLDPOINT_EDITS").map_or(400, |text| text.parse().unwrap());
    assert!(wanted >= 2 * all.len(), "two edits of each of {} columns", all.len());
    let mut dice = Dice(seed());
    let (mut edits, mut not_vouched) = (0, 0);
    // Every column in turn, until there are enough.
    for (table, column) in all.iter().cycle() {
        if edits == wanted {
            break;
        }
        let Some(what) = edit(&database, &mut dice, table, column) else {
            fs::write(&database, &whole).unwrap();
            continue;
        };
        edits += 1;
        let before = fs::read(&database).unwrap();
        let opened = unless_in_use(|| Store::open(folder.path()));
        if NOT_VOUCHED.contains(&(table.as_str(), column.as_str())) {
            not_vouched += 1;
            // An edit of a record's signed wall time is found.
            if let Err(error) = opened {
                let is_damaged = refusal(&error).0 == RefusalCause::Damaged;
                assert!(column == "wall_ms" && is_damaged, "{what}: {error}");
            }
        } else {
            let error = opened.map(drop).expect_err(&what);
            assert!(matches!(error, StoreError::Refused { .. }), "{what}: {error}");
            assert!(error.hint().is_some(), "{what}: {error}");
            assert_eq!(fs::read(&database).unwrap(), before, "{what}: it was written to");
            assert!(verify(&database, None).is_err() || table == "meta", "{what}");
        }
        fs::write(&database, &whole).unwrap();
        for ending in ["db-wal", "db-shm"] {
            drop(fs::remove_file(folder.path().join("holdpoint").with_extension(ending)));
        }
    }
    println!("{edits} edits in {} columns, {not_vouched} in columns that nothing vouches for", all.len());
}

#[test]
fn no_write_of_a_running_engine_hides_an_edit() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let database = folder.path().join("holdpoint.db");
    let whole = fs::read(&database).unwrap();
    let all = columns(&Connection::open(&database).unwrap());
    let chained: Vec<_> = all
        .iter()
        .filter(|(table, _)| !["audit", "audit_head", "meta", "command"].contains(&table.as_str()))
        .collect();
    let checkpoints = folder.path().join("checkpoints");
    let checkpoint_names = names(&checkpoints);
    let mut dice = Dice(seed());
    let mut edits = 0;
    while edits < EDITS_RUNNING {
        let (table, column) = chained[dice.roll(chained.len())];
        let store = open(folder.path());
        commit(&store, "before", Vec::new()).unwrap();
        if let Some(what) = edit(&database, &mut dice, table, column).filter(|_| column != "signed") {
            edits += 1;
            for retry in ["first", "second"] {
                let error = commit(&store, retry, vec![context(ProfileName::Real)]).expect_err(&what);
                assert!(matches!(error, StoreError::Altered(_)), "{what}: {error}");
            }
            assert!(store.check_unaltered().is_err(), "{what}");
            // Writes that only record something continue, and hide nothing.
            let note =
                Change::SetFamily { family: family("other"), safe_stopped: true, reason: text("held") };
            commit(&store, "note", vec![note]).unwrap_or_else(|error| panic!("{what}: {error}"));
            drop(store);
            assert!(verify(&database, None).is_err(), "{what}");
            assert!(Views::open_checked(&database).is_err(), "{what}");
        } else {
            drop(store);
        }
        for ending in ["db-wal", "db-shm"] {
            drop(fs::remove_file(folder.path().join("holdpoint").with_extension(ending)));
        }
        fs::write(&database, &whole).unwrap();
        put_back(&checkpoints, &checkpoint_names);
    }
}

/// The checkpoints of a store, by name.
pub fn names(folder: &Path) -> Vec<std::ffi::OsString> {
    fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name()).collect()
}

/// Removes checkpoints of records that the file put back does not have.
pub fn put_back(folder: &Path, checkpoint_names: &[std::ffi::OsString]) {
    for name in names(folder).iter().filter(|name| !checkpoint_names.contains(name)) {
        fs::remove_file(folder.join(name)).unwrap();
    }
}

#[test]
fn a_missing_state_is_refused_by_name() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let database = folder.path().join("holdpoint.db");
    Connection::open(&database)
        .unwrap()
        .execute_batch("UPDATE family SET standing = NULL WHERE name = 'grasp'")
        .unwrap();
    let error = unless_in_use(|| Store::open(folder.path())).unwrap_err();
    let (cause, problem) = refusal(&error);
    assert!(cause == RefusalCause::NotTheChain && problem.contains("family \"grasp\""), "{error}");
}

#[test]
fn changed_schema_is_found() {
    for (edit, named) in [
        ("DROP TRIGGER audit_no_update", "audit_no_update"),
        ("DROP INDEX one_active", "one_active"),
        ("CREATE TRIGGER late AFTER INSERT ON audit BEGIN DELETE FROM alarm; END", "late"),
        ("CREATE TABLE notes (x)", "notes"),
        ("CREATE VIEW seen AS SELECT 1", "seen"),
        ("ALTER TABLE alarm ADD COLUMN more TEXT", "alarm"),
    ] {
        let folder = quick_folder();
        make_full_store(folder.path());
        let database = folder.path().join("holdpoint.db");
        Connection::open(&database).unwrap().execute_batch(edit).unwrap();
        let error = unless_in_use(|| Store::open(folder.path())).unwrap_err().to_string();
        assert!(error.contains(named), "{edit}: {error}");
        let error = verify(&database, None).unwrap_err().to_string();
        assert!(error.contains(named), "{edit}: {error}");
    }
}

/// A trigger added under a running engine neither changes the engine's writes nor activates anything.
#[test]
fn trigger_added_under_a_running_engine_has_no_effect() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let database = folder.path().join("holdpoint.db");
    let store = open(folder.path());
    commit(&store, "before", Vec::new()).unwrap();
    let trigger = "CREATE TRIGGER late AFTER UPDATE OF reason ON family
        BEGIN UPDATE family SET void_seq = 0, standing = '[]' WHERE name = NEW.name; END";
    Connection::open(&database).unwrap().execute_batch(trigger).unwrap();
    let stop = Change::SetFamily { family: family("other"), safe_stopped: true, reason: text("held") };
    commit(&store, "stop", vec![stop]).unwrap();
    let again = Change::SetFamily { family: family("other"), safe_stopped: true, reason: text("still") };
    commit(&store, "again", vec![again]).unwrap();
    let error = commit(&store, "in", vec![context(ProfileName::Real)]).unwrap_err();
    assert!(matches!(&error, StoreError::Altered(problem) if problem.contains("\"late\"")), "{error}");
    let stored_state: Option<String> = Connection::open(&database)
        .unwrap()
        .query_row("SELECT standing FROM family WHERE name = 'other'", [], |row| row.get(0))
        .unwrap();
    assert_eq!(stored_state, None);
    drop(store);
    Connection::open(&database).unwrap().execute_batch("DROP TRIGGER late").unwrap();
    verify(&database, None).unwrap();
}
