//! Counts live tasks of telemetry by bucket: reads the sealed blocks and compares them with the chain.

use std::collections::BTreeMap;

use serde::Deserialize;

use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_governance::stats::{SHOWN_LEVEL, wilson};
use holdpoint_protocol::health::{HealthCoverage, HealthPoint, HealthSeries};
use holdpoint_store::{AuditFilter, RecordViews, StoreError, StoredBatch, TelemetryReader};

use super::clock::{RecordSpan, on_clock};
use crate::store_metrics::record_bodies::{SealedBatchBody, SealedBlockBody, change};
use holdpoint_record::live_task_record::{LIVE, UNWATCHED};

/// The most batches that one query reads; a pass over the span that has begun still completes.
pub const TASKS_READ: u64 = 8_000;

/// Blocks of one pass over the span; a block is at most 64 batches.
const PASS: usize = 32;

/// The longest time from a task to the seal of its block, ms: records after the span are read for that long.
const SEALED_WITHIN_MS: i64 = 15 * 60_000;

/// The parts of a stored task that are read.
#[derive(Deserialize)]
struct TaskOutcomeBody {
    success: bool,
    violation: bool,
    #[serde(default)]
    near: bool,
    time_secs: f64,
    peak_force_n: f64,
    #[serde(default)]
    invalid: bool,
    #[serde(default)]
    cut_short: bool,
}

/// The tally of one version in one bucket.
#[derive(Default)]
struct TaskTally {
    succeeded: u64,
    violated: u64,
    near: u64,
    time_s: Vec<f64>,
    force_n: Vec<f64>,
    at_ms: Option<[u64; 2]>,
}

/// By family, bucket and version.
type TaskTallies = BTreeMap<(Family, u32, CapabilityId), TaskTally>;

/// Every point of a series.
pub(super) fn points(
    views: &dyn RecordViews,
    telemetry: &dyn TelemetryReader,
    (span, series): (&RecordSpan, &HealthSeries),
    coverage: &mut HealthCoverage,
    tasks_read: u64,
) -> Result<Vec<HealthPoint>, StoreError> {
    let after =
        RecordSpan::first_at(views, span.clock, span.head, span.until_ms.saturating_add(SEALED_WITHIN_MS))?;
    // A later record may seal a block with earlier tasks, so the next one counts as well.
    let within = after.saturating_add(1).min(span.head + 1);
    let mut blocks = views.numbers_of(RecordKind::TelemetryBlockSealed, span.first, within)?;
    if let Some(next) = views.numbers_of(RecordKind::TelemetryBlockSealed, within, span.head + 1)?.first() {
        blocks.push(*next);
    }
    blocks.extend(views.numbers_of(RecordKind::TelemetrySealed, span.first, within)?);
    blocks.sort_unstable();
    let gone = removed(views, telemetry, &blocks, coverage)?;
    blocks.drain(..gone);
    coverage.blocks = blocks.len() as u64;
    let mut tallies = TaskTallies::new();
    let mut read = 0;
    for pass in passes(blocks.len()) {
        // A pass always completes; a partial one would cover only one end of the span.
        if read >= tasks_read {
            break;
        }
        for block in pass.filter_map(|at| blocks.get(at)) {
            coverage.blocks_read += 1;
            let filter = AuditFilter { from_seq: *block, limit: 1, ..AuditFilter::default() };
            for record in views.audit(&filter)? {
                read += take_in(telemetry, &record, (span, series), coverage, &mut tallies)?;
            }
        }
    }
    coverage.tasks = tallies.values().map(|tally| tally.time_s.len() as u64).sum();
    Ok(tallies.into_iter().filter_map(point).collect())
}

