//! Break-glass: what one person may activate alone, and the review that follows.
//!
//! Makes the requests and checks the person. The rules ([`holdpoint_governance::approval`]) rate the vote, and the
//! gate decides on the activation.

use holdpoint_approvals::SignedApproval;
use holdpoint_governance::approval::{self, ApprovalDecision, ApprovalResult, REVIEWERS};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::{Review, Stage, State};
use holdpoint_governance::submission::Risk;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::snapshot::{ApprovalRequestView, RequestKind};
use holdpoint_store::{ApprovalRequest, Change, RequestState};
use holdpoint_text::is_visible;
use holdpoint_wording::request::review_cause;

use super::approvals::{Approvals, PendingApproval, new_row, tier, view, vote};
use super::request_display::{DisplayedText, RequestSources};
use super::signers::check_signer;
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_file::{EvidenceFile, EvidenceFiles};
use holdpoint_record::version_origin;

/// An emergency approval that the rules count, and until when it holds.
pub(crate) struct BreakGlassApproval {
    pub(crate) signed: SignedApproval,
    /// The text shown to its signer.
    pub(crate) shown: DisplayedText,
    pub(crate) result: ApprovalResult,
    /// By when it has to be reviewed.
    pub(crate) until: WallTime,
}

/// The stored break-glass approval of a version.
fn break_glass_approval(
    record: &EngineRecorder,
    id: &CapabilityId,
) -> Result<Option<SignedApproval>, EngineFault> {
    let rows = record.version_table().store().views()?.approvals(id)?;
    Ok(rows.into_iter().rev().map(|entry| entry.signed).find(|signed| signed.approval().break_glass))
}

/// What a break-glass approval of a version must sign now; absent if break-glass does not apply.
pub(super) fn break_glass_request(from: RequestSources<'_>, id: &CapabilityId) -> Option<PendingApproval> {
    let RequestSources { context, record, evidence_files } = from;
    let settings = context.profile.approval;
    let entry = record.version_table().family(&id.family).ok()?;
    let (_, state, member) = entry.find(id)?;
    let stands = state.state == State::Shadowed
        && !state.flags.paused
        && matches!(state.flags.running, None | Some(Stage::Activation));
    let evidence_file = evidence_files.of(id)?;
    let waits = evidence_file.held || state.flags.awaiting_approval;
    if !(settings.break_glass && stands && waits && entry.state.review.is_none()) {
        return None;
    }
    let until = record.wall_now().plus_secs(settings.break_glass_valid_s);
    let risk = version_origin::assessed_risk(evidence_file);
    // One person is never enough in the ordinary way: it counts as an emergency or not at all.
    let quorum = approval::quorum(&settings, risk, false).max(2);
    let mut row = new_row(context, record, id, (evidence_file.digest().ok()?, quorum, until)).ok()?;
    // Each reader gets it composed again, and it stays the same request.
    row.id = format!("{}-{}-{}-emergency", id.family, id.version, member.row_version);
    let request = PendingApproval::new(context, record, row, RequestKind::Emergency, risk).ok()?;
    Some(PendingApproval { review: true, ..request })
}

/// Versions that one person may activate by break-glass now.
pub(crate) fn views(from: RequestSources<'_>) -> Vec<ApprovalRequestView> {
    let mut found = Vec::new();
    if !from.context.profile.approval.break_glass {
        return found;
    }
    for (member, _) in from.record.version_table().versions() {
        let id = member.capability.id();
        if let Some(request) = break_glass_request(from, &id) {
            let mut shown = view(from, &id, &request);
            shown.valid_until = request.row.until;
            shown.tier = tier(from.context.profile.name, 2, true);
            found.push(shown);
        }
    }
    found
}

