//! Open approval requests: the question, the answers so far, and the text shown to approvers.
//!
//! Asks and takes votes; the rules ([`holdpoint_governance::approval`]) and the gate decide on them.

mod approval_request;
mod restored_requests;

use std::collections::{BTreeMap, BTreeSet};

use holdpoint_approvals::SignedApproval;
use holdpoint_governance::alarms::{AlarmEvent, AlarmKey};
use holdpoint_governance::approval::{
    self, ApprovalDecision, ApprovalOutcome, ApprovalResult, Role, SignatureCheck, Subject, Vote,
};
use holdpoint_governance::gate;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::LifecycleEvent;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::submission::{Provenance, Risk};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::{Operation, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::snapshot::{ApprovalRequestView, RequestKind};
use holdpoint_registry::store_terms::RequestState;
use holdpoint_registry::{ApprovalRequest, Change};

use crate::context::Context;
use crate::evidence_file::{EvidenceFile, EvidenceFiles};
use crate::fault::EngineFault;
use crate::recorder::EngineRecorder;
use crate::version_origin;
use crate::version_table::{TransitionNote, VersionTable};
use crate::view::check_explanation;

pub(super) use approval_request::NewApprovalRequest;
pub use approval_request::PendingApproval;

use super::request_display::{self, IssuedRequests};
use super::signers::signer;

#[derive(Default)]
pub struct Approvals {
    prompts: BTreeMap<CapabilityId, PendingApproval>,
    /// Approved, and waiting for the end of a sequence.
    granted: BTreeSet<CapabilityId>,
    /// The texts shown, by approver and request.
    pub(super) requests: IssuedRequests,
}

impl Approvals {
    /// The question about a version.
    #[must_use]
    pub fn of(&self, id: &CapabilityId) -> Option<&PendingApproval> {
        self.prompts.get(id)
    }

    /// Takes the question about a version away: it is answered, or void.
    pub fn close(&mut self, id: &CapabilityId) -> Option<PendingApproval> {
        self.granted.remove(id);
        let closed = self.prompts.remove(id)?;
        self.requests.close(&closed.id);
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
        for (id, prompt) in &mut self.prompts {
            let before = prompt.votes.len();
            prompt.votes.retain(|vote| vote.key != key);
            prompt.signed.retain(|signed| signed.public_key() != key);
            count += before - prompt.votes.len();
            match prompt.result(context, record.wall_now()).outcome {
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
        let due = |(id, prompt): &(&CapabilityId, &PendingApproval)| {
            let waits = prompt.purpose != RequestKind::Review && !self.granted.contains(*id);
            waits && prompt.request.until <= now
        };
        self.prompts.iter().filter(due).map(|(id, _)| id.clone()).collect()
    }

    /// Questions about versions whose row has changed since; a review stands whatever becomes of its version.
    #[must_use]
    pub fn changed(&self, record: &EngineRecorder) -> Vec<CapabilityId> {
        let changed = |(id, prompt): &(&CapabilityId, &PendingApproval)| {
            let row = record.version_table().version(id).map(|(_, state, _)| state.row_version);
            prompt.purpose != RequestKind::Review && row.is_ok_and(|row| row != prompt.life_row_version)
        };
        self.prompts.iter().filter(changed).map(|(id, _)| id.clone()).collect()
    }

    /// The next deadline.
    #[must_use]
    pub fn next(&self) -> Option<WallTime> {
        self.prompts.values().filter(|prompt| !prompt.overdue).map(|prompt| prompt.request.until).min()
    }

    /// What waits for people.
    #[must_use]
    pub fn views(
        &self,
        context: &Context,
        record: &EngineRecorder,
        evidence_files: &EvidenceFiles,
    ) -> Vec<ApprovalRequestView> {
        let shown = |(id, prompt)| ApprovalRequestView {
            granted: self.granted.contains(id),
            ..view(context, record, evidence_files, id, prompt)
        };
        self.prompts.iter().map(shown).collect()
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
        let evidence = evidence_file.digest()?;
        self.put(
            context,
            record,
            evidence_files,
            id,
            (RequestKind::Activation, String::new(), None),
            (evidence, quorum, review),
        )
    }

    /// Asks people to lift the restriction of an active version.
    ///
    /// # Errors
    /// If the lifecycle refuses the question, or it cannot be written.
    pub fn request_release(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        evidence_files: &mut EvidenceFiles,
        operation: &Operation,
    ) -> Result<(), EngineFault> {
        let Operation { version: id, by, reason } = operation;
        let about = format!("{by} asks for it: {reason}");
        let evidence_file = evidence_files.edit(id);
        let quorum =
            approval::quorum(&context.profile.approval, version_origin::assessed_risk(evidence_file), false);
        let evidence =
            Digest::of_parts("holdpoint.release.v1", &[evidence_file.digest()?.bytes(), about.as_bytes()]);
        let request = (RequestKind::Release, about, Some(by.clone()));
        self.put(context, record, evidence_files, id, request, (evidence, quorum, false))
    }

    fn put(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        evidence_files: &mut EvidenceFiles,
        id: &CapabilityId,
        (purpose, about, asked_by): (RequestKind, String, Option<String>),
        (evidence, quorum, review): (Digest, u8, bool),
    ) -> Result<(), EngineFault> {
        let settings = context.profile.approval;
        let (version, _, member) = record.version_table().version(id)?;
        let row_version = member.row_version;
        let now = record.wall_now();
        let until = now.plus_secs(settings.timeout_s);
        // After a restart the engine asks the same question with another deadline: another request.
        let prompt_id =
            format!("{}-{}-{row_version}-{}-{}", id.family, id.version, evidence.short(), now.ms());
        let evidence_file = evidence_files.edit(id);
        let risk = version_origin::assessed_risk(evidence_file);
        let question = ApprovalRequest {
            id: prompt_id.clone(),
            version: id.clone(),
            row_version,
            evidence_digest: evidence,
            policy_digest: context.digest,
            profile: context.profile.name,
            needed: u32::from(quorum),
            until,
            state: RequestState::Open,
            json: serde_json::to_string(evidence_file)?,
        };
        let note = TransitionNote {
            before: vec![Change::PutApprovalRequest(Box::new(question))],
            ..TransitionNote::because(Notice::ApproversAsked)
        };
        record.transition(&id.family, LifecycleEvent::RequestApproval { version }, note)?;
        let request = NewApprovalRequest {
            id: prompt_id,
            purpose,
            about,
            asked_by,
            evidence,
            quorum,
            risk,
            review,
            requested_at: now,
            until,
        };
        let prompt = PendingApproval::new(context, record, id, request)?;
        self.open(context, record, evidence_files, id, prompt);
        let priority = context.profile.alarms.approval_waiting;
        let notice = Notice::WaitsForApproval { version: id.clone() };
        record.raise(AlarmKey::Approval(id.clone()), priority, false, notice);
        Ok(())
    }

    /// A question that is on record is open from now on, and told.
    pub(super) fn open(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        evidence_files: &EvidenceFiles,
        id: &CapabilityId,
        prompt: PendingApproval,
    ) {
        let request_view = view(context, record, evidence_files, id, &prompt);
        let conditions = evidence_files.of(id).map(|known| known.conditions.clone()).unwrap_or_default();
        self.prompts.insert(id.clone(), prompt);
        record.tell(EventKind::ApprovalRequested {
            version: id.clone(),
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
        let refuse = |code, text: String, hint: Option<&str>| {
            Ok(Err(Reply::Refused { code, text, hint: hint.map(ToOwned::to_owned) }))
        };
        let identity = match signer(context, record, &signed) {
            Ok(identity) => identity,
            Err(refused) => return Ok(Err(refused)),
        };
        let Some(prompt) = self.prompts.get(&id) else {
            let text = format!("nothing waits for a decision on {id}");
            return refuse(Refusal::NotFound, text, Some("see `holdpoint status`"));
        };
        let now = record.wall_now();
        let profile =
            if approval.profile == context.profile.name { context.profile_digest } else { context.digest };
        let subject = Subject {
            candidate: approval.candidate_digest,
            row_version: approval.row_version,
            evidence: approval.evidence_digest,
            policy: approval.policy_digest,
            profile,
        };
        // A refusal is never too late, and a review stays open past its time.
        let is_late = now >= prompt.request.until && prompt.purpose != RequestKind::Review;
        if is_late && approval.decision == ApprovalDecision::Approve {
            let text = format!("the question about {id} was open until {}", prompt.request.until);
            return refuse(Refusal::NotNow, text, Some("`holdpoint resume` has people asked again"));
        }
        if subject != prompt.request.subject {
            let text = format!("the decision on {id} is over something that has changed since");
            return refuse(Refusal::Stale, text, Some("look at the prompt again and decide again"));
        }
        if prompt.has_answered(&approval.who, approval.decision, now) {
            let (who, answer) = (&approval.who, approval.decision.name());
            let text =
                format!("{who} has answered {answer} on {id} already; the same answer is not taken twice");
            let hint =
                "`holdpoint status` shows whom it waits for; another answer of the same person is taken";
            return refuse(Refusal::NotAllowed, text, Some(hint));
        }
        let shown = match self.displayed_text(context, record, evidence_files, prompt, &approval)? {
            Ok(shown) => shown,
            Err(refused) => return Ok(Err(refused)),
        };
        let records = shown.iter().map(|shown| shown.record(&approval)).collect::<Result<Vec<_>, _>>()?;
        record.write(vec![Change::PutApproval(Box::new(signed.clone()))], records)?;
        let Some(prompt) = self.prompts.get_mut(&id) else {
            return Err(EngineFault::Impossible(format!(
                "the question about {id} closed while it was answered"
            )));
        };
        self.requests.answered(&prompt.id, &approval.who);
        prompt.votes.push(Vote {
            person: approval.who.clone(),
            key: signed.public_key().to_owned(),
            role: identity.role,
            answer: approval.decision,
            reason: approval.reason.clone(),
            subject,
            until: approval.not_after(),
            break_glass: false,
            signature: SignatureCheck::Valid,
            nonce_used: false,
        });
        prompt.signed.push(signed);
        let result = prompt.result(context, record.wall_now());
        let needed = u32::from(prompt.request.quorum);
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

/// The note by which a request is closed.
#[must_use]
pub fn closing_note(
    context: &Context,
    id: &CapabilityId,
    prompt: &PendingApproval,
    state: RequestState,
    reason: Notice,
) -> TransitionNote {
    let request = ApprovalRequest {
        id: prompt.id.clone(),
        version: id.clone(),
        row_version: prompt.row_version,
        evidence_digest: prompt.evidence,
        policy_digest: context.digest,
        profile: context.profile.name,
        needed: u32::from(prompt.request.quorum),
        until: prompt.request.until,
        state,
        json: "{}".to_owned(),
    };
    TransitionNote {
        before: vec![Change::PutApprovalRequest(Box::new(request))],
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
    context: &Context,
    record: &EngineRecorder,
    evidence_files: &EvidenceFiles,
    id: &CapabilityId,
    prompt: &PendingApproval,
) -> ApprovalRequestView {
    let counted = approval::counted(&prompt.request, &prompt.votes, record.wall_now());
    let quorum = prompt.request.quorum;
    let empty = EvidenceFile::default();
    let evidence_file = evidence_files.of(id).unwrap_or(&empty);
    ApprovalRequestView {
        id: prompt.id.clone(),
        version: id.clone(),
        replaces: prompt.replaces.clone(),
        candidate: prompt.request.subject.candidate,
        row_version: prompt.row_version,
        evidence: prompt.evidence,
        policy: context.digest,
        profile: context.profile.name,
        site: context.profile.site.clone(),
        needed: u32::from(quorum),
        granted: false,
        approved_by: counted.iter().map(|vote| vote.person.clone()).collect(),
        officer_missing: prompt.request.risk == Risk::High
            && !counted.iter().any(|vote| vote.role == Role::Safety),
        until: prompt.request.until,
        valid_until: record.wall_now().plus_secs(context.profile.approval.valid_s),
        store_id: record.version_table().store().store_id().to_owned(),
        asked: prompt.requested_at,
        tier: tier(context.profile.name, quorum, prompt.review),
        author: prompt.request.author.label(),
        requester: prompt.request.requester.clone(),
        risk: evidence_file.risk.clone(),
        new_permissions: evidence_file.new_permissions.clone(),
        changes: evidence_file.changes.clone(),
        conditions: evidence_file.conditions.iter().map(ToString::to_string).collect(),
        why: check_explanation::summary(evidence_file),
        untested: request_display::untested(evidence_file).iter().map(ToString::to_string).collect(),
        on_drift: match prompt.purpose {
            RequestKind::Activation | RequestKind::Emergency => {
                request_display::on_drift(context, prompt, evidence_file, evidence_files.has_open_concern(id))
                    .to_string()
            }
            RequestKind::Release | RequestKind::Review => prompt.about.clone(),
        },
        purpose: prompt.purpose,
        about: prompt.about.clone(),
        lines: request_display::overview(context, record, evidence_files, id, prompt),
    }
}

/// How much friction a decision needs (reference A6).
pub(super) const fn tier(profile: ProfileName, quorum: u8, review: bool) -> u8 {
    if quorum >= 2 || review {
        return 2;
    }
    match profile {
        ProfileName::Sim => 0,
        ProfileName::Real => 1,
        ProfileName::Human => 2,
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
