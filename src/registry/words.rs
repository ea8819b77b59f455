//! Administrators' signed words on record, looked at again: on witnesses, and on looser profiles.

use rusqlite::Connection;
use serde::Deserialize;

use super::change::Change;
use holdpoint_approvals::{Person, Persons};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::RecordKind;

/// The part of a record that is looked at.
#[derive(Deserialize)]
struct WordOnRecord {
    change: Change,
}

/// Looks at every signed word again: whose it is, and that they were an administrator then. Tells whose is bad, and why.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn check_words(
    connection: &Connection,
    persons: &Persons,
) -> rusqlite::Result<Result<(), (String, String)>> {
    let mut select =
        connection.prepare("SELECT seq, prev, body FROM audit WHERE kind IN (?1, ?2) ORDER BY seq")?;
    let mut rows = select.query([RecordKind::WitnessSet.name(), RecordKind::ProfileAllowed.name()])?;
    while let Some(row) = rows.next()? {
        let (seq, prev, body): (u64, [u8; 32], String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let Ok(WordOnRecord { change }) = serde_json::from_str(&body) else { continue };
        let by = match &change {
            Change::SetWitness { act: Some(act), .. } => &act.act().by,
            Change::AllowProfile { act, .. } => &act.act().by,
            // Of earlier versions, which had no words.
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
                act.judge(&then, (folder, *present), after)
            }
            Change::AllowProfile { act, profile, .. } => act.judge(&then, *profile, after),
            _ => continue,
        };
        if let Err(error) = checked {
            return Ok(Err((by.clone(), format!("in record {seq}: {error}"))));
        }
    }
    Ok(Ok(()))
}
