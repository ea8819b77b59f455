//! The audit chain's account of telemetry: how far it is sealed, how far it was removed, and the known gaps. Batches
//! are numbered from 1 on without a gap, so that these few numbers cover each of them.

use std::collections::BTreeMap;

use rusqlite::{Connection, params};
use serde::{Deserialize, Serialize};

use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::RecordKind;
use holdpoint_store::Change;

/// The most batches between two that are looked at one by one; at 32 tasks a batch, more than a decade of them.
const EACH_MAX: u64 = 10_000_000;

/// See the module's head.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TelemetryAccount {
    /// The last batch that a record seals.
    sealed: u64,
    /// The last one that has its own record; then removals were not on record.
    singly: u64,
    /// All batches up to here were removed, on record; `None` before removals were on record.
    pruned: Option<u64>,
    /// Runs of batches, first and last, that were found missing; in order, apart from each other.
    missed: Vec<[u64; 2]>,
}

impl TelemetryAccount {
    /// Of a chain without telemetry.
    pub(crate) const fn none() -> Self {
        Self { sealed: 0, singly: 0, pruned: None, missed: Vec::new() }
    }

    pub(crate) const fn sealed(&self) -> u64 {
        self.sealed
    }

    /// Whether batches may be removed without a record: no removal is on record, and seals have the old form.
    pub(crate) const fn is_before_removals(&self) -> bool {
        self.pruned.is_none() && self.singly > 0
    }

    pub(crate) fn seal(&mut self, batch: u64) {
        self.sealed = self.sealed.max(batch);
    }

    pub(crate) fn seal_singly(&mut self, batch: u64) {
        self.seal(batch);
        self.singly = self.singly.max(batch);
    }

    pub(crate) fn prune(&mut self, through: u64) {
        self.pruned = self.pruned.max(Some(through));
        self.missed.retain(|[_, last]| *last > through);
    }

    pub(crate) fn miss(&mut self, gaps: &[[u64; 2]]) {
        self.missed.extend_from_slice(gaps);
        self.missed.sort_unstable();
        let mut joined: Vec<[u64; 2]> = Vec::with_capacity(self.missed.len());
        for [first, last] in self.missed.drain(..) {
            match joined.last_mut() {
                Some(before) if first <= before[1].saturating_add(1) => before[1] = before[1].max(last),
                Some(_) | None => joined.push([first, last]),
            }
        }
        self.missed = joined;
    }

    /// Whether it is missing on record.
    pub(crate) fn is_missed(&self, batch: u64) -> bool {
        self.missed.iter().any(|[first, last]| (*first..=*last).contains(&batch))
    }

    /// Whether it may be removed for age. `oldest` is the oldest batch there is: before removals were on record,
    /// removed batches were older than kept ones.
    pub(crate) fn is_pruned(&self, batch: u64, oldest: Option<u64>) -> bool {
        self.pruned.map_or_else(
            || batch <= self.singly && oldest.is_some_and(|oldest| batch < oldest),
            |pruned| batch <= pruned,
        )
    }

    /// The expected batches that are not in this ordered list, as runs of them, at most `most`; the last run extends to
    /// the end of the gap. `oldest` as above.
    pub(crate) fn gaps(&self, there: &[u64], oldest: Option<u64>, most: usize) -> Vec<[u64; 2]> {
        let mut gaps: Vec<[u64; 2]> = Vec::new();
        let mut next = self.pruned.unwrap_or(0).saturating_add(1);
        let ends = there.iter().copied().filter(|batch| (next..=self.sealed).contains(batch));
        for batch in ends.chain([self.sealed.saturating_add(1)]).collect::<Vec<_>>() {
            if batch.saturating_sub(next) > EACH_MAX {
                // A gap this long means an edited number in the file.
                add_run(&mut gaps, [next, batch - 1], most);
                next = batch.saturating_add(1);
                continue;
            }
            for missing in next..batch {
                if self.is_missed(missing) || self.is_pruned(missing, oldest) {
                    continue;
                }
                add_run(&mut gaps, [missing, missing], most);
            }
            next = batch.saturating_add(1);
        }
        gaps
    }
}

/// Adds a run of missing batches. If it follows the last run, or there are `most` already, the last one extends to its end.
fn add_run(gaps: &mut Vec<[u64; 2]>, [from, to]: [u64; 2], most: usize) {
    let is_full = gaps.len() >= most;
    match gaps.last_mut() {
        Some([_, last]) if is_full || last.saturating_add(1) == from => *last = to,
        Some(_) | None => gaps.push([from, to]),
    }
}

#[derive(Deserialize)]
struct SealBody<C> {
    change: C,
}

#[derive(Deserialize)]
struct SealedBatchFields {
    batch: u64,
    digest: Digest,
}

#[derive(Deserialize)]
struct SealedBlockFields {
    batches: Vec<SealedBatchFields>,
}

