//! The history of a store in one file, and the verifier in Python with the same verdicts as ours.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use holdpoint_approvals::{Identity, SignedWitnessAct};
use holdpoint_governance::approval::Role;
use holdpoint_governance::profile::ProfileName;
use holdpoint_registry::{
    ExportError, ExportReport, ExportScope, RefusalCause, UnsignedRecords, VerifyError, add_witness,
    export_store, is_exported, rebuild, verify, verify_export,
};

use crate::damage::rewrite;
use crate::edits::{made, quick_folder};
use crate::proofs::{heads, public_key};
use crate::released::schema_1;
use crate::support::*;

/// The history of a store in one file.
pub fn exported(folder: &Path, file: &Path) -> Vec<String> {
    let mut bytes = Vec::new();
    export_store(&folder.join("holdpoint.db"), ExportScope::Signed, Some(&public_key(folder)), &mut bytes)
        .unwrap();
    fs::write(file, &bytes).unwrap();
    String::from_utf8(bytes).unwrap().lines().map(str::to_owned).collect()
}

/// The verdict of the verifier in Python, `None` without a Python with `cryptography`.
pub fn python(file: &Path) -> Option<serde_json::Value> {
    let answers = python_of_all(std::slice::from_ref(&file.to_owned()), None)?;
    answers.into_iter().next()
}

/// A Python, and the verifier for it.
pub fn script() -> (OsString, PathBuf) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/verifier/verify.py");
    (std::env::var_os("HOLDPOINT_PYTHON").unwrap_or_else(|| "python3".into()), script)
}

/// The Python verifier's verdict on each of these, in one run.
pub fn python_of_all(files: &[PathBuf], key: Option<&Path>) -> Option<Vec<serde_json::Value>> {
    let (python, script) = script();
    let there = Command::new(&python).args(["-c", "import cryptography"]).output();
    if !there.is_ok_and(|output| output.status.success()) {
        assert!(
            std::env::var_os("HOLDPOINT_PYTHON").is_none(),
            "the Python that was named has no `cryptography`"
        );
        println!(
            "LEFT OUT: there is no python3 with `cryptography`; the verifier in Python judges nothing here"
        );
        return None;
    }
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
pub fn both(file: &Path) -> Result<(), VerifyError> {
    let ours = verify_export(file, None);
    if let Some(theirs) = python(file) {
        same(&ours, &theirs).unwrap_or_else(|problem| panic!("{problem}"));
    }
    ours.map(drop)
}

/// The kind of problem, as both verifiers name it.
pub fn what(error: &VerifyError) -> &'static str {
    match error {
        VerifyError::Record { .. } => "record",
        VerifyError::Checkpoint { .. } => "head",
        VerifyError::Unsigned(_) => "end",
        VerifyError::Approval { .. } => "approval",
        VerifyError::Person { .. } => "person",
        VerifyError::Line { .. } => "line",
        other => panic!("{other}"),
    }
}

/// Whether both agree: sound with the same numbers, or the same kind of problem at the same record.
pub fn same(ours: &Result<ExportReport, VerifyError>, theirs: &serde_json::Value) -> Result<(), String> {
    let is_same = match ours {
        Ok(report) => {
            let mut expected = serde_json::to_value(report).unwrap();
            expected["sound"] = true.into();
            *theirs == expected
        }
        Err(error) => {
            theirs["sound"] == false
                && theirs["what"] == what(error)
                && theirs["record"].as_u64() == error.record()
        }
    };
    if is_same { Ok(()) } else { Err(format!("theirs: {theirs}, ours: {ours:?}")) }
}

/// An administrator verifies a person, and authorizes a witness and changes of profile.
pub fn vouched(folder: &Path, witness: &Path) {
    let store = open(folder);
    confirm(&store, "ada");
    let (place, head) = (witness.display().to_string(), store.views().unwrap().head().unwrap());
    let end = (store.store_id(), head.hash);
    let act = SignedWitnessAct::by(&administrator(&store), (&place, true), end, "a test").unwrap();
    add_witness(&store, &place, ("{}".to_owned(), Some(Box::new(act))), 7).unwrap();
    commit(&store, "real", vec![context(ProfileName::Real)]).unwrap();
    let looser = context_of(ProfileName::Real, "looser", &["runtime.retries_max"]);
    authorize(&store, &administrator(&store), &looser).unwrap();
    commit(&store, "looser", vec![looser]).unwrap();
    let sim = context(ProfileName::Sim);
    authorize(&store, &administrator(&store), &sim).unwrap();
    commit(&store, "sim", vec![sim]).unwrap();
}

