//! Lenient forms of record bodies: records may be older or newer than this build.
//!
//! The forms are those of governance. A missing or unreadable part is absent; an unknown code stays as text.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer};
use serde_json::Value;

use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::behavior::BehaviorAssessment;
use holdpoint_governance::cached_result::CachedResultUse;
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::composition::Kappas;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::evidence::{DrillTallies, EpisodeValues, EvidenceBinding, Pair};
use holdpoint_governance::explanation::ReasonContent;
use holdpoint_governance::finding::Finding;
use holdpoint_governance::gate::ShadowAssessment;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::notice::NoticeOrText;
use holdpoint_governance::permission::PermissionUse;
use holdpoint_governance::start_domain::StartDomain;
use holdpoint_governance::tries::CountedTry;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_store::RequestState;

/// The body of a `decision` record.
#[derive(Debug, Deserialize)]
pub struct DecisionRecord {
    /// A string, or a string with content.
    pub outcome: Value,
    #[serde(default)]
    pub reasons: Vec<ReasonRecord>,
}

/// The body of a `monitor` record.
#[derive(Debug, Deserialize)]
pub struct MonitorRecord {
    pub action: Lenient<MonitorOutcome>,
    #[serde(default)]
    pub reasons: Vec<ReasonRecord>,
}

/// A reason on record.
#[derive(Clone, Debug, Deserialize)]
pub struct ReasonRecord {
    pub code: Lenient<ReasonCode>,
    #[serde(default)]
    pub dimension: Option<Lenient<Dimension>>,
    /// What was found; absent in records of older builds, and in those of newer builds whose findings are not known here.
    #[serde(default, deserialize_with = "known_finding")]
    pub finding: Option<Finding>,
    /// The sentence in a record of an older build.
    #[serde(default, rename = "text")]
    pub older_text: String,
    #[serde(default)]
    pub evidence: Option<f64>,
    #[serde(default)]
    pub limit: Option<f64>,
}

impl From<&Reason> for ReasonRecord {
    fn from(reason: &Reason) -> Self {
        Self {
            code: reason.code.into(),
            dimension: Some(reason.dimension.into()),
            finding: reason.finding.clone(),
            older_text: reason.older_text.clone(),
            evidence: reason.evidence,
            limit: reason.limit,
        }
    }
}

fn known_finding<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Finding>, D::Error> {
    let value = Option::<serde_json::Value>::deserialize(from)?;
    Ok(value.and_then(|value| serde_json::from_value(value).ok()))
}

impl ReasonRecord {
    /// What was found, with its numbers.
    #[must_use]
    pub fn content(&self) -> ReasonContent {
        let (finding, older_text) = (self.finding.clone(), self.older_text.clone());
        ReasonContent { finding, older_text, evidence: self.evidence, limit: self.limit }
    }

    /// Whether it states the same as another, whatever their numbers.
    #[must_use]
    pub fn states_same(&self, other: &Self) -> bool {
        self.code == other.code && self.finding == other.finding && self.older_text == other.older_text
    }

    /// The reason in the terms of this build; `None` for a code that it does not know.
    #[must_use]
    pub fn known(&self) -> Option<Reason> {
        let (code, dimension) = (*self.code.known()?, *self.dimension.as_ref()?.known()?);
        let (finding, older_text) = (self.finding.clone(), self.older_text.clone());
        Some(Reason { code, dimension, finding, older_text, evidence: self.evidence, limit: self.limit })
    }

    /// Whether it concerns this dimension.
    #[must_use]
    pub fn is_about(&self, dimension: Dimension) -> bool {
        self.dimension.as_ref().is_some_and(|about| *about == dimension)
    }
}

/// The body of a `state-set` record.
#[derive(Debug, Deserialize)]
pub struct StateSetRecord {
    pub change: MoveRecord,
}

