//! Changes about persons: the acts that enroll, verify and revoke them, checked inside their transaction.

use rusqlite::params;

use crate::chain::person_rows;
use crate::terms::sqlite_error::sqlite_error;
use crate::transaction::apply::{Applier, ChangeEffect};
use holdpoint_approvals::{PersonActKind, PersonDirectory, PersonState, SignedPersonAct};
use holdpoint_governance::ids::canonical_json;
use holdpoint_governance::record::RecordKind;
use holdpoint_store::StoreError;

impl Applier<'_> {
    /// All persons of the store in this transaction so far.
    pub(crate) fn persons(&self) -> Result<PersonDirectory, StoreError> {
        person_rows::read(self.connection, self.place.store_id)
            .map_err(sqlite_error("read who may decide"))?
            .map_err(|(name, problem)| StoreError::Person { name, problem })
    }

    /// Enrolls, verifies or revokes, if the act is allowed.
    pub(crate) fn person_act(
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

    pub(crate) fn write_person_act(&self, signed: &SignedPersonAct) -> Result<ChangeEffect, StoreError> {
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
