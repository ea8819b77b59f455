//! Re-checks the text shown to approvers: the lines and facts on record are the signed ones, and the facts match the
//! records before them.
//!
//! Earlier versions stored unsigned screen text; their records are not checked.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::export_body::{typed, value_of};
use holdpoint_approvals::{Approval, SignedFacts, facts_digest, lines_digest};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::RecordKind;

/// The body of a record of a displayed text.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct DisplayRecord {
    /// The approver.
    by: String,
    /// Canonical JSON of the facts.
    facts: String,
    lines: Vec<String>,
    nonce: String,
}

/// The displayed text, as far as decisions are compared with it.
#[derive(Debug)]
struct DisplayedForm {
    lines: Digest,
    facts: Digest,
    bound: SignedFacts,
}

/// The part of a version's registration that is looked at.
#[derive(Deserialize)]
struct RegisteredDigest {
    candidate_digest: Digest,
}

/// The checked part of a request's record.
#[derive(Debug, Deserialize, PartialEq)]
struct RequestedApproval {
    id: String,
    row_version: u64,
    evidence_digest: Digest,
    policy_digest: Digest,
    needed: u32,
}

#[derive(Deserialize)]
struct ChangeField<C> {
    change: C,
}

/// The records so far about versions, requests and displayed texts.
#[derive(Debug, Default)]
pub struct DisplayRecords {
    registered: BTreeMap<String, Digest>,
    requests: BTreeMap<String, (String, RequestedApproval)>,
    shown: BTreeMap<String, DisplayedForm>,
}

impl DisplayRecords {
    /// The kinds of records that [`Self::take`] reads.
    pub const KINDS: [RecordKind; 3] =
        [RecordKind::VersionRegistered, RecordKind::ApprovalRequested, RecordKind::Shown];

    /// Reads a record of any kind.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn take(&mut self, kind: Option<RecordKind>, subject: &str, body: &str) -> Result<(), String> {
        match kind {
            // Records of earlier versions must only not contradict anything.
            Some(RecordKind::VersionRegistered) => {
                if let Ok(ChangeField::<RegisteredDigest> { change }) = serde_json::from_str(body) {
                    self.registered.insert(subject.to_owned(), change.candidate_digest);
                }
                Ok(())
            }
            Some(RecordKind::ApprovalRequested) => {
                if let Ok(ChangeField::<RequestedApproval> { change }) = serde_json::from_str(body) {
                    self.requests.insert(change.id.clone(), (subject.to_owned(), change));
                }
                Ok(())
            }
            Some(RecordKind::Shown) => self.take_shown(subject, body),
            Some(_) | None => Ok(()),
        }
    }

    fn take_shown(&mut self, subject: &str, body: &str) -> Result<(), String> {
        let value = value_of(body)?;
        if value.get("text").is_some() {
            return Ok(());
        }
        let DisplayRecord { by, facts, lines, nonce } = typed(value)?;
        let bound = SignedFacts::read(&facts).map_err(|error| error.to_string())?;
        let differs =
            |what: &str| Err(format!("the displayed text differs in {what} from the records before it"));
        if bound.asked.name != by || bound.version.to_string() != subject {
            return Err("the displayed text belongs to another person or version".to_owned());
        }
        if self.registered.get(subject) != Some(&bound.candidate) {
            return differs("the candidate");
        }
        // Break-glass has no approval request.
        if !bound.is_emergency() {
            let request = RequestedApproval {
                id: bound.question.clone(),
                row_version: bound.row_version,
                evidence_digest: bound.evidence,
                policy_digest: bound.policy,
                needed: bound.needed,
            };
            if self.requests.get(&bound.question) != Some(&(subject.to_owned(), request)) {
                return differs("the question");
            }
        }
        let form = DisplayedForm { lines: lines_digest(&lines), facts: facts_digest(&facts), bound };
        match self.shown.insert(nonce, form) {
            None => Ok(()),
            Some(_) => Err("the displayed text of this decision is on record already".to_owned()),
        }
    }

    /// Whether a decision covers the displayed text on record; decisions of earlier versions, and refusals by name,
    /// cover none.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn check(&self, approval: &Approval, store_key: Option<&str>) -> Result<(), String> {
        let stored = self.shown.get(approval.nonce.as_str());
        let Some(shown) = &approval.shown else {
            return stored.map_or(Ok(()), |_| Err("it was signed over nothing that was shown".to_owned()));
        };
        if store_key.is_some_and(|key| key != shown.store_key) {
            return Err("it was signed for a store with another key".to_owned());
        }
        let stored = stored.ok_or("no record has its displayed text")?;
        if stored.lines != shown.lines {
            return Err("the lines on record are not those that it was signed over".to_owned());
        }
        if stored.facts != shown.facts {
            return Err("the facts on record are not those that it was signed over".to_owned());
        }
        stored.bound.agree(approval).map_err(|what| format!("its facts differ in {what}"))
    }
}
