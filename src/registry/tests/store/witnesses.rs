//! Heads kept elsewhere: copies made by a person, and witnesses that get every checkpoint.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use holdpoint_approvals::keyfile;
use holdpoint_audit::checkpoint::Checkpoint;
use holdpoint_audit::head_copies::HeadFault;
use holdpoint_audit::history_error::HistoryError;
use holdpoint_audit::witness::{WITNESSES_MAX, check_witness};
use holdpoint_registry::{
    BackupParts, DatabaseLocation, ExportScope, Store, UnsignedRecords, VerifyOptions, add_witness, backup,
    export_store, prove_record, remove_witness, verify, verify_against, witnesses,
};
use holdpoint_store::{RefusalCause, StoreError, VerifyError};

use crate::edits::make_full_store;
use crate::killed::copy;
use crate::proofs::{heads, public_key};
use crate::quick_folder::quick_folder;
use crate::support::*;

const BY: &str = "{\"user\":\"ada\"}";

/// The store restored to its earlier state.
fn put_back(folder: &Path, before: &Path) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { fs::remove_dir_all(path).unwrap() } else { fs::remove_file(path).unwrap() }
    }
    copy(before, folder);
}

fn against(folder: &Path, copies: &[PathBuf]) -> Result<u64, VerifyError> {
    let key = public_key(folder);
    let options = VerifyOptions {
        key: Some(&key),
        against: copies,
        place: DatabaseLocation::Store,
        tell: &|_, _, _| {},
    };
    verify_against(&folder.join("holdpoint.db"), &options).map(|report| report.copies)
}

/// The comparison's verdict, by the file that it names.
fn copy_fault(found: Result<u64, VerifyError>, file: &Path) -> HeadFault {
    match found.unwrap_err() {
        VerifyError::History(HistoryError::Copy { file: named, fault }) => {
            assert!(named.starts_with(&file.display().to_string()), "{named}: {fault}");
            fault
        }
        other => panic!("{other}"),
    }
}

fn is_rewritten(fault: &HeadFault) -> bool {
    matches!(fault, HeadFault::RecordRewritten(_) | HeadFault::TreeRewritten(_))
}

/// Every form in which heads of a store can be kept elsewhere.
fn forms(folder: &Path, elsewhere: &Path) -> Vec<PathBuf> {
    let database = folder.join("holdpoint.db");
    copy(&folder.join("checkpoints"), &elsewhere.join("checkpoints"));
    copy(folder, &elsewhere.join("store"));
    fs::copy(&database, elsewhere.join("alone.db")).unwrap();
    let (newest, _) = heads(folder).pop().unwrap();
    fs::copy(newest, elsewhere.join("newest.json")).unwrap();
    fs::write(elsewhere.join("proof.json"), prove_record(&database, 3).unwrap().text().unwrap() + "\n")
        .unwrap();
    let mut exported = Vec::new();
    export_store(&database, ExportScope::Signed, Some(&public_key(folder)), &mut exported).unwrap();
    fs::write(elsewhere.join("store.jsonl"), exported).unwrap();
    ["checkpoints", "store", "alone.db", "newest.json", "proof.json", "store.jsonl"]
        .map(|name| elsewhere.join(name))
        .into()
}

#[test]
fn restored_older_store_is_found_by_every_form_of_witness_copy() {
    let (folder, before, elsewhere) = (quick_folder(), quick_folder(), quick_folder());
    make_full_store(folder.path());
    copy(folder.path(), before.path());
    let store = open(folder.path());
    shadowed(&store, "place@1.2.0");
    drop(store);
    let forms = forms(folder.path(), elsewhere.path());
    assert!(against(folder.path(), &forms).unwrap() > 8);
    put_back(folder.path(), before.path());
    // By itself it is sound: nothing in it shows later records.
    verify(&folder.path().join("holdpoint.db"), None).unwrap();
    drop(open(folder.path()));
    for form in &forms {
        let fault = copy_fault(against(folder.path(), std::slice::from_ref(form)), form);
        assert!(matches!(fault, HeadFault::CutOff { .. }), "{form:?}: {fault}");
    }
    // Continued from there, it is another history.
    let store = open(folder.path());
    for version in ["place@1.3.0", "place@1.4.0", "place@1.5.0"] {
        shadowed(&store, version);
    }
    drop(store);
    for form in &forms {
        let fault = copy_fault(against(folder.path(), std::slice::from_ref(form)), form);
        assert!(is_rewritten(&fault), "{form:?}: {fault}");
    }
    assert_eq!(against(folder.path(), &[before.path().join("checkpoints")]).unwrap(), 3);
}

