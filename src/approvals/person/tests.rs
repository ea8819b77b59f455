//! Which acts about people a store accepts, each attack by itself.

use super::*;

fn made(folder: &Path, name: &str, role: Role) -> Identity {
    Identity::create(folder, name, role).unwrap()
}

fn enrol(persons: &mut PersonDirectory, who: &Identity, by: &Identity) -> Result<(), PersonError> {
    let act = persons.enrolment(who.info(), true, by, "a test").unwrap();
    persons.push(&act)
}

fn revoke(persons: &mut PersonDirectory, name: &str, by: &Identity) -> Result<(), PersonError> {
    let who = persons.named(name).cloned().unwrap();
    let act = persons.revocation(&who, by, "a test").unwrap();
    persons.push(&act)
}

/// A store with an administrator and an engineer.
fn begun(folder: &Path) -> (PersonDirectory, Identity, Identity) {
    let (root, ada) = (made(folder, "admin", Role::Admin), made(folder, "ada", Role::Engineer));
    let mut persons = PersonDirectory::none("a store");
    enrol(&mut persons, &root, &root).unwrap();
    enrol(&mut persons, &ada, &root).unwrap();
    (persons, root, ada)
}

#[test]
fn first_person_is_an_administrator_with_a_self_signed_key() {
    let folder = tempfile::tempdir().unwrap();
    let (root, ada) = (made(folder.path(), "admin", Role::Admin), made(folder.path(), "ada", Role::Engineer));
    let mut persons = PersonDirectory::none("a store");
    assert_eq!(enrol(&mut persons, &ada, &ada), Err(PersonError::NotTheFirst("ada".into())));
    assert_eq!(enrol(&mut persons, &ada, &root), Err(PersonError::NotTheFirst("ada".into())));
    enrol(&mut persons, &root, &root).unwrap();
    let eve = made(folder.path(), "eve", Role::Admin);
    assert_eq!(enrol(&mut persons, &eve, &eve), Err(PersonError::SignerUnknown("eve".into())));
}

#[test]
fn only_an_enrolled_administrator_enrolls_and_revokes() {
    let folder = tempfile::tempdir().unwrap();
    let (mut persons, root, ada) = begun(folder.path());
    let ben = made(folder.path(), "ben", Role::Engineer);
    let error = enrol(&mut persons, &ben, &ada).unwrap_err();
    assert_eq!(error, PersonError::NoAdministrator { name: "ada".into(), role: Role::Engineer });
    assert!(revoke(&mut persons, "admin", &ada).is_err());
    let second = made(folder.path(), "second", Role::Admin);
    enrol(&mut persons, &second, &root).unwrap();
    revoke(&mut persons, "admin", &second).unwrap();
    assert_eq!(enrol(&mut persons, &ben, &root), Err(PersonError::SignerUnknown("admin".into())));
    assert!(persons.named("ben").is_none());
    // An administrator's name needs the administrator's key.
    let other = tempfile::tempdir().unwrap();
    let impostor = made(other.path(), "second", Role::Admin);
    assert_eq!(enrol(&mut persons, &ben, &impostor), Err(PersonError::SignerUnknown("second".into())));
}

#[test]
fn key_of_a_person_is_never_enrolled_again() {
    let folder = tempfile::tempdir().unwrap();
    let (mut persons, root, ada) = begun(folder.path());
    let alias = IdentityInfo { name: "alias".into(), ..ada.info().clone() };
    let act = persons.enrolment(&alias, false, &root, "a test").unwrap();
    assert!(matches!(persons.push(&act), Err(PersonError::KeyTaken { other, .. }) if other == "ada"));
    revoke(&mut persons, "ada", &root).unwrap();
    for name in ["ada", "alias"] {
        let who = IdentityInfo { name: name.into(), ..ada.info().clone() };
        let act = persons.enrolment(&who, false, &root, "a test").unwrap();
        assert!(persons.push(&act).is_err(), "{name}");
    }
    let other = tempfile::tempdir().unwrap();
    let error = enrol(&mut persons, &made(other.path(), "ada", Role::Engineer), &root).unwrap_err();
    assert!(matches!(error, PersonError::NameTaken { state: PersonState::Revoked, .. }), "{error}");
}

#[test]
fn last_administrator_cannot_be_revoked() {
    let folder = tempfile::tempdir().unwrap();
    let (mut persons, root, _) = begun(folder.path());
    assert_eq!(revoke(&mut persons, "admin", &root), Err(PersonError::LastAdministrator("admin".into())));
}

#[test]
fn signed_act_is_valid_once_in_one_store() {
    let folder = tempfile::tempdir().unwrap();
    let (mut persons, root, _) = begun(folder.path());
    let ben = made(folder.path(), "ben", Role::Engineer);
    let early = persons.enrolment(ben.info(), false, &root, "a test").unwrap();
    let mut elsewhere = PersonDirectory::none("another store");
    enrol(&mut elsewhere, &root, &root).unwrap();
    assert!(matches!(elsewhere.push(&early), Err(PersonError::OtherStore { .. })));
    persons.push(&early).unwrap();
    assert_eq!(persons.push(&early), Err(PersonError::DoesNotFollow("ben".into())));
}

