//! Lists of audit records: by kind, subject and place, newest or oldest first. The cost depends on the number of
//! returned rows.
//!
//! Reading only. [`audit`](crate::chain::audit) has the rows of the chain.

use rusqlite::params_from_iter;
use rusqlite::types::Value;

use crate::chain::audit;
use crate::reading::views::{Views, limit, many};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::record::AuditRecord;
use holdpoint_governance::version_status::RecordedChanges;
use holdpoint_store::{AuditFilter, StoreError};

/// The most kinds of records of one chain: an engine knows a quarter of them, and a query has room for this many.
const KINDS_MAX: usize = 200;

impl Views {
    /// Audit records that pass the filter.
    ///
    /// Excluded records cost nothing: each other kind is read by its index, at most the requested number of rows.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn audit(&self, filter: &AuditFilter) -> Result<Vec<AuditRecord>, StoreError> {
        let order = if filter.newest_first { "DESC" } else { "ASC" };
        let before = filter.before_seq.map_or(i64::MAX, |before| i64::try_from(before).unwrap_or(i64::MAX));
        let mut values = vec![
            Value::Integer(i64::try_from(filter.from_seq).unwrap_or(i64::MAX)),
            Value::Integer(before),
            Value::Integer(limit(filter.limit)),
        ];
        let mut fits = "seq >= ?1 AND seq < ?2".to_owned();
        let mut demand = |fits: &str, column: &str, value: &str| {
            values.push(Value::Text(value.to_owned()));
            format!("{fits} AND {column} = ?{}", values.len())
        };
        if let Some(subject) = &filter.subject {
            fits = demand(&fits, "subject", subject);
        }
        let rows = if let Some(kind) = filter.kind {
            if filter.without.contains(&kind) {
                return Ok(Vec::new());
            }
            demand(&fits, "kind", kind.name())
        } else if filter.without.is_empty() {
            fits
        } else {
            let left_out = |kind: &String| filter.without.iter().any(|without| without.name() == kind);
            let each: Vec<String> = self
                .kinds()?
                .into_iter()
                .filter(|kind| !left_out(kind))
                .map(|kind| {
                    let fits = demand(&fits, "kind", &kind);
                    format!(
                        "SELECT * FROM (SELECT seq FROM audit WHERE {fits} ORDER BY seq {order} LIMIT ?3)"
                    )
                })
                .collect();
            if each.is_empty() {
                return Ok(Vec::new());
            }
            format!("seq IN ({})", each.join(" UNION ALL "))
        };
        let columns = audit::COLUMNS;
        let sql = format!("SELECT {columns} FROM audit WHERE {rows} ORDER BY seq {order} LIMIT ?3");
        many(&self.connection, &sql, params_from_iter(values), audit::read)
    }

    /// What is on record of a version's present state.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn recorded_changes(&self, id: &CapabilityId) -> Result<RecordedChanges, StoreError> {
        let mut found = Vec::new();
        for (kind, limit) in RecordedChanges::READ {
            found.extend(self.audit(&AuditFilter {
                kind: Some(kind),
                subject: Some(id.to_string()),
                limit,
                newest_first: true,
                ..AuditFilter::default()
            })?);
        }
        found.sort_by_key(|record| record.seq);
        let mut changes = RecordedChanges::default();
        for record in &found {
            changes.note(record);
        }
        Ok(changes)
    }

    /// The kinds of records in the chain, including those of other builds: one index search for each.
    fn kinds(&self) -> Result<Vec<String>, StoreError> {
        let sql = "WITH RECURSIVE found(kind) AS (
                SELECT min(kind) FROM audit
                UNION ALL
                SELECT (SELECT min(kind) FROM audit WHERE kind > found.kind) FROM found WHERE kind IS NOT NULL
            ) SELECT kind FROM found WHERE kind IS NOT NULL LIMIT ?1";
        let kinds: Vec<String> = many(&self.connection, sql, [KINDS_MAX + 1], |row| row.get(0))?;
        if kinds.len() > KINDS_MAX {
            let more = format!("more than {KINDS_MAX} kinds of records");
            return Err(StoreError::invalid("audit chain", "kind", more));
        }
        Ok(kinds)
    }
}
