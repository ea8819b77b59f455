//! Copies of a store, its history in one file, quick looks, and the verifier in Python that reads that file.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

use holdpoint_approvals::{Identity, SignedWitnessAct};
use holdpoint_governance::approval::Role;
use holdpoint_governance::ids::Digest;
use holdpoint_registry::{
    BackupError, BackupParts, Exporting, LeftOut, RecordingOnRecord, Store, UnsignedRecords, VerifyError,
    Views, add_witness, backup, check_store, export_store, is_exported, rebuild, store_info, verify,
    verify_copy, verify_export,
};

use crate::damage::rewrite;
use crate::edits::{Dice, made, quick_folder};
use crate::proofs::{heads, public_key};
use crate::released::schema_1;
use crate::support::*;

const ALL: BackupParts<'static> = BackupParts { keys: true, recordings: None };

#[test]
fn a_copy_is_whole_while_an_engine_writes() {
    let (folder, to) = (quick_folder(), quick_folder());
    made(folder.path());
    let store = open(folder.path());
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut number = 1;
            while !done.load(Ordering::Relaxed) {
                number += 1;
                store.commit(transaction(&format!("more {number}"), number, Vec::new())).unwrap();
            }
        });
        let mut records = 0;
        for nth in 0..5 {
            let copy = to.path().join(format!("copy-{nth}"));
            let report = backup(folder.path(), &copy, BackupParts::default()).unwrap();
            assert!(report.verified.records > records && report.verified.key_given, "{report:?}");
            records = report.verified.records;
            let alone = to.path().join(format!("copy-{nth}.db"));
            backup(folder.path(), &alone, BackupParts::default()).unwrap();
            assert!(verify_copy(&alone, Some(&public_key(folder.path()))).unwrap().records >= records);
        }
        done.store(true, Ordering::Relaxed);
    });
    drop(store);
    verify(&folder.path().join("holdpoint.db"), None).unwrap();
    assert_eq!(fs::read_dir(to.path()).unwrap().count(), 10, "nothing is left beside the copies");
}

#[test]
fn secrets_are_copied_only_where_they_are_asked_for() {
    let (folder, to) = (quick_folder(), quick_folder());
    made(folder.path());
    let (without, with) = (to.path().join("without"), to.path().join("with"));
    assert!(!backup(folder.path(), &without, BackupParts::default()).unwrap().keys);
    let keys = |folder: &Path| -> Vec<String> {
        let mut names = Vec::new();
        for place in ["keys", "keys/identities"] {
            for entry in fs::read_dir(folder.join(place)).unwrap() {
                let path = entry.unwrap().path();
                if path.is_file() {
                    names.push(path.file_name().unwrap().to_str().unwrap().to_owned());
                }
            }
        }
        names.sort();
        names
    };
    assert_eq!(keys(&without), ["ada.pub", "admin.pub", "ben.pub", "store.pub"]);
    assert!(!without.join("recordings").exists());
    assert!(backup(folder.path(), &with, ALL).unwrap().keys);
    assert_eq!(keys(&with), keys(folder.path()));
    // It is a store to go on with.
    let head = open(folder.path()).opening().head;
    let copied = open(&with);
    assert_eq!(copied.opening().head, head);
    shadowed(&copied, "place@1.2.0");
    drop(copied);
    verify(&with.join("holdpoint.db"), None).unwrap();
    // Without keys nobody can.
    assert!(unless_in_use(|| Store::open(&without)).map(drop).unwrap_err().to_string().contains("store.key"));
}

