//! A looser profile than the last one takes an administrator's word, once and at once.

use holdpoint_approvals::{Identity, SignedProfileAct};
use holdpoint_governance::profile::ProfileName;
use holdpoint_registry::{Head, Store, StoreError, UnsignedRecords, allow_profile, rebuild, verify};
use holdpoint_text::Hint as _;

use crate::damage::rewrite;
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
    refused(&store, || allow_profile(&store, Sim, (BY.to_owned(), early), 7), "none for this end");
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

/// Whoever edits the newest record under a running engine, or of a store that nobody has, makes no word of it.
#[test]
fn an_edited_record_is_no_word() {
    use ProfileName::{Human, Sim};
    let folder = quick_folder();
    made(folder.path());
    let store = open(folder.path());
    set(&store, "human", Human).unwrap();
    let connection = rusqlite::Connection::open(folder.path().join("holdpoint.db")).unwrap();
    let guard: String = connection
        .query_row("SELECT sql FROM sqlite_schema WHERE name = 'audit_no_update'", [], |row| row.get(0))
        .unwrap();
    let (kind, body): (String, String) = connection
        .query_row("SELECT kind, body FROM audit ORDER BY seq DESC LIMIT 1", [], |row| {
            Ok((row.get(0)?, row.get(1)?))
        })
        .unwrap();
    let newest = |kind: &str, body: &str| {
        connection.execute_batch("BEGIN; DROP TRIGGER audit_no_update").unwrap();
        let edit = "UPDATE audit SET kind = ?1, body = ?2 WHERE seq = (SELECT max(seq) FROM audit)";
        connection.execute(edit, [kind, body]).unwrap();
        connection.execute_batch(&format!("{guard}; COMMIT")).unwrap();
    };
    newest(
        "profile-allowed",
        r#"{"change":{"act":{},"by":"{}","change":"allow-profile","profile":"sim"},"rows":[]}"#,
    );
    let error = set(&store, "sim", Sim).unwrap_err();
    assert!(matches!(error, StoreError::LooserProfile { last: Human, next: Sim }), "{error}");
    let error = store.views().unwrap().may_follow(Sim).unwrap_err();
    assert!(matches!(error, StoreError::LooserProfile { last: Human, next: Sim }), "{error}");
    newest(&kind, &body);
    assert!(set(&store, "sim", Sim).is_err());
    let key = *store.public_key();
    drop((store, connection));
    verify(&folder.path().join("holdpoint.db"), Some(&key)).unwrap();
}

/// A record that nobody signed goes over to a looser profile: nobody can be got to take it by a rebuild.
#[test]
fn no_rebuild_takes_a_looser_profile_that_nobody_signed() {
    let folder = quick_folder();
    made(folder.path());
    let store = open(folder.path());
    set(&store, "human", ProfileName::Human).unwrap();
    drop(store);
    let append = |kind: &str, body: &str| {
        let record = format!(
            "INSERT INTO audit (seq, prev, hash, at_ms, kind, subject, body, wall_ms)
               SELECT seq + 1, hash, zeroblob(32), at_ms, '{kind}', '', {body}, wall_ms
               FROM audit ORDER BY seq DESC LIMIT 1"
        );
        rewrite(folder.path(), &record);
    };
    // As an earlier version wrote it.
    let first = "replace((SELECT body FROM audit WHERE kind = 'context-set' ORDER BY seq LIMIT 1),
       '\"looser_by_word\":true,', '')";
    let database = folder.path().join("holdpoint.db");
    let is_refused = || {
        for unsigned in [UnsignedRecords::Refuse, UnsignedRecords::Take] {
            let error = unless_in_use(|| rebuild(folder.path(), unsigned, BY, 7)).unwrap_err();
            let said = error.to_string();
            assert!(said.contains("goes over from the profile human to sim"), "{unsigned:?}: {said}");
            assert!(error.hint().unwrap().contains("from a backup"), "{error:?}");
        }
        assert!(verify(&database, None).is_err());
    };
    append("context-set", first);
    is_refused();
    // Nor beside a word that nobody signed either.
    rewrite(folder.path(), "DELETE FROM audit WHERE seq = (SELECT max(seq) FROM audit)");
    let word = r#"'{"change":{"act":{},"by":"{}","change":"allow-profile","profile":"sim"},"rows":[]}'"#;
    append("profile-allowed", word);
    append("context-set", first);
    is_refused();
    // Nor one that is read in two ways.
    rewrite(folder.path(), "DELETE FROM audit WHERE seq > (SELECT max(seq) - 2 FROM audit)");
    let twice =
        format!("replace({first}, '\"profile\":\"sim\"', '\"profile\":\"human\",\"profile\":\"sim\"')");
    append("context-set", &twice);
    let error = unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Take, BY, 7)).unwrap_err();
    assert!(error.to_string().contains("duplicate field"), "{error}");
    // Nor one that an index hides.
    rewrite(folder.path(), "DELETE FROM audit WHERE seq = (SELECT max(seq) FROM audit)");
    append("context-set", first);
    let connection = rusqlite::Connection::open(&database).unwrap();
    let sql = "SELECT sql FROM sqlite_schema WHERE name = 'audit_kind'";
    let whole: String = connection.query_row(sql, [], |row| row.get(0)).unwrap();
    let seq: u64 = connection.query_row("SELECT max(seq) FROM audit", [], |row| row.get(0)).unwrap();
    let hides = format!("DROP INDEX audit_kind; {whole} WHERE seq < {seq}; PRAGMA writable_schema = ON");
    connection.execute_batch(&hides).unwrap();
    let text = "UPDATE sqlite_schema SET sql = ?1 WHERE name = 'audit_kind'";
    connection.execute(text, [&whole]).unwrap();
    drop(connection);
    let error = unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Take, BY, 7)).unwrap_err();
    assert!(error.to_string().contains("goes over from the profile human to sim"), "{error}");
}
