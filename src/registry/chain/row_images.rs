//! Row images: the digest of a row, which enters the audit chain with every change of it.
//!
//! If a row's digest is not the last one in the chain, another program changed it.

use rusqlite::types::{Value, ValueRef};
use rusqlite::{Connection, OptionalExtension, Row};

use crate::database::migrate::{STORE, version};
use holdpoint_governance::ids::Digest;
use holdpoint_store::Change;

/// A row by its table and key.
pub(crate) type RowName = (ChainedTable, String);

/// The tables that the chain covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum ChainedTable {
    Context,
    Version,
    Family,
    Activation,
    Evidence,
    ApprovalRequest,
    Approval,
    Alarm,
    Person,
}

impl ChainedTable {
    pub(crate) const ALL: [Self; 9] = [
        Self::Context,
        Self::Version,
        Self::Family,
        Self::Activation,
        Self::Evidence,
        Self::ApprovalRequest,
        Self::Approval,
        Self::Alarm,
        Self::Person,
    ];

    /// Name in the schema and in the chain.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Context => "context",
            Self::Version => "version",
            Self::Family => "family",
            Self::Activation => "activation",
            Self::Evidence => "evidence",
            Self::ApprovalRequest => "approval_request",
            Self::Approval => "approval",
            Self::Alarm => "alarm",
            Self::Person => "person",
        }
    }

    /// The table of a name in the chain, `None` if there is none.
    pub(crate) fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|table| table.name() == name)
    }

    /// The column that names a row.
    const fn key(self) -> &'static str {
        match self {
            Self::Context | Self::ApprovalRequest | Self::Alarm => "id",
            Self::Version | Self::Family | Self::Person => "name",
            Self::Activation | Self::Evidence => "seq",
            Self::Approval => "nonce",
        }
    }

    /// Every column that the chain covers.
    const fn columns(self) -> &'static str {
        match self {
            Self::Context => "profile, policy_digest, json, seq",
            Self::Version => {
                "name, family, version, sort_key, parent, state, row_version, running, paused, awaiting_approval, \
                 provisional, restricted, rollback_pending, kappa_i, kappa_p, kappa_b, kappa_r, signature, baseline, \
                 candidate_digest, manifest_digest, bundle_digest, author, provenance, risk, permissions, \
                 environments, manifest, submission, registered_ms, changed_ms"
            }
            Self::Family => "name, active, pinned, bootstrapped, safe_stopped, reason, void_seq, standing",
            Self::Activation => "seq, family, active, pinned, cause, gate_digest, approvals_needed, at_ms",
            Self::Evidence => "seq, version, kind, row_version, profile, policy_digest, digest, json, at_ms",
            Self::ApprovalRequest => {
                "id, version, row_version, evidence_digest, policy_digest, profile, needed, asked_ms, deadline_ms, \
                 state, json"
            }
            Self::Approval => {
                "nonce, seq, version, who, decision, row_version, not_after_ms, claim, consumed_seq, at_ms"
            }
            Self::Alarm => "id, subject, state, priority, json, changed_ms",
            Self::Person => {
                "name, seq, role, public_key, state, unprotected, enrolled_by, enrolled, revoked_seq, revoked_by, \
                 revoked, changed_ms"
            }
        }
    }

    /// Columns that a later schema added; a digest holds those that are set.
    const fn later_columns(self) -> &'static [LaterColumn] {
        match self {
            Self::Family | Self::Activation => &[LaterColumn { name: "robot", since: 2 }],
            Self::Context
            | Self::Version
            | Self::Evidence
            | Self::ApprovalRequest
            | Self::Approval
            | Self::Alarm => &[],
            Self::Person => &[
                LaterColumn { name: "confirmed_seq", since: 4 },
                LaterColumn { name: "confirmed", since: 4 },
            ],
        }
    }

    /// The schema that introduced the table.
    pub(crate) const fn since(self) -> usize {
        match self {
            Self::Person => 3,
            Self::Context
            | Self::Version
            | Self::Family
            | Self::Activation
            | Self::Evidence
            | Self::ApprovalRequest
            | Self::Approval
            | Self::Alarm => 1,
        }
    }

    /// Every column as [`image`] takes them, in a database of some schema.
    fn selected(self, schema: usize) -> String {
        let later = self.later_columns().iter();
        let later = later.map(|column| if column.since <= schema { column.name } else { "NULL" });
        std::iter::once(self.columns()).chain(later).collect::<Vec<_>>().join(", ")
    }
}

