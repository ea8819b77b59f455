//! Applies one record of the chain again, by the original code and without a check of permission: it is on record.

use std::collections::BTreeMap;

use rusqlite::{Connection, params};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::chain::audit;
use crate::chain::compare::check_approval;
use crate::chain::fold::Fold;
use crate::chain::row_images::{ChainedTable, RowName, differing_columns, row_digest};
use crate::database::migrate::{STORE, migrate};
use crate::terms::sqlite_error::sqlite_error;
use crate::transaction::apply::{Applier, ApprovalBasis};
use crate::transaction::rebuild_losses::{lost_mark, rows_lost, text_of};
use holdpoint_approvals::SignedApproval;
use holdpoint_audit::chain::Head;
use holdpoint_audit::recorded_approval::RecordedApproval;
use holdpoint_governance::ids::{CapabilityId, Digest, canonical_json};
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_store::{ApprovalFault, Change, StoreError};

/// The text of an approval, also where its row is under another key.
const SIGNED: &str = "SELECT signed FROM approval WHERE nonce = ?1
     OR CASE WHEN json_valid(signed) THEN json_extract(signed, '$.approval.nonce') = ?1 END
     ORDER BY nonce <> ?1 LIMIT 1";

/// The parts of a store record that are applied.
#[derive(Deserialize)]
struct AppliedBody {
    change: Value,
    #[serde(default)]
    rows: Vec<(String, String, Digest)>,
}

/// Applies a record to the new database. Texts that it does not repeat come from the damaged store. Returns the rows
/// with a lost text.
pub(crate) fn replay(
    new_store: &Connection,
    damaged_store: &Connection,
    fold: &Fold,
    record: &AuditRecord,
) -> Result<Vec<RowName>, StoreError> {
    let Some(kind) = record.kind.known().copied().filter(|kind| crate::terms::own_records::is_own(*kind))
    else {
        return Ok(Vec::new());
    };
    let unreadable = |error: serde_json::Error| StoreError::invalid("audit record", record.seq, error);
    if kind == RecordKind::StoreRebuilt {
        let lost = rows_lost(record)?;
        return lost.iter().map(|(table, key)| mark(new_store, table, key)).collect();
    }
    let body: AppliedBody = serde_json::from_str(&record.body).map_err(unreadable)?;
    let head = Head { seq: record.seq.saturating_sub(1), hash: record.prev, at_ms: record.at_ms };
    let place = ApprovalBasis { store_id: "", store_key: "" };
    let mut applier = Applier::new(new_store, fold, place, (record.at_ms, record.wall_ms), head);
    if kind == RecordKind::ApprovalPut {
        let recorded: RecordedApproval = serde_json::from_value(body.change).map_err(unreadable)?;
        return put_approval(&applier, damaged_store, &record.subject, &recorded);
    }
    let mut change = body.change;
    fill_texts(&mut change, damaged_store, record.seq);
    let change: Change = serde_json::from_value(change).map_err(unreadable)?;
    applier.reapply(&change)?;
    if let Change::RegisterVersion(new) = &change {
        repair_version(new_store, &new.id.to_string(), &new.manifest, &body.rows)?;
    }
    Ok(Vec::new())
}

