//! Replies about one version, the registry and the audit log, with more detail than a snapshot.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeSet;

use super::event::DimensionResult;
use super::explanation::DecisionExplanation;
use super::film::FilmRequest;
use holdpoint_governance::approval::Requester;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Dimension, Reason};
use holdpoint_governance::evidence::{DrillKind, SandboxMode};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::phase::WorkPhase;
use holdpoint_governance::record::{AuditRecord, VersionSummary};
use holdpoint_governance::risk::RiskCause;
use holdpoint_governance::submission::{InterfaceChange, Provenance, Risk};
use holdpoint_governance::wall_time::WallTime;

/// The most rows of one page; a larger limit is read as this one.
pub const PAGE_MAX: usize = 10_000;

/// A page of the registry, by family and semantic version.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RegistryPage {
    /// One row a version, at most [`PAGE_MAX`].
    pub rows: Vec<VersionSummary>,
    /// The total number of rows on all pages.
    pub total: u64,
    /// The profile's limits of kappa I, P, B, R.
    pub thresholds: [f64; 4],
    /// Versions that people made their family's anchor, of any page; the anchor of another family is its first version.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub anchors: Vec<CapabilityId>,
}

/// A page of the audit log, the newest first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuditPage {
    /// One row a record, at most [`PAGE_MAX`].
    pub rows: Vec<AuditRecord>,
    /// Number of the newest record of the log.
    pub head: u64,
}

/// The result of checking the whole chain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AuditVerification {
    /// Whether every record links to the one before and the store's views match the log.
    pub holds: bool,
    /// Records in the chain that was checked.
    pub records: u64,
    /// The finding, one sentence for the operator.
    pub text: String,
}

/// A field in which two documents differ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FieldDiff {
    /// Path of the field, e.g. `permissions.max_force_n`.
    pub field: String,
    /// Its old value, in the active version; absent if the field is new.
    pub old: Option<Value>,
    /// Its new value; absent if the field is gone.
    pub new: Option<Value>,
}

/// The whole difference between a candidate and the version it would replace.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct VersionDiff {
    /// Every field of manifest and parameters in which they differ.
    pub fields: Vec<FieldDiff>,
    /// The interface changes that its author declares; shown as declared.
    pub declared: Vec<InterfaceChange>,
}

/// One measured value with its place between limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MeasuredValue {
    /// The measured component or rate, in the rules' words.
    pub name: String,
    /// The candidate's mean or rate, in the unit of its name; absent if not measured.
    pub candidate: Option<f64>,
    /// The active version's mean or rate, on the same seeds; absent if not measured.
    pub active: Option<f64>,
    /// The interval of the candidate's true value.
    pub interval: Option<[f64; 2]>,
    /// The limit it is compared with; absent if there is none.
    pub limit: Option<f64>,
    /// The number of measured episodes.
    pub n: u64,
}

/// Sandbox results of one mode of perturbation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeView {
    /// The conditions the versions were run under.
    pub mode: SandboxMode,
    /// The measured values, one row per component.
    pub measures: Vec<MeasuredValue>,
}

/// One kind of recovery drill, for both versions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DrillView {
    /// The kind of drill.
    pub kind: DrillKind,
    /// Drills the candidate recovered from, of how many.
    pub candidate: [u64; 2],
    /// Drills the active version recovered from, of how many.
    pub active: [u64; 2],
    /// The same by the phase in which they began.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub phases: Vec<PhaseDrillView>,
}

/// One kind of recovery drill in one phase, for both versions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PhaseDrillView {
    /// The phase in which the drills began.
    pub phase: WorkPhase,
    /// Drills the candidate recovered from, of how many.
    pub candidate: [u64; 2],
    /// Drills the active version recovered from, of how many.
    pub active: [u64; 2],
}

/// The result of one part of the rules, with its reasons.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RationaleView {
    /// The part of the rules.
    pub about: Dimension,
    /// The deciding fact, one sentence, its numbers first.
    pub decisive: String,
    /// The changes that would improve the result, one sentence each; empty if none.
    pub change: Vec<String>,
    /// The measurements, the gravest first. A larger value is worse.
    pub findings: Vec<RationaleFinding>,
    /// The work that shows it; absent if none can be re-run.
    pub film: Option<FilmRequest>,
}

/// Something measured that bears on a check.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RationaleFinding {
    /// The finding, with the numbers of both versions and the limit.
    pub text: String,
    /// The worsening in units of the margin: 1 is just accepted, below 0 is better; absent without a margin or a
    /// comparison.
    pub weight: Option<f64>,
    /// The conclusion from the evidence.
    pub verdict: FindingVerdict,
}

holdpoint_governance::closed_set! {
    /// The conclusion from the evidence on one measurement.
    FindingVerdict, "verdict of a finding", {
        /// A worsening is significant and counts against the version.
        Worse = "worse",
        /// Inconclusive: neither significantly worse nor non-inferior.
        Doubtful = "doubtful",
        /// Non-inferior: a worsening beyond the margin is excluded.
        Tolerable = "tolerable",
    }
}

/// All details of one version.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Detail {
    /// The version.
    pub version: CapabilityId,
    /// The version it would replace or has replaced.
    pub against: Option<CapabilityId>,
    /// The version it was made from, as the submission has it.
    pub parent: Option<CapabilityId>,
    /// Digest of its manifest and bundle.
    pub digest: Digest,
    /// The changes that its author declares; shown as declared.
    pub summary: String,
    /// Identity of its author, as the submission has it.
    pub author: String,
    /// How the version came about, as the submission has it.
    pub provenance: Provenance,
    /// The person who registered it, and so cannot approve it.
    #[serde(default)]
    pub requester: Requester,
    /// Risk class by its changes; before the assessment, the submission's estimate.
    pub risk: Risk,
    /// The causes of the risk class; empty before the assessment.
    #[serde(default)]
    pub risk_causes: BTreeSet<RiskCause>,
    /// Virtual time of registration, ms.
    pub registered_ms: u64,
    /// When that was by the machine's clock; absent in scripts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub registered_at: Option<WallTime>,
    /// The latest assessment of the four dimensions, in the order I, P, B, R.
    pub dimensions: Vec<DimensionResult>,
    /// The composite score of the four dimensions; reported, never gating.
    pub composite: Option<f64>,
    /// Reasons of every dimension, the deciding ones first.
    pub reasons: Vec<Reason>,
    /// Conditions under which it may be used, from all four dimensions.
    pub conditions: Vec<Condition>,
    /// The result of each part of the rules with its reasons, the four compatibilities first.
    #[serde(default)]
    pub why: Vec<RationaleView>,
    /// Manifest against the active version's, field by field.
    pub differences: Vec<FieldDiff>,
    /// The components of the behavior comparison; interval and limit are of the worsening, candidate against active
    /// version (paired), not of the candidate's own value.
    pub behavior: Vec<MeasuredValue>,
    /// Sandbox results by mode of perturbation.
    pub modes: Vec<ModeView>,
    /// Results of the recovery drills by kind.
    pub drills: Vec<DrillView>,
    /// Every decision, oldest first.
    pub decisions: Vec<DecisionExplanation>,
    /// Audit records about it, newest first.
    pub audit: Vec<AuditRecord>,
    /// Digest of the evidence that a decision would cover; absent without evidence.
    pub evidence: Option<Digest>,
    /// What was not tested, one sentence each.
    pub untested: Vec<String>,
}
