//! `holdpoint metrics` on stores whose numbers are counted a second time, with SQL and none of the program's code.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use holdpoint_wording::program::replay::rerun_totals;
use rusqlite::Connection;
use serde_json::Value;

use crate::quick_folder::quick_folder;
use crate::reported_error::assert_error;

fn holdpoint(arguments: &[&str], data: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint")).args(arguments).arg("--data").arg(data).output().unwrap()
}

fn metrics(arguments: &[&str], data: &Path) -> Value {
    let output = holdpoint(&[&["metrics", "--json"], arguments].concat(), data);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A copy of an earlier version's store, with two activations by the gate and twenty live tasks; readers of a
/// database create files beside it.
fn store() -> tempfile::TempDir {
    let folder = quick_folder();
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/store-4831bf5/store");
    for file in ["holdpoint.db", "telemetry.db"] {
        fs::copy(from.join(file), folder.path().join(file)).unwrap();
    }
    folder
}

/// A connection to both files of a store, telemetry as `t`.
fn tables(data: &Path) -> Connection {
    let connection = Connection::open(data.join("holdpoint.db")).unwrap();
    connection.execute("ATTACH ?1 AS t", [data.join("telemetry.db").to_str().unwrap()]).unwrap();
    connection
}

/// Live tasks of gate-activated versions, since a record.
const LIVE: &str = "FROM t.batch AS b
    JOIN audit AS a ON a.kind = 'telemetry-sealed' AND json_extract(a.body, '$.change.batch') = b.id
    WHERE b.stream = 'live' AND a.seq >= ?1 AND b.version IN (SELECT active FROM activation WHERE cause = 'gate')";

fn count(connection: &Connection, sql: &str, from: u64) -> u64 {
    connection.query_row(sql, [from], |row| row.get(0)).unwrap_or_else(|error| panic!("{sql}: {error}"))
}

fn pair(rate: &Value) -> (u64, u64) {
    (rate["count"].as_u64().unwrap(), rate["total"].as_u64().unwrap())
}

#[test]
fn rates_equal_those_of_telemetry_and_record() {
    let folder = store();
    let sql = tables(folder.path());
    // The middle of the live tasks is a moment, too: the tenth of twenty.
    let tenth = "SELECT a.seq FROM audit AS a JOIN t.batch AS b
        ON a.kind = 'telemetry-sealed' AND json_extract(a.body, '$.change.batch') = b.id
        WHERE b.stream = 'live' AND ?1 > 0 ORDER BY a.seq LIMIT 1 OFFSET 9";
    for from in [1, count(&sql, tenth, 1)] {
        let report = metrics(&["--since", &format!("#{from}")], folder.path());
        let rates = &report["metrics"];
        let live = |what: &str| {
            let body = "CAST(b.body AS TEXT)";
            count(&sql, &format!("SELECT count(*) {LIVE} AND {}", what.replace("BODY", body)), from)
        };
        let all = live("1");
        assert_eq!(all, if from == 1 { 20 } else { 11 }, "the store is another one");
        for (name, rate, expected) in [
            ("pvr hard", &rates["pvr_observed"]["hard"], live("json_extract(BODY, '$.violation')")),
            (
                "pvr near",
                &rates["pvr_observed"]["near"],
                live("(json_extract(BODY, '$.violation') OR json_extract(BODY, '$.near'))"),
            ),
            ("success", &rates["success_observed"], live("json_extract(BODY, '$.success')")),
            ("anomaly", &rates["anomaly_observed"], live("json_extract(BODY, '$.anomaly')")),
            ("recovery", &rates["recovery_observed"], live("json_extract(BODY, '$.recovery')")),
            ("timeout", &rates["timeout_observed"], live("json_extract(BODY, '$.timeout')")),
        ] {
            assert_eq!(pair(rate), (expected, all), "{name} from {from}");
            let (lower, upper) = (&rate["interval"]["lower"], &rate["interval"]["upper"]);
            let share = expected as f64 / all as f64;
            assert!(lower.as_f64().unwrap() <= share && share <= upper.as_f64().unwrap(), "{name}: {rate}");
        }
        let time = format!("SELECT avg(json_extract(CAST(b.body AS TEXT), '$.time_secs')) {LIVE}");
        let time: f64 = sql.query_row(&time, [from], |row| row.get(0)).unwrap();
        let mean = rates["time_s_observed"]["mean"].as_f64().unwrap();
        assert!((mean - time).abs() < 1e-9, "{mean} and {time}");

        let activations = "SELECT count(*) FROM activation WHERE cause = 'gate' AND seq >= ?1";
        assert_eq!(pair(&rates["uar_observed"]), (0, count(&sql, activations, from)), "from {from}");
        let rollbacks = "SELECT count(DISTINCT json_extract(json, '$.trigger.tick')) FROM evidence
                       WHERE kind = 'rollback' AND seq >= ?1 AND json_extract(json, '$.recovered') IS NOT NULL";
        assert_eq!(rates["rsr_observed"]["total"], count(&sql, rollbacks, from));
        let decisions =
            "SELECT (SELECT count(*) FROM audit WHERE kind IN ('decision', 'monitor') AND seq >= ?1)
                       + (SELECT count(*) FROM evidence WHERE kind = 'monitor' AND seq >= ?1)";
        assert_eq!(rates["auditability_observed"]["total"], count(&sql, decisions, from));
        let candidates = "SELECT count(*) FROM version AS v JOIN audit AS a
            ON a.kind = 'version-registered' AND a.subject = v.name WHERE v.baseline = 0 AND a.seq >= ?1";
        assert_eq!(rates["screening_observed"]["candidates"], count(&sql, candidates, from));
    }
    // As in `MADE.md` beside the store.
    let report = metrics(&[], folder.path());
    let (rates, screening) = (&report["metrics"], &report["metrics"]["screening_observed"]);
    assert_eq!(pair(&rates["rsr_observed"]), (1, 1));
    assert_eq!(pair(&rates["shadow_only_share_observed"]), (0, 1));
    assert_eq!(screening["blocked"], serde_json::json!({ "sandbox": 1, "validation": 1 }));
    let counts =
        ["blocked_by_people", "contained", "kept", "open"].map(|name| screening[name].as_u64().unwrap());
    assert_eq!(counts, [1, 1, 1, 1]);
    // `reject align@1.1.0 --as omar`.
    assert_eq!(rates["interventions_observed"], serde_json::json!({ "refused": 1 }));
    assert_eq!(report["coverage"]["removed_batches"], 0);
}

#[test]
fn rate_without_cases_is_absent() {
    let folder = store();
    let report = metrics(&["--since", "#100000"], folder.path());
    for name in ["uar_observed", "rsr_observed", "success_observed", "srdr_observed", "auditability_observed"]
    {
        let rate = &report["metrics"][name];
        assert_eq!((pair(rate), &rate["interval"]), ((0, 0), &Value::Null), "{name}");
    }
    assert_eq!(report["metrics"]["time_s_observed"]["mean"], Value::Null);
    let output = holdpoint(&["metrics", "--since", "#100000"], folder.path());
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("no data") && !text.contains("0.000"), "{text}");
    // Without its telemetry a store still has its record.
    fs::remove_file(folder.path().join("telemetry.db")).unwrap();
    let report = metrics(&[], folder.path());
    assert_eq!(pair(&report["metrics"]["uar_observed"]), (0, 2));
    assert_eq!(pair(&report["metrics"]["success_observed"]), (0, 0));
    assert_eq!(report["coverage"]["removed_batches"], 80);
}

