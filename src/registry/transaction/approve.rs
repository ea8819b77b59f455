//! Changes about approvals: requests, signed decisions, and their one use.

use rusqlite::params;

use crate::transaction::apply::{Applier, ChangeEffect, check_int, check_json, check_name};
use holdpoint_approvals::SignedApproval;
use holdpoint_audit::recorded_approval::RecordedApproval;
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::ids::{CapabilityId, Digest, canonical_json};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_store::{ApprovalFault, ApprovalRequest, StoreError, verify_approval};

impl Applier<'_> {
    pub(crate) fn put_request(&mut self, request: &ApprovalRequest) -> Result<ChangeEffect, StoreError> {
        check_name("approval request", &request.id)?;
        check_json("approval request", &request.json)?;
        check_int("row version", request.row_version)?;
        self.version(&request.version)?;
        self.execute(
            "keep an approval request",
            "INSERT INTO approval_request (id, version, row_version, evidence_digest, policy_digest, profile, needed,
               asked_ms, deadline_ms, state, json)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)
             ON CONFLICT (id) DO UPDATE SET state = ?10, json = ?11
               WHERE version = ?2 AND row_version = ?3 AND evidence_digest = ?4 AND policy_digest = ?5
                 AND profile = ?6 AND needed = ?7 AND deadline_ms = ?9",
            params![
                request.id,
                request.version.to_string(),
                request.row_version,
                request.evidence_digest.to_string(),
                request.policy_digest.to_string(),
                request.profile.name(),
                request.needed,
                self.at_ms,
                request.until.ms(),
                request.state.name(),
                request.json
            ],
        )
        .and_then(|changed| match changed {
            0 => Err(StoreError::Exists { what: "approval request (for something else)", name: request.id.clone() }),
            _ => Ok(()),
        })?;
        Ok(ChangeEffect::new(RecordKind::ApprovalRequested, &request.version))
    }

    pub(crate) fn put_approval(&mut self, signed: &SignedApproval) -> Result<ChangeEffect, StoreError> {
        let approval = signed.approval();
        let nonce = approval.nonce.to_string();
        let refuse = |problem: ApprovalFault| StoreError::Approval { nonce: nonce.clone(), problem };
        verify_approval(signed, &self.persons()?).map_err(refuse)?;
        if approval.store_id != self.place.store_id {
            return Err(refuse(ApprovalFault::OtherStore(approval.store_id.clone())));
        }
        match &approval.shown {
            Some(shown) if shown.store_key != self.place.store_key => {
                return Err(refuse(ApprovalFault::OtherStoreKey));
            }
            None if approval.decision == ApprovalDecision::Approve => {
                return Err(refuse(ApprovalFault::NothingShown));
            }
            Some(_) | None => {}
        }
        check_int("expiry", approval.not_after_ms)?;
        check_int("row version", approval.row_version)?;
        self.version(&approval.version)?;
        if self.exists("find an approval", "SELECT 1 FROM approval WHERE nonce = ?1", [&nonce])? {
            return Err(refuse(ApprovalFault::Repeated));
        }
        let text =
            canonical_json(signed).map_err(|error| refuse(ApprovalFault::Damaged(error.to_string())))?;
        let recorded = RecordedApproval::of(approval);
        self.write_approval(&approval.version, &recorded, approval.claim_digest(), &text)
    }

    /// Stores an approval after the checks: its record's form, the digest of its claim, and all of it as JSON text.
    pub(crate) fn write_approval(
        &self,
        version: &CapabilityId,
        recorded: &RecordedApproval,
        claim: Digest,
        signed: &str,
    ) -> Result<ChangeEffect, StoreError> {
        self.execute(
            "keep an approval",
            "INSERT INTO approval (nonce, seq, version, who, decision, row_version, not_after_ms, claim, at_ms, signed)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10)",
            params![
                recorded.nonce.as_str(),
                self.next_seq(),
                version.to_string(),
                recorded.who,
                recorded.decision.name(),
                recorded.row_version,
                recorded.not_after_ms,
                claim.to_string(),
                self.at_ms,
                signed
            ],
        )?;
        Ok(ChangeEffect::new(RecordKind::ApprovalPut, version))
    }

    pub(crate) fn consume_approval(
        &mut self,
        nonce: &str,
        evidence_digest: Digest,
        at: Option<WallTime>,
    ) -> Result<ChangeEffect, StoreError> {
        let refuse = |problem: ApprovalFault| StoreError::Approval { nonce: nonce.to_owned(), problem };
        let (text, seq, consumed): (String, u64, Option<u64>) = self
            .find(
                "find an approval",
                "SELECT signed, seq, consumed_seq FROM approval WHERE nonce = ?1",
                [nonce],
                |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)),
            )?
            .ok_or_else(|| StoreError::NotFound { what: "approval", name: nonce.to_owned() })?;
        let signed: SignedApproval =
            serde_json::from_str(&text).map_err(|error| refuse(ApprovalFault::Damaged(error.to_string())))?;
        let approval = signed.approval();
        let name = approval.version.to_string();
        let (_, row_version) = self.version(&approval.version)?;
        let (profile, policy_digest, context_seq) = self.context()?;
        let (candidate_digest, void_seq): (String, u64) = self
            .find(
                "find a version",
                "SELECT v.candidate_digest, f.void_seq FROM version v JOIN family f ON f.name = v.family
                 WHERE v.name = ?1",
                [&name],
                |row| Ok((row.get(0)?, row.get(1)?)),
            )?
            .ok_or_else(|| StoreError::NotFound { what: "version", name: name.clone() })?;
        // The first problem that applies is reported, from the plainest to the subtlest.
        let problem = if consumed.is_some() {
            Some(ApprovalFault::Used)
        } else if approval.decision != ApprovalDecision::Approve {
            Some(ApprovalFault::Refusal)
        } else if approval.shown.is_none() {
            Some(ApprovalFault::NothingShown)
        } else if at.is_none_or(|at| at >= approval.not_after()) {
            Some(ApprovalFault::Expired)
        } else if approval.row_version != self.row_version_before(&name, row_version) {
            Some(ApprovalFault::VersionChanged)
        } else if approval.candidate_digest.to_string() != candidate_digest {
            Some(ApprovalFault::OtherCandidate)
        } else if approval.evidence_digest != evidence_digest {
            Some(ApprovalFault::EvidenceChanged)
        } else if approval.profile != profile || approval.policy_digest.to_string() != policy_digest {
            Some(ApprovalFault::RulesChanged)
        } else if seq <= void_seq || seq <= context_seq {
            Some(ApprovalFault::Voided)
        } else {
            None
        };
        if let Some(problem) = problem {
            return Err(refuse(problem));
        }
        // The row was on disk since: an editor of the file has no key of an enrolled person.
        verify_approval(&signed, &self.persons()?).map_err(refuse)?;
        self.write_consumed(nonce)?;
        crate::fp!("approval-consumed");
        let touched = ChangeEffect::new(RecordKind::ApprovalConsumed, &approval.version);
        self.approved.entry(name).or_default().insert(signed.public_key().to_owned());
        Ok(touched)
    }

    /// Consumes an approval after the checks.
    pub(crate) fn write_consumed(&self, nonce: &str) -> Result<(), StoreError> {
        self.execute(
            "use an approval",
            "UPDATE approval SET consumed_seq = ?2 WHERE nonce = ?1 AND consumed_seq IS NULL",
            params![nonce, self.next_seq()],
        )
        .and_then(|changed| match changed {
            1 => Ok(()),
            _ => Err(StoreError::Approval { nonce: nonce.to_owned(), problem: ApprovalFault::Used }),
        })
    }
}
