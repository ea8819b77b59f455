//! Applies the changes of one transaction, each with its audit record. The caller holds the write transaction and rolls
//! it back on any error.

use std::collections::{BTreeMap, BTreeSet};

use rusqlite::{Connection, OptionalExtension, Row, params};
use serde_json::{Value, json};

use crate::chain::audit;
use crate::chain::fold::{ChainFault, Fold};
use crate::chain::invariants;
use crate::chain::row_images::{RowName, row_digest, rows_of};
use crate::database::columns::parsed;
use crate::terms::own_records::is_own;
use crate::terms::sqlite_error::sqlite_error;
use holdpoint_approvals::PersonActKind;
use holdpoint_audit::chain::Head;
use holdpoint_audit::profile_history::ProfileHistory;
use holdpoint_audit::recorded_approval::RecordedApproval;
use holdpoint_audit::witness::{WITNESSES_MAX, check_path};
use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::ids::{CapabilityId, Digest, canonical_json, is_name};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::notice::{Notice, NoticeOrText};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;
use holdpoint_store::{
    AUDIT_MAX, AuditBody, BODY_BYTES_MAX, CHANGES_MAX, Change, EvidenceKind, NOTICE_BYTES_MAX, Receipt,
    StoreError, TEXT_BYTES_MAX, Transaction,
};

/// The most alarms a store holds.
const ALARMS_MAX: u64 = 10_000;
/// The longest text that a record repeats, bytes. Longer texts (measurements) are stored once; a damaged row gets the
/// shorter ones back from the chain.
const TEXT_IN_RECORD_BYTES_MAX: usize = 16 << 10;
/// Fields of a change that hold texts.
const TEXTS: [&str; 6] = ["json", "manifest", "submission", "permissions", "environments", "signature"];
const COMMAND_ID_BYTES_MAX: usize = 128;

/// The data, beside the database, that an approval is checked against.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ApprovalBasis<'a> {
    pub(crate) store_id: &'a str,
    /// Its public key, 64 hexadecimal digits.
    pub(crate) store_key: &'a str,
}

/// A transaction being applied.
pub(crate) struct Applier<'a> {
    pub(crate) connection: &'a Connection,
    /// The chain's account of the rows before this transaction.
    fold: &'a Fold,
    /// Digests of the rows that this transaction wrote.
    written: BTreeMap<RowName, Digest>,
    pub(crate) at_ms: u64,
    wall_ms: i64,
    pub(crate) place: ApprovalBasis<'a>,
    pub(crate) head: Head,
    pub(crate) row_versions: Vec<(CapabilityId, u64)>,
    /// Row version of each version whose state was set, as it was before this transaction.
    pub(crate) row_versions_before: BTreeMap<String, u64>,
    /// The approvers whose approvals this transaction consumed, by key, because one key is one person.
    pub(crate) approved: BTreeMap<String, BTreeSet<String>>,
    /// Families whose invariants are checked before the commit.
    pub(crate) families: BTreeSet<String>,
}

/// The effect of a change: its record's kind and subject.
pub(crate) struct ChangeEffect {
    pub(crate) kind: RecordKind,
    pub(crate) subject: String,
}

impl ChangeEffect {
    pub(crate) fn new(kind: RecordKind, subject: impl ToString) -> Self {
        Self { kind, subject: subject.to_string() }
    }
}

/// The wall time of a transaction's records: never before that of the newest record, unless a person confirms the time.
fn wall_ms_after(connection: &Connection, seq: u64, transaction: &Transaction) -> Result<i64, StoreError> {
    if transaction.audit.iter().any(|body| body.kind == RecordKind::ClockConfirmed) {
        return Ok(transaction.wall_ms);
    }
    Ok(audit::wall_ms_of(connection, seq)?.unwrap_or(0).max(transaction.wall_ms))
}