/// Stores with approvals, of an earlier version, and rebuilt with a gap.
pub fn stores(root: &Path) -> Vec<PathBuf> {
    let plain = root.join("plain");
    made(&plain);
    vouched(&plain, root);
    let released = schema_1(root);
    let store = open(&released);
    store.commit(transaction("one more", store.opening().head.at_ms, Vec::new())).unwrap();
    drop(store);
    let mended = root.join("mended");
    made(&mended);
    fs::remove_file(&heads(&mended)[1].0).unwrap();
    let connection = rusqlite::Connection::open(mended.join("holdpoint.db")).unwrap();
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
    unless_in_use(|| rebuild(&mended, UnsignedRecords::Refuse, "{}", 7)).unwrap().unwrap();
    vec![plain, released, mended]
}

#[test]
fn an_exported_store_is_sound_for_both_verifiers() {
    let root = quick_folder();
    let file = root.path().join("store.jsonl");
    for store in stores(root.path()) {
        let lines = exported(&store, &file);
        assert!(is_exported(&file) && !is_exported(&store.join("holdpoint.db")));
        both(&file).unwrap_or_else(|problem| panic!("{store:?}: {problem}"));
        let report = verify_export(&file, Some(&public_key(&store))).unwrap();
        let whole = verify(&store.join("holdpoint.db"), Some(&public_key(&store))).unwrap();
        assert_eq!((report.records, report.head, report.root), (whole.records, whole.head, whole.root));
        assert_eq!((report.heads, report.approvals), (whole.checkpoints + 1, whole.approvals));
        assert!(lines.iter().all(|line| line.bytes().all(|byte| (b' '..=b'~').contains(&byte))));
    }
    // And so is the record of an earlier version, with an authorization of a class of profile.
    both(Path::new("../../tests/fixtures/store-d43131bc/export.jsonl")).unwrap();
    let other = holdpoint_approvals::keyfile::generate().unwrap().verifying_key();
    assert!(matches!(verify_export(&file, Some(&other)), Err(VerifyError::Line { line: 1, .. })));
}

