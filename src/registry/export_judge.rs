//! What is judged of an exported history: what another verifier can judge by the file alone, in the order in which the guide's
//! page on records has it.

use std::collections::{BTreeMap, BTreeSet};

use ed25519_dalek::VerifyingKey;

use super::approve::ApprovalOnRecord;
use super::audit::Head;
use super::checkpoint::{Checkpoint, Kept, check_links, check_newest};
use super::copies::HEADS_MAX;
use super::export_body::{self, ProfileOnRecord, Said};
use super::export_line::{ExportHeader, ExportLine};
use super::fold::START;
use super::loosened::ProfileCourse;
use super::merkle::Frontier;
use super::shown::ShownOnRecords;
use super::unsound::VerifyError;
use super::words::guarded;
use holdpoint_approvals::keyfile::hex;
use holdpoint_approvals::{
    PersonActKind, PersonError, PersonState, Persons, SignedApproval, SignedPersonAct,
};
use holdpoint_governance::approval::Role;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::{AuditRecord, RecordKind};

/// A word on record that does not hold, and whose it is to be.
fn bad_word(by: &str, error: &PersonError) -> VerifyError {
    VerifyError::Person { name: by.to_owned(), problem: error.to_string() }
}

/// What was read of a file. Its records are let go once they were looked at.
pub(super) struct Exported {
    pub(super) heads: Vec<Kept>,
    pub(super) signed_end: Option<Checkpoint>,
    pub(super) end: Head,
    pub(super) tree: Frontier,
    /// Records that a head speaks of.
    spoken_of: BTreeSet<u64>,
    /// Their hash, the tree's root and their wall time.
    seen: BTreeMap<u64, (Digest, Digest, i64)>,
    /// The approvals on record, by their nonces.
    put: BTreeMap<String, Put>,
    /// Nonces of those that a rebuild gave up.
    lost: BTreeSet<String>,
    pub(super) approvals: Vec<SignedApproval>,
    pub(super) persons: Persons,
    course: ProfileCourse,
    shown: ShownOnRecords,
}

/// What a record tells of an approval.
struct Put {
    /// The key of who gave it; none before anybody was enrolled.
    key: Option<String>,
    /// Digest of all that the record tells.
    told: Digest,
}

impl Put {
    /// The digest of what a record with this subject tells.
    fn told(subject: &str, change: &ApprovalOnRecord) -> Result<Digest, serde_json::Error> {
        Digest::of_json("approval on record", &(subject, change))
    }
}

impl Exported {
    pub(super) fn of(store_id: &str) -> Self {
        Self {
            persons: Persons::none(store_id),
            heads: Vec::new(),
            signed_end: None,
            end: START,
            tree: Frontier::empty(),
            spoken_of: BTreeSet::new(),
            seen: BTreeMap::new(),
            put: BTreeMap::new(),
            lost: BTreeSet::new(),
            approvals: Vec::new(),
            course: ProfileCourse::default(),
            shown: ShownOnRecords::default(),
        }
    }

