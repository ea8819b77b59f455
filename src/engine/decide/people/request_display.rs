//! The text of an approval request for one approver: the current facts, the lines rendered from them, and the nonce.
//!
//! Composed when an approver requests it, and again when the answer arrives and when it is used. If the text has
//! changed by then, the answer does not count. So no one signs a text that was altered between engine and screen.
//!
//! The text of an approver names the approvals recorded before theirs, so that an answer changes the text of those who
//! have not answered yet, and of no one else.

use std::collections::BTreeMap;

use holdpoint_approvals::{Approval, DisplayBinding, Nonce, facts_digest, lines_digest};
use holdpoint_governance::approval::{self, ApprovalDecision, ApprovalOutcome, Role, SignatureCheck, Vote};
use holdpoint_governance::decision::{Dimension, ReasonCode};
use holdpoint_governance::ids::{CapabilityId, Digest, canonical_json};
use holdpoint_governance::manifest::BundleSource;
use holdpoint_governance::outcome::DimensionOutcome;
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::strictness::Strictness;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::approval_document::{
    AnswerVoidCause, ApprovalDocument, ApprovalFacts, ComponentFacts, CoverageFacts, DriftResponse,
    EarlierSignature, PairsFacts, QuestionRefusal, RequestedSigner, ShadowFacts, SignatureEffect,
};
use holdpoint_protocol::command::Reply;
use holdpoint_protocol::event::DimensionResult;
use holdpoint_protocol::snapshot::RequestKind;
use holdpoint_record::untested::untested;
use holdpoint_runtime::capability::Capability;
use holdpoint_store::AuditBody;
use holdpoint_text::hex::hex;
use holdpoint_wording::approval::{RENDERER_VERSION, render};
use holdpoint_wording::request::stricter_levels;

use super::approvals::{Approvals, PendingApproval, RecordedAnswer, vote};
use super::break_glass_approvals;
use super::signers::{person, refused};
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::stale_causes;
use holdpoint_record::evidence_file::{EvidenceFile, EvidenceFiles};
use holdpoint_record::evidence_view;
use holdpoint_record::rationale::check_explanation::{SUMMARIZED, summary};
use holdpoint_record::rationale::remedy::is_in_favor;

/// The most requests that are remembered: one for each open question and each person.
const REQUESTS_MAX: usize = 4096;

/// Reasons against it that are shown.
const REASONS_MAX: usize = 4;

/// What requests are read from.
#[derive(Clone, Copy)]
pub(crate) struct RequestSources<'a> {
    pub(crate) context: &'a Context,
    pub(crate) record: &'a EngineRecorder,
    pub(crate) evidence_files: &'a EvidenceFiles,
}

/// The open nonces, by approval request and approver. Closing a request removes its nonces. An approver who asks again
/// before answering gets the same nonce, so that repeated requests cannot void an honest answer.
#[derive(Default)]
pub(super) struct IssuedRequests(BTreeMap<(String, String), Nonce>);

impl IssuedRequests {
    fn nonce(
        &mut self,
        record: &EngineRecorder,
        question: &str,
        who: &str,
    ) -> Result<Option<Nonce>, EngineFault> {
        let key = (question.to_owned(), who.to_owned());
        if let Some(known) = self.0.get(&key) {
            return Ok(Some(known.clone()));
        }
        if self.0.len() >= REQUESTS_MAX {
            return Ok(None);
        }
        let nonce = if record.clock().is_scripted() {
            let digest =
                Digest::of_parts("holdpoint/scripted-request/v1", &[question.as_bytes(), who.as_bytes()]);
            let mut bytes = [0; 16];
            bytes.copy_from_slice(&digest.bytes()[..16]);
            Nonce::from_bytes(bytes)
        } else {
            Nonce::random().map_err(|error| EngineFault::Impossible(error.to_string()))?
        };
        self.0.insert(key, nonce.clone());
        Ok(Some(nonce))
    }

    fn is_open(&self, question: &str, who: &str, nonce: &Nonce) -> bool {
        self.0.get(&(question.to_owned(), who.to_owned())) == Some(nonce)
    }

    /// An answer was taken: the next one takes another request.
    pub(super) fn answered(&mut self, question: &str, who: &str) {
        self.0.remove(&(question.to_owned(), who.to_owned()));
    }

