//! Why a version is in its state: every decision on record, as sentences, with the changes that would be needed.
//!
//! Reads only the store's views, so it works without an engine and beside a running one. It judges nothing: every number is
//! computed from the record, and a missing number is omitted.

pub mod difference;
mod lenient_bodies;
mod remedy;

use lenient_bodies::{
    ConfirmationRecord, DecisionRecord, EvidenceFileRecord, MonitorRecord, MoveRecord, ReasonRecord,
    StateSetRecord,
};
pub use remedy::is_in_favor;

use crate::evidence_file::EvidenceFile;
use crate::recorded_decision;
use crate::version_concern::VersionConcern;
use holdpoint_governance::cached_result::{CachedResultMismatch, CachedResultUse, SeedRange};
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::decision::{Dimension, Reason};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_governance::rollback::{RollbackRecord, RungFailure};
use holdpoint_protocol::explanation::{
    DecisionExplanation, ExplainedReason, Explanation, PeopleRuling, Rule, Ruling,
};
use holdpoint_registry::store_terms::EvidenceKind;
use holdpoint_registry::{AuditFilter, EvidenceEntry, StoreError, Views};

/// Explains every decision about a version; `None` if it is not in the store.
///
/// # Errors
/// If the store cannot be read.
pub fn explain(views: &Views, id: &CapabilityId) -> Result<Option<Explanation>, StoreError> {
    let Some(detail) = views.version(id)? else { return Ok(None) };
    let filter = AuditFilter { subject: Some(id.to_string()), ..AuditFilter::default() };
    let records = views.audit(&filter)?;
    let mut reader = DecisionReader { evidence: &detail.evidence, decisions: Vec::new() };
    let approvals: Vec<_> = detail.approvals.iter().map(|entry| entry.signed.approval()).collect();
    let mut answers = approvals.into_iter();
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
            RecordKind::ApprovalPut => {
                if let Some(approval) = answers.next() {
                    let answer = approval.decision;
                    let text = format!(
                        "{} ({}) says {answer}: {}",
                        approval.who,
                        approval.role.name(),
                        approval.reason
                    );
                    reader.people(record, PeopleRuling::Answered(answer), text);
                }
            }
            RecordKind::ApprovalRequested => {
                reader.then(format!("approvers were asked (record {})", record.seq));
            }
            // The decision already includes the change of state.
            RecordKind::StateSet if decided_with(records.get(index + 1..).unwrap_or_default(), record) => {}
            RecordKind::StateSet => reader.state(record),
            RecordKind::AuditClosed => {
                reader.then(format!("the record of the upgrade was closed (record {})", record.seq));
            }
            RecordKind::ProfilesSet => {
                reader.then(format!("it was blocked or unblocked under profiles (record {})", record.seq));
            }
            RecordKind::Resumed => reader.then(format!("an operator resumed it (record {})", record.seq)),
            RecordKind::BreakGlass => {
                reader.then(format!("one person activated it by break-glass (record {})", record.seq));
            }
            RecordKind::BreakGlassReviewed => {
                reader.then(format!("approvers reviewed its break-glass activation (record {})", record.seq));
            }
            // These are neither decisions nor their results.
            RecordKind::VersionRegistered
            | RecordKind::FlagsSet
            | RecordKind::ScoresSet
            | RecordKind::ActiveSet
            | RecordKind::FamilySet
            | RecordKind::FamilyVoided
            | RecordKind::StandingSet
            | RecordKind::ApprovalConsumed
            | RecordKind::PersonEnrolled
            | RecordKind::PersonConfirmed
            | RecordKind::PersonRevoked
            | RecordKind::ContextSet
            | RecordKind::ProfileLoaded
            | RecordKind::TelemetrySealed
            | RecordKind::TelemetryBlockSealed
            | RecordKind::TelemetryPruned
            | RecordKind::TelemetryMissed
            | RecordKind::AlarmChanged
            | RecordKind::MonitorAnswer
            | RecordKind::Shown
            | RecordKind::ClockDoubted
            | RecordKind::ClockConfirmed
            | RecordKind::AlarmReset
            | RecordKind::Asked
            | RecordKind::Drift
            | RecordKind::LiveFault
            | RecordKind::GoalSet
            | RecordKind::PaceSet
            | RecordKind::ShiftNote
            | RecordKind::CellStopped
            | RecordKind::CellReleased
            | RecordKind::EngineBegan
            | RecordKind::EngineEnded
            | RecordKind::Commissioned
            | RecordKind::SensesCommissioned
            | RecordKind::Recording
            | RecordKind::RecordingRemoved
            | RecordKind::ProfileAllowed
            | RecordKind::WitnessSet
            | RecordKind::StoreRebuilt => {}
        }
    }
    let decisions = reader.decisions;
    let summary = detail.summary;
    Ok(Some(Explanation { version: id.clone(), state: summary.state, author: summary.author, decisions }))
}