#[test]
fn a_copy_overwrites_nothing_and_is_not_made_of_what_is_not_sound() {
    let (folder, to) = (quick_folder(), quick_folder());
    made(folder.path());
    for name in ["folder", "file.db"] {
        let there = to.path().join(name);
        if name == "folder" {
            fs::create_dir(&there).unwrap();
        } else {
            fs::write(&there, "mine").unwrap();
        }
        let said = backup(folder.path(), &there, ALL).unwrap_err().to_string();
        assert!(said.contains("is there already, and nothing is overwritten"), "{said}");
    }
    assert_eq!(fs::read_to_string(to.path().join("file.db")).unwrap(), "mine");
    let connection = rusqlite::Connection::open(folder.path().join("holdpoint.db")).unwrap();
    connection.execute_batch("UPDATE family SET reason = 'edited'").unwrap();
    drop(connection);
    for name in ["other", "other.db"] {
        let said = backup(folder.path(), &to.path().join(name), ALL).unwrap_err().to_string();
        assert!(said.contains("is not sound") && said.contains("family"), "{said}");
    }
    assert!(backup(to.path(), &to.path().join("none"), ALL).is_err());
    assert_eq!(fs::read_dir(to.path()).unwrap().count(), 2, "nothing is left");
}

/// What has the name under which a copy is made is somebody's.
#[test]
fn nothing_that_was_there_is_removed() {
    let (folder, to) = (quick_folder(), quick_folder());
    made(folder.path());
    let there = |name: &str| to.path().join(name);
    fs::create_dir(there("photos.part")).unwrap();
    fs::write(there("photos.part").join("mine.txt"), "mine").unwrap();
    fs::write(there("notes.db.part"), "mine").unwrap();
    fs::write(there("other.db.part-wal"), "mine").unwrap();
    for name in ["photos", "notes.db"] {
        let error = backup(folder.path(), &there(name), ALL).unwrap_err();
        assert!(matches!(error, BackupError::PartExists(_)), "{error}");
        assert!(error.to_string().contains(&format!("{name}.part")), "{error}");
        assert!(!there(name).exists());
    }
    backup(folder.path(), &there("other.db"), ALL).unwrap();
    for name in ["photos.part/mine.txt", "notes.db.part", "other.db.part-wal"] {
        assert_eq!(fs::read_to_string(there(name)).unwrap(), "mine", "{name}");
    }
    assert_eq!(fs::read_dir(to.path()).unwrap().count(), 4, "nothing is left");
}

#[test]
fn no_copy_is_made_in_the_store() {
    let folder = quick_folder();
    made(folder.path());
    let link = quick_folder();
    std::os::unix::fs::symlink(folder.path(), link.path().join("store")).unwrap();
    let before = fs::read_dir(folder.path()).unwrap().count();
    for place in [
        folder.path().join("inside"),
        folder.path().join("keys/in"),
        folder.path().join("checkpoints/in.db"),
        folder.path().join("keys/../inside"),
        link.path().join("store/inside"),
    ] {
        let error = backup(folder.path(), &place, ALL).unwrap_err();
        assert!(matches!(error, BackupError::Inside(_)), "{place:?}: {error}");
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), before);
}

