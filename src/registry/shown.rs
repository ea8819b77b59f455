//! What people were shown, looked at again: the lines and facts on record are those that were signed, and the facts are what
//! the records before them say.
//!
//! Earlier versions kept the text of a screen, which nobody signed; their records are left as they are.

use std::collections::BTreeMap;

use rusqlite::Connection;
use serde::{Deserialize, Serialize};

use super::export_body::{typed, value_of};
use holdpoint_approvals::{Approval, BoundFacts, facts_digest, lines_digest};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::RecordKind;

/// The body of a record of what somebody was shown.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShownOnRecord {
    /// Who decided.
    by: String,
    /// Canonical JSON of the facts.
    facts: String,
    lines: Vec<String>,
    /// Nonce of the decision.
    nonce: String,
}

/// What was shown, as far as decisions are held against it.
struct Kept {
    lines: Digest,
    facts: Digest,
    bound: BoundFacts,
}

/// The part of a version's registration that is looked at.
#[derive(Deserialize)]
struct Registration {
    candidate_digest: Digest,
}

/// The part of a question's record that is looked at.
#[derive(Deserialize, PartialEq)]
struct Asked {
    id: String,
    row_version: u64,
    evidence_digest: Digest,
    policy_digest: Digest,
    needed: u32,
}

#[derive(Deserialize)]
struct Body<C> {
    change: C,
}

/// The kinds of records that are read here.
const KINDS: [RecordKind; 3] =
    [RecordKind::VersionRegistered, RecordKind::ApprovalRequested, RecordKind::Shown];

/// What the records tell so far of versions, questions, and what was shown of them.
#[derive(Default)]
pub(super) struct ShownOnRecords {
    registered: BTreeMap<String, Digest>,
    asked: BTreeMap<String, (String, Asked)>,
    shown: BTreeMap<String, Kept>,
}

impl ShownOnRecords {
    /// Reads those of a whole store.
    ///
    /// # Errors
    /// If the store cannot be read; then the first record that is bad.
    pub(super) fn read(connection: &Connection) -> rusqlite::Result<Result<Self, (u64, String)>> {
        let mut select = connection
            .prepare("SELECT seq, kind, subject, body FROM audit WHERE kind IN (?1, ?2, ?3) ORDER BY seq")?;
        let mut rows = select.query(KINDS.map(RecordKind::name))?;
        let mut read = Self::default();
        while let Some(row) = rows.next()? {
            let (seq, kind): (u64, String) = (row.get(0)?, row.get(1)?);
            let (subject, body): (String, String) = (row.get(2)?, row.get(3)?);
            let kind = KINDS.into_iter().find(|known| known.name() == kind);
            if let Err(problem) = read.take(kind, &subject, &body) {
                return Ok(Err((seq, problem)));
            }
        }
        Ok(Ok(read))
    }

    /// Takes in a record of any kind.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(super) fn take(&mut self, kind: Option<RecordKind>, subject: &str, body: &str) -> Result<(), String> {
        match kind {
            // Of what earlier versions wrote no more is asked than that nothing speaks against it.
            Some(RecordKind::VersionRegistered) => {
                if let Ok(Body::<Registration> { change }) = serde_json::from_str(body) {
                    self.registered.insert(subject.to_owned(), change.candidate_digest);
                }
                Ok(())
            }
            Some(RecordKind::ApprovalRequested) => {
                if let Ok(Body::<Asked> { change }) = serde_json::from_str(body) {
                    self.asked.insert(change.id.clone(), (subject.to_owned(), change));
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
        let ShownOnRecord { by, facts, lines, nonce } = typed(value)?;
        let bound = BoundFacts::read(&facts).map_err(|error| error.to_string())?;
        let told =
            |what: &str| Err(format!("what was shown says otherwise of {what} than the records before it"));
        if bound.asked.name != by || bound.version.to_string() != subject {
            return Err("what was shown is another person's, or of another version".to_owned());
        }
        if self.registered.get(subject) != Some(&bound.candidate) {
            return told("the candidate");
        }
        // The emergency door asks nobody beforehand.
        if !bound.is_emergency() {
            let asked = Asked {
                id: bound.question.clone(),
                row_version: bound.row_version,
                evidence_digest: bound.evidence,
                policy_digest: bound.policy,
                needed: bound.needed,
            };
            if self.asked.get(&bound.question) != Some(&(subject.to_owned(), asked)) {
                return told("the question");
            }
        }
        let kept = Kept { lines: lines_digest(&lines), facts: facts_digest(&facts), bound };
        match self.shown.insert(nonce, kept) {
            None => Ok(()),
            Some(_) => Err("what was shown with this decision is on record already".to_owned()),
        }
    }

    /// Whether a decision is over what is on record as shown; of earlier versions, and of a refusal by name, nothing is.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(super) fn check(&self, approval: &Approval, store_key: Option<&str>) -> Result<(), String> {
        let kept = self.shown.get(approval.nonce.as_str());
        let Some(shown) = &approval.shown else {
            return kept.map_or(Ok(()), |_| Err("it was signed over nothing that was shown".to_owned()));
        };
        if store_key.is_some_and(|key| key != shown.store_key) {
            return Err("it was signed for a store with another key".to_owned());
        }
        let kept = kept.ok_or("no record has what was shown with it")?;
        if kept.lines != shown.lines {
            return Err("the lines on record are not those that it was signed over".to_owned());
        }
        if kept.facts != shown.facts {
            return Err("the facts on record are not those that it was signed over".to_owned());
        }
        kept.bound.agree(approval).map_err(|what| format!("its facts say otherwise of {what}"))
    }
}
