//! Rows by entity, and the chunks made of them.
//!
//! Ids are counted, never random: the same rows give the same bytes.

use std::collections::BTreeMap;

use rerun::external::re_log_types::external::re_tuid::Tuid;
use rerun::log::{Chunk, ChunkId, RowId};
use rerun::time::{TimeCell, TimePoint};
use rerun::{AsComponents, EntityPath};

use super::limits::BLOCK_ROWS;
use holdpoint_protocol::clock::tick_of;

/// The timeline of the cell's ticks.
pub const TICK: &str = "tick";

/// The time of a row.
#[derive(Clone, Debug)]
pub struct RowTime(TimePoint);

impl RowTime {
    /// Virtual time in ms, when the recording began, the live cell's sequence, and wall time in ns.
    #[must_use]
    pub fn new(at_ms: u64, since_ms: u64, sequence: u64, wall_nanos: Option<i64>) -> Self {
        let signed = |value: u64| i64::try_from(value).unwrap_or(i64::MAX);
        let mut point = TimePoint::default();
        point.insert_cell(TICK, TimeCell::from_sequence(signed(tick_of(at_ms))));
        let nanos = signed(at_ms).saturating_sub(signed(since_ms)).saturating_mul(1_000_000);
        point.insert_cell("sim_time", TimeCell::from_duration_nanos(nanos));
        point.insert_cell("episode", TimeCell::from_sequence(signed(sequence)));
        if let Some(nanos) = wall_nanos {
            point.insert_cell("wall", TimeCell::from_timestamp_nanos_since_epoch(nanos));
        }
        Self(point)
    }
}

/// Counts ids of rows and chunks separately, so that the number of writes changes no row's id. Ids of a later segment
/// follow those of an earlier one.
#[derive(Clone, Debug)]
pub struct RowIds {
    rows: Tuid,
    chunks: Tuid,
}

impl RowIds {
    /// The ids of a segment, counting from 1.
    #[must_use]
    pub fn of_segment(segment: u32) -> Self {
        let base = u64::from(segment) << 40;
        Self { rows: Tuid::from_nanos_and_inc(base, 0), chunks: Tuid::from_nanos_and_inc(base | 1 << 39, 0) }
    }

    pub fn row(&mut self) -> RowId {
        RowId::from_tuid(self.plain())
    }

    pub fn chunk(&mut self) -> ChunkId {
        self.chunks = self.chunks.next();
        ChunkId::from_tuid(self.chunks)
    }

    /// An id in the form of a row's id, for other uses.
    pub fn plain(&mut self) -> Tuid {
        self.rows = self.rows.next();
        self.rows
    }
}

/// A pending row: its id, its time (none for static data), its columns.
type PendingRow = (RowId, TimePoint, Vec<rerun::SerializedComponentBatch>);

/// Pending rows.
#[derive(Debug)]
pub struct PendingRows {
    ids: RowIds,
    waiting: BTreeMap<(String, bool), Vec<PendingRow>>,
    longest: usize,
}

impl PendingRows {
    #[must_use]
    pub const fn new(ids: RowIds) -> Self {
        Self { ids, waiting: BTreeMap::new(), longest: 0 }
    }

    /// A row that is valid from a moment on.
    pub fn at(&mut self, path: &str, time: &RowTime, what: &dyn AsComponents) {
        self.push((path.to_owned(), false), time.0.clone(), what);
    }

    /// A static row.
    pub fn always(&mut self, path: &str, what: &dyn AsComponents) {
        self.push((path.to_owned(), true), TimePoint::STATIC, what);
    }

    fn push(&mut self, key: (String, bool), point: TimePoint, what: &dyn AsComponents) {
        let row = self.ids.row();
        let rows = self.waiting.entry(key).or_default();
        rows.push((row, point, what.as_serialized_batches()));
        self.longest = self.longest.max(rows.len());
    }

    /// Whether an entity has enough rows for a chunk.
    #[must_use]
    pub const fn are_many(&self) -> bool {
        self.longest >= BLOCK_ROWS
    }

    /// Takes all rows as chunks. Rows that make no chunk (a defect of this program) are left out and counted.
    pub fn take(&mut self) -> (Vec<Chunk>, u64) {
        self.longest = 0;
        let mut left_out = 0;
        let mut chunks = Vec::with_capacity(self.waiting.len());
        for ((path, _), rows) in std::mem::take(&mut self.waiting) {
            let count = rows.len() as u64;
            let mut builder = Chunk::builder_with_id(self.ids.chunk(), EntityPath::parse_forgiving(&path));
            for (row, point, batches) in rows {
                builder = builder.with_serialized_batches(row, point, batches);
            }
            match builder.build() {
                Ok(chunk) => chunks.push(chunk),
                Err(_) => left_out += count,
            }
        }
        (chunks, left_out)
    }
}