#[test]
fn removed_tail_with_its_newest_checkpoint_is_found() {
    let (folder, elsewhere) = (quick_folder(), quick_folder());
    make_full_store(folder.path());
    let database = folder.path().join("holdpoint.db");
    let cut = fs::read(&database).unwrap();
    let store = open(folder.path());
    shadowed(&store, "place@1.2.0");
    drop(store);
    let (newest, head) = heads(folder.path()).pop().unwrap();
    let copied = elsewhere.path().join("head.json");
    fs::rename(newest, &copied).unwrap();
    fs::write(&database, cut).unwrap();
    drop(open(folder.path()));
    let fault = copy_fault(against(folder.path(), std::slice::from_ref(&copied)), &copied);
    assert!(matches!(fault, HeadFault::CutOff { seq, .. } if seq == head.seq), "{fault}");
}

#[test]
fn witness_copy_of_another_store_is_named() {
    let (folder, other, elsewhere) = (quick_folder(), quick_folder(), quick_folder());
    make_full_store(folder.path());
    make_full_store(other.path());
    let path = |name: &str| elsewhere.path().join(name);
    let (file, head) = heads(folder.path()).pop().unwrap();
    let secret = keyfile::read_secret(&folder.path().join("keys").join("store.key")).unwrap();
    let sign = |head: &Checkpoint, root: &str, key: &ed25519_dalek::SigningKey| {
        let end = holdpoint_audit::chain::Head { seq: head.seq, hash: head.head, at_ms: head.at_ms };
        let signed = Checkpoint::sign(
            &head.store_id,
            (end, digest(root)),
            head.wall_ms,
            head.link.clone().unwrap(),
            None,
            key,
        );
        serde_json::to_string(&signed).unwrap()
    };
    fs::write(path("tree.json"), sign(&head, "another tree", &secret)).unwrap();
    fs::write(path("key.json"), sign(&head, "x", &keyfile::generate().unwrap())).unwrap();
    fs::copy(&heads(other.path())[0].0, path("other.json")).unwrap();
    fs::write(path("garbage"), [0xff; 100]).unwrap();
    fs::write(path("empty"), "").unwrap();
    fs::create_dir(path("nothing")).unwrap();
    let edited = fs::read_to_string(&file).unwrap().replace("\"number\"", "\"nomber\"");
    fs::write(path("form.json"), edited).unwrap();
    let fault = |name: &str| copy_fault(against(folder.path(), &[file.clone(), path(name)]), &path(name));
    assert_eq!(fault("tree.json"), HeadFault::TreeRewritten(head.seq));
    assert_eq!(fault("key.json"), HeadFault::NotSigned);
    assert_eq!(fault("other.json"), HeadFault::OtherStore(heads(other.path())[0].1.store_id.clone()));
    for name in ["garbage", "empty", "nothing", "form.json", "not-there"] {
        assert!(matches!(fault(name), HeadFault::Unreadable(_)), "{name}");
    }
}

/// A witness that the store has.
fn witnessed(folder: &Path) -> (tempfile::TempDir, String) {
    let witness = quick_folder();
    let name = witness.path().display().to_string();
    let store = open(folder);
    add_witness(&store, &name, (BY.to_owned(), None), 7).unwrap();
    (witness, name)
}

