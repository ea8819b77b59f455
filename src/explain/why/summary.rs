//! The short explanation of a version, in typed values: what it is, the deciding reasons, and what ends it.
//!
//! Reads the decisions of [`super::decisions`] and the rows beside them. It judges nothing: the order of the reasons is that
//! of the rules, and among further reasons of one code the larger excess comes first.

mod decisive_reasons;

use std::cmp::Reverse;
use std::collections::BTreeMap;

use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Dimension, Kappa, Reason};
use holdpoint_governance::evidence::{DrillKind, EpisodeValues};
use holdpoint_governance::explanation::{
    ActiveTerms, Approver, Consequence, DecisionRemark, DecisiveReason, DrillComparison, EvidenceExtent,
    ExplanationSummary, FailureCounts, PassedCheck, PendingStep, RecordMoment, Remedy, RemedyAction,
    SummaryRemark, TwinFailures, VersionPosition,
};
use holdpoint_governance::failure_cause::FailureCause;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::notice::NoticeOrText;
use holdpoint_governance::outcome::{ActivationMode, Basis, CheckResult, StageOutcome};
use holdpoint_governance::permission::PermissionUse;
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_governance::rollback::{PostStatus, RollbackRecord};
use holdpoint_governance::version_status::{StatusFacts, VersionCondition, VersionStatus, next_stage};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::explanation::{PeopleRuling, Ruling};
use holdpoint_store::{ApprovalEntry, EvidenceKind, FamilyStatus, RecordViews, StoreError, VersionDetail};

pub(super) use decisive_reasons::decision_remedies;
use decisive_reasons::{decisive_reasons, reason_remedies};

use super::evidence_file_before;
use super::explained_decision::{DecisionReason, ExplainedDecision};
use holdpoint_record::rationale::lenient_bodies::{
    EvidenceFileRecord, GateRecord, RequestRecord, ReviewRecord, StateSetRecord,
};
use holdpoint_record::rationale::remedy::is_in_favor;
use holdpoint_record::version_concern::VersionConcern;

/// Explains a version in short; `None` if it is not in the store.
///
/// # Errors
/// If the store cannot be read.
pub fn summarize(
    views: &dyn RecordViews,
    id: &CapabilityId,
) -> Result<Option<ExplanationSummary>, StoreError> {
    let Some(detail) = views.version(id)? else { return Ok(None) };
    let records = super::records_about(views, id, &detail)?;
    let decisions = super::decisions_in(&records, &detail);
    let family = views.families()?.into_iter().find(|family| family.name == id.family.as_str());
    let recorded = views.recorded_changes(id)?;
    let status = VersionStatus::of(&StatusFacts {
        state: detail.summary.state,
        flags: &detail.summary.flags,
        held: recorded.has_lapsed() || is_held_by_gate(&decisions),
        reasons: &[],
        obstacle: None,
        recorded: &recorded,
    });
    SummaryReader {
        views,
        id,
        detail: &detail,
        decisions: &decisions,
        records: &records,
        family: family.as_ref(),
        status: &status,
    }
    .summary()
    .map(Some)
}

/// Whether the newest decision of a stage is the gate's hold.
fn is_held_by_gate(decisions: &[ExplainedDecision]) -> bool {
    let newest = decisions.iter().rev().find(|decision| stage_of(&decision.ruling).is_some());
    newest.is_some_and(
        |decision| matches!(&decision.ruling, Ruling::Activation(outcome) if *outcome == StageOutcome::Hold),
    )
}

/// Everything about one version that is on record.
struct SummaryReader<'a> {
    views: &'a dyn RecordViews,
    id: &'a CapabilityId,
    detail: &'a VersionDetail,
    decisions: &'a [ExplainedDecision],
    records: &'a [AuditRecord],
    family: Option<&'a FamilyStatus>,
    status: &'a VersionStatus,
}

/// What a version is, and what led to it.
struct FoundPosition<'a> {
    position: VersionPosition,
    /// Number of the record, and virtual time, ms.
    since: (u64, u64),
    /// The decision whose reasons count; absent if no rule decided.
    decision: Option<&'a ExplainedDecision>,
    /// What has to change beside the reasons.
    remedies: Vec<Remedy>,
}

