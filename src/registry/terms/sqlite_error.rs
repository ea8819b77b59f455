//! Errors of SQLite as errors of the store.

use holdpoint_store::StoreError;
use rusqlite::ErrorCode;

/// Wraps an SQLite error; a full disk and a long row have variants of their own.
pub(crate) fn sqlite_error(what: &'static str) -> impl Fn(rusqlite::Error) -> StoreError {
    move |source| match source.sqlite_error_code() {
        Some(ErrorCode::DiskFull) => StoreError::DiskFull { what },
        Some(ErrorCode::TooBig) => StoreError::RowTooLong { what },
        _ => StoreError::Database { what, source: Box::new(source) },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rusqlite::ffi;

    #[test]
    fn a_full_disk_and_a_long_row_have_errors_of_their_own() {
        let failure = |code| rusqlite::Error::SqliteFailure(ffi::Error::new(code), None);
        let wrap = sqlite_error("read the registry");
        assert!(matches!(wrap(failure(ffi::SQLITE_FULL)), StoreError::DiskFull { .. }));
        assert!(matches!(wrap(failure(ffi::SQLITE_TOOBIG)), StoreError::RowTooLong { .. }));
        let (busy, text) = (failure(ffi::SQLITE_BUSY), failure(ffi::SQLITE_BUSY).to_string());
        let busy = wrap(busy);
        assert!(matches!(busy, StoreError::Database { .. }));
        assert_eq!(busy.to_string(), format!("the store could not read the registry: {text}"));
    }
}
