//! The history of a store in one file, and the verifier in Python with the same verdicts as ours.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use holdpoint_approvals::{Identity, SignedWitnessAct};
use holdpoint_audit::export_file::{ExportReport, is_exported, verify_export};
use holdpoint_audit::history_error::HistoryError;
use holdpoint_governance::approval::Role;
use holdpoint_governance::profile::ProfileName;
use holdpoint_registry::{
    ExportError, ExportScope, UnsignedRecords, add_witness, export_store, rebuild, verify,
};
use holdpoint_store::RefusalCause;

use crate::damage::rewrite;
use crate::edits::make_full_store;
use crate::killed::copy;
use crate::proofs::{heads, public_key};
use crate::quick_folder::quick_folder;
use crate::released::schema_1;
use crate::support::*;

/// Exports the history of a store into a file and returns its lines.
pub fn export_lines(folder: &Path, file: &Path) -> Vec<String> {
    let mut bytes = Vec::new();
    export_store(&folder.join("holdpoint.db"), ExportScope::Signed, Some(&public_key(folder)), &mut bytes)
        .unwrap();
    fs::write(file, &bytes).unwrap();
    String::from_utf8(bytes).unwrap().lines().map(str::to_owned).collect()
}

/// The Python interpreter and the script of the verifier.
pub fn python_and_script() -> (OsString, PathBuf) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/verifier/verify.py");
    (std::env::var_os("HOLDPOINT_PYTHON").unwrap_or_else(|| "python3".into()), script)
}

/// Whether there is a Python with `cryptography`; asked once in a process.
pub fn has_python() -> bool {
    static HAS_PYTHON: OnceLock<bool> = OnceLock::new();
    *HAS_PYTHON.get_or_init(|| {
        let import = Command::new(python_and_script().0).args(["-c", "import cryptography"]).output();
        let is_there = import.is_ok_and(|output| output.status.success());
        assert!(
            is_there || std::env::var_os("HOLDPOINT_PYTHON").is_none(),
            "the Python that was named has no `cryptography`"
        );
        if !is_there {
            println!(
                "LEFT OUT: there is no python3 with `cryptography`; the verifier in Python judges nothing here"
            );
        }
        is_there
    })
}

/// The Python verifier's verdict on each of these, in one run; `None` without a Python with `cryptography`.
pub fn python_verdicts(files: &[PathBuf], key: Option<&Path>) -> Option<Vec<serde_json::Value>> {
    if !has_python() {
        return None;
    }
    let (python, script) = python_and_script();
    let mut command = Command::new(&python);
    command.arg(script).arg("--json").args(files);
    if let Some(key) = key {
        command.arg("--key").arg(key);
    }
    let output = command.output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    let read = |line| serde_json::from_str(line).unwrap_or_else(|_| panic!("{line}{error}"));
    let answers: Vec<serde_json::Value> = text.lines().map(read).collect();
    assert_eq!(answers.len(), files.len(), "{error}");
    let sound = answers.iter().all(|answer| answer["sound"] == true);
    assert_eq!(output.status.code(), Some(i32::from(!sound)), "{error}");
    Some(answers)
}

/// Both verifiers have the same verdict on a file. Returns ours.
pub fn verify_by_both(file: &Path) -> Result<(), HistoryError> {
    verify_files_by_both(&[file.to_owned()]).remove(0)
}

/// Both verifiers have the same verdict on each of these contents of files. Returns ours.
pub fn verify_contents_by_both(
    folder: &Path,
    contents: &[impl AsRef<[u8]>],
) -> Vec<Result<(), HistoryError>> {
    let files: Vec<PathBuf> =
        (0..contents.len()).map(|nth| folder.join(format!("case-{nth}.jsonl"))).collect();
    for (file, content) in files.iter().zip(contents) {
        fs::write(file, content).unwrap();
    }
    verify_files_by_both(&files)
}