impl<'a> SummaryReader<'a> {
    fn summary(&self) -> Result<ExplanationSummary, StoreError> {
        let FoundPosition { position, since, decision, remedies } = self.position()?;
        let last = decision.map_or(u64::MAX, |decision| decision.record);
        let file = evidence_file_before(&self.detail.evidence, last);
        let reasons = decision
            .map_or_else(Vec::new, |decision| decisive_reasons(decision, &file, is_adverse(&position)));
        let against = reasons.iter().map(|reason| DecisiveReason {
            content: reason.record.content(),
            measured: reason.measured.cloned(),
        });
        Ok(ExplanationSummary {
            version: self.id.clone(),
            since: self.moment(since)?,
            compared: self.compared(&file)?,
            against: against.collect(),
            passed: passed_checks(&file),
            remarks: self.remarks(&position, &file)?,
            remedies: if changes_by_remedies(&position) {
                [reason_remedies(&reasons, &file), remedies].concat()
            } else {
                Vec::new()
            },
            has_recording: self.has_recording(),
            position,
        })
    }

    fn position(&self) -> Result<FoundPosition<'a>, StoreError> {
        Ok(match self.detail.summary.state {
            State::Rejected => self.rejected(),
            State::RolledBack | State::Demoted => self.left(),
            State::Superseded => self.superseded(),
            State::Active => self.active(),
            State::Registered | State::Validated | State::Sandboxed | State::Shadowed => self.waiting()?,
        })
    }

    fn rejected(&self) -> FoundPosition<'a> {
        let Some(decision) = self.decision_to(State::Rejected) else {
            let cause = DecisionRemark::StateChange(self.state_cause());
            return self.unexplained(VersionPosition::RejectedByPeople(cause));
        };
        let since = (decision.record, decision.at_ms);
        match stage_of(&decision.ruling) {
            Some(stage) => {
                let file = evidence_file_before(&self.detail.evidence, decision.record);
                let position = VersionPosition::Rejected { stage, extent: extent(stage, &file) };
                FoundPosition { position, since, decision: Some(decision), remedies: Vec::new() }
            }
            None => FoundPosition {
                position: VersionPosition::RejectedByPeople(self.rejection(decision)),
                since,
                decision: None,
                remedies: vec![Remedy::Act(RemedyAction::RegisterAgain)],
            },
        }
    }

    /// The answer that rejected the version, or what changed its state.
    fn rejection(&self, decision: &ExplainedDecision) -> DecisionRemark {
        let rejects = |decision: &&ExplainedDecision| {
            decision.ruling == Ruling::People(PeopleRuling::Answered(ApprovalDecision::Reject))
        };
        let answer = self.decisions.iter().rev().find(rejects).and_then(first_remark);
        let remark = answer.or_else(|| first_remark(decision)).cloned();
        remark.unwrap_or_else(|| DecisionRemark::StateChange(self.state_cause()))
    }

    /// A version that left control, or evaluation.
    fn left(&self) -> FoundPosition<'a> {
        let state = self.detail.summary.state;
        if let Some(stage) = self.detail.summary.flags.running {
            return self.unexplained(VersionPosition::Waiting(PendingStep::StageEnd(stage)));
        }
        let Some(decision) = self.decision_to(state) else {
            let cause = self.state_cause();
            return self.unexplained(if state == State::RolledBack {
                let status = PostStatus::RolledBack;
                VersionPosition::RolledBack { status, target: None, cause, measured: None }
            } else {
                VersionPosition::Returned { stage: None, cause: Some(cause) }
            });
        };
        let since = (decision.record, decision.at_ms);
        if let Some(rollback) = self.rollback(decision) {
            let by_monitor = rollback.trigger.kind.is_by_monitor();
            let position = VersionPosition::RolledBack {
                status: rollback.post_status,
                target: rollback.predecessor,
                cause: rollback.trigger.text,
                measured: rollback.trigger.measured,
            };
            let failures = rollback.rungs.iter().filter_map(|rung| rung.failure);
            let remedies = failures.map(Remedy::RepairRung).collect();
            let decision = self.monitor_decision(decision.record).filter(|_| by_monitor);
            return FoundPosition { position, since, decision, remedies };
        }
        let stage = stage_of(&decision.ruling);
        let cause = stage.is_none().then(|| match first_remark(decision) {
            Some(DecisionRemark::StateChange(cause)) => cause.clone(),
            Some(_) | None => self.state_cause(),
        });
        let position = VersionPosition::Returned { stage, cause };
        let decision = stage.is_some().then_some(decision);
        FoundPosition { position, since, decision, remedies: Vec::new() }
    }

    /// The record of the rollback that a decision explains.
    fn rollback(&self, decision: &ExplainedDecision) -> Option<RollbackRecord> {
        if !matches!(decision.ruling, Ruling::Rollback(_)) {
            return None;
        }
        let entries = self.detail.evidence.iter().rev();
        let mut of_kind =
            entries.filter(|entry| entry.kind == EvidenceKind::Rollback && entry.seq <= decision.record);
        of_kind.find_map(|entry| serde_json::from_str(&entry.json).ok())
    }

    fn superseded(&self) -> FoundPosition<'a> {
        let is_target = self.family.is_some_and(|family| family.pinned.as_ref() == Some(self.id));
        let mut moves = self.detail.activations.iter().rev();
        match moves.find(|entry| entry.pinned.as_ref() == Some(self.id)) {
            Some(entry) => FoundPosition {
                position: VersionPosition::Superseded { by: entry.active.clone(), is_target },
                since: (entry.seq, entry.at_ms),
                decision: None,
                remedies: Vec::new(),
            },
            None => self.unexplained(VersionPosition::Superseded { by: None, is_target }),
        }
    }

    fn active(&self) -> FoundPosition<'a> {
        let flags = &self.detail.summary.flags;
        let mut moves =
            self.detail.activations.iter().rev().filter(|entry| entry.active.as_ref() == Some(self.id));
        let Some(entry) = moves.next() else {
            return self.unexplained(VersionPosition::Waiting(PendingStep::StageStart(Stage::Activation)));
        };
        // Approvals of an earlier activation are consumed too.
        let earlier = moves.next().map_or(0, |entry| entry.seq);
        let is_used = |answer: &&ApprovalEntry| {
            let used = answer.consumed_seq.is_some_and(|seq| earlier < seq && seq < entry.seq);
            used && answer.signed.approval().decision == ApprovalDecision::Approve
        };
        let used: Vec<_> =
            self.detail.approvals.iter().filter(is_used).map(|answer| answer.signed.approval()).collect();
        let approvers = used
            .iter()
            .map(|approval| Approver { person: approval.who.clone(), role: approval.role })
            .collect();
        let review = self.records.iter().rev().find(|record| record.kind == RecordKind::BreakGlassReviewed);
        let review = review.filter(|record| record.seq > entry.seq);
        let review: ReviewRecord =
            review.and_then(|record| serde_json::from_str(&record.body).ok()).unwrap_or_default();
        let terms = ActiveTerms {
            cause: entry.cause,
            approvers,
            is_break_glass: used.iter().any(|approval| approval.break_glass),
            reviewed_by: review.by,
            target: self.family.and_then(|family| family.pinned.clone()),
            conditions: self.conditions(flags.provisional),
            is_provisional: flags.provisional,
            is_restricted: flags.restricted,
        };
        FoundPosition {
            position: VersionPosition::Active(terms),
            since: (entry.seq, entry.at_ms),
            decision: self.monitor_decision(u64::MAX).filter(|_| flags.restricted),
            remedies: Vec::new(),
        }
    }

    /// The conditions of the last gate that bound how the version is used now.
    fn conditions(&self, provisional: bool) -> Vec<Condition> {
        let mut gates = self.detail.evidence.iter().rev().filter(|entry| entry.kind == EvidenceKind::Gate);
        let gate = gates.find_map(|entry| serde_json::from_str::<GateRecord>(&entry.json).ok());
        let all = gate.and_then(|gate| gate.answers.conditions).unwrap_or_default();
        let bounds = |of: &Condition| of.bounds_use() || *of == Condition::RollbackCoupled;
        all.into_iter().filter(|of| bounds(of) && (provisional || of.outlives_confirmation())).collect()
    }

    fn waiting(&self) -> Result<FoundPosition<'a>, StoreError> {
        let summary = &self.detail.summary;
        let decision = self.decisions.iter().rev().find(|decision| stage_of(&decision.ruling).is_some());
        let request = if summary.flags.awaiting_approval { self.open_request()? } else { None };
        let step = match (self.status.condition, request) {
            (VersionCondition::Paused, _) => PendingStep::Resumption,
            (_, Some(request)) => request,
            (VersionCondition::Held, None) => match self.unanswered() {
                Some(until) => PendingStep::Unanswered(until),
                None => PendingStep::Gate,
            },
            (_, None) => match summary.flags.running {
                Some(stage) => PendingStep::StageEnd(stage),
                None => PendingStep::StageStart(next_stage(summary.state)),
            },
        };
        let found = self.unexplained(VersionPosition::Waiting(step));
        Ok(FoundPosition { decision, ..found })
    }

    /// The open approval request, with the people who approved the same evidence.
    fn open_request(&self) -> Result<Option<PendingStep>, StoreError> {
        let Some(request) =
            self.views.open_requests()?.into_iter().find(|request| request.version == *self.id)
        else {
            return Ok(None);
        };
        let mut approved_by: Vec<String> = Vec::new();
        for answer in self.detail.approvals.iter().filter(|answer| answer.consumed_seq.is_none()) {
            let approval = answer.signed.approval();
            let is_same = approval.row_version == request.row_version
                && approval.evidence_digest == request.evidence_digest
                && !approval.break_glass;
            if is_same {
                // The last answer of a person counts.
                approved_by.retain(|person| *person != approval.who);
                approved_by
                    .extend((approval.decision == ApprovalDecision::Approve).then(|| approval.who.clone()));
            }
        }
        Ok(Some(PendingStep::Approval { needed: request.needed, approved_by, until: request.until }))
    }

    /// The deadline of the last approval request, if it passed and no operator has resumed the version since.
    fn unanswered(&self) -> Option<WallTime> {
        let is_step = |record: &&AuditRecord| {
            [RecordKind::ApprovalRequested, RecordKind::Resumed].iter().any(|of| record.kind == *of)
        };
        let last = self.records.iter().rev().find(is_step)?;
        serde_json::from_str::<RequestRecord>(&last.body).ok()?.expired()
    }

    /// A position that no decision explains: since the last change of the version.
    fn unexplained(&self, position: VersionPosition) -> FoundPosition<'a> {
        let changes = [RecordKind::StateSet, RecordKind::FlagsSet, RecordKind::VersionRegistered];
        let last = self.records.iter().rev().find(|record| changes.iter().any(|of| record.kind == *of));
        let since = last.map_or((0, self.detail.registered_ms), |record| (record.seq, record.at_ms));
        FoundPosition { position, since, decision: None, remedies: Vec::new() }
    }

    /// The last decision after which the version was in this state.
    fn decision_to(&self, state: State) -> Option<&'a ExplainedDecision> {
        let leads = |decision: &&ExplainedDecision| {
            let consequences = decision.consequences.iter();
            consequences
                .map(|(_, of)| of)
                .any(|of| matches!(of, Consequence::StateChanged { to, .. } if *to == state))
        };
        self.decisions.iter().rev().find(leads)
    }

    /// The last decision of the drift monitor before a record.
    fn monitor_decision(&self, record: u64) -> Option<&'a ExplainedDecision> {
        let is_one = |of: &&ExplainedDecision| of.record < record && matches!(of.ruling, Ruling::Monitor(_));
        self.decisions.iter().rev().find(is_one)
    }

    /// Why the state changed last.
    fn state_cause(&self) -> NoticeOrText {
        let last = self.records.iter().rev().find(|record| record.kind == RecordKind::StateSet);
        let read = last.and_then(|record| serde_json::from_str::<StateSetRecord>(&record.body).ok());
        read.map(|read| read.change.reason).unwrap_or_default()
    }

    fn moment(&self, (record, at_ms): (u64, u64)) -> Result<RecordMoment, StoreError> {
        let wall_ms = self.views.stamp(record)?.and_then(|stamp| stamp.wall_ms);
        Ok(RecordMoment { record, at_ms, wall: wall_ms.map(WallTime::from_ms) })
    }

    /// The version that the evidence compares with.
    fn compared(&self, file: &EvidenceFileRecord) -> Result<Option<CapabilityId>, StoreError> {
        let binding = file.bindings.iter().flatten().next();
        let Some(digest) = binding.and_then(|binding| binding.active) else { return Ok(None) };
        // A family may have thousands of versions, and reading one reads its evidence: the near ones are enough.
        let active = self.family.and_then(|family| family.active.clone());
        let pinned = self.family.and_then(|family| family.pinned.clone());
        for near in [self.detail.parent.clone(), active, pinned].into_iter().flatten() {
            if self.views.version(&near)?.is_some_and(|version| version.candidate_digest == digest) {
                return Ok(Some(near));
            }
        }
        Ok(None)
    }

    fn remarks(
        &self,
        position: &VersionPosition,
        file: &EvidenceFileRecord,
    ) -> Result<Vec<SummaryRemark>, StoreError> {
        let status = Some(self.status).filter(|status| status.is_limited()).cloned();
        let mut remarks: Vec<SummaryRemark> = status.map(SummaryRemark::Limited).into_iter().collect();
        remarks.extend(file.counted.clone().map(SummaryRemark::Counted));
        let excesses = file.permissions.as_ref().map(PermissionUse::excesses).unwrap_or_default();
        // What does not count explains no rejection.
        let is_shown = |counts: bool| counts || !is_adverse(position);
        let shown = excesses.into_iter().filter(|excess| is_shown(excess.effect().counts()));
        remarks.extend(shown.map(SummaryRemark::BeyondDeclaration));
        if is_adverse(position) {
            remarks.extend(failure_counts(file).map(SummaryRemark::FailureCauses));
            remarks.extend(twin_failures(file).map(SummaryRemark::TwinFailures));
            return Ok(remarks);
        }
        remarks.extend(fewer_drills_passed(file).into_iter().map(SummaryRemark::FewerDrillsPassed));
        remarks.extend(file.domain.clone().map(SummaryRemark::Covered));
        if matches!(position, VersionPosition::Active(_)) {
            remarks.extend(self.open_concern(file).map(SummaryRemark::OpenConcern));
            let reviews = self.views.open_reviews()?;
            let review = reviews.into_iter().find(|(version, _)| version == self.id);
            remarks.extend(review.map(|(_, until)| SummaryRemark::ReviewUntil(until)));
        }
        Ok(remarks)
    }

    /// The first reason of an open concern, from the live cell or from the activation.
    fn open_concern(&self, file: &EvidenceFileRecord) -> Option<Reason> {
        let mut monitored =
            self.detail.evidence.iter().rev().filter(|entry| entry.kind == EvidenceKind::Monitor);
        let concern = monitored.find_map(|entry| serde_json::from_str::<VersionConcern>(&entry.json).ok());
        if let Some(concern) = concern.filter(VersionConcern::is_open) {
            return concern.reasons.into_iter().next();
        }
        // The end of the window settles the concern of an activation.
        if !self.detail.summary.flags.provisional {
            return None;
        }
        let kappas = file.assessments()?;
        let coupled = CheckResult::PassRestricted(ActivationMode::RollbackCoupled);
        let is_coupled = |of: Dimension| kappas.checks().contains(&(of, coupled));
        let mut reasons = kappas.reasons().into_iter();
        reasons.find(|reason| !is_in_favor(reason.code) && is_coupled(reason.dimension))
    }

    fn has_recording(&self) -> bool {
        let kinds = [RecordKind::Recording, RecordKind::RecordingRemoved];
        let last = self.records.iter().rev().find(|record| kinds.iter().any(|of| record.kind == *of));
        last.is_some_and(|record| record.kind == RecordKind::Recording)
    }
}

