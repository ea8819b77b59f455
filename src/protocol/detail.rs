//! Answers to questions about one version, the registry and the audit log: more than a snapshot carries.

use serde::{Deserialize, Serialize};

use super::event::DimensionResult;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::Reason;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::{Flags, State};

/// The most rows of one page.
pub const PAGE_MAX: usize = 10_000;

/// Which versions a page of the registry is about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Group {
    /// Every version.
    #[default]
    All,
    /// In control.
    Active,
    /// On the way.
    Candidate,
    /// Done.
    History,
}

/// A version in a list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegistryRow {
    /// The version.
    pub version: CapabilityId,
    /// Its state.
    pub state: State,
    /// Its flags.
    pub flags: Flags,
    /// kappa I, P, B, R; absent where not measured.
    pub kappas: [Option<f64>; 4],
    /// Whether it was its family's first.
    pub baseline: bool,
    /// Who made it.
    pub author: String,
    /// How.
    pub provenance: String,
    /// Declared risk.
    pub risk: String,
    /// Virtual time of its last change, ms.
    pub changed_ms: u64,
}

/// A page of the registry, by family and semantic version.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RegistryPage {
    /// The rows.
    pub rows: Vec<RegistryRow>,
    /// How many there are in all.
    pub total: u64,
    /// The profile's limits of kappa I, P, B, R.
    pub thresholds: [f64; 4],
}

/// A record of the audit log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AuditRow {
    /// Its number.
    pub seq: u64,
    /// Virtual time, ms.
    pub at_ms: u64,
    /// What kind of record.
    pub kind: String,
    /// What it is about; may be empty.
    pub subject: String,
    /// Its content, JSON text.
    pub body: String,
    /// Its hash, which the next record carries on.
    pub hash: Digest,
}

/// A page of the audit log, the newest first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AuditPage {
    /// The rows.
    pub rows: Vec<AuditRow>,
    /// Number of the newest record of the log.
    pub head: u64,
}

/// What checking the whole chain came to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Verified {
    /// Whether every record follows from the one before and the store's views follow from the log.
    pub holds: bool,
    /// Records checked.
    pub records: u64,
    /// One sentence.
    pub text: String,
}

/// One decision on record, explained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExplainedView {
    /// The record.
    pub record: u64,
    /// Virtual time, ms.
    pub at_ms: u64,
    /// The stage, or `monitor`, `rollback`, `people`.
    pub stage: String,
    /// What was decided.
    pub outcome: String,
    /// The rule by name, and where it is written.
    pub rule: [String; 2],
    /// Why: the reason in full, with evidence and limit.
    pub reasons: Vec<ExplainedLine>,
    /// What would have to change.
    pub change: Vec<String>,
    /// What happened next.
    pub then: Vec<String>,
}

/// One reason of a decision.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExplainedLine {
    /// The stable name.
    pub code: String,
    /// What it is about.
    pub dimension: String,
    /// Whether it speaks for the version.
    pub in_favour: bool,
    /// One sentence.
    pub text: String,
    /// The measured value.
    pub evidence: Option<f64>,
    /// Its limit.
    pub limit: Option<f64>,
    /// What was measured: n, value, interval.
    pub measured: Option<String>,
}

/// A field in which a version differs from the active one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DifferenceView {
    /// Path of the field.
    pub field: String,
    /// In the active version; absent where it is new.
    pub active: Option<String>,
    /// In this version; absent where it is gone.
    pub candidate: Option<String>,
}

/// One measured value with its place between limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measure {
    /// What, in the rules' words.
    pub name: String,
    /// Of the candidate.
    pub candidate: Option<f64>,
    /// Of the active version.
    pub active: Option<f64>,
    /// Where the candidate's true value lies.
    pub interval: Option<[f64; 2]>,
    /// The limit, where there is one.
    pub limit: Option<f64>,
    /// Of how many episodes.
    pub n: u64,
}

/// Sandbox results of one mode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModeView {
    /// The mode, e.g. `nominal`.
    pub mode: String,
    /// What was measured in it.
    pub measures: Vec<Measure>,
}

/// One kind of recovery drill.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DrillView {
    /// The injected failure.
    pub kind: String,
    /// Drills the candidate recovered from, of how many.
    pub candidate: [u64; 2],
    /// Drills the active version recovered from, of how many.
    pub active: [u64; 2],
}

/// Everything there is to say about one version.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Detail {
    /// The version.
    pub version: CapabilityId,
    /// The version it would replace or has replaced.
    pub against: Option<CapabilityId>,
    /// The version it was made from.
    pub parent: Option<String>,
    /// Digest of manifest and bundle.
    pub digest: Digest,
    /// What the author says about it.
    pub summary: String,
    /// Who made it.
    pub author: String,
    /// How.
    pub provenance: String,
    /// Declared risk.
    pub risk: String,
    /// Virtual time of registration, ms.
    pub registered_ms: u64,
    /// The four dimensions.
    pub dimensions: Vec<DimensionResult>,
    /// The composite; reported, never gating.
    pub composite: Option<f64>,
    /// Reasons of every dimension, the deciding ones first.
    pub reasons: Vec<Reason>,
    /// Conditions of use.
    pub conditions: Vec<Condition>,
    /// Manifest against the active version's, field by field.
    pub differences: Vec<DifferenceView>,
    /// The components of the behavioural comparison; interval and limit are of the worsening, candidate against
    /// active version (paired), not of the candidate's own value.
    pub behavior: Vec<Measure>,
    /// Sandbox, mode by mode.
    pub modes: Vec<ModeView>,
    /// Drills, kind by kind.
    pub drills: Vec<DrillView>,
    /// Every decision, oldest first.
    pub decisions: Vec<ExplainedView>,
    /// Records about it, newest first.
    pub audit: Vec<AuditRow>,
    /// The digest of its evidence.
    pub evidence: Option<Digest>,
    /// What was not tested, one sentence each.
    pub untested: Vec<String>,
}
