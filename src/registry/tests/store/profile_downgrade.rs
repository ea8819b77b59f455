//! A change of profile where robots or people are at risk needs an administrator's authorization, once and directly
//! before it.

use holdpoint_audit::chain::Head;
use holdpoint_governance::approval::Role;
use holdpoint_governance::profile::ProfileName;
use holdpoint_registry::{Store, UnsignedRecords, allow_profile, rebuild, verify};
use holdpoint_store::{Change, RefusalCause, StoreError, VerifyError};

use crate::damage::rewrite;
use crate::edits::make_full_store;
use crate::quick_folder::quick_folder;
use crate::support::*;
use holdpoint_approvals::{Identity, PersonError};

const BY: &str = "{\"user\":\"ada\"}";

fn head(store: &Store) -> Head {
    store.views().unwrap().head().unwrap()
}

/// A refused change writes nothing.
fn assert_refused(
    store: &Store,
    change: impl FnOnce() -> Result<(), StoreError>,
    expected: impl std::fmt::Display,
) {
    let before = head(store);
    let error = change().unwrap_err();
    assert!(error.to_string().contains(&expected.to_string()), "{error}");
    assert_eq!(head(store), before, "nothing was written");
}

fn commit_change(store: &Store, command: &str, next: &Change) -> Result<(), StoreError> {
    commit(store, command, vec![next.clone()]).map(drop)
}

fn profile_change(profile: ProfileName, rules: &str, less_strict: &[&str]) -> Change {
    context_of(profile, rules, less_strict)
}

