//! Persons: enrolled and revoked only by signed acts, in the chain.

use holdpoint_approvals::{Identity, PersonError, SignedPersonAct};
use holdpoint_governance::approval::Role;
use holdpoint_registry::{Store, UnsignedRecords, rebuild, verify};
use holdpoint_store::{Change, RefusalCause};

use crate::quick_folder::quick_folder;
use crate::support::*;

const NEW: &str = "grasp@1.1.0";

/// A store with a candidate at the gate.
fn begun(folder: &std::path::Path) -> Store {
    let store = open(folder);
    store.first_administrator(0).unwrap();
    bootstrap(&store, "grasp");
    shadowed(&store, NEW);
    store
}

fn enrolment(store: &Store, who: &Identity, by: &Identity) -> SignedPersonAct {
    store.persons().unwrap().enrolment(who.info(), true, by, "a test").unwrap()
}

fn revocation(store: &Store, name: &str, by: &Identity) -> SignedPersonAct {
    let persons = store.persons().unwrap();
    persons.revocation(persons.named(name).unwrap(), by, "a test").unwrap()
}

#[track_caller]
fn refused(store: &Store, change: Change, expected: impl std::fmt::Display) {
    let before = store.views().unwrap().head().unwrap();
    let error = commit(store, "refused", vec![change]).unwrap_err().to_string();
    assert!(error.contains(&expected.to_string()), "{error}");
    assert_eq!(store.views().unwrap().head().unwrap(), before, "nothing was written");
}

fn enroll_change(signed: SignedPersonAct) -> Change {
    Change::EnrolPerson(Box::new(signed))
}

#[test]
fn first_administrator_is_created_once() {
    let folder = quick_folder();
    let store = open(folder.path());
    assert_eq!(store.first_administrator(0).unwrap().as_deref(), Some("admin"));
    assert_eq!(store.first_administrator(0).unwrap(), None);
    let persons = store.persons().unwrap();
    let admin = persons.named("admin").unwrap();
    assert_eq!((admin.role, admin.unprotected, admin.enrolled_by.as_str()), (Role::Admin, true, "admin"));
    // Another key can no longer be the first.
    let eve = Identity::create(quick_folder().path(), "eve", Role::Admin).unwrap();
    refused(
        &store,
        enroll_change(enrolment(&store, &eve, &eve)),
        PersonError::SignerUnknown("eve".to_owned()),
    );
    drop(store);
    // A death between the key and its record: the key is taken the next time.
    let folder = quick_folder();
    let store = open(folder.path());
    let left = Identity::create(&store.layout().identities(), "admin", Role::Admin).unwrap();
    store.first_administrator(0).unwrap();
    assert_eq!(administrator(&store).info(), left.info());
}