impl Applier<'_> {
    /// Writes the effect of a change that was allowed.
    fn reapply(&mut self, change: &Change) -> Result<(), StoreError> {
        let touched = match change {
            Change::SetState { version, expected_row_version, to, .. } => {
                self.write_state(version, *expected_row_version, *to)
            }
            Change::SetActive { family, active, pinned, cause, robot } => {
                self.write_active(family, (active.as_ref(), pinned.as_ref()), cause, robot.as_deref())
            }
            // These write no row.
            Change::SetWitness { .. } | Change::AllowProfile { .. } => return Ok(()),
            // The authorization was checked when it was written.
            Change::SetContext { profile, policy_digest, json, .. } => {
                self.write_context(*profile, *policy_digest, json)
            }
            Change::ConsumeApproval { nonce, .. } => return self.write_consumed(nonce),
            Change::EnrolPerson(signed) | Change::ConfirmPerson(signed) | Change::RevokePerson(signed) => {
                self.write_person_act(signed)
            }
            Change::RegisterVersion(_)
            | Change::SetFlags { .. }
            | Change::SetScores { .. }
            | Change::SetFamily { .. }
            | Change::SetStanding { .. }
            | Change::VoidFamily { .. }
            | Change::PutEvidence { .. }
            | Change::PutApprovalRequest(_)
            | Change::PutApproval(_)
            | Change::SealTelemetry { .. }
            | Change::SealTelemetryBlock { .. }
            | Change::PruneTelemetry { .. }
            | Change::MissTelemetry { .. }
            | Change::AlarmChange { .. } => self.change(change),
        };
        touched.map(drop)
    }
}

/// A mark replaces a text that an earlier rebuild gave up.
fn mark(new_store: &Connection, table: &str, key: &str) -> Result<RowName, StoreError> {
    let known = ChainedTable::named(table);
    let (sql, table) = match known {
        Some(table @ ChainedTable::Evidence) => ("UPDATE evidence SET json = ?2 WHERE seq = ?1", table),
        Some(table @ ChainedTable::Approval) => ("UPDATE approval SET signed = ?2 WHERE nonce = ?1", table),
        _ => return Err(StoreError::invalid("lost row of the table", table, "evidence or approval")),
    };
    new_store.execute(sql, params![key, lost_mark(key)]).map_err(sqlite_error("mark a lost text"))?;
    Ok((table, key.to_owned()))
}

/// Adds the texts that a record does not repeat to its change.
fn fill_texts(change: &mut Value, damaged_store: &Connection, seq: u64) {
    let Some(fields) = change.as_object_mut() else { return };
    let named = |field: &str| fields.get(field).and_then(Value::as_str).unwrap_or_default().to_owned();
    let of_version = |column: &str| format!("SELECT {column} FROM version WHERE name = ?1");
    let wanted: Vec<(&str, String, String)> = match named("change").as_str() {
        "register-version" => ["manifest", "submission", "permissions", "environments"]
            .map(|column| (column, of_version(column), named("id")))
            .into(),
        "set-scores" => vec![("signature", of_version("signature"), named("version"))],
        "set-standing" => {
            vec![("json", "SELECT standing FROM family WHERE name = ?1".to_owned(), named("family"))]
        }
        "put-evidence" => {
            vec![("json", "SELECT json FROM evidence WHERE seq = ?1".to_owned(), seq.to_string())]
        }
        "put-approval-request" => {
            vec![("json", "SELECT json FROM approval_request WHERE id = ?1".to_owned(), named("id"))]
        }
        "set-context" => {
            vec![("json", "SELECT json FROM context WHERE id = ?1".to_owned(), "1".to_owned())]
        }
        "alarm-change" => {
            vec![("json", "SELECT json FROM alarm WHERE id = ?1".to_owned(), named("alarm"))]
        }
        _ => Vec::new(),
    };
    for (field, sql, key) in wanted {
        if fields.contains_key(field) {
            continue;
        }
        let found = text_of(damaged_store, &sql, &key);
        let found = found.filter(|text| serde_json::from_str::<serde::de::IgnoredAny>(text).is_ok());
        let text = match (found, field) {
            (Some(text), _) => json!(text),
            (None, "signature") => Value::Null,
            // Any value here is compared with the row's digest in the end.
            (None, _) => json!("null"),
        };
        fields.insert(field.to_owned(), text);
    }
}

