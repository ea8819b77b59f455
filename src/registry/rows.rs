//! Row images: the digest of a row as it stands, which enters the audit chain with every change of it.
//!
//! A row whose digest is not the last one the chain holds for it was changed behind the chain's back.

use rusqlite::types::ValueRef;
use rusqlite::{Connection, OptionalExtension, Row};

use holdpoint_governance::ids::Digest;

/// The tables the chain vouches for.
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
}

impl ChainedTable {
    pub(crate) const ALL: [Self; 8] = [
        Self::Context,
        Self::Version,
        Self::Family,
        Self::Activation,
        Self::Evidence,
        Self::ApprovalRequest,
        Self::Approval,
        Self::Alarm,
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
        }
    }

    /// The column that names a row.
    const fn key(self) -> &'static str {
        match self {
            Self::Context | Self::ApprovalRequest | Self::Alarm => "id",
            Self::Version | Self::Family => "name",
            Self::Activation | Self::Evidence => "seq",
            Self::Approval => "nonce",
        }
    }

    /// Every column the chain vouches for.
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
        }
    }
}

/// The digest of a row: each column's type and bytes.
fn image(table: ChainedTable, row: &Row<'_>, first: usize) -> rusqlite::Result<Digest> {
    let count = table.columns().split(',').count();
    let mut parts: Vec<Vec<u8>> = Vec::with_capacity(count);
    for index in first..first + count {
        parts.push(match row.get_ref(index)? {
            ValueRef::Null => vec![b'n'],
            ValueRef::Integer(value) => [b"i".as_slice(), &value.to_le_bytes()].concat(),
            ValueRef::Real(value) => [b"r".as_slice(), &value.to_bits().to_le_bytes()].concat(),
            ValueRef::Text(value) => [b"t".as_slice(), value].concat(),
            ValueRef::Blob(value) => [b"b".as_slice(), value].concat(),
        });
    }
    let parts: Vec<&[u8]> = parts.iter().map(Vec::as_slice).collect();
    Ok(Digest::of_parts(table.name(), &parts))
}

/// The digest of one row, `None` if there is none.
pub(crate) fn row_digest(
    connection: &Connection,
    table: ChainedTable,
    key: &str,
) -> rusqlite::Result<Option<Digest>> {
    let sql = format!("SELECT {} FROM {} WHERE {} = ?1", table.columns(), table.name(), table.key());
    connection.prepare_cached(&sql)?.query_row([key], |row| image(table, row, 0)).optional()
}

/// Key and digest of every row of a table.
pub(crate) fn all_rows(
    connection: &Connection,
    table: ChainedTable,
    mut visit: impl FnMut(String, Digest),
) -> rusqlite::Result<()> {
    let sql = format!("SELECT CAST({} AS TEXT), {} FROM {}", table.key(), table.columns(), table.name());
    let mut select = connection.prepare(&sql)?;
    let mut rows = select.query([])?;
    while let Some(row) = rows.next()? {
        visit(row.get(0)?, image(table, row, 1)?);
    }
    Ok(())
}
