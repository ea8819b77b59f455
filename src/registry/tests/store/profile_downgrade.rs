//! A change of profile where robots or people are at risk needs an administrator's authorization, once and directly
//! before it.

use holdpoint_governance::profile::ProfileName;
use holdpoint_registry::{
    Change, Head, RefusalCause, Store, StoreError, UnsignedRecords, VerifyError, allow_profile, rebuild,
    verify,
};

use crate::damage::rewrite;
use crate::edits::{made, quick_folder};
use crate::support::*;
use holdpoint_approvals::Identity;

const BY: &str = "{\"user\":\"ada\"}";

fn head(store: &Store) -> Head {
    store.views().unwrap().head().unwrap()
}

/// A refused change writes nothing.
fn refused(store: &Store, what: impl FnOnce() -> Result<(), StoreError>, expected: &str) {
    let before = head(store);
    let error = what().unwrap_err();
    assert!(error.to_string().contains(expected), "{error}");
    assert_eq!(head(store), before, "nothing was written");
}

fn set(store: &Store, command: &str, next: &Change) -> Result<(), StoreError> {
    commit(store, command, vec![next.clone()]).map(drop)
}

fn of(profile: ProfileName, rules: &str, looser: &[&str]) -> Change {
    context_of(profile, rules, looser)
}

#[test]
fn a_change_of_profile_takes_an_administrators_authorization_right_before_it() {
    use ProfileName::{Human, Real, Sim};
    let folder = quick_folder();
    made(folder.path());
    let store = open(folder.path());
    let admin = administrator(&store);
    let ada = Identity::load(&store.layout().identities(), "ada").unwrap();
    // The built-in profile needs no signature, and a less strict one needs an administrator's.
    refused(&store, || set(&store, "loose", &of(Real, "loose", &["runtime.retries_max"])), "1 field is");
    let (real, sim) = (of(Real, "real", &[]), of(Sim, "sim", &[]));
    set(&store, "real", &real).unwrap();
    let error = set(&store, "sim", &sim).unwrap_err();
    let StoreError::UnauthorizedProfile { named, problem } = &error else { panic!("{error}") };
    assert!(named == "sim" && problem.contains("real to sim"), "{error}");
    // A stricter profile is another one, and so is the same one with other numbers.
    assert!(set(&store, "human", &of(Human, "human", &[])).is_err());
    assert!(set(&store, "other numbers", &of(Real, "other numbers", &[])).is_err());
    // Only an administrator's, and only for this end of the chain.
    refused(&store, || authorize(&store, &ada, &sim), "only an administrator");
    let (_, early) = sign_profile(&store, &admin, &sim);
    set(&store, "real again", &real).unwrap();
    refused(&store, || allow_profile(&store, Sim, (BY.to_owned(), early), 7), "another end of the record");
    // A later record uses up an authorization.
    authorize(&store, &admin, &sim).unwrap();
    set(&store, "real a third time", &real).unwrap();
    assert!(set(&store, "sim", &sim).is_err());
    // An authorization covers one list of fields.
    let loose = of(Real, "loose", &["runtime.retries_max"]);
    authorize(&store, &admin, &of(Real, "loose", &[])).unwrap();
    assert!(set(&store, "loose", &loose).is_err());
    authorize(&store, &admin, &of(Real, "loose", &["runtime.retries_max", "runtime.near_margin"])).unwrap();
    assert!(set(&store, "loose", &loose).is_err());
    authorize(&store, &admin, &loose).unwrap();
    set(&store, "loose", &loose).unwrap();
    set(&store, "loose again", &loose).unwrap();
    authorize(&store, &admin, &sim).unwrap();
    set(&store, "sim", &sim).unwrap();
    // And one change.
    let human = of(Human, "human", &[]);
    set(&store, "human", &human).unwrap();
    refused(&store, || authorize(&store, &admin, &real), "had no passphrase when it signed");
    let guarded = guarded_administrator(&store);
    authorize(&store, &guarded, &real).unwrap();
    assert!(set(&store, "sim once more", &sim).is_err());
    set(&store, "real at last", &real).unwrap();
    // For a profile with approvers the key must also be passphrase-protected.
    refused(&store, || authorize(&store, &admin, &human), "had no passphrase when it signed");
    let key = *store.public_key();
    drop(store);
    let database = folder.path().join("holdpoint.db");
    verify(&database, Some(&key)).unwrap();
    // It is in the chain, and a rebuild gives the same tables.
    let connection = rusqlite::Connection::open(&database).unwrap();
    connection.execute("UPDATE context SET profile = 'sim'", []).unwrap();
    drop(connection);
    let error = verify(&database, Some(&key)).unwrap_err();
    assert!(matches!(error, VerifyError::State { table: "context", .. }), "{error}");
    unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Refuse, BY, 7)).unwrap().unwrap();
    verify(&database, Some(&key)).unwrap();
    let store = open(folder.path());
    assert_eq!(store.views().unwrap().context().unwrap().unwrap().0, Real);
}

/// Editing the newest record, under a running engine or in a free store, makes no authorization.
#[test]
fn an_edited_record_is_no_authorization() {
    use ProfileName::{Human, Sim};
    let folder = quick_folder();
    made(folder.path());
    let store = open(folder.path());
    let (human, sim) = (context(Human), context(Sim));
    set(&store, "human", &human).unwrap();
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
    assert!(set(&store, "sim", &sim).is_err());
    newest(&kind, &body);
    assert!(set(&store, "sim", &sim).is_err());
    let key = *store.public_key();
    drop((store, connection));
    verify(&folder.path().join("holdpoint.db"), Some(&key)).unwrap();
}

/// An unsigned record changes the profile: a rebuild must not take it.
#[test]
fn no_rebuild_takes_a_change_of_profile_that_nobody_signed() {
    let folder = quick_folder();
    made(folder.path());
    let store = open(folder.path());
    set(&store, "human", &context(ProfileName::Human)).unwrap();
    drop(store);
    let append = |kind: &str, body: &str| {
        let record = format!(
            "INSERT INTO audit (seq, prev, hash, at_ms, kind, subject, body, wall_ms)
               SELECT seq + 1, hash, zeroblob(32), at_ms, '{kind}', '', {body}, wall_ms
               FROM audit ORDER BY seq DESC LIMIT 1"
        );
        rewrite(folder.path(), &record);
    };
    // In the form of an earlier version.
    let first = "json_remove((SELECT body FROM audit WHERE kind = 'context-set' ORDER BY seq LIMIT 1), '$.change.rules')";
    let database = folder.path().join("holdpoint.db");
    let is_unsigned_profile = |error: &StoreError| {
        let (cause, problem) = refusal(error);
        assert!(cause == RefusalCause::UnsignedProfile && problem.contains("human to sim"), "{error}");
    };
    let is_refused = || {
        for unsigned in [UnsignedRecords::Refuse, UnsignedRecords::Take] {
            let error = unless_in_use(|| rebuild(folder.path(), unsigned, BY, 7)).unwrap_err();
            is_unsigned_profile(&error);
        }
        assert!(verify(&database, None).is_err());
    };
    append("context-set", first);
    is_refused();
    // Nor beside an authorization that is also unsigned.
    rewrite(folder.path(), "DELETE FROM audit WHERE seq = (SELECT max(seq) FROM audit)");
    let authorization =
        r#"'{"change":{"act":{},"by":"{}","change":"allow-profile","profile":"sim"},"rows":[]}'"#;
    append("profile-allowed", authorization);
    append("context-set", first);
    is_refused();
    // Nor an ambiguous one.
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
    is_unsigned_profile(&error);
}