#[test]
fn only_a_signed_act_of_an_administrator_for_this_store_enrolls() {
    let (folder, elsewhere) = (quick_folder(), quick_folder());
    let (store, other) = (begun(folder.path()), begun(elsewhere.path()));
    let (ada, root) = (person(&store, "ada"), administrator(&store));
    let keys = quick_folder();
    let ben = Identity::create(keys.path(), "ben", Role::Operator).unwrap();
    let not_admin = PersonError::NoAdministrator { name: "ada".to_owned(), role: Role::Operator };
    refused(&store, enroll_change(enrolment(&store, &ben, &ada)), not_admin);
    // Of another store, whose administrator has the same key or another one.
    let other_store = PersonError::OtherStore { name: "ben".to_owned(), found: other.store_id().to_owned() };
    refused(&store, enroll_change(enrolment(&other, &ben, &root)), other_store);
    let unknown_signer = || PersonError::SignerUnknown("admin".to_owned());
    refused(&store, enroll_change(enrolment(&store, &ben, &administrator(&other))), unknown_signer());
    // A superseded act, and a used one.
    let (early, act) = (enrolment(&store, &ben, &root), enrolment(&store, &ben, &root));
    commit(&store, "enrol", vec![enroll_change(act.clone())]).unwrap();
    let does_not_follow = || PersonError::DoesNotFollow("ben".to_owned());
    refused(&store, enroll_change(early), does_not_follow());
    refused(&store, enroll_change(act), does_not_follow());
    // One key is one person, and a revocation enrolls no one.
    let alias = Identity::create(quick_folder().path(), "cleo", Role::Admin).unwrap();
    commit(&store, "second", vec![enroll_change(enrolment(&store, &alias, &root))]).unwrap();
    let revoked = revocation(&store, "admin", &alias);
    refused(&store, enroll_change(revoked.clone()), "of another kind than its change");
    commit(&store, "revoke", vec![Change::RevokePerson(Box::new(revoked))]).unwrap();
    let dora = Identity::create(keys.path(), "dora", Role::Operator).unwrap();
    refused(&store, enroll_change(enrolment(&store, &dora, &root)), unknown_signer());
    let last = Change::RevokePerson(Box::new(revocation(&store, "cleo", &alias)));
    refused(&store, last, PersonError::LastAdministrator("cleo".to_owned()));
    let report = verify(&store.layout().database(), Some(store.public_key())).unwrap();
    assert_eq!(report.persons, 4);
}

#[test]
fn a_revoked_keys_approval_has_no_effect() {
    let folder = quick_folder();
    let store = begun(folder.path());
    let (ada, root) = (person(&store, "ada"), administrator(&store));
    let (early, late) = (approve(&store, &ada, NEW, 1), approve(&store, &ada, NEW, 2));
    commit(&store, "kept", vec![Change::PutApproval(Box::new(early))]).unwrap();
    let act = revocation(&store, "ada", &root);
    commit(&store, "revoke", vec![Change::RevokePerson(Box::new(act))]).unwrap();
    refused(&store, Change::PutApproval(Box::new(late)), "not enrolled");
    refused(&store, consume(NEW, 1), "not enrolled");
}

/// Re-signed approvals with swapped public files, and removed identities, were once verified as sound.
#[test]
fn key_files_beside_the_store_enroll_no_person() {
    let folder = quick_folder();
    let store = begun(folder.path());
    let ada = person(&store, "ada");
    let signed = approve(&store, &ada, NEW, 1);
    let public = store.layout().identities().join("ada.pub");
    std::fs::remove_file(&public).unwrap();
    let eve = Identity::create(quick_folder().path(), "ada", Role::Operator).unwrap();
    let of = |who: &Identity| holdpoint_text::hex::hex(who.info().public_key.as_bytes());
    std::fs::write(&public, format!("{} operator\n", of(&eve))).unwrap();
    let forged = Change::PutApproval(Box::new(approve(&store, &eve, NEW, 2)));
    refused(&store, forged, "another key");
    commit(&store, "kept", vec![Change::PutApproval(Box::new(signed))]).unwrap();
    verify(&store.layout().database(), Some(store.public_key())).unwrap();
}

#[test]
fn persons_are_rebuilt_from_the_chain() {
    let folder = quick_folder();
    let store = begun(folder.path());
    let (ada, root) = (person(&store, "ada"), administrator(&store));
    commit(&store, "kept", vec![Change::PutApproval(Box::new(approve(&store, &ada, NEW, 1)))]).unwrap();
    let act = revocation(&store, "ada", &root);
    commit(&store, "revoke", vec![Change::RevokePerson(Box::new(act))]).unwrap();
    let before: Vec<_> = store.persons().unwrap().all().cloned().collect();
    drop(store);
    let database = folder.path().join("holdpoint.db");
    let edit = rusqlite::Connection::open(&database).unwrap();
    edit.execute_batch(
        "DROP TRIGGER person_revoked; UPDATE person SET state = 'enrolled', revoked_seq = NULL, \
         revoked_by = NULL, revoked = NULL WHERE name = 'ada'",
    )
    .unwrap();
    drop(edit);
    let error = unless_in_use(|| Store::open(folder.path())).unwrap_err();
    let (cause, problem) = refusal(&error);
    assert!(cause == RefusalCause::NotTheChain && problem.contains("person \"ada\""), "{error}");
    unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, "{}", 0)).unwrap();
    let store = open(folder.path());
    assert_eq!(store.persons().unwrap().all().cloned().collect::<Vec<_>>(), before);
}

