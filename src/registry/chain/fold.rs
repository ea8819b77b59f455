//! The fold of the audit chain: the registry that its records produce.
//!
//! Checks the links while it reads. [`compare`](crate::chain::compare) compares the tables with it.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use rusqlite::{Connection, Row};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use crate::chain::audit::{self, head};
use crate::chain::chain_signature;
use crate::chain::row_images::{ChainedTable, RowName};
use crate::chain::structure::IndexSums;
use crate::chain::telemetry_seals::TelemetryAccount;
use crate::terms::own_records::is_own;
use holdpoint_audit::chain::Head;
use holdpoint_audit::merkle::{self, Frontier};
use holdpoint_audit::profile_history::ProfileHistory;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::record::{RecordKind, RecordRef};

/// The key of the one row that says where the chain ends.
pub(crate) const HEAD_ROW: i64 = 1;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum ChainFault {
    /// A record of the chain.
    Record { seq: u64, problem: String },
    /// A row that does not match the chain.
    Row { table: &'static str, key: String, problem: String },
}

impl std::fmt::Display for ChainFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Record { seq, problem } => write!(f, "audit record {seq} is bad: {problem}"),
            Self::Row { table, key, problem } => {
                write!(f, "the {table} {key:?} does not match the audit chain: {problem}")
            }
        }
    }
}

/// A failure of a fold: a fault found, or a database that cannot be read.
#[derive(Debug)]
pub(crate) enum FoldError {
    Fault(ChainFault),
    Read { seq: u64, source: rusqlite::Error },
}

impl From<rusqlite::Error> for FoldError {
    fn from(source: rusqlite::Error) -> Self {
        Self::Read { seq: 0, source }
    }
}

/// A batch of telemetry the chain vouches for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SealedBatch {
    pub(crate) seq: u64,
    pub(crate) batch: u64,
    pub(crate) digest: Digest,
}

/// The last record's state of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ChainedRow {
    pub(crate) digest: Digest,
    /// That record.
    pub(crate) seq: u64,
}

/// The chain's record numbers about the cell's stop, 0 for none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CellStop {
    /// The last one that let the cell run again.
    pub(crate) released: u64,
    /// The first stop since then.
    pub(crate) stopped: u64,
    /// The start of a session in the cell, if no record ends it.
    #[serde(default)]
    pub(crate) began: u64,
}

/// The content of the chain.
#[derive(Clone, Debug)]
pub(crate) struct Fold {
    pub(crate) end: Head,
    /// Records up to here were not read: a snapshot replaces them.
    pub(crate) since: Head,
    pub(crate) rows: BTreeMap<RowName, ChainedRow>,
    pub(crate) states: BTreeMap<String, (State, u64)>,
    /// By the record that set it: a version and its row version from then on. Of the records that were read.
    sets: BTreeMap<u64, (String, u64)>,
    /// Versions in the order of their registration.
    pub(crate) order: Vec<String>,
    /// Of the records that were read.
    hashes: Vec<Digest>,
    /// Of the records that were read; `None` if the caller does not need them.
    pub(crate) indexes: Option<IndexSums>,
    /// The kind of the last record that was read, with its meaning for the fold.
    last_kind: (String, Option<RecordKind>),
    pub(crate) cell: CellStop,
    /// The tree over all records, those before `since` included; it follows once records were read.
    pub(crate) tree: Frontier,
    /// Witness folders, which get every checkpoint.
    pub(crate) witnesses: BTreeSet<String>,
    pub(crate) profiles: ProfileHistory,
    /// Sizes of the tree whose roots are wanted, and those roots.
    noted: BTreeSet<u64>,
    roots: BTreeMap<u64, Digest>,
    /// First and last of the unsigned records that a rebuild took, among the records that were read.
    pub(crate) taken_unsigned: Vec<(u64, u64)>,
    /// Of the records that were read.
    pub(crate) batches: Vec<SealedBatch>,
    pub(crate) telemetry: TelemetryAccount,
}

/// Records between two progress reports.
const REPORT_EVERY: u64 = 1024;

/// Gets the number of records read, every few thousand.
pub(crate) type ReadProgress<'a> = &'a mut dyn FnMut(u64);

/// The parts of a store record that the fold reads; of most kinds only which rows it set.
#[derive(Deserialize)]
struct RecordBody<'a, C = IgnoredAny> {
    change: C,
    #[serde(borrow)]
    rows: Vec<RowSet<'a>>,
}

