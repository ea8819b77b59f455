//! Why a version is in its state: every decision on record, with the changes that would be needed.
//!
//! Reads only the store's views, so it works without an engine and beside a running one. It judges nothing: every number is
//! computed from the record, and a missing number is omitted. The crate `holdpoint-wording` makes the sentences at the last
//! step.

mod explained_decision;
mod summary;

use explained_decision::{DecisionReason, ExplainedDecision};
use holdpoint_record::rationale::lenient_bodies::{
    self, AnswerChangeRecord, AnswerRecord, ConfirmationRecord, DecisionRecord, EvidenceFileRecord,
    MonitorRecord, MoveRecord, ReasonRecord, StateSetRecord,
};
use holdpoint_record::rationale::remedy;
pub use summary::summarize;

use holdpoint_governance::cached_result::{CachedResultMismatch, SeedRange};
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::explanation::{Consequence, DecisionRemark, Remedy};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_governance::rollback::RollbackRecord;
use holdpoint_governance::version_status::RecordedChanges;
use holdpoint_protocol::explanation::{Explanation, PeopleRuling, Ruling};
use holdpoint_record::recorded_decision;
use holdpoint_record::version_concern::VersionConcern;
use holdpoint_store::{
    AuditFilter, EvidenceEntry, EvidenceKind, PAGE_ROWS_MAX, RecordViews, StoreError, VersionDetail,
};

/// Explains every decision about a version; `None` if it is not in the store.
///
/// # Errors
/// If the store cannot be read.
pub fn explain(views: &dyn RecordViews, id: &CapabilityId) -> Result<Option<Explanation>, StoreError> {
    let Some(detail) = views.version(id)? else { return Ok(None) };
    let decisions = decisions(views, id, &detail)?.into_iter().map(ExplainedDecision::view).collect();
    let summary = detail.summary;
    Ok(Some(Explanation { version: id.clone(), state: summary.state, author: summary.author, decisions }))
}

/// Every decision about a version, in typed values.
///
/// # Errors
/// If the store cannot be read.
pub fn decisions(
    views: &dyn RecordViews,
    id: &CapabilityId,
    detail: &VersionDetail,
) -> Result<Vec<ExplainedDecision>, StoreError> {
    Ok(decisions_in(&records_about(views, id, detail)?, detail))
}

/// Every record about a version that an explanation may read, oldest first.
///
/// Most records of a long history are seals and counts of harm, which no explanation reads. A search without them reads the
/// other records of the whole store, so that it costs more for a short history.
fn records_about(
    views: &dyn RecordViews,
    id: &CapabilityId,
    detail: &VersionDetail,
) -> Result<Vec<AuditRecord>, StoreError> {
    let is_long = detail.audit_links.len() > PAGE_ROWS_MAX;
    let unread = RecordKind::SEALS.into_iter().chain([RecordKind::LiveHarm]);
    let without = unread.filter(|_| is_long).collect();
    views.whole_audit(&AuditFilter { subject: Some(id.to_string()), without, ..AuditFilter::default() })
}

/// The decisions in the records about a version.
fn decisions_in(records: &[AuditRecord], detail: &VersionDetail) -> Vec<ExplainedDecision> {
    let mut reader = DecisionReader { evidence: &detail.evidence, decisions: Vec::new() };
    for (index, record) in records.iter().enumerate() {
        let Some(kind) = record.kind.known() else { continue };
        match kind {
            RecordKind::Decision => reader.decision(record, records.get(..index).unwrap_or_default()),
            RecordKind::Monitor => reader.monitor(record),
            RecordKind::EvidencePut => {
                reader.rollback(record);
                reader.confirmation(record);
            }
            RecordKind::KeptVoided => reader.voided(record),
            RecordKind::ApprovalPut => reader.answer(record),
            RecordKind::ApprovalRequested => reader.add_consequence(record, Consequence::ApproversAsked),
            // The decision already includes the change of state.
            RecordKind::StateSet if decided_with(records.get(index + 1..).unwrap_or_default(), record) => {}
            RecordKind::StateSet => reader.state(record),
            RecordKind::AuditClosed => reader.add_consequence(record, Consequence::UpgradeRecordClosed),
            RecordKind::ProfilesSet => reader.add_consequence(record, Consequence::ProfilesSet),
            RecordKind::PauseSet | RecordKind::Resumed | RecordKind::MonitorAnswer => {
                reader.person_act(record);
            }
            RecordKind::AnchorSet => reader.add_consequence(record, Consequence::AnchorSet),
            RecordKind::TriesReviewed => reader.add_consequence(record, Consequence::TriesReviewed),
            RecordKind::BreakGlass => reader.add_consequence(record, Consequence::BreakGlassUsed),
            RecordKind::BreakGlassReviewed => reader.add_consequence(record, Consequence::BreakGlassReviewed),
            // The others are neither decisions nor their results.
            _ => {}
        }
    }
    reader.decisions
}