/// The rows that a change writes, if record `seq` is its own.
pub(crate) fn rows_of(change: &Change, seq: u64) -> Vec<RowName> {
    use ChainedTable as T;
    match change {
        Change::RegisterVersion(new) => {
            vec![(T::Version, new.id.to_string()), (T::Family, new.id.family.to_string())]
        }
        Change::SetState { version, .. }
        | Change::SetFlags { version, .. }
        | Change::SetScores { version, .. } => vec![(T::Version, version.to_string())],
        Change::SetActive { family, .. } => {
            vec![(T::Family, family.to_string()), (T::Activation, seq.to_string())]
        }
        Change::SetFamily { family, .. }
        | Change::SetStanding { family, .. }
        | Change::VoidFamily { family, .. } => vec![(T::Family, family.to_string())],
        Change::PutEvidence { .. } => vec![(T::Evidence, seq.to_string())],
        Change::PutApprovalRequest(request) => vec![(T::ApprovalRequest, request.id.clone())],
        Change::EnrolPerson(signed) | Change::ConfirmPerson(signed) | Change::RevokePerson(signed) => {
            vec![(T::Person, signed.act().name.clone())]
        }
        Change::PutApproval(signed) => vec![(T::Approval, signed.approval().nonce.to_string())],
        Change::ConsumeApproval { nonce, .. } => vec![(T::Approval, nonce.clone())],
        Change::SetContext { .. } => vec![(T::Context, "1".to_owned())],
        Change::SealTelemetry { .. }
        | Change::SealTelemetryBlock { .. }
        | Change::PruneTelemetry { .. }
        | Change::SetWitness { .. }
        | Change::AllowProfile { .. }
        | Change::MissTelemetry { .. } => Vec::new(),
        Change::AlarmChange { alarm, .. } => vec![(T::Alarm, alarm.clone())],
    }
}

/// A column that a table got after schema 1.
struct LaterColumn {
    name: &'static str,
    /// The schema that introduced it.
    since: usize,
}

fn bytes(value: ValueRef<'_>) -> Vec<u8> {
    match value {
        ValueRef::Null => vec![b'n'],
        ValueRef::Integer(value) => [b"i".as_slice(), &value.to_le_bytes()].concat(),
        ValueRef::Real(value) => [b"r".as_slice(), &value.to_bits().to_le_bytes()].concat(),
        ValueRef::Text(value) => [b"t".as_slice(), value].concat(),
        ValueRef::Blob(value) => [b"b".as_slice(), value].concat(),
    }
}

/// The digest of a row: each column's type and bytes. A later column counts from its first value on, so that rows of
/// an earlier schema keep the digests that their records hold.
fn image(table: ChainedTable, row: &Row<'_>, first: usize) -> rusqlite::Result<Digest> {
    let count = table.columns().split(',').count();
    let mut parts: Vec<Vec<u8>> = Vec::with_capacity(count);
    for index in first..first + count {
        parts.push(bytes(row.get_ref(index)?));
    }
    for (index, later) in table.later_columns().iter().enumerate() {
        let value = row.get_ref(first + count + index)?;
        if value != ValueRef::Null {
            parts.push([later.name.as_bytes(), b"=", &bytes(value)].concat());
        }
    }
    let parts: Vec<&[u8]> = parts.iter().map(Vec::as_slice).collect();
    Ok(Digest::of_parts(table.name(), &parts))
}

/// The digest of one row of a database of the newest schema, `None` if there is none.
pub(crate) fn row_digest(
    connection: &Connection,
    table: ChainedTable,
    key: &str,
) -> rusqlite::Result<Option<Digest>> {
    let selected = table.selected(STORE.newest());
    let sql = format!("SELECT {selected} FROM {} WHERE {} = ?1", table.name(), table.key());
    connection.prepare_cached(&sql)?.query_row([key], |row| image(table, row, 0)).optional()
}

/// The columns of a row that differ in another database; none if either row is missing.
pub(crate) fn differing_columns(
    here: &Connection,
    there: &Connection,
    table: ChainedTable,
    key: &str,
) -> rusqlite::Result<Vec<String>> {
    let names: Vec<&str> =
        table.columns().split(", ").chain(table.later_columns().iter().map(|column| column.name)).collect();
    let values = |connection: &Connection| -> rusqlite::Result<Option<Vec<Value>>> {
        let schema = version(connection)?;
        if schema < table.since() {
            return Ok(None);
        }
        let selected = table.selected(schema);
        let sql = format!("SELECT {selected} FROM {} WHERE {} = ?1", table.name(), table.key());
        let read = |row: &Row<'_>| (0..names.len()).map(|index| row.get(index)).collect();
        connection.prepare(&sql)?.query_row([key], read).optional()
    };
    let (Some(here), Some(there)) = (values(here)?, values(there)?) else { return Ok(Vec::new()) };
    let pairs = names.iter().zip(here.iter().zip(&there));
    Ok(pairs.filter(|(_, (here, there))| here != there).map(|(name, _)| (*name).to_owned()).collect())
}

/// Key and digest of every row of a table.
pub(crate) fn all_rows(
    connection: &Connection,
    table: ChainedTable,
    mut visit: impl FnMut(String, Digest),
) -> rusqlite::Result<()> {
    let schema = version(connection)?;
    if schema < table.since() {
        return Ok(());
    }
    let selected = table.selected(schema);
    let sql = format!("SELECT CAST({} AS TEXT), {selected} FROM {}", table.key(), table.name());
    let mut select = connection.prepare(&sql)?;
    let mut rows = select.query([])?;
    while let Some(row) = rows.next()? {
        visit(row.get(0)?, image(table, row, 1)?);
    }
    Ok(())
}
