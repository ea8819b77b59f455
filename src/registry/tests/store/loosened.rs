//! A looser profile than the last one takes an administrator's word, once and at once.

use holdpoint_approvals::{Identity, SignedProfileAct};
use holdpoint_governance::profile::ProfileName;
use holdpoint_registry::{Head, Store, StoreError, UnsignedRecords, allow_profile, rebuild, verify};
use holdpoint_text::Hint as _;

use crate::edits::{made, quick_folder};
use crate::support::*;

const BY: &str = "{\"user\":\"ada\"}";

fn head(store: &Store) -> Head {
    store.views().unwrap().head().unwrap()
}

/// Puts a word on record that somebody signs over the end of the chain as it is.
fn allow(store: &Store, who: &Identity, profile: ProfileName) -> Result<(), StoreError> {
    let end = (store.store_id(), head(store).hash);
    let act = SignedProfileAct::by(who, profile, end, "a test").unwrap();
    allow_profile(store, profile, (BY.to_owned(), act), 7)
}

/// What is refused writes nothing.
fn refused(store: &Store, what: impl FnOnce() -> Result<(), StoreError>, said: &str) {
    let before = head(store);
    let error = what().unwrap_err();
    assert!(error.to_string().contains(said), "{error}");
    assert_eq!(head(store), before, "nothing was written");
}

fn set(store: &Store, command: &str, profile: ProfileName) -> Result<(), StoreError> {
    commit(store, command, vec![context(profile)]).map(drop)
}

#[test]
fn a_looser_profile_takes_an_administrators_word_right_before_it() {
    use ProfileName::{Human, Real, Sim};
    let folder = quick_folder();
    made(folder.path());
    let store = open(folder.path());
    let admin = administrator(&store);
    let ada = Identity::load(&store.layout().identities(), "ada").unwrap();
    // To a stricter one nobody has to sign, and a word on no looser one is of no use.
    refused(&store, || allow(&store, &admin, Sim), "looser one than sim");
    set(&store, "real", Real).unwrap();
    refused(&store, || allow(&store, &admin, Human), "looser one than real");
    let error = set(&store, "sim", Sim).unwrap_err();
    assert!(matches!(error, StoreError::LooserProfile { last: Real, next: Sim }), "{error}");
    let hint = error.hint().unwrap();
    assert!(hint.contains("holdpoint profile allow sim --by ADMIN"), "{hint}");
    // Nobody else's, and not one that was signed for another end of the chain.
    refused(&store, || allow(&store, &ada, Sim), "only an administrator");
    let early = SignedProfileAct::by(&admin, Sim, (store.store_id(), head(&store).hash), "a test").unwrap();
    set(&store, "real again", Real).unwrap();
    refused(&store, || allow_profile(&store, Sim, (BY.to_owned(), early), 7), "does not follow");
    // A word that something came after is used up.
    allow(&store, &admin, Sim).unwrap();
    set(&store, "real a third time", Real).unwrap();
    assert!(set(&store, "sim", Sim).is_err());
    allow(&store, &admin, Sim).unwrap();
    set(&store, "sim", Sim).unwrap();
    // And one is for one profile.
    set(&store, "human", Human).unwrap();
    refused(&store, || allow(&store, &admin, Real), "had no passphrase when it signed");
    let guarded = guarded_administrator(&store);
    allow(&store, &guarded, Real).unwrap();
    let error = set(&store, "sim once more", Sim).unwrap_err();
    assert!(matches!(error, StoreError::LooserProfile { last: Human, next: Sim }), "{error}");
    set(&store, "real at last", Real).unwrap();
    let key = *store.public_key();
    drop(store);
    let database = folder.path().join("holdpoint.db");
    verify(&database, Some(&key)).unwrap();
    // It is in the chain, and tables that are made anew from it are the same.
    let connection = rusqlite::Connection::open(&database).unwrap();
    connection.execute("UPDATE context SET profile = 'sim'", []).unwrap();
    drop(connection);
    assert!(verify(&database, Some(&key)).unwrap_err().to_string().contains("does not match"));
    unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7)).unwrap().unwrap();
    verify(&database, Some(&key)).unwrap();
    let store = open(folder.path());
    assert_eq!(store.views().unwrap().context().unwrap().unwrap().0, Real);
}
