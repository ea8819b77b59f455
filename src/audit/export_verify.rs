//! The checks of an exported history: those that another verifier can make from the file alone, in the order of the
//! guide's page on records.

use std::collections::{BTreeMap, BTreeSet};

use ed25519_dalek::VerifyingKey;

use super::chain::Head;
use super::checkpoint::{Checkpoint, StoredCheckpoint, check_links, check_newest};
use super::display_records::DisplayRecords;
use super::export_body::{self, ExportedProfileAct, RecordStatement};
use super::export_line::{ExportHeader, ExportLine};
use super::head_copies::HEADS_MAX;
use super::history_error::HistoryError;
use super::merkle::Frontier;
use super::profile_history::{ProfileHistory, check_key_guarded};
use super::recorded_approval::RecordedApproval;
use holdpoint_approvals::{
    PersonActKind, PersonDirectory, PersonError, PersonState, SignedApproval, SignedPersonAct,
};
use holdpoint_governance::approval::Role;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_text::hex::hex;

/// An invalid authorization on record, and its claimed signer.
fn bad_authorization(by: &str, error: &PersonError) -> HistoryError {
    HistoryError::Person { name: by.to_owned(), problem: error.to_string() }
}

/// The content of a file. Records are dropped after their check.
pub(crate) struct ExportedChain {
    pub(crate) heads: Vec<StoredCheckpoint>,
    pub(crate) signed_end: Option<Checkpoint>,
    pub(crate) end: Head,
    pub(crate) tree: Frontier,
    /// Records that a head refers to.
    head_seqs: BTreeSet<u64>,
    /// Their hash, the tree's root and their wall time.
    seen: BTreeMap<u64, (Digest, Digest, i64)>,
    /// The approvals on record, by their nonces.
    approval_facts: BTreeMap<String, StoredApprovalFacts>,
    /// Nonces that a rebuild gave up.
    lost: BTreeSet<String>,
    pub(crate) approvals: Vec<SignedApproval>,
    pub(crate) persons: PersonDirectory,
    history: ProfileHistory,
    shown: DisplayRecords,
}

struct StoredApprovalFacts {
    /// The approver's key; none before a person was enrolled.
    key: Option<String>,
    /// Digest of the record's content.
    digest: Digest,
}

impl StoredApprovalFacts {
    /// The digest of what a record with this subject tells.
    fn statement_digest(subject: &str, change: &RecordedApproval) -> Result<Digest, serde_json::Error> {
        Digest::of_json("approval on record", &(subject, change))
    }
}

impl ExportedChain {
    pub(crate) fn of(store_id: &str) -> Self {
        Self {
            persons: PersonDirectory::none(store_id),
            heads: Vec::new(),
            signed_end: None,
            end: Head::START,
            tree: Frontier::empty(),
            head_seqs: BTreeSet::new(),
            seen: BTreeMap::new(),
            approval_facts: BTreeMap::new(),
            lost: BTreeSet::new(),
            approvals: Vec::new(),
            history: ProfileHistory::default(),
            shown: DisplayRecords::default(),
        }
    }

    pub(crate) fn take(&mut self, line: ExportLine, number: u64) -> Result<(), HistoryError> {
        let bad = |problem: String| HistoryError::Line { line: number, problem };
        let misplaced = || bad("it does not belong here".to_owned());
        match line {
            ExportLine::Export(_) => Err(misplaced()),
            ExportLine::Head(_) | ExportLine::End(_) if self.end.seq > 0 || self.signed_end.is_some() => {
                Err(misplaced())
            }
            ExportLine::Head(_) if self.heads.len() >= HEADS_MAX => {
                Err(bad(format!("it is one checkpoint more than {HEADS_MAX}, and so many are allowed")))
            }
            ExportLine::Head(checkpoint) => {
                self.head_seqs.insert(checkpoint.seq);
                self.heads.push(StoredCheckpoint { file: format!("line {number}"), checkpoint });
                Ok(())
            }
            ExportLine::End(end) => {
                self.head_seqs.insert(end.seq);
                self.signed_end = Some(end);
                Ok(())
            }
            ExportLine::Record(_) if !self.approvals.is_empty() => Err(misplaced()),
            ExportLine::Record(record) => self.take_record(&(*record).into()),
            // It is one too many: a duplicate, or no record names it.
            ExportLine::Approval(_) if self.approvals.len() > self.approval_facts.len() => {
                Err(bad("no record names this further approval".to_owned()))
            }
            ExportLine::Approval(signed) => {
                self.approvals.push(*signed);
                Ok(())
            }
        }
    }

