//! Lenient forms of record bodies: records may be older or newer than this build.
//!
//! The forms are those of governance. A missing or unreadable part is absent; an unknown code stays as text.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer};
use serde_json::Value;

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
use holdpoint_registry::store_terms::RequestState;

/// The body of a `decision` record.
#[derive(Debug, Deserialize)]
pub(super) struct DecisionRecord {
    /// A string, or a string with content.
    pub(super) outcome: Value,
    #[serde(default)]
    pub(super) reasons: Vec<ReasonRecord>,
}

/// The body of a `monitor` record.
#[derive(Debug, Deserialize)]
pub(super) struct MonitorRecord {
    pub(super) action: Lenient<MonitorOutcome>,
    #[serde(default)]
    pub(super) reasons: Vec<ReasonRecord>,
}

/// A reason on record.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct ReasonRecord {
    pub(super) code: Lenient<ReasonCode>,
    #[serde(default)]
    pub(super) dimension: Option<Lenient<Dimension>>,
    /// What was found; absent in records of older builds, and in those of newer builds whose findings are not known here.
    #[serde(default, deserialize_with = "known_finding")]
    pub(super) finding: Option<Finding>,
    /// The sentence in a record of an older build.
    #[serde(default, rename = "text")]
    pub(super) older_text: String,
    #[serde(default)]
    pub(super) evidence: Option<f64>,
    #[serde(default)]
    pub(super) limit: Option<f64>,
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
    pub(super) fn content(&self) -> ReasonContent {
        let (finding, older_text) = (self.finding.clone(), self.older_text.clone());
        ReasonContent { finding, older_text, evidence: self.evidence, limit: self.limit }
    }

    /// Whether it states the same as another, whatever their numbers.
    pub(super) fn states_same(&self, other: &Self) -> bool {
        self.code == other.code && self.finding == other.finding && self.older_text == other.older_text
    }

    /// The reason in the terms of this build; `None` for a code that it does not know.
    pub(super) fn known(&self) -> Option<Reason> {
        let (code, dimension) = (*self.code.known()?, *self.dimension.as_ref()?.known()?);
        let (finding, older_text) = (self.finding.clone(), self.older_text.clone());
        Some(Reason { code, dimension, finding, older_text, evidence: self.evidence, limit: self.limit })
    }

    /// Whether it concerns this dimension.
    pub(super) fn is_about(&self, dimension: Dimension) -> bool {
        self.dimension.as_ref().is_some_and(|about| *about == dimension)
    }
}

/// The body of a `state-set` record.
#[derive(Debug, Deserialize)]
pub(super) struct StateSetRecord {
    pub(super) change: MoveRecord,
}

/// A state that changed.
#[derive(Debug, Deserialize)]
pub(super) struct MoveRecord {
    pub(super) from: State,
    pub(super) to: State,
    #[serde(default)]
    pub(super) reason: NoticeOrText,
}

/// The body of an `approval-requested` record.
#[derive(Debug, Deserialize)]
pub(super) struct RequestRecord {
    pub(super) change: RequestChangeRecord,
}

/// An approval request, new or with another state.
#[derive(Debug, Deserialize)]
pub(super) struct RequestChangeRecord {
    pub(super) state: Lenient<RequestState>,
    pub(super) deadline_ms: i64,
}

impl RequestRecord {
    /// The deadline, if the request ended without enough answers.
    pub(super) fn expired(&self) -> Option<WallTime> {
        let RequestChangeRecord { state, deadline_ms } = &self.change;
        (*state == RequestState::Expired).then(|| WallTime::from_ms(*deadline_ms))
    }
}

/// The body of a `break-glass-reviewed` record.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct ReviewRecord {
    pub(super) by: Vec<String>,
}

/// The part of a gate's decision that is explained beside its reasons.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct GateRecord {
    pub(super) answers: AnswersRecord,
}

/// The answers of a gate's decision.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct AnswersRecord {
    #[serde(deserialize_with = "readable")]
    pub(super) conditions: Option<Vec<Condition>>,
}

/// The parts of an evidence file that are explained.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct EvidenceFileRecord {
    pub(super) kappas: Option<Value>,
    #[serde(deserialize_with = "readable")]
    pub(super) behavior: Option<BehaviorAssessment>,
    #[serde(deserialize_with = "readable")]
    pub(super) drills: Option<(DrillTallies, DrillTallies)>,
    #[serde(deserialize_with = "readable")]
    pub(super) shadow: Option<ShadowAssessment>,
    #[serde(deserialize_with = "readable")]
    pub(super) pairs: Option<Vec<Pair>>,
    #[serde(deserialize_with = "readable")]
    pub(super) twins: Option<Vec<EpisodeValues>>,
    #[serde(deserialize_with = "readable")]
    pub(super) domain: Option<StartDomain>,
    #[serde(deserialize_with = "readable")]
    pub(super) permissions: Option<PermissionUse>,
    #[serde(deserialize_with = "readable")]
    pub(super) kept: Option<CachedResultUse>,
    #[serde(deserialize_with = "readable")]
    pub(super) bindings: Option<Vec<EvidenceBinding>>,
    #[serde(deserialize_with = "readable")]
    pub(super) counted: Option<CountedTry>,
}

/// The parts of a confirmation's evidence that are explained.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct ConfirmationRecord {
    #[serde(deserialize_with = "readable")]
    pub(super) kept: Option<CachedResultUse>,
}

impl EvidenceFileRecord {
    /// Whether the text was an evidence file: an assessed one has its four values.
    pub(super) const fn is_one(&self) -> bool {
        self.kappas.is_some()
    }

    /// The four assessments in the terms of this build; absent if it cannot read them.
    pub(super) fn assessments(&self) -> Option<Kappas> {
        serde_json::from_value(self.kappas.clone()?).ok()
    }
}

/// A part that this build can read; otherwise absent.
fn readable<'de, T: DeserializeOwned, D: Deserializer<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
    Value::deserialize(deserializer).map(|value| serde_json::from_value(value).ok())
}

/// A unit variant's name, or that of a variant with content.
pub(super) fn variant_name(value: &Value) -> String {
    match value {
        Value::String(name) => name.clone(),
        Value::Object(fields) => fields.keys().next().cloned().unwrap_or_else(|| "unknown".to_owned()),
        _ => "unknown".to_owned(),
    }
}