/// The digest that distinguishes a retry from another command with the same id.
pub(crate) fn command_digest(transaction: &Transaction) -> Result<Digest, StoreError> {
    Digest::of_json("holdpoint/command/v1", &(&transaction.changes, &transaction.audit))
        .map_err(|error| StoreError::invalid("command", &transaction.command_id, error))
}

/// Applies a whole transaction; nothing is committed.
pub(crate) fn apply(
    connection: &Connection,
    transaction: &Transaction,
    place: ApprovalBasis<'_>,
    fold: &Fold,
) -> Result<(Receipt, Head), StoreError> {
    check_size(transaction)?;
    let digest = command_digest(transaction)?;
    let before = audit::head(connection).map_err(sqlite_error("read the audit chain"))?;
    if before != fold.end {
        let problem =
            format!("the audit chain ends at {}, this engine wrote up to {}", before.seq, fold.end.seq);
        return Err(StoreError::Altered(problem));
    }
    if let Some(receipt) = earlier_receipt(connection, transaction, digest)? {
        return Ok((receipt, before));
    }
    if transaction.at_ms < before.at_ms {
        return Err(StoreError::ClockBack { last_ms: before.at_ms, found_ms: transaction.at_ms });
    }
    let wall_ms = wall_ms_after(connection, before.seq, transaction)?;
    let mut applier = Applier::new(connection, fold, place, (transaction.at_ms, wall_ms), before);
    crate::fp!("begin");
    for change in &transaction.changes {
        let rows = rows_of(change, applier.next_seq());
        applier.check_before(&rows)?;
        let touched = applier.change(change)?;
        applier.record(&touched, change, rows)?;
    }
    for body in &transaction.audit {
        applier.caller_record(body)?;
    }
    for family in &applier.families {
        if let Some(violation) = invariants::check_family(connection, family)
            .map_err(sqlite_error("check its invariants"))?
            .into_iter()
            .next()
        {
            return Err(StoreError::Invariant(violation.to_string()));
        }
    }
    let written = applier.head.seq > before.seq;
    let receipt = Receipt {
        command_id: transaction.command_id.clone(),
        first_seq: if written { before.seq + 1 } else { 0 },
        last_seq: if written { applier.head.seq } else { 0 },
        head: applier.head.hash,
        row_versions: applier.row_versions,
    };
    // A transaction that wrote nothing may run again.
    if written {
        let text = canonical_json(&receipt)
            .map_err(|error| StoreError::invalid("receipt", &transaction.command_id, error))?;
        connection
            .prepare_cached("INSERT INTO command (id, digest, last_seq, receipt) VALUES (?1, ?2, ?3, ?4)")
            .and_then(|mut insert| {
                insert.execute(params![receipt.command_id, digest.to_string(), applier.head.seq, text])
            })
            .map_err(sqlite_error("keep the receipt"))?;
    }
    crate::fp!("before-commit");
    Ok((receipt, applier.head))
}

fn earlier_receipt(
    connection: &Connection,
    transaction: &Transaction,
    digest: Digest,
) -> Result<Option<Receipt>, StoreError> {
    let error = sqlite_error("look up the command");
    let found: Option<(String, String)> = connection
        .prepare_cached("SELECT digest, receipt FROM command WHERE id = ?1")
        .and_then(|mut select| {
            select.query_row([&transaction.command_id], |row| Ok((row.get(0)?, row.get(1)?))).optional()
        })
        .map_err(&error)?;
    let Some((stored, receipt)) = found else { return Ok(None) };
    let receipt: Receipt = serde_json::from_str(&receipt)
        .map_err(|source| StoreError::invalid("stored receipt", &transaction.command_id, source))?;
    if receipt.first_seq == 0 {
        // A receipt without a record proves nothing, because any program can write one; earlier versions wrote such
        // receipts.
        connection
            .prepare_cached("DELETE FROM command WHERE id = ?1")
            .and_then(|mut delete| delete.execute([&transaction.command_id]))
            .map_err(&error)?;
        return Ok(None);
    }
    if stored != digest.to_string() {
        return Err(StoreError::CommandReused(transaction.command_id.clone()));
    }
    Ok(Some(receipt))
}