/// The number of blocks at the front that were removed for age: the oldest remaining batch is newer. Batches are numbered in
/// order, so bisection finds it at no cost per removed block.
fn removed(
    views: &dyn RecordViews,
    telemetry: &dyn TelemetryReader,
    blocks: &[u64],
    coverage: &mut HealthCoverage,
) -> Result<usize, StoreError> {
    let oldest = telemetry.oldest()?.unwrap_or(u64::MAX);
    let ends = |block: &u64| -> Result<[u64; 2], StoreError> {
        let filter = AuditFilter { from_seq: *block, limit: 1, ..AuditFilter::default() };
        let (batches, _) = views.audit(&filter)?.first().map(sealed).unwrap_or_default();
        Ok([batches.first().map_or(0, |one| one.batch), batches.last().map_or(0, |one| one.batch)])
    };
    let (mut low, mut high) = (0, blocks.len());
    while low < high {
        let middle = low + (high - low) / 2;
        let last = blocks.get(middle).map(ends).transpose()?.map_or(u64::MAX, |[_, last]| last);
        if last < oldest { low = middle + 1 } else { high = middle }
    }
    let gone = blocks.get(..low).unwrap_or_default();
    if let (Some(first), Some(last)) = (gone.first(), gone.last()) {
        let ([first, _], [_, last]) = (ends(first)?, ends(last)?);
        coverage.removed = coverage.removed.saturating_add(last.saturating_add(1).saturating_sub(first));
    }
    Ok(low)
}

/// The numbers below `count` in passes of about [`PASS`], each spread evenly over all, and each halfway between the earlier
/// passes.
fn passes(count: usize) -> impl Iterator<Item = std::iter::StepBy<std::ops::Range<usize>>> {
    let stride = count.div_ceil(PASS).next_power_of_two();
    let bits = stride.trailing_zeros();
    (0..stride).map(move |pass: usize| {
        let offset = if bits == 0 { 0 } else { pass.reverse_bits() >> (usize::BITS - bits) };
        (offset..count).step_by(stride)
    })
}

/// Reads one block. Returns the number of its batches that were read.
fn take_in(
    telemetry: &dyn TelemetryReader,
    record: &AuditRecord,
    (span, series): (&RecordSpan, &HealthSeries),
    coverage: &mut HealthCoverage,
    tallies: &mut TaskTallies,
) -> Result<u64, StoreError> {
    let (batches, found) = sealed(record);
    let (Some(first), Some(last)) = (batches.first(), batches.last()) else { return Ok(0) };
    if found {
        coverage.late += batches.len() as u64;
        return Ok(0);
    }
    let digests: BTreeMap<u64, Digest> = batches.iter().map(|one| (one.batch, one.digest)).collect();
    let wall_ms = (record.wall_ms > 0).then_some(record.wall_ms);
    let mut there = 0;
    telemetry.each_of_streams(
        [LIVE, UNWATCHED],
        (first.batch, last.batch),
        &mut |StoredBatch { number, digest, batch }| {
            let Some(expected) = digests.get(&number) else { return };
            there += 1;
            let task = batch.filter(|_| digest == *expected).and_then(|batch| {
                let worked: TaskOutcomeBody = serde_json::from_slice(&batch.body).ok()?;
                Some((batch.version, batch.to_ms, worked))
            });
            let Some((version, to_ms, worked)) = task else {
                coverage.damaged += 1;
                return;
            };
            // Both clocks advanced together from the task to its seal.
            let lag = i64::try_from(record.at_ms.saturating_sub(to_ms)).unwrap_or(0);
            let Some(place) = on_clock(span.clock, to_ms, wall_ms.map(|wall_ms| wall_ms - lag)) else {
                coverage.without_wall += 1;
                return;
            };
            let Some(bucket) = series.bucket_of(place) else { return };
            if worked.invalid || worked.cut_short {
                coverage.not_judged += 1;
                return;
            }
            tallies.entry((version.family.clone(), bucket, version)).or_default().add(&worked, to_ms);
        },
    )?;
    if there == 0 {
        // Of other streams, or removed.
        let mut any = false;
        telemetry.each_of(&[first.batch, last.batch], &mut |_| any = true)?;
        coverage.removed += if any { 0 } else { batches.len() as u64 };
    }
    Ok(there)
}