/// The changes that would remove each of these reasons, in their order and without repetition.
pub(crate) fn changes<'a>(
    evidence_file: &EvidenceFile,
    reasons: impl IntoIterator<Item = &'a Reason>,
) -> Vec<String> {
    let value = serde_json::to_value(evidence_file).unwrap_or_default();
    let measured: EvidenceFileRecord = serde_json::from_value(value).unwrap_or_default();
    let mut sentences: Vec<String> = Vec::new();
    for text in
        reasons.into_iter().filter_map(|reason| remedy::change(&ReasonRecord::from(reason), &measured))
    {
        if !sentences.contains(&text) {
            sentences.push(text);
        }
    }
    sentences
}

/// Reads the records in order.
struct DecisionReader<'a> {
    evidence: &'a [EvidenceEntry],
    decisions: Vec<DecisionExplanation>,
}

impl DecisionReader<'_> {
    /// The decision of a stage. Its evidence was written before it in the same transaction.
    fn decision(&mut self, record: &AuditRecord, before: &[AuditRecord]) {
        let Ok(decision) = serde_json::from_str::<DecisionRecord>(&record.body) else {
            self.unreadable(record);
            return;
        };
        let entry = self.evidence.iter().rev().find(|entry| entry.seq < record.seq);
        // The gate's evidence is its decision; the measurements are in the evidence file before it.
        let evidence_file = self
            .evidence
            .iter()
            .rev()
            .filter(|entry| entry.seq < record.seq)
            .find_map(|entry| {
                serde_json::from_str::<EvidenceFileRecord>(&entry.json)
                    .ok()
                    .filter(EvidenceFileRecord::is_one)
            })
            .unwrap_or_default();
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
        let state_changes: Vec<String> = before
            .iter()
            .rev()
            .take_while(|earlier| earlier.at_ms == record.at_ms && earlier.kind != RecordKind::Decision)
            .filter(|earlier| {
                earlier.kind == RecordKind::StateSet && Some(earlier.seq) > entry.map(|entry| entry.seq)
            })
            .filter_map(state_change)
            .collect();
        self.push(record, ruling, &reasons, &evidence_file);
        state_changes.into_iter().rev().for_each(|text| self.then(text));
    }

    fn monitor(&mut self, record: &AuditRecord) {
        match serde_json::from_str::<MonitorRecord>(&record.body) {
            Ok(MonitorRecord { action, reasons }) => {
                self.push(record, Ruling::Monitor(action), &reasons, &EvidenceFileRecord::default());
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
        if let Some(last) = self.decisions.last()
            && matches!(last.ruling, Ruling::Rollback(_))
        {
            // The state at the swap is part of the present state.
            let then = self.decisions.pop().map(|earlier| earlier.then).unwrap_or_default();
            self.decisions.push(rollback_explanation(record, &rollback, then));
            return;
        }
        self.decisions.push(rollback_explanation(record, &rollback, Vec::new()));
    }

    /// The cached results that a confirmation used.
    fn confirmation(&mut self, record: &AuditRecord) {
        let found = self.evidence.iter().find(|entry| entry.seq == record.seq);
        let Some(entry) = found.filter(|entry| entry.kind == EvidenceKind::Monitor) else { return };
        if let Ok(suspicion) = serde_json::from_str::<VersionConcern>(&entry.json) {
            for text in suspicion.lines() {
                self.then(format!("{text} (record {})", record.seq));
            }
            return;
        }
        let read = serde_json::from_str::<ConfirmationRecord>(&entry.json).unwrap_or_default();
        for text in read.kept.iter().flat_map(CachedResultUse::lines) {
            self.then(format!("confirmation: {text} (record {})", record.seq));
        }
    }

    fn voided(&mut self, record: &AuditRecord) {
        let Ok(CachedResultMismatch { place, rerun, differing, .. }) = serde_json::from_str(&record.body)
        else {
            self.unreadable(record);
            return;
        };
        let count: u64 = differing.iter().map(|(_, seeds)| SeedRange::count(seeds)).sum();
        self.then(format!(
            "{count} of {rerun} results cached in the {place} differed when re-run; none counts, and the comparison \
             started again (record {})",
            record.seq
        ));
    }

    fn people(&mut self, record: &AuditRecord, what: PeopleRuling, text: String) {
        let ruling = Ruling::People(what);
        self.decisions.push(DecisionExplanation {
            record: record.seq,
            at_ms: record.at_ms,
            rule: ruling.rule(),
            ruling,
            said: Vec::new(),
            reasons: vec![reason(text, Dimension::Approval)],
            change: Vec::new(),
            permissions: None,
            kept: None,
            then: Vec::new(),
        });
    }

    /// A changed state. Without a decision, a person or a deadline changed it.
    fn state(&mut self, record: &AuditRecord) {
        let Some(text) = state_change(record) else { return };
        let Ok(StateSetRecord { change: MoveRecord { to, reason, .. } }) = serde_json::from_str(&record.body)
        else {
            return;
        };
        if reason.is_by_people() {
            self.people(record, PeopleRuling::Moved(to), holdpoint_wording::notice(&reason));
        }
        self.then(text);
    }

    fn push(
        &mut self,
        record: &AuditRecord,
        ruling: Ruling,
        reasons: &[ReasonRecord],
        evidence_file: &EvidenceFileRecord,
    ) {
        let mut seen = std::collections::BTreeSet::new();
        let reasons: Vec<&ReasonRecord> =
            reasons.iter().filter(|reason| seen.insert((&reason.code, reason.text()))).collect();
        let mut change: Vec<String> = Vec::new();
        for text in reasons.iter().filter_map(|reason| remedy::change(reason, evidence_file)) {
            if !change.contains(&text) {
                change.push(text);
            }
        }
        let is_sandbox = matches!(ruling, Ruling::Sandbox(_));
        self.decisions.push(DecisionExplanation {
            record: record.seq,
            at_ms: record.at_ms,
            rule: ruling.rule(),
            ruling,
            permissions: evidence_file.permissions.clone().filter(|_| is_sandbox),
            kept: evidence_file.kept.clone().filter(|_| is_sandbox),
            said: recorded_decision::sentences(&record.body),
            reasons: reasons
                .into_iter()
                .map(|reason| ExplainedReason {
                    code: Some(reason.code.clone()),
                    dimension: reason.dimension.clone(),
                    in_favour: reason.code.known().is_some_and(|code| is_in_favor(*code)),
                    text: reason.text(),
                    evidence: reason.evidence,
                    limit: reason.limit,
                    rule: rule_of(reason.dimension.as_ref()),
                    measured: remedy::measured(reason, evidence_file),
                })
                .collect(),
            change,
            then: Vec::new(),
        });
    }

    fn then(&mut self, text: String) {
        if let Some(last) = self.decisions.last_mut() {
            last.then.push(text);
        }
    }

    fn unreadable(&mut self, record: &AuditRecord) {
        self.then(format!("record {} ({}) cannot be read by this build", record.seq, record.kind));
    }
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

/// The rule that a reason belongs to.
fn rule_of(dimension: Option<&Lenient<Dimension>>) -> Rule {
    dimension.and_then(Lenient::known).map_or(Rule::Any, |dimension| Rule::from(*dimension))
}

/// `validated -> rejected (record 36)`.
fn state_change(record: &AuditRecord) -> Option<String> {
    let MoveRecord { from, to, .. } = serde_json::from_str::<StateSetRecord>(&record.body).ok()?.change;
    Some(format!("{from} -> {to} (record {})", record.seq))
}

fn reason(text: String, dimension: Dimension) -> ExplainedReason {
    ExplainedReason {
        code: None,
        dimension: Some(dimension.into()),
        in_favour: false,
        text,
        evidence: None,
        limit: None,
        rule: dimension.into(),
        measured: None,
    }
}

/// A rollback as sentences: trigger, times, rungs.
fn rollback_explanation(
    record: &AuditRecord,
    rollback: &RollbackRecord,
    then: Vec<String>,
) -> DecisionExplanation {
    let ms = |ms: Option<u64>| ms.map_or_else(|| "never".to_owned(), |ms| format!("after {ms} ms"));
    let mut reasons = vec![
        reason(
            format!(
                "trigger {} at tick {}: {}",
                rollback.trigger.kind.name(),
                rollback.trigger.tick,
                holdpoint_wording::notice(&rollback.trigger.text)
            ),
            Dimension::Monitor,
        ),
        reason(
            format!(
                "every joint was at standstill {}; the rollback target took over {}; it moved {} ms beyond braking",
                ms(rollback.time_to_safe_ms),
                ms(rollback.time_to_restored_ms),
                rollback.unsafe_continuation_ms
            ),
            Dimension::Recovery,
        ),
    ];
    for rung in &rollback.rungs {
        let ended = rung.failure.map_or("held", RungFailure::name);
        reasons.push(reason(
            format!(
                "rung {}: {ended} in {} ms: {}",
                rung.rung.name(),
                rung.ms,
                holdpoint_wording::notice(&rung.text)
            ),
            Dimension::Recovery,
        ));
    }
    let change = rollback
        .rungs
        .iter()
        .filter_map(|rung| rung.failure.map(remedy::of_failure))
        .map(str::to_owned)
        .collect();
    let ruling = Ruling::Rollback(rollback.post_status.into());
    let (record, at_ms, rule) = (record.seq, record.at_ms, ruling.rule());
    DecisionExplanation {
        record,
        at_ms,
        rule,
        ruling,
        said: Vec::new(),
        reasons,
        change,
        permissions: None,
        kept: None,
        then,
    }
}