#[test]
fn any_edit_voids_an_act() {
    let folder = tempfile::tempdir().unwrap();
    let (persons, root, _) = begun(folder.path());
    let ben = made(folder.path(), "ben", Role::Operator);
    let signed = persons.enrolment(ben.info(), false, &root, "a test").unwrap();
    persons.check(&signed).unwrap();
    type ActEdit = fn(&mut PersonAct);
    let edits: [(&str, ActEdit); 11] = [
        ("act", |a| a.act = PersonActKind::Revoke),
        ("name", |a| a.name = "eve".into()),
        ("role", |a| a.role = Role::Safety),
        ("key", |a| a.key = hex(&[7; 32])),
        ("unprotected", |a| a.unprotected = true),
        ("by", |a| a.by = "ada".into()),
        ("reason", |a| a.reason.push('!')),
        ("store", |a| a.store_id.push('!')),
        ("follows", |a| a.follows = Digest::of_parts("t", &[b"x"])),
        ("nonce", |a| a.nonce = Nonce::from_bytes([8; 16])),
        ("guarded", |a| a.guarded = true),
    ];
    for (name, edit) in edits {
        let mut forged = signed.clone();
        edit(&mut forged.act);
        assert!(persons.check(&forged).is_err(), "{name}");
    }
    for reason in ["", " \u{200b}", &"x".repeat(super::super::signed_approval::REASON_BYTES_MAX + 1)] {
        let act = persons.enrolment(ben.info(), false, &root, reason).unwrap();
        assert!(matches!(persons.check(&act), Err(PersonError::Field { field: "reason", .. })));
        // Readability of a recorded reason is not checked, because the Unicode tables change.
        assert_eq!(persons.judge(&act).is_ok(), reason == " \u{200b}", "{reason:?}");
    }
}

/// The same key under a passphrase.
fn guarded(folder: &Path, who: &Identity) -> Identity {
    use crate::keyfile::KeyEncoding;
    use crate::{KdfCost, Passphrase};
    let passphrase = Passphrase::new("under the oak".to_owned().into()).unwrap();
    who.rewrite_key(folder, KeyEncoding::Sealed(&passphrase, KdfCost::LEAST)).unwrap();
    Identity::open(folder, &who.info().name).unwrap().unlock(Some(&passphrase)).unwrap()
}

fn confirm(persons: &mut PersonDirectory, name: &str, by: &Identity) -> Result<(), PersonError> {
    let who = persons.named(name).cloned().unwrap();
    let act = persons.confirmation(&who, by, "a test").unwrap();
    persons.push(&act)
}

fn confirmed_by<'a>(persons: &'a PersonDirectory, name: &str) -> Option<&'a str> {
    persons.named(name).unwrap().confirmed_by.as_deref()
}

/// An administrator with an unencrypted key could enroll any person, who then counted as verified.
#[test]
fn administrator_with_an_unencrypted_key_verifies_no_person() {
    let folder = tempfile::tempdir().unwrap();
    let (mut persons, root, _) = begun(folder.path());
    assert_eq!(confirmed_by(&persons, "ada"), None);
    assert_eq!(confirmed_by(&persons, "admin"), Some("admin"), "where trust begins");
    assert_eq!(confirm(&mut persons, "ada", &root), Err(PersonError::Unguarded("admin".into())));
    // The same key, now protected: its signatures count from now on, and its earlier ones do not.
    let root = guarded(folder.path(), &root);
    assert_eq!(confirmed_by(&persons, "ada"), None);
    confirm(&mut persons, "ada", &root).unwrap();
    assert_eq!(confirmed_by(&persons, "ada"), Some("admin"));
    let again = confirm(&mut persons, "ada", &root).unwrap_err();
    assert_eq!(again, PersonError::Confirmed { name: "ada".into(), by: "admin".into() });
    let ben = made(folder.path(), "ben", Role::Safety);
    enrol(&mut persons, &ben, &root).unwrap();
    assert_eq!(confirmed_by(&persons, "ben"), Some("admin"), "enrolled by a passphrase-protected key");
    revoke(&mut persons, "ben", &root).unwrap();
    let who = Person { confirmed_by: None, ..persons.named("ben").cloned().unwrap() };
    let act = persons.confirmation(&who, &root, "a test").unwrap();
    assert_eq!(persons.check(&act), Err(PersonError::NotEnrolled("ben".into())));
    // Only an administrator can verify a person, and the signature covers whether the key was protected.
    let cleo = made(folder.path(), "cleo", Role::Safety);
    let mut act =
        persons.enrolment(cleo.info(), false, &made(folder.path(), "x", Role::Admin), "a test").unwrap();
    assert!(!act.act().guarded);
    act.act.guarded = true;
    assert!(matches!(persons.check(&act), Err(PersonError::Signature(_))));
}

/// An administrator whose own enrollment was signed by an unencrypted key cannot verify any person.
#[test]
fn only_a_verified_administrator_verifies_persons() {
    let folder = tempfile::tempdir().unwrap();
    let (mut persons, root, _) = begun(folder.path());
    let second = made(folder.path(), "second", Role::Admin);
    enrol(&mut persons, &second, &root).unwrap();
    let second = guarded(folder.path(), &second);
    let third = made(folder.path(), "third", Role::Admin);
    enrol(&mut persons, &third, &second).unwrap();
    let third = guarded(folder.path(), &third);
    assert_eq!((confirmed_by(&persons, "second"), confirmed_by(&persons, "third")), (None, None));
    for (whom, by) in [("second", &second), ("third", &second), ("second", &third), ("ada", &second)] {
        let error = confirm(&mut persons, whom, by).unwrap_err();
        assert_eq!(error, PersonError::SignerUnconfirmed(by.info().name.clone()), "{whom}");
    }
    let root = guarded(folder.path(), &root);
    confirm(&mut persons, "second", &root).unwrap();
    assert_eq!(confirmed_by(&persons, "third"), None, "the validity of an act is fixed when it is signed");
    confirm(&mut persons, "third", &second).unwrap();
    revoke(&mut persons, "admin", &second).unwrap();
    assert_eq!(persons.confirmer().map(|one| one.name.as_str()), Some("second"));
    confirm(&mut persons, "ada", &third).unwrap();
}