    pub(super) fn close(&mut self, question: &str) {
        self.0.retain(|(of, _), _| of != question);
    }
}

/// The text shown to an approver: its lines, and the facts behind them.
pub(crate) struct DisplayedText {
    lines: Vec<String>,
    facts: String,
}

impl DisplayedText {
    /// The record of it, beside the decision that was signed over it.
    pub(crate) fn record(&self, approval: &Approval) -> Result<AuditBody, EngineFault> {
        let body = serde_json::json!({
            "by": approval.who,
            "nonce": approval.nonce,
            "lines": self.lines,
            "facts": self.facts,
        });
        // As every body that is judged: it has one text.
        let body = canonical_json(&body)?;
        Ok(AuditBody { kind: RecordKind::Shown, subject: approval.version.to_string(), body })
    }
}

impl Approvals {
    /// The question about a version as one person gets it.
    ///
    /// # Errors
    /// If the version cannot be read, or the machine gives no random number.
    pub(crate) fn question(
        &mut self,
        from: RequestSources<'_>,
        (id, purpose): (&CapabilityId, RequestKind),
        who: &str,
    ) -> Result<Reply, EngineFault> {
        let RequestSources { context, record, .. } = from;
        let store = record.version_table().store();
        let who = match person(&store.persons()?, who) {
            Ok(who) => who,
            Err(refusal) => return Ok(refusal),
        };
        let emergency = match purpose {
            RequestKind::Emergency => break_glass_approvals::break_glass_request(from, id),
            RequestKind::Activation | RequestKind::Release | RequestKind::Review => None,
        };
        let pending = self.of(id).filter(|pending| pending.kind == purpose);
        let Some(pending) = emergency.as_ref().or(pending) else {
            let why = QuestionRefusal::NothingPending { purpose, version: id.clone() };
            return Ok(refused(&why));
        };
        let reader = RequestReader {
            asked: Some((&who.name, who.role)),
            earlier: &pending.answers,
            at: record.wall_now(),
        };
        let facts = facts(from, id, pending, &reader)?;
        let (lines, facts) = (render(&facts), canonical_json(&facts)?);
        let valid_until = valid_until(context, record, pending);
        let question = pending.row.id.clone();
        let Some(request) = self.requests.nonce(record, &question, &who.name)? else {
            let why = QuestionRefusal::TooManyRequests { max: REQUESTS_MAX };
            return Ok(refused(&why));
        };
        let question = ApprovalDocument {
            lines,
            facts,
            renderer: RENDERER_VERSION,
            request,
            store_id: store.store_id().to_owned(),
            store_key: hex(store.public_key().as_bytes()),
            valid_until,
        };
        Ok(Reply::Question { question: Box::new(question) })
    }

    /// Returns the text that a decision was signed over, if its nonce is open and the approver would see the same text now.
    /// A rejection without a text gives `None`.
    pub(super) fn displayed_text(
        &self,
        from: RequestSources<'_>,
        pending: &PendingApproval,
        approval: &Approval,
    ) -> Result<Result<Option<DisplayedText>, Reply>, EngineFault> {
        let RequestSources { context, record, .. } = from;
        let stale = |cause| {
            let why = QuestionRefusal::AnswerVoid { version: approval.version.clone(), cause };
            Ok(Err(refused(&why)))
        };
        let Some(binding) = &approval.shown else {
            return match approval.decision {
                ApprovalDecision::Reject => Ok(Ok(None)),
                ApprovalDecision::Approve => stale(AnswerVoidCause::NotDisplayed),
            };
        };
        if !self.requests.is_open(&pending.row.id, &approval.who, &binding.request) {
            return stale(AnswerVoidCause::RequestClosed);
        }
        if approval.not_after() > valid_until(context, record, pending) {
            return stale(AnswerVoidCause::ValidTooLong);
        }
        let reader = RequestReader {
            asked: Some((&approval.who, approval.role)),
            earlier: &pending.answers,
            at: record.wall_now(),
        };
        match check_display(from, (pending, &approval.version), &reader, binding)? {
            Ok(texts) => Ok(Ok(Some(texts))),
            Err(cause) => stale(cause),
        }
    }

