//! Why a version stands where it stands: every decision on record, in plain words, with what would have to change.
//!
//! Reads the store's views and nothing else, so it works without an engine and beside a running one. Judges
//! nothing: what it says is computed from the record, and where the record has no number it says none.

pub mod difference;
mod need;
mod seen;

use serde::Serialize;

pub use need::is_in_favour;
use seen::{Change, Decided, Decision, Dossier, Monitored, Reason};

use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::rollback::RollbackRecord;
use holdpoint_registry::names::EvidenceKind;
use holdpoint_registry::{AuditFilter, AuditRecord, EvidenceEntry, StoreError, Views};

/// Everything that was decided about a version.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Explanation {
    /// The version.
    pub version: CapabilityId,
    /// Where it stands.
    pub state: State,
    /// Who submitted it.
    pub author: String,
    /// In the order they were made.
    pub decisions: Vec<Explained>,
}

/// One decision.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Explained {
    /// The audit record it stands in.
    pub record: u64,
    /// Virtual time, ms.
    pub at_ms: u64,
    /// The stage, or `monitor`, `rollback`, `people`.
    pub stage: String,
    /// What was decided, in the rule's own word.
    pub outcome: String,
    /// The rule that decided.
    pub rule: Rule,
    /// Why, the deciding reasons first.
    pub reasons: Vec<ExplainedReason>,
    /// What would have to change for the next better outcome; empty where there is none.
    pub change: Vec<String>,
    /// What happened next, until the next decision.
    pub then: Vec<String>,
}

/// A rule by name, and where it is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Rule {
    /// Its name.
    pub name: &'static str,
    /// Design rule and section of the paper.
    pub source: &'static str,
}

/// A reason with the evidence it rests on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExplainedReason {
    /// The stable name.
    pub code: String,
    /// What it is about.
    pub dimension: String,
    /// Whether it speaks for the version.
    pub in_favour: bool,
    /// One sentence, as recorded.
    pub text: String,
    /// The measured value; absent where there is none.
    pub evidence: Option<f64>,
    /// The limit it was held against.
    pub limit: Option<f64>,
    /// The rule it belongs to.
    pub rule: Rule,
    /// What was measured, where the evidence in the store tells more than the reason: n, value, interval.
    pub measured: Option<String>,
}

/// Reads everything that was decided about a version; `None` where the store does not know it.
///
/// # Errors
/// Where the store cannot be read.
pub fn explain(views: &Views, id: &CapabilityId) -> Result<Option<Explanation>, StoreError> {
    let Some(detail) = views.version(id)? else { return Ok(None) };
    let filter = AuditFilter { subject: Some(id.to_string()), ..AuditFilter::default() };
    let records = views.audit(&filter)?;
    let mut reader = Reader { evidence: &detail.evidence, decisions: Vec::new() };
    let approvals: Vec<_> = detail.approvals.iter().map(|entry| entry.signed.approval()).collect();
    let mut answers = approvals.into_iter();
    for (index, record) in records.iter().enumerate() {
        match record.kind.as_str() {
            "decision" => reader.decision(record, records.get(..index).unwrap_or_default()),
            "monitor" => reader.monitor(record),
            "evidence-put" => reader.rollback(record),
            "approval-put" => {
                if let Some(said) = answers.next() {
                    let word = said.decision.name();
                    let text = format!("{} ({}) says {word}: {}", said.who, said.role.name(), said.reason);
                    reader.people(record, word, text);
                }
            }
            "approval-requested" => reader.then(format!("people were asked (record {})", record.seq)),
            // What moved with a decision is told with it.
            "state-set" if decided_with(records.get(index + 1..).unwrap_or_default(), record) => {}
            "state-set" => reader.state(record),
            "audit-closed" => {
                reader.then(format!("the record of the upgrade was closed (record {})", record.seq));
            }
            _ => {}
        }
    }
    let decisions = reader.decisions;
    let summary = detail.summary;
    Ok(Some(Explanation { version: id.clone(), state: summary.state, author: summary.author, decisions }))
}