fn check_size(transaction: &Transaction) -> Result<(), StoreError> {
    let id = &transaction.command_id;
    if id.is_empty() || id.len() > COMMAND_ID_BYTES_MAX || id.chars().any(char::is_control) {
        return Err(StoreError::invalid("command id", id, "1 to 128 bytes without control characters"));
    }
    if transaction.changes.len() > CHANGES_MAX || transaction.audit.len() > AUDIT_MAX {
        let size = format!("{} changes, {} records", transaction.changes.len(), transaction.audit.len());
        return Err(StoreError::invalid("transaction of", size, "at most 256 of each"));
    }
    Ok(())
}

/// A whole number in SQLite's form.
pub(crate) fn check_int(what: &'static str, value: u64) -> Result<(), StoreError> {
    i64::try_from(value).map(drop).map_err(|_| StoreError::invalid(what, value, "at most 2^63 - 1"))
}

/// JSON text of at most [`BODY_BYTES_MAX`].
pub(crate) fn check_json(what: &'static str, text: &str) -> Result<(), StoreError> {
    if text.len() > BODY_BYTES_MAX {
        return Err(StoreError::invalid(what, format!("of {} bytes", text.len()), "at most 4 MiB"));
    }
    match serde_json::from_str::<serde::de::IgnoredAny>(text) {
        Ok(_) => Ok(()),
        Err(error) => {
            let start: String = text.chars().take(80).collect();
            Err(StoreError::invalid(what, start, format!("it must be JSON ({error})")))
        }
    }
}

/// Free text of at most [`TEXT_BYTES_MAX`].
pub(crate) fn check_text(what: &'static str, text: &str) -> Result<(), StoreError> {
    if text.len() > TEXT_BYTES_MAX {
        return Err(StoreError::invalid(what, format!("of {} bytes", text.len()), "at most 4096 bytes"));
    }
    Ok(())
}

/// The reason of a change as a row has it: a notice as JSON text, an older text as it is.
pub(crate) fn checked_reason(reason: &NoticeOrText) -> Result<String, StoreError> {
    match reason {
        NoticeOrText::Text(text) => {
            check_text("reason", text)?;
            Ok(text.clone())
        }
        NoticeOrText::Notice(notice) => {
            let invalid = |found: String, allowed: &str| StoreError::invalid("reason", found, allowed);
            let json = serde_json::to_string(notice)
                .map_err(|error| invalid(error.to_string(), "a notice that can be written"))?;
            if json.len() > NOTICE_BYTES_MAX {
                return Err(invalid(format!("of {} bytes", json.len()), "at most 65536 bytes"));
            }
            Ok(json)
        }
    }
}

/// The reason in a row, as [`checked_reason`] wrote it.
pub(crate) fn read_reason(column: String) -> NoticeOrText {
    serde_json::from_str::<Notice>(&column).map_or(NoticeOrText::Text(column), NoticeOrText::from)
}

/// A name in the usual form.
pub(crate) fn check_name(what: &'static str, name: &str) -> Result<(), StoreError> {
    if is_name(name) {
        Ok(())
    } else {
        Err(StoreError::invalid(what, name, "a name: a-z, 0-9, '.', '_', '-'"))
    }
}

impl<'a> Applier<'a> {
    /// For the changes whose records follow this end of the chain.
    pub(crate) fn new(
        connection: &'a Connection,
        fold: &'a Fold,
        place: ApprovalBasis<'a>,
        (at_ms, wall_ms): (u64, i64),
        head: Head,
    ) -> Self {
        Self {
            connection,
            fold,
            written: BTreeMap::new(),
            at_ms,
            wall_ms,
            place,
            head,
            row_versions: Vec::new(),
            row_versions_before: BTreeMap::new(),
            approved: BTreeMap::new(),
            families: BTreeSet::new(),
        }
    }
}

