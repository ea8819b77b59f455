//! The fold of the audit chain: what the registry must look like if every record is true.
//!
//! Checks the links while it reads, then compares its result with the tables.

use std::collections::BTreeMap;

use rusqlite::Connection;
use serde::Deserialize;

use super::audit::{Head, for_each, head};
use super::columns::parsed;
use super::names::is_own;
use super::rows::{ChainedTable, all_rows};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::record::{AuditRecord, RecordKind};

/// The first thing that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum ChainFault {
    /// A record of the chain.
    Record { seq: u64, problem: String },
    /// A row that is not what the chain says.
    Row { table: &'static str, key: String, problem: String },
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

/// What the chain says.
#[derive(Debug)]
pub(crate) struct Fold {
    end: Head,
    rows: BTreeMap<(String, String), (Digest, u64)>,
    states: BTreeMap<String, (State, u64)>,
    hashes: Vec<Digest>,
    pub(crate) batches: Vec<SealedBatch>,
}

/// The parts of a store record that the fold reads.
#[derive(Deserialize)]
struct RecordBody {
    change: serde_json::Value,
    rows: Vec<(String, String, Digest)>,
}

#[derive(Deserialize)]
struct StateSet {
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
struct TelemetrySealed {
    batch: u64,
    digest: Digest,
}

impl Fold {
    /// Reads the whole chain.
    pub(crate) fn read(connection: &Connection) -> Result<Self, FoldError> {
        let start = Head { seq: 0, hash: Digest::from_bytes([0; 32]), at_ms: 0 };
        let mut fold = Self {
            end: start,
            rows: BTreeMap::new(),
            states: BTreeMap::new(),
            hashes: Vec::new(),
            batches: Vec::new(),
        };
        let read = for_each(connection, 0, |record| fold.push(&record).map_err(FoldError::Fault));
        match read {
            Err(FoldError::Read { source, .. }) => Err(FoldError::Read { seq: fold.end.seq + 1, source }),
            Err(error) => Err(error),
            Ok(()) => {
                let end = head(connection)?;
                if (end.seq, end.hash) == (fold.end.seq, fold.end.hash) {
                    return Ok(fold);
                }
                let problem =
                    format!("the chain ends at {}, its end was recorded at {}", fold.end.seq, end.seq);
                let seq = fold.end.seq.min(end.seq) + 1;
                Err(FoldError::Fault(ChainFault::Record { seq, problem }))
            }
        }
    }

    /// The end of the chain.
    pub(crate) const fn end(&self) -> Head {
        self.end
    }

    /// The hash of a record, `None` if there is none.
    pub(crate) fn hash(&self, seq: u64) -> Option<Digest> {
        usize::try_from(seq.checked_sub(1)?).ok().and_then(|index| self.hashes.get(index)).copied()
    }

    fn push(&mut self, record: &AuditRecord) -> Result<(), ChainFault> {
        let fault = |problem: String| ChainFault::Record { seq: self.end.seq + 1, problem };
        if record.seq != self.end.seq + 1 {
            return Err(fault(format!("it is missing; the next one is {}", record.seq)));
        }
        if record.prev != self.end.hash {
            return Err(fault("it does not follow from the record before".to_owned()));
        }
        if record.hash != record.expected_hash() {
            return Err(fault("its content does not match its hash".to_owned()));
        }
        if record.at_ms < self.end.at_ms {
            return Err(fault("it is older than the record before".to_owned()));
        }
        if let Some(kind) = record.kind.known().copied().filter(|kind| is_own(*kind)) {
            let body: RecordBody =
                serde_json::from_str(&record.body).map_err(|e| fault(format!("its body: {e}")))?;
            self.fold_body(record.seq, kind, body)?;
        }
        self.end = Head { seq: record.seq, hash: record.hash, at_ms: record.at_ms };
        self.hashes.push(record.hash);
        Ok(())
    }

    fn fold_body(&mut self, seq: u64, kind: RecordKind, body: RecordBody) -> Result<(), ChainFault> {
        let fault = |problem: String| ChainFault::Record { seq, problem };
        let unreadable =
            |error: serde_json::Error| ChainFault::Record { seq, problem: format!("its body: {error}") };
        match kind {
            RecordKind::VersionRegistered => {
                let new: RegisteredRow = serde_json::from_value(body.change).map_err(unreadable)?;
                if self.states.insert(new.id.clone(), (State::Registered, 1)).is_some() {
                    return Err(fault(format!("{} was registered before", new.id)));
                }
            }
            RecordKind::StateSet => {
                let set: StateSet = serde_json::from_value(body.change).map_err(unreadable)?;
                let found = self.states.get(&set.version).copied();
                if found != Some((set.from, set.expected_row_version)) {
                    return Err(fault(format!("{} was not {} then", set.version, set.from)));
                }
                self.states.insert(set.version, (set.to, set.expected_row_version + 1));
            }
            RecordKind::TelemetrySealed => {
                let sealed: TelemetrySealed = serde_json::from_value(body.change).map_err(unreadable)?;
                self.batches.push(SealedBatch { seq, batch: sealed.batch, digest: sealed.digest });
            }
            _ => {}
        }
        for (table, key, digest) in body.rows {
            self.rows.insert((table, key), (digest, seq));
        }
        Ok(())
    }

    /// The first difference between the tables and what the chain says, `None` if there is none.
    pub(crate) fn compare(&self, connection: &Connection) -> rusqlite::Result<Option<ChainFault>> {
        let mut expected = self.rows.clone();
        let mut fault = None;
        for table in ChainedTable::ALL {
            all_rows(connection, table, |key, digest| {
                let problem = match expected.remove(&(table.name().to_owned(), key.clone())) {
                    Some((known, _)) if known == digest => return,
                    Some((_, seq)) => format!("it is not what record {seq} says"),
                    None => "no record speaks of it".to_owned(),
                };
                fault.get_or_insert(ChainFault::Row { table: table.name(), key, problem });
            })?;
        }
        if fault.is_some() {
            return Ok(fault);
        }
        if let Some(((table, key), (_, seq))) = expected.into_iter().next() {
            let table = ChainedTable::ALL
                .iter()
                .find(|known| known.name() == table)
                .map_or("unknown", |known| known.name());
            return Ok(Some(ChainFault::Row {
                table,
                key,
                problem: format!("it is missing; record {seq} made it"),
            }));
        }
        let mut select = connection.prepare("SELECT name, state, row_version FROM version")?;
        let mut rows = select.query([])?;
        while let Some(row) = rows.next()? {
            let (name, state, row_version): (String, State, u64) =
                (row.get(0)?, parsed(row, 1)?, row.get(2)?);
            if self.states.get(&name) != Some(&(state, row_version)) {
                let problem = format!("its state {state} is not the fold of the chain");
                return Ok(Some(ChainFault::Row { table: "version", key: name, problem }));
            }
        }
        Ok(None)
    }
}