/// Reads records in order.
struct Reader<'a> {
    evidence: &'a [EvidenceEntry],
    decisions: Vec<Explained>,
}

impl Reader<'_> {
    /// The decision of a stage. Its evidence was written before it in the same transaction.
    fn decision(&mut self, record: &AuditRecord, before: &[AuditRecord]) {
        let Ok(decision) = serde_json::from_str::<Decision>(&record.body) else {
            self.unreadable(record);
            return;
        };
        let entry = self.evidence.iter().rev().find(|entry| entry.seq < record.seq);
        let stage = entry.map_or("registration", |entry| stage_of(entry.kind));
        // The gate keeps its decision as its evidence; what was measured is in the dossier before it.
        let dossier = self
            .evidence
            .iter()
            .rev()
            .filter(|entry| entry.seq < record.seq)
            .find_map(|entry| serde_json::from_str::<Dossier>(&entry.json).ok().filter(Dossier::is_one))
            .unwrap_or_default();
        let mut reasons = decision.reasons;
        let mut outcome = seen::word(&decision.outcome);
        if stage == "shadow"
            && let Some(shadow) = &dossier.shadow
        {
            // Shadow has a rule of its own beside the composition.
            reasons = shadow.reasons.iter().cloned().chain(reasons).collect();
            outcome = seen::word(&shadow.check);
        }
        let moved: Vec<String> = before
            .iter()
            .rev()
            .take_while(|earlier| earlier.at_ms == record.at_ms && earlier.kind != "decision")
            .filter(|earlier| earlier.kind == "state-set" && Some(earlier.seq) > entry.map(|entry| entry.seq))
            .filter_map(moved)
            .collect();
        self.push(record, stage, outcome, &reasons, &dossier);
        moved.into_iter().rev().for_each(|text| self.then(text));
    }

    fn monitor(&mut self, record: &AuditRecord) {
        match serde_json::from_str::<Monitored>(&record.body) {
            Ok(Monitored { action, reasons }) => {
                self.push(record, "monitor", action, &reasons, &Dossier::default());
            }
            Err(_) => self.unreadable(record),
        }
    }

    /// A rollback; the last record of one tells all of it.
    fn rollback(&mut self, record: &AuditRecord) {
        let found = self.evidence.iter().find(|entry| entry.seq == record.seq);
        let Some(entry) = found.filter(|entry| entry.kind == EvidenceKind::Rollback) else { return };
        let Ok(told) = serde_json::from_str::<RollbackRecord>(&entry.json) else {
            self.unreadable(record);
            return;
        };
        if let Some(last) = self.decisions.last()
            && last.stage == "rollback"
        {
            // What was known at the swap is in what is known now.
            let then = self.decisions.pop().map(|earlier| earlier.then).unwrap_or_default();
            self.decisions.push(climbed(record, &told, then));
            return;
        }
        self.decisions.push(climbed(record, &told, Vec::new()));
    }

    fn people(&mut self, record: &AuditRecord, outcome: &str, text: String) {
        self.decisions.push(Explained {
            record: record.seq,
            at_ms: record.at_ms,
            stage: "people".to_owned(),
            outcome: outcome.to_owned(),
            rule: need::APPROVAL,
            reasons: vec![said(text, "approval")],
            change: Vec::new(),
            then: Vec::new(),
        });
    }

    /// A state that changed. One that no decision goes with was somebody's, or the clock's.
    fn state(&mut self, record: &AuditRecord) {
        let Some(text) = moved(record) else { return };
        let Ok(Change { change: Decided { to, reason, .. } }) = serde_json::from_str(&record.body) else {
            return;
        };
        let marks = ["rejected by ", "demoted by ", "approval-refused", "approval-timeout"];
        if marks.iter().any(|mark| reason.starts_with(mark)) {
            self.people(record, &to, reason);
        }
        self.then(text);
    }

    fn push(
        &mut self,
        record: &AuditRecord,
        stage: &str,
        outcome: String,
        reasons: &[Reason],
        dossier: &Dossier,
    ) {
        let mut seen = std::collections::BTreeSet::new();
        let reasons: Vec<&Reason> =
            reasons.iter().filter(|reason| seen.insert((&reason.code, &reason.text))).collect();
        let mut change: Vec<String> = Vec::new();
        for text in reasons.iter().filter_map(|reason| need::change(reason, dossier)) {
            if !change.contains(&text) {
                change.push(text);
            }
        }
        self.decisions.push(Explained {
            record: record.seq,
            at_ms: record.at_ms,
            stage: stage.to_owned(),
            outcome,
            rule: need::rule_of_stage(stage),
            reasons: reasons
                .into_iter()
                .map(|reason| ExplainedReason {
                    code: reason.code.clone(),
                    dimension: reason.dimension.clone(),
                    in_favour: is_in_favour(&reason.code),
                    text: reason.text.clone(),
                    evidence: reason.evidence,
                    limit: reason.limit,
                    rule: need::rule_of(&reason.dimension),
                    measured: need::measured(reason, dossier),
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

/// Whether a decision was written in the same transaction: after the changes, before the next of them.
fn decided_with(after: &[AuditRecord], moved: &AuditRecord) -> bool {
    after
        .iter()
        .take_while(|later| later.at_ms == moved.at_ms && later.kind != "state-set")
        .any(|later| later.kind == "decision")
}

fn stage_of(kind: EvidenceKind) -> &'static str {
    match kind {
        EvidenceKind::Compat => "validation",
        EvidenceKind::Sandbox | EvidenceKind::Drill => "sandbox",
        EvidenceKind::Shadow => "shadow",
        EvidenceKind::Gate | EvidenceKind::Activation => "activation",
        EvidenceKind::Monitor => "monitor",
        EvidenceKind::Rollback => "rollback",
    }
}

/// `validated -> rejected (record 36)`.
fn moved(record: &AuditRecord) -> Option<String> {
    let Decided { from, to, .. } = serde_json::from_str::<Change>(&record.body).ok()?.change;
    Some(format!("{from} -> {to} (record {})", record.seq))
}

fn said(text: String, dimension: &str) -> ExplainedReason {
    ExplainedReason {
        code: String::new(),
        dimension: dimension.to_owned(),
        in_favour: false,
        text,
        evidence: None,
        limit: None,
        rule: need::rule_of(dimension),
        measured: None,
    }
}

/// A rollback in plain words: trigger, times, rungs.
fn climbed(record: &AuditRecord, told: &RollbackRecord, then: Vec<String>) -> Explained {
    let ms = |ms: Option<u64>| ms.map_or_else(|| "never".to_owned(), |ms| format!("after {ms} ms"));
    let mut reasons = vec![
        said(
            format!(
                "trigger {} at tick {}: {}",
                told.trigger.kind.name(),
                told.trigger.tick,
                told.trigger.text
            ),
            "monitor",
        ),
        said(
            format!(
                "every joint stood {}; the predecessor was back {}; the arm moved on for {} ms beyond braking",
                ms(told.time_to_safe_ms),
                ms(told.time_to_restored_ms),
                told.unsafe_continuation_ms
            ),
            "recovery",
        ),
    ];
    for rung in &told.rungs {
        let ended = rung.failure.map_or("held", |failure| failure.name());
        reasons.push(said(
            format!("rung {}: {ended} in {} ms: {}", rung.rung.name(), rung.ms, rung.text),
            "recovery",
        ));
    }
    let change =
        told.rungs.iter().filter_map(|rung| rung.failure.map(need::of_failure)).map(str::to_owned).collect();
    Explained {
        record: record.seq,
        at_ms: record.at_ms,
        stage: "rollback".to_owned(),
        outcome: told.post_status.clone(),
        rule: need::rule_of_stage("rollback"),
        reasons,
        change,
        then,
    }
}
