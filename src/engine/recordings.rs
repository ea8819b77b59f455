//! What a store's audit chain says of recordings.

use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_recordings::record::{KIND, OnRecord, REMOVED_KIND, RecordError};
use holdpoint_registry::{AuditFilter, PAGE_ROWS_MAX, StoreError, Views};
use holdpoint_text::Hint;
use std::borrow::Cow;

/// Why the records cannot be told.
#[derive(Debug, thiserror::Error)]
pub enum OnRecordError {
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A record has another form.
    #[error(transparent)]
    Form(#[from] RecordError),
}

impl Hint for OnRecordError {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Store(error) => error.hint(),
            Self::Form(error) => error.hint(),
        }
    }
}

/// Reads what is on record of every recording.
///
/// # Errors
/// [`OnRecordError`].
pub fn on_record(views: &Views) -> Result<OnRecord, OnRecordError> {
    let mut records = of_kind(views, KIND)?;
    records.extend(of_kind(views, REMOVED_KIND)?);
    records.sort_by_key(|record| record.seq);
    let mut found = OnRecord::default();
    for record in records {
        found.take(&record)?;
    }
    Ok(found)
}

/// Every record of a kind, oldest first.
fn of_kind(views: &Views, kind: RecordKind) -> Result<Vec<AuditRecord>, StoreError> {
    let mut all = Vec::new();
    let mut from_seq = 0;
    loop {
        let page = views.audit(&AuditFilter {
            from_seq,
            kind: Some(kind),
            limit: PAGE_ROWS_MAX,
            ..AuditFilter::default()
        })?;
        let full = page.len() >= PAGE_ROWS_MAX;
        from_seq = page.last().map_or(from_seq, |record| record.seq + 1);
        all.extend(page);
        if !full {
            return Ok(all);
        }
    }
}