/// Restores a version's permissions and environments from its manifest if the row does not match its recorded digest.
fn repair_version(
    new_store: &Connection,
    name: &str,
    manifest: &str,
    rows: &[(String, String, Digest)],
) -> Result<(), StoreError> {
    let error = sqlite_error("repair a version");
    let is_whole = || -> Result<bool, StoreError> {
        let digest = row_digest(new_store, ChainedTable::Version, name).map_err(&error)?;
        let table = ChainedTable::Version.name();
        Ok(rows.iter().any(|row| (row.0.as_str(), row.1.as_str()) == (table, name) && Some(row.2) == digest))
    };
    if is_whole()? {
        return Ok(());
    }
    let manifest: Value = serde_json::from_str(manifest).unwrap_or_default();
    let places =
        BTreeMap::from([("permissions", "/permissions"), ("environments", "/deployment/environments")]);
    for (column, place) in places {
        let Some(text) = manifest.pointer(place).and_then(|part| canonical_json(part).ok()) else { continue };
        let sql = format!("UPDATE version SET {column} = ?2 WHERE name = ?1");
        new_store.execute(&sql, [name, &text]).map_err(&error)?;
        if is_whole()? {
            return Ok(());
        }
    }
    Ok(())
}

/// Stores an approval with a valid signature. Otherwise only the claim is stored, and the approval no longer counts.
fn put_approval(
    applier: &Applier<'_>,
    damaged_store: &Connection,
    subject: &str,
    recorded: &RecordedApproval,
) -> Result<Vec<RowName>, StoreError> {
    let nonce = recorded.nonce.as_str();
    let unreadable = |problem: String| StoreError::Approval {
        nonce: nonce.to_owned(),
        problem: ApprovalFault::Damaged(problem),
    };
    let version: CapabilityId = subject
        .parse()
        .map_err(|error: holdpoint_governance::ids::CapabilityIdError| unreadable(error.to_string()))?;
    let text = text_of(damaged_store, SIGNED, nonce);
    let signed = text.as_deref().and_then(|text| serde_json::from_str::<SignedApproval>(text).ok());
    let valid = signed.filter(|signed| {
        let approval = signed.approval();
        let claim = approval.claim_digest().to_string();
        let text = text.as_deref().unwrap_or_default();
        check_approval(signed, nonce, &claim, text, &approval.store_id).is_ok()
            && (approval.version == version && approval.who == recorded.who)
            && (approval.decision == recorded.decision && approval.row_version == recorded.row_version)
    });
    let claim = match &valid {
        Some(signed) => signed.approval().claim_digest(),
        None => text_of(damaged_store, "SELECT claim FROM approval WHERE nonce = ?1", nonce)
            .and_then(|claim| claim.parse().ok())
            .ok_or_else(|| unreadable("its claim and its signature are missing".to_owned()))?,
    };
    let signed = match (&valid, text) {
        (Some(_), Some(text)) => text,
        _ => lost_mark(nonce),
    };
    applier.write_approval(&version, recorded, claim, &signed)?;
    Ok(if valid.is_some() { Vec::new() } else { vec![(ChainedTable::Approval, nonce.to_owned())] })
}

/// The columns of a row that differ from the chain; none if the chain cannot tell.
pub(crate) fn columns_otherwise(
    fold: &Fold,
    damaged_store: &Connection,
    table: ChainedTable,
    key: &str,
) -> Vec<String> {
    let rebuilt = || -> Result<Vec<String>, ReapplyError> {
        let mut new_store = Connection::open_in_memory()?;
        migrate(&mut new_store, &STORE)?;
        audit::for_each::<ReapplyError>(damaged_store, 0, |record| {
            replay(&new_store, damaged_store, fold, &record)?;
            Ok(())
        })?;
        Ok(differing_columns(damaged_store, &new_store, table, key)?)
    };
    rebuilt().unwrap_or_default()
}

/// A failure while records are applied again.
pub(crate) struct ReapplyError(pub(crate) StoreError);

impl From<rusqlite::Error> for ReapplyError {
    fn from(error: rusqlite::Error) -> Self {
        Self(sqlite_error("read the audit chain")(error))
    }
}

impl From<StoreError> for ReapplyError {
    fn from(error: StoreError) -> Self {
        Self(error)
    }
}
