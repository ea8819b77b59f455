//! Open approval requests: the question, the answers so far, and the text shown to approvers.
//!
//! Asks and takes votes; the rules ([`holdpoint_governance::approval`]) and the gate decide on them.

mod approval_request;
mod restored_requests;

use std::collections::{BTreeMap, BTreeSet};

use holdpoint_approvals::SignedApproval;
use holdpoint_governance::alarms::{AlarmEvent, AlarmKey};
use holdpoint_governance::approval::{self, ApprovalDecision, ApprovalOutcome, ApprovalResult, Role};
use holdpoint_governance::gate;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::LifecycleEvent;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::profile::{ClassRisk, ProfileName};
use holdpoint_governance::submission::{Provenance, Risk};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::approval_document::QuestionRefusal;
use holdpoint_protocol::command::{Operation, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::snapshot::{ApprovalRequestView, RequestKind};
use holdpoint_store::{ApprovalRequest, Change, RequestState};
use holdpoint_wording::request::{self, drift_response};

use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_file::{EvidenceFile, EvidenceFiles};
use holdpoint_record::rationale::check_explanation;
use holdpoint_record::untested::untested;
use holdpoint_record::version_origin;
use holdpoint_record::version_table::{TransitionNote, VersionTable};

pub use approval_request::PendingApproval;
pub(super) use approval_request::{RecordedAnswer, new_row, vote};

use super::request_display::{self, IssuedRequests, RequestSources};
use super::signers::{check_signer, refused};

#[derive(Default)]
pub struct Approvals {
    pending: BTreeMap<CapabilityId, PendingApproval>,
    /// Approved, and waiting for the end of a sequence.
    granted: BTreeSet<CapabilityId>,
    /// The texts shown, by approver and request.
    pub(super) requests: IssuedRequests,
}

impl Approvals {
    /// The question about a version.
    #[must_use]
    pub fn of(&self, id: &CapabilityId) -> Option<&PendingApproval> {
        self.pending.get(id)
    }

    /// Removes the request about a version: it is answered, or void.
    pub fn close(&mut self, id: &CapabilityId) -> Option<PendingApproval> {
        self.granted.remove(id);
        let closed = self.pending.remove(id)?;
        self.requests.close(&closed.row.id);
        Some(closed)
    }

    /// Remembers that a version takes over when the sequence that runs is over.
    pub fn grant_later(&mut self, id: &CapabilityId) {
        self.granted.insert(id.clone());
    }

    /// The next version that was approved while a sequence ran.
    pub fn pop_granted(&mut self) -> Option<CapabilityId> {
        self.granted.pop_first()
    }

    /// Discards the answers of a key to open requests; a version granted by them waits again. Returns their number.
    pub(crate) fn discard_answers(&mut self, context: &Context, record: &EngineRecorder, key: &str) -> usize {
        let mut count = 0;
        for (id, request) in &mut self.pending {
            let before = request.answers.len();
            request.answers.retain(|answer| answer.signed.public_key() != key);
            count += before - request.answers.len();
            match request.result(context, record.wall_now()).outcome {
                ApprovalOutcome::Granted { .. } | ApprovalOutcome::NotNeeded => {}
                ApprovalOutcome::Pending { .. }
                | ApprovalOutcome::TimedOut
                | ApprovalOutcome::Refused { .. } => {
                    self.granted.remove(id);
                }
            }
        }
        count
    }

    /// Questions whose time is over.
    #[must_use]
    pub fn due(&self, now: WallTime) -> Vec<CapabilityId> {
        let due = |(id, request): &(&CapabilityId, &PendingApproval)| {
            let waits = request.kind != RequestKind::Review && !self.granted.contains(*id);
            waits && request.row.until <= now
        };
        self.pending.iter().filter(due).map(|(id, _)| id.clone()).collect()
    }

    /// Questions about versions whose row has changed since; a review stands whatever becomes of its version.
    #[must_use]
    pub fn changed(&self, record: &EngineRecorder) -> Vec<CapabilityId> {
        let changed = |(id, request): &(&CapabilityId, &PendingApproval)| {
            let row = record.version_table().version(id).map(|(_, state, _)| state.row_version);
            request.kind != RequestKind::Review && row.is_ok_and(|row| row != request.life_row_version)
        };
        self.pending.iter().filter(changed).map(|(id, _)| id.clone()).collect()
    }

    /// The next deadline.
    #[must_use]
    pub fn next(&self) -> Option<WallTime> {
        self.pending.values().filter(|request| !request.overdue).map(|request| request.row.until).min()
    }

    /// What waits for people.
    pub(crate) fn views(&self, from: RequestSources<'_>) -> Vec<ApprovalRequestView> {
        let shown = |(id, request)| ApprovalRequestView {
            granted: self.granted.contains(id),
            ..view(from, id, request)
        };
        self.pending.iter().map(shown).collect()
    }

    /// Asks people to let a candidate in; from here on only they or the deadline move it.
    ///
    /// # Errors
    /// If the question cannot be written.
    pub fn request_approval(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        evidence_files: &mut EvidenceFiles,
        id: &CapabilityId,
    ) -> Result<(), EngineFault> {
        let evidence_file = evidence_files.edit(id);
        let provenance = record.capability(id)?.submission.provenance;
        let Some((quorum, review)) = activation_terms(context, evidence_file, provenance) else {
            return Err(EngineFault::Impossible(format!("{id} reached the gate without an assessment")));
        };
        let terms = (evidence_file.digest()?, quorum, until(context, record));
        let risk = version_origin::assessed_risk(evidence_file);
        let row = new_row(context, record, id, terms)?;
        let request = PendingApproval::new(context, record, row, RequestKind::Activation, risk)?;
        self.put(context, record, evidence_files, PendingApproval { review, ..request })
    }

    /// Asks people to lift the restriction of an active version.
    ///
    /// # Errors
    /// If the lifecycle refuses the request, or it cannot be written.
    pub fn request_release(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        evidence_files: &mut EvidenceFiles,
        operation: &Operation,
    ) -> Result<(), EngineFault> {
        let Operation { version: id, by, reason } = operation;
        let about = request::release_cause(by, reason);
        let evidence_file = evidence_files.edit(id);
        let risk = version_origin::assessed_risk(evidence_file);
        let quorum = approval::quorum(&context.profile.approval, risk, false);
        let evidence =
            Digest::of_parts("holdpoint.release.v1", &[evidence_file.digest()?.bytes(), about.as_bytes()]);
        let row = new_row(context, record, id, (evidence, quorum, until(context, record)))?;
        let request = PendingApproval::new(context, record, row, RequestKind::Release, risk)?;
        self.put(context, record, evidence_files, request.asked_by(record, by, about)?)
    }

    /// Records a new request, with the state change that goes with it, and opens it.
    fn put(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        evidence_files: &mut EvidenceFiles,
        mut request: PendingApproval,
    ) -> Result<(), EngineFault> {
        let id = request.row.version.clone();
        let (version, _, _) = record.version_table().version(&id)?;
        let json = serde_json::to_string(evidence_files.edit(&id))?;
        let row = ApprovalRequest { json, ..request.row.clone() };
        let note = TransitionNote {
            before: vec![Change::PutApprovalRequest(Box::new(row))],
            ..TransitionNote::because(Notice::ApproversAsked)
        };
        record.transition(&id.family, LifecycleEvent::RequestApproval { version }, note)?;
        request.life_row_version = record.version_table().version(&id)?.1.row_version;
        self.open(context, record, evidence_files, request);
        let priority = context.profile.alarms.approval_waiting;
        let notice = Notice::WaitsForApproval { version: id.clone() };
        record.raise(AlarmKey::Approval(id), priority, false, notice);
        Ok(())
    }

    /// Opens a request that is on record, and publishes it.
    pub(super) fn open(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        evidence_files: &EvidenceFiles,
        request: PendingApproval,
    ) {
        let id = request.row.version.clone();
        let request_view = view(RequestSources { context, record, evidence_files }, &id, &request);
        let conditions = evidence_files.of(&id).map(|known| known.conditions.clone()).unwrap_or_default();
        self.pending.insert(id.clone(), request);
        record.tell(EventKind::ApprovalRequested {
            version: id,
            replaces: request_view.replaces,
            needed: request_view.needed,
            until: request_view.until,
            evidence: request_view.evidence,
            author: request_view.author,
            new_permissions: request_view.new_permissions,
            changes: Box::new(request_view.changes),
            conditions,
            untested: request_view.untested,
            on_drift: request_view.on_drift,
            purpose: request_view.purpose,
        });
    }

    /// Takes one signed decision; returns the result of the request. Refuses, without effect, a decision that does not
    /// fit the request, or whose text differs from the one shown now.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn vote(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        evidence_files: &EvidenceFiles,
        signed: SignedApproval,
    ) -> Result<Result<ApprovalResult, Reply>, EngineFault> {
        let approval = signed.approval().clone();
        let id = approval.version.clone();
        let refuse = |why: QuestionRefusal| Ok(Err(refused(&why)));
        if let Err(refused) = check_signer(context, record, &signed) {
            return Ok(Err(refused));
        }
        let version = id.clone();
        let Some(request) = self.pending.get(&id) else {
            return refuse(QuestionRefusal::NotWaiting { version });
        };
        let now = record.wall_now();
        // A refusal is never too late, and a review stays open past its time.
        let is_late = now >= request.row.until && request.kind != RequestKind::Review;
        if is_late && approval.decision == ApprovalDecision::Approve {
            return refuse(QuestionRefusal::Ended { version, until: request.row.until });
        }
        if vote(context, request.kind, &signed).subject != request.quorum.subject {
            return refuse(QuestionRefusal::SubjectChanged { version });
        }
        if request.has_answered(&approval.who, approval.decision, now) {
            let (name, answer) = (approval.who, approval.decision);
            return refuse(QuestionRefusal::AnsweredAlready { name, answer, version });
        }
        let from = RequestSources { context, record, evidence_files };
        let shown = match self.displayed_text(from, request, &approval)? {
            Ok(shown) => shown,
            Err(refused) => return Ok(Err(refused)),
        };
        let records = shown.iter().map(|shown| shown.record(&approval)).collect::<Result<Vec<_>, _>>()?;
        // The store verifies the signature. What it refuses is answered as a refusal, and nothing has changed.
        record.write(vec![Change::PutApproval(Box::new(signed))], records)?;
        let recorded = record.version_table().store().views()?.approvals(&id)?;
        // The newest is this one. Its time is the stored one, so that it is the same after a restart.
        let (Some(entry), Some(request)) = (recorded.into_iter().next_back(), self.pending.get_mut(&id))
        else {
            return Err(EngineFault::Impossible(format!(
                "the request about {id} closed while it was answered"
            )));
        };
        self.requests.answered(&request.row.id, &approval.who);
        request.answers.push(RecordedAnswer::of(record, entry));
        let result = request.result(context, record.wall_now());
        let needed = request.row.needed;
        let have = match &result.outcome {
            ApprovalOutcome::Granted { people, .. } => u32::try_from(people.len()).unwrap_or(u32::MAX),
            ApprovalOutcome::Pending { missing } => needed.saturating_sub(u32::from(*missing)),
            ApprovalOutcome::NotNeeded | ApprovalOutcome::TimedOut | ApprovalOutcome::Refused { .. } => 0,
        };
        record.tell(EventKind::ApprovalReceived {
            version: id,
            by: approval.who.clone(),
            decision: approval.decision,
            reason: approval.reason,
            have,
            needed,
        });
        Ok(Ok(result))
    }
}