#[test]
fn restored_older_store_is_refused_by_its_witness() {
    let (folder, before) = (quick_folder(), quick_folder());
    make_full_store(folder.path());
    let (witness, _) = witnessed(folder.path());
    drop(open(folder.path()));
    copy(folder.path(), before.path());
    let store = open(folder.path());
    shadowed(&store, "place@1.2.0");
    let store_id = store.store_id().to_owned();
    drop(store);
    let newest = heads(folder.path()).pop().unwrap().1;
    let sent = witness.path().join(&store_id).join(format!("{:012}.json", newest.seq));
    assert_eq!(Checkpoint::read(&sent).unwrap(), newest);
    verify(&folder.path().join("holdpoint.db"), None).unwrap();
    // An earlier copy is sound, and older than the witness's head.
    let elsewhere = quick_folder();
    backup(before.path(), &elsewhere.path().join("alone.db"), BackupParts::default()).unwrap();
    put_back(folder.path(), before.path());
    let refused = || unless_in_use(|| Store::open(folder.path())).map(drop).unwrap_err();
    let is_refused = || assert_eq!(refusal(&refused()).0, RefusalCause::Witness);
    is_refused();
    let error = verify(&folder.path().join("holdpoint.db"), None).unwrap_err();
    let VerifyError::History(HistoryError::Copy { fault, .. }) = &error else { panic!("{error}") };
    assert!(matches!(fault, HeadFault::CutOff { seq, .. } if *seq == newest.seq), "{fault}");
    // A witness that was cut back, or foreign files in it, prove nothing.
    fs::rename(&sent, folder.path().join("head")).unwrap();
    fs::write(sent.with_file_name("999999999999.json"), "{}").unwrap();
    drop(open(folder.path()));
    fs::remove_file(sent.with_file_name("999999999999.json")).unwrap();
    // Continued differently meanwhile, it is refused by the head that comes back.
    let store = open(folder.path());
    for version in ["place@1.3.0", "place@1.4.0"] {
        shadowed(&store, version);
    }
    drop(store);
    verify(&folder.path().join("holdpoint.db"), None).unwrap();
    let mut heads_there: Vec<_> =
        fs::read_dir(sent.parent().unwrap()).unwrap().map(|entry| entry.unwrap().path()).collect();
    heads_there.retain(|path| *path > sent);
    for path in heads_there {
        fs::remove_file(path).unwrap();
    }
    fs::rename(folder.path().join("head"), &sent).unwrap();
    is_refused();
    let error = verify(&folder.path().join("holdpoint.db"), None).unwrap_err();
    assert!(
        matches!(&error, VerifyError::History(HistoryError::Copy { fault, .. }) if is_rewritten(fault)),
        "{error}"
    );
    // Removing the witness is the way out.
    fs::rename(sent.parent().unwrap(), witness.path().join("put-aside")).unwrap();
    let store = open(folder.path());
    let problem = store.checkpoint_problem().unwrap();
    assert!(problem.contains("witness"), "{problem}");
}

/// A commit with a checkpoint behind it.
fn checkpointed(store: &Store, number: u64) {
    let text = "x".repeat(10);
    let many = |nth: u64| holdpoint_store::AuditBody {
        kind: holdpoint_governance::record::RecordKind::Monitor,
        subject: String::new(),
        body: format!("{{\"text\":\"{text}{nth}\"}}"),
    };
    let mut transaction = transaction(&format!("many {number}"), number, Vec::new());
    transaction.audit = (0..256).map(many).collect();
    store.commit(transaction).unwrap();
}

/// The store's report about its witness after a try.
fn settled(store: &Store, wanted: bool) -> Option<String> {
    let until = Instant::now() + Duration::from_secs(20);
    loop {
        let problem = store.checkpoint_problem();
        if problem.is_some() == wanted || Instant::now() > until {
            return problem;
        }
        std::thread::park_timeout(Duration::from_millis(5));
    }
}