/// As [`verify_by_both`]; a run of Python costs more than its verdict on a file, so one run judges all.
fn verify_files_by_both(files: &[PathBuf]) -> Vec<Result<(), HistoryError>> {
    let ours: Vec<_> = files.iter().map(|file| verify_export(file, None)).collect();
    if let Some(theirs) = python_verdicts(files, None) {
        for (file, (ours, theirs)) in files.iter().zip(ours.iter().zip(&theirs)) {
            check_same_verdict(ours, theirs)
                .unwrap_or_else(|problem| panic!("{}: {problem}", file.display()));
        }
    }
    ours.into_iter().map(|verdict| verdict.map(drop)).collect()
}

/// The kind of problem, as both verifiers name it.
pub fn problem_kind(error: &HistoryError) -> &'static str {
    match error {
        HistoryError::Record { .. } => "record",
        HistoryError::Checkpoint { .. } => "head",
        HistoryError::Unsigned(_) => "end",
        HistoryError::Approval { .. } => "approval",
        HistoryError::Person { .. } => "person",
        HistoryError::Line { .. } => "line",
        other => panic!("{other}"),
    }
}

/// Checks that both verifiers agree: sound with the same numbers, or the same kind of problem at the same record.
pub fn check_same_verdict(
    ours: &Result<ExportReport, HistoryError>,
    theirs: &serde_json::Value,
) -> Result<(), String> {
    let is_same = match ours {
        Ok(report) => {
            let mut expected = serde_json::to_value(report).unwrap();
            expected["sound"] = true.into();
            *theirs == expected
        }
        Err(error) => {
            theirs["sound"] == false
                && theirs["what"] == problem_kind(error)
                && theirs["record"].as_u64() == error.record()
        }
    };
    if is_same { Ok(()) } else { Err(format!("theirs: {theirs}, ours: {ours:?}")) }
}

/// Adds signed acts of an administrator: a verified person, an authorized witness and changes of profile.
pub fn add_signed_acts(folder: &Path, witness: &Path) {
    let store = open(folder);
    confirm(&store, "ada");
    let (place, head) = (witness.display().to_string(), store.views().unwrap().head().unwrap());
    let end = (store.store_id(), head.hash);
    let act = SignedWitnessAct::by(&administrator(&store), (&place, true), end, "a test").unwrap();
    add_witness(&store, &place, ("{}".to_owned(), Some(Box::new(act))), 7).unwrap();
    commit(&store, "real", vec![context(ProfileName::Real)]).unwrap();
    let less_strict = context_of(ProfileName::Real, "looser", &["runtime.retries_max"]);
    authorize(&store, &administrator(&store), &less_strict).unwrap();
    commit(&store, "looser", vec![less_strict]).unwrap();
    let sim = context(ProfileName::Sim);
    authorize(&store, &administrator(&store), &sim).unwrap();
    commit(&store, "sim", vec![sim]).unwrap();
}

/// Stores with approvals, of an earlier version, and rebuilt with a gap.
pub fn sample_stores(root: &Path) -> Vec<PathBuf> {
    let plain = root.join("plain");
    make_full_store(&plain);
    add_signed_acts(&plain, root);
    let released = schema_1(root);
    let store = open(&released);
    store.commit(transaction("one more", store.opening().head.at_ms, Vec::new())).unwrap();
    drop(store);
    let rebuilt = root.join("rebuilt");
    make_full_store(&rebuilt);
    fs::remove_file(&heads(&rebuilt)[1].0).unwrap();
    let connection = rusqlite::Connection::open(rebuilt.join("holdpoint.db")).unwrap();
    let sql = "SELECT 'DROP TRIGGER ' || name || ';' FROM sqlite_schema WHERE type = 'trigger'";
    let drops: Vec<String> = connection
        .prepare(sql)
        .unwrap()
        .query_map([], |row| row.get(0))
        .unwrap()
        .map(Result::unwrap)
        .collect();
    connection.execute_batch(&drops.concat()).unwrap();
    connection.execute_batch("UPDATE approval SET signed = '{}'").unwrap();
    drop(connection);
    unless_in_use(|| rebuild(&rebuilt, UnsignedRecords::Refuse, "{}", 7)).unwrap().unwrap();
    vec![plain, released, rebuilt]
}

