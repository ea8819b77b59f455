//! Answers to questions about one version, the registry and the audit log: more than a snapshot carries.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::event::DimensionResult;
use super::explained::Explained;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::Reason;
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::record::{AuditRecord, VersionSummary};
use holdpoint_governance::submission::{Provenance, Risk};

/// The most rows of one page.
pub const PAGE_MAX: usize = 10_000;

/// A page of the registry, by family and semantic version.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RegistryPage {
    /// The rows.
    pub rows: Vec<VersionSummary>,
    /// How many there are in all.
    pub total: u64,
    /// The profile's limits of kappa I, P, B, R.
    pub thresholds: [f64; 4],
}

/// A page of the audit log, the newest first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuditPage {
    /// The rows.
    pub rows: Vec<AuditRecord>,
    /// Number of the newest record of the log.
    pub head: u64,
}

/// What checking the whole chain came to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Verified {
    /// Whether every record follows from the one before and the store's views follow from the log.
    pub holds: bool,
    /// Records checked.
    pub records: u64,
    /// One sentence.
    pub text: String,
}

/// A field in which two documents differ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Difference {
    /// Path of the field, e.g. `permissions.max_force_n`.
    pub field: String,
    /// Its old value, in the active version; absent where it is new.
    pub old: Option<Value>,
    /// Its new value; absent where it is gone.
    pub new: Option<Value>,
}

/// One measured value with its place between limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeView {
    /// The mode, e.g. `nominal`.
    pub mode: String,
    /// What was measured in it.
    pub measures: Vec<Measure>,
}

/// One kind of recovery drill.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DrillView {
    /// The injected failure.
    pub kind: DrillKind,
    /// Drills the candidate recovered from, of how many.
    pub candidate: [u64; 2],
    /// Drills the active version recovered from, of how many.
    pub active: [u64; 2],
}

/// Everything there is to say about one version.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Detail {
    /// The version.
    pub version: CapabilityId,
    /// The version it would replace or has replaced.
    pub against: Option<CapabilityId>,
    /// The version it was made from.
    pub parent: Option<CapabilityId>,
    /// Digest of manifest and bundle.
    pub digest: Digest,
    /// What the author says about it.
    pub summary: String,
    /// Who made it.
    pub author: String,
    /// How.
    pub provenance: Provenance,
    /// Declared risk.
    pub risk: Risk,
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
    pub differences: Vec<Difference>,
    /// The components of the behavioural comparison; interval and limit are of the worsening, candidate against
    /// active version (paired), not of the candidate's own value.
    pub behavior: Vec<Measure>,
    /// Sandbox, mode by mode.
    pub modes: Vec<ModeView>,
    /// Drills, kind by kind.
    pub drills: Vec<DrillView>,
    /// Every decision, oldest first.
    pub decisions: Vec<Explained>,
    /// Records about it, newest first.
    pub audit: Vec<AuditRecord>,
    /// The digest of its evidence.
    pub evidence: Option<Digest>,
    /// What was not tested, one sentence each.
    pub untested: Vec<String>,
}