impl Applier<'_> {
    /// Sequence number of the record of the change being applied.
    pub(crate) const fn next_seq(&self) -> u64 {
        self.head.seq + 1
    }

    /// The row version a decision before this transaction saw.
    pub(crate) fn row_version_before(&self, name: &str, now: u64) -> u64 {
        self.row_versions_before.get(name).copied().unwrap_or(now)
    }

    /// Distinct approvers of this version in this transaction.
    pub(crate) fn approved_by(&self, name: &str) -> usize {
        self.approved.get(name).map_or(0, BTreeSet::len)
    }

    pub(crate) fn execute(
        &self,
        what: &'static str,
        sql: &str,
        parameters: impl rusqlite::Params,
    ) -> Result<usize, StoreError> {
        self.connection
            .prepare_cached(sql)
            .and_then(|mut statement| statement.execute(parameters))
            .map_err(sqlite_error(what))
    }

    pub(crate) fn find<T>(
        &self,
        what: &'static str,
        sql: &str,
        parameters: impl rusqlite::Params,
        read: impl FnOnce(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Option<T>, StoreError> {
        self.connection
            .prepare_cached(sql)
            .and_then(|mut select| select.query_row(parameters, read).optional())
            .map_err(sqlite_error(what))
    }

    pub(crate) fn exists(
        &self,
        what: &'static str,
        sql: &str,
        parameters: impl rusqlite::Params,
    ) -> Result<bool, StoreError> {
        Ok(self.find(what, sql, parameters, |_| Ok(()))?.is_some())
    }

    /// Checks that the replaced rows are those of the chain: a row that another program changed is never taken over.
    fn check_before(&self, rows: &[RowName]) -> Result<(), StoreError> {
        for (table, key) in rows {
            let found = row_digest(self.connection, *table, key).map_err(sqlite_error("read a row back"))?;
            let written = self.written.get(&(*table, key.clone())).copied();
            let expected = written.or_else(|| self.fold.row(*table, key).map(|vouched| vouched.digest));
            if found != expected {
                let problem = match self.fold.row(*table, key) {
                    Some(vouched) => format!("it differs from record {}", vouched.seq),
                    None => "no record names it".to_owned(),
                };
                let fault = ChainFault::Row { table: table.name(), key: key.clone(), problem };
                return Err(StoreError::Altered(fault.to_string()));
            }
        }
        Ok(())
    }

    /// Appends the record of a change with the digests of the rows it touched.
    fn record(
        &mut self,
        touched: &ChangeEffect,
        change: &Change,
        changed: Vec<RowName>,
    ) -> Result<(), StoreError> {
        let mut rows = Vec::with_capacity(changed.len());
        for (table, key) in changed {
            let digest = row_digest(self.connection, table, &key).map_err(sqlite_error("read a row back"))?;
            let digest =
                digest.ok_or_else(|| StoreError::NotFound { what: table.name(), name: key.clone() })?;
            rows.push(json!([table.name(), key, digest]));
            self.written.insert((table, key), digest);
        }
        let body = json!({ "change": summary(change)?, "rows": rows });
        let body = canonical_json(&body)
            .map_err(|error| StoreError::invalid("record", touched.kind.name(), error))?;
        let times = (self.at_ms, self.wall_ms);
        self.head = audit::append(self.connection, times, touched.kind, &touched.subject, body)?;
        Ok(())
    }

    fn caller_record(&mut self, record: &AuditBody) -> Result<(), StoreError> {
        if is_own(record.kind) {
            return Err(StoreError::invalid(
                "kind of record",
                record.kind.name(),
                "one the store does not write itself",
            ));
        }
        check_text("subject of a record", &record.subject)?;
        check_json("body of a record", &record.body)?;
        let times = (self.at_ms, self.wall_ms);
        self.head = audit::append(self.connection, times, record.kind, &record.subject, record.body.clone())?;
        Ok(())
    }

    pub(crate) fn change(&mut self, change: &Change) -> Result<ChangeEffect, StoreError> {
        match change {
            Change::RegisterVersion(new) => self.register(new),
            Change::SetState { version, expected_row_version, from, to, reason } => {
                self.set_state(version, (*expected_row_version, *from), *to, reason)
            }
            Change::SetFlags { version, flags } => self.set_flags(version, *flags),
            Change::SetScores { version, kappas, signature } => {
                self.set_scores(version, kappas, signature.as_deref())
            }
            Change::SetActive { family, active, pinned, cause, robot } => {
                self.families.insert(family.to_string());
                self.check_robot(family, robot.as_deref())?;
                self.set_active(family, active.as_ref(), pinned.as_ref(), cause, robot.as_deref())
            }
            Change::SetFamily { family, safe_stopped, reason } => {
                self.families.insert(family.to_string());
                self.set_family(family, *safe_stopped, reason)
            }
            Change::SetStanding { family, json } => self.set_family_state(family, json),
            Change::VoidFamily { family, reason } => self.void_family(family, reason),
            Change::PutEvidence { version, kind, json, digest } => {
                self.put_evidence(version, *kind, json, *digest)
            }
            Change::PutApprovalRequest(request) => self.put_request(request),
            Change::EnrolPerson(signed) => self.person_act(signed, PersonActKind::Enrol),
            Change::ConfirmPerson(signed) => self.person_act(signed, PersonActKind::Confirm),
            Change::RevokePerson(signed) => self.person_act(signed, PersonActKind::Revoke),
            Change::PutApproval(signed) => self.put_approval(signed),
            Change::ConsumeApproval { nonce, evidence_digest, at } => {
                self.consume_approval(nonce, *evidence_digest, *at)
            }
            Change::SetContext { profile, policy_digest, json, rules } => {
                let Some(rules) = rules else {
                    return Err(StoreError::invalid("rules of a context", "none", "those of its profile"));
                };
                self.check_profile(*profile, rules)?;
                self.write_context(*profile, *policy_digest, json)
            }
            Change::AllowProfile { profile, by, act } => {
                check_json("caller", by)?;
                self.check_profile_act(*profile, act)?;
                Ok(ChangeEffect::new(RecordKind::ProfileAllowed, ""))
            }
            Change::SealTelemetry { .. }
            | Change::SealTelemetryBlock { .. }
            | Change::PruneTelemetry { .. }
            | Change::MissTelemetry { .. } => self.about_telemetry(change),
            Change::SetWitness { folder, present, by, act } => {
                check_json("caller", by)?;
                self.check_witness_act((folder, *present), act.as_deref())?;
                check_path(folder)?;
                let known = &self.fold.witnesses;
                if *present && known.len() >= WITNESSES_MAX && !known.contains(folder) {
                    let allowed = format!("at most {WITNESSES_MAX}");
                    return Err(StoreError::invalid("number of witnesses", known.len() + 1, allowed));
                }
                Ok(ChangeEffect::new(RecordKind::WitnessSet, ""))
            }
            Change::AlarmChange { alarm, subject, state, priority, json } => {
                self.alarm(alarm, subject, (*state, *priority), json)
            }
        }
    }

    /// The history of the store's profiles before this transaction.
    pub(crate) const fn profile_history(&self) -> &ProfileHistory {
        &self.fold.profiles
    }

    /// State and row version of an existing version.
    pub(crate) fn version(&self, version: &CapabilityId) -> Result<(State, u64), StoreError> {
        let name = version.to_string();
        self.find(
            "find a version",
            "SELECT state, row_version FROM version WHERE name = ?1",
            [&name],
            |row| Ok((parsed(row, 0)?, row.get(1)?)),
        )?
        .ok_or(StoreError::NotFound { what: "version", name })
    }

    fn put_evidence(
        &mut self,
        version: &CapabilityId,
        kind: EvidenceKind,
        json: &str,
        digest: Digest,
    ) -> Result<ChangeEffect, StoreError> {
        check_json("evidence", json)?;
        let (_, row_version) = self.version(version)?;
        let (profile, policy_digest, _) = self.context()?;
        let seq = self.next_seq();
        self.execute(
            "keep evidence",
            "INSERT INTO evidence (seq, version, kind, row_version, profile, policy_digest, digest, json, at_ms)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)",
            params![
                seq,
                version.to_string(),
                kind.name(),
                row_version,
                profile.name(),
                policy_digest,
                digest.to_string(),
                json,
                self.at_ms
            ],
        )?;
        Ok(ChangeEffect::new(RecordKind::EvidencePut, version))
    }

    /// Profile, policy digest and the record that set them.
    pub(crate) fn context(&self) -> Result<(ProfileName, String, u64), StoreError> {
        self.find(
            "read the context",
            "SELECT profile, policy_digest, seq FROM context WHERE id = 1",
            [],
            |row| Ok((parsed(row, 0)?, row.get(1)?, row.get(2)?)),
        )?
        .ok_or(StoreError::NotFound { what: "context (profile and policy)", name: "set it first".to_owned() })
    }

    pub(crate) fn write_context(
        &mut self,
        profile: ProfileName,
        policy_digest: Digest,
        json: &str,
    ) -> Result<ChangeEffect, StoreError> {
        check_json("context", json)?;
        self.execute(
            "set the context",
            "INSERT INTO context (id, profile, policy_digest, json, seq) VALUES (1, ?1, ?2, ?3, ?4)
             ON CONFLICT (id) DO UPDATE SET profile = ?1, policy_digest = ?2, json = ?3, seq = ?4",
            params![profile.name(), policy_digest.to_string(), json, self.next_seq()],
        )?;
        Ok(ChangeEffect::new(RecordKind::ContextSet, ""))
    }

    fn alarm(
        &mut self,
        alarm: &str,
        subject: &str,
        (state, priority): (AlarmState, Priority),
        json: &str,
    ) -> Result<ChangeEffect, StoreError> {
        check_json("alarm", json)?;
        for (what, text) in [("alarm", alarm), ("subject", subject)] {
            check_text(what, text)?;
        }
        let count: Option<u64> =
            self.find("count alarms", "SELECT count(*) FROM alarm", [], |row| row.get(0))?;
        if count.unwrap_or(0) >= ALARMS_MAX
            && !self.exists("find an alarm", "SELECT 1 FROM alarm WHERE id = ?1", [alarm])?
        {
            return Err(StoreError::invalid(
                "number of alarms",
                ALARMS_MAX,
                "no more than that in one store",
            ));
        }
        self.execute(
            "keep an alarm",
            "INSERT INTO alarm (id, subject, state, priority, json, changed_ms) VALUES (?1, ?2, ?3, ?4, ?5, ?6)
             ON CONFLICT (id) DO UPDATE SET subject = ?2, state = ?3, priority = ?4, json = ?5, changed_ms = ?6",
            params![alarm, subject, state.name(), priority.name(), json, self.at_ms],
        )?;
        Ok(ChangeEffect::new(RecordKind::AlarmChanged, subject))
    }
}

/// The change in its record's form: without long texts, which its rows' digests cover.
fn summary(change: &Change) -> Result<Value, StoreError> {
    let value = if let Change::PutApproval(signed) = change {
        serde_json::to_value(RecordedApproval::of(signed.approval()))
    } else {
        serde_json::to_value(change)
    };
    let mut value = value.map_err(|error| StoreError::invalid("change", "", error))?;
    if let Some(fields) = value.as_object_mut() {
        for text in TEXTS {
            if fields
                .get(text)
                .and_then(Value::as_str)
                .is_some_and(|text| text.len() > TEXT_IN_RECORD_BYTES_MAX)
            {
                fields.remove(text);
            }
        }
    }
    Ok(value)
}