#[test]
fn a_change_of_profile_needs_an_administrators_authorization_directly_before_it() {
    use ProfileName::{Human, Real, Sim};
    let folder = quick_folder();
    make_full_store(folder.path());
    let store = open(folder.path());
    let admin = administrator(&store);
    let ada = Identity::load(&store.layout().identities(), "ada").unwrap();
    // The built-in profile needs no signature, and a less strict one needs an administrator's.
    assert_refused(
        &store,
        || commit_change(&store, "loose", &profile_change(Real, "loose", &["runtime.retries_max"])),
        "1 field is",
    );
    let (real, sim) = (profile_change(Real, "real", &[]), profile_change(Sim, "sim", &[]));
    commit_change(&store, "real", &real).unwrap();
    let error = commit_change(&store, "sim", &sim).unwrap_err();
    let StoreError::UnauthorizedProfile { named, problem } = &error else { panic!("{error}") };
    assert!(named == "sim" && problem.contains(&format!("{Real} to {Sim}")), "{error}");
    // A stricter profile needs an authorization too, and so does the same profile with other numbers.
    assert!(commit_change(&store, "human", &profile_change(Human, "human", &[])).is_err());
    assert!(commit_change(&store, "other numbers", &profile_change(Real, "other numbers", &[])).is_err());
    // Only an administrator can authorize, and only for this end of the chain.
    let not_admin = PersonError::NoAdministrator { name: "ada".to_owned(), role: Role::Operator };
    assert_refused(&store, || authorize(&store, &ada, &sim), not_admin);
    let (_, outdated) = sign_profile(&store, &admin, &sim);
    commit_change(&store, "real again", &real).unwrap();
    assert_refused(
        &store,
        || allow_profile(&store, Sim, (BY.to_owned(), outdated), 7),
        PersonError::AuthorizationDoesNotFollow("sim".to_owned()),
    );
    // A later record uses up an authorization.
    authorize(&store, &admin, &sim).unwrap();
    commit_change(&store, "real a third time", &real).unwrap();
    assert!(commit_change(&store, "sim", &sim).is_err());
    // An authorization covers one list of fields.
    let loose = profile_change(Real, "loose", &["runtime.retries_max"]);
    authorize(&store, &admin, &profile_change(Real, "loose", &[])).unwrap();
    assert!(commit_change(&store, "loose", &loose).is_err());
    authorize(
        &store,
        &admin,
        &profile_change(Real, "loose", &["runtime.retries_max", "runtime.near_margin"]),
    )
    .unwrap();
    assert!(commit_change(&store, "loose", &loose).is_err());
    authorize(&store, &admin, &loose).unwrap();
    commit_change(&store, "loose", &loose).unwrap();
    commit_change(&store, "loose again", &loose).unwrap();
    authorize(&store, &admin, &sim).unwrap();
    commit_change(&store, "sim", &sim).unwrap();
    // An authorization covers one change.
    let human = profile_change(Human, "human", &[]);
    commit_change(&store, "human", &human).unwrap();
    let unguarded = || PersonError::Unguarded("admin".to_owned());
    assert_refused(&store, || authorize(&store, &admin, &real), unguarded());
    let protected = guarded_administrator(&store);
    authorize(&store, &protected, &real).unwrap();
    assert!(commit_change(&store, "sim once more", &sim).is_err());
    commit_change(&store, "real at last", &real).unwrap();
    // For a profile with approvers the key must also be passphrase-protected.
    assert_refused(&store, || authorize(&store, &admin, &human), unguarded());
    let key = *store.public_key();
    drop(store);
    let database = folder.path().join("holdpoint.db");
    verify(&database, Some(&key)).unwrap();
    // The change is in the chain, and a rebuild gives the same tables.
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
fn an_edited_record_is_not_an_authorization() {
    use ProfileName::{Human, Sim};
    let folder = quick_folder();
    make_full_store(folder.path());
    let store = open(folder.path());
    let (human, sim) = (context(Human), context(Sim));
    commit_change(&store, "human", &human).unwrap();
    let connection = rusqlite::Connection::open(folder.path().join("holdpoint.db")).unwrap();
    let guard: String = connection
        .query_row("SELECT sql FROM sqlite_schema WHERE name = 'audit_no_update'", [], |row| row.get(0))
        .unwrap();
    let (kind, body): (String, String) = connection
        .query_row("SELECT kind, body FROM audit ORDER BY seq DESC LIMIT 1", [], |row| {
            Ok((row.get(0)?, row.get(1)?))
        })
        .unwrap();
    let overwrite_newest = |kind: &str, body: &str| {
        connection.execute_batch("BEGIN; DROP TRIGGER audit_no_update").unwrap();
        let edit = "UPDATE audit SET kind = ?1, body = ?2 WHERE seq = (SELECT max(seq) FROM audit)";
        connection.execute(edit, [kind, body]).unwrap();
        connection.execute_batch(&format!("{guard}; COMMIT")).unwrap();
    };
    overwrite_newest(
        "profile-allowed",
        r#"{"change":{"act":{},"by":"{}","change":"allow-profile","profile":"sim"},"rows":[]}"#,
    );
    assert!(commit_change(&store, "sim", &sim).is_err());
    overwrite_newest(&kind, &body);
    assert!(commit_change(&store, "sim", &sim).is_err());
    let key = *store.public_key();
    drop((store, connection));
    verify(&folder.path().join("holdpoint.db"), Some(&key)).unwrap();
}

/// A rebuild must not apply an unsigned record that changes the profile.
#[test]
fn no_rebuild_applies_an_unsigned_change_of_profile() {
    let folder = quick_folder();
    make_full_store(folder.path());
    let store = open(folder.path());
    commit_change(&store, "human", &context(ProfileName::Human)).unwrap();
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
    let assert_unsigned_profile = |error: &StoreError| {
        let (cause, problem) = refusal(error);
        assert!(
            cause == RefusalCause::UnsignedProfile
                && problem.contains(&format!("{} to {}", ProfileName::Human, ProfileName::Sim)),
            "{error}"
        );
    };
    let assert_rebuild_refused = || {
        for unsigned in [UnsignedRecords::Refuse, UnsignedRecords::Take] {
            let error = unless_in_use(|| rebuild(folder.path(), unsigned, BY, 7)).unwrap_err();
            assert_unsigned_profile(&error);
        }
        assert!(verify(&database, None).is_err());
    };
    append("context-set", first);
    assert_rebuild_refused();
    // Nor beside an authorization that is also unsigned.
    rewrite(folder.path(), "DELETE FROM audit WHERE seq = (SELECT max(seq) FROM audit)");
    let authorization =
        r#"'{"change":{"act":{},"by":"{}","change":"allow-profile","profile":"sim"},"rows":[]}'"#;
    append("profile-allowed", authorization);
    append("context-set", first);
    assert_rebuild_refused();
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
    let index_sql: String = connection.query_row(sql, [], |row| row.get(0)).unwrap();
    let seq: u64 = connection.query_row("SELECT max(seq) FROM audit", [], |row| row.get(0)).unwrap();
    let hide_record =
        format!("DROP INDEX audit_kind; {index_sql} WHERE seq < {seq}; PRAGMA writable_schema = ON");
    connection.execute_batch(&hide_record).unwrap();
    let restore_text = "UPDATE sqlite_schema SET sql = ?1 WHERE name = 'audit_kind'";
    connection.execute(restore_text, [&index_sql]).unwrap();
    drop(connection);
    let error = unless_in_use(|| rebuild(folder.path(), UnsignedRecords::Take, BY, 7)).unwrap_err();
    assert_unsigned_profile(&error);
}
