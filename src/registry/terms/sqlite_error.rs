//! Errors of SQLite as errors of the store.

use holdpoint_store::StoreError;
use rusqlite::{ErrorCode, ffi};

/// Whether there was no room: in a file, or for the memory that connections share beside the database.
pub(crate) fn is_disk_full(error: &rusqlite::Error) -> bool {
    error.sqlite_error_code() == Some(ErrorCode::DiskFull)
        || error.sqlite_extended_error_code() == Some(ffi::SQLITE_IOERR_SHMSIZE)
}

/// Wraps an SQLite error; a full disk and a long row have variants of their own.
pub(crate) fn sqlite_error(what: &'static str) -> impl Fn(rusqlite::Error) -> StoreError {
    move |source| match source.sqlite_error_code() {
        _ if is_disk_full(&source) => StoreError::DiskFull { what },
        Some(ErrorCode::TooBig) => StoreError::RowTooLong { what },
        _ => StoreError::Database { what, source: Box::new(source) },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_and_a_long_row_have_errors_of_their_own() {
        let failure = |code| rusqlite::Error::SqliteFailure(ffi::Error::new(code), None);
        let wrap = sqlite_error("read the registry");
        for full in [ffi::SQLITE_FULL, ffi::SQLITE_IOERR_SHMSIZE] {
            assert!(matches!(wrap(failure(full)), StoreError::DiskFull { .. }), "{full}");
        }
        assert!(matches!(wrap(failure(ffi::SQLITE_TOOBIG)), StoreError::RowTooLong { .. }));
        let busy = wrap(failure(ffi::SQLITE_BUSY));
        let StoreError::Database { what, source } = &busy else { panic!("{busy}") };
        let text = failure(ffi::SQLITE_BUSY).to_string();
        assert_eq!((*what, source.to_string()), ("read the registry", text));
    }
}