#[test]
fn an_invalid_time_lists_the_allowed_forms() {
    let folder = store();
    let output = holdpoint(&["metrics", "--since", "last tuesday", "--json"], folder.path());
    let error = assert_error(&output, 2, "usage");
    // The sentence lists the allowed forms; no code does.
    let text = error["error"].as_str().unwrap();
    assert!(text.contains("last tuesday") && text.contains("2026-11-17T08:00"), "{text}");
    let nowhere = folder.path().join("none");
    assert_error(&holdpoint(&["metrics", "--json"], &nowhere), 2, "no-store");
    assert!(!nowhere.exists(), "reading made a store");
}

/// Changes one number of the evidence of a decision.
fn edit(data: &Path, kind: &str, change: impl FnOnce(&mut Value)) -> u64 {
    let connection = Connection::open(data.join("holdpoint.db")).unwrap();
    let (seq, json): (u64, String) = connection
        .query_row("SELECT seq, json FROM evidence WHERE kind = ?1", [kind], |row| {
            Ok((row.get(0)?, row.get(1)?))
        })
        .unwrap();
    let mut evidence: Value = serde_json::from_str(&json).unwrap();
    change(&mut evidence);
    let text = evidence.to_string();
    assert_ne!(text, json, "nothing was changed");
    connection.execute("UPDATE evidence SET json = ?1 WHERE seq = ?2", (text, seq)).unwrap();
    let next = "SELECT min(seq) FROM audit WHERE kind = 'decision' AND seq > ?1";
    connection.query_row(next, [seq], |row| row.get(0)).unwrap()
}