/// Recordings are what was recorded, or are not in the copy, and that is said; one that grew without end is not read.
#[test]
fn recordings_in_a_copy_are_what_was_recorded() {
    let (folder, to) = (quick_folder(), quick_folder());
    made(folder.path());
    let place = folder.path().join("recordings");
    let of = |text: &str| -> Digest {
        use sha2::Digest as _;
        Digest::from_bytes(sha2::Sha256::digest(text).into())
    };
    let names =
        ["good.rrd", "cut.rrd", "swapped.rrd", "gone.rrd", "link.rrd", "pipe.rrd", "endless.rrd", "../keys"];
    let on_record: Vec<RecordingOnRecord> = names
        .iter()
        .map(|file| RecordingOnRecord { file: (*file).to_owned(), sha256: of("scene"), bytes: 5 })
        .collect();
    for (name, text) in
        [("good.rrd", "scene"), ("cut.rrd", "scen"), ("swapped.rrd", "Scene"), ("open.rrd", "x")]
    {
        fs::write(place.join(name), text).unwrap();
    }
    std::os::unix::fs::symlink(place.join("good.rrd"), place.join("link.rrd")).unwrap();
    assert!(Command::new("mkfifo").arg(place.join("pipe.rrd")).status().unwrap().success());
    fs::File::create(place.join("endless.rrd")).unwrap().set_len(1 << 40).unwrap();
    let told = |_: &Views| Ok(on_record.clone());
    let parts = BackupParts { keys: false, recordings: Some(&told) };
    let copy = to.path().join("copy");
    let report = backup(folder.path(), &copy, parts).unwrap();
    assert_eq!(report.recordings, 1);
    let bad: Vec<(&str, &str)> = report
        .left_out
        .iter()
        .filter(|left| left.bad)
        .map(|left| (left.file.as_str(), left.why.as_str()))
        .collect();
    assert_eq!(bad.iter().map(|(file, _)| *file).collect::<Vec<_>>(), names[1..]);
    for ((file, why), expected) in
        bad.iter().zip(["another size", "SHA-256", "missing", "a link", "a link", "another size", "name"])
    {
        assert!(why.contains(expected), "{file}: {why}");
    }
    let others: Vec<&LeftOut> = report.left_out.iter().filter(|left| !left.bad).collect();
    assert!(others.len() == 1 && others[0].file == "open.rrd", "{others:?}");
    let copied: Vec<_> =
        fs::read_dir(copy.join("recordings")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(copied, ["good.rrd"]);
}

/// What is no file in place of a database or of what SQLite keeps beside it is said, with what helps.
#[test]
fn what_is_no_file_of_a_database_is_named() {
    for (name, helps) in
        [("holdpoint.db", "--data"), ("holdpoint.db-wal", "remove it"), ("holdpoint.db-shm", "anew")]
    {
        for kind in ["a named pipe", "a folder", "a link"] {
            let folder = quick_folder();
            made(folder.path());
            let path = folder.path().join(name);
            drop(fs::remove_file(&path));
            match kind {
                "a named pipe" => assert!(Command::new("mkfifo").arg(&path).status().unwrap().success()),
                "a folder" => fs::create_dir(&path).unwrap(),
                _ => std::os::unix::fs::symlink("/dev/null", &path).unwrap(),
            }
            let database = folder.path().join("holdpoint.db");
            let opened = unless_in_use(|| Store::open(folder.path())).map(drop).unwrap_err();
            let views = holdpoint_registry::Views::open(&database).map(drop).unwrap_err();
            for error in [opened, views] {
                let hint = holdpoint_text::Hint::hint(&error).unwrap_or_default().into_owned();
                let said = format!("{error} {hint}");
                assert!(
                    said.contains(kind) && said.contains(&format!("{name}\"")) && said.contains(helps),
                    "{said}"
                );
            }
        }
    }
}

#[test]
fn a_quick_look_finds_what_is_plain_to_see() {
    let folder = quick_folder();
    made(folder.path());
    let bad = || -> Vec<String> {
        let found = check_store(folder.path()).unwrap();
        found.into_iter().filter(|looked| !looked.good).map(|looked| looked.text).collect()
    };
    assert_eq!(bad(), Vec::<String>::new());
    let info = store_info(folder.path()).unwrap();
    assert_eq!((info.signed_at, info.in_use_by), (Some(info.records), None));
    let store = open(folder.path());
    assert!(store_info(folder.path()).unwrap().in_use_by.unwrap().contains("process"));
    drop(store);
    let sql = |text: &str| {
        let connection = rusqlite::Connection::open(folder.path().join("holdpoint.db")).unwrap();
        connection.execute_batch(text).unwrap();
    };
    sql("CREATE INDEX stray ON version (author); UPDATE audit_head SET seq = seq - 1");
    let key = folder.path().join("keys").join("store.key");
    let mode = std::os::unix::fs::PermissionsExt::from_mode;
    fs::set_permissions(&key, mode(0o644)).unwrap();
    let found = bad().join("\n");
    for expected in ["not of this program", "was recorded at", "not the end", "chmod 600"] {
        assert!(found.contains(expected), "{expected}: {found}");
    }
}

/// The history of a store in one file.
fn exported(folder: &Path, file: &Path) -> Vec<String> {
    let mut bytes = Vec::new();
    export_store(&folder.join("holdpoint.db"), Exporting::Signed, Some(&public_key(folder)), &mut bytes)
        .unwrap();
    fs::write(file, &bytes).unwrap();
    String::from_utf8(bytes).unwrap().lines().map(str::to_owned).collect()
}

/// What the verifier in Python says, `None` where there is no Python with `cryptography`.
fn python(file: &Path) -> Option<serde_json::Value> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/verifier/verify.py");
    let python = std::env::var_os("HOLDPOINT_PYTHON").unwrap_or_else(|| "python3".into());
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
    let output = Command::new(&python).arg(script).arg(file).arg("--json").output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    let value: serde_json::Value = serde_json::from_str(&text).unwrap_or_else(|_| panic!("{text}{error}"));
    assert_eq!(output.status.code(), Some(i32::from(value["sound"] != true)), "{value}");
    Some(value)
}