#[test]
fn store_continues_if_a_witness_cannot_be_written() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let (witness, name) = witnessed(folder.path());
    let store = open(folder.path());
    let place = witness.path().join(store.store_id());
    let aside = witness.path().join("aside");
    let start = store.opening().head.at_ms;
    assert_eq!(store.checkpoint_problem(), None);
    fs::rename(&place, &aside).unwrap();
    // Another entry, which cannot be removed, blocks the write.
    let blocked = || {
        fs::create_dir(&place).unwrap();
        for seq in 0..4000 {
            fs::create_dir(place.join(format!("{seq:012}.part"))).unwrap();
        }
    };
    type Break<'a> = (&'a str, &'a dyn Fn(), &'a str);
    let breaks: [Break<'_>; 4] = [
        ("gone", &|| {}, "is not there"),
        ("a file", &|| fs::write(&place, "").unwrap(), "is not there"),
        ("read-only", &|| symlink("/proc", &place).unwrap(), "cannot create"),
        ("blocked", &blocked, "directory"),
    ];
    for (number, (what, break_it, expected)) in (1..).zip(breaks) {
        break_it();
        checkpointed(&store, start + number * 2);
        let problem = settled(&store, true).unwrap_or_else(|| panic!("{what} is not noticed"));
        assert!(problem.contains(&name) && problem.contains(expected), "{what}: {problem}");
        let looked = check_witness(&name, store.store_id());
        assert_eq!(looked.is_ok(), what == "blocked" || what == "read-only", "{what}: {looked:?}");
        match fs::symlink_metadata(&place) {
            Ok(found) if found.is_dir() => fs::remove_dir_all(&place).unwrap(),
            Ok(_) => fs::remove_file(&place).unwrap(),
            Err(_) => {}
        }
        fs::rename(&aside, &place).unwrap();
        checkpointed(&store, start + number * 2 + 1);
        assert_eq!(settled(&store, false), None, "after {what}");
        fs::rename(&place, &aside).unwrap();
    }
    fs::rename(&aside, &place).unwrap();
    drop(store);
    verify(&folder.path().join("holdpoint.db"), None).unwrap();
}

#[test]
fn hanging_witness_blocks_no_commit() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let (witness, _) = witnessed(folder.path());
    let store = open(folder.path());
    let start = store.opening().head;
    let place = witness.path().join(store.store_id());
    // A write to a pipe without a reader blocks forever.
    for seq in start.seq..start.seq + 600 {
        let pipe = place.join(format!("{seq:012}.part"));
        drop(fs::remove_file(&pipe));
        let mode = rustix::fs::Mode::from_raw_mode(0o600);
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, mode, 0).unwrap();
    }
    let began = Instant::now();
    checkpointed(&store, start.at_ms + 1);
    checkpointed(&store, start.at_ms + 2);
    assert!(began.elapsed() < Duration::from_secs(10), "{:?}", began.elapsed());
    let began = Instant::now();
    drop(store);
    assert!(began.elapsed() < Duration::from_secs(10), "{:?}", began.elapsed());
}

#[test]
fn witnesses_are_stored_only_on_record() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let database = folder.path().join("holdpoint.db");
    let (witness, name) = witnessed(folder.path());
    assert_eq!(witnesses(&database).unwrap(), [name.clone()].into());
    let store = open(folder.path());
    let add = |folder: &str| add_witness(&store, folder, (BY.to_owned(), None), 7);
    assert!(matches!(add(&name), Err(StoreError::Exists { .. })));
    for address in ["https://example.org/w", "ssh://host/w", "ada@host:/w"] {
        let error = add(address).unwrap_err();
        assert!(matches!(&error, StoreError::Invalid { value, .. } if value == address), "{error}");
    }
    for bad in ["relative", "", "/not/there", "/etc/hostname", "/a\nb"] {
        assert!(matches!(add(bad), Err(StoreError::Invalid { .. })), "{bad}");
    }
    assert!(matches!(
        remove_witness(&store, "/not/there", (BY.to_owned(), None), 7),
        Err(StoreError::NotFound { .. })
    ));
    let more: Vec<_> = (1..=WITNESSES_MAX).map(|_| quick_folder()).collect();
    for (nth, another) in more.iter().enumerate() {
        let added = add(&another.path().display().to_string());
        assert_eq!(added.is_ok(), nth + 1 < WITNESSES_MAX, "{nth}: {added:?}");
    }
    remove_witness(&store, &name, (BY.to_owned(), None), 7).unwrap();
    assert_eq!(witnesses(&database).unwrap().len(), WITNESSES_MAX - 1);
    let removed_at = store.views().unwrap().head().unwrap().seq;
    checkpointed(&store, store.opening().head.at_ms + 1);
    let store_id = store.store_id().to_owned();
    drop(store);
    // Its last head is the one that covers its removal.
    let mut entries: Vec<_> =
        fs::read_dir(witness.path().join(store_id)).unwrap().map(|it| it.unwrap()).collect();
    entries.sort_by_key(fs::DirEntry::file_name);
    assert_eq!(Checkpoint::read(&entries.pop().unwrap().path()).unwrap().seq, removed_at);
    // A rebuild keeps them, and an edited-away record is found missing.
    let sql = "UPDATE family SET reason = 'edited'";
    rusqlite::Connection::open(&database).unwrap().execute_batch(sql).unwrap();
    unless_in_use(|| holdpoint_registry::rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7))
        .unwrap()
        .unwrap();
    assert_eq!(witnesses(&database).unwrap().len(), WITNESSES_MAX - 1);
    let before = more[0].path().display().to_string();
    let edit = format!("UPDATE audit SET body = replace(body, '{before}', '/elsewhere')");
    crate::damage::rewrite(folder.path(), &edit);
    verify(&database, None).unwrap_err();
    unless_in_use(|| Store::open(folder.path())).map(drop).unwrap_err();
}

