//! Read access: candidates and history, one version in full, requests, alarms, the chain.
//!
//! Reading only.

use std::io::Write;
use std::path::Path;

use rusqlite::types::Value;
use rusqlite::{Connection, OptionalExtension, Row, params, params_from_iter};

use crate::chain::audit::{self, ExportError};
use crate::chain::compare::is_lost;
use crate::chain::person_rows;
use crate::database::columns::{conversion, parsed, parsed_option};
use crate::database::migrate::{STORE, version};
use crate::database::open::open_reader;
use crate::terms::sqlite_error::sqlite_error;
use crate::transaction::apply::read_reason;
use crate::verification::check::{VerificationDepth, open_checked};
use holdpoint_approvals::PersonDirectory;
use holdpoint_audit::chain::Head;
use holdpoint_audit::profile_history::ProfileChangeBody;
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::{State, VersionFlags};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::profile_downgrade::AdmissionContext;
use holdpoint_governance::record::{ActivationCause, AuditRecord, RecordKind, UpgradeEnd, VersionSummary};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_store::{
    ActivationEntry, AlarmEntry, ApprovalEntry, ApprovalRequest, AuditFilter, EvidenceEntry, EvidenceKind,
    FamilyStatus, PAGE_ROWS_MAX, StoreError, VersionDetail, VersionFilter, VersionHistory,
};

/// The most closing records of one version that are read: one for each way an upgrade can end.
const CLOSINGS_MAX: usize = 100;

/// Everything that can be read; [`RecordViews`](holdpoint_store::RecordViews) describes what each call returns.
#[derive(Debug)]
pub struct Views {
    pub(crate) connection: Connection,
}

const SUMMARY_COLUMNS: &str = "name, state, row_version, running, paused, awaiting_approval, provisional, restricted, \
    rollback_pending, kappa_i, kappa_p, kappa_b, kappa_r, baseline, author, provenance, risk, changed_ms, \
    (SELECT wall_ms FROM audit WHERE subject = version.name AND at_ms <= version.changed_ms ORDER BY seq DESC LIMIT 1)";

impl Views {
    pub fn folder(&self) -> Option<std::path::PathBuf> {
        std::path::Path::new(self.connection.path()?).parent().map(std::path::Path::to_path_buf)
    }

