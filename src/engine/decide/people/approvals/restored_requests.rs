//! A question that was open when the engine ended, taken up as it was.

use holdpoint_governance::approval::{ApprovalDecision, ApprovalOutcome};
use holdpoint_governance::gate::{GateOutcome, GateResult};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_store::verify_approval;

use super::{Approvals, PendingApproval, RecordedAnswer, RequestKind, activation_terms, vote};
use crate::decide::people::persons::unconfirmed;
use crate::decide::people::request_display::{RequestSources, is_display_current};
use crate::decide::recorder::EngineRecorder;
use crate::decide::stages::activation::gate;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_file::EvidenceFiles;
use holdpoint_record::version_origin;

impl Approvals {
    /// Restores a request that was open when the engine ended, with its answers: the same question, evidence and
    /// deadline. Returns the number of answers; `None` if anything that the request binds has changed, so that people
    /// must be asked again.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn restore(
        &mut self,
        context: &Context,
        record: &EngineRecorder,
        evidence_files: &mut EvidenceFiles,
        id: &CapabilityId,
    ) -> Result<Option<usize>, EngineFault> {
        let views = record.version_table().store().views()?;
        // The newest of those that an interrupted engine may have left.
        let request = views.open_requests()?.into_iter().rfind(|request| request.version == *id);
        let (Some(request), Some(evidence_file)) = (request, evidence_files.of(id)) else { return Ok(None) };
        let (_, _, member) = record.version_table().version(id)?;
        let provenance = record.capability(id)?.submission.provenance;
        let Some((quorum, review)) = activation_terms(context, evidence_file, provenance) else {
            return Ok(None);
        };
        let risk = version_origin::assessed_risk(evidence_file);
        let evidence = evidence_file.digest()?;
        let requested_ms = views.requested_ms(&request.id)?.unwrap_or(u64::MAX);
        // Earlier versions stored the deadline in engine time, which gives no wall time: people are asked again.
        let unchanged = request.until >= WallTime::SCRIPT_EPOCH
            && request.policy_digest == context.digest
            && request.profile == context.profile.name
            && request.evidence_digest == evidence
            && request.row_version == member.row_version
            && request.needed == u32::from(quorum);
        if !unchanged {
            return Ok(None);
        }
        // The text must show what takes effect: no stage's evidence holds the conditions that the gate adds.
        let GateResult { decision, .. } = gate(context, record, evidence_files, id, None)?;
        if *decision.outcome() != GateOutcome::AwaitApproval {
            return Ok(None);
        }
        evidence_files.edit(id).take_gate(&decision);
        let requested_at = request.until.minus_secs(context.profile.approval.timeout_s);
        let pending = PendingApproval::new(context, record, request, RequestKind::Activation, risk)?;
        let mut pending = PendingApproval { requested_at, review, ..pending };
        let persons = record.version_table().store().persons()?;
        for entry in views.approvals(id)? {
            let approval = entry.signed.approval().clone();
            let same = vote(context, pending.kind, &entry.signed).subject == pending.quorum.subject
                && entry.at_ms >= requested_ms;
            // Answers of revoked and of unverified persons do not count.
            let is_live_approval =
                approval.decision == ApprovalDecision::Approve && !record.clock().is_scripted();
            let counts = same
                && verify_approval(&entry.signed, &persons).is_ok()
                && !(is_live_approval && unconfirmed(context, &persons, &approval.who).is_some());
            // An answer over another text than the present one must be given again.
            let consumed = entry.consumed_seq.is_some();
            let answer = RecordedAnswer::of(record, entry);
            let earlier = &pending.answers;
            let from = RequestSources { context, record, evidence_files };
            let is_same_text = is_display_current(from, &pending, &answer, earlier)?;
            if counts && is_same_text && !consumed {
                pending.answers.push(answer);
            }
        }
        drop(views);
        let answers = pending.answers.len();
        match pending.result(context, record.wall_now()).outcome {
            ApprovalOutcome::Granted { .. } | ApprovalOutcome::NotNeeded => self.grant_later(id),
            ApprovalOutcome::Pending { .. } | ApprovalOutcome::TimedOut | ApprovalOutcome::Refused { .. } => {
            }
        }
        self.pending.insert(id.clone(), pending);
        Ok(Some(answers))
    }
}
