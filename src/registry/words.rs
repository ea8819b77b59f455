//! Administrators' signed words on record, looked at again: on witnesses, and on changes of profile that take one.

use rusqlite::Connection;
use serde::Deserialize;

use super::change::Change;
use super::loosened::{OnRecord, ProfileCourse};
use super::unsound::VerifyError;
use holdpoint_approvals::{Person, PersonError, Persons, SignedProfileAct};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;

/// The part of a word's record that is looked at.
#[derive(Deserialize)]
struct WordOnRecord {
    change: Change,
}

/// Looks at every signed word again: whose it is, that they were an administrator then, and that their key was guarded where
/// people decided; and that every change of profile that takes one has one. Tells what is bad.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn check_words(
    connection: &Connection,
    persons: &Persons,
) -> rusqlite::Result<Result<(), VerifyError>> {
    let kinds = [RecordKind::WitnessSet, RecordKind::ProfileAllowed, RecordKind::ContextSet];
    let mut select = connection
        .prepare("SELECT seq, prev, body, kind FROM audit WHERE kind IN (?1, ?2, ?3) ORDER BY seq")?;
    let mut rows = select.query(kinds.map(RecordKind::name))?;
    let mut course = ProfileCourse::default();
    while let Some(row) = rows.next()? {
        let (seq, prev, body): (u64, [u8; 32], String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let bad = |problem: String| Ok(Err(VerifyError::Record { seq, problem }));
        if row.get::<_, String>(3)? == RecordKind::ContextSet.name() {
            let set = serde_json::from_str::<OnRecord>(&body).map_err(|error| error.to_string());
            match set.and_then(|set| course.take(seq, set.change)) {
                Ok(()) => continue,
                Err(problem) => return bad(problem),
            }
        }
        let change = match serde_json::from_str(&body) {
            Ok(WordOnRecord { change }) => change,
            Err(error) => return bad(error.to_string()),
        };
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
            Change::AllowProfile { act, profile, .. } => {
                let last = course.last().map(|last| last.class);
                course.allow(seq, *profile, act.act().rules.clone());
                act.judge(&then, *profile, after).and_then(|()| guarded(act, &then, last))
            }
            _ => continue,
        };
        if let Err(error) = checked {
            let problem = format!("in record {seq}: {error}");
            return Ok(Err(VerifyError::Person { name: by.clone(), problem }));
        }
    }
    Ok(Ok(()))
}

/// Where people decide, before or after it, the word is one that only the administrator could have given.
pub(crate) fn guarded(
    act: &SignedProfileAct,
    persons: &Persons,
    last: Option<ProfileName>,
) -> Result<(), PersonError> {
    // Earlier versions looked at the profile in force alone.
    let next = act.act().rules.as_ref().map(|_| act.act().profile);
    if [last, next].contains(&Some(ProfileName::Human)) { act.check_guarded(persons) } else { Ok(()) }
}