/// The state of a row after a record: table, key, digest.
#[derive(Deserialize)]
struct RowSet<'a>(#[serde(borrow)] Cow<'a, str>, #[serde(borrow)] Cow<'a, str>, Digest);

#[derive(Deserialize)]
struct StateSetFields {
    version: String,
    expected_row_version: u64,
    from: State,
    to: State,
}

#[derive(Deserialize)]
struct RegisteredRow {
    id: String,
}

#[derive(Deserialize)]
struct WitnessSet {
    folder: String,
    present: bool,
}

#[derive(Deserialize)]
struct TelemetrySealed {
    batch: u64,
    digest: Digest,
}

#[derive(Deserialize)]
struct TelemetryBlock {
    batches: Vec<TelemetrySealed>,
}

#[derive(Deserialize)]
struct TelemetryPruned {
    through: u64,
}

#[derive(Deserialize)]
struct TelemetryMissed {
    gaps: Vec<[u64; 2]>,
}

#[derive(Deserialize)]
struct StoreRebuilt {
    from_seq: u64,
    #[serde(default)]
    unsigned: u64,
}

impl Fold {
    /// The fold of no records.
    pub(crate) fn empty() -> Self {
        Self {
            end: Head::START,
            since: Head::START,
            rows: BTreeMap::new(),
            states: BTreeMap::new(),
            sets: BTreeMap::new(),
            order: Vec::new(),
            hashes: Vec::new(),
            tree: Frontier::empty(),
            witnesses: BTreeSet::new(),
            profiles: ProfileHistory::default(),
            noted: BTreeSet::new(),
            roots: BTreeMap::new(),
            indexes: None,
            last_kind: (String::new(), None),
            cell: CellStop::default(),
            taken_unsigned: Vec::new(),
            batches: Vec::new(),
            telemetry: TelemetryAccount::none(),
        }
    }

    /// Reads the whole chain.
    pub(crate) fn read(connection: &Connection) -> Result<Self, FoldError> {
        let mut fold = Self::empty();
        fold.go_on(connection)?;
        Ok(fold)
    }

    /// As [`Self::read`], with the roots of the tree at these sizes, and with what the indexes of the chain must hold.
    pub(crate) fn read_noting(connection: &Connection, sizes: BTreeSet<u64>) -> Result<Self, FoldError> {
        let mut fold = Self { noted: sizes, indexes: Some(IndexSums::default()), ..Self::empty() };
        fold.go_on(connection)?;
        Ok(fold)
    }

    /// Reads the later records, up to the end in the store's `audit_head`.
    pub(crate) fn go_on(&mut self, connection: &Connection) -> Result<(), FoldError> {
        self.read_records(connection, &mut |_| ())?;
        self.check_end(connection)
    }

    /// Reads all later records, whatever the stored end is.
    pub(crate) fn read_records(
        &mut self,
        connection: &Connection,
        watch: ReadProgress<'_>,
    ) -> Result<(), FoldError> {
        let first = self.end.seq + 1;
        let unreadable = |source| FoldError::Read { seq: first, source };
        let sql = format!("SELECT {} FROM audit WHERE seq >= ?1 ORDER BY seq", audit::COLUMNS);
        let mut select = connection.prepare_cached(&sql).map_err(unreadable)?;
        let mut rows = select.query([first]).map_err(unreadable)?;
        let mut read = || -> Result<(), FoldError> {
            loop {
                let seq = self.end.seq + 1;
                let unreadable = |source| FoldError::Read { seq, source };
                let Some(row) = rows.next().map_err(unreadable)? else { break };
                self.push(&borrowed(row).map_err(unreadable)?).map_err(FoldError::Fault)?;
                if self.end.seq.is_multiple_of(REPORT_EVERY) {
                    watch(self.end.seq);
                }
            }
            watch(self.end.seq);
            Ok(())
        };
        let ended = read();
        self.grow_tree();
        ended
    }

    /// Adds the records that were read to the tree.
    fn grow_tree(&mut self) {
        let known = usize::try_from(self.tree.size() - self.since.seq).unwrap_or(usize::MAX);
        for hash in self.hashes.iter().skip(known) {
            self.tree.push(hash);
            if self.noted.contains(&self.tree.size()) {
                self.roots.insert(self.tree.size(), self.tree.root());
            }
        }
    }

