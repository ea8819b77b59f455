//! The witnesses on record: lists, adds and removes them; where robots or people are at risk, by an administrator's signed
//! authorization.

use std::collections::BTreeSet;
use std::path::Path;

use serde::Deserialize;

use super::apply::Applier;
use super::chain_signature;
use super::change::{Change, Transaction, command_id};
use super::error::StoreError;
use super::migrate::STORE;
use super::open::open_reader;
use super::store::Store;
use holdpoint_approvals::SignedWitnessAct;
use holdpoint_audit::witness::{check_path, prepare};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;

/// The requesting system user, JSON text, and the authorizing administrator.
pub type WitnessRequester = (String, Option<Box<SignedWitnessAct>>);

/// The witness folders of a store, from its records.
///
/// # Errors
/// If the store cannot be read.
pub fn witnesses(database: &Path) -> Result<BTreeSet<String>, StoreError> {
    #[derive(Deserialize)]
    struct RecordedWitness {
        change: Change,
    }
    let error = StoreError::sql("read the audit chain");
    let connection = open_reader(database, &STORE)?;
    let mut select =
        connection.prepare("SELECT seq, body FROM audit WHERE kind = ?1 ORDER BY seq").map_err(&error)?;
    let mut rows = select.query([RecordKind::WitnessSet.name()]).map_err(&error)?;
    let mut found = BTreeSet::new();
    while let Some(row) = rows.next().map_err(&error)? {
        let (seq, body): (u64, String) = (row.get(0).map_err(&error)?, row.get(1).map_err(&error)?);
        let read: RecordedWitness =
            serde_json::from_str(&body).map_err(|it| StoreError::invalid("audit record", seq, it))?;
        if let Change::SetWitness { folder, present, .. } = read.change {
            if present {
                found.insert(folder);
            } else {
                found.remove(&folder);
            }
        }
    }
    Ok(found)
}

/// Adds a witness: makes its folder for this store and puts it on record. `by` is the requesting user.
///
/// # Errors
/// If the folder cannot be written, there are too many, it is a witness already, or the authorization is missing.
pub fn add_witness(
    store: &Store,
    folder: &str,
    by: WitnessRequester,
    wall_ms: i64,
) -> Result<(), StoreError> {
    check_path(folder)?;
    if witnesses(&store.layout().database())?.contains(folder) {
        return Err(StoreError::Exists { what: "witness", name: folder.to_owned() });
    }
    let connection = open_reader(&store.layout().database(), &STORE)?;
    let unreadable = |problem: String| StoreError::invalid("signed end", "", problem);
    let Some(end) = chain_signature::read(&connection).map_err(unreadable)? else {
        return Err(StoreError::invalid("store", store.store_id(), "one with at least one record"));
    };
    prepare(folder, &end)?;
    set(store, folder, true, by, wall_ms)
}

/// Removes a witness, on record. Its files stay.
///
/// # Errors
/// If it is not a witness.
pub fn remove_witness(
    store: &Store,
    folder: &str,
    by: WitnessRequester,
    wall_ms: i64,
) -> Result<(), StoreError> {
    if !witnesses(&store.layout().database())?.contains(folder) {
        return Err(StoreError::NotFound { what: "witness", name: folder.to_owned() });
    }
    set(store, folder, false, by, wall_ms)
}

fn set(
    store: &Store,
    folder: &str,
    present: bool,
    by: WitnessRequester,
    wall_ms: i64,
) -> Result<(), StoreError> {
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

/// Whether a profile requires an administrator's signed authorization to change witnesses.
#[must_use]
pub const fn witnesses_are_signed(profile: ProfileName) -> bool {
    match profile {
        ProfileName::Sim => false,
        ProfileName::Real | ProfileName::Human => true,
    }
}

impl Applier<'_> {
    /// Checks the administrator's authorization, for this end of the chain; without a required one nothing is done.
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
        let refused = |problem: String| StoreError::invalid("authorization of the witness", folder, problem);
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