#[test]
fn exported_store_is_sound_for_both_verifiers() {
    let root = quick_folder();
    let file = root.path().join("store.jsonl");
    for store in sample_stores(root.path()) {
        let lines = export_lines(&store, &file);
        assert!(is_exported(&file) && !is_exported(&store.join("holdpoint.db")));
        verify_by_both(&file).unwrap_or_else(|problem| panic!("{store:?}: {problem}"));
        let report = verify_export(&file, Some(&public_key(&store))).unwrap();
        let whole = verify(&store.join("holdpoint.db"), Some(&public_key(&store))).unwrap();
        assert_eq!((report.records, report.head, report.root), (whole.records, whole.head, whole.root));
        assert_eq!((report.heads, report.approvals), (whole.checkpoints + 1, whole.approvals));
        assert!(lines.iter().all(|line| line.bytes().all(|byte| (b' '..=b'~').contains(&byte))));
    }
    // And so is the record of an earlier version, with an authorization of a class of profile.
    verify_by_both(Path::new("../../tests/fixtures/store-d43131bc/export.jsonl")).unwrap();
    let other = holdpoint_approvals::keyfile::generate().unwrap().verifying_key();
    assert!(matches!(verify_export(&file, Some(&other)), Err(HistoryError::Line { line: 1, .. })));
}

#[test]
fn damaged_export_gets_the_same_verdict_of_both_verifiers() {
    let root = quick_folder();
    let (store, file) = (root.path().join("store"), root.path().join("store.jsonl"));
    make_full_store(&store);
    let lines = export_lines(&store, &file);
    let written = |lines: &[String]| lines.join("\n") + "\n";
    let at = |start: &str| lines.iter().position(|line| line.starts_with(start)).unwrap();
    let (head, end, record, approval) =
        (at("{\"head\""), at("{\"end\""), at("{\"record\""), at("{\"approval\""));
    type LinesEdit<'a> = Box<dyn Fn(&mut Vec<String>) + 'a>;
    /// The case, the damage, the kind of problem, and the record that is bad.
    type DamageCase<'a> = (&'a str, LinesEdit<'a>, &'a str, Option<u64>);
    let replaced = |line: usize, from: &'static str, to: &'static str| -> LinesEdit<'static> {
        Box::new(move |lines| {
            assert!(lines[line].contains(from), "{}", lines[line]);
            lines[line] = lines[line].replacen(from, to, 1);
        })
    };
    let records = (approval - record) as u64;
    let damages: Vec<DamageCase<'_>> = vec![
        ("a record's text", replaced(record + 4, "{}", "{ }"), "record", Some(5)),
        ("a record's number", replaced(record + 4, "\"seq\":5", "\"seq\":6"), "record", Some(5)),
        ("a record's time", replaced(record + 6, "\"at_ms\":1", "\"at_ms\":0"), "record", Some(7)),
        ("a record gone", Box::new(|lines| drop(lines.remove(record + 9))), "record", Some(10)),
        (
            "a record twice",
            Box::new(|lines| lines.insert(record + 3, lines[record + 2].clone())),
            "record",
            Some(4),
        ),
        ("two records exchanged", Box::new(|lines| lines.swap(record + 1, record + 2)), "record", Some(2)),
        ("the last record gone", Box::new(|lines| drop(lines.remove(approval - 1))), "record", Some(records)),
        ("a head gone", Box::new(|lines| drop(lines.remove(head + 1))), "head", None),
        ("a head edited", replaced(head, "\"at_ms\":1", "\"at_ms\":2"), "head", None),
        ("a tree edited", replaced(end, "\"root\":\"", "\"fold\":\""), "line", None),
        ("no end", Box::new(|lines| drop(lines.remove(end))), "end", None),
        (
            "a head for the end",
            Box::new(|lines| lines[end] = lines[head].replace("head\":{", "end\":{")),
            "end",
            None,
        ),
        ("an approval gone", Box::new(|lines| drop(lines.remove(approval))), "approval", None),
        ("an approval twice", Box::new(|lines| lines.push(lines[approval].clone())), "approval", None),
        ("an approval edited", replaced(approval, "\"seen\"", "\"Seen\""), "approval", None),
        ("another's approval", replaced(approval, "\"who\":\"ada\"", "\"who\":\"bob\""), "approval", None),
        ("not JSON", replaced(record + 2, "{", "["), "line", None),
        ("an empty object", Box::new(|lines| lines.insert(record, "{}".to_owned())), "line", None),
        ("a second first line", Box::new(|lines| lines.insert(record, lines[0].clone())), "line", None),
        ("heads at the end", Box::new(|lines| lines.push(lines[head].clone())), "line", None),
        ("another form", replaced(0, "\"version\":1", "\"version\":2"), "line", None),
        ("another store", replaced(0, "\"store_id\":\"", "\"store_id\":\"a"), "person", None),
        ("more records", replaced(0, "\"records\":", "\"records\":1"), "record", Some(records + 1)),
    ];
    let damaged = |(_, damage, ..): &DamageCase<'_>| {
        let mut lines = lines.clone();
        damage(&mut lines);
        written(&lines)
    };
    let mut contents: Vec<String> = damages.iter().map(damaged).collect();
    contents.extend([lines.join("\n"), String::new()]);
    let mut verdicts = verify_contents_by_both(root.path(), &contents);
    assert!(matches!(verdicts.pop(), Some(Err(HistoryError::Line { line: 1, .. }))), "an empty file");
    let error = verdicts.pop().unwrap().unwrap_err();
    assert_eq!(problem_kind(&error), "line", "a line without its end: {error}");
    for ((case, _, kind, seq), verdict) in damages.iter().zip(verdicts) {
        let error = verdict.err().unwrap_or_else(|| panic!("{case} is not found"));
        assert_eq!((problem_kind(&error), error.record()), (*kind, *seq), "{case}: {error}");
    }
}