#[test]
fn a_confirmation_is_stored_checked_and_rebuilt() {
    let folder = quick_folder();
    let store = begun(folder.path());
    person(&store, "ada");
    person(&store, "ben");
    let report = || verify(&folder.path().join("holdpoint.db"), Some(store.public_key())).unwrap();
    assert_eq!((report().persons, report().confirmed), (3, 1));
    // By an unencrypted key, and submitted as another kind of act.
    let persons = store.persons().unwrap();
    let (ada, root) = (persons.named("ada").unwrap(), administrator(&store));
    let open_key = persons.confirmation(ada, &root, "a test").unwrap();
    refused(&store, Change::ConfirmPerson(Box::new(open_key)), PersonError::Unguarded("admin".to_owned()));
    let guarded = persons.confirmation(ada, &guarded_administrator(&store), "a test").unwrap();
    refused(&store, Change::RevokePerson(Box::new(guarded.clone())), "of another kind than its change");
    confirm(&store, "ada");
    refused(&store, Change::ConfirmPerson(Box::new(guarded)), PersonError::DoesNotFollow("ada".to_owned()));
    assert_eq!((report().persons, report().confirmed), (3, 2));
    // Revoked persons and later acts keep their order.
    commit(&store, "revoke", vec![Change::RevokePerson(Box::new(revocation(&store, "ada", &root)))]).unwrap();
    confirm(&store, "ben");
    let before: Vec<_> = store.persons().unwrap().all().cloned().collect();
    drop(store);
    // Forged for ben by hand: the chain differs, and a rebuild restores it.
    let database = folder.path().join("holdpoint.db");
    let edit = rusqlite::Connection::open(&database).unwrap();
    let by_hand = "DROP TRIGGER person_confirmed; UPDATE person SET confirmed_seq = NULL, confirmed = NULL WHERE name = 'ben'";
    edit.execute_batch(by_hand).unwrap();
    drop(edit);
    let error = unless_in_use(|| Store::open(folder.path())).unwrap_err();
    let (cause, problem) = refusal(&error);
    assert!(cause == RefusalCause::NotTheChain && problem.contains("person \"ben\""), "{error}");
    unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, "{}", 0)).unwrap();
    assert_eq!(open(folder.path()).persons().unwrap().all().cloned().collect::<Vec<_>>(), before);
}

/// Schema 3 had no verifications: its persons are read unchanged, and only the first administrator is verified.
#[test]
fn schema_3_is_migrated_with_no_verified_person() {
    let folder = quick_folder();
    let store = begun(folder.path());
    person(&store, "ada");
    drop(store);
    let database = folder.path().join("holdpoint.db");
    let older = rusqlite::Connection::open(&database).unwrap();
    older
        .execute_batch(
            "DROP TRIGGER person_confirmed; ALTER TABLE person DROP COLUMN confirmed;
             ALTER TABLE person DROP COLUMN confirmed_seq; PRAGMA user_version = 3",
        )
        .unwrap();
    drop(older);
    let persons = holdpoint_registry::Views::open(&database).unwrap().persons().unwrap();
    assert_eq!((persons.all().count(), persons.confirmed().count()), (2, 1));
    let store = open(folder.path());
    confirm(&store, "ada");
    let report = verify(&database, Some(store.public_key())).unwrap();
    assert_eq!((report.persons, report.confirmed), (2, 2));
}
