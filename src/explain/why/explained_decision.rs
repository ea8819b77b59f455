//! A decision in typed values, and its form for front ends, in which sentences replace the values.

use holdpoint_governance::cached_result::CachedResultUse;
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::decision::Dimension;
use holdpoint_governance::explanation::{Consequence, DecisionRemark, ReasonMeasurement, Remedy};
use holdpoint_governance::permission::PermissionUse;
use holdpoint_protocol::explanation::{DecisionExplanation, ExplainedReason, Rule, Ruling};
use holdpoint_wording::explanation::{
    consequence, decision_remark, reason_content, reason_measurement, remedies,
};

use holdpoint_record::rationale::lenient_bodies::ReasonRecord;
use holdpoint_record::rationale::remedy::is_in_favor;

/// A decision on record.
#[derive(Debug)]
pub struct ExplainedDecision {
    /// Number of the audit record.
    pub(super) record: u64,
    /// Virtual time, ms.
    pub(super) at_ms: u64,
    pub(super) ruling: Ruling,
    /// The deciding sentences that were recorded with it.
    pub(super) recorded_sentences: Vec<String>,
    pub(super) reasons: Vec<DecisionReason>,
    pub(super) remedies: Vec<Remedy>,
    pub(super) permissions: Option<PermissionUse>,
    pub(crate) cached: Option<CachedResultUse>,
    /// What followed until the next decision, each with the number of its record.
    pub consequences: Vec<(u64, Consequence)>,
}

/// A reason of a decision.
#[derive(Debug)]
pub(super) enum DecisionReason {
    /// A reason of a rule.
    Rule { reason: Box<ReasonRecord>, measured: Option<ReasonMeasurement> },
    /// A remark that no rule produced.
    Remark(DecisionRemark),
}

impl ExplainedDecision {
    /// A decision without anything but reasons.
    pub(super) const fn new(record: u64, at_ms: u64, ruling: Ruling, reasons: Vec<DecisionReason>) -> Self {
        Self {
            record,
            at_ms,
            ruling,
            recorded_sentences: Vec::new(),
            reasons,
            remedies: Vec::new(),
            permissions: None,
            cached: None,
            consequences: Vec::new(),
        }
    }

    /// As front ends show it.
    pub(super) fn view(self) -> DecisionExplanation {
        let then = self.consequences.iter().flat_map(|(record, of)| consequence(of, *record)).collect();
        DecisionExplanation {
            record: self.record,
            at_ms: self.at_ms,
            rule: self.ruling.rule(),
            ruling: self.ruling,
            said: self.recorded_sentences,
            reasons: self.reasons.into_iter().map(DecisionReason::view).collect(),
            change: remedies(&self.remedies),
            permissions: self.permissions,
            kept: self.cached,
            then,
        }
    }
}

impl DecisionReason {
    fn view(self) -> ExplainedReason {
        match self {
            Self::Rule { reason, measured } => ExplainedReason {
                text: reason_content(&reason.content()),
                in_favour: reason.code.known().is_some_and(|code| is_in_favor(*code)),
                rule: rule_of(reason.dimension.as_ref()),
                code: Some(reason.code),
                dimension: reason.dimension,
                evidence: reason.evidence,
                limit: reason.limit,
                measured: measured.as_ref().map(reason_measurement),
            },
            Self::Remark(remark) => {
                let dimension = remark.dimension();
                ExplainedReason {
                    code: None,
                    dimension: Some(dimension.into()),
                    in_favour: false,
                    text: decision_remark(&remark),
                    evidence: None,
                    limit: None,
                    rule: dimension.into(),
                    measured: None,
                }
            }
        }
    }
}

/// The rule that a reason belongs to.
fn rule_of(dimension: Option<&Lenient<Dimension>>) -> Rule {
    dimension.and_then(Lenient::known).map_or(Rule::Any, |dimension| Rule::from(*dimension))
}