    fn take_record(&mut self, record: &AuditRecord) -> Result<(), HistoryError> {
        let seq = self.end.seq + 1;
        let bad = |problem: &str| HistoryError::Record { seq, problem: problem.to_owned() };
        let end = self.end.with_record(&record.hashed()).map_err(|problem| bad(&problem))?;
        self.shown
            .take(record.kind.known().copied(), &record.subject, &record.body)
            .map_err(|problem| bad(&format!("its body is not of its form: {problem}")))?;
        let statement = export_body::read(record.kind.known(), &record.body)
            .map_err(|problem| bad(&format!("its body is not of its form: {problem}")))?;
        match statement {
            RecordStatement::Put(change) => self.take_approval(record, change)?,
            RecordStatement::Act { change, signed } => self.take_act(record, &change, &signed)?,
            RecordStatement::Witness(witness) => {
                if let Some(act) = &witness.act {
                    let of = (witness.folder.as_str(), witness.present);
                    let judged = act.judge(&self.persons, of, record.prev);
                    judged.map_err(|error| bad_authorization(&act.act().by, &error))?;
                }
            }
            RecordStatement::Profile(ExportedProfileAct { profile, act, .. }) => {
                let judged = act.judge(&self.persons, profile, record.prev);
                judged
                    .and_then(|()| {
                        check_key_guarded(&act, &self.persons, self.history.last().map(|last| last.class))
                    })
                    .map_err(|error| bad_authorization(&act.act().by, &error))?;
                self.history.allow(seq, profile, act.act().rules.clone());
            }
            RecordStatement::Context(context) => {
                let result = self.history.set(seq, context.profile, context.looser_by_word, context.rules);
                result.map_err(|problem| bad(&problem))?;
            }
            RecordStatement::Lost(nonces) => self.lost.extend(nonces),
            RecordStatement::Nothing => {}
        }
        self.end = end;
        self.tree.push(&record.hash);
        if self.head_seqs.contains(&seq) {
            self.seen.insert(seq, (record.hash, self.tree.root(), record.wall_ms));
        }
        Ok(())
    }

    fn take_approval(&mut self, record: &AuditRecord, change: RecordedApproval) -> Result<(), HistoryError> {
        let nonce = change.nonce.to_string();
        let bad =
            |problem: &str| HistoryError::Approval { nonce: nonce.clone(), problem: problem.to_owned() };
        if self.approval_facts.contains_key(&nonce) {
            return Err(bad("two records name it"));
        }
        let key = self.key_of(&change.who, change.role).map_err(bad)?;
        let digest = StoredApprovalFacts::statement_digest(&record.subject, &change)
            .map_err(|error| bad(&error.to_string()))?;
        self.approval_facts.insert(nonce, StoredApprovalFacts { key, digest });
        Ok(())
    }

