//! Witnesses are added and removed on record, and where robots or people are at risk by an administrator's signed word.

use rusqlite::Connection;
use serde::Deserialize;

use super::apply::Applier;
use super::change::{Change, Transaction, command_id};
use super::error::StoreError;
use super::migrate::STORE;
use super::open::open_reader;
use super::signed;
use super::store::Store;
use super::witness::{check_path, prepare, witnesses};
use holdpoint_approvals::{Person, Persons, SignedWitnessAct};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;

/// Who asked for a witness, as the system says, JSON text, and the administrator who answers for it.
pub type WitnessedBy = (String, Option<Box<SignedWitnessAct>>);

/// Adds a witness: its folder for this store is made, and it is on record from then on. `by` is who asked for it.
///
/// # Errors
/// If the folder cannot be written, there are too many, it is one already, or nobody who may answers for it.
pub fn add_witness(store: &Store, folder: &str, by: WitnessedBy, wall_ms: i64) -> Result<(), StoreError> {
    check_path(folder)?;
    if witnesses(&store.layout().database())?.contains(folder) {
        return Err(StoreError::Exists { what: "witness", name: folder.to_owned() });
    }
    let connection = open_reader(&store.layout().database(), &STORE)?;
    let unreadable = |problem: String| StoreError::invalid("signed end", "", problem);
    let Some(end) = signed::read(&connection).map_err(unreadable)? else {
        return Err(StoreError::invalid("store", store.store_id(), "one with at least one record"));
    };
    prepare(folder, &end)?;
    set(store, folder, true, by, wall_ms)
}

/// Removes a witness, on record. What it has stays there.
///
/// # Errors
/// If it is none.
pub fn remove_witness(store: &Store, folder: &str, by: WitnessedBy, wall_ms: i64) -> Result<(), StoreError> {
    if !witnesses(&store.layout().database())?.contains(folder) {
        return Err(StoreError::NotFound { what: "witness", name: folder.to_owned() });
    }
    set(store, folder, false, by, wall_ms)
}

fn set(store: &Store, folder: &str, present: bool, by: WitnessedBy, wall_ms: i64) -> Result<(), StoreError> {
    let head = store.views()?.head()?;
    let (by, act) = by;
    store
        .commit(Transaction {
            command_id: command_id("witness")?,
            at_ms: head.at_ms,
            wall_ms,
            changes: vec![Change::SetWitness { folder: folder.to_owned(), present, by, act }],
            audit: Vec::new(),
        })
        .map(drop)
}

/// Whether witnesses are set under a profile by an administrator's signed word alone.
#[must_use]
pub const fn witnesses_are_signed(profile: ProfileName) -> bool {
    match profile {
        ProfileName::Sim => false,
        ProfileName::Real | ProfileName::Human => true,
    }
}

impl Applier<'_> {
    /// The word on a witness is an administrator's, for this end of the chain; without one where one is needed nothing
    /// is done.
    pub(super) fn check_witness_act(
        &self,
        (folder, present): (&str, bool),
        act: Option<&SignedWitnessAct>,
    ) -> Result<(), StoreError> {
        let profile = match self.context() {
            Ok((profile, ..)) => Some(profile),
            Err(StoreError::NotFound { .. }) => None,
            Err(error) => return Err(error),
        };
        let refused = |problem: String| StoreError::invalid("word on the witness", folder, problem);
        let Some(signed) = act else {
            return match profile.filter(|profile| witnesses_are_signed(*profile)) {
                None => Ok(()),
                Some(profile) => {
                    Err(refused(format!("an administrator signs it under the profile {profile}")))
                }
            };
        };
        let persons = self.persons()?;
        let checked = signed.check(&persons, (folder, present), self.head.hash);
        let checked = checked.and_then(|()| match profile {
            Some(ProfileName::Human) => signed.check_guarded(&persons),
            Some(ProfileName::Sim | ProfileName::Real) | None => Ok(()),
        });
        checked.map_err(|error| refused(error.to_string()))
    }
}

/// The part of a witness's record that is looked at.
#[derive(Deserialize)]
struct WitnessOnRecord {
    change: Change,
}

/// Looks at every signed word on a witness again: whose it is, and that they were an administrator then. Tells whose is
/// bad, and why.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn check_witness_acts(
    connection: &Connection,
    persons: &Persons,
) -> rusqlite::Result<Result<(), (String, String)>> {
    let mut select = connection.prepare("SELECT seq, prev, body FROM audit WHERE kind = ?1 ORDER BY seq")?;
    let mut rows = select.query([RecordKind::WitnessSet.name()])?;
    while let Some(row) = rows.next()? {
        let (seq, prev, body): (u64, [u8; 32], String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let Ok(WitnessOnRecord { change: Change::SetWitness { folder, present, act: Some(act), .. } }) =
            serde_json::from_str(&body)
        else {
            continue;
        };
        let by = act.act().by.clone();
        let span =
            connection.query_row("SELECT seq, revoked_seq FROM person WHERE name = ?1", [&by], |row| {
                Ok((row.get::<_, u64>(0)?, row.get::<_, Option<u64>>(1)?))
            });
        let was_enrolled =
            span.is_ok_and(|(since, until)| since < seq && until.is_none_or(|until| seq < until));
        let then = |person: &Person| person.name != by || was_enrolled;
        let checked = act.judge(&persons.at_a_time(then), (&folder, present), Digest::from_bytes(prev));
        if let Err(error) = checked {
            return Ok(Err((by, format!("in record {seq}: {error}"))));
        }
    }
    Ok(Ok(()))
}