    pub(super) fn take(&mut self, line: ExportLine, number: u64) -> Result<(), VerifyError> {
        let bad = |problem: String| VerifyError::Line { line: number, problem };
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
                self.spoken_of.insert(checkpoint.seq);
                self.heads.push(Kept { file: format!("line {number}"), checkpoint });
                Ok(())
            }
            ExportLine::End(end) => {
                self.spoken_of.insert(end.seq);
                self.signed_end = Some(end);
                Ok(())
            }
            ExportLine::Record(_) if !self.approvals.is_empty() => Err(misplaced()),
            ExportLine::Record(record) => self.take_record(&(*record).into()),
            // One more than there can be: it is there twice, or no record speaks of it.
            ExportLine::Approval(_) if self.approvals.len() > self.put.len() => {
                Err(bad("it is one approval more than records speak of".to_owned()))
            }
            ExportLine::Approval(signed) => {
                self.approvals.push(*signed);
                Ok(())
            }
        }
    }

    fn take_record(&mut self, record: &AuditRecord) -> Result<(), VerifyError> {
        let seq = self.end.seq + 1;
        let bad = |problem: &str| VerifyError::Record { seq, problem: problem.to_owned() };
        if record.seq != seq {
            return Err(bad(&format!("it is missing; the next one is {}", record.seq)));
        }
        if record.prev != self.end.hash {
            return Err(bad("it does not follow from the record before"));
        }
        if record.hash != record.expected_hash() {
            return Err(bad("its content does not match its hash"));
        }
        if record.at_ms < self.end.at_ms {
            return Err(bad("it is older than the record before"));
        }
        self.shown
            .take(record.kind.known().copied(), &record.subject, &record.body)
            .map_err(|problem| bad(&format!("its body is not of its form: {problem}")))?;
        let said = export_body::read(record.kind.known(), &record.body)
            .map_err(|problem| bad(&format!("its body is not of its form: {problem}")))?;
        match said {
            Said::Put(change) => self.take_put(record, change)?,
            Said::Act { change, signed } => self.take_act(record, &change, &signed)?,
            Said::Witness(witness) => {
                if let Some(act) = &witness.act {
                    let of = (witness.folder.as_str(), witness.present);
                    let judged = act.judge(&self.persons, of, record.prev);
                    judged.map_err(|error| bad_word(&act.act().by, &error))?;
                }
            }
            Said::Profile(ProfileOnRecord { profile, act, .. }) => {
                let judged = act.judge(&self.persons, profile, record.prev);
                judged
                    .and_then(|()| guarded(&act, &self.persons, self.course.last().map(|last| last.class)))
                    .map_err(|error| bad_word(&act.act().by, &error))?;
                self.course.allow(seq, profile, act.act().rules.clone());
            }
            Said::Context(set) => {
                let set = self.course.set(seq, set.profile, set.looser_by_word, set.rules);
                set.map_err(|problem| bad(&problem))?;
            }
            Said::Lost(nonces) => self.lost.extend(nonces),
            Said::Nothing => {}
        }
        self.end = Head { seq, hash: record.hash, at_ms: record.at_ms };
        self.tree.push(&record.hash);
        if self.spoken_of.contains(&seq) {
            self.seen.insert(seq, (record.hash, self.tree.root(), record.wall_ms));
        }
        Ok(())
    }

    fn take_put(&mut self, record: &AuditRecord, change: ApprovalOnRecord) -> Result<(), VerifyError> {
        let nonce = change.nonce().to_string();
        let bad = |problem: &str| VerifyError::Approval { nonce: nonce.clone(), problem: problem.to_owned() };
        if self.put.contains_key(&nonce) {
            return Err(bad("two records speak of it"));
        }
        let key = self.key_of(change.who(), change.role()).map_err(bad)?;
        let told = Put::told(&record.subject, &change).map_err(|error| bad(&error.to_string()))?;
        self.put.insert(nonce, Put { key, told });
        Ok(())
    }

    /// The key of somebody who is enrolled in this role as the records stand so far; none before anybody was enrolled.
    fn key_of(&self, who: &str, role: Role) -> Result<Option<String>, &'static str> {
        if self.persons.is_empty() {
            return Ok(None);
        }
        let person = self.persons.named(who).filter(|person| person.state == PersonState::Enrolled);
        let person = person.ok_or("whoever gave it was not enrolled then")?;
        if person.role != role {
            return Err("whoever gave it has another role");
        }
        Ok(Some(hex(person.public_key.as_bytes())))
    }

    /// The act is allowed as the records stand so far, and is what the record is said to be.
    fn take_act(
        &mut self,
        record: &AuditRecord,
        change: &str,
        signed: &SignedPersonAct,
    ) -> Result<(), VerifyError> {
        let act = signed.act();
        let (kind, called) = match act.act {
            PersonActKind::Enrol => (RecordKind::PersonEnrolled, "enrol-person"),
            PersonActKind::Confirm => (RecordKind::PersonConfirmed, "confirm-person"),
            PersonActKind::Revoke => (RecordKind::PersonRevoked, "revoke-person"),
        };
        let bad = |problem: String| VerifyError::Person { name: act.name.clone(), problem };
        if record.kind != kind || change != called || record.subject != act.name {
            return Err(bad("the act is not what was recorded".to_owned()));
        }
        self.persons.push(signed).map_err(|error| bad(error.to_string()))
    }

    pub(super) fn check(&self, header: &ExportHeader, key: &VerifyingKey) -> Result<(), VerifyError> {
        if self.end.seq != header.records {
            let problem = format!("it is missing; the file is said to have {}", header.records);
            return Err(VerifyError::Record { seq: self.end.seq + 1, problem });
        }
        for Kept { file, checkpoint } in &self.heads {
            self.check_head(checkpoint, &header.store_id, key)
                .map_err(|problem| VerifyError::Checkpoint { file: file.clone(), problem })?;
        }
        let unsigned = VerifyError::Unsigned;
        match &self.signed_end {
            Some(end) => {
                self.check_head(end, &header.store_id, key).map_err(unsigned)?;
                if end.seq != self.end.seq {
                    return Err(unsigned(format!("nobody signed the records after {}", end.seq)));
                }
            }
            None if self.end.seq == 0 => {}
            None => {
                return Err(unsigned(format!(
                    "nobody signed where the audit chain ends, at record {}",
                    self.end.seq
                )));
            }
        }
        let gap = self.signed_end.as_ref().and_then(|end| end.link.as_ref()).is_some_and(|link| link.gap);
        if !gap {
            check_links(&self.heads)
                .map_err(|bad| VerifyError::Checkpoint { file: bad.file, problem: bad.problem })?;
            if let Some(end) = &self.signed_end {
                check_newest(end, &self.heads).map_err(unsigned)?;
            }
        }
        self.check_approvals(&header.store_id, &hex(key.as_bytes()))
    }

    fn check_head(&self, checkpoint: &Checkpoint, store_id: &str, key: &VerifyingKey) -> Result<(), String> {
        if checkpoint.store_id != store_id {
            return Err(format!("it belongs to the store {:?}", checkpoint.store_id));
        }
        if !checkpoint.is_signed_by(key) {
            return Err("its signature does not match the public key".to_owned());
        }
        match self.seen.get(&checkpoint.seq) {
            Some((hash, ..)) if *hash != checkpoint.head => {
                Err("its record is another one: history was rewritten".to_owned())
            }
            Some((_, root, _)) if checkpoint.root.is_some_and(|signed| signed != *root) => {
                Err("its tree head is not the one of these records".to_owned())
            }
            Some((_, _, wall_ms)) if checkpoint.wall_ms.is_some_and(|signed| signed != *wall_ms) => {
                Err("its wall time is not the one of its record".to_owned())
            }
            Some(_) => Ok(()),
            None if checkpoint.seq == 0 => Ok(()),
            None => Err(format!("its record {} is missing", checkpoint.seq)),
        }
    }

    fn check_approvals(&self, store_id: &str, store_key: &str) -> Result<(), VerifyError> {
        let mut found = BTreeSet::new();
        for signed in &self.approvals {
            let nonce = signed.approval().nonce.as_str();
            let bad = |problem: &str| VerifyError::Approval {
                nonce: nonce.to_owned(),
                problem: problem.to_owned(),
            };
            if signed.verify_signature().is_err() {
                return Err(bad("its signature does not match the decision"));
            }
            if signed.approval().store_id != store_id {
                return Err(bad("it was made for another store"));
            }
            let Some(Put { key, told }) = self.put.get(nonce) else {
                return Err(bad("no record speaks of it"));
            };
            if key.as_deref().is_some_and(|key| key != signed.public_key()) {
                return Err(bad("it was signed with another key than that of who gave it"));
            }
            let tells = ApprovalOnRecord::of(signed.approval());
            let tells = Put::told(&signed.approval().version.to_string(), &tells);
            if tells.map_err(|error| bad(&error.to_string()))? != *told {
                return Err(bad("it is not what its record tells of it"));
            }
            self.shown.check(signed.approval(), Some(store_key)).map_err(|problem| bad(&problem))?;
            if !found.insert(nonce) {
                return Err(bad("it is there twice"));
            }
        }
        match self.put.keys().find(|put| !found.contains(put.as_str()) && !self.lost.contains(*put)) {
            None => Ok(()),
            Some(nonce) => {
                Err(VerifyError::Approval { nonce: nonce.clone(), problem: "it is missing".to_owned() })
            }
        }
    }
}