    /// Opens a store's database for reading, also while an engine has it open.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn open(database: &Path) -> Result<Self, StoreError> {
        Ok(Self { connection: open_reader(database, &STORE)? })
    }

    /// As [`Self::open`], after reading the chain from its newest snapshot and comparing every row: for displaying the
    /// tables without an engine.
    ///
    /// # Errors
    /// If it cannot be opened, or its tables are not what its chain says.
    pub fn open_checked(database: &Path) -> Result<Self, StoreError> {
        Ok(Self { connection: open_checked(database, VerificationDepth::Rows)? })
    }

    /// As [`Self::open`], after reading every record and checking its signatures: for exporting or counting records.
    ///
    /// # Errors
    /// If it cannot be opened, or its records are not what was signed.
    pub fn open_records(database: &Path) -> Result<Self, StoreError> {
        Ok(Self { connection: open_checked(database, VerificationDepth::Records)? })
    }

    /// The connection, for [`check_invariants`](crate::check_invariants).
    #[must_use]
    pub const fn connection(&self) -> &Connection {
        &self.connection
    }

    /// Versions that pass the filter, by family and semantic version, and how many there are in all.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn versions(&self, filter: &VersionFilter) -> Result<(Vec<VersionSummary>, usize), StoreError> {
        let mut conditions = vec!["1".to_owned()];
        let mut values: Vec<Value> = Vec::new();
        let states: Vec<_> =
            filter.group.states().iter().filter(|s| filter.state.is_none_or(|one| one == **s)).collect();
        if states.len() < State::ALL.len() {
            let list: Vec<_> = states.iter().map(|state| format!("'{state}'")).collect();
            conditions.push(format!("state IN ({})", list.join(", ")));
        }
        if let Some(family) = &filter.family {
            values.push(Value::Text(family.clone()));
            conditions.push(format!("family = ?{}", values.len()));
        }
        if let Some(text) = &filter.text {
            values.push(Value::Text(text.clone()));
            conditions.push(format!("instr(name, ?{}) > 0", values.len()));
        }
        let conditions = conditions.join(" AND ");
        let count = format!("SELECT count(*) FROM version INDEXED BY version_list WHERE {conditions}");
        let total =
            one(&self.connection, &count, params_from_iter(values.clone()), |row| row.get(0))?.unwrap_or(0);
        values.push(Value::Integer(limit(filter.limit)));
        values.push(Value::Integer(i64::try_from(filter.offset).unwrap_or(i64::MAX)));
        let page = format!(
            "SELECT {SUMMARY_COLUMNS} FROM version INDEXED BY version_list WHERE {conditions}
             ORDER BY family, sort_key LIMIT ?{} OFFSET ?{}",
            values.len() - 1,
            values.len()
        );
        let mut rows = many(&self.connection, &page, params_from_iter(values), read_summary)?;
        for (unreviewed, _) in self.open_reviews()? {
            rows.iter_mut().filter(|row| row.version == unreviewed).for_each(|row| row.unreviewed = true);
        }
        Ok((rows, total))
    }

    /// Versions that were activated by break-glass and are not reviewed yet, with the deadline of the review.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn open_reviews(&self) -> Result<Vec<(CapabilityId, WallTime)>, StoreError> {
        // A review names its version by the place in the family; few families have one.
        let sql = "SELECT v.name, json_extract(f.standing, '$.review.until_ms') FROM family f
             JOIN version v ON v.family = f.name
             WHERE instr(f.standing, '\"review\"') > 0 AND json_extract(f.standing, '$.review.version') =
               (SELECT count(*) FROM version w WHERE w.family = v.family AND w.id < v.id) ORDER BY v.id";
        many(&self.connection, sql, [], |row| Ok((parsed(row, 0)?, WallTime::from_ms(row.get(1)?))))
    }

    /// One version in full, `None` if there is none.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn version(&self, id: &CapabilityId) -> Result<Option<VersionDetail>, StoreError> {
        let name = id.to_string();
        let sql = format!(
            "SELECT {SUMMARY_COLUMNS}, parent, candidate_digest, manifest_digest, bundle_digest, manifest, submission,
               permissions, environments, signature, registered_ms FROM version WHERE name = ?1"
        );
        let found = one(&self.connection, &sql, [&name], |row| {
            Ok(VersionDetail {
                summary: read_summary(row)?,
                parent: parsed_option(row, 19)?,
                candidate_digest: parsed(row, 20)?,
                manifest_digest: parsed(row, 21)?,
                bundle_digest: parsed(row, 22)?,
                manifest: row.get(23)?,
                submission: row.get(24)?,
                permissions: row.get(25)?,
                environments: row.get(26)?,
                signature: row.get(27)?,
                registered_ms: row.get(28)?,
                evidence: Vec::new(),
                activations: Vec::new(),
                approvals: Vec::new(),
                audit_links: Vec::new(),
            })
        })?;
        let Some(mut detail) = found else { return Ok(None) };
        detail.evidence = self.evidence(id, None)?;
        detail.activations = many(
            &self.connection,
            "SELECT seq, active, pinned, cause, gate_digest, at_ms FROM activation
             WHERE family = ?1 AND (active = ?2 OR pinned = ?2) ORDER BY seq",
            [id.family.as_str(), &name],
            read_activation,
        )?;
        detail.approvals = self.approvals(id)?;
        // Numbers alone, so all of them: their count goes on record.
        let links = "SELECT seq FROM audit WHERE subject = ?1 ORDER BY seq";
        detail.audit_links = many(&self.connection, links, [&name], |row| row.get(0))?;
        Ok(Some(detail))
    }

    /// Evidence on a version, the newest [`PAGE_ROWS_MAX`] pieces, oldest first; of one kind if one is given.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn evidence(
        &self,
        id: &CapabilityId,
        kind: Option<EvidenceKind>,
    ) -> Result<Vec<EvidenceEntry>, StoreError> {
        let sql = format!(
            "SELECT e.seq, e.kind, e.row_version, e.profile, e.policy_digest, e.digest, e.json, e.at_ms,
               e.seq > (SELECT void_seq FROM family WHERE name = ?2)
                 AND e.seq > coalesce((SELECT seq FROM context WHERE id = 1), 0)
             FROM evidence e WHERE e.version = ?1 AND (?3 IS NULL OR e.kind = ?3)
             ORDER BY e.seq DESC LIMIT {PAGE_ROWS_MAX}"
        );
        let parameters = params![id.to_string(), id.family.as_str(), kind.map(EvidenceKind::name)];
        many(&self.connection, &sql, parameters, |row| {
            Ok(EvidenceEntry {
                seq: row.get(0)?,
                kind: parsed(row, 1)?,
                row_version: row.get(2)?,
                profile: parsed(row, 3)?,
                policy_digest: parsed(row, 4)?,
                digest: parsed(row, 5)?,
                json: row.get(6)?,
                at_ms: row.get(7)?,
                current: row.get(8)?,
            })
        })
        .map(|found| found.into_iter().rev().collect())
    }

    /// Decisions about a version, the newest [`PAGE_ROWS_MAX`], oldest first.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn approvals(&self, id: &CapabilityId) -> Result<Vec<ApprovalEntry>, StoreError> {
        let sql = format!(
            "SELECT signed, consumed_seq, approval.at_ms, NULLIF(wall_ms, 0) FROM approval LEFT JOIN audit USING (seq)
             WHERE version = ?1 ORDER BY seq DESC LIMIT {PAGE_ROWS_MAX}"
        );
        let found = many(&self.connection, &sql, [id.to_string()], |row| {
            // The mark of a lost text is not an approval.
            let text = Some(row.get::<_, String>(0)?).filter(|text| !is_lost(text));
            let signed = text.map(|text| serde_json::from_str(&text)).transpose();
            let signed = signed.map_err(|error| conversion(0, error))?;
            let (consumed_seq, at_ms, wall_ms) = (row.get(1)?, row.get(2)?, row.get(3)?);
            Ok(signed.map(|signed| ApprovalEntry { signed, consumed_seq, at_ms, wall_ms }))
        })?;
        Ok(found.into_iter().rev().flatten().collect())
    }

    /// All persons, revoked ones included: each act is checked again.
    ///
    /// # Errors
    /// If the store cannot be read, or an act does not hold.
    pub fn persons(&self) -> Result<PersonDirectory, StoreError> {
        let reading = "read who may decide";
        let id = "SELECT value FROM meta WHERE +key = 'store_id'";
        let store_id: String =
            self.connection.query_row(id, [], |row| row.get(0)).map_err(sqlite_error(reading))?;
        person_rows::read(&self.connection, &store_id)
            .map_err(sqlite_error(reading))?
            .map_err(|(name, problem)| StoreError::Person { name, problem })
    }

    /// Open requests for approval, the most urgent first.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn open_requests(&self) -> Result<Vec<ApprovalRequest>, StoreError> {
        let sql =
            "SELECT id, version, row_version, evidence_digest, policy_digest, profile, needed, deadline_ms,
               state, json FROM approval_request WHERE state = 'open' ORDER BY deadline_ms LIMIT 10000";
        many(&self.connection, sql, [], |row| {
            Ok(ApprovalRequest {
                id: row.get(0)?,
                version: parsed(row, 1)?,
                row_version: row.get(2)?,
                evidence_digest: parsed(row, 3)?,
                policy_digest: parsed(row, 4)?,
                profile: parsed(row, 5)?,
                needed: row.get(6)?,
                until: WallTime::from_ms(row.get(7)?),
                state: parsed(row, 8)?,
                json: row.get(9)?,
            })
        })
    }

    /// When a request for approval was made, the engine's time, ms; `None` if there is none of that id.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn requested_ms(&self, request: &str) -> Result<Option<u64>, StoreError> {
        let sql = "SELECT asked_ms FROM approval_request WHERE id = ?1";
        one(&self.connection, sql, [request], |row| row.get(0))
    }

    /// Every version of a family, in the order of registration.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn family_in_order(&self, family: &Family) -> Result<Vec<CapabilityId>, StoreError> {
        let sql = "SELECT name FROM version WHERE family = ?1 ORDER BY id";
        many(&self.connection, sql, [family.as_str()], |row| parsed(row, 0))
    }

    /// All families, by name.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn families(&self) -> Result<Vec<FamilyStatus>, StoreError> {
        let sql = "SELECT name, active, pinned, bootstrapped, safe_stopped, reason, standing FROM family ORDER BY name";
        many(&self.connection, sql, [], |row| {
            Ok(FamilyStatus {
                name: row.get(0)?,
                active: parsed_option(row, 1)?,
                pinned: parsed_option(row, 2)?,
                bootstrapped: row.get(3)?,
                safe_stopped: row.get(4)?,
                reason: read_reason(row.get(5)?),
                state_json: row.get(6)?,
            })
        })
    }

    /// Families whose active pointer names the robot it was set with, and that robot's digest.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn pointer_robots(&self) -> Result<Vec<(String, String)>, StoreError> {
        // Before schema 2 none did.
        if version(&self.connection).map_err(sqlite_error("read the registry"))? < 2 {
            return Ok(Vec::new());
        }
        let sql = "SELECT name, robot FROM family WHERE robot IS NOT NULL ORDER BY name";
        many(&self.connection, sql, [], |row| Ok((row.get(0)?, row.get(1)?)))
    }

    /// Profile, policy digest and content of the present context; `None` before the first.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn context(&self) -> Result<Option<(ProfileName, Digest, String)>, StoreError> {
        let sql = "SELECT profile, policy_digest, json FROM context WHERE id = 1";
        one(&self.connection, sql, [], |row| Ok((parsed(row, 0)?, parsed(row, 1)?, row.get(2)?)))
    }

    /// Alarms as they stand, the last changed first.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn alarms(&self) -> Result<Vec<AlarmEntry>, StoreError> {
        let sql =
            "SELECT id, subject, state, priority, json, changed_ms FROM alarm ORDER BY changed_ms DESC, id";
        many(&self.connection, sql, [], |row| {
            Ok(AlarmEntry {
                alarm: row.get(0)?,
                subject: row.get(1)?,
                state: parsed(row, 2)?,
                priority: parsed(row, 3)?,
                json: row.get(4)?,
                changed_ms: row.get(5)?,
            })
        })
    }

    /// The history of a version's state, by the audit chain.
    ///
    /// # Errors
    /// If the store cannot be read, or the program does not write such a record.
    pub fn version_history(&self, id: &CapabilityId) -> Result<VersionHistory, StoreError> {
        #[derive(serde::Deserialize)]
        struct DepartureBody {
            change: DepartureChange,
        }
        #[derive(serde::Deserialize)]
        struct DepartureChange {
            from: State,
        }
        #[derive(serde::Deserialize)]
        struct FlagsSetBody {
            change: FlagsSetChange,
        }
        #[derive(serde::Deserialize)]
        struct FlagsSetChange {
            flags: VersionFlags,
        }
        #[derive(serde::Deserialize)]
        struct ActiveSetBody {
            change: ActiveSetChange,
        }
        #[derive(serde::Deserialize)]
        struct ActiveSetChange {
            cause: RecordedCause,
        }
        #[derive(serde::Deserialize)]
        struct RecordedCause {
            cause: ActivationCause,
        }
        #[derive(serde::Deserialize)]
        struct AuditClosedFields {
            outcome: UpgradeEnd,
        }
        let records = |kind, limit, before_seq| {
            self.audit(&AuditFilter {
                before_seq,
                kind: Some(kind),
                subject: Some(id.to_string()),
                limit,
                newest_first: true,
                ..AuditFilter::default()
            })
        };
        let unread = |error| StoreError::invalid("audit record", id, error);
        let last = records(RecordKind::StateSet, 1, None)?;
        let last = last.first();
        let mut ran = None;
        if let Some(last) = last {
            // The earlier flags show what ran; the state is written first.
            let flags = records(RecordKind::FlagsSet, 1, Some(last.seq))?;
            let flags =
                flags.first().map(|record| serde_json::from_str::<FlagsSetBody>(&record.body)).transpose();
            ran = flags.map_err(unread)?.and_then(|body| body.change.flags.running);
        }
        let left = last.map(|record| serde_json::from_str::<DepartureBody>(&record.body)).transpose();
        let mut confirmed = false;
        for record in records(RecordKind::AuditClosed, CLOSINGS_MAX, None)? {
            let closed: AuditClosedFields = serde_json::from_str(&record.body).map_err(unread)?;
            confirmed |= closed.outcome == UpgradeEnd::Confirmed;
        }
        let mut activated_under = None;
        for record in records(RecordKind::ActiveSet, CLOSINGS_MAX, None)? {
            let set: ActiveSetBody = serde_json::from_str(&record.body).map_err(unread)?;
            if set.change.cause.cause == ActivationCause::Gate {
                activated_under = Some(self.in_force_at(record.seq)?);
                break;
            }
        }
        Ok(VersionHistory {
            left: left.map_err(unread)?.map(|body| body.change.from),
            ran,
            confirmed,
            activated_under,
        })
    }

    /// The profile that was in force when a record was written.
    fn in_force_at(&self, seq: u64) -> Result<AdmissionContext, StoreError> {
        let newest_before =
            AuditFilter { before_seq: Some(seq), ..AuditFilter::newest(RecordKind::ContextSet) };
        let found = self.audit(&newest_before)?;
        let read = |record: &AuditRecord| serde_json::from_str::<ProfileChangeBody>(&record.body).ok();
        Ok(found.first().and_then(read).map_or(AdmissionContext::LEAST, |set| set.change.admission_context()))
    }

    /// Calls `visit` with each record of the chain up to `to_seq`, in order, one at a time.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn each_record(&self, to_seq: u64, mut visit: impl FnMut(AuditRecord)) -> Result<(), StoreError> {
        audit::for_each(&self.connection, 0, |record| {
            if record.seq <= to_seq {
                visit(record);
            }
            Ok::<(), rusqlite::Error>(())
        })
        .map_err(sqlite_error("read the audit chain"))
    }

    /// The end of the chain.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn head(&self) -> Result<Head, StoreError> {
        audit::head(&self.connection).map_err(sqlite_error("read the audit chain"))
    }

    /// Writes the chain from `from_seq` on as JSON lines, printable ASCII only, and returns their number. A closed pipe
    /// is a clean end.
    ///
    /// # Errors
    /// [`ExportError`].
    pub fn export(&self, from_seq: u64, out: &mut dyn Write) -> Result<u64, ExportError> {
        audit::export(&self.connection, from_seq, out)
    }
}

