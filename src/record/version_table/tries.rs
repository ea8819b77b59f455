//! The counted tries of each family, read from their records; no table repeats them.

use std::collections::BTreeMap;

use holdpoint_governance::approval::Requester;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::tries::{CountedTry, TryAuthor, TryLedger};
use holdpoint_store::{AuditFilter, RecordViews, StoreError};

use super::{VersionEntry, VersionTable, VersionTableError};

/// Reads the tries and their reviews, in the order of their records.
pub(super) fn recorded_tries(views: &dyn RecordViews) -> Result<BTreeMap<Family, TryLedger>, StoreError> {
    let of = |kind| views.whole_audit(&AuditFilter { kind: Some(kind), ..AuditFilter::default() });
    let mut records = of(RecordKind::TryCounted)?;
    records.extend(of(RecordKind::TriesReviewed)?);
    records.sort_by_key(|record| record.seq);
    let mut ledgers: BTreeMap<Family, TryLedger> = BTreeMap::new();
    for record in records {
        let Ok(version) = record.subject.parse::<CapabilityId>() else { continue };
        let ledger = ledgers.entry(version.family.clone()).or_default();
        if record.kind == RecordKind::TriesReviewed {
            ledger.review();
        } else if let Ok(counted) = serde_json::from_str::<CountedTry>(&record.body) {
            ledger.note(version, counted);
        }
    }
    Ok(ledgers)
}

impl VersionTable {
    /// The tries of a family; absent before the first.
    #[must_use]
    pub fn tries(&self, family: &Family) -> Option<&TryLedger> {
        self.tries.get(family)
    }

    /// The author that the tries of a version count for: the one who signed it, else the person who registered it.
    ///
    /// # Errors
    /// If there is no such version.
    pub fn try_author(&self, id: &CapabilityId) -> Result<TryAuthor, VersionTableError> {
        let (_, _, VersionEntry { capability, origin, .. }) = self.version(id)?;
        Ok(match (&origin.author_key, &origin.requester) {
            (Some(key), _) => TryAuthor { name: capability.submission.author.clone(), key: key.clone() },
            (None, Requester::Person { name, key }) if !key.is_empty() => {
                TryAuthor { name: name.clone(), key: key.clone() }
            }
            (
                None,
                Requester::Person { .. } | Requester::Script | Requester::Program | Requester::Unknown,
            ) => TryAuthor::default(),
        })
    }

    /// Takes in a recorded try.
    pub fn note_try(&mut self, id: &CapabilityId, counted: CountedTry) {
        self.tries.entry(id.family.clone()).or_default().note(id.clone(), counted);
    }

    /// Takes in a recorded review of the tries of a family.
    pub fn note_review(&mut self, family: &Family) {
        self.tries.entry(family.clone()).or_default().review();
    }
}
