//! Adds and removes witnesses on record; where robots or people are at risk, by an administrator's signed
//! authorization.

use crate::chain::chain_signature;
use crate::database::migrate::STORE;
use crate::database::open::open_reader;
use crate::reading::witness_views::witnesses;
use crate::writer::store::Store;
use holdpoint_approvals::SignedWitnessAct;
use holdpoint_audit::witness::{check_path, prepare};
use holdpoint_store::{Change, StoreError};

/// The requesting system user, JSON text, and the authorizing administrator.
pub type WitnessRequester = (String, Option<Box<SignedWitnessAct>>);

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
    (by, act): WitnessRequester,
    wall_ms: i64,
) -> Result<(), StoreError> {
    let change = Change::SetWitness { folder: folder.to_owned(), present, by, act };
    store.commit_alone("witness", change, wall_ms)
}