/// Every batch that the chain seals, with its digest; the last seal of a number counts.
pub(crate) fn sealed_digests(connection: &Connection) -> rusqlite::Result<BTreeMap<u64, Digest>> {
    let (one, block) =
        (RecordKind::TelemetrySealed.to_string(), RecordKind::TelemetryBlockSealed.to_string());
    let mut select = connection.prepare("SELECT body FROM audit WHERE kind IN (?1, ?2) ORDER BY seq")?;
    let mut rows = select.query(params![one, block])?;
    let mut sealed = BTreeMap::new();
    while let Some(row) = rows.next()? {
        let body = row.get_ref(0)?.as_str()?;
        if let Ok(SealBody { change: SealedBlockFields { batches } }) = serde_json::from_str(body) {
            sealed.extend(batches.into_iter().map(|one| (one.batch, one.digest)));
        } else if let Ok(SealBody { change: SealedBatchFields { batch, digest } }) =
            serde_json::from_str(body)
        {
            sealed.insert(batch, digest);
        }
    }
    Ok(sealed)
}

/// How far a transaction that is on disk seals telemetry, and how far it removes it; 0 if it does not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct SealProgress {
    pub(crate) sealed: u64,
    pub(crate) pruned: u64,
}

impl SealProgress {
    pub(crate) fn by(changes: &[Change]) -> Self {
        let mut settled = Self::default();
        for change in changes {
            match change {
                Change::SealTelemetryBlock { batches, .. } => {
                    settled.sealed = batches.iter().map(|batch| batch.batch).fold(settled.sealed, u64::max);
                }
                Change::PruneTelemetry { through } => settled.pruned = settled.pruned.max(*through),
                _ => {}
            }
        }
        settled
    }
}

/// The verifier's result for one batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BatchState {
    /// There, and its content matches.
    Matches,
    /// Removed because of its age, which is on record.
    Pruned,
    /// Missing, which is on record.
    Missed,
    Bad(&'static str),
}

/// The result for an absent batch. `oldest` is the oldest present one.
pub(crate) fn absent(account: &TelemetryAccount, batch: u64, oldest: Option<u64>) -> BatchState {
    if account.is_pruned(batch, oldest) {
        BatchState::Pruned
    } else if account.is_missed(batch) {
        BatchState::Missed
    } else {
        BatchState::Bad("it is missing")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn account(sealed: u64, singly: u64) -> TelemetryAccount {
        TelemetryAccount { sealed, singly, ..TelemetryAccount::none() }
    }

    #[test]
    fn gaps_of_missing_batches_are_computed() {
        let mut account = account(10, 0);
        assert_eq!(account.gaps(&[1, 2, 3, 4, 5, 6, 7, 8, 9, 10], Some(1), 64), [[0; 2]; 0]);
        assert_eq!(account.gaps(&[3, 4, 8, 10], Some(3), 64), [[1, 2], [5, 7], [9, 9]]);
        assert_eq!(account.gaps(&[3, 4, 8, 10], Some(3), 2), [[1, 2], [5, 9]]);
        // An edited number in the file delays nothing.
        let forged = i64::MAX.unsigned_abs();
        account.sealed = forged;
        assert_eq!(account.gaps(&[1, 2, forged], Some(1), 64), [[3, forged - 1]]);
        assert_eq!(
            account.gaps(&[1, 3, forged], Some(1), 1),
            [[2, forged - 1]],
            "no more runs than asked for"
        );
        account.sealed = 10;
        assert_eq!(account.gaps(&[], None, 64), [[1, 10]]);
        let mut further = account.clone();
        further.prune(12);
        assert!(further.gaps(&[], None, 64).is_empty(), "it is removed further than sealed");
        account.prune(4);
        assert_eq!(account.gaps(&[3, 8, 10], Some(3), 64), [[5, 7], [9, 9]]);
        account.miss(&[[9, 9], [5, 6]]);
        assert_eq!(account.gaps(&[8, 10], Some(8), 64), [[7, 7]]);
        account.miss(&[[7, 7]]);
        assert_eq!(account.missed, [[5, 7], [9, 9]]);
        assert!(account.gaps(&[8, 10], Some(8), 64).is_empty());
        account.prune(8);
        assert_eq!(account.missed, [[9, 9]]);
    }

    #[test]
    fn batches_removed_before_removals_were_recorded_are_no_gap() {
        let account = account(10, 6);
        assert_eq!(account.gaps(&[5, 6, 7, 8, 9, 10], Some(5), 64), [[0; 2]; 0]);
        assert_eq!(account.gaps(&[9, 10], Some(9), 64), [[7, 8]], "those had to be on record");
        assert_eq!(account.gaps(&[], None, 64), [[1, 10]], "the newest are never removed");
    }
}