    /// The root of the tree of the first `size` records, `None` if there are fewer, or if they were not all read.
    pub(crate) fn root(&self, size: u64) -> Option<Digest> {
        if size == self.tree.size() {
            return Some(self.tree.root());
        }
        self.roots.get(&size).copied().or_else(|| {
            let read = self.hashes.get(..usize::try_from(size).ok()?)?;
            (self.since.seq == 0).then(|| merkle::root(read))
        })
    }

    /// Notes the roots of the tree at more sizes. Of a fold of the whole chain.
    pub(crate) fn note_roots(&mut self, mut sizes: BTreeSet<u64>) {
        sizes.retain(|size| !self.roots.contains_key(size) && *size < self.tree.size());
        if self.since.seq > 0 || sizes.is_empty() {
            return;
        }
        let mut tree = Frontier::empty();
        for hash in &self.hashes {
            tree.push(hash);
            if sizes.contains(&tree.size()) {
                self.roots.insert(tree.size(), tree.root());
            }
        }
    }

    /// The chain ends where the store says.
    pub(crate) fn check_end(&self, connection: &Connection) -> Result<(), FoldError> {
        let row = |problem: String| {
            FoldError::Fault(ChainFault::Row { table: "audit_head", key: HEAD_ROW.to_string(), problem })
        };
        let end = match head(connection) {
            Err(rusqlite::Error::QueryReturnedNoRows) => return Err(row("it is missing".to_owned())),
            end => end?,
        };
        if (end.seq, end.hash) == (self.end.seq, self.end.hash) {
            return Ok(());
        }
        let problem = format!("the chain ends at {}, its end was recorded at {}", self.end.seq, end.seq);
        // If the found end is the signed one, no record is missing. The signature is checked in any case.
        let signed = chain_signature::read(connection).ok().flatten();
        let is_signed = signed.is_some_and(|end| (end.seq, end.head) == (self.end.seq, self.end.hash));
        if end.seq > self.end.seq && !is_signed {
            let fault = ChainFault::Record { seq: self.end.seq + 1, problem };
            return Err(FoldError::Fault(fault));
        }
        Err(row(problem))
    }

    /// The hash of a record, `None` if there is none or it was not read.
    pub(crate) fn hash(&self, seq: u64) -> Option<Digest> {
        if seq == self.since.seq && seq > 0 {
            return Some(self.since.hash);
        }
        let index = seq.checked_sub(self.since.seq)?.checked_sub(1)?;
        usize::try_from(index).ok().and_then(|index| self.hashes.get(index)).copied()
    }

    /// The last record's state of a row.
    pub(crate) fn row(&self, table: ChainedTable, key: &str) -> Option<ChainedRow> {
        self.rows.get(&(table, key.to_owned())).copied()
    }

    /// Versions whose state these records set, and the row version from then on.
    pub(crate) fn states_set(&self, first: u64, last: u64) -> impl Iterator<Item = (String, u64)> {
        self.sets.range(first..=last.max(first)).map(|(_, set)| set.clone())
    }

    pub(crate) fn push(&mut self, record: &RecordRef<'_>) -> Result<(), ChainFault> {
        let seq = self.end.seq + 1;
        let end = self.end.with_record(record).map_err(|problem| ChainFault::Record { seq, problem })?;
        // Most records have the kind of the one before.
        if self.last_kind.0 != record.kind {
            self.last_kind = (record.kind.to_owned(), record.kind.parse().ok());
        }
        match self.last_kind.1 {
            Some(kind) if is_own(kind) => self.fold_body(record.seq, kind, record.body)?,
            Some(RecordKind::CellStopped) if self.cell.stopped == 0 => self.cell.stopped = record.seq,
            Some(RecordKind::CellReleased) => {
                self.cell = CellStop { released: record.seq, stopped: 0, ..self.cell };
            }
            Some(RecordKind::EngineBegan) => self.cell.began = record.seq,
            Some(RecordKind::EngineEnded) => self.cell.began = 0,
            Some(_) | None => {}
        }
        self.end = end;
        self.hashes.push(record.hash);
        if let Some(indexes) = &mut self.indexes {
            indexes.add(record);
        }
        Ok(())
    }