/// An attacker who replaces the store's key and signs the history again is refused by a witness's head.
#[test]
fn another_key_is_refused_by_the_witness() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let (witness, _) = witnessed(folder.path());
    drop(open(folder.path()));
    let head = heads(folder.path()).pop().unwrap().1;
    let sent = witness.path().join(&head.store_id).join(format!("{:012}.json", head.seq));
    let testimony = fs::read(&sent).unwrap();
    // The same head by another key: the file at the witness is no longer this store's.
    let mut text: serde_json::Value = serde_json::from_slice(&testimony).unwrap();
    text["signature"] = serde_json::Value::from("0".repeat(128));
    for file in fs::read_dir(sent.parent().unwrap()).unwrap() {
        fs::write(file.unwrap().path(), text.to_string()).unwrap();
    }
    let error = unless_in_use(|| Store::open(folder.path())).map(drop).unwrap_err();
    let (cause, problem) = refusal(&error);
    assert!(cause == RefusalCause::Witness && problem.contains("another key"), "{error}");
}

/// A witness that lost its files has no head, and each start reports that until one reads it again.
#[test]
fn an_emptied_or_littered_witness_is_reported() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let (witness, _) = witnessed(folder.path());
    drop(open(folder.path()));
    let newest = heads(folder.path()).pop().unwrap().1;
    let place = witness.path().join(&newest.store_id);
    let empty =
        || fs::read_dir(&place).unwrap().for_each(|file| fs::remove_file(file.unwrap().path()).unwrap());
    let litter = || {
        for nth in 0..200 {
            fs::write(place.join(format!("99999999{nth:04}.json")), "x").unwrap();
        }
    };
    empty();
    let store = open(folder.path());
    let problem = store.checkpoint_problem().unwrap();
    assert!(problem.contains("is empty"), "{problem}");
    // Opening it silently hides nothing: it is as empty for the next start.
    checkpointed(&store, store.opening().head.at_ms + 1);
    drop(store);
    assert_eq!(fs::read_dir(&place).unwrap().count(), 0);
    let store = open(folder.path());
    assert!(store.checkpoint_problem().unwrap().contains("is empty"));
    store.mark_problems_reported();
    // A later head does not make up for it.
    checkpointed(&store, store.opening().head.at_ms + 1);
    let until = Instant::now() + Duration::from_secs(20);
    while fs::read_dir(&place).unwrap().count() == 0 && Instant::now() < until {
        std::thread::park_timeout(Duration::from_millis(5));
    }
    assert!(store.checkpoint_problem().unwrap().contains("is empty"));
    drop(store);
    // Other files beside its heads prove nothing, and are named.
    litter();
    let store = open(folder.path());
    assert_eq!(store.checkpoint_problem(), None);
    drop(store);
    let report = verify(&folder.path().join("holdpoint.db"), None).unwrap();
    let silent = report.witnesses_silent.join("\n");
    assert!(silent.contains("999999990000.json") && silent.contains("197 files"), "{silent}");
    assert!(report.copies > 0, "{report:?}");
    // Alone they prove nothing.
    empty();
    litter();
    let store = open(folder.path());
    let problem = store.checkpoint_problem().unwrap();
    assert!(problem.contains("signed none"), "{problem}");
}

