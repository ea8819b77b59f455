//! Answers to questions about one version, the registry and the audit log: more than a snapshot carries.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeSet;

use super::event::DimensionResult;
use super::explained::Explained;
use super::film::FilmAsked;
use holdpoint_governance::approval::Requester;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Dimension, Reason};
use holdpoint_governance::evidence::{DrillKind, SandboxMode};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::phase::WorkPhase;
use holdpoint_governance::record::{AuditRecord, VersionSummary};
use holdpoint_governance::risk::RiskCause;
use holdpoint_governance::submission::{InterfaceChange, Provenance, Risk};

/// The most rows of one page; a larger limit is read as this one.
pub const PAGE_MAX: usize = 10_000;

/// A page of the registry, by family and semantic version.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RegistryPage {
    /// One row a version, at most [`PAGE_MAX`].
    pub rows: Vec<VersionSummary>,
    /// How many rows there are in all, on this page and others.
    pub total: u64,
    /// The profile's limits of kappa I, P, B, R.
    pub thresholds: [f64; 4],
}

/// A page of the audit log, the newest first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuditPage {
    /// One row a record, at most [`PAGE_MAX`].
    pub rows: Vec<AuditRecord>,
    /// Number of the newest record of the log.
    pub head: u64,
}

/// What checking the whole chain came to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Verified {
    /// Whether every record follows from the one before and the store's views follow from the log.
    pub holds: bool,
    /// Records in the chain that was checked.
    pub records: u64,
    /// What was found, one sentence for the operator.
    pub text: String,
}

/// A field in which two documents differ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Difference {
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
pub struct Changes {
    /// Every field of manifest and parameters in which they differ.
    pub fields: Vec<Difference>,
    /// What its author declares to have changed in the interface; an author's word, shown as such.
    pub declared: Vec<InterfaceChange>,
}

/// One measured value with its place between limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Measure {
    /// The component or rate that was measured, in the rules' words.
    pub name: String,
    /// The candidate's mean or share, in the unit of its name; absent if not measured.
    pub candidate: Option<f64>,
    /// The active version's mean or share, on the same seeds; absent if not measured.
    pub active: Option<f64>,
    /// Where the candidate's true value lies.
    pub interval: Option<[f64; 2]>,
    /// The limit it is held against; absent if there is none.
    pub limit: Option<f64>,
    /// Over how many episodes it was measured.
    pub n: u64,
}

/// Sandbox results of one mode of perturbation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeView {
    /// The conditions the versions were run under.
    pub mode: SandboxMode,
    /// What was measured in it, one row a component.
    pub measures: Vec<Measure>,
}

/// One kind of recovery drill, for both versions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DrillView {
    /// The kind of rehearsal.
    pub kind: DrillKind,
    /// Drills the candidate recovered from, of how many.
    pub candidate: [u64; 2],
    /// Drills the active version recovered from, of how many.
    pub active: [u64; 2],
    /// The same by the phase of the work in which they began.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub phases: Vec<PhaseDrillView>,
}

/// One kind of recovery drill in one phase of the work, for both versions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PhaseDrillView {
    /// The phase in which the drills began.
    pub phase: WorkPhase,
    /// Drills the candidate recovered from, of how many.
    pub candidate: [u64; 2],
    /// Drills the active version recovered from, of how many.
    pub active: [u64; 2],
}

/// Why one part of the rules came out as it did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WhyView {
    /// The part of the rules.
    pub about: Dimension,
    /// What decided, one sentence, its numbers first.
    pub decisive: String,
    /// What would have to be otherwise, one sentence each; empty: nothing.
    pub change: Vec<String>,
    /// What was measured, the gravest first. More of anything in it is worse.
    pub findings: Vec<WhyFinding>,
    /// The work that shows it; absent if none can be worked again.
    pub film: Option<FilmAsked>,
}

/// Something measured that bears on a check.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WhyFinding {
    /// What was found, with the numbers of both versions and what is allowed.
    pub text: String,
    /// How much worse than the active version, in units of what is tolerated: 1 is just tolerated, below 0 is better;
    /// absent where nothing is tolerated, or nothing compared.
    pub weight: Option<f64>,
    /// What the evidence says of it.
    pub verdict: FindingVerdict,
}

holdpoint_governance::words! {
    /// What the evidence says of something measured.
    FindingVerdict, "verdict of a finding", {
        /// A worsening is established.
        Worse = "worse",
        /// A worsening beyond what is tolerated is neither established nor excluded.
        Doubtful = "doubtful",
        /// A worsening beyond what is tolerated is excluded.
        Tolerable = "tolerable",
    }
}

/// Everything there is to say about one version.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Detail {
    /// The version everything here is about.
    pub version: CapabilityId,
    /// The version it would replace or has replaced.
    pub against: Option<CapabilityId>,
    /// The version it was made from, as the submission has it.
    pub parent: Option<CapabilityId>,
    /// Digest of its manifest and bundle.
    pub digest: Digest,
    /// What its author says has changed; an author's word, shown as such.
    pub summary: String,
    /// Identity of its author, as the submission has it.
    pub author: String,
    /// How the version came about, as the submission has it.
    pub provenance: Provenance,
    /// Who registered it, and so cannot approve it.
    #[serde(default)]
    pub requester: Requester,
    /// Risk class by what changed; before it was assessed, as the submission estimates it.
    pub risk: Risk,
    /// What the risk class follows from; empty before it was assessed.
    #[serde(default)]
    pub risk_causes: BTreeSet<RiskCause>,
    /// Virtual time of registration, ms.
    pub registered_ms: u64,
    /// The four dimensions as they were last assessed, in the order I, P, B, R.
    pub dimensions: Vec<DimensionResult>,
    /// The composite score of the four dimensions; reported, never gating.
    pub composite: Option<f64>,
    /// Reasons of every dimension, the deciding ones first.
    pub reasons: Vec<Reason>,
    /// Conditions under which it may be used, from all four dimensions.
    pub conditions: Vec<Condition>,
    /// Why each part of the rules came out as it did, the four compatibilities first.
    #[serde(default)]
    pub why: Vec<WhyView>,
    /// Manifest against the active version's, field by field.
    pub differences: Vec<Difference>,
    /// The components of the behavioural comparison; interval and limit are of the worsening, candidate against
    /// active version (paired), not of the candidate's own value.
    pub behavior: Vec<Measure>,
    /// Sandbox results by mode of perturbation.
    pub modes: Vec<ModeView>,
    /// Results of the recovery drills by kind.
    pub drills: Vec<DrillView>,
    /// Every decision, oldest first.
    pub decisions: Vec<Explained>,
    /// Audit records about it, newest first.
    pub audit: Vec<AuditRecord>,
    /// Digest of the evidence a decision would be over; absent before there is any.
    pub evidence: Option<Digest>,
    /// What was not tested, one sentence each.
    pub untested: Vec<String>,
}