#[test]
fn a_damaged_export_is_judged_the_same_by_both() {
    let root = quick_folder();
    let (store, file) = (root.path().join("store"), root.path().join("store.jsonl"));
    made(&store);
    let lines = exported(&store, &file);
    let at = |start: &str| lines.iter().position(|line| line.starts_with(start)).unwrap();
    let (head, end, record, approval) =
        (at("{\"head\""), at("{\"end\""), at("{\"record\""), at("{\"approval\""));
    type LinesEdit<'a> = Box<dyn Fn(&mut Vec<String>) + 'a>;
    type DamageCase<'a> = (&'a str, LinesEdit<'a>, &'a str);
    let replaced = |line: usize, from: &'static str, to: &'static str| -> LinesEdit<'static> {
        Box::new(move |lines| {
            assert!(lines[line].contains(from), "{}", lines[line]);
            lines[line] = lines[line].replacen(from, to, 1);
        })
    };
    let damages: Vec<DamageCase<'_>> = vec![
        ("a record's text", replaced(record + 4, "{}", "{ }"), "audit record 5 is bad"),
        ("a record's number", replaced(record + 4, "\"seq\":5", "\"seq\":6"), "audit record 5 is bad"),
        ("a record's time", replaced(record + 6, "\"at_ms\":1", "\"at_ms\":0"), "audit record 7 is bad"),
        ("a record gone", Box::new(|lines| drop(lines.remove(record + 9))), "audit record 10 is bad"),
        (
            "a record twice",
            Box::new(|lines| lines.insert(record + 3, lines[record + 2].clone())),
            "audit record 4",
        ),
        ("two changed round", Box::new(|lines| lines.swap(record + 1, record + 2)), "audit record 2 is bad"),
        (
            "the last gone",
            Box::new(|lines| drop(lines.remove(approval - 1))),
            "is missing; the first line names",
        ),
        ("a head gone", Box::new(|lines| drop(lines.remove(head + 1))), "is missing"),
        ("a head edited", replaced(head, "\"at_ms\":1", "\"at_ms\":2"), "does not match the public key"),
        ("a tree edited", replaced(end, "\"root\":\"", "\"fold\":\""), "not as it was written"),
        ("no end", Box::new(|lines| drop(lines.remove(end))), "no signature covers the end"),
        (
            "a head for the end",
            Box::new(|lines| lines[end] = lines[head].replace("head\":{", "end\":{")),
            "no signature covers",
        ),
        ("an approval gone", Box::new(|lines| drop(lines.remove(approval))), "it is missing"),
        ("an approval twice", Box::new(|lines| lines.push(lines[approval].clone())), "it is there twice"),
        ("an approval edited", replaced(approval, "\"seen\"", "\"Seen\""), "does not match the decision"),
        (
            "another's approval",
            replaced(approval, "\"who\":\"ada\"", "\"who\":\"bob\""),
            "does not match the decision",
        ),
        ("not JSON", replaced(record + 2, "{", "["), "line"),
        ("a line of nothing", Box::new(|lines| lines.insert(record, "{}".to_owned())), "line"),
        (
            "a second first line",
            Box::new(|lines| lines.insert(record, lines[0].clone())),
            "does not belong here",
        ),
        ("heads at the end", Box::new(|lines| lines.push(lines[head].clone())), "does not belong here"),
        ("another form", replaced(0, "\"version\":1", "\"version\":2"), "line 1"),
        ("another store", replaced(0, "\"store_id\":\"", "\"store_id\":\"a"), "the person \"admin\" is bad"),
        ("fewer records", replaced(0, "\"records\":", "\"records\":1"), "is missing; the first line names"),
    ];
    for (what, damage, expected) in damages {
        let mut lines = lines.clone();
        damage(&mut lines);
        fs::write(&file, lines.join("\n") + "\n").unwrap();
        let error = both(&file).err().unwrap_or_else(|| panic!("{what} is not found"));
        assert!(error.to_string().contains(expected), "{what}: {error}");
    }
    fs::write(&file, lines.join("\n")).unwrap();
    let error = both(&file).unwrap_err();
    assert!(matches!(&error, VerifyError::Line { problem, .. } if problem.contains("cut short")), "{error}");
    fs::write(&file, "").unwrap();
    assert!(matches!(both(&file), Err(VerifyError::Line { line: 1, .. })));
}