/// A stray file hides no head: the witness's other heads still contradict the store.
#[test]
fn a_stray_file_does_not_silence_a_witness() {
    let (folder, before) = (quick_folder(), quick_folder());
    make_full_store(folder.path());
    let (witness, _) = witnessed(folder.path());
    drop(open(folder.path()));
    copy(folder.path(), before.path());
    let store = open(folder.path());
    shadowed(&store, "place@1.2.0");
    let store_id = store.store_id().to_owned();
    drop(store);
    put_back(folder.path(), before.path());
    fs::write(witness.path().join(store_id).join("999999999999.json"), "x").unwrap();
    let error = verify(&folder.path().join("holdpoint.db"), None).unwrap_err();
    assert!(
        matches!(&error, VerifyError::History(HistoryError::Copy { fault: HeadFault::CutOff { .. }, .. })),
        "{error}"
    );
    assert!(unless_in_use(|| Store::open(folder.path())).is_err());
}

/// An attacker with write access to the store could once remove its witnesses unseen where robots and people rely on
/// it.
#[test]
fn an_administrator_signs_which_witnesses_there_are() {
    use holdpoint_approvals::{Identity, PersonError, SignedWitnessAct};
    use holdpoint_governance::approval::Role;
    use holdpoint_governance::profile::ProfileName;
    let (folder, place) = (quick_folder(), quick_folder());
    make_full_store(folder.path());
    let store = open(folder.path());
    let name = place.path().display().to_string();
    let head = || store.views().unwrap().head().unwrap();
    let authorization = |who: &Identity, present: bool, after| {
        let act = SignedWitnessAct::by(who, (&name, present), (store.store_id(), after), "a test").unwrap();
        (BY.to_owned(), Some(Box::new(act)))
    };
    let admin = administrator(&store);
    let ada = Identity::load(&store.layout().identities(), "ada").unwrap();
    commit(&store, "real", vec![context(ProfileName::Real)]).unwrap();
    let add = |by| add_witness(&store, &name, by, 7).map_err(|error| error.to_string());
    let refused = |by, expected: &str| {
        let before = head();
        let error = add(by).unwrap_err();
        assert!(error.contains(expected), "{error}");
        assert_eq!(head(), before, "nothing was written");
    };
    refused((BY.to_owned(), None), "profile real");
    let not_admin = PersonError::NoAdministrator { name: "ada".to_owned(), role: Role::Operator };
    refused(authorization(&ada, true, head().hash), &not_admin.to_string());
    let does_not_follow = PersonError::AuthorizationDoesNotFollow(name.clone()).to_string();
    refused(authorization(&admin, false, head().hash), &does_not_follow);
    let early = authorization(&admin, true, head().hash);
    commit(&store, "another", vec![context(ProfileName::Real)]).unwrap();
    refused(early, &does_not_follow);
    add(authorization(&admin, true, head().hash)).unwrap();
    remove_witness(&store, &name, authorization(&admin, false, head().hash), 7).unwrap();
    // Under a profile with approvers, an unencrypted key is not enough.
    let human = context(ProfileName::Human);
    authorize(&store, &guarded_administrator(&store), &human).unwrap();
    commit(&store, "human", vec![human]).unwrap();
    let unguarded = PersonError::Unguarded("admin".to_owned());
    refused(authorization(&admin, true, head().hash), &unguarded.to_string());
    add(authorization(&guarded_administrator(&store), true, head().hash)).unwrap();
    let report = verify(&folder.path().join("holdpoint.db"), Some(store.public_key())).unwrap();
    assert_eq!(report.witnesses_silent, Vec::<String>::new());
    // The record names the administrator who signed, not the user who ran the command.
    let database = folder.path().join("holdpoint.db");
    drop(store);
    let connection = rusqlite::Connection::open(&database).unwrap();
    let sql = "SELECT body FROM audit WHERE kind = 'witness-set' ORDER BY seq DESC LIMIT 1";
    let body: String = connection.query_row(sql, [], |row| row.get(0)).unwrap();
    let body: serde_json::Value = serde_json::from_str(&body).unwrap();
    assert_eq!(body["change"]["act"]["act"]["by"], "admin");
    assert_eq!(body["change"]["act"]["act"]["guarded"], true);
}
