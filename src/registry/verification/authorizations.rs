//! Re-checks the signed authorizations on record: of witnesses, and of changes of profile that need one.

use rusqlite::Connection;
use serde::Deserialize;

use holdpoint_approvals::{Person, PersonDirectory};
use holdpoint_audit::history_error::HistoryError;
use holdpoint_audit::profile_history::{ProfileChangeBody, ProfileHistory, check_key_guarded};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::RecordKind;
use holdpoint_store::Change;

/// The checked part of an authorization's record.
#[derive(Deserialize)]
struct AuthorizationBody {
    change: Change,
}

/// Re-checks every signed authorization: its signer was an administrator at that time, with a passphrase-protected key
/// under a profile with approvers. Every change of profile that needs an authorization must have one. Returns the first
/// problem.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn check_authorizations(
    connection: &Connection,
    persons: &PersonDirectory,
) -> rusqlite::Result<Result<(), HistoryError>> {
    let kinds = [RecordKind::WitnessSet, RecordKind::ProfileAllowed, RecordKind::ContextSet];
    let mut select = connection
        .prepare("SELECT seq, prev, body, kind FROM audit WHERE kind IN (?1, ?2, ?3) ORDER BY seq")?;
    let mut rows = select.query(kinds.map(RecordKind::name))?;
    let mut history = ProfileHistory::default();
    while let Some(row) = rows.next()? {
        let (seq, prev, body): (u64, [u8; 32], String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let bad = |problem: String| Ok(Err(HistoryError::Record { seq, problem }));
        if row.get::<_, String>(3)? == RecordKind::ContextSet.name() {
            let set = serde_json::from_str::<ProfileChangeBody>(&body).map_err(|error| error.to_string());
            match set.and_then(|set| history.take(seq, set.change)) {
                Ok(()) => continue,
                Err(problem) => return bad(problem),
            }
        }
        let change = match serde_json::from_str(&body) {
            Ok(AuthorizationBody { change }) => change,
            Err(error) => return bad(error.to_string()),
        };
        let by = match &change {
            Change::SetWitness { act: Some(act), .. } => &act.act().by,
            Change::AllowProfile { act, .. } => &act.act().by,
            // Records of earlier versions, which had no authorizations.
            _ => continue,
        };
        let span = connection.query_row("SELECT seq, revoked_seq FROM person WHERE name = ?1", [by], |row| {
            Ok((row.get::<_, u64>(0)?, row.get::<_, Option<u64>>(1)?))
        });
        let was_enrolled =
            span.is_ok_and(|(since, until)| since < seq && until.is_none_or(|until| seq < until));
        let then = persons.at_a_time(|person: &Person| &person.name != by || was_enrolled);
        let after = Digest::from_bytes(prev);
        let checked = match &change {
            Change::SetWitness { act: Some(act), folder, present, .. } => {
                act.judge(&then, (folder.as_str(), *present), after)
            }
            Change::AllowProfile { act, profile, .. } => {
                let last = history.last().map(|last| last.class);
                history.allow(seq, *profile, act.act().rules.clone());
                act.judge(&then, *profile, after).and_then(|()| check_key_guarded(act, &then, last))
            }
            _ => continue,
        };
        if let Err(error) = checked {
            let problem = format!("in record {seq}: {error}");
            return Ok(Err(HistoryError::Person { name: by.clone(), problem }));
        }
    }
    Ok(Ok(()))
}

/// The first later record that changes a profile without an authorization, with its problem. The records there are
/// unsigned. An authorization among them therefore does not count, nor do earlier forms or unreadable records. Other
/// checks judge the signed records.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn first_unauthorized(
    connection: &Connection,
    signed: u64,
) -> rusqlite::Result<Option<(u64, String)>> {
    let kinds = [RecordKind::ContextSet.name(), RecordKind::ProfileAllowed.name()];
    let mut select =
        // Without an index: a false one hides records.
        connection.prepare("SELECT seq, kind, body FROM audit WHERE +kind IN (?1, ?2) ORDER BY seq")?;
    let mut rows = select.query(kinds)?;
    let mut history = ProfileHistory::default();
    while let Some(row) = rows.next()? {
        let (seq, kind, body): (u64, String, String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let is_signed = seq <= signed;
        if !is_signed {
            history.require_authorization();
        }
        let problem = match serde_json::from_str::<ProfileChangeBody>(&body) {
            Ok(found) if kind == RecordKind::ContextSet.name() => history.take(seq, found.change).err(),
            Ok(found) if is_signed => {
                history.allow_on_record(seq, found.change);
                None
            }
            Ok(_) => None,
            Err(error) => Some(format!("it cannot be read which profile it is about: {error}")),
        };
        if let Some(problem) = problem.filter(|_| !is_signed) {
            return Ok(Some((seq, problem)));
        }
    }
    Ok(None)
}
