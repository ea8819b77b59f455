//! The rows of persons, read from the acts that enroll, verify and revoke them.

use rusqlite::Connection;

use crate::chain::row_images::ChainedTable;
use crate::database::migrate::version;
use holdpoint_approvals::{Person, PersonActKind, PersonDirectory, SignedPersonAct};
use holdpoint_governance::ids::canonical_json;

/// The schema that introduced verifications.
const CONFIRMED_SINCE: usize = 4;

/// A person's row beside the acts.
struct PersonRow {
    name: String,
    role: String,
    public_key: String,
    state: String,
    enrolled_by: String,
    unprotected: bool,
    revoked_by: Option<String>,
}

impl PersonRow {
    fn is(&self, person: &Person) -> bool {
        let key = holdpoint_text::hex::hex(person.public_key.as_bytes());
        (self.role.as_str(), self.state.as_str()) == (person.role.name(), person.state.name())
            && (&self.public_key, &self.enrolled_by) == (&key, &person.enrolled_by)
            && (self.unprotected, &self.revoked_by) == (person.unprotected, &person.revoked_by)
    }
}

/// All persons of a store: each act is read from its row, in the order of the records, and checked again.
///
/// # Errors
/// If the store cannot be read. The name and the problem of the first invalid act.
pub(crate) fn read(
    connection: &Connection,
    store_id: &str,
) -> rusqlite::Result<Result<PersonDirectory, (String, String)>> {
    let mut persons = PersonDirectory::none(store_id);
    let schema = version(connection)?;
    if schema < ChainedTable::Person.since() {
        return Ok(Ok(persons));
    }
    let confirmed = if schema < CONFIRMED_SINCE { "NULL, NULL" } else { "confirmed_seq, confirmed" };
    let mut select = connection.prepare_cached(&format!(
        "SELECT name, role, public_key, state, enrolled_by, unprotected, revoked_by, seq, enrolled, revoked_seq, revoked,
         {confirmed} FROM person",
    ))?;
    let mut found = select.query([])?;
    let (mut rows, mut acts) = (Vec::new(), Vec::new());
    while let Some(row) = found.next()? {
        let name: String = row.get(0)?;
        let enrolled: (u64, String) = (row.get(7)?, row.get(8)?);
        acts.push((enrolled.0, name.clone(), PersonActKind::Enrol, enrolled.1));
        for (kind, seq, text) in [(PersonActKind::Revoke, 9, 10), (PersonActKind::Confirm, 11, 12)] {
            if let (Some(seq), Some(text)) =
                (row.get::<_, Option<u64>>(seq)?, row.get::<_, Option<String>>(text)?)
            {
                acts.push((seq, name.clone(), kind, text));
            }
        }
        rows.push(PersonRow {
            name,
            role: row.get(1)?,
            public_key: row.get(2)?,
            state: row.get(3)?,
            enrolled_by: row.get(4)?,
            unprotected: row.get(5)?,
            revoked_by: row.get(6)?,
        });
    }
    acts.sort_by_key(|(seq, ..)| *seq);
    for (_, name, kind, text) in acts {
        let pushed = serde_json::from_str::<SignedPersonAct>(&text)
            .map_err(|error| error.to_string())
            .and_then(|signed| {
                let act = signed.act();
                if (&act.name, act.act) != (&name, kind) || canonical_json(&signed).ok() != Some(text) {
                    return Err("the act differs from its record".to_owned());
                }
                persons.push(&signed).map_err(|error| error.to_string())
            });
        if let Err(problem) = pushed {
            return Ok(Err((name, problem)));
        }
    }
    for row in rows {
        if persons.named(&row.name).is_none_or(|person| !row.is(person)) {
            return Ok(Err((row.name, "the row differs from its acts".to_owned())));
        }
    }
    Ok(Ok(persons))
}
