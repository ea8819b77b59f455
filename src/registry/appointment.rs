//! Witnesses are added and removed on record.

use super::change::{Change, Transaction};
use super::error::StoreError;
use super::migrate::STORE;
use super::open::open_reader;
use super::signed;
use super::store::Store;
use super::witness::{check_path, prepare, witnesses};

/// Adds a witness: its folder for this store is made, and it is on record from then on. `by` is who asked for it as the
/// system says, JSON text.
///
/// # Errors
/// If the folder cannot be written, there are too many, or it is one already.
pub fn add_witness(store: &Store, folder: &str, by: String, wall_ms: i64) -> Result<(), StoreError> {
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
pub fn remove_witness(store: &Store, folder: &str, by: String, wall_ms: i64) -> Result<(), StoreError> {
    if !witnesses(&store.layout().database())?.contains(folder) {
        return Err(StoreError::NotFound { what: "witness", name: folder.to_owned() });
    }
    set(store, folder, false, by, wall_ms)
}

fn set(store: &Store, folder: &str, present: bool, by: String, wall_ms: i64) -> Result<(), StoreError> {
    let head = store.views()?.head()?;
    store
        .commit(Transaction {
            command_id: format!("witness-{}", head.seq + 1),
            at_ms: head.at_ms,
            wall_ms,
            changes: vec![Change::SetWitness { folder: folder.to_owned(), present, by }],
            audit: Vec::new(),
        })
        .map(drop)
}