/// How many people an activation takes, and whether they override what a rule would not pass; absent before the
/// version was assessed.
fn activation_terms(
    context: &Context,
    evidence_file: &EvidenceFile,
    provenance: Provenance,
) -> Option<(u8, bool)> {
    let kappas = evidence_file.kappas.as_ref()?;
    let of = (version_origin::assessed_risk(evidence_file), provenance);
    let quorum = gate::people_needed(kappas, of, &context.table, &context.profile);
    // If the profile needs no approver, people decide on what it would not have let pass.
    let review = gate::needs_review(kappas, &context.profile) || !context.needs_approval();
    Some((quorum, review))
}

/// Until when people may answer a request that is made now.
fn until(context: &Context, record: &EngineRecorder) -> WallTime {
    record.wall_now().plus_secs(context.profile.approval.timeout_s)
}

/// The note by which a request is closed.
#[must_use]
pub fn closing_note(request: &PendingApproval, state: RequestState, reason: Notice) -> TransitionNote {
    TransitionNote {
        before: vec![Change::PutApprovalRequest(Box::new(request.row_as(state)))],
        ..TransitionNote::because(reason)
    }
}

/// The request is closed. An answer also acknowledges the alarm.
pub fn clear_alarm(record: &mut EngineRecorder, id: &CapabilityId, answered_by: Option<String>) {
    let key = AlarmKey::Approval(id.clone());
    if let Some(by) = answered_by.filter(|_| record.alarms().get(&key).is_some()) {
        record.alarm_event(&AlarmEvent::Acknowledge { key: key.clone(), by });
    }
    record.alarm_event(&AlarmEvent::Clear { key });
}