fn copy_store(from: &Path) -> tempfile::TempDir {
    let folder = quick_folder();
    for file in ["holdpoint.db", "telemetry.db"] {
        fs::copy(from.join(file), folder.path().join(file)).unwrap();
    }
    folder
}

#[test]
fn every_decision_is_reproduced_until_its_evidence_is_edited() {
    let folder = quick_folder();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/scenarios/reject-recovery.toml");
    let run = holdpoint(&["run", "--headless", "--no-recording", "--script", script], folder.path());
    assert_eq!(run.status.code(), Some(1), "{}", String::from_utf8_lossy(&run.stderr));
    let whole = metrics(&[], folder.path());
    assert_eq!(pair(&whole["metrics"]["auditability_observed"]), (2, 2), "{}", whole["unequal"]);
    assert_eq!(whole["unequal"], serde_json::json!([]));

    // A failed drill is changed to passed, and one value of an episode is changed.
    type EvidenceEdit = fn(&mut Value);
    let edits: [(&str, EvidenceEdit, &str); 3] = [
        (
            "sandbox",
            |evidence| {
                let tally = &mut evidence["drills"][0]["rollback"];
                tally["passed"] = (tally["passed"].as_u64().unwrap() + 1).into();
            },
            "recovery",
        ),
        (
            "sandbox",
            |evidence| {
                let candidate = &mut evidence["pairs"][0]["candidate"];
                candidate["success"] = (!candidate["success"].as_bool().unwrap()).into();
            },
            "behavior",
        ),
        ("compat", |evidence| evidence["kappas"]["interface"]["kappa"] = 0.96.into(), "kappa_I"),
    ];
    for (kind, change, part) in edits {
        let copy = copy_store(folder.path());
        let record = edit(copy.path(), kind, change);
        let report = metrics(&[], copy.path());
        assert_eq!(
            pair(&report["metrics"]["auditability_observed"]),
            (1, 2),
            "{kind}: {}",
            report["unequal"]
        );
        assert_eq!(report["metrics"]["replays"]["differs"], 1, "{kind}");
        let unequal = report["unequal"].as_array().unwrap();
        assert_eq!((unequal.len(), &unequal[0]["record"]), (1, &Value::from(record)), "{kind}");
        let what = unequal[0]["what"].as_str().unwrap();
        assert!(what.starts_with(part) && what.contains("on record"), "{what}");
    }
    // The copy has no key, and its evaluation runs again from its seeds.
    let copy = copy_store(folder.path());
    let same = holdpoint(&["audit", "rerun", "--json"], copy.path());
    assert_eq!(same.status.code(), Some(0), "{}", String::from_utf8_lossy(&same.stderr));
    let report: Value = serde_json::from_slice(&same.stdout).unwrap();
    let runs = |place: usize| report["decisions"][place]["runs"].as_u64().unwrap();
    assert_eq!((report["evaluations"].as_u64(), runs(0)), (Some(1), 0), "{report}");
    assert!(runs(1) >= 20, "{report}");
    let (kind, change, _) = edits[1];
    let record = edit(copy.path(), kind, change);
    let other = holdpoint(&["audit", "rerun"], copy.path());
    assert_eq!(other.status.code(), Some(1), "{}", String::from_utf8_lossy(&other.stderr));
    // The lines are wrapped.
    let text = String::from_utf8(other.stdout).unwrap().split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(text.contains(&format!("record {record}, ")) && text.contains(": pair 1 (seed "), "{text}");
    let totals = rerun_totals(report["to_record"].as_u64().unwrap(), [1, 1, 0], &[], 1);
    assert!(text.contains(&totals), "{text}");
}