/// Holds an emergency approval against everything it has to be. Changes nothing.
///
/// # Errors
/// If the version cannot be read.
pub(crate) fn check(
    from: RequestSources<'_>,
    approvals: &Approvals,
    signed: SignedApproval,
) -> Result<Result<BreakGlassApproval, Reply>, EngineFault> {
    let RequestSources { context, record, .. } = from;
    let refuse = |code, text: String, hint: Option<&str>| {
        Ok(Err(Reply::Refused { code, text, hint: hint.map(ToOwned::to_owned) }))
    };
    if let Err(refused) = check_signer(context, record, &signed) {
        return Ok(Err(refused));
    }
    let answer = signed.approval().clone();
    let (id, settings) = (&answer.version, context.profile.approval);
    if !settings.break_glass {
        let text = format!("the profile {} permits no break-glass", context.profile.name.name());
        return refuse(Refusal::NotAllowed, text, Some("people approve it, or it waits"));
    }
    if answer.decision != ApprovalDecision::Approve || !is_visible(&answer.reason) {
        let text = "break-glass needs an approval with a reason".to_owned();
        return refuse(Refusal::BadInput, text, None);
    }
    let Some(request) = break_glass_request(from, id) else {
        let text = format!("{id} does not wait for approval or a freeze after shadow");
        return refuse(Refusal::NotNow, text, Some("break-glass replaces no stage and no measurement"));
    };
    let vote = vote(context, RequestKind::Emergency, &signed);
    let result = approval::evaluate(&request.quorum, &[vote], record.wall_now(), &settings);
    if !result.is_emergency() {
        let why = result.reasons.last().map_or_else(String::new, holdpoint_wording::reason);
        return refuse(Refusal::NotAllowed, format!("{id} is not activated: {why}"), None);
    }
    let shown = match approvals.displayed_text(from, &request, signed.approval())? {
        Ok(Some(shown)) => shown,
        Ok(None) => {
            return refuse(Refusal::BadInput, "it is signed over nothing that was shown".to_owned(), None);
        }
        Err(refused) => return Ok(Err(refused)),
    };
    let until = answer.not_after().min(request.row.until);
    Ok(Ok(BreakGlassApproval { signed, shown, result, until }))
}

impl Approvals {
    /// Asks two people to review an emergency activation, in place of any open request about the version.
    ///
    /// # Errors
    /// If the question cannot be written.
    pub(crate) fn request_review(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        evidence_files: &EvidenceFiles,
        id: &CapabilityId,
        review: Review,
    ) -> Result<(), EngineFault> {
        let mut changes = Vec::new();
        if let Some(old) = self.close(id) {
            changes.push(Change::PutApprovalRequest(Box::new(old.row_as(RequestState::Void))));
        }
        let risk = evidence_files.of(id).map_or(Risk::High, version_origin::assessed_risk);
        let candidate = record.capability(id)?;
        let now = record.wall_now();
        let overdue = review.until <= now;
        let break_glass = break_glass_approval(record, id)?;
        let (by, reason) = break_glass.as_ref().map_or_else(
            || ("engine".to_owned(), None),
            |signed| (signed.approval().who.clone(), Some(signed.approval().reason.clone())),
        );
        let claim = break_glass.map_or_else(|| candidate.digest(), |signed| signed.approval().claim_digest());
        let evidence = Digest::of_parts("holdpoint.review.v1", &[claim.bytes(), candidate.digest().bytes()]);
        let about = review_cause(&by, reason.as_deref(), overdue);
        let mut row = new_row(context, record, id, (evidence, REVIEWERS, review.until))?;
        row.id = format!("{}-{}-{}-review-{}", id.family, id.version, row.row_version, now.ms());
        let empty = EvidenceFile::default();
        let json = serde_json::to_string(evidence_files.of(id).unwrap_or(&empty))?;
        changes.push(Change::PutApprovalRequest(Box::new(ApprovalRequest { json, ..row.clone() })));
        let request = PendingApproval::new(context, record, row, RequestKind::Review, risk)?;
        let request = request.asked_by(record, &by, about)?;
        record.write(changes, Vec::new())?;
        self.open(context, record, evidence_files, PendingApproval { overdue, review: true, ..request });
        Ok(())
    }
}