/// A holder of the store's key with write access cannot make a person: other keys sign the acts.
#[test]
fn edited_persons_and_authorizations_are_found_by_both_verifiers() {
    let root = quick_folder();
    let file = root.path().join("store.jsonl");
    let body = |from: &str, to: &str, which: &str| {
        format!("UPDATE audit SET body = replace(body, '{from}', '{to}') WHERE seq = ({which})")
    };
    let of =
        |name: &str| format!("SELECT seq FROM audit WHERE kind = 'person-enrolled' AND subject = '{name}'");
    let of_kind = |kind: &str| format!("SELECT seq FROM audit WHERE kind = '{kind}'");
    let newest_of = |kind: &str| format!("SELECT max(seq) FROM audit WHERE kind = '{kind}'");
    let less_strict_of = |kind: &str| format!("{} AND body LIKE '%retries_max%'", of_kind(kind));
    let first_approval = "SELECT min(seq) FROM audit WHERE kind = 'approval-put'";
    // What is affected is named: the person, or the field that became less strict.
    let cases = [
        ("a reason", body("a test", "no test", &of("ada")), "person", "\"ada\""),
        ("a role", body("\"role\":\"operator\"", "\"role\":\"safety\"", &of("ada")), "person", "\"ada\""),
        ("a signer", body("\"by\":\"admin\"", "\"by\":\"ada\"", &of("ada")), "person", "\"ada\""),
        ("a confirmation", body("\"guarded\":true,", "", &of_kind("person-confirmed")), "person", "\"ada\""),
        ("who confirmed", body("admin", "ada", &of_kind("person-confirmed")), "person", ""),
        ("a witness", body("a test", "no test", &of_kind("witness-set")), "person", "\"admin\""),
        ("whose witness", body("admin", "ada", &of_kind("witness-set")), "person", "\"ada\""),
        (
            "which witness",
            body("\"present\":true", "\"present\":false", &of_kind("witness-set")),
            "person",
            "",
        ),
        ("a profile", body("a test", "no test", &newest_of("profile-allowed")), "person", "\"admin\""),
        (
            "which profile",
            body("\"profile\":\"sim\"}", "\"profile\":\"real\"}", &newest_of("profile-allowed")),
            "person",
            "",
        ),
        (
            "whose profile",
            format!("UPDATE audit SET kind = 'decision' WHERE seq = ({})", newest_of("profile-allowed")),
            "record",
            "real to sim",
        ),
        (
            "a field that got less strict without an authorization",
            body("\"field\":\"runtime.retries_max\"", "\"field\":\"runtime.near_margin\"", &less_strict_of("context-set")),
            "record",
            "runtime.near_margin",
        ),
        (
            "what an administrator signed of a field",
            body("\"now\":\"3\"", "\"now\":\"4\"", &less_strict_of("profile-allowed")),
            "person",
            "\"admin\"",
        ),
        (
            "which rules",
            "UPDATE audit SET body = replace(body, substr(body, instr(body, '\"rules\":{\"digest\":\"') + 20, 8), '00000000')
             WHERE kind = 'context-set' AND body LIKE '%retries_max%'"
                .to_owned(),
            "record",
            "",
        ),
        (
            "a profile without its rules",
            "UPDATE audit SET body = json_remove(body, '$.change.rules') WHERE kind = 'context-set' AND
             body LIKE '%\"profile\":\"sim\"%' AND seq > 9"
                .to_owned(),
            "record",
            "",
        ),
        (
            "an unknown giver",
            body("\"who\":\"ada\"", "\"who\":\"zoe\"", first_approval),
            "approval",
            "",
        ),
        (
            "left out",
            format!("UPDATE audit SET kind = 'decision' WHERE seq = ({})", of("ada")),
            "person",
            "",
        ),
    ];
    let whole = root.path().join("whole");
    make_full_store(&whole);
    add_signed_acts(&whole, root.path());
    let mut contents = Vec::new();
    for (case, edit, ..) in &cases {
        let store = root.path().join(case);
        fs::create_dir(&store).unwrap();
        copy(&whole, &store);
        rewrite(&store, edit);
        let mut export = Vec::new();
        let key = public_key(&store);
        export_store(&store.join("holdpoint.db"), ExportScope::Unchecked, Some(&key), &mut export).unwrap();
        contents.push(export);
        // The export of a signed history refuses the store, too.
        let refused = export_store(&store.join("holdpoint.db"), ExportScope::Signed, None, &mut Vec::new());
        let Err(ExportError::Store(error)) = &refused else { panic!("{case}: {refused:?}") };
        assert_eq!(refusal(error).0, RefusalCause::Damaged, "{case}: {error}");
    }
    for ((case, _, kind, named), verdict) in cases.iter().zip(verify_contents_by_both(root.path(), &contents))
    {
        let error = verdict.err().unwrap_or_else(|| panic!("{case} is not found"));
        let is_named = error.to_string().contains(named);
        assert!(problem_kind(&error) == *kind && is_named, "{case}: {error}");
    }
    // The same decision under the same name, signed by another person's key.
    let store = root.path().join("another key");
    make_full_store(&store);
    let mut lines = export_lines(&store, &file);
    let line = lines.iter_mut().find(|line| line.starts_with("{\"approval\"")).unwrap();
    let value: serde_json::Value = serde_json::from_str(line).unwrap();
    let approval = serde_json::from_value(value["approval"]["approval"].clone()).unwrap();
    fs::create_dir(root.path().join("others")).unwrap();
    let other = Identity::create(&root.path().join("others"), "ada", Role::Operator);
    let signed = other.unwrap().sign(approval).unwrap();
    *line = format!("{{\"approval\":{}}}", serde_json::to_string(&signed).unwrap());
    fs::write(&file, lines.join("\n") + "\n").unwrap();
    assert!(matches!(verify_by_both(&file), Err(HistoryError::Approval { .. })));
}