/// Reads the records in order.
struct DecisionReader<'a> {
    evidence: &'a [EvidenceEntry],
    decisions: Vec<ExplainedDecision>,
}

impl DecisionReader<'_> {
    /// The decision of a stage. Its evidence was written before it in the same transaction.
    fn decision(&mut self, record: &AuditRecord, before: &[AuditRecord]) {
        let Ok(decision) = serde_json::from_str::<DecisionRecord>(&record.body) else {
            self.unreadable(record);
            return;
        };
        let entry = self.evidence.iter().rev().find(|entry| entry.seq < record.seq);
        let evidence_file = evidence_file_before(self.evidence, record.seq);
        let mut reasons = decision.reasons;
        let mut outcome = lenient_bodies::variant_name(&decision.outcome);
        let kind = entry.map(|entry| entry.kind);
        if kind == Some(EvidenceKind::Shadow)
            && let Some(shadow) = &evidence_file.shadow
        {
            // Shadow has a separate rule beside the composition.
            reasons = shadow.reasons.iter().map(ReasonRecord::from).chain(reasons).collect();
            outcome = serde_json::to_value(shadow.check)
                .map_or(outcome, |check| lenient_bodies::variant_name(&check));
        }
        let ruling = ruling(kind, outcome);
        let mut state_changes: Vec<(u64, Consequence)> = before
            .iter()
            .rev()
            .take_while(|earlier| earlier.at_ms == record.at_ms && earlier.kind != RecordKind::Decision)
            .filter(|earlier| {
                earlier.kind == RecordKind::StateSet && Some(earlier.seq) > entry.map(|entry| entry.seq)
            })
            .filter_map(|earlier| Some((earlier.seq, state_change(earlier)?)))
            .collect();
        state_changes.reverse();
        self.push(record, ruling, reasons, evidence_file);
        self.add_consequences(state_changes);
    }

    fn monitor(&mut self, record: &AuditRecord) {
        match serde_json::from_str::<MonitorRecord>(&record.body) {
            Ok(MonitorRecord { action, reasons }) => {
                self.push(record, Ruling::Monitor(action), reasons, EvidenceFileRecord::default());
            }
            Err(_) => self.unreadable(record),
        }
    }

    /// A rollback; its last record contains all of it.
    fn rollback(&mut self, record: &AuditRecord) {
        let found = self.evidence.iter().find(|entry| entry.seq == record.seq);
        let Some(entry) = found.filter(|entry| entry.kind == EvidenceKind::Rollback) else { return };
        let Ok(rollback) = serde_json::from_str::<RollbackRecord>(&entry.json) else {
            self.unreadable(record);
            return;
        };
        let mut explained = explained_rollback(record, &rollback);
        // The state at the swap is part of the present state.
        let at_swap = self.decisions.pop_if(|last| matches!(last.ruling, Ruling::Rollback(_)));
        explained.consequences = at_swap.map(|earlier| earlier.consequences).unwrap_or_default();
        self.decisions.push(explained);
    }

    /// The cached results that a confirmation used.
    fn confirmation(&mut self, record: &AuditRecord) {
        let found = self.evidence.iter().find(|entry| entry.seq == record.seq);
        let Some(entry) = found.filter(|entry| entry.kind == EvidenceKind::Monitor) else { return };
        if let Ok(concern) = serde_json::from_str::<VersionConcern>(&entry.json) {
            self.add_consequence(record, concern.consequence());
            return;
        }
        let read = serde_json::from_str::<ConfirmationRecord>(&entry.json).unwrap_or_default();
        if let Some(used) = read.kept {
            self.add_consequence(record, Consequence::ConfirmationCached(used));
        }
    }

    fn voided(&mut self, record: &AuditRecord) {
        let Ok(CachedResultMismatch { place, rerun, differing, .. }) = serde_json::from_str(&record.body)
        else {
            self.unreadable(record);
            return;
        };
        let differing: u64 = differing.iter().map(|(_, seeds)| SeedRange::count(seeds)).sum();
        self.add_consequence(record, Consequence::CacheVoided { place, differing, rerun });
    }

    /// A person's answer, as its own record has it: a rebuild may have lost the signed text.
    fn answer(&mut self, record: &AuditRecord) {
        match serde_json::from_str::<AnswerRecord>(&record.body) {
            Ok(AnswerRecord { change: AnswerChangeRecord { who, role, decision, reason } }) => {
                let remark = DecisionRemark::Answer { person: who, role, answer: decision, reason };
                self.people(record, PeopleRuling::Answered(decision), remark);
            }
            Err(_) => self.unreadable(record),
        }
    }

    fn people(&mut self, record: &AuditRecord, ruling: PeopleRuling, remark: DecisionRemark) {
        let (ruling, reasons) = (Ruling::People(ruling), vec![DecisionReason::Remark(remark)]);
        self.decisions.push(ExplainedDecision::new(record.seq, record.at_ms, ruling, reasons));
    }

    /// A pause, its end, or the end of a restriction. An answer to a monitor that lifts none changes nothing.
    fn person_act(&mut self, record: &AuditRecord) {
        let mut changes = RecordedChanges::default();
        changes.note(record);
        let RecordedChanges { paused, resumed, released, .. } = changes;
        match paused.or(resumed).or(released).and_then(|change| change.cause) {
            Some(act) => self.add_consequence(record, Consequence::PersonActed(act)),
            None if record.kind == RecordKind::MonitorAnswer => {}
            None => self.unreadable(record),
        }
    }

    /// A changed state. Without a decision, a person or a deadline changed it.
    fn state(&mut self, record: &AuditRecord) {
        let Ok(StateSetRecord { change: MoveRecord { from, to, reason } }) =
            serde_json::from_str(&record.body)
        else {
            return;
        };
        if reason.is_by_people() {
            self.people(record, PeopleRuling::Moved(to), DecisionRemark::StateChange(reason));
        }
        self.add_consequence(record, Consequence::StateChanged { from, to });
    }

    fn push(
        &mut self,
        record: &AuditRecord,
        ruling: Ruling,
        reasons: Vec<ReasonRecord>,
        evidence_file: EvidenceFileRecord,
    ) {
        let mut distinct: Vec<ReasonRecord> = Vec::new();
        for reason in reasons {
            if !distinct.iter().any(|earlier| earlier.states_same(&reason)) {
                distinct.push(reason);
            }
        }
        let reasons = distinct.into_iter().map(|reason| DecisionReason::Rule {
            measured: remedy::measured(&reason, &evidence_file),
            reason: Box::new(reason),
        });
        let is_sandbox = matches!(ruling, Ruling::Sandbox(_));
        let mut explained = ExplainedDecision::new(record.seq, record.at_ms, ruling, reasons.collect());
        explained.recorded_sentences = recorded_decision::sentences(&record.body);
        explained.remedies = summary::decision_remedies(&explained, &evidence_file);
        explained.permissions = evidence_file.permissions.filter(|_| is_sandbox);
        explained.cached = evidence_file.kept.filter(|_| is_sandbox);
        self.decisions.push(explained);
    }

    /// What a record states of the time after the last decision.
    fn add_consequence(&mut self, record: &AuditRecord, consequence: Consequence) {
        self.add_consequences(vec![(record.seq, consequence)]);
    }

    fn add_consequences(&mut self, consequences: Vec<(u64, Consequence)>) {
        if let Some(last) = self.decisions.last_mut() {
            last.consequences.extend(consequences);
        }
    }

    fn unreadable(&mut self, record: &AuditRecord) {
        self.add_consequence(record, Consequence::Unreadable { kind: record.kind.clone() });
    }
}

