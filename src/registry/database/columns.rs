//! Text columns of closed sets, ids and digests, read back as what they are.

use rusqlite::Row;
use rusqlite::types::{FromSql, FromSqlError, Type};

pub(crate) fn conversion(
    column: usize,
    error: impl std::error::Error + Send + Sync + 'static,
) -> rusqlite::Error {
    rusqlite::Error::FromSqlConversionFailure(column, Type::Text, Box::new(error))
}

/// A text column parsed.
pub(crate) fn parsed<T>(row: &Row<'_>, column: usize) -> rusqlite::Result<T>
where
    T: std::str::FromStr<Err: std::error::Error + Send + Sync + 'static>,
{
    let text = row.get_ref(column)?;
    let text = text.as_str().map_err(|error: FromSqlError| conversion(column, error))?;
    text.parse().map_err(|error| conversion(column, error))
}

/// A text column that may be missing, parsed.
pub(crate) fn parsed_option<T>(row: &Row<'_>, column: usize) -> rusqlite::Result<Option<T>>
where
    T: std::str::FromStr<Err: std::error::Error + Send + Sync + 'static>,
{
    match Option::<String>::column_result(row.get_ref(column)?) {
        Ok(None) => Ok(None),
        _ => parsed(row, column).map(Some),
    }
}