    /// The key of a person enrolled in this role in the records so far; none before a person was enrolled.
    fn key_of(&self, who: &str, role: Role) -> Result<Option<String>, &'static str> {
        if self.persons.is_empty() {
            return Ok(None);
        }
        let person = self.persons.named(who).filter(|person| person.state == PersonState::Enrolled);
        let person = person.ok_or("its approver was not enrolled then")?;
        if person.role != role {
            return Err("its approver has another role");
        }
        Ok(Some(hex(person.public_key.as_bytes())))
    }

    /// The act is allowed by the records so far, and matches the kind of its record.
    fn take_act(
        &mut self,
        record: &AuditRecord,
        change: &str,
        signed: &SignedPersonAct,
    ) -> Result<(), HistoryError> {
        let act = signed.act();
        let (kind, change_name) = match act.act {
            PersonActKind::Enrol => (RecordKind::PersonEnrolled, "enrol-person"),
            PersonActKind::Confirm => (RecordKind::PersonConfirmed, "confirm-person"),
            PersonActKind::Revoke => (RecordKind::PersonRevoked, "revoke-person"),
        };
        let bad = |problem: String| HistoryError::Person { name: act.name.clone(), problem };
        if record.kind != kind || change != change_name || record.subject != act.name {
            return Err(bad("the act differs from its record".to_owned()));
        }
        self.persons.push(signed).map_err(|error| bad(error.to_string()))
    }

    pub(crate) fn check(&self, header: &ExportHeader, key: &VerifyingKey) -> Result<(), HistoryError> {
        if self.end.seq != header.records {
            let problem = format!("it is missing; the first line names {} records", header.records);
            return Err(HistoryError::Record { seq: self.end.seq + 1, problem });
        }
        for StoredCheckpoint { file, checkpoint } in &self.heads {
            self.check_head(checkpoint, &header.store_id, key)
                .map_err(|problem| HistoryError::Checkpoint { file: file.clone(), problem })?;
        }
        let unsigned = HistoryError::Unsigned;
        match &self.signed_end {
            Some(end) => {
                self.check_head(end, &header.store_id, key).map_err(unsigned)?;
                if end.seq != self.end.seq {
                    return Err(unsigned(format!("no signature covers the records after {}", end.seq)));
                }
            }
            None if self.end.seq == 0 => {}
            None => {
                return Err(unsigned(format!(
                    "no signature covers the end of the audit chain, record {}",
                    self.end.seq
                )));
            }
        }
        let gap = self.signed_end.as_ref().and_then(|end| end.link.as_ref()).is_some_and(|link| link.gap);
        if !gap {
            check_links(&self.heads)
                .map_err(|bad| HistoryError::Checkpoint { file: bad.file, problem: bad.problem })?;
            if let Some(end) = &self.signed_end {
                check_newest(end, &self.heads).map_err(unsigned)?;
            }
        }
        self.check_approvals(&header.store_id, &hex(key.as_bytes()))
    }

    fn check_head(&self, checkpoint: &Checkpoint, store_id: &str, key: &VerifyingKey) -> Result<(), String> {
        checkpoint.check_origin(store_id, Some(key))?;
        match self.seen.get(&checkpoint.seq) {
            Some((hash, ..)) if *hash != checkpoint.head => {
                Err("its record is another one: history was rewritten".to_owned())
            }
            Some((_, root, wall_ms)) => checkpoint.check_record(Some(*root), Some(*wall_ms)),
            None if checkpoint.seq == 0 => Ok(()),
            None => Err(format!("its record {} is missing", checkpoint.seq)),
        }
    }

    fn check_approvals(&self, store_id: &str, store_key: &str) -> Result<(), HistoryError> {
        let mut found = BTreeSet::new();
        for signed in &self.approvals {
            let nonce = signed.approval().nonce.as_str();
            let bad = |problem: &str| HistoryError::Approval {
                nonce: nonce.to_owned(),
                problem: problem.to_owned(),
            };
            if signed.verify_signature().is_err() {
                return Err(bad("its signature does not match the decision"));
            }
            if signed.approval().store_id != store_id {
                return Err(bad("it was made for another store"));
            }
            let Some(StoredApprovalFacts { key, digest }) = self.approval_facts.get(nonce) else {
                return Err(bad("no record names it"));
            };
            if key.as_deref().is_some_and(|key| key != signed.public_key()) {
                return Err(bad("it was signed with another key than its approver's"));
            }
            let change = RecordedApproval::of(signed.approval());
            let computed =
                StoredApprovalFacts::statement_digest(&signed.approval().version.to_string(), &change);
            if computed.map_err(|error| bad(&error.to_string()))? != *digest {
                return Err(bad("it differs from its record"));
            }
            self.shown.check(signed.approval(), Some(store_key)).map_err(|problem| bad(&problem))?;
            if !found.insert(nonce) {
                return Err(bad("it is there twice"));
            }
        }
        match self
            .approval_facts
            .keys()
            .find(|put| !found.contains(put.as_str()) && !self.lost.contains(*put))
        {
            None => Ok(()),
            Some(nonce) => {
                Err(HistoryError::Approval { nonce: nonce.clone(), problem: "it is missing".to_owned() })
            }
        }
    }
}