/// Why tasks failed in the pairs, where the version failed in more of them than the one compared with.
fn failure_counts(file: &EvidenceFileRecord) -> Option<FailureCounts> {
    let pairs = file.pairs.as_ref()?;
    let own = by_cause(pairs.iter().map(|pair| &pair.candidate));
    let other = by_cause(pairs.iter().map(|pair| &pair.active));
    let failed = |counts: &[(FailureCause, usize)]| counts.iter().map(|(_, count)| count).sum::<usize>();
    (failed(&own) > failed(&other)).then_some(FailureCounts { pairs: pairs.len(), own, other })
}

/// Why tasks of the twins failed; absent if none did.
fn twin_failures(file: &EvidenceFileRecord) -> Option<TwinFailures> {
    let twins = file.twins.as_ref()?;
    let own = by_cause(twins.iter());
    (!own.is_empty()).then_some(TwinFailures { tasks: twins.len(), own })
}

/// Failed tasks by their cause, the most frequent first.
fn by_cause<'a>(values: impl Iterator<Item = &'a EpisodeValues>) -> Vec<(FailureCause, usize)> {
    let mut counts = BTreeMap::<FailureCause, usize>::new();
    values.filter_map(|values| values.failure).for_each(|cause| *counts.entry(cause).or_default() += 1);
    let mut counts: Vec<_> = counts.into_iter().collect();
    counts.sort_by_key(|(_, count)| Reverse(*count));
    counts
}