/// Voids the requests about a version from before a restart.
///
/// # Errors
/// If the store cannot be read.
pub fn void_requests(version_table: &VersionTable, id: &CapabilityId) -> Result<Vec<Change>, EngineFault> {
    let open = version_table.store().views()?.open_requests()?;
    let ours = open.into_iter().filter(|request| request.version == *id);
    let void = ours.map(|request| ApprovalRequest { state: RequestState::Void, ..request });
    Ok(void.map(|request| Change::PutApprovalRequest(Box::new(request))).collect())
}

pub(super) fn view(
    from: RequestSources<'_>,
    id: &CapabilityId,
    request: &PendingApproval,
) -> ApprovalRequestView {
    let RequestSources { context, record, evidence_files } = from;
    let votes = request.votes(context);
    let counted = approval::counted(&request.quorum, &votes, record.wall_now());
    let quorum = request.quorum.quorum;
    let empty = EvidenceFile::default();
    let evidence_file = evidence_files.of(id).unwrap_or(&empty);
    ApprovalRequestView {
        id: request.row.id.clone(),
        version: id.clone(),
        replaces: request.replaces.clone(),
        candidate: request.quorum.subject.candidate,
        row_version: request.row.row_version,
        evidence: request.row.evidence_digest,
        policy: context.digest,
        profile: context.profile.name,
        site: context.profile.site.clone(),
        needed: u32::from(quorum),
        granted: false,
        approved_by: counted.iter().map(|vote| vote.person.clone()).collect(),
        officer_missing: request.quorum.risk == Risk::High
            && !counted.iter().any(|vote| vote.role == Role::Safety),
        until: request.row.until,
        valid_until: record.wall_now().plus_secs(context.profile.approval.valid_s),
        store_id: record.version_table().store().store_id().to_owned(),
        asked: request.requested_at,
        tier: tier(context.profile.name, quorum, request.review),
        author: request.quorum.author.label(),
        requester: request.quorum.requester.clone(),
        risk: evidence_file.risk.clone(),
        new_permissions: evidence_file.new_permissions.clone(),
        changes: evidence_file.changes.clone(),
        conditions: evidence_file.conditions.iter().map(holdpoint_wording::condition_of_use).collect(),
        why: check_explanation::summary(evidence_file, &check_explanation::SUMMARIZED),
        untested: untested(evidence_file).into_iter().map(request::untested).collect(),
        on_drift: match request.kind {
            RequestKind::Activation | RequestKind::Emergency => drift_response(&request_display::on_drift(
                context,
                request,
                evidence_file,
                evidence_files.has_open_concern(id),
            )),
            RequestKind::Release | RequestKind::Review => request.about.clone(),
        },
        purpose: request.kind,
        about: request.about.clone(),
        lines: request_display::overview(from, id, request),
    }
}

/// How much friction a decision needs (reference A6).
pub(super) const fn tier(profile: ProfileName, quorum: u8, review: bool) -> u8 {
    if quorum >= 2 || review {
        return 2;
    }
    match profile.declaration().risk {
        ClassRisk::Nothing => 0,
        ClassRisk::Machine => 1,
        ClassRisk::People => 2,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_follows_profile_and_quorum() {
        use ProfileName::{Human, Real, Sim};
        for (profile, quorum, review, expected) in [
            (Sim, 0, false, 0),
            (Sim, 1, false, 0),
            (Sim, 2, false, 2),
            (Sim, 1, true, 2),
            (Real, 1, false, 1),
            (Real, 2, false, 2),
            (Human, 1, false, 2),
        ] {
            assert_eq!(tier(profile, quorum, review), expected, "{profile:?} {quorum} {review}");
        }
    }
}