/// The last evidence file before a record; an empty one if there is none. The gate's evidence is its decision: the
/// measurements are in the evidence file before it.
fn evidence_file_before(evidence: &[EvidenceEntry], record: u64) -> EvidenceFileRecord {
    let before = evidence.iter().rev().filter(|entry| entry.seq < record);
    let mut read = before.filter_map(|entry| serde_json::from_str::<EvidenceFileRecord>(&entry.json).ok());
    read.find(EvidenceFileRecord::is_one).unwrap_or_default()
}

/// Whether a decision was written in the same transaction: after these changes, before the next ones.
fn decided_with(after: &[AuditRecord], change: &AuditRecord) -> bool {
    after
        .iter()
        .take_while(|later| later.at_ms == change.at_ms && later.kind != RecordKind::StateSet)
        .any(|later| later.kind == RecordKind::Decision)
}

/// The rule that decided, by the evidence written with the decision, and its outcome.
fn ruling(kind: Option<EvidenceKind>, outcome: String) -> Ruling {
    match kind {
        None => Ruling::Registration(Lenient::read(outcome)),
        Some(EvidenceKind::Compat) => Ruling::Validation(Lenient::read(outcome)),
        Some(EvidenceKind::Sandbox | EvidenceKind::Drill) => Ruling::Sandbox(Lenient::read(outcome)),
        Some(EvidenceKind::Shadow) => Ruling::Shadow(Lenient::read(outcome)),
        Some(EvidenceKind::Gate | EvidenceKind::Activation) => Ruling::Activation(Lenient::read(outcome)),
        Some(EvidenceKind::Monitor) => Ruling::Monitor(Lenient::read(outcome)),
        Some(EvidenceKind::Rollback) => Ruling::Rollback(Lenient::read(outcome)),
    }
}