/// A holder of the store's key with write access cannot make a person: other keys sign the acts.
#[test]
fn persons_and_who_approved_are_judged_by_both() {
    let root = quick_folder();
    let file = root.path().join("store.jsonl");
    let body = |from: &str, to: &str, which: &str| {
        format!("UPDATE audit SET body = replace(body, '{from}', '{to}') WHERE seq = ({which})")
    };
    let of =
        |name: &str| format!("SELECT seq FROM audit WHERE kind = 'person-enrolled' AND subject = '{name}'");
    let of_kind = |kind: &str| format!("SELECT seq FROM audit WHERE kind = '{kind}'");
    let newest_of = |kind: &str| format!("SELECT max(seq) FROM audit WHERE kind = '{kind}'");
    let looser_of = |kind: &str| format!("{} AND body LIKE '%retries_max%'", of_kind(kind));
    let put = "SELECT min(seq) FROM audit WHERE kind = 'approval-put'";
    for (what, edit, expected) in [
        ("a reason", body("a test", "no test", &of("ada")), "the person \"ada\" is bad"),
        (
            "a role",
            body("\"role\":\"operator\"", "\"role\":\"safety\"", &of("ada")),
            "the person \"ada\" is bad",
        ),
        ("a signer", body("\"by\":\"admin\"", "\"by\":\"ada\"", &of("ada")), "the person \"ada\" is bad"),
        (
            "a confirmation",
            body("\"guarded\":true,", "", &of_kind("person-confirmed")),
            "the person \"ada\" is bad",
        ),
        ("who confirmed", body("admin", "ada", &of_kind("person-confirmed")), "the person"),
        ("a witness", body("a test", "no test", &of_kind("witness-set")), "the person \"admin\" is bad"),
        ("whose witness", body("admin", "ada", &of_kind("witness-set")), "the person \"ada\" is bad"),
        (
            "which witness",
            body("\"present\":true", "\"present\":false", &of_kind("witness-set")),
            "the person",
        ),
        ("a profile", body("a test", "no test", &newest_of("profile-allowed")), "the person \"admin\" is bad"),
        (
            "which profile",
            body("\"profile\":\"sim\"}", "\"profile\":\"real\"}", &newest_of("profile-allowed")),
            "the person",
        ),
        (
            "whose profile",
            format!("UPDATE audit SET kind = 'decision' WHERE seq = ({})", newest_of("profile-allowed")),
            "goes over from the profile real to sim",
        ),
        (
            "a field that got less strict without an authorization",
            body("\"field\":\"runtime.retries_max\"", "\"field\":\"runtime.near_margin\"", &looser_of("context-set")),
            ": runtime.near_margin",
        ),
        (
            "what an administrator signed of a field",
            body("\"now\":\"3\"", "\"now\":\"4\"", &looser_of("profile-allowed")),
            "the person \"admin\" is bad",
        ),
        (
            "which rules",
            "UPDATE audit SET body = replace(body, substr(body, instr(body, '\"rules\":{\"digest\":\"') + 20, 8), '00000000')
             WHERE kind = 'context-set' AND body LIKE '%retries_max%'"
                .to_owned(),
            "no administrator's authorization of that",
        ),
        (
            "a profile without its rules",
            "UPDATE audit SET body = json_remove(body, '$.change.rules') WHERE kind = 'context-set' AND
             body LIKE '%\"profile\":\"sim\"%' AND seq > 9"
                .to_owned(),
            "does not name its rules",
        ),
        ("an unknown giver", body("\"who\":\"ada\"", "\"who\":\"zoe\"", put), "was not enrolled then"),
        (
            "left out",
            format!("UPDATE audit SET kind = 'decision' WHERE seq = ({})", of("ada")),
            "does not follow",
        ),
    ] {
        let store = root.path().join(what);
        made(&store);
        vouched(&store, root.path());
        rewrite(&store, &edit);
        export_store(
            &store.join("holdpoint.db"),
            ExportScope::Unchecked,
            Some(&public_key(&store)),
            &mut fs::File::create(&file).unwrap(),
        )
        .unwrap();
        let error = both(&file).err().unwrap_or_else(|| panic!("{what} is not found"));
        assert!(error.to_string().contains(expected), "{what}: {error}");
        // The export of a signed history refuses the store, too.
        let refused = export_store(&store.join("holdpoint.db"), ExportScope::Signed, None, &mut Vec::new());
        let Err(ExportError::Store(error)) = &refused else { panic!("{what}: {refused:?}") };
        assert_eq!(refusal(error).0, RefusalCause::Damaged, "{what}: {error}");
    }
    // The same decision under the same name, signed by another person's key.
    let store = root.path().join("another key");
    made(&store);
    let mut lines = exported(&store, &file);
    let line = lines.iter_mut().find(|line| line.starts_with("{\"approval\"")).unwrap();
    let value: serde_json::Value = serde_json::from_str(line).unwrap();
    let approval = serde_json::from_value(value["approval"]["approval"].clone()).unwrap();
    fs::create_dir(root.path().join("others")).unwrap();
    let other = Identity::create(&root.path().join("others"), "ada", Role::Operator);
    let signed = other.unwrap().sign(approval).unwrap();
    *line = format!("{{\"approval\":{}}}", serde_json::to_string(&signed).unwrap());
    fs::write(&file, lines.join("\n") + "\n").unwrap();
    assert!(matches!(both(&file), Err(VerifyError::Approval { .. })));
}