/// Both verifiers say the same of a file. Tells what ours says.
fn both(file: &Path) -> Result<(), String> {
    let ours = verify_export(file, None);
    let theirs = python(file);
    match (ours, theirs) {
        (Ok(_), None) => Ok(()),
        (Err(error), None) => Err(error.to_string()),
        (Ok(report), Some(theirs)) => {
            let mut expected = serde_json::to_value(&report).unwrap();
            expected["sound"] = true.into();
            assert_eq!(theirs, expected);
            Ok(())
        }
        (Err(error), Some(theirs)) => {
            let what = match &error {
                VerifyError::Record { .. } => "record",
                VerifyError::Checkpoint { .. } => "head",
                VerifyError::Unsigned(_) => "end",
                VerifyError::Approval { .. } => "approval",
                VerifyError::Person { .. } => "person",
                VerifyError::Line { .. } => "line",
                other => panic!("{other}"),
            };
            assert_eq!(
                (&theirs["sound"], theirs["what"].as_str()),
                (&false.into(), Some(what)),
                "{theirs} {error}"
            );
            assert_eq!(theirs["record"].as_u64(), error.record(), "{theirs} {error}");
            Err(error.to_string())
        }
    }
}

/// An administrator confirms somebody, and answers for a witness.
fn vouched(folder: &Path, witness: &Path) {
    let store = open(folder);
    confirm(&store, "ada");
    let (place, head) = (witness.display().to_string(), store.views().unwrap().head().unwrap());
    let end = (store.store_id(), head.hash);
    let act = SignedWitnessAct::by(&administrator(&store), (&place, true), end, "a test").unwrap();
    add_witness(&store, &place, ("{}".to_owned(), Some(Box::new(act))), 7).unwrap();
}

/// Stores with approvals, of an earlier version, and rebuilt with a gap.
fn stores(root: &Path) -> Vec<PathBuf> {
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
    let other = holdpoint_approvals::keyfile::generate().unwrap().verifying_key();
    assert!(verify_export(&file, Some(&other)).unwrap_err().to_string().contains("another public key"));
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
    type Edit<'a> = Box<dyn Fn(&mut Vec<String>) + 'a>;
    type Damage<'a> = (&'a str, Edit<'a>, &'a str);
    let replaced = |line: usize, from: &'static str, to: &'static str| -> Edit<'static> {
        Box::new(move |lines| {
            assert!(lines[line].contains(from), "{}", lines[line]);
            lines[line] = lines[line].replacen(from, to, 1);
        })
    };
    let damages: Vec<Damage<'_>> = vec![
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
        ("the last gone", Box::new(|lines| drop(lines.remove(approval - 1))), "is missing; the file is said"),
        ("a head gone", Box::new(|lines| drop(lines.remove(head + 1))), "is missing"),
        ("a head edited", replaced(head, "\"at_ms\":1", "\"at_ms\":2"), "does not match the public key"),
        ("a tree edited", replaced(end, "\"root\":\"", "\"fold\":\""), "not signed to its end"),
        ("no end", Box::new(|lines| drop(lines.remove(end))), "nobody signed where"),
        (
            "a head for the end",
            Box::new(|lines| lines[end] = lines[head].replace("head\":{", "end\":{")),
            "nobody signed",
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
        ("fewer records", replaced(0, "\"records\":", "\"records\":1"), "is missing; the file is said"),
    ];
    for (what, damage, expected) in damages {
        let mut lines = lines.clone();
        damage(&mut lines);
        fs::write(&file, lines.join("\n") + "\n").unwrap();
        let said = both(&file).err().unwrap_or_else(|| panic!("{what} is not found"));
        assert!(said.contains(expected), "{what}: {said}");
    }
    fs::write(&file, lines.join("\n")).unwrap();
    assert!(both(&file).unwrap_err().contains("cut short"));
    fs::write(&file, "").unwrap();
    assert!(both(&file).unwrap_err().contains("line 1"));
}