    fn fold_body(&mut self, seq: u64, kind: RecordKind, text: &str) -> Result<(), ChainFault> {
        let fault = |problem: String| ChainFault::Record { seq, problem };
        let rows = match kind {
            RecordKind::VersionRegistered => {
                let RecordBody::<RegisteredRow> { change: new, rows } = body(seq, text)?;
                if self.states.insert(new.id.clone(), (State::Registered, 1)).is_some() {
                    return Err(fault(format!("{} was registered before", new.id)));
                }
                self.order.push(new.id);
                rows
            }
            RecordKind::StateSet => {
                let RecordBody::<StateSetFields> { change: set, rows } = body(seq, text)?;
                let found = self.states.get(&set.version).copied();
                if found != Some((set.from, set.expected_row_version)) {
                    return Err(fault(format!("{} was not {} then", set.version, set.from)));
                }
                let row_version = set.expected_row_version + 1;
                self.sets.insert(seq, (set.version.clone(), row_version));
                self.states.insert(set.version, (set.to, row_version));
                rows
            }
            RecordKind::WitnessSet => {
                let RecordBody::<WitnessSet> { change: set, rows } = body(seq, text)?;
                if set.present {
                    self.witnesses.insert(set.folder);
                } else {
                    self.witnesses.remove(&set.folder);
                }
                rows
            }
            RecordKind::ProfileAllowed => {
                let RecordBody { change, rows } = body(seq, text)?;
                self.profiles.allow_on_record(seq, change);
                rows
            }
            RecordKind::ContextSet => {
                let RecordBody { change, rows } = body(seq, text)?;
                // An unauthorized profile is in force, but authorized for no session; a verifier reports it.
                drop(self.profiles.take(seq, change));
                rows
            }
            RecordKind::TelemetrySealed => {
                let RecordBody::<TelemetrySealed> { change: sealed, rows } = body(seq, text)?;
                self.batches.push(SealedBatch { seq, batch: sealed.batch, digest: sealed.digest });
                self.telemetry.seal_singly(sealed.batch);
                rows
            }
            RecordKind::TelemetryBlockSealed => {
                let RecordBody::<TelemetryBlock> { change: block, rows } = body(seq, text)?;
                for sealed in block.batches {
                    self.batches.push(SealedBatch { seq, batch: sealed.batch, digest: sealed.digest });
                    self.telemetry.seal(sealed.batch);
                }
                rows
            }
            RecordKind::TelemetryPruned => {
                let RecordBody::<TelemetryPruned> { change: pruned, rows } = body(seq, text)?;
                self.telemetry.prune(pruned.through);
                rows
            }
            RecordKind::TelemetryMissed => {
                let RecordBody::<TelemetryMissed> { change: missed, rows } = body(seq, text)?;
                self.telemetry.miss(&missed.gaps);
                rows
            }
            RecordKind::StoreRebuilt => {
                let RecordBody::<StoreRebuilt> { change: rebuilt, rows } = body(seq, text)?;
                if rebuilt.unsigned > 0 {
                    let first = rebuilt.from_seq.saturating_add(1).saturating_sub(rebuilt.unsigned);
                    self.taken_unsigned.push((first, rebuilt.from_seq));
                }
                rows
            }
            _ => body::<IgnoredAny>(seq, text)?.rows,
        };
        for RowSet(name, key, digest) in rows {
            let table = ChainedTable::named(&name)
                .ok_or_else(|| fault(format!("it names a table {name:?} that does not exist")))?;
            self.rows.insert((table, key.into_owned()), ChainedRow { digest, seq });
        }
        Ok(())
    }
}

/// A row of [`audit::COLUMNS`], borrowed.
fn borrowed<'a>(row: &'a Row<'_>) -> rusqlite::Result<RecordRef<'a>> {
    // No record hashes this; it is a number all the same.
    row.get::<_, i64>(7)?;
    Ok(RecordRef {
        seq: row.get(0)?,
        prev: Digest::from_bytes(row.get(1)?),
        hash: Digest::from_bytes(row.get(2)?),
        at_ms: row.get(3)?,
        kind: row.get_ref(4)?.as_str()?,
        subject: row.get_ref(5)?.as_str()?,
        body: row.get_ref(6)?.as_str()?,
    })
}

fn body<'a, C: Deserialize<'a>>(seq: u64, text: &'a str) -> Result<RecordBody<'a, C>, ChainFault> {
    serde_json::from_str(text)
        .map_err(|error| ChainFault::Record { seq, problem: format!("its body: {error}") })
}