    /// Whether an approver would see another text now: then the earlier answers no longer count.
    ///
    /// # Errors
    /// If the version cannot be read.
    pub(crate) fn is_outdated(
        &self,
        from: RequestSources<'_>,
        id: &CapabilityId,
    ) -> Result<bool, EngineFault> {
        let Some(pending) = self.of(id) else { return Ok(false) };
        for (number, answer) in pending.answers.iter().enumerate() {
            let earlier = pending.answers.get(..number).unwrap_or_default();
            if !is_display_current(from, pending, answer, earlier)? {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

/// Until when an answer that is given now counts.
fn valid_until(context: &Context, record: &EngineRecorder, pending: &PendingApproval) -> WallTime {
    match pending.kind {
        RequestKind::Emergency => pending.row.until,
        RequestKind::Activation | RequestKind::Release | RequestKind::Review => {
            record.wall_now().plus_secs(context.profile.approval.valid_s)
        }
    }
}

/// Whether a recorded decision was signed over the text that its approver would see now, after these earlier answers. A
/// rejection counts without a text; an approval that an older program recorded without one does not.
pub(super) fn is_display_current(
    from: RequestSources<'_>,
    pending: &PendingApproval,
    answer: &RecordedAnswer,
    earlier: &[RecordedAnswer],
) -> Result<bool, EngineFault> {
    let approval = answer.signed.approval();
    let Some(binding) = &approval.shown else { return Ok(approval.decision == ApprovalDecision::Reject) };
    let reader = RequestReader { asked: Some((&approval.who, approval.role)), earlier, at: answer.at };
    let of = (pending, &approval.version);
    Ok(check_display(from, of, &reader, binding)?.is_ok())
}

fn check_display(
    from: RequestSources<'_>,
    (pending, version): (&PendingApproval, &CapabilityId),
    reader: &RequestReader<'_>,
    binding: &DisplayBinding,
) -> Result<Result<DisplayedText, AnswerVoidCause>, EngineFault> {
    if binding.renderer != RENDERER_VERSION {
        return Ok(Err(AnswerVoidCause::OtherRenderer));
    }
    if binding.store_key != hex(from.record.version_table().store().public_key().as_bytes()) {
        return Ok(Err(AnswerVoidCause::OtherStoreKey));
    }
    let facts = facts(from, version, pending, reader)?;
    let (lines, facts) = (render(&facts), canonical_json(&facts)?);
    Ok(if facts_digest(&facts) != binding.facts {
        Err(AnswerVoidCause::OtherFacts)
    } else if lines_digest(&lines) != binding.lines {
        Err(AnswerVoidCause::OtherLines)
    } else {
        Ok(DisplayedText { lines, facts })
    })
}

/// The lines of a request for observers; empty if the version cannot be read.
pub(super) fn overview(
    from: RequestSources<'_>,
    id: &CapabilityId,
    pending: &PendingApproval,
) -> Vec<String> {
    let reader = RequestReader { asked: None, earlier: &pending.answers, at: from.record.wall_now() };
    facts(from, id, pending, &reader).map(|facts| render(&facts)).unwrap_or_default()
}

/// The reader of a request.
struct RequestReader<'a> {
    /// The approver; absent for an observer.
    asked: Option<(&'a str, Role)>,
    /// The answers recorded before theirs.
    earlier: &'a [RecordedAnswer],
    /// When they read it, or when their answer was recorded.
    at: WallTime,
}

fn facts(
    from: RequestSources<'_>,
    id: &CapabilityId,
    pending: &PendingApproval,
    reader: &RequestReader<'_>,
) -> Result<ApprovalFacts, EngineFault> {
    let RequestSources { context, record, evidence_files } = from;
    let (_, lifecycle, member) = record.version_table().version(id)?;
    let empty = EvidenceFile::default();
    let evidence_file = evidence_files.of(id).unwrap_or(&empty);
    let (profile, request) = (&context.profile, &pending.quorum);
    let activates = matches!(pending.kind, RequestKind::Activation | RequestKind::Emergency);
    let against = evidence_file
        .reasons
        .iter()
        .filter(|reason| !is_in_favor(reason.code) && reason.code != ReasonCode::ApprovalPending);
    let dimensions = evidence_file.dimensions(profile);
    let (failures, why) = decided(evidence_file, &dimensions);
    let votes: Vec<Vote> =
        reader.earlier.iter().map(|answer| vote(context, pending.kind, &answer.signed)).collect();
    Ok(ApprovalFacts {
        asked: reader.asked.map(|(name, role)| RequestedSigner {
            name: name.to_owned(),
            role,
            void: void(context, record, pending, name, role),
        }),
        question: pending.row.id.clone(),
        purpose: pending.kind,
        version: id.clone(),
        replaces: pending.replaces.clone(),
        robot: context.cell.spec.robot.name.clone(),
        candidate: request.subject.candidate,
        row_version: pending.row.row_version,
        evidence: pending.row.evidence_digest,
        policy: context.digest,
        profile: profile.name,
        site: profile.site.clone(),
        needed: if pending.kind == RequestKind::Emergency { 1 } else { u32::from(request.quorum) },
        until: (pending.kind != RequestKind::Emergency).then_some(pending.row.until),
        risk: request.risk,
        assessed: evidence_file.risk.clone(),
        requester: request.requester.clone(),
        author: request.author.clone(),
        asked_by: request.asked_by.as_ref().map(|asker| asker.name().to_owned()),
        about: pending.about.clone(),
        summary: member.capability.submission.summary.clone(),
        component: component(record, &member.capability, pending)?,
        state: lifecycle.state,
        deployment: evidence_file.deployment,
        stale: stale_causes(
            context,
            record.version_table(),
            &member.capability,
            lifecycle.state,
            evidence_file,
        ),
        pairs: evidence_view::pairs(evidence_file).map(|pairs| PairsFacts {
            n: pairs.n,
            candidate: pairs.candidate.success,
            candidate_interval: pairs.candidate_success,
            active: pairs.active.success,
            active_interval: pairs.active_success,
        }),
        counted: evidence_file.counted.clone(),
        shadow: evidence_view::shadow(evidence_file, &profile.evaluation).map(|shadow| ShadowFacts {
            n: shadow.n,
            output: shadow.output,
            governance: shadow.governance,
            envelope: shadow.envelope,
        }),
        covers: evidence_file
            .domain
            .clone()
            .map(|domain| CoverageFacts { domain, outside: profile.domain.outside }),
        reasons: against.take(REASONS_MAX).cloned().collect(),
        failures,
        why,
        new_permissions: evidence_file.new_permissions.clone(),
        changes: evidence_file.changes.clone(),
        conditions: evidence_file.conditions.clone(),
        untested: untested(evidence_file),
        on_drift: activates
            .then(|| on_drift(context, pending, evidence_file, evidence_files.has_open_concern(id))),
        signed_before: signed_before(pending, reader, &votes),
        effect: reader.asked.and_then(|asked| effect(context, pending, asked, votes, reader.at)),
        dimensions,
    })
}

/// What decided the failed ones of behavior and recovery, and what the others.
fn decided(evidence_file: &EvidenceFile, dimensions: &[DimensionResult]) -> (Vec<String>, Vec<String>) {
    let failed = |of: &Dimension| {
        dimensions.iter().any(|one| one.dimension == *of && one.outcome == DimensionOutcome::Incompatible)
    };
    let (failed, rest): (Vec<Dimension>, Vec<Dimension>) = SUMMARIZED.into_iter().partition(failed);
    let of = |about: &[Dimension]| {
        if about.is_empty() { Vec::new() } else { summary(evidence_file, about) }
    };
    let (failures, mut why) = (of(&failed), of(&rest));
    // How confined code failed stands with the failures, where there are any.
    why.retain(|line| !failures.contains(line));
    (failures, why)
}

/// The component that a version runs; absent for code compiled into the engine.
fn component(
    record: &EngineRecorder,
    capability: &Capability,
    pending: &PendingApproval,
) -> Result<Option<ComponentFacts>, EngineFault> {
    let BundleSource::Wasm(file) = &capability.manifest.deployment.bundle else { return Ok(None) };
    let replaced = match pending.kind {
        RequestKind::Activation | RequestKind::Emergency => pending.replaces.as_ref(),
        RequestKind::Release | RequestKind::Review => None,
    };
    let replaced = replaced.map(|id| record.capability(id)).transpose()?;
    let replaces = replaced.map(|active| String::from(active.manifest.deployment.bundle.clone()));
    let file = file.as_str().to_owned();
    Ok(Some(ComponentFacts { replaces: replaces.filter(|code| *code != file), file }))
}

/// The earlier approvals that counted when the reader read; `votes` are the rule's form of the earlier answers.
fn signed_before(
    pending: &PendingApproval,
    reader: &RequestReader<'_>,
    votes: &[Vote],
) -> Vec<EarlierSignature> {
    let counted = approval::counted(&pending.quorum, votes, reader.at);
    let answers = reader.earlier.iter().zip(votes);
    answers
        .filter(|(_, vote)| counted.iter().any(|counted| std::ptr::eq(*counted, *vote)))
        .map(|(answer, vote)| EarlierSignature {
            name: vote.person.clone(),
            role: vote.role,
            at: answer.at,
            reason: vote.reason.clone(),
        })
        .collect()
}

/// What an approval of this person would do after these votes, by the rules that count it.
fn effect(
    context: &Context,
    pending: &PendingApproval,
    (name, role): (&str, Role),
    mut votes: Vec<Vote>,
    at: WallTime,
) -> Option<SignatureEffect> {
    let outcome =
        |votes: &[Vote]| approval::evaluate(&pending.quorum, votes, at, &context.profile.approval).outcome;
    let count = |votes: &[Vote]| approval::counted(&pending.quorum, votes, at).len();
    let before = count(&votes);
    match outcome(&votes) {
        ApprovalOutcome::NotNeeded | ApprovalOutcome::Granted { .. } | ApprovalOutcome::Refused { .. } => {
            return None;
        }
        ApprovalOutcome::Pending { .. } | ApprovalOutcome::TimedOut => {}
    }
    votes.push(supposed_approval(pending, name, role));
    if count(&votes) == before {
        return None;
    }
    match outcome(&votes) {
        ApprovalOutcome::Granted { .. } => Some(SignatureEffect::Completes),
        ApprovalOutcome::Pending { .. } | ApprovalOutcome::TimedOut => Some(SignatureEffect::MoreNeeded),
        ApprovalOutcome::NotNeeded | ApprovalOutcome::Refused { .. } => None,
    }
}

/// The vote that a person would give by approving.
fn supposed_approval(pending: &PendingApproval, name: &str, role: Role) -> Vote {
    Vote {
        person: name.to_owned(),
        key: String::new(),
        role,
        answer: ApprovalDecision::Approve,
        reason: "asked".to_owned(),
        subject: pending.quorum.subject,
        until: WallTime::from_ms(i64::MAX),
        break_glass: pending.kind == RequestKind::Emergency,
        signature: SignatureCheck::Valid,
        nonce_used: false,
    }
}

/// Why an approval would not count, by the rules that count it.
fn void(
    context: &Context,
    record: &EngineRecorder,
    pending: &PendingApproval,
    name: &str,
    role: Role,
) -> Option<ReasonCode> {
    let vote = supposed_approval(pending, name, role);
    let result = approval::evaluate(&pending.quorum, &[vote], record.wall_now(), &context.profile.approval);
    let against = |code: &ReasonCode| matches!(code, ReasonCode::ApprovalSelf | ReasonCode::ApprovalRole);
    result.reasons.iter().map(|reason| reason.code).find(against)
}

/// What happens when a version gets worse after its activation, and what confirms it.
pub(super) fn on_drift(
    context: &Context,
    pending: &PendingApproval,
    evidence_file: &EvidenceFile,
    in_doubt: bool,
) -> DriftResponse {
    let monitor = &context.profile.monitor;
    let watch = Strictness::of(&evidence_file.conditions);
    DriftResponse {
        back: pending.replaces.clone(),
        coupled: watch.coupled,
        restricted_to: monitor.restrict_factor,
        answer_within_s: monitor.escalation_deadline_s,
        confirmed_after: context.profile.activation.provisional_episodes,
        in_doubt,
        limits: (watch.factor < 1.0).then(|| stricter_levels(&watch, monitor)),
    }
}