/// The states before and after a change of state.
fn state_change(record: &AuditRecord) -> Option<Consequence> {
    let MoveRecord { from, to, .. } = serde_json::from_str::<StateSetRecord>(&record.body).ok()?.change;
    Some(Consequence::StateChanged { from, to })
}

/// A rollback: trigger, times, rungs, and what each failed rung needs.
fn explained_rollback(record: &AuditRecord, rollback: &RollbackRecord) -> ExplainedDecision {
    let trigger = DecisionRemark::RollbackTrigger {
        kind: rollback.trigger.kind,
        tick: rollback.trigger.tick,
        notice: rollback.trigger.text.clone(),
        measured: rollback.trigger.measured,
    };
    let times = DecisionRemark::RollbackTimes {
        safe_ms: rollback.time_to_safe_ms,
        restored_ms: rollback.time_to_restored_ms,
        unsafe_continuation_ms: rollback.unsafe_continuation_ms,
    };
    let rungs = rollback.rungs.iter().map(|rung| DecisionRemark::RungEnd {
        rung: rung.rung,
        failure: rung.failure,
        ms: rung.ms,
        notice: rung.text.clone(),
    });
    let remarks = [trigger, times].into_iter().chain(rungs);
    let ruling = Ruling::Rollback(rollback.post_status.into());
    let reasons = remarks.map(DecisionReason::Remark).collect();
    let mut explained = ExplainedDecision::new(record.seq, record.at_ms, ruling, reasons);
    let failures = rollback.rungs.iter().filter_map(|rung| rung.failure);
    explained.remedies = failures.map(Remedy::RepairRung).collect();
    explained
}

#[cfg(test)]
mod tests;