/// A state that changed.
#[derive(Debug, Deserialize)]
pub struct MoveRecord {
    pub from: State,
    pub to: State,
    #[serde(default)]
    pub reason: NoticeOrText,
}

/// The body of an `approval-put` record.
#[derive(Debug, Deserialize)]
pub struct AnswerRecord {
    pub change: AnswerChangeRecord,
}

/// A person's answer.
#[derive(Debug, Deserialize)]
pub struct AnswerChangeRecord {
    pub who: String,
    pub role: Role,
    pub decision: ApprovalDecision,
    pub reason: String,
}

/// The body of an `approval-requested` record.
#[derive(Debug, Deserialize)]
pub struct RequestRecord {
    pub change: RequestChangeRecord,
}

/// An approval request, new or with another state.
#[derive(Debug, Deserialize)]
pub struct RequestChangeRecord {
    pub state: Lenient<RequestState>,
    pub deadline_ms: i64,
}

impl RequestRecord {
    /// The deadline, if the request ended without enough answers.
    #[must_use]
    pub fn expired(&self) -> Option<WallTime> {
        let RequestChangeRecord { state, deadline_ms } = &self.change;
        (*state == RequestState::Expired).then(|| WallTime::from_ms(*deadline_ms))
    }
}

/// The body of a `break-glass-reviewed` record.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct ReviewRecord {
    pub by: Vec<String>,
}

/// The part of a gate's decision that is explained beside its reasons.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct GateRecord {
    pub answers: AnswersRecord,
}

/// The answers of a gate's decision.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct AnswersRecord {
    #[serde(deserialize_with = "readable")]
    pub conditions: Option<Vec<Condition>>,
}

/// The parts of an evidence file that are explained.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct EvidenceFileRecord {
    pub kappas: Option<Value>,
    #[serde(deserialize_with = "readable")]
    pub behavior: Option<BehaviorAssessment>,
    #[serde(deserialize_with = "readable")]
    pub drills: Option<(DrillTallies, DrillTallies)>,
    #[serde(deserialize_with = "readable")]
    pub shadow: Option<ShadowAssessment>,
    #[serde(deserialize_with = "readable")]
    pub pairs: Option<Vec<Pair>>,
    #[serde(deserialize_with = "readable")]
    pub twins: Option<Vec<EpisodeValues>>,
    #[serde(deserialize_with = "readable")]
    pub domain: Option<StartDomain>,
    #[serde(deserialize_with = "readable")]
    pub permissions: Option<PermissionUse>,
    #[serde(deserialize_with = "readable")]
    pub kept: Option<CachedResultUse>,
    #[serde(deserialize_with = "readable")]
    pub bindings: Option<Vec<EvidenceBinding>>,
    #[serde(deserialize_with = "readable")]
    pub counted: Option<CountedTry>,
}

/// The parts of a confirmation's evidence that are explained.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct ConfirmationRecord {
    #[serde(deserialize_with = "readable")]
    pub kept: Option<CachedResultUse>,
}

impl EvidenceFileRecord {
    /// Whether the text was an evidence file: an assessed one has its four values.
    #[must_use]
    pub const fn is_one(&self) -> bool {
        self.kappas.is_some()
    }

    /// The four assessments in the terms of this build; absent if it cannot read them.
    #[must_use]
    pub fn assessments(&self) -> Option<Kappas> {
        serde_json::from_value(self.kappas.clone()?).ok()
    }
}

/// A part that this build can read; otherwise absent.
fn readable<'de, T: DeserializeOwned, D: Deserializer<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
    Value::deserialize(deserializer).map(|value| serde_json::from_value(value).ok())
}

/// A unit variant's name, or that of a variant with content.
#[must_use]
pub fn variant_name(value: &Value) -> String {
    match value {
        Value::String(name) => name.clone(),
        Value::Object(fields) => fields.keys().next().cloned().unwrap_or_else(|| "unknown".to_owned()),
        _ => "unknown".to_owned(),
    }
}