/// Whether the version is out of control and evaluation.
const fn is_adverse(position: &VersionPosition) -> bool {
    match position {
        VersionPosition::Rejected { .. }
        | VersionPosition::RejectedByPeople(_)
        | VersionPosition::RolledBack { .. }
        | VersionPosition::Returned { .. } => true,
        VersionPosition::Superseded { .. } | VersionPosition::Active(_) | VersionPosition::Waiting(_) => {
            false
        }
    }
}

/// Whether a change of the version, or of what surrounds it, would have led to another result.
const fn changes_by_remedies(position: &VersionPosition) -> bool {
    is_adverse(position) || matches!(position, VersionPosition::Waiting(PendingStep::Gate))
}

/// The stage whose rule decided; `None` for the monitor, the ladder and people.
const fn stage_of(ruling: &Ruling) -> Option<Stage> {
    match ruling {
        Ruling::Registration(_) | Ruling::Validation(_) => Some(Stage::Validation),
        Ruling::Sandbox(_) => Some(Stage::Sandbox),
        Ruling::Shadow(_) => Some(Stage::Shadow),
        Ruling::Activation(_) => Some(Stage::Activation),
        Ruling::Monitor(_) | Ruling::Rollback(_) | Ruling::People(_) => None,
    }
}

fn extent(stage: Stage, file: &EvidenceFileRecord) -> EvidenceExtent {
    let nothing = EvidenceExtent::default();
    match stage {
        Stage::Sandbox => {
            let drills = file.drills.as_ref().map_or(0, |(candidate, _)| {
                DrillKind::ALL.into_iter().map(|kind| u64::from(candidate.of(kind).feasible())).sum::<u64>()
            });
            EvidenceExtent {
                pairs: file.pairs.as_ref().map_or(0, |pairs| pairs.len() as u64),
                drills,
                ..nothing
            }
        }
        Stage::Shadow => {
            let sequences = file.shadow.as_ref().map_or(0, |shadow| u64::from(shadow.sequences));
            EvidenceExtent { sequences, ..nothing }
        }
        Stage::Validation | Stage::Activation => nothing,
    }
}