/// Rows to return, for SQLite.
pub(crate) fn limit(requested: usize) -> i64 {
    let rows = if requested == 0 { PAGE_ROWS_MAX } else { requested.min(PAGE_ROWS_MAX) };
    i64::try_from(rows).unwrap_or(i64::MAX)
}

fn read_summary(row: &Row<'_>) -> rusqlite::Result<VersionSummary> {
    Ok(VersionSummary {
        version: parsed(row, 0)?,
        state: parsed(row, 1)?,
        row_version: row.get(2)?,
        flags: VersionFlags {
            running: parsed_option(row, 3)?,
            paused: row.get(4)?,
            awaiting_approval: row.get(5)?,
            provisional: row.get(6)?,
            restricted: row.get(7)?,
            rollback_pending: row.get(8)?,
        },
        kappas: [row.get(9)?, row.get(10)?, row.get(11)?, row.get(12)?],
        baseline: row.get(13)?,
        author: row.get(14)?,
        provenance: parsed(row, 15)?,
        risk: parsed(row, 16)?,
        changed_ms: row.get(17)?,
        changed_at: row.get::<_, Option<i64>>(18)?.filter(|wall_ms| *wall_ms > 0).map(WallTime::from_ms),
        unreviewed: false,
    })
}

fn read_activation(row: &Row<'_>) -> rusqlite::Result<ActivationEntry> {
    Ok(ActivationEntry {
        seq: row.get(0)?,
        active: parsed_option(row, 1)?,
        pinned: parsed_option(row, 2)?,
        cause: parsed(row, 3)?,
        gate_digest: parsed_option(row, 4)?,
        at_ms: row.get(5)?,
    })
}

fn one<T>(
    connection: &Connection,
    sql: &str,
    parameters: impl rusqlite::Params,
    read: impl FnOnce(&Row<'_>) -> rusqlite::Result<T>,
) -> Result<Option<T>, StoreError> {
    connection
        .prepare_cached(sql)
        .and_then(|mut select| select.query_row(parameters, read).optional())
        .map_err(sqlite_error("read the registry"))
}

pub(crate) fn many<T>(
    connection: &Connection,
    sql: &str,
    parameters: impl rusqlite::Params,
    read: impl FnMut(&Row<'_>) -> rusqlite::Result<T>,
) -> Result<Vec<T>, StoreError> {
    connection
        .prepare_cached(sql)
        .and_then(|mut select| select.query_map(parameters, read)?.collect())
        .map_err(sqlite_error("read the registry"))
}