/// Whoever can write the records and has the store's key cannot make anybody a person: the acts are signed by others.
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
            body("\"guarded\":true", "\"guarded\":false", &of_kind("person-confirmed")),
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
            Exporting::Unchecked,
            Some(&public_key(&store)),
            &mut fs::File::create(&file).unwrap(),
        )
        .unwrap();
        let said = both(&file).err().unwrap_or_else(|| panic!("{what} is not found"));
        assert!(said.contains(expected), "{what}: {said}");
        // Nor is it written out as a history that was signed.
        let refused = export_store(&store.join("holdpoint.db"), Exporting::Signed, None, &mut Vec::new());
        assert!(refused.unwrap_err().to_string().contains("history was rewritten"));
    }
    // The same decision under the same name, signed by somebody else's key.
    let store = root.path().join("another key");
    made(&store);
    let mut lines = exported(&store, &file);
    let line = lines.iter_mut().find(|line| line.starts_with("{\"approval\"")).unwrap();
    let value: serde_json::Value = serde_json::from_str(line).unwrap();
    let approval = serde_json::from_value(value["approval"]["approval"].clone()).unwrap();
    fs::create_dir(root.path().join("others")).unwrap();
    let other = Identity::create(&root.path().join("others"), "ada", Role::Operator);
    let signed = other.unwrap().sign(approval).unwrap();
    *line = serde_json::json!({ "approval": signed }).to_string();
    fs::write(&file, lines.join("\n") + "\n").unwrap();
    assert!(both(&file).unwrap_err().contains("another key than that of who gave it"));
}

/// What JSON is made of.
const LETTERS: &[u8] = b"0123456789abcdef{}[],:\"\\ \n";

/// How often the export is damaged at random; each asks Python once.
fn damages() -> usize {
    std::env::var("HOLDPOINT_FUZZ_RUNS")
        .ok()
        .and_then(|runs| runs.parse().ok())
        .map_or(30, |runs: usize| runs.min(2_000))
}

#[test]
fn no_random_damage_parts_the_verifiers() {
    let root = quick_folder();
    let (store, file) = (root.path().join("store"), root.path().join("store.jsonl"));
    made(&store);
    let whole = exported(&store, &file).join("\n") + "\n";
    if python(&file).is_none() {
        return;
    }
    let mut dice = Dice(0x5eed);
    for _ in 0..damages() {
        let mut bytes = whole.clone().into_bytes();
        let at = dice.roll(bytes.len());
        match dice.roll(5) {
            0 => bytes[at] ^= 1 << dice.roll(7),
            1 => bytes[at] = LETTERS[dice.roll(LETTERS.len())],
            2 => bytes.truncate(at),
            3 => drop(bytes.drain(at..bytes.len().min(at + 1 + dice.roll(40)))),
            _ => {
                let piece: Vec<u8> = bytes[at..bytes.len().min(at + 1 + dice.roll(400))].to_vec();
                bytes.splice(at..at, piece);
            }
        }
        fs::write(&file, &bytes).unwrap();
        let theirs = python(&file).unwrap();
        let ours = verify_export(&file, None);
        let context = || format!("at {at}: {theirs} {ours:?}");
        assert_eq!(theirs["sound"], ours.is_ok(), "{}", context());
        let record = ours.as_ref().err().and_then(VerifyError::record);
        assert_eq!(theirs["record"].as_u64(), record, "{}", context());
    }
}