fn first_remark(decision: &ExplainedDecision) -> Option<&DecisionRemark> {
    decision.reasons.iter().find_map(|reason| match reason {
        DecisionReason::Remark(remark) => Some(remark),
        DecisionReason::Rule { .. } => None,
    })
}

/// The checks that a version passed, as far as they were measured.
fn passed_checks(file: &EvidenceFileRecord) -> Vec<PassedCheck> {
    let mut passed = Vec::new();
    if let Some(kappas) = file.assessments() {
        let measured = [
            (kappas.interface.kappa, kappas.interface.basis),
            (kappas.policy.kappa, kappas.policy.basis),
            (kappas.behavior.kappa, kappas.behavior.basis),
            (kappas.recovery.kappa, kappas.recovery.basis),
        ];
        for ((of, check), (kappa, basis)) in kappas.checks().into_iter().zip(measured) {
            if check.advances() && basis == Basis::Measured {
                let is_restricted = matches!(check, CheckResult::PassRestricted(_));
                passed.push(PassedCheck { of, kappa: kappa.map(Kappa::get), is_restricted, sequences: None });
            }
        }
    }
    if let Some(shadow) = file.shadow.as_ref().filter(|shadow| shadow.check.advances()) {
        let (of, sequences) = (Dimension::Shadow, Some(shadow.sequences));
        passed.push(PassedCheck { of, kappa: None, is_restricted: false, sequences });
    }
    passed
}

/// The kinds of drill that the candidate passed less often than the version compared with.
fn fewer_drills_passed(file: &EvidenceFileRecord) -> Vec<DrillComparison> {
    let Some((candidate, active)) = &file.drills else { return Vec::new() };
    let compared = DrillKind::ALL.map(|kind| DrillComparison {
        kind,
        phase: None,
        candidate: *candidate.of(kind),
        active: *active.of(kind),
    });
    // Shares, compared without division.
    let is_lower = |DrillComparison { candidate, active, .. }: &DrillComparison| {
        u64::from(candidate.passed) * u64::from(active.feasible())
            < u64::from(active.passed) * u64::from(candidate.feasible())
    };
    compared.into_iter().filter(is_lower).collect()
}
