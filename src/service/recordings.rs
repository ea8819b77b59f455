//! The recordings in a store's audit chain.

use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::record::{AuditRecord, RecordKind, UpgradeEnd};
use holdpoint_protocol::sink::ClosedRecording;
use holdpoint_recordings::audit_record::{FileRecord, KIND, REMOVED_KIND, RecordError, RecordedFiles};
use holdpoint_recordings::recording_folder::RecordingName;
use holdpoint_store::{AuditFilter, RecordViews, StoreError};
use holdpoint_text::{ErrorDetails, Hint};
use holdpoint_wording::program::engine::{RecordingContradiction, recording_contradiction};
use serde::Deserialize;
use std::borrow::Cow;

/// Why the records cannot be listed.
#[derive(Debug, thiserror::Error)]
pub enum RecordListError {
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Form(#[from] RecordError),
}

impl Hint for RecordListError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Store(error) => error.details(),
            Self::Form(error) => error.details(),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Store(error) => error.hint(),
            Self::Form(error) => error.hint(),
        }
    }
}

/// Reads the record of every recording.
///
/// # Errors
/// [`RecordListError`].
pub fn on_record(views: &dyn RecordViews) -> Result<RecordedFiles, RecordListError> {
    let of = |kind| views.whole_audit(&AuditFilter { kind: Some(kind), ..AuditFilter::default() });
    let mut records = of(KIND)?;
    records.extend(of(REMOVED_KIND)?);
    records.sort_by_key(|record| record.seq);
    let mut found = RecordedFiles::default();
    for record in records {
        found.take(&record)?;
    }
    Ok(found)
}

/// Why a recording contradicts the store's record, if it does. Other programs can write to the folder, so a file counts only
/// with the name of a registered candidate, and for an upgrade that ended as the file states and has no recording yet.
///
/// # Errors
/// [`RecordListError`].
pub fn contradiction(
    views: &dyn RecordViews,
    closed: &ClosedRecording,
) -> Result<Option<String>, RecordListError> {
    let ClosedRecording { version, outcome, file, .. } = closed;
    let found = |of: RecordingContradiction<'_>| Some(recording_contradiction(of, version));
    let Some(name) = RecordingName::parse(file).filter(|name| name.version == *version) else {
        return Ok(found(RecordingContradiction::OtherName));
    };
    let Some(registered) = views.version(version)? else {
        return Ok(found(RecordingContradiction::Unregistered));
    };
    if !registered.candidate_digest.to_string().starts_with(&name.digest_start) {
        return Ok(found(RecordingContradiction::OtherDigest));
    }
    let closings = views.whole_audit(&AuditFilter {
        kind: Some(RecordKind::AuditClosed),
        subject: Some(version.to_string()),
        ..AuditFilter::default()
    })?;
    let is_end = |record: &&AuditRecord| {
        serde_json::from_str::<UpgradeEndBody>(&record.body).is_ok_and(|closing| closing.outcome == *outcome)
    };
    let ends = closings.iter().filter(is_end).count();
    let of_these = |(file, record): &(String, FileRecord)| {
        RecordingName::parse(file).is_some_and(|name| name.version == *version)
            && record.recorded.as_ref().is_some_and(|recording| recording.outcome == *outcome)
    };
    let recordings = on_record(views)?.0.into_iter().filter(of_these).count();
    if recordings < ends {
        return Ok(None);
    }
    let outcome = &outcome.to_string();
    Ok(found(RecordingContradiction::Surplus { ends, outcome, recordings }))
}

/// The parts read of the record of an upgrade's end.
#[derive(Deserialize)]
struct UpgradeEndBody {
    outcome: Lenient<UpgradeEnd>,
}