/// The live tasks of each family that no record seals yet.
pub(super) fn unsealed(
    views: &dyn RecordViews,
    telemetry: &dyn TelemetryReader,
) -> Result<BTreeMap<Family, u64>, StoreError> {
    let mut last = 0;
    for kind in RecordKind::SEALS {
        let newest = views.audit(&AuditFilter::newest(kind))?;
        let batches = newest.first().map(sealed).unwrap_or_default().0;
        last = last.max(batches.last().map_or(0, |one| one.batch));
    }
    let mut tasks: BTreeMap<Family, u64> = BTreeMap::new();
    telemetry.each_of_streams(
        [LIVE, UNWATCHED],
        (last.saturating_add(1), u64::MAX),
        &mut |StoredBatch { batch, .. }| {
            if let Some(batch) = batch {
                *tasks.entry(batch.version.family).or_default() += 1;
            }
        },
    )?;
    Ok(tasks)
}

fn sealed(record: &AuditRecord) -> (Vec<SealedBatchBody>, bool) {
    if record.kind == RecordKind::TelemetrySealed {
        return (change::<SealedBatchBody>(record).into_iter().collect(), false);
    }
    change::<SealedBlockBody>(record)
        .map_or_else(|| (Vec::new(), false), |block| (block.batches, block.found))
}

impl TaskTally {
    fn add(&mut self, worked: &TaskOutcomeBody, at_ms: u64) {
        self.succeeded += u64::from(worked.success);
        self.violated += u64::from(worked.violation);
        self.near += u64::from(worked.violation || worked.near);
        self.time_s.push(worked.time_secs);
        self.force_n.push(worked.peak_force_n);
        let [first, last] = self.at_ms.unwrap_or([at_ms, at_ms]);
        self.at_ms = Some([first.min(at_ms), last.max(at_ms)]);
    }
}

fn point(((_, bucket, version), mut tally): ((Family, u32, CapabilityId), TaskTally)) -> Option<HealthPoint> {
    let tasks = tally.time_s.len() as u64;
    let interval = wilson(tally.succeeded, tasks, SHOWN_LEVEL).ok()?;
    Some(HealthPoint {
        version,
        bucket,
        tasks,
        succeeded: tally.succeeded,
        success: [interval.lower, interval.upper],
        violated: tally.violated,
        near: tally.near,
        time_s: middle_and_tail(&mut tally.time_s),
        force_n: middle_and_tail(&mut tally.force_n),
        at_ms: tally.at_ms.unwrap_or_default(),
    })
}

/// Median and 95th percentile, each a measured value: the smallest that this share does not exceed.
fn middle_and_tail(values: &mut [f64]) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    [50, 95].map(|percent| {
        let rank = (values.len() * percent).div_ceil(100).max(1);
        values.get(rank - 1).copied().unwrap_or(f64::NAN)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_take_each_block_once_and_each_of_them_is_spread_over_all() {
        for count in [0, 1, 2, 63, 64, 65, 1_000, 9_999] {
            let mut all: Vec<usize> = passes(count).flatten().collect();
            for pass in passes(count) {
                let pass: Vec<usize> = pass.collect();
                assert!(pass.len() <= PASS, "{count}");
                let ends = [pass.first(), pass.last()].map(|end| end.copied().unwrap_or(0));
                assert!(count < 64 || (ends[0] < count / 4 && ends[1] > count / 2), "{count}: {ends:?}");
            }
            all.sort_unstable();
            assert_eq!(all, (0..count).collect::<Vec<_>>());
        }
    }

    #[test]
    fn median_and_tail_are_measured_values() {
        let mut values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert_eq!(middle_and_tail(&mut values), [50.0, 95.0]);
        assert_eq!(middle_and_tail(&mut [3.0]), [3.0, 3.0]);
        assert_eq!(middle_and_tail(&mut [2.0, 1.0]), [1.0, 2.0]);
    }
}
