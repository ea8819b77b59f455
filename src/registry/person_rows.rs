//! Persons in the store: the acts that enroll, verify and revoke them, checked inside their transaction, and the first
//! administrator.

use rusqlite::{Connection, params};

use super::apply::{Applier, ChangeEffect};
use super::error::StoreError;
use super::migrate::version;
use super::row_images::ChainedTable;
use holdpoint_approvals::{Person, PersonActKind, PersonDirectory, PersonState, SignedPersonAct};
use holdpoint_governance::ids::canonical_json;
use holdpoint_governance::record::RecordKind;

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
        let key = holdpoint_approvals::keyfile::hex(person.public_key.as_bytes());
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

impl Applier<'_> {
    /// All persons of the store in this transaction so far.
    pub(super) fn persons(&self) -> Result<PersonDirectory, StoreError> {
        read(self.connection, self.place.store_id)
            .map_err(StoreError::sql("read who may decide"))?
            .map_err(|(name, problem)| StoreError::Person { name, problem })
    }

    /// Enrolls, verifies or revokes, if the act is allowed.
    pub(super) fn person_act(
        &self,
        signed: &SignedPersonAct,
        kind: PersonActKind,
    ) -> Result<ChangeEffect, StoreError> {
        let act = signed.act();
        let refuse = |problem: String| StoreError::Person { name: act.name.clone(), problem };
        if act.act != kind {
            return Err(refuse("the act is of another kind than its change".to_owned()));
        }
        self.persons()?.check(signed).map_err(|error| refuse(error.to_string()))?;
        self.write_person_act(signed)
    }

    /// Stores an allowed act.
    pub(super) fn write_person_act(&self, signed: &SignedPersonAct) -> Result<ChangeEffect, StoreError> {
        let act = signed.act();
        let text = canonical_json(signed).map_err(|error| StoreError::invalid("act", &act.name, error))?;
        match act.act {
            PersonActKind::Enrol => {
                self.execute(
                    "enrol a person",
                    "INSERT INTO person (name, seq, role, public_key, state, unprotected, enrolled_by, enrolled, changed_ms)
                     VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)",
                    params![
                        act.name,
                        self.next_seq(),
                        act.role.name(),
                        act.key,
                        PersonState::Enrolled.name(),
                        act.unprotected,
                        act.by,
                        text,
                        self.at_ms
                    ],
                )?;
                Ok(ChangeEffect::new(RecordKind::PersonEnrolled, &act.name))
            }
            PersonActKind::Confirm => {
                self.execute(
                    "confirm a person",
                    "UPDATE person SET confirmed_seq = ?2, confirmed = ?3, changed_ms = ?4 WHERE name = ?1",
                    params![act.name, self.next_seq(), text, self.at_ms],
                )?;
                Ok(ChangeEffect::new(RecordKind::PersonConfirmed, &act.name))
            }
            PersonActKind::Revoke => {
                self.execute(
                    "revoke a person",
                    "UPDATE person SET state = ?2, revoked_seq = ?3, revoked_by = ?4, revoked = ?5, changed_ms = ?6
                     WHERE name = ?1",
                    params![
                        act.name,
                        PersonState::Revoked.name(),
                        self.next_seq(),
                        act.by,
                        text,
                        self.at_ms
                    ],
                )?;
                Ok(ChangeEffect::new(RecordKind::PersonRevoked, &act.name))
            }
        }
    }
}
